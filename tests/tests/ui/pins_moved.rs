//! The configurator's pins: dragged, moved by the list, compared with a board, and printed.

use super::{Server, board, in_order};
use crate::browser::Browser;
use ferrocnc_tests::root;

#[test]
fn what_is_on_a_pin_goes_to_another_and_a_board_says_what_it_has_instead() {
    let (board, _) = board();
    let (server, browser) = (Server::start(), Browser::start("pins"));
    browser.open(&server.page("configurator"));
    let file = root().join("boards/mill6.toml");
    let committed = std::fs::read_to_string(&file).expect("a board file");
    browser.write(
        &browser.find("input[type=file]"),
        &file.display().to_string(),
    );
    browser.says("It can be built.");
    browser.until("the card is drawn", || browser.all(".pin").len() >= 128);
    let text = || browser.value_of("textarea");
    let compare = |says: &str| {
        browser.fill_labelled("Board", &board.udp().to_string());
        browser.click(&browser.button("Compare"));
        browser.says(says);
    };
    compare("has what this file says");

    // STEP and DIR of the first axis change places, and back: the text is as it was.
    let pin = |name: &str| browser.button(&format!("{name}, pin"));
    browser.drag(&pin("j1:0"), &pin("j1:1"));
    browser.until("the text says so", || text() != committed);
    assert!(
        text().contains("step = \"j1:1\"\ndir = \"j1:0\""),
        "{}",
        text()
    );
    browser.says("It can be built.");
    compare("stepgen 0");
    browser.says("step=j1:0 dir=j1:1");
    in_order(&browser);
    browser.until("the card shows it", || {
        browser.label(&pin("j1:1")).contains("step")
    });
    browser.click(&pin("j1:1"));
    browser.choose(".editor form select", "j1:0");
    browser.click(&browser.button("Move"));
    browser.until("the text is as it was", || text() == committed);

    // On paper the card, and not the text.
    browser.says("It can be built.");
    browser.medium("print");
    let shown = |css: &str| browser.is_shown(&browser.find(css));
    assert!(shown(".card .pin") && !shown("textarea") && !shown("nav"));
    browser.medium("");
    assert!(shown("textarea"));
    assert!(browser.pdf().starts_with("JVBERi0"), "a PDF in base64");
}
