//! The board file that is open in the configurator goes to a board, by keyboard and after a
//! question. The simulated board refuses it: its pins are part of its image. That a card whose pins
//! are configured takes it, and gives it back, is tested in `host/tests/ui.rs`.

use super::{Server, board, in_order};
use crate::browser::{Browser, ENTER, TAB};
use ferrocnc_tests::{program, root};
use std::process::Command;

/// What the command complains of.
fn complaint(arguments: &[&str]) -> String {
    let mut tool = Command::new(program("ferrocnc"));
    let done = tool.args(arguments).output().expect("the tool");
    assert!(!done.status.success(), "{arguments:?} was taken");
    let said = String::from_utf8(done.stderr).expect("a text");
    said.trim_end().trim_start_matches("ferrocnc: ").to_owned()
}

#[test]
fn a_board_with_fixed_pins_takes_no_file_and_the_page_says_what_the_command_says() {
    let (board, _) = board();
    let (server, browser) = (Server::start(), Browser::start("applied"));
    let at = board.udp().to_string();
    let file = root().join("boards/mill6.toml").display().to_string();
    browser.open(&server.page("configurator"));
    let refused = |arguments: &[&str]| {
        let said = complaint(arguments);
        assert!(
            said.contains("the pins of this board are part of its image"),
            "{said}"
        );
        browser.says(&said);
    };

    // Nothing is open yet: what the board has is asked for first.
    browser.fill_labelled("Board", &at);
    browser.click(&browser.button(&format!("Read from {at}")));
    refused(&["config", "read", &at]);
    // The browser writes down every refusal of a request.
    let complaints = browser.complaints();
    assert_eq!(complaints.len(), 1, "{complaints:#?}");

    browser.write(&browser.find("input[type=file]"), &file);
    browser.says("It can be built.");
    assert!(browser.all("p.problem").is_empty(), "{}", browser.text());
    let apply = format!("Apply to {at}");
    let is_off = || {
        let script = "return [...document.querySelectorAll('button')] \
                      .find((it) => it.textContent === arguments[0]).disabled";
        browser.js(script, &[apply.as_str().into()]) == true
    };
    let good = browser.value_of("textarea");
    browser.fill("textarea", &good.replacen("\"j1:1\"", "\"j1:0\"", 1));
    browser.until("a file with an error cannot be applied", is_off);
    browser.fill("textarea", &good);
    browser.until("the right one can", || !is_off());
    in_order(&browser);

    browser.until("the button has the focus", || {
        browser.focused() == apply || {
            browser.press(TAB);
            false
        }
    });
    browser.press(ENTER);
    browser.says(&format!("mill6 for 5a-75b-8.0 to the board at {at}"));
    in_order(&browser);
    // Its first button leaves all as it is.
    assert_eq!(browser.focused(), "Cancel");
    browser.press(TAB);
    assert_eq!(browser.focused(), "Apply it");
    browser.press(ENTER);
    refused(&["config", "apply", &at, &file]);
    let alerts = browser.all(".with-board [role=alert]");
    assert_eq!(alerts.len(), 1, "a screen reader says it");
    assert!(!is_off(), "it can be tried again");
    in_order(&browser);
    browser.picture("applied");
}
