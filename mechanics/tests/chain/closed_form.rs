//! Tests the closed form for spherical wrists: arms are recognised by their axes alone, all
//! branches are found, the original joints are among them, and for the PUMA 260 the general closed
//! form equals its own.

use crate::example_arms::{Lcg, PI, puma, random_wrist_arm, seven, ur5e_like};
use glam::DVec3;
use taktil_mechanics::chain::{Chain, DhRow, JointSpec};
use taktil_mechanics::puma260::{Puma260, WRIST_SINGULAR};
use taktil_mechanics::spatial::wrap_angle;
use taktil_mechanics::{Joints, Pose};

fn apart(a: &Joints, b: &Joints) -> f64 {
    (a - b).map(wrap_angle).amax()
}

fn miss(chain: &Chain<6>, q: &Joints, tool: &Pose) -> f64 {
    let got = chain.tool_pose(q);
    let off = (got.rotation - tool.rotation).to_cols_array();
    let turn = off.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
    (got.translation - tool.translation).length().max(turn)
}

#[test]
fn the_puma_by_the_general_path_is_the_puma_by_its_own() {
    let (arm, chain) = (Puma260::reference(), puma());
    let wrist = chain.spherical_wrist().expect("recognised");
    let mut lcg = Lcg(21);
    for n in 0..5000 {
        let q = lcg.inside(&chain);
        let tool = arm.tool_pose(&q);
        let own = arm.inverse_kinematics(&arm.tool_to_wrist(&tool), Some(&q));
        let got = wrist.inverse_kinematics(&tool, Some(&q));
        assert_eq!((own.len(), got.len()), (8, 8));
        let d = arm.singularity_distance(&q);
        let ill = 1e-14 / (d.smallest() * d.smallest());
        for (a, b) in own.iter().zip(&got) {
            assert_eq!((a.shoulder, a.elbow, a.wrist), (b.shoulder, b.elbow, b.wrist));
            assert_eq!((a.in_limits, a.singular_flags), (b.in_limits, b.singular_flags));
            assert!(apart(&a.q, &b.q) < ill, "draw {n}: {:e} {d:?}", apart(&a.q, &b.q));
        }
        let e = wrist.singularity_distance(&q);
        assert!((e.shoulder - d.shoulder).abs() < 1e-15);
        assert!((e.elbow.abs() - d.elbow.abs()).abs() < 1e-15 && (e.wrist - d.wrist).abs() < 1e-15);
        let (_, near) = wrist.nearest_branch(&got, &q).unwrap();
        assert!((near - arm.nearest_branch(&own, &q).unwrap().1).amax() < ill);
    }
}

#[test]
fn any_arm_of_the_family_is_recognised_and_solved() {
    let mut lcg = Lcg(22);
    let mut branches = [0_u32; 9];
    for n in 0..200 {
        let arm = random_wrist_arm(&mut lcg).chain(&mut lcg);
        let wrist = arm.spherical_wrist().unwrap_or_else(|| panic!("arm {n}: not recognised"));
        for _ in 0..50 {
            let q = lcg.inside(&arm);
            let tool = arm.tool_pose(&q);
            let got = wrist.inverse_kinematics(&tool, Some(&q));
            branches[got.len()] += 1;
            for branch in &got {
                assert!(miss(&arm, &branch.q, &tool) < 2e-14, "arm {n}: {branch:?}");
                let d = wrist.singularity_distance(&branch.q);
                assert!(f64::from(branch.shoulder) * d.shoulder > -1e-9, "{branch:?} {d:?}");
                assert!(f64::from(branch.elbow) * d.elbow > -1e-7, "{branch:?} {d:?}");
                assert!(f64::from(branch.wrist) * d.wrist > -1e-14, "{branch:?} {d:?}");
            }
            let d = wrist.singularity_distance(&q).smallest();
            if d > 1e-4 {
                let nearest = got.iter().map(|b| apart(&b.q, &q)).fold(f64::INFINITY, f64::min);
                assert!(nearest < 1e-13 / (d * d), "arm {n}: {nearest:e} at {d:e}");
            }
        }
    }
    // Offsets of the shoulder let one of its roots reach where the other does not.
    assert!(branches[8] > 1000 && branches[4] > 100 && branches[0] == 0, "{branches:?}");
}

#[test]
fn arms_of_other_kinds_are_not_taken_for_one() {
    assert!(ur5e_like().spherical_wrist().is_none());
    assert!(seven().spherical_wrist().is_none());
    // One millionth of a metre beside the wrist's centre is not a spherical wrist.
    let mut lcg = Lcg(23);
    for i in 0..3 {
        let mut arm = random_wrist_arm(&mut lcg);
        let aside = arm.axes[3 + i].any_orthonormal_vector();
        arm.points[3 + i] += 1e-6 * (aside + arm.axes[3 + i].cross(aside));
        assert!(arm.chain(&mut lcg).spherical_wrist().is_none(), "axis {}", i + 4);
        let mut arm = random_wrist_arm(&mut lcg);
        arm.axes[i] = (arm.axes[i] + DVec3::new(1e-6, 0.0, 1e-6)).normalize();
        if i > 0 {
            assert!(arm.chain(&mut lcg).spherical_wrist().is_none(), "axis {}", i + 1);
        }
    }
}

#[test]
fn the_wrist_stays_with_its_joints_down_to_the_singularity() {
    let mut lcg = Lcg(24);
    for n in 0..100 {
        let arm = random_wrist_arm(&mut lcg).chain(&mut lcg);
        let wrist = arm.spherical_wrist().unwrap();
        let mut q = lcg.inside(&arm);
        // Joint 5 where axes 4 and 6 are in line.
        let zero = wrist.singularity_distance(&Joints::zeros()).wrist;
        let six_joint_start = libm::asin(zero);
        let straight = [-six_joint_start, six_joint_start + PI, six_joint_start - PI]
            .into_iter()
            .find(|x| {
                let at = Joints::new(0.0, 0.0, 0.0, 0.0, *x, 0.0);
                let j = arm.jacobian_base(&at);
                let (a, b) = (j.column(3), j.column(5));
                (a.fixed_rows::<3>(3) - b.fixed_rows::<3>(3)).amax() < 1e-12
            })
            .unwrap();
        for off in [1e-3, 1e-6, 1e-9, 1e-12, 0.0, -1e-12, -1e-7] {
            q[4] = straight + off;
            let d = wrist.singularity_distance(&q);
            if d.shoulder.abs() < 0.05 || d.elbow.abs() < 0.05 {
                continue;
            }
            let got = wrist.inverse_kinematics(&arm.tool_pose(&q), Some(&q));
            let held = off.abs() < 1e-11;
            let tolerance = if held { 2e-9 } else { 2e-9 + 2e-13 / off.abs() };
            let near = got.iter().find(|b| apart(&b.q, &q) < tolerance);
            let near = near.unwrap_or_else(|| panic!("arm {n} at {off:e}: {got:?} {q}"));
            if held {
                assert_eq!(near.singular_flags & WRIST_SINGULAR, WRIST_SINGULAR);
            }
        }
    }
}

#[test]
fn a_known_industrial_arm_is_solved_from_its_rows() {
    // KUKA's KR 6 R700 as rs-opw-kinematics lists it: a1 = 25, b = 0, c1 = 400, c2 = 315, c3 = 365,
    // a2 = -35, c4 = 80 mm; axes and points of that family at zero, arm upright.
    let at = |x: f64, z: f64| DVec3::new(x, 0.0, z);
    let (y, z) = (DVec3::Y, DVec3::Z);
    let points = [at(0.0, 0.0), at(0.025, 0.4), at(0.025, 0.715), at(-0.01, 1.08)];
    let arm = crate::example_arms::WristArmGeometry {
        axes: [z, y, y, z, y, z],
        points: [points[0], points[1], points[2], points[3], points[3], points[3]],
    };
    let mut lcg = Lcg(25);
    let chain = arm.chain(&mut lcg);
    let wrist = chain.spherical_wrist().unwrap();
    let q = Joints::new(0.3, -0.4, 0.9, 1.1, 0.7, -2.0);
    let got = wrist.inverse_kinematics(&chain.tool_pose(&q), None);
    assert_eq!(got.len(), 8);
    assert!(got.iter().all(|b| miss(&chain, &b.q, &chain.tool_pose(&q)) < 1e-14));
    // Stretched ahead: with the shoulder turned about it is 50 mm further, which is too far.
    let far = Joints::new(0.3, 1.3, 0.4, 1.1, 0.7, -2.0);
    assert_eq!(wrist.inverse_kinematics(&chain.tool_pose(&far), None).len(), 4);
    assert!(got.iter().any(|b| apart(&b.q, &q) < 1e-13));
}

#[test]
fn what_is_out_of_reach_or_no_number_has_no_branch() {
    let chain = puma();
    let wrist = chain.spherical_wrist().unwrap();
    let good = chain.tool_pose(&Joints::zeros());
    for bad in [0.7, -3.0, 1e300, f64::NAN, f64::INFINITY] {
        let mut pose = good;
        pose.translation.x = bad;
        assert!(wrist.inverse_kinematics(&pose, None).is_empty());
    }
    let mut pose = good;
    pose.rotation.y_axis.y = f64::NAN;
    assert!(wrist.inverse_kinematics(&pose, None).is_empty());
    let lost = wrist.inverse_kinematics(&good, Some(&Joints::repeat(f64::NAN)));
    assert_eq!(lost, wrist.inverse_kinematics(&good, None));
    assert_eq!(wrist.nearest_branch(&lost, &Joints::repeat(f64::NAN)), None);
    // Rows with a sliding joint or fewer joints are another arm.
    let spec = JointSpec::default();
    let row = DhRow { a_m: 0.1, d_m: 0.0, alpha_rad: 1.0, theta_rad: 0.0, spec };
    assert!(Chain::from_dh(&[row; 3], &Pose::IDENTITY).unwrap().spherical_wrist().is_none());
}
