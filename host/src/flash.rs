//! The board's flash over the network: its contents, and operations that survive a bad cable.
//!
//! A refused datagram is not answered, and a lost one looks the same. So after silence the tool
//! always reads words that every client may read: is the machine armed, does a session own it, did
//! the board take the operation? An operation is sent again until one of these gives the answer;
//! every operation may safely happen twice.

use crate::client::{Client, ClientError, Session};
use std::net::{Ipv4Addr, SocketAddrV4};
use std::time::{Duration, Instant};
use wire::exchange::StateWord;
use wire::flash::{Layout, LinkWord, Op, OpResult, OpWord, Origin, PAGE, Running, Slot};
use wire::settings::{self, Settings, SettingsError};
use wire::{State, describe, map};

/// How long one question is repeated before the tool looks for the cause of the silence: three
/// tries.
const QUESTION: Duration = Duration::from_millis(600);
/// 60 s: time to walk to the machine and plug the cable in again.
pub const PATIENCE: Duration = Duration::from_secs(60);
/// 20 s: the slowest thing a flash does is to erase 64 KiB, 2 s by its data sheet. After this time
/// the chip or the firmware is stuck, unless the patience is longer than three times this: the
/// board may be a simulated one on a busy computer.
const SLOWEST: Duration = Duration::from_secs(20);
/// 5 s in which the board answers but does not take the operation: it refuses.
const REFUSED: Duration = Duration::from_secs(5);
/// Between two looks at a running operation.
const LOOK: Duration = Duration::from_millis(2);

/// What every answer to an operation carries, besides the page.
const LOOKS: [u32; 8] = [
    map::FLASH_OP,
    map::FLASH_ADDRESS,
    map::FLASH_OP_LENGTH,
    map::FLASH_CRC,
    describe::address(describe::STATE_AT),
    map::SESSION_TOKEN,
    map::SESSION_OWNER_IP,
    map::SESSION_OWNER_PORT,
];

/// Why it did not work; it says what to do.
#[derive(Debug)]
pub enum FlashError {
    /// The board does not answer, or the network does not take it.
    Client(ClientError),
    /// It answered for a while, then no more.
    Lost {
        /// The board.
        address: String,
        /// How long it was waited for.
        waited: Duration,
    },
    /// No flash, or one with an unknown layout.
    NoFlash {
        /// Its JEDEC id.
        jedec: u32,
    },
    /// The machine is not at rest.
    Armed(State),
    /// Another host drives the board.
    Owned(SocketAddrV4),
    /// The board answers but does not take the operation.
    Refused(Op),
    /// It takes it and says no.
    Failed {
        /// What was asked.
        op: Op,
        /// Where.
        address: u32,
        /// Its answer.
        result: OpResult,
    },
    /// An operation does not end.
    Stuck(Op),
    /// The board reports a value that this version does not know.
    Nonsense,
    /// The settings in force cannot be read.
    Settings(SettingsError),
}

impl core::fmt::Display for FlashError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            FlashError::Client(error) => write!(f, "{error}"),
            FlashError::Lost { address, waited } => write!(
                f,
                "{address} has not answered for {:.0} s; check cable and power, then give the same command again: it goes on where it stopped",
                waited.as_secs_f64()
            ),
            FlashError::NoFlash { jedec: 0 } => f.write_str(
                "no flash answers on the board; it can be loaded by JTAG only (ferrocnc flash load)",
            ),
            FlashError::NoFlash { jedec } => write!(
                f,
                "the board has a flash of an unknown kind (JEDEC id {jedec:06x}); 2 and 4 MiB ones can be written"
            ),
            FlashError::Armed(state) => write!(
                f,
                "the machine is {state}; switch it off in LinuxCNC (F2), then try again"
            ),
            FlashError::Owned(owner) => write!(
                f,
                "the board is driven by {owner}; stop LinuxCNC there, then try again"
            ),
            FlashError::Refused(op) => write!(
                f,
                "the board answers but refuses to {op}; look at its console (ferrocnc console) for the reason"
            ),
            FlashError::Failed {
                op,
                address,
                result,
            } => write!(f, "cannot {op} at {address:#08x}: {result}"),
            FlashError::Stuck(op) => write!(
                f,
                "the board does not finish \"{op}\"; power it off and on and try again"
            ),
            FlashError::Nonsense => f.write_str(
                "the board's flash window holds a value that this version does not know; update the tool",
            ),
            FlashError::Settings(error) => write!(f, "the board's settings cannot be read: {error}"),
        }
    }
}

impl std::error::Error for FlashError {}

impl From<ClientError> for FlashError {
    fn from(error: ClientError) -> Self {
        FlashError::Client(error)
    }
}

/// What a board says of its flash, its settings and its link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Overview {
    /// JEDEC id, 0 without a flash.
    pub jedec: u32,
    /// Unique id; zeros without.
    pub uid: [u32; 2],
    /// What lies where; `None` if unknown.
    pub layout: Option<Layout>,
    /// Which image runs.
    pub running: Running,
    /// Which loads at the next power-up; `None`: golden.
    pub selected: Option<Slot>,
    /// Of what runs.
    pub build_id: u32,
    /// Where the settings are from.
    pub origin: Origin,
    /// The Ethernet link.
    pub link: LinkWord,
    /// The flash protects the golden image.
    pub protected: bool,
    /// The address in force.
    pub ip: Ipv4Addr,
    /// The settings in force, the key blanked.
    pub settings: Result<Settings, SettingsError>,
}

impl Overview {
    /// Asks the board.
    pub fn read(client: &mut Client) -> Result<Self, FlashError> {
        let head = client.read_from(map::FLASH_JEDEC, 11)?;
        let words = client.read_from(map::FLASH_SETTINGS, settings::WORDS)?;
        let [
            jedec,
            uid_hi,
            uid_lo,
            size,
            running,
            selected,
            build_id,
            origin,
            link,
            protected,
            ip,
        ] = head[..]
        else {
            return Err(FlashError::Nonsense);
        };
        let settings = words.first_chunk().ok_or(FlashError::Nonsense)?;
        let selected = match selected {
            0 => None,
            code => Some(Slot::from_code(code).ok_or(FlashError::Nonsense)?),
        };
        Ok(Overview {
            jedec,
            uid: [uid_hi, uid_lo],
            layout: Layout::of(size),
            running: Running::from_code(running).ok_or(FlashError::Nonsense)?,
            selected,
            build_id,
            origin: Origin::from_code(origin).ok_or(FlashError::Nonsense)?,
            link: LinkWord::from_word(link),
            protected: protected != 0,
            ip: ip.into(),
            settings: Settings::parse(settings),
        })
    }
}

/// What is said while it goes on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Word {
    /// The board has stopped answering; it is waited for.
    Silent(Duration),
    /// It answers again.
    Back,
}

/// The result of an operation.
#[derive(Clone, Copy, Debug)]
struct Answer {
    word: OpWord,
    address: u32,
    length: u32,
    crc: u32,
    state: StateWord,
    yours: bool,
    owner: Option<SocketAddrV4>,
    page: [u32; map::FLASH_BUFFER_WORDS as usize],
}

/// Operations on one board's flash.
pub struct Flasher<'t> {
    client: Client,
    patience: Duration,
    tell: Box<dyn FnMut(Word) + 't>,
    /// When the board answered last, and whether its silence was told.
    heard: Instant,
    silent: bool,
    /// The session, which a board with a key needs before it takes an operation.
    session: Option<Session>,
}

impl Drop for Flasher<'_> {
    fn drop(&mut self) {
        if let Some(session) = &self.session {
            self.client.release(session);
        }
    }
}

impl<'t> Flasher<'t> {
    /// Over this client; silence and its end are told to `tell`.
    pub fn new(client: Client, patience: Duration, tell: impl FnMut(Word) + 't) -> Self {
        Flasher {
            client: client.with_patience(QUESTION.min(patience)),
            patience,
            tell: Box::new(tell),
            heard: Instant::now(),
            silent: false,
            session: None,
        }
    }

    /// Takes the session of a board with a key: operations are its owner's alone.
    fn unlock(&mut self) -> Result<(), FlashError> {
        if let (true, _) = self.client.locked()? {
            self.session = Some(self.client.acquire()?);
        }
        Ok(())
    }

    /// The client, for everything else.
    pub fn client(&mut self) -> &mut Client {
        &mut self.client
    }

    /// Reads at most a page's bytes.
    pub fn read(&mut self, address: u32, length: u32) -> Result<Vec<u8>, FlashError> {
        let answer = self.operate(Op::Read, address, length, None)?;
        let mut bytes = vec![0; PAGE as usize];
        wire::words_to_bytes(&answer.page, &mut bytes);
        bytes.truncate(length as usize);
        Ok(bytes)
    }

    /// The CRC of bytes in flash, counted by the board.
    pub fn crc(&mut self, address: u32, length: u32) -> Result<u32, FlashError> {
        Ok(self.operate(Op::Crc, address, length, None)?.crc)
    }

    /// Erases a sector.
    pub fn erase_sector(&mut self, address: u32) -> Result<(), FlashError> {
        self.operate(Op::EraseSector, address, 0, None).map(|_| ())
    }

    /// Erases 64 KiB.
    pub fn erase_block(&mut self, address: u32) -> Result<(), FlashError> {
        self.operate(Op::EraseBlock, address, 0, None).map(|_| ())
    }

    /// Programs at most a page.
    pub fn program(&mut self, address: u32, bytes: &[u8]) -> Result<(), FlashError> {
        self.operate(Op::Program, address, bytes.len() as u32, Some(bytes))
            .map(|_| ())
    }

    /// From the next power-up on this slot loads.
    pub fn select(&mut self, slot: Slot) -> Result<(), FlashError> {
        self.operate(Op::Select, slot.code(), 0, None).map(|_| ())
    }

    /// Saves settings; in force after the next start.
    pub fn save(&mut self, settings: &Settings) -> Result<(), FlashError> {
        let mut bytes = [0; settings::WORDS * 4];
        wire::words_to_bytes(&settings.to_words(), &mut bytes);
        self.operate(Op::SaveSettings, 0, 0, Some(&bytes))
            .map(|_| ())
    }

    /// Forgets all saved settings.
    pub fn forget(&mut self) -> Result<(), FlashError> {
        self.operate(Op::ForgetSettings, 0, 0, None).map(|_| ())
    }

    /// Has the flash protect the golden image.
    pub fn protect(&mut self) -> Result<(), FlashError> {
        self.operate(Op::Protect, 0, 0, None).map(|_| ())
    }

    /// Has the firmware restart. There is no answer, because the board restarts.
    pub fn restart(&mut self) {
        // Silence is what a restart looks like.
        let _ = self.client.transact(
            &[(map::SESSION_REBOOT, &[map::REBOOT_KEY])],
            &[map::FLASH_OP],
        );
    }

    fn operate(
        &mut self,
        op: Op,
        address: u32,
        length: u32,
        page: Option<&[u8]>,
    ) -> Result<Answer, FlashError> {
        let mut words = Vec::new();
        if let Some(bytes) = page {
            let mut padded = bytes.to_vec();
            padded.resize(bytes.len().next_multiple_of(4), 0xff);
            let (chunks, _) = padded.as_chunks::<4>();
            words.extend(chunks.iter().map(|chunk| u32::from_be_bytes(*chunk)));
        }
        let operands = [address, length];
        let code = [op.code()];
        let mut writes: Vec<(u32, &[u32])> = vec![(map::FLASH_ADDRESS, &operands)];
        if !words.is_empty() {
            writes.push((map::FLASH_BUFFER, &words));
        }
        writes.push((map::FLASH_OP, &code));
        let reads = reads(op);
        let mine = |answer: &Answer| {
            answer.word.op == Some(op) && answer.address == address && answer.length == length
        };
        self.heard = Instant::now();
        let asked = Instant::now();
        loop {
            // Taken, or refused, or lost.
            let mut answer = match self.ask(&writes, &reads)? {
                Some(answer) => answer,
                None => {
                    let Some(answer) = self.ask(&[], &reads)? else {
                        continue;
                    };
                    self.may(&answer)?;
                    if !mine(&answer) {
                        // After a long silence the board has ended the session.
                        if answer.owner.is_none() {
                            self.unlock()?;
                        }
                        if asked.elapsed() > REFUSED {
                            return Err(FlashError::Refused(op));
                        }
                        continue;
                    }
                    answer
                }
            };
            let began = Instant::now();
            while answer.word.busy && mine(&answer) {
                if began.elapsed() > SLOWEST.max(self.patience / 3) {
                    return Err(FlashError::Stuck(op));
                }
                std::thread::sleep(LOOK);
                match self.ask(&[], &reads)? {
                    Some(next) => answer = next,
                    None => continue,
                }
            }
            // The board has restarted and does not know the operation.
            if !mine(&answer) {
                continue;
            }
            return match answer.word.result {
                OpResult::Ok => Ok(answer),
                OpResult::Armed => Err(FlashError::Armed(answer.state.state)),
                OpResult::NoFlash => Err(FlashError::NoFlash { jedec: 0 }),
                result @ (OpResult::Busy
                | OpResult::Address
                | OpResult::Value
                | OpResult::Flash
                | OpResult::Image
                | OpResult::NoDhcp) => Err(FlashError::Failed {
                    op,
                    address,
                    result,
                }),
            };
        }
    }

    /// Refuses a board that would not take any operation now.
    pub fn may_write(&mut self) -> Result<(), FlashError> {
        self.heard = Instant::now();
        loop {
            if let Some(answer) = self.ask(&[], &LOOKS)? {
                self.may(&answer)?;
                return self.unlock();
            }
        }
    }

    fn may(&self, answer: &Answer) -> Result<(), FlashError> {
        match answer.state.state {
            State::Armed | State::Stopping => return Err(FlashError::Armed(answer.state.state)),
            State::Boot | State::Disarmed | State::Faulted => {}
        }
        match answer.owner {
            Some(owner) if !answer.yours => Err(FlashError::Owned(owner)),
            Some(_) | None => Ok(()),
        }
    }

    /// One question; `None` without an answer, an error if there was none for too long.
    fn ask(
        &mut self,
        writes: &[(u32, &[u32])],
        reads: &[u32],
    ) -> Result<Option<Answer>, FlashError> {
        match self.client.transact(writes, reads) {
            Ok(words) => {
                self.heard = Instant::now();
                if core::mem::take(&mut self.silent) {
                    (self.tell)(Word::Back);
                }
                Answer::from_words(&words).map(Some)
            }
            // Without a cable this computer may refuse to send; that counts as silence, too.
            Err(ClientError::Silent { .. } | ClientError::Socket(..)) => {
                if self.heard.elapsed() > self.patience {
                    return Err(FlashError::Lost {
                        address: self.client.address().to_string(),
                        waited: self.heard.elapsed(),
                    });
                }
                // A refused operation is silent, too: three questions without an answer are not.
                if !self.silent && self.heard.elapsed() > QUESTION * 3 {
                    self.silent = true;
                    (self.tell)(Word::Silent(self.patience));
                }
                std::thread::sleep(LOOK);
                Ok(None)
            }
            Err(error) => Err(error.into()),
        }
    }
}

/// What is read with every question about this operation.
fn reads(op: Op) -> Vec<u32> {
    let mut reads = LOOKS.to_vec();
    if op == Op::Read {
        reads.extend((0..map::FLASH_BUFFER_WORDS).map(|n| map::FLASH_BUFFER + 4 * n));
    }
    reads
}

impl Answer {
    fn from_words(words: &[u32]) -> Result<Answer, FlashError> {
        let Some((&[op, address, length, crc, state, token, ip, port], rest)) =
            words.split_first_chunk::<{ LOOKS.len() }>()
        else {
            return Err(FlashError::Nonsense);
        };
        let mut page = [0; map::FLASH_BUFFER_WORDS as usize];
        for (place, word) in page.iter_mut().zip(rest) {
            *place = *word;
        }
        Ok(Answer {
            word: OpWord::from_word(op).ok_or(FlashError::Nonsense)?,
            address,
            length,
            crc,
            state: StateWord::from_word(state).map_err(|_| FlashError::Nonsense)?,
            yours: token != 0,
            owner: (ip != 0).then(|| SocketAddrV4::new(ip.into(), port as u16)),
            page,
        })
    }
}
