//! A TAP interface of this machine: what leaves a network interface of the kernel comes here as
//! Ethernet frames, and the other way round. The kernel adds the checksums and cuts long segments
//! before a frame comes out, so a simulated board gets what it would get over its cable.

use smoltcp::phy::{Device as _, Medium, RxToken as _, TunTapInterface, TxToken as _};
use smoltcp::time::Instant;

/// Bytes of the longest frame, without its FCS.
const LONGEST: usize = 1514;

/// The interface. It is gone with this, unless it was made to stay (`ip tuntap add`).
#[derive(Debug)]
pub struct Tap(TunTapInterface);

impl Tap {
    /// Takes this interface, and makes it if it is not there. Needs root in the network namespace.
    pub fn open(name: &str) -> std::io::Result<Self> {
        TunTapInterface::new(name, Medium::Ethernet).map(Tap)
    }

    /// The next frame of this machine's kernel, if there is one: destination MAC .. payload.
    pub fn receive(&mut self) -> Option<Vec<u8>> {
        let (frame, _) = self.0.receive(Instant::ZERO)?;
        Some(frame.consume(<[u8]>::to_vec))
    }

    /// Hands a frame to the kernel. It may drop it, as a switch may.
    pub fn send(&mut self, frame: &[u8]) {
        if let Some(token) = self
            .0
            .transmit(Instant::ZERO)
            .filter(|_| frame.len() <= LONGEST)
        {
            token.consume(frame.len(), |room| room.copy_from_slice(frame));
        }
    }
}
