//! Analysis of the release image's machine code: where it can panic, and how deep its stack can
//! get.
//!
//! Every panic of the image comes down to one `ebreak` (`soc/postmortem.rs` of the image), so the
//! places that can panic are the calls of `core`'s panicking functions and the `ebreak`s inlined
//! elsewhere. The stack is the longest way through the call graph: the stack of a function is in
//! its `addi sp`, its calls are in its jumps. A call through a table may reach every function with
//! an address in the ROM's data or made by code. Recursion has no bound and is an error.
//!
//! It reads RV32IM as rustc and riscv-rt emit it; an unknown pattern is an error, not a guess.

use object::{Object, ObjectSection, ObjectSymbol, SectionKind, SymbolKind};
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::path::Path;

/// Functions of `core` that do not come back, by a part of their name.
const PANICKING: &[&str] = &[
    "panicking",
    "slice_index_fail",
    "unwrap_failed",
    "expect_failed",
    "copy_from_slice_impl",
    "len_mismatch_fail",
    "panic_nounwind",
    "rust_begin_unwind",
];
/// Below lie start-up, traps and the fast path. No code takes their addresses, so a number this
/// small in the data is a number.
const CALLED_BY_NAME: u32 = 0x800;
/// In riscv-rt's tables of exceptions and interrupts only; `_start_trap_rust` names them, too. And
/// the trap vector itself, where only the processor goes.
const HANDLERS: &[&str] = &[
    "_default_abort",
    "DefaultHandler",
    "ExceptionHandler",
    "services_trap",
];
const RA: u32 = 1;
const SP: u32 = 2;
const T0: u32 = 5;
const T2: u32 = 7;
const EBREAK: u32 = 0x0010_0073;
const UNIMP: u32 = 0xc000_1073;
const MRET: u32 = 0x3020_0073;
const RET: u32 = 0x0000_8067;
/// Functions begin at lines of the instruction cache; one linker leaves 0 in between, one `nop`.
const PADDING: [u32; 2] = [0, 0x0000_0013];
/// `j` to the next instruction.
const J_NEXT: u32 = 0x0040_006f;
/// Restores registers and returns, for the function that jumps to it (`firmware/src/bin/saves.s`).
const RESTORE: &str = "__riscv_restore_";

/// The code of an image.
#[derive(Debug)]
pub struct Code {
    words: BTreeMap<u32, u32>,
    /// Start to name and end.
    functions: BTreeMap<u32, (String, u32)>,
    /// Every name of a function.
    names: BTreeMap<String, u32>,
    /// Words of the ROM's data.
    data: Vec<u32>,
    /// Bytes of stack there are.
    pub stack: u32,
}

/// A place that can panic.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Panic {
    /// The function it is in, without hashes.
    pub function: String,
    /// Where.
    pub at: u32,
}

/// What a function does to the stack.
#[derive(Clone, Debug, Default)]
struct Frame {
    /// Deepest, without its calls.
    own: u32,
    /// The depth at each call.
    calls: BTreeMap<Callee, u32>,
    /// The depth at its return: not 0 in a function that the outliner made.
    left: i64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Callee {
    At(u32),
    /// Through a table.
    Any,
}

/// The longest way, function by function.
#[derive(Clone, Debug, Default)]
pub struct Deepest {
    /// Bytes.
    pub bytes: u32,
    /// From the outside in: name, and bytes it takes before it calls the next.
    pub way: Vec<(String, u32)>,
}

/// What the services call back: they have a stack of their own, in SDRAM
/// (`firmware::services::abi`).
pub const CALLED_BACK: [&str; 4] = [
    "services_datagram",
    "services_send",
    "services_console",
    "services_leased",
];
/// They jump there with the function in `t2`, which it calls with the guard open.
const ENTER: &str = "services_enter";
/// Bytes of stack it takes for that.
const ENTER_STACK: u32 = 16;
/// The entry of the services, in its header: only the ROM calls it.
const WAY_IN: &str = "services_entry";
/// Takes the stack back from services that failed: it is as it was when they were called.
const WAY_BACK: &str = "services_end";
/// What was saved there.
const SAVED: i64 = 64;

impl Code {
    /// Reads the image.
    pub fn read(elf: &Path) -> Self {
        let bytes = std::fs::read(elf).unwrap_or_else(|why| panic!("{}: {why}", elf.display()));
        let file =
            object::File::parse(&*bytes).unwrap_or_else(|why| panic!("{}: {why}", elf.display()));
        let mut code = Code {
            words: BTreeMap::new(),
            functions: BTreeMap::new(),
            names: BTreeMap::new(),
            data: Vec::new(),
            stack: 0,
        };
        for section in file.sections() {
            let words = section.data().unwrap_or(&[]).as_chunks::<4>().0.iter();
            let words = words.map(|bytes| u32::from_le_bytes(*bytes));
            let base = section.address() as u32;
            match (section.name(), section.kind()) {
                (Ok(".stack"), _) => code.stack = section.size() as u32,
                (_, SectionKind::Text) => {
                    code.words.extend((base..).step_by(4).zip(words));
                }
                // The linker calls it strings when every part of it could be merged.
                (
                    _,
                    SectionKind::ReadOnlyData
                    | SectionKind::ReadOnlyDataWithRel
                    | SectionKind::ReadOnlyString
                    | SectionKind::Data,
                ) => code.data.extend(words),
                _ => {}
            }
        }
        let place = |name| {
            let mut symbols = file.symbols();
            let symbol = symbols.find(|symbol| symbol.name() == Ok(name));
            symbol.map(|symbol| symbol.address() as u32)
        };
        if let (Some(top), Some(end)) = (place("__services_stack"), place("__services_bss_end")) {
            code.stack = top - end;
        }
        for symbol in file.symbols() {
            let at = symbol.address() as u32;
            let code_of = |index| {
                file.section_by_index(index)
                    .is_ok_and(|section| section.kind() == SectionKind::Text)
            };
            let name = symbol.name().unwrap_or("?");
            let function = match symbol.kind() {
                SymbolKind::Text => true,
                // Hand-written: riscv-rt's. `$x` and the like only mark code.
                _ => name.starts_with('_'),
            };
            let ours = symbol.section_index().is_some_and(code_of);
            if function && ours && code.words.contains_key(&at) {
                let name = format!("{:#}", rustc_demangle::demangle(name));
                code.functions.entry(at).or_insert((name.clone(), 0));
                code.names.insert(name, at);
            }
        }
        code.close();
        code
    }

    /// Every function ends where the next begins, or at the padding in front of that.
    fn close(&mut self) {
        let mut end = self.words.keys().next_back().map_or(0, |last| last + 4);
        for (start, (_, its_end)) in self.functions.iter_mut().rev() {
            *its_end = end;
            let last = |end: u32| self.words.get(&(end - 4)).copied();
            while *its_end > *start + 4
                && last(*its_end).is_some_and(|word| PADDING.contains(&word))
            {
                *its_end -= 4;
            }
            end = *start;
        }
    }

    /// What is at this address.
    pub fn function(&self, at: u32) -> (u32, &str) {
        let found = self.functions.range(..=at).next_back();
        found.map_or((at, "?"), |(start, (name, _))| (*start, name))
    }

    /// Every place in the image that can panic: once per call, `core`'s own panicking functions
    /// left out.
    pub fn panics(&self) -> Vec<Panic> {
        let panicking = |name: &str| PANICKING.iter().any(|part| name.contains(part));
        let mut found = Vec::new();
        for (&at, &word) in &self.words {
            let (_, function) = self.function(at);
            let calls = self.jump_target(at, word).is_some_and(|target| {
                panicking(self.function(target).1) && self.functions.contains_key(&target)
            });
            if (calls || word == EBREAK) && !panicking(function) {
                found.push(Panic {
                    function: function.into(),
                    at,
                });
            }
        }
        found
    }

    /// Functions of `core` that panic and are in the image.
    pub fn panicking(&self) -> BTreeSet<&str> {
        let names = self.functions.values().map(|(name, _)| name.as_str());
        names
            .filter(|name| PANICKING.iter().any(|part| name.contains(part)))
            .collect()
    }

    /// Where `jal`, or `auipc` and `jalr`, goes.
    fn jump_target(&self, at: u32, word: u32) -> Option<u32> {
        match word & 0x7f {
            0x6f => Some(at.wrapping_add(jal_offset(word))),
            0x67 => {
                let base = self.constant(at, word >> 15 & 31)?;
                Some(base.wrapping_add(i_immediate(word)) & !1)
            }
            _ => None,
        }
    }

    /// What the one or two instructions before `at` put into `register`, if that is a constant.
    fn constant(&self, at: u32, register: u32) -> Option<u32> {
        if register == 0 {
            return Some(0);
        }
        let before = at.checked_sub(4)?;
        let word = *self.words.get(&before)?;
        let (opcode, rd) = (word & 0x7f, word >> 7 & 31);
        match opcode {
            0x17 if rd == register => Some(before.wrapping_add(word & !0xfff)),
            0x37 if rd == register => Some(word & !0xfff),
            // slli of what the one before made.
            0x13 if rd == register && word >> 12 & 7 == 1 => {
                Some(self.constant(before, word >> 15 & 31)? << (word >> 20 & 31))
            }
            0x13 if rd == register && word >> 12 & 7 == 0 => {
                let base = word >> 15 & 31;
                if base == 0 {
                    return Some(i_immediate(word));
                }
                let upper = *self.words.get(&before.checked_sub(4)?)?;
                let made = matches!(upper & 0x7f, 0x17 | 0x37) && upper >> 7 & 31 == base;
                let base = made.then(|| self.constant(before, base)).flatten()?;
                Some(base.wrapping_add(i_immediate(word)))
            }
            _ => None,
        }
    }

    /// The deepest the stack gets from `entry` on.
    pub fn deepest(&self, entry: &str) -> Result<Deepest, String> {
        let start = self.names.get(entry).copied();
        let start = start.ok_or_else(|| format!("no {entry} in the image"))?;
        let mut walk = Walk {
            code: self,
            frames: BTreeMap::new(),
            depths: BTreeMap::new(),
            open: Vec::new(),
            by_table: self.by_table(),
        };
        walk.deepest(start)
    }

    /// Functions that can be called through a table or a pointer.
    fn by_table(&self) -> BTreeSet<u32> {
        let in_data = self.data.iter().copied();
        let in_code = self.words.iter().filter_map(|(&at, &word)| {
            let made = word & 0x7f == 0x13 && word >> 12 & 7 == 0;
            let made = made
                .then(|| self.constant(at + 4, word >> 7 & 31))
                .flatten()?;
            // What is jumped to at once, or entered, is followed where that is done.
            let next = *self.words.get(&(at + 4))?;
            let enters = next & 0xfff == 0x6f
                && self
                    .jump_target(at + 4, next)
                    .is_some_and(|to| self.function(to).1 == ENTER);
            (next & 0x7f != 0x67 && !enters).then_some(made)
        });
        in_data
            .chain(in_code)
            .filter(|at| *at >= CALLED_BY_NAME && self.functions.contains_key(at))
            .filter(|at| {
                !HANDLERS
                    .iter()
                    .any(|name| self.names.get(*name) == Some(at))
            })
            .filter(|at| {
                let name = self.functions.get(at).map_or("", |(name, _)| name);
                name != WAY_IN && !CALLED_BACK.contains(&name)
            })
            .collect()
    }

    /// Is this the return of a function that has returned already, by its last jump to what
    /// restores registers? A compiler may leave it behind that jump, and one to it between them.
    fn has_returned(&self, at: u32, word: u32) -> bool {
        let word_at = |at: u32| self.words.get(&at).copied().unwrap_or(0);
        let stray = u32::from(word_at(at.wrapping_sub(4)) == J_NEXT);
        let last = at.wrapping_sub(4 + 4 * stray);
        let to = word_at(last);
        let jumps = to & 0xfff == 0x6f || to & 0xfff == 0x67;
        let target = self.jump_target(last, to).filter(|_| jumps);
        word == RET && target.is_some_and(|target| self.function(target).1.starts_with(RESTORE))
    }

    fn frame(&self, start: u32, walk: &mut Walk) -> Result<Frame, String> {
        let (name, end) = &self.functions[&start];
        let inside = |at: &u32| (start..*end).contains(at);
        let mut frame = Frame::default();
        let mut seen: BTreeMap<u32, i64> = BTreeMap::new();
        let mut todo = vec![(start, 0i64)];
        let mut left: Option<i64> = None;
        while let Some((at, depth)) = todo.pop() {
            if seen.get(&at).is_some_and(|known| *known >= depth) {
                continue;
            }
            seen.insert(at, depth);
            let deep = u32::try_from(depth.max(0)).unwrap_or(u32::MAX);
            if deep > self.stack.max(1 << 20) {
                return Err(format!("{name} takes stack in a loop at {at:#x}"));
            }
            frame.own = frame.own.max(deep);
            let word = *self
                .words
                .get(&at)
                .ok_or_else(|| format!("{name} runs out of the code at {at:#x}"))?;
            let (rd, rs1) = (word >> 7 & 31, word >> 15 & 31);
            let call = |frame: &mut Frame, callee| {
                let known = frame.calls.entry(callee).or_default();
                *known = (*known).max(deep);
            };
            let target = self.jump_target(at, word);
            match word & 0x7f {
                _ if matches!(word, EBREAK | UNIMP | MRET) => {}
                // The reset vector: everything begins anew.
                0x67 if rd == 0 && rs1 == 0 => {}
                0x6f | 0x67 if rd != 0 => {
                    let back = match target {
                        Some(target) => {
                            call(&mut frame, Callee::At(target));
                            walk.left(target)?
                        }
                        None => {
                            call(&mut frame, Callee::Any);
                            0
                        }
                    };
                    if inside(&(at + 4)) {
                        todo.push((at + 4, depth + back));
                    }
                }
                0x67 if target.is_none() && matches!(rs1, RA | T0) => {
                    left = left.max(Some(depth));
                }
                // A switch with its table in the ROM's data, or a tail call through a table.
                0x67 if target.is_none() => {
                    let cases = self.data.iter().filter(|at| inside(at) && *at % 4 == 0);
                    let switch: Vec<_> = cases.map(|case| (*case, depth)).collect();
                    if switch.is_empty() {
                        call(&mut frame, Callee::Any);
                        left = left.max(Some(depth));
                    }
                    todo.extend(switch);
                }
                0x6f | 0x67 => {
                    let target = target.unwrap_or_default();
                    let named = self.function(target).1;
                    if inside(&target) {
                        todo.push((target, depth));
                    } else if named == WAY_BACK {
                        left = left.max(Some(0));
                    } else if named == ENTER {
                        let function = self.constant(at, T2);
                        let function = function.ok_or_else(|| format!("{name} enters nothing"))?;
                        frame.calls.insert(Callee::At(function), deep + ENTER_STACK);
                        left = left.max(Some(depth));
                    } else {
                        call(&mut frame, Callee::At(target));
                        left = left.max(Some(depth + walk.left(target)?));
                    }
                }
                0x63 => {
                    todo.push((at.wrapping_add(branch_offset(word)), depth));
                    todo.push((at + 4, depth));
                }
                0x13 | 0x33 | 0x37 | 0x17 | 0x03 if rd == SP => {
                    todo.push((at + 4, self.depth_behind(name, at, word, depth)?));
                }
                _ => todo.push((at + 4, depth)),
            }
        }
        if let Some(at) = self.overlooked(start..*end, &seen) {
            return Err(format!("{name}: no way to {at:#x} was found"));
        }
        frame.left = left.unwrap_or(0);
        Ok(frame)
    }

    /// The depth of the stack after an instruction that writes its pointer.
    fn depth_behind(&self, name: &str, at: u32, word: u32, depth: i64) -> Result<i64, String> {
        let (rs1, function) = (word >> 15 & 31, word >> 12 & 7);
        match word & 0x7f {
            0x13 if rs1 == SP && function == 0 => Ok(depth - i64::from(i_immediate(word) as i32)),
            // More than an immediate holds.
            0x33 if rs1 == SP && function == 0 => {
                let by = self.constant(at, word >> 20 & 31).ok_or_else(|| {
                    format!("{name} moves the stack at {at:#x} by something not understood")
                })?;
                let by = i64::from(by as i32);
                let taken = if word >> 25 == 0 { -by } else { by };
                Ok(depth + taken)
            }
            // Start-up puts it at the top.
            0x13 if function == 7 && name == "_abs_start" => Ok(0),
            0x03 if name == WAY_BACK => Ok(SAVED),
            _ => Err(format!(
                "{name} moves the stack at {at:#x} in a way not understood"
            )),
        }
    }

    /// A compiler leaves a few instructions that nothing leads to. Those that take stack or go
    /// elsewhere were overlooked: the first of them in a function.
    fn overlooked(&self, function: Range<u32>, seen: &BTreeMap<u32, i64>) -> Option<u32> {
        let matters = |at: u32, word: u32| match word & 0x7f {
            0x67 => true,
            0x6f => {
                let inside = function.contains(&at.wrapping_add(jal_offset(word)));
                word >> 7 & 31 != 0 || !inside
            }
            0x13 | 0x33 | 0x37 | 0x17 | 0x03 => word >> 7 & 31 == SP,
            _ => false,
        };
        let mut all = self.words.range(function.clone());
        let found = all.find(|(at, word)| {
            !seen.contains_key(at) && matters(**at, **word) && !self.has_returned(**at, **word)
        });
        found.map(|(at, _)| *at)
    }
}

struct Walk<'c> {
    code: &'c Code,
    frames: BTreeMap<u32, Frame>,
    depths: BTreeMap<u32, Deepest>,
    /// The functions on the present way: one that appears twice calls itself.
    open: Vec<u32>,
    by_table: BTreeSet<u32>,
}

impl Walk<'_> {
    fn frame(&mut self, start: u32) -> Result<Frame, String> {
        if let Some(frame) = self.frames.get(&start) {
            return Ok(frame.clone());
        }
        if !self.code.functions.contains_key(&start) {
            let (_, name) = self.code.function(start);
            let caller = self.open.last().map_or("?", |at| self.code.function(*at).1);
            return Err(format!(
                "{caller} calls {start:#x}, which is in the middle of {name}"
            ));
        }
        // Until it is known, for those that call themselves: they are found out by `deepest`.
        self.frames.insert(start, Frame::default());
        let frame = self.code.frame(start, self)?;
        self.frames.insert(start, frame.clone());
        Ok(frame)
    }

    fn left(&mut self, start: u32) -> Result<i64, String> {
        Ok(self.frame(start)?.left)
    }

    fn deepest(&mut self, start: u32) -> Result<Deepest, String> {
        if let Some(known) = self.depths.get(&start) {
            return Ok(known.clone());
        }
        let name = self.code.function(start).1.to_owned();
        if self.open.contains(&start) {
            let names: Vec<_> = self
                .open
                .iter()
                .map(|at| self.code.function(*at).1)
                .collect();
            return Err(format!(
                "{name} calls itself, by way of {}",
                names.join(" > ")
            ));
        }
        self.open.push(start);
        let frame = self.frame(start)?;
        let mut deepest = Deepest {
            bytes: frame.own,
            way: vec![(name.clone(), frame.own)],
        };
        for (callee, depth) in frame.calls {
            let callees: Vec<u32> = match callee {
                Callee::At(at) => vec![at],
                Callee::Any => self.by_table.iter().copied().collect(),
            };
            for callee in callees {
                let below = self.deepest(callee)?;
                if depth + below.bytes > deepest.bytes {
                    deepest.bytes = depth + below.bytes;
                    deepest.way = vec![(name.clone(), depth)];
                    deepest.way.extend(below.way);
                }
            }
        }
        self.open.pop();
        self.depths.insert(start, deepest.clone());
        Ok(deepest)
    }
}

fn i_immediate(word: u32) -> u32 {
    (word as i32 >> 20) as u32
}

fn branch_offset(word: u32) -> u32 {
    let offset = (word & 0x8000_0000) as i32 >> 19
        | (word << 4 & 0x800) as i32
        | (word >> 20 & 0x7e0) as i32
        | (word >> 7 & 0x1e) as i32;
    offset as u32
}

fn jal_offset(word: u32) -> u32 {
    let high = (word & 0x8000_0000) as i32 >> 11;
    high as u32 | word & 0xf_f000 | word >> 9 & 0x800 | word >> 20 & 0x7fe
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Functions one behind the other from address 0x1000 on, where what is called through a table
    /// may lie.
    fn code(functions: &[(&str, &[u32])], data: &[u32]) -> Code {
        let mut code = Code {
            words: BTreeMap::new(),
            functions: BTreeMap::new(),
            names: BTreeMap::new(),
            data: data.to_vec(),
            stack: 4096,
        };
        let mut at = 0x1000;
        for (name, words) in functions {
            code.functions.insert(at, ((*name).into(), 0));
            code.names.insert((*name).into(), at);
            for word in *words {
                code.words.insert(at, *word);
                at += 4;
            }
        }
        code.close();
        code
    }

    /// `addi sp, sp, bytes`.
    fn take(bytes: i32) -> u32 {
        (bytes as u32) << 20 | SP << 15 | SP << 7 | 0x13
    }

    /// `jal rd, offset` for small offsets.
    fn jal(rd: u32, offset: i32) -> u32 {
        let o = offset as u32;
        (o & 0x10_0000) << 11 | (o & 0x7fe) << 20 | (o & 0x800) << 9 | o & 0xf_f000 | rd << 7 | 0x6f
    }

    #[test]
    fn the_stack_is_the_longest_way_through_the_calls() {
        let code = code(
            &[
                (
                    "main",
                    &[take(-32), jal(RA, 16), jal(RA, 24), take(32), RET],
                ),
                ("small", &[take(-16), take(16), RET]),
                ("large", &[take(-64), jal(RA, -16), take(64), RET]),
            ],
            &[],
        );
        let deepest = code.deepest("main").unwrap();
        assert_eq!(deepest.bytes, 32 + 64 + 16, "{deepest:?}");
        let names: Vec<_> = deepest.way.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, ["main", "large", "small"]);
    }

    #[test]
    fn a_call_through_a_table_may_reach_whatever_has_its_address_in_the_data() {
        let indirect = 0x0005_00e7; // jalr ra, 0(a0)
        let functions: &[(&str, &[u32])] = &[
            ("main", &[take(-32), indirect, take(32), RET]),
            ("listed", &[take(-80), take(80), RET]),
            ("unlisted", &[take(-800), take(800), RET]),
        ];
        assert_eq!(
            code(functions, &[0x1010]).deepest("main").unwrap().bytes,
            112
        );
    }

    #[test]
    fn a_switch_goes_wherever_its_table_in_the_data_says() {
        let switch = 0x0007_0067; // jr a4
        let functions: &[(&str, &[u32])] = &[
            ("main", &[take(-32), switch, jal(RA, 12), take(32), RET]),
            ("leaf", &[take(-16), take(16), RET]),
        ];
        assert_eq!(
            code(functions, &[0x1008]).deepest("main").unwrap().bytes,
            32 + 16
        );
        let why = code(functions, &[]).deepest("main").unwrap_err();
        assert!(why.contains("no way to 0x1008"), "{why}");
    }

    #[test]
    fn the_last_call_of_a_function_may_be_one_through_a_table() {
        let indirect = 0x0007_0067; // jr a4
        let functions: &[(&str, &[u32])] = &[
            ("main", &[take(-32), take(32), indirect]),
            ("listed", &[take(-80), take(80), RET]),
        ];
        assert_eq!(
            code(functions, &[0x100c]).deepest("main").unwrap().bytes,
            80
        );
    }

    #[test]
    fn code_that_no_way_leads_to_is_refused_when_it_takes_stack_or_goes_elsewhere() {
        for (dead, matters) in [
            (take(-800), true),
            (jal(RA, -4), true),
            (jal(0, -8), true),
            (RET, true),
            (jal(0, -4), false),
            (UNIMP, false),
            (0x0080_0513, false), // li a0, 8
        ] {
            let functions: &[(&str, &[u32])] = &[("other", &[RET]), ("main", &[RET, dead])];
            match code(functions, &[]).deepest("main") {
                Ok(_) => assert!(!matters, "{dead:#010x} was overlooked"),
                Err(why) => assert!(
                    matters && why.contains("no way to 0x1008"),
                    "{dead:#010x}: {why}"
                ),
            }
        }
    }

    #[test]
    fn a_function_that_calls_itself_has_no_bound() {
        let functions: &[(&str, &[u32])] = &[
            ("main", &[take(-16), jal(RA, 12), take(16), RET]),
            ("again", &[take(-16), jal(RA, -20), take(16), RET]),
        ];
        let why = code(functions, &[]).deepest("main").unwrap_err();
        assert!(why.contains("calls itself"), "{why}");
    }

    #[test]
    fn what_the_outliner_cut_out_may_take_stack_for_its_caller() {
        let back = 0x0002_8067; // jr t0
        let code = code(
            &[
                ("main", &[jal(T0, 16), jal(RA, 20), take(48), RET]),
                ("outlined", &[take(-48), back]),
                ("leaf", &[take(-16), take(16), RET]),
            ],
            &[],
        );
        assert_eq!(code.deepest("main").unwrap().bytes, 48 + 16);
    }

    #[test]
    fn shared_saves_and_restores_take_stack_and_give_it_back_and_a_return_behind_them_is_none() {
        let back = 0x0002_8067; // jr t0
        let with = |main: &[u32]| {
            let length = 4 * main.len() as i32;
            let mut main = main.to_vec();
            main[0] = jal(T0, length);
            main[3] = jal(0, length + 8 - 12);
            code(
                &[
                    ("main", &main),
                    ("__riscv_save_4", &[take(-32), back]),
                    ("__riscv_restore_4", &[take(32), RET]),
                ],
                &[],
            )
        };
        for rest in [&[][..], &[RET], &[J_NEXT, RET]] {
            let main = [&[0, take(-48), take(48), 0], rest].concat();
            assert_eq!(with(&main).deepest("main").unwrap().bytes, 80, "{rest:x?}");
        }
        // Behind anything else it is code that was overlooked.
        for rest in [&[RET, RET][..], &[UNIMP, RET], &[take(-800), RET]] {
            let main = [&[0, take(-48), take(48), 0], rest].concat();
            let why = with(&main).deepest("main").unwrap_err();
            assert!(why.contains("no way to"), "{why}");
        }
    }

    #[test]
    fn a_stack_that_is_moved_otherwise_is_refused() {
        let odd = 0x4000_0133 | SP << 15 | 10 << 20; // sub sp, sp, a0
        let why = code(&[("main", &[odd, RET])], &[]).deepest("main");
        assert!(why.unwrap_err().contains("not understood"));
    }

    #[test]
    fn a_frame_larger_than_an_immediate_is_counted_whole() {
        let lui = 0x0000_f6b7; // lui a3, 0xf
        let addi = 0x5c06_8693; // addi a3, a3, 1472
        let (sub, add) = (0x40d1_0133, 0x00d1_0133); // sub sp, sp, a3; add sp, sp, a3
        let code = code(
            &[
                ("main", &[lui, addi, sub, jal(RA, 20), lui, addi, add, RET]),
                ("leaf", &[take(-16), take(16), RET]),
            ],
            &[],
        );
        assert_eq!(code.deepest("main").unwrap().bytes, 0xf5c0 + 16);
    }

    #[test]
    fn a_frame_that_is_a_shifted_number_is_counted_whole() {
        let li = 0x0170_0693; // li a3, 23
        let slli = 0x0086_9693; // slli a3, a3, 8
        let (sub, add) = (0x40d1_0133, 0x00d1_0133); // sub sp, sp, a3; add sp, sp, a3
        let main = [li, slli, sub, li, slli, add, RET];
        let code = code(&[("main", &main)], &[]);
        assert_eq!(code.deepest("main").unwrap().bytes, 23 << 8);
    }

    #[test]
    fn a_panic_is_a_call_of_cores_panicking_functions_or_a_break() {
        let code = code(
            &[
                ("main", &[jal(RA, 12), EBREAK, RET]),
                ("core::panicking::panic_fmt", &[EBREAK]),
            ],
            &[],
        );
        let at: Vec<_> = code.panics().iter().map(|panic| panic.at).collect();
        assert_eq!(at, [0x1000, 0x1004]);
    }
}
