//! What the doctor repairs, and takes back: on this computer's own paths, but in a mount namespace
//! in which they are files of the test.

use super::{Server, in_order};
use crate::browser::Browser;
use ferrocnc_tests::program;
use std::process::Command;

/// Runs the tool over the two.
const NAMESPACE: &str = r#"
    mount --bind "$1/tmpfiles.d" /etc/tmpfiles.d &&
    mount --bind "$1/throttling" /proc/sys/kernel/sched_rt_runtime_us &&
    shift && exec "$@""#;

#[test]
fn nothing_is_repaired_before_the_question_that_shows_what_is_written_is_answered() {
    let folder = std::env::temp_dir().join(format!("ferrocnc-repairs-{}", std::process::id()));
    let tmpfiles = folder.join("tmpfiles.d");
    std::fs::create_dir_all(&tmpfiles).expect("a folder");
    let value = folder.join("throttling");
    let put = |text: &str| std::fs::write(&value, text).expect("a value");
    let now = || {
        std::fs::read_to_string(&value)
            .expect("a value")
            .trim()
            .to_owned()
    };
    put("950000\n");
    let kept = tmpfiles.join("ferrocnc-throttling.conf");

    let mut command = Command::new("unshare");
    command
        .args(["--map-root-user", "--mount", "sh", "-c", NAMESPACE, "sh"])
        .arg(&folder)
        .arg(program("ferrocnc"));
    let (server, browser) = (Server::run(command), Browser::start("repairs"));
    browser.open(&server.page("doctor"));
    let repair = || browser.click(&browser.button("Repair real-time throttling"));
    repair();
    browser.says("/proc/sys/kernel/sched_rt_runtime_us: 950000 becomes -1");
    browser.says("w /proc/sys/kernel/sched_rt_runtime_us - - - - -1");
    in_order(&browser);
    browser.picture("repair");
    browser.click(&browser.button("Cancel"));
    assert_eq!((now().as_str(), kept.exists()), ("950000", false));

    // What is to be written has changed since it was shown.
    repair();
    put("800000\n");
    browser.click(&browser.button("Write it"));
    browser.says("not what was shown any more");
    assert_eq!((now().as_str(), kept.exists()), ("800000", false));

    put("950000\n");
    browser.click(&browser.button("Look again"));
    browser.until("it has looked", || {
        repair();
        let is_new = browser.text().contains("950000 becomes -1");
        browser.click(&browser.button(if is_new { "Write it" } else { "Cancel" }));
        is_new
    });
    browser.says("real-time throttling: repaired");
    assert_eq!((now().as_str(), kept.exists()), ("-1", true));

    browser.click(&browser.button("Take back etc/tmpfiles.d/ferrocnc-throttling.conf"));
    browser.says("-1 becomes 950000");
    browser.click(&browser.button("Take it back"));
    browser.says("ferrocnc-throttling.conf: taken back");
    assert_eq!((now().as_str(), kept.exists()), ("950000", false));
    drop(server);
    let _ = std::fs::remove_dir_all(&folder);
}
