//! What the server serves: a board with its clock, its sockets and its faults.

use std::net::Ipv4Addr;
use std::time::Duration;

use crate::board::Clockwork;
use crate::environment::PinEnvironment;
use crate::exchange::{Meter, wants_reply};
use crate::faults::{Plan, Script};
use crate::lan_segment::{BOARD_PORT, Connection, HOST_IP};
use crate::report::{FrameCounts, Report};
use crate::rig::Rig;
use crate::soc::Silicon;

/// The service of the board that a datagram is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Service {
    /// The Etherbone server.
    Etherbone,
    /// Discovery, by broadcast.
    Discovery,
    /// The DHCP client. Only a board that is an interface has one.
    Dhcp,
    /// Whatever an Ethernet frame carries: the payload is the frame, from the destination's MAC
    /// address on. Only for a board whose network is frames.
    Cable,
}

/// A datagram of the board's.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Reply {
    /// The sender.
    pub service: Service,
    /// The host's port.
    pub port: u16,
    /// What it says.
    pub payload: Vec<u8>,
}

/// The network addresses of a board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Addresses {
    /// Hardware address.
    pub mac: [u8; 6],
    /// IPv4 address.
    pub ip: Ipv4Addr,
    /// Bits of the netmask.
    pub prefix: u8,
    /// UDP port of the Etherbone server.
    pub port: u16,
}

/// A board that can be served: datagrams and console lines in, answers out, and time that passes
/// only when told to.
pub trait Device {
    /// One client's connection to the console.
    type Console: Copy;

    /// Sys clocks since power-up.
    fn clock(&self) -> u64;
    /// How time is divided.
    fn clockwork(&self) -> Clockwork;
    /// Puts a datagram from a host's `port` on the way to the board.
    fn post(&mut self, port: u16, service: Service, payload: &[u8]);
    /// Lets time pass to the sys clock `until` or to the next answer; true when something may have
    /// come.
    fn pass(&mut self, until: u64) -> bool;
    /// What the board has sent.
    fn take_replies(&mut self) -> Vec<Reply>;
    /// Clocks from one frame of [`Service::Cable`] to the next.
    fn between_frames(&self) -> u64 {
        0
    }
    /// Longest wait for the answer to `payload`, or for it to take effect, sys clocks.
    fn wait_for(&self, service: Service, payload: &[u8]) -> u64;
    /// The network addresses of the board at present; `None` if nothing outside its cable needs
    /// them.
    fn addresses(&self) -> Option<Addresses> {
        None
    }

    /// A client connects to this TCP port: the console's, or that of jobs.
    fn open(&mut self, port: u16) -> Self::Console;
    /// Bytes from the client; returns how many were taken.
    fn type_in(&mut self, console: Self::Console, bytes: &[u8]) -> usize;
    /// The board's new output for the client.
    fn heard(&mut self, console: Self::Console) -> Vec<u8>;
    /// Bytes from the client that the board has not received yet.
    fn untold(&mut self, console: Self::Console) -> usize;
    /// The client closes its side.
    fn hang_up(&mut self, console: Self::Console);
    /// The board has closed its side.
    fn hung_up(&mut self, console: Self::Console) -> bool;
    /// Both sides are closed.
    fn closed(&mut self, console: Self::Console) -> bool;
    /// Forgets the connection.
    fn forget(&mut self, console: Self::Console);

    /// Pins, edges, plant.
    fn environment(&self) -> &PinEnvironment;
    /// The same, to be changed.
    fn environment_mut(&mut self) -> &mut PinEnvironment;
    /// Stops or starts the CPU.
    fn freeze_cpu(&mut self, frozen: bool);
    /// The faults.
    fn faults(&mut self) -> &mut Script;
    /// Starts these faults now. An error names the fault that this board cannot have, and an
    /// alternative.
    fn trouble(&mut self, plan: &Plan) -> Result<(), String>;
    /// Measurements of exchanges.
    fn meter(&self) -> &Meter;
    /// Frames passed.
    fn frames(&self) -> FrameCounts;
    /// Round trip of a ping, sys clocks.
    fn ping(&mut self) -> Option<u64>;
    /// Thousands of sys clocks simulated per second of this machine.
    fn kcycles_per_second(&self) -> f64;
    /// Everything worth reporting.
    fn report(&mut self) -> Report;

    /// A duration in sys clocks.
    fn clocks(&self, time: Duration) -> u64 {
        self.clockwork().clocks_in_ns(time.as_nanos() as u64)
    }
}

impl<S: Silicon> Device for Rig<S> {
    type Console = Connection;

    fn clock(&self) -> u64 {
        Rig::clock(self)
    }
    fn clockwork(&self) -> Clockwork {
        self.board.clockwork()
    }
    fn post(&mut self, port: u16, service: Service, payload: &[u8]) {
        match service {
            Service::Etherbone => {
                self.ask_again();
                Rig::post(self, (HOST_IP, port), BOARD_PORT, payload);
            }
            Service::Discovery => self.broadcast((HOST_IP, port), wire::DISCOVERY_PORT, payload),
            Service::Dhcp => {}
            Service::Cable => drop(self.inject_frame(payload)),
        }
    }
    /// Half a millisecond, in which the image takes any frame. This machine sends ten while the
    /// board takes one, and what the board loses comes again after a second of its own, which is a
    /// minute here.
    fn between_frames(&self) -> u64 {
        self.clocks(Duration::from_micros(500))
    }
    fn pass(&mut self, until: u64) -> bool {
        self.advance(until)
    }
    fn take_replies(&mut self) -> Vec<Reply> {
        if self.unplugged() {
            let frame = |payload| Reply {
                service: Service::Cable,
                port: 0,
                payload,
            };
            return self.take_frames().into_iter().map(frame).collect();
        }
        let datagrams = self.take_datagrams().into_iter();
        datagrams
            .map(|(datagram, _)| Reply {
                service: match datagram.from.1 {
                    wire::DISCOVERY_PORT => Service::Discovery,
                    _ => Service::Etherbone,
                },
                port: datagram.to.1,
                payload: datagram.payload,
            })
            .collect()
    }
    fn wait_for(&self, service: Service, payload: &[u8]) -> u64 {
        if service == Service::Discovery || wants_reply(payload) {
            Rig::wait_for(self, payload)
        } else {
            self.patience / 10
        }
    }
    fn open(&mut self, port: u16) -> Connection {
        self.segment.connect(port)
    }
    fn type_in(&mut self, console: Connection, bytes: &[u8]) -> usize {
        self.segment.send(console, bytes)
    }
    fn heard(&mut self, console: Connection) -> Vec<u8> {
        self.segment.recv(console)
    }
    fn untold(&mut self, console: Connection) -> usize {
        self.segment.unsent(console)
    }
    fn hang_up(&mut self, console: Connection) {
        self.segment.close(console);
    }
    fn hung_up(&mut self, console: Connection) -> bool {
        self.segment.hung_up(console)
    }
    fn closed(&mut self, console: Connection) -> bool {
        self.segment.closed(console)
    }
    fn forget(&mut self, console: Connection) {
        self.segment.drop_connection(console);
    }
    fn environment(&self) -> &PinEnvironment {
        &self.board
    }
    fn environment_mut(&mut self) -> &mut PinEnvironment {
        &mut self.board
    }
    fn freeze_cpu(&mut self, frozen: bool) {
        self.board.freeze_cpu(frozen);
    }
    fn faults(&mut self) -> &mut Script {
        &mut self.faults
    }
    fn trouble(&mut self, plan: &Plan) -> Result<(), String> {
        Rig::trouble(self, plan)
    }
    fn meter(&self) -> &Meter {
        &self.meter
    }
    fn frames(&self) -> FrameCounts {
        self.frames
    }
    fn ping(&mut self) -> Option<u64> {
        Rig::ping(self)
    }
    fn kcycles_per_second(&self) -> f64 {
        Rig::kcycles_per_second(self)
    }
    fn report(&mut self) -> Report {
        Rig::report(self)
    }
}
