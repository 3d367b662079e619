//! The realtime module: the symbols of `ferrocnc.so` that `loadrt ferrocnc boards=...` needs.
//!
//! `rtapi_app` looks up `rtapi_app_main`, `rtapi_app_exit`, and per module parameter a pair of
//! words saying its type and where it lives. C uses macros for them; here they are written out.
//!
//! # Unloading
//!
//! `unloadrt` calls `rtapi_app_exit` while realtime threads run on, and unmaps the module when that
//! returns. Nothing in HAL waits for a thread that is inside one of our functions, or about to call
//! one. So:
//!
//! 1. Every function goes through its board's [`Turn`]. `rtapi_app_exit` shuts it, waits for the
//!    thread inside, and gives the session back: the board stops softly.
//! 2. HAL takes our functions out of its threads' lists without asking whether one is being walked
//!    through. That is done right after a thread was turned away, when it has the rest of its
//!    period to sleep.
//! 3. What a thread may still hold after that is the address of the `Turn` and of the function. The
//!    one is never freed (some hundred bytes a board), the other never unmapped (`build.rs` links
//!    with `nodelete`).

use crate::address::{self, Address};
use crate::client::{Client, ClientError};
use crate::clock::Timebase;
use crate::driver::Driver;
use crate::fence::{Fenced, install_quiet_hook};
use crate::group::Group;
use crate::hal::ffi::{Api, Funct};
use crate::hal::real::{Component, messenger, print};
use crate::hal::{ExportError, Level};
use crate::keys::Keys;
use crate::link::Link;
use crate::names::{self, Does, NamesError, Scheme};
use crate::turn::Turn;
use core::ffi::{CStr, c_char, c_int, c_long, c_void};
use core::sync::atomic::{AtomicPtr, Ordering};
use std::ffi::CString;
use std::path::Path;
use std::time::{Duration, Instant};

/// A pointer-sized word `rtapi_app` reads by name.
#[repr(transparent)]
pub struct Word(*const c_void);
// SAFETY: never written after the program starts, and what it points to is a static.
unsafe impl Sync for Word {}

macro_rules! exported {
    ($name:ident, $value:expr) => {
        #[unsafe(no_mangle)]
        #[allow(non_upper_case_globals, missing_docs)]
        pub static $name: Word = Word($value.cast());
    };
}

static BOARDS: AtomicPtr<c_char> = AtomicPtr::new(core::ptr::null_mut());
static NAMES: AtomicPtr<c_char> = AtomicPtr::new(core::ptr::null_mut());
static KEY: AtomicPtr<c_char> = AtomicPtr::new(core::ptr::null_mut());

// RTAPI_MP_STRING(boards, "...") and the usual declarations.
exported!(rtapi_info_type_boards, c"s".as_ptr());
exported!(rtapi_info_address_boards, (&raw const BOARDS));
exported!(
    rtapi_info_description_boards,
    c"Boards to drive: IP[:port][,IP[:port]...], at most 4".as_ptr()
);
exported!(rtapi_info_type_names, c"s".as_ptr());
exported!(rtapi_info_address_names, (&raw const NAMES));
exported!(
    rtapi_info_description_names,
    c"Pins under other drivers' names as well: lcnc, or litexcnc[-named][:NAME[,NAME...]]".as_ptr()
);
exported!(rtapi_info_type_key, c"s".as_ptr());
exported!(rtapi_info_address_key, (&raw const KEY));
exported!(
    rtapi_info_description_key,
    c"File with the key of boards that have one; each board's own in ~/.config/ferrocnc/keys if not given".as_ptr()
);
/// In front of the release in the module's file, for `ferrocnc doctor`.
pub const VERSION_MARK: &str = "ferrocnc.so of release ";
exported!(
    rtapi_info_version,
    concat!("ferrocnc.so of release ", env!("CARGO_PKG_VERSION"), "\0").as_ptr()
);
exported!(rtapi_info_license, c"GPL".as_ptr());
exported!(
    rtapi_info_description,
    c"FerroCNC: motion on Colorlight ECP5 boards".as_ptr()
);

/// A board as HAL's functions know it; empty once it is unloaded.
pub type SharedBoard = Turn<Option<Fenced>>;

/// Everything alive between load and unload.
struct Loaded {
    component: Component,
    /// Leaked: a thread may look at one after it was unloaded.
    boards: Vec<&'static SharedBoard>,
}

/// 5 s for a thread to come out of a function: longer than any `packet-read-timeout`.
const PATIENCE: Duration = Duration::from_secs(5);
/// 100 us between two looks.
const LOOK: Duration = Duration::from_micros(100);
/// 20 ms: a thread that was not turned away in that time does not run, or is too slow to be waited
/// for.
const SLOWEST: Duration = Duration::from_millis(20);

static LOADED: AtomicPtr<Loaded> = AtomicPtr::new(core::ptr::null_mut());

/// Why `loadrt` fails.
enum LoadError {
    Address(address::AddressError),
    Names(NamesError),
    Client(ClientError),
    Export(ExportError),
    Hal(&'static str, i32),
}

impl core::fmt::Display for LoadError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            LoadError::Address(error) => write!(f, "parameter boards: {error}"),
            LoadError::Names(error) => write!(f, "parameter names: {error}"),
            LoadError::Client(error) => error.fmt(f),
            LoadError::Export(error) => error.fmt(f),
            LoadError::Hal(what, errno) => write!(
                f,
                "{what} failed ({})",
                std::io::Error::from_raw_os_error(-errno)
            ),
        }
    }
}

impl LoadError {
    fn errno(&self) -> c_int {
        match self {
            LoadError::Address(_) | LoadError::Names(_) => -libc::EINVAL,
            LoadError::Client(error) => match error {
                ClientError::Silent { .. } => -libc::ETIMEDOUT,
                ClientError::Socket(_, error) => -error.raw_os_error().unwrap_or(libc::EIO),
                ClientError::Describe(..)
                | ClientError::Blob(..)
                | ClientError::Abi { .. }
                | ClientError::Pins(_) => -libc::EPROTO,
                ClientError::Owned { .. } | ClientError::NoSession(_) => -libc::EBUSY,
                ClientError::Key(..) => -libc::EACCES,
            },
            LoadError::Export(error) => error.errno,
            LoadError::Hal(_, errno) => *errno,
        }
    }
}

/// `loadrt` calls this after setting the parameters.
#[unsafe(no_mangle)]
pub extern "C" fn rtapi_app_main() -> c_int {
    let api = match Api::load() {
        Ok(api) => api,
        // Without HAL there is nowhere else to say it.
        Err(missing) => {
            eprintln!("ferrocnc: this process has no {missing:?}; load it with loadrt");
            return -libc::ENOSYS;
        }
    };
    install_quiet_hook(move |text| print(&api, Level::Error, text));
    let result = std::panic::catch_unwind(|| load(api));
    match result {
        Ok(Ok(loaded)) => {
            LOADED.store(Box::into_raw(Box::new(loaded)), Ordering::Release);
            0
        }
        Ok(Err(error)) => {
            say(&api, &error.to_string());
            error.errno()
        }
        // The panic hook has printed the place.
        Err(_) => -libc::EFAULT,
    }
}

/// `unloadrt`, and LinuxCNC's end.
#[unsafe(no_mangle)]
pub extern "C" fn rtapi_app_exit() {
    let loaded = LOADED.swap(core::ptr::null_mut(), Ordering::AcqRel);
    if loaded.is_null() {
        return;
    }
    // SAFETY: `rtapi_app_main` put a box there, and the swap made us the only one to take it.
    let loaded = unsafe { Box::from_raw(loaded) };
    // Nothing may unwind out of here; the hook has said what happened.
    let _ = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| drop(loaded)));
    // The module stays where it is, and the next `loadrt` sets only what it is given.
    for parameter in [&BOARDS, &NAMES, &KEY] {
        parameter.store(core::ptr::null_mut(), Ordering::Relaxed);
    }
}

impl Drop for Loaded {
    fn drop(&mut self) {
        // Out of the threads' reach first; HAL forgets functions and pins when `component` is
        // dropped.
        for shared in &self.boards {
            drop(unload(shared));
        }
    }
}

/// Takes a board away from the threads and gives its session back. `None`: a thread is inside and
/// does not leave, so everything stays loaded; the board's watchdog stops the machine.
pub fn unload(shared: &SharedBoard) -> Option<Fenced> {
    let deadline = Instant::now() + PATIENCE;
    let patient = || {
        std::thread::sleep(LOOK);
        Instant::now() < deadline
    };
    let mut board = shared.shut(patient, Option::take).flatten()?;
    board.release();
    turned_away(shared);
    Some(board)
}

/// Waits until the threads that call a board have just been turned away, and sleep.
fn turned_away(shared: &SharedBoard) {
    let began = Instant::now();
    let before = shared.late();
    let mut last = before;
    while began.elapsed() < SLOWEST {
        std::thread::sleep(LOOK);
        let now = shared.late();
        // The last of its functions was called more than a look ago.
        if now != before && now == last {
            return;
        }
        last = now;
    }
}

fn load(api: Api) -> Result<Loaded, LoadError> {
    let boards = address::parse_list(&parameter(&BOARDS)).map_err(LoadError::Address)?;
    let scheme = Scheme::parse(&parameter(&NAMES)).map_err(LoadError::Names)?;
    let keys = Some(parameter(&KEY)).filter(|file| !file.is_empty());
    let keys = Keys::named(keys.as_deref().map(Path::new));
    // Connect to the boards first: if one is missing, nothing is registered with HAL.
    let clients = boards
        .iter()
        .map(|address| connect(address, &keys))
        .collect::<Result<Vec<_>, _>>()
        .map_err(LoadError::Client)?;
    if let Some(scheme) = &scheme {
        for (index, (_, identity)) in clients.iter().enumerate() {
            scheme.check(index, identity).map_err(LoadError::Names)?;
        }
    }
    let component =
        Component::new(api, c"ferrocnc").map_err(|errno| LoadError::Hal("hal_init", errno))?;
    let mut loaded = Loaded {
        component,
        boards: Vec::new(),
    };
    let (time, group, count) = (Timebase::new(), Group::new(), boards.len());
    for (index, (address, (client, identity))) in boards.into_iter().zip(clients).enumerate() {
        let key = client.key();
        let link = Link::new(client.into_socket())
            .map_err(|error| LoadError::Client(ClientError::Socket(address.clone(), error)))?;
        let mut driver = Driver::export(
            &mut loaded.component,
            index,
            address,
            &identity,
            link,
            messenger(api),
        )
        .map_err(LoadError::Export)?;
        driver.remember(key);
        driver.join(&time, &group, count);
        let mut functions = vec![
            (format!("ferrocnc.{index}.read-request"), READ_REQUEST),
            (format!("ferrocnc.{index}.read"), READ),
            (format!("ferrocnc.{index}.write"), WRITE),
        ];
        if let Some(scheme) = &scheme {
            let glue = names::export(scheme, &mut loaded.component, index, &identity, &driver)
                .map_err(LoadError::Export)?;
            driver.adopt(glue);
            let prefix = scheme.prefix(index, &identity);
            functions.extend(scheme.functions().iter().map(|(name, does)| {
                let function = match does {
                    Does::Read => READ,
                    Does::Write => WRITE,
                    Does::Both => UPDATE,
                };
                (format!("{prefix}.{name}"), function)
            }));
        }
        let fenced = Fenced::new(driver, messenger(api));
        let shared: &SharedBoard = Box::leak(Box::new(Turn::new(Some(fenced))));
        loaded.boards.push(shared);
        register(&loaded.component, &functions, shared).map_err(LoadError::Export)?;
    }
    let ready = loaded.component.ready();
    ready.map_err(|errno| LoadError::Hal("hal_ready", errno))?;
    Ok(loaded)
}

/// Identifies a board and takes its session.
fn connect(
    address: &Address,
    keys: &Keys,
) -> Result<(Client, crate::client::Identity), ClientError> {
    let mut client = Client::open(address)?.with_keys(keys.clone());
    let identity = client.identify()?;
    client.check(&identity)?;
    client.acquire()?;
    Ok((client, identity))
}

const READ_REQUEST: Funct = read_request;
const READ: Funct = read;
const WRITE: Funct = write;
const UPDATE: Funct = update;

fn register(
    component: &Component,
    functions: &[(String, Funct)],
    shared: &'static SharedBoard,
) -> Result<(), ExportError> {
    let argument = core::ptr::from_ref(shared).cast_mut();
    for (name, function) in functions {
        let name = CString::new(name.as_str()).unwrap_or_default();
        // SAFETY: all functions take a `SharedBoard`, and look at it only; it lives as long as the
        // program.
        unsafe { component.function(&name, *function, argument.cast())? };
    }
    Ok(())
}

/// A function's way in: not if another thread is inside, and not after the board was unloaded.
///
/// # Safety
/// `shared` must be what `register` registered.
unsafe fn enter(shared: *mut c_void, work: impl FnOnce(&mut Fenced)) {
    // SAFETY: the caller's promise; boards are never freed.
    let shared = unsafe { &*shared.cast::<SharedBoard>() };
    shared.take(|board| {
        let Some(board) = board else { return };
        board.collided(shared.collisions());
        work(board);
    });
}

unsafe extern "C" fn read_request(shared: *mut c_void, period_ns: c_long) {
    // SAFETY: HAL passes back what `register` registered.
    unsafe { enter(shared, |board| board.read_request(nanos(period_ns))) };
}

unsafe extern "C" fn read(shared: *mut c_void, period_ns: c_long) {
    // SAFETY: as in `read_request`.
    unsafe { enter(shared, |board| board.read(nanos(period_ns))) };
}

unsafe extern "C" fn write(shared: *mut c_void, period_ns: c_long) {
    // SAFETY: as in `read_request`.
    unsafe { enter(shared, |board| board.write(nanos(period_ns))) };
}

/// Lcnc's one function for both.
unsafe extern "C" fn update(shared: *mut c_void, period_ns: c_long) {
    // SAFETY: as in `read_request`.
    unsafe {
        enter(shared, |board| {
            board.read(nanos(period_ns));
            board.write(nanos(period_ns));
        });
    }
}

/// C's `long` is 32 bits on small machines.
#[allow(clippy::useless_conversion)]
fn nanos(period_ns: c_long) -> i64 {
    i64::from(period_ns)
}

fn parameter(value: &AtomicPtr<c_char>) -> String {
    let text = value.load(Ordering::Relaxed);
    if text.is_null() {
        return String::new();
    }
    // SAFETY: `rtapi_app` stored a C string it never frees.
    unsafe { CStr::from_ptr(text) }
        .to_string_lossy()
        .into_owned()
}

fn say(api: &Api, text: &str) {
    if let Ok(text) = CString::new(text) {
        print(api, Level::Error, &text);
    }
}
