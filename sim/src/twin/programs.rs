//! What runs in the twin's SDRAM.

use ::jobs::inside::Inside;
use firmware::machine::Shared;
use firmware::services::console::Reader;
use wire::describe::JobsState;

use crate::board_facts::BoardFacts;
use crate::jobs;
use crate::lease::DhcpClient;
use crate::model_board::ModelBoard;

/// The services of a board: jobs where there are segments, what asks DHCP servers, and what the
/// consoles read with.
pub(super) fn programs(
    machine: &mut Shared<ModelBoard>,
    facts: &BoardFacts,
    sdram: bool,
) -> (Option<jobs::Program>, Option<DhcpClient>, Option<Reader>) {
    if !facts.sdram {
        machine.alone().jobs(match facts.jobs {
            0 => JobsState::None,
            _ => JobsState::Streamed,
        });
        return (None, None, None);
    }
    if !sdram {
        machine.alone().jobs(JobsState::Sdram);
        return (None, None, None);
    }
    let program = match facts.jobs {
        0 => None,
        _ => jobs::Program::start(machine.guest(), facts.clock_hz),
    };
    machine.alone().jobs(JobsState::Alive);
    let dhcp = DhcpClient::start(machine.guest(), facts.clock_hz);
    let board = Inside::new(&mut jobs::Outer(machine.guest()));
    (
        program,
        dhcp,
        board.map(|(_, board)| Reader::new(board.channels, board.clock_hz)),
    )
}
