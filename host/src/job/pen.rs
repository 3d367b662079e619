//! A pen that a program moves with Z, made into the pen of a plotter: the output of M3 and M5.
//!
//! Gcodetools and its like switch the tool on once (M3), lift it with Z to travel and lower it with
//! Z to draw. Here Z below a height is the pen down, M3 and M5 are not looked at, and no Z is left.
//! A line that passes the height is divided there; an arc that does is drawn with the pen up.

use crate::job::program::Program;
use jobs::instruction::{AUX_TOOL, Feed, Instruction, Place};

/// Where a program has its tool while it travels and while it draws, in mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Heights {
    /// The lowest Z that is not drawing.
    pub up: f64,
    /// The highest Z that is.
    pub down: f64,
}

impl Heights {
    /// Between the two.
    pub fn middle(&self) -> f64 {
        f64::midpoint(self.up, self.down)
    }

    /// Of a program in which every rapid is higher than all that is drawn, or in which there are
    /// two heights. Motion before the first Z has no height yet.
    pub fn of(program: &Program) -> Option<Heights> {
        let (mut at, mut told): (Place, bool) = ([0; 3], false);
        let (mut up, mut down) = (i64::MAX, i64::MIN);
        let mut levels = std::collections::BTreeSet::new();
        for (instruction, _) in &program.instructions {
            let (to, rapid) = match instruction {
                Instruction::Line { to, feed } => (*to, *feed == Feed::Rapid),
                Instruction::Arc(arc) => (arc.to, arc.feed == Feed::Rapid),
                _ => continue,
            };
            let moves = to[..2] != at[..2] || matches!(instruction, Instruction::Arc(_));
            told |= to[2] != at[2];
            if moves && told {
                levels.extend([at[2], to[2]]);
                match rapid {
                    true => up = up.min(at[2]).min(to[2]),
                    false => down = down.max(at[2]).max(to[2]),
                }
            }
            at = to;
        }
        let mm = |nm: i64| nm as f64 / 1e6;
        let two = (levels.len() == 2)
            .then(|| levels.first().copied().zip(levels.last().copied()))
            .flatten();
        let apart = || (down != i64::MIN && up != i64::MAX && down < up).then_some((down, up));
        two.or_else(apart).map(|(down, up)| Heights {
            up: mm(up),
            down: mm(down),
        })
    }
}

/// The tool is switched on once and lifted with Z, as a pen plotter cannot do it.
pub fn lifts_with_z(program: &Program) -> Option<Heights> {
    let mut on = false;
    let (mut at, mut travels) = ([0; 3], false);
    for (instruction, _) in &program.instructions {
        match instruction {
            Instruction::Aux { bits } => on = bits & AUX_TOOL != 0,
            Instruction::Line { to, feed } => {
                travels |= on && *feed == Feed::Rapid && to[..2] != at[..2];
                at = *to;
            }
            Instruction::Arc(arc) => at = arc.to,
            _ => {}
        }
    }
    Heights::of(program).filter(|_| travels)
}

/// The program with the pen down where its Z is below the height, in mm.
pub fn from_z(program: &Program, height: f64) -> Program {
    let mut written = Written {
        instructions: Vec::new(),
        down: true,
        height: height * 1e6,
    };
    // Whatever was before, it begins with the pen up.
    let first = program.instructions.first().map_or(1, |(_, line)| *line);
    written.pen(false, first);
    let mut at: Place = [0; 3];
    for (instruction, line) in &program.instructions {
        let line = *line;
        match instruction {
            Instruction::Line { to, feed } => {
                written.line(at, *to, *feed, line);
                at = *to;
            }
            Instruction::Arc(arc) => {
                let draws = written.draws(at) && written.draws(arc.to);
                written.pen(draws, line);
                let (mut flat, end) = (*arc, arc.to);
                flat.to[2] = 0;
                written.instructions.push((Instruction::Arc(flat), line));
                written.pen(written.draws(end), line);
                at = end;
            }
            Instruction::Aux { .. } => {}
            Instruction::Home { axes } => {
                let [x, y, _] = *axes;
                for (place, homed) in at.iter_mut().zip(*axes) {
                    *place = if homed { 0 } else { *place };
                }
                if x || y {
                    let axes = [x, y, false];
                    written
                        .instructions
                        .push((Instruction::Home { axes }, line));
                }
            }
            Instruction::End => {
                written.pen(false, line);
                written.instructions.push((Instruction::End, line));
            }
            Instruction::Dwell { .. } | Instruction::Pause => {
                written.instructions.push((*instruction, line));
            }
        }
    }
    Program {
        name: program.name.clone(),
        instructions: written.instructions,
    }
}

struct Written {
    instructions: Vec<(Instruction, u32)>,
    down: bool,
    /// In nanometres.
    height: f64,
}

impl Written {
    fn draws(&self, at: Place) -> bool {
        (at[2] as f64) < self.height
    }

    fn pen(&mut self, down: bool, line: u32) {
        if self.down != down {
            self.down = down;
            let bits = if down { AUX_TOOL } else { 0 };
            self.instructions.push((Instruction::Aux { bits }, line));
        }
    }

    fn line(&mut self, from: Place, to: Place, feed: Feed, line: u32) {
        let (before, after) = (self.draws(from), self.draws(to));
        if from[..2] == to[..2] {
            return self.pen(after, line);
        }
        self.pen(before, line);
        if before != after {
            let part = (self.height - from[2] as f64) / (to[2] - from[2]) as f64;
            let between =
                |axis: usize| from[axis] + ((to[axis] - from[axis]) as f64 * part).round() as i64;
            let to = [between(0), between(1), 0];
            self.instructions
                .push((Instruction::Line { to, feed }, line));
            self.pen(after, line);
        }
        let to = [to[0], to[1], 0];
        self.instructions
            .push((Instruction::Line { to, feed }, line));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use jobs::gcode::DwellUnit;
    use proptest::prelude::*;

    /// As Gcodetools writes it, with its default header and footer.
    pub(crate) const GCODETOOLS: &str = include_str!("../../tests/programs/gcodetools.ngc");
    /// As a plugin does that travels with G1 and has two heights.
    const TWO_HEIGHTS: &str = include_str!("../../tests/programs/two-heights.gcode");
    /// As a plugin does that draws in several passes, each deeper.
    const PASSES: &str = include_str!("../../tests/programs/passes.nc");

    fn program(text: &str) -> Program {
        Program::from_gcode(text.as_bytes(), DwellUnit::Seconds)
            .unwrap_or_else(|error| panic!("{error}"))
    }

    /// mm drawn and travelled in XY, times the pen goes down, and whether no Z is left.
    fn told(program: &Program) -> (f64, f64, usize, bool) {
        let (mut at, mut down): (Place, bool) = ([0; 3], false);
        let (mut drawn, mut travelled, mut downs, mut flat) = (0.0, 0.0, 0, true);
        for (instruction, _) in &program.instructions {
            let to = match instruction {
                Instruction::Aux { bits } => {
                    down = bits & AUX_TOOL != 0;
                    downs += usize::from(down);
                    continue;
                }
                Instruction::Line { to, .. } => *to,
                Instruction::Arc(arc) => arc.to,
                _ => continue,
            };
            let way = ((to[0] - at[0]) as f64).hypot((to[1] - at[1]) as f64) / 1e6;
            *if down { &mut drawn } else { &mut travelled } += way;
            flat &= to[2] == 0;
            at = to;
        }
        (drawn, travelled, downs, flat)
    }

    #[test]
    fn the_heights_are_found_in_the_files_of_three_plugins() {
        for (text, up, down) in [
            (GCODETOOLS, 5.0, -1.0),
            (TWO_HEIGHTS, 3.0, 0.0),
            (PASSES, 2.0, -0.2),
        ] {
            assert_eq!(Heights::of(&program(text)), Some(Heights { up, down }));
        }
    }

    #[test]
    fn the_pen_is_down_where_z_is_and_m3_does_not_lower_it() {
        for (text, strokes) in [(GCODETOOLS, 2), (TWO_HEIGHTS, 2), (PASSES, 2)] {
            let program = program(text);
            let height = Heights::of(&program).expect("heights").middle();
            let drawn = from_z(&program, height);
            let (_, travelled, downs, flat) = told(&drawn);
            assert!(flat, "{drawn:?}");
            assert_eq!(downs, strokes, "{drawn:?}");
            assert!(travelled > 0.0);
            // The pen is up first and last.
            let [first, .., last, _] = &drawn.instructions[..] else {
                panic!("{drawn:?}")
            };
            assert_eq!(first.0, Instruction::Aux { bits: 0 });
            assert!(!matches!(last.0, Instruction::Aux { bits: AUX_TOOL }));
        }
    }

    #[test]
    fn a_program_that_leaves_the_tool_on_and_lifts_it_is_told_from_a_plotters() {
        assert!(lifts_with_z(&program(GCODETOOLS)).is_some());
        let plotter = "G0 X1 Y1\nM3\nG1 X5 F600\nM5\nG0 X0 Y0\nM2\n";
        assert_eq!(lifts_with_z(&program(plotter)), None);
        assert_eq!(Heights::of(&program(plotter)), None);
        // A mill that goes down in steps while it moves has heights that overlap.
        let relief = "M3\nG0 Z1\nG0 X5\nG1 X6 Z0.5 F60\nG1 X7 Z2\nG0 X0\nM2\n";
        assert_eq!(Heights::of(&program(relief)), None);
    }

    #[test]
    fn a_line_that_passes_the_height_is_divided_there() {
        let ramp = program("G0 Z2\nG0 X10\nG1 X14 Z-2 F600\nG1 X20\nG1 X24 Z2\nM2\n");
        let drawn = from_z(&ramp, 1.0);
        let switches: Vec<(i64, bool)> = {
            let mut x = 0;
            let of = |(instruction, _): &(Instruction, u32)| match instruction {
                Instruction::Line { to, .. } => {
                    x = to[0] / 1_000_000;
                    None
                }
                Instruction::Aux { bits } => Some((x, bits & AUX_TOOL != 0)),
                _ => None,
            };
            drawn.instructions.iter().filter_map(of).collect()
        };
        assert_eq!(switches, [(0, false), (11, true), (23, false)]);
    }

    proptest! {
        #[test]
        fn what_is_drawn_and_travelled_is_the_whole_way(
            moves in prop::collection::vec((0u8..50, 0u8..50, -3i8..4, any::<bool>()), 1..30)
        ) {
            let mut text = String::from("M3\nF600\n");
            for (x, y, z, rapid) in &moves {
                text += &format!("G{} X{x} Y{y} Z{z}\n", if *rapid { 0 } else { 1 });
            }
            text += "M5\nM2\n";
            let program = program(&text);
            let (drawn, travelled, _, flat) = told(&from_z(&program, 0.5));
            let (mut at, mut whole, mut below) = ([0.0, 0.0, 0.0f64], 0.0, 0.0);
            for (x, y, z, _) in moves {
                let to = [f64::from(x), f64::from(y), f64::from(z)];
                let way = (to[0] - at[0]).hypot(to[1] - at[1]);
                whole += way;
                let (low, high) = (at[2].min(to[2]), at[2].max(to[2]));
                below += way * match high - low {
                    0.0 => f64::from(u8::from(low < 0.5)),
                    by => ((0.5 - low) / by).clamp(0.0, 1.0),
                };
                at = to;
            }
            prop_assert!(flat);
            prop_assert!((drawn + travelled - whole).abs() < 1e-3 && (drawn - below).abs() < 1e-3);
        }
    }
}
