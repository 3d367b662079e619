//! Programs (G-code, the job file, XYPenPlotter's binary): they are read to their end or refused
//! with a place, and the result is motion that the machine can make.

use crate::byte_reader::ByteReader;
use jobs::gcode::{DwellUnit, Options, Reader};
use jobs::instruction::{FARTHEST, Feed, Instruction, Place};
use jobs::job::{self, BLOCK, Kind};
use jobs::plan::{AxisSetup, Output, Planner, Setup};
use jobs::xypen::{self, Quirks, Record};
use motion::segment::{AXES, MAX_CLOCKS, MIN_CLOCKS};
use wire::crc::Crc32;

/// A circle of ten metres has too many chords for a fuzzer.
const OUTPUTS: u32 = 20_000;
/// The number of lines the board looks ahead.
const DEPTH: usize = 16;

/// A plotter: 80 steps/mm, 100 mm/s, 1 m/s^2 in the plane, slower in Z.
const PLOTTER: Setup = Setup {
    clock_hz: 60_000_000,
    axes: [
        AxisSetup {
            steps_per_km: 80_000_000,
            max_speed: 100_000_000,
            max_accel: 1_000_000_000,
        },
        AxisSetup {
            steps_per_km: 80_000_000,
            max_speed: 100_000_000,
            max_accel: 1_000_000_000,
        },
        AxisSetup {
            steps_per_km: 400_000_000,
            max_speed: 10_000_000,
            max_accel: 200_000_000,
        },
    ],
    chord_tolerance: 5_000,
    junction_deviation: 20_000,
    aux_settle: 1_000,
};

/// G-code: the instructions of a line, and their segments.
pub fn gcode(data: &[u8]) {
    let mut input = ByteReader(data);
    let [mode, percent] = input.array();
    let dwell = match mode & 1 {
        0 => DwellUnit::Seconds,
        _ => DwellUnit::Milliseconds,
    };
    let mut reader = Reader::new(Options { dwell });
    let mut bench = Bench::new();
    if mode & 2 != 0 {
        let setup = Setup {
            junction_deviation: 0,
            ..PLOTTER
        };
        bench.planner = Planner::new(&setup).expect("a plotter");
    }
    if mode & 4 != 0 {
        bench.planner.set_override(percent.into());
    }
    for byte in input.0.iter().copied().map(Some).chain([None]) {
        let lines = reader.line_number();
        let ended = reader.ended();
        let read = match byte {
            Some(byte) => reader.byte(byte),
            None => reader.finish(),
        };
        let instructions = match read {
            Ok(instructions) => instructions,
            Err(error) => {
                assert!(error.line == lines + 1 && error.column >= 1, "{error:?}");
                assert!(!error.to_string().is_empty());
                // A refused program is never started.
                return;
            }
        };
        for instruction in instructions {
            assert!(!ended, "{instruction:?} after the end");
            possible(&instruction);
            bench.execute(&instruction, reader.line_number());
            if bench.outputs >= OUTPUTS {
                return;
            }
        }
    }
    bench.execute(&Instruction::End, reader.line_number());
}

/// The job file. With the first bit of the first byte the input is the file; without it, the input
/// is the content of blocks with a right CRC, so that a fuzzer gets past the CRC.
pub fn job(data: &[u8]) {
    let mut input = ByteReader(data);
    let [mode] = input.array();
    let file = match mode & 1 {
        1 => input.0.to_vec(),
        _ => in_blocks(&mut input),
    };
    let mut bench = Bench::new();
    let mut reader = job::Reader::default();
    let mut read: Vec<(Instruction, u32)> = Vec::new();
    let mut at = 0;
    let refused = loop {
        match reader.block(&file[at..], |instruction, line| {
            possible(&instruction);
            read.push((instruction, line));
        }) {
            Ok(length) => at += length,
            Err(error) => break error,
        }
        if reader.summary().is_some() {
            break job::Error::Cut;
        }
    };
    assert!(!refused.to_string().is_empty());
    for (instruction, line) in &read {
        if bench.outputs >= OUTPUTS {
            break;
        }
        bench.execute(instruction, *line);
    }
    written_it_reads_the_same(&read);
}

/// Blocks of the input: a length, then that many bytes.
fn in_blocks(input: &mut ByteReader) -> Vec<u8> {
    let mut file = Vec::new();
    let mut before = block(&mut file, Kind::Header, b"\x01fuzz", 0);
    while !input.is_over() {
        let length = usize::from(input.half()) % (BLOCK + 1);
        let payload = input.take(length);
        before = block(&mut file, Kind::Instructions, payload, before);
    }
    file
}

/// A block with the writer's frame; returns its CRC.
fn block(file: &mut Vec<u8>, kind: Kind, payload: &[u8], before: u32) -> u32 {
    let begin = file.len();
    let code = match kind {
        Kind::Header => 1,
        Kind::Instructions => 2,
        Kind::End => 3,
    };
    file.extend([b'F', b'J', code, 0]);
    file.extend((payload.len() as u32).to_le_bytes());
    file.extend(payload);
    let mut crc = Crc32::new();
    crc.update(&before.to_le_bytes());
    crc.update(&file[begin..]);
    file.extend(crc.value().to_le_bytes());
    crc.value()
}

fn written_it_reads_the_same(program: &[(Instruction, u32)]) {
    let mut writer = job::Writer::new("again");
    let mut file = writer.header().to_vec();
    for (instruction, line) in program {
        writer.add(instruction, *line, |full| file.extend(full));
    }
    let written = writer.finish(|full| file.extend(full));
    let (mut reader, mut read, mut at) = (job::Reader::default(), Vec::new(), 0);
    while reader.summary().is_none() {
        at += reader
            .block(&file[at..], |instruction, line| {
                read.push((instruction, line));
            })
            .expect("what is written can be read");
    }
    assert_eq!(at, file.len());
    assert_eq!(reader.summary(), Some(written));
    assert_eq!(read, program);
}

/// Binary G-code of XYPenPlotter, by all its flags.
pub fn xypen(data: &[u8]) {
    let mut input = ByteReader(data);
    let [flags, dwell, feed] = input.array();
    let quirks = Quirks {
        count_fields: flags & 1 != 0,
        invert_y: flags & 2 != 0,
        dwell_micros: 1 + 100 * u32::from(dwell),
        feed: match feed {
            0 => Feed::Rapid,
            feed => Feed::Rate(1_000_000 * u32::from(feed)),
        },
    };
    // Without the flag the count is right, so that a fuzzer gets past it.
    let mut file = input.0.to_vec();
    if flags & 4 == 0 {
        let whole = file.len() / (4 * xypen::FIELDS) * xypen::FIELDS;
        file.truncate(4 * whole);
        let count = if quirks.count_fields {
            whole
        } else {
            whole / xypen::FIELDS
        };
        file.splice(0..0, (count as u32).to_le_bytes());
    }
    let reader = match xypen::Reader::new(&file, quirks) {
        Ok(reader) => reader,
        Err(error) => return assert!(!error.to_string().is_empty()),
    };
    let mut bench = Bench::new();
    let mut program = Vec::new();
    for read in reader {
        match read {
            Ok(instruction) => program.push(instruction),
            Err(error) => {
                assert!(!error.to_string().is_empty());
                return;
            }
        }
    }
    for instruction in &program {
        possible(instruction);
        if bench.outputs < OUTPUTS {
            bench.execute(instruction, 0);
        }
    }
    let mut writer = xypen::Writer::new(quirks);
    let records: Vec<Record> = program
        .iter()
        .map(|instruction| writer.record(instruction))
        .map(|record| {
            record
                .expect("the format can represent it")
                .expect("no end")
        })
        .collect();
    let mut again = writer.count().to_le_bytes().to_vec();
    again.extend(records.iter().flat_map(|record| record.to_bytes()));
    let read = xypen::Reader::new(&again, quirks).expect("a count of its own");
    assert_eq!(read.count(), program.len());
}

/// An instruction that a machine can execute.
fn possible(instruction: &Instruction) {
    let near = |place: &Place| {
        place
            .iter()
            .all(|nm| nm.unsigned_abs() <= FARTHEST.unsigned_abs())
    };
    let (to, feed) = match instruction {
        Instruction::Line { to, feed } => (to, feed),
        Instruction::Arc(arc) => (&arc.to, &arc.feed),
        Instruction::Dwell { .. }
        | Instruction::Aux { .. }
        | Instruction::Home { .. }
        | Instruction::Pause
        | Instruction::End => return,
    };
    assert!(near(to), "{instruction:?} is too far");
    assert!(*feed != Feed::Rate(0), "{instruction:?} never arrives");
}

struct Bench {
    planner: Planner<DEPTH>,
    outputs: u32,
}

impl Bench {
    fn new() -> Self {
        Bench {
            planner: Planner::new(&PLOTTER).expect("a plotter"),
            outputs: 0,
        }
    }

    fn execute(&mut self, instruction: &Instruction, line: u32) {
        while !self.planner.accepts() {
            if !self.output() {
                return;
            }
        }
        assert!(
            self.planner.push(instruction, line),
            "read, but not accepted: {instruction:?}"
        );
        while self.output() {}
    }

    /// The next output; false if there is none.
    fn output(&mut self) -> bool {
        if self.outputs >= OUTPUTS {
            return false;
        }
        self.outputs += 1;
        let aux = self.planner.machine().aux;
        let Some(output) = self.planner.poll() else {
            return false;
        };
        match output {
            Output::Segment(segment) => {
                assert!(segment.clocks >= MIN_CLOCKS, "{segment:?}");
                let still = segment.accel == [0; AXES];
                assert!(still || segment.clocks <= MAX_CLOCKS, "{segment:?}");
                for (accel, limit) in segment.accel.iter().zip(self.planner.limits()) {
                    assert!(*accel <= limit, "{segment:?}, {limit}");
                }
                let rests = self.planner.machine().rests();
                assert!(
                    aux == segment.aux || rests,
                    "outputs changed in motion: {segment:?}"
                );
            }
            Output::Home(_) | Output::Pause | Output::End => {
                assert!(self.planner.machine().rests(), "{output:?} in motion");
                if !matches!(output, Output::Home(_)) {
                    self.arrived();
                }
            }
        }
        true
    }

    /// At rest the machine is at the program's position, to the step.
    fn arrived(&self) {
        let (steps, target) = (self.planner.machine().steps(), self.planner.target());
        for (axis, (steps, nm)) in steps.into_iter().zip(target).enumerate() {
            let per_km = i128::from(PLOTTER.axes[axis].steps_per_km);
            // Twice the distance to the target, in 10^-12 of a step.
            let off = 2 * (i128::from(nm) * per_km - i128::from(steps) * 1_000_000_000_000);
            assert!(
                off.abs() <= 1_000_000_000_000 + 1_000_000,
                "axis {axis} at step {steps} is not at {nm} nm"
            );
        }
    }
}
