//! Requests to a board outside the servo thread: blocking, with retries.
//!
//! `loadrt` uses this module to identify a board and to take its session; the tool uses it to read.
//! Every request carries a tag that comes back with the words read, so a late answer to an earlier
//! try is never taken for the present one. A datagram that writes and reads is executed whole or
//! not at all, so an answer to its reads is the receipt for its writes.

use crate::address::Address;
use crate::keys::{Key, KeyError, Keys};
use std::io;
use std::net::{SocketAddr, SocketAddrV4, UdpSocket};
use std::ops::RangeInclusive;
use std::path::Path;
use std::time::{Duration, Instant};
use wire::board::{Blob, BlobError, Kind};
use wire::describe::{self, Describe, DescribeError};
use wire::map::{PwmType, StepType};
use wire::{MAX_PAYLOAD, MAX_WORDS, Packet, Request, map};

/// How long one try waits: some hundred times a healthy board's answer, short enough that a lost
/// packet is not felt.
const TRY: Duration = Duration::from_millis(200);
/// How long to go on trying. A board needs well under a second from power-up to its first answer; a
/// simulated one may take a few.
pub const PATIENCE: Duration = Duration::from_secs(4);
/// Words read per request: as many as a board answers any client in any state.
const CHUNK: usize = wire::GUEST_READS;

/// Why a request failed; it says what to do.
#[derive(Debug)]
pub enum ClientError {
    /// The socket itself.
    Socket(Address, io::Error),
    /// No answer.
    Silent {
        /// The board.
        address: Address,
        /// How long.
        waited: Duration,
        /// What the network said meanwhile, if anything.
        hint: Option<io::Error>,
    },
    /// It is not a FerroCNC board, or has another version.
    Describe(Address, DescribeError),
    /// Its board information is unreadable.
    Blob(Address, BlobError),
    /// Gateware and firmware disagree.
    Abi {
        /// The board.
        address: Address,
        /// The number the firmware was built for.
        firmware: u32,
        /// The number the gateware was built from.
        gateware: u32,
    },
    /// Its board file is not in force, for a reason that prevents arming.
    Pins(Address),
    /// Another host drives it.
    Owned {
        /// Which board.
        address: Address,
        /// The owner of its session.
        owner: Owner,
    },
    /// It answers, but will not give its session.
    NoSession(Address),
    /// It has a key that this computer cannot show.
    Key(Address, KeyError),
}

impl core::fmt::Display for ClientError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            ClientError::Socket(address, error) => write!(
                f,
                "cannot send to {address}: {error}; check that this computer has an address in the board's network"
            ),
            ClientError::Silent {
                address,
                waited,
                hint,
            } => {
                write!(
                    f,
                    "no answer from {address} for {:.1} s; check power, cable and the board's address (ping {})",
                    waited.as_secs_f64(),
                    address.socket.ip()
                )?;
                match hint {
                    Some(error) => write!(f, "; the network says: {error}"),
                    None => Ok(()),
                }
            }
            ClientError::Describe(address, error) => write!(f, "{address}: {error}"),
            ClientError::Blob(address, error) => write!(f, "{address}: {error}"),
            ClientError::Abi {
                address,
                firmware,
                gateware,
            } => write!(
                f,
                "{address}: the firmware was built for register map {firmware:#010x}, the gateware is {gateware:#010x}; flash a matching pair"
            ),
            ClientError::Pins(address) => write!(
                f,
                "{address}: the board file on this board is not in force, so it would not arm; ferrocnc describe {address} says why and what to do, as in: ferrocnc config apply {address} FILE.toml"
            ),
            ClientError::Owned { address, owner } => write!(
                f,
                "{address} is driven by {owner}; stop LinuxCNC there, or wait until its watchdog has ended that session"
            ),
            ClientError::Key(address, error) => write!(f, "{address}: {error}"),
            ClientError::NoSession(address) => write!(
                f,
                "{address} answers but gives no session; look at its console (ferrocnc console {})",
                address.socket.ip()
            ),
        }
    }
}

impl std::error::Error for ClientError {}

/// The owner of a board's session, and the address that asks. If both are the same computer, the
/// message says so, because the operator then looks for a hung LinuxCNC on this computer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Owner(pub SocketAddrV4, pub Option<SocketAddrV4>);

impl core::fmt::Display for Owner {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let Owner(owner, asks) = self;
        owner.fmt(f)?;
        if asks.is_some_and(|asks| asks.ip() == owner.ip()) {
            f.write_str(" (another program on this computer)")?;
        }
        Ok(())
    }
}

/// A board's identity: its description and the names after it.
#[derive(Clone, Debug)]
pub struct Identity {
    /// Versions, counts, clock, state.
    pub describe: Describe,
    /// The board blob, checked; read it with [`Identity::blob`].
    blob: Vec<u8>,
}

impl Identity {
    /// Puts one together; refused when the blob is unreadable.
    pub fn new(describe: Describe, blob: Vec<u8>) -> Result<Self, BlobError> {
        Blob::new_checked(&blob)?;
        Ok(Identity { describe, blob })
    }

    /// What the board file says of a channel's pins: the value of `step=`, `dir=`, `type=`,
    /// `estop=`. `class` is the first letter of the entry.
    pub fn pin(&self, class: u8, channel: usize, key: &str) -> Option<&str> {
        self.blob().entries().find_map(|entry| {
            let (first, text) = entry.value.split_first()?;
            let this = entry.kind == Kind::Pins
                && usize::from(entry.channel) == channel
                && *first == class;
            let text = core::str::from_utf8(text).ok().filter(|_| this)?;
            let mut words = text.split(' ');
            words.find_map(|word| word.strip_prefix(key)?.strip_prefix('='))
        })
    }

    /// Whether the board file says anything of it.
    pub fn has_pin(&self, class: u8, channel: usize, key: &str) -> bool {
        self.pin(class, channel, key).is_some()
    }

    /// How the board file has this stepgen speak; what it does not say, or in words of a later
    /// version, is step/dir.
    pub fn step_type(&self, stepgen: usize) -> StepType {
        match self.pin(b's', stepgen, "type") {
            Some("up_down") => StepType::UpDown,
            Some("quadrature") => StepType::Quadrature,
            Some(_) | None => StepType::StepDir,
        }
    }

    /// What the board file makes of this PWM; the same.
    pub fn pwm_type(&self, pwm: usize) -> PwmType {
        match self.pin(b'p', pwm, "type") {
            Some("up_down") => PwmType::UpDown,
            Some("pdm") => PwmType::Pdm,
            Some(_) | None => PwmType::Pwm,
        }
    }

    /// The functions of its pins are configured, not part of its image.
    pub fn has_configured_pins(&self) -> bool {
        self.describe.features & describe::FEATURE_PINS != 0
    }

    /// The numbers of the channels of a kind, in the board file's order. Where pins are
    /// configured, an input or output has the number of its pin, and only those that the
    /// description names are there.
    pub fn numbers(&self, kind: Kind) -> Vec<u8> {
        let channels = self.describe.channels;
        let count = match kind {
            Kind::Stepgen => channels.stepgens,
            Kind::Encoder => channels.encoders,
            Kind::Pwm => channels.pwms,
            Kind::Input => channels.inputs,
            Kind::Output => channels.outputs,
            _ => 0,
        };
        let sparse = matches!(kind, Kind::Input | Kind::Output) && self.has_configured_pins();
        if !sparse {
            return (0..count).collect();
        }
        let mut numbers = Vec::new();
        for entry in self.blob().entries().filter(|entry| entry.kind == kind) {
            if entry.channel < count && !numbers.contains(&entry.channel) {
                numbers.push(entry.channel);
            }
        }
        numbers
    }

    /// The bit of an input in the status block's `estop`, if it is an e-stop input. Where pins are
    /// configured, they are counted in the order of their numbers.
    pub fn estop_bit(&self, input: u8) -> Option<u8> {
        let stops = |n: u8| self.has_pin(b'i', n.into(), "estop");
        if !stops(input) {
            return None;
        }
        if !self.has_configured_pins() {
            return Some(input);
        }
        let before = self.numbers(Kind::Input).into_iter();
        Some(before.filter(|n| *n < input && stops(*n)).count() as u8)
    }

    /// The names.
    pub fn blob(&self) -> Blob<'_> {
        // Checked in `new`; nothing changes it since.
        Blob::new_checked(&self.blob).expect("a checked blob")
    }
}

/// A socket to one board.
#[derive(Debug)]
pub struct Client {
    address: Address,
    socket: UdpSocket,
    tag: u32,
    patience: Duration,
    /// How long one try waits.
    every: Duration,
    keys: Keys,
    key: Option<Key>,
}

impl Client {
    /// Opens a socket; sends nothing yet.
    pub fn open(address: &Address) -> Result<Self, ClientError> {
        let socket = UdpSocket::bind("0.0.0.0:0").and_then(|socket| {
            socket.connect(address.socket)?;
            Ok(socket)
        });
        let socket = socket.map_err(|error| ClientError::Socket(address.clone(), error))?;
        Ok(Client {
            address: address.clone(),
            // Any start works if it differs from that of the program before.
            tag: nonce(),
            socket,
            patience: PATIENCE,
            every: TRY,
            keys: Keys::default(),
            key: None,
        })
    }

    /// Gives up after this long instead of [`PATIENCE`].
    #[must_use]
    pub fn with_patience(mut self, patience: Duration) -> Self {
        self.patience = patience;
        self
    }

    /// The same, and asks again this often: for a caller that needs a lost packet repeated sooner.
    #[must_use]
    pub fn hurried(mut self, every: Duration, patience: Duration) -> Self {
        (self.every, self.patience) = (every, patience);
        self
    }

    /// Another one for this address, with the same keys.
    pub fn elsewhere(&self, address: &Address) -> Result<Self, ClientError> {
        Ok(Client::open(address)?.with_keys(self.keys.clone()))
    }

    /// Looks there for the board's key, if it has one.
    #[must_use]
    pub fn with_keys(mut self, keys: Keys) -> Self {
        self.keys = keys;
        self
    }

    /// The key the last acquisition needed.
    pub fn key(&self) -> Option<Key> {
        self.key
    }

    /// Does the board have a key, and what is its unique id?
    pub fn locked(&mut self) -> Result<(bool, [u32; 2]), ClientError> {
        let words = self.read(&[FEATURES, map::FLASH_UID_HI, map::FLASH_UID_LO])?;
        let [features, hi, lo] = words[..] else {
            return Ok((false, [0; 2])); // as many words come as were asked for
        };
        Ok((features & describe::FEATURE_KEY != 0, [hi, lo]))
    }

    /// The board's address.
    pub fn address(&self) -> &Address {
        &self.address
    }

    fn local(&self) -> Option<SocketAddrV4> {
        match self.socket.local_addr() {
            Ok(SocketAddr::V4(local)) => Some(local),
            Ok(SocketAddr::V6(_)) | Err(_) => None,
        }
    }

    /// The socket, for the servo thread to go on with: the session belongs to its port.
    pub fn into_socket(self) -> UdpSocket {
        self.socket
    }

    /// Reads these words.
    pub fn read(&mut self, addresses: &[u32]) -> Result<Vec<u32>, ClientError> {
        let mut words = Vec::with_capacity(addresses.len());
        for chunk in addresses.chunks(CHUNK) {
            words.extend(self.transact(&[], chunk)?);
        }
        Ok(words)
    }

    /// Reads `count` consecutive words.
    pub fn read_from(&mut self, base: u32, count: usize) -> Result<Vec<u32>, ClientError> {
        let addresses: Vec<u32> = (0..count as u32).map(|i| base + 4 * i).collect();
        self.read(&addresses)
    }

    /// Writes words and reads others in one datagram: the answer proves that both happened.
    pub fn write_then_read(
        &mut self,
        base: u32,
        words: &[u32],
        addresses: &[u32],
    ) -> Result<Vec<u32>, ClientError> {
        self.transact(&[(base, words)], addresses)
    }

    /// Reads and checks what the board is.
    pub fn identify(&mut self) -> Result<Identity, ClientError> {
        let words = self.read_from(map::DESCRIBE, describe::WORDS)?;
        let head = words.first_chunk::<{ describe::WORDS }>();
        let describe = head
            .ok_or(DescribeError::Malformed)
            .and_then(Describe::parse);
        let describe =
            describe.map_err(|error| ClientError::Describe(self.address.clone(), error))?;
        let words = self.read_from(map::DESCRIBE_BLOB, describe.blob_words as usize)?;
        let mut bytes = vec![0; words.len() * 4];
        wire::words_to_bytes(&words, &mut bytes);
        Identity::new(describe, bytes)
            .map_err(|error| ClientError::Blob(self.address.clone(), error))
    }

    /// Refuses a board that would never arm.
    pub fn check(&self, identity: &Identity) -> Result<(), ClientError> {
        let describe = &identity.describe;
        if describe.abi_firmware != describe.abi_gateware
            || describe.obstacles & describe::OBSTACLE_ABI != 0
        {
            return Err(ClientError::Abi {
                address: self.address.clone(),
                firmware: describe.abi_firmware,
                gateware: describe.abi_gateware,
            });
        }
        if describe.obstacles & describe::OBSTACLE_PINS != 0 {
            return Err(ClientError::Pins(self.address.clone()));
        }
        Ok(())
    }

    /// Takes the session; its token and the sequence number the board has seen last. With a key,
    /// every one the board may have is tried in turn.
    pub fn acquire(&mut self) -> Result<Session, ClientError> {
        let (locked, uid) = self.locked()?;
        self.key = None;
        if !locked {
            return self.acquire_as(None);
        }
        let found = self.keys.find(uid).map_err(|error| self.no_key(error))?;
        for (key, path) in &found {
            match self.acquire_as(Some((*key, path))) {
                Err(ClientError::Key(_, KeyError::Wrong(_))) => {}
                Ok(session) => {
                    self.keys.accepted(uid, path);
                    return Ok(session);
                }
                Err(error) => return Err(error),
            }
        }
        let tried = found.into_iter().map(|(_, path)| path).collect();
        Err(self.no_key(KeyError::Wrong(tried)))
    }

    /// The same with this key, or without any.
    fn acquire_as(&mut self, with: Option<(Key, &Path)>) -> Result<Session, ClientError> {
        let before = Instant::now();
        self.key = with.map(|(key, _)| key);
        let patience = core::mem::replace(&mut self.patience, TRY * 3);
        let mut wrong = 0;
        let result = loop {
            // A refused acquisition is a dropped datagram. So silence here, together with an answer
            // to the question for the owner, means that another host owns the board.
            let asked = self.ask_for_session();
            if let Ok(words) = &asked
                && let Some(session) = Session::from_words(words)
            {
                break Ok(session);
            }
            let owner = self.read(&[map::SESSION_OWNER_IP, map::SESSION_OWNER_PORT]);
            // The session is free but was not given. Once, the cause may be a challenge that became
            // too old on its way.
            wrong += u32::from(owner.as_deref().is_ok_and(|owner| owner == [0, 0]));
            if let Some((_, path)) = with.filter(|_| wrong > 1) {
                break Err(self.no_key(KeyError::Wrong(vec![path.to_owned()])));
            }
            if before.elapsed() < patience {
                continue;
            }
            break Err(match owner.as_deref() {
                Ok([ip, port]) if *ip != 0 => ClientError::Owned {
                    address: self.address.clone(),
                    owner: Owner(SocketAddrV4::new((*ip).into(), *port as u16), self.local()),
                },
                Ok(_) => ClientError::NoSession(self.address.clone()),
                Err(_) => asked
                    .err()
                    .unwrap_or_else(|| ClientError::NoSession(self.address.clone())),
            });
        };
        self.patience = patience;
        result
    }

    fn no_key(&self, error: KeyError) -> ClientError {
        ClientError::Key(self.address.clone(), error)
    }

    fn ask_for_session(&mut self) -> Result<Vec<u32>, ClientError> {
        let nonce = nonce();
        let Some(key) = self.key else {
            return self.write_then_read(map::SESSION_ACQUIRE, &[nonce], &SESSION_WORDS);
        };
        let challenge = self.read(&CHALLENGE_WORDS)?;
        let challenge = challenge.first_chunk().unwrap_or(&wire::auth::NONE);
        let answer = key.acquire(*challenge, nonce);
        let writes: [(u32, &[u32]); 2] = [
            (map::SESSION_RESPONSE, &answer),
            (map::SESSION_ACQUIRE, &[nonce]),
        ];
        // Only once, because the answer to a used challenge is not valid.
        let patience = core::mem::replace(&mut self.patience, self.every);
        let asked = self.transact(&writes, &SESSION_WORDS);
        self.patience = patience;
        asked
    }

    /// Gives a session back. One datagram: if it is lost the board takes it back in 3 s.
    pub fn release(&mut self, session: &Session) {
        let mut words = [0; 8];
        let request = Request::new(&mut words).write(map::SESSION_RELEASE, &[session.token]);
        if let Some(request) = request.words() {
            let mut bytes = [0; 32];
            let length = wire::words_to_bytes(request, &mut bytes);
            // Without a network there is nothing to do.
            let _ = self.socket.send(&bytes[..length]);
        }
    }

    pub(crate) fn transact(
        &mut self,
        writes: &[(u32, &[u32])],
        reads: &[u32],
    ) -> Result<Vec<u32>, ClientError> {
        self.tag = self.tag.wrapping_add(1);
        let mut words = [0; MAX_WORDS];
        let request = writes
            .iter()
            .fold(Request::new(&mut words), |request, (base, words)| {
                request.write(*base, words)
            });
        let request = request.read(self.tag, reads).words();
        debug_assert!(request.is_some(), "a request beyond one frame");
        let mut bytes = [0; MAX_PAYLOAD];
        let length = wire::words_to_bytes(request.unwrap_or_default(), &mut bytes);

        let start = Instant::now();
        let mut hint = None;
        while start.elapsed() < self.patience {
            match self.socket.send(&bytes[..length]) {
                // Refused is the answer to the try before: keep trying, it may be starting.
                Err(error) if error.kind() != io::ErrorKind::ConnectionRefused => {
                    return Err(ClientError::Socket(self.address.clone(), error));
                }
                Err(error) => hint = Some(error),
                Ok(_) => {}
            }
            let deadline = Instant::now() + self.every;
            match self.answer(self.tag..=self.tag, reads.len(), deadline) {
                Ok(Some((_, words))) => return Ok(words),
                Ok(None) => {}
                Err(error) => {
                    hint = Some(error);
                    std::thread::sleep(self.every);
                }
            }
        }
        Err(ClientError::Silent {
            address: self.address.clone(),
            waited: start.elapsed(),
            hint,
        })
    }

    /// A tag no earlier request had.
    pub fn next_tag(&mut self) -> u32 {
        self.tag = self.tag.wrapping_add(1);
        self.tag
    }

    /// One try of a whole request: the answer's tag, one of these, and its words. For requests that
    /// must not be executed twice.
    pub fn once(
        &self,
        request: &[u32],
        tags: RangeInclusive<u32>,
        count: usize,
    ) -> io::Result<Option<(u32, Vec<u32>)>> {
        let mut bytes = [0; MAX_PAYLOAD];
        let length = wire::words_to_bytes(request, &mut bytes);
        self.socket.send(&bytes[..length])?;
        self.answer(tags, count, Instant::now() + self.every)
    }

    /// Waits once more for the answer to what was sent with one of these tags.
    pub fn wait(
        &self,
        tags: RangeInclusive<u32>,
        count: usize,
    ) -> io::Result<Option<(u32, Vec<u32>)>> {
        self.answer(tags, count, Instant::now() + self.every)
    }

    fn answer(
        &self,
        tags: RangeInclusive<u32>,
        count: usize,
        deadline: Instant,
    ) -> io::Result<Option<(u32, Vec<u32>)>> {
        let mut bytes = [0; MAX_PAYLOAD];
        let mut words = [0; MAX_WORDS];
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Ok(None);
            }
            self.socket.set_read_timeout(Some(left))?;
            let length = match self.socket.recv(&mut bytes) {
                Ok(length) => length,
                Err(error)
                    if matches!(
                        error.kind(),
                        io::ErrorKind::WouldBlock
                            | io::ErrorKind::TimedOut
                            | io::ErrorKind::Interrupted
                    ) =>
                {
                    continue;
                }
                Err(error) => return Err(error),
            };
            if let Some(answer) = wire::words_from_bytes(&bytes[..length], &mut words)
                .ok()
                .and_then(|words| single_record(words))
                && tags.contains(&answer.0)
                && answer.1.len() == count
            {
                return Ok(Some((answer.0, answer.1.to_vec())));
            }
        }
    }
}

/// Base and words of a datagram that is one write record, as every answer is.
pub(crate) fn single_record(words: &[u32]) -> Option<(u32, &[u32])> {
    let packet = Packet::new_checked(words).ok()?;
    let mut records = packet.records();
    match (records.next(), records.next()) {
        (Some(record), None) => Some((record.write_base, record.writes)),
        _ => None,
    }
}

/// What [`Session::from_words`] understands, in this order.
pub(crate) const SESSION_WORDS: [u32; 8] = [
    map::SESSION_TOKEN,
    map::SESSION_LAST_SEQ,
    describe::address(describe::WIRE_VERSION_AT),
    describe::address(describe::CHANNELS_AT),
    describe::address(describe::CHANNELS_AT + 1),
    describe::address(describe::BOOT_ID_AT),
    describe::address(describe::RESET_REASON_AT),
    describe::address(describe::GATE_CLOSE_AT),
];

/// The describe block's features.
const FEATURES: u32 = describe::address(describe::FEATURES_AT);

/// A challenge.
pub(crate) const CHALLENGE_WORDS: [u32; wire::auth::WORDS] = [
    map::SESSION_CHALLENGE,
    map::SESSION_CHALLENGE + 4,
    map::SESSION_CHALLENGE + 8,
    map::SESSION_CHALLENGE + 12,
];

/// A session just taken, and what is needed to know that the board is still the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Session {
    /// Goes into every command.
    pub token: u32,
    /// The last sequence number the board accepted.
    pub last_sequence: u32,
    /// The board's wire version.
    pub wire_version: u32,
    /// The board's channel words.
    pub channels: [u32; 2],
    /// The firmware's boot id.
    pub boot_id: u32,
    /// Code of a [`wire::ResetReason`].
    pub reset_reason: u32,
    /// Code of a [`wire::GateClose`].
    pub gate_close: u32,
}

impl Session {
    pub(crate) fn from_words(words: &[u32]) -> Option<Session> {
        match *words {
            [
                token,
                last_sequence,
                wire_version,
                channels0,
                channels1,
                boot_id,
                reset_reason,
                gate_close,
            ] if token != 0 => Some(Session {
                token,
                last_sequence,
                wire_version,
                channels: [channels0, channels1],
                boot_id,
                reset_reason,
                gate_close,
            }),
            _ => None,
        }
    }
}

/// A number that is never 0 and rarely repeats.
pub fn nonce() -> u32 {
    let now = std::time::SystemTime::now()
        .duration_since(std::time::UNIX_EPOCH)
        .unwrap_or_default();
    (now.subsec_nanos() ^ (now.as_secs() as u32).rotate_left(20) ^ std::process::id()) | 1
}
