//! Exports the channels and states of a board as pins and parameters under its own names.

use super::Driver;
use super::state::{Blocks, Condition, Exchange, Membership, SessionState, Times};
use super::tell::Notifier;
use crate::address::Address;
use crate::blocks::encoder::Encoder;
use crate::blocks::ethernet::Ethernet;
use crate::blocks::exchange::Exchanges;
use crate::blocks::gpio;
use crate::blocks::packets::Packets;
use crate::blocks::pwm::Pwm;
use crate::blocks::stepgen::Stepgen;
use crate::blocks::wallclock::Wallclock;
use crate::blocks::watchdog::Watchdog;
use crate::blocks::ways::Ways;
use crate::client::Identity;
use crate::glue::Glue;
use crate::hal::checked::{Checked, Rule, Watch};
use crate::hal::{Backend, Catalogue, ExportError, Exporter, In, Messenger, Out, Param};
use crate::link::{Flood, Link};
use wire::board::Kind;
use wire::describe::Describe;
use wire::exchange::MAX_CHANNELS;
use wire::regmap::IN_MAX;

/// None, or one of those that can be it.
const PROBE_INPUTS: Rule = Rule::Whole(-1, IN_MAX as i32 - 1);

/// The board-wide pins.
#[derive(Debug)]
pub(super) struct Pins {
    pub(super) enable: In<bool>,
    pub(super) enable_request: In<bool>,
    pub(super) enabled: Out<bool>,
    pub(super) fault_reason: Out<u32>,
    pub(super) fault_code: Out<u32>,
    pub(super) state: Out<u32>,
    pub(super) position_trusted: Out<bool>,
    pub(super) refused_total: Out<u32>,
    pub(super) estop: Out<bool>,
    pub(super) reset_reason: Out<u32>,
    pub(super) gate_close: Out<u32>,
    pub(super) services: Out<u32>,
    pub(super) io_error: Param<bool>,
    pub(super) stop_group: Param<bool>,
    pub(super) probe_input: Checked<i32>,
    pub(super) probe_invert: Param<bool>,
    pub(super) apply_delay: Checked<u32>,
}

impl Driver {
    /// Exports everything this board has as `ferrocnc.<index>.*`. The port of the link must own the
    /// session.
    pub fn export(
        backend: &mut dyn Backend,
        index: usize,
        address: Address,
        identity: &Identity,
        link: Link,
        say: Messenger,
    ) -> Result<Self, ExportError> {
        let describe = &identity.describe;
        let mut catalogue = Catalogue::default();
        let mut hal = Exporter::new(backend, format!("ferrocnc.{index}")).listed(&mut catalogue);
        let pins = Pins::export(&mut hal, describe)?;
        let blocks = Blocks::export(&mut hal, index, identity)?;
        let watches = catalogue.iter().filter_map(Watch::of).collect();
        let notifier = Notifier::new(say, format!("board {index} ({})", address.text));
        Ok(Driver {
            index,
            address,
            link,
            flood: Flood::default(),
            channels: describe.channels,
            clock_hz: describe.clock_hz,
            notifier,
            pins,
            blocks,
            session: SessionState::new(describe.boot_id),
            exchange: Exchange::default(),
            condition: Condition::of(describe),
            group: Membership::new(),
            times: Times::new(describe.clock_hz),
            catalogue,
            watches,
            glue: Glue::default(),
        })
    }
}

impl Pins {
    fn export(hal: &mut Exporter<'_>, describe: &Describe) -> Result<Self, ExportError> {
        let pins = Pins {
            enable: hal.input("enable")?,
            enable_request: hal.input("enable-request")?,
            enabled: hal.output("enabled")?,
            fault_reason: hal.output("fault-reason")?,
            fault_code: hal.output("fault-code")?,
            state: hal.output("state")?,
            position_trusted: hal.output("position-trusted")?,
            refused_total: hal.output("refused-total")?,
            estop: hal.output("estop")?,
            reset_reason: hal.output("last-reset-reason")?,
            gate_close: hal.output("last-gate-close")?,
            services: hal.output("services")?,
            io_error: hal.param("io-error", false)?,
            stop_group: hal.param("stop-group", true)?,
            probe_input: hal.setting("probe-input", -1, PROBE_INPUTS)?,
            probe_invert: hal.param("probe-invert", false)?,
            apply_delay: hal.setting("apply-delay-ns", 0, Rule::Any)?,
        };
        pins.reset_reason
            .set(u32::from(describe.reset_reason.code()));
        pins.gate_close.set(u32::from(describe.gate_close.code()));
        pins.services.set(describe.state.services.code());
        Ok(pins)
    }
}

impl Blocks {
    fn export(
        hal: &mut Exporter<'_>,
        index: usize,
        identity: &Identity,
    ) -> Result<Self, ExportError> {
        let describe = &identity.describe;
        let blob = identity.blob();
        let names = |kind, class: &str, longest: &str| {
            let room =
                wire::board::HAL_NAME_MAX - format!("ferrocnc.{index}.{class}..{longest}").len();
            let numbers = identity.numbers(kind).into_iter();
            channel_names(numbers.map(|n| (n, blob.text(kind, n))), room)
        };
        let packets = Packets::export(hal)?;
        let watchdog = Watchdog::export(hal)?;
        let wallclock = Wallclock::export(hal)?;
        let mut ethernet = Ethernet::export(hal)?;
        ethernet.sampled(&describe.state);
        let ways = Ways::export(hal)?;
        let exchanges = Exchanges::export(hal)?;
        let stepgens = each(
            hal,
            "stepgen",
            names(Kind::Stepgen, "stepgen", "position-scale"),
            |hal, n| Stepgen::export(hal, identity.step_type(n.into())),
        )?;
        let encoders = each(
            hal,
            "encoder",
            names(Kind::Encoder, "encoder", "velocity-rpm"),
            |hal, _| Encoder::export(hal),
        )?;
        let pwms = each(
            hal,
            "pwm",
            names(Kind::Pwm, "pwm", "invert-output"),
            |hal, n| {
                let has_direction = identity.has_pin(b'p', n.into(), "dir");
                Pwm::export(hal, has_direction, identity.pwm_type(n.into()))
            },
        )?;
        let inputs = each(
            hal,
            "gpio",
            names(Kind::Input, "gpio", "in-not"),
            |hal, n| gpio::Input::export(hal, n, identity.estop_bit(n)),
        )?;
        let outputs = each(
            hal,
            "gpio",
            names(Kind::Output, "gpio", "invert"),
            |hal, n| {
                let said = |key, word| identity.pin(b'o', n.into(), key) == Some(word);
                gpio::Output::export(hal, n, said("safe", "high"), said("invert", "true"))
            },
        )?;
        Ok(Blocks {
            packets,
            watchdog,
            wallclock,
            ethernet,
            ways,
            exchanges,
            stepgens,
            encoders,
            pwms,
            inputs,
            outputs,
        })
    }
}

/// One block per name, under `class.name`.
fn each<T>(
    hal: &mut Exporter<'_>,
    class: &str,
    names: Vec<(u8, String)>,
    mut export: impl FnMut(&mut Exporter<'_>, u8) -> Result<T, ExportError>,
) -> Result<Vec<T>, ExportError> {
    let each = names.iter();
    each.map(|(n, name)| export(&mut hal.channel(class, name, (*n).into()), *n))
        .collect()
}

/// What channels are called: the board's names where they make good HAL names of at most `room`
/// characters, their number in two digits otherwise.
fn channel_names<'n>(
    names: impl Iterator<Item = (u8, Option<&'n str>)>,
    room: usize,
) -> Vec<(u8, String)> {
    let mut result: Vec<(u8, String)> = Vec::with_capacity(MAX_CHANNELS);
    for (n, name) in names {
        let good = name.filter(|name| {
            !name.is_empty()
                && name.len() <= room
                && name
                    .bytes()
                    .all(|b| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'-')
                // Digits alone could be taken for another channel's number.
                && !name.bytes().all(|b| b.is_ascii_digit())
                && !result.iter().any(|(_, known)| known == name)
        });
        result.push((n, good.map_or_else(|| format!("{n:02}"), str::to_owned)));
    }
    result
}

#[cfg(test)]
mod tests {
    use super::channel_names;

    #[test]
    fn a_channel_is_called_what_the_board_calls_it_if_hal_can_bear_that() {
        let names = [
            Some("x"),
            None,
            Some("Y"),
            Some("spindle-on"),
            Some("x"),
            Some("3"),
        ];
        let called = |names: &[Option<&str>], room| -> Vec<String> {
            let names = (0..).zip(names.iter().copied());
            let called = channel_names(names, room).into_iter();
            called.map(|(_, name)| name).collect()
        };
        assert_eq!(called(&names, 9), ["x", "01", "02", "03", "04", "05"]);
        assert_eq!(called(&[Some("spindle-on")], 10), ["spindle-on"]);
    }

    #[test]
    fn a_channel_without_a_good_name_is_called_by_its_own_number() {
        let names = [(50, Some("probe")), (7, None), (12, Some("Door"))];
        let called = [(50, "probe"), (7, "07"), (12, "12")];
        let called = called.map(|(n, name)| (n, name.to_owned()));
        assert_eq!(channel_names(names.into_iter(), 9), called);
    }
}
