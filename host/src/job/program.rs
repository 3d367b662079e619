//! A program in memory: instructions with their source lines, from any kind of file.

use jobs::gcode::{self, DwellUnit};
use jobs::instruction::Instruction;
use jobs::job::{self, Block, Reader, Writer};
use jobs::xypen::{self, Quirks};
use std::path::Path;

/// A program.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Program {
    /// Its name.
    pub name: String,
    /// What to do, and the line of the source that asks for it.
    pub instructions: Vec<(Instruction, u32)>,
}

/// What a file does not say.
#[derive(Clone, Copy, Debug)]
pub struct Dialect {
    /// What `G4 P` counts.
    pub dwell: DwellUnit,
    /// Of binary files.
    pub quirks: Quirks,
}

impl Default for Dialect {
    fn default() -> Self {
        Dialect {
            dwell: DwellUnit::Seconds,
            quirks: Quirks::G2B,
        }
    }
}

impl Program {
    /// From a job (`.job`), XYPenPlotter's binary (`.bin`) or G-code (anything else). The message
    /// begins with the file's name.
    pub fn read(file: &Path, dialect: &Dialect) -> Result<Program, String> {
        let shown = file.display();
        let bytes = std::fs::read(file).map_err(|error| format!("{shown}: {error}"))?;
        let program = match ending(file).as_str() {
            "job" => Program::from_job(&bytes),
            "bin" => Program::from_binary(&bytes, dialect.quirks),
            _ => Program::from_gcode(&bytes, dialect.dwell),
        };
        let mut program = program.map_err(|error| format!("{shown}: {error}"))?;
        if program.name.is_empty() {
            program.name = file
                .file_stem()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned();
        }
        Ok(program)
    }

    /// From G-code.
    pub fn from_gcode(text: &[u8], dwell: DwellUnit) -> Result<Program, String> {
        let mut reader = gcode::Reader::new(gcode::Options { dwell });
        let mut program = Program::default();
        for &byte in text {
            let read = reader.byte(byte).map_err(|error| error.to_string())?;
            program
                .instructions
                .extend(read.map(|instruction| (instruction, reader.line_number())));
        }
        let read = reader.finish().map_err(|error| error.to_string())?;
        program
            .instructions
            .extend(read.map(|instruction| (instruction, reader.line_number())));
        Ok(program)
    }

    /// From XYPenPlotter's binary; its records count as lines.
    pub fn from_binary(bytes: &[u8], quirks: Quirks) -> Result<Program, String> {
        let reader = xypen::Reader::new(bytes, quirks).map_err(|error| error.to_string())?;
        let read: Result<Vec<Instruction>, _> = reader.collect();
        let instructions = read.map_err(|error| error.to_string())?;
        Ok(Program {
            name: String::new(),
            instructions: instructions.into_iter().zip(1..).collect(),
        })
    }

    /// From a job file.
    pub fn from_job(bytes: &[u8]) -> Result<Program, String> {
        let header = Block::parse(bytes, 0).map_err(|error| error.to_string())?;
        let name = job::name_of(header.payload).map_err(|error| error.to_string())?;
        let mut program = Program {
            name: name.to_owned(),
            instructions: Vec::new(),
        };
        let (mut reader, mut at) = (Reader::default(), 0);
        while reader.summary().is_none() {
            let length = reader.block(&bytes[at..], |instruction, line| {
                program.instructions.push((instruction, line))
            });
            at += length.map_err(|error| format!("byte {at}: {error}"))?;
        }
        match bytes.len() - at {
            0 => Ok(program),
            more => Err(format!("{more} bytes after the end")),
        }
    }

    /// As a job file.
    pub fn to_job(&self) -> Vec<u8> {
        let mut writer = Writer::new(&self.name);
        let mut file = writer.header().to_vec();
        for (instruction, line) in &self.instructions {
            writer.add(instruction, *line, |block| file.extend(block));
        }
        writer.finish(|block| file.extend(block));
        file
    }

    /// As XYPenPlotter's binary.
    pub fn to_binary(&self, quirks: Quirks) -> Result<Vec<u8>, String> {
        let mut writer = xypen::Writer::new(quirks);
        let mut records = Vec::new();
        for (instruction, line) in &self.instructions {
            let record = writer
                .record(instruction)
                .map_err(|error| format!("line {line}: {error}"))?;
            records.extend(record.into_iter().flat_map(xypen::Record::to_bytes));
        }
        let mut file = writer.count().to_le_bytes().to_vec();
        file.extend(records);
        Ok(file)
    }
}

/// How a file's name ends, in small letters.
pub fn ending(file: &Path) -> String {
    file.extension()
        .unwrap_or_default()
        .to_string_lossy()
        .to_lowercase()
}
