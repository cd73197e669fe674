//! The law against a body of springs: each fingertip meets a wall at a given distance from the
//! middle.

use glam::{DMat3, DVec2};
use taktil_mechanics::Pose;
use taktil_mechanics::chain::{Chain, JointSpec};
use taktil_mechanics::hand::{ThreeFingers, ThreeFingersOnArm};
use taktil_mechanics::rigid_body::Body;
use taktil_mechanics::spatial::{rotation_z, to_nalgebra_vector};

use super::*;
use crate::config::Config;

/// Stiffness of a wall (N/m).
const WALL_N_M: f64 = 2000.0;
/// Period of the jobs (s).
const PERIOD_S: f64 = 2.5e-3;

/// The joints of a finger and its fingertip, palm frame.
fn finger_joints(azimuth_rad: f64) -> ([JointSpec; 3], Pose) {
    let base = rotation_z(azimuth_rad);
    let joint = |origin: Pose, axis: DVec3| JointSpec {
        origin,
        axis,
        body: Body::diagonal(0.05, [0.0, 0.0, -0.03], [1e-5; 3]),
        speed_max: 5.0,
        ..JointSpec::default()
    };
    let at = |z| Pose::new(DMat3::IDENTITY, DVec3::new(0.0, 0.0, z));
    let joints = [
        joint(Pose::new(base, base * DVec3::new(0.005, 0.0, 0.0)), DVec3::X),
        joint(at(0.0), DVec3::Y),
        joint(at(-0.065), DVec3::Y),
    ];
    let face = DMat3::from_cols(-DVec3::Y, DVec3::Z, -DVec3::X);
    (joints, Pose::new(face, DVec3::new(-0.008, 0.0, -0.05)))
}

fn finger(azimuth_rad: f64) -> Chain<3> {
    let (joints, tip) = finger_joints(azimuth_rad);
    Chain::new(&joints, &tip).unwrap()
}

fn hand() -> ThreeFingers {
    let third = core::f64::consts::TAU / 3.0;
    ThreeFingers::new([finger(0.0), finger(third), finger(2.0 * third)]).unwrap()
}

/// Joints with upright faces at this distance from the middle (m).
fn at_distance(distance_m: f64) -> JointVector<9> {
    let lean = libm::asin((distance_m + 0.003) / 0.065);
    JointVector::from_fn(|i, _| [0.0, -lean, lean][i % 3])
}

/// Walls around the middle, and a force that the object puts on the fingers in equal parts.
struct Walls {
    distance_m: [f64; 3],
    load: DVec3,
}

impl Walls {
    /// What a hand at its goal feels, and the torques of its motors. The walls and the load go with
    /// the palm.
    fn inputs<const N: usize>(&self, hand: &Hand<3, N>, q: &JointVector<N>) -> Inputs<3, N> {
        let mut torque_nm = hand.gravity_torque(q);
        let mut touch = [Touch::default(); 3];
        for (f, touch) in touch.iter_mut().enumerate() {
            let tip = hand.fingertip_in_palm(q, f);
            let normal = tip.pose.rotation.z_axis;
            let radius = tip.pose.translation.truncate().length();
            let load_n = WALL_N_M * (self.distance_m[f] - radius).max(0.0);
            *touch = Touch { load_n, middle_m: DVec2::ZERO, felt: load_n > 0.0 };
            if load_n > 0.0 {
                // The finger's force on the object balances a third of what the object bears.
                let force = normal * load_n - self.load / 3.0;
                let own = tip.linear.transpose() * to_nalgebra_vector(force);
                for i in 0..3 {
                    torque_nm[Hand::<3, N>::first_joint(f) + i] += own[i];
                }
            }
        }
        Inputs { q: *q, torque_nm, touch, dt_s: PERIOD_S }
    }
}

fn config(edit: impl FnOnce(&mut Config)) -> Config {
    let closing_deg_s = vec![0.0, 20.0, -20.0];
    let mut config = Config { squeeze_mm_n_s: 2.0, closing_deg_s, ..Config::default() };
    edit(&mut config);
    config
}

fn law(edit: impl FnOnce(&mut Config)) -> Law<3, 9> {
    Law::new(hand(), config(edit).tuning().unwrap(), &at_distance(0.035))
}

/// The same hand on an arm, and its joints with upright faces.
fn law_on_arm(edit: impl FnOnce(&mut Config)) -> Law<3, 15> {
    let axes = [DVec3::Z, DVec3::Y, DVec3::Y, DVec3::Z, DVec3::Y, DVec3::Z];
    let arm = axes.map(|axis| JointSpec {
        origin: Pose::new(DMat3::IDENTITY, DVec3::new(0.0, 0.0, 0.2)),
        axis,
        body: Body::diagonal(1.0, [0.0, 0.0, 0.1], [1e-2; 3]),
        speed_max: 3.0,
        ..JointSpec::default()
    });
    let third = core::f64::consts::TAU / 3.0;
    let fingers = [0.0, third, 2.0 * third].map(finger_joints);
    let palm = Pose::new(DMat3::IDENTITY, DVec3::new(0.0, 0.0, 0.1));
    let joints = fingers.map(|(joints, _)| joints);
    let tips = fingers.map(|(_, tip)| tip);
    let hand = ThreeFingersOnArm::on_arm(&arm, &palm, &joints, &tips).unwrap();
    let own = at_distance(0.035);
    let bent = [0.3, 0.4, 1.4, 0.2, 0.7, -0.4];
    let start = JointVector::from_fn(|i, _| if i < 6 { bent[i] } else { own[i - 6] });
    Law::new(hand, config(edit).tuning().unwrap(), &start)
}

/// Runs the law for a time against walls; the joints are where it wants them.
fn run<const N: usize>(law: &mut Law<3, N>, walls: &Walls, seconds: f64) {
    for _ in 0..(seconds / PERIOD_S).round() as usize {
        let inputs = walls.inputs(&law.hand, &law.goal);
        law.step(&inputs);
    }
}

fn walls(load: DVec3) -> Walls {
    Walls { distance_m: [0.025; 3], load }
}

#[test]
fn fingers_that_touch_wait_for_the_others() {
    let mut law = law(|_| ());
    let uneven = Walls { distance_m: [0.030, 0.025, 0.020], load: DVec3::ZERO };
    let mut closed = [None; 3];
    for job in 0..2000 {
        let before = law.goal;
        law.step(&uneven.inputs(&hand(), &before));
        if law.phase() == Phase::Holding {
            break;
        }
        for (f, closed) in closed.iter_mut().enumerate() {
            if law.touched[f] {
                let at = closed.get_or_insert((job, Hand::<3, 9>::finger_joints(&law.goal, f)));
                assert_eq!(Hand::<3, 9>::finger_joints(&law.goal, f), at.1);
            }
        }
    }
    assert_eq!(law.phase(), Phase::Holding);
    let jobs: Vec<usize> = closed.iter().flatten().map(|closed| closed.0).collect();
    assert!(jobs.windows(2).all(|pair| pair[0] < pair[1]), "{jobs:?}");
}

#[test]
fn without_anything_to_touch_the_hand_closes_to_its_limits_and_stays() {
    let mut law = law(|_| ());
    let far = Walls { distance_m: [-1.0; 3], load: DVec3::ZERO };
    run(&mut law, &far, 30.0);
    assert_eq!(law.phase(), Phase::Closing);
    assert!(hand().within_limits(&law.goal));
}

#[test]
fn the_grip_by_touch_becomes_the_one_that_is_wanted() {
    let mut law = law(|c| c.grip_min_n = 3.0);
    run(&mut law, &walls(DVec3::ZERO), 6.0);
    assert_eq!(law.phase(), Phase::Holding);
    for (force, margin) in law.forces().iter().zip(law.margins_n()) {
        assert!((force.normal_n - 3.0).abs() < 0.02, "{force:?}");
        assert!((margin - 0.6 * 3.0).abs() < 0.05, "{margin}");
    }
}

#[test]
fn the_grip_grows_with_the_tangential_force_and_falls_again() {
    let mut law = law(|_| ());
    run(&mut law, &walls(DVec3::ZERO), 4.0);
    run(&mut law, &walls(DVec3::new(0.0, 0.0, -6.0)), 4.0);
    // 2 N on each finger, over a coefficient of 0.6, times 1.5.
    let needed = 1.5 * 2.0 / 0.6;
    assert!((law.grip().0 - needed).abs() < 0.1, "{:?}", law.grip());
    assert!(law.margins_n().iter().all(|margin| *margin > 0.5), "{:?}", law.margins_n());
    run(&mut law, &walls(DVec3::ZERO), 8.0);
    assert!(law.grip().0 < 2.1, "{:?}", law.grip());
}

#[test]
fn beyond_the_strongest_grip_the_margin_is_negative() {
    let mut law = law(|_| ());
    run(&mut law, &walls(DVec3::ZERO), 4.0);
    run(&mut law, &walls(DVec3::new(0.0, 0.0, -18.0)), 4.0);
    assert!((law.grip().0 - 8.0).abs() < 1e-9);
    // 6 N on each finger where 0.6 x 8 N are borne.
    for margin in law.margins_n() {
        assert!((margin + 1.2).abs() < 0.1, "{margin}");
    }
}

#[test]
fn a_plan_moves_and_turns_the_fingertips_together() {
    let plan = Plan {
        after_s: 0.5,
        shift_m: DVec3::new(0.0, 0.0, 0.004),
        shift_m_s: 0.01,
        turn_rad: DVec3::new(0.0, 0.0, 0.1),
        turn_rad_s: 0.2,
    };
    assert_eq!(plan.at(0.2), (DVec3::ZERO, DVec3::ZERO));
    assert!((plan.at(0.7).0.z - 0.002).abs() < 1e-12 && (plan.at(9.0).0.z - 0.004).abs() < 1e-12);
    assert!((plan.at(0.75).1.z - 0.05).abs() < 1e-12);
    let mut law = law(|c| c.plan_after_s = 0.0);
    run(&mut law, &walls(DVec3::ZERO), 4.0);
    let place = |law: &Law<3, 9>| {
        core::array::from_fn::<_, 3, _>(|f| hand().fingertip(&law.goal, f).pose.translation)
    };
    let before = place(&law);
    (law.tuning.plan, law.tuning.correction_per_s) = (plan, 0.0);
    run(&mut law, &walls(DVec3::ZERO), 2.0);
    for (f, (before, after)) in before.iter().zip(place(&law)).enumerate() {
        let moved = after - *before;
        let turned = DVec3::new(0.0, 0.0, 0.1).cross(DVec3::new(before.x, before.y, 0.0));
        let asked = plan.shift_m + turned;
        assert!((moved - asked).length() < 4e-4, "{f}: {moved} {asked}");
    }
}

#[test]
fn the_object_is_brought_back_where_the_fingers_found_it() {
    // The hand sags by a millimetre: the goal goes up by it.
    let mut law = law(|_| ());
    run(&mut law, &walls(DVec3::ZERO), 3.0);
    let (reference, sag) = (law.reference.unwrap(), DVec3::new(0.0, 0.0, -1e-3));
    for _ in 0..2000 {
        let mut q = law.goal;
        for f in 0..3 {
            let tip = hand().fingertip(&law.goal, f);
            let step = joint_step(&tip, sag);
            for i in 0..3 {
                q[3 * f + i] += step[i];
            }
        }
        law.step(&walls(DVec3::ZERO).inputs(&hand(), &q));
    }
    // The damped step of the sag itself is a tenth short.
    assert!((law.shift_m - DVec3::new(0.0, 0.0, 1e-3)).length() < 1.5e-4, "{}", law.shift_m);
    assert!(reference.middle_m.z < -0.1);
}

#[test]
fn numbers_that_are_none_move_nothing_far() {
    let mut law = law(|_| ());
    run(&mut law, &walls(DVec3::ZERO), 3.0);
    let before = law.goal;
    let mut bad = walls(DVec3::ZERO).inputs(&hand(), &before);
    bad.torque_nm[4] = f64::NAN;
    bad.touch[1].load_n = f64::NAN;
    let goal = law.step(&bad);
    assert!(goal.iter().all(|q| q.is_finite()) && (goal - before).amax() < 0.05);
    run(&mut law, &walls(DVec3::ZERO), 3.0);
    assert!((law.forces()[0].normal_n - 2.0).abs() < 0.05, "{:?}", law.forces());
    assert!(law.margins_n().iter().all(|margin| margin.is_finite()));
}

#[test]
fn the_arm_moves_the_palm_as_planned_there_and_back_and_the_fingers_keep_their_grip() {
    let plan = |c: &mut Config| {
        (c.lift_after_s, c.lift_mm, c.lift_mm_s) = (2.0, [20.0, -10.0, 40.0], 80.0);
        (c.tilt_deg, c.tilt_deg_s, c.lift_back_after_s) = ([0.0, 10.0, 0.0], 60.0, Some(0.4));
    };
    let mut law = law_on_arm(plan);
    let start = law.hand.tool_pose(&law.goal);
    run(&mut law, &walls(DVec3::ZERO), 0.2);
    while law.grip().2 < 1.9 {
        run(&mut law, &walls(DVec3::ZERO), PERIOD_S);
    }
    let held = law.goal;
    assert!((held - law.start).rows(0, 6).amax() == 0.0, "the arm stands while the hand closes");
    let (mut farthest, mut fastest, mut before) = (0.0_f64, 0.0_f64, start);
    let way_s = law.tuning.palm.way_s();
    let length_m = libm::sqrt(0.0021);
    assert!((way_s - 1.875 * length_m / 0.08).abs() < 1e-12, "{way_s}");
    while law.grip().2 < 2.0 + 2.0 * way_s + 0.4 + 0.1 {
        run(&mut law, &walls(DVec3::ZERO), PERIOD_S);
        let now = law.hand.tool_pose(&law.goal);
        farthest = farthest.max((now.translation - start.translation).length());
        fastest = fastest.max((now.translation - before.translation).length() / PERIOD_S);
        before = now;
        let stays = law.grip().2 - 2.0 - way_s;
        if (0.05..0.35).contains(&stays) {
            let turned = rotation_from_vector(DVec3::Y * 10_f64.to_radians()) * start.rotation;
            let off_rad = taktil_mechanics::spatial::rotation_vector(&turned, &now.rotation);
            assert!(off_rad.length() < 1e-7, "{off_rad} {}", law.is_palm_refused());
        }
        // The walls move with the palm: nothing changes between the fingers.
        for force in law.forces() {
            assert!((force.normal_n - 2.0).abs() < 0.1 && force.tangential.length() < 0.02);
        }
    }
    assert!((farthest - length_m).abs() < 1e-9 && (fastest - 0.08).abs() < 1e-3, "{fastest}");
    assert!((before.translation - start.translation).length() < 1e-9);
    assert!(!law.is_palm_refused());
}

#[test]
fn a_palm_that_is_to_go_out_of_reach_stops_there_and_the_fingers_hold() {
    let mut law = law_on_arm(|c| (c.lift_mm, c.lift_mm_s) = ([0.0, 0.0, 900.0], 400.0));
    let (mut before, mut braking) = ([law.goal; 2], 0.0_f64);
    for _ in 0..4000 {
        run(&mut law, &walls(DVec3::ZERO), PERIOD_S);
        let change = law.goal - before[1] * 2.0 + before[0];
        if law.is_palm_refused() {
            braking = braking.max(change.rows(0, 6).amax() / (PERIOD_S * PERIOD_S));
        }
        before = [before[1], law.goal];
    }
    assert!(law.is_palm_refused() && law.phase() == Phase::Holding);
    // It brakes at the joints' limit, 1 rad/s^2, and does not stop at once.
    assert!((braking - 1.0).abs() < 1e-6, "{braking}");
    let stopped = law.goal;
    run(&mut law, &walls(DVec3::ZERO), 1.0);
    assert!((law.goal - stopped).rows(0, 6).amax() == 0.0);
    assert!((law.forces()[0].normal_n - 2.0).abs() < 0.1, "{:?}", law.forces());
}

#[test]
fn fingers_open_to_where_they_began_after_their_time() {
    let mut law = law(|c| c.open_after_s = Some(1.0));
    run(&mut law, &walls(DVec3::ZERO), 1.0);
    assert_eq!(law.phase(), Phase::Holding);
    run(&mut law, &walls(DVec3::ZERO), 3.0);
    assert_eq!(law.phase(), Phase::Opening);
    assert!((law.goal - at_distance(0.035)).amax() < 1e-12, "{}", law.goal);
}

/// Runs the law with an arm at `q` (rad) whose joints friction stops at this distance from their
/// goals (rad), until the palm has been at the end of its path for some time (s).
fn run_with_friction(
    law: &mut Law<3, 15>,
    q: &mut JointVector<15>,
    friction_rad: f64,
    stays_s: f64,
) {
    while law.grip().2 < law.tuning.palm.after_s + law.tuning.palm.way_s() + stays_s {
        for joint in 0..6 {
            let goal = law.goal[joint];
            q[joint] = q[joint].clamp(goal - friction_rad, goal + friction_rad);
        }
        for joint in 6..15 {
            q[joint] = law.goal[joint];
        }
        law.step(&walls(DVec3::ZERO).inputs(&law.hand, q));
    }
}

#[test]
fn friction_that_stops_the_arm_short_is_integrated_away_within_bounds() {
    let lift = |rate: f64| {
        move |c: &mut Config| {
            (c.lift_after_s, c.lift_mm, c.lift_mm_s) = (0.5, [20.0, -10.0, 40.0], 80.0);
            c.lift_correction_per_s = rate;
        }
    };
    let error_rad = |law: &Law<3, 15>, q: &JointVector<15>| {
        (law.palm.unwrap().follower.joints() - q).rows(0, 6).amax()
    };
    let mut without = law_on_arm(lift(0.0));
    let mut q = without.goal;
    run_with_friction(&mut without, &mut q, 2e-3, 2.0);
    assert!((error_rad(&without, &q) - 2e-3).abs() < 1e-6);
    let mut with = law_on_arm(lift(4.0));
    let mut q = with.goal;
    run_with_friction(&mut with, &mut q, 2e-3, 2.0);
    assert!(error_rad(&with, &q) <= ARM_DEAD_ZONE_RAD, "{}", error_rad(&with, &q));
    // A jammed gear: the goal goes no farther than the bound.
    let mut jammed = law_on_arm(lift(4.0));
    let mut q = jammed.goal;
    run_with_friction(&mut jammed, &mut q, 0.1, 60.0);
    let most = jammed.palm.unwrap().correction_rad.amax();
    assert!((most - ARM_CORRECTION_MAX_RAD).abs() < 1e-12, "{most}");
    assert!(jammed.goal.iter().all(|q| q.is_finite()));
}

#[test]
fn the_arms_correction_rests_on_the_way_and_fades_on_the_way_back() {
    let mut law = law_on_arm(|c| {
        (c.lift_after_s, c.lift_mm, c.lift_mm_s) = (0.5, [0.0, 0.0, 40.0], 80.0);
        c.lift_back_after_s = Some(1.0);
    });
    let (way_s, mut q) = (law.tuning.palm.way_s(), law.goal);
    run_with_friction(&mut law, &mut q, 2e-3, -0.01);
    assert_eq!(law.palm.unwrap().correction_rad.amax(), 0.0, "on the way");
    run_with_friction(&mut law, &mut q, 2e-3, 1.0 + 0.5 * way_s);
    let palm = law.palm.unwrap();
    let share = (law.goal - palm.follower.joints()).rows(0, 6).amax() / palm.correction_rad.amax();
    assert!(palm.correction_rad.amax() > 1e-3 && (share - 0.5).abs() < 0.02, "{share}");
    run_with_friction(&mut law, &mut q, 2e-3, 1.0 + way_s + 1.0);
    let palm = law.palm.unwrap();
    assert_eq!((law.goal - palm.follower.joints()).rows(0, 6).amax(), 0.0);
}
