//! Hands on an arm through the whole stack in virtual time: what is lifted, held and set down, what
//! is out of the arm's reach, and that a run repeats bit for bit.

mod grasp_run;

use grasp_run::{GraspRun, digest_hex, scene};
use taktil_lab_scene::assembly::Assembly;
use taktil_lab_world::HandTruth;
use taktil_rtcore::{FaultCode, FaultSet};

/// How far a truth's object is from where it was in another one (mm).
fn moved_mm<const N: usize>(from: &HandTruth<N>, to: &HandTruth<N>) -> [f64; 3] {
    core::array::from_fn(|i| 1e3 * (to.object_m[i] - from.object_m[i]))
}

#[test]
fn an_arm_lifts_a_ball_and_holds_it_under_a_push_within_the_cones() {
    let seen = GraspRun::<15>::new(&scene("lift.toml"), 9.4);
    let (first, last) = (&seen.truths[0], seen.truths.last().unwrap());
    assert!(seen.faults.is_empty(), "{:?}", seen.faults);
    let [x, y, z] = moved_mm(first, last);
    // A push of 1 N moves it in the hand.
    assert!((z - 120.0).abs() < 0.5 && x.abs() < 1.0 && y.abs() < 1.0, "{x} {y} {z}");
    assert!(last.support_n == 0.0 && last.push_n[0] > 0.9);
    let held = seen.states.iter().filter(|state| state.at_ns > 3_500_000_000);
    assert!(held.clone().count() > 2000 && held.clone().all(|state| state.beyond == 0));
    assert!(held.clone().all(|state| state.least_margin_n > 0.5));
    let state = seen.states.last().unwrap();
    for f in 0..3 {
        assert!((state.load_n[f] - last.normal_n[f]).abs() < 0.3, "{state:?} {last:?}");
        assert!((state.tangential_n[f] - last.tangential_n[f]).abs() < 0.4, "{state:?} {last:?}");
    }
}

#[test]
fn balls_of_any_mass_are_lifted_to_the_end_of_the_way_in_spite_of_friction_and_weight() {
    // Until shortly before the first push; without the correction the arm stops short.
    for (correction_per_s, mass_kg) in
        [(4.0, 0.02), (4.0, 0.083), (4.0, 0.171), (4.0, 0.3), (0.0, 0.083), (0.0, 0.3)]
    {
        let mut scene = scene("lift.toml");
        scene.world.hand.mass_kg = mass_kg;
        scene.machine.grasp.as_mut().unwrap().lift_correction_per_s = correction_per_s;
        let seen = GraspRun::<15>::new(&scene, 8.45);
        assert!(seen.faults.is_empty(), "{:?}", seen.faults);
        let off_mm = moved_mm(&seen.truths[0], seen.truths.last().unwrap());
        let error_mm = libm::hypot(libm::hypot(off_mm[0], off_mm[1]), off_mm[2] - 120.0);
        match correction_per_s > 0.0 {
            true => assert!(error_mm < 0.2, "{mass_kg} kg: {off_mm:?}"),
            false => assert!(error_mm > 0.7, "{mass_kg} kg: {off_mm:?}"),
        }
        // It stands: nothing hunts.
        let fastest = seen.truths.iter().filter(|truth| truth.t_ns > 8_200_000_000).map(|truth| {
            truth.object_m_s.iter().fold(0.0_f64, |most, speed| most.max(speed.abs()))
        });
        let fastest_m_s = fastest.fold(0.0, f64::max);
        assert!(fastest_m_s < 1e-3, "{mass_kg} kg: {fastest_m_s}");
    }
}

#[test]
fn a_cylinder_is_carried_tilted_and_set_down_where_it_stood() {
    let seen = GraspRun::<15>::new(&scene("set-down.toml"), 13.0);
    let (first, last) = (&seen.truths[0], seen.truths.last().unwrap());
    assert!(seen.faults.is_empty(), "{:?}", seen.faults);
    let tilt = |truth: &HandTruth<15>| libm::acos(truth.object_axes[8].min(1.0)).to_degrees();
    let most = seen.truths.iter().map(tilt).fold(0.0, f64::max);
    let highest = seen.truths.iter().map(|truth| moved_mm(first, truth)[2]).fold(0.0, f64::max);
    assert!((most - 20.0).abs() < 1.0 && (highest - 86.0).abs() < 4.0, "{most} {highest}");
    let left = moved_mm(first, last);
    assert!(left.iter().all(|mm| mm.abs() < 1.0) && tilt(last) < 0.1, "{left:?}");
    assert!((last.support_n - 0.15 * 9.81).abs() < 1e-3 && last.normal_n == [0.0; 3]);
    assert_eq!(seen.states.last().unwrap().phase, 3);
}

#[test]
fn a_ball_on_an_arm_is_turned_by_rolling_it_between_the_fingers() {
    let mut scene = scene("lift.toml");
    let grasp = scene.machine.grasp.as_mut().unwrap();
    (grasp.plan_after_s, grasp.turn_deg, grasp.turn_deg_s) = (4.0, [0.0, 0.0, 12.0], 8.0);
    let seen = GraspRun::<15>::new(&scene, 8.5);
    assert!(seen.faults.is_empty(), "{:?}", seen.faults);
    // The arm has lifted it by then.
    let lifted = seen.truths.iter().find(|truth| truth.t_ns > 7_200_000_000).unwrap();
    let last = seen.truths.last().unwrap();
    let angle = |truth: &HandTruth<15>| libm::atan2(truth.object_axes[1], truth.object_axes[0]);
    let turned = (angle(last) - angle(&seen.truths[0])).to_degrees();
    let moved = moved_mm(lifted, last);
    assert!(
        (turned - 12.0).abs() < 2.0 && moved.iter().all(|mm| mm.abs() < 2.0),
        "{turned} {moved:?}"
    );
    assert_eq!(last.effort.map(|effort| effort > 1.0), [false; 3]);
}

#[test]
fn an_arm_with_two_fingers_lifts_a_box() {
    let seen = GraspRun::<12>::new(&scene("lift-box.toml"), 8.4);
    let (first, last) = (&seen.truths[0], seen.truths.last().unwrap());
    assert!(seen.faults.is_empty(), "{:?}", seen.faults);
    let [x, y, z] = moved_mm(first, last);
    assert!((z - 100.0).abs() < 0.5 && x.abs() < 1.0 && y.abs() < 1.0, "{x} {y} {z}");
    assert!(last.support_n == 0.0 && last.object_axes[8] > 0.999, "{last:?}");
}

#[test]
fn a_lift_out_of_the_arms_reach_is_a_fault_and_the_ball_is_not_lost() {
    let mut scene = scene("lift.toml");
    let grasp = scene.machine.grasp.as_mut().unwrap();
    (grasp.lift_mm, grasp.lift_mm_s, grasp.lift_after_s) = ([-900.0, 0.0, 200.0], 500.0, 1.0);
    let seen = GraspRun::<15>::new(&scene, 7.0);
    let mut refused = FaultSet::default();
    refused.insert(FaultCode::Unreachable);
    assert_eq!(seen.faults, refused);
    let last = seen.truths.last().unwrap();
    assert!(last.normal_n.iter().all(|normal| *normal > 1.0), "{last:?}");
}

#[test]
fn a_palm_that_stands_is_not_lifted() {
    let mut scene = scene("hold.toml");
    let mut grasp = scene.machine.grasp.clone().unwrap_or_default();
    grasp.lift_mm[2] = 10.0;
    scene.machine.grasp = Some(grasp);
    let bad = Assembly::new(&scene).build().err().unwrap();
    assert!(bad.what.contains("stands still"), "{bad:?}");
}

#[test]
fn a_run_of_a_hand_on_an_arm_repeats_bit_for_bit_and_another_seed_differs() {
    let digest = |seed| digest_hex("lift.toml", seed);
    assert_eq!(digest(1), digest(1));
    assert_ne!(digest(1), digest(2));
}
