//! The thesis's rolling experiment: strokes, spans, rolling without slip, for several seeds, pins
//! and slopes. Features are what the robot measured, positions what the simulator knows. All scenes
//! are the one scene file with some keys changed.

use taktil_lab_scene::scene::Scene;
use taktil_lab_world::WorldTruth;
use taktil_rtcore::Nanos;
use taktil_signal::{Features, State, defined};

use taktil_tests::bench::{SceneDraft, run};

/// Distance between tactels, mm.
const PITCH_MM: f64 = 25.4 / 16.0;
/// Rolling counts from when the force first reaches this share of its set point.
const PRESSED_SHARE: f64 = 0.9;

/// What is asked of a run.
struct Roll {
    strokes: u32,
    x_c: Span,
    /// True tool positions while rolling, mm: along x0 and z0.
    path_mm: Vec<(f64, f64)>,
    slip_m_s: f64,
    roll_rad: f64,
}

/// The smallest and the largest of some values.
#[derive(Clone, Copy)]
struct Span {
    low: f64,
    high: f64,
}

impl Span {
    fn of(values: impl Iterator<Item = f64>) -> Span {
        let none = Span { low: f64::INFINITY, high: f64::NEG_INFINITY };
        values.fold(none, |span, x| Span { low: span.low.min(x), high: span.high.max(x) })
    }

    fn width(self) -> f64 {
        self.high - self.low
    }
}

fn roll(scene: &Scene, seed: u64) -> Roll {
    let kept = run(scene, seed);
    let control = kept.last_control();
    assert_eq!((control.faults, control.refused), (0, 0), "seed {seed}");
    assert_eq!(control.state, State::TactileServo as u32, "seed {seed}");
    let set_point = scene.machine.tactile_servo.clone().unwrap_or_default().m0_counts;
    let features: Vec<(Nanos, Features)> = kept.of("tactile_servo.features");
    let pressed = |f: &Features| f.active != 0 && f.m0 >= PRESSED_SHARE * set_point;
    let since = features.iter().find(|(_, f)| pressed(f)).expect("the finger never pressed").0;
    let rolling =
        || features.iter().filter(|(t, f)| *t >= since && f.defined & defined::CENTROID != 0);
    let truth: Vec<(Nanos, WorldTruth)> = kept.of("world.truth");
    let truth: Vec<WorldTruth> =
        truth.into_iter().filter(|row| row.0 >= since).map(|r| r.1).collect();
    let slip = truth.iter().map(|t| t.finger_slip_m_s.max(t.table_slip_m_s)).fold(0.0, f64::max);
    Roll {
        strokes: features.last().unwrap().1.reversals,
        x_c: Span::of(rolling().map(|(_, f)| f.x_c)),
        path_mm: truth.iter().map(|t| (t.tool_m[0] * 1e3, t.tool_m[2] * 1e3)).collect(),
        slip_m_s: slip,
        roll_rad: Span::of(truth.iter().map(|t| t.pin_roll_rad)).width(),
    }
}

impl Roll {
    fn p_x_mm(&self) -> f64 {
        Span::of(self.path_mm.iter().map(|p| p.0)).width()
    }

    fn p_z_mm(&self) -> f64 {
        Span::of(self.path_mm.iter().map(|p| p.1)).width()
    }

    /// Slope of the straight line of least squares through the finger's path.
    #[expect(clippy::cast_precision_loss, reason = "counts of samples")]
    fn slope(&self) -> f64 {
        let n = self.path_mm.len() as f64;
        let mean = |part: fn(&(f64, f64)) -> f64| self.path_mm.iter().map(part).sum::<f64>() / n;
        let (x, z) = (mean(|p| p.0), mean(|p| p.1));
        let both: f64 = self.path_mm.iter().map(|p| (p.0 - x) * (p.1 - z)).sum();
        let square: f64 = self.path_mm.iter().map(|p| (p.0 - x) * (p.0 - x)).sum();
        both / square
    }

    /// The finger travels twice as far as the contact on it, and nothing slips.
    fn assert_rolls(&self, what: &str) {
        assert!(self.strokes >= 3, "{what}: {} strokes", self.strokes);
        let Span { low, high } = self.x_c;
        assert!(low > 2.0 && high < 15.0, "{what}: x_c from {low} to {high}");
        let p_x = self.p_x_mm();
        assert!((30.0..=40.0).contains(&p_x), "{what}: p_x spans {p_x} mm");
        let ratio = p_x / (self.x_c.width() * PITCH_MM);
        assert!((ratio - 2.0).abs() <= 0.1, "{what}: finger over contact travel is {ratio}");
        assert!(self.slip_m_s < 1e-3, "{what}: slips at {} m/s", self.slip_m_s);
    }
}

#[test]
fn the_pin_rolls_to_and_fro_with_every_seed() {
    let scene = SceneDraft::roll_pin().scene();
    assert_eq!(scene.duration, Nanos::from_secs(10));
    for seed in 1..=5 {
        roll(&scene, seed).assert_rolls(&format!("seed {seed}"));
    }
}

#[test]
fn thin_and_thick_pins_roll_by_their_radius_alone() {
    for radius_mm in [15.0, 35.0] {
        let scene = SceneDraft::roll_pin().set("world.pin.radius_mm", radius_mm).scene();
        let found = roll(&scene, 1);
        found.assert_rolls(&format!("radius {radius_mm} mm"));
        // Half the finger's travel is the pin's, which turns by it over its radius.
        let turned_mm = found.roll_rad * radius_mm * 2.0;
        let share = turned_mm / found.p_x_mm();
        assert!((share - 1.0).abs() < 0.05, "radius {radius_mm} mm: {share} of the travel turned");
    }
}

#[test]
fn a_finger_along_a_slope_climbs_with_it() {
    for tilt_deg in [4.0, 8.0] {
        let scene = SceneDraft::roll_pin().set("world.table.tilt_y_deg", tilt_deg).scene();
        let found = roll(&scene, 1);
        found.assert_rolls(&format!("{tilt_deg} deg"));
        let due = libm::tan(f64::to_radians(tilt_deg));
        let share = found.p_z_mm() / (due * found.p_x_mm());
        assert!((share - 1.0).abs() < 0.05, "{tilt_deg} deg: p_z spans {share} of slope x travel");
        let fitted = found.slope() / due;
        assert!((fitted - 1.0).abs() < 0.05, "{tilt_deg} deg: climbs by {fitted} of the slope");
    }
}

#[test]
fn a_level_finger_on_a_slope_climbs_with_half_the_angle() {
    // The pin rolls on the table's plane and under the finger's: the finger goes along the plane
    // that halves the angle between them.
    for tilt_deg in [4.0, 8.0] {
        let scene = SceneDraft::roll_pin()
            .set("world.table.tilt_y_deg", tilt_deg)
            .set("start.pitch_deg", 0.0)
            .scene();
        let found = roll(&scene, 1);
        found.assert_rolls(&format!("level over {tilt_deg} deg"));
        let share = found.slope() / libm::tan(f64::to_radians(tilt_deg / 2.0));
        assert!((share - 1.0).abs() < 0.1, "{tilt_deg} deg: climbs by {share} of half the angle");
    }
}

#[test]
fn a_level_table_keeps_the_finger_level() {
    // What a slope is measured against: without one the same fit finds nothing.
    let found = roll(&SceneDraft::roll_pin().scene(), 1);
    assert!(found.slope().abs() < 0.003, "climbs by {}", found.slope());
}
