//! Tests the closed-form inverse kinematics: every branch of the reference data, many random
//! joints, and poses at and beside singularities.

use crate::lcg::Lcg;
use crate::table::rows;
use core::f64::consts::{FRAC_PI_2, PI};
use glam::{DMat3, DVec3};
use taktil_mechanics::puma260::{ELBOW_SINGULAR, Puma260, SHOULDER_SINGULAR, WRIST_SINGULAR};
use taktil_mechanics::spatial::wrap_angle;
use taktil_mechanics::{Joints, Pose};

fn apart(a: &Joints, b: &Joints) -> f64 {
    (a - b).map(wrap_angle).amax()
}

/// Position (m) and rotation (entries) by which joints miss a pose.
fn miss(arm: &Puma260, q: &Joints, pose: &Pose) -> (f64, f64) {
    let got = arm.wrist_pose(q);
    let off = (got.rotation - pose.rotation).to_cols_array();
    ((got.translation - pose.translation).length(), off.iter().fold(0.0, |m, x| m.max(x.abs())))
}

#[test]
fn every_branch_of_the_reference_is_found() {
    let arm = Puma260::reference();
    let branches = rows("kinematics/ik_branches.csv");
    assert_eq!(branches.len(), 800);
    for (index, row) in rows("kinematics/ik_poses.csv").iter().enumerate() {
        let pose = row.pose();
        let got = arm.inverse_kinematics(&pose, None);
        assert_eq!(got.len(), 8);
        assert_eq!(
            got.iter().filter(|b| b.in_limits).count(),
            row.word("n_in_limits").parse().unwrap()
        );
        for want in &branches[8 * index..8 * index + 8] {
            assert_eq!(want.word("pose_id"), row.word("pose_id"));
            let branch = got
                .iter()
                .find(|b| {
                    f64::from(b.shoulder) == want.num("shoulder")
                        && f64::from(b.elbow) == want.num("elbow")
                        && f64::from(b.wrist) == want.num("wrist")
                })
                .unwrap();
            let error = apart(&branch.q, &want.joints("q"));
            assert!(error < 1e-11, "pose {index}: {error:e}");
            assert_eq!(branch.in_limits, want.word("in_limits") == "1");
            assert_eq!(branch.singular_flags, want.word("singular_flags").parse::<u8>().unwrap());
            assert!(branch.q.iter().all(|x| (-PI..PI).contains(x)));
            let (position, rotation) = miss(&arm, &branch.q, &pose);
            assert!(position < 1e-12 && rotation < 1e-12, "pose {index}");
        }
    }
}

#[test]
fn twenty_thousand_random_poses_are_met_by_all_branches_and_the_start_is_among_them() {
    let arm = Puma260::reference();
    let mut lcg = Lcg::new(1);
    let mut worst: (f64, f64) = (0.0, 0.0);
    for n in 0..20_000 {
        let q = lcg.joints(&arm);
        let pose = arm.wrist_pose(&q);
        let branches = arm.inverse_kinematics(&pose, Some(&q));
        assert_eq!(branches.len(), 8, "draw {n}");
        for branch in &branches {
            let (position, rotation) = miss(&arm, &branch.q, &pose);
            worst = (worst.0.max(position), worst.1.max(rotation));
            assert!(branch.q.iter().all(|x| (-PI..PI).contains(x)));
            let d = arm.singularity_distance(&branch.q);
            let signs = [
                (branch.shoulder, d.shoulder),
                (branch.elbow, branch.q[2].signum() * d.elbow),
                (branch.wrist, d.wrist),
            ];
            assert!(f64::from(signs[0].0) * signs[0].1 >= -1e-15);
            assert!(f64::from(signs[2].0) * signs[2].1 >= -1e-15);
            let above = wrap_angle(branch.q[2] + FRAC_PI_2);
            assert!(f64::from(branch.elbow) * above >= -1e-7);
        }
        let (index, near) = arm.nearest_branch(&branches, &q).unwrap();
        let error = (near - q).amax();
        let d = arm.singularity_distance(&q).smallest();
        assert!(
            error < 1e-14 / (d * d).min(1.0) + 2e-8 * f64::from(d < 1e-6),
            "draw {n}: {error:e} at {d:e}"
        );
        assert!(branches[index].in_limits && arm.within_limits(&near));
    }
    println!("worst residual {:e} m, {:e}", worst.0, worst.1);
    assert!(worst.0 < 1e-15 && worst.1 < 5e-15, "{worst:?}");
}

#[test]
fn near_singular_poses_are_met_and_the_joints_before_are_found_again() {
    let arm = Puma260::reference();
    let file = rows("kinematics/near_singular.csv");
    assert_eq!(file.len(), 50);
    for row in file {
        let (pose, q) = (row.pose(), row.joints("q"));
        let branches = arm.inverse_kinematics(&pose, Some(&q));
        assert_eq!(branches.len(), 8, "case {}", row.word("case_id"));
        for branch in &branches {
            let (position, rotation) = miss(&arm, &branch.q, &pose);
            assert!(position < row.num("tol_pos_m") && rotation < row.num("tol_rot_rad"));
        }
        let nearest = branches.iter().map(|b| apart(&b.q, &q)).fold(f64::INFINITY, f64::min);
        let tolerance = row.num("tol_q_rad");
        let limit = if tolerance < 0.0 { 1e-9 } else { tolerance };
        assert!(nearest < limit, "case {}: {nearest:e}", row.word("case_id"));
    }
}

#[test]
fn the_wrist_stays_with_its_joints_down_to_the_singularity() {
    let arm = Puma260::reference();
    let mut lcg = Lcg::new(2);
    for n in 0..2_000 {
        let mut q = lcg.joints(&arm);
        q[4] = match n % 4 {
            0 => 0.0,
            1 => 1e-14,
            2 => -3e-12,
            _ => lcg.between(-1e-11, 1e-11),
        };
        let d = arm.singularity_distance(&q);
        if d.shoulder.abs() < 0.05 || d.elbow.abs() < 0.05 {
            continue;
        }
        let branches = arm.inverse_kinematics(&arm.wrist_pose(&q), Some(&q));
        let (index, near) = arm.nearest_branch(&branches, &q).unwrap();
        assert!((near - q).amax() < 1e-9, "draw {n}: {:e}", (near - q).amax());
        assert_eq!(branches[index].singular_flags, WRIST_SINGULAR);
        // The other wrist is half a turn away, not a copy.
        let other = branches[index ^ 1].q;
        assert!((wrap_angle(other[3] - near[3]).abs() - PI).abs() < 1e-9);
    }
    let straight = arm.wrist_pose(&Joints::new(0.3, 0.2, 0.1, 1.0, 0.0, 0.5));
    let alone = arm.inverse_kinematics(&straight, None);
    assert!(alone.iter().any(|b| b.q[3] == 0.0 && (b.q[5] - 1.5).abs() < 1e-12));
}

#[test]
fn double_roots_are_flagged() {
    let arm = Puma260::reference();
    let stretched = arm.wrist_pose(&Joints::new(0.4, 0.3, -FRAC_PI_2, 0.2, 0.7, 0.1));
    let branches = arm.inverse_kinematics(&stretched, None);
    assert!(branches.len() == 8 && branches.iter().all(|b| b.singular_flags == ELBOW_SINGULAR));
    let pose = Pose::new(DMat3::IDENTITY, DVec3::new(0.0, -arm.d3_m, 0.25));
    let branches = arm.inverse_kinematics(&pose, None);
    assert!(branches.iter().all(|b| b.singular_flags & SHOULDER_SINGULAR != 0));
    // Folded on itself, the wrist centre on the shoulder axis: theta2 is free and held.
    let pose = Pose::new(DMat3::IDENTITY, DVec3::new(0.0, -arm.d3_m, 0.0));
    let before = Joints::new(0.0, 0.75, 0.0, 0.0, 0.0, 0.0);
    for branch in &arm.inverse_kinematics(&pose, Some(&before)) {
        assert!((branch.q[1] - 0.75).abs() < 1e-15 && branch.q.iter().all(|x| x.is_finite()));
        assert!(miss(&arm, &branch.q, &pose).0 < 1e-15);
    }
}

#[test]
fn what_is_out_of_reach_has_no_branch() {
    let arm = Puma260::reference();
    let at = |x: f64, y: f64, z: f64| Pose::new(DMat3::IDENTITY, DVec3::new(x, y, z));
    for pose in [
        at(0.5, 0.0, 0.0),
        at(0.05, 0.0, 0.2),
        at(0.0, 0.0, 0.0),
        at(1e300, -1e300, 1e300),
        at(f64::NAN, 0.0, 0.1),
        at(f64::INFINITY, 0.0, 0.1),
        Pose::new(DMat3::IDENTITY * f64::NAN, DVec3::new(0.2, -0.127, 0.2)),
    ] {
        let branches = arm.inverse_kinematics(&pose, None);
        assert!(branches.is_empty() && arm.nearest_branch(&branches, &Joints::zeros()).is_none());
    }
    let edge = libm::hypot(arm.a2_m + arm.d4_m, arm.d3_m);
    assert_eq!(arm.inverse_kinematics(&at(edge, 0.0, 0.0), None).len(), 8);
    assert_eq!(arm.inverse_kinematics(&at(edge + 1e-6, 0.0, 0.0), None).len(), 0);
}

#[test]
fn whole_turns_follow_the_joints_before_and_the_limits() {
    let arm = Puma260::reference();
    let q = Joints::new(0.3, 1.0, -1.0, 6.0, 0.8, -4.4);
    let branches = arm.inverse_kinematics(&arm.wrist_pose(&q), None);
    let (_, near) = arm.nearest_branch(&branches, &q).unwrap();
    assert!((near - q).amax() < 1e-12, "joint 4 beyond half a turn: {near}");
    let mut short = q;
    short[3] -= core::f64::consts::TAU;
    let (_, near) = arm.nearest_branch(&branches, &short).unwrap();
    assert!((near[3] - short[3]).abs() < 1e-12);
    // A wish outside the limits is answered inside them.
    let far = Joints::repeat(40.0);
    let (_, near) = arm.nearest_branch(&branches, &far).unwrap();
    assert!(arm.within_limits(&near));
    assert_eq!(arm.nearest_branch(&branches, &Joints::repeat(f64::NAN)), None);
    let lost = arm.inverse_kinematics(&arm.wrist_pose(&q), Some(&Joints::repeat(f64::NAN)));
    assert_eq!(lost, arm.inverse_kinematics(&arm.wrist_pose(&q), None));
}
