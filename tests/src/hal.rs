//! LinuxCNC's HAL for tests: a folder per run, and `halrun` on a file. HAL exists once per machine.

use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// What a session that is ending may take.
const ENDING: Duration = Duration::from_secs(20);

pub use crate::root;

/// An empty folder for a run of this name.
pub fn out(name: &str) -> PathBuf {
    let folder = root().join("target/linuxcnc").join(name);
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).expect("a folder for the run");
    folder
}

/// Waits until a session that is ending has ended: LinuxCNC's scripts wait 5 s for it and then go.
fn nothing_runs() {
    let until = Instant::now() + ENDING;
    loop {
        let listed = Command::new("ps")
            .args(["-C", "rtapi_app", "-o", "stat="])
            .output()
            .expect("ps");
        let states = String::from_utf8_lossy(&listed.stdout);
        if states.split_whitespace().all(|it| it.starts_with('Z')) {
            return;
        }
        assert!(Instant::now() < until, "another HAL session is running");
        std::thread::sleep(Duration::from_millis(100));
    }
}

/// Runs a HAL file without LinuxCNC's task; what it said.
pub fn halrun(name: &str, hal: &str) -> String {
    nothing_runs();
    let folder = out(name);
    let file = folder.join("test.hal");
    std::fs::write(&file, hal).expect("the HAL file");
    let done = Command::new("timeout")
        .args(["-k", "5", "120", "halrun"])
        .arg(&file)
        .env("RTAPI_UID", "1000")
        .env(
            "RTAPI_FIFO_PATH",
            format!("/tmp/ferrocnc_test_fifo_{}", std::process::id()),
        )
        .stdin(Stdio::null())
        .output()
        .expect("halrun, which `cargo xtask setup` installs");
    let said = format!(
        "{}{}",
        String::from_utf8_lossy(&done.stdout),
        String::from_utf8_lossy(&done.stderr)
    );
    std::fs::write(folder.join("said.txt"), &said).expect("its words");
    said
}
