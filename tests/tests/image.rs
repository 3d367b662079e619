//! Shows from the machine code that the release image cannot panic after its parser and cannot run
//! out of stack.

use ferrocnc_tests::image::{CALLED_BACK, Code, Deepest};
use ferrocnc_tests::{BenchMachine, parts, report_part, wired};
use serde_json::json;
use std::path::PathBuf;

/// Every place that may panic: a part of its function's name, how many there are in it, and why
/// they may.
type Justified = [(&'static str, usize, &'static str)];

/// In the ROM's image.
const IN_THE_IMAGE: &Justified = &[(
    "App>::housekeeping",
    1,
    "the guard at the end of the stack is damaged: a restart, rather than a damaged record",
)];

/// In the services, what plans and executes motion: a panic there ends a job. No file and no frame
/// can reach one of them. For the rest of the services, smoltcp above all, there is no such list:
/// a panic ends them, and the machine goes on (`services`).
const IN_THE_PLANNER: &Justified = &[
    (
        "Executor>::play",
        1,
        "the queue's head is counted modulo the queue's length",
    ),
    (
        "Planner<32>>::begin_at",
        1,
        "steps by steps per km: `Machinery::new` takes no 0",
    ),
    (
        "Player<64>>::legs_of",
        2,
        "clocks by the clock's frequency, which the board's description has; axes of a word that has as many",
    ),
    (
        "Planner<32>>::goal",
        1,
        "its callers count axes up to as many as there are",
    ),
    (
        "Planner<32>>::append",
        1,
        "a feed between a line's slowest and its top: the slowest is at most the top when the line is made",
    ),
    ("line::PlannedLine>::at", 1, "the same"),
    (
        "Follower>::piece",
        2,
        "a segment has clocks, so it has pieces; a velocity is whole where a segment begins, so it lies between those that are within reach",
    ),
    (
        "MotionState>::run",
        1,
        "a line without a slope ends before anything is divided by the slope",
    ),
    (
        "wide::quotient_by_digits",
        1,
        "`quotient` keeps 0 away from it",
    ),
    (
        "wide::digit",
        1,
        "`quotient` and `wide` keep 0 away from it, and the slope of a line is none (`within`)",
    ),
    (
        "wide::half_digit",
        1,
        "its divisor has been shifted until its highest bit is set",
    ),
    (
        "<[u8]>::copy_within",
        1,
        "what of a block is done and what of it is loaded, which is at least as much and at most a block",
    ),
    (
        "Store>::new",
        1,
        "so many pieces as fit with their links; the links have been taken",
    ),
];

/// Bytes of stack that stay free even on the longest way.
const MARGIN: u32 = 128;

/// Is this code of `jobs` or `motion`? The turn of the connections is inlined into `poll_beside`.
fn plans(function: &str) -> bool {
    let planner = ["ferrocnc_jobs::", "ferrocnc_motion::"];
    planner.iter().any(|part| function.contains(part)) && !function.contains("poll_beside")
}

/// Every panic of `code` in these functions is in `justified`, which is what may be there at most;
/// how many there are.
fn panics_only_where(code: &Code, of: impl Fn(&str) -> bool, justified: &Justified) -> usize {
    let mut panics = code.panics();
    panics.retain(|panic| of(&panic.function));
    let mut left: Vec<usize> = justified.iter().map(|(_, count, _)| *count).collect();
    let mut wrong = Vec::new();
    for panic in &panics {
        let mut known = justified.iter();
        let known = known.position(|(part, ..)| panic.function.contains(part));
        match known.map(|index| &mut left[index]) {
            Some(left) if *left > 0 => *left -= 1,
            _ => wrong.push(format!("{:#x} in {}", panic.at, panic.function)),
        }
    }
    assert!(
        wrong.is_empty(),
        "these can panic, besides what is justified:\n  {}\nriscv64-unknown-elf-addr2line -Cipe IMAGE ADDRESS says which line",
        wrong.join("\n  ")
    );
    println!("panicking functions: {:?}", code.panicking());
    panics.len()
}

/// There is room for so many bytes of stack, and for the margin.
fn fits(code: &Code, most: u32) {
    println!("{most} of {} bytes", code.stack);
    assert!(
        most + MARGIN <= code.stack,
        "the stack may take {most} bytes, there are {}",
        code.stack
    );
}

fn longest(code: &Code, entry: &str) -> Deepest {
    let way = code.deepest(entry).unwrap_or_else(|why| panic!("{why}"));
    println!("from {entry}: {} bytes", way.bytes);
    for (name, bytes) in &way.way {
        println!("{bytes:>6}  {name}");
    }
    way
}

/// The services that go with the image, with jobs.
fn services() -> PathBuf {
    parts().1.with_file_name("ferrocnc-services.elf")
}

#[test]
fn the_image_can_panic_nowhere_but_where_it_is_meant_to() {
    let panics = panics_only_where(&Code::read(&parts().1), |_| true, IN_THE_IMAGE);
    // The check itself can fail: the one panic there is, is seen.
    assert_eq!(panics, IN_THE_IMAGE.len());
}

#[test]
fn what_plans_motion_can_panic_nowhere_but_where_that_cannot_happen() {
    let panics = panics_only_where(&Code::read(&services()), plans, IN_THE_PLANNER);
    // Another compiler may see that some of them cannot be.
    assert_ne!(panics, 0, "none was found: the check finds nothing");
}

#[test]
fn the_stack_holds_the_longest_way_through_the_image_and_a_trap_at_its_end() {
    let code = Code::read(&parts().1);
    let run = longest(&code, "_abs_start");
    let trap = longest(&code, "services_trap");
    let most = run.bytes + trap.bytes;
    report_part(
        "image",
        "stack",
        json!({ "longest": most, "bytes": code.stack }),
    );
    fits(&code, most);
}

#[test]
fn the_services_stack_holds_its_longest_way_what_it_calls_back_and_a_trap() {
    let image = Code::read(&parts().1);
    let back = CALLED_BACK.map(|entry| longest(&image, entry).bytes);
    let trap = longest(&image, "services_trap");
    let without_jobs = services().with_file_name("ferrocnc-services-without-jobs.elf");
    for program in [services(), without_jobs] {
        let code = Code::read(&program);
        let run = longest(&code, "services_main");
        let most = run.bytes + back.into_iter().max().unwrap_or(0) + trap.bytes;
        fits(&code, most);
    }
}

#[test]
fn a_board_at_work_has_used_no_more_stack_than_the_longest_way_and_most_of_it() {
    let code = Code::read(&parts().1);
    let longest = longest(&code, "_abs_start");
    // The console tells.
    let mut machine = BenchMachine::boot(wired::mill());
    machine.make_ready();
    let mut command = machine.enabled_command();
    for _ in 0..20 {
        machine.exchange_and_wait(&mut command);
    }
    // The console is shut while the machine is armed.
    machine.run_millis(100);
    let used = machine.stack_used();
    println!("{used} of {} bytes", longest.bytes);
    assert!(
        (longest.bytes * 9 / 10..=longest.bytes).contains(&used),
        "{used} bytes were used; the longest way is said to take {}",
        longest.bytes
    );
}
