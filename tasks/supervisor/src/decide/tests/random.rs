//! Long random runs, which may break no rule.

use super::super::*;
use super::scenario::{Scenario, TICK_PERIOD, set};

/// A small generator (Steele, Lea & Flood 2014, SplitMix64): the same scenario for the same seed.
struct RandomNumbers(u64);

impl RandomNumbers {
    fn throw(&mut self, sides: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        (z ^ (z >> 31)) % sides
    }
}

/// What may change from one job to the next.
fn disturb(scenario: &mut Scenario, dice: &mut RandomNumbers) {
    let bit = |dice: &mut RandomNumbers| u32::from(dice.throw(50) != 0);
    *scenario.lines() =
        Lines { drive_power: bit(dice), estop_a_closed: bit(dice), estop_b_closed: bit(dice) };
    if dice.throw(300) == 0 {
        scenario.inputs.raised = set(&[FaultCode::ALL[dice.throw(22) as usize]]);
    }
    scenario.inputs.touch_silent = dice.throw(500) == 0;
    scenario.inputs.present =
        if dice.throw(9) == 0 { FaultSet::NONE } else { scenario.inputs.raised };
    let done = dice.throw(20) == 0;
    scenario.inputs.trajectory =
        SourceReport { stamp: scenario.inputs.release - TICK_PERIOD, done };
    if dice.throw(4) == 0 {
        scenario.sequence += 1;
        let verb = dice.throw(13) as u32;
        scenario.inputs.request = Some(Request { verb, sequence: scenario.sequence });
    }
}

#[test]
fn long_random_runs_break_no_rule() {
    let mut visited = [0u32; 9];
    for seed in 0..40 {
        let mut dice = RandomNumbers(seed);
        let mut scenario = Scenario::new();
        let mut before = (scenario.at(), scenario.control);
        for _ in 0..5000 {
            // Most jobs are undisturbed, so that motion can begin; then disturbances come in
            // bursts.
            if dice.throw(100) < 30 {
                let keep = scenario.inputs.lines;
                disturb(&mut scenario, &mut dice);
                if dice.throw(20) != 0 {
                    scenario.inputs.lines = keep;
                }
            } else {
                *scenario.lines() = Lines { drive_power: 1, estop_a_closed: 1, estop_b_closed: 1 };
                scenario.inputs.touch_silent = false;
                scenario.inputs.present = FaultSet::NONE;
            }
            scenario.tick();
            let (state, mode) = scenario.at();
            visited[state as usize] += 1;
            let torque = matches!(mode, Mode::Hold | Mode::Moving | Mode::Stopping);
            assert_eq!(state != State::Start, torque, "seed {seed}: {state:?} in {mode:?}");
            if torque && mode != Mode::Stopping {
                assert_eq!(crate::law::required_mode(state), Some(mode), "seed {seed}");
            }
            let asked = (scenario.control.request != before.1.request)
                .then(|| scenario.inputs.request.and_then(|r| Verb::from_code(r.verb)))
                .flatten();
            let lost = before.1.faults & !scenario.control.faults;
            assert!(lost == 0 || asked == Some(Verb::Reset), "seed {seed}: a fault was forgotten");
            if before.0.1 == Mode::Fault && mode != Mode::Fault {
                assert_eq!((asked, mode), (Some(Verb::Reset), Mode::Checking), "seed {seed}");
            }
            if mode == Mode::Enabling && before.0.1 != Mode::Enabling {
                assert_eq!(asked, Some(Verb::Enable), "seed {seed}");
            }
            if scenario.control.calibrate == 1 {
                assert_eq!((asked, state), (Some(Verb::Calibrate), State::IdleCalibrated));
            }
            before = ((state, mode), scenario.control);
        }
    }
    assert!(visited.iter().all(|jobs| *jobs > 0), "not every state was visited: {visited:?}");
}
