//! Executes a datagram: reads, writes, and the exchange.

use super::Mind;
use std::net::SocketAddr;
use wire::exchange::{self, Command, EncoderStatus, Latch, Status};
use wire::refusal::COUNTERS_WAYS;
use wire::units::{Clocks, Count, Position, Velocity};
use wire::{FaultReason, MAX_WORDS, Packet, Refusal, ReplyWriter, State, etherbone, map};

const RESPONSE_END: u32 = map::SESSION_RESPONSE + 16;
const WAYS_END: u32 = COUNTERS_WAYS + 12;

impl Mind {
    pub(super) fn serve(
        &mut self,
        words: &[u32],
        from: SocketAddr,
    ) -> Result<Option<Vec<u32>>, Refusal> {
        let packet = Packet::new_checked(words)?;
        let record = packet.records().next().ok_or(Refusal::Short)?;
        if record.write_base == map::COMMAND && !record.writes.is_empty() {
            self.tick(true);
            return self.exchange(record.writes, from).map(Some);
        }
        self.tick(false);
        self.proof = None;
        for record in packet.records() {
            if record.write_base == map::SESSION_RESPONSE {
                self.proof = record.writes.try_into().ok();
            }
            for (n, word) in record.writes.iter().enumerate() {
                self.may_write(record.write_base + 4 * n as u32, *word, from)?;
            }
        }
        let mut buffer = vec![0; MAX_WORDS];
        let mut writer = ReplyWriter::new(&mut buffer, etherbone::HEADER);
        for record in packet.records() {
            for (n, word) in record.writes.iter().enumerate() {
                self.write(record.write_base + 4 * n as u32, *word, from)?;
            }
            if !record.reads.is_empty() {
                writer.write_record(record.return_base, record.reads.len() as u8);
                for address in record.reads {
                    writer.push(self.read(*address, from));
                }
            }
        }
        let used = writer.words().len();
        buffer.truncate(used);
        Ok((used > etherbone::HEADER_WORDS).then_some(buffer))
    }

    /// Never the same twice: the number of answers is part of it.
    fn challenge(&self, from: SocketAddr) -> [u32; 4] {
        let free = self.owner.is_none_or(|owner| owner == from);
        match self.key {
            Some(_) if free => [self.boot_id, self.proved, from.port().into(), 77],
            Some(_) | None => wire::auth::NONE,
        }
    }

    fn may_write(&mut self, address: u32, word: u32, from: SocketAddr) -> Result<(), Refusal> {
        let owner = self.owner == Some(from);
        match address {
            map::SESSION_RESPONSE..RESPONSE_END => Ok(()),
            map::SESSION_ACQUIRE => {
                let free = self.owner.is_none_or(|owner| owner == from);
                if !free || self.knobs.foreign_owner.is_some() {
                    return Err(Refusal::NotOwner);
                }
                let Some(key) = self.key else { return Ok(()) };
                if self.proof != Some(key.acquire(self.challenge(from), word)) {
                    return Err(Refusal::Key);
                }
                self.proved += 1;
                Ok(())
            }
            map::SESSION_RELEASE if owner => Ok(()),
            map::CONFIG..map::COMMAND if owner => {
                let live_safe = (map::CONFIG_PWM..map::CONFIG_ENCODER).contains(&address)
                    && address.is_multiple_of(map::CONFIG_STRIDE);
                if self.gate && !live_safe {
                    Err(Refusal::Armed)
                } else {
                    Ok(())
                }
            }
            map::FLASH..map::SERVICE | map::SESSION_REBOOT => match self.state {
                State::Armed | State::Stopping => Err(Refusal::Armed),
                _ if self.owner.is_some_and(|owner| owner != from) => Err(Refusal::NotOwner),
                _ if self.knobs.foreign_owner.is_some() => Err(Refusal::NotOwner),
                _ if self.key.is_some() && !owner => Err(Refusal::Key),
                _ if self.flash.busy() => Err(Refusal::Busy),
                _ => Ok(()),
            },
            map::SESSION_RELEASE | map::CONFIG..map::COMMAND => Err(Refusal::NotOwner),
            _ => Err(Refusal::ReadOnly),
        }
    }

    fn write(&mut self, address: u32, word: u32, from: SocketAddr) -> Result<(), Refusal> {
        match address {
            map::SESSION_ACQUIRE => {
                if self.state == State::Armed {
                    self.stop(FaultReason::SessionLost);
                }
                self.owner = Some(from);
                self.token = word ^ 0x5a5a_0000 ^ self.boot_id;
                self.last_sequence = 0;
                self.request = None;
            }
            map::SESSION_RELEASE => {
                if word != self.token {
                    return Err(Refusal::NotOwner);
                }
                if self.state == State::Armed {
                    self.stop(FaultReason::SessionLost);
                }
                self.owner = None;
            }
            map::FLASH..map::SERVICE => self.flash.write(address, word),
            map::SESSION_REBOOT => self.reboot(),
            map::SESSION_RESPONSE..RESPONSE_END => {}
            _ => {
                self.config.insert(address, word);
            }
        }
        Ok(())
    }

    fn read(&mut self, address: u32, from: SocketAddr) -> u32 {
        let foreign = self.knobs.foreign_owner.map(SocketAddr::V4);
        let owner = foreign.or(self.owner).and_then(|owner| match owner {
            SocketAddr::V4(owner) => Some(owner),
            SocketAddr::V6(_) => None,
        });
        match address {
            map::DESCRIBE..map::DESCRIBE_BLOB => {
                let words = self.describe().to_words();
                let mut word = words.get(address as usize / 4).copied().unwrap_or(0);
                match address / 4 {
                    0 => word = self.knobs.magic.unwrap_or(word),
                    1 => word = self.knobs.wire_version.unwrap_or(word),
                    _ => {}
                }
                word
            }
            map::DESCRIBE_BLOB..map::SESSION => {
                let blob = self.blob();
                let at = (address - map::DESCRIBE_BLOB) as usize;
                blob.get(at..at + 4)
                    .map_or(0, |b| u32::from_be_bytes(b.try_into().unwrap()))
            }
            map::SESSION_TOKEN if self.owner == Some(from) => self.token,
            map::SESSION_OWNER_IP => owner.map_or(0, |owner| (*owner.ip()).into()),
            map::SESSION_OWNER_PORT => owner.map_or(0, |owner| owner.port().into()),
            map::SESSION_LAST_SEQ => self.last_sequence,
            map::SESSION_CHALLENGE..map::SESSION_RESPONSE => {
                self.challenge(from)[(address - map::SESSION_CHALLENGE) as usize / 4]
            }
            map::CONFIG..map::COMMAND => self.setting(address),
            map::FLASH_PINS => self.loaded(),
            map::SERVICE.. => self.ident(address),
            map::FLASH..map::SERVICE => {
                let link = self.link();
                self.flash.read(address, link)
            }
            map::STATUS..map::COUNTERS => {
                let mut words = [0; exchange::STATUS_MAX];
                let words = self.last_status.emit(self.channels, &mut words).unwrap();
                let at = (address - map::STATUS) as usize / 4;
                words.get(at).copied().unwrap_or(0)
            }
            COUNTERS_WAYS..WAYS_END => self.knobs.ways[(address - COUNTERS_WAYS) as usize / 4],
            _ => 0,
        }
    }

    fn exchange(&mut self, words: &[u32], from: SocketAddr) -> Result<Vec<u32>, Refusal> {
        let command = Command::parse(words, self.channels)?;
        if self.owner != Some(from) || command.token != self.token {
            return Err(Refusal::NotOwner);
        }
        exchange::judge_sequence(command.sequence, self.last_sequence)?;
        let left =
            (self.fed + u64::from(self.setting(map::CONFIG_BOARD))).saturating_sub(self.now) as u32;
        // Sampled on the clock of the commit: before it takes effect.
        let mut stepgen = [(Position::ZERO, Velocity(0)); exchange::MAX_CHANNELS];
        let mut encoder = [EncoderStatus::default(); exchange::MAX_CHANNELS];
        for (n, axis) in self.axes.iter().enumerate() {
            stepgen[n] = (Position(axis.ramp.position), axis.ramp.velocity());
            encoder[n].count = Count(axis.pulses() as u32);
            encoder[n].edge_time = self.now as u32 & 0x00ff_ffff;
        }
        let here = self.axes[0].pulses() as i32;
        let counted = here - self.knobs.encoder_lag;
        encoder[0].count = Count(counted as u32);
        encoder[0].errors = self.knobs.quad_errors;
        let lag = self.knobs.encoder_lag;
        // Upwards: the last index that was passed. No test goes downwards.
        let index_at = |here: i32| match self.knobs.index_every {
            Some(every) => Some(here.div_euclid(every) * every),
            None => self.knobs.index_at,
        };
        let (index_0, index_1) = (index_at(counted), index_at(here));
        let probe_at = self.knobs.probe_at;
        self.latches[0].turn(counted, index_0, probe_at.map(|at| at - lag));
        self.latches[1].turn(here, index_1, probe_at);
        let [encoder_flags, stepgen_flags] = self.latches.map(|latch| latch.flags());
        // A channel that was not selected gives a value, too.
        let latch = match command.latch {
            Latch::Encoder(0) => self.latches[0].caught.map_or(-1, |(_, at)| at),
            Latch::Stepgen(0) => self.latches[1].caught.map_or(-1, |(_, at)| at),
            Latch::Encoder(_) | Latch::Stepgen(_) => -1,
        };
        self.decide(&command);
        self.pending = None;
        match command.apply_at {
            Some(at) if self.state == State::Armed && at.0 > self.now => {
                self.pending = Some(command);
            }
            Some(_) | None => self.commit(&command),
        }
        self.fed = self.now;
        self.last_sequence = command.sequence;
        self.exchanges += 1;
        self.command = command;
        let status = Status {
            state: self.state_word(true),
            sequence: command.sequence,
            arrival: Clocks(self.now),
            sample: Clocks(self.now),
            watchdog_left: left,
            refused: Count(self.refused),
            boot_id: self.boot_id,
            estop: self.estop_latched,
            gpio_in: self.knobs.gpio_in,
            index_latched: encoder_flags.0,
            probe_latched: encoder_flags.1,
            illegal: self.knobs.illegal,
            rate_limited: self.knobs.rate_limited,
            stepgen_index_latched: stepgen_flags.0,
            stepgen_probe_latched: stepgen_flags.1,
            latch: Count(latch as u32),
            stepgen,
            encoder,
        };
        self.last_status = status;
        let mut block = [0; exchange::STATUS_MAX];
        let block = status.emit(self.channels, &mut block).unwrap();
        let mut buffer = vec![0; MAX_WORDS];
        let mut writer = ReplyWriter::new(&mut buffer, etherbone::HEADER);
        writer.write_record(command.sequence, block.len() as u8);
        writer.extend(block);
        let used = writer.words().len();
        buffer.truncate(used);
        Ok(buffer)
    }

    /// The firmware's rule for arming: seen low, then high, then one more command.
    fn decide(&mut self, command: &Command) {
        let edge = self.request == Some(false) && command.enable_request;
        self.request = match (self.request, command.enable_request) {
            (_, false) => Some(false),
            (None, true) => None,
            (Some(_), true) => Some(true),
        };
        match self.state {
            State::Armed if !command.enable => self.stop(FaultReason::HostDisable),
            State::Disarmed | State::Faulted if edge => {
                if !self.knobs.external_reset && self.knobs.estop == 0 {
                    self.state = State::Disarmed;
                    self.bitten = false;
                    self.estop_latched = 0;
                    self.reset_latched = false;
                    self.edge = true;
                    return;
                }
            }
            State::Disarmed if self.edge && command.enable_request && command.enable => {
                if !self.knobs.external_reset && !self.bitten {
                    self.state = State::Armed;
                    self.reason = FaultReason::None;
                    self.gate = true;
                }
            }
            State::Boot | State::Disarmed | State::Armed | State::Stopping | State::Faulted => {}
        }
        self.edge = false;
    }
}
