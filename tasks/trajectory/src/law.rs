//! From a queue of goals to a path: Paul's joint motion from where the arm is wanted now. Refuses
//! paths that leave the limits of angle, speed or acceleration, before the first step is made.

use glam::DVec3;
use taktil_mechanics::paul::{JointPath, MAX_POINTS, segment_time_s};
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::{Joints, Pose};

use crate::config::{Goal, Step};

/// Why a queue cannot be run from here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// Move with this index has no solution within the limits.
    Unreachable {
        /// Position in the queue.
        index: usize,
    },
    /// The start, an angle, a speed or an acceleration is outside the arm's limits, or there are
    /// too many moves.
    Limits,
}

/// Rounding that a limit forgives, relative.
const SLACK: f64 = 1e-9;

/// The path from rest at `start` (rad) through all `steps` to rest at the last one.
///
/// A tool goal takes the branch of the inverse kinematics nearest to the point before it. Segments
/// without a time get the shortest at which no joint is faster than `speed` times its limit, and at
/// least two `tau_s`. An empty queue is a wait of two `tau_s`.
///
/// # Errors
/// [`Refusal`]; nothing moves then.
pub fn plan(
    arm: &Puma260,
    start: &Joints,
    steps: &[Step],
    tau_s: f64,
    speed: f64,
) -> Result<JointPath, Refusal> {
    let mut points = [*start; MAX_POINTS];
    let mut times = [2.0 * tau_s; MAX_POINTS];
    if steps.len() >= MAX_POINTS || !arm.within_limits(start) {
        return Err(Refusal::Limits);
    }
    let speed_max = arm.speed_max_rad_s * speed;
    for (index, step) in steps.iter().enumerate() {
        let before = points[index];
        let point = match &step.goal {
            Goal::Joints(q) => *q,
            Goal::Tool(pose) => reach(arm, pose, &before).ok_or(Refusal::Unreachable { index })?,
            Goal::By(shift) => {
                let mut pose = arm.tool_pose(&before);
                pose.translation += pose.rotation * DVec3::from_array(*shift);
                reach(arm, &pose, &before).ok_or(Refusal::Unreachable { index })?
            }
        };
        points[index + 1] = point;
        times[index] =
            step.t_s.unwrap_or_else(|| segment_time_s(&before, &point, &speed_max, tau_s));
    }
    let segments = steps.len().max(1);
    let path = JointPath::new(&points[..=segments], &times[..segments], tau_s)
        .map_err(|_| Refusal::Limits)?;
    let inside = points[..=segments].iter().all(|q| arm.within_limits(q))
        && below(&path.peak_speed(), &arm.speed_max_rad_s)
        && below(&path.peak_acceleration(), &arm.acceleration_max_rad_s2);
    if inside { Ok(path) } else { Err(Refusal::Limits) }
}

/// The solution nearest to `before` within the limits.
fn reach(arm: &Puma260, tool: &Pose, before: &Joints) -> Option<Joints> {
    let branches = arm.inverse(&arm.tool_to_wrist(tool), Some(before));
    Some(arm.nearest(&branches, before)?.1)
}

fn below(values: &Joints, limits: &Joints) -> bool {
    (0..6).all(|i| values[i] <= limits[i] * (1.0 + SLACK))
}

#[cfg(test)]
mod tests {
    use super::*;
    use taktil_mechanics::spatial::rotation_y;

    fn rolling() -> Joints {
        Joints::from([0.0, 40.2, -153.4, -180.0, 66.8, 180.0].map(f64::to_radians))
    }

    fn to(q: Joints) -> Step {
        Step { goal: Goal::Joints(q), t_s: None }
    }

    #[test]
    fn a_path_starts_and_ends_at_rest_and_keeps_the_speed() {
        let arm = Puma260::reference();
        let goal = rolling() + Joints::new(0.5, 0.1, 0.2, 0.0, -0.3, 0.4);
        let path = plan(&arm, &rolling(), &[to(goal), to(rolling())], 0.1, 0.3).unwrap();
        assert_eq!(path.at(0.0).q, rolling());
        assert_eq!(path.at(0.0).qd, Joints::zeros());
        let end = path.at(path.duration_s());
        assert_eq!((end.q, end.qd), (rolling(), Joints::zeros()));
        let top = path.peak_speed().component_div(&(arm.speed_max_rad_s * 0.3)).max();
        assert!((top - 1.0).abs() < 1e-12, "one joint uses its whole share, {top}");
    }

    #[test]
    fn a_tool_goal_is_reached_on_the_branch_at_hand() {
        let arm = Puma260::reference();
        let here = arm.tool_pose(&rolling());
        let there = Pose::new(
            rotation_y(0.1) * here.rotation,
            here.translation + Pose::from_rows(&[0.0; 9], &[-0.02, 0.01, 0.015]).translation,
        );
        let step = Step { goal: Goal::Tool(there), t_s: Some(1.0) };
        let path = plan(&arm, &rolling(), &[step], 0.1, 0.3).unwrap();
        let q = path.at(10.0).q;
        let got = arm.tool_pose(&q);
        assert!((got.translation - there.translation).length() < 1e-12);
        assert!(got.rotation.abs_diff_eq(there.rotation, 1e-12));
        assert!((q - rolling()).amax() < 0.5, "no other branch: {q}");
    }

    #[test]
    fn a_displacement_goes_along_the_tool_s_own_axes_and_keeps_the_orientation() {
        let arm = Puma260::reference();
        let here = arm.tool_pose(&rolling());
        let step = Step { goal: Goal::By([0.003, 0.0, 0.012]), t_s: None };
        let path = plan(&arm, &rolling(), &[step, step], 0.1, 0.3).unwrap();
        let got = arm.tool_pose(&path.at(path.duration_s()).q);
        let wanted = here.apply(DVec3::new(0.006, 0.0, 0.024));
        assert!((got.translation - wanted).length() < 1e-12);
        assert!(got.rotation.abs_diff_eq(here.rotation, 1e-12));
    }

    #[test]
    fn an_empty_queue_and_a_goal_where_the_arm_is_stand_still() {
        let arm = Puma260::reference();
        for steps in [&[][..], &[to(rolling())][..]] {
            let path = plan(&arm, &rolling(), steps, 0.1, 0.3).unwrap();
            for tick in 0..200 {
                assert_eq!(path.at(0.0025 * f64::from(tick)).q, rolling());
            }
        }
    }

    #[test]
    fn what_the_arm_cannot_do_is_refused() {
        let arm = Puma260::reference();
        let limits = Err(Refusal::Limits);
        let far =
            Pose::from_rows(&[-1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0], &[0.9, 0.0, 0.0]);
        let steps = [to(rolling()), Step { goal: Goal::Tool(far), t_s: None }];
        assert_eq!(
            plan(&arm, &rolling(), &steps, 0.1, 0.3),
            Err(Refusal::Unreachable { index: 1 })
        );
        let hasty = Step { goal: Goal::Joints(rolling().add_scalar(0.3)), t_s: Some(0.2) };
        assert_eq!(plan(&arm, &rolling(), &[hasty], 0.1, 0.3), limits, "acceleration");
        let fast = Step { goal: Goal::Joints(arm.q_max_rad), t_s: Some(1.0) };
        assert_eq!(plan(&arm, &rolling(), &[fast], 0.5, 0.3), limits, "speed");
        let outside = to(arm.q_max_rad.add_scalar(0.01));
        assert_eq!(plan(&arm, &rolling(), &[outside], 0.1, 0.3), limits);
        assert_eq!(plan(&arm, &Joints::repeat(f64::NAN), &[], 0.1, 0.3), limits);
        assert_eq!(plan(&arm, &Joints::repeat(9.0), &[], 0.1, 0.3), limits);
        let many = [to(rolling()); MAX_POINTS];
        assert_eq!(plan(&arm, &rolling(), &many, 0.1, 0.3), limits);
        assert!(plan(&arm, &rolling(), &many[1..], 0.1, 0.3).is_ok(), "exactly full");
        for tau_s in [0.0, -1.0, f64::NAN] {
            assert_eq!(plan(&arm, &rolling(), &[to(rolling())], tau_s, 0.3), limits);
        }
    }

    #[test]
    fn the_fastest_checked_speed_obeys_the_acceleration_even_when_turning_round() {
        let arm = Puma260::reference();
        let there = rolling() + Joints::new(-2.5, 1.5, -0.4, 0.9, -0.7, 0.5);
        let steps = [to(there), to(rolling()), to(there)];
        assert!(plan(&arm, &rolling(), &steps, 0.3, 1.0).is_ok());
        assert!(plan(&arm, &rolling(), &steps, 0.29, 1.0).is_err());
    }
}
