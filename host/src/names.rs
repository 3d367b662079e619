//! `names=lcnc`, `names=litexcnc[:NAME,...]` and `names=litexcnc-named[:NAME,...]`: the pins of
//! other drivers for the same boards, so that a HAL file for one of them needs only another
//! `loadrt` line. Tests run LinuxCNC with the two files in `host/examples/peers`.
//!
//! If a pin of the other driver equals one of ours in type, direction and unit, it becomes a HAL
//! alias: one pin with two names. If it differs, it is a pin of its own, coupled to ours by glue
//! code that runs before `write` and after `read`. A value written to such a pin is passed on when
//! it *changes*, so if a file uses both names for one pin, the last write counts, and a pin without
//! a write changes nothing.
//!
//! The ordinary names stay. `docs/pins.md` lists the meaning of each name here, and each difference
//! from the other driver.

mod lcnc;
mod litexcnc;

use crate::client::Identity;
use crate::driver::Driver;
use crate::glue::Glue;
use crate::hal::checked::{Rule, Source, Watch};
use crate::hal::{Backend, Catalogue, Direction, ExportError, Exported, Exporter, Handle, Type};
use Direction::Out;
use Type::Bit;
use wire::board::HAL_NAME_LEN;

/// The driver with the names.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Scheme {
    /// `Lcnc.NN.*`.
    Lcnc,
    /// `NAME.*`: a name per board; the board's own configuration name where none is given.
    LitexCnc(Vec<String>),
    /// The same, where the channels that have a name in its JSON are called by it, and not by their
    /// number. A pin has one alias in HAL, so it is one or the other.
    LitexCncNamed(Vec<String>),
}

/// Why a board does not get others' names.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum NamesError {
    /// `names=` is not understood.
    Scheme(String),
    /// This board does not say which number LiteX-CNC gave its inputs and outputs, and our numbers
    /// differ.
    Row(String, RowError),
    /// This board gives a channel a name of LiteX-CNC's that is none.
    Name(String, NameError),
}

/// What is wrong with the name of a channel in LiteX-CNC.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum NameError {
    /// Not a word of a HAL file.
    NoWord(String),
    /// Two channels of a kind have this one.
    Twice(String),
    /// This pin would be too long for HAL.
    Long(String),
}

/// What is wrong with the numbers of a board's inputs and outputs in LiteX-CNC's row.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RowError {
    /// It gives no number, and has channels that shift the numbers.
    Unsaid,
    /// This is not a number of the row.
    NoNumber(String),
    /// Two channels have this one.
    Twice(u8),
}

impl core::fmt::Display for NamesError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            NamesError::Scheme(text) => write!(
                f,
                "\"{text}\" is not valid for names=; write names=lcnc, names=litexcnc or names=litexcnc:NAME[,NAME...], one per board, or litexcnc-named in place of litexcnc"
            ),
            NamesError::Row(prefix, wrong) => {
                write!(f, "names=litexcnc cannot number gpio of \"{prefix}\": ")?;
                match wrong {
                    RowError::Unsaid => f.write_str(
                        "LiteX-CNC numbers inputs and outputs in one row, in the order of its JSON, and the board does not say which number each had, so that its HAL file would switch the wrong outputs",
                    ),
                    RowError::NoNumber(text) => {
                        write!(f, "the board says {text:?}, which is not a number from 0 to 127")
                    }
                    RowError::Twice(number) => {
                        write!(f, "the board gives the number {number} to two channels")
                    }
                }?;
                f.write_str(
                    "; import that JSON again (ferrocnc config import litexcnc), or write litexcnc = NUMBER beside each [[gpio_in]] and [[gpio_out]] of the board file, then build and update the board",
                )
            }
            NamesError::Name(prefix, wrong) => {
                write!(
                    f,
                    "names=litexcnc-named cannot name a channel of \"{prefix}\": "
                )?;
                match wrong {
                    NameError::NoWord(name) => write!(
                        f,
                        "the board says {name:?}, which no HAL file can contain; correct litexcnc_name in the board file, then build and update the board"
                    ),
                    NameError::Twice(name) => write!(
                        f,
                        "the board calls two channels {name:?}; correct litexcnc_name in the board file, then build and update the board"
                    ),
                    NameError::Long(pin) => write!(
                        f,
                        "{pin} has {} characters and HAL takes {HAL_NAME_LEN}; write a shorter name of the board, names=litexcnc-named:NAME, here and in the HAL file",
                        pin.len()
                    ),
                }
            }
        }
    }
}

impl std::error::Error for NamesError {}

impl Scheme {
    /// The module parameter; empty means no other names.
    pub fn parse(text: &str) -> Result<Option<Scheme>, NamesError> {
        let error = || NamesError::Scheme(text.to_owned());
        match text.trim() {
            "" => Ok(None),
            "lcnc" => Ok(Some(Scheme::Lcnc)),
            "litexcnc" => Ok(Some(Scheme::LitexCnc(Vec::new()))),
            "litexcnc-named" => Ok(Some(Scheme::LitexCncNamed(Vec::new()))),
            other => {
                let (scheme, names) = other.split_once(':').ok_or_else(error)?;
                let scheme = match scheme {
                    "litexcnc" => Scheme::LitexCnc,
                    "litexcnc-named" => Scheme::LitexCncNamed,
                    _ => return Err(error()),
                };
                let names: Vec<String> = names
                    .split(',')
                    .map(|name| name.trim().to_owned())
                    .collect();
                if names.iter().any(|name| !is_name(name)) {
                    return Err(error());
                }
                Ok(Some(scheme(names)))
            }
        }
    }

    /// What everything of board `index` begins with.
    pub fn prefix(&self, index: usize, identity: &Identity) -> String {
        match self {
            Scheme::Lcnc => format!("Lcnc.{index:02}"),
            Scheme::LitexCnc(names) | Scheme::LitexCncNamed(names) => {
                let blob = identity.blob();
                let own = blob.text(wire::board::Kind::Configuration, 0);
                let given = names.get(index).map(String::as_str);
                given
                    .or(own.filter(|own| is_name(own)))
                    .unwrap_or("test")
                    .to_owned()
            }
        }
    }

    /// Refuses a board if the other driver's names would belong to other pins.
    pub fn check(&self, index: usize, identity: &Identity) -> Result<(), NamesError> {
        let prefix = || self.prefix(index, identity);
        let row = || litexcnc::judge(identity).map_err(|wrong| NamesError::Row(prefix(), wrong));
        match self {
            Scheme::Lcnc => Ok(()),
            Scheme::LitexCnc(_) => row(),
            Scheme::LitexCncNamed(_) => {
                row()?;
                litexcnc::judge_names(identity, &prefix())
                    .map_err(|wrong| NamesError::Name(prefix(), wrong))
            }
        }
    }

    /// The realtime functions: name after the prefix, and what they do.
    pub fn functions(&self) -> &'static [(&'static str, Does)] {
        match self {
            Scheme::Lcnc => &[("update", Does::Both)],
            Scheme::LitexCnc(_) | Scheme::LitexCncNamed(_) => {
                &[("read", Does::Read), ("write", Does::Write)]
            }
        }
    }
}

/// What a function of theirs does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Does {
    /// Our `read`.
    Read,
    /// Our `write`.
    Write,
    /// One after the other.
    Both,
}

/// LiteX-CNC allows 16 characters; more would not leave its longest pin enough room either.
fn is_name(name: &str) -> bool {
    let good = |b: u8| b.is_ascii_alphanumeric() || b == b'-' || b == b'_';
    !name.is_empty() && name.len() <= 16 && name.bytes().all(good)
}

/// Exports the names of a scheme for a board.
pub fn export(
    scheme: &Scheme,
    backend: &mut dyn Backend,
    index: usize,
    identity: &Identity,
    driver: &Driver,
) -> Result<Glue, ExportError> {
    let prefix = scheme.prefix(index, identity);
    let mut theirs = Catalogue::default();
    let mut names = Names {
        hal: Exporter::new(backend, prefix)
            .with_foreign_names()
            .listed(&mut theirs),
        ours: driver.catalogue(),
        glue: Glue::default(),
    };
    match scheme {
        Scheme::Lcnc => lcnc::export(&mut names, identity, driver)?,
        Scheme::LitexCnc(_) => litexcnc::export(&mut names, identity, driver, false)?,
        Scheme::LitexCncNamed(_) => litexcnc::export(&mut names, identity, driver, true)?,
    }
    let mut glue = names.glue;
    glue.watches = theirs.iter().filter_map(Watch::of).collect();
    Ok(glue)
}

/// A name, type and direction of theirs.
type Theirs<'n> = (&'n str, Type, Direction);

/// Names under construction.
struct Names<'b> {
    hal: Exporter<'b>,
    ours: &'b Catalogue,
    glue: Glue,
}

impl<'b> Names<'b> {
    fn ours(&self, logical: &str) -> Result<&'b Exported, ExportError> {
        self.ours.find(logical).ok_or_else(|| ExportError {
            name: logical.to_owned(),
            errno: -libc::ENOENT,
        })
    }

    /// One pin, two names.
    fn alias(&mut self, theirs: &str, ours: &str) -> Result<(), ExportError> {
        let exported = self.ours(ours)?;
        self.hal.alias(exported, theirs)
    }

    /// A pin of theirs, two names.
    fn second(&mut self, theirs: &str, other: &str) -> Result<(), ExportError> {
        self.hal.alias_own(theirs, other)
    }

    /// A number of ours that HAL sets, as it is in force.
    fn checked(&self, logical: &str) -> Result<Source, ExportError> {
        let source = self.ours(logical)?.source.clone();
        source.ok_or_else(|| ExportError {
            name: logical.to_owned(),
            errno: -libc::EINVAL,
        })
    }

    /// A number of theirs that HAL sets.
    fn told(
        &mut self,
        (name, ty, direction): Theirs<'_>,
        initial: f64,
        rule: Rule,
    ) -> Result<Source, ExportError> {
        self.hal.checked(name, ty, direction, initial, rule)
    }

    /// A pin of theirs nothing is coupled to yet, a bit or one that we write.
    fn lone(
        &mut self,
        (name, ty, direction): Theirs<'_>,
        initial: f64,
    ) -> Result<Handle, ExportError> {
        self.hal.export(name, ty, direction, initial)
    }

    /// Ours is what `value` says, told whenever that changes.
    fn set(
        &mut self,
        ours: &str,
        value: impl Fn() -> f64 + Send + 'static,
    ) -> Result<(), ExportError> {
        let ours = self.ours(ours)?.handle;
        let mut last = value();
        ours.set(last);
        self.glue.inputs.push(Box::new(move || {
            let now = value();
            if now.to_bits() != last.to_bits() {
                last = now;
                ours.set(now);
            }
        }));
        Ok(())
    }

    /// A number of theirs that sets ours, converted.
    fn follow(
        &mut self,
        theirs: Theirs<'_>,
        (initial, rule): (f64, Rule),
        ours: &[&str],
        convert: fn(f64) -> f64,
    ) -> Result<(), ExportError> {
        let theirs = self.told(theirs, initial, rule)?;
        for ours in ours {
            let theirs = theirs.clone();
            self.set(ours, move || convert(theirs.get()))?;
        }
        Ok(())
    }

    /// A pin of theirs that shows what `value` says.
    fn publish(
        &mut self,
        theirs: Theirs<'_>,
        value: impl Fn() -> f64 + Send + 'static,
    ) -> Result<(), ExportError> {
        let theirs = self.lone(theirs, value())?;
        self.glue
            .outputs
            .push(Box::new(move || theirs.set(value())));
        Ok(())
    }

    /// A pin of theirs that shows ours, converted.
    fn show(
        &mut self,
        theirs: Theirs<'_>,
        ours: &str,
        convert: fn(f64) -> f64,
    ) -> Result<(), ExportError> {
        let ours = self.ours(ours)?.handle;
        self.publish(theirs, move || convert(ours.get()))
    }

    /// High for the period in which the index was found: when `index-enable` fell by itself.
    fn index_pulse(&mut self, theirs: &str, ours: &str) -> Result<(), ExportError> {
        let pulse = self.lone((theirs, Bit, Out), 0.0)?;
        let enable = self.ours(ours)?.handle;
        let asked = std::sync::Arc::new(std::sync::atomic::AtomicBool::new(false));
        let relaxed = std::sync::atomic::Ordering::Relaxed;
        let seen = std::sync::Arc::clone(&asked);
        self.glue
            .inputs
            .push(Box::new(move || seen.store(enable.get() != 0.0, relaxed)));
        self.glue.outputs.push(Box::new(move || {
            let found = asked.load(relaxed) && enable.get() == 0.0;
            pulse.set(f64::from(found));
        }));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_parameter_is_understood_or_refused_by_its_own_text() {
        assert_eq!(Scheme::parse(""), Ok(None));
        assert_eq!(Scheme::parse("lcnc"), Ok(Some(Scheme::Lcnc)));
        assert_eq!(
            Scheme::parse("litexcnc:mill, io_1"),
            Ok(Some(Scheme::LitexCnc(vec![
                "mill".to_owned(),
                "io_1".to_owned()
            ])))
        );
        assert_eq!(
            Scheme::parse("litexcnc-named:mill"),
            Ok(Some(Scheme::LitexCncNamed(vec!["mill".to_owned()])))
        );
        for text in [
            "Lcnc",
            "litexcnc:",
            "litexcnc-named:",
            "litexcnc-x:a",
            "litexcnc:a,,b",
            "litexcnc:a.b",
            "mesa",
        ] {
            let message = Scheme::parse(text).unwrap_err().to_string();
            assert!(message.contains(text), "{message}");
        }
    }
}
