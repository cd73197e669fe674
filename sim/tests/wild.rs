//! Draws scenes at random from everything that may be written, ends of the ranges included. Each is
//! refused with its place, or runs: no number is not finite, nothing pulls, no reading exceeds its
//! converter, and a restored snapshot goes on identically.

mod common;

use common::{at, seconds};
use glam::{DMat3, DVec3};
use taktil_hal::{Devices, Nanos, TactileFrame};
use taktil_sim::fidelity::{ArmModel, ContactModel, Integrator};
use taktil_sim::scene::{
    Axis, Defect, DefectKind, EdgeProfile, Electronics, Fault, FaultKind, Motion, MotionKind,
    ObjectConfig, ObjectKind, RubberConfig, ScanStamp, TactileConfig,
};
use taktil_sim::{
    Carriage, FloatingGuide, Invalid, Timing, Truth, World, WorldConfig, build, build_with_carriage,
};

/// Random numbers of a scene, by Steele, Lea and Flood's splittable generator (2014).
struct Draw(u64);

impl Draw {
    fn word(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn unit(&mut self) -> f64 {
        (self.word() >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn chance(&mut self, part: f64) -> bool {
        self.unit() < part
    }

    fn one<T: Copy>(&mut self, of: &[T]) -> T {
        of[(self.word() % of.len() as u64) as usize]
    }

    /// A number that is uniform in the range, and one time in eight an end of it.
    fn even(&mut self, low: f64, high: f64) -> f64 {
        match self.word() % 16 {
            0 => low,
            1 => high,
            _ => low + self.unit() * (high - low),
        }
    }

    /// A number that is uniform in the logarithm, with the same probability of the ends.
    fn size(&mut self, low: f64, high: f64) -> f64 {
        match self.word() % 16 {
            0 => low,
            1 => high,
            _ => low * libm::exp(self.unit() * libm::log(high / low)),
        }
    }
}

fn rubber(draw: &mut Draw) -> RubberConfig {
    RubberConfig {
        thickness_mm: draw.size(0.05, 100.0),
        youngs_mpa: draw.size(0.01, 1000.0),
        poisson: draw.even(0.0, 0.4999),
        relaxation_ms: if draw.chance(0.2) { 0.0 } else { draw.size(0.01, 100.0) },
    }
}

fn tactile(draw: &mut Draw) -> TactileConfig {
    let bits = draw.one(&[8, 10, 12, 16]);
    let full = f64::from((1_u32 << bits) - 1);
    let noise_counts = if draw.chance(0.3) { 0.0 } else { draw.even(0.0, 0.02 * full) };
    let mut tactile = TactileConfig {
        present: !draw.chance(0.1),
        bits,
        noise_counts,
        rest_counts: 5.0 * noise_counts + draw.even(0.0, 0.3 * full),
        full_scale_n: draw.size(1e-3, 1e3),
        row_us: if draw.chance(0.7) { 0.0 } else { draw.even(0.0, 300.0) },
        delay_scans: draw.one(&[0, 0, 0, 1, 30]),
        stamp: draw.one(&[ScanStamp::Scanned, ScanStamp::Delivered]),
        electronics: draw.one(&[
            Electronics::Ideal,
            Electronics::Response,
            Electronics::Memory,
            Electronics::Network,
        ]),
        gain_spread: draw.even(0.0, 0.3),
        exponent: draw.even(0.2, 2.0),
        hysteresis: draw.even(0.0, 1.0),
        creep_per_decade: draw.even(0.0, 1.0),
        full_scale_ohm: draw.size(1.0, 1e9),
        driver_ohm: draw.even(0.0, 1e6),
        ..TactileConfig::default()
    };
    tactile.threshold_n = draw.even(0.0, 0.99) * tactile.full_scale_n.min(10.0);
    if draw.chance(0.3) {
        let kind = draw.one(&[DefectKind::Dead, DefectKind::Stuck, DefectKind::Blinking]);
        let counts = if kind == DefectKind::Dead { 0 } else { full as u32 };
        let row = draw.chance(0.5).then_some(15);
        let column = draw.chance(0.5).then_some(0);
        tactile.defect = vec![Defect { kind, row, column, counts, period_s: 0.02, from_s: 0.1 }];
    }
    tactile
}

fn motion(draw: &mut Draw) -> Motion {
    let axis = draw.one(&[Axis::TiltX, Axis::TiltY, Axis::Pan, Axis::Slide, Axis::Height]);
    let kind =
        draw.one(&[MotionKind::Ramp, MotionKind::Step, MotionKind::Sine, MotionKind::Points]);
    let turns = axis.unit() == "deg";
    let (most, from_s) = (if turns { 10.0 } else { 5.0 }, draw.even(0.0, 0.3));
    let by = draw.even(-most, most);
    let some = |of: bool, value: f64| of.then_some(value);
    let mut motion = Motion { from_s, ..Motion::of(axis, kind) };
    match kind {
        MotionKind::Ramp => {
            motion.to_s = Some(from_s + draw.size(1e-3, 1.0));
            motion.rate_deg_s = some(turns, 4.0 * by);
            motion.rate_mm_s = some(!turns, 4.0 * by);
        }
        MotionKind::Step => (motion.by_deg, motion.by_mm) = (some(turns, by), some(!turns, by)),
        MotionKind::Sine => {
            motion.amplitude_deg = some(turns, 0.2 * by.abs());
            motion.amplitude_mm = some(!turns, 0.2 * by.abs());
            motion.frequency_hz = Some(draw.size(0.1, 40.0));
        }
        MotionKind::Points => {
            let points = vec![[0.0, 0.0], [0.05, by], [0.4, -by]];
            *if turns { &mut motion.points_deg } else { &mut motion.points_mm } = Some(points);
        }
    }
    motion
}

fn object(draw: &mut Draw) -> ObjectConfig {
    let kind = draw.one(&[ObjectKind::Sphere, ObjectKind::Edge, ObjectKind::Bar]);
    let mut object = ObjectConfig::of(kind);
    (object.x_mm, object.y_mm) = (draw.even(-8.0, 8.0), draw.even(-8.0, 8.0));
    (object.yaw_deg, object.friction) = (draw.even(-180.0, 180.0), Some(draw.even(0.0, 5.0)));
    (object.tilt_x_deg, object.tilt_y_deg) = (draw.even(-30.0, 30.0), draw.even(-30.0, 30.0));
    match kind {
        ObjectKind::Sphere => object.radius_mm = Some(draw.size(0.2, 2000.0)),
        ObjectKind::Bar => {
            object.width_mm = Some(draw.size(0.2, 25.0));
            object.length_mm = Some(draw.size(1.0, 600.0));
        }
        ObjectKind::Edge => {
            object.radius_mm = Some(draw.size(0.2, 20.0));
            object.length_mm = Some(draw.size(1.0, 600.0));
            let profile = draw.one(&[EdgeProfile::Straight, EdgeProfile::Arc, EdgeProfile::Corner]);
            object.profile = Some(profile);
            let way = draw.one(&[-1.0, 1.0]);
            object.arc_radius_mm =
                (profile == EdgeProfile::Arc).then(|| way * draw.size(3.0 * object.radius(), 2e3));
            object.corner_deg = (profile == EdgeProfile::Corner).then(|| draw.even(-120.0, 120.0));
        }
    }
    object
}

fn faults(draw: &mut Draw) -> Vec<Fault> {
    use FaultKind::{DeadEncoder, DropFrames, EmergencyStop, FrozenWrist, PowerLoss};
    let mut all = Vec::new();
    while draw.chance(0.3) && all.len() < 4 {
        let kind = draw.one(&[DropFrames, DeadEncoder, PowerLoss, EmergencyStop, FrozenWrist]);
        let fraction = (kind == DropFrames).then(|| draw.unit());
        let joint = (kind == DeadEncoder).then(|| draw.one(&[1, 6]));
        let (at_s, for_s) = (draw.even(0.0, 0.5), Some(draw.size(1e-4, 1.0)));
        all.push(Fault { for_s, joint, fraction, ..Fault::at(kind, at_s) });
    }
    all
}

/// A random scene.
fn scene(draw: &mut Draw) -> WorldConfig {
    let mut c = WorldConfig::default();
    c.fidelity.arm = draw.one(&[ArmModel::Rigid, ArmModel::RigidMotors, ArmModel::Compliant]);
    c.fidelity.contact = draw.one(&[ContactModel::Line, ContactModel::Layer2d]);
    if draw.chance(0.15) {
        c.fidelity.contact = ContactModel::Layer3d;
    }
    if draw.chance(0.1) {
        c.fidelity.integrator = draw.one(&[Integrator::Euler, Integrator::Implicit]);
        c.substep_us = 80.0;
    } else {
        c.substep_us = draw.size(200.0, 1e5);
    }
    c.finger.friction = draw.even(0.0, 5.0);
    c.table.friction = draw.even(0.0, 5.0);
    if draw.chance(0.7) {
        c.finger.rubber = rubber(draw);
        c.table.rubber = rubber(draw);
    }
    let p = &mut c.pin;
    p.present = !draw.chance(0.3);
    (p.radius_mm, p.length_mm) = (draw.size(1.0, 500.0), draw.size(1.0, 1000.0));
    (p.mass_kg, p.yaw_deg) = (draw.size(1e-3, 100.0), draw.even(-70.0, 70.0));
    (p.x_mm, p.y_mm) = (draw.even(-10.0, 10.0), draw.even(-10.0, 10.0));
    (p.fixture, p.fixture_release_n) = (draw.chance(0.5), draw.size(1e-3, 1e3));
    p.rolling_resistance_mm = draw.one(&[0.0, 0.1, 1.0]);
    if draw.chance(0.3) {
        let tilts = (draw.even(-60.0, 60.0), draw.even(-60.0, 60.0));
        (c.table.tilt_x_deg, c.table.tilt_y_deg) = tilts;
        c.table.pan_deg = draw.even(-180.0, 180.0);
    }
    while draw.chance(0.4) && c.table.motion.len() < 4 {
        c.table.motion.push(motion(draw));
    }
    while draw.chance(if c.pin.present { 0.2 } else { 0.7 }) && c.object.len() < 4 {
        c.object.push(object(draw));
    }
    if c.pin.present && draw.chance(0.2) {
        c.opposed.present = true;
        (c.opposed.x_mm, c.opposed.y_mm) = (c.pin.x_mm, c.pin.y_mm);
        c.opposed.yaw_deg = c.pin.yaw_deg + draw.even(-70.0, 70.0);
        c.opposed.rubber = rubber(draw);
        c.opposed.friction = draw.even(0.0, 5.0);
        c.opposed.tactile = tactile(draw);
    }
    c.tactile = tactile(draw);
    c.wrist.noise_codes = draw.even(0.0, 500.0);
    c.wrist.present = !draw.chance(0.2);
    c.fault = faults(draw);
    c
}

/// A finger that comes down at an angle, slowly or at a metre per second, moves sideways and
/// leaves; or floats down under a load.
fn carriage(draw: &mut Draw, config: &WorldConfig) -> Carriage {
    let nominal = DMat3::from_cols(-DVec3::X, DVec3::Y, -DVec3::Z);
    let lean = if draw.chance(0.3) { 0.3 } else { 0.01 };
    let axes = nominal
        * DMat3::from_rotation_x(draw.even(-lean, lean))
        * DMat3::from_rotation_y(draw.even(-lean, lean))
        * DMat3::from_rotation_z(draw.even(-1.0, 1.0));
    let top = 1e-3 * (config.table_height_mm() + 2.0 * config.pin.radius_mm);
    let at = |x_mm: f64, z: f64| DVec3::new(0.325 + 1e-3 * x_mm, -0.127, top + z);
    let deep = 1e-3 * draw.size(0.01, 0.5) * config.finger.rubber.thickness_mm;
    let by = draw.even(-30.0, 30.0);
    let (down, aside) = (draw.size(0.002, 0.2), draw.size(0.02, 0.3));
    let knots = vec![
        (0.02, at(0.0, 0.002)),
        (0.02 + down, at(0.0, -deep)),
        (0.02 + down + aside, at(by, -deep)),
        (0.05 + down + aside, at(by, 0.005)),
    ];
    let float = draw.chance(0.4).then(|| FloatingGuide {
        mass_kg: draw.size(1e-3, 10.0),
        load_n: draw.even(0.0, 50.0),
        damping_n_s_m: draw.even(0.0, 500.0),
    });
    Carriage { axes, knots, float }
}

fn bench(seed: u64) -> (WorldConfig, Result<(World, Devices), Invalid>) {
    let draw = &mut Draw(seed);
    let mut config = scene(draw);
    let timing = Timing {
        scan_period: Nanos::from_micros(draw.one(&[1_000, 5_000, 7_001, 20_000])),
        ..Timing::default()
    };
    if draw.chance(0.7) {
        let carriage = carriage(draw, &config);
        let built = build_with_carriage(&config, &timing, seed, carriage);
        return (config, built);
    }
    if draw.chance(0.3) {
        config.fidelity.arm = ArmModel::Kinematic;
        let [a, b, c, d, e, f] = common::lowered(draw.even(14.0, 16.0));
        config.arm.trajectory_deg = vec![[0.3, a, b, c, d, e, f]];
    }
    let built = build(&config, &timing, seed);
    (config, built)
}

fn sound(seed: u64, truth: &Truth) {
    let vectors = [truth.pin, truth.pin_velocity, truth.pin_axis, truth.tool, truth.tool_velocity];
    assert!(vectors.iter().all(|v| v.is_finite()), "scene {seed}: {truth:?}");
    let wrench = truth.tool_wrench.iter().chain(truth.q.iter()).chain(truth.qd.iter());
    assert!(wrench.copied().all(f64::is_finite), "scene {seed}: {truth:?}");
    let pulls = truth.finger_normal_n < 0.0 || truth.table_normal_n < 0.0;
    assert!(!pulls, "scene {seed}: {truth:?}");
    assert!((truth.pin_axis.length() - 1.0).abs() < 1e-9, "scene {seed}: {truth:?}");
    // A finger on rails has no limit to its force and shoots a pin of a few grams out from a slope;
    // a diverging iteration is a thousand times faster still.
    assert!(truth.pin_velocity.length() < 3000.0, "scene {seed} explodes: {truth:?}");
}

/// Checks that the readings of a scan are within the converter's range.
fn read(seed: u64, devices: &mut Devices, now: Nanos, full: u16) {
    let mut frame = TactileFrame::new(16, 16);
    let _ = devices.tactile.get_mut("tactile").unwrap().sample(now, &mut frame);
    assert!(frame.values.iter().all(|value| *value <= full), "scene {seed} at {now}");
}

/// Runs a scene and checks it; returns whether the scene could be built.
fn lives(seed: u64) -> bool {
    let (config, built) = bench(seed);
    let (mut world, mut devices) = match built {
        Ok(built) => built,
        Err(bad) => {
            assert!(!bad.place.is_empty() && !bad.remedy.is_empty(), "scene {seed}: {bad}");
            return false;
        }
    };
    let mut snapshot = None;
    for i in 1..=60_u32 {
        sound(seed, &at(&mut world, 0.01 * f64::from(i)));
        read(seed, &mut devices, world.now(), config.tactile.full_counts());
        if i == 25 {
            snapshot = Some(world.snapshot());
        }
    }
    let work = world.statistics();
    if !config.tactile.present && !config.opposed.present {
        assert_eq!((work.tactile_images, work.tactile_scans), (0, 0), "scene {seed}");
    }
    if !config.pin.present && config.object.is_empty() {
        assert_eq!((work.contact_evaluations, work.tactile_images), (0, 0), "scene {seed}");
    }
    let (mut again, _halves) = snapshot.unwrap().restore();
    for i in 26..=60_u32 {
        again.advance(seconds(0.01 * f64::from(i)));
    }
    assert_eq!(again.state_hash(), world.state_hash(), "scene {seed} goes another way");
    true
}

/// Seeds of scenes that once failed: an iteration diverged, the damping of a light guide was too
/// large for an explicit step, and grams under stiff rubber with 0.1 s of relaxation counted as
/// converged by the matrix of a contact that they had left.
const REGRESSION_SEEDS: [u64; 3] = [86, 91, 823];

#[test]
fn drawn_scenes_are_refused_with_their_place_or_run_soundly() {
    let ran = (0..24).filter(|seed| lives(*seed)).count();
    assert!(ran > 12, "{ran}");
}

#[test]
fn scenes_that_once_diverged_stay_finite() {
    assert!(REGRESSION_SEEDS.into_iter().all(lives));
}

#[test]
#[ignore = "minutes: cargo test --release -p taktil-sim --test wild -- --ignored"]
fn two_thousand_drawn_scenes() {
    let (mut ran, mut bad) = (0, Vec::new());
    for seed in 0..2000 {
        match std::panic::catch_unwind(|| lives(seed)) {
            Ok(lived) => ran += u32::from(lived),
            Err(_) => bad.push(seed),
        }
    }
    assert_eq!(bad, [0_u64; 0]);
    assert!(ran > 1000, "{ran}");
}
