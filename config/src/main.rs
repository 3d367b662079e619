//! `ferrocnc-config`: what the build needs of the reader. People use `ferrocnc config`.

use std::io::Write;
use std::path::Path;
use std::process::ExitCode;

const USAGE: &str =
    "usage: ferrocnc-config export BOARD.toml    the configuration as JSON, on standard output";

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let done = match words.as_slice() {
        ["export", board] => export(Path::new(board)),
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

fn export(path: &Path) -> Result<(), String> {
    let board = ferrocnc_config::read_board(path).map_err(|error| error.to_string())?;
    let json = ferrocnc_config::export::export(&board).map_err(|error| error.to_string())?;
    // Whoever reads from us may have seen enough.
    let _ = writeln!(std::io::stdout(), "{json:#}");
    Ok(())
}

fn schema(folder: &Path) -> Result<(), String> {
    for (name, schema) in ferrocnc_config::schema::FILES {
        let file = folder.join(name);
        std::fs::write(&file, format!("{:#}\n", schema()))
            .map_err(|e| format!("{}: cannot be written ({e})", file.display()))?;
    }
    Ok(())
}
