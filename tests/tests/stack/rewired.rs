//! A robot that is wired otherwise than the arm's description says rolls the pin by its machine
//! file alone, and does not if the file is wrong.

use std::collections::BTreeMap;

use taktil_lab_scene::scene::Scene;
use taktil_lab_world::WorldTruth;
use taktil_rtcore::Nanos;
use taktil_signal::{Features, State, defined};
use taktil_tests::bench::{RecordedRun, SceneDraft, run};

/// Difference of the finger's place from that of the plain robot while it rolls: counts and codes
/// have other steps, and strokes turn round a few frames sooner or later (mm).
const PLACE_TOLERANCE_MM: f64 = 0.3;
/// The same for the contact's place on the array (tactels), and for the sum in parts of it.
const CENTROID_TOLERANCE_TACTELS: f64 = 0.5;
const SUM_TOLERANCE: f64 = 0.1;

fn rolls(run: &RecordedRun) -> bool {
    let control = run.last_control();
    let features: Vec<(Nanos, Features)> = run.of("tactile_servo.features");
    let strokes = features.last().map_or(0, |(_, f)| f.reversals);
    control.faults == 0 && control.state == State::TactileServo as u32 && strokes >= 3
}

fn ended(scene: &Scene) -> RecordedRun {
    run(scene, 1)
}

/// Root mean square of the differences of a quantity at the same instants.
#[expect(clippy::cast_precision_loss, reason = "counts of samples")]
fn difference(one: &[(Nanos, f64)], other: &[(Nanos, f64)]) -> f64 {
    let other: BTreeMap<Nanos, f64> = other.iter().copied().collect();
    let pairs = one.iter().filter_map(|(at, a)| Some((*a, *other.get(at)?)));
    let squares: Vec<f64> = pairs.map(|(a, b)| (a - b) * (a - b)).collect();
    assert!(squares.len() > 100);
    libm::sqrt(squares.iter().sum::<f64>() / squares.len() as f64)
}

fn features(run: &RecordedRun, value: fn(&Features) -> f64) -> Vec<(Nanos, f64)> {
    let all: Vec<(Nanos, Features)> = run.of("tactile_servo.features");
    let felt = |f: &Features| f.active != 0 && f.defined & defined::CENTROID != 0;
    all.iter().filter(|(_, f)| felt(f)).map(|(at, f)| (*at, value(f))).collect()
}

fn places_mm(run: &RecordedRun, axis: usize) -> Vec<(Nanos, f64)> {
    let all: Vec<(Nanos, WorldTruth)> = run.of("world.truth");
    all.iter().map(|(at, truth)| (*at, 1e3 * truth.tool_m[axis])).collect()
}

#[test]
fn a_rewired_robot_rolls_the_pin_as_the_plain_one_does() {
    let (plain, rewired) =
        (ended(&SceneDraft::roll_pin().scene()), ended(&SceneDraft::of("rewired.toml").scene()));
    assert!(rolls(&plain) && rolls(&rewired));
    for axis in 0..3 {
        let off_mm = difference(&places_mm(&plain, axis), &places_mm(&rewired, axis));
        assert!(off_mm < PLACE_TOLERANCE_MM, "axis {axis}: {off_mm} mm");
    }
    let x_c = |run| features(run, |f| f.x_c);
    let off = difference(&x_c(&plain), &x_c(&rewired));
    assert!(off < CENTROID_TOLERANCE_TACTELS, "centroid: {off} tactels");
    let m0 = |run| features(run, |f| f.m0);
    let sums = m0(&plain);
    let mean = sums.iter().map(|(_, sum)| sum).sum::<f64>() / sums.len() as f64;
    let off = difference(&sums, &m0(&rewired)) / mean;
    assert!(off < SUM_TOLERANCE, "sum: {off}");
}

#[test]
fn a_machine_file_with_a_wrong_line_does_not_roll() {
    let list = |numbers: [f64; 6]| toml::Value::from(numbers.to_vec());
    for (key, wrong) in [
        ("motor_sign", [1.0; 6]),
        // Joints 1 and 4 hardly move on this path: their exchange alone would go unnoticed.
        ("encoder_channel", [3.0, 2.0, 1.0, 0.0, 4.0, 5.0]),
        ("gear", [46.72, 37.5, 42.9867, 50.0, 39.3846, 31.7692]),
        ("counts_per_rev", [1024.0, 1000.0, 1000.0, 800.0, 1024.0, 1000.0]),
    ] {
        let scene =
            SceneDraft::of("rewired.toml").set(&format!("robot.joints.{key}"), list(wrong)).scene();
        assert!(!rolls(&ended(&scene)), "{key}");
    }
}
