//! Moves the tool by keys from poses near singularities, limits and edges of the workspace, along
//! every axis of the base and of the tool: it stays on its line until it stops, and it can be moved
//! back.

use super::super::*;
use super::chains::{demand, rates, seven, six};

const DT_S: f64 = 0.0025;

/// Result of holding a key for 6.5 s and then the opposite key for at most 4 s.
struct Held {
    /// Largest deviation of the tool point from its line, less the part that the rotation of its
    /// axes explains (m).
    off_m: f64,
    /// Distance of the motion back (m): a millimetre is enough.
    back_m: f64,
}

/// Angle between two rotations near each other (rad).
fn turned(a: &Pose, b: &Pose) -> f64 {
    let off = (a.rotation - b.rotation).to_cols_array();
    (0.5 * off.iter().map(|x| x * x).sum::<f64>()).sqrt()
}

fn outcome_of_start<const N: usize, A: Arm<N>>(
    arm: &A,
    rates: &Rates<N>,
    at: &JointVector<N>,
    (axis, by): (usize, f64),
    frame: JogFrame,
) -> Held {
    let mut law = Law::new(arm, rates, at, true);
    let start = arm.tool_pose(at);
    let mut along = [0.0; 3];
    along[axis] = by;
    let mut along = DVec3::from_array(along);
    if frame == JogFrame::Tool {
        along = start.rotation * along;
    }
    let (mut off_m, mut last) = (0.0f64, JointVector::<N>::zeros());
    for tick in 0..2600 {
        let now = law.step(&demand(axis, by, frame), DT_S);
        assert!(arm.within_limits(&now.q), "{axis} {by} at {tick}: {}", now.q);
        let change: JointVector<N> = now.qd - last;
        let worst = change.component_div(&(arm.acceleration_max() * DT_S)).amax();
        assert!(worst < 1.0 + 1e-9, "{axis} {by} at {tick}: {worst} of the acceleration");
        last = now.qd;
        let pose = arm.tool_pose(&now.q);
        let way = pose.translation - start.translation;
        // Past a wrist singularity the orientation of the tool has an error; its own axes, and its
        // line with them, rotate by that error.
        let bent = if frame == JogFrame::Tool { turned(&pose, &start) * way.length() } else { 0.0 };
        off_m = off_m.max((way - way.dot(along) * along).length() - bent);
    }
    let stood = arm.tool_pose(&law.q).translation;
    let mut back_m = 0.0;
    for _ in 0..1600 {
        law.step(&demand(axis, -by, frame), DT_S);
        back_m = (arm.tool_pose(&law.q).translation - stood).length();
        if back_m > 1e-3 {
            break;
        }
    }
    Held { off_m, back_m }
}

/// Moves the tool in every direction from a start (deg).
fn every_way<const N: usize, A: Arm<N>>(arm: &A, rates: &Rates<N>, degrees: [f64; N]) {
    let at = JointVector::from(degrees.map(f64::to_radians));
    for frame in [JogFrame::Base, JogFrame::Tool] {
        for way in [(0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0), (2, 1.0), (2, -1.0)] {
            let Held { off_m, back_m } = outcome_of_start(arm, rates, &at, way, frame);
            assert!(off_m < 6e-4, "{degrees:?} {frame:?} {way:?}: {off_m} m off its line");
            assert!(back_m > 1e-3, "{degrees:?} {frame:?} {way:?}: {back_m} m back");
        }
    }
}

#[test]
fn beside_the_wrist_s_singularity_the_tool_stays_on_its_line() {
    let arm = Puma260::reference();
    let rates = crate::Config::default().rates(&arm, true);
    // 4 and 20 degrees from it, and one from which the arm stretches.
    for start in [
        [-86.7, -14.3, -168.4, 93.1, -4.0, 205.7],
        [-133.1, -39.5, -193.0, -153.5, 19.7, 215.9],
        [92.2, 185.1, -192.6, 248.3, -47.1, 53.6],
    ] {
        every_way(&arm, &rates, start);
    }
}

#[test]
fn beside_a_joint_s_limit_chains_stay_on_their_lines() {
    every_way(&six(), &rates(&six()), [-19.7, -163.0, -141.4, -40.1, -136.7, -101.4]);
    every_way(&seven(), &rates(&seven()), [-91.6, -146.4, 131.5, -115.1, -140.4, 154.2, 154.2]);
}
