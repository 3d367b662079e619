//! `ferrocnc install-module` with made-up builds of LinuxCNC.

#[path = "common/tool.rs"]
mod ferrocnc_tool;

use ferrocnc_tool::{answer, complaint};
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

/// A folder with a run-in-place build and a module.
struct Place(PathBuf);

impl Place {
    fn new(name: &str) -> Self {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("install-module-{name}"));
        let _ = fs::remove_dir_all(&folder);
        for part in ["rip/bin", "rip/rtlib"] {
            fs::create_dir_all(folder.join(part)).unwrap();
        }
        fs::write(folder.join("rip/bin/rtapi_app"), "").unwrap();
        fs::write(folder.join("module.so"), b"\x7fELF...\0rtapi_app_main\0").unwrap();
        Place(folder)
    }

    fn path(&self, part: &str) -> String {
        self.0.join(part).display().to_string()
    }

    fn arguments(&self) -> [String; 5] {
        let (rip, from) = (self.path("rip"), self.path("module.so"));
        [
            "install-module".into(),
            "--rip".into(),
            rip,
            "--from".into(),
            from,
        ]
    }

    #[track_caller]
    fn says(&self) -> String {
        answer(&self.arguments().each_ref().map(String::as_str))
    }

    #[track_caller]
    fn complains(&self) -> String {
        complaint(&self.arguments().each_ref().map(String::as_str))
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

#[test]
fn the_module_gets_into_a_run_in_place_build_once() {
    let place = Place::new("once");
    let said = place.says();
    assert!(
        said.contains("rtlib/ferrocnc.so is the module now"),
        "{said}"
    );
    assert!(said.contains("sudo make setuid"), "{said}");
    let module = fs::read(place.path("module.so")).unwrap();
    assert_eq!(
        fs::read(place.path("rip/rtlib/ferrocnc.so")).unwrap(),
        module
    );
    let said = place.says();
    assert!(said.contains("is the module already"), "{said}");
    let left: Vec<_> = fs::read_dir(place.path("rip/rtlib")).unwrap().collect();
    assert_eq!(left.len(), 1, "no part of a file is left");
}

#[test]
fn a_loaded_module_is_replaced_not_written_over() {
    let place = Place::new("replaced");
    let (installed, loaded) = (place.path("rip/rtlib/ferrocnc.so"), place.path("loaded"));
    fs::write(&installed, "old").unwrap();
    fs::hard_link(&installed, &loaded).unwrap();
    place.says();
    assert_eq!(fs::read(&loaded).unwrap(), b"old");
}

#[test]
fn a_folder_that_is_no_build_and_a_file_that_is_no_module_are_refused() {
    let place = Place::new("refused");
    fs::write(place.path("module.so"), "\x7fELF of something else").unwrap();
    let said = place.complains();
    assert!(said.contains("module.so is no realtime module"), "{said}");
    fs::remove_file(place.path("rip/bin/rtapi_app")).unwrap();
    let said = place.complains();
    assert!(said.contains("is no run-in-place build"), "{said}");
}

#[test]
fn rights_of_rtapi_app_are_told_only_if_they_are_missing() {
    let place = Place::new("rights");
    let program = place.path("rip/bin/rtapi_app");
    let owner = fs::metadata(&program).unwrap();
    if std::os::unix::fs::MetadataExt::uid(&owner) != 0 {
        return; // Only root can make a file of root's.
    }
    fs::set_permissions(&program, fs::Permissions::from_mode(0o4755)).unwrap();
    let said = place.says();
    assert!(!said.contains("setuid"), "{said}");
}
