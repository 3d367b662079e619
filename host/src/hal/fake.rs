//! A HAL in a `Vec`: for tests, and for looking at what a board would export.

use super::{Backend, Direction, Level, Messenger, Type, Value};
use core::ffi::{CStr, c_void};
use core::ptr::NonNull;
use std::sync::{Arc, Mutex};

/// One exported pin or parameter.
struct Entry {
    name: String,
    alias: Option<String>,
    ty: Type,
    direction: Direction,
    /// Where our side looks for the pointer; null for a parameter.
    slot: *mut *mut c_void,
    value: *mut c_void,
}

impl Entry {
    fn is(&self, name: &str) -> bool {
        self.name == name || self.alias.as_deref() == Some(name)
    }
}

/// The fake.
#[derive(Default)]
pub struct FakeHal {
    entries: Vec<Entry>,
    /// Never moved: pins point into the boxes.
    memory: Vec<Box<[u64]>>,
    said: Arc<Mutex<Vec<String>>>,
}

// SAFETY: the pointers go to heap memory this value owns; accesses are volatile on both sides.
unsafe impl Send for FakeHal {}

impl FakeHal {
    /// An empty HAL.
    pub fn new() -> Self {
        Self::default()
    }

    /// Names with type and direction, in order of export.
    pub fn list(&self) -> impl Iterator<Item = (&str, Type, Direction)> {
        self.entries
            .iter()
            .map(|entry| (entry.name.as_str(), entry.ty, entry.direction))
    }

    /// Second names with type and direction.
    pub fn aliases(&self) -> impl Iterator<Item = (&str, Type, Direction)> {
        self.entries
            .iter()
            .filter_map(|entry| Some((entry.alias.as_deref()?, entry.ty, entry.direction)))
    }

    /// The value of a pin or parameter.
    ///
    /// # Panics
    /// If there is no pin or parameter of that name and type.
    #[track_caller]
    pub fn get<T: Value>(&self, name: &str) -> T {
        let value = self.find(name, T::TYPE).value;
        // SAFETY: `value` points into `memory` at a value of this type.
        unsafe { T::from_raw(value.cast::<T::Raw>().read_volatile()) }
    }

    /// Sets a pin or parameter, as `setp` or a signal would.
    ///
    /// # Panics
    /// As [`FakeHal::get`].
    #[track_caller]
    pub fn set<T: Value>(&self, name: &str, value: T) {
        let at = self.find(name, T::TYPE).value;
        // SAFETY: as in `get`.
        unsafe { at.cast::<T::Raw>().write_volatile(value.to_raw()) }
    }

    /// Moves a pin's value elsewhere, as linking it to a signal does.
    ///
    /// # Panics
    /// When there is no such pin.
    pub fn relink(&mut self, name: &str) {
        let fresh = self.cell();
        let entry = self
            .entries
            .iter_mut()
            .find(|entry| entry.is(name) && !entry.slot.is_null())
            .expect("no such pin");
        entry.value = fresh;
        // SAFETY: the slot lies in `memory`.
        unsafe { entry.slot.write_volatile(fresh) };
    }

    /// A messenger; [`FakeHal::said`] returns its messages.
    pub fn messenger(&self) -> Messenger {
        let said = Arc::clone(&self.said);
        Box::new(move |level, text| {
            let text = text.to_string_lossy();
            if let Ok(mut said) = said.lock() {
                said.push(match level {
                    Level::Error => format!("error: {text}"),
                    Level::Info => format!("info: {text}"),
                });
            }
        })
    }

    /// Every alias, with the name of what it belongs to.
    pub fn aliases_of(&self) -> impl Iterator<Item = (&str, &str)> {
        let entries = self.entries.iter();
        entries.filter_map(|entry| Some((entry.alias.as_deref()?, entry.name.as_str())))
    }

    /// Takes everything said since the last call.
    pub fn said(&self) -> Vec<String> {
        self.said
            .lock()
            .map(|mut said| core::mem::take(&mut *said))
            .unwrap_or_default()
    }

    #[track_caller]
    fn find(&self, name: &str, ty: Type) -> &Entry {
        let entry = self.entries.iter().find(|entry| entry.is(name));
        let entry = entry.unwrap_or_else(|| panic!("nothing is called {name}"));
        assert_eq!(entry.ty, ty, "the type of {name}");
        entry
    }

    fn cell(&mut self) -> *mut c_void {
        self.memory.push(vec![0; 1].into_boxed_slice());
        let cell = self.memory.last_mut().expect("just pushed");
        cell.as_mut_ptr().cast()
    }

    fn add(&mut self, entry: Entry) -> i32 {
        if self.entries.iter().any(|known| known.is(&entry.name)) {
            return -libc::EINVAL;
        }
        self.entries.push(entry);
        0
    }
}

impl Backend for FakeHal {
    fn allocate(&mut self, bytes: usize) -> Option<NonNull<u8>> {
        self.memory
            .push(vec![0; bytes.div_ceil(8).max(1)].into_boxed_slice());
        NonNull::new(self.memory.last_mut()?.as_mut_ptr().cast())
    }

    unsafe fn pin(
        &mut self,
        name: &CStr,
        ty: Type,
        direction: Direction,
        slot: *mut *mut c_void,
    ) -> i32 {
        let value = self.cell();
        // SAFETY: the caller's promise: `slot` came from `allocate`.
        unsafe { slot.write_volatile(value) };
        self.add(Entry {
            name: name.to_string_lossy().into_owned(),
            alias: None,
            ty,
            direction,
            slot,
            value,
        })
    }

    unsafe fn param(
        &mut self,
        name: &CStr,
        ty: Type,
        direction: Direction,
        value: *mut c_void,
    ) -> i32 {
        self.add(Entry {
            name: name.to_string_lossy().into_owned(),
            alias: None,
            ty,
            direction,
            slot: core::ptr::null_mut(),
            value,
        })
    }

    fn alias(&mut self, name: &CStr, alias: &CStr, pin: bool) -> i32 {
        let (name, alias) = (name.to_string_lossy(), alias.to_string_lossy());
        if self.entries.iter().any(|known| known.is(&alias)) {
            return -libc::EINVAL;
        }
        let entry = self
            .entries
            .iter_mut()
            .find(|entry| entry.is(&name) && entry.slot.is_null() != pin);
        match entry {
            // As in HAL: one alias each.
            Some(entry) if entry.alias.is_none() => {
                entry.alias = Some(alias.into_owned());
                0
            }
            Some(_) | None => -libc::EINVAL,
        }
    }
}
