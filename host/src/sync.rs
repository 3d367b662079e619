//! The atomics and cells of [`crate::turn`]. The model in `tests/turn.rs` puts loom's in its place.

pub use core::sync::atomic::{AtomicU32, Ordering};

/// A cell as loom has it: the address is lent, not given.
#[derive(Debug)]
pub struct UnsafeCell<T>(core::cell::UnsafeCell<T>);

impl<T> UnsafeCell<T> {
    /// Around this.
    pub fn new(inside: T) -> Self {
        UnsafeCell(core::cell::UnsafeCell::new(inside))
    }

    /// Lends the address; the caller knows that no other thread has it.
    pub fn with_mut<R>(&self, work: impl FnOnce(*mut T) -> R) -> R {
        work(self.0.get())
    }
}
