//! The images in flash: which one runs, which one loads next, and how that changes one byte at a
//! time.
//!
//! The FPGA takes the first page of the two stub sectors that has a preamble
//! ([`wire::images::Stub`]). The selection of another slot takes small steps. Each step is derived
//! from the pages as they are ([`next`]). So a selection that a power cut interrupted continues
//! where it stopped, and in every state on the way either the old slot or the new one comes first.
//!
//! ```text
//!   a live stub behind the first         break it, unless it is the new one
//!   the new one lies behind the first    break the first: the new one is it      <- the switch
//!   room behind the first                write the new one there: body, then b3, then bd
//!   none left in the sector              the same in the other sector; if that lies before the first,
//!                                        the new stub's last byte                 <- is the switch
//!   none left there either               clear every preamble in it, then erase it
//! ```
//!
//! This module accesses only the stub sectors; [`crate::flash`] checks that a slot holds a whole
//! image.

use crate::nor::Nor;
use embedded_hal::spi::SpiDevice;
use wire::flash::{Layout, OpResult, PAGE, SECTOR, Slot};
use wire::images::Stub;

/// Pages in a stub sector.
const PER_SECTOR: usize = (SECTOR / PAGE) as usize;
const PAGES: usize = Layout::STUB_PAGES as usize;
/// A stub's bytes after its preamble.
const BODY_AT: usize = Stub::SWITCH_AT + 2;

/// What a page of a stub sector is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Page {
    /// Its first bytes are erased.
    Blank,
    /// A stub without its preamble's last two bytes.
    Bare(Slot),
    /// A stub without its switch.
    Ready(Slot),
    /// A stub.
    Live(Slot),
    /// Has a preamble, but points to no known image.
    Foreign,
    /// Has no preamble, and not even a partial erase could create one.
    Cleared,
    /// Anything else.
    Dead,
}

impl Page {
    fn of(head: &[u8; Stub::BYTES], layout: &Layout) -> Page {
        if head.iter().all(|byte| *byte == 0xff) {
            return Page::Blank;
        }
        let switch = (head[Stub::SWITCH_AT], head[Stub::SWITCH_AT + 1]);
        for slot in [Slot::A, Slot::B] {
            let target = layout.slot(slot).start;
            let stub = Stub { target }.to_page();
            let same = |range: core::ops::Range<usize>| head.get(range.clone()) == stub.get(range);
            if same(0..Stub::SWITCH_AT) && same(BODY_AT..Stub::BYTES) {
                match switch {
                    (0xff, 0xff) => return Page::Bare(slot),
                    (0xff, 0xb3) => return Page::Ready(slot),
                    (0xbd, 0xb3) => return Page::Live(slot),
                    _ => {}
                }
            }
        }
        match switch {
            (0xbd, 0xb3) => Page::Foreign,
            (0, 0) => Page::Cleared,
            _ => Page::Dead,
        }
    }

    /// Would the FPGA take this page?
    fn live(self) -> bool {
        matches!(self, Page::Live(_) | Page::Foreign)
    }
}

/// The next step towards a selection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// The slot is selected, and no other stub is live.
    Done,
    /// Program these bytes.
    Program(u32, &'static [u8]),
    /// Program the body of this slot's stub.
    Body(u32, Slot),
    /// Erase this sector.
    Erase(u32),
}

fn scan<S: SpiDevice>(nor: &mut Nor<S>, layout: &Layout) -> Result<[Page; PAGES], OpResult> {
    let mut pages = [Page::Dead; PAGES];
    for (n, page) in pages.iter_mut().enumerate() {
        let mut head = [0; Stub::BYTES];
        nor.read(layout.stub(n as u32), &mut head)?;
        *page = Page::of(&head, layout);
    }
    Ok(pages)
}

/// The slot that loads at the next power-up, if one does.
pub fn selected<S: SpiDevice>(nor: &mut Nor<S>, layout: &Layout) -> Result<Option<Slot>, OpResult> {
    let pages = scan(nor, layout)?;
    Ok(match pages.iter().find(|page| page.live()) {
        Some(Page::Live(slot)) => Some(*slot),
        _ => None,
    })
}

/// The next step that is needed to make `slot` the one that loads.
pub fn next<S: SpiDevice>(nor: &mut Nor<S>, layout: &Layout, slot: Slot) -> Result<Step, OpResult> {
    let pages = scan(nor, layout)?;
    let at = |n: usize, offset: usize| layout.stub(n as u32) + offset as u32;
    let broken = |n| Step::Program(at(n, Stub::SWITCH_AT), &[0]);
    let mut live = pages.iter().enumerate().filter(|(_, page)| page.live());
    let first = live.next();
    match (first, live.next()) {
        (Some((_, Page::Live(of))), None) if *of == slot => return Ok(Step::Done),
        (Some((n, page)), Some((_, Page::Live(of))))
            if *of == slot && *page != Page::Live(slot) =>
        {
            return Ok(broken(n));
        }
        (Some(_), Some((n, _))) => return Ok(broken(n)),
        (Some(_), None) | (None, _) => {}
    }
    // At most one is live, and it is not the new one.
    let sector = |n: usize| n / PER_SECTOR;
    let (here, other) = match first {
        Some((n, _)) => (n + 1..(sector(n) + 1) * PER_SECTOR, 1 - sector(n).min(1)),
        None => (0..PAGES, 0),
    };
    let there = other * PER_SECTOR..(other + 1) * PER_SECTOR;
    for n in here.chain(there.clone()) {
        match pages.get(n) {
            Some(Page::Ready(of)) if *of == slot => {
                return Ok(Step::Program(at(n, Stub::SWITCH_AT), &[0xbd]));
            }
            Some(Page::Bare(of)) if *of == slot => {
                return Ok(Step::Program(at(n, Stub::SWITCH_AT + 1), &[0xb3]));
            }
            Some(Page::Blank) if nor.blank(at(n, 0), PAGE)? => {
                return Ok(Step::Body(at(n, BODY_AT), slot));
            }
            _ => {}
        }
    }
    // A sector full of used pages. During an erase its bits rise one by one: no page may pass
    // through a state with a preamble.
    for n in there {
        if pages.get(n) != Some(&Page::Cleared) {
            let mut switch = [0xff; 2];
            nor.read(at(n, Stub::SWITCH_AT), &mut switch)?;
            if switch != [0, 0] {
                return Ok(Step::Program(at(n, Stub::SWITCH_AT), &[0, 0]));
            }
        }
    }
    Ok(Step::Erase(at(other * PER_SECTOR, 0)))
}

/// The bytes of a stub after its preamble.
pub fn body(layout: &Layout, slot: Slot) -> [u8; Stub::BYTES - BODY_AT] {
    let target = layout.slot(slot).start;
    let page = Stub { target }.to_page();
    core::array::from_fn(|n| page.get(BODY_AT + n).copied().unwrap_or(0xff))
}
