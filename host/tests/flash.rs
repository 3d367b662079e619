//! `ferrocnc flash`, with a program in openFPGALoader's place that prints what the real one prints.

use ferrocnc::flash_file;
use ferrocnc::image::{self, Image};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// A place with a fake openFPGALoader, a bitstream and a flash image.
struct Bench {
    place: PathBuf,
}

impl Bench {
    fn new(name: &str) -> Self {
        let place = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
        let _ = std::fs::remove_dir_all(&place);
        std::fs::create_dir_all(place.join("bin")).unwrap();
        let bench = Bench { place };
        bench.install("openFPGALoader");
        let file = |build| image::sample::file("mill6", "5a-75b-8.0", build, 3000);
        let parse = |build| Image::parse(&file(build)).unwrap();
        std::fs::write(bench.path("mill6.bit"), file(1)).unwrap();
        let flash = flash_file::sample::file(0x20_0000, &parse(1), &parse(2));
        std::fs::write(bench.path("mill6.flash"), flash).unwrap();
        bench
    }

    fn install(&self, name: &str) {
        let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fake-openFPGALoader.sh");
        // A link: a freshly written program may still be open for writing in another test's child.
        std::os::unix::fs::symlink(script, self.place.join("bin").join(name)).unwrap();
    }

    fn path(&self, name: &str) -> PathBuf {
        self.place.join(name)
    }

    fn run(&self, case: &str, arguments: &[&str]) -> Output {
        // The real one may be installed here.
        let system = if case == "absent" {
            ""
        } else {
            ":/usr/bin:/bin"
        };
        let path = format!("{}{system}", self.path("bin").display());
        Command::new(env!("CARGO_BIN_EXE_ferrocnc"))
            .arg("flash")
            .args(arguments)
            .current_dir(&self.place)
            .env("PATH", path)
            .env("FAKE", case)
            .env("FAKE_LOG", self.path("log"))
            .env("FAKE_FLASH", self.path("board.bin"))
            .output()
            .unwrap()
    }

    fn complaint(&self, case: &str, arguments: &[&str]) -> String {
        let output = self.run(case, arguments);
        assert!(!output.status.success(), "{case} succeeded");
        String::from_utf8(output.stderr).unwrap()
    }

    fn answer(&self, case: &str, arguments: &[&str]) -> String {
        let output = self.run(case, arguments);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.success(), "{case}: {said}");
        String::from_utf8(output.stdout).unwrap()
    }

    fn calls(&self) -> Vec<String> {
        let log = std::fs::read_to_string(self.path("log")).unwrap_or_default();
        log.lines().map(str::to_owned).collect()
    }
}

#[test]
fn load_asks_for_the_fpga_id_and_then_loads() {
    let bench = Bench::new("load");
    bench.answer("fine-1.0", &["load", "mill6.bit"]);
    std::fs::remove_file(bench.path("log")).unwrap();
    let said = bench.answer("fine", &["load", "mill6.bit"]);
    assert!(
        said.contains("mill6 on 5a-75b-8.0, build 00000001"),
        "{said}"
    );
    assert_eq!(
        bench.calls(),
        ["-c ft232 --detect", "-c ft232 -m mill6.bit"]
    );
}

#[test]
fn write_unprotects_verifies_and_begins_at_0_with_the_cable_named() {
    let bench = Bench::new("write");
    let said = bench.answer(
        "fine",
        &[
            "write",
            "mill6.flash",
            "--cable",
            "dirtyJtag",
            "--freq",
            "1000000",
        ],
    );
    assert!(said.contains("golden build 00000002"), "{said}");
    assert_eq!(
        bench.calls()[1],
        "-c dirtyJtag --freq 1000000 -f --unprotect-flash --verify -o 0 --file-type raw mill6.flash"
    );
    assert_eq!(
        std::fs::read(bench.path("board.bin")).unwrap(),
        std::fs::read(bench.path("mill6.flash")).unwrap()
    );
    let said = bench.answer("fine", &["verify", "mill6.flash"]);
    assert!(said.contains("agrees with the file"), "{said}");
}

#[test]
fn verify_names_the_pieces_that_differ() {
    let bench = Bench::new("verify");
    let mut flash = std::fs::read(bench.path("mill6.flash")).unwrap();
    flash[0x18_0040] ^= 1;
    std::fs::write(bench.path("board.bin"), flash).unwrap();
    let said = bench.complaint("fine", &["verify", "mill6.flash"]);
    assert!(said.contains("golden image first at 0x180040"), "{said}");
    assert!(!said.contains("slot A ("), "{said}");
}

#[test]
fn without_a_terminal_progress_is_one_line_per_step() {
    let bench = Bench::new("progress");
    let output = bench.run("fine", &["write", "mill6.flash"]);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(
        said.contains("Erasing") && said.contains("Writing"),
        "{said}"
    );
}

#[test]
fn every_usual_failure_has_its_own_sentence() {
    let bench = Bench::new("failures");
    for (case, what, expected) in [
        ("no-cable", "load", "no JTAG cable \"ft232\" is plugged in"),
        (
            "no-cable-1.0",
            "load",
            "no JTAG cable \"ft232\" is plugged in",
        ),
        (
            "permission",
            "load",
            "ATTRS{idVendor}==\"0403\", ATTRS{idProduct}==\"6014\"",
        ),
        (
            "permission-8",
            "load",
            "/etc/udev/rules.d/60-ferrocnc-jtag.rules",
        ),
        ("permission-1.0", "write", "TAG+=\"uaccess\""),
        ("busy", "load", "in use by another program"),
        ("unknown-cable", "load", "--list-cables"),
        ("no-fpga", "load", "check the board's power"),
        ("stuck", "write", "TDO is stuck at 0"),
        (
            "wrong-fpga",
            "load",
            "the file is for LFE5U-25F (0x41111043), the board has LFE5U-45F (0x41112043)",
        ),
        ("wrong-fpga", "write", "the board has LFE5U-45F"),
        ("protected", "write", "write-protected"),
        ("stays-protected", "write", "write-protected"),
        ("no-flash", "write", "its flash does not"),
        (
            "wrong-fpga-1.0",
            "load",
            "the board has LFE5U-45F (0x41112043)",
        ),
        ("same-die", "load", "the board has LFE5U-12F (0x21111043)"),
        ("stubborn", "write", "does not accept a configuration"),
        ("stubborn", "verify", "does not accept a configuration"),
        ("verify", "write", "Verification failed at 4096"),
        ("odd", "load", "the moon is in the wrong house"),
    ] {
        let file = if what == "load" {
            "mill6.bit"
        } else {
            "mill6.flash"
        };
        let said = bench.complaint(case, &[what, file]);
        assert!(said.contains(expected), "{case}: {said}");
        let sentence = said.lines().filter(|line| line.starts_with("ferrocnc: "));
        assert_eq!(sentence.count(), 1, "{case}: {said}");
    }
}

#[test]
fn nothing_is_written_when_the_fpga_or_the_file_is_the_wrong_one() {
    let bench = Bench::new("nothing");
    bench.complaint("wrong-fpga", &["write", "mill6.flash"]);
    assert_eq!(bench.calls(), ["-c ft232 --detect"]);
    let said = bench.complaint("fine", &["write", "mill6.bit"]);
    assert!(said.contains("write the .flash file"), "{said}");
    let said = bench.complaint("fine", &["load", "mill6.flash"]);
    assert!(said.contains("not an ECP5 bitstream"), "{said}");
    let said = bench.complaint("fine", &["load", "nowhere.bit"]);
    assert!(said.contains("cannot read nowhere.bit"), "{said}");
    assert_eq!(bench.calls().len(), 1);
}

#[test]
fn without_the_program_the_message_says_how_to_get_it() {
    let bench = Bench::new("absent");
    std::fs::remove_file(bench.path("bin/openFPGALoader")).unwrap();
    let said = bench.complaint("absent", &["load", "mill6.bit"]);
    assert!(said.contains("sudo apt install openfpgaloader"), "{said}");
}

/// Images as the package has them: a folder per board file.
fn install_images(bench: &Bench, images: &[(&str, &str)]) {
    for (configuration, platform) in images {
        let folder = bench.path("images").join(configuration);
        std::fs::create_dir_all(&folder).unwrap();
        let image = |build| {
            let file = image::sample::file(configuration, platform, build, 3000);
            Image::parse(&file).unwrap()
        };
        let flash = flash_file::sample::file(0x20_0000, &image(1), &image(2));
        std::fs::write(folder.join(format!("{configuration}.flash")), flash).unwrap();
    }
}

#[test]
fn write_finds_the_image_of_a_card_in_the_package() {
    let bench = Bench::new("card");
    install_images(&bench, &[("mill6", "5a-75b-8.0"), ("lathe", "5a-75b-7.0")]);
    let write = ["write", "--images", "images", "--card", "5a-75b-8.0"];
    let said = bench.answer("fine-1.0", &write);
    assert!(said.contains("mill6 on 5a-75b-8.0"), "{said}");
    assert!(
        bench
            .calls()
            .last()
            .unwrap()
            .ends_with("images/mill6/mill6.flash")
    );
}

#[test]
fn several_images_of_a_card_are_named_and_one_is_chosen() {
    let bench = Bench::new("several");
    install_images(&bench, &[("mill6", "5a-75b-8.0"), ("router", "5a-75b-8.0")]);
    let write = ["write", "--images", "images", "--card", "5a-75b-8.0"];
    let said = bench.complaint("fine-1.0", &write);
    assert!(said.contains("--board: mill6, router"), "{said}");
    let said = bench.answer("fine-1.0", &[&write[..], &["--board", "router"]].concat());
    assert!(said.contains("router on 5a-75b-8.0"), "{said}");
}

#[test]
fn a_card_without_an_image_is_told_which_there_are() {
    let bench = Bench::new("none");
    install_images(&bench, &[("mill6", "5a-75b-8.0")]);
    let write = |images: &str, card: &str| {
        bench.complaint("fine-1.0", &["write", "--images", images, "--card", card])
    };
    let said = write("images", "5a-75e-7.1");
    assert!(said.contains("it has mill6 for 5a-75b-8.0"), "{said}");
    let said = write("nowhere", "5a-75b-8.0");
    assert!(
        said.contains("install the package ferrocnc-images"),
        "{said}"
    );
    assert_eq!(bench.calls(), Vec::<String>::new());
}

#[test]
fn a_file_for_another_card_is_refused_before_the_fpga_is_asked() {
    let bench = Bench::new("other-card");
    let said = bench.complaint(
        "fine-1.0",
        &["write", "mill6.flash", "--card", "5a-75e-7.1"],
    );
    assert!(
        said.contains("is for 5a-75b-8.0, not for 5a-75e-7.1"),
        "{said}"
    );
    assert_eq!(bench.calls(), Vec::<String>::new());
}
