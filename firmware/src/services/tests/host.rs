//! A host that sends what a test tells it to, segment by segment. It acknowledges only on command.

use super::rig::{Board, PROMPT, US, echo};
use smoltcp::phy::ChecksumCapabilities;
use smoltcp::wire::{
    EthernetAddress, EthernetFrame, EthernetProtocol, EthernetRepr, IpProtocol, Ipv4Address,
    Ipv4Packet, Ipv4Repr, TcpControl, TcpPacket, TcpRepr, TcpSeqNumber, UdpPacket, UdpRepr,
};
use std::vec;
use std::vec::Vec;
use wire::CONSOLE_PORT;
use wire::jobs::{FRAME, Frame, Op, PORT, Request, Status};

/// A segment.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TcpSegment {
    /// The port of the host.
    pub host: u16,
    pub control: TcpControl,
    pub seq: TcpSeqNumber,
    pub ack: Option<TcpSeqNumber>,
    pub window: u16,
    pub data: Vec<u8>,
}

/// A segment of the board's, with its sums checked; not ARP.
pub fn segment_of(frame: &[u8]) -> Option<TcpSegment> {
    let sums = ChecksumCapabilities::default();
    let frame = EthernetFrame::new_checked(frame).expect("a frame");
    if frame.ethertype() != EthernetProtocol::Ipv4 {
        return None;
    }
    let packet = Ipv4Packet::new_checked(frame.payload()).expect("a packet");
    let ip = Ipv4Repr::parse(&packet, &sums).expect("a right header");
    let packet = TcpPacket::new_checked(packet.payload()).expect("TCP");
    let (from, to) = (ip.src_addr.into(), ip.dst_addr.into());
    let tcp = TcpRepr::parse(&packet, &from, &to, &sums).expect("a right segment");
    Some(TcpSegment {
        host: tcp.dst_port,
        control: tcp.control,
        seq: tcp.seq_number,
        ack: tcp.ack_number,
        window: tcp.window_len,
        data: tcp.payload.to_vec(),
    })
}

/// A datagram of this device between these ports, to the board or to a group.
pub fn udp_frame(
    (mac, src_addr): (EthernetAddress, Ipv4Address),
    (src_port, dst_port): (u16, u16),
    to: u32,
    payload: &[u8],
) -> Vec<u8> {
    let sums = ChecksumCapabilities::default();
    let dst_addr = Ipv4Address::from_bits(to);
    let udp = UdpRepr { src_port, dst_port };
    let ip = Ipv4Repr {
        src_addr,
        dst_addr,
        next_header: IpProtocol::Udp,
        payload_len: udp.header_len() + payload.len(),
        hop_limit: 255,
    };
    let mut bytes = vec![0; 14 + ip.buffer_len() + ip.payload_len];
    let mut frame = EthernetFrame::new_unchecked(&mut bytes);
    frame.set_src_addr(mac);
    let [_, a, b, c] = dst_addr.octets();
    frame.set_dst_addr(match dst_addr.is_multicast() {
        true => EthernetAddress([1, 0, 0x5e, a & 0x7f, b, c]),
        false => EthernetAddress(US.mac),
    });
    frame.set_ethertype(EthernetProtocol::Ipv4);
    let mut packet = Ipv4Packet::new_unchecked(frame.payload_mut());
    ip.emit(&mut packet, &sums);
    udp.emit(
        &mut UdpPacket::new_unchecked(packet.payload_mut()),
        &src_addr.into(),
        &dst_addr.into(),
        payload.len(),
        |room| room.copy_from_slice(payload),
        &sums,
    );
    bytes
}

/// One end of a connection.
#[derive(Clone, Debug)]
pub struct Host {
    pub ip: Ipv4Address,
    pub port: u16,
    pub to: u16,
    pub seq: TcpSeqNumber,
    pub ack: TcpSeqNumber,
    pub window: u16,
}

impl Host {
    /// A client of the console, at 192.168.2.`last`.
    pub fn new(last: u8) -> Self {
        Host {
            ip: Ipv4Address::new(192, 168, 2, last),
            port: 40_000,
            to: CONSOLE_PORT,
            seq: TcpSeqNumber(i32::from(last) << 20),
            ack: TcpSeqNumber(0),
            window: 4096,
        }
    }

    /// A client of the port of jobs.
    pub fn of_jobs(last: u8) -> Self {
        let to = PORT;
        Host {
            to,
            ..Host::new(last)
        }
    }

    /// The same with this port of its own.
    pub fn at(self, port: u16) -> Self {
        Host { port, ..self }
    }

    pub fn segment(&self, control: TcpControl, ack: bool, data: &[u8]) -> Vec<u8> {
        self.frame(&TcpSegment {
            host: self.port,
            control,
            seq: self.seq,
            ack: ack.then_some(self.ack),
            window: self.window,
            data: data.to_vec(),
        })
    }

    /// An acknowledgement of everything.
    pub fn nod(&self) -> Vec<u8> {
        self.segment(TcpControl::None, true, b"")
    }

    pub fn frame(&self, segment: &TcpSegment) -> Vec<u8> {
        let sums = ChecksumCapabilities::default();
        let tcp = TcpRepr {
            src_port: self.port,
            dst_port: self.to,
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

    /// Takes the segments for it in order, and returns their bytes. `ack` moves on.
    pub fn hear<'f>(&mut self, frames: impl IntoIterator<Item = &'f Vec<u8>>) -> Vec<u8> {
        let mut bytes = Vec::new();
        for segment in frames.into_iter().filter_map(|frame| segment_of(frame)) {
            if segment.host != self.port {
                continue;
            }
            if segment.control == TcpControl::Syn {
                self.ack = segment.seq + 1;
            } else if segment.seq == self.ack {
                self.ack += segment.data.len();
                self.ack += usize::from(segment.control == TcpControl::Fin);
                bytes.extend(segment.data);
            }
        }
        bytes
    }

    /// Sends a SYN; true if the board accepts it.
    pub fn knocks(&mut self, board: &mut Board) -> bool {
        let sent = board.frame(&self.segment(TcpControl::Syn, false, b""));
        let welcome = |segment: TcpSegment| {
            let ours = segment.host == self.port && segment.control == TcpControl::Syn;
            ours && segment.ack == Some(self.seq + 1)
        };
        let mut segments = sent.iter().filter_map(|frame| segment_of(frame));
        let welcome = segments.any(welcome);
        if welcome {
            self.hear(&sent);
            self.seq += 1;
        }
        welcome
    }

    /// Sends a SYN, and the handshake's end if the board accepts it. True if the board speaks as it
    /// should: a prompt at the console; nothing, or Busy, at the port of jobs.
    pub fn enters(&mut self, board: &mut Board) -> bool {
        if !self.knocks(board) {
            return false;
        }
        let sent = board.frame(&self.nod());
        let heard = self.hear(&sent);
        if !heard.is_empty() {
            board.frame(&self.nod());
        }
        self.to == PORT || heard == PROMPT.as_bytes()
    }

    /// Sends these bytes, and returns what comes back; all of it is acknowledged.
    pub fn says(&mut self, board: &mut Board, bytes: &[u8]) -> Vec<u8> {
        let mut sent = board.frame(&self.segment(TcpControl::Psh, true, bytes));
        self.seq += bytes.len();
        let mut heard = self.hear(&sent);
        loop {
            sent = board.frame(&self.nod());
            match self.hear(&sent) {
                more if more.is_empty() => return heard,
                more => heard.extend(more),
            }
        }
    }

    /// A client of the console: sends a line; true if it comes back.
    pub fn is_heard(&mut self, board: &mut Board) -> bool {
        self.says(board, b"x\n") == echo("x").as_bytes()
    }

    /// A client of jobs: its Hello is answered with this.
    pub fn greets(&mut self, board: &mut Board) -> Option<Status> {
        let mut out = [0; FRAME];
        let length = Request::Hello { client: 9 }.emit(1, &mut out);
        let heard = self.says(board, &out[..length]);
        let (frame, _) = Frame::parse(&heard).ok()??;
        let (op, status) = frame.answer()?;
        (op == Op::Hello).then_some(status)
    }

    /// Ends the connection as a client does that has nothing more to say. True if the board ends
    /// its half at once.
    pub fn leaves(&mut self, board: &mut Board) -> bool {
        let sent = board.frame(&self.segment(TcpControl::Fin, true, b""));
        self.seq += 1;
        self.hear(&sent);
        let mut all = sent.iter().filter_map(|frame| segment_of(frame));
        let ended = all.any(|it| it.control == TcpControl::Fin && it.host == self.port);
        board.frame(&self.nod());
        ended
    }

    /// Ends it with a reset.
    pub fn resets(&self, board: &mut Board) {
        board.frame(&self.segment(TcpControl::Rst, true, b""));
    }
}

/// A client at the console, heard.
pub fn visitor(board: &mut Board, last: u8) -> Host {
    let mut host = Host::new(last);
    assert!(host.enters(board), "a console is free");
    assert!(host.is_heard(board));
    host
}

/// A board, and clients at all its consoles.
pub fn visited() -> (Board, [Host; 3]) {
    let mut board = Board::new();
    let hosts = [1, 2, 3].map(|last| visitor(&mut board, last));
    (board, hosts)
}
