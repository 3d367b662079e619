//! Gives a port of this computer to the board, so that it lasts, and takes it back.
//!
//! ```text
//!   System -- read --> Facts -- plan --> Plan -- carry out --> the computer
//!                                          |
//!                                        Record -- undo ----> the computer as it was
//! ```
//!
//! A port that is set up has an address in the board's net and no other, never the default route,
//! no IPv6 and no coalescing. The board's hardware address is known to the kernel, and an egress
//! rule keeps what is not for boards off the line. A profile of NetworkManager says so, or a file
//! in `/etc/network/interfaces.d` where NetworkManager does not run.
//!
//! [`plan`] decides everything and does nothing; [`act`] does it and decides nothing. What undoes
//! the plan is written down before its first step. Only files with a name of our own are written.
//! A port that others use or set up is refused.
//!
//! | module | |
//! |---|---|
//! | [`facts`] | what the plan depends on, and where that is read |
//! | [`paths`] | where our files are |
//! | [`files`] | what is in them |
//! | [`plan`] | the steps, and why a port is refused |
//! | [`record`] | what undoes them, as a file |
//! | [`act`] | writes files and runs programs |

pub mod act;
pub mod facts;
pub mod files;
pub mod paths;
pub mod plan;
pub mod record;

#[cfg(test)]
mod tests;
