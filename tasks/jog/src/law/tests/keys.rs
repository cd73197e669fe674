//! Tests random keys in every frame on every kind of arm: no set point steps farther than the
//! fastest joint in one job, no joint leaves its limits, and the arm stops when the keys are
//! released.

use super::super::*;
use super::chains::{rates, seven, seven_at, six, six_at};
use super::tool_motion::TRIALS_MAX;
use taktil_tests_script::dice::Dice;

const DT_S: f64 = 0.0025;
/// Number of jobs in a tenth of a second, less those in which an unconfirmed key still counts as
/// held.
const STOP_JOBS_MAX: u32 = 24;

/// Random keys of one operator.
fn random_demand(dice: &mut Dice) -> JogDemand {
    let axes = core::array::from_fn(|_| match dice.roll(8) {
        0 => 1.0,
        1 => -1.0,
        2 => 0.37,
        _ => 0.0,
    });
    let frame = match dice.roll(8) {
        0 => JogFrame::Joints,
        1 => JogFrame::Outer,
        2..5 => JogFrame::Base,
        _ => JogFrame::Tool,
    };
    JogDemand { axes, frame }
}

/// Runs a minute of random keys; returns the largest number of jobs in which the arm came to rest
/// after a release.
fn minute<const N: usize, A: Arm<N>>(
    arm: &A,
    rates: &Rates<N>,
    at: &JointVector<N>,
    seed: u64,
) -> u32 {
    let (mut dice, mut law) = (Dice::new(seed), Law::new(arm, rates, at, true));
    let (mut before, mut qd, mut slowest) = (*at, JointVector::<N>::zeros(), 0);
    let mut step = |law: &mut Law<N, A>, demand: &JogDemand, seed: u64| {
        let now = law.step(demand, DT_S);
        let share = (now.q - before).abs().component_div(&(arm.speed_max() * DT_S)).amax();
        assert!(share <= 1.0 + 1e-9, "seed {seed}: a jump of {share} ticks");
        let change = (now.qd - qd).component_div(&(arm.acceleration_max() * DT_S)).amax();
        assert!(change <= 1.0 + 1e-9, "seed {seed}: {change} of the acceleration");
        assert!(arm.within_limits(&now.q), "seed {seed}: {}", now.q);
        assert!(now.trials <= 2 * TRIALS_MAX, "seed {seed}: {} trials", now.trials);
        (before, qd) = (now.q, now.qd);
        now.qd == JointVector::<N>::zeros()
    };
    let mut left = 24_000u64;
    while left > 0 {
        let (demand, jobs) = (random_demand(&mut dice), 8 + dice.roll(400));
        for _ in 0..jobs {
            step(&mut law, &demand, seed);
        }
        left = left.saturating_sub(jobs);
        if dice.roll(3) == 0 {
            let rests = (1..=400).find(|_| step(&mut law, &JogDemand::ZERO, seed)).unwrap();
            slowest = slowest.max(rests);
        }
    }
    assert!((law.q - at).amax() > 0.1, "seed {seed}: it moved");
    slowest
}

#[test]
fn a_minute_of_random_keys_never_makes_a_joint_jump_and_letting_go_stops_it() {
    let puma = Puma260::reference();
    let usual = crate::Config::default();
    let bent = JointVector::from([10.0, 40.0, -150.0, 20.0, 40.0, 10.0].map(f64::to_radians));
    for seed in 1..=4 {
        let slowest = [
            minute(&puma, &usual.rates(&puma, true), &bent, seed),
            minute(&six(), &usual.rates(&six(), true), &six_at(), seed),
            minute(&seven(), &usual.rates(&seven(), true), &seven_at(), seed),
        ];
        assert!(
            slowest.iter().all(|jobs| *jobs <= STOP_JOBS_MAX),
            "seed {seed}: {slowest:?} jobs to rest"
        );
        // The next session has other rates, and nothing jumps.
        minute(&six(), &rates(&six()), &six_at(), seed);
    }
}
