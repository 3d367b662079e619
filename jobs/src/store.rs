//! Jobs in memory: several, by name, in pieces of 4 KiB, so that a deleted job leaves no unusable
//! hole.
//!
//! ```text
//!   memory   next piece of piece 0, 1, 2 .. (u16 each)     piece 0    piece 1    piece 2   ...
//! ```
//!
//! An upload is checked while it arrives, block by block ([`Store::poll`]): when the last byte
//! comes, nearly all of it has been checked. A job is ready only when its CRC is the announced one
//! and every block can be read.

use crate::job::{self, Reader};
use wire::Name;
use wire::crc::Crc32;
use wire::jobs::{Entry, Status};

/// Bytes of a piece.
pub const PIECE: usize = 4096;
/// Largest number of jobs.
pub const JOBS: usize = 32;
/// No piece follows.
const LAST: u16 = u16::MAX;

/// A place in a job: the offset, and where that is in memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Place {
    offset: u32,
    piece: u16,
}

/// A job.
#[derive(Clone, Debug)]
struct Job {
    name: Name,
    total: u32,
    crc: u32,
    first: u16,
    /// The place of the next byte.
    end: Place,
    ready: bool,
    instructions: u32,
}

/// Identifies a job: its place in the directory, and how many jobs had that place before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Id {
    index: u8,
    age: u32,
}

/// The check of an upload.
#[derive(Debug)]
struct Reading {
    index: u8,
    at: Place,
    reader: Reader,
    crc: Crc32,
    /// Bytes of this block that `crc` already includes.
    block: [u8; job::BLOCK + job::FRAME],
    loaded: usize,
    instructions: u32,
    /// The offset of the first invalid block.
    broken: Option<u32>,
}

/// The store.
#[derive(Debug)]
pub struct Store<'m> {
    next: &'m mut [u8],
    pieces: &'m mut [u8],
    free: u16,
    free_count: u16,
    jobs: [Option<Job>; JOBS],
    ages: [u32; JOBS],
    reading: Reading,
    upload: Option<u8>,
}

impl<'m> Store<'m> {
    /// A store in this memory; its old content does not matter.
    pub fn new(memory: &'m mut [u8]) -> Self {
        let count = (memory.len() / (PIECE + 2)).min(usize::from(LAST));
        let (next, rest) = memory.split_at_mut(2 * count);
        let (pieces, _) = rest.split_at_mut(count * PIECE);
        let mut store = Store {
            next,
            pieces,
            free: LAST,
            free_count: 0,
            jobs: [const { None }; JOBS],
            ages: [0; JOBS],
            reading: Reading {
                index: 0,
                at: Place {
                    offset: 0,
                    piece: LAST,
                },
                reader: Reader::default(),
                crc: Crc32::new(),
                block: [0; job::BLOCK + job::FRAME],
                loaded: 0,
                instructions: 0,
                broken: None,
            },
            upload: None,
        };
        for piece in (0..count as u16).rev() {
            store.give_back(piece);
        }
        store
    }

    /// Size in bytes.
    pub fn room(&self) -> u32 {
        self.pieces.len() as u32
    }

    /// Free bytes.
    pub fn free(&self) -> u32 {
        u32::from(self.free_count) * PIECE as u32
    }

    fn after(&self, piece: u16) -> u16 {
        after(self.next, piece)
    }

    fn set_after(&mut self, piece: u16, next: u16) {
        if let Some(bytes) = self.next.as_chunks_mut().0.get_mut(usize::from(piece)) {
            *bytes = next.to_le_bytes();
        }
    }

    fn give_back(&mut self, piece: u16) {
        self.set_after(piece, self.free);
        self.free = piece;
        self.free_count += 1;
    }

    fn find(&self, name: &Name) -> Option<usize> {
        self.jobs
            .iter()
            .position(|job| job.as_ref().is_some_and(|job| job.name == *name))
    }

    fn count(&self) -> u8 {
        self.jobs.iter().flatten().count() as u8
    }

    fn entry_of(&self, job: &Job) -> Entry {
        Entry {
            count: self.count(),
            ready: job.ready,
            total: job.total,
            have: job.end.offset,
            crc: job.crc,
            instructions: job.instructions,
            name: job.name,
        }
    }

    /// The job with this number, from 0.
    pub fn entry(&self, number: u8) -> Option<Entry> {
        let job = self.jobs.iter().flatten().nth(number.into())?;
        Some(self.entry_of(job))
    }

    /// A job that can be executed.
    pub fn get(&self, name: &Name) -> Result<Id, Status> {
        let index = self.find(name).ok_or(Status::NoSuchJob)?;
        match self.jobs.get(index) {
            Some(Some(job)) if job.ready => Ok(Id {
                index: index as u8,
                age: self.ages.get(index).copied().unwrap_or(0),
            }),
            Some(_) | None => Err(Status::Incomplete),
        }
    }

    /// Does this id belong to that name?
    pub fn is(&self, id: Id, name: &Name) -> bool {
        self.job(id).is_some_and(|job| job.name == *name)
    }

    fn job(&self, id: Id) -> Option<&Job> {
        let age = self.ages.get(usize::from(id.index))?;
        let job = self.jobs.get(usize::from(id.index))?.as_ref()?;
        (*age == id.age).then_some(job)
    }

    /// Does the job of this name have this length and CRC?
    pub fn same(&self, name: &Name, total: u32, crc: u32) -> bool {
        let mut jobs = self.jobs.iter().flatten();
        jobs.any(|job| job.name == *name && (job.total, job.crc) == (total, crc))
    }

    /// Begins an upload, or continues it; returns the offset to continue from.
    pub fn put(&mut self, name: Name, total: u32, crc: u32) -> Result<u32, Status> {
        let known = self.find(&name);
        if let Some(index) = known
            && let Some(Some(job)) = self.jobs.get(index)
            && (job.total, job.crc) == (total, crc)
        {
            let (have, ready) = (job.end.offset, job.ready);
            if !ready && self.upload != Some(index as u8) {
                self.begin(index as u8);
            }
            return Ok(have);
        }
        // Unfinished uploads have a promise of room; the job that this upload replaces gives room
        // back.
        let (mut free, mut promised) = (u32::from(self.free_count), 0);
        for (index, job) in self.jobs.iter().enumerate() {
            match job {
                Some(job) if known == Some(index) => free += pieces(job.end.offset),
                Some(job) => promised += pieces(job.total) - pieces(job.end.offset),
                None => {}
            }
        }
        if pieces(total) > free.saturating_sub(promised) {
            return Err(Status::Full);
        }
        let vacant = || self.jobs.iter().position(Option::is_none);
        let index = known.or_else(vacant).ok_or(Status::Full)?;
        self.remove(index);
        let start = Place {
            offset: 0,
            piece: LAST,
        };
        if let (Some(place), Some(age)) = (self.jobs.get_mut(index), self.ages.get_mut(index)) {
            *age = age.wrapping_add(1);
            *place = Some(Job {
                name,
                total,
                crc,
                first: LAST,
                end: start,
                ready: false,
                instructions: 0,
            });
        }
        self.begin(index as u8);
        Ok(0)
    }

    /// Starts the check of a job from its beginning.
    fn begin(&mut self, index: u8) {
        let first = match self.jobs.get(usize::from(index)) {
            Some(Some(job)) => job.first,
            Some(None) | None => LAST,
        };
        self.upload = Some(index);
        let reading = &mut self.reading;
        reading.index = index;
        reading.at = Place {
            offset: 0,
            piece: first,
        };
        reading.reader = Reader::default();
        reading.crc = Crc32::new();
        (reading.loaded, reading.instructions, reading.broken) = (0, 0, None);
    }

    fn uploading(&self) -> Option<(usize, &Job)> {
        let index = usize::from(self.upload?);
        Some((index, self.jobs.get(index)?.as_ref()?))
    }

    /// Takes the next bytes of the upload; returns the offset after them. An error contains the
    /// right offset, or the free bytes.
    pub fn data(&mut self, offset: u32, bytes: &[u8]) -> Result<u32, (Status, u32)> {
        let Some((index, job)) = self.uploading() else {
            return Err((Status::NoSuchJob, 0));
        };
        let (mut end, total, mut first) = (job.end, job.total, job.first);
        if offset != end.offset || bytes.len() as u64 > u64::from(total - end.offset) {
            return Err((Status::Offset, end.offset));
        }
        let mut rest = bytes;
        while !rest.is_empty() {
            let within = end.offset as usize % PIECE;
            if within == 0 {
                let piece = self.free;
                if piece == LAST {
                    break;
                }
                self.free = self.after(piece);
                self.free_count -= 1;
                self.set_after(piece, LAST);
                if first == LAST {
                    first = piece;
                } else {
                    self.set_after(end.piece, piece);
                }
                end.piece = piece;
            }
            let (now, later) = rest.split_at(rest.len().min(PIECE - within));
            let at = usize::from(end.piece) * PIECE + within;
            if let Some(place) = self.pieces.get_mut(at..at + now.len()) {
                place.copy_from_slice(now);
            }
            end.offset += now.len() as u32;
            rest = later;
        }
        if let Some(Some(job)) = self.jobs.get_mut(index) {
            (job.end, job.first) = (end, first);
        }
        if rest.is_empty() {
            Ok(end.offset)
        } else {
            Err((Status::Full, self.free()))
        }
    }

    /// Ends an upload. `None`: the check is not finished, ask again. The upload of an invalid job
    /// starts again.
    pub fn commit(&mut self) -> Option<Result<Entry, (Status, u32)>> {
        let Some((index, job)) = self.uploading() else {
            return Some(Err((Status::NoSuchJob, 0)));
        };
        let have = job.end.offset;
        if have != job.total {
            return Some(Err((Status::Incomplete, have)));
        }
        if job.ready {
            return Some(Ok(self.entry_of(job)));
        }
        let (reading, crc) = (&self.reading, job.crc);
        if reading.at.offset < have {
            return None;
        }
        let wrong = if reading.crc.value() != crc {
            Some((Status::Crc, 0))
        } else if reading.reader.summary().is_none() || reading.broken.is_some() {
            Some((Status::NoJob, reading.broken.unwrap_or(have)))
        } else {
            None
        };
        if let Some(wrong) = wrong {
            self.remove(index);
            return Some(Err(wrong));
        }
        let instructions = reading.instructions;
        let Some(Some(job)) = self.jobs.get_mut(index) else {
            return Some(Err((Status::NoSuchJob, 0)));
        };
        (job.ready, job.instructions) = (true, instructions);
        let job = job.clone();
        Some(Ok(self.entry_of(&job)))
    }

    /// Deletes a job.
    pub fn delete(&mut self, name: &Name) -> Result<(), Status> {
        let index = self.find(name).ok_or(Status::NoSuchJob)?;
        self.remove(index);
        Ok(())
    }

    fn remove(&mut self, index: usize) {
        let Some(Some(job)) = self.jobs.get(index) else {
            return;
        };
        let mut piece = job.first;
        while piece != LAST {
            let next = self.after(piece);
            self.give_back(piece);
            piece = next;
        }
        if let Some(place) = self.jobs.get_mut(index) {
            *place = None;
        }
        if self.upload == Some(index as u8) {
            self.upload = None;
        }
    }

    /// Is there anything left to check?
    pub fn reads(&self) -> bool {
        let Some((_, job)) = self.uploading() else {
            return false;
        };
        let reading = &self.reading;
        let waits = job.end.offset - reading.at.offset;
        let enough = waits as usize + reading.loaded >= reading.block.len();
        !job.ready && (enough || waits > 0 && job.end.offset == job.total)
    }

    /// Checks the next block, if it is there. After an invalid block only the CRC is computed.
    pub fn poll(&mut self) {
        if !self.reads() {
            return;
        }
        let Some((_, job)) = self.uploading() else {
            return;
        };
        let (end, total, first) = (job.end.offset, job.total, job.first);
        let (next, all, reading) = (&*self.next, &*self.pieces, &mut self.reading);
        if reading.at.offset == 0 {
            reading.at.piece = first;
        }
        let wanted = (reading.block.len() - reading.loaded).min((end - reading.at.offset) as usize);
        let from = reading.loaded;
        let place = reading.block.get_mut(from..from + wanted);
        let place = place.unwrap_or(&mut []);
        reading.at = copy(next, all, reading.at, place);
        reading.crc.update(place);
        reading.loaded += wanted;
        reading.block();
        // No more bytes follow the last blocks, which may be short. (In an unfinished upload more
        // bytes follow.)
        while reading.at.offset == total && reading.loaded > 0 {
            reading.block();
        }
    }

    /// Starts reading a job.
    pub fn reader(&self, id: Id) -> JobReader {
        JobReader {
            id,
            at: Place {
                offset: 0,
                piece: self.job(id).map_or(LAST, |job| job.first),
            },
        }
    }

    /// Reads its next bytes, as many as there are; `None` if the job is gone.
    pub fn read(&self, reader: &mut JobReader, out: &mut [u8]) -> Option<usize> {
        let job = self.job(reader.id)?;
        let left = (job.end.offset - reader.at.offset) as usize;
        let count = left.min(out.len());
        reader.at = copy(self.next, self.pieces, reader.at, out.get_mut(..count)?);
        Some(count)
    }
}

impl Reading {
    /// Checks the block at the front of the loaded bytes.
    fn block(&mut self) {
        let known = self.block.get(..self.loaded).unwrap_or(&[]);
        let mut count = 0;
        let length = match self.reader.block(known, |_, _| count += 1) {
            _ if self.broken.is_some() => self.loaded,
            Ok(length) => length,
            Err(_) => {
                self.broken = Some(self.at.offset - self.loaded as u32);
                self.loaded
            }
        };
        self.instructions += count;
        self.block.copy_within(length..self.loaded, 0);
        self.loaded -= length;
    }
}

fn pieces(bytes: u32) -> u32 {
    bytes.div_ceil(PIECE as u32)
}

fn after(next: &[u8], piece: u16) -> u16 {
    let bytes = next.as_chunks().0.get(usize::from(piece));
    bytes.map_or(LAST, |bytes| u16::from_le_bytes(*bytes))
}

/// Copies the bytes from this place on; returns the place after them.
fn copy(next: &[u8], pieces: &[u8], mut at: Place, mut out: &mut [u8]) -> Place {
    while !out.is_empty() {
        let within = at.offset as usize % PIECE;
        if within == 0 && at.offset > 0 {
            at.piece = after(next, at.piece);
        }
        let count = out.len().min(PIECE - within);
        let from = usize::from(at.piece) * PIECE + within;
        let (now, later) = out.split_at_mut(count);
        if let Some(bytes) = pieces.get(from..from + count) {
            now.copy_from_slice(bytes);
        }
        at.offset += count as u32;
        out = later;
    }
    at
}

/// The position of a reader in a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct JobReader {
    id: Id,
    at: Place,
}

impl JobReader {
    /// The job's id.
    pub fn id(&self) -> Id {
        self.id
    }
}

#[cfg(test)]
mod tests;
