//! Hand-written bindings for the part of `hal.h` and `rtapi.h` that a driver needs.
//!
//! Nothing is linked. LinuxCNC loads `hal_lib.so` globally and exports `rtapi_*` from `rtapi_app`
//! before it loads us, so [`Api::load`] asks the dynamic linker once, at load time. The tool and
//! the tests contain the same code and link everywhere; only calling [`Api::load`] outside
//! `rtapi_app` fails, with the name of what is missing. `host/abi/abi.c` checks types and constants
//! against the real headers.

use core::ffi::{CStr, c_char, c_int, c_long, c_void};

pub use wire::board::HAL_NAME_LEN;

/// A realtime function as HAL calls it.
pub type Funct = unsafe extern "C" fn(argument: *mut c_void, period_ns: c_long);

macro_rules! api {
    ($($(#[doc = $doc:literal])+ $name:ident: fn($($argument:ty),* $(; $variadic:tt)?) $(-> $result:ty)?;)+) => {
        /// HAL's and RTAPI's functions.
        #[derive(Clone, Copy)]
        pub struct Api { $($(#[doc = $doc])+ pub $name: unsafe extern "C" fn($($argument),* $(, $variadic)?) $(-> $result)?,)+ }

        impl Api {
            /// Finds them in the running process; the error is the name that is missing.
            pub fn load() -> Result<Api, &'static CStr> {
                $(
                    // A literal with its terminator, so that `dlsym` can take it as it is.
                    let name = const {
                        match CStr::from_bytes_with_nul(concat!(stringify!($name), "\0").as_bytes()) {
                            Ok(name) => name,
                            Err(_) => panic!("a name without a NUL inside"),
                        }
                    };
                    // SAFETY: `name` is a C string; RTLD_DEFAULT needs no handle.
                    let $name = unsafe { libc::dlsym(libc::RTLD_DEFAULT, name.as_ptr()) };
                    if $name.is_null() {
                        return Err(name);
                    }
                )+
                Ok(Api {
                    // SAFETY: the symbols are LinuxCNC's, and `host/abi/abi.c` assigns each of them
                    // to a pointer of exactly this type.
                    $($name: unsafe { core::mem::transmute::<*mut c_void, unsafe extern "C" fn($($argument),* $(, $variadic)?) $(-> $result)?>($name) },)+
                })
            }
        }
    };
}

api! {
    /// Registers a component; its id, or a negative errno.
    hal_init: fn(*const c_char) -> c_int;
    /// Removes a component with all its pins, parameters and functions.
    hal_exit: fn(c_int) -> c_int;
    /// Says that everything is exported.
    hal_ready: fn(c_int) -> c_int;
    /// Memory every HAL process sees; never freed.
    hal_malloc: fn(c_long) -> *mut c_void;
    /// New pin: name, type, direction, where HAL keeps the pointer to the value, component.
    hal_pin_new: fn(*const c_char, c_int, c_int, *mut *mut c_void, c_int) -> c_int;
    /// New parameter: name, type, direction, the value itself, component.
    hal_param_new: fn(*const c_char, c_int, c_int, *mut c_void, c_int) -> c_int;
    /// Second name for a pin: its name, the other one.
    hal_pin_alias: fn(*const c_char, *const c_char) -> c_int;
    /// Second name for a parameter.
    hal_param_alias: fn(*const c_char, *const c_char) -> c_int;
    /// New realtime function: name, function, argument, uses floating point, reentrant, component.
    hal_export_funct: fn(*const c_char, Funct, *mut c_void, c_int, c_int, c_int) -> c_int;
    /// Message to the log, and under LinuxCNC to the operator; lock-free from realtime threads.
    rtapi_print_msg: fn(c_int, *const c_char; ...);
}
