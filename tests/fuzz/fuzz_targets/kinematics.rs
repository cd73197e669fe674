//! Joints, poses and twists through the PUMA 260 and through chains from URDF files: whatever is
//! finite gives what is finite, and every inverse leads back to its pose.
#![no_main]

use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use nalgebra::Vector6;
use taktil_fuzz::{Numbers, finite, rigid};
use taktil_mechanics::arm::{Arm, PathFollower};
use taktil_mechanics::chain::{Chain, SearchBudget};
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::puma260::dynamics::Dynamics;
use taktil_mechanics::spatial::JointVector;
use taktil_mechanics::{Joints, Pose, dls};

fn chain<const N: usize>(text: &str) -> Chain<N> {
    let whole = taktil_machine::urdf::Selection::default();
    taktil_machine::urdf::read(text, &whole).expect("ours").chain().expect("sound")
}

static SIX: LazyLock<Chain<6>> =
    LazyLock::new(|| chain(include_str!("../../../sim/arms/ur5e-like.urdf")));
static ROUND: LazyLock<Chain<6>> =
    LazyLock::new(|| chain(include_str!("../../../sim/arms/puma260.urdf")));
static SEVEN: LazyLock<Chain<7>> =
    LazyLock::new(|| chain(include_str!("../../../sim/arms/seven-joints.urdf")));

/// Farther than that a sine knows nothing of its angle.
const ANGLE_MAX: f64 = 1e6;
/// Motion up to which the dynamics promises finite torques.
const MOTION_MAX: f64 = 1e60;

fn pose_error(a: &Pose, b: &Pose) -> f64 {
    let turned = a.rotation - b.rotation;
    let turned = turned.to_cols_array().into_iter().fold(0.0, |most: f64, x| most.max(x.abs()));
    turned.max((a.translation - b.translation).abs().max_element())
}

fn puma(n: &mut Numbers<'_>) {
    let arm = Puma260::reference();
    let (q, before) = (n.vector::<6>(ANGLE_MAX), n.vector::<6>(ANGLE_MAX));
    let wrist = arm.wrist_pose(&q);
    rigid("wrist pose", &wrist);
    rigid("tool pose", &arm.tool_pose(&q));
    finite("jacobian", arm.jacobian_base(&q).iter());
    finite("tool jacobian", arm.jacobian_tool(&q).iter());
    finite("determinant", &[arm.jacobian_determinant(&q), arm.singularity_distance(&q).smallest()]);
    let branches = arm.inverse_kinematics(&wrist, Some(&before));
    assert!(
        matches!(branches.len(), 4 | 8),
        "{} branches of a pose that is reached",
        branches.len()
    );
    for branch in &branches {
        finite("branch", branch.q.iter());
        let off = pose_error(&arm.wrist_pose(&branch.q), &wrist);
        // On the boundary of the reach the wrist centre may be a nanometre out.
        assert!(off < 2e-9, "a branch misses its pose by {off:e}: {:?}", branch.q);
        if branch.singular_flags == 0 {
            assert!(off < 1e-14, "a regular branch misses its pose by {off:e}");
        }
    }
    for (i, one) in branches.iter().enumerate() {
        for other in branches.as_slice().iter().skip(i + 1) {
            let same = (one.q - other.q).amax() == 0.0 && one.singular_flags == 0;
            assert!(!same, "the same branch twice: {:?}", one.q);
        }
    }
    let dynamics = Dynamics::reference();
    let (qd, qdd) = (n.vector::<6>(MOTION_MAX), n.vector::<6>(MOTION_MAX));
    finite("torque", dynamics.inverse_dynamics(&q, &qd, &qdd).iter());
    finite("mass matrix", dynamics.mass_matrix(&q).iter());
    let twist = Vector6::from(n.vector::<6>(1e100));
    let rates = dls::damped_least_squares(&arm.jacobian_base(&q), &twist, n.number(1e3));
    if let Some(rates) = rates {
        finite("rates", rates.iter());
        finite("limited", dls::scale_to_speed_limits(&rates, &arm.speed_max_rad_s).0.iter());
    }
}

/// Any pose, near or far, and any other previous joints.
fn any_pose(n: &mut Numbers<'_>) {
    let arm = Puma260::reference();
    let pose = n.pose(1e300);
    let before = n.vector::<6>(1e300);
    for branch in &arm.inverse_kinematics(&pose, Some(&before)) {
        finite("branch", branch.q.iter());
    }
    for q in [
        arm.inverse_kinematics_near(&pose, &before),
        Arm::inverse_kinematics_near(&*SIX, &pose, &before),
    ]
    .into_iter()
    .flatten()
    {
        finite("reached", q.iter());
    }
}

fn any_chain<const N: usize>(chain: &Chain<N>, n: &mut Numbers<'_>) {
    let q = n.vector::<N>(ANGLE_MAX);
    let pose = chain.tool_pose(&q);
    rigid("chain's pose", &pose);
    finite("chain's jacobian", chain.jacobian_base(&q).iter());
    finite("singular values", &chain.singular_values(&q));
    let (qd, qdd) = (n.vector::<N>(MOTION_MAX), n.vector::<N>(MOTION_MAX));
    finite("chain's torque", chain.inverse_dynamics(&q, &qd, &qdd).iter());
    finite("chain's mass matrix", chain.mass_matrix(&q).iter());
    let (rates, lost) =
        chain.resolved_rates(&q, &Vector6::from(n.vector::<6>(1e100)), n.number(1e300));
    finite("chain's rates", rates.iter());
    finite("lost", lost.iter());
    let effort = SearchBudget { starts: 2, ..SearchBudget::default() };
    let before: JointVector<N> = n.vector::<N>(ANGLE_MAX);
    match chain.inverse_kinematics(&pose, &before, &effort) {
        Ok(found) => {
            assert!(chain.within_limits(&found.q), "{:?}", found.q);
            assert!(pose_error(&chain.tool_pose(&found.q), &pose) < 1e-8);
        }
        Err(nearest) => finite("nearest", nearest.q.iter()),
    }
    if let Some(wrist) = chain.spherical_wrist()
        && let Ok(six) = <[f64; 6]>::try_from(before.as_slice())
    {
        for branch in &wrist.inverse_kinematics(&pose, Some(&Joints::from(six))) {
            finite("chain's branch", branch.q.iter());
        }
    }
}

/// Follows a line between two poses from where the arm stands.
fn follow<const N: usize, A: Arm<N>>(arm: &A, n: &mut Numbers<'_>) {
    let inside = |q: JointVector<N>| {
        JointVector::<N>::from_fn(|i, _| {
            let (low, high) = (arm.q_min()[i].max(-10.0), arm.q_max()[i].min(10.0));
            low + (q[i] / 4.0).rem_euclid(1.0) * (high - low)
        })
    };
    let from = inside(n.vector::<N>(ANGLE_MAX));
    let start = arm.tool_pose(&from);
    let mut follower = arm.follower(&from);
    let way = n.vector::<3>(1.0);
    let (dt_s, ticks) = (1e-3 * f64::from(1 + n.byte() % 10), 60);
    for tick in 1..=ticks {
        let share = f64::from(tick) / f64::from(ticks);
        let mut tool = start;
        tool.translation += glam::DVec3::new(way[0], way[1], way[2]) * share;
        let before = *follower.joints();
        match follower.step(&tool, dt_s) {
            Ok(followed) => {
                finite("followed", followed.q.iter());
                finite("off", &[followed.position_error_m, followed.orientation_error_rad]);
                assert!(arm.within_limits(&followed.q), "outside: {:?}", followed.q);
                for i in 0..N {
                    let most = arm.speed_max()[i] * dt_s * (1.0 + 1e-6);
                    assert!((followed.q[i] - before[i]).abs() <= most, "joint {i} too fast");
                }
            }
            Err(_) => {
                assert_eq!(*follower.joints(), before, "a lost follower moved");
                return;
            }
        }
    }
}

fuzz_target!(|bytes: &[u8]| {
    let mut n = Numbers::new(bytes);
    match n.byte() % 8 {
        0 | 1 => puma(&mut n),
        2 => any_pose(&mut n),
        3 => any_chain(&*SIX, &mut n),
        4 => any_chain(&*SEVEN, &mut n),
        5 => any_chain(&*ROUND, &mut n),
        6 => follow(&Puma260::reference(), &mut n),
        _ if n.byte() % 2 == 0 => follow(&*SIX, &mut n),
        _ => follow(&*SEVEN, &mut n),
    }
});
