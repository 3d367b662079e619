//! Runs cargo-deny with `deny.toml`: licences, sources and bans, and advisories if their database
//! has been fetched. It never uses the network, but for its own installation.

use crate::{setup, step};
use anyhow::Result;
use std::env;
use std::path::{Path, PathBuf};
use std::process::Command;

/// How to get what is missing.
const FETCH: &str = "`cargo deny fetch db` brings the database of advisories";

/// Checks the dependencies.
pub fn check() -> Result<()> {
    let tool = setup::cargo_deny()?;
    let checks = checks(&databases());
    if !checks.contains(&"advisories") {
        step::note(&format!("cargo-deny checks no advisories; {FETCH}"));
    }
    let mut deny = Command::new(tool);
    deny.args(["--offline", "check"]).args(checks);
    step::run("lint-deny", "cargo-deny", "2 s", &mut deny)
}

/// The checks that need no network: that of advisories needs a database in this folder.
/// cargo-deny leaves a lock file there even if it could not fetch one.
fn checks(databases: &Path) -> Vec<&'static str> {
    let mut checks = vec!["bans", "licenses", "sources"];
    let fetched = databases
        .read_dir()
        .is_ok_and(|all| all.flatten().any(|entry| entry.path().is_dir()));
    checks.extend(fetched.then_some("advisories"));
    checks
}

/// The folder in which cargo-deny keeps databases of advisories.
fn databases() -> PathBuf {
    let home = || PathBuf::from(env::var_os("HOME").unwrap_or_default()).join(".cargo");
    env::var_os("CARGO_HOME")
        .map_or_else(home, PathBuf::from)
        .join("advisory-dbs")
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn advisories_are_checked_where_a_database_has_been_fetched() {
        let folder = crate::target("tmp/advisory-dbs");
        let _ = fs::remove_dir_all(&folder);
        assert!(!checks(&folder).contains(&"advisories"), "no folder");
        fs::create_dir_all(&folder).unwrap();
        assert!(!checks(&folder).contains(&"advisories"), "an empty folder");
        fs::write(folder.join("db.lock"), "").unwrap();
        assert!(!checks(&folder).contains(&"advisories"), "a lock alone");
        fs::create_dir(folder.join("advisory-db-1")).unwrap();
        let found = checks(&folder);
        fs::remove_dir_all(&folder).unwrap();
        assert_eq!(found, ["bans", "licenses", "sources", "advisories"]);
    }
}
