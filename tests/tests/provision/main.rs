//! A board's flash under the firmware: settings, images, discovery, with power lost at every step
//! of them.
//!
//! The firmware's library runs on the twin; its flash is the behavioural NOR, which can lose power
//! in any byte of a program and any part of an erase. A model of an ECP5 at power-up decides what
//! runs after that. So each test here is of the form "prepare, cut the power at step n, look", for
//! every n, or for thousands drawn from a printed seed.

mod description;
mod images;
mod refusals;
mod rig;
mod settings;
