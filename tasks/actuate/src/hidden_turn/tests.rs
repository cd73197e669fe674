//! A finger that presses on a long body, and turns about the pad's normal without being counted;
//! or what it presses on is turned.

use super::*;
use crate::runaway::{Motion, MotorModel};
use taktil_mechanics::Joints;
use taktil_mechanics::robot::Robot;

const PERIOD_S: f64 = 2.5e-3;
const JOBS_MAX: u32 = 500;
/// Jobs before the turn, in which the contact settles.
const JOBS_BEFORE: u32 = 160;
const JOINT_1: usize = 0;
const JOINT_5: usize = 4;
const JOINT_6: usize = 5;

/// What happens after the first [`JOBS_BEFORE`] jobs.
#[derive(Clone, Copy)]
struct Trial {
    motor: usize,
    /// Torque of the motor beyond gravity, over what friction and the error of gravity may take.
    pull_share: f64,
    /// Speed of joint 6 (rad/s), and the share of its motion that is counted.
    turn_rad_s: f64,
    counted_share: f64,
    /// Speed at which the body turns the same way (rad/s).
    body_rad_s: f64,
    /// Largest error of the direction in an image (rad).
    noise_rad: f64,
}

const DEAD: Trial = Trial {
    motor: JOINT_6,
    pull_share: 0.5,
    turn_rad_s: 0.4,
    counted_share: 0.0,
    body_rad_s: 0.0,
    noise_rad: 0.0,
};

/// How far joint 6 has turned when its encoder is found, if it is (deg).
fn found_deg(trial: &Trial) -> Option<f64> {
    let robot = Robot::puma260();
    let q = robot.nominal_rad;
    let motion = Motion { q_rad: q.into(), qd_rad_s: [0.0; 6], calibrated: true };
    let load = MotorModel::new(&robot).load(&motion, PERIOD_S);
    let mut detector = HiddenTurnDetector::new(&robot.arm, &robot.gears);
    // The torque at which no share is pulled, and that at which all of it is.
    let [up, down] = [1.0, -1.0].map(|side| load.excess_nm(trial.motor, 0.0, side));
    let (bias_nm, bound_nm) = (0.5 * (down - up), -0.5 * (up + down));
    let mut torque_nm =
        Joints::from_fn(|i, _| 0.5 * (load.excess_nm(i, 0.0, -1.0) - load.excess_nm(i, 0.0, 1.0)));
    for job in 0..JOBS_MAX {
        let t_s = f64::from(job.saturating_sub(JOBS_BEFORE)) * PERIOD_S;
        torque_nm[trial.motor] = bias_nm + trial.pull_share * bound_nm;
        let turned_rad = trial.turn_rad_s * t_s;
        let mut counted = q;
        counted[JOINT_6] += trial.counted_share * turned_rad;
        // An image each other job; its direction is off by turns.
        let image = job / 2;
        let off_rad = trial.noise_rad * [0.3, -1.0, 0.8, -0.2, 1.0, -0.9][image as usize % 6];
        let shown_s = f64::from((2 * image).saturating_sub(JOBS_BEFORE)) * PERIOD_S;
        let on_pad_rad = (trial.body_rad_s - trial.turn_rad_s) * shown_s + off_rad;
        let reading = Reading {
            counts: &robot.gears.counts(&counted),
            q_rad: &counted.into(),
            calibrated: true,
            torque_nm: &torque_nm,
            acceleration: &Joints::zeros(),
            touch: Touch::Contact {
                x_m: 8e-3,
                y_m: 12e-3,
                yaw_rad: Some((on_pad_rad + FRAC_PI_2).rem_euclid(PI) - FRAC_PI_2),
            },
            has_jumped: false,
            after_s: PERIOD_S,
        };
        if let Some(motor) = detector.update(&reading, &load) {
            assert!(motor == trial.motor && job >= JOBS_BEFORE, "motor {motor} in job {job}");
            return Some(turned_rad.to_degrees());
        }
    }
    None
}

#[test]
fn a_turn_that_is_not_counted_is_found_by_the_load_that_turns_back() {
    for side in [1.0, -1.0] {
        let turns = Trial { turn_rad_s: side * 0.4, pull_share: side * 0.5, ..DEAD };
        let found = found_deg(&turns).unwrap().abs();
        assert!(found < 10.0, "{found} deg");
        let noisy = found_deg(&Trial { noise_rad: 0.03, ..turns }).unwrap().abs();
        assert!(noisy < 15.0, "{noisy} deg");
        // A quarter turn and more, fast.
        assert!(found_deg(&Trial { turn_rad_s: side * 6.0, ..turns }).is_some());
    }
}

#[test]
fn a_turn_that_is_counted_or_has_no_torque_or_the_wrong_one_is_none() {
    assert_eq!(found_deg(&Trial { counted_share: 1.0, ..DEAD }), None);
    assert_eq!(found_deg(&Trial { pull_share: 0.2, ..DEAD }), None);
    assert_eq!(found_deg(&Trial { pull_share: -0.5, ..DEAD }), None);
    // It comes to less than the smallest turn within the time.
    assert_eq!(found_deg(&Trial { turn_rad_s: 0.1, ..DEAD }), None);
    // Motors that turn the finger about another axis, or take it along.
    for pull_share in [0.5, -0.5] {
        assert_eq!(found_deg(&Trial { motor: JOINT_1, pull_share, ..DEAD }), None);
    }
    assert_eq!(found_deg(&Trial { motor: JOINT_5, ..DEAD }), None);
}

#[test]
fn a_body_that_turns_is_followed_and_not_taken_for_a_dead_encoder() {
    for body_rad_s in [0.3_f64, 1.0, -0.3, -1.0] {
        // The law asks for a torque to the side to which the body turns, and friction holds.
        let pull_share = 0.9 * body_rad_s.signum();
        let turned = Trial { body_rad_s, pull_share, turn_rad_s: 0.0, ..DEAD };
        assert_eq!(found_deg(&turned), None, "{body_rad_s} rad/s");
    }
    // Noise alone: of a long load, and of a round one, whose direction is any.
    for noise_rad in [0.03, 0.1, 1.2] {
        for pull_share in [0.9, -0.9] {
            let noise = Trial { noise_rad, pull_share, turn_rad_s: 0.0, ..DEAD };
            assert_eq!(found_deg(&noise), None);
        }
    }
}
