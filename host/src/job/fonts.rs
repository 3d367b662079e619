//! Finds the system's fonts, and chooses one for each generic family (`serif`, `sans-serif`).

use resvg::usvg::fontdb::{Database, Family, Query};
use resvg::usvg::{FontFamily, Options, TextChunk};
use std::path::PathBuf;

/// Fonts for a generic family: the first of these that is installed, else any font.
const COMMON: [&str; 4] = ["DejaVu Sans", "Liberation Sans", "Noto Sans", "FreeSans"];

/// Options with the system's fonts and these files'.
pub fn options(files: &[PathBuf]) -> Result<Options<'static>, String> {
    let mut options = Options::default();
    let fonts = options.fontdb_mut();
    fonts.load_system_fonts();
    for file in files {
        fonts
            .load_font_file(file)
            .map_err(|error| format!("{}: {error}", file.display()))?;
    }
    let any = fonts
        .faces()
        .next()
        .and_then(|face| face.families.first())
        .map(|family| family.0.clone());
    let common = COMMON
        .iter()
        .find(|name| has(fonts, Family::Name(name)))
        .map(|name| (*name).to_owned());
    if let Some(family) = common.or(any) {
        if !has(fonts, Family::Serif) {
            fonts.set_serif_family(&family);
        }
        if !has(fonts, Family::SansSerif) {
            fonts.set_sans_serif_family(&family);
        }
        if !has(fonts, Family::Monospace) {
            fonts.set_monospace_family(&family);
        }
        if !has(fonts, Family::Cursive) {
            fonts.set_cursive_family(&family);
        }
        if !has(fonts, Family::Fantasy) {
            fonts.set_fantasy_family(&family);
        }
    }
    Ok(options)
}

/// The fonts a text asks for by name, if none of them is there: it is drawn with another then.
pub fn missing(fonts: &Database, chunk: &TextChunk) -> Option<String> {
    chunk.spans().iter().find_map(|span| {
        let mut names = Vec::new();
        for family in span.font().families() {
            match family {
                FontFamily::Named(name) if has(fonts, Family::Name(name)) => return None,
                FontFamily::Named(name) => names.push(name.as_str()),
                FontFamily::Serif
                | FontFamily::SansSerif
                | FontFamily::Cursive
                | FontFamily::Fantasy
                | FontFamily::Monospace => {}
            }
        }
        (!names.is_empty()).then(|| names.join(", "))
    })
}

fn has(fonts: &Database, family: Family) -> bool {
    let query = Query {
        families: &[family],
        ..Query::default()
    };
    fonts.query(&query).is_some()
}
