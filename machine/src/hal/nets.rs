//! Signals with one source and what reads them.

use crate::model::Switch;
use std::fmt::Write as _;

/// In the order in which they were asked for.
#[derive(Default)]
pub(super) struct Nets(Vec<Net>);

struct Net {
    signal: String,
    source: String,
    sinks: Vec<String>,
}

impl Nets {
    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// This pin reads that switch.
    pub(super) fn read(&mut self, switch: &Switch, sink: String) {
        let source = switch.pin();
        match self.0.iter_mut().find(|net| net.source == source) {
            Some(net) if net.sinks.contains(&sink) => {}
            Some(net) => net.sinks.push(sink),
            None => self.0.push(Net {
                signal: switch.signal(),
                source,
                sinks: vec![sink],
            }),
        }
    }

    pub(super) fn to_text(&self) -> String {
        let mut text = String::new();
        for net in &self.0 {
            let (signal, source, sinks) = (&net.signal, &net.source, net.sinks.join(" "));
            let _ = writeln!(text, "net in:{signal} {source} => {sinks}");
        }
        text
    }
}
