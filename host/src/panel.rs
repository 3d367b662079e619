//! Panels for LinuxCNC's screens that say what is wrong with a board and what to do about it: files
//! for PyVCP and QtVCP, made of the one table of faults, [`crate::fault`]. Nothing of the table is
//! kept in a file of ours.
//!
//! PyVCP shows bits only, so LinuxCNC's component `demux` makes a bit of each number, and each
//! fault has a line with a light. QtVCP reads the number itself and shows one sentence.

use crate::fault::Fault;

/// A file of a panel: its name below the machine's folder, and its content.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct File {
    /// The name.
    pub name: String,
    /// The content.
    pub text: String,
}

/// `demux` counts its outputs from 0 to this.
fn highest() -> u32 {
    Fault::all().map(Fault::code).max().unwrap_or_default()
}

/// The panel for PyVCP, and the HAL file that feeds it.
pub fn pyvcp(board: usize) -> Vec<File> {
    let name = format!("ferrocnc-fault{board}");
    let lines: String = Fault::all().map(pyvcp_line).collect();
    let panel = format!(
        "<?xml version='1.0' encoding='UTF-8'?>\n\
         <!-- Written by `ferrocnc panel pyvcp`. In the INI file:\n\
         [DISPLAY] PYVCP = {name}.xml\n\
         [HAL] POSTGUI_HALFILE = {name}.hal -->\n\
         <pyvcp>\n<labelframe text=\"Board {board}\">\n<vbox>\n\
         <boxanchor anchor=\"w\"/>\n{lines}</vbox>\n</labelframe>\n</pyvcp>\n"
    );
    let outputs: String = Fault::all()
        .map(|fault| {
            let code = fault.code();
            format!("net {name}-{code:02} {name}.out-{code:02} => pyvcp.fault-{code:02}\n")
        })
        .collect();
    let wires = format!(
        "# Written by `ferrocnc panel pyvcp`. If another file loads demux, add the name to its line.\n\
         loadrt demux names={name} personality={}\n\
         addf {name} servo-thread\n\
         net {name} ferrocnc.{board}.fault-code => {name}.sel-u32\n{outputs}",
        highest() + 1
    );
    let file = |ending: &str, text| File {
        name: format!("{name}.{ending}"),
        text,
    };
    vec![file("xml", panel), file("hal", wires)]
}

fn pyvcp_line(fault: Fault) -> String {
    let code = fault.code();
    let color = match code {
        0 => "green",
        _ => "red",
    };
    // PyVCP evaluates texts as Python; JSON's strings are Python's, too.
    let text = escaped(&json(&fault.sentences()));
    format!(
        "<hbox><led><halpin>\"fault-{code:02}\"</halpin><size>12</size>\
         <on_color>\"{color}\"</on_color><off_color>\"gray70\"</off_color></led>\
         <label><text>{text}</text></label></hbox>\n"
    )
}

/// The panel for QtVCP: `qtvcp/panels/ferrocnc_fault`, one for every board of the machine.
pub fn qtvcp(boards: usize) -> Vec<File> {
    const FOLDER: &str = "qtvcp/panels/ferrocnc_fault";
    let table: String = Fault::all()
        .map(|fault| format!("    {}: {},\n", fault.code(), json(&fault.sentences())))
        .collect();
    let handler = HANDLER
        .replace("BOARDS = 1", &format!("BOARDS = {boards}"))
        .replace("    # FAULTS\n", &table);
    let wires: String = (0..boards)
        .map(|n| {
            format!(
                "net ferrocnc-fault{n} ferrocnc.{n}.fault-code => ferrocnc_fault.fault-code-{n}\n"
            )
        })
        .collect();
    let wires = format!(
        "# Written by `ferrocnc panel qtvcp`.\n\
         loadusr -Wn ferrocnc_fault qtvcp ferrocnc_fault\n{wires}"
    );
    let file = |name: String, text: String| File { name, text };
    vec![
        file(format!("{FOLDER}/ferrocnc_fault.ui"), WINDOW.to_owned()),
        file(format!("{FOLDER}/ferrocnc_fault_handler.py"), handler),
        file("ferrocnc-fault-qtvcp.hal".to_owned(), wires),
    ]
}

/// As a string of JSON.
fn json(text: &str) -> String {
    serde_json::Value::from(text).to_string()
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
}

const HANDLER: &str = r#"# Written by `ferrocnc panel qtvcp`.
from PyQt5.QtWidgets import QLabel
from qtvcp.core import Qhal

QHAL = Qhal()
BOARDS = 1
FAULTS = {
    # FAULTS
}


def sentence(code):
    return FAULTS.get(code, "Fault %d, of a newer driver: write the panel anew." % code)


class HandlerClass:
    def __init__(self, halcomp, widgets, paths):
        self.w = widgets

    def initialized__(self):
        for board in range(BOARDS):
            label = QLabel(self.w.centralwidget)
            label.setWordWrap(True)
            self.w.layout.addWidget(label)
            pin = QHAL.newpin("fault-code-%d" % board, QHAL.HAL_U32, QHAL.HAL_IN)
            pin.value_changed.connect(lambda code, to=label, n=board: self.show(to, n, code))
            self.show(label, board, 0)

    def show(self, label, board, code):
        label.setText("Board %d: %s" % (board, sentence(code)))
        label.setStyleSheet("color: %s" % ("green" if code == 0 else "red"))


def get_handlers(halcomp, widgets, paths):
    return [HandlerClass(halcomp, widgets, paths)]
"#;

const WINDOW: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<!-- Written by `ferrocnc panel qtvcp`. -->
<ui version="4.0">
 <class>MainWindow</class>
 <widget class="QMainWindow" name="MainWindow">
  <property name="windowTitle">
   <string>FerroCNC</string>
  </property>
  <widget class="QWidget" name="centralwidget">
   <layout class="QVBoxLayout" name="layout"/>
  </widget>
 </widget>
</ui>
"#;

#[cfg(test)]
mod tests {
    use super::*;
    use std::process::{Command, Stdio};

    fn text(files: &[File], ending: &str) -> String {
        let file = files.iter().find(|file| file.name.ends_with(ending));
        file.expect("the file").text.clone()
    }

    #[test]
    fn every_fault_has_its_line_and_its_wire_in_the_panel_for_pyvcp() {
        let files = pyvcp(1);
        let (panel, wires) = (text(&files, ".xml"), text(&files, ".hal"));
        for fault in Fault::all() {
            let code = fault.code();
            let line = panel
                .lines()
                .find(|line| line.contains(&format!("\"fault-{code:02}\"")));
            assert!(
                line.is_some_and(|line| line.contains(&fault.sentences())),
                "{fault:?}"
            );
            let wire = format!("out-{code:02} => pyvcp.fault-{code:02}\n");
            assert!(wires.contains(&wire), "{fault:?}: {wires}");
        }
        assert!(wires.contains("ferrocnc.1.fault-code => ferrocnc-fault1.sel-u32"));
        assert!(wires.contains("personality=27\n"), "{wires}");
        let longest = wires.split_whitespace().map(str::len).max();
        assert!(longest <= Some(wire::board::HAL_NAME_MAX), "{wires}");
    }

    #[test]
    fn the_panel_for_pyvcp_is_xml() {
        let panel = text(&pyvcp(0), ".xml");
        let tree = closes(&panel);
        assert_eq!(tree, Ok(()), "{panel}");
    }

    /// Every tag that opens is closed by its own name.
    fn closes(xml: &str) -> Result<(), String> {
        let mut open = Vec::new();
        let body = xml.split_once("-->").map_or("", |(_, body)| body);
        for part in body.split('<').skip(1) {
            let (tag, _) = part.split_once('>').ok_or(part)?;
            let name = tag.split([' ', '/']).find(|it| !it.is_empty());
            let name = name.unwrap_or_default();
            if tag.starts_with('/') {
                match open.pop() {
                    Some(last) if last == name => {}
                    other => return Err(format!("{other:?} is closed by {name}")),
                }
            } else if !tag.ends_with('/') {
                open.push(name);
            }
        }
        match open.is_empty() {
            true => Ok(()),
            false => Err(format!("{open:?} stay open")),
        }
    }

    #[test]
    fn every_fault_has_its_sentence_in_the_panel_for_qtvcp() {
        let files = qtvcp(2);
        let handler = text(&files, "_handler.py");
        for fault in Fault::all() {
            let line = format!("    {}: \"{}\",\n", fault.code(), fault.sentences());
            assert!(handler.contains(&line), "{fault:?}: {handler}");
        }
        assert!(handler.contains("BOARDS = 2\n"), "{handler}");
        let wires = text(&files, ".hal");
        assert!(wires.contains("ferrocnc.1.fault-code => ferrocnc_fault.fault-code-1\n"));
    }

    #[test]
    fn the_handler_for_qtvcp_is_python() {
        let handler = text(&qtvcp(1), "_handler.py");
        let python = Command::new("python3")
            .args(["-c", "import ast, sys; ast.parse(sys.argv[1])", &handler])
            .stdout(Stdio::null())
            .status();
        // A computer without Python has no QtVCP either.
        assert!(python.map_or(true, |status| status.success()), "{handler}");
    }
}
