//! The hand's scenes through the whole stack in virtual time: what is held, what is told, what
//! turns; and that a run repeats bit for bit.

mod grasp_run;

use grasp_run::{GraspRun, digest_hex, scene};
use taktil_lab_scene::scene::Scene;
use taktil_lab_world::HandTruth;

/// A whole run, in which no fault is latched.
fn seen(scene: &Scene) -> GraspRun<9> {
    let run = GraspRun::new(scene, scene.duration.as_secs_f64());
    assert!(run.faults.is_empty(), "{:?}", run.faults);
    run
}

/// How far (mm) the object was from where it was at `from_s`, from then on.
fn moved_mm(seen: &GraspRun<9>, from_s: f64) -> f64 {
    let judged: Vec<&HandTruth<9>> =
        seen.truths.iter().filter(|truth| truth.t_ns as f64 >= 1e9 * from_s).collect();
    let from = judged[0].object_m;
    let way = |truth: &&HandTruth<9>| {
        let square = |i: usize| (truth.object_m[i] - from[i]) * (truth.object_m[i] - from[i]);
        1e3 * (0..3).map(square).sum::<f64>().sqrt()
    };
    judged.iter().map(way).fold(0.0, f64::max)
}

#[test]
fn a_ball_is_held_under_pushes_within_the_cones() {
    let seen = seen(&scene("hold.toml"));
    let last = seen.states.last().unwrap();
    assert_eq!((last.phase, last.beyond), (2, 0));
    assert!(moved_mm(&seen, 4.5) < 3.0, "{}", moved_mm(&seen, 4.5));
    assert!(seen.truths.last().unwrap().support_n == 0.0);
    let held = seen.states.iter().filter(|state| state.at_ns > 4_500_000_000);
    assert!(held.clone().count() > 1000 && held.clone().all(|state| state.beyond == 0));
    // What touch tells of the loads is what the contacts have.
    let (state, truth) = (last, seen.truths.last().unwrap());
    for f in 0..3 {
        assert!((state.load_n[f] - truth.normal_n[f]).abs() < 0.2, "{state:?} {truth:?}");
        assert!((state.tangential_n[f] - truth.tangential_n[f]).abs() < 0.3, "{state:?} {truth:?}");
    }
}

#[test]
fn a_push_beyond_the_cones_is_told_before_the_ball_slides() {
    let seen = seen(&scene("push-beyond.toml"));
    let told = seen.states.iter().find(|state| state.at_ns > 4_500_000_000 && state.beyond != 0);
    let told = told.expect("the margin is told").at_ns;
    let slid = seen.truths.iter().find(|truth| {
        truth.t_ns > 4_500_000_000 && truth.effort.iter().any(|effort| *effort > 1.0)
    });
    assert!(told < slid.expect("the ball slides").t_ns);
    assert!(moved_mm(&seen, 4.5) > 10.0);
}

#[test]
fn a_ball_is_turned_by_rolling_it_between_the_fingers() {
    let seen = seen(&scene("roll.toml"));
    let from = seen.truths.iter().find(|truth| truth.t_ns > 4_000_000_000).unwrap();
    let last = seen.truths.last().unwrap();
    // The ball's x axis turns about the vertical.
    let angle = |truth: &HandTruth<9>| libm::atan2(truth.object_axes[1], truth.object_axes[0]);
    let turned = (angle(last) - angle(from)).to_degrees();
    assert!((turned - 12.0).abs() < 2.0, "{turned}");
    assert!(moved_mm(&seen, 4.5) < 2.0, "{}", moved_mm(&seen, 4.5));
    assert_eq!(last.effort.map(|effort| effort > 1.0), [false; 3]);
}

#[test]
fn a_run_of_a_hand_repeats_bit_for_bit_and_another_seed_differs() {
    let digest = |seed| digest_hex("hold.toml", seed);
    assert_eq!(digest(1), digest(1));
    assert_ne!(digest(1), digest(2));
}
