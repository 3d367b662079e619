use super::*;
use crate::netlist::Sink;

fn net(bit: u64, source: u32, sinks: &[u32]) -> Net {
    let sink = |&wire| Sink {
        wire,
        through: Vec::new(),
        end: Some((0.0, 0)),
    };
    Net {
        bit,
        source,
        begin: Some((0.0, 0)),
        sinks: sinks.iter().map(sink).collect(),
    }
}

/// Routes, and looks whether every pin is reached, by switches there are, and no wire twice.
/// The wires of every net.
fn route(chip: &Chip, nets: &[Net], target: f32) -> Result<Vec<Vec<u32>>> {
    let mut router = Router::new(chip, nets, vec![target]);
    router.run(100, &[target], |_| {})?;
    let mut owner = HashMap::new();
    for (n, (net, way)) in nets.iter().zip(&router.ways).enumerate() {
        for (&wire, step) in &way.tree {
            assert_eq!(owner.insert(wire, n), None, "wire {wire} is in two nets");
            if step.pip == NONE {
                assert_eq!(wire, net.source);
            } else {
                assert_eq!(chip.pip(step.pip).to, wire);
                let (first, pips) = chip.downhill(step.from);
                assert!((first..first + pips.len() as u32).contains(&step.pip));
                assert!(way.tree.contains_key(&step.from));
            }
        }
        net.sinks.iter().for_each(|s| {
            assert!(
                way.tree.contains_key(&s.wire),
                "pin {} is not reached",
                s.wire
            )
        });
    }
    let wires = |way: &Way| {
        let mut wires: Vec<u32> = way.tree.keys().copied().collect();
        wires.sort_unstable();
        wires
    };
    Ok(router.ways.iter().map(wires).collect())
}

/// Sources 0 and 1, pins 8 and 9; a short wire 2 for both, and a detour for each.
const CROSSING: [(u32, u32); 10] = [
    (0, 2),
    (1, 2),
    (2, 8),
    (2, 9),
    (0, 3),
    (3, 4),
    (4, 8),
    (1, 5),
    (5, 6),
    (6, 9),
];

#[test]
fn of_two_nets_that_want_a_wire_one_takes_the_detour() {
    let chip = Chip::of(10, &CROSSING);
    let ways =
        route(&chip, &[net(7, 0, &[8]), net(8, 1, &[9])], 1e6).expect("there is room for both");
    assert_eq!(ways.iter().filter(|way| way.contains(&2)).count(), 1);
}

#[test]
fn the_net_a_clock_depends_on_gets_the_short_way() {
    let chip = Chip::of(10, &CROSSING);
    for critical in 0..2 {
        let mut nets = [net(7, 0, &[8]), net(8, 1, &[9])];
        nets[critical].begin = Some((5000.0, 0));
        let ways = route(&chip, &nets, 5100.0).expect("there is room for both");
        assert!(ways[critical].contains(&2), "net {critical} was to be fast");
    }
}

#[test]
fn what_does_not_fit_is_an_error_that_says_so() {
    let chip = Chip::of(10, &[(0, 2), (1, 2), (2, 8), (2, 9)]);
    let error =
        route(&chip, &[net(7, 0, &[8]), net(8, 1, &[9])], 1e6).expect_err("one wire for two nets");
    assert!(error.to_string().contains("too crowded"), "{error}");
}

#[test]
fn a_pin_that_cannot_be_reached_is_named() {
    let chip = Chip::of(10, &[(0, 2)]);
    let error = route(&chip, &[net(7, 0, &[8])], 1e6).expect_err("no switch leads there");
    assert_eq!(error.to_string(), "no way leads from X0/Y0/w to X8/Y0/w");
}

#[test]
fn random_designs_are_routed_and_twice_the_same() {
    for seed in 1..200u64 {
        let mut state = seed;
        let mut random = |below: u32| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as u32 % below
        };
        // Sources 0..10 lead to wires of 20..80, those on to each other and to pins 100..140. A
        // way of its own is there for every pin, so that nothing is too crowded.
        let (mut pips, mut nets) = (Vec::new(), Vec::new());
        for source in 0..10 {
            let pins: Vec<u32> = (0..1 + random(4))
                .map(|pin| 100 + 4 * source + pin)
                .collect();
            pips.push((source, 80 + source));
            pips.extend(pins.iter().map(|&pin| (80 + source, pin)));
            pips.extend((0..3).map(|_| (source, 20 + random(60))));
            nets.push(net(u64::from(source), source, &pins));
        }
        pips.extend(
            (20..80)
                .flat_map(|wire| {
                    [
                        (wire, 20 + random(60)),
                        (wire, 100 + random(40)),
                        (wire, 100 + random(40)),
                    ]
                })
                .collect::<Vec<_>>(),
        );
        let chip = Chip::of(140, &pips);
        let ways =
            route(&chip, &nets, 400.0).unwrap_or_else(|error| panic!("seed {seed}: {error}"));
        let again =
            route(&chip, &nets, 400.0).unwrap_or_else(|error| panic!("seed {seed}: {error}"));
        assert_eq!(ways, again, "seed {seed}");
    }
}
