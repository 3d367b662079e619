//! Exclusive access to a board: for one realtime thread, or for the thread that unloads the module.
//!
//! HAL calls a board's functions from the threads they were added to, possibly two. `unloadrt`
//! calls `rtapi_app_exit` from a third while those run on. So every access to a driver goes through
//! a [`Turn`]. A realtime thread never waits: it is let in, or turned away because another one is
//! inside or because the board is being unloaded. The unloading thread shuts the turn, waits for
//! the one inside to leave, and has the driver for itself from then on.
//!
//! ```text
//!            let in            leaves
//!   IDLE  ----------->  BUSY  -------->  IDLE
//!     | shut              | shut
//!     v                   v      leaves
//!   SHUT              BUSY|SHUT ------>  SHUT     no thread is let in again
//! ```
//!
//! `tests/turn.rs` runs this file, as it stands, through every order in which its accesses can
//! happen.

use crate::sync::{AtomicU32, Ordering, UnsafeCell};

/// No thread is inside, and the next one is let in.
const IDLE: u32 = 0;
/// A thread is inside.
const BUSY: u32 = 1;
/// No thread is let in again.
const SHUT: u32 = 2;

/// Something that one thread at a time may use, until it is taken away.
#[derive(Debug)]
pub struct Turn<T> {
    state: AtomicU32,
    /// Calls turned away because another thread was inside.
    collisions: AtomicU32,
    /// Calls turned away because the turn was shut.
    late: AtomicU32,
    inside: UnsafeCell<T>,
}

// SAFETY: `inside` is reached by the one thread that set BUSY, or by the one that set SHUT after
// BUSY was gone; both edges are acquire and release, so each sees what the one before it did.
unsafe impl<T: Send> Sync for Turn<T> {}

/// Gives the turn back, also when what was done with it panics.
struct Leave<'t>(&'t AtomicU32);

impl Drop for Leave<'_> {
    fn drop(&mut self) {
        self.0.fetch_and(!BUSY, Ordering::Release);
    }
}

impl<T> Turn<T> {
    /// No thread's turn yet.
    pub fn new(inside: T) -> Self {
        Turn {
            state: AtomicU32::new(IDLE),
            collisions: AtomicU32::new(0),
            late: AtomicU32::new(0),
            inside: UnsafeCell::new(inside),
        }
    }

    /// Does something if it is our turn, and does not wait until it is.
    pub fn take<R>(&self, work: impl FnOnce(&mut T) -> R) -> Option<R> {
        let state = &self.state;
        match state.compare_exchange(IDLE, BUSY, Ordering::Acquire, Ordering::Relaxed) {
            Ok(_) => {}
            Err(now) if now & SHUT != 0 => {
                self.late.fetch_add(1, Ordering::Relaxed);
                return None;
            }
            Err(_) => {
                self.collisions.fetch_add(1, Ordering::Relaxed);
                return None;
            }
        }
        let leave = Leave(state);
        // SAFETY: we set BUSY, so no other thread is in here until `leave` is dropped.
        let done = self.inside.with_mut(|inside| work(unsafe { &mut *inside }));
        drop(leave);
        Some(done)
    }

    /// Shuts the turn and waits for the thread inside; `wait` is called between two looks and gives
    /// up by returning false. `None`: it gave up, or another thread has shut it.
    pub fn shut<R>(
        &self,
        mut wait: impl FnMut() -> bool,
        work: impl FnOnce(&mut T) -> R,
    ) -> Option<R> {
        if self.state.fetch_or(SHUT, Ordering::Relaxed) & SHUT != 0 {
            return None;
        }
        while self.state.load(Ordering::Acquire) & BUSY != 0 {
            if !wait() {
                return None;
            }
        }
        // SAFETY: no thread is inside and none is let in any more, and only one call comes this
        // far.
        Some(self.inside.with_mut(|inside| work(unsafe { &mut *inside })))
    }

    /// Calls turned away so far because another thread was inside.
    pub fn collisions(&self) -> u32 {
        self.collisions.load(Ordering::Relaxed)
    }

    /// Calls turned away so far because the turn was shut.
    pub fn late(&self) -> u32 {
        self.late.load(Ordering::Relaxed)
    }
}
