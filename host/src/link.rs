//! The socket in the servo thread: one `send` per period, one `recv`, and a `ppoll` when the answer
//! is not there yet. Nothing else of this crate makes a system call in that thread.
//!
//! Each datagram comes with the time at which the kernel had it (`SO_TIMESTAMPNS`), because `read`
//! looks up to a period later, and the exchange is to be told from that wait.
//!
//! It uses `ppoll`, not a read timeout: `SO_RCVTIMEO` counts in jiffies, and 200 us measured as 11
//! ms, ten servo periods for one lost packet.
//!
//! The work for received datagrams is bounded: a period looks at [`LOOKS`] datagrams at most. The
//! rest of a flood is discarded unread ([`Link::discard`]), 64 at a time; otherwise the next answer
//! would wait behind it.

use std::io;
use std::net::{SocketAddr, SocketAddrV4, UdpSocket};
use std::os::fd::AsRawFd;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
use wire::{MAX_PAYLOAD, MAX_WORDS};

/// Datagrams a period looks at, some 1 us each. The board sends 8 at most (two answers, two
/// receipts, a session in three), and in front of an answer that takes 150 us stand 100 of what one
/// program on this computer can send without a pause.
pub const LOOKS: u32 = 128;
/// Datagrams thrown away by one system call, and calls: twice what a queue of ordinary length (212
/// 992 bytes) holds.
const BATCH: usize = 64;
const BATCHES: usize = 8;

/// More datagrams than this in a period: a flood, or a backlog that the network delivers at once.
/// Twice what a board sends.
const ORDINARY: u32 = 16;
/// 1 s at 1 kHz: for so many periods after that nothing is left in the queue.
const WARY: u32 = 1000;
/// Such periods after which it is a flood and no backlog.
const FLOOD: u32 = 8;

/// What to do about many datagrams.
#[derive(Debug, Default)]
pub struct Flood {
    /// Periods for which the queue is emptied yet.
    wary: u32,
    /// Periods with many, since it was last in order.
    many: u32,
}

/// After a period.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Verdict {
    /// Discard the rest of the queue, because it is in front of the next answer.
    pub discard: bool,
    /// It is a flood.
    pub tell: bool,
}

impl Flood {
    /// A period has looked at so many.
    pub fn looked(&mut self, datagrams: u32) -> Verdict {
        let many = datagrams > ORDINARY;
        if many {
            (self.wary, self.many) = (WARY, self.many.saturating_add(1));
        } else if self.wary == 0 {
            self.many = 0;
        }
        let discard = self.wary > 0;
        self.wary = self.wary.saturating_sub(1);
        Verdict {
            discard,
            tell: many && self.many == FLOOD,
        }
    }
}

/// A connected, non-blocking UDP socket with its buffers.
#[derive(Debug)]
pub struct Link {
    socket: UdpSocket,
    bytes: [u8; MAX_PAYLOAD],
    words: [u32; MAX_WORDS],
    /// System calls made so far.
    calls: u64,
    /// When the kernel had the last datagram, by the wall clock, if it said so.
    stamp: Option<Duration>,
}

impl Link {
    /// Takes over a connected socket.
    pub fn new(socket: UdpSocket) -> io::Result<Self> {
        socket.set_nonblocking(true)?;
        stamp_arrivals(&socket);
        Ok(Link {
            socket,
            bytes: [0; MAX_PAYLOAD],
            words: [0; MAX_WORDS],
            calls: 0,
            stamp: None,
        })
    }

    /// System calls made on the socket so far.
    pub fn calls(&self) -> u64 {
        self.calls
    }

    /// This computer's address on the way to the board.
    pub fn local(&self) -> Option<SocketAddrV4> {
        match self.socket.local_addr() {
            Ok(SocketAddr::V4(local)) => Some(local),
            Ok(SocketAddr::V6(_)) | Err(_) => None,
        }
    }

    /// For how long the last datagram has lain here unread; 0 if the kernel does not say. The wall
    /// clock may have been set since, so this may be anything.
    pub fn unread_for(&self) -> Duration {
        let now = SystemTime::now().duration_since(UNIX_EPOCH);
        let since = |stamp| now.ok()?.checked_sub(stamp);
        self.stamp.and_then(since).unwrap_or_default()
    }

    /// Sends one datagram; `false` if the network would not take it.
    #[must_use]
    pub fn send(&mut self, words: &[u32]) -> bool {
        let length = wire::words_to_bytes(words, &mut self.bytes);
        let send = |link: &mut Link| {
            link.calls += 1;
            link.socket.send(&link.bytes[..length])
        };
        match send(self) {
            Ok(_) => true,
            // The refusal of an earlier datagram; this one was not sent. Once more.
            Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => send(self).is_ok(),
            Err(_) => false,
        }
    }

    /// The next datagram that is whole words; `None` when none came until the deadline, or when
    /// this period has looked at as many as it may: each takes one of `looks`. A deadline in the
    /// past takes what is there and does not wait.
    pub fn receive(&mut self, deadline: Instant, looks: &mut u32) -> Option<&[u32]> {
        while *looks > 0 {
            self.calls += 1;
            match self.take() {
                Ok(length) => {
                    *looks -= 1;
                    // A datagram with a part of a word is not an answer.
                    if wire::words_from_bytes(&self.bytes[..length], &mut self.words).is_ok() {
                        return self.words.get(..length / 4);
                    }
                }
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                    if !self.wait(deadline) {
                        return None;
                    }
                }
                // "Refused" is about an earlier datagram; the board may be about to answer this
                // one.
                Err(error)
                    if matches!(
                        error.kind(),
                        io::ErrorKind::ConnectionRefused | io::ErrorKind::Interrupted
                    ) =>
                {
                    *looks -= 1;
                    if Instant::now() >= deadline {
                        return None;
                    }
                }
                Err(_) => return None,
            }
        }
        None
    }

    /// As `recv`, with the time of arrival.
    fn take(&mut self) -> io::Result<usize> {
        // Two of the one message with a time that there may be; aligned as its head has to be.
        let mut control = [0u64; 8];
        let mut data = libc::iovec {
            iov_base: self.bytes.as_mut_ptr().cast(),
            iov_len: self.bytes.len(),
        };
        // SAFETY: all of its fields are numbers or null pointers.
        let mut head: libc::msghdr = unsafe { core::mem::zeroed() };
        (head.msg_iov, head.msg_iovlen) = (&raw mut data, 1);
        head.msg_control = control.as_mut_ptr().cast();
        head.msg_controllen = size_of_val(&control) as _;
        // SAFETY: `head` names two buffers that live here and are as long as it says.
        let length = unsafe { libc::recvmsg(self.socket.as_raw_fd(), &raw mut head, 0) };
        let length = usize::try_from(length).map_err(|_| io::Error::last_os_error())?;
        // SAFETY: the kernel has filled `control` and said in `head` how far.
        let first = unsafe { libc::CMSG_FIRSTHDR(&raw const head).as_ref() };
        self.stamp = first
            .filter(|it| (it.cmsg_level, it.cmsg_type) == (libc::SOL_SOCKET, libc::SCM_TIMESTAMPNS))
            .and_then(|it| {
                // SAFETY: a message of this type has a `timespec`; its place need not be aligned.
                let time = unsafe {
                    libc::CMSG_DATA(it)
                        .cast::<libc::timespec>()
                        .read_unaligned()
                };
                let seconds = u64::try_from(time.tv_sec).ok()?;
                Some(Duration::new(seconds, u32::try_from(time.tv_nsec).ok()?))
            });
        Ok(length)
    }

    /// Throws away what is in the queue, unread; how many that were. A queue that fills as fast is
    /// left as it is after [`BATCHES`] calls.
    pub fn discard(&mut self) -> u32 {
        // SAFETY: all of its fields are numbers or null pointers; with no room for data the kernel
        // writes nothing but counts.
        let mut heads: [libc::mmsghdr; BATCH] = unsafe { core::mem::zeroed() };
        let mut total = 0;
        for _ in 0..BATCHES {
            self.calls += 1;
            // SAFETY: `BATCH` valid headers without buffers; no timeout, no waiting.
            let taken = unsafe {
                libc::recvmmsg(
                    self.socket.as_raw_fd(),
                    heads.as_mut_ptr(),
                    BATCH as libc::c_uint,
                    libc::MSG_DONTWAIT,
                    core::ptr::null_mut(),
                )
            };
            // Nothing there, or the refusal of an earlier datagram: there may be more after it next
            // time.
            let Ok(taken) = u32::try_from(taken) else {
                break;
            };
            total += taken;
            if (taken as usize) < BATCH {
                break;
            }
        }
        total
    }

    /// Sleeps until something is there to receive (`true`) or the deadline has passed.
    fn wait(&mut self, deadline: Instant) -> bool {
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
        self.calls += 1;
        // SAFETY: one valid pollfd, a valid timespec, no signal mask.
        let ready = unsafe { libc::ppoll(&raw mut poll, 1, &raw const timeout, core::ptr::null()) };
        // An interrupted wait is asked again through `recv`.
        ready != 0
    }
}

/// Has the kernel say when each datagram arrived. One that cannot is no obstacle: then a datagram
/// counts as arrived when it is read.
fn stamp_arrivals(socket: &UdpSocket) {
    let on: libc::c_int = 1;
    // SAFETY: the value is an int that lives here, and its length is said.
    let _ = unsafe {
        libc::setsockopt(
            socket.as_raw_fd(),
            libc::SOL_SOCKET,
            libc::SO_TIMESTAMPNS,
            (&raw const on).cast(),
            size_of_val(&on) as libc::socklen_t,
        )
    };
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_datagram_tells_how_long_it_has_lain_unread() {
        let here = UdpSocket::bind("127.0.0.1:0").expect("a socket");
        let there = UdpSocket::bind("127.0.0.1:0").expect("a socket");
        here.connect(there.local_addr().unwrap()).unwrap();
        there.connect(here.local_addr().unwrap()).unwrap();
        let mut link = Link::new(here).expect("a link");
        assert_eq!(link.unread_for(), Duration::ZERO, "nothing was read");
        let lain = Duration::from_millis(5);
        // The kernel begins to stamp datagrams some time after the first socket has asked for it.
        let is_told = (0..200).any(|_| {
            let before = Instant::now();
            there.send(&[0; 8]).unwrap();
            std::thread::sleep(lain);
            let deadline = Instant::now() + Duration::from_secs(10);
            assert_eq!(link.receive(deadline, &mut 8), Some(&[0, 0][..]));
            (lain..before.elapsed()).contains(&link.unread_for())
        });
        assert!(is_told, "{:?}", link.unread_for());
    }

    #[test]
    fn a_backlog_is_thrown_away_and_a_flood_is_told_once_while_it_lasts() {
        let mut flood = Flood::default();
        let quiet = |discard| Verdict {
            discard,
            tell: false,
        };
        assert_eq!(flood.looked(ORDINARY), quiet(false));
        assert_eq!(flood.looked(ORDINARY + 1), quiet(true));
        // Nothing stays in the queue for a second, so every other period cannot be the one that
        // loses its answer.
        for _ in 1..WARY {
            assert_eq!(flood.looked(1), quiet(true));
        }
        assert_eq!(flood.looked(1), quiet(false));
        let mut told = 0;
        for n in 1..=100 {
            // Seen in every tenth period only.
            let verdict = flood.looked(if n % 10 == 0 { LOOKS } else { 1 });
            told += u32::from(verdict.tell);
            assert_eq!((told > 0, verdict.discard), (n >= 80, n >= 10), "{n}");
        }
        assert_eq!(told, 1);
    }
}
