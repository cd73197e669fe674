//! Motors that stand under torque: without contact, held by what is touched, and with encoders that
//! hide how the finger moves over a pin.

use super::*;
use crate::contact_age::ContactAge;
use crate::runaway::{Motion, MotorModel};
use taktil_mechanics::Joints;
use taktil_mechanics::robot::Robot;

const PERIOD_S: f64 = 2.5e-3;
const JOINT_3: usize = 2;
const JOINT_5: usize = 4;
const JOINT_6: usize = 5;
const JOBS_MAX: u32 = 400;
/// Jobs before the fault, in which the contact settles.
const JOBS_BEFORE: u32 = 60;

/// Jobs in which a motor creeps.
const CREEPING_JOBS: u32 = 140;

/// Until it is driven a motor goes to and fro by so many counts, each time after so many jobs: it
/// is not held.
const STIR_COUNTS: i32 = 8;
const STIR_JOBS: u32 = 10;

/// What happens to a motor, which is driven from a job on.
#[derive(Clone, Copy)]
struct Trial {
    /// The motor, 0 the first, the side to which it is driven, and from which job on.
    motor: usize,
    side: f64,
    from_job: u32,
    /// Torque over what gravity and friction may take (N m at the motor).
    excess_nm: f64,
    /// What is touched, by the hidden way of the finger along the sensor's x axis (m).
    touch: fn(f64) -> Touch,
    /// Whether the encoder counts.
    counts: bool,
}

/// A contact at a place of the pad (m).
fn at(x_m: f64) -> Touch {
    Touch::Contact { x_m, y_m: 12e-3, yaw_rad: None }
}

/// A finger that rolls a pin: the load moves over the pad by half of its way, the other way.
const ROLLING_TOUCH: fn(f64) -> Touch = |way_m| at(8e-3 - 0.5 * way_m);
const HELD_TOUCH: fn(f64) -> Touch = |_| at(8e-3);

/// How far the joint has turned when it is found, if it is (deg). It moves as the torque makes it,
/// against a friction that is that of the model.
fn found_deg(trial: &Trial) -> Option<f64> {
    let robot = Robot::puma260();
    let Trial { motor, side, .. } = *trial;
    let q = robot.nominal_rad;
    let motion = Motion { q_rad: q.into(), qd_rad_s: [0.0; 6], calibrated: true };
    let load = MotorModel::new(&robot).load(&motion, PERIOD_S);
    let mut detector = HiddenMotionDetector::new(&robot.arm, &robot.gears);
    let mut contact = ContactAge::new();
    let [up, down] = PULL_SIDES.map(|side| load.excess_nm(motor, 0.0, side));
    let (bias_nm, bound_nm) = (0.5 * (down - up), -0.5 * (up + down));
    let mut torque_nm =
        Joints::from_fn(|i, _| 0.5 * (load.excess_nm(i, 0.0, -1.0) - load.excess_nm(i, 0.0, 1.0)));
    let friction_nm = robot.friction.coulomb_nm[motor] / robot.gears.gear_matrix()[(motor, motor)];
    let (mut speed, mut way) = (0.0, 0.0);
    let zero = robot.gears.counts(&q);
    let from = robot.arm.tool_pose(&q);
    for job in 0..JOBS_MAX {
        let is_driven = job >= trial.from_job;
        if is_driven {
            let pull_nm = bound_nm + trial.excess_nm;
            torque_nm[motor] = bias_nm + side * pull_nm;
            speed += side * (pull_nm - friction_nm.abs()) / load.own_inertia(motor);
            way += speed;
        }
        let mut hidden = [0; 6];
        hidden[motor] = whole(way);
        let turned = robot.gears.joints(&hidden);
        let there = robot.arm.tool_pose(&(q + turned));
        let way_m = (there.translation - from.translation).dot(from.rotation.x_axis);
        let mut counts = zero;
        if trial.counts {
            counts[motor] += whole(way);
        }
        if !is_driven && job / STIR_JOBS % 2 == 1 {
            counts[motor] += STIR_COUNTS;
        }
        let reading = Reading {
            counts: &counts,
            q_rad: &motion.q_rad,
            calibrated: true,
            torque_nm: &torque_nm,
            acceleration: &Joints::zeros(),
            has_jumped: contact.update((trial.touch)(way_m).place_m(), PERIOD_S),
            touch: (trial.touch)(way_m),
            after_s: PERIOD_S,
        };
        if let Some(found) = detector.update(&reading, &load) {
            assert!(found == motor && is_driven, "motor {found} in job {job}");
            return Some(turned[motor].abs().to_degrees());
        }
    }
    None
}

const DRIVEN_TRIAL: Trial = Trial {
    motor: JOINT_5,
    side: 1.0,
    from_job: JOBS_BEFORE,
    excess_nm: 5e-3,
    touch: ROLLING_TOUCH,
    counts: false,
};

#[test]
fn what_is_pressed_on_anew_holds_the_motor_that_presses() {
    let robot = Robot::puma260();
    let pose = robot.nominal_rad;
    let push = crate::contact_push::ContactPush::new(&robot.arm, &robot.gears);
    let pressing = Trial { motor: JOINT_3, excess_nm: 0.05, ..DRIVEN_TRIAL };
    let pressing = Trial { side: -push.side(&pose.into(), JOINT_3), ..pressing };
    assert_eq!(found_deg(&pressing), None, "what rolls away below it is no motion of its own");
    // The other way it leaves what it touches, and in time the contact is one that stays.
    let lifting = Trial { side: -pressing.side, ..pressing };
    assert!(found_deg(&lifting).is_some_and(|deg| deg < 2.0));
    let settled_jobs = whole(PRESSED_SETTLED_S / PERIOD_S).unsigned_abs();
    let later = Trial { from_job: settled_jobs, ..pressing };
    assert!(found_deg(&later).is_some_and(|deg| deg < 2.0));
}

/// A load that moves by 3 mm along x as soon as the finger should have turned, and a little more
/// from image to image, and is pressed elsewhere along y by so much (m) from then on.
fn shifted(way_m: f64, along_y_m: f64) -> Touch {
    let is_shifted = way_m.abs() > 0.5e-3;
    let (x_m, y_m) = if is_shifted { (3e-3 * way_m.signum(), along_y_m) } else { (0.0, 0.0) };
    Touch::Contact { x_m: 8e-3 - x_m - 0.01 * way_m, y_m: 22e-3 - y_m, yaw_rad: None }
}

#[test]
fn a_load_that_jumps_to_the_other_end_of_the_pad_tells_nothing_of_the_finger() {
    // The finger rocks on a slanted edge: at its other end the load lies elsewhere along x, too.
    let robot = Robot::puma260();
    let push = crate::contact_push::ContactPush::new(&robot.arm, &robot.gears);
    let side = -push.side(&robot.nominal_rad.into(), JOINT_3);
    let from_job = whole(PRESSED_SETTLED_S / PERIOD_S).unsigned_abs();
    let pressing = Trial { motor: JOINT_3, side, from_job, excess_nm: 0.05, ..DRIVEN_TRIAL };
    let of = |touch: fn(f64) -> Touch| found_deg(&Trial { touch, ..pressing });
    assert!(of(|way_m| shifted(way_m, 0.0)).is_some_and(|deg| deg < 2.0));
    assert_eq!(of(|way_m| shifted(way_m, 20e-3)), None);
}

#[test]
fn a_motor_without_contact_must_move_under_its_torque() {
    for touch in [(|_| Touch::Free) as fn(f64) -> Touch, |_| Touch::Absent] {
        let found = found_deg(&Trial { touch, ..DRIVEN_TRIAL }).unwrap();
        assert!(found < 2.0, "{found} deg");
        assert_eq!(found_deg(&Trial { touch, counts: true, ..DRIVEN_TRIAL }), None);
        // Gravity and friction may take as much.
        assert_eq!(found_deg(&Trial { touch, excess_nm: -1e-4, ..DRIVEN_TRIAL }), None);
    }
}

#[test]
fn a_motor_that_its_torque_has_stopped_is_not_found() {
    let robot = Robot::puma260();
    let motion = Motion { q_rad: robot.nominal_rad.into(), qd_rad_s: [0.0; 6], calibrated: true };
    let load = MotorModel::new(&robot).load(&motion, PERIOD_S);
    let mut detector = HiddenMotionDetector::new(&robot.arm, &robot.gears);
    let hold_nm =
        Joints::from_fn(|i, _| 0.5 * (load.excess_nm(i, 0.0, -1.0) - load.excess_nm(i, 0.0, 1.0)));
    let bound_nm = -load.excess_nm(JOINT_6, hold_nm[JOINT_6], 1.0);
    let zero = robot.gears.counts(&robot.nominal_rad);
    // Three counts a reading backwards, until a torque stops it between two readings.
    let way = |job: u32| -3 * i32::try_from(job.min(JOBS_BEFORE)).unwrap();
    for job in 0..JOBS_MAX {
        let mut torque_nm = hold_nm;
        if job == JOBS_BEFORE + 1 {
            torque_nm[JOINT_6] += bound_nm + INERTIA_FACTOR * 3.5 * load.own_inertia(JOINT_6);
        }
        let mut counts = zero;
        counts[JOINT_6] += way(job);
        let reading = Reading {
            counts: &counts,
            q_rad: &motion.q_rad,
            calibrated: true,
            torque_nm: &torque_nm,
            acceleration: &Joints::zeros(),
            touch: Touch::Absent,
            has_jumped: false,
            after_s: PERIOD_S,
        };
        assert_eq!(detector.update(&reading, &load), None, "job {job}");
    }
}

#[test]
fn the_way_of_the_load_over_the_pad_tells_a_joint_that_is_held_from_one_that_is_not() {
    let found = found_deg(&DRIVEN_TRIAL).unwrap();
    assert!(found < 2.0, "{found} deg");
    assert_eq!(found_deg(&Trial { counts: true, ..DRIVEN_TRIAL }), None);
    let others: [fn(f64) -> Touch; 3] = [
        HELD_TOUCH,
        // It moves the other way: something else moves what is touched.
        |way_m| at(8e-3 + 0.5 * way_m),
        |_| Touch::Unknown,
    ];
    for touch in others {
        assert_eq!(found_deg(&Trial { touch, ..DRIVEN_TRIAL }), None);
    }
}

#[test]
fn a_contact_that_is_lost_only_now_and_then_is_none_that_is_gone() {
    // Four images of five show no load: it is noise, or the edge of a pad.
    let robot = Robot::puma260();
    let motion = Motion { q_rad: robot.nominal_rad.into(), qd_rad_s: [0.0; 6], calibrated: true };
    let load = MotorModel::new(&robot).load(&motion, PERIOD_S);
    let mut detector = HiddenMotionDetector::new(&robot.arm, &robot.gears);
    let counts = robot.gears.counts(&robot.nominal_rad);
    let torque_nm = Joints::repeat(1.0);
    for job in 0..JOBS_MAX {
        let touch = if job % 5 == 0 { at(0.01) } else { Touch::Free };
        let reading = Reading {
            counts: &counts,
            q_rad: &motion.q_rad,
            calibrated: true,
            torque_nm: &torque_nm,
            acceleration: &Joints::zeros(),
            touch,
            has_jumped: false,
            after_s: PERIOD_S,
        };
        assert_eq!(detector.update(&reading, &load), None, "job {job}");
    }
}

#[test]
fn a_motor_that_the_contact_held_is_not_found_when_the_contact_ends() {
    let robot = Robot::puma260();
    let motion = Motion { q_rad: robot.nominal_rad.into(), qd_rad_s: [0.0; 6], calibrated: true };
    let load = MotorModel::new(&robot).load(&motion, PERIOD_S);
    let mut detector = HiddenMotionDetector::new(&robot.arm, &robot.gears);
    let counts = robot.gears.counts(&robot.nominal_rad);
    for job in 0..JOBS_MAX {
        let pressed = job < JOBS_MAX / 2;
        let excess_nm = if pressed { 0.05 } else { -1e-4 };
        let torque_nm = Joints::from_fn(|i, _| excess_nm - load.excess_nm(i, 0.0, 1.0));
        let touch = if pressed { at(0.01) } else { Touch::Free };
        let reading = Reading {
            counts: &counts,
            q_rad: &motion.q_rad,
            calibrated: true,
            torque_nm: &torque_nm,
            acceleration: &Joints::zeros(),
            touch,
            has_jumped: false,
            after_s: PERIOD_S,
        };
        assert_eq!(detector.update(&reading, &load), None, "job {job}");
    }
}

/// Whether a motor is found that the contact holds against a torque which acts from job
/// [`JOBS_BEFORE`] on, by so much (N m) over what gravity and friction may take, where the load's
/// place on the pad (m) is a function of the image at 80 Hz.
fn is_found_while_held(excess_nm: f64, place_m: impl Fn(usize) -> f64) -> bool {
    is_found_while_creeping(excess_nm, 0.0, place_m)
}

/// The same of a motor that creeps at a speed (counts/s) in the first [`CREEPING_JOBS`] jobs.
fn is_found_while_creeping(
    excess_nm: f64,
    creep_counts_s: f64,
    place_m: impl Fn(usize) -> f64,
) -> bool {
    let robot = Robot::puma260();
    let motion = Motion { q_rad: robot.nominal_rad.into(), qd_rad_s: [0.0; 6], calibrated: true };
    let load = MotorModel::new(&robot).load(&motion, PERIOD_S);
    let mut detector = HiddenMotionDetector::new(&robot.arm, &robot.gears);
    let mut counts = robot.gears.counts(&robot.nominal_rad);
    let mut torque_nm =
        Joints::from_fn(|i, _| 0.5 * (load.excess_nm(i, 0.0, -1.0) - load.excess_nm(i, 0.0, 1.0)));
    let zero = counts[JOINT_5];
    (0..JOBS_MAX).any(|job| {
        if job == JOBS_BEFORE {
            torque_nm[JOINT_5] = excess_nm - load.excess_nm(JOINT_5, 0.0, 1.0);
        }
        let crept = creep_counts_s * f64::from(job.min(CREEPING_JOBS)) * PERIOD_S;
        counts[JOINT_5] = zero + whole(crept);
        let reading = Reading {
            counts: &counts,
            q_rad: &motion.q_rad,
            calibrated: true,
            torque_nm: &torque_nm,
            acceleration: &Joints::zeros(),
            touch: at(place_m(job as usize / 5)),
            has_jumped: false,
            after_s: PERIOD_S,
        };
        detector.update(&reading, &load).is_some()
    })
}

#[test]
fn what_the_other_motors_throw_a_motor_by_is_no_torque_that_must_move_it() {
    let robot = Robot::puma260();
    let motion = Motion { q_rad: robot.nominal_rad.into(), qd_rad_s: [0.0; 6], calibrated: true };
    let load = MotorModel::new(&robot).load(&motion, PERIOD_S);
    let counts = robot.gears.counts(&robot.nominal_rad);
    let mut torque_nm =
        Joints::from_fn(|i, _| 0.5 * (load.excess_nm(i, 0.0, -1.0) - load.excess_nm(i, 0.0, 1.0)));
    torque_nm[JOINT_5] = DRIVEN_TRIAL.excess_nm - load.excess_nm(JOINT_5, 0.0, 1.0);
    let found = |acceleration: &Joints| {
        let mut detector = HiddenMotionDetector::new(&robot.arm, &robot.gears);
        (0..JOBS_MAX).find_map(|_| {
            let reading = Reading {
                counts: &counts,
                q_rad: &motion.q_rad,
                calibrated: true,
                torque_nm: &torque_nm,
                acceleration,
                touch: Touch::Free,
                has_jumped: false,
                after_s: PERIOD_S,
            };
            detector.update(&reading, &load)
        })
    };
    assert_eq!(found(&Joints::zeros()), Some(JOINT_5));
    // Joint 4 stops with an acceleration that takes as much.
    let mut thrown = Joints::zeros();
    thrown[3] = 1.0;
    thrown[3] = 1.1 * DRIVEN_TRIAL.excess_nm / load.reaction_nm(JOINT_5, &thrown);
    assert_eq!(found(&thrown), None);
    assert_eq!(found(&(thrown * 0.5)), Some(JOINT_5));
}

#[test]
fn one_image_and_noise_tell_of_no_motion() {
    for side in [1.0, -1.0] {
        for jump in 12..40 {
            let place = |image| 0.01 + if image == jump { side * 3e-3 } else { 0.0 };
            assert!(!is_found_while_held(DRIVEN_TRIAL.excess_nm, place), "image {jump}");
        }
        // The noise of a centroid over all tactels.
        let noise_m = [0.0, 1.5e-3, 1.3e-3, 1.6e-3, -0.9e-3, 0.4e-3, -1.4e-3, -1.2e-3, -1.3e-3];
        for first in 0..noise_m.len() {
            let place = |image| 0.01 + side * noise_m[(image + first) % noise_m.len()];
            assert!(!is_found_while_held(DRIVEN_TRIAL.excess_nm, place), "from {first} on");
        }
    }
}

#[test]
fn what_is_touched_may_slip_under_a_finger_that_has_stood() {
    for speed_m in [5e-4, -5e-4] {
        let slid = |image: usize| 0.01 + speed_m * image.saturating_sub(60) as f64;
        assert!(!is_found_while_held(3e-4, slid), "{speed_m} m an image");
        // It slips while the motor creeps, or has just done so.
        for creep_counts_s in [-25.0, -10.0, 10.0, 25.0] {
            for first in [26, 28, 30] {
                let slid = |image: usize| 0.01 + speed_m * image.saturating_sub(first) as f64;
                let found = is_found_while_creeping(2e-3, creep_counts_s, slid);
                assert!(!found, "{speed_m} m an image, {creep_counts_s} counts/s, from {first}");
            }
        }
    }
}
