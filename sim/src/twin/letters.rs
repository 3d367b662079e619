//! What is on the cable between the twin and its hosts.

use crate::faults::Cargo;
use crate::gmii;
use crate::server::{Reply, Service};

/// Bytes around a UDP payload on the wire: preamble, Ethernet, IPv4, UDP, FCS.
const ENVELOPE: usize = 8 + 14 + 20 + 8 + 4;

/// A datagram on its way to the board.
#[derive(Clone, Debug)]
pub(super) struct Letter {
    pub(super) port: u16,
    pub(super) service: Service,
    pub(super) payload: Vec<u8>,
}

fn on_the_wire(service: Service, payload: &[u8]) -> usize {
    match service {
        Service::Cable => gmii::encode(payload).len(),
        _ => (payload.len() + ENVELOPE).max(gmii::MIN_FRAME + 12),
    }
}

impl Cargo for Letter {
    fn wire_bytes(&self) -> usize {
        on_the_wire(self.service, &self.payload)
    }
    /// The MAC drops what its checksum does not fit.
    fn damage(&mut self, _: u64) -> bool {
        false
    }
}

impl Cargo for Reply {
    fn wire_bytes(&self) -> usize {
        on_the_wire(self.service, &self.payload)
    }
    /// So does the host's.
    fn damage(&mut self, _: u64) -> bool {
        false
    }
}

/// One that has arrived.
#[derive(Debug)]
pub(super) struct Request {
    pub(super) port: u16,
    pub(super) service: Service,
    pub(super) payload: Vec<u8>,
    /// The clocks of execution and answer.
    pub(super) due: u64,
    pub(super) answered: u64,
    pub(super) reply: Option<Vec<u8>>,
}
