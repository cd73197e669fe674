//! Tests the law of a described task: answers calculated by hand, its state, its errors.

use super::*;
use crate::config::law_name::LawName;
use crate::config::task_frame::ServoedFeature;

fn servoed(name: Feature, jacobian: &[f64]) -> ServoedFeature {
    ServoedFeature { name, desired: None, jacobian: jacobian.into(), kp_per_s: 5.0, ki_per_s2: 0.0 }
}

/// Follows a surface: presses, and turns until the contact is in the middle.
fn surface() -> TaskFrame {
    TaskFrame {
        state: vec![Motion::Z, Motion::ThetaY],
        feed_per_s: [6.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        slew_s: 0.0,
        feature: vec![servoed(Feature::M0, &[10_000.0, 0.0]), servoed(Feature::XC, &[0.0, -0.05])],
    }
}

fn config(task_frame: TaskFrame) -> Config {
    Config { task_frame, ..Config::default() }
}

#[test]
fn what_is_fed_keeps_to_the_limits_of_speed() {
    let mut config = config(surface());
    config.task_frame.feed_per_s = [400.0, -400.0, 0.0, 500.0, 0.0, 0.0];
    let law = TaskFrameGains::new(&config.task_frame, &config.array).unwrap();
    let seen = touch(config.m0_counts, 8.5);
    let (step, _) = displacement(&config, &law, &TaskFrameState::default(), &seen);
    let s = 1e-3 * config.image_period_ms;
    let due = [config.roll_mm_s * s, -config.roll_mm_s * s, config.tilt_mrad_s * s];
    assert_eq!([step[0], step[1], step[3]], due);
}

#[test]
fn set_points_beyond_the_array_are_refused() {
    let out = [
        (Feature::M0, -5000.0),
        (Feature::M0, f64::NAN),
        (Feature::XC, 17.0),
        (Feature::YC, 0.5),
        (Feature::ThetaZ, 1e7),
    ];
    for (name, desired) in out {
        let mut task = surface();
        let index = usize::from(name != Feature::M0);
        task.feature[index] =
            ServoedFeature { desired: Some(desired), ..servoed(name, &[0.0, 1.0]) };
        let place = task.check(&Array::default()).unwrap_err().place;
        assert_eq!(place, format!("feature[{index}].desired"), "{name:?} {desired}");
    }
    let mut near = config(surface());
    near.task_frame.feature[0].desired = Some(2_000.0);
    assert_eq!(near.load_counts(), near.m0_counts, "another law's");
    near.law = LawName::TaskFrame;
    assert_eq!(near.load_counts(), 2_000.0);
}

fn touch(m0: f64, x_c: f64) -> TouchFeatures {
    let (x_c, y_c) = (Some(x_c), Some(8.5));
    TouchFeatures { trusted: true, contact: true, m0, m_x: 0.0, x_c, y_c, theta_z_rad: None }
}

#[test]
fn features_are_servoed_by_their_motions_and_the_rest_is_fed() {
    let config = config(surface());
    let law = TaskFrameGains::new(&config.task_frame, &config.array).unwrap();
    assert_eq!(law.is_moved(), [true, false, true]);
    let (step, _) = displacement(&config, &law, &TaskFrameState::default(), &touch(14_000.0, 9.5));
    // 5/s of 1000 counts over 10000 counts/mm in 5 ms; a column too far: a turn of 20 mrad.
    assert!((step[2] - 2.5e-3).abs() < 1e-12 && (step[4] - 0.5).abs() < 1e-12, "{step:?}");
    assert_eq!([step[0], step[1], step[3], step[5]], [0.03, 0.0, 0.0, 0.0]);
    let weak = displacement(&config, &law, &TaskFrameState::default(), &touch(3_000.0, 8.5)).0;
    assert_eq!(weak[0], 0.0, "nothing is fed before the finger presses");
}

#[test]
fn a_coupled_jacobian_is_inverted_as_a_whole() {
    let mut task = surface();
    task.feature[1].jacobian = vec![0.5, -0.05];
    let config = config(task);
    let law = TaskFrameGains::new(&config.task_frame, &config.array).unwrap();
    let (step, _) = displacement(&config, &law, &TaskFrameState::default(), &touch(14_000.0, 8.5));
    // Pressing moves the centroid by 0.5 a mm, which the turn takes back.
    assert!((0.5 * step[2] - 0.05 * step[4]).abs() < 1e-15, "{step:?}");
}

#[test]
fn the_integral_waits_at_a_limit_and_is_forgotten_without_contact() {
    let mut task = surface();
    task.feature[0].ki_per_s2 = 10.0;
    let config = config(task);
    let law = TaskFrameGains::new(&config.task_frame, &config.array).unwrap();
    let far = displacement(&config, &law, &TaskFrameState::default(), &touch(1_000.0, 8.5));
    assert_eq!(far.1.integral, [0.0; MOTIONS_MAX], "at its limit of 4 mm/s");
    let near = displacement(&config, &law, &TaskFrameState::default(), &touch(14_900.0, 8.5));
    assert!((near.1.integral[0] - 0.5).abs() < 1e-12);
    let lost = TouchFeatures { contact: false, ..touch(0.0, 8.5) };
    let (step, state) = displacement(&config, &law, &near.1, &lost);
    assert_eq!((step, state), ([0.0, 0.0, 0.03, 0.0, 0.0, 0.0], TaskFrameState::default()));
    let blind = TouchFeatures { trusted: false, ..touch(9_000.0, 3.0) };
    assert_eq!(displacement(&config, &law, &near.1, &blind).0, [0.0; MOTIONS_MAX]);
}

#[test]
fn what_cannot_work_is_refused_with_its_place() {
    assert_eq!(TaskFrame::default().check(&Array::default()), Ok(()));
    assert!(surface().inverse().unwrap().1 < 10.0);
    let place = |change: &dyn Fn(&mut TaskFrame)| {
        let mut task = surface();
        change(&mut task);
        task.check(&Array::default()).unwrap_err().place
    };
    assert_eq!(place(&|t| t.state[1] = Motion::Z), "state[1]");
    assert_eq!(place(&|t| t.feed_per_s[2] = 1.0), "feed_per_s[2]");
    assert_eq!(place(&|t| t.feed_per_s[1] = f64::NAN), "feed_per_s[1]");
    assert_eq!(place(&|t| t.slew_s = f64::NAN), "slew_s");
    assert_eq!(place(&|t| t.slew_s = -0.1), "slew_s");
    assert_eq!(place(&|t| t.feature[1].name = Feature::M0), "feature[1].name");
    assert_eq!(place(&|t| t.feature[1].jacobian = vec![1.0]), "feature[1].jacobian");
    assert_eq!(place(&|t| t.feature[0].jacobian[1] = f64::NAN), "feature[0].jacobian[1]");
    assert_eq!(place(&|t| t.feature[0].kp_per_s = -1.0), "feature[0].kp_per_s");
    assert_eq!(place(&|t| t.feature[0].desired = Some(f64::INFINITY)), "feature[0].desired");
    assert_eq!(place(&|t| t.state.push(Motion::Y)), "feature[0].jacobian");
    assert_eq!(place(&|t| t.feature[1].jacobian = vec![1.0, 0.0]), "feature");
    let empty = TaskFrame { state: vec![], feature: vec![], ..surface() };
    assert_eq!(
        empty.check(&Array::default()),
        Ok(()),
        "a finger that only feeds is blind, not wrong"
    );
}

#[test]
fn speeds_of_turns_and_of_feed_are_gathered_and_not_stepped() {
    let mut config = config(surface());
    config.task_frame.slew_s = 0.1;
    let law = TaskFrameGains::new(&config.task_frame, &config.array).unwrap();
    let period_s = 1e-3 * config.image_period_ms;
    // The load at the pad's edge asks for much more than the limit.
    let edge = touch(9_000.0, 15.5);
    let mut state = TaskFrameState::default();
    let mut before = [0.0; MOTIONS_MAX];
    for image in 1..=25 {
        let (step, next) = displacement(&config, &law, &state, &edge);
        let speed = step.map(|step| step / period_s);
        let due = f64::from(image.min(20)) / 20.0;
        assert!((speed[4] - due * config.tilt_mrad_s).abs() < 1e-9, "{image}: {speed:?}");
        assert!((speed[0] - before[0]).abs() < 0.05 * config.roll_mm_s + 1e-9, "{image}");
        assert!((speed[2] - 3.0).abs() < 1e-9, "pressing steps: {speed:?}");
        (state, before) = (next, speed);
    }
    assert!((before[0] - 6.0).abs() < 1e-12, "as fast as it is fed");
    let blind = TouchFeatures { trusted: false, ..edge };
    let stood = displacement(&config, &law, &state, &blind).1;
    let lost = TouchFeatures { contact: false, ..touch(0.0, 8.5) };
    let gone = displacement(&config, &law, &state, &lost).1;
    assert_eq!(
        (stood.speed, gone.speed),
        ([0.0; MOTIONS_MAX], [0.0; MOTIONS_MAX]),
        "from rest again"
    );
}
