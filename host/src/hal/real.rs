//! The HAL of the process we are loaded into.

use super::ffi::Api;
use super::{Backend, Direction, ExportError, Level, Messenger, Type};
use core::ffi::{CStr, c_long, c_void};
use core::ptr::NonNull;

/// A component in LinuxCNC's HAL. Leaving the scope removes it with everything it exported.
pub struct Component {
    api: Api,
    id: i32,
}

impl Component {
    /// Registers a component. The name must be the module's file name, or `loadrt` waits for ever.
    pub fn new(api: Api, name: &CStr) -> Result<Self, i32> {
        // SAFETY: `name` is a C string; called from `rtapi_app_main`.
        let id = unsafe { (api.hal_init)(name.as_ptr()) };
        if id < 0 {
            return Err(id);
        }
        Ok(Component { api, id })
    }

    /// Exports a realtime function.
    ///
    /// # Safety
    /// `argument` must be what `function` expects and live until the component is dropped.
    pub unsafe fn function(
        &self,
        name: &CStr,
        function: super::ffi::Funct,
        argument: *mut c_void,
    ) -> Result<(), ExportError> {
        // SAFETY: the caller's promise; `name` is a C string HAL copies.
        let errno = unsafe {
            (self.api.hal_export_funct)(name.as_ptr(), function, argument, 1, 0, self.id)
        };
        super::check(name.to_string_lossy().into_owned(), errno)
    }

    /// Everything is exported.
    pub fn ready(&self) -> Result<(), i32> {
        // SAFETY: `id` came from `hal_init`.
        match unsafe { (self.api.hal_ready)(self.id) } {
            errno if errno < 0 => Err(errno),
            _ => Ok(()),
        }
    }
}

impl Drop for Component {
    fn drop(&mut self) {
        // SAFETY: `id` came from `hal_init` and is given back once.
        unsafe { (self.api.hal_exit)(self.id) };
    }
}

impl Backend for Component {
    fn allocate(&mut self, bytes: usize) -> Option<NonNull<u8>> {
        let bytes = bytes.next_multiple_of(8);
        // SAFETY: any size is fine; the result is checked.
        let memory = NonNull::new(unsafe { (self.api.hal_malloc)(bytes as c_long) }.cast::<u8>())?;
        // SAFETY: `hal_malloc` gave us that many bytes.
        unsafe { memory.as_ptr().write_bytes(0, bytes) };
        Some(memory)
    }

    unsafe fn pin(
        &mut self,
        name: &CStr,
        ty: Type,
        direction: Direction,
        slot: *mut *mut c_void,
    ) -> i32 {
        // SAFETY: the caller's promise: `slot` lies in `hal_malloc` memory, zeroed, as HAL insists.
        unsafe { (self.api.hal_pin_new)(name.as_ptr(), ty as i32, direction as i32, slot, self.id) }
    }

    unsafe fn param(
        &mut self,
        name: &CStr,
        ty: Type,
        direction: Direction,
        value: *mut c_void,
    ) -> i32 {
        // SAFETY: the caller's promise: `value` lies in `hal_malloc` memory of that type's size.
        unsafe {
            (self.api.hal_param_new)(name.as_ptr(), ty as i32, direction as i32, value, self.id)
        }
    }

    fn alias(&mut self, name: &CStr, alias: &CStr, pin: bool) -> i32 {
        let give = if pin {
            self.api.hal_pin_alias
        } else {
            self.api.hal_param_alias
        };
        // SAFETY: two C strings HAL copies.
        unsafe { give(name.as_ptr(), alias.as_ptr()) }
    }
}

/// Prints through RTAPI: lock-free from the servo thread, and on the operator's screen when
/// LinuxCNC runs.
pub fn print(api: &Api, level: Level, text: &CStr) {
    // SAFETY: the format takes one string, and gets one.
    unsafe { (api.rtapi_print_msg)(level as i32, c"ferrocnc: %s\n".as_ptr(), text.as_ptr()) };
}

/// [`print()`] as a [`Messenger`].
pub fn messenger(api: Api) -> Messenger {
    Box::new(move |level, text| print(&api, level, text))
}
