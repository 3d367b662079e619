//! The services on a PC: frames in, frames out, and a clock that the test moves.
//!
//! | module | what it shows |
//! |---|---|
//! | [`rig`] | the board: the program, over a server with a fake board below it |
//! | [`host`] | a host that sends what a test tells it to, segment by segment |
//! | [`wire`] | smoltcp at the other end, over a wire that loses, doubles and reorders frames |
//! | [`forged`] | segments of strangers: resets, acknowledgements, handshakes, fragments |
//! | [`ends`] | how connections end, and when their places are free again |
//! | [`day`] | 24 hours of clients that die, return, hang up and lie |
//! | [`kinds`] | 24 hours of six ways to leave a console without a word, each with its limit |
//! | [`status`] | the status page, and datagrams of names |
//! | [`servers`] | a server of syslog and one of the time: what they hear, and what comes of it |

mod rig;

mod day;
mod ends;
mod forged;
mod host;
mod kinds;
mod servers;
mod status;
mod wire;
