//! Lockstep: simulated time passes with the host's exchanges ([`super`]).

use std::net::SocketAddr;
use std::sync::mpsc::{RecvTimeoutError, TryRecvError};
use std::time::{Duration, Instant};

use super::device::{Device, Service};
use super::{Event, SLICE, Server};
use crate::exchange::{is_read, is_request};

/// How long a host that asked something may take until its next exchange, in the machine's time.
const NEXT_EXCHANGE: Duration = Duration::from_millis(50);

impl<D: Device> Server<D> {
    pub(super) fn lockstep(&mut self, period: u64) {
        if self.waited() >= NEXT_EXCHANGE {
            self.answer_asked();
        }
        let silent = self
            .last_exchange
            .is_some_and(|at| at.elapsed() >= self.options.silence);
        if silent {
            self.last_exchange = None;
            self.orphan_until = self.rig.clock() + self.options.orphan_clocks;
            eprintln!(
                "sim: no exchange for {:?}, the board runs on by itself",
                self.options.silence
            );
        }
        let event = if self.rig.clock() < self.orphan_until {
            self.pass(self.rig.clock() + SLICE);
            self.events
                .try_recv()
                .map_err(|e| e == TryRecvError::Disconnected)
        } else {
            let until_silence = self
                .last_exchange
                .map(|at| self.options.silence.saturating_sub(at.elapsed()))
                .unwrap_or(Duration::MAX);
            // A fifth of a second at most: signals are looked at in between.
            let patience = match self.asked.is_empty() {
                true => Duration::from_millis(200),
                false => NEXT_EXCHANGE.saturating_sub(self.waited()),
            };
            self.events
                .recv_timeout(until_silence.min(patience))
                .map_err(|e| e == RecvTimeoutError::Disconnected)
        };
        match event {
            Ok(Event::Datagram(Service::Etherbone, sender, payload)) if is_request(&payload) => {
                // A period starts where the last one ended, unless time has been moved by something
                // else since. A servo thread takes the session in the period before its first one.
                let before = match self.exchanger == Some(sender) {
                    true => 0,
                    false => period,
                };
                let start = (self.rig.clock() + before).max(self.period_end);
                self.pass(start);
                self.period_end = start + period;
                self.orphan_until = 0;
                self.post(Service::Etherbone, sender, &payload);
                for (_, host, asked) in core::mem::take(&mut self.asked) {
                    self.post(Service::Etherbone, host, &asked);
                }
                self.pass(self.period_end);
                self.last_exchange = Some(Instant::now());
                self.exchanger = Some(sender);
            }
            Ok(Event::Datagram(Service::Etherbone, sender, payload))
                if self.last_exchange.is_some()
                    && self.exchanger == Some(sender)
                    && is_read(&payload) =>
            {
                self.asked.push((Instant::now(), sender, payload));
            }
            Ok(Event::Datagram(service, sender, payload)) => {
                self.answer(service, sender, &payload);
            }
            Ok(event) => {
                self.handle(event);
                self.settle_consoles();
            }
            Err(disconnected) => self.quit |= disconnected,
        }
    }

    /// The board has time until the answer to this datagram is out.
    fn answer(&mut self, service: Service, sender: SocketAddr, payload: &[u8]) {
        let port = self.post(service, sender, payload);
        let until = self.rig.clock() + self.rig.wait_for(service, payload);
        while self.rig.clock() < until && !self.pass_frame(until).contains(&port) {}
    }

    /// How long the first of the questions has waited, whatever else has come since.
    fn waited(&self) -> Duration {
        self.asked
            .first()
            .map_or(Duration::ZERO, |(at, ..)| at.elapsed())
    }

    /// The host that asked makes no exchange.
    fn answer_asked(&mut self) {
        for (_, host, asked) in core::mem::take(&mut self.asked) {
            self.answer(Service::Etherbone, host, &asked);
        }
    }
}
