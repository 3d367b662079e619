use super::*;

const TIMEOUT: u32 = 5;
const GRACE: u32 = 3;

/// A clock without an input.
const SILENCE: Input = Input {
    rst: false,
    ext_reset: false,
    estop: false,
    token: None,
    feed: false,
    arm: false,
    soft_stop: false,
    shut: false,
    clear: false,
    timeout: TIMEOUT,
    grace: GRACE,
    all_stopped: false,
};
const ARM: Input = Input {
    arm: true,
    ..SILENCE
};
const CLEAR: Input = Input {
    clear: true,
    ..SILENCE
};
const SOFT_STOP: Input = Input {
    soft_stop: true,
    ..SILENCE
};
const SHUT: Input = Input {
    shut: true,
    ..SILENCE
};
const RST: Input = Input {
    rst: true,
    ..SILENCE
};
const RESET: Input = Input {
    ext_reset: true,
    ..SILENCE
};
const ESTOP: Input = Input {
    estop: true,
    ..SILENCE
};
const AT_REST: Input = Input {
    all_stopped: true,
    ..SILENCE
};

fn token(token: u32) -> Input {
    Input {
        token: Some(token),
        ..SILENCE
    }
}

fn after(mut watchdog: Watchdog, inputs: &[Input]) -> Watchdog {
    inputs.iter().for_each(|input| watchdog.clock(input));
    watchdog
}

fn new(inputs: &[Input]) -> Watchdog {
    after(Watchdog::default(), inputs)
}

fn open(watchdog: &Watchdog) -> bool {
    watchdog.gate(false, false)
}

/// Bitten this very clock, still open.
fn bitten() -> Watchdog {
    after(new(&[ARM]), &[SILENCE; TIMEOUT as usize + 1])
}

#[test]
fn it_opens_when_it_is_told_to_and_counts_from_there() {
    let watchdog = new(&[]);
    assert_eq!(
        (watchdog.status(false, false), watchdog.remaining()),
        (0, 0)
    );
    let watchdog = new(&[ARM]);
    assert_eq!(watchdog.status(false, false), 0b10_0001);
    assert_eq!(watchdog.remaining(), TIMEOUT);
    let watchdog = after(watchdog, &[SILENCE, ARM]);
    assert_eq!(
        watchdog.remaining(),
        TIMEOUT - 2,
        "an open gate is not armed"
    );
    assert_eq!(watchdog.last_close(), 0);
}

#[test]
fn a_token_that_differs_feeds_it_and_a_repeated_one_does_not() {
    let watchdog = after(new(&[ARM]), &[SILENCE, SILENCE, token(7)]);
    assert_eq!((watchdog.remaining(), watchdog.last_token()), (TIMEOUT, 7));
    let watchdog = after(watchdog, &[token(7)]);
    assert_eq!(
        (watchdog.remaining(), watchdog.last_token()),
        (TIMEOUT - 1, 7)
    );
    assert_eq!(after(watchdog, &[token(6)]).remaining(), TIMEOUT);
    let watchdog = after(new(&[ARM]), &[SILENCE; TIMEOUT as usize]);
    assert_eq!(watchdog.remaining(), 0);
    let watchdog = after(watchdog, &[token(7)]);
    assert_eq!(
        (watchdog.remaining(), watchdog.bites()),
        (TIMEOUT, 0),
        "in time"
    );
}

#[test]
fn a_token_feeds_nothing_that_is_closed_or_stops() {
    assert_eq!(new(&[token(3)]).remaining(), 0);
    let stopping = after(new(&[ARM]), &[SOFT_STOP]);
    assert_eq!(after(stopping, &[token(3)]).remaining(), GRACE - 1);
    let both = Input {
        token: Some(3),
        ..SOFT_STOP
    };
    let stopping = after(new(&[ARM]), &[both]);
    assert_eq!((stopping.remaining(), stopping.last_token()), (GRACE, 3));
}

#[test]
fn without_a_token_it_bites_and_the_gate_stays_open_for_the_soft_stop() {
    let watchdog = bitten();
    assert_eq!(watchdog.status(false, false), 0b00_0111);
    assert!(watchdog.stop());
    assert_eq!((watchdog.remaining(), watchdog.bites()), (GRACE, 1));
    assert_eq!(watchdog.last_close(), 0, "not closed yet");
    let watchdog = after(watchdog, &[token(9)]);
    assert_eq!(watchdog.remaining(), GRACE - 1, "a token mends no bite");
}

#[test]
fn a_bite_ends_at_rest_or_with_its_grace() {
    for (inputs, closed) in [
        (&[AT_REST][..], true),
        (&[SILENCE; 3], false),
        (&[SILENCE; 4], true),
    ] {
        let watchdog = after(bitten(), inputs);
        assert_eq!(open(&watchdog), !closed, "{inputs:?}");
        assert_eq!(watchdog.stop(), !closed);
        if closed {
            assert_eq!(watchdog.status(false, false), 0b00_0100);
            assert_eq!((watchdog.last_close(), watchdog.remaining()), (1, 0));
        }
    }
    assert!(open(&after(new(&[ARM]), &[AT_REST])), "nothing was to stop");
}

#[test]
fn an_ordered_stop_ends_like_a_bite_and_is_none() {
    let stopping = after(new(&[ARM]), &[SOFT_STOP]);
    assert_eq!(stopping.status(false, false), 0b00_0011);
    assert_eq!((stopping.remaining(), stopping.bites()), (GRACE, 0));
    let again = after(stopping.clone(), &[SOFT_STOP]);
    assert_eq!(
        again.remaining(),
        GRACE - 1,
        "asked again it takes no longer"
    );
    let watchdog = after(stopping, &[AT_REST]);
    assert_eq!((open(&watchdog), watchdog.last_close()), (false, 4));
    assert_eq!(watchdog.status(false, false), 0);
    assert!(
        !new(&[SOFT_STOP]).stop(),
        "a closed gate has nothing to stop"
    );
}

#[test]
fn an_order_closes_at_once() {
    let watchdog = after(new(&[ARM]), &[SHUT]);
    assert_eq!((open(&watchdog), watchdog.last_close()), (false, 3));
    assert_eq!((watchdog.remaining(), watchdog.stop()), (0, false));
    let both = Input {
        soft_stop: true,
        ..SHUT
    };
    assert!(!after(new(&[ARM]), &[both]).stop(), "closed, not stopping");
    assert_eq!(new(&[SHUT]).last_close(), 0, "it was closed before");
}

#[test]
fn a_pin_closes_the_gate_in_its_own_clock_and_is_latched() {
    let live = new(&[ARM]);
    assert!(!live.gate(true, false) && !live.gate(false, true) && open(&live));
    for (input, close, status) in [(RESET, 2, 0b00_1000), (ESTOP, 5, 0b100_0000)] {
        let watchdog = after(live.clone(), &[input, SILENCE]);
        assert_eq!((open(&watchdog), watchdog.last_close()), (false, close));
        assert_eq!(watchdog.status(false, false), status);
        assert_eq!(watchdog.remaining(), 0);
    }
    assert_eq!(new(&[]).status(true, false), 0b001_0000);
    assert_eq!(new(&[]).status(false, true), 0b1000_0000);
    let both = Input {
        estop: true,
        ..RESET
    };
    assert_eq!(
        after(live, &[both]).last_close(),
        5,
        "the e-stop comes first"
    );
}

#[test]
fn nothing_opens_over_what_is_latched_or_forbids_it() {
    let latched = [after(bitten(), &[AT_REST]), new(&[RESET]), new(&[ESTOP])];
    for watchdog in latched {
        assert!(!open(&after(watchdog.clone(), &[ARM])), "{watchdog:?}");
        let cleared = after(watchdog, &[CLEAR]);
        assert_eq!(cleared.status(false, false), 0);
        assert!(open(&after(cleared, &[ARM])));
    }
    for input in [RESET, ESTOP, SHUT, RST] {
        let input = Input { arm: true, ..input };
        assert!(!open(&new(&[input])), "{input:?}");
    }
}

#[test]
fn nothing_is_cleared_behind_an_open_gate_or_under_a_pin() {
    let watchdog = bitten();
    assert!(!watchdog.cleared(&CLEAR));
    assert_eq!(after(watchdog, &[CLEAR]).status(false, false), 0b00_0111);
    for (input, status) in [(RESET, 0b00_1000), (ESTOP, 0b100_0000)] {
        let under_a_pin = Input {
            clear: true,
            ..input
        };
        let watchdog = new(&[input]);
        assert!(!watchdog.cleared(&under_a_pin) && watchdog.cleared(&CLEAR));
        assert!(!watchdog.cleared(&SILENCE));
        let watchdog = after(watchdog, &[under_a_pin]);
        assert_eq!(watchdog.status(false, false), status);
    }
}

#[test]
fn a_system_reset_forgets_a_bite_and_a_reset_but_no_e_stop_and_keeps_the_reason() {
    let watchdog = after(new(&[ARM]), &[RST]);
    assert_eq!((open(&watchdog), watchdog.last_close()), (false, 6));
    let watchdog = after(bitten(), &[RST]);
    assert_eq!(
        (watchdog.status(false, false), watchdog.last_close()),
        (0, 1)
    );
    assert_eq!(watchdog.bites(), 1);
    let at_its_bite = after(new(&[ARM]), &[SILENCE; TIMEOUT as usize]);
    let watchdog = after(at_its_bite, &[RST]);
    assert_eq!(
        (watchdog.status(false, false), watchdog.last_close()),
        (0, 1)
    );
    assert_eq!(new(&[RESET, RST]).status(false, false), 0);
    assert_eq!(new(&[ESTOP, RST]).status(false, false), 0b100_0000);
}

#[test]
fn what_cuts_the_stop_of_a_bite_short_is_not_the_reason_unless_it_is_a_pin() {
    for (input, close) in [(SHUT, 1), (RST, 1), (RESET, 2), (ESTOP, 5)] {
        assert_eq!(after(bitten(), &[input]).last_close(), close, "{input:?}");
    }
}

#[test]
fn quiet_clocks_at_once_are_the_same_as_one_by_one() {
    for watchdog in [new(&[]), new(&[ARM]), bitten(), new(&[RESET])] {
        let quiet = watchdog.quiet().min(40);
        for clocks in 0..=quiet {
            let mut skipped = watchdog.clone();
            skipped.skip(clocks);
            let silence = vec![SILENCE; clocks as usize];
            assert_eq!(skipped, after(watchdog.clone(), &silence));
        }
    }
    assert_eq!(new(&[ARM]).quiet(), u64::from(TIMEOUT));
    assert_eq!(new(&[]).quiet(), u64::MAX);
}

#[test]
fn every_bite_is_counted() {
    let again = after(bitten(), &[AT_REST, CLEAR, ARM]);
    let again = after(again, &[SILENCE; TIMEOUT as usize + 1]);
    assert_eq!(again.bites(), 2);
}
