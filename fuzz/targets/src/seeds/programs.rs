//! Programs in each of the formats.

use super::Seed;
use jobs::instruction::{AUX_TOOL, Arc, Feed, Instruction};
use jobs::job::{self, FRAME};
use jobs::xypen::{self, Record};

pub(super) fn gcode_seeds() -> Vec<Seed> {
    let program = |mode: u8, text: &str| [&[mode, 50][..], text.as_bytes()].concat();
    vec![
        (
            "gcode",
            "square_with_a_pen",
            program(
                0,
                "%\nG21 G90\nG0 X10 Y10\nM3\nG4 P0.1\nG1 X20 F600\nY20\nX10\nY10\nM5\nG0 X0 Y0\nM2\n",
            ),
        ),
        (
            "gcode",
            "arcs_and_a_full_circle",
            program(
                0,
                "G1 F1200 X5\nG2 X10 Y5 I5 J0\nG3 X5 Y0 R5\nG2 I2 J0\nG3 X0 Y1 Z1 R-4\nM30\n",
            ),
        ),
        (
            "gcode",
            "inches_and_relative",
            program(
                2,
                "N10 G20 G91 (inches)\nN20 G1 X.5 Y-.25 F30 ; a comment\nN30 G92 X0\nN40 G0 Z1*94\nG90 G0 X0\n",
            ),
        ),
        (
            "gcode",
            "homed_paused_slowed",
            program(
                5,
                "G28 X0 Y0\nM0\nG1 X3 Y3 F300\nG4 P250\nG4 S1\nM2\nG1 X9\n",
            ),
        ),
        (
            "gcode",
            "many_short_lines",
            program(
                0,
                &(0..40)
                    .map(|n| format!("G1 X{}.{n:02} Y{} F3000\n", n % 7, n % 3))
                    .collect::<String>(),
            ),
        ),
        ("gcode", "refused", program(0, "G1 X1 F100\nG64 P0.01\n")),
        (
            "gcode",
            "too_far",
            program(0, "G0 X9999.999999\nG0 X10001\n"),
        ),
    ]
}

/// Whole job files, and the content of their blocks.
pub(super) fn job_seeds() -> Vec<Seed> {
    let to = |x: i64, y: i64| [1_000_000 * x, 1_000_000 * y, 0];
    let line = |x, y| Instruction::Line {
        to: to(x, y),
        feed: Feed::Rate(20_000_000),
    };
    let arc = |x, y, center: [i64; 2], clockwise| {
        Instruction::Arc(Arc {
            to: to(x, y),
            center: center.map(|mm| 1_000_000 * mm),
            clockwise,
            feed: Feed::Rate(10_000_000),
        })
    };
    let rapid = |x, y| Instruction::Line {
        to: to(x, y),
        feed: Feed::Rapid,
    };
    let pen = |bits| Instruction::Aux { bits };
    let programs: [(&str, &[Instruction]); 3] = [
        (
            "a_square",
            &[
                rapid(10, 10),
                pen(AUX_TOOL),
                line(20, 10),
                line(20, 20),
                line(10, 20),
                line(10, 10),
                pen(0),
                Instruction::End,
            ],
        ),
        (
            "arcs_and_a_full_circle",
            &[
                line(10, 0),
                arc(0, 10, [0, 0], false),
                arc(0, 10, [5, 10], true),
                Instruction::End,
            ],
        ),
        (
            "home_dwell_pause",
            &[
                Instruction::Home { axes: [true; 3] },
                Instruction::Dwell { micros: 250_000 },
                Instruction::Pause,
                rapid(1, 1),
                Instruction::End,
            ],
        ),
    ];
    let mut seeds = Vec::new();
    for (name, program) in programs {
        let mut writer = job::Writer::new(name);
        let mut file = writer.header().to_vec();
        let mut blocks = vec![0];
        let mut held = |block: &[u8]| {
            blocks.extend(((block.len() - FRAME) as u16).to_be_bytes());
            blocks.extend(&block[FRAME - 4..block.len() - 4]);
        };
        for (instruction, number) in program.iter().zip(1..) {
            writer.add(instruction, number, |full| {
                held(full);
                file.extend(full);
            });
        }
        // The last block is the end, with the count of instructions: a fuzzer's blocks do not have
        // it.
        let mut last = Vec::new();
        writer.finish(|full| last.push(full.to_vec()));
        for block in &last[..last.len() - 1] {
            held(block);
        }
        file.extend(last.concat());
        seeds.push(("job", name, blocks));
        seeds.push(("job", whole(name), [&[1][..], &file].concat()));
    }
    seeds
}

/// The name of the same job as a file.
fn whole(name: &str) -> &'static str {
    match name {
        "a_square" => "a_file_with_a_square",
        "arcs_and_a_full_circle" => "a_file_with_arcs",
        _ => "a_file_with_a_pause",
    }
}

/// Records as `g2b.py` writes them and as its description has them.
pub(super) fn xypen_seeds() -> Vec<Seed> {
    const NONE: f32 = f32::from_bits(xypen::MISSING);
    let record = |code: u32, [x, y, z, i, j]: [f32; 5], p: u32| {
        Record([
            code,
            x.to_bits(),
            y.to_bits(),
            z.to_bits(),
            i.to_bits(),
            j.to_bits(),
            p,
        ])
    };
    let go = |code, x, y, z| record(code, [x, y, z, NONE, NONE], xypen::MISSING);
    let arc = |code, x, y, i, j| record(code, [x, y, NONE, i, j], xypen::MISSING);
    let input = |flags: u8, counted: bool, records: &[Record]| {
        let mut input = vec![flags, 10, 20];
        if counted {
            input.extend((7 * records.len() as u32).to_le_bytes());
        }
        input.extend(records.iter().flat_map(|record| record.to_bytes()));
        input
    };
    let square = [
        go(0, 10.0, -10.0, 1.0),
        go(1, NONE, NONE, -1.0),
        go(1, 20.0, -10.0, NONE),
        go(1, 20.0, -20.0, NONE),
        record(4, [NONE; 5], 30),
        go(0, 0.0, 0.0, 1.0),
    ];
    let circles = [
        go(1, 10.0, 0.0, -1.0),
        arc(2, 10.0, 0.0, -5.0, NONE),
        arc(3, 0.0, -10.0, -10.0, 0.0),
        arc(2, 0.01, -10.0, NONE, 10.0),
    ];
    vec![
        ("xypen", "a_square_of_g2b", input(0b111, true, &square)),
        ("xypen", "a_square_upright", input(0b000, false, &square)),
        (
            "xypen",
            "circles_and_a_short_arc",
            input(0b011, false, &circles),
        ),
        (
            "xypen",
            "an_arc_without_a_centre",
            input(0b011, false, &[arc(2, 1.0, 1.0, NONE, NONE)]),
        ),
    ]
}
