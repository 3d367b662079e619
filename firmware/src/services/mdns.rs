//! Answers multicast DNS: `NAME.local`, and the services `_ferrocnc._udp` and `_http._tcp`.
//!
//! A name is asked for three times, a quarter of a second apart, before it is the board's; if
//! another device has it, the board takes it with a number behind it. Then the records are
//! announced twice. A question is answered in the next turn, or up to 120 ms later if other devices
//! may answer, too; what the sender knows already is left out. A question from another port than
//! 5353 is one of plain DNS and gets its answer itself, with a short time to live.
//!
//! A datagram is read once, up to sixteen questions and 32 records of it, and leaves behind only a
//! set of records to be sent. A turn sends at most one message. There is no goodbye: a board loses
//! power without one, and its address is kept for two minutes at most.

use super::post::Party;
use crate::text::{Out, Sink};
use heapless::String;
use wire::mdns::{
    A, AAAA, ANY, AUTHORITY, FERROCNC, GROUP, HTTP, IN, LABEL, Message, NSEC, PORT, PTR, Question,
    RESPONSE, Record, SERVICES, SRV, Section, TOP, TRUNCATED, TXT, UID, Writer,
};

/// Longest message that a turn sends: all records.
pub const MESSAGE: usize = 900;

/// Seconds that what contains the address may be kept.
const SHORT: u32 = 120;
/// Seconds that the rest may be kept: 75 min.
const LONG: u32 = 4500;
/// Seconds for a client of plain DNS (RFC 6762, 6.7).
const LEGACY: u32 = 10;

/// Between two questions whether the name is taken.
const PROBE_MS: u32 = 250;
/// Questions.
const PROBES: u8 = 3;
/// Announcements, and the time between them.
const ANNOUNCEMENTS: u8 = 2;
const ANNOUNCE_MS: u32 = 1000;
/// The loser of two that ask at once waits so long.
const YIELD_MS: u32 = 1000;
/// After so many conflicts there is one attempt in five seconds.
const CONFLICTS: u8 = 15;
const CONFLICT_MS: u32 = 5000;
/// A record goes to the group once a second at most.
const AGAIN_MS: u32 = 1000;
/// Wait for more of what the sender knows.
const MORE_MS: u32 = 400;

/// The records.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
enum Item {
    Address,
    Kinds,
    Ferrocnc,
    FerrocncHost,
    FerrocncFacts,
    Http,
    HttpHost,
    HttpFacts,
    ListFerrocnc,
    ListHttp,
}

use Item::{
    Address, Ferrocnc, FerrocncFacts, FerrocncHost, Http, HttpFacts, HttpHost, Kinds, ListFerrocnc,
    ListHttp,
};

const ITEMS: [Item; 10] = [
    Address,
    Kinds,
    Ferrocnc,
    FerrocncHost,
    FerrocncFacts,
    Http,
    HttpHost,
    HttpFacts,
    ListFerrocnc,
    ListHttp,
];

/// A set of records.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Items(u16);

impl Items {
    const NONE: Items = Items(0);
    const ALL: Items = Items((1 << ITEMS.len()) - 1);

    fn of(items: &[Item]) -> Self {
        Items(items.iter().fold(0, |all, item| all | 1 << *item as u16))
    }

    fn has(self, item: Item) -> bool {
        self.0 >> item as u16 & 1 != 0
    }

    fn with(self, other: Items) -> Self {
        Items(self.0 | other.0)
    }

    fn without(self, other: Items) -> Self {
        Items(self.0 & !other.0)
    }
}

impl Item {
    /// Other devices may have the same record.
    fn shared(self) -> bool {
        match self {
            Ferrocnc | Http | ListFerrocnc | ListHttp => true,
            Address | Kinds | FerrocncHost | FerrocncFacts | HttpHost | HttpFacts => false,
        }
    }

    fn kind(self) -> u16 {
        match self {
            Address => A,
            Kinds => NSEC,
            Ferrocnc | Http | ListFerrocnc | ListHttp => PTR,
            FerrocncHost | HttpHost => SRV,
            FerrocncFacts | HttpFacts => TXT,
        }
    }

    fn ttl(self) -> u32 {
        match self {
            Address | Kinds | FerrocncHost | HttpHost => SHORT,
            Ferrocnc | FerrocncFacts | Http | HttpFacts | ListFerrocnc | ListHttp => LONG,
        }
    }
}

/// What the records say.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Identity {
    /// The board's own name; empty: one of the unique id.
    pub name: wire::Name,
    /// The flash's unique id.
    pub uid: [u32; 2],
    /// Its address; 0: none, and nothing is said.
    pub ip: u32,
    /// UDP port of the Etherbone server.
    pub port: u16,
}

const ALL_HOSTS: Party = Party {
    ip: GROUP,
    port: PORT,
};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// Asks whether the name is taken; questions asked.
    Probing(u8),
    /// Says what the board has; announcements made.
    Announcing(u8),
    Ready,
}

/// The responder.
#[derive(Debug)]
pub struct Responder {
    identity: Identity,
    /// The first label of the names.
    label: String<LABEL>,
    /// The number behind it; 1: none.
    suffix: u32,
    conflicts: u8,
    phase: Phase,
    /// When the phase goes on.
    due: u32,
    /// To be sent to the group, and when.
    group: Items,
    group_at: u32,
    /// Whose question it was: only what that host knows is left out.
    group_for: u32,
    /// To be sent to one host: to this place, with this number, and the question of plain DNS.
    single: Option<Single>,
    /// When each record went to the group last.
    sent: [Option<u32>; ITEMS.len()],
    random: u32,
}

#[derive(Clone, Copy, Debug)]
struct Single {
    to: Party,
    items: Items,
    /// Of plain DNS: the number, and kind and name of the question.
    legacy: Option<(u16, u16, Named)>,
}

/// Whose records.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Named {
    Host,
    FerrocncInstance,
    HttpInstance,
    FerrocncService,
    HttpService,
    List,
}

const NAMED: [Named; 6] = [
    Named::Host,
    Named::FerrocncInstance,
    Named::HttpInstance,
    Named::FerrocncService,
    Named::HttpService,
    Named::List,
];

impl Named {
    fn items(self) -> &'static [Item] {
        match self {
            Named::Host => &[Address, Kinds],
            Named::FerrocncInstance => &[FerrocncHost, FerrocncFacts],
            Named::HttpInstance => &[HttpHost, HttpFacts],
            Named::FerrocncService => &[Ferrocnc],
            Named::HttpService => &[Http],
            Named::List => &[ListFerrocnc, ListHttp],
        }
    }

    fn of(item: Item) -> Self {
        match item {
            Address | Kinds => Named::Host,
            Ferrocnc => Named::FerrocncService,
            FerrocncHost | FerrocncFacts => Named::FerrocncInstance,
            Http => Named::HttpService,
            HttpHost | HttpFacts => Named::HttpInstance,
            ListFerrocnc | ListHttp => Named::List,
        }
    }

    /// No other device may have it.
    fn ours_alone(self) -> bool {
        match self {
            Named::Host | Named::FerrocncInstance | Named::HttpInstance => true,
            Named::FerrocncService | Named::HttpService | Named::List => false,
        }
    }

    /// Its labels, with the board's.
    fn with<R>(self, label: &str, take: impl FnOnce(&[&str]) -> R) -> R {
        let [f, u, l] = FERROCNC;
        let [h, t, _] = HTTP;
        match self {
            Named::Host => take(&[label, l]),
            Named::FerrocncInstance => take(&[label, f, u, l]),
            Named::HttpInstance => take(&[label, h, t, l]),
            Named::FerrocncService => take(&FERROCNC),
            Named::HttpService => take(&HTTP),
            Named::List => take(&SERVICES),
        }
    }
}

/// A label that is being written: ASCII, and what does not fit is lost.
struct Label<'l, const N: usize>(&'l mut String<N>);

impl<const N: usize> Sink for Label<'_, N> {
    fn put(&mut self, text: &[u8]) {
        for byte in text {
            let _ = self.0.push(char::from(*byte));
        }
    }
}

/// A name as a label of DNS: letters in lower case, digits, and single hyphens for all else.
pub fn label(name: &wire::Name, uid: [u32; 2]) -> String<LABEL> {
    let mut label = String::new();
    for byte in name.text().bytes() {
        let byte = byte.to_ascii_lowercase();
        // A name has 32 bytes: there is room.
        if byte.is_ascii_lowercase() || byte.is_ascii_digit() {
            let _ = label.push(char::from(byte));
        } else if !label.is_empty() && !label.ends_with('-') {
            let _ = label.push('-');
        }
    }
    if label.ends_with('-') {
        label.pop();
    }
    if label.is_empty() {
        Out(&mut Label(&mut label)).text("ferrocnc-").hex(uid[1]);
    }
    label
}

/// Is this time over?
fn over(due: u32, now: u32) -> bool {
    now.wrapping_sub(due) as i32 >= 0
}

impl Responder {
    /// It begins to ask for its name a little later: boards that are switched on together must not
    /// ask together.
    pub fn new(identity: Identity, now: u32) -> Self {
        let [high, low] = identity.uid;
        let mut responder = Responder {
            identity,
            label: label(&identity.name, identity.uid),
            suffix: 1,
            conflicts: 0,
            phase: Phase::Probing(0),
            due: now,
            group: Items::NONE,
            group_at: now,
            group_for: 0,
            single: None,
            sent: [None; ITEMS.len()],
            random: (high ^ low.rotate_left(7) ^ now) | 1,
        };
        responder.begin(now);
        responder
    }

    /// The name the board has, or asks for, without `.local`.
    pub fn name(&self) -> &str {
        &self.label
    }

    /// Is the name the board's?
    pub fn settled(&self) -> bool {
        match self.phase {
            Phase::Probing(_) => false,
            Phase::Announcing(_) | Phase::Ready => true,
        }
    }

    /// The board's name or address may have changed.
    pub fn settle(&mut self, identity: Identity, now: u32) {
        if self.identity == identity {
            return;
        }
        if self.identity.name != identity.name || self.identity.uid != identity.uid {
            self.label = label(&identity.name, identity.uid);
            self.suffix = 1;
        }
        self.identity = identity;
        self.begin(now);
    }

    /// Asks for the name, after up to a quarter of a second.
    fn begin(&mut self, now: u32) {
        let wait = self.pick(PROBE_MS);
        self.phase = Phase::Probing(0);
        self.due = now.wrapping_add(wait);
        self.group = Items::NONE;
        self.single = None;
        self.sent = [None; ITEMS.len()];
    }

    /// A number below this one: xorshift.
    fn pick(&mut self, below: u32) -> u32 {
        self.random ^= self.random << 13;
        self.random ^= self.random >> 17;
        self.random ^= self.random << 5;
        self.random % below
    }

    /// Which of our records is this?
    fn named(&self, name: &wire::mdns::DomainName) -> Option<Named> {
        NAMED
            .into_iter()
            .find(|named| named.with(&self.label, |labels| name.is(labels)))
    }

    /// Takes a datagram that came from there.
    pub fn take(&mut self, datagram: &[u8], from: Party, now: u32) {
        let Some(message) = Message::parse(datagram) else {
            return;
        };
        if self.identity.ip == 0 || from.ip == self.identity.ip {
            return; // what we said ourselves
        }
        if message.is_response() {
            if from.port == PORT {
                self.heard(&message, now);
            }
        } else {
            self.asked(&message, from, now);
        }
    }

    /// Another device's records: is one of them ours?
    fn heard(&mut self, message: &Message, now: u32) {
        let taken = message.records().any(|record| {
            self.named(&record.name).is_some_and(|named| {
                named.ours_alone() && record.ttl > 0 && !self.same(&record, named)
            })
        });
        if !taken {
            return;
        }
        match self.phase {
            Phase::Probing(_) => self.rename(now),
            // It may be an old one of another's cache: ask again.
            Phase::Announcing(_) | Phase::Ready => self.begin(now),
        }
    }

    /// Is this record one of ours, or of a kind we do not have?
    fn same(&self, record: &Record, named: Named) -> bool {
        let mut items = named.items().iter();
        let Some(item) = items.find(|item| item.kind() == record.kind) else {
            return false;
        };
        self.equal(*item, record)
    }

    /// Is the content of this record that of ours?
    fn equal(&self, item: Item, record: &Record) -> bool {
        if record.kind != item.kind() {
            return false;
        }
        let target = |named: Named, offset| {
            let name = record.name_at(offset);
            name.is_some_and(|name| named.with(&self.label, |labels| name.is(labels)))
        };
        match item {
            Address => record.ip() == Some(self.identity.ip),
            Kinds => true,
            Ferrocnc => target(Named::FerrocncInstance, 0),
            Http => target(Named::HttpInstance, 0),
            ListFerrocnc => target(Named::FerrocncService, 0),
            ListHttp => target(Named::HttpService, 0),
            FerrocncHost => record.port() == Some(self.identity.port) && target(Named::Host, 6),
            HttpHost => record.port() == Some(wire::PAGE_PORT) && target(Named::Host, 6),
            FerrocncFacts => record.strings().next() == Some(&self.facts()),
            HttpFacts => record.data.len() <= 1,
        }
    }

    /// The unique id as the TXT record has it.
    fn facts(&self) -> [u8; UID.len() + 16] {
        let [high, low] = self.identity.uid;
        let uid = u64::from(high) << 32 | u64::from(low);
        core::array::from_fn(|at| match at.checked_sub(UID.len()) {
            None => UID.as_bytes().get(at).copied().unwrap_or(b'='),
            Some(at) => {
                let digit = (uid >> (60 - 4 * at) & 15) as u8;
                digit + if digit < 10 { b'0' } else { b'a' - 10 }
            }
        })
    }

    /// Takes the next name.
    fn rename(&mut self, now: u32) {
        self.suffix += 1;
        self.conflicts = self.conflicts.saturating_add(1);
        let mut number = String::<12>::new();
        Out(&mut Label(&mut number)).text("-").number(self.suffix);
        self.label = label(&self.identity.name, self.identity.uid);
        // ASCII: every byte is a character.
        self.label.truncate(LABEL - number.len());
        let _ = self.label.push_str(&number);
        self.begin(now);
        if self.conflicts >= CONFLICTS {
            self.due = now.wrapping_add(CONFLICT_MS);
        }
    }

    /// A question, or a device that asks for a name of its own.
    fn asked(&mut self, message: &Message, from: Party, now: u32) {
        if let Phase::Probing(_) = self.phase {
            if self.loses(message) {
                self.begin(now);
                self.due = now.wrapping_add(YIELD_MS);
            }
            return;
        }
        let legacy = from.port != PORT;
        let (mut group, mut single, mut first) = (Items::NONE, Items::NONE, None);
        for question in message.questions() {
            let Some((named, items)) = self.answers(&question) else {
                continue;
            };
            first = first.or(Some((question.kind, named)));
            if legacy || question.class & TOP != 0 {
                single = single.with(items);
            } else {
                group = group.with(items);
            }
        }
        let known = self.known(message);
        single = single.without(known);
        group = group.without(known);
        // A probe for one of our names is answered at once.
        let probed = message
            .records()
            .any(|record| record.section == Section::Authority);
        if single != Items::NONE {
            let legacy = first.filter(|_| legacy);
            self.single = Some(Single {
                to: from,
                items: single,
                legacy: legacy.map(|(kind, named)| (message.id, kind, named)),
            });
        }
        if message.questions().next().is_none() && self.group_for == from.ip {
            self.group = self.group.without(known);
        }
        if group == Items::NONE {
            return;
        }
        let shared = ITEMS.iter().any(|item| group.has(*item) && item.shared());
        let wait = match (message.flags & TRUNCATED != 0, shared && !probed) {
            (true, _) => MORE_MS + self.pick(100),
            (false, true) => 20 + self.pick(100),
            (false, false) => 0,
        };
        let at = now.wrapping_add(wait);
        if self.group == Items::NONE || over(at, self.group_at) {
            self.group_at = at;
        }
        self.group_for = from.ip;
        if !probed {
            group = self.fresh(group, now);
        }
        self.group = self.group.with(group);
    }

    /// Without what all hosts heard within the last second.
    fn fresh(&self, items: Items, now: u32) -> Items {
        let said = ITEMS
            .into_iter()
            .zip(self.sent)
            .filter(|(_, sent)| sent.is_some_and(|sent| now.wrapping_sub(sent) < AGAIN_MS));
        said.fold(items, |items, (item, _)| items.without(Items::of(&[item])))
    }

    /// Our records that answer a question.
    fn answers(&self, question: &Question) -> Option<(Named, Items)> {
        if !matches!(question.class & !TOP, IN | 255) {
            return None;
        }
        let named = self.named(&question.name)?;
        let asked = |item: &Item| {
            let kind = item.kind();
            question.kind == kind
                || question.kind == ANY && *item != Kinds
                || question.kind == AAAA && *item == Kinds
        };
        let items = named.items().iter().filter(|item| asked(item));
        let items = items.fold(Items::NONE, |all, item| all.with(Items::of(&[*item])));
        (items != Items::NONE).then_some((named, items))
    }

    /// What the sender knows, and will know for half its time at least.
    fn known(&self, message: &Message) -> Items {
        let mut known = Items::NONE;
        for record in message.records() {
            let Some(named) = self.named(&record.name) else {
                continue;
            };
            for item in named.items() {
                let fresh = record.section == Section::Answer && record.ttl >= item.ttl() / 2;
                if fresh && self.equal(*item, &record) {
                    known = known.with(Items::of(&[*item]));
                }
            }
        }
        known
    }

    /// Two devices ask for the same name at once: the one whose address is greater has it.
    fn loses(&self, message: &Message) -> bool {
        let claims = |record: &Record| {
            record.section == Section::Authority && self.named(&record.name) == Some(Named::Host)
        };
        let theirs = message.records().filter(claims);
        // The lowest kind is compared first; ours has an address alone.
        let theirs = theirs.map(|record| (record.kind, record.ip().unwrap_or(u32::MAX)));
        theirs.min().is_some_and(|it| it > (A, self.identity.ip))
    }

    /// Is there something to send soon?
    pub fn busy(&self, now: u32) -> bool {
        let phase = !matches!(self.phase, Phase::Ready) && over(self.due, now);
        let group = self.group != Items::NONE && over(self.group_at, now);
        self.identity.ip != 0 && (self.single.is_some() || group || phase)
    }

    /// Writes the message that is due, if one is; says where it goes and how long it is.
    pub fn poll(&mut self, now: u32, room: &mut [u8]) -> Option<(Party, usize)> {
        if self.identity.ip == 0 {
            return None;
        }
        if let Some(single) = self.single.take() {
            return Some((single.to, self.answer_one(&single, room)));
        }
        if self.group != Items::NONE && over(self.group_at, now) {
            let items = core::mem::take(&mut self.group);
            return Some((ALL_HOSTS, self.say(items, now, room)));
        }
        if self.phase == Phase::Ready || !over(self.due, now) {
            return None;
        }
        let length = match self.phase {
            Phase::Probing(asked) if asked < PROBES => {
                self.phase = Phase::Probing(asked + 1);
                self.due = now.wrapping_add(PROBE_MS);
                self.probe(room)
            }
            Phase::Probing(_) => {
                self.phase = Phase::Announcing(1);
                self.due = now.wrapping_add(ANNOUNCE_MS);
                self.say(Items::ALL, now, room)
            }
            Phase::Announcing(said) if said < ANNOUNCEMENTS => {
                self.phase = Phase::Announcing(said + 1);
                self.due = now.wrapping_add(ANNOUNCE_MS);
                self.say(Items::ALL, now, room)
            }
            Phase::Announcing(_) | Phase::Ready => {
                (self.phase, self.conflicts) = (Phase::Ready, 0);
                return None;
            }
        };
        Some((ALL_HOSTS, length))
    }

    /// Asks whether the names are taken, and says what we would say.
    fn probe(&self, room: &mut [u8]) -> usize {
        let mut writer = Writer::new(room, 0, 0);
        for named in NAMED.into_iter().filter(|named| named.ours_alone()) {
            named.with(&self.label, |name| writer.question(name, ANY, IN | TOP));
        }
        for item in [Address, FerrocncHost, HttpHost] {
            self.write(item, Section::Authority, item.ttl(), false, &mut writer);
        }
        writer.finish()
    }

    /// Says these records to all hosts.
    fn say(&mut self, items: Items, now: u32, room: &mut [u8]) -> usize {
        for (item, sent) in ITEMS.into_iter().zip(&mut self.sent) {
            if items.has(item) {
                *sent = Some(now);
            }
        }
        let mut writer = Writer::new(room, 0, RESPONSE | AUTHORITY);
        self.write_all(items, None, &mut writer);
        writer.finish()
    }

    fn answer_one(&self, single: &Single, room: &mut [u8]) -> usize {
        let id = single.legacy.map_or(0, |(id, ..)| id);
        let mut writer = Writer::new(room, id, RESPONSE | AUTHORITY);
        if let Some((_, kind, named)) = single.legacy {
            named.with(&self.label, |name| writer.question(name, kind, IN));
        }
        let ttl = single.legacy.map(|_| LEGACY);
        self.write_all(single.items, ttl, &mut writer);
        writer.finish()
    }

    /// These records, and what goes with them.
    fn write_all(&self, items: Items, most: Option<u32>, writer: &mut Writer) {
        let mut besides = Items::NONE;
        for item in ITEMS.into_iter().filter(|item| items.has(*item)) {
            let ttl = most.unwrap_or(u32::MAX).min(item.ttl());
            self.write(item, Section::Answer, ttl, most.is_none(), writer);
            besides = besides.with(Items::of(match item {
                Ferrocnc => &[FerrocncHost, FerrocncFacts, Address],
                Http => &[HttpHost, HttpFacts, Address],
                FerrocncHost | HttpHost => &[Address],
                Address => &[Kinds],
                Kinds | FerrocncFacts | HttpFacts | ListFerrocnc | ListHttp => &[],
            }));
        }
        let besides = besides.without(items);
        for item in ITEMS.into_iter().filter(|item| besides.has(*item)) {
            let ttl = most.unwrap_or(u32::MAX).min(item.ttl());
            self.write(item, Section::Additional, ttl, most.is_none(), writer);
        }
    }

    /// Writes a record. `flush`: it replaces what others have of ours.
    fn write(&self, item: Item, section: Section, ttl: u32, flush: bool, writer: &mut Writer) {
        let label = self.label.as_str();
        let top = if flush && !item.shared() { TOP } else { 0 };
        Named::of(item).with(label, |name| {
            let head = (name, item.kind(), IN | top, ttl);
            writer.record(section, head, |data| {
                let mut named = |to: Named| to.with(label, |name| data.name(name));
                match item {
                    Address => data.put(&self.identity.ip.to_be_bytes()),
                    // There is an address of kind 1, bit 1 of the first byte, and no other.
                    Kinds => named(Named::Host) && data.put(&[0, 1, 0x40]),
                    Ferrocnc => named(Named::FerrocncInstance),
                    Http => named(Named::HttpInstance),
                    ListFerrocnc => named(Named::FerrocncService),
                    ListHttp => named(Named::HttpService),
                    FerrocncHost | HttpHost => {
                        let port = match item {
                            HttpHost => wire::PAGE_PORT,
                            _ => self.identity.port,
                        };
                        let [high, low] = port.to_be_bytes();
                        data.put(&[0, 0, 0, 0, high, low])
                            && Named::Host.with(label, |name| data.name(name))
                    }
                    FerrocncFacts => data.string(&self.facts(), b""),
                    HttpFacts => data.put(&[0]),
                }
            });
        });
    }
}

#[cfg(test)]
mod tests;
