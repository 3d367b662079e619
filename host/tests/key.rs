//! Fake boards with a key: a client with the key is accepted, a client without it gets the remedy.

#[path = "common/fake_board.rs"]
mod common;

use common::flash::LanSegment;
use common::rig::PERIOD_NS;
use common::{FakeBoard, Time};
use ferrocnc::address;
use ferrocnc::client::{Client, ClientError};
use ferrocnc::discovery::{DiscoveryError, Finder};
use ferrocnc::driver::Driver;
use ferrocnc::hal::fake::FakeHal;
use ferrocnc::keys::{self, Key, KeyError, Keys};
use ferrocnc::link::Link;
use ferrocnc::uid::uid_text;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::time::Duration;
use wire::map;
use wire::settings::Settings;

/// A folder of this test's own, for $XDG_CONFIG_HOME.
fn home(test: &str) -> PathBuf {
    let home = std::env::temp_dir().join(format!("ferrocnc-key-{}-{test}", std::process::id()));
    let _ = fs::remove_dir_all(&home);
    fs::create_dir_all(&home).unwrap();
    home
}

fn board() -> FakeBoard {
    let board = FakeBoard::mill6(Time::Lockstep(60_000));
    board.look().flash.looks = 0;
    board
}

/// A board with a key, and a file with that key and one with another.
fn locked(test: &str) -> (FakeBoard, Keys, Keys) {
    let board = board();
    let home = home(test);
    let [right, wrong] = ["right.key", "wrong.key"].map(|name| home.join(name));
    let key = Key::random().unwrap();
    keys::write(&right, &key).unwrap();
    keys::write(&wrong, &Key::random().unwrap()).unwrap();
    {
        let mut mind = board.look();
        mind.key = Some(key);
        mind.flash.settings.key = key.words();
    }
    (board, Keys::File(right), Keys::File(wrong))
}

fn client(board: &FakeBoard, keys: &Keys) -> Client {
    let address = address::parse(&board.text(), 1234).unwrap();
    let client = Client::open(&address).unwrap().with_keys(keys.clone());
    client.with_patience(Duration::from_secs(1))
}

fn tool(home: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_ferrocnc"))
        .args(arguments)
        .env("XDG_CONFIG_HOME", home)
        .output()
        .unwrap()
}

#[track_caller]
fn answer(home: &Path, arguments: &[&str]) -> String {
    let output = tool(home, arguments);
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{arguments:?}: {error}");
    String::from_utf8(output.stdout).unwrap()
}

#[track_caller]
fn complaint(home: &Path, arguments: &[&str]) -> String {
    let output = tool(home, arguments);
    assert!(!output.status.success(), "{arguments:?} succeeded");
    String::from_utf8(output.stderr).unwrap()
}

#[test]
fn a_client_with_the_key_gets_the_session_and_can_give_it_back() {
    let (board, right, _) = locked("session");
    let mut client = client(&board, &right);
    let session = client.acquire().unwrap();
    assert!(board.look().owner.is_some());
    assert!(client.key().is_some());
    client.release(&session);
    // The answer comes after the release.
    client.read(&[map::SESSION_TOKEN]).unwrap();
    assert!(board.look().owner.is_none());
}

#[test]
fn a_client_without_the_key_or_with_another_is_told_what_to_do() {
    let (board, _, wrong) = locked("refused");
    let nowhere = Keys::File("/nowhere/at/all.key".into());
    let said = client(&board, &nowhere).acquire().unwrap_err();
    assert!(
        matches!(said, ClientError::Key(_, KeyError::Missing(_))),
        "{said}"
    );
    let said = said.to_string();
    for part in [
        &board.text()[..],
        "requires a key",
        "/nowhere/at/all.key",
        "key=FILE",
        "factory pin",
    ] {
        assert!(said.contains(part), "{part} is not in: {said}");
    }
    let said = client(&board, &wrong).acquire().unwrap_err();
    assert!(
        matches!(said, ClientError::Key(_, KeyError::Wrong(_))),
        "{said}"
    );
    assert!(said.to_string().contains("not the one in"), "{said}");
    assert!(board.look().owner.is_none());
}

#[test]
fn a_board_that_another_host_drives_is_refused_with_that_reason_even_with_the_key() {
    let (board, right, _) = locked("owned");
    let _owner = client(&board, &right).acquire().unwrap();
    let said = client(&board, &right).acquire().unwrap_err();
    assert!(matches!(said, ClientError::Owned { .. }), "{said}");
}

#[test]
fn a_board_without_a_key_is_asked_for_none() {
    let board = board();
    let nowhere = Keys::File("/nowhere/at/all.key".into());
    client(&board, &nowhere).acquire().unwrap();
}

#[test]
fn the_driver_takes_a_board_with_a_key_again_after_the_cable_was_out() {
    let (board, right, _) = locked("driver");
    let mut hal = FakeHal::default();
    let mut client = client(&board, &right);
    let address = client.address().clone();
    let identity = client.identify().unwrap();
    client.acquire().unwrap();
    let key = client.key();
    let link = Link::new(client.into_socket()).unwrap();
    let say = hal.messenger();
    let mut driver = Driver::export(&mut hal, 0, address, &identity, link, say).unwrap();
    driver.remember(key);
    // A busy computer may lose the session by itself; it comes back the same way.
    let mut online = |other_than: Option<u32>| {
        (0..1_000).find_map(|_| {
            driver.read(PERIOD_NS);
            driver.write(PERIOD_NS);
            std::thread::sleep(Duration::from_millis(2));
            driver.token().filter(|token| Some(*token) != other_than)
        })
    };
    let first = online(None).expect("online");
    let before = board.look().proved;
    board.look().reboot();
    online(Some(first)).expect("taken again");
    assert!(board.look().proved > before);
}

#[test]
fn a_key_is_made_kept_for_this_user_alone_shown_changed_and_cleared() {
    let (board, home) = (board(), home("life"));
    let at = board.text();
    let uid = board.look().flash.uid;
    let file = home
        .join("ferrocnc/keys")
        .join(format!("{}.key", uid_text(uid)));

    let said = answer(&home, &["key", "show", &at]);
    assert!(
        said.contains("has no key") && said.contains("not there"),
        "{said}"
    );
    let said = complaint(&home, &["key", "clear", &at]);
    assert!(said.contains("has no key"), "{said}");

    let said = answer(&home, &["key", "new", &at]);
    assert!(said.contains(file.to_str().unwrap()), "{said}");
    assert_eq!(
        fs::metadata(&file).unwrap().permissions().mode() & 0o777,
        0o600
    );
    let first = keys::read(&file).unwrap();
    assert_eq!(board.look().flash.settings.key, first.words());
    assert!(
        !said.contains(fs::read_to_string(&file).unwrap().trim()),
        "{said}"
    );
    let said = answer(&home, &["key", "show", &at]);
    assert!(
        said.contains("they fit") && said.contains(&first.fingerprint()),
        "{said}"
    );

    // Another computer, which has not the key.
    let stranger = self::home("stranger");
    for arguments in [["key", "new", &at], ["key", "clear", &at]] {
        let said = complaint(&stranger, &arguments);
        assert!(said.contains("requires a key"), "{said}");
    }
    assert_eq!(board.look().flash.settings.key, first.words());
    assert!(files(&stranger).is_empty(), "{:?}", files(&stranger));

    answer(&home, &["key", "new", &at]);
    let second = keys::read(&file).unwrap();
    assert_ne!(second, first);
    assert_eq!(board.look().flash.settings.key, second.words());

    let third = home.join("third");
    keys::write(&third, &Key::random().unwrap()).unwrap();
    answer(&home, &["key", "set", &at, third.to_str().unwrap()]);
    assert_eq!(keys::read(&file).unwrap(), keys::read(&third).unwrap());

    answer(&home, &["key", "clear", &at]);
    assert_eq!(board.look().flash.settings.key, wire::auth::NONE);
    assert!(!file.exists());
}

/// The files of a board's keys: its own first, if it is there, then what was on its way.
fn files(home: &Path) -> Vec<PathBuf> {
    let folder = fs::read_dir(home.join("ferrocnc/keys"));
    let mut files: Vec<_> = folder
        .into_iter()
        .flatten()
        .map(|entry| entry.unwrap().path())
        .collect();
    files.sort();
    files
}

/// The board comes back after the plug was out: what it has saved is in force.
fn plug_in_again(board: &FakeBoard) {
    let mut mind = board.look();
    mind.flash.silent_after = None;
    mind.flash.lose_save = false;
    mind.knobs.unplugged = false;
    mind.power_cycle();
}

#[test]
fn if_the_receipt_for_a_key_is_lost_the_key_is_kept_named_and_used_at_the_next_contact() {
    let (board, home) = (board(), home("receipt"));
    let at = board.text();
    // The board has saved, and sends nothing more.
    board.look().flash.looks = 1;
    board.look().flash.silent_after = Some(1);
    let said = complaint(&home, &["key", "new", &at]);
    let saved = Key::new(board.look().flash.settings.key).expect("the board has a key");
    let [kept] = &files(&home)[..] else {
        panic!("{:?}", files(&home));
    };
    assert_eq!(keys::read(kept).unwrap(), saved);
    assert!(
        said.contains(kept.to_str().unwrap()) && said.contains("not known"),
        "{said}"
    );
    assert!(
        !said.contains(fs::read_to_string(kept).unwrap().trim()),
        "{said}"
    );

    plug_in_again(&board);
    answer(&home, &["set", &at, "--name", "mill"]);
    assert_eq!(board.look().flash.settings.name.text(), "mill");
    let [file] = &files(&home)[..] else {
        panic!("{:?}", files(&home));
    };
    assert_eq!(keys::read(file).unwrap(), saved);
    assert!(file.to_str().unwrap().ends_with(".key"), "{file:?}");
}

#[test]
fn a_key_that_never_reached_the_board_is_kept_beside_the_one_it_has_and_does_no_harm() {
    let (board, home) = (board(), home("request"));
    let at = board.text();
    answer(&home, &["key", "new", &at]);
    let has = board.look().flash.settings.key;
    board.look().flash.lose_save = true;
    let said = complaint(&home, &["key", "new", &at]);
    assert_eq!(board.look().flash.settings.key, has);
    let both = files(&home);
    assert_eq!(both.len(), 2, "{both:?}");
    assert!(said.contains(both[1].to_str().unwrap()), "{said}");

    plug_in_again(&board);
    let said = answer(&home, &["key", "show", &at]);
    assert!(
        said.contains("they fit") && said.contains(both[1].to_str().unwrap()),
        "{said}"
    );
    assert_eq!(keys::read(&both[0]).unwrap().words(), has);
    // The next one that arrives overtakes it.
    answer(&home, &["key", "new", &at]);
    assert_eq!(files(&home), both[..1]);
    assert_eq!(
        keys::read(&both[0]).unwrap().words(),
        board.look().flash.settings.key
    );
}

#[test]
fn a_key_the_board_refuses_is_not_kept_and_one_its_flash_failed_at_is() {
    use wire::flash::OpResult;
    for (result, left) in [
        (OpResult::Value, 0),
        (OpResult::NoFlash, 0),
        (OpResult::Flash, 1),
    ] {
        let (board, home) = (board(), home(&format!("refuses-{left}-{}", result.code())));
        board.look().flash.refuse = Some(result);
        let said = complaint(&home, &["key", "new", &board.text()]);
        assert_eq!(files(&home).len(), left, "{result}: {said}");
        assert_eq!(said.contains("not known"), left > 0, "{said}");
    }
}

#[test]
fn a_key_that_a_board_may_have_since_an_earlier_try_is_kept_when_a_later_one_is_refused() {
    use wire::flash::OpResult;
    let (board, home) = (board(), home("again"));
    let file = home.join("mine");
    let key = Key::random().unwrap();
    keys::write(&file, &key).unwrap();
    let arguments = ["key", "set", &board.text(), file.to_str().unwrap()];
    board.look().flash.looks = 1;
    board.look().flash.silent_after = Some(1);
    assert!(complaint(&home, &arguments).contains("not known"));
    assert_eq!(board.look().flash.settings.key, key.words());
    // It has saved it, goes on without it until its next start, and refuses the next try.
    board.look().flash.silent_after = None;
    board.look().knobs.unplugged = false;
    board.look().flash.refuse = Some(OpResult::Value);
    complaint(&home, &arguments);
    board.look().flash.refuse = None;
    plug_in_again(&board);
    answer(&home, &["set", &board.text(), "--name", "mill"]);
    assert_eq!(keys::read(&files(&home)[0]).unwrap(), key);
}

#[test]
fn a_tool_killed_while_the_board_saves_leaves_the_key_on_the_disk() {
    let (board, home) = (board(), home("killed"));
    let at = board.text();
    // It saves for longer than the tool runs.
    board.look().flash.looks = u32::MAX;
    let mut tool = Command::new(env!("CARGO_BIN_EXE_ferrocnc"))
        .args(["key", "new", &at])
        .env("XDG_CONFIG_HOME", &home)
        .spawn()
        .unwrap();
    while !board.look().flash.busy() {
        assert!(tool.try_wait().unwrap().is_none(), "it ended by itself");
        std::thread::sleep(Duration::from_millis(1));
    }
    tool.kill().unwrap();
    tool.wait().unwrap();
    board.look().flash.end();
    let saved = Key::new(board.look().flash.settings.key).expect("the board has a key");
    let [kept] = &files(&home)[..] else {
        panic!("{:?}", files(&home));
    };
    assert_eq!(keys::read(kept).unwrap(), saved);
    board.look().flash.looks = 0;
    plug_in_again(&board);
    let said = answer(&home, &["key", "show", &at]);
    assert!(
        said.contains("they fit") && said.contains(&saved.fingerprint()),
        "{said}"
    );
}

#[test]
fn when_the_receipt_for_no_key_is_lost_the_old_one_stays_on_this_computer() {
    let (board, home) = (board(), home("clear"));
    let at = board.text();
    answer(&home, &["key", "new", &at]);
    let before = files(&home);
    board.look().flash.lose_save = true;
    let said = complaint(&home, &["key", "clear", &at]);
    assert!(said.contains("not known"), "{said}");
    assert_eq!(files(&home), before);
    plug_in_again(&board);
    answer(&home, &["key", "clear", &at]);
    assert!(files(&home).is_empty());
}

#[test]
fn discovery_tries_the_key_that_was_on_its_way_too() {
    let segment = LanSegment::of(&[[1, 2]]);
    let home = home("discovery-pending");
    let [has, other] = [Key::random().unwrap(), Key::random().unwrap()];
    let folder = home.join("ferrocnc/keys");
    let file = folder.join(format!("{}.key", uid_text([1, 2])));
    let waiting = file.with_extension(format!("key.new-{}", has.fingerprint()));
    keys::write(&file, &other).unwrap();
    keys::write(&waiting, &has).unwrap();
    segment.look()[0].flash.settings.key = has.words();
    let at = segment.address.to_string();
    let arguments = [
        "set",
        "--uid",
        &uid_text([1, 2]),
        "--at",
        &at,
        "--ip",
        "10.0.0.7",
    ];
    // The board has no Etherbone server at its address: only discovery is asked.
    let output = tool(&home, &arguments);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(segment.look()[0].flash.settings.ip, 0x0a00_0007, "{said}");
    assert_eq!(files(&home), std::slice::from_ref(&file));
    assert_eq!(keys::read(&file).unwrap(), has);
}

#[test]
fn if_the_receipt_for_an_address_is_lost_the_address_is_told_to_be_old_or_new() {
    let (board, home) = (board(), home("address"));
    board.look().flash.looks = 1;
    board.look().flash.silent_after = Some(1);
    let said = complaint(&home, &["set", &board.text(), "--ip", "10.0.0.7"]);
    for part in ["may have", "10.0.0.7", "ferrocnc discover"] {
        assert!(said.contains(part), "{part} is not in: {said}");
    }
}

#[test]
fn settings_change_with_the_key_only_and_leave_it_alone() {
    let (board, right, wrong) = locked("settings");
    let home = home("settings-home");
    let at = board.text();
    let [right, wrong] = [right, wrong].map(|keys| keys.path([0; 2]).unwrap());
    let [right, wrong] = [&right, &wrong].map(|path| path.to_str().unwrap());
    let said = complaint(&home, &["set", &at, "--name", "mill"]);
    assert!(said.contains("requires a key"), "{said}");
    let said = complaint(&home, &["set", &at, "--name", "mill", "--key", wrong]);
    assert!(said.contains("not the one in"), "{said}");
    assert_eq!(board.look().flash.settings.name.text(), "");
    let key = board.look().flash.settings.key;
    answer(&home, &["set", &at, "--name", "mill", "--key", right]);
    let settings = board.look().flash.settings;
    assert_eq!((settings.name.text(), settings.key), ("mill", key));
}

#[test]
fn settings_by_discovery_are_proved_and_a_lost_receipt_is_asked_for_again() {
    let segment = LanSegment::of(&[[1, 2]]);
    let home = home("discovery");
    let (right, wrong) = (home.join("right.key"), home.join("wrong.key"));
    let key = Key::random().unwrap();
    keys::write(&right, &key).unwrap();
    keys::write(&wrong, &Key::random().unwrap()).unwrap();
    segment.look()[0].flash.settings.key = key.words();
    let finder = Finder::at(segment.address).unwrap();
    let settings = Settings {
        ip: 0x0a00_0007,
        keep_key: true,
        ..Settings::default()
    };
    let said = finder
        .set([1, 2], &settings, &Keys::File(wrong))
        .unwrap_err();
    assert!(
        matches!(said, DiscoveryError::Key(_, KeyError::Wrong(_))),
        "{said}"
    );
    let said = finder
        .set([1, 2], &settings, &Keys::File(home.join("none")))
        .unwrap_err();
    assert!(
        matches!(said, DiscoveryError::Key(_, KeyError::Missing(_))),
        "{said}"
    );
    assert_eq!(segment.look()[0].saved, 0);
    // The challenge arrives, the receipt does not.
    for lose in [0, 1, 2] {
        segment.look()[0].lose = lose;
        let settings = Settings {
            ip: settings.ip + lose,
            ..settings
        };
        finder
            .set([1, 2], &settings, &Keys::File(right.clone()))
            .unwrap();
        assert_eq!(segment.look()[0].flash.settings.ip, settings.ip);
        assert_eq!(segment.look()[0].flash.settings.key, key.words());
    }
}
