use super::*;
use crate::text::Sink;
use proptest::prelude::*;
use smoltcp::iface::{Config, Interface, SocketHandle, SocketSet};
use smoltcp::phy::{Device, DeviceCapabilities, Medium, RxToken, TxToken};
use smoltcp::socket::{icmp, tcp};
use smoltcp::time::Instant;
use smoltcp::wire::{
    EthernetAddress, HardwareAddress, Icmpv4Packet, Icmpv4Repr, IpAddress, IpCidr,
};
use std::collections::VecDeque;

const US: Us = Us {
    mac: [2, 0, 0, 0, 0, 1],
    ip: 0xc0a8_0232,
    port: 1234,
};

/// Repeats every line in capitals, and hangs up at "quit".
#[derive(Default)]
struct Echo(Vec<u8>);

impl StreamHandler for Echo {
    fn greet(&mut self, out: &mut Text) {
        out.put(b"> ");
    }

    fn take(&mut self, bytes: &[u8], out: &mut Text) -> usize {
        let mut used = 0;
        for byte in bytes {
            used += 1;
            self.0.push(byte.to_ascii_uppercase());
            if *byte == b'\n' {
                out.close |= self.0 == b"QUIT\n";
                out.put(&self.0);
                self.0.clear();
                break;
            }
        }
        used
    }
}

/// A wire that loses frames as the dice say.
#[derive(Default)]
struct Wire {
    to_us: VecDeque<Vec<u8>>,
    to_them: VecDeque<Vec<u8>>,
    dice: VecDeque<bool>,
}

impl Wire {
    fn lost(&mut self) -> bool {
        self.dice.pop_front().unwrap_or(false)
    }
}

struct Rx(Vec<u8>);
struct Tx<'a>(&'a mut Wire);

impl RxToken for Rx {
    fn consume<R, F: FnOnce(&[u8]) -> R>(self, f: F) -> R {
        f(&self.0)
    }
}

impl TxToken for Tx<'_> {
    fn consume<R, F: FnOnce(&mut [u8]) -> R>(self, length: usize, f: F) -> R {
        let mut frame = vec![0; length];
        let result = f(&mut frame);
        if !self.0.lost() {
            self.0.to_us.push_back(frame);
        }
        result
    }
}

impl Device for Wire {
    type RxToken<'a> = Rx;
    type TxToken<'a> = Tx<'a>;

    fn receive(&mut self, _: Instant) -> Option<(Rx, Tx<'_>)> {
        let frame = self.to_them.pop_front()?;
        Some((Rx(frame), Tx(self)))
    }

    fn transmit(&mut self, _: Instant) -> Option<Tx<'_>> {
        Some(Tx(self))
    }

    fn capabilities(&self) -> DeviceCapabilities {
        let mut capabilities = DeviceCapabilities::default();
        capabilities.medium = Medium::Ethernet;
        capabilities.max_transmission_unit = 1514;
        capabilities
    }
}

/// Our stack and an independent one, on one wire.
struct Bench {
    ip: Ip,
    echo: Echo,
    wire: Wire,
    peer: Interface,
    sockets: SocketSet<'static>,
    ms: u32,
}

impl Bench {
    fn new(dice: Vec<bool>) -> Self {
        let mut wire = Wire::default();
        let mac = HardwareAddress::Ethernet(EthernetAddress([2, 0, 0, 0, 0, 9]));
        let mut peer = Interface::new(Config::new(mac), &mut wire, Instant::ZERO);
        peer.update_ip_addrs(|all| {
            all.push(IpCidr::new(IpAddress::v4(192, 168, 2, 1), 24))
                .unwrap();
        });
        wire.dice = dice.into();
        let mut ip = Ip::new();
        ip.listen(23, 700);
        Bench {
            ip,
            echo: Echo::default(),
            wire,
            peer,
            sockets: SocketSet::new(Vec::new()),
            ms: 0,
        }
    }

    fn step(&mut self) {
        self.ms += 5;
        let now = Instant::from_millis(self.ms);
        self.peer.poll(now, &mut self.wire, &mut self.sockets);
        let mut out = [0; 1514];
        while let Some(frame) = self.wire.to_us.pop_front() {
            let sent = self
                .ip
                .frame(&frame, &US, self.ms, &mut self.echo, &mut out);
            self.send(sent, &out);
        }
        while let Some(length) = self.ip.poll(&US, self.ms, &mut self.echo, &mut out) {
            self.send(Some(length), &out);
        }
    }

    fn send(&mut self, length: Option<usize>, out: &[u8]) {
        let Some(length) = length else { return };
        if !self.wire.lost() {
            self.wire.to_them.push_back(out[..length].to_vec());
        }
    }

    fn connect(&mut self, port: u16) -> SocketHandle {
        let buffer = || tcp::SocketBuffer::new(vec![0; 4096]);
        let mut socket = tcp::Socket::new(buffer(), buffer());
        let to = (IpAddress::v4(192, 168, 2, 50), 23);
        socket.connect(self.peer.context(), to, port).unwrap();
        self.sockets.add(socket)
    }

    fn socket(&mut self, handle: SocketHandle) -> &mut tcp::Socket<'static> {
        self.sockets.get_mut(handle)
    }

    /// Sends text, and returns what comes within this many seconds, until this many bytes came.
    fn talk(&mut self, handle: SocketHandle, say: &[u8], wanted: usize, seconds: u32) -> Vec<u8> {
        let (mut said, mut heard) = (0, Vec::new());
        let end = self.ms + seconds * 1000;
        while self.ms < end && heard.len() < wanted {
            self.step();
            let socket = self.socket(handle);
            if socket.can_send() && said < say.len() {
                said += socket.send_slice(&say[said..]).unwrap();
            }
            while socket.can_recv() {
                let mut some = [0; 512];
                let count = socket.recv_slice(&mut some).unwrap();
                heard.extend_from_slice(&some[..count]);
            }
        }
        heard
    }

    fn settle(&mut self, seconds: u32) {
        for _ in 0..seconds * 200 {
            self.step();
        }
    }
}

#[test]
fn a_visitor_is_greeted_answered_and_hung_up_on() {
    let mut bench = Bench::new(Vec::new());
    let handle = bench.connect(4000);
    let heard = bench.talk(handle, b"hello\nworld\nquit\n", 19, 2);
    assert_eq!(String::from_utf8_lossy(&heard), "> HELLO\nWORLD\nQUIT\n");
    bench.socket(handle).close();
    bench.settle(1);
    assert!(!bench.ip.busy(), "{:?}", bench.ip);
}

#[test]
fn one_visitor_after_the_other_and_never_two() {
    let mut bench = Bench::new(Vec::new());
    let first = bench.connect(4000);
    assert_eq!(bench.talk(first, b"a\n", 4, 2), b"> A\n");
    let second = bench.connect(4001);
    bench.settle(1);
    assert_eq!(bench.socket(second).state(), tcp::State::Closed, "refused");
    bench.socket(first).close();
    bench.settle(1);
    assert!(!bench.ip.busy());
    let third = bench.connect(4002);
    assert_eq!(bench.talk(third, b"b\n", 4, 2), b"> B\n");
    bench.socket(third).abort();
    bench.settle(1);
    assert!(!bench.ip.busy(), "a reset is heard");
}

#[test]
fn a_dead_peer_is_forgotten() {
    let mut bench = Bench::new(Vec::new());
    let handle = bench.connect(4000);
    assert_eq!(bench.talk(handle, b"a\n", 4, 2), b"> A\n");
    // The cable is unplugged while an answer is on its way.
    let socket = bench.socket(handle);
    socket.send_slice(b"b\n").unwrap();
    bench.step();
    bench.wire.dice = vec![true; 100_000].into();
    bench.settle(40);
    assert!(!bench.ip.busy());
}

#[test]
fn more_than_fits_is_answered_bit_by_bit() {
    let mut bench = Bench::new(Vec::new());
    let handle = bench.connect(4000);
    let line = [&[b'x'; 99][..], b"\n"].concat();
    let all = line.repeat(40);
    let heard = bench.talk(handle, &all, all.len() + 2, 60);
    assert_eq!(heard.len(), all.len() + 2);
    assert!(heard[2..].eq_ignore_ascii_case(&all));
}

#[test]
fn a_ping_is_answered() {
    let mut bench = Bench::new(Vec::new());
    let buffer = || icmp::PacketBuffer::new(vec![icmp::PacketMetadata::EMPTY; 4], vec![0; 4096]);
    let mut socket = icmp::Socket::new(buffer(), buffer());
    socket.bind(icmp::Endpoint::Ident(7)).unwrap();
    let handle = bench.sockets.add(socket);
    for length in [0, 1, 56, 1400] {
        let data = vec![0x5a; length];
        let ping = Icmpv4Repr::EchoRequest {
            ident: 7,
            seq_no: 1,
            data: &data,
        };
        let socket = bench.sockets.get_mut::<icmp::Socket>(handle);
        let to = IpAddress::v4(192, 168, 2, 50);
        let bytes = socket.send(ping.buffer_len(), to).unwrap();
        ping.emit(&mut Icmpv4Packet::new_unchecked(bytes), &Default::default());
        bench.settle(2);
        let socket = bench.sockets.get_mut::<icmp::Socket>(handle);
        let (pong, from) = socket.recv().expect("an answer");
        assert_eq!((from, pong.len()), (to, 8 + length));
    }
}

#[test]
fn without_an_address_nothing_is_answered() {
    let mut bench = Bench::new(Vec::new());
    bench.connect(4000);
    let now = Instant::from_millis(5);
    bench.peer.poll(now, &mut bench.wire, &mut bench.sockets);
    let arp = bench.wire.to_us.pop_front().unwrap();
    let unnumbered = Us { ip: 0, ..US };
    let mut out = [0; 1514];
    let mut ask = |us: &Us| bench.ip.frame(&arp, us, 0, &mut bench.echo, &mut out);
    assert_eq!(ask(&unnumbered), None);
    assert_eq!(ask(&US), Some(42));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn whatever_gets_lost_arrives_in_the_end(dice in prop::collection::vec(prop::bool::weighted(0.2), 0..300)) {
        let mut bench = Bench::new(dice);
        let handle = bench.connect(4000);
        let heard = bench.talk(handle, b"one\ntwo\nthree\nquit\n", 21, 120);
        prop_assert_eq!(String::from_utf8_lossy(&heard), "> ONE\nTWO\nTHREE\nQUIT\n");
        bench.socket(handle).close();
        bench.settle(40);
        prop_assert!(!bench.ip.busy());
    }

    #[test]
    fn no_frame_breaks_anything(
        frames in prop::collection::vec((any::<bool>(), prop::collection::vec(any::<(usize, u8)>(), 0..6), 0usize..1514), 1..40),
    ) {
        let mut bench = Bench::new(Vec::new());
        let handle = bench.connect(4000);
        bench.talk(handle, b"a\n", 4, 1);
        let now = Instant::from_millis(bench.ms);
        bench.socket(handle).send_slice(b"hello\n").unwrap();
        bench.peer.poll(now, &mut bench.wire, &mut bench.sockets);
        let good = bench.wire.to_us.pop_front().unwrap();
        let mut out = [0; 1514];
        for (base, changes, cut) in frames {
            let mut frame = if base { good.clone() } else { vec![0; 200] };
            let length = frame.len();
            for (at, byte) in changes {
                frame[at % length] = byte;
            }
            frame.truncate(cut.max(1));
            bench.ip.frame(&frame, &US, 0, &mut bench.echo, &mut out);
        }
    }
}
