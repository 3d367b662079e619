//! `ferrocnc-config`: the commands of the reader that the build needs. Users run `ferrocnc config`.

use ferrocnc_config::board::Platforms;
use ferrocnc_config::image::{Counts, export_image};
use ferrocnc_config::source::{Folder, read_text};
use ferrocnc_config::{Board, Platform, read_board_text};
use std::io::Write;
use std::path::Path;
use std::process::ExitCode;

const USAGE: &str =
    "usage: ferrocnc-config export BOARD.toml [--ip A.B.C.D] [--port N] [--mac aa:bb:cc:dd:ee:ff]
       ferrocnc-config export-platform NAME [--channels S/E/P] [--jobs N]

the configuration, or the image of a platform, as JSON, on standard output; what is named here
stands in for what the file says";

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let done = match words.as_slice() {
        ["export", board, network @ ..] => export(Path::new(board), network),
        ["export-platform", name, "--channels", counts, jobs @ ..] => {
            Counts::read(counts).and_then(|counts| image(name, counts, jobs))
        }
        ["export-platform", name, jobs @ ..] => image(name, Counts::OF_IMAGES, jobs),
        ["schema", folder] => schema(Path::new(folder)),
        _ => Err(USAGE.to_owned()),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("{message}");
            ExitCode::FAILURE
        }
    }
}

fn export(path: &Path, network: &[&str]) -> Result<(), String> {
    let board = read(path, network).map_err(|error| error.to_string())?;
    let json = ferrocnc_config::export::export(&board).map_err(|error| error.to_string())?;
    // The reader of our output may have closed the pipe.
    let _ = writeln!(std::io::stdout(), "{json:#}");
    Ok(())
}

fn image(name: &str, counts: Counts, jobs: &[&str]) -> Result<(), String> {
    let jobs = match jobs {
        [] => counts.jobs(),
        ["--jobs", "0"] => 0,
        ["--jobs", axes] if axes.parse() == Ok(counts.jobs()) => counts.jobs(),
        ["--jobs", axes] => {
            return Err(format!(
                "--jobs {axes}: an image with these channels has jobs of {} axes, or of none; leave it out, or write 0",
                counts.jobs()
            ));
        }
        _ => return Err(USAGE.to_owned()),
    };
    let platforms = Folder::beside(Path::new("boards/-"));
    let Some((file, text)) = platforms.text(name) else {
        return Err(format!(
            "{name}: is not a platform we know; write one of {}",
            platforms.names().join(", ")
        ));
    };
    let json = Platform::read(&file, name, &text)
        .and_then(|platform| export_image(&platform, counts, jobs))
        .map_err(|error| error.to_string())?;
    let _ = writeln!(std::io::stdout(), "{json:#}");
    Ok(())
}

/// As the file says, but for these. They go through the file's text, so that they are judged as if
/// they stood there.
fn read(path: &Path, network: &[&str]) -> Result<Board, Box<dyn std::error::Error>> {
    let mut text = read_text(path)?;
    for pair in network.chunks(2) {
        text = match pair {
            ["--ip", ip] => with(&text, "ipv4", &format!("{ip:?}")),
            ["--port", port] => with(&text, "udp_port", port),
            ["--mac", mac] => with(&text, "mac", &format!("{mac:?}")),
            _ => return Err(USAGE.into()),
        };
    }
    Ok(read_board_text(path, &text)?)
}

/// The text with another value in its table `network`.
fn with(text: &str, key: &str, value: &str) -> String {
    let (mut inside, mut lines) = (false, Vec::new());
    for line in text.lines() {
        if line.trim_start().starts_with('[') {
            inside = line.trim() == "[network]";
        }
        let names_it = line
            .split_once('=')
            .is_some_and(|(name, _)| name.trim() == key);
        if inside && names_it {
            continue;
        }
        lines.push(line.to_owned());
        if line.trim() == "[network]" {
            lines.push(format!("{key} = {value}"));
        }
    }
    lines.join("\n")
}

fn schema(folder: &Path) -> Result<(), String> {
    for (name, schema) in ferrocnc_config::schema::FILES {
        let file = folder.join(name);
        std::fs::write(&file, format!("{:#}\n", schema()))
            .map_err(|e| format!("{}: cannot be written ({e})", file.display()))?;
    }
    Ok(())
}
