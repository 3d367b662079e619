//! The socket in the servo thread: one `send` per period, one `recv`, and a `ppoll` when the answer
//! is not there yet. Nothing else of this crate makes a system call in that thread.
//!
//! `ppoll` and not a read timeout: `SO_RCVTIMEO` counts in jiffies and turned 200 us into 11 ms when
//! measured, ten servo periods for one lost packet.

use std::io;
use std::net::{SocketAddr, SocketAddrV4, UdpSocket};
use std::os::fd::AsRawFd;
use std::time::Instant;
use wire::{MAX_PAYLOAD, MAX_WORDS};

/// A connected, non-blocking UDP socket with its buffers.
#[derive(Debug)]
pub struct Link {
    socket: UdpSocket,
    bytes: [u8; MAX_PAYLOAD],
    words: [u32; MAX_WORDS],
}

impl Link {
    /// Takes over a connected socket.
    pub fn new(socket: UdpSocket) -> io::Result<Self> {
        socket.set_nonblocking(true)?;
        Ok(Link {
            socket,
            bytes: [0; MAX_PAYLOAD],
            words: [0; MAX_WORDS],
        })
    }

    /// This computer's address on the way to the board.
    pub fn local(&self) -> Option<SocketAddrV4> {
        match self.socket.local_addr() {
            Ok(SocketAddr::V4(local)) => Some(local),
            Ok(SocketAddr::V6(_)) | Err(_) => None,
        }
    }

    /// Sends one datagram; `false` if the network would not take it.
    #[must_use]
    pub fn send(&mut self, words: &[u32]) -> bool {
        let length = wire::words_to_bytes(words, &mut self.bytes);
        let send = |link: &Link| link.socket.send(&link.bytes[..length]);
        match send(self) {
            Ok(_) => true,
            // The refusal of an earlier datagram; this one was not sent. Once more.
            Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => send(self).is_ok(),
            Err(_) => false,
        }
    }

    /// The next datagram that is whole words; `None` when none came until the deadline. A deadline
    /// in the past takes what is there and does not wait.
    pub fn receive(&mut self, deadline: Instant) -> Option<&[u32]> {
        loop {
            match self.socket.recv(&mut self.bytes) {
                Ok(length) => {
                    // What is not whole words is nobody's answer.
                    if wire::words_from_bytes(&self.bytes[..length], &mut self.words).is_ok() {
                        return self.words.get(..length / 4);
                    }
                }
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                    if !self.wait(deadline) {
                        return None;
                    }
                }
                // "Refused" tells of an earlier datagram; the board may be about to answer this one.
                Err(error)
                    if matches!(
                        error.kind(),
                        io::ErrorKind::ConnectionRefused | io::ErrorKind::Interrupted
                    ) =>
                {
                    if Instant::now() >= deadline {
                        return None;
                    }
                }
                Err(_) => return None,
            }
        }
    }

    /// Sleeps until something is there to receive (`true`) or the deadline has passed.
    fn wait(&self, deadline: Instant) -> bool {
        let left = deadline.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return false;
        }
        let mut poll = libc::pollfd {
            fd: self.socket.as_raw_fd(),
            events: libc::POLLIN,
            revents: 0,
        };
        let timeout = libc::timespec {
            tv_sec: left.as_secs() as libc::time_t,
            tv_nsec: libc::c_long::from(left.subsec_nanos()),
        };
        // SAFETY: one valid pollfd, a valid timespec, no signal mask.
        let ready = unsafe { libc::ppoll(&raw mut poll, 1, &raw const timeout, core::ptr::null()) };
        // An interrupted wait is asked again through `recv`.
        ready != 0
    }
}
