//! Tests following of tool paths, as planning uses it: the arm stays on the path, within its limits
//! and speeds, or the error names the joint at fault.

use crate::example_arms::{Lcg, puma, seven, ur5e_like};
use glam::DVec3;
use taktil_mechanics::Pose;
use taktil_mechanics::arm::{Arm, FollowError, PathFollower};
use taktil_mechanics::chain::Chain;
use taktil_mechanics::feasibility::{FeasibilityCriteria, FeasibilityReport, Infeasible};
use taktil_mechanics::paul::JointPath;
use taktil_mechanics::paul::cartesian::{Blend, CartesianPath};
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::spatial::JointVector;
use taktil_mechanics::tracking::PathRef;
use taktil_mechanics::transmission::Transmission;

fn six_joint_start() -> JointVector<6> {
    JointVector::<6>::new(0.2, -1.3, 1.6, -1.9, -1.5, 0.4)
}

fn seven_joint_start() -> JointVector<7> {
    JointVector::from([0.1, -0.4, 0.2, -2.0, 0.1, 1.7, 0.5])
}

fn terms<const N: usize>(arm: Chain<N>) -> FeasibilityCriteria<N, Chain<N>> {
    FeasibilityCriteria {
        arm,
        dynamics: arm,
        torque_max_nm: JointVector::repeat(f64::INFINITY),
        position_error_max_m: 1e-3,
        orientation_error_max_rad: 1e-3,
        tick_s: 0.0025,
    }
}

/// A line of the tool by `way` (base, m) in `t_s`.
fn line<const N: usize>(arm: &Chain<N>, q: &JointVector<N>, way: DVec3, t_s: f64) -> CartesianPath {
    let here = arm.tool_pose(q);
    let there = Pose::new(here.rotation, here.translation + way);
    CartesianPath::new(&[here, there], &[t_s], 0.1, Blend::Smooth).unwrap()
}

fn stays_on_the_line<const N: usize>(arm: Chain<N>, q: JointVector<N>) {
    let path = line(&arm, &q, DVec3::new(0.05, 0.08, 0.06), 1.0);
    let preview = FeasibilityReport::of(PathRef::Cartesian(&path), &q, &terms(arm)).unwrap();
    assert!(
        preview.position_error_m.value < 1e-9 && preview.orientation_error_rad.value < 1e-9,
        "{preview:?}"
    );
    let end = arm.tool_pose(&preview.end_q).translation;
    assert!((end - path.points()[1].translation).length() < 1e-9, "{end}");
    assert!(
        preview.speed_ratio.iter().all(|peak| peak.value > 0.0 && peak.value < 0.9),
        "{preview:?}"
    );
}

#[test]
fn lines_are_followed_to_rounding() {
    stays_on_the_line(ur5e_like(), six_joint_start());
    stays_on_the_line(seven(), seven_joint_start());
}

#[test]
fn what_an_arm_cannot_follow_names_the_joint() {
    let (arm, q) = (seven(), seven_joint_start());
    let terms = terms(arm);
    // Ten times as fast as the arm is.
    let hasty = line(&arm, &q, DVec3::new(0.0, 0.4, 0.0), 0.2);
    let refused = FeasibilityReport::of(PathRef::Cartesian(&hasty), &q, &terms).unwrap_err();
    let Infeasible::NotFollowed { error: FollowError::SpeedLimit { joint, ratio }, t_s } = refused
    else {
        panic!("{refused}")
    };
    assert!(joint < 7 && ratio > 1.0 && t_s > 0.0, "{refused}");
    // Out of reach, or on the way there at a limit.
    let far = line(&arm, &q, DVec3::new(2.0, 0.0, 0.0), 20.0);
    let refused = FeasibilityReport::of(PathRef::Cartesian(&far), &q, &terms).unwrap_err();
    assert!(
        matches!(refused, Infeasible::NotFollowed { .. } | Infeasible::PathDeviation { .. }),
        "{refused}"
    );
    // A joint beyond its limit by the joints' own motion.
    let mut over = q;
    over[3] = 0.2;
    let path = JointPath::new(&[q, over], &[4.0], 0.1).unwrap();
    let refused = FeasibilityReport::of(PathRef::Joint(&path), &q, &terms).unwrap_err();
    let Infeasible::NotFollowed { error: why, .. } = refused else { panic!("{refused}") };
    assert_eq!(why, FollowError::JointLimit { joint: 3 });
    // The drives are too weak.
    let weak = FeasibilityCriteria { torque_max_nm: JointVector::repeat(1.0), ..terms };
    let slow = line(&arm, &q, DVec3::new(0.0, 0.1, 0.0), 2.0);
    let refused = FeasibilityReport::of(PathRef::Cartesian(&slow), &q, &weak).unwrap_err();
    assert!(matches!(refused, Infeasible::Torque { ratio, .. } if ratio > 1.0), "{refused}");
}

#[test]
fn a_follower_that_is_lost_stays_where_it_was() {
    let arm = ur5e_like();
    let mut follower = arm.follower(&six_joint_start());
    let here = arm.tool_pose(&six_joint_start());
    let bad = [
        Pose::new(here.rotation, DVec3::splat(9.0)),
        Pose::new(here.rotation, DVec3::splat(f64::NAN)),
        Pose::new(here.rotation * f64::INFINITY, here.translation),
        Pose::new(here.rotation, here.translation + DVec3::new(0.2, 0.0, 0.0)),
    ];
    for pose in bad {
        assert!(follower.step(&pose, 0.0025).is_err(), "{pose:?}");
        assert_eq!(follower.joints(), &six_joint_start());
    }
    for dt_s in [0.0, f64::NAN] {
        let aside = Pose::new(here.rotation, here.translation + DVec3::new(1e-4, 0.0, 0.0));
        let _ = follower.step(&aside, dt_s);
        assert!(follower.joints().iter().all(|q| q.is_finite()));
    }
}

#[test]
fn an_arm_jogged_outward_stops_at_the_end_of_its_reach() {
    let arm = ur5e_like();
    for way in [DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::new(0.6, 0.0, 0.8)] {
        let mut follower = arm.follower(&six_joint_start());
        // As a jog does it: from where the arm came to, a little further, at 0.1 m/s for a minute.
        let stuck = (0..24_000).find(|_| {
            let here = arm.tool_pose(follower.joints());
            let next = Pose::new(here.rotation, here.translation + way * 2.5e-4);
            follower.step(&next, 0.0025).is_err()
        });
        let stuck = stuck.unwrap_or_else(|| panic!("{way}: it goes on for ever"));
        assert!(stuck < 24_000 && arm.tool_pose(follower.joints()).is_finite());
    }
}

#[test]
fn poses_are_reached_near_where_the_arm_is_or_not_at_all() {
    let arm = ur5e_like();
    let mut lcg = Lcg(5);
    let mut found = 0;
    for _ in 0..200 {
        let q = six_joint_start() + lcg.vector::<6>(0.3);
        let pose = arm.tool_pose(&q);
        assert!(arm.is_within_reach_bound(&pose) && arm.is_reachable(&pose));
        if let Some(got) = arm.inverse_kinematics_near(&pose, &six_joint_start()) {
            found += 1;
            assert!(arm.within_limits(&got));
            let off = arm.tool_pose(&got).translation - pose.translation;
            assert!(off.length() < 1e-9);
        }
    }
    assert!(found >= 198, "{found} of 200");
    let far = Pose::new(glam::DMat3::IDENTITY, DVec3::new(3.0, 0.0, 0.0));
    assert!(
        !arm.is_within_reach_bound(&far)
            && !arm.is_reachable(&far)
            && arm.inverse_kinematics_near(&far, &six_joint_start()).is_none()
    );
    let lost = Pose::new(glam::DMat3::IDENTITY, DVec3::splat(f64::NAN));
    assert!(!arm.is_within_reach_bound(&lost) && !arm.is_reachable(&lost));
}

#[test]
fn the_puma_by_its_rows_is_the_puma_to_planning() {
    let (chain, own) = (puma(), Puma260::reference());
    let mut lcg = Lcg(7);
    for _ in 0..200 {
        let q = lcg.inside(&chain);
        for (a, b) in chain.singularity_distances(&q).iter().zip(own.singularity_distances(&q)) {
            assert!((a - b).abs() < 1e-12, "{a} {b}");
        }
        assert_eq!(chain.within_limits(&q), Arm::within_limits(&own, &q));
    }
    let slow = Arm::with_speed_max(&chain, &JointVector::repeat(0.1));
    assert_eq!(Arm::speed_max(&slow), &JointVector::<6>::repeat(0.1));
    assert_eq!(
        Arm::remaining_travel(&chain, 0, &JointVector::zeros(), &JointVector::repeat(1.0)),
        own.q_max_rad[0]
    );
    assert_eq!(
        Arm::remaining_travel(&chain, 0, &JointVector::repeat(9.0), &JointVector::repeat(10.0)),
        0.0
    );
}

#[test]
fn gears_without_coupling_count_there_and_back() {
    let ratio = JointVector::from([100.0, -50.0, 30.0, 120.0, 80.0, -101.0, 7.0]);
    let gears = Transmission::uncoupled(&ratio, &JointVector::repeat(4096.0));
    let counts = [1000, -2000, 3, 40_000, 0, 77, -5];
    assert_eq!(gears.counts(&gears.joints(&counts)), counts);
    let q = gears.joints(&[4096, 4096, 4096, 4096, 4096, 4096, 4096]);
    assert!((q[0] - core::f64::consts::TAU / 100.0).abs() < 1e-15 && q[1] < 0.0);
    let motor = gears.motor_torque(&JointVector::repeat(1.0));
    assert!((gears.joint_torque(&motor) - JointVector::repeat(1.0)).amax() < 1e-15);
}
