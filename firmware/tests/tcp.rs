//! Tests of TCP at the console's port: peers that die, strangers that forge segments, and stacks
//! that ask whether the board is still there.
//!
//! Frames in, frames out, and a clock. Only [`Board`] knows the stack; another stack would have to
//! pass the same tests.

use firmware::ip::{Ip, StreamHandler, Text};
use firmware::net::Us;
use firmware::text::Sink;
use smoltcp::phy::ChecksumCapabilities;
use smoltcp::wire::{
    EthernetAddress, EthernetFrame, EthernetProtocol, EthernetRepr, IpProtocol, Ipv4Address,
    Ipv4Packet, Ipv4Repr, TcpControl, TcpPacket, TcpRepr, TcpSeqNumber,
};

const US: Us = Us {
    mac: [2, 0, 0, 0, 0, 1],
    ip: 0xc0a8_0232,
    port: 1234,
};
const PORT: u16 = 23;
const PROMPT: &[u8] = b"> ";
/// A dead peer is dropped within two minutes: a minute of silence, half a minute of probes.
const FORGOTTEN_MS: u32 = 120_000;
/// How long an unfinished handshake may delay the next client: three tries, a second apart.
const HALF_OPEN_MS: u32 = 3_000;

/// Repeats every line; answers `more` with a kilobyte and `quiet` with nothing.
#[derive(Default)]
struct Echo {
    line: Vec<u8>,
    lines: usize,
}

impl StreamHandler for Echo {
    fn greet(&mut self, out: &mut Text) {
        out.put(PROMPT);
    }

    fn take(&mut self, bytes: &[u8], out: &mut Text) -> usize {
        let end = bytes.iter().position(|byte| *byte == b'\n');
        let taken = end.map_or(bytes.len(), |end| end + 1);
        self.line.extend_from_slice(&bytes[..taken]);
        if end.is_some() {
            self.lines += 1;
            let times = match &self.line[..] {
                b"more\n" => 200,
                b"quiet\n" => 0,
                _ => 1,
            };
            out.put(&self.line.repeat(times));
            self.line.clear();
        }
        taken
    }
}

/// The board's stack with its cable.
struct Board {
    ip: Ip,
    echo: Echo,
    now: u32,
}

impl Board {
    fn new() -> Self {
        let mut ip = Ip::new();
        ip.listen(PORT, 1100);
        Board {
            ip,
            echo: Echo::default(),
            now: 100_000,
        }
    }

    /// The immediate answers.
    fn frame(&mut self, frame: &[u8]) -> Vec<Vec<u8>> {
        let mut out = [0; 1514];
        let length = self
            .ip
            .frame(frame, &US, self.now, &mut self.echo, &mut out);
        let mut sent: Vec<_> = length
            .map(|length| out[..length].to_vec())
            .into_iter()
            .collect();
        sent.extend(self.turn());
        sent
    }

    fn turn(&mut self) -> Vec<Vec<u8>> {
        let (mut out, mut sent) = ([0; 1514], Vec::new());
        while let Some(length) = self.ip.poll(&US, self.now, &mut self.echo, &mut out) {
            sent.push(out[..length].to_vec());
        }
        sent
    }

    /// Lets time pass, one turn every 10 ms; returns the frames sent, and when.
    fn wait(&mut self, ms: u32) -> Vec<(u32, Vec<u8>)> {
        let (end, mut sent) = (self.now + ms, Vec::new());
        while self.now < end {
            self.now += 10;
            sent.extend(self.turn().into_iter().map(|frame| (self.now, frame)));
        }
        sent
    }

    /// Lines that were taken as input.
    fn lines(&self) -> usize {
        self.echo.lines
    }
}

/// A segment, parsed from a frame.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Segment {
    control: TcpControl,
    seq: TcpSeqNumber,
    ack: Option<TcpSeqNumber>,
    window: u16,
    data: Vec<u8>,
}

fn segment_of(frame: &[u8]) -> Segment {
    let sums = ChecksumCapabilities::default();
    let frame = EthernetFrame::new_checked(frame).expect("a frame");
    let packet = Ipv4Packet::new_checked(frame.payload()).expect("a packet");
    let ip = Ipv4Repr::parse(&packet, &sums).expect("a right header");
    let packet = TcpPacket::new_checked(packet.payload()).expect("TCP");
    let (from, to) = (ip.src_addr.into(), ip.dst_addr.into());
    let tcp = TcpRepr::parse(&packet, &from, &to, &sums).expect("a right segment");
    Segment {
        control: tcp.control,
        seq: tcp.seq_number,
        ack: tcp.ack_number,
        window: tcp.window_len,
        data: tcp.payload.to_vec(),
    }
}

/// A host, segment by segment. It acknowledges only on command.
struct Host {
    ip: Ipv4Address,
    port: u16,
    seq: TcpSeqNumber,
    ack: TcpSeqNumber,
    window: u16,
}

impl Host {
    fn new(last: u8) -> Self {
        Host {
            ip: Ipv4Address::new(192, 168, 2, last),
            port: 40_000,
            seq: TcpSeqNumber(i32::from(last) << 20),
            ack: TcpSeqNumber(0),
            window: 4096,
        }
    }

    fn segment(&self, control: TcpControl, ack: bool, data: &[u8]) -> Vec<u8> {
        let segment = Segment {
            control,
            seq: self.seq,
            ack: ack.then_some(self.ack),
            window: self.window,
            data: data.to_vec(),
        };
        self.frame(&segment)
    }

    fn frame(&self, segment: &Segment) -> Vec<u8> {
        let sums = ChecksumCapabilities::default();
        let tcp = TcpRepr {
            src_port: self.port,
            dst_port: PORT,
            control: segment.control,
            seq_number: segment.seq,
            ack_number: segment.ack,
            window_len: segment.window,
            window_scale: None,
            max_seg_size: None,
            sack_permitted: false,
            sack_ranges: [None; 3],
            timestamp: None,
            payload: &segment.data,
        };
        let to = Ipv4Address::from_bits(US.ip);
        let ip = Ipv4Repr {
            src_addr: self.ip,
            dst_addr: to,
            next_header: IpProtocol::Tcp,
            payload_len: tcp.buffer_len(),
            hop_limit: 64,
        };
        let ethernet = EthernetRepr {
            src_addr: EthernetAddress([2, 0, 0, 0, 1, self.ip.octets()[3]]),
            dst_addr: EthernetAddress(US.mac),
            ethertype: EthernetProtocol::Ipv4,
        };
        let at = ethernet.buffer_len();
        let mut frame = vec![0; at + ip.buffer_len() + tcp.buffer_len()];
        ethernet.emit(&mut EthernetFrame::new_unchecked(&mut frame));
        let mut packet = Ipv4Packet::new_unchecked(&mut frame[at..]);
        ip.emit(&mut packet, &sums);
        let mut packet = TcpPacket::new_unchecked(packet.payload_mut());
        tcp.emit(&mut packet, &self.ip.into(), &to.into(), &sums);
        frame
    }

    /// Takes the received segments in order, and returns their text. `seq` and `ack` move on.
    fn hear<'f>(&mut self, frames: impl IntoIterator<Item = &'f Vec<u8>>) -> Vec<u8> {
        let mut text = Vec::new();
        for frame in frames {
            let segment = segment_of(frame);
            if segment.control == TcpControl::Syn {
                self.ack = segment.seq + 1;
            } else if segment.seq == self.ack {
                self.ack += segment.data.len();
                text.extend(segment.data);
            }
        }
        text
    }

    /// Sends a SYN; true if the board accepts it.
    fn knocks(&mut self, board: &mut Board) -> bool {
        let sent = board.frame(&self.segment(TcpControl::Syn, false, b""));
        let welcome = |frame: &Vec<u8>| {
            let segment = segment_of(frame);
            segment.control == TcpControl::Syn && segment.ack == Some(self.seq + 1)
        };
        let welcome = sent.iter().any(welcome);
        if welcome {
            self.hear(&sent);
            self.seq += 1;
        }
        welcome
    }

    /// Completes the handshake if the board accepts it, and tries again every second for this long.
    fn enters_within(&mut self, board: &mut Board, ms: u32) -> bool {
        for _ in 0..=ms / 1000 {
            if self.knocks(board) {
                let sent = board.frame(&self.segment(TcpControl::None, true, b""));
                let greeted = self.hear(&sent) == PROMPT;
                board.frame(&self.segment(TcpControl::None, true, b""));
                return greeted;
            }
            board.wait(1000);
        }
        false
    }

    /// Sends a line; true if it comes back.
    fn is_heard(&mut self, board: &mut Board) -> bool {
        let sent = board.frame(&self.segment(TcpControl::Psh, true, b"x\n"));
        self.seq += 2;
        let heard = self.hear(&sent) == b"x\n";
        board.frame(&self.segment(TcpControl::None, true, b""));
        heard
    }
}

/// A board, and a client at its console that has acknowledged everything.
fn visited() -> (Board, Host) {
    let (mut board, mut host) = (Board::new(), Host::new(1));
    assert!(host.enters_within(&mut board, 0), "the console is free");
    assert!(host.is_heard(&mut board));
    (board, host)
}

/// Is the only answer an acknowledgement with the board's current numbers?
fn says_where_it_is(sent: &[Vec<u8>], host: &Host, board_next: TcpSeqNumber) -> bool {
    let [frame] = sent else { return false };
    let segment = segment_of(frame);
    segment.control == TcpControl::None
        && segment.seq == board_next
        && segment.ack == Some(host.seq)
        && segment.data.is_empty()
}

#[test]
fn a_visitor_that_dies_without_a_word_leaves_the_console_within_two_minutes() {
    let (mut board, _dead) = visited();
    let mut next = Host::new(2);
    assert!(!next.knocks(&mut board), "one visitor at a time");
    let asked = board.wait(FORGOTTEN_MS);
    assert!(asked.len() < 20, "{} questions", asked.len());
    assert!(next.enters_within(&mut board, 0));
    assert!(next.is_heard(&mut board));
}

#[test]
fn a_visitor_that_is_alive_keeps_the_console_for_hours_without_a_word() {
    let (mut board, mut host) = visited();
    for _ in 0..3 * 3600 {
        for (_, frame) in board.wait(1_000) {
            let question = segment_of(&frame);
            assert_eq!(question.control, TcpControl::None);
            // As a stack answers a segment that it has already received.
            board.frame(&host.segment(TcpControl::None, true, b""));
        }
    }
    assert!(host.is_heard(&mut board));
    assert!(!Host::new(2).knocks(&mut board));
}

#[test]
fn unfinished_handshakes_keep_no_visitor_out() {
    let mut board = Board::new();
    for round in 0..20 {
        // From an address that does not answer.
        let mut forger = Host::new(200);
        forger.port += round;
        board.frame(&forger.segment(TcpControl::Syn, false, b""));
        board.wait(50 * u32::from(round));
        let mut host = Host::new(1);
        host.port += round;
        assert!(
            host.enters_within(&mut board, HALF_OPEN_MS),
            "round {round}: kept out by a handshake of a forger"
        );
        assert!(host.is_heard(&mut board));
        let reset = host.segment(TcpControl::Rst, true, b"");
        board.frame(&reset);
    }
}

#[test]
fn a_knock_that_is_repeated_is_answered_with_the_same_number() {
    let (mut board, mut host) = (Board::new(), Host::new(1));
    let knock = host.segment(TcpControl::Syn, false, b"");
    let first = board.frame(&knock);
    board.wait(100);
    let again = board.frame(&knock);
    assert_eq!(segment_of(&first[0]).seq, segment_of(&again[0]).seq);
    host.hear(&first);
    host.seq += 1;
    let sent = board.frame(&host.segment(TcpControl::None, true, b""));
    assert_eq!(host.hear(&sent), PROMPT);
}

#[test]
fn a_handshake_is_not_finished_by_a_guess() {
    for guess in [1, 1000, -1, i32::MIN] {
        let (mut board, mut host) = (Board::new(), Host::new(1));
        assert!(host.knocks(&mut board));
        let right = host.ack;
        host.ack = TcpSeqNumber(right.0.wrapping_add(guess));
        for data in [&b""[..], b"x\n"] {
            let sent = board.frame(&host.segment(TcpControl::None, true, data));
            let [frame] = &sent[..] else {
                panic!("{guess}: {} frames", sent.len())
            };
            // RFC 9293, 3.10.7.4: in SYN-RECEIVED a reset is the answer.
            let reset = segment_of(frame);
            assert_eq!((reset.control, reset.seq), (TcpControl::Rst, host.ack));
        }
        assert_eq!(board.lines(), 0);
        host.ack = right;
        let sent = board.frame(&host.segment(TcpControl::None, true, b""));
        assert_eq!(
            host.hear(&sent),
            PROMPT,
            "{guess}: the right one still counts"
        );
    }
}

#[test]
fn a_keepalive_is_answered() {
    let (mut board, mut host) = visited();
    // Without data, and with the byte that some stacks send.
    for data in [&b""[..], b"\n"] {
        board.wait(5_000);
        host.seq = TcpSeqNumber(host.seq.0 - 1);
        let sent = board.frame(&host.segment(TcpControl::None, true, data));
        host.seq += 1;
        assert!(
            says_where_it_is(&sent, &host, host.ack),
            "{data:?}: {sent:?}"
        );
    }
    assert_eq!(board.lines(), 1);
    assert!(host.is_heard(&mut board));
}

#[test]
fn a_lost_window_update_hangs_nothing() {
    let (mut board, mut host) = visited();
    // While a kilobyte is not acknowledged there is no room for another answer. Received bytes are
    // kept until the window is closed.
    let mut sent = board.frame(&host.segment(TcpControl::Psh, true, b"more\n"));
    host.seq += 5;
    for _ in 0..1_000 {
        let said = board.frame(&host.segment(TcpControl::Psh, true, b"quiet\n"));
        let last = segment_of(said.last().expect("an acknowledgement"));
        sent.extend(said);
        host.seq = last.ack.expect("an acknowledgement");
        if last.window == 0 {
            break;
        }
    }
    assert_eq!(segment_of(sent.last().expect("frames")).window, 0);
    assert_eq!(host.hear(&sent).len(), 1_000);
    // All bytes are acknowledged. The window update is sent once, and lost.
    let lost = board.frame(&host.segment(TcpControl::None, true, b""));
    let lost: Vec<_> = lost.iter().map(|frame| segment_of(frame)).collect();
    assert!(lost.iter().all(|update| update.data.is_empty()));
    assert!(lost.iter().any(|update| update.window > 0));
    assert_eq!(board.wait(5_000), Vec::new());
    // The host probes as Linux does: the number of an old byte, no data.
    let mut probe = segment_of(&host.segment(TcpControl::None, true, b""));
    probe.seq = TcpSeqNumber(host.seq.0 - 1);
    let answer = board.frame(&host.frame(&probe));
    let open = answer.iter().any(|frame| segment_of(frame).window > 0);
    assert!(open, "{} frames", answer.len());
}

#[test]
fn a_shut_window_is_asked_for_as_long_as_its_owner_answers() {
    let (mut board, mut host) = visited();
    host.window = 0;
    board.frame(&host.segment(TcpControl::Psh, true, b"y\n"));
    host.seq += 2;
    for _ in 0..300 {
        for (_, _) in board.wait(1_000) {
            board.frame(&host.segment(TcpControl::None, true, b""));
        }
    }
    host.window = 4096;
    let mut sent = board.frame(&host.segment(TcpControl::None, true, b""));
    sent.extend(board.wait(20_000).into_iter().map(|(_, frame)| frame));
    assert_eq!(host.hear(&sent), b"y\n");
}

#[test]
fn a_forged_reset_has_to_hit_the_very_number() {
    let (mut board, host) = visited();
    for distance in [1, 2, 100, 127, 128, 5_000, -1, -2, 1 << 30, i32::MIN] {
        board.wait(2_000);
        for ack in [true, false] {
            let mut forged = segment_of(&host.segment(TcpControl::Rst, ack, b""));
            forged.seq = TcpSeqNumber(forged.seq.0.wrapping_add(distance));
            let sent = board.frame(&host.frame(&forged));
            // RFC 5961: inside the window the board asks the real peer; outside it the segment is
            // ignored.
            let asked = says_where_it_is(&sent, &host, host.ack);
            assert!(sent.is_empty() || asked, "{distance}: {sent:?}");
        }
    }
    let mut host = host;
    assert!(host.is_heard(&mut board));
    board.frame(&host.segment(TcpControl::Rst, false, b""));
    assert!(Host::new(2).knocks(&mut board), "the right one is heard");
}

#[test]
fn a_forged_knock_of_the_visitor_only_makes_the_board_say_where_it_is() {
    let (mut board, mut host) = visited();
    for distance in [0, 1, 77, 1 << 20, -5] {
        board.wait(2_000);
        let mut forged = segment_of(&host.segment(TcpControl::Syn, false, b""));
        forged.seq = TcpSeqNumber(forged.seq.0.wrapping_add(distance));
        let sent = board.frame(&host.frame(&forged));
        assert!(
            says_where_it_is(&sent, &host, host.ack),
            "{distance}: {sent:?}"
        );
    }
    assert!(host.is_heard(&mut board));
    // A restarted host sends a SYN from the same port. The board's answer makes it reset.
    let mut anew = Host::new(1);
    anew.seq = TcpSeqNumber(12_345);
    board.wait(2_000);
    let sent = board.frame(&anew.segment(TcpControl::Syn, false, b""));
    let expected = segment_of(&sent[0]).ack.expect("an acknowledgement");
    let mut reset = segment_of(&anew.segment(TcpControl::Rst, false, b""));
    reset.seq = expected;
    board.frame(&anew.frame(&reset));
    assert!(anew.enters_within(&mut board, 0));
}

#[test]
fn what_acknowledges_what_was_never_sent_is_not_taken() {
    let (mut board, mut host) = visited();
    for ahead in [1, 1000, 1 << 30, i32::MIN] {
        for data in [&b""[..], b"evil\n"] {
            board.wait(2_000);
            let mut forged = segment_of(&host.segment(TcpControl::None, true, data));
            forged.ack = Some(TcpSeqNumber(host.ack.0.wrapping_add(ahead)));
            let sent = board.frame(&host.frame(&forged));
            assert!(
                says_where_it_is(&sent, &host, host.ack),
                "{ahead}: {sent:?}"
            );
        }
    }
    // A segment without an acknowledgement is ignored.
    let sent = board.frame(&host.segment(TcpControl::Psh, false, b"evil\n"));
    assert_eq!(sent, Vec::<Vec<u8>>::new());
    assert_eq!(board.lines(), 1);
    assert!(host.is_heard(&mut board));
}

#[test]
fn two_stacks_that_disagree_do_not_talk_for_ever() {
    let (mut board, host) = visited();
    board.wait(2_000);
    let mut wrong = segment_of(&host.segment(TcpControl::None, true, b""));
    wrong.seq = TcpSeqNumber(wrong.seq.0 - 5_000);
    let wrong = host.frame(&wrong);
    let mut answers = 0;
    for _ in 0..1_000 {
        answers += board.frame(&wrong).len();
        board.wait(10);
    }
    assert!((1..=50).contains(&answers), "{answers} answers in 10 s");
}

/// Changes bytes of a frame; corrects the IP header's checksum if asked to.
fn spoiled(frame: &[u8], changes: &[(usize, u8)], seal: bool) -> Vec<u8> {
    let mut frame = frame.to_vec();
    for (at, byte) in changes {
        frame[*at] = *byte;
    }
    if seal {
        Ipv4Packet::new_unchecked(&mut frame[14..]).fill_checksum();
    }
    frame
}

#[test]
fn a_wrong_checksum_and_a_fragment_are_nothing() {
    let (mut board, mut host) = visited();
    let good = host.segment(TcpControl::Psh, true, b"evil\n");
    let length = good.len() as u8 - 14;
    let knock = Host::new(2).segment(TcpControl::Syn, false, b"");
    let reset = host.segment(TcpControl::Rst, false, b"");
    for frame in [&good, &knock, &reset] {
        for (what, changes, seal) in [
            ("TCP's checksum", &[(50, frame[50] ^ 1)][..], false),
            ("no TCP checksum", &[(50, 0), (51, 0)], false),
            ("IP's checksum", &[(24, frame[24] ^ 1)], false),
            ("a first fragment", &[(20, 0x20)], true),
            ("a middle fragment", &[(20, 0x20), (21, 1)], true),
            ("a last fragment", &[(20, 0), (21, 1)], true),
            ("another board's address", &[(33, 51)], true),
            ("TCP's header of 4 words", &[(46, 0x40)], false),
            ("TCP's header of 15 words", &[(46, 0xf0)], false),
            ("IP says it is longer", &[(17, length + 4)], true),
            ("IP says it is shorter", &[(17, 30)], true),
        ] {
            let sent = board.frame(&spoiled(frame, changes, seal));
            assert_eq!(sent, Vec::<Vec<u8>>::new(), "{what}");
        }
    }
    assert_eq!(board.lines(), 1);
    assert!(host.is_heard(&mut board));
}
