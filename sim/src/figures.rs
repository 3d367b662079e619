//! Figures that tests and benches leave in `target/reports`, from which `docs/figures.json` takes
//! them.

use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fmt::Debug;
use std::path::Path;
use std::sync::Mutex;

/// Puts a part into `target/reports/NAME.json`, beside what other tests put there.
pub fn report_part(name: &str, part: &str, figures: Value) {
    static WRITING: Mutex<()> = Mutex::new(());
    let _writing = WRITING.lock();
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../target/reports");
    std::fs::create_dir_all(&folder).expect("a folder for reports");
    let path = folder.join(format!("{name}.json"));
    let before = std::fs::read_to_string(&path).unwrap_or_default();
    let mut all: Value = serde_json::from_str(&before).unwrap_or_else(|_| json!({}));
    all[part] = figures;
    std::fs::write(&path, format!("{all:#}\n")).expect("the report");
}

/// Stops of random machines: what the worst of each kind has used of the way it is allowed.
#[derive(Debug, Default)]
pub struct Used(BTreeMap<String, (u64, f64)>);

impl Used {
    /// One of this kind.
    pub fn see(&mut self, kind: impl Debug, used: f64) {
        let (count, worst) = self.0.entry(format!("{kind:?}")).or_default();
        *count += 1;
        *worst = worst.max(used);
    }

    /// Prints each kind, and puts the runs and the worst of all into `target/reports/stops.json`,
    /// with what else was found.
    pub fn report(&self, part: &str, more: Value) {
        for (kind, (count, worst)) in &self.0 {
            println!("{part}, {kind}: {count}, at most {worst:.3} of the way allowed");
        }
        let runs: u64 = self.0.values().map(|(count, _)| count).sum();
        let worst = self.0.values().map(|(_, worst)| *worst);
        let used = worst.fold(0.0, f64::max);
        let figures = json!({ "runs": runs, "used_max": used, "more": more });
        report_part("stops", part, figures);
    }
}
