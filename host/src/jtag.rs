//! Runs openFPGALoader: the first flash of a board goes through a JTAG cable.
//!
//! This module finds the program, gives it the right options, passes its progress on, and turns its
//! error output into one sentence with the remedy. Before a write it always reads the id of the
//! FPGA on the cable.
//!
//! | step | command |
//! |---|---|
//! | read the FPGA's id | `openFPGALoader -c CABLE --detect` |
//! | load | `openFPGALoader -c CABLE -m FILE.bit` |
//! | write | `openFPGALoader -c CABLE -f --unprotect-flash --verify -o 0 --file-type raw FILE.flash` |
//! | read back | `openFPGALoader -c CABLE --dump-flash -o 0 --file-size BYTES FILE` |
//!
//! `--unprotect-flash` is needed because these boards come with their flash protected;
//! openFPGALoader restores the protection afterwards. Its messages are those of version 0.10
//! (Debian 12) and of the sources of 1.0.

use crate::image::fpga_name;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// FTDI's single-channel chip: the cable most of these boards were flashed with.
pub const DEFAULT_CABLE: &str = "ft232";
/// The bits of an FPGA's id that every version shows.
const ID_SHOWN: u32 = 0x0fff_ffff;
/// At most this much of its last output is shown.
const SAID_MOST: usize = 400;

/// Why it did not work; it says what to do.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum JtagError {
    /// No such program.
    NotInstalled,
    /// It is there, but cannot be started.
    NotStarted(String),
    /// It knows no cable of this name.
    UnknownCable(String),
    /// The cable is not plugged in.
    NoCable(String),
    /// It is, but this user may not use it.
    Permission {
        /// Its name.
        cable: String,
        /// USB vendor and product, in hex as udev writes them.
        usb: Option<(String, String)>,
    },
    /// Another program or driver has it.
    Busy(String),
    /// No FPGA answers on the cable.
    NoFpga {
        /// The cable's name.
        cable: String,
        /// What openFPGALoader said.
        said: String,
    },
    /// Another FPGA than the file is for.
    WrongFpga {
        /// The file's id.
        file: u32,
        /// The board's.
        board: u32,
    },
    /// The FPGA answers, but does not enter configuration.
    Configuration,
    /// The flash keeps its write protection.
    Protected,
    /// The flash does not answer.
    NoFlash,
    /// What was read back is not what was written.
    Verify(String),
    /// The file cannot be read by it.
    File(String),
    /// Anything else.
    Failed(String),
}

impl core::fmt::Display for JtagError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            JtagError::NotInstalled => f.write_str(
                "openFPGALoader is not installed; on Debian and Ubuntu: sudo apt install openfpgaloader",
            ),
            JtagError::NotStarted(why) => write!(f, "openFPGALoader cannot be started: {why}"),
            JtagError::UnknownCable(cable) => write!(
                f,
                "openFPGALoader knows no cable \"{cable}\"; openFPGALoader --list-cables shows its names, --cable takes one"
            ),
            JtagError::NoCable(cable) => write!(
                f,
                "no JTAG cable \"{cable}\" is plugged in; plug it in, or name yours with --cable (lsusb shows what is there, openFPGALoader --list-cables its names)"
            ),
            JtagError::Permission { cable, usb } => {
                let line = match usb {
                    Some((vendor, product)) => {
                        format!("ATTRS{{idVendor}}==\"{vendor}\", ATTRS{{idProduct}}==\"{product}\"")
                    }
                    None => "ATTRS{idVendor}==\"VVVV\", ATTRS{idProduct}==\"PPPP\" (as lsusb shows them)".to_owned(),
                };
                write!(
                    f,
                    "the cable \"{cable}\" is there but this user may not use it; put the line\n  SUBSYSTEM==\"usb\", {line}, MODE=\"0660\", GROUP=\"plugdev\", TAG+=\"uaccess\"\ninto /etc/udev/rules.d/60-ferrocnc-jtag.rules, run sudo udevadm control --reload, and plug the cable in again"
                )
            }
            JtagError::Busy(cable) => write!(
                f,
                "the cable \"{cable}\" is in use by another program or by a serial driver; close it (or sudo rmmod ftdi_sio) and try again"
            ),
            JtagError::NoFpga { cable, said } => {
                write!(
                    f,
                    "no FPGA answers on the cable \"{cable}\"; check the board's power, ground, and the wires to TCK, TMS, TDI, TDO"
                )?;
                match said.is_empty() {
                    true => Ok(()),
                    false => write!(f, " (openFPGALoader says: {said})"),
                }
            }
            JtagError::WrongFpga { file, board } => write!(
                f,
                "the file is for {} ({file:#010x}), the board has {} ({board:#010x}); take the file of this board's platform",
                fpga_name(*file),
                fpga_name(*board)
            ),
            JtagError::Configuration => f.write_str(
                "the FPGA answers but does not accept a configuration; power the board off and on, and use shorter wires or a slower cable (--freq) if it stays so",
            ),
            JtagError::Protected => f.write_str(
                "the flash stays write-protected; look whether its WP pin is tied low, and power the board off and on before the next try",
            ),
            JtagError::NoFlash => f.write_str(
                "the FPGA answers but its flash does not; power the board off and on and try again",
            ),
            JtagError::Verify(said) => write!(
                f,
                "what was read back differs from what was written ({said}); write it again, with shorter wires or a slower cable (--freq) if it stays so"
            ),
            JtagError::File(said) => write!(f, "openFPGALoader cannot read the file: {said}"),
            JtagError::Failed(said) => write!(f, "openFPGALoader failed: {said}"),
        }
    }
}

impl std::error::Error for JtagError {}

/// How far a step is.
#[derive(Clone, Debug, PartialEq)]
pub struct Progress {
    /// openFPGALoader's word for what it does: Erasing, Writing, Loading.
    pub step: String,
    /// 0 to 100.
    pub percent: f64,
}

/// openFPGALoader with a cable.
#[derive(Clone, Debug)]
pub struct Loader {
    program: PathBuf,
    cable: String,
    frequency: Option<u32>,
}

impl Loader {
    /// The program as PATH finds it.
    pub fn new(cable: &str) -> Self {
        Loader {
            program: PathBuf::from("openFPGALoader"),
            cable: cable.to_owned(),
            frequency: None,
        }
    }

    /// Another program.
    #[must_use]
    pub fn with_program(mut self, program: &Path) -> Self {
        program.clone_into(&mut self.program);
        self
    }

    /// Another JTAG clock than openFPGALoader's own.
    #[must_use]
    pub fn with_frequency(mut self, hz: Option<u32>) -> Self {
        self.frequency = hz;
        self
    }

    /// The id of the FPGA on the cable.
    pub fn detect(&self) -> Result<u32, JtagError> {
        let out = self.run(&["--detect".as_ref()], &mut |_| {})?;
        idcode_of(&out).ok_or_else(|| JtagError::NoFpga {
            cable: self.cable.clone(),
            said: String::new(),
        })
    }

    /// Refuses any FPGA but this.
    ///
    /// Version 0.10 shows ids without their upper four bits, which tell a 12F from a 25F of the
    /// same die. Then the rest has to do; for a bitstream openFPGALoader compares the whole id by
    /// itself.
    pub fn expect(&self, file: u32) -> Result<(), JtagError> {
        match self.detect()? {
            board if board == file || board == file & ID_SHOWN => Ok(()),
            board if board & !ID_SHOWN == 0 => Err(JtagError::WrongFpga {
                file,
                board: board | file & !ID_SHOWN,
            }),
            board => Err(JtagError::WrongFpga { file, board }),
        }
    }

    /// Loads a bitstream into the FPGA until the next power-down.
    pub fn load(&self, file: &Path, tell: &mut dyn FnMut(Progress)) -> Result<(), JtagError> {
        self.run(&["-m".as_ref(), file], tell).map(|_| ())
    }

    /// Writes a whole flash image from its first byte on.
    pub fn write(&self, file: &Path, tell: &mut dyn FnMut(Progress)) -> Result<(), JtagError> {
        let arguments = [
            "-f",
            "--unprotect-flash",
            "--verify",
            "-o",
            "0",
            "--file-type",
            "raw",
        ];
        let mut arguments: Vec<&Path> = arguments.iter().map(Path::new).collect();
        arguments.push(file);
        self.run(&arguments, tell).map(|_| ())
    }

    /// Reads the flash into a file. The board starts again afterwards.
    pub fn dump(
        &self,
        length: usize,
        file: &Path,
        tell: &mut dyn FnMut(Progress),
    ) -> Result<(), JtagError> {
        let length = length.to_string();
        let arguments = ["--dump-flash", "-o", "0", "--file-size", &length];
        let mut arguments: Vec<&Path> = arguments.iter().map(Path::new).collect();
        arguments.push(file);
        self.run(&arguments, tell).map(|_| ())
    }

    /// Runs it to its end; what it printed on stdout.
    fn run(
        &self,
        arguments: &[&Path],
        tell: &mut dyn FnMut(Progress),
    ) -> Result<String, JtagError> {
        let mut command = Command::new(&self.program);
        command.arg("-c").arg(&self.cable);
        if let Some(hz) = self.frequency {
            command.arg("--freq").arg(hz.to_string());
        }
        command
            .args(arguments)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        let mut child = command.spawn().map_err(|error| match error.kind() {
            std::io::ErrorKind::NotFound => JtagError::NotInstalled,
            _ => JtagError::NotStarted(error.to_string()),
        })?;
        // Both pipes have to be emptied, or the program stands still.
        let stderr = child.stderr.take();
        let complaints = std::thread::spawn(move || {
            let mut bytes = Vec::new();
            if let Some(mut stderr) = stderr {
                // The output until then has to be enough.
                let _ = stderr.read_to_end(&mut bytes);
            }
            String::from_utf8_lossy(&bytes).into_owned()
        });
        let mut out = String::new();
        if let Some(mut stdout) = child.stdout.take() {
            let mut piece = [0; 512];
            let mut line = Vec::new();
            while let Ok(length @ 1..) = stdout.read(&mut piece) {
                for byte in &piece[..length] {
                    // A bar is drawn again and again on one line.
                    if matches!(byte, b'\r' | b'\n') {
                        take_line(&mut line, &mut out, tell);
                    } else {
                        line.push(*byte);
                    }
                }
                if let Some(progress) = progress_of(&String::from_utf8_lossy(&line)) {
                    tell(progress);
                }
            }
            take_line(&mut line, &mut out, tell);
        }
        let status = child
            .wait()
            .map_err(|error| JtagError::NotStarted(error.to_string()))?;
        let complaints = complaints.join().unwrap_or_default();
        // The exit code does not show every failed step: in 0.10 not a verification, nor reading
        // the flash.
        let failed = complaints.contains("FAIL") || complaints.contains("erification failed");
        match status.success() && !failed {
            true => Ok(out),
            false => Err(self
                .understand(&complaints, &out)
                .unwrap_or_else(|| JtagError::Failed(last_words(&complaints, &out)))),
        }
    }

    /// The meaning of its error output.
    fn understand(&self, complaints: &str, out: &str) -> Option<JtagError> {
        let said = |text: &str| complaints.contains(text) || out.contains(text);
        let any = |texts: &[&str]| texts.iter().any(|text| said(text));
        let cable = || self.cable.clone();
        if said("error : ") && said(&format!("{} not found", self.cable)) {
            Some(JtagError::UnknownCable(cable()))
        } else if any(&[
            "LIBUSB_ERROR_ACCESS",
            "usb_open() failed",
            "inappropriate permissions",
            "Access denied",
            "insufficient permissions",
        ]) {
            Some(JtagError::Permission {
                cable: cable(),
                usb: self.usb_id(),
            })
        } else if any(&[
            "unable to claim",
            "LIBUSB_ERROR_BUSY",
            "error while claiming",
            "claim interface failed",
        ]) {
            Some(JtagError::Busy(cable()))
        } else if any(&[
            "device not found",
            "No cable found",
            "fails to open device",
            "fail to open device",
            "no J-Link device found",
        ]) {
            Some(JtagError::NoCable(cable()))
        } else if said("mismatch between target's idcode") {
            mismatch(complaints).or_else(|| mismatch(out))
        } else if any(&[
            "can't unlock",
            "block protection is set",
            "disable protection failed",
            "Can't erase flash",
        ]) {
            Some(JtagError::Protected)
        } else if any(&["Verification failed", "Verify write failed"]) {
            Some(JtagError::Verify(line_with("erif", complaints, out)))
        } else if any(&[
            "Read ID failed",
            "SPI Flash prepare access failed",
            "Failed to read flash",
        ]) {
            Some(JtagError::NoFlash)
        } else if said("displayReadReg") {
            Some(JtagError::Configuration)
        } else if any(&[
            "no device found",
            "TDO is stuck",
            "Unknown device with IDCODE",
            "JTAG init failed",
        ]) {
            Some(JtagError::NoFpga {
                cable: cable(),
                said: last_words(complaints, out),
            })
        } else if any(&[
            "Preamble key not found",
            "Wrong File",
            "incompatible file format",
            "fail to open",
            "Fail to open",
        ]) {
            Some(JtagError::File(last_words(complaints, out)))
        } else {
            None
        }
    }

    /// The cable's USB ids, from openFPGALoader's own table.
    fn usb_id(&self) -> Option<(String, String)> {
        let output = Command::new(&self.program)
            .arg("--list-cables")
            .stdin(Stdio::null())
            .output()
            .ok()?;
        let table = String::from_utf8_lossy(&output.stdout).into_owned();
        let row = table
            .lines()
            .find(|line| line.split_whitespace().next() == Some(&self.cable))?;
        let (vendor, product) = row.split_whitespace().nth(1)?.split_once(':')?;
        let vendor = vendor.trim_start_matches("0x").to_owned();
        (vendor != "0000").then(|| (vendor, product.trim_start_matches("0x").to_owned()))
    }
}

fn take_line(line: &mut Vec<u8>, out: &mut String, tell: &mut dyn FnMut(Progress)) {
    let text = String::from_utf8_lossy(line).into_owned();
    line.clear();
    match progress_of(&text) {
        Some(progress) => tell(progress),
        None if text.is_empty() => {}
        None => {
            out.push_str(&text);
            out.push('\n');
        }
    }
}

/// `Writing: [====      ] 41.50%`.
fn progress_of(line: &str) -> Option<Progress> {
    let (step, bar) = line.trim().split_once(": [")?;
    let percent = bar.rsplit_once(']')?.1.trim().strip_suffix('%')?;
    let percent: f64 = percent.trim().parse().ok()?;
    (0.0..=100.0).contains(&percent).then(|| Progress {
        step: step.trim().to_owned(),
        percent,
    })
}

/// Out of `--detect`: a line `idcode 0x41111043` for each device.
fn idcode_of(out: &str) -> Option<u32> {
    out.lines()
        .filter_map(|line| line.trim().strip_prefix("idcode"))
        .filter_map(|rest| u32::from_str_radix(rest.trim().strip_prefix("0x")?, 16).ok())
        .find(|id| *id != 0 && *id != u32::MAX)
}

/// `bitstream has 0x41111043 hardware requires 0x21111043`.
fn mismatch(text: &str) -> Option<JtagError> {
    let id = |after: &str| {
        let rest = text.split_once(after)?.1.trim_start();
        let word = rest.split_whitespace().next()?;
        u32::from_str_radix(word.trim_start_matches("0x").trim_start_matches("0X"), 16).ok()
    };
    Some(JtagError::WrongFpga {
        file: id("bitstream has")?,
        board: id("hardware requires")?,
    })
}

fn line_with(word: &str, complaints: &str, out: &str) -> String {
    let mut lines = complaints.lines().chain(out.lines());
    let line = lines.find(|line| line.contains(word) && line.contains("ail"));
    line.unwrap_or("").trim().to_owned()
}

/// The end of what it said, on one line.
fn last_words(complaints: &str, out: &str) -> String {
    let text = match complaints.trim() {
        "" => out.trim(),
        text => text,
    };
    let lines: Vec<&str> = text
        .lines()
        .map(str::trim)
        .filter(|l| !l.is_empty())
        .collect();
    let text = lines[lines.len().saturating_sub(3)..].join("; ");
    match text.char_indices().nth(SAID_MOST) {
        Some((at, _)) => format!("{}...", &text[..at]),
        None if text.is_empty() => "it gave no reason".to_owned(),
        None => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bar_is_read_wherever_it_is_in_its_line() {
        let at = |line| progress_of(line).map(|p| (p.step, p.percent));
        assert_eq!(
            at("Writing: [=====          ] 41.50%"),
            Some(("Writing".to_owned(), 41.5))
        );
        assert_eq!(
            at("Loading: [=] 100.00%"),
            Some(("Loading".to_owned(), 100.0))
        );
        for line in [
            "",
            "Done",
            "Open file: DONE",
            "x: [ 5%",
            "x: [=] nan%",
            "x: [=] 400%",
        ] {
            assert_eq!(at(line), None, "{line}");
        }
    }

    #[test]
    fn the_id_is_found_and_an_open_wire_is_none() {
        let out = "index 0:\n\tidcode 0x41111043\n\tmanufacturer lattice\n\tfamily ECP5\n";
        assert_eq!(idcode_of(out), Some(0x4111_1043));
        assert_eq!(idcode_of("\tidcode 0xffffffff\n"), None);
        assert_eq!(idcode_of(""), None);
    }

    #[test]
    fn long_complaints_are_shortened_to_their_end() {
        let text = last_words(&"x\n".repeat(9), "");
        assert_eq!(text, "x; x; x");
        assert!(last_words(&"y".repeat(900), "").len() < 420);
        assert_eq!(last_words("", " \n"), "it gave no reason");
    }
}
