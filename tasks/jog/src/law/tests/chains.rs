//! Tests jogging of general serial chains: the edge of the workspace, joint limits of an arm with
//! seven joints, and the drift of the elbow of a redundant arm.

use super::super::*;
use core::f64::consts::{FRAC_PI_2, PI};
use taktil_mechanics::chain::{Chain, DhRow, JointSpec};

const DT_S: f64 = 0.0025;

/// Rows (a, d, alpha) with limits, speeds and accelerations of arms of this size.
fn chain<const N: usize>(rows: [(f64, f64, f64); N]) -> Chain<N> {
    let dh = rows.map(|(a_m, d_m, alpha_rad)| {
        let spec = JointSpec {
            q_min: -0.97 * PI,
            q_max: 0.97 * PI,
            speed_max: 3.0,
            acceleration_max: 15.0,
            ..JointSpec::default()
        };
        DhRow { a_m, d_m, alpha_rad, theta_rad: 0.0, spec }
    });
    Chain::from_dh(&dh, &Pose::IDENTITY).unwrap()
}

/// Two long links and a wrist whose axes do not meet.
pub(super) fn six() -> Chain<6> {
    chain([
        (0.0, 0.16, FRAC_PI_2),
        (-0.43, 0.0, 0.0),
        (-0.39, 0.0, 0.0),
        (0.0, 0.13, FRAC_PI_2),
        (0.0, 0.1, -FRAC_PI_2),
        (0.0, 0.1, 0.0),
    ])
}

/// Shoulder and wrist of three axes each, an elbow between.
pub(super) fn seven() -> Chain<7> {
    chain([
        (0.0, 0.34, -FRAC_PI_2),
        (0.0, 0.0, FRAC_PI_2),
        (0.0, 0.4, FRAC_PI_2),
        (0.0, 0.0, -FRAC_PI_2),
        (0.0, 0.4, -FRAC_PI_2),
        (0.0, 0.0, FRAC_PI_2),
        (0.0, 0.13, 0.0),
    ])
}

pub(super) fn rates<const N: usize>(arm: &Chain<N>) -> Rates<N> {
    Rates {
        joints_rad_s: arm.speed_max() * 0.1,
        ramp_s: 0.1,
        line_m_s: 0.1,
        turn_rad_s: 0.5,
        off_max_rad: 0.01,
    }
}

pub(super) fn demand(axis: usize, by: f64, frame: JogFrame) -> JogDemand {
    let mut axes = [0.0; 6];
    axes[axis] = by;
    JogDemand { axes, frame }
}

pub(super) fn six_at() -> JointVector<6> {
    JointVector::from([0.2, -1.2, 1.5, -1.8, -1.3, 0.1])
}

pub(super) fn seven_at() -> JointVector<7> {
    JointVector::from([0.1, 0.6, 0.2, -1.4, 0.1, 0.9, 0.3])
}

/// Holds one key for 22 s, then moves the tool back for 2 s. Returns the largest deviation from the
/// line, the distance covered in the last 2.5 s, and the distance back (m).
fn to_the_edge<const N: usize>(
    arm: &Chain<N>,
    at: &JointVector<N>,
    axis: usize,
    by: f64,
) -> [f64; 3] {
    let mut law = Law::new(arm, &rates(arm), at, true);
    let start = arm.tool_pose(at).translation;
    let mut along = [0.0; 3];
    along[axis] = by;
    let along = DVec3::from_array(along);
    let (mut last, mut off, mut late) = (JointVector::<N>::zeros(), 0.0f64, start);
    for tick in 0..8800 {
        let now = law.step(&demand(axis, by, JogFrame::Base), DT_S);
        let share = now.qd.component_div(arm.speed_max()).amax();
        assert!(share <= 0.6 + 1e-9, "{axis} {by} at {tick}: {share} of the speed");
        assert!(arm.within_limits(&now.q), "{axis} {by} at {tick}: {}", now.q);
        let change: JointVector<N> = now.qd - last;
        let worst = change.component_div(&(arm.acceleration_max() * DT_S)).amax();
        assert!(worst < 1.0 + 1e-9, "{axis} {by} at {tick}: {worst} of the acceleration");
        last = now.qd;
        let place = arm.tool_pose(&now.q).translation;
        let way = place - start;
        off = off.max((way - way.dot(along) * along).length());
        if tick == 7800 {
            late = place;
        }
    }
    let edge = arm.tool_pose(&law.q).translation;
    for _ in 0..800 {
        law.step(&demand(axis, -by, JogFrame::Base), DT_S);
    }
    let back = edge - arm.tool_pose(&law.q).translation;
    assert!((back - back.dot(along) * along).length() < 1.5e-3, "{axis} {by}: back on its line");
    [off, (edge - late).length(), back.dot(along)]
}

#[test]
fn at_the_edge_of_its_reach_a_chain_stands_on_its_line_and_comes_back() {
    for (axis, by) in [(0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0), (2, 1.0), (2, -1.0)] {
        let six = to_the_edge(&six(), &six_at(), axis, by);
        assert!(six[0] < 2e-4, "{axis} {by}: {} m off the line", six[0]);
        let seven = to_the_edge(&seven(), &seven_at(), axis, by);
        assert!(seven[0] < 1.5e-3, "{axis} {by}: {} m off the line", seven[0]);
        for [_, on, back] in [six, seven] {
            assert!(on < 1e-6, "{axis} {by}: goes on by {on} m");
            assert!(back > 0.05, "{axis} {by}: comes back by {back} m");
        }
    }
}

#[test]
fn keys_pressed_again_after_release_move_the_tool() {
    let arm = seven();
    let held = demand(1, 1.0, JogFrame::Base);
    let mut law = Law::new(&arm, &rates(&arm), &seven_at(), true);
    let stood = (0..8000).map(|_| law.step(&held, DT_S)).last().unwrap();
    assert!(stood.obstacle.is_some() && stood.qd.amax() < 1e-3, "stands at the edge");
    // Back from the edge by the elbow alone, then the same key as before.
    for _ in 0..1200 {
        law.step(&demand(3, -1.0, JogFrame::Joints), DT_S);
    }
    for _ in 0..60 {
        law.step(&JogDemand::ZERO, DT_S);
    }
    let before = arm.tool_pose(&law.q).translation;
    for _ in 0..200 {
        law.step(&held, DT_S);
    }
    let way = arm.tool_pose(&law.q).translation - before;
    assert!(way.y > 0.01, "it moves again: {way}");
}

#[test]
fn the_outer_joints_of_seven_reach_the_last_and_not_the_first() {
    let arm = seven();
    for (axis, joint) in [(5, 6), (0, 1)] {
        let mut law = Law::new(&arm, &rates(&arm), &seven_at(), true);
        let mut q = seven_at();
        for _ in 0..20_000 {
            q = law.step(&demand(axis, 1.0, JogFrame::Outer), DT_S).q;
        }
        let moved = q - seven_at();
        assert!((q[joint] - arm.q_max()[joint]).abs() < 1e-3, "to its limit: {}", q[joint]);
        assert!((0..7).all(|other| other == joint || moved[other] == 0.0), "{moved}");
    }
    // An arm of six joints has no further joints that could drift.
    let arm = six();
    let (mut one, mut two) = (Law::new(&arm, &rates(&arm), &six_at(), true), six_at());
    let mut other = Law::new(&arm, &rates(&arm), &six_at(), true);
    for _ in 0..100 {
        two = one.step(&demand(3, 1.0, JogFrame::Outer), DT_S).q;
        assert_eq!(two, other.step(&demand(3, 1.0, JogFrame::Joints), DT_S).q);
    }
    assert!(two[3] > six_at()[3]);
}

/// Runs the tool round a square of 80 mm and back to where it began; how far each joint is then
/// from where it was.
fn round(law: &mut Law<7, Chain<7>>) -> JointVector<7> {
    let before = law.q;
    for (axis, by) in [(0, 1.0), (1, 1.0), (0, -1.0), (1, -1.0)] {
        for _ in 0..320 {
            law.step(&demand(axis, by, JogFrame::Base), DT_S);
        }
        for _ in 0..60 {
            law.step(&JogDemand::ZERO, DT_S);
        }
    }
    law.q - before
}

#[test]
fn the_elbow_of_a_redundant_arm_drifts_slowly_and_the_tool_not_at_all() {
    let arm = seven();
    let mut law = Law::new(&arm, &rates(&arm), &seven_at(), true);
    let start = arm.tool_pose(&seven_at());
    let mut most = 0.0f64;
    for _ in 0..10 {
        most = most.max(round(&mut law).amax());
    }
    let end = arm.tool_pose(&law.q);
    assert!((end.translation - start.translation).length() < 1e-6, "the tool is where it was");
    let gone = (law.q - seven_at()).amax();
    // A square of 80 mm: below half a degree a round, four degrees in ten.
    assert!(most < 0.0087 && gone < 0.07, "{most} rad a round, {gone} in ten");
    // There and back on one line closes by itself.
    let before = law.q;
    for by in [1.0, -1.0] {
        for _ in 0..400 {
            law.step(&demand(2, by, JogFrame::Base), DT_S);
        }
        for _ in 0..60 {
            law.step(&JogDemand::ZERO, DT_S);
        }
    }
    assert!((law.q - before).amax() < 1e-4, "{}", (law.q - before).amax());
}
