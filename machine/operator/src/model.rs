//! The arm as a drawing needs it: the frames of its joints at zero, limits, and its tool.

use serde_json::{Value, json};
use taktil_machine::operator::command::CommandContext;
use taktil_mechanics::Pose;
use taktil_signal::State;

/// The arm of a machine. A frame is twelve numbers, the three rows of rotation and place (m).
pub(crate) fn model(context: &CommandContext) -> Value {
    let robot = &context.robot;
    let frames = robot.frames();
    let limits = robot.limits_rad();
    let joint = |(at, origin): (usize, &Pose)| {
        json!({
            "name": robot.joint_label(at),
            "origin": rows(origin),
            "low_rad": limits.get(at).map(|limit| limit.0),
            "high_rad": limits.get(at).map(|limit| limit.1),
        })
    };
    json!({
        "arm": if robot.is_puma260() { "PUMA 260" } else { "chain from URDF" },
        "joints": frames.joint_origins.iter().enumerate().map(joint).collect::<Value>(),
        "tool": rows(&frames.tool),
        "home_rad": robot.home_rad(),
        "states": State::ALL.map(State::name),
    })
}

/// The rows of rotation and place.
fn rows(pose: &Pose) -> Vec<f64> {
    let rotation = pose.rotation.to_cols_array_2d();
    let place = pose.translation.to_array();
    let row = |i: usize| [rotation[0][i], rotation[1][i], rotation[2][i], place[i]];
    (0..3).flat_map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The product of two frames of twelve numbers.
    fn product(a: &[f64], b: &[f64]) -> Vec<f64> {
        let element = |i: usize, j: usize| {
            let turned: f64 = (0..3).map(|k| a[4 * i + k] * b[4 * k + j]).sum();
            turned + if j == 3 { a[4 * i + 3] } else { 0.0 }
        };
        (0..12).map(|at| element(at / 4, at % 4)).collect()
    }

    #[test]
    fn what_is_told_of_the_arm_draws_its_tool_where_its_kinematics_have_it() {
        let context = CommandContext::default();
        let told = model(&context);
        let numbers = |value: &Value| -> Vec<f64> {
            value.as_array().unwrap().iter().map(|n| n.as_f64().unwrap()).collect()
        };
        for q in [[0.0; 6], [0.3, -0.7, 1.1, 2.0, -0.4, 0.9], [-2.0, 3.9, -3.0, 0.1, 1.9, -4.0]] {
            let mut at = numbers(&json!([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]));
            for (joint, angle) in told["joints"].as_array().unwrap().iter().zip(q) {
                let (s, c) = libm_sincos(angle);
                let turn = [c, -s, 0.0, 0.0, s, c, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0];
                at = product(&product(&at, &numbers(&joint["origin"])), &turn);
            }
            let drawn = product(&at, &numbers(&told["tool"]));
            let tool = context.robot.tool_pose(&q).unwrap();
            // Rounding of two dozen products of numbers below one.
            let differs = drawn.iter().zip(rows(&tool)).any(|(a, b)| (a - b).abs() > 1e-12);
            assert!(!differs, "{q:?}: {drawn:?} {tool:?}");
        }
        assert_eq!(told["joints"].as_array().unwrap().len(), 6);
        assert!(told["joints"][1]["low_rad"].as_f64() < told["joints"][1]["high_rad"].as_f64());
    }

    fn libm_sincos(angle: f64) -> (f64, f64) {
        let turn = taktil_mechanics::spatial::rotation_z(angle);
        (turn.x_axis.y, turn.x_axis.x)
    }
}
