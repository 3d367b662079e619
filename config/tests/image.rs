//! Images: what a platform's gateware is built of.

use ferrocnc_config::image::{Counts, built, export_image, lines};
use ferrocnc_config::platform::Platform;
use ferrocnc_config::source::BUILT_IN;
use wire::board::{Blob, Kind};

const EIGHT: Counts = Counts {
    stepgens: 8,
    encoders: 8,
    pwms: 8,
};

fn platform(name: &str) -> Platform {
    let (_, text) = BUILT_IN.iter().find(|(known, _)| *known == name).unwrap();
    Platform::read("test", name, text).unwrap_or_else(|error| panic!("{error}"))
}

#[test]
fn lines_are_what_each_header_has_and_behind_those_what_all_share() {
    let platform = platform("5a-75b-8.0");
    let lines = lines(&platform);
    let name = |n: usize| (lines[n].0.as_str(), lines[n].1);
    assert_eq!(lines.len(), 56);
    assert_eq!((name(0), name(3)), (("j1:0", "C4"), ("j1:4", "D3")));
    assert_eq!((name(6), name(47)), (("j2:0", "F1"), ("j8:6", "B15")));
    assert_eq!((name(48), name(55)), (("j1:7", "N4"), ("j1:14", "M4")));
    let balls: std::collections::BTreeSet<&str> = lines.iter().map(|(_, ball)| *ball).collect();
    assert_eq!(balls.len(), 56, "every line has a ball of its own");
}

#[test]
fn every_small_card_has_an_image_and_a_large_one_is_told_why_not() {
    for (name, _) in BUILT_IN {
        let built = built(&platform(name), EIGHT);
        match name.starts_with("5a-75b") {
            true => assert_eq!(built.unwrap().lines, 56, "{name}"),
            false => {
                let said = built.unwrap_err().to_string();
                assert!(said.contains("104 lines are not what"), "{said}");
            }
        }
    }
}

#[test]
fn an_image_is_a_board_without_channels() {
    let image = export_image(&platform("5a-75b-8.0"), EIGHT, 3).unwrap();
    assert_eq!(image["name"], "5a-75b-8.0");
    assert_eq!(image["lines"].as_array().unwrap().len(), 56);
    assert_eq!(image["key"]["ball"], "R7");
    assert_eq!((&image["jobs"], &image["sdram"]), (&3.into(), &true.into()));
    assert_eq!(image["built"]["encoder"], 8);
    let hex = image["blob"].as_str().unwrap();
    let blob: Vec<u8> = (0..hex.len())
        .step_by(2)
        .map(|at| u8::from_str_radix(&hex[at..at + 2], 16).unwrap())
        .collect();
    let blob = Blob::new_checked(&blob).unwrap();
    assert_eq!(blob.text(Kind::Configuration, 0), Some("5a-75b-8.0 image"));
    assert!(blob.facts().count() >= 5 && blob.entries().count() == blob.facts().count());
}

#[test]
fn counts_are_three_numbers_the_gateware_has() {
    assert_eq!(Counts::read("8/8/8"), Ok(EIGHT));
    assert_eq!(
        (EIGHT.jobs(), Counts::read("2/0/16").unwrap().jobs()),
        (3, 0)
    );
    for (text, why) in [
        ("8/8", "as in 8/8/8"),
        ("8/8/8/8", "as in 8/8/8"),
        ("8/8/x", "as in 8/8/8"),
        ("8/17/8", "at most 16"),
    ] {
        let said = Counts::read(text).unwrap_err();
        assert!(said.contains(why) && said.contains(text), "{said}");
    }
}
