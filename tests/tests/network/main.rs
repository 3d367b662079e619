//! Real clients at the board's own IP stack: telnet, curl, ping, dnsmasq and avahi in network
//! namespaces, on an Ethernet segment that a simulated board is plugged into with its frames
//! ([`sim::tap`]). tcpdump listens.
//!
//! ```text
//!   host: eth0 --- bridge --- tap: ferrocnc-sim, firmware::net and firmware::services
//! ```
//!
//! The twin runs the firmware's library in real time or faster. The Verilated board runs the
//! release image, most of a hundred times slower than real time: all of this computer's times are
//! long, and the board's are as they are.

mod clients;
mod leases;
mod rig;
