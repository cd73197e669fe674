//! An arm under a servo, with motors and encoders of either sign: what the detector says, and how
//! far the arm got.

use super::*;
use crate::stuck_encoder::StuckEncoderDetector;
use taktil_mechanics::Joints;

const PERIOD_S: f64 = 2.5e-3;
const PERIOD_SUBSTEPS: u32 = 25;

/// What is wrong with the arm, and what happens to it.
#[derive(Clone, Copy)]
struct Trial {
    /// Signs of the motors and of the encoders; 0 is a dead encoder.
    motor: [f64; 6],
    encoder: [i32; 6],
    calibrated: bool,
    /// Where the joints rest at first (rad); the nominal pose when absent.
    pose_rad: Option<Joints>,
    /// Largest torques (N m).
    limit_nm: [f64; 6],
    /// Desired motion from that rest (rad at a time in s).
    desired: fn(f64) -> Joints,
    /// Torque that something puts on the joints (N m), at a time and a displacement.
    push: fn(f64, &Joints) -> Joints,
}

/// Torque limits of the shipped scenes (N m).
const LIMIT_NM: [f64; 6] = [8.0, 12.0, 7.0, 2.0, 1.5, 1.2];

const SOUND: Trial = Trial {
    motor: [1.0; 6],
    encoder: [1; 6],
    calibrated: true,
    pose_rad: None,
    limit_nm: LIMIT_NM,
    desired: |_| Joints::zeros(),
    push: |_, _| Joints::zeros(),
};

/// What was said first, when, and how far a joint was from where it was to be.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Verdict {
    motor: usize,
    stuck: bool,
    away_deg: f64,
}

fn verdict(trial: &Trial) -> Option<Verdict> {
    tried(trial).0
}

/// The verdict, and how far a joint was from where it was to be at the end (degrees).
fn tried(trial: &Trial) -> (Option<Verdict>, f64) {
    let robot = Robot::puma260();
    let model = MotorModel::new(&robot);
    let (mut runaway, mut stuck) =
        (RunawayDetector::new(), StuckEncoderDetector::new(&[1.0; 6], &[0.0; 6]));
    let gains = robot.dynamics.mass_matrix(&robot.nominal_rad).diagonal();
    let start = trial.pose_rad.unwrap_or(robot.nominal_rad);
    let zero = robot.gears.counts(&start);
    let (mut q, mut qd, mut last_error) = (start, Joints::zeros(), Joints::zeros());
    let (mut acting, mut torque) = (Joints::zeros(), Joints::zeros());
    for tick in 0..240 {
        let t_s = f64::from(tick) * PERIOD_S;
        let counted = robot.gears.counts(&q);
        let counts: [i32; 6] =
            core::array::from_fn(|i| zero[i] + trial.encoder[i] * (counted[i] - zero[i]));
        let measured = robot.gears.joints(&counts);
        let goal = start + (trial.desired)(t_s);
        let error = goal - measured;
        let motion =
            Motion { q_rad: measured.into(), qd_rad_s: qd.into(), calibrated: trial.calibrated };
        let load = model.load(&motion, PERIOD_S);
        let departure = -model.counts(&error);
        let away_deg = (q - goal).abs().amax().to_degrees();
        let reversed = runaway.update(counts, departure, &load, None);
        if let Some(motor) = reversed {
            return (Some(Verdict { motor, stuck: false, away_deg }), away_deg);
        }
        let motor_nm = model.motor_torque(&torque.into());
        if let Some(motor) = stuck.update(&counts, &departure, &motor_nm, &load, PERIOD_S, false) {
            return (Some(Verdict { motor, stuck: true, away_deg }), away_deg);
        }
        let rate = if tick == 0 { Joints::zeros() } else { (error - last_error) / PERIOD_S };
        last_error = error;
        torque = robot.dynamics.gravity_torque(&goal)
            + gains.component_mul(&(error * 3600.0 + rate * 60.0));
        torque = torque.zip_map(&Joints::from(trial.limit_nm), |tau, most| tau.clamp(-most, most));
        runaway.command(model.motor_torque(&torque.into()));
        for step in 0..PERIOD_SUBSTEPS {
            // A torque acts from half a period after its command.
            let commanded = if step < PERIOD_SUBSTEPS / 2 { acting } else { torque };
            let motors =
                robot.gears.motor_torque(&commanded).component_mul(&Joints::from(trial.motor));
            let sliding = qd.map(|v| (v / 1e-2).clamp(-1.0, 1.0));
            let friction = robot.friction.coulomb_nm.component_mul(&sliding)
                + robot.friction.viscous_nms_rad.component_mul(&qd);
            let sum = robot.gears.joint_torque(&motors) + (trial.push)(t_s, &(q - start))
                - friction
                - robot.dynamics.bias_torque(&q, &qd);
            let mass = robot.dynamics.mass_matrix(&q).cholesky().unwrap();
            qd += mass.solve(&sum) * (PERIOD_S / f64::from(PERIOD_SUBSTEPS));
            q += qd * (PERIOD_S / f64::from(PERIOD_SUBSTEPS));
        }
        acting = torque;
    }
    (None, (q - start - (trial.desired)(240.0 * PERIOD_S)).abs().amax().to_degrees())
}

fn alone(joint: usize, value: f64) -> Joints {
    let mut all = Joints::zeros();
    all[joint] = value;
    all
}

/// Every joint from rest to rest, about 9 degrees away.
fn swing(t_s: f64) -> Joints {
    Joints::repeat(t_s * t_s * (1.2 - 1.3 * t_s))
}

#[test]
fn a_sound_arm_is_never_said_to_run_away() {
    for calibrated in [true, false] {
        let still = Trial { calibrated, ..SOUND };
        assert_eq!(verdict(&still), None);
        assert_eq!(verdict(&Trial { desired: swing, ..still }), None);
        // A step of load, and a load that comes slowly.
        let loads: [fn(f64, &Joints) -> Joints; 2] =
            [|t_s, _| alone(1, if t_s > 0.1 { 1.5 } else { 0.0 }), |t_s, _| alone(2, 2.0 * t_s)];
        for push in loads {
            assert_eq!(verdict(&Trial { push, ..still }), None);
            assert_eq!(verdict(&Trial { push, desired: swing, ..still }), None);
        }
        // Something as stiff as the servo, which the arm approaches at 3 degrees a second. A blow
        // at full speed is no different from a motor that is reversed in mid motion.
        let push = |_, away: &Joints| alone(1, -2000.0 * (away[1] - 0.01).max(0.0));
        let desired = |t_s| Joints::repeat(0.05 * t_s);
        assert_eq!(verdict(&Trial { push, desired, ..still }), None);
    }
}

#[test]
fn each_reversed_motor_and_encoder_is_named_before_a_degree() {
    for calibrated in [true, false] {
        for joint in 0..6 {
            let (mut motor, mut encoder) = ([1.0; 6], [1; 6]);
            (motor[joint], encoder[joint]) = (-1.0, -1);
            let moved = Trial { calibrated, desired: swing, ..SOUND };
            for trial in [Trial { motor, ..moved }, Trial { encoder, ..moved }] {
                let said = verdict(&trial).unwrap();
                assert!(!said.stuck && said.away_deg < 0.9, "joint {joint}: {said:?}");
                assert!(said.motor == joint || joint > 3, "joint {joint}: {said:?}");
            }
        }
    }
}

/// Poses all over the range of the joints, by a sequence of small discrepancy (rad).
fn poses() -> impl Iterator<Item = Joints> {
    let robot = Robot::puma260();
    let (low, high) = (*robot.arm.q_min(), *robot.arm.q_max());
    let golden: f64 = 0.618_033_988_749_895;
    (0..40_u32).map(move |k| {
        Joints::from_fn(|i, _| {
            let step = (0..i).fold(golden, |power, _| power * golden);
            let share = (f64::from(k) * step + 0.1 * i as f64).fract();
            low[i] + share * (high[i] - low[i])
        })
    })
}

#[test]
fn in_no_pose_a_motor_has_less_than_the_least_inertia() {
    let model = MotorModel::new(&Robot::puma260());
    let load = |q_rad: [f64; 6], calibrated| {
        model.load(&Motion { q_rad, qd_rad_s: [0.0; 6], calibrated }, PERIOD_S)
    };
    let least = load([0.0; 6], false).least_inertia;
    for (k, pose) in poses().enumerate() {
        for joint in 0..6 {
            let here = load(pose.into(), true).own_inertia(joint);
            assert!(here >= least[joint], "pose {k}, joint {joint}: {here} {}", least[joint]);
            assert!(least[joint] > 0.2 * here, "pose {k}, joint {joint}: {here} {}", least[joint]);
        }
    }
}

#[test]
fn in_any_pose_a_reversed_motor_or_encoder_is_named_before_a_degree() {
    for (k, pose) in poses().enumerate() {
        for calibrated in [true, false] {
            let still = Trial { calibrated, pose_rad: Some(pose), ..SOUND };
            assert_eq!(verdict(&still), None);
            for joint in 0..6 {
                let (mut motor, mut encoder) = ([1.0; 6], [1; 6]);
                (motor[joint], encoder[joint]) = (-1.0, -1);
                for trial in [Trial { motor, ..still }, Trial { encoder, ..still }] {
                    // What stays within 0.2 degrees need not be named.
                    let (said, away_deg) = tried(&trial);
                    let most_deg = if said.is_some() { 0.8 } else { 0.2 };
                    assert!(
                        away_deg < most_deg,
                        "pose {k}, calibrated {calibrated}, joint {joint}: {away_deg} {said:?}"
                    );
                }
            }
        }
    }
}

#[test]
fn a_dead_encoder_is_stuck_while_its_motor_is_driven_and_unseen_at_rest() {
    for joint in 0..6 {
        let mut encoder = [1; 6];
        encoder[joint] = 0;
        assert_eq!(verdict(&Trial { encoder, ..SOUND }), None, "at rest, gravity held");
        let said = verdict(&Trial { encoder, desired: swing, ..SOUND }).unwrap();
        assert!(said.stuck && said.motor == joint, "joint {joint}: {said:?}");
    }
}

#[test]
fn missing_and_impossible_readings_begin_the_comparison_anew() {
    let model = MotorModel::new(&Robot::puma260());
    let motion = Motion { q_rad: [0.0; 6], qd_rad_s: [0.0; 6], calibrated: true };
    let load = model.load(&motion, PERIOD_S);
    // Counts that depart as fast as a runaway against a large torque, but for one gap.
    let place = |tick: i32| 4 * tick * tick;
    let found = |gap: Option<i32>, bad: f64| {
        let mut detector = RunawayDetector::new();
        (0..9).find(|tick| {
            let here = place(*tick);
            let mut departure = alone(1, f64::from(here));
            if Some(*tick) == gap {
                departure[1] = bad;
            }
            let mut counts = [0; 6];
            counts[1] = here;
            let found = detector.update(counts, departure, &load, None);
            detector.command(alone(1, -0.3));
            found.is_some()
        })
    };
    assert_eq!(found(None, 0.0), Some(4));
    assert_eq!(found(Some(2), f64::NAN), Some(7));
    assert_eq!(found(Some(2), f64::INFINITY), Some(7));
}

#[test]
fn what_is_touched_may_push_a_motor_a_little_to_its_side() {
    let model = MotorModel::new(&Robot::puma260());
    let motion = Motion { q_rad: [0.0; 6], qd_rad_s: [0.0; 6], calibrated: true };
    let load = model.load(&motion, PERIOD_S);
    // The desired angle turns back by so many counts a squared period.
    let found = |side: i32, contact: Option<MotorContact<'_>>, back: f64| {
        let mut detector = RunawayDetector::new();
        (0..20).find(|tick| {
            let mut counts = [0; 6];
            counts[1] = side * tick * tick;
            let away = f64::from(side) * back * f64::from(tick * tick);
            let departure = alone(1, f64::from(counts[1]) + away);
            let found = detector.update(counts, departure, &load, contact);
            detector.command(alone(1, -0.3 * f64::from(side)));
            found.is_some()
        })
    };
    for side in [1, -1] {
        let free = found(side, None, 0.0).unwrap();
        let pushed = |to: f64, is_new: bool, back: f64| {
            let pushed_side: &dyn Fn(usize) -> f64 = &|i| if i == 1 { to } else { 0.0 };
            found(side, Some(MotorContact { pushed_side, is_new }), back)
        };
        let to = f64::from(side);
        for is_new in [true, false] {
            assert_eq!(pushed(-to, is_new, 0.0), Some(free), "it brakes the motor");
            assert_eq!(pushed(0.0, is_new, 0.0), Some(free), "it holds the motor in no direction");
        }
        assert_eq!(pushed(to, false, 0.0), Some(free), "no motor runs away more slowly for it");
        // Where the motor makes little more than half of the growth, the contact may carry it on.
        assert!(found(side, None, 0.8).is_some() && pushed(-to, false, 0.8).is_some());
        assert_eq!(pushed(to, false, 0.8), None);
        let away = pushed(to, true, 0.0).unwrap();
        let departed = |tick: i32| f64::from(tick * tick - (tick - 8) * (tick - 8));
        let due = PUSHED_FACTOR * load.departure_min()[1];
        assert!(away > free && departed(away) > due && departed(away - 1) <= due, "{away}");
    }
}

#[test]
fn a_motor_that_keeps_its_speed_while_its_desired_angle_turns_back_does_not_run_away() {
    let model = MotorModel::new(&Robot::puma260());
    let motion = Motion { q_rad: [0.0; 6], qd_rad_s: [0.0; 6], calibrated: true };
    let load = model.load(&motion, PERIOD_S);
    // The motor accelerates by this many counts a squared period; the desired angle turns back by
    // as much as that of a runaway would.
    let found = |acceleration: f64| {
        let mut detector = RunawayDetector::new();
        (0..9).find(|tick| {
            let t = f64::from(*tick);
            // The readings are rounded up and down by turns, as it happens.
            let rounded = 10.0 * t + 0.5 * acceleration * t * t + 0.4 * f64::from(*tick % 2);
            let mut counts = [0; 6];
            counts[1] = whole(rounded);
            let desired = -(8.0 - acceleration) * 0.5 * t * t;
            let departure = alone(1, f64::from(counts[1]) - desired);
            let found = detector.update(counts, departure, &load, None);
            detector.command(alone(1, -0.3));
            found.is_some()
        })
    };
    assert_eq!(found(0.0), None);
    assert_eq!(found(0.05), None);
    // What is touched may push it to that side, meanwhile.
    assert_eq!(found(2.0), None);
    assert!(found(8.0).is_some());
}

/// The nearest whole count.
#[expect(clippy::cast_possible_truncation, reason = "some hundred counts")]
fn whole(counts: f64) -> i32 {
    counts.round() as i32
}

#[test]
fn joint_by_joint_the_largest_torques_of_gravity_are_found_as_on_a_grid() {
    let robot = Robot::puma260();
    let (on_grid, ascended) = (on_grid_nm(&robot), ascended_nm(&robot));
    for motor in 0..6 {
        // The first axis is upright: gravity leaves it rounding alone.
        let (found, most) = (ascended[motor], on_grid[motor]);
        assert!(found <= most + 1e-12 && found >= 0.95 * most - 1e-12, "{motor}: {found} {most}");
    }
}
