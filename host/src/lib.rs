//! FerroCNC on the host.
//!
//! Built as a `cdylib` this crate is the realtime module `ferrocnc.so` that `loadrt ferrocnc
//! boards=192.168.2.50` loads into LinuxCNC. Built as an `rlib` it is everything the tool and the
//! tests need. Neither needs LinuxCNC to build or link.
//!
//! Feature `tool`, on unless it is turned off, has the tool's modules, from [`image`] to [`job`] in
//! this table. The realtime module uses none of them.
//!
//! | module | what it is for |
//! |---|---|
//! | [`module`] | what `loadrt` finds: parameters, entry points |
//! | [`turn`] | exclusive access to a board: one realtime thread at a time, and then `unloadrt` |
//! | [`fence`] | a panic stops the machine, not the process |
//! | [`driver`] | one board in the servo thread: read, write, session, state; the timing model |
//! | [`blocks`] | one function block each: pins, units, policy; also the list of pins |
//! | [`names`] | other drivers' names for the same pins |
//! | [`clock`] | the time of a board's clock; one moment for several boards |
//! | [`group`] | a stop of one of several boards stops all |
//! | [`settings`] | parameters on their way to the board |
//! | [`link`] | the socket in the servo thread |
//! | [`client`] | the socket everywhere else: blocking requests, board identity, session |
//! | [`address`] | `IP[:port]` |
//! | [`replace`] | files that are written whole or not at all |
//! | [`image`] | a bitstream file: what it is for, whether it is whole |
//! | [`flash`] | the board's flash over the network |
//! | [`discovery`] | finding boards with any address |
//! | [`provision`] | giving boards new settings |
//! | [`update`] | a new image over the network |
//! | [`flash_file`] | a whole flash image, before it is written by JTAG |
//! | [`jtag`] | runs openFPGALoader |
//! | [`doctor`] | what of this computer makes exchanges late or lost, with remedies |
//! | [`net`] | a port of this computer, given to the board and taken back |
//! | [`panel`] | panels for LinuxCNC's screens that say what is wrong |
//! | [`selftest`] | tests of a new board and its wiring, with remedies |
//! | [`tryout`] | one output, axis or encoder at a time, by hand |
//! | [`finding`] | what those two found, as text and JSON |
//! | [`job`] | drawings and programs become jobs, are drawn and checked |
//! | [`histogram`] | how often an exchange took how long, in bounded time |
//! | [`fault`] | what can be wrong with a board, its number, its words, its remedy |
//! | [`hal`] | typed pins, the real HAL, a HAL in a `Vec` |
//!
//! # Pins of a board
//!
//! Functions `ferrocnc.<n>.read` and `ferrocnc.<n>.write`: `read` first and `write` last in the
//! servo thread. `ferrocnc.<n>.read-request`, optional and before every `read`: feedback from the
//! beginning of the period instead of the end of the last, for one more datagram each way.
//! Board-wide, as `ferrocnc.<n>.<name>`:
//!
//! | name | | |
//! |---|---|---|
//! | `enable` | bit in | the machine may move; falling stops it softly |
//! | `enable-request` | bit in | a rising edge arms, if `enable` is true and no obstacle is left |
//! | `enabled` | bit out | armed, outputs live; for the E-stop chain |
//! | `state` | u32 out | [`wire::State`]: 0 boot, 1 disarmed, 2 armed, 3 stopping, 4 faulted |
//! | `fault-reason` | u32 out | [`wire::FaultReason`]: why it stopped last; 100 + n: because board n did |
//! | `fault-code` | u32 out | [`fault::Fault`]: what the operator was told last, or why it stopped |
//! | `position-trusted` | bit out | no pulse was cut off since it was armed, and the board answers |
//! | `estop` | bit out | an e-stop input has tripped; latched until armed again |
//! | `refused-total` | u32 out | datagrams the board refused since it started |
//! | `last-reset-reason` | u32 out | [`wire::ResetReason`]: why the firmware started last |
//! | `last-gate-close` | u32 out | [`wire::GateClose`]: why the gateware closed the outputs last |
//! | `services` | u32 out | [`wire::describe::JobsState`]: what became of the board's services; 1: they run |
//! | `io-error` | bit param | the board was given up, or the driver halted; cleared by arming or by hand |
//! | `stop-group` | bit param | what stops another board stops this one, and the other way round |
//! | `probe-input` | s32 param | which input trips the probe latches; -1 for none |
//! | `probe-invert` | bit param | it is active low |
//! | `apply-delay-ns` | u32 param | commands take effect this long after `write`, on all boards at once; 0: on arrival |
//!
//! then [`blocks::packets`], [`blocks::watchdog`], [`blocks::wallclock`], [`blocks::ethernet`],
//! [`blocks::ways`], [`blocks::exchange`], and per channel [`blocks::stepgen`],
//! [`blocks::encoder`], [`blocks::pwm`], [`blocks::gpio`], with the board's own name for the
//! channel where it has one and two digits where not. If a pin's name would be longer than 41
//! characters, it has its channel's two digits instead: `encoder.05.position-latched` of the
//! encoder `spindle`. `docs/pins.md` has them all in one table, beside what other drivers call
//! them.
#![deny(unsafe_op_in_unsafe_fn)]

pub mod address;
pub mod blocks;
pub mod client;
pub mod clock;
#[cfg(feature = "tool")]
pub mod discovery;
#[cfg(feature = "tool")]
pub mod doctor;
pub mod driver;
pub mod fault;
pub mod fence;
#[cfg(feature = "tool")]
pub mod finding;
#[cfg(feature = "tool")]
pub mod flash;
#[cfg(feature = "tool")]
pub mod flash_file;
pub mod glue;
pub mod group;
pub mod hal;
pub mod histogram;
#[cfg(feature = "tool")]
pub mod image;
#[cfg(feature = "tool")]
pub mod job;
#[cfg(feature = "tool")]
pub mod jtag;
pub mod keys;
pub mod link;
pub mod mdns;
pub mod module;
pub mod names;
#[cfg(feature = "tool")]
pub mod net;
#[cfg(feature = "tool")]
pub mod panel;
#[cfg(feature = "tool")]
pub mod pins;
#[cfg(feature = "tool")]
pub mod provision;
pub mod replace;
#[cfg(feature = "tool")]
pub mod selftest;
pub mod settings;
pub mod sync;
#[cfg(feature = "tool")]
pub mod tryout;
pub mod turn;
pub mod uid;
#[cfg(feature = "tool")]
pub mod update;
