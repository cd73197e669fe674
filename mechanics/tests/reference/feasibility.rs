//! Tests following tool paths past the wrist singularity, and the check of whole moves before they
//! start.

use glam::DVec3;
use taktil_mechanics::arm::FollowError;
use taktil_mechanics::feasibility::{
    FeasibilityCheck, FeasibilityCriteria, FeasibilityReport, FeasibilityStatus, Infeasible,
};
use taktil_mechanics::paul::JointPath;
use taktil_mechanics::paul::cartesian::{Blend, CartesianPath};
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::puma260::dynamics::Dynamics;
use taktil_mechanics::puma260::follower::Follower;
use taktil_mechanics::spatial::{rotation_about, rotation_y};
use taktil_mechanics::tracking::{PathRef, PathTracker, SETTLING_TIME_MAX_S};
use taktil_mechanics::transmission::{Drive, Transmission};
use taktil_mechanics::{Joints, Pose};

const TICK_S: f64 = 0.0025;

fn terms() -> FeasibilityCriteria {
    FeasibilityCriteria {
        arm: Puma260::reference(),
        dynamics: Dynamics::reference(),
        torque_max_nm: Drive::reference().peak_joint_torque(&Transmission::reference()),
        position_error_max_m: 0.03,
        orientation_error_max_rad: 0.15,
        tick_s: TICK_S,
    }
}

fn degrees(q: [f64; 6]) -> Joints {
    Joints::from(q.map(f64::to_radians))
}

/// A pose in mid range whose wrist is mid_range_joints by 40 degrees.
fn mid_range_joints() -> Joints {
    degrees([10.0, 40.0, -150.0, 20.0, 40.0, 10.0])
}

/// A line that leads the approach axis past the forearm's at an angle of `miss_rad`, from theta5 of
/// about -40 to about 40 degrees.
fn past_the_singularity(arm: &Puma260, miss_rad: f64, t_s: f64) -> (CartesianPath, Joints) {
    let straight = degrees([10.0, 40.0, -150.0, 0.0, 0.0, 30.0]);
    let middle = arm.wrist_pose(&straight);
    let axis = middle.rotation * DVec3::new(0.6, 0.8, 0.0);
    let across = middle.rotation.z_axis.cross(axis);
    let tilted = rotation_about(across, miss_rad) * middle.rotation;
    let tool = DVec3::Z * arm.tool_z_m;
    let at = |angle: f64| {
        let rotation = rotation_about(axis, angle) * tilted;
        Pose::new(rotation, middle.translation + rotation * tool)
    };
    let span = 40.0f64.to_radians();
    let points = [at(-span), at(0.0), at(span)];
    let path = CartesianPath::new(&points, &[t_s, t_s], 0.1, Blend::So3).unwrap();
    let branches = arm.inverse_kinematics(&arm.tool_to_wrist(&points[0]), None);
    let start = arm.nearest_branch(&branches, &straight).unwrap().1;
    (path, start)
}

#[test]
fn away_from_the_singularity_following_is_the_inverse() {
    let arm = Puma260::reference();
    let here = arm.tool_pose(&mid_range_joints());
    let there = Pose::new(
        rotation_y(-0.2) * here.rotation,
        here.translation + DVec3::new(0.02, -0.03, 0.01),
    );
    let path = CartesianPath::new(&[here, there], &[1.0], 0.1, Blend::Smooth).unwrap();
    let mut follower = Follower::new(&arm, &mid_range_joints());
    for tick in 0..500 {
        let pose = path.at(f64::from(tick) * TICK_S).pose;
        let got = follower.step(&pose, TICK_S).unwrap();
        assert_eq!((got.position_error_m, got.orientation_error_rad), (0.0, 0.0));
        let reached = arm.tool_pose(&got.q);
        assert!((reached.translation - pose.translation).length() < 1e-14);
        assert!(reached.rotation.abs_diff_eq(pose.rotation, 1e-14));
    }
}

#[test]
fn a_line_past_the_wrist_singularity_keeps_every_joint_within_its_speed() {
    let terms = terms();
    let mut worst = 0.0f64;
    for miss in [0.0, 1e-12, 1e-9, 1e-6, 1e-4, 1e-3, 0.01, 0.03, 0.1, 0.15, 0.2, 0.3] {
        let (path, start) = past_the_singularity(&terms.arm, miss, 0.8);
        let preview = FeasibilityReport::of(PathRef::Cartesian(&path), &start, &terms)
            .unwrap_or_else(|refusal| panic!("miss {miss}: {refusal}"));
        for joint in preview.speed_ratio {
            assert!(joint.value <= 1.0 + 1e-9, "miss {miss}: {preview:?}");
        }
        // What is missed is the angle by which the path misses the singularity, never more than
        // half of the rate (0.87 rad/s) over the speed of joint 4 (3.6 rad/s).
        let bound = (1.05 * miss + 1e-3).min(0.12);
        assert!(
            preview.orientation_error_rad.value <= bound,
            "miss {miss}: {:?}",
            preview.orientation_error_rad
        );
        assert!(
            preview.position_error_m.value <= 0.2 * preview.orientation_error_rad.value + 1e-12,
            "about the wrist"
        );
        assert!(preview.singularity[2].value <= miss + 0.02, "{:?}", preview.singularity);
        // At the end it is back on the path.
        let end = terms.arm.tool_pose(&preview.end_q);
        assert!(end.rotation.abs_diff_eq(path.points()[2].rotation, 1e-9), "miss {miss}");
        worst = worst.max(preview.orientation_error_rad.value);
        if miss >= 0.3 {
            assert_eq!(
                preview.orientation_error_rad.value, 0.0,
                "far enough away nothing is missed"
            );
        }
    }
    assert!(worst > 0.05, "the case is hard: somewhere the path cannot be met, {worst}");
}

#[test]
fn straight_through_the_singularity_joint_5_changes_its_sign_and_nothing_is_missed() {
    let arm = Puma260::reference();
    let straight = degrees([10.0, 40.0, -150.0, 35.0, 0.0, -5.0]);
    let bent_by = |angle: f64| {
        let mut q = straight;
        q[4] = angle;
        q
    };
    let mut follower = Follower::new(&arm, &bent_by(-0.5));
    for tick in 0..=400 {
        let angle = -0.5 + f64::from(tick) / 400.0;
        let pose = arm.tool_pose(&bent_by(angle));
        let got = follower.step(&pose, TICK_S).unwrap();
        assert!(got.orientation_error_rad < 1e-9 && got.position_error_m < 1e-9, "{tick}: {got:?}");
        assert!((got.q[3] - straight[3]).abs() < 1e-6, "joint 4 need not move: {got:?}");
        assert!((got.q[4] - angle).abs() < 1e-6, "{tick}: {got:?}");
    }
}

#[test]
fn a_move_that_would_miss_its_path_by_too_much_is_refused() {
    let strict = FeasibilityCriteria { orientation_error_max_rad: 1e-4, ..terms() };
    let (path, start) = past_the_singularity(&strict.arm, 0.03, 0.8);
    let refusal = FeasibilityReport::of(PathRef::Cartesian(&path), &start, &strict).unwrap_err();
    let Infeasible::PathDeviation { orientation_error_rad: off_rad, t_s, .. } = refusal else {
        panic!("{refusal}")
    };
    assert!(off_rad > 1e-4 && t_s > 0.3 && t_s < 1.2, "{refusal}");
    assert!(refusal.to_string().contains("wrist singularity"));
}

#[test]
fn a_move_that_must_cross_a_limit_names_joint_and_time() {
    let terms = terms();
    let arm = &terms.arm;
    // About the vertical through the base, beyond what joint 1 can turn.
    let start = degrees([140.0, 40.0, -150.0, 20.0, 40.0, 10.0]);
    let here = arm.tool_pose(&start);
    let around = |angle: f64| {
        let turn = rotation_about(DVec3::Z, angle);
        Pose::new(turn * here.rotation, turn * here.translation)
    };
    let points: Vec<Pose> = (0..=8).map(|n| around(0.08 * f64::from(n))).collect();
    let path = CartesianPath::new(&points, &[0.5; 8], 0.1, Blend::So3).unwrap();
    let refusal = FeasibilityReport::of(PathRef::Cartesian(&path), &start, &terms).unwrap_err();
    let Infeasible::NotFollowed { error: FollowError::JointLimit { joint: 0 }, t_s } = refusal
    else {
        panic!("{refusal}")
    };
    // 19 degrees further at about 0.16 rad/s.
    assert!((t_s - 2.17).abs() < 0.1, "{t_s}");
    assert!(refusal.to_string().contains("joint 1"), "{refusal}");
}

#[test]
fn what_is_out_of_reach_too_fast_too_heavy_or_elsewhere_is_refused() {
    let terms = terms();
    let here = terms.arm.tool_pose(&mid_range_joints());
    let line = |dx: f64, t_s: f64| {
        let to = Pose::new(here.rotation, here.translation + DVec3::new(dx, 0.0, 0.0));
        CartesianPath::new(&[here, to], &[t_s], 0.1, Blend::So3).unwrap()
    };
    let of = |path: &CartesianPath| {
        FeasibilityReport::of(PathRef::Cartesian(path), &mid_range_joints(), &terms).unwrap_err()
    };
    // Stretching, the elbow would have to be infinitely fast just before the end of its reach.
    let stretched = of(&line(0.8, 5.0));
    let fits = |why: &FollowError| {
        matches!(why, FollowError::OutOfReach | FollowError::SpeedLimit { joint: 1 | 2, .. })
    };
    assert!(
        matches!(&stretched, Infeasible::NotFollowed { error: why, .. } if fits(why)),
        "{stretched}"
    );
    let hasty = of(&line(0.05, 0.2));
    assert!(
        matches!(
            hasty,
            Infeasible::Torque { .. }
                | Infeasible::NotFollowed { error: FollowError::SpeedLimit { .. }, .. }
        ),
        "{hasty}"
    );
    let weak = FeasibilityCriteria { torque_max_nm: terms.torque_max_nm * 1e-3, ..terms.clone() };
    let refusal =
        FeasibilityReport::of(PathRef::Cartesian(&line(0.01, 1.0)), &mid_range_joints(), &weak)
            .unwrap_err();
    assert!(matches!(refusal, Infeasible::Torque { .. }), "{refusal}");
    let elsewhere =
        FeasibilityReport::of(PathRef::Cartesian(&line(0.01, 1.0)), &degrees([0.0; 6]), &terms)
            .unwrap_err();
    assert!(matches!(elsewhere, Infeasible::StartMismatch { distance: off } if off > 0.01));
    for tick_s in [0.0, -1.0, f64::NAN, 1e-12] {
        let bad = FeasibilityCriteria { tick_s, ..terms.clone() };
        let refused =
            FeasibilityReport::of(PathRef::Cartesian(&line(0.01, 1.0)), &mid_range_joints(), &bad);
        assert_eq!(refused, Err(Infeasible::InvalidTick), "{tick_s}");
    }
    let nan = FeasibilityReport::of(
        PathRef::Cartesian(&line(0.01, 1.0)),
        &Joints::repeat(f64::NAN),
        &terms,
    );
    assert!(matches!(nan, Err(Infeasible::StartMismatch { .. })));
}

#[test]
fn joint_moves_are_looked_at_too() {
    let terms = terms();
    let there = mid_range_joints() + degrees([20.0, 10.0, -15.0, 30.0, -20.0, 40.0]);
    let path = JointPath::new(&[mid_range_joints(), there], &[1.0], 0.2).unwrap();
    let preview =
        FeasibilityReport::of(PathRef::Joint(&path), &mid_range_joints(), &terms).unwrap();
    assert!((preview.end_q - there).amax() < 1e-15);
    let wanted = path.peak_speed();
    for joint in 0..6 {
        let share = wanted[joint] / terms.arm.speed_max_rad_s[joint];
        assert!((preview.speed_ratio[joint].value - share).abs() < 1e-12);
        assert!(preview.torque_ratio[joint].value > 0.0);
    }
    assert_eq!((preview.position_error_m.value, preview.orientation_error_rad.value), (0.0, 0.0));
    let far = JointPath::new(
        &[mid_range_joints(), degrees([200.0, 0.0, 0.0, 0.0, 0.0, 0.0])],
        &[4.0],
        0.2,
    );
    let refusal = FeasibilityReport::of(PathRef::Joint(&far.unwrap()), &mid_range_joints(), &terms)
        .unwrap_err();
    assert!(
        matches!(
            refusal,
            Infeasible::NotFollowed { error: FollowError::JointLimit { joint: 0 }, .. }
        ),
        "{refusal}"
    );
    let elsewhere = FeasibilityReport::of(PathRef::Joint(&path), &there, &terms).unwrap_err();
    assert!(matches!(elsewhere, Infeasible::StartMismatch { .. }));
}

#[test]
fn the_branch_is_kept_and_nan_is_out_of_reach() {
    let arm = Puma260::reference();
    let mut follower = Follower::new(&arm, &mid_range_joints());
    let mut pose = arm.tool_pose(&mid_range_joints());
    pose.translation.x = f64::NAN;
    assert_eq!(follower.step(&pose, TICK_S), Err(FollowError::OutOfReach));
    assert_eq!(follower.joints(), &mid_range_joints(), "nothing moved");
    // A jump of the target is too fast, not another branch.
    let other = arm.tool_pose(&degrees([60.0, 40.0, -150.0, 20.0, 40.0, 10.0]));
    assert!(matches!(follower.step(&other, TICK_S), Err(FollowError::SpeedLimit { joint: 0, .. })));
}

#[test]
fn checking_in_pieces_gives_the_same_verdict() {
    let terms = terms();
    let (path, start) = past_the_singularity(&terms.arm, 0.03, 0.8);
    let route = PathRef::Cartesian(&path);
    let whole = FeasibilityReport::of(route, &start, &terms).unwrap();
    let mut inspection = FeasibilityCheck::new(route, &start, &terms).unwrap();
    let mut pieces = 0;
    let verdict = loop {
        match inspection.advance(7, route, &terms) {
            FeasibilityStatus::InProgress => pieces += 1,
            verdict => break verdict,
        }
    };
    assert_eq!((verdict, inspection.report()), (FeasibilityStatus::Feasible, &whole));
    assert_eq!(pieces, (720 + 8) / 7);
}

/// A line of the tool past the singularity that ends 0.1 s after it.
fn ending_beside_it(arm: &Puma260) -> (CartesianPath, Joints) {
    let start = degrees([-10.0, 30.0, -150.0, 50.0, 30.0, -10.0]);
    let here = arm.tool_pose(&start);
    let turn = rotation_about(DVec3::X, 0.3);
    let goal = Pose::new(turn * here.rotation, here.translation + DVec3::new(0.02, 0.01, 0.03));
    (CartesianPath::new(&[here, goal], &[0.4], 0.1, Blend::Smooth).unwrap(), start)
}

#[test]
fn a_move_takes_until_the_arm_rests_on_its_goal() {
    let terms = terms();
    let (path, start) = ending_beside_it(&terms.arm);
    let preview = FeasibilityReport::of(PathRef::Cartesian(&path), &start, &terms).unwrap();
    assert!((preview.settling_s - 0.2).abs() < 0.01, "{preview:?}");
    assert_eq!(preview.duration_s, path.duration_s() + preview.settling_s);
    let end = terms.arm.tool_pose(&preview.end_q);
    assert!((end.translation - path.points()[1].translation).length() < 1e-12);
    assert!(end.rotation.abs_diff_eq(path.points()[1].rotation, 1e-12));
    // The tracker by itself gives the same joints tick by tick.
    let mut lead = PathTracker::new(&terms.arm, &start);
    let mut tick = 0;
    let led = loop {
        tick += 1;
        let t_s = f64::from(tick) * TICK_S;
        let led = lead.step(&terms.arm, PathRef::Cartesian(&path), t_s, TICK_S).unwrap();
        if led.is_finished {
            break led;
        }
    };
    assert_eq!((led.setpoint.q, led.settling_s), (preview.end_q, preview.settling_s));
    // A path that stays away from the singularity takes its own time.
    let (path, start) = past_the_singularity(&terms.arm, 0.3, 0.8);
    let preview = FeasibilityReport::of(PathRef::Cartesian(&path), &start, &terms).unwrap();
    assert_eq!((preview.settling_s, preview.duration_s), (0.0, path.duration_s()));
}

#[test]
fn an_arm_that_would_not_get_to_its_goal_in_time_is_refused_with_the_joint() {
    let mut terms = FeasibilityCriteria {
        position_error_max_m: 1.0,
        orientation_error_max_rad: 3.0,
        ..terms()
    };
    terms.arm.speed_max_rad_s[3] = 0.3;
    let (path, start) = ending_beside_it(&terms.arm);
    let refusal = FeasibilityReport::of(PathRef::Cartesian(&path), &start, &terms).unwrap_err();
    let Infeasible::NotFollowed { error: FollowError::NotSettled { joint }, t_s } = refusal else {
        panic!("{refusal}")
    };
    assert!(
        joint == 3 && (t_s - path.duration_s() - SETTLING_TIME_MAX_S).abs() < 0.01,
        "{refusal}"
    );
    assert!(refusal.to_string().contains("joint 4 would still be short of the goal"), "{refusal}");
}
