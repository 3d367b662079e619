//! Lets hosts find the board and set its settings, whatever its address ([`wire::discovery`]).
//!
//! This module judges requests; frames belong to the transport. A Set is answered once the settings
//! are in flash, which is later: the answer then waits ([`Waiting`]).

use crate::server::Server;
use wire::Name;
use wire::WIRE_VERSION;
use wire::discovery::{Body, Here, Message};
use wire::flash::OpResult;
use wire::settings::Settings;

/// The reaction to a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Act {
    /// Not for us.
    Nothing,
    /// Send this answer to the host that asked.
    Answer(Body),
    /// Save these settings, if the key was proved; the answer comes later.
    Save(Settings),
}

/// The request that still has to be answered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Waiting {
    /// The nonce of the request.
    pub nonce: u32,
    /// The UDP port it came from.
    pub port: u16,
}

/// The names a board reports.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Names {
    /// The configuration.
    pub configuration: Name,
    /// The platform.
    pub platform: Name,
}

/// The board's answer to a host that looks for boards.
pub fn here(server: &Server, us: &crate::net::Us, dhcp: bool, names: &Names) -> Here {
    let flash = server.flash();
    Here {
        mac: us.mac,
        ip: us.ip,
        port: us.port,
        dhcp,
        armed: !server.safety().at_rest(),
        owned: server.session().owner().is_some(),
        keyed: server.auth.locked(),
        running: flash.running(),
        origin: flash.origin(),
        speed: server.link().word().speed,
        wire_version: WIRE_VERSION,
        firmware_version: crate::VERSION,
        build_id: flash.build_id(),
        name: flash.settings().name,
        configuration: names.configuration,
        platform: names.platform,
    }
}

/// Judges a request.
pub fn judge(
    message: &Message,
    server: &Server,
    waiting: Option<Waiting>,
    here: impl FnOnce() -> Here,
) -> Act {
    let uid = server.flash().uid();
    let any = message.uid == [0; 2];
    let set = |settings: Settings| {
        if any || message.uid != uid {
            Act::Nothing
        } else if !server.safety().at_rest() || server.session().owner().is_some() {
            Act::Answer(Body::Done(OpResult::Armed))
        } else if settings.dhcp && !server.has_sdram() {
            Act::Answer(Body::Done(OpResult::NoDhcp))
        } else if !server.flash().busy() {
            Act::Save(settings)
        } else if waiting.is_some_and(|waiting| waiting.nonce == message.nonce) {
            Act::Nothing // repeated; the answer comes later
        } else {
            Act::Answer(Body::Done(OpResult::Busy))
        }
    };
    match message.body {
        Body::Discover if any || message.uid == uid => Act::Answer(Body::Here(here())),
        Body::Set(settings) => set(settings),
        Body::Discover | Body::Here(_) | Body::Done(_) | Body::Prove(_) | Body::Proven(..) => {
            Act::Nothing // answers, or handled above
        }
    }
}
