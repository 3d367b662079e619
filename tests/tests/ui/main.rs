//! The pages of `ferrocnc ui` in a real browser against the twin. Pictures of them are left in
//! `target/reports`. Which requests the server answers is tested in `host/tests/ui.rs`.

mod applied;
mod browser;
mod change;
mod pins_moved;
mod repairs;

use browser::{Browser, DOWN, ENTER, RIGHT, TAB};
use ferrocnc_tests::driver::Driver;
use ferrocnc_tests::plotter::Plotter;
use ferrocnc_tests::{Simulator, control, program, root};
use ferrocnc_tests::{drawing, pins};
use std::cell::RefCell;
use std::io::{BufRead as _, BufReader};
use std::net::{SocketAddr, UdpSocket};
use std::process::{Child, Command, Stdio};
use wire::jobs::End;

/// The server; it ends with the test.
struct Server {
    child: Child,
    address: String,
}

impl Server {
    /// In an empty folder, so that no checkout is needed.
    fn start() -> Self {
        Self::run(Command::new(program("ferrocnc")))
    }

    /// The same by this command.
    fn run(mut command: Command) -> Self {
        // As long as a busy computer may take for an exchange.
        command
            .args(["ui", "--no-open", "--patience", "1000"])
            .current_dir(std::env::temp_dir());
        let mut child = command.stdout(Stdio::piped()).spawn().expect("the tool");
        let mut line = String::new();
        let output = child.stdout.take().expect("its output");
        BufReader::new(output)
            .read_line(&mut line)
            .expect("the address");
        let address = line.trim().to_owned();
        Server { child, address }
    }

    fn page(&self, page: &str) -> String {
        format!("{}#{page}", self.address)
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A free port of this computer for datagrams.
fn free() -> SocketAddr {
    let socket = UdpSocket::bind("127.0.0.1:0").and_then(|socket| socket.local_addr());
    socket.expect("a free port")
}

/// A board whose time passes by itself; where it is discovered.
fn board() -> (Simulator, SocketAddr) {
    let at = free();
    let discovery = at.to_string();
    let board = Simulator::twin(&["--mode", "free", "--discovery", &discovery]);
    (board, at)
}

/// Nothing has failed in the browser, everything that can be used has a role and a name, light and
/// dark keep no reader out, and a tablet shows the page without scrolling sideways.
#[track_caller]
fn in_order(browser: &Browser) {
    for scheme in ["dark", "light"] {
        browser.scheme(scheme);
        let barriers = browser.barriers();
        assert!(barriers.is_empty(), "{scheme}: {barriers:#?}");
    }
    browser.tablet(true);
    let wider = "const page = document.documentElement; return page.scrollWidth - page.clientWidth";
    let wider = browser.js(wider, &[]);
    browser.tablet(false);
    assert_eq!(wider, 0, "pixels that a tablet does not show");
    let complaints = browser.complaints();
    assert!(complaints.is_empty(), "{complaints:#?}");
    // Behind a question nothing can be used.
    let controls = match browser.all("dialog").is_empty() {
        true => browser.all("a, input, select, textarea, summary, button:not(.pin)"),
        false => browser.all("dialog button"),
    };
    assert!(controls.len() > 1, "{}", controls.len());
    for it in controls.into_iter().filter(|it| browser.is_shown(it)) {
        let (role, label) = (browser.role(&it), browser.label(&it));
        assert!(
            !role.is_empty() && !label.is_empty(),
            "{it:?}: {role} {label:?}"
        );
    }
}

#[test]
fn boards_are_found_and_described() {
    let (board, discovery) = board();
    let (server, browser) = (Server::start(), Browser::start("boards"));
    browser.open(&server.address);
    browser.until("the first look is over", || {
        let text = browser.text();
        text.contains("answer") && !text.contains("Asking")
    });
    browser.fill("section input", &discovery.to_string());
    browser.click(&browser.button("Look again"));
    browser.says("1 board answers");
    browser.says("mill6");
    browser.open(&server.page(&format!("boards/{}", board.udp())));
    browser.says("60 MHz");
    browser.says("step=j1:0 dir=j1:1");
    in_order(&browser);
    browser.picture("boards");
}

/// How many plots have something in a colour: a line or a bar. Axes and grid are grey.
const DRAWN: &str = "const has = (it) => { \
    const { data } = it.getContext('2d').getImageData(0, 0, it.width, it.height); \
    for (let n = 0; n < data.length; n += 4) { \
        const [red, green, blue, cover] = data.subarray(n, n + 4); \
        const spread = Math.max(red, green, blue) - Math.min(red, green, blue); \
        if (cover > 200 && spread > 60) return true; } \
    return false; }; \
    return [...document.querySelectorAll('.plot canvas')].filter(has).length";

#[test]
fn a_fault_is_told_with_its_remedy_and_a_board_may_go_and_come_back() {
    let (board, _) = board();
    let (server, browser) = (Server::start(), Browser::start("dashboard"));
    browser.open(&server.page(&format!("dashboard/{}", board.udp())));
    browser.says("DISARMED");
    // A host that falls silent.
    drop(Driver::armed(board.udp()));
    browser.says("FAULTED");
    browser.says("check cable, switch and the computer's latency");
    browser.until("its lines are drawn", || browser.js(DRAWN, &[]) == 4);
    let plots = browser.all(".plot");
    let said = browser.label(&plots[0]);
    assert!(said.starts_with("Positions, steps: x "), "{said}");
    in_order(&browser);
    browser.picture("dashboard");
    control(board.control(), "ext-reset 1");
    browser.until("the reset is told", || {
        browser.text().contains("External reset\nactive")
    });

    control(board.control(), "fault pull");
    browser.says("What it said last");
    control(board.control(), "fault plug");
    browser.until("it is back", || {
        !browser.text().contains("What it said last")
    });
    browser.scheme("dark");
    browser.picture("dashboard-dark");
}

#[test]
fn a_board_file_is_made_drawn_edited_and_downloaded() {
    let (server, browser) = (Server::start(), Browser::start("configurator"));
    browser.open(&server.page("configurator"));
    browser.until("the cards are listed", || !browser.all("option").is_empty());
    browser.click(&browser.button("Make it"));
    browser.says("It can be built.");
    browser.until("the card is drawn", || browser.all(".pin").len() >= 128);
    in_order(&browser);
    browser.picture("configurator");

    // Point at a pin: its line is shown.
    let pin = browser.button("j1:0, pin 1");
    browser.click(&pin);
    let chosen = "const it = document.querySelector('textarea'); \
                  return it.value.slice(it.selectionStart, it.selectionEnd)";
    assert_eq!(browser.js(chosen, &[]), "\"j1:0\"");

    // A pin that is used twice, and taken back.
    let good = browser.value_of("textarea");
    let wrong = good.replacen("\"j1:1\"", "\"j1:0\"", 1);
    browser.fill("textarea", &wrong);
    browser.says("REFUSED");
    browser.click(&browser.button("Line "));
    let line = browser.js(chosen, &[]);
    assert!(
        line.as_str().is_some_and(|line| line.contains("j1:0")),
        "{line}"
    );
    browser.picture("configurator-refused");
    let commented = format!("# mine\n{good}");
    browser.fill("textarea", &commented);
    browser.says("It can be built.");

    browser.click(&browser.button("Download TOML"));
    assert_eq!(browser.downloaded("my-machine.toml"), commented);
    browser.click(&browser.button("Download SVG"));
    let svg = browser.downloaded("my-machine.svg");
    assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"));
}

#[test]
fn files_of_lcnc_and_litexcnc_are_imported_where_they_are_dropped() {
    let (server, browser) = (Server::start(), Browser::start("import"));
    browser.open(&server.page("configurator"));
    browser.says("Open or import");
    // One by the chooser, which the keyboard reaches, one dropped.
    let lcnc = root().join("config/tests/samples/router.ini");
    let chooser = browser.find("input[type=file]");
    browser.write(&chooser, &lcnc.display().to_string());
    browser.says("It can be built.");
    assert!(browser.value_of("textarea").contains("name = \"router\""));
    let theirs = root().join("host/examples/peers/litexcnc.json");
    let theirs = std::fs::read_to_string(theirs).expect("a file");
    browser.drop_file("litexcnc.json", &theirs);
    browser.until("it is in the place of the other", || {
        browser.value_of("textarea").contains("name = \"litexcnc\"")
    });
    browser.says("It can be built.");
    browser.drop_file("conf.ini", "[nonsense]\nx = 1\n");
    browser.until("it is refused", || !browser.all("p.problem").is_empty());
    browser.drop_file("drawing.svg", "<svg/>");
    browser.says("drawing.svg: a board file ends in .toml");
}

#[test]
fn the_doctor_lists_what_it_found() {
    let (board, _) = board();
    let (server, browser) = (Server::start(), Browser::start("doctor"));
    browser.open(&server.page(&format!("doctor/{}", board.udp())));
    browser.says("board and tool");
    browser.until("findings", || browser.all(".findings li").len() > 10);
    in_order(&browser);
    browser.picture("doctor");
}

#[test]
fn a_machine_is_asked_for_drawn_and_the_files_shown_are_those_that_the_command_writes() {
    let (server, browser) = (Server::start(), Browser::start("machine"));
    browser.open(&server.page("machine"));
    browser.until("the samples are listed", || {
        !browser.all("option").is_empty()
    });
    browser.click(&browser.button("Make it"));
    browser.says("LinuxCNC's files can be made.");
    browser.until("the card is drawn", || browser.all(".pin").len() >= 128);
    in_order(&browser);

    // An answer goes into the text, and its comment stays.
    let pitch = "fieldset:nth-of-type(2) label:nth-of-type(4) input";
    assert_eq!(browser.value_of(pitch), "5");
    // At once, as the page may put a new field in its place at any time.
    let answer = |text: &str| {
        let script = format!(
            "const it = document.querySelector('{pitch}'); it.value = '{text}'; \
             it.dispatchEvent(new Event('change', {{ bubbles: true }}))"
        );
        browser.js(&script, &[]);
    };
    answer("4");
    browser.until("the answer is in the text", || {
        browser.value_of("textarea").contains("\npitch = 4 ")
    });
    browser.until("the field has it", || browser.value_of(pitch) == "4");
    browser.picture("machine");
    answer("four");
    browser.until("it is refused", || !browser.all("p.problem").is_empty());
    assert!(browser.value_of("textarea").contains("\npitch = 4 "));

    // A line that is wrong, and taken back.
    let good = browser.value_of("textarea");
    browser.fill("textarea", &good.replacen("pitch = 4 ", "pitch = 0 ", 1));
    browser.says("REFUSED");
    browser.fill("textarea", &format!("# mine\n{good}"));
    browser.says("LinuxCNC's files can be made.");

    browser.click(&browser.button("Download machine.toml"));
    let folder = root().join("target/ui/machine");
    let _none = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).expect("a folder");
    let text = browser.downloaded("machine.toml");
    assert!(text.starts_with("# mine\n"));
    std::fs::write(folder.join("machine.toml"), text).expect("a file");
    let mut write = Command::new(program("ferrocnc"));
    write
        .args(["machine", "write", "--yes"])
        .current_dir(&folder);
    assert!(write.status().expect("the tool").success());
    let shown = "const all = [...document.querySelectorAll('details:has(pre)')]; \
                 return all.map((it) => [it.querySelector('summary').textContent, \
                                         it.querySelector('pre').textContent])";
    let shown = browser.js(shown, &[]);
    let shown = shown.as_array().expect("files");
    assert!(shown.len() >= 5, "{}", shown.len());
    for file in shown {
        let (name, text) = (file[0].as_str(), file[1].as_str());
        let written = std::fs::read_to_string(folder.join(name.expect("a name")));
        assert_eq!(text, written.ok().as_deref(), "{name:?}");
    }
}

/// Where the pen is, and whether that is on the drawing.
const PEN: &str = "const pen = document.querySelector('.pen'); if (!pen) return null; \
    const { e, f } = pen.transform.baseVal[0].matrix; \
    const { x, y, width, height } = pen.ownerSVGElement.viewBox.baseVal; \
    return [e, f, e >= x && e <= x + width && f >= y && f <= y + height]";

#[test]
fn a_drawing_that_was_dropped_is_drawn_sent_and_executed_to_its_last_edge() {
    let plotter = Plotter::paced(4);
    let (server, browser) = (Server::start(), Browser::start("jobs"));
    browser.open(&server.page(&format!("jobs/{}", plotter.jobs)));
    browser.says("stopped");
    let machine = drawing::folder().join("machine.toml");
    let machine = std::fs::read_to_string(machine).expect("the machine");
    browser.drop_file("plotter.toml", &machine);
    browser.drop_file("drawing.svg", &drawing::text());
    let set = |label: &str, value: f64| browser.fill_labelled(label, &value.to_string());
    set("Tolerance", drawing::TOLERANCE);
    set("Feed", drawing::FEED);
    let program = drawing::program(drawing::TOLERANCE);
    browser.says("Takes");
    in_order(&browser);

    browser.click(&browser.button("Send"));
    browser.says(&format!("{} instructions", program.instructions.len()));
    browser.click(&browser.button("Start"));
    let ended = |end: End| format!("Ended last\n{}", end.text());
    // Where the pen was seen on the drawing.
    let seen = RefCell::new(Vec::new());
    browser.until("it is drawn", || {
        let pen = browser.js(PEN, &[]);
        if pen.is_array() && !seen.borrow().contains(&pen) {
            seen.borrow_mut().push(pen);
        }
        browser.text().contains(&ended(End::Done))
    });
    let seen = seen.into_inner();
    assert!(!seen.is_empty(), "the pen is not shown");
    assert!(
        seen.iter().all(|it| it[2] == true),
        "off the paper: {seen:?}"
    );
    browser.js("scrollTo(0, 0)", &[]);
    browser.picture("jobs");

    // Once more, paused, continued and stopped.
    browser.click(&browser.button("Start"));
    browser.says("running");
    browser.click(&browser.button("Pause"));
    browser.says("paused");
    browser.click(&browser.button("Continue"));
    browser.says("running");
    browser.click(&browser.button("Stop"));
    browser.until("it is stopped", || {
        browser.text().contains(&ended(End::Stopped))
    });

    browser.drop_file("wrong.ngc", "G1 X1 Q\n");
    browser.until("it is refused", || !browser.all("p.problem").is_empty());

    drop((browser, server));
    let told = pins::predict(&program, &drawing::machine()).unwrap_or_else(|why| panic!("{why}"));
    let emitted = plotter.events();
    let difference = told.compare(&emitted[..told.events.len()]);
    println!("{} edges, {} differ", difference.edges, difference.wrong);
    assert!(difference.edges > 10_000);
    assert_eq!(difference.wrong, 0);
}

#[test]
fn on_the_bench_an_axis_moves_while_its_button_is_held_and_only_one_page_has_the_board() {
    // Its time passes with the exchanges, so a busy computer is not too late for it.
    let board = Simulator::twin(&["--mode", "lockstep", "--period-ns", "5000000"]);
    let (server, browser) = (Server::start(), Browser::start("bench"));
    let bench = server.page(&format!("bench/{}", board.udp()));
    browser.open(&bench);
    browser.says("nothing is driven before");
    assert!(!board.is_open());
    browser.click(&browser.button("Arm"));
    browser.says("ARMED");
    assert!(board.is_open());
    in_order(&browser);

    let outputs = || board.told("pins", "gpio_out");
    let off = outputs();
    let flood = browser.button("flood on for 3 s");
    browser.click(&flood);
    browser.until("the output is on", || {
        let is_on = outputs() != off;
        // A busy computer may have looked away for its three seconds.
        if !is_on && browser.text().contains("flood is off again") {
            browser.click(&flood);
        }
        is_on
    });
    browser.says("flood is off again");
    assert_eq!(outputs(), off);

    // Further than it gets before the key is released, on a busy computer, too.
    for distance in ["1000 steps", "10000 steps"] {
        browser.click(&browser.button("x: another distance"));
        browser.says(distance);
    }
    // A key that is held, until it is released.
    let key = |kind: &str| {
        let script = format!(
            "document.querySelector('[aria-label=\"Jog x plus\"]').dispatchEvent(\
             new KeyboardEvent('{kind}', {{ key: ' ', bubbles: true }}))"
        );
        browser.js(&script, &[]);
    };
    key("keydown");
    browser.until("it moves", || board.steps() > 5);
    browser.picture("bench");
    key("keyup");
    browser.says("released");
    browser.until("it stands", || {
        let at = board.steps();
        board.run_ms(20);
        at == board.steps()
    });

    // Another page does not get the board, and can neither move nor release it.
    let second = Browser::start("bench-second");
    second.open(&bench);
    second.says("is driven by");
    assert!(second.all(".jog").is_empty());
    browser.says("ARMED");
    let foreign = "return fetch('api/bench/keys', { method: 'POST', \
                   headers: { 'Content-Type': 'application/json' }, \
                   body: JSON.stringify({ hold: '0', keys: ['off'] }) }).then((it) => it.status)";
    assert_eq!(second.js(foreign, &[]), 409);

    // When the first has left it, the second has it.
    browser.open(&server.page("doctor"));
    second.says("nothing is driven before");
    browser.until("the gate is closed", || !board.is_open());
}

#[test]
fn the_keyboard_alone_is_enough() {
    let (server, browser) = (Server::start(), Browser::start("keyboard"));
    browser.open(&server.page("doctor"));
    browser.says("This computer");
    browser.press(TAB);
    assert_eq!(browser.focused(), "To the content");
    browser.press(&TAB.repeat(4));
    browser.until("the link has the focus", || {
        browser.focused() == "Configurator" || {
            browser.press(TAB);
            false
        }
    });
    browser.press(ENTER);
    browser.until("the cards are listed", || !browser.all("option").is_empty());
    // Enter in the name's field makes the file.
    browser.until("the name has the focus", || {
        browser.focused() == "Name" || {
            browser.press(TAB);
            false
        }
    });
    browser.press(ENTER);
    browser.says("It can be built.");
    browser.until("a pin has the focus", || {
        browser.focused().starts_with("j1:0, ") || {
            browser.press(TAB);
            false
        }
    });
    browser.press(RIGHT);
    assert!(
        browser.focused().starts_with("j1:1, "),
        "{}",
        browser.focused()
    );
    browser.press(DOWN);
    assert!(
        browser.focused().starts_with("j1:3, "),
        "{}",
        browser.focused()
    );
    // The next header is one Tab away, not thirteen.
    browser.press(TAB);
    assert!(
        browser.focused().starts_with("j2:0, "),
        "{}",
        browser.focused()
    );
}
