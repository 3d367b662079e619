//! The thread that exchanges: at the priority of a servo thread if it may.

use super::{Measured, Priority, to_ns};
use crate::blocks::exchange::Expected;
use crate::blocks::packets;
use crate::client::{Client, ClientError, Session, single_record};
use crate::link::{LOOKS, Link};
use std::io;
use std::time::{Duration, Instant};
use wire::describe::Channels;
use wire::exchange::{COMMAND_MAX, Command, REQUEST_OVERHEAD, status_words};
use wire::{Request, map};

/// Below that of the kernel's timers and of LinuxCNC's own threads (98).
const PRIORITY: libc::c_int = 90;
/// The first exchanges of a session are answered by the firmware, not by the gateware.
const WARM_UP: u32 = 10;
/// For answers that are still on their way at the end.
const PATIENCE: Duration = Duration::from_millis(100);

/// What is to be measured.
#[derive(Clone, Copy, Debug)]
pub struct Plan {
    /// From one exchange to the next.
    pub period: Duration,
    /// Exchanges that count.
    pub exchanges: u64,
    /// The isolated processor, if there is one.
    pub cpu: Option<u32>,
}

/// Why nothing was measured.
#[derive(Debug)]
pub enum SoakError {
    /// The board does not answer, is owned, or gives no session.
    Board(ClientError),
    /// This computer has no socket or no thread for it.
    Computer(io::Error),
}

impl core::fmt::Display for SoakError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            SoakError::Board(error) => error.fmt(f),
            SoakError::Computer(error) => write!(f, "cannot measure on this computer: {error}"),
        }
    }
}

impl std::error::Error for SoakError {}

/// Takes the board, measures, gives it back. `tick` is called for every exchange, and may end it by
/// `false`.
pub fn measure(
    mut client: Client,
    plan: &Plan,
    tick: impl FnMut(u64) -> bool + Send,
) -> Result<Measured, SoakError> {
    let identity = client.identify().map_err(SoakError::Board)?;
    client.check(&identity).map_err(SoakError::Board)?;
    let session = client.acquire().map_err(SoakError::Board)?;
    let mut link = Link::new(client.into_socket()).map_err(SoakError::Computer)?;
    let channels = identity.describe.channels;
    // A thread of its own, so that nothing else gets its priority.
    let measured = std::thread::scope(|scope| {
        let work = || exchanges(&mut link, channels, &session, plan, tick);
        let thread = std::thread::Builder::new().spawn_scoped(scope, work);
        let thread = thread.map_err(SoakError::Computer)?;
        let broken = || SoakError::Computer(io::Error::other("the thread that measures failed"));
        thread.join().map_err(|_| broken())
    });
    let mut words = [0; 8];
    if let Some(release) = Request::new(&mut words)
        .write(map::SESSION_RELEASE, &[session.token])
        .words()
    {
        // One that is lost is made good by the board: an idle session ends.
        let _ = link.send(release);
    }
    measured
}

/// The exchanges, and what is expected of them.
struct Exchanges<'l> {
    link: &'l mut Link,
    words: usize,
    expected: Expected,
    measured: Measured,
}

fn exchanges(
    link: &mut Link,
    channels: Channels,
    session: &Session,
    plan: &Plan,
    mut tick: impl FnMut(u64) -> bool,
) -> Measured {
    let priority = match raise(plan.cpu) {
        Ok(()) => Priority::Realtime(plan.cpu),
        Err(error) => Priority::Ordinary(error.to_string()),
    };
    let mut all = Exchanges {
        link,
        words: status_words(channels),
        expected: Expected::default(),
        measured: Measured::new(plan.period, priority),
    };
    // Neither `enable` nor `enable_request`: the board stays as safe as it is.
    let mut command = Command {
        token: session.token,
        sequence: session.last_sequence,
        ..Command::default()
    };
    let mut due = Instant::now() + plan.period;
    for warm_up in (0..WARM_UP).rev() {
        all.exchange(&mut command, channels, due, plan.period);
        due = next(due, plan.period);
        if warm_up == 0 {
            all.forget();
        }
    }
    while all.measured.asked < plan.exchanges && tick(all.measured.asked) {
        all.exchange(&mut command, channels, due, plan.period);
        due = next(due, plan.period);
    }
    all.receive(Instant::now() + PATIENCE, None);
    all.measured.lost += u64::from(all.expected.given_up());
    all.measured
}

/// The next moment that is still to come: what is missed is not made up for.
fn next(mut due: Instant, period: Duration) -> Instant {
    due += period;
    let now = Instant::now();
    while due < now {
        due += period;
    }
    due
}

impl Exchanges<'_> {
    fn exchange(
        &mut self,
        command: &mut Command,
        channels: Channels,
        due: Instant,
        period: Duration,
    ) {
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
        self.measured.wake.record(to_ns(due.elapsed()));
        command.sequence = command.sequence.wrapping_add(1);
        self.measured.asked += 1;
        let lost = self.expected.sent(command.sequence);
        self.measured.lost += u64::from(lost);
        let mut words = [0; REQUEST_OVERHEAD + COMMAND_MAX];
        let sent = Instant::now();
        // What was not sent is lost.
        let is_sent = command
            .emit_request(channels, &mut words)
            .is_some_and(|request| self.link.send(request));
        if is_sent {
            let patience = packets::default_timeout_ns(to_ns(period) as i64);
            let deadline = sent + Duration::from_nanos(patience);
            self.receive(deadline, Some((command.sequence, sent)));
        }
    }

    /// Until the answer to this one is there, or the time is over.
    fn receive(&mut self, deadline: Instant, waited_for: Option<(u32, Instant)>) {
        let mut looks = LOOKS;
        while let Some(words) = self.link.receive(deadline, &mut looks) {
            let Some((base, payload)) = single_record(words) else {
                continue;
            };
            if payload.len() != self.words || !self.expected.came(base) {
                continue;
            }
            match waited_for {
                Some((sequence, sent)) if sequence == base => {
                    let took = sent.elapsed();
                    let took = took.checked_sub(self.link.unread_for()).unwrap_or(took);
                    self.measured.exchange.record(to_ns(took));
                    return;
                }
                Some(_) | None => self.measured.late += 1,
            }
        }
    }

    /// Begins anew: the warm-up is over.
    fn forget(&mut self) {
        self.expected.given_up();
        let (period, priority) = (self.measured.period, self.measured.priority.clone());
        self.measured = Measured::new(period, priority);
    }
}

/// Gives this thread the priority of a servo thread, and its processor.
fn raise(cpu: Option<u32>) -> io::Result<()> {
    let done = |result: libc::c_int| match result {
        0 => Ok(()),
        _ => Err(io::Error::last_os_error()),
    };
    // SAFETY: all of its fields are numbers; 0 is good for those that `SCHED_FIFO` does not use.
    let mut parameters: libc::sched_param = unsafe { core::mem::zeroed() };
    parameters.sched_priority = PRIORITY;
    // SAFETY: of this thread (0), with parameters that live here.
    done(unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const parameters) })?;
    // SAFETY: no memory is named. What cannot be locked may be swapped out, and shows as late.
    let _ = unsafe { libc::mlockall(libc::MCL_CURRENT) };
    let Some(cpu) = cpu else { return Ok(()) };
    // SAFETY: a set of bits, all of them 0.
    let mut set: libc::cpu_set_t = unsafe { core::mem::zeroed() };
    let place = usize::try_from(cpu).unwrap_or(usize::MAX);
    if place < 8 * size_of::<libc::cpu_set_t>() {
        // SAFETY: it was just seen to be a bit of the set.
        unsafe { libc::CPU_SET(place, &mut set) };
    }
    // SAFETY: of this thread (0), with a set that lives here and its length.
    done(unsafe { libc::sched_setaffinity(0, size_of_val(&set), &raw const set) })
}
