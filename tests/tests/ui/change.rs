//! What changes a board: its settings, its key and its image. After a question each, and refused in
//! the command's words while the board is armed.

use super::{Server, in_order};
use crate::browser::{Browser, ENTER, TAB};
use ferrocnc_tests::driver::Driver;
use ferrocnc_tests::flash::{self, SECOND, UID, factory};
use ferrocnc_tests::{Simulator, program};
use sim::nor::Part;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// An empty folder, which goes with the test.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let folder = std::env::temp_dir().join(format!("ferrocnc-{name}-{}", std::process::id()));
        let _none = std::fs::remove_dir_all(&folder);
        std::fs::create_dir_all(&folder).expect("a folder");
        Folder(folder)
    }

    fn file(&self, name: &str, bytes: &[u8]) -> String {
        let path = self.0.join(name);
        std::fs::write(&path, bytes).expect("a file");
        path.display().to_string()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// The tool with a home of its own: keys are kept there.
fn tool(home: &Path) -> Command {
    let mut command = Command::new(program("ferrocnc"));
    command.env("XDG_CONFIG_HOME", home);
    command
}

/// A board with a flash, and a page that shows it.
struct Scene {
    folder: Folder,
    board: Simulator,
    _server: Server,
    browser: Browser,
}

fn scene(name: &str) -> Scene {
    let folder = Folder::new(name);
    let cells = folder.0.join("board.flash");
    let nor = factory(Part::W25Q32JV, UID);
    nor.leave_in(&cells).expect("two files");
    let board = Simulator::twin(&["--mode", "free", "--flash", &cells.display().to_string()]);
    let (server, browser) = (Server::run(tool(&folder.0)), Browser::start(name));
    browser.open(&server.page(&format!("boards/{}", board.udp())));
    browser.says("60 MHz");
    for part in ["Settings", "Key", "Update"] {
        browser.open_part(part);
    }
    Scene {
        folder,
        board,
        _server: server,
        browser,
    }
}

#[test]
fn settings_are_saved_after_a_question_by_keyboard() {
    let scene = scene("settings");
    let browser = &scene.browser;
    in_order(browser);
    let save = browser.button("Save settings");
    browser.fill_labelled("Name", "mill");
    browser.fill_labelled("Syslog server", "192.168.2.9");
    browser.click(&save);
    browser.says("none becomes mill");
    in_order(browser);
    // Its first button leaves all as it is.
    assert_eq!(browser.focused(), "Cancel");
    browser.press(ENTER);
    browser.until("the question is gone", || browser.all("dialog").is_empty());
    browser.click(&save);
    browser.says("192.168.2.9");
    browser.press(TAB);
    assert_eq!(browser.focused(), "Save them");
    browser.press(ENTER);
    browser.says("saved; the board restarts at");
    browser.says("mill, 192.168.2.50/24");

    // What no board can have: the command's words.
    browser.fill_labelled("Address", "192.168.2.255/24");
    browser.click(&save);
    browser.click(&browser.button("Save them"));
    browser.says("no board can have this address");
}

#[test]
fn a_key_is_made_compared_and_removed_and_a_foreign_one_is_set_from_its_file() {
    let scene = scene("keys");
    let (browser, folder) = (&scene.browser, &scene.folder);
    let told = |button: &str, yes: &str, says: &str| {
        browser.click(&browser.button(button));
        browser.click(&browser.button(yes));
        browser.says(says);
    };
    told("New key", "Make it", "(fingerprint ");
    browser.click(&browser.button("Compare keys"));
    browser.says("they fit");
    let theirs = folder.file(
        "theirs.key",
        format!("{}\n", "0123456789abcdef".repeat(2)).as_bytes(),
    );
    let chooser = browser.find("input[accept='.key']");
    browser.write(&chooser, &theirs);
    told("Set this key", "Set it", "(fingerprint ");
    browser.click(&browser.button("Compare keys"));
    browser.says("they fit");
    browser.write(&chooser, &folder.file("no.key", b"hello"));
    told(
        "Set this key",
        "Set it",
        "no.key holds no key: one line of 32 hex digits",
    );
    told("Remove the key", "Remove it", "has no key any more");
}

#[test]
fn an_image_is_written_and_the_one_before_is_selected_again() {
    let scene = scene("update");
    let (browser, folder) = (&scene.browser, &scene.folder);
    let chooser = browser.find("input[accept='.bit']");
    let write = |path: &str, says: &str| {
        browser.write(&chooser, path);
        browser.click(&browser.button("Write this file"));
        browser.click(&browser.button("Write it"));
        browser.says(says);
    };
    write(&folder.file("wrong.bit", b"hello"), "wrong.bit: ");
    browser.says("not an ECP5 bitstream");
    write(
        &folder.file("second.bit", &flash::bit(SECOND, 14)),
        "verified and selected",
    );
    browser.says("slot B, build bbbb0002");
    browser.picture("update");
    let back = || {
        browser.click(&browser.button("Back to the image before"));
        browser.click(&browser.button("Select it"));
    };
    back();
    browser.says("build aaaa0001, and is selected");
    // And forth again.
    back();
    browser.says("build bbbb0002, and is selected");
}

/// Ends the host's thread, whatever becomes of the test.
struct End<'o>(&'o AtomicBool);

impl Drop for End<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

#[test]
fn a_board_that_is_armed_is_not_changed_and_the_page_says_what_the_command_says() {
    let scene = scene("armed");
    let (browser, folder, board) = (&scene.browser, &scene.folder, &scene.board);
    let file = folder.file("second.bit", &flash::bit(SECOND, 14));
    browser.write(&browser.find("input[accept='.bit']"), &file);
    browser.fill_labelled("Name", "mill");
    let at = board.udp().to_string();
    let over = AtomicBool::new(false);
    let mut driver = Driver::armed(board.udp());
    let enabled = std::thread::scope(|scope| {
        let end = End(&over);
        let host = scope.spawn(|| {
            let mut enabled = true;
            while !over.load(Ordering::Relaxed) {
                enabled &= driver.exchange().state.enabled;
                std::thread::sleep(Duration::from_millis(1));
            }
            enabled
        });
        for (parts, button, yes, command) in [
            (
                1,
                "Save settings",
                "Save them",
                &["set", &at, "--name", "mill"][..],
            ),
            (2, "New key", "Make it", &["key", "new", &at]),
            (3, "Write this file", "Write it", &["update", &at, &file]),
            (
                3,
                "Back to the image before",
                "Select it",
                &["update", &at, "--back"],
            ),
        ] {
            let done = tool(&folder.0).args(command).output().expect("the tool");
            let said = String::from_utf8_lossy(&done.stderr).into_owned();
            assert!(!done.status.success(), "{command:?} was taken");
            let said = said.lines().last().unwrap_or_default();
            let said = said.trim_start_matches("ferrocnc: ");
            assert!(said.contains("armed") || said.contains("driven"), "{said}");
            browser.click(&browser.button(button));
            browser.click(&browser.button(yes));
            // Each part of the page says it for itself.
            browser.until(&format!("{button}: {said}"), || {
                let text = browser.text();
                text.matches(said).count() >= parts && !text.contains("Working")
            });
        }
        drop(end);
        host.join().expect("it exchanges")
    });
    assert!(enabled, "it stays armed");
}
