//! Tests the law with a geometric model: a rigid pin on a rigid, level table under the arm's
//! finger. Each tactel reads its depth inside the pin; the finger is compliant along its own z as
//! the position servo is; a pin in contact rolls, so it moves half as far as the finger. There are
//! no masses and no time constants: the tests check signs, frames and the ratio of rolling, not
//! stability.

use glam::DVec3;
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::spatial::rotation_about;
use taktil_mechanics::{Joints, Pose};
use taktil_signal::TactileImage;
use taktil_tasks_tactile_servo::Config;
use taktil_tasks_tactile_servo::config::array::Array;
use taktil_tasks_tactile_servo::heading::Heading;
use taktil_tasks_tactile_servo::joint_integrator::joint_step;
use taktil_tasks_tactile_servo::law::thesis::ThesisLaw;
use taktil_tasks_tactile_servo::law::tool_motion;
use taktil_tasks_tactile_servo::perception::{TouchFeatures, touch_features};

const RADIUS_M: f64 = 0.023;
const PITCH_M: f64 = 1.5875e-3;
/// Counts of a tactel per metre of depth: 15 000 in all at about 0.1 mm.
const COUNTS_PER_M: f64 = 5.0e6;
/// Counts per metre that the finger gives way.
const FINGER_COUNTS_PER_M: f64 = 14.0e6;

struct Pin {
    centre: DVec3,
    axis: DVec3,
}

fn depth_m(pin: &Pin, at: DVec3) -> f64 {
    let from = at - pin.centre;
    RADIUS_M - (from - pin.axis * from.dot(pin.axis)).length()
}

fn image(pin: &Pin, finger: &Pose) -> TactileImage {
    let mut image =
        TactileImage { valid: vec![1; 256].into(), baseline_ready: 1, ..TactileImage::new(16, 16) };
    for row in 0..16_u8 {
        for col in 0..16_u8 {
            let x = (f64::from(col) - 7.5) * PITCH_M;
            let y = (f64::from(row) - 7.5) * PITCH_M;
            let counts = COUNTS_PER_M * depth_m(pin, finger.apply(DVec3::new(x, y, 0.0)));
            image.counts[usize::from(row) * 16 + usize::from(col)] = counts.max(0.0) as f32;
        }
    }
    image
}

fn config() -> Config {
    Config { threshold_counts: Some(0.0), ..Config::default() }
}

fn features_at(pin: &Pin, finger: &Pose) -> TouchFeatures {
    touch_features(&image(pin, finger), &Array::default(), 0.0, 500.0)
}

/// Where the finger comes to rest when `wanted` lies inside the pin.
fn give_way(pin: &Pin, wanted: &Pose) -> Pose {
    let back = |s: f64| {
        let translation = wanted.translation - wanted.rotation.z_axis * s;
        Pose { translation, ..*wanted }
    };
    let (mut low, mut high) = (0.0, 0.02);
    for _ in 0..40 {
        let s = 0.5 * (low + high);
        if touch_features(&image(pin, &back(s)), &Array::default(), 0.0, 0.0).m0
            > FINGER_COUNTS_PER_M * s
        {
            low = s;
        } else {
            high = s;
        }
    }
    back(0.5 * (low + high))
}

fn rolling() -> Joints {
    Joints::from([0.0, 40.2, -153.4, -180.0, 66.8, 180.0].map(f64::to_radians))
}

/// A pin across the finger's x, touched in the middle, its surface `depth` inside the face.
fn pin_under(finger: &Pose, depth: f64) -> Pin {
    let centre = finger.translation + finger.rotation.z_axis * (RADIUS_M - depth);
    Pin { centre, axis: finger.rotation.y_axis }
}

/// The finger after a displacement (mm, mm, mrad, mrad) in its own frame.
fn moved(finger: &Pose, displacement: &[f64; 4]) -> Pose {
    let [x, z, theta_x, theta_z] = displacement.map(|d| d * 1e-3);
    let turn = rotation_about(DVec3::X, theta_x) * rotation_about(DVec3::Z, theta_z);
    finger.compose(&Pose::new(turn, DVec3::new(x, 0.0, z)))
}

/// The finger after component `i` alone of the displacement for `before`, `times` at once.
fn pushed(finger: &Pose, before: &TouchFeatures, x_c_desired: f64, i: usize, times: f64) -> Pose {
    let law = ThesisLaw::new(&config());
    let all = law.displacement(before, x_c_desired);
    let mut one = [0.0; 4];
    one[i] = times * all[i];
    assert!(all[i].abs() > 0.0, "component {i} answers: {all:?}");
    moved(finger, &one)
}

#[test]
fn rolling_the_sensor_by_plus_x_lowers_x_c_as_the_law_assumes() {
    let finger = Puma260::reference().tool_pose(&rolling());
    let mut pin = pin_under(&finger, 0.1e-3);
    let before = features_at(&pin, &finger);
    assert!((before.x_c.unwrap() - 8.5).abs() < 1e-9);
    for desired in [2.0, 15.0] {
        let after = pushed(&finger, &before, desired, 0, 100.0);
        let centre = pin.centre;
        pin.centre += 0.5 * (after.translation - finger.translation);
        let x_c = features_at(&pin, &after).x_c.unwrap();
        pin.centre = centre;
        assert!((x_c - desired).abs() < (8.5 - desired).abs() - 0.5, "{desired}: {x_c}");
    }
}

#[test]
fn the_press_brings_m0_nearer_from_either_side() {
    let finger = Puma260::reference().tool_pose(&rolling());
    for depth in [0.08e-3, 0.15e-3] {
        let pin = pin_under(&finger, depth);
        let before = features_at(&pin, &finger);
        let after = pushed(&finger, &before, 8.5, 1, 0.1);
        let m0 = features_at(&pin, &after).m0;
        let error = |m0: f64| (m0 - 15_000.0_f64).abs();
        assert!(error(m0) < error(before.m0), "{} to {m0}", before.m0);
    }
}

#[test]
fn the_tilt_evens_out_the_load_along_y() {
    let finger = Puma260::reference().tool_pose(&rolling());
    for tilt_mrad in [-4.0, 4.0] {
        let pin = pin_under(&finger, 0.1e-3);
        let tilted = moved(&finger, &[0.0, 0.0, tilt_mrad, 0.0]);
        let before = features_at(&pin, &tilted);
        assert!(before.m_x * tilt_mrad > 1_000.0, "+theta_x loads +y: {}", before.m_x);
        let m_x = features_at(&pin, &pushed(&tilted, &before, 8.5, 2, 10.0)).m_x;
        assert!(m_x.abs() < before.m_x.abs(), "{} to {m_x}", before.m_x);
    }
}

#[test]
fn the_turn_brings_the_pin_s_axis_along_y() {
    let finger = Puma260::reference().tool_pose(&rolling());
    for yaw in [-0.1, 0.1] {
        let mut pin = pin_under(&finger, 0.1e-3);
        pin.axis = finger.rotation * (rotation_about(DVec3::Z, yaw) * DVec3::Y);
        let before = features_at(&pin, &finger);
        let theta_z = before.theta_z_rad.unwrap();
        assert!((theta_z - yaw).abs() < 0.02, "the axis turned by {yaw} reads {theta_z}");
        let after =
            features_at(&pin, &pushed(&finger, &before, 8.5, 3, 100.0)).theta_z_rad.unwrap();
        assert!(after.abs() < theta_z.abs() && after * theta_z > 0.0, "{theta_z} to {after}");
    }
}

/// What ten seconds of rolling left behind.
struct Run {
    reversals: u32,
    x_c: [f64; 2],
    p_x: [f64; 2],
    /// Last touch and last pose of the finger.
    touch: TouchFeatures,
    finger: Pose,
    contact_lost: bool,
}

/// Ten seconds of images through the arm: features, law, joint step, desired joints.
fn roll(pin: &mut Pin, start: Joints) -> Run {
    let (arm, config) = (Puma260::reference(), config());
    let (law, mut heading) = (ThesisLaw::new(&config), Heading::new(&config));
    let mut q = start;
    let mut finger = give_way(pin, &arm.tool_pose(&q));
    let mut run = Run {
        reversals: 0,
        x_c: [f64::MAX, f64::MIN],
        p_x: [f64::MAX, f64::MIN],
        touch: TouchFeatures::default(),
        finger,
        contact_lost: false,
    };
    for _ in 0..2_000 {
        let touch = features_at(pin, &finger);
        run.contact_lost |= run.touch.contact && !touch.contact;
        heading.update(touch.x_c);
        // From the first turn on the strokes are whole.
        if let Some(x_c) = touch.x_c.filter(|_| heading.reversals() > 0) {
            run.x_c = [run.x_c[0].min(x_c), run.x_c[1].max(x_c)];
            let p_x = finger.translation.x;
            run.p_x = [run.p_x[0].min(p_x), run.p_x[1].max(p_x)];
        }
        let motion = tool_motion(&law.displacement(&touch, heading.x_c()));
        q += joint_step(&arm, &q, &motion, &Joints::zeros(), 0.05).unwrap();
        let before = finger.translation;
        finger = give_way(pin, &arm.tool_pose(&q));
        if touch.contact {
            let way = finger.translation - before;
            let across = pin.axis.cross(DVec3::Z).normalize();
            pin.centre += 0.5 * way.dot(across) * across;
        }
        run.touch = touch;
    }
    run.reversals = heading.reversals();
    run.finger = finger;
    run
}

#[test]
fn the_pin_is_rolled_to_and_fro_and_the_finger_moves_twice_as_far() {
    let start = rolling();
    let finger = Puma260::reference().tool_pose(&start);
    let mut pin = pin_under(&finger, -2.0e-3);
    let run = roll(&mut pin, start);
    assert!(run.reversals >= 3 && !run.contact_lost, "{} reversals", run.reversals);
    assert!(run.x_c[0] > 2.0 && run.x_c[0] < 2.5, "{:?}", run.x_c);
    assert!(run.x_c[1] < 15.0 && run.x_c[1] > 14.5, "{:?}", run.x_c);
    let ratio = (run.p_x[1] - run.p_x[0]) / ((run.x_c[1] - run.x_c[0]) * PITCH_M);
    assert!((ratio - 2.0).abs() < 0.1, "ratio {ratio}");
    assert!((run.touch.m0 - 15_000.0).abs() < 1_500.0, "M0 {}", run.touch.m0);
    assert!(run.touch.m_x.abs() < 2_000.0 && run.touch.theta_z_rad.unwrap().abs() < 0.01);
}

#[test]
fn the_finger_turns_after_a_pin_that_lies_askew_and_slopes() {
    let start = rolling();
    let arm = Puma260::reference();
    let finger = arm.tool_pose(&start);
    for (yaw, slope) in [(0.08, 0.04), (-0.08, -0.04)] {
        let mut pin = pin_under(&finger, -1.5e-3);
        let turn = rotation_about(DVec3::Z, yaw) * rotation_about(DVec3::X, slope);
        pin.axis = turn * pin.axis;
        let run = roll(&mut pin, start);
        assert!(!run.contact_lost);
        // The axis seen from the finger: its tilt is gone, its yaw is fading with 0.2/s.
        let axis = run.finger.rotation.transpose() * pin.axis;
        assert!(axis.z.abs() < 0.1 * slope.abs(), "slope {slope}: {axis}");
        let left = axis.x.abs() / yaw.abs();
        assert!((0.05..0.5).contains(&left), "yaw {yaw}: {left} of it is left");
        // y and theta_y are nobody's: the finger's x stays level along the pin's travel.
        assert!(run.finger.rotation.x_axis.x < -0.9);
    }
}
