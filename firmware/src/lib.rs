//! The firmware's logic, without access to the hardware.
//!
//! The code here decides and moves words. It contains no addresses of the chip, never waits, and
//! never reads a clock. It reaches the board through [`cores::Board`], time is an argument, frames
//! are words. So it runs on a PC, where the tests are, and on the softcore, where `src/bin` gives
//! it registers.
//!
//! ```text
//!   bytes --> machine --+
//!                       |
//!   frame words --> net ----> exchange (hot) ---------+
//!                    |                                |--> cores::Board --> registers
//!                    +--> server (everything else) ---+
//!                            |      |       |
//!                         session  safety  config, describe, log, postmortem, service
//! ```
//!
//! | module | what it does and refuses |
//! |---|---|
//! | [`machine`] | combines the modules below, for the image and the simulator |
//! | [`cores`] | the board as the lib sees it: a trait |
//! | [`net`] | recognises plain UDP to us and checks it; leaves everything else to the services |
//! | [`server`] | Etherbone: checks a whole datagram, then executes all of it or nothing |
//! | [`block`] | the words of an exchange and how many there are on this board |
//! | [`exchange`] | the servo-period datagram: judge, stage, commit, sample, answer |
//! | [`pass`] | the next exchange, judged before it comes: the gateware executes it |
//! | [`session`] | which host owns the motion |
//! | [`auth`] | the pre-shared key: challenges, and judging the answers |
//! | [`safety`] | the state machine: when outputs may be live |
//! | [`config`] | which settings exist, their ranges, and which may change while armed |
//! | [`describe`] | how the board says what it is |
//! | [`service`] | which raw registers may be touched |
//! | [`flash`] | the SPI flash: one operation at a time, never blocking; golden and the slot in use cannot be written |
//! | [`nor`] | the commands of the flash chip |
//! | [`images`] | which slot loads, and how that changes one byte at a time |
//! | [`pins`] | puts the configuration of the pins into force, or none |
//! | [`settings`] | the two copies of what a board keeps over a power cycle |
//! | [`discovery`] | lets hosts find the board and set its settings, whatever its address |
//! | [`reserve`] | ARP and ping where there are no services |
//! | [`services`] | TCP/IP, consoles and jobs, in a separate program; if it fails, the machine goes on |
//! | [`link`] | up or down, speed, errors |
//! | `path_stop` | decelerations that keep the axes on their line when no commands come any more |
//! | [`log`] | the ring `ferrocnc log` reads |
//! | [`postmortem`] | what survives a panic |
//! | [`text`] | text in pieces, without `core::fmt` |
#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]

pub mod auth;
pub mod block;
pub mod config;
pub mod cores;
pub mod describe;
pub mod discovery;
pub mod exchange;
pub mod flash;
pub mod gate;
pub mod images;
pub mod link;
pub mod log;
pub mod machine;
pub mod net;
pub mod nor;
pub mod pass;
pub(crate) mod path_stop;
pub mod pins;
pub mod postmortem;
pub mod reserve;
pub mod safety;
pub mod server;
pub mod service;
pub mod services;
pub mod session;
pub mod settings;
pub mod text;

#[cfg(test)]
mod fake;

/// Major << 16 | minor << 8 | patch of this crate.
pub const VERSION: u32 = version(env!("CARGO_PKG_VERSION"));

/// "1.2.3" as a word. A version that does not consist of three small numbers does not compile.
const fn version(text: &str) -> u32 {
    let bytes = text.as_bytes();
    let (mut word, mut part, mut at) = (0u32, 0u32, 0);
    while at < bytes.len() {
        match bytes[at] {
            b'.' => {
                word = word << 8 | part;
                part = 0;
            }
            digit => {
                assert!(digit.is_ascii_digit());
                part = part * 10 + (digit - b'0') as u32;
                assert!(part < 256);
            }
        }
        at += 1;
    }
    word << 8 | part
}

const _: () = assert!(version("1.2.3") == 0x01_02_03);
