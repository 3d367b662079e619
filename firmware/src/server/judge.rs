//! Decides what a client may read and write, with a copy of the session and the state, before
//! anything is executed.

use crate::auth::{Auth, Words};
use crate::cores::Ident;
use crate::flash::Flash;
use crate::safety::{Event, Safety};
use crate::session::{Peer, Session};
use crate::{config, service};
use wire::auth::Purpose;
use wire::describe::JobsState;
use wire::etherbone::Record;
use wire::{Refusal, map};

const WINDOW: u32 = 0x1000;
pub(super) const STATUS_WORDS_END: u32 = map::STATUS + 0x400;
pub(super) const COMMAND_END: u32 = map::COMMAND + WINDOW;
pub(super) const COUNTERS_END: u32 = map::COUNTERS + WINDOW;
pub(super) const LOG_END: u32 = map::LOG_RING + WINDOW;
pub(super) const PANIC_END: u32 = map::PANIC_TEXT + map::PANIC_TEXT_LEN;
pub(super) const CONFIG_END: u32 = map::CONFIG + map::CONFIG_LEN;
pub(super) const DESCRIBE_END: u32 = map::DESCRIBE + map::DESCRIBE_LEN;
pub(super) const FLASH_END: u32 = map::FLASH + map::FLASH_LEN;
pub(super) const SEGMENTS_END: u32 = map::SEGMENTS + 4 * map::SEGMENTS_WRITABLE;
pub(super) const SESSION_END: u32 = map::SESSION + map::SESSION_LEN;

/// The session and the state as they would be after the writes of a datagram that were checked so
/// far.
pub(super) struct Judge<'s> {
    pub(super) ident: &'s Ident,
    pub(super) boot_id: u32,
    pub(super) session: Session,
    pub(super) auth: &'s mut Auth,
    /// The answer to a challenge.
    pub(super) answer: Option<&'s Words>,
    pub(super) safety: Safety,
    pub(super) peer: Peer,
    pub(super) now: u64,
    pub(super) flash_busy: bool,
    /// A count with the right number precedes the writes to the segments.
    pub(super) counted: bool,
}

impl Judge<'_> {
    /// Judges a write; what it means for the session and the state counts from here on.
    pub(super) fn write(&mut self, address: u32, value: u32) -> Result<(), Refusal> {
        match address {
            map::SESSION_ACQUIRE => {
                // Cheap checks first: while the session has an owner, nothing is hashed for another
                // client.
                self.session.may_acquire(self.peer, value)?;
                self.auth
                    .prove(self.peer, Purpose::Acquire, &[value], self.answer)?;
                self.session
                    .acquire(self.peer, value, self.boot_id, self.now)?;
                let _ = self.safety.step(Event::Acquired, self.now);
                Ok(())
            }
            map::SESSION_RELEASE => {
                self.session.release(self.peer, value)?;
                let _ = self.safety.step(Event::Lost, self.now);
                Ok(())
            }
            map::SESSION_REBOOT => {
                if value != map::REBOOT_KEY {
                    return Err(Refusal::Value);
                }
                self.owned_by_this_peer_or_free()?;
                self.at_rest()?;
                self.flash_idle()
            }
            map::SESSION_SEGMENTS if JobsState::streamed(self.ident.features) => {
                self.owner()?;
                self.session.count_segments();
                self.counted = value == self.session.segments();
                if self.counted {
                    Ok(())
                } else {
                    Err(Refusal::Stale)
                }
            }
            map::FLASH..FLASH_END => {
                Flash::check_write(address, value)?;
                self.owned_by_this_peer_or_free()?;
                self.at_rest()?;
                self.flash_idle()?;
                // Writes after this one in the same datagram come while the operation runs.
                self.flash_busy = address == map::FLASH_OP;
                Ok(())
            }
            map::CONFIG..CONFIG_END => {
                let setting =
                    config::setting_at(address, self.ident.channels).ok_or(Refusal::Unmapped)?;
                self.owner()?;
                if !config::live_safe(setting) {
                    self.at_rest()?;
                }
                config::check(setting, value, self.ident.channels, self.ident.clock_hz)
            }
            // The owner's write, with the right number: the gateware itself judges the values.
            map::SEGMENTS..SEGMENTS_END if self.counted => Ok(()),
            map::SERVICE.. => {
                service::check_write(address, value, self.ident.channels, self.ident.clock_hz)?;
                self.owner()?;
                self.at_rest()
            }
            _ => {
                check_read(address)?;
                Err(Refusal::ReadOnly)
            }
        }
    }

    fn owner(&self) -> Result<(), Refusal> {
        if self.session.is_owner(self.peer) {
            Ok(())
        } else {
            Err(Refusal::NotOwner)
        }
    }

    /// With a key, only the owner: it has proved that it has the key.
    fn owned_by_this_peer_or_free(&self) -> Result<(), Refusal> {
        match self.session.owner() {
            Some(_) => self.owner(),
            None if self.auth.locked() => Err(Refusal::Key),
            None => Ok(()),
        }
    }

    fn flash_idle(&self) -> Result<(), Refusal> {
        if self.flash_busy {
            Err(Refusal::Busy)
        } else {
            Ok(())
        }
    }

    fn at_rest(&self) -> Result<(), Refusal> {
        if self.safety.at_rest() {
            Ok(())
        } else {
            Err(Refusal::Armed)
        }
    }
}

/// Is this an aligned address inside a window? Unused addresses of a window read 0.
pub(super) fn check_read(address: u32) -> Result<(), Refusal> {
    if !address.is_multiple_of(4) {
        return Err(Refusal::Alignment);
    }
    match address {
        map::DESCRIBE..DESCRIBE_END
        | map::SESSION..SESSION_END
        | map::CONFIG..CONFIG_END
        | map::COMMAND..COMMAND_END
        | map::STATUS..STATUS_WORDS_END
        | map::COUNTERS..COUNTERS_END
        | map::LOG..LOG_END
        | map::PANIC..PANIC_END
        | map::FLASH..FLASH_END => Ok(()),
        map::SERVICE.. if service::readable(address) => Ok(()),
        _ => Err(Refusal::Unmapped),
    }
}

/// Every written word with its address; refused if the base is not aligned or the end is out of
/// range.
pub(super) fn writes_of<'w>(
    record: &Record<'w>,
) -> Result<impl Iterator<Item = (u32, u32)> + use<'w>, Refusal> {
    let base = record.write_base;
    if !record.writes.is_empty() {
        if !base.is_multiple_of(4) {
            return Err(Refusal::Alignment);
        }
        if base
            .checked_add(4 * (record.writes.len() as u32 - 1))
            .is_none()
        {
            return Err(Refusal::Unmapped);
        }
    }
    let addresses = (0u32..).map(move |index| base.wrapping_add(4 * index));
    Ok(addresses.zip(record.writes.iter().copied()))
}
