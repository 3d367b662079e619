//! The fake board's flash, and its discovery port.
//!
//! The flash programs by clearing bits, erases whole sectors, and executes the operations of the
//! protocol. It has no stubs; the selected slot is a variable.
#![allow(dead_code)]

use ferrocnc::keys::Key;
use std::net::{SocketAddr, SocketAddrV4, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;
use wire::board::crc32;
use wire::discovery::{Body, Here, Message, WORDS_MAX};
use wire::flash::{
    BLOCK, Layout, LinkWord, Op, OpResult, OpWord, Origin, PAGE, Running, SECTOR, Slot,
};
use wire::images::Meta;
use wire::pins::Loaded;
use wire::settings::{self, Settings, mac_of_uid};
use wire::{LinkSpeed, MAX_PAYLOAD, MAX_WORDS, Name, map};

/// A 2 MiB flash; 4 MiB would only take longer.
pub const SIZE: u32 = 0x20_0000;

/// A flash and what the firmware makes of it.
#[derive(Clone, Debug)]
pub struct FakeFlash {
    pub uid: [u32; 2],
    pub jedec: u32,
    pub bytes: Vec<u8>,
    pub selected: Option<Slot>,
    pub running: Running,
    pub build_id: u32,
    pub protected: bool,
    pub settings: Settings,
    pub origin: Origin,
    /// What became of the configuration of the pins, if they are configured.
    pub pins: Option<Loaded>,
    /// Every operation done, in order.
    pub done: Vec<(Op, u32)>,
    /// An operation is seen running so many times.
    pub looks: u32,
    /// The cable is out from the datagram with the next save on, which is lost.
    pub lose_save: bool,
    /// Fall silent after so many more operations.
    pub silent_after: Option<u32>,
    /// Flip a bit of this byte whenever it is programmed.
    pub weak: Option<u32>,
    /// Answer this to a save, and save nothing.
    pub refuse: Option<OpResult>,
    left: u32,
    word: OpWord,
    address: u32,
    length: u32,
    crc: u32,
    buffer: [u32; 64],
}

impl Default for FakeFlash {
    fn default() -> Self {
        FakeFlash {
            uid: [0xd162_0c8a, 0x1b2c_3d4e],
            jedec: 0xef_4015,
            bytes: vec![0xff; SIZE as usize],
            selected: None,
            running: Running::Volatile,
            build_id: 0x0b1d_0000,
            protected: true,
            settings: Settings::default(),
            origin: Origin::BuiltIn,
            pins: None,
            done: Vec::new(),
            looks: 1,
            lose_save: false,
            silent_after: None,
            weak: None,
            refuse: None,
            left: 0,
            word: OpWord::IDLE,
            address: 0,
            length: 0,
            crc: 0,
            buffer: [0; 64],
        }
    }
}

impl FakeFlash {
    pub fn layout(&self) -> Layout {
        Layout::of(self.bytes.len() as u32).unwrap()
    }

    /// An image in a slot, as the first flash has it.
    pub fn put(&mut self, area: wire::flash::Area, image: &ferrocnc::image::Image) {
        let start = area.start as usize;
        self.bytes[start..start + image.bytes.len()].copy_from_slice(&image.bytes);
        let meta = area.meta() as usize;
        self.bytes[meta..meta + PAGE as usize].copy_from_slice(&image.meta().to_page());
    }

    /// The slot's image, if it is whole.
    pub fn whole(&self, slot: Slot) -> Option<Meta> {
        let area = self.layout().slot(slot);
        let meta = Meta::from_page(&self.bytes[area.meta() as usize..], area)?;
        let image = &self.bytes[area.start as usize..][..meta.length as usize];
        (crc32(image) == meta.crc).then_some(meta)
    }

    pub fn busy(&self) -> bool {
        self.word.busy
    }

    /// The operation that runs is done now.
    pub fn end(&mut self) {
        if self.word.busy {
            self.finish();
        }
    }

    pub fn count(&self, op: Op) -> usize {
        self.done.iter().filter(|(done, _)| *done == op).count()
    }

    pub fn read(&mut self, address: u32, link: (LinkSpeed, u8)) -> u32 {
        let settings = Settings {
            mac: self.mac(),
            ..self.settings.blanked()
        };
        let settings = settings.to_words();
        match address {
            map::FLASH_OP => {
                let word = self.word.to_word();
                self.left = self.left.saturating_sub(1);
                if self.left == 0 && self.word.busy {
                    self.finish();
                }
                word
            }
            map::FLASH_ADDRESS => self.address,
            map::FLASH_OP_LENGTH => self.length,
            map::FLASH_CRC => self.crc,
            map::FLASH_JEDEC => self.jedec,
            map::FLASH_UID_HI => self.uid[0],
            map::FLASH_UID_LO => self.uid[1],
            map::FLASH_SIZE if self.jedec != 0 => self.bytes.len() as u32,
            map::FLASH_RUNNING => self.running.code(),
            map::FLASH_SELECTED => self.selected.map_or(0, Slot::code),
            map::FLASH_BUILD_ID => self.build_id,
            map::FLASH_ORIGIN => self.origin.code(),
            map::FLASH_LINK => LinkWord {
                speed: link.0,
                full_duplex: true,
                errors: link.1.into(),
            }
            .to_word(),
            map::FLASH_PROTECTED => self.protected.into(),
            map::FLASH_IP => self.settings.ip,
            map::FLASH_BUFFER..map::FLASH_SETTINGS => {
                let at = (address - map::FLASH_BUFFER) as usize / 4;
                self.buffer.get(at).copied().unwrap_or(0)
            }
            _ => {
                let at = address.checked_sub(map::FLASH_SETTINGS);
                let word = at.and_then(|at| settings.get(at as usize / 4));
                word.copied().unwrap_or(0)
            }
        }
    }

    pub fn write(&mut self, address: u32, word: u32) {
        match address {
            map::FLASH_ADDRESS => self.address = word,
            map::FLASH_OP_LENGTH => self.length = word,
            map::FLASH_OP => {
                self.word = OpWord {
                    busy: true,
                    result: OpResult::Busy,
                    op: Op::from_code(word),
                };
                self.left = self.looks;
                // Reading answers at once.
                if self.word.op == Some(Op::Read) || self.looks == 0 {
                    self.finish();
                }
            }
            _ => {
                let at = (address - map::FLASH_BUFFER) as usize / 4;
                if let Some(place) = self.buffer.get_mut(at) {
                    *place = word;
                }
            }
        }
    }

    fn finish(&mut self) {
        let result = match self.word.op {
            Some(op) => {
                self.done.push((op, self.address));
                self.silent_after = self.silent_after.map(|left| left.saturating_sub(1));
                self.perform(op)
            }
            None => OpResult::Value,
        };
        self.word.busy = false;
        self.word.result = result;
    }

    fn perform(&mut self, op: Op) -> OpResult {
        let layout = self.layout();
        let (at, length) = (self.address as usize, self.length as usize);
        let of_pins = |length: u32| {
            let Some(loaded) = self.pins else {
                return false;
            };
            let mut others = (0..2).filter(|copy| loaded.copy != Some(*copy));
            others.any(|copy| layout.pins_copy(copy).contains(self.address, length))
        };
        let may =
            |length: u32| layout.writable(self.selected, self.address, length) || of_pins(length);
        let mut page = [0; PAGE as usize];
        wire::words_to_bytes(&self.buffer, &mut page);
        match op {
            Op::Read | Op::Crc if self.among_settings() => return OpResult::Address,
            Op::Read => {
                let Some(bytes) = self.bytes.get(at..at + length) else {
                    return OpResult::Address;
                };
                let mut page = [0; PAGE as usize];
                page[..length].copy_from_slice(bytes);
                let words = &mut self.buffer;
                let _ = wire::words_from_bytes(&page, words);
            }
            Op::Crc => match self.bytes.get(at..at + length) {
                Some(bytes) => self.crc = crc32(bytes),
                None => return OpResult::Address,
            },
            Op::EraseSector if may(SECTOR) => self.bytes[at..at + SECTOR as usize].fill(0xff),
            Op::EraseBlock if may(BLOCK) => self.bytes[at..at + BLOCK as usize].fill(0xff),
            Op::Program if may(self.length) => {
                for (n, byte) in page[..length].iter().enumerate() {
                    self.bytes[at + n] &= byte;
                }
                if let Some(weak) = self.weak
                    && (at..at + length).contains(&(weak as usize))
                {
                    self.bytes[weak as usize] ^= 1;
                }
            }
            Op::EraseSector | Op::EraseBlock | Op::Program => return OpResult::Address,
            Op::Select => {
                let Some(slot) = Slot::from_code(self.address) else {
                    return OpResult::Value;
                };
                if self.whole(slot).is_none() {
                    return OpResult::Image;
                }
                self.selected = Some(slot);
            }
            Op::SaveSettings if self.refuse.is_some() => {
                return self.refuse.expect("it is there");
            }
            Op::SaveSettings => {
                let words = *self.buffer.first_chunk::<{ settings::WORDS }>().unwrap();
                self.buffer.fill(u32::MAX);
                match Settings::parse(&words) {
                    Ok(settings) => self.save(&settings),
                    Err(_) => return OpResult::Value,
                }
            }
            Op::ForgetSettings => {
                self.settings = Settings::default();
                self.origin = Origin::BuiltIn;
            }
            Op::Protect => self.protected = true,
        }
        OpResult::Ok
    }

    fn among_settings(&self) -> bool {
        let first = self.layout().settings;
        self.address < first + 2 * SECTOR && self.address + self.length > first
    }

    pub fn save(&mut self, settings: &Settings) {
        let key = if settings.keep_key {
            self.settings.key
        } else {
            settings.key
        };
        self.settings = Settings {
            key,
            keep_key: false,
            sequence: self.settings.sequence + 1,
            ..*settings
        };
        self.origin = Origin::Copy0;
    }

    pub fn mac(&self) -> [u8; 6] {
        match self.settings.mac {
            [0, 0, 0, 0, 0, 0] => mac_of_uid(self.uid),
            mac => mac,
        }
    }

    /// Its answer to discovery.
    pub fn here(&self, armed: bool) -> Here {
        Here {
            mac: self.mac(),
            ip: self.settings.ip,
            port: self.settings.port,
            dhcp: self.settings.dhcp,
            armed,
            owned: armed,
            keyed: self.settings.key != wire::auth::NONE,
            running: self.running,
            origin: self.origin,
            speed: LinkSpeed::M1000,
            wire_version: wire::WIRE_VERSION,
            firmware_version: 0x100,
            build_id: self.build_id,
            name: self.settings.name,
            configuration: Name::cut("mill6"),
            platform: Name::cut("5a-75b-8.0"),
        }
    }
}

/// Boards on a segment of their own: every board receives every question, and the answers go to the
/// sender.
pub struct LanSegment {
    pub address: SocketAddrV4,
    boards: Arc<Mutex<Vec<Neighbour>>>,
    stop: Arc<AtomicBool>,
    thread: Option<std::thread::JoinHandle<()>>,
}

/// One of them.
#[derive(Debug, Default)]
pub struct Neighbour {
    pub flash: FakeFlash,
    pub armed: bool,
    /// Answers lost on the way, so many more.
    pub lose: u32,
    /// Settings written so often.
    pub saved: u32,
    /// Challenges given so often.
    pub challenges: u32,
}

impl LanSegment {
    pub fn of(uids: &[[u32; 2]]) -> Self {
        let boards = uids.iter().map(|uid| Neighbour {
            flash: FakeFlash {
                uid: *uid,
                ..FakeFlash::default()
            },
            ..Neighbour::default()
        });
        let boards: Vec<Neighbour> = boards.collect();
        let socket = UdpSocket::bind("127.0.0.1:0").expect("a free UDP port");
        let SocketAddr::V4(address) = socket.local_addr().expect("its address") else {
            panic!("IPv4 only");
        };
        let boards = Arc::new(Mutex::new(boards));
        let stop = Arc::new(AtomicBool::new(false));
        let thread = std::thread::spawn({
            let (boards, stop) = (Arc::clone(&boards), Arc::clone(&stop));
            move || run(&socket, &boards, &stop)
        });
        LanSegment {
            address,
            boards,
            stop,
            thread: Some(thread),
        }
    }

    pub fn look(&self) -> MutexGuard<'_, Vec<Neighbour>> {
        self.boards.lock().expect("the segment's thread is well")
    }
}

impl Drop for LanSegment {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn run(socket: &UdpSocket, boards: &Mutex<Vec<Neighbour>>, stop: &AtomicBool) {
    socket
        .set_read_timeout(Some(Duration::from_millis(20)))
        .expect("a timeout");
    let mut bytes = [0; MAX_PAYLOAD];
    let mut words = [0; MAX_WORDS];
    while !stop.load(Ordering::Relaxed) {
        let Ok((length, from)) = socket.recv_from(&mut bytes) else {
            continue;
        };
        let words_in = wire::words_from_bytes(&bytes[..length], &mut words);
        let Ok(asked) = words_in.and_then(Message::parse) else {
            continue;
        };
        for board in boards.lock().expect("the test is well").iter_mut() {
            let Some(body) = board.answer(&asked, &words[..length / 4]) else {
                continue;
            };
            if board.lose > 0 {
                board.lose -= 1;
                continue;
            }
            let answer = Message {
                nonce: asked.nonce,
                uid: board.flash.uid,
                body,
            };
            let mut words = [0; WORDS_MAX];
            let words = answer.emit(&mut words);
            let mut out = [0; WORDS_MAX * 4];
            let length = wire::words_to_bytes(words, &mut out);
            let _ = socket.send_to(&out[..length], from);
        }
    }
}

impl Neighbour {
    fn answer(&mut self, asked: &Message, words: &[u32]) -> Option<Body> {
        let mine = asked.uid == self.flash.uid;
        if let (true, false, Body::Set(_) | Body::Proven(..)) = (mine, self.armed, asked.body)
            && let Some(key) = Key::new(self.flash.settings.key)
        {
            let right = wire::discovery::proof(words).is_some_and(|(signed, answer)| {
                key.set([self.challenges, 1, 2, 3], signed) == *answer && self.challenges > 0
            });
            self.challenges += 1;
            if !right {
                return Some(Body::Prove([self.challenges, 1, 2, 3]));
            }
        }
        match &asked.body {
            Body::Discover if mine || asked.uid == [0, 0] => {
                Some(Body::Here(self.flash.here(self.armed)))
            }
            Body::Set(_) | Body::Proven(..) if mine && self.armed => {
                Some(Body::Done(OpResult::Armed))
            }
            Body::Set(settings) | Body::Proven(settings, _) if mine => {
                let kept = match settings.keep_key {
                    true => self.flash.settings.key,
                    false => settings.key,
                };
                let same = Settings {
                    sequence: self.flash.settings.sequence,
                    keep_key: false,
                    key: kept,
                    ..*settings
                } == self.flash.settings;
                if !same {
                    self.flash.save(settings);
                    self.saved += 1;
                }
                Some(Body::Done(OpResult::Ok))
            }
            Body::Discover | Body::Here(_) | Body::Set(_) | Body::Done(_) => None,
            Body::Prove(_) | Body::Proven(..) => None,
        }
    }
}
