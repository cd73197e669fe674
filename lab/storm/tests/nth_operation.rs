//! Each operation of a board fails in turn: the first one of a run, the second one, until a run has
//! no more of them; once alone, and once with all that follow within a tenth of a second. The
//! rules of the storm stand beside each run: drives off where they have to be, and the machine
//! comes back.

use taktil_hal::Nanos;
use taktil_hal::fault::{Fault, FaultKind, FaultPlan};
use taktil_lab_storm::case::{Campaign, Case, Scenes};
use taktil_lab_storm::run::run;

/// Time between two operations of a half.
const JOB_PERIOD: Nanos = Nanos::from_micros(2_500);
/// How long operations fail that fail in a row.
const LASTING_TIME: Nanos = Nanos::from_millis(100);
/// The operations in which the operator does what the seed says; behind them only a way back.
const LIVELY_TIME: Nanos = Nanos::from_millis(500);
/// The seed of scene and operator.
const CASE_SEED: u64 = 3;
/// Halves of boards.
const HALVES: [&str; 4] = ["encoders", "analog_out", "digital_in", "digital_out"];
/// From one operation that is tried in every run of the tests to the next one: a prime, so that
/// every phase of the lanes comes.
const CI_STRIDE: i64 = 241;

fn undisturbed() -> Case {
    let scenes = Scenes::built_in().unwrap();
    let none = FaultPlan::default();
    Case::draw(&scenes, CASE_SEED, Campaign::Recoverable, Some(&none), Some(LIVELY_TIME))
}

/// Lets operation after operation fail, `stride` apart; how many runs it took.
fn try_operations(half: &str, duration: Nanos, stride: i64) -> u32 {
    let case = undisturbed();
    let clean = run(&case).unwrap();
    assert_eq!(clean.violations, [], "without a fault");
    let (mut runs, mut met, mut number) = (0, 0, 0);
    loop {
        // The fault begins between two releases and meets what is released next.
        let at = JOB_PERIOD * number + Nanos(JOB_PERIOD.0 / 4);
        let fault = Fault {
            kind: FaultKind::Failing,
            target: half.to_owned(),
            channel: None,
            at,
            duration,
            value: 1.0,
        };
        let mut case = case.with_plan(FaultPlan::new(vec![fault]));
        // What fails late is given the same time to come back from it.
        case.until = case.until.max(at + duration + (case.until - case.calm_from));
        case.calm_from = case.calm_from.max(at + duration);
        let outcome = run(&case).unwrap();
        assert_eq!(outcome.violations, [], "{half}, operation {number}, for {duration}");
        runs += 1;
        met += u32::from(outcome.digest != clean.digest);
        if at > clean.length {
            assert!(met > 0, "{half}: no failure was noticed");
            return runs;
        }
        number += stride;
    }
}

#[test]
fn operations_of_a_board_fail_in_turn() {
    for half in HALVES {
        for duration in [JOB_PERIOD, LASTING_TIME] {
            try_operations(half, duration, CI_STRIDE);
        }
    }
}

#[test]
#[ignore = "minutes: cargo test --release -p taktil-lab-storm --test nth_operation -- --ignored"]
fn every_operation_of_a_board_fails_in_turn() {
    for half in HALVES {
        for duration in [JOB_PERIOD, LASTING_TIME] {
            let runs = try_operations(half, duration, 1);
            println!("{half}, for {duration}: {runs} runs");
        }
    }
}
