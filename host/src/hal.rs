//! HAL with types: pins and parameters that know their value, direction and name.
//!
//! HAL keeps a *pointer* per pin in shared memory and re-points it whenever a signal is linked, so
//! a pin's slot is read again at every access. Other processes write those values while we look:
//! every access is volatile and a `bit` is read as a byte, never as a Rust `bool`.
//!
//! Where HAL comes from is a [`Backend`]: the real one ([`ffi`]) or a `Vec` ([`fake`]). Numbers
//! that come from it are [`checked`].

pub mod checked;
pub mod fake;
pub mod ffi;
pub mod real;

use checked::{Checked, Number, Rule, Source};
use core::ffi::{CStr, c_void};
use core::marker::PhantomData;
use core::ptr::NonNull;
use std::ffi::CString;
use wire::board::HAL_NAME_MAX;

/// Types of values, with HAL's codes (`hal_type_t`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(i32)]
pub enum Type {
    /// `hal_bit_t`.
    Bit = 1,
    /// `hal_float_t`.
    Float = 2,
    /// `hal_s32_t`.
    S32 = 3,
    /// `hal_u32_t`.
    U32 = 4,
}

/// Directions, with HAL's codes (`hal_pin_dir_t`, `hal_param_dir_t`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(i32)]
pub enum Direction {
    /// Pin: we read it.
    In = 16,
    /// Pin: we write it.
    Out = 32,
    /// Pin: both sides write it.
    Io = 48,
    /// Parameter: `setp` is refused.
    ReadOnly = 64,
    /// Parameter: `setp` sets it.
    ReadWrite = 192,
}

/// How loud a message is, with RTAPI's codes (`msg_level_t`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(i32)]
pub enum Level {
    /// Reaches the operator's screen.
    Error = 1,
    /// Log only, at the default level of LinuxCNC.
    Info = 3,
}

/// Why something could not be exported.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ExportError {
    /// What was to be exported.
    pub name: String,
    /// Negative errno.
    pub errno: i32,
}

impl core::fmt::Display for ExportError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(
            f,
            "HAL refused to export {} ({}); is another component using the name, or HAL memory full?",
            self.name,
            std::io::Error::from_raw_os_error(-self.errno)
        )
    }
}

impl std::error::Error for ExportError {}

/// Somewhere pins can be exported to.
pub trait Backend {
    /// Zeroed memory that lives as long as the component, aligned to 8 bytes.
    fn allocate(&mut self, bytes: usize) -> Option<NonNull<u8>>;
    /// Makes a pin; the backend stores the pointer to its value in `slot`.
    ///
    /// # Safety
    /// `slot` must come from this backend's [`Backend::allocate`], with room for a pointer.
    unsafe fn pin(
        &mut self,
        name: &CStr,
        ty: Type,
        direction: Direction,
        slot: *mut *mut c_void,
    ) -> i32;
    /// Makes a parameter; `value` points to its value.
    ///
    /// # Safety
    /// `value` must come from this backend's [`Backend::allocate`], with room for a `ty`.
    unsafe fn param(
        &mut self,
        name: &CStr,
        ty: Type,
        direction: Direction,
        value: *mut c_void,
    ) -> i32;
    /// Gives a pin (or a parameter) of ours a second name; both are good from then on.
    fn alias(&mut self, name: &CStr, alias: &CStr, pin: bool) -> i32;
}

/// Says something to the operator. Must not allocate: it is called from the servo thread.
pub type Messenger = Box<dyn Fn(Level, &CStr) + Send>;

mod sealed {
    pub trait Sealed {}
}

/// A value HAL knows.
pub trait Value: sealed::Sealed + Copy {
    /// Its HAL type.
    const TYPE: Type;
    /// Its layout in shared memory.
    type Raw: Copy;
    /// From shared memory.
    fn from_raw(raw: Self::Raw) -> Self;
    /// To shared memory.
    fn to_raw(self) -> Self::Raw;
}

macro_rules! value {
    ($ty:ty, $raw:ty, $code:ident, $from:expr, $to:expr) => {
        impl sealed::Sealed for $ty {}
        impl Value for $ty {
            const TYPE: Type = Type::$code;
            type Raw = $raw;
            fn from_raw(raw: $raw) -> Self {
                $from(raw)
            }
            fn to_raw(self) -> $raw {
                $to(self)
            }
        }
    };
}
// Any byte but 0 is true: a C program may have stored something else than 1.
value!(bool, u8, Bit, |raw| raw != 0, u8::from);
value!(f64, f64, Float, |raw| raw, |value| value);
value!(i32, i32, S32, |raw| raw, |value| value);
value!(u32, u32, U32, |raw| raw, |value| value);

/// Direction marker: we read.
#[derive(Clone, Copy, Debug)]
pub struct Input;
/// Direction marker: we write.
#[derive(Clone, Copy, Debug)]
pub struct Output;
/// Direction marker: both.
#[derive(Clone, Copy, Debug)]
pub struct Both;

/// A pin.
#[derive(Debug)]
pub struct Pin<T: Value, D> {
    slot: NonNull<*mut T::Raw>,
    direction: PhantomData<D>,
}

/// A pin we read.
pub type In<T> = Pin<T, Input>;
/// A pin we write.
pub type Out<T> = Pin<T, Output>;
/// A pin both sides write.
pub type Io<T> = Pin<T, Both>;

impl<T: Value, D> Pin<T, D> {
    /// The value right now.
    pub fn get(&self) -> T {
        // SAFETY: the slot lies in backend memory that outlives us, and HAL keeps a valid pointer
        // to a value of this type in it from the moment the pin exists.
        unsafe { T::from_raw(self.slot.as_ptr().read_volatile().read_volatile()) }
    }

    fn store(&self, value: T) {
        // SAFETY: as in `get`.
        unsafe {
            self.slot
                .as_ptr()
                .read_volatile()
                .write_volatile(value.to_raw());
        }
    }
}

impl<T: Value> Pin<T, Output> {
    /// Sets the value.
    pub fn set(&self, value: T) {
        self.store(value);
    }
}

impl<T: Value> Pin<T, Both> {
    /// Sets the value.
    pub fn set(&self, value: T) {
        self.store(value);
    }
}

/// A parameter.
#[derive(Debug)]
pub struct Param<T: Value> {
    value: NonNull<T::Raw>,
}

impl<T: Value> Param<T> {
    /// The value right now.
    pub fn get(&self) -> T {
        // SAFETY: the value lies in backend memory that outlives us.
        unsafe { T::from_raw(self.value.as_ptr().read_volatile()) }
    }

    /// Sets the value.
    pub fn set(&self, value: T) {
        // SAFETY: as in `get`.
        unsafe { self.value.as_ptr().write_volatile(value.to_raw()) }
    }
}

// SAFETY: both are addresses in shared memory that every access goes through volatile; HAL itself
// gives no more than that to any two threads.
unsafe impl<T: Value, D> Send for Pin<T, D> {}
// SAFETY: as above.
unsafe impl<T: Value> Send for Param<T> {}

/// The place of a value of any type, for the glue between pins.
#[derive(Clone, Copy, Debug)]
pub struct Handle {
    ty: Type,
    place: Place,
}

#[derive(Clone, Copy, Debug)]
enum Place {
    /// HAL's pointer to the value.
    Pin(NonNull<*mut c_void>),
    /// The value itself.
    Param(NonNull<c_void>),
}

impl Handle {
    fn address(&self) -> *mut c_void {
        match self.place {
            // SAFETY: the slot lies in backend memory that outlives us, and HAL keeps a valid
            // pointer in it.
            Place::Pin(slot) => unsafe { slot.as_ptr().read_volatile() },
            Place::Param(value) => value.as_ptr(),
        }
    }

    /// The value as a number; a bit is 0 or 1.
    pub fn get(&self) -> f64 {
        fn read<T: Value>(at: *mut c_void) -> T {
            // SAFETY: `at` points to a value of the type the handle was made with.
            unsafe { T::from_raw(at.cast::<T::Raw>().read_volatile()) }
        }
        let at = self.address();
        match self.ty {
            Type::Bit => f64::from(u8::from(read::<bool>(at))),
            Type::Float => read(at),
            Type::S32 => f64::from(read::<i32>(at)),
            Type::U32 => f64::from(read::<u32>(at)),
        }
    }

    /// Sets it, saturating at what its type can hold.
    pub fn set(&self, value: f64) {
        fn write<T: Value>(at: *mut c_void, value: T) {
            // SAFETY: as in `get`.
            unsafe { at.cast::<T::Raw>().write_volatile(value.to_raw()) }
        }
        let at = self.address();
        match self.ty {
            Type::Bit => write(at, value != 0.0),
            Type::Float => write(at, value),
            Type::S32 => write(at, value as i32),
            Type::U32 => write(at, value as u32),
        }
    }

    /// Its type.
    pub fn ty(&self) -> Type {
        self.ty
    }
}

// SAFETY: as for `Pin` and `Param`.
unsafe impl Send for Handle {}

/// Something exported, and how to find it again.
#[derive(Clone, Debug)]
pub struct Exported {
    /// Class, number, pin: `stepgen.0.position-cmd`, even if the board has a name for channel 0.
    pub logical: String,
    /// What HAL knows it by.
    pub name: CString,
    /// Which way it goes.
    pub direction: Direction,
    /// The value.
    pub handle: Handle,
    /// The same, checked: of every number that comes from HAL.
    pub source: Option<Source>,
}

/// Everything exported for one board, by logical name, as the base of other drivers' names.
#[derive(Clone, Debug, Default)]
pub struct Catalogue(Vec<Exported>);

impl Catalogue {
    /// The pin or parameter of this logical name.
    pub fn find(&self, logical: &str) -> Option<&Exported> {
        self.0.iter().find(|exported| exported.logical == logical)
    }

    /// All of it.
    pub fn iter(&self) -> impl Iterator<Item = &Exported> {
        self.0.iter()
    }
}

/// Exports pins and parameters under one prefix.
pub struct Exporter<'b> {
    backend: &'b mut dyn Backend,
    catalogue: Option<&'b mut Catalogue>,
    prefix: String,
    /// The prefix for what would be too long under the usual one.
    short: Option<String>,
    logical: String,
    limit: usize,
}

impl<'b> Exporter<'b> {
    /// Everything will be called `prefix.something`.
    pub fn new(backend: &'b mut dyn Backend, prefix: impl Into<String>) -> Self {
        Exporter {
            backend,
            catalogue: None,
            prefix: prefix.into(),
            short: None,
            logical: String::new(),
            limit: HAL_NAME_MAX,
        }
    }

    /// Notes down everything exported.
    #[must_use]
    pub fn listed(mut self, catalogue: &'b mut Catalogue) -> Self {
        self.catalogue = Some(catalogue);
        self
    }

    /// Names may be as long as HAL allows: another driver chose them.
    #[must_use]
    pub fn with_foreign_names(mut self) -> Self {
        self.limit = ffi::HAL_NAME_LEN;
        self
    }

    /// The same one level down.
    pub fn under(&mut self, name: &str) -> Exporter<'_> {
        Exporter {
            backend: self.backend,
            catalogue: self.catalogue.as_deref_mut(),
            prefix: format!("{}.{name}", self.prefix),
            short: self.short.as_ref().map(|short| format!("{short}.{name}")),
            logical: format!("{}{name}.", self.logical),
            limit: self.limit,
        }
    }

    /// A channel: `class.name`, or `class.number` for a pin with a name that would be too long.
    pub fn channel(&mut self, class: &str, name: &str, number: usize) -> Exporter<'_> {
        Exporter {
            backend: self.backend,
            catalogue: self.catalogue.as_deref_mut(),
            prefix: format!("{}.{class}.{name}", self.prefix),
            short: Some(format!("{}.{class}.{number:02}", self.prefix)),
            logical: format!("{class}.{number}."),
            limit: self.limit,
        }
    }

    /// A pin we read. Numbers are [`Exporter::command`]s.
    pub fn input(&mut self, name: &str) -> Result<In<bool>, ExportError> {
        self.pin(name, Direction::In)
    }

    /// The same with another value to begin with than false.
    pub fn input_from(&mut self, name: &str, initial: bool) -> Result<In<bool>, ExportError> {
        let pin: In<bool> = self.pin(name, Direction::In)?;
        pin.store(initial);
        Ok(pin)
    }

    /// A pin we write.
    pub fn output<T: Value>(&mut self, name: &str) -> Result<Out<T>, ExportError> {
        self.pin(name, Direction::Out)
    }

    /// A pin both sides write, with the value it begins with. Numbers are
    /// [`Exporter::setting_pin`]s.
    pub fn both(&mut self, name: &str, initial: bool) -> Result<Io<bool>, ExportError> {
        let pin: Io<bool> = self.pin(name, Direction::Io)?;
        pin.set(initial);
        Ok(pin)
    }

    /// A parameter the user sets, with its default. Numbers are [`Exporter::setting`]s.
    pub fn param(&mut self, name: &str, initial: bool) -> Result<Param<bool>, ExportError> {
        self.parameter(name, Direction::ReadWrite, initial)
    }

    /// A parameter that is a number, with its default, which has to be a good one.
    pub fn setting<T: Number>(
        &mut self,
        name: &str,
        initial: T,
        rule: Rule,
    ) -> Result<Checked<T>, ExportError> {
        let direction = Direction::ReadWrite;
        self.checked(name, T::TYPE, direction, initial.number(), rule)
            .map(Checked::new)
    }

    /// The same as a pin.
    pub fn setting_pin<T: Number>(
        &mut self,
        name: &str,
        initial: T,
        rule: Rule,
    ) -> Result<Checked<T>, ExportError> {
        self.checked(name, T::TYPE, Direction::Io, initial.number(), rule)
            .map(Checked::new)
    }

    /// A pin that says where to go or how fast.
    pub fn command(&mut self, name: &str) -> Result<Checked<f64>, ExportError> {
        self.checked(name, Type::Float, Direction::In, 0.0, Rule::Command)
            .map(Checked::new)
    }

    /// A number that comes from HAL, of a type and direction known at run time only.
    pub fn checked(
        &mut self,
        name: &str,
        ty: Type,
        direction: Direction,
        initial: f64,
        rule: Rule,
    ) -> Result<Source, ExportError> {
        let handle = self.export(name, ty, direction, initial)?;
        let source = Source::new(handle, rule);
        if let Some(listed) = self.catalogue.as_mut().and_then(|all| all.0.last_mut()) {
            listed.source = Some(source.clone());
        }
        Ok(source)
    }

    /// A parameter only we set.
    pub fn readonly<T: Value>(&mut self, name: &str, initial: T) -> Result<Param<T>, ExportError> {
        self.parameter(name, Direction::ReadOnly, initial)
    }

    /// A pin or parameter of a type and direction known at run time only.
    pub fn export(
        &mut self,
        name: &str,
        ty: Type,
        direction: Direction,
        initial: f64,
    ) -> Result<Handle, ExportError> {
        let place = match (ty, direction) {
            (Type::Bit, Direction::ReadOnly | Direction::ReadWrite) => {
                self.param_place::<bool>(name, direction)?
            }
            (Type::Float, Direction::ReadOnly | Direction::ReadWrite) => {
                self.param_place::<f64>(name, direction)?
            }
            (Type::S32, Direction::ReadOnly | Direction::ReadWrite) => {
                self.param_place::<i32>(name, direction)?
            }
            (Type::U32, Direction::ReadOnly | Direction::ReadWrite) => {
                self.param_place::<u32>(name, direction)?
            }
            (ty, Direction::In | Direction::Out | Direction::Io) => {
                Place::Pin(self.slot(name, ty, direction)?)
            }
        };
        let handle = Handle { ty, place };
        handle.set(initial);
        Ok(handle)
    }

    /// Gives something exported a second name.
    pub fn alias(&mut self, exported: &Exported, name: &str) -> Result<(), ExportError> {
        let (text, alias) = self.full_name(name)?;
        let pin = matches!(exported.handle.place, Place::Pin(_));
        let result = self.backend.alias(&exported.name, &alias, pin);
        check(text, result)
    }

    /// Gives something that was exported here, and is listed, a second name.
    pub fn alias_own(&mut self, own: &str, name: &str) -> Result<(), ExportError> {
        let listed = self.catalogue.as_ref().and_then(|all| all.find(own));
        let exported = listed.cloned().ok_or_else(|| ExportError {
            name: own.to_owned(),
            errno: -libc::ENOENT,
        })?;
        self.alias(&exported, name)
    }

    fn pin<T: Value, D>(
        &mut self,
        name: &str,
        direction: Direction,
    ) -> Result<Pin<T, D>, ExportError> {
        Ok(Pin {
            slot: self.slot(name, T::TYPE, direction)?.cast(),
            direction: PhantomData,
        })
    }

    fn slot(
        &mut self,
        name: &str,
        ty: Type,
        direction: Direction,
    ) -> Result<NonNull<*mut c_void>, ExportError> {
        let (text, full) = self.full_name(name)?;
        let slot = self.memory::<*mut c_void>(&text)?;
        // SAFETY: `memory` asked the backend for a pointer's room.
        let result = unsafe { self.backend.pin(&full, ty, direction, slot.as_ptr()) };
        check(text, result)?;
        self.note(name, full, ty, direction, Place::Pin(slot));
        Ok(slot)
    }

    fn parameter<T: Value>(
        &mut self,
        name: &str,
        direction: Direction,
        initial: T,
    ) -> Result<Param<T>, ExportError> {
        let value = self.value::<T>(name, direction)?;
        let param = Param { value };
        param.set(initial);
        Ok(param)
    }

    fn param_place<T: Value>(
        &mut self,
        name: &str,
        direction: Direction,
    ) -> Result<Place, ExportError> {
        Ok(Place::Param(self.value::<T>(name, direction)?.cast()))
    }

    fn value<T: Value>(
        &mut self,
        name: &str,
        direction: Direction,
    ) -> Result<NonNull<T::Raw>, ExportError> {
        let (text, full) = self.full_name(name)?;
        let value = self.memory::<T::Raw>(&text)?;
        // SAFETY: `memory` asked the backend for a `T::Raw`'s room, which is `T::TYPE`'s.
        let result = unsafe {
            self.backend
                .param(&full, T::TYPE, direction, value.as_ptr().cast())
        };
        check(text, result)?;
        self.note(name, full, T::TYPE, direction, Place::Param(value.cast()));
        Ok(value)
    }

    fn note(&mut self, name: &str, full: CString, ty: Type, direction: Direction, place: Place) {
        if let Some(catalogue) = &mut self.catalogue {
            catalogue.0.push(Exported {
                logical: format!("{}{name}", self.logical),
                name: full,
                direction,
                handle: Handle { ty, place },
                source: None,
            });
        }
    }

    fn full_name(&self, name: &str) -> Result<(String, CString), ExportError> {
        let mut text = format!("{}.{name}", self.prefix);
        if text.len() > self.limit
            && let Some(short) = &self.short
        {
            text = format!("{short}.{name}");
        }
        let refused = |text: &str| ExportError {
            name: text.to_owned(),
            errno: -libc::ENAMETOOLONG,
        };
        if text.len() > self.limit {
            return Err(refused(&text));
        }
        let name = CString::new(text.as_str()).map_err(|_| refused(&text))?;
        Ok((text, name))
    }

    fn memory<T>(&mut self, name: &str) -> Result<NonNull<T>, ExportError> {
        let memory = self.backend.allocate(size_of::<T>());
        memory.map(NonNull::cast).ok_or_else(|| ExportError {
            name: name.to_owned(),
            errno: -libc::ENOMEM,
        })
    }
}

fn check(name: String, result: i32) -> Result<(), ExportError> {
    if result < 0 {
        return Err(ExportError {
            name,
            errno: result,
        });
    }
    Ok(())
}

/// A line of text on the stack, for messages from the servo thread. What does not fit is left out.
pub struct MessageLine {
    bytes: [u8; 256],
    used: usize,
}

impl MessageLine {
    /// Formats a message.
    pub fn format(arguments: core::fmt::Arguments<'_>) -> Self {
        let mut line = MessageLine {
            bytes: [0; 256],
            used: 0,
        };
        // `write_str` below never fails; what is cut is cut.
        let _ = core::fmt::write(&mut line, arguments);
        line
    }

    /// As a C string.
    pub fn as_c_str(&self) -> &CStr {
        CStr::from_bytes_until_nul(&self.bytes).unwrap_or(c"")
    }
}

impl core::fmt::Write for MessageLine {
    fn write_str(&mut self, text: &str) -> core::fmt::Result {
        // The last byte stays 0.
        let room = self.bytes.len() - 1 - self.used;
        let taken = text.len().min(room);
        self.bytes[self.used..self.used + taken].copy_from_slice(&text.as_bytes()[..taken]);
        self.used += taken;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use fake::FakeHal;

    #[test]
    fn a_name_beyond_41_characters_is_refused_before_hal_sees_it() {
        let mut hal = FakeHal::new();
        let mut exporter = Exporter::new(&mut hal, "ferrocnc.0");
        let refused = exporter
            .output::<bool>("stepgen.a-name-much-too-long-for-a-channel.position-fb")
            .unwrap_err();
        assert_eq!(refused.errno, -libc::ENAMETOOLONG);
    }

    #[test]
    fn a_pin_too_long_for_its_channels_name_goes_by_its_number() {
        let mut hal = FakeHal::new();
        let mut catalogue = Catalogue::default();
        let mut exporter = Exporter::new(&mut hal, "ferrocnc.0").listed(&mut catalogue);
        let mut channel = exporter.channel("encoder", "spindle", 5);
        let _: Out<f64> = channel.output("position").unwrap();
        let _: Out<f64> = channel.output("position-latched").unwrap();
        let name = |logical: &str| catalogue.find(logical).unwrap().name.clone();
        assert_eq!(
            name("encoder.5.position").to_str(),
            Ok("ferrocnc.0.encoder.spindle.position")
        );
        assert_eq!(
            name("encoder.5.position-latched").to_str(),
            Ok("ferrocnc.0.encoder.05.position-latched")
        );
    }

    #[test]
    fn an_alias_is_the_same_pin() {
        let mut hal = FakeHal::new();
        let mut catalogue = Catalogue::default();
        let mut exporter = Exporter::new(&mut hal, "ferrocnc.0").listed(&mut catalogue);
        let pin = exporter.command("velocity-cmd").unwrap();
        let exported = catalogue.find("velocity-cmd").unwrap();
        let mut theirs = Exporter::new(&mut hal, "Lcnc.00");
        theirs.alias(exported, "vel-cmd").unwrap();
        hal.set("Lcnc.00.vel-cmd", 2.5);
        assert_eq!(pin.get(), 2.5);
        assert_eq!(hal.get::<f64>("ferrocnc.0.velocity-cmd"), 2.5);
    }

    #[test]
    fn any_byte_but_zero_is_true() {
        assert!(bool::from_raw(0x80) && !bool::from_raw(0));
    }

    #[test]
    fn a_pin_follows_hal_when_it_is_linked_to_a_signal() {
        let mut hal = FakeHal::new();
        let pin = Exporter::new(&mut hal, "x").command("y").unwrap();
        hal.relink("x.y");
        hal.set("x.y", 2.5);
        assert_eq!(pin.get(), 2.5);
    }

    #[test]
    fn a_line_that_is_too_long_is_cut_not_overrun() {
        let line = MessageLine::format(format_args!("{:>500}", 1));
        assert_eq!(line.as_c_str().to_bytes().len(), 255);
    }
}
