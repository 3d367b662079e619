//! A twin in this process, with access to its flash: operations, restarts, and power lost at any
//! step.

use host::keys::Key;
use sim::board_facts::BoardFacts;
use sim::model_board::Setup;
use sim::nor::spi::Shared;
use sim::nor::{Cut, Nor};
use sim::plant::Plant;
use sim::server::{Device, Service};
use sim::twin::Twin;
use wire::auth::WORDS;
use wire::describe::{self, Channels, FEATURE_KEY};
use wire::discovery::{Body, Message, WORDS_MAX};
use wire::etherbone::{HEADER, record};
use wire::exchange::{Command, Status};
use wire::flash::{BLOCK, Op, OpResult, OpWord, PAGE, Slot};
use wire::map;
use wire::settings::{self, Settings};

use crate::{flash, to_bytes, to_words};

/// The tester's port.
const PORT: u16 = 40_000;
/// Milliseconds of board time after which an operation is stuck: 64 KiB are erased in 2 s at worst,
/// an image summed in less.
const STUCK_MS: u64 = 20_000;

/// The key of the boards that have one.
pub const KEY: [u32; WORDS] = [1, 2, 3, 4];

/// The result of an operation of the flash.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Went {
    /// To its end.
    Done(OpResult),
    /// The datagram was not taken.
    Refused,
    /// The power failed.
    Dark,
}

impl Went {
    /// As asked.
    pub const OK: Went = Went::Done(OpResult::Ok);
}

/// A board that is on.
#[derive(Debug)]
pub struct Bench {
    twin: Twin,
    flash: Shared,
    /// The port of the client.
    port: u16,
    command: Command,
}

impl Bench {
    /// The board of these tests, with this flash; on.
    pub fn new(nor: Nor) -> Self {
        Self::start(Shared::new(nor), false)
    }

    fn start(flash: Shared, factory: bool) -> Self {
        let facts = BoardFacts::named(flash::CONFIGURATION).expect("a committed board");
        let mut setup = Setup::new(facts, Plant::default());
        setup.flash = flash.clone();
        setup.factory = factory;
        let mut bench = Bench {
            twin: Twin::power_up(setup),
            flash,
            port: PORT,
            command: Command::default(),
        };
        // The operations of the flash at start are over.
        bench.pass(20);
        bench
    }

    /// Power is off and on again.
    pub fn power_cycle(self) -> Self {
        Self::start(self.flash, false)
    }

    /// The same with the factory pin held.
    pub fn power_cycle_with_factory_pin(self) -> Self {
        Self::start(self.flash, true)
    }

    /// Lets the power fail there.
    pub fn cut_at(&mut self, cut: Cut) {
        self.flash.chip().cut_at(cut);
    }

    /// The flash as it stands.
    pub fn nor(&self) -> std::sync::MutexGuard<'_, Nor> {
        self.flash.chip()
    }

    /// The pins, and what is wired to them.
    pub fn environment(&mut self) -> &mut sim::environment::PinEnvironment {
        self.twin.environment_mut()
    }

    /// Milliseconds of board time.
    pub fn pass(&mut self, milliseconds: u64) {
        let end = self.twin.clock() + milliseconds * self.twin.clockwork().sys_hz / 1000;
        while self.twin.clock() < end && !self.flash.chip().dead() {
            self.twin.pass(end);
        }
    }

    fn post(&mut self, service: Service, words: &[u32]) -> Option<Vec<u32>> {
        self.twin.take_replies();
        self.twin.post(self.port, service, &to_bytes(words));
        let end = self.twin.clock() + 3_000;
        while self.twin.clock() < end && !self.twin.pass(end) {}
        let reply = self.twin.take_replies().pop()?;
        Some(to_words(&reply.payload))
    }

    /// One datagram: these writes in order, then these reads.
    pub fn transact(&mut self, writes: &[(u32, &[u32])], reads: &[u32]) -> Option<Vec<u32>> {
        let mut words = vec![HEADER, 0];
        for (base, data) in writes {
            words.extend([record(data.len(), 0), *base]);
            words.extend(*data);
        }
        words.extend([record(0, reads.len()), 0]);
        words.extend(reads);
        let reply = self.post(Service::Etherbone, &words)?;
        // Records without reads are answered by nothing.
        let read = reply.get(reply.len().checked_sub(reads.len())?..)?;
        Some(read.to_vec())
    }

    /// Reads a word.
    pub fn read(&mut self, address: u32) -> u32 {
        let words = self.transact(&[], &[address]);
        words.unwrap_or_else(|| panic!("no answer to a read of {address:#x}"))[0]
    }

    /// Reads words one after the other.
    pub fn read_block(&mut self, base: u32, count: u32) -> Vec<u32> {
        let addresses: Vec<u32> = (0..count).map(|n| base + 4 * n).collect();
        let words = self.transact(&[], &addresses);
        words.unwrap_or_else(|| panic!("no answer to a read of {base:#x}"))
    }

    /// Writes a word, whether it is taken or not.
    pub fn write(&mut self, address: u32, value: u32) {
        self.transact(&[(address, &[value])], &[map::DESCRIBE]);
    }

    /// Starts an operation and waits for its end; on a board with a key as the owner, after the
    /// answer to a challenge.
    pub fn op(&mut self, op: Op, address: u32, length: u32, buffer: &[u32]) -> Went {
        if self.read(describe::address(describe::FEATURES_AT)) & FEATURE_KEY != 0
            && self.read(map::SESSION_OWNER_PORT) != u32::from(self.port)
        {
            self.show_key();
        }
        self.unproven_op(op, address, length, buffer)
    }

    /// Acquires with [`KEY`].
    fn show_key(&mut self) {
        const NONCE: u32 = 0x1234_5678;
        let challenge = self.read_block(map::SESSION_CHALLENGE, WORDS as u32);
        let challenge = challenge.try_into().expect("as many as asked for");
        let answer = Key::new(KEY)
            .expect("not all zeros")
            .acquire(challenge, NONCE);
        let taken = self.transact(
            &[
                (map::SESSION_RESPONSE, &answer),
                (map::SESSION_ACQUIRE, &[NONCE]),
            ],
            &[map::SESSION_TOKEN],
        );
        assert!(taken.is_some(), "the board's key is another than was saved");
    }

    fn unproven_op(&mut self, op: Op, address: u32, length: u32, buffer: &[u32]) -> Went {
        let operands = [address, length];
        let code = [op.code()];
        let mut writes: Vec<(u32, &[u32])> = vec![(map::FLASH_ADDRESS, &operands)];
        if !buffer.is_empty() {
            writes.push((map::FLASH_BUFFER, buffer));
        }
        writes.push((map::FLASH_OP, &code));
        let taken = self.transact(&writes, &[map::FLASH_OP]);
        if self.flash.chip().dead() {
            return Went::Dark;
        }
        if taken.is_none() {
            return Went::Refused;
        }
        for _ in 0..STUCK_MS {
            let word = OpWord::from_word(self.read(map::FLASH_OP)).expect("an operation word");
            if self.flash.chip().dead() {
                return Went::Dark;
            }
            assert_eq!(word.op, Some(op), "another operation than was asked for");
            if !word.busy {
                return Went::Done(word.result);
            }
            self.pass(1);
        }
        panic!("{op} is stuck");
    }

    /// Programs bytes, at most a page.
    pub fn program(&mut self, at: u32, bytes: &[u8]) -> Went {
        self.op(Op::Program, at, bytes.len() as u32, &packed(bytes))
    }

    /// Bytes by the `Read` operation.
    pub fn read_flash(&mut self, at: u32, length: u32) -> Vec<u8> {
        assert_eq!(self.op(Op::Read, at, length, &[]), Went::OK);
        let words = self.read_block(map::FLASH_BUFFER, length.div_ceil(4));
        let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_be_bytes()).collect();
        bytes[..length as usize].to_vec()
    }

    /// The settings in force.
    pub fn settings(&mut self) -> Settings {
        let words = self.read_block(map::FLASH_SETTINGS, settings::WORDS as u32);
        let words = words.first_chunk().expect("as many as asked for");
        Settings::parse(words).unwrap_or_else(|error| panic!("settings in force: {error}"))
    }

    /// Saves settings.
    pub fn save(&mut self, settings: &Settings) -> Went {
        self.op(Op::SaveSettings, 0, 0, &settings.to_words())
    }

    /// Selects a slot.
    pub fn select(&mut self, slot: Slot) -> Went {
        self.op(Op::Select, slot.code(), 0, &[])
    }

    /// Which slot the board says is selected.
    pub fn selected(&mut self) -> Option<Slot> {
        Slot::from_code(self.read(map::FLASH_SELECTED))
    }

    /// An operation, asked for by another client.
    pub fn op_from_a_stranger(&mut self, op: Op) -> Went {
        self.port = PORT + 1;
        let went = self.unproven_op(op, 0, 0, &[]);
        self.port = PORT;
        went
    }

    /// Acquires, so that others may not.
    pub fn acquire(&mut self) {
        self.write(map::SESSION_ACQUIRE, 0x1234_5678);
        self.command.token = self.read(map::SESSION_TOKEN);
        self.command.sequence = self.read(map::SESSION_LAST_SEQ);
    }

    /// The command of the next exchange.
    pub fn command(&mut self) -> &mut Command {
        &mut self.command
    }

    /// The board's clock, Hz.
    pub fn clock_hz(&self) -> f64 {
        self.twin.clockwork().sys_hz as f64
    }

    /// One servo period.
    pub fn exchange(&mut self) -> Status {
        self.command.sequence = self.command.sequence.wrapping_add(1);
        let channels = self.channels();
        let mut buffer = [0; wire::MAX_WORDS];
        let request = self.command.emit_request(channels, &mut buffer);
        let request = request.expect("room for the request").to_vec();
        let reply = self.post(Service::Etherbone, &request);
        let reply = reply.expect("an answer to the exchange");
        self.pass(1);
        Status::parse_reply(&reply, channels).unwrap_or_else(|error| panic!("{error}"))
    }

    fn channels(&self) -> Channels {
        BoardFacts::named(flash::CONFIGURATION)
            .expect("a committed board")
            .channels
    }

    /// Acquires and arms; nothing moves.
    pub fn arm(&mut self) {
        self.acquire();
        self.command.enable = true;
        for request in [false, false, true, true, true] {
            self.command.enable_request = request;
            self.exchange();
        }
        assert!(self.exchange().state.enabled, "arming failed");
    }

    /// A broadcast message, and the answer to it.
    pub fn discover(&mut self, message: &Message) -> Option<Message> {
        let mut buffer = [0; WORDS_MAX];
        let words = message.emit(&mut buffer).to_vec();
        // A Set is answered when it is saved.
        let mut reply = self.post(Service::Discovery, &words);
        for _ in 0..500 {
            if reply.is_some() || self.flash.chip().dead() {
                break;
            }
            self.pass(1);
            let came = self.twin.take_replies().pop();
            reply = came.map(|came| {
                let words = came.payload.as_chunks::<4>().0.iter();
                words.map(|word| u32::from_be_bytes(*word)).collect()
            });
        }
        let reply = reply?;
        Some(Message::parse(&reply).unwrap_or_else(|why| panic!("{reply:x?}: {why}")))
    }

    /// The answer to a discovery message for all boards.
    pub fn present(&mut self) -> Message {
        let ask = Message {
            nonce: 77,
            uid: [0, 0],
            body: Body::Discover,
        };
        self.discover(&ask).expect("a board answers")
    }

    /// The whole of an update, in the order of `ferrocnc update`; ends where it is not done. `None`
    /// when it was.
    pub fn update(&mut self, build: u32, frames: u16) -> Option<Went> {
        self.bring(build, &flash::image(build, frames))
    }

    /// The same with this image.
    pub fn bring(&mut self, build: u32, image: &[u8]) -> Option<Went> {
        let slot = match self.selected() {
            Some(slot) => slot.other(),
            None => Slot::A,
        };
        let area = flash::layout(&self.nor()).slot(slot);
        let mut steps = vec![(Op::EraseSector, area.meta(), 0, vec![])];
        for (n, block) in (0..).zip(image.chunks(BLOCK as usize)) {
            let at = area.start + n * BLOCK;
            steps.push((Op::EraseBlock, at, 0, vec![]));
            for (n, page) in (0..).zip(block.chunks(PAGE as usize)) {
                steps.push((Op::Program, at + n * PAGE, page.len() as u32, packed(page)));
            }
            steps.push((Op::Crc, at, block.len() as u32, vec![]));
        }
        let page = flash::meta(image, build).to_page();
        steps.push((Op::Program, area.meta(), PAGE, packed(&page)));
        steps.push((Op::Select, slot.code(), 0, vec![]));
        for (op, address, length, buffer) in steps {
            let went = self.op(op, address, length, &buffer);
            if went != Went::OK {
                return Some(went);
            }
        }
        None
    }
}

/// Bytes as words, padded as an erased page.
pub fn packed(bytes: &[u8]) -> Vec<u32> {
    let mut bytes = bytes.to_vec();
    bytes.resize(bytes.len().next_multiple_of(4), 0xff);
    let chunks = bytes.as_chunks::<4>().0.iter();
    chunks.map(|chunk| u32::from_be_bytes(*chunk)).collect()
}
