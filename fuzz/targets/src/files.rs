//! Files from users: they are read completely or refused with a helpful message, and the result can
//! be used.

use crate::byte_reader::ByteReader;
use ferrocnc_config::import::{Imported, lcnc, litexcnc};
use ferrocnc_config::pinout::{Pinout, svg, terminal};
use ferrocnc_config::source::Folder;
use ferrocnc_config::{Board, Error, Platform, blob, export, show, write};
use host::flash_file::{self, FlashFile};
use host::image::{self, Image};
use wire::flash::{Layout, Slot};
use wire::images::{Meta, Stub, Trailer};

/// The name inside a file: it has to match the file's own name, which a fuzzer does not guess.
fn stem(text: &str) -> String {
    let line = text.lines().find_map(|line| {
        let (key, value) = line.split_once('=')?;
        (key.trim() == "name").then(|| value.trim().trim_matches(['"', '\'']).to_owned())
    });
    line.unwrap_or_else(|| "board".to_owned())
}

/// An error says what to do, and names a place that exists in the file.
fn helps(error: &Error, file: &str, text: &str) {
    let said = error.to_string();
    assert!(
        !error.problem.is_empty() && !error.remedy.is_empty(),
        "{said}"
    );
    if let Some(place) = error.place.filter(|_| error.file == file) {
        let lines = text.split('\n').count();
        assert!(
            place.line >= 1 && place.column >= 1 && place.line <= lines,
            "{place:?} of {lines} lines: {said}"
        );
    }
}

/// A board that was read can be printed, drawn, built and written.
fn usable(board: &Board) {
    show::show(board);
    let pinout = Pinout::of_board(board);
    svg(&pinout);
    terminal(&pinout, 100, true);
    board.missing_pins();
    let built = blob::blob(board);
    if let Ok(bytes) = &built {
        let blob = wire::board::Blob::new_checked(bytes);
        let blob = blob.expect("a board's own information can be read");
        let named = blob.text(wire::board::Kind::Configuration, 0);
        assert_eq!(named, Some(board.name.as_str()));
    }
    if built.is_ok() {
        export::export(board).expect("a board with a blob can be built");
    }
    let text = write::to_toml(board, &["a note".to_owned()]);
    let again = Board::read("again.toml", &board.name, &text, &Folder::default());
    match again {
        Ok(again) => {
            assert_eq!(again.channels, board.channels);
            assert_eq!(
                (again.sys_clk_hz, again.udp_port, again.ipv4, again.mac),
                (board.sys_clk_hz, board.udp_port, board.ipv4, board.mac)
            );
            assert_eq!(write::to_toml(&again, &["a note".to_owned()]), text);
        }
        Err(error) => panic!("written, but not readable: {error}\n{text}"),
    }
}

/// `boards/*.toml` and `boards/platforms/*.toml`.
pub fn board_toml(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else {
        return;
    };
    let stem = stem(text);
    match Board::read("board.toml", &stem, text, &Folder::default()) {
        Ok(board) => usable(&board),
        Err(error) => helps(&error, "board.toml", text),
    }
    match Platform::read("platform.toml", &stem, text) {
        Ok(platform) => {
            svg(&Pinout::of_platform(&platform));
            for (name, _) in platform.pins() {
                assert!(
                    platform.pin(&name).is_some(),
                    "{name} is listed but is not a pin"
                );
            }
        }
        Err(error) => helps(&error, "platform.toml", text),
    }
}

fn imported(import: Result<Imported, Error>, file: &str, text: &str) {
    match import {
        Ok(imported) => {
            usable(&imported.board);
            let read = Board::read(
                "imported.toml",
                &imported.board.name,
                &imported.toml,
                &Folder::default(),
            );
            let read = read.unwrap_or_else(|error| panic!("{error}\n{}", imported.toml));
            assert_eq!(read.channels, imported.board.channels);
        }
        Err(error) => helps(&error, file, text),
    }
}

/// Lcnc's configurations.
pub fn lcnc_ini(data: &[u8]) {
    if let Ok(text) = std::str::from_utf8(data) {
        let import = lcnc("theirs.ini", text, "ours", &Folder::default());
        imported(import, "theirs.ini", text);
    }
}

/// LiteX-CNC's configurations.
pub fn litexcnc_json(data: &[u8]) {
    if let Ok(text) = std::str::from_utf8(data) {
        let import = litexcnc("theirs.json", text, "ours", &Folder::default());
        imported(import, "theirs.json", text);
    }
}

/// Bitstreams, flash images, and their meta pages.
pub fn image(data: &[u8]) {
    let mut input = ByteReader(data);
    match input.byte() & 3 {
        0 => bitstream(input.0),
        // A header that fits the bytes after it, so that the bytes themselves are read.
        1 => {
            let build = input.word();
            let idcode = input.word();
            let mut body = image::sample::body(idcode, build, 0);
            body.extend(input.0);
            bitstream(&image::sample::wrap("board", "platform", build, &body));
        }
        2 => flash(&mut input),
        _ => pages(input.0),
    }
}

fn bitstream(file: &[u8]) {
    match Image::parse(file) {
        Ok(image) => {
            assert!(file.ends_with(&image.bytes));
            assert_eq!(image::idcode(&image.bytes), Some(image.idcode));
            let meta = image.meta();
            let area = Layout::of(0x20_0000).expect("a layout").slot(Slot::A);
            // If an image fits a slot, its meta page is valid.
            let fits = image.bytes.len() <= (area.meta() - area.start) as usize;
            let read = Meta::from_page(&meta.to_page(), area);
            assert!(!fits || read == Some(meta), "{meta:?} reads as {read:?}");
            let _ = image.to_string();
        }
        Err(why) => assert!(!why.to_string().is_empty()),
    }
}

thread_local! {
    /// A flash as built; made only once, because that takes most of the time.
    static FLASH: Vec<u8> = {
        let sample = |build| {
            let file = image::sample::file("board", "platform", build, 600);
            Image::parse(&file).expect("the sample is whole")
        };
        flash_file::sample::file(0x20_0000, &sample(1), &sample(2))
    };
}

/// A whole flash with some bytes changed; the changes are at pages, so that a fuzzer can hit the
/// same ones.
fn flash(input: &mut ByteReader) {
    let layout = Layout::of(0x20_0000).expect("a layout");
    let places = [
        0,
        layout.slot(Slot::A).start,
        layout.slot(Slot::A).meta(),
        layout.golden.start,
        layout.golden.meta(),
        layout.jump_page(),
    ];
    let mut bytes = FLASH.with(Vec::clone);
    let mut changed = Vec::new();
    while !input.is_over() {
        let [place, offset] = input.array();
        let at = places[usize::from(place) % places.len()] as usize + usize::from(offset);
        let new = input.some();
        for (place, byte) in bytes[at..].iter_mut().zip(new) {
            *place = *byte;
        }
        changed.push(bytes[at..].iter().take(256).copied().collect::<Vec<u8>>());
    }
    if let Ok(file) = FlashFile::parse(bytes) {
        assert_eq!(file.len(), 0x20_0000);
        assert_eq!(file.image.idcode, file.golden.idcode);
        // A difference from a flash as built is reported with its area and an offset in that area.
        let differ = FLASH.with(|flash| file.compare(flash));
        assert!(differ.len() <= 4, "{differ:?}");
        assert!(differ.iter().all(|(_, at)| (*at as usize) < file.len()));
        file.compare(&[]);
    }
    for page in changed {
        pages(&page);
    }
}

fn pages(page: &[u8]) {
    for size in [0x20_0000, 0x40_0000] {
        let layout = Layout::of(size).expect("a layout");
        for area in [layout.slot(Slot::A), layout.slot(Slot::B), layout.golden] {
            if let Some(meta) = Meta::from_page(page, area) {
                assert!(meta.length <= area.meta() - area.start, "{meta:?}");
                assert_eq!(Meta::from_page(&meta.to_page(), area), Some(meta));
            }
        }
        if let Some(stub) = Stub::from_page(page) {
            let again = stub.to_page();
            assert_eq!(Stub::from_page(&again).map(|s| s.target), Some(stub.target));
            stub.slot(&layout);
        }
    }
    if let Some(words) = crate::byte_reader::words(page).first_chunk() {
        Trailer::from_words(*words).running(None);
    }
}
