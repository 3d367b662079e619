//! A host that owns a board through a real socket and keeps it armed, as LinuxCNC does.

use std::net::{SocketAddr, UdpSocket};
use std::time::Duration;

use wire::describe::{self, Channels};
use wire::etherbone::{HEADER, record};
use wire::exchange::{Command, Status};
use wire::map;

use sim::board_facts::BoardFacts;

/// The host.
#[derive(Debug)]
pub struct Driver {
    socket: UdpSocket,
    channels: Channels,
    command: Command,
}

impl Driver {
    /// Acquires and arms the board at this address; nothing moves.
    pub fn armed(board: SocketAddr) -> Self {
        let socket = UdpSocket::bind("0.0.0.0:0").expect("a socket");
        // 5 s: a busy machine, not a slow board.
        let set = socket.set_read_timeout(Some(Duration::from_secs(5)));
        set.and_then(|()| socket.connect(board))
            .expect("a connected socket");
        let mut driver = Driver {
            socket,
            channels: BoardFacts::named("mill6")
                .expect("a committed board")
                .channels,
            command: Command::default(),
        };
        let write = |address, value| [HEADER, 0, record(1, 0), address, value];
        driver.send(&write(map::SESSION_ACQUIRE, 0x1234_5678));
        driver.command.token = driver.read(map::SESSION_TOKEN);
        driver.command.sequence = driver.read(map::SESSION_LAST_SEQ);
        // A second: enough for a busy computer to come back here.
        let second = driver.read(describe::address(describe::CLOCK_HZ_AT));
        driver.send(&write(map::CONFIG_BOARD, second));
        driver.command.enable = true;
        for request in [false, false, true, true, true] {
            driver.command.enable_request = request;
            driver.exchange();
            std::thread::sleep(Duration::from_millis(2));
        }
        assert!(driver.exchange().state.enabled, "arming failed");
        driver
    }

    fn send(&self, words: &[u32]) {
        let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_be_bytes()).collect();
        self.socket.send(&bytes).expect("sent");
    }

    fn ask(&self, words: &[u32]) -> Vec<u32> {
        self.send(words);
        let mut buffer = [0; 2048];
        let length = self.socket.recv(&mut buffer).expect("an answer");
        let words = buffer[..length].as_chunks::<4>().0.iter();
        words.map(|word| u32::from_be_bytes(*word)).collect()
    }

    fn read(&self, address: u32) -> u32 {
        self.ask(&[HEADER, 0, record(0, 1), 0, address])[4]
    }

    /// One exchange.
    pub fn exchange(&mut self) -> Status {
        self.command.sequence = self.command.sequence.wrapping_add(1);
        let mut buffer = [0; wire::MAX_WORDS];
        let request = self.command.emit_request(self.channels, &mut buffer);
        let reply = self.ask(request.expect("room for the request"));
        Status::parse_reply(&reply, self.channels).unwrap_or_else(|error| panic!("{error}"))
    }
}
