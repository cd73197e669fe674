//! Arrays of other sizes than the thesis's: scenes that roll the pin by them, told in newtons and
//! millimetres, and the smallest and largest arrays.

use taktil_lab_experiment::evaluated_run;
use taktil_lab_scene::scene::Scene;
use taktil_rtcore::Nanos;
use taktil_signal::{Features, TactileImage, defined};
use taktil_tests::bench::{SceneDraft, run};

/// The load that the scenes ask for (N).
const LOAD_N: f64 = 14.65;
/// Largest root mean square of the force's error over the load. The scenes have 0.011, 0.009 and
/// 0.016 over five seeds.
const FORCE_ERROR_SHARE_MAX: f64 = 0.03;

/// Runs a scene of the repository and judges it by the simulator's truth.
fn assert_holds(name: &str, seed: u64) {
    let scene = SceneDraft::of(name).scene();
    let verdict = evaluated_run(&scene, seed, false).unwrap();
    let figures = &verdict.figures;
    assert!(figures.faults.is_empty(), "{name} {seed}: {:?}", figures.faults);
    assert_eq!(figures.contact_lost, 0, "{name} {seed}");
    assert!(figures.strokes >= 3, "{name} {seed}: {} strokes", figures.strokes);
    let force = verdict.force_n.rms().unwrap() / LOAD_N;
    assert!(force < FORCE_ERROR_SHARE_MAX, "{name} {seed}: {force} of the load");
    let (yaw, tilt) = (verdict.yaw_deg.peak().unwrap(), verdict.tilt_deg.peak().unwrap());
    assert!(yaw < 1.0 && tilt < 0.1, "{name} {seed}: yaw {yaw} deg, tilt {tilt} deg");
}

#[test]
fn a_pad_of_16_by_32_tactels_at_100_frames_a_second_holds_the_contact() {
    [1, 2].into_iter().for_each(|seed| assert_holds("flexitac-16x32.toml", seed));
}

#[test]
fn a_pad_of_12_by_32_tactels_at_100_frames_a_second_holds_the_contact() {
    [1, 2].into_iter().for_each(|seed| assert_holds("flexitac-12x32.toml", seed));
}

#[test]
fn a_pad_of_5_mm_pitch_holds_the_contact() {
    [1, 2].into_iter().for_each(|seed| assert_holds("coarse-pad.toml", seed));
}

/// The rolling scene with an array of these sizes, which the servo knows or does not.
fn with_array(rows: i64, cols: i64, pitch_mm: [f64; 2], known: bool) -> Scene {
    let mut draft = SceneDraft::of("roll-pin.toml").set("duration_s", 4.0);
    let sections = ["world.tactile", "robot.tactile_servo.array"];
    for section in &sections[..1 + usize::from(known)] {
        draft = draft
            .set(&format!("{section}.rows"), rows)
            .set(&format!("{section}.cols"), cols)
            .set(&format!("{section}.pitch_x_mm"), pitch_mm[0])
            .set(&format!("{section}.pitch_y_mm"), pitch_mm[1]);
    }
    // A tactel that bears less of the load reads as much of its converter.
    let full_n = 4.0 * pitch_mm[0] * pitch_mm[1] / (1.5875 * 1.5875);
    draft
        .set("world.tactile.full_scale_n", full_n)
        .set("robot.tactile_servo.model.counts_per_n", 4095.0 / full_n)
        .set("robot.tactile_servo.m0_n", LOAD_N)
        .set("robot.tactile_servo.law", "model")
        .scene()
}

#[test]
fn the_smallest_and_the_largest_arrays_run_without_fault_and_press() {
    for (rows, cols, pitch_mm) in
        [(1, 64, [1.0, 10.0]), (64, 64, [0.5, 0.5]), (64, 8, [4.0, 0.5]), (16, 16, [1.5, 3.0])]
    {
        let scene = with_array(rows, cols, pitch_mm, true);
        let kept = run(&scene, 1);
        let control = kept.last_control();
        assert_eq!((control.faults, control.refused), (0, 0), "{rows} x {cols}");
        let images: Vec<(Nanos, TactileImage)> = kept.of("tactile_scan.image");
        let image = &images.last().expect("images").1;
        assert_eq!((i64::from(image.rows), i64::from(image.cols)), (rows, cols));
        let features: Vec<(Nanos, Features)> = kept.of("tactile_servo.features");
        let last = features.last().expect("features").1;
        assert!(last.defined & defined::CONTACT != 0, "{rows} x {cols}: {last:?}");
        let wanted = scene.machine.tactile_servo.clone().unwrap().m0_counts;
        assert!((last.m0 / wanted - 1.0).abs() < 0.3, "{rows} x {cols}: {last:?}");
    }
}

#[test]
fn an_array_of_another_size_than_the_servo_s_moves_nothing() {
    for (rows, cols) in [(1, 1), (12, 32), (64, 64)] {
        let kept = run(&with_array(rows, cols, [5.0, 5.0], false), 1);
        let control = kept.last_control();
        assert_eq!((control.faults, control.refused), (0, 0), "{rows} x {cols}");
        let features: Vec<(Nanos, Features)> = kept.of("tactile_servo.features");
        assert!(!features.is_empty(), "{rows} x {cols}");
        let blind = features
            .iter()
            .all(|(_, seen)| seen.defined == defined::CONTACT_UNCERTAIN && seen.m0 == 0.0);
        assert!(blind, "{rows} x {cols}");
    }
}

#[test]
fn an_opposed_array_of_other_rows_and_pitches_is_gone_by_too() {
    let mut draft = SceneDraft::of("two-fingers.toml");
    for section in ["world.opposed.tactile", "robot.tactile_servo.opposed.array"] {
        draft = draft
            .set(&format!("{section}.rows"), 20)
            .set(&format!("{section}.cols"), 24)
            .set(&format!("{section}.pitch_x_mm"), 1.2)
            .set(&format!("{section}.pitch_y_mm"), 1.4);
    }
    let verdict = evaluated_run(&draft.scene(), 1, false).unwrap();
    assert!(verdict.figures.faults.is_empty() && verdict.figures.contact_lost == 0);
    let force = verdict.force_n.rms().unwrap() / LOAD_N;
    let yaw = verdict.yaw_deg.peak().unwrap();
    assert!(force < FORCE_ERROR_SHARE_MAX && yaw < 1.0, "{force} of the load, {yaw} deg");
}
