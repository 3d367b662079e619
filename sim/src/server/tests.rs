use super::*;
use crate::board::Board;
use crate::plant::Plant;
use crate::rig::Rig;
use crate::soc::{ETH, Pins, SYS, Silicon};

/// Silicon that answers every UDP frame as a board would: addresses and ports exchanged, the
/// payload echoed. It stores the frame and sends the answer when the frame has ended.
#[derive(Default)]
struct Echo {
    incoming: Vec<u8>,
    outgoing: Vec<u8>,
    at: usize,
}

impl Echo {
    fn answer(wire: &[u8]) -> Vec<u8> {
        let Ok(frame) = crate::gmii::decode(wire) else {
            return vec![];
        };
        let mut frame = frame.to_vec();
        match (frame[12], frame[13]) {
            (8, 6) if frame[21] == 1 => {
                // ARP: a reply from 10:e2:d5:00:00:01.
                frame[21] = 2;
                let asked: [u8; 20] = frame[22..42].try_into().unwrap();
                frame[32..42].copy_from_slice(&asked[..10]);
                frame[22..28].copy_from_slice(&[0x10, 0xe2, 0xd5, 0, 0, 1]);
                frame[28..32].copy_from_slice(&asked[16..]);
            }
            (8, 0) if frame[23] == 17 => {
                let (src, dst): ([u8; 4], [u8; 4]) = (
                    frame[26..30].try_into().unwrap(),
                    frame[30..34].try_into().unwrap(),
                );
                frame[26..30].copy_from_slice(&dst);
                frame[30..34].copy_from_slice(&src);
                let ports: [u8; 4] = frame[34..38].try_into().unwrap();
                frame[34..36].copy_from_slice(&ports[2..]);
                frame[36..38].copy_from_slice(&ports[..2]);
            }
            _ => return vec![],
        }
        crate::gmii::encode(&frame)
    }
}

impl Silicon for Echo {
    fn rise(&mut self, pins: &mut Pins, clocks: u32, _: u64) {
        if clocks & SYS != 0 {
            pins.gate = 1;
        }
        if clocks & ETH != 0 {
            if pins.gmii_rx_dv != 0 {
                self.incoming.push(pins.gmii_rx_data);
            } else if !self.incoming.is_empty() {
                self.outgoing = Self::answer(&std::mem::take(&mut self.incoming));
                self.at = 0;
            }
            let byte = self.outgoing.get(self.at).copied();
            self.at += 1;
            (pins.gmii_tx_en, pins.gmii_tx_data) = (byte.is_some().into(), byte.unwrap_or(0));
        }
    }
}

/// Where a served board and its control are, the flag that ends it, and the thread that then gives
/// its rig back.
type Served = (
    SocketAddr,
    SocketAddr,
    Arc<AtomicBool>,
    std::thread::JoinHandle<Rig<Echo>>,
);

/// A served echo board.
fn serve(mode: Mode) -> Served {
    serve_waiting(mode, None)
}

fn serve_waiting(mode: Mode, alone: Option<u64>) -> Served {
    let mut board = Board::new(Echo::default(), 60_000_000, Plant::default());
    board.reset(|_| {});
    let rig = Rig::around(board, crate::lan_segment::BOARD_IP);
    let any: SocketAddr = "127.0.0.1:0".parse().unwrap();
    let options = Options {
        udp: any,
        discovery: None,
        interface: None,
        tap: None,
        console: None,
        jobs: None,
        control: Some(any),
        stdin: false,
        mode,
        silence: Duration::from_secs(60),
        orphan_clocks: 1000,
        alone,
        report: None,
    };
    let stop = Arc::new(AtomicBool::new(false));
    let (told, hear) = channel();
    let stopped = stop.clone();
    let thread = std::thread::spawn(move || {
        let server = Server::bind(rig, options, stopped).unwrap();
        let (udp, control) = (
            server.udp.as_ref().unwrap().udp.local_addr().unwrap(),
            server.control_address.unwrap(),
        );
        assert!(server.ready_line().starts_with(&format!(
            "ready udp={udp} console=- control={control} sys_clk_hz=60000000"
        )));
        told.send((udp, control)).unwrap();
        server.run()
    });
    let (udp, control) = hear.recv().unwrap();
    (udp, control, stop, thread)
}

fn client(to: SocketAddr) -> UdpSocket {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    socket
        .set_read_timeout(Some(Duration::from_secs(20)))
        .unwrap();
    socket.connect(to).unwrap();
    socket
}

fn talk(socket: &UdpSocket, payload: &[u8]) -> Vec<u8> {
    socket.send(payload).unwrap();
    hear(socket)
}

fn hear(socket: &UdpSocket) -> Vec<u8> {
    let mut buffer = [0; 2048];
    let n = socket.recv(&mut buffer).unwrap();
    buffer[..n].to_vec()
}

fn exchange(sequence: u32) -> Vec<u8> {
    let base = wire::map::COMMAND;
    bytes(&[0x4e6f_1044, 0, 0x000f_0300, base, 1, sequence, 0])
}

fn bytes(words: &[u32]) -> Vec<u8> {
    words.iter().flat_map(|word| word.to_be_bytes()).collect()
}

#[test]
fn lockstep_gives_each_exchange_one_period() {
    let (udp, control, stop, thread) = serve(Mode::Lockstep { period: 5000 });
    let (a, b) = (client(udp), client(udp));
    for n in 0..10 {
        assert_eq!(talk(&a, &exchange(n)), exchange(n));
    }
    // Another host's question is answered to it and not to the first.
    assert_eq!(talk(&b, b"No exchange at all"), b"No exchange at all");
    assert_eq!(talk(&a, &exchange(11)), exchange(11));
    let mut stream = TcpStream::connect(control).unwrap();
    writeln!(stream, "fault loss\nfault pull seed=3\nfault plug").unwrap();
    let mut answers = BufReader::new(stream.try_clone().unwrap()).lines();
    let answers: [String; 3] = std::array::from_fn(|_| answers.next().unwrap().unwrap());
    assert!(
        answers[0].starts_with("error: \"loss\": how much?"),
        "{}",
        answers[0]
    );
    assert!(answers[1].contains("faults=pull "), "{}", answers[1]);
    assert!(answers[2].contains("faults=none "), "{}", answers[2]);
    writeln!(stream, "ext-reset 1\nfrobnicate\nquit").unwrap();
    let answers: Vec<_> = BufReader::new(stream)
        .lines()
        .take(3)
        .map(Result::unwrap)
        .collect();
    assert_eq!(
        (answers[0].as_str(), answers[2].as_str()),
        ("ok ext_reset=1", "ok")
    );
    assert!(answers[1].contains("frobnicate"));
    let rig = thread.join().unwrap();
    // 11 exchanges, and the period before the first one.
    let question = rig.clock() - 32 - 12 * 5000;
    assert!((60..=1000).contains(&question), "{question}");
    assert_eq!(rig.meter.requested, 11);
    assert_eq!(rig.pins().ext_reset, 1);
    assert!(!stop.load(Ordering::Relaxed));
}

#[test]
fn lockstep_begins_while_the_board_runs() {
    let (udp, control, _, thread) = serve(Mode::Free { pace: None });
    let host = client(udp);
    let mut stream = TcpStream::connect(control).unwrap();
    let mut answers = BufReader::new(stream.try_clone().unwrap()).lines();
    let mut ask = |command: &str| {
        writeln!(stream, "{command}").unwrap();
        answers.next().unwrap().unwrap()
    };
    let clock = |answer: String| -> u64 {
        let (_, rest) = answer.split_once("ok clock=").expect(&answer);
        rest.split(' ').next().unwrap().parse().unwrap()
    };
    for wrong in [
        "",
        " lockstep",
        " free",
        " lockstep x",
        " lockstep 0",
        " lockstep 1",
    ] {
        assert!(
            ask(&format!("mode{wrong}")).starts_with("error: "),
            "{wrong}"
        );
    }
    let before = clock(ask("pins"));
    while clock(ask("pins")) == before {}
    // 6000 clocks of 60 MHz.
    let begun = clock(ask("mode lockstep 100000"));
    for n in 0..10 {
        assert_eq!(talk(&host, &exchange(n)), exchange(n));
    }
    let passed = clock(ask("pins")) - begun;
    assert!((60_000..=67_000).contains(&passed), "{passed}");
    assert_eq!(clock(ask("pins")) - begun, passed);
    assert_eq!(ask("quit"), "ok");
    thread.join().unwrap();
}

#[test]
fn a_question_of_the_exchanging_host_is_answered_while_a_client_asks_the_control_all_the_time() {
    let (udp, control, _, thread) = serve(Mode::Lockstep { period: 5000 });
    let host = client(udp);
    assert_eq!(talk(&host, &exchange(1)), exchange(1));
    let mut stream = TcpStream::connect(control).unwrap();
    let mut answers = BufReader::new(stream.try_clone().unwrap()).lines();
    let asks = Arc::new(AtomicBool::new(true));
    let asking = std::thread::spawn({
        let asks = asks.clone();
        move || {
            while asks.load(Ordering::Relaxed) {
                writeln!(stream, "pins").unwrap();
                answers.next().unwrap().unwrap();
            }
            writeln!(stream, "quit").unwrap();
        }
    });
    let answer = talk(&host, &question());
    asks.store(false, Ordering::Relaxed);
    asking.join().unwrap();
    assert_eq!(answer, question());
    thread.join().unwrap();
}

/// A record that reads one word.
fn question() -> Vec<u8> {
    bytes(&[0x4e6f_1000, 0, 0x0000_0001, 0, 0x1234])
}

#[test]
fn what_a_host_reads_between_two_exchanges_is_on_the_wire_behind_the_second() {
    let (udp, _, stop, thread) = serve(Mode::Lockstep { period: 5000 });
    let a = client(udp);
    assert_eq!(talk(&a, &exchange(1)), exchange(1));
    a.send(&question()).unwrap();
    a.send(&exchange(2)).unwrap();
    assert_eq!(hear(&a), exchange(2));
    assert_eq!(hear(&a), question());
    assert_eq!(talk(&a, &exchange(3)), exchange(3));
    // Without another exchange it is answered, too.
    assert_eq!(talk(&a, &question()), question());
    stop.store(true, Ordering::Relaxed);
    let rig = thread.join().unwrap();
    let last = rig.clock() - 32 - 4 * 5000;
    assert!((60..=1000).contains(&last), "{last}");
}

#[test]
fn a_question_is_answered_to_the_host_that_asked_whichever_makes_the_next_exchange() {
    let (udp, _, stop, thread) = serve(Mode::Lockstep { period: 5000 });
    let (a, b) = (client(udp), client(udp));
    assert_eq!(talk(&a, &exchange(1)), exchange(1));
    a.send(&question()).unwrap();
    assert_eq!(talk(&b, &exchange(2)), exchange(2));
    assert_eq!(hear(&a), question());
    stop.store(true, Ordering::Relaxed);
    thread.join().unwrap();
}

#[test]
fn free_runs_by_itself_and_stops_when_told() {
    let (udp, _, stop, thread) = serve(Mode::Free { pace: None });
    assert_eq!(talk(&client(udp), b"hello"), b"hello");
    stop.store(true, Ordering::Relaxed);
    let rig = thread.join().unwrap();
    assert_eq!(rig.frames.from_board, 1);
    assert!(rig.clock() > 32);
}

#[test]
fn free_and_waiting_time_stands_still_until_the_next_datagram_of_the_host() {
    let alone = 5000;
    let (udp, _, stop, thread) = serve_waiting(Mode::Free { pace: None }, Some(alone));
    let host = client(udp);
    assert_eq!(talk(&host, b"one"), b"one");
    std::thread::sleep(Duration::from_millis(50));
    assert_eq!(talk(&host, b"two"), b"two");
    std::thread::sleep(Duration::from_millis(50));
    stop.store(true, Ordering::Relaxed);
    let rig = thread.join().unwrap();
    assert!(
        (alone..3 * alone + 3 * SLICE).contains(&rig.clock()),
        "{} clocks",
        rig.clock()
    );
}
