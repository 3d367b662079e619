//! What the release image cannot do: panic behind its parser, or run out of stack. Read from its machine code.

use ferrocnc_tests::image::Code;
use ferrocnc_tests::{Machine, parts};

/// Every place that may panic, by the function it is in, and why it may.
const JUSTIFIED: &[(&str, &str)] = &[(
    "App>::chores",
    "the guard at the end of the stack is damaged: a restart, rather than a damaged record",
)];

/// Bytes of stack that are nobody's, even on the longest way anybody can think of.
const MARGIN: u32 = 128;

#[test]
fn the_image_can_panic_nowhere_but_where_it_is_meant_to() {
    let code = Code::read(&parts().1);
    let unjustified: Vec<_> = code
        .panics()
        .into_iter()
        .filter(|panic| {
            !JUSTIFIED
                .iter()
                .any(|(place, _)| panic.function.contains(place))
        })
        .map(|panic| format!("{:#x} in {}", panic.at, panic.function))
        .collect();
    assert!(
        unjustified.is_empty(),
        "these can panic:\n  {}\nriscv64-unknown-elf-addr2line -Cipe IMAGE ADDRESS says which line",
        unjustified.join("\n  ")
    );
    // The check itself can fail: the one panic there is, is seen.
    assert_eq!(code.panics().len(), JUSTIFIED.len());
    println!("panicking functions in the image: {:?}", code.panicking());
}

#[test]
fn the_stack_holds_the_longest_way_through_the_image_and_a_trap_at_its_end() {
    let code = Code::read(&parts().1);
    let longest = |entry| code.deepest(entry).unwrap_or_else(|why| panic!("{why}"));
    let (run, trap) = (longest("_abs_start"), longest("_default_start_trap"));
    for (name, bytes) in run.way.iter().chain(&trap.way) {
        println!("{bytes:>6}  {name}");
    }
    let most = run.bytes + trap.bytes;
    println!("{} + {} of {} bytes", run.bytes, trap.bytes, code.stack);
    assert!(
        most + MARGIN <= code.stack,
        "the stack may take {most} bytes, there are {}",
        code.stack
    );
}

#[test]
fn a_board_at_work_has_used_no_more_stack_than_the_longest_way_and_most_of_it() {
    let code = Code::read(&parts().1);
    let longest = code
        .deepest("_abs_start")
        .unwrap_or_else(|why| panic!("{why}"));
    let mut machine = Machine::armed();
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
