//! Planning of legs from a queue of goals: Paul's joint motion, or his straight motion of the tool,
//! from the joints that are desired now. A path that leaves the joints' limits of angle, speed or
//! acceleration is refused before the first step is made; whether the arm can follow a leg is then
//! checked tick by tick ([`crate::program`]). A leg may have 31 moves, and each costs an inverse
//! kinematics, so one move is appended in a job.

use glam::DVec3;
use taktil_mechanics::Pose;
use taktil_mechanics::arm::Arm;
use taktil_mechanics::paul::cartesian::{Blend, CartesianPath};
use taktil_mechanics::paul::{JointPath, PathError, segment_time_s};
use taktil_mechanics::spatial::JointVector;
use taktil_mechanics::spatial::rotation_vector;
use taktil_mechanics::tracking::PathRef;
use taktil_rtcore::StateHash;

use crate::config::{BlendName, Config, Goal, Step};

/// Why a queue cannot be run from here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Infeasible {
    /// Move with this index has no solution within the limits.
    Unreachable {
        /// Position in the queue.
        index: usize,
    },
    /// The start, an angle, a speed or an acceleration is outside the arm's limits, or there are
    /// too many moves.
    Limits,
}

/// Relative tolerance of limits, for rounding.
const LIMIT_TOLERANCE: f64 = 1e-9;

/// The speeds of moves without a prescribed time, and how moves pass intermediate points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathTiming {
    /// Half the time of each transition (s).
    pub tau_s: f64,
    /// Share of the joints' largest speeds.
    pub speed: f64,
    /// Speed of the tool point in straight moves (m/s).
    pub line_m_s: f64,
    /// Speed of turning in straight moves (rad/s).
    pub turn_rad_s: f64,
    /// How the orientation passes a point.
    pub blend: Blend,
}

impl PathTiming {
    /// The pace of a configuration.
    #[must_use]
    pub fn of(config: &Config) -> PathTiming {
        PathTiming {
            tau_s: config.tau_s,
            speed: config.speed,
            line_m_s: config.line_mm_s * 1e-3,
            turn_rad_s: config.turn_deg_s.to_radians(),
            blend: match config.blend {
                BlendName::Paul => Blend::Paul,
                BlendName::Smooth => Blend::Smooth,
                BlendName::So3 => Blend::So3,
            },
        }
    }
}

/// A leg of the queue: it starts at rest, continues as long as steps are of the same kind, and ends
/// at rest. It is planned in place and move by move, so that no job has to plan more than one move.
#[derive(Debug)]
pub struct Leg<const N: usize = 6> {
    joints: JointPath<N>,
    tool: CartesianPath,
    straight: bool,
    /// The step that is planned next.
    next: usize,
    whole: bool,
}

impl<const N: usize> Leg<N> {
    /// Room for a leg, before the first is begun.
    ///
    /// # Errors
    /// A pace whose `tau_s` is not a positive time.
    pub fn empty<A: Arm<N>>(arm: &A, pace: &PathTiming) -> Result<Leg<N>, Infeasible> {
        let rest = JointVector::zeros();
        let tool = CartesianPath::rest(&arm.tool_pose(&rest), pace.tau_s, pace.blend);
        let joints = JointPath::rest(&rest, pace.tau_s);
        let (joints, tool) = (joints.map_err(limits_refusal)?, tool.map_err(limits_refusal)?);
        Ok(Leg { joints, tool, straight: false, next: 0, whole: false })
    }

    /// Begins the leg that starts at rest at `start` (rad) with step `first`; nothing is planned
    /// yet.
    ///
    /// # Errors
    /// A start outside the limits.
    pub fn begin<A: Arm<N>>(
        &mut self,
        arm: &A,
        start: &JointVector<N>,
        steps: &[Step<N>],
        first: usize,
        pace: &PathTiming,
    ) -> Result<(), Infeasible> {
        if !arm.within_limits(start) {
            return Err(Infeasible::Limits);
        }
        self.straight = steps.get(first).is_some_and(|step| step.straight);
        (self.next, self.whole) = (first, false);
        if self.straight {
            self.tool.restart(&arm.tool_pose(start), pace.tau_s, pace.blend).map_err(limits_refusal)
        } else {
            self.joints.restart(start, pace.tau_s).map_err(limits_refusal)
        }
    }

    /// Plans the next step, if the leg has one more. An empty rest of the queue is a wait of two
    /// tau.
    ///
    /// A tool goal of a joint move takes the branch of the inverse kinematics nearest to the point
    /// before it. Moves without a time get the shortest at which no joint is faster than its share
    /// of its limit, or the tool than its speeds, and at least two tau.
    ///
    /// # Errors
    /// [`Infeasible`], its index counted from the beginning of the queue.
    pub fn append_move<A: Arm<N>>(
        &mut self,
        arm: &A,
        steps: &[Step<N>],
        pace: &PathTiming,
    ) -> Result<(), Infeasible> {
        if self.whole {
            return Ok(());
        }
        match steps.get(self.next) {
            None => self.append_wait(pace)?,
            Some(step) if self.straight => self.append_straight_move(arm, step, pace)?,
            Some(step) => self.append_joint_move(arm, step, pace)?,
        }
        self.next = steps.len().min(self.next + 1);
        self.whole = steps.get(self.next).is_none_or(|step| step.straight != self.straight);
        // The end comes to rest as well; it did not have to while the leg went on.
        if self.whole && !self.straight {
            self.check_corner(arm, self.joints.points().len() - 1)?;
        }
        Ok(())
    }

    /// Copies another leg into this one's place.
    pub fn copy(&mut self, other: &Leg<N>) {
        self.joints.clone_from(&other.joints);
        self.tool.clone_from(&other.tool);
        (self.straight, self.next, self.whole) = (other.straight, other.next, other.whole);
    }

    /// Whether a step is of the kind of this leg.
    #[must_use]
    pub fn continues_with(&self, step: &Step<N>) -> bool {
        step.straight == self.straight
    }

    /// Appends one more step of the same kind. The path is unchanged until two tau before its
    /// former end.
    ///
    /// # Errors
    /// As [`Leg::append_move`], and a full leg. The leg is unusable after an error.
    pub fn extend<A: Arm<N>>(
        &mut self,
        arm: &A,
        step: &Step<N>,
        pace: &PathTiming,
    ) -> Result<(), Infeasible> {
        self.whole = false;
        self.next = 0;
        self.append_move(arm, core::slice::from_ref(step), pace)
    }

    /// Moves whose end lies after `t_s` (s) of the leg's time.
    #[must_use]
    pub fn moves_left(&self, t_s: f64) -> usize {
        let ends = match self.route() {
            PathRef::Joint(path) => path.corners_s(),
            PathRef::Cartesian(path) => path.corners_s(),
        };
        ends.iter().skip(1).filter(|end_s| **end_s > t_s).count()
    }

    /// Whether everything is planned.
    #[must_use]
    pub fn is_whole(&self) -> bool {
        self.whole
    }

    /// The step after those planned so far.
    #[must_use]
    pub fn next_step(&self) -> usize {
        self.next
    }

    /// The path planned so far, which ends at rest.
    #[must_use]
    pub fn route(&self) -> PathRef<'_, N> {
        if self.straight { PathRef::Cartesian(&self.tool) } else { PathRef::Joint(&self.joints) }
    }

    /// Adds the progress of the planning to the digest; the path itself follows from the queue and
    /// the start.
    pub fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.straight).add(&self.next).add(&self.whole);
        if let (false, Some(q)) = (self.straight, self.joints.points().last()) {
            hash.add(q.as_slice());
        }
        if let (true, Some(pose)) = (self.straight, self.tool.points().last()) {
            hash.add(&pose.translation.to_array());
        }
    }

    fn append_wait(&mut self, pace: &PathTiming) -> Result<(), Infeasible> {
        let here = self.joints.points().last().copied().unwrap_or_else(JointVector::zeros);
        self.joints.push(&here, 2.0 * pace.tau_s).map_err(limits_refusal)
    }

    /// One straight move of the tool.
    fn append_straight_move<A: Arm<N>>(
        &mut self,
        arm: &A,
        step: &Step<N>,
        pace: &PathTiming,
    ) -> Result<(), Infeasible> {
        let before = self.tool.points().last().copied().unwrap_or_default();
        let pose = match &step.goal {
            Goal::Tool(pose) => *pose,
            Goal::By(shift) => shifted(&before, shift),
            Goal::Joints(q) => arm.tool_pose(q),
        };
        if !arm.is_within_reach_bound(&pose) {
            return Err(Infeasible::Unreachable { index: self.next });
        }
        let way = (pose.translation - before.translation).length() / pace.line_m_s;
        let turn = rotation_vector(&before.rotation, &pose.rotation).length() / pace.turn_rad_s;
        let time_s = step.t_s.unwrap_or(way.max(turn).max(2.0 * pace.tau_s));
        self.tool.push(&pose, time_s).map_err(limits_refusal)
    }

    /// One move of the joints.
    fn append_joint_move<A: Arm<N>>(
        &mut self,
        arm: &A,
        step: &Step<N>,
        pace: &PathTiming,
    ) -> Result<(), Infeasible> {
        let corner = self.joints.points().len() - 1;
        let before = self.joints.points()[corner];
        let unreachable = Infeasible::Unreachable { index: self.next };
        let point = match &step.goal {
            Goal::Joints(q) => *q,
            Goal::Tool(pose) => arm.inverse_kinematics_near(pose, &before).ok_or(unreachable)?,
            Goal::By(shift) => {
                let pose = shifted(&arm.tool_pose(&before), shift);
                arm.inverse_kinematics_near(&pose, &before).ok_or(unreachable)?
            }
        };
        let speed_max = arm.speed_max() * pace.speed;
        let time_s =
            step.t_s.unwrap_or_else(|| segment_time_s(&before, &point, &speed_max, pace.tau_s));
        self.joints.push(&point, time_s).map_err(limits_refusal)?;
        let able = arm.within_limits(&point)
            && is_below(&self.joints.segment_speed(corner), arm.speed_max());
        if !able {
            return Err(Infeasible::Limits);
        }
        self.check_corner(arm, corner)
    }

    /// Checks that a corner does not need more acceleration than the arm has.
    fn check_corner<A: Arm<N>>(&self, arm: &A, corner: usize) -> Result<(), Infeasible> {
        let peak = self.joints.corner_acceleration(corner);
        if is_below(&peak, arm.acceleration_max()) { Ok(()) } else { Err(Infeasible::Limits) }
    }
}

/// Reports an error of a path that the earlier checks should have found.
fn limits_refusal(_: PathError) -> Infeasible {
    Infeasible::Limits
}

/// A pose displaced along its own axes (m).
fn shifted(pose: &Pose, shift: &[f64; 3]) -> Pose {
    Pose::new(pose.rotation, pose.apply(DVec3::from_array(*shift)))
}

fn is_below<const N: usize>(values: &JointVector<N>, limits: &JointVector<N>) -> bool {
    (0..N).all(|i| values[i] <= limits[i] * (1.0 + LIMIT_TOLERANCE))
}

#[cfg(test)]
mod tests {
    use super::*;
    use taktil_mechanics::Joints;
    use taktil_mechanics::paul::MAX_POINTS;
    use taktil_mechanics::puma260::Puma260;
    use taktil_mechanics::spatial::rotation_y;

    fn rolling() -> Joints {
        Joints::from([0.0, 40.2, -153.4, -180.0, 66.8, 180.0].map(f64::to_radians))
    }

    fn pace(tau_s: f64, speed: f64) -> PathTiming {
        PathTiming { tau_s, speed, ..PathTiming::of(&Config::default()) }
    }

    fn to(q: Joints) -> Step {
        Step { goal: Goal::Joints(q), straight: false, t_s: None }
    }

    /// Plans a whole leg at once.
    fn leg(
        arm: &Puma260,
        start: &Joints,
        steps: &[Step],
        first: usize,
        pace: &PathTiming,
    ) -> Result<Leg, Infeasible> {
        let mut leg = Leg::empty(arm, pace)?;
        leg.begin(arm, start, steps, first, pace)?;
        while !leg.is_whole() {
            leg.append_move(arm, steps, pace)?;
        }
        Ok(leg)
    }

    fn plan(
        arm: &Puma260,
        start: &Joints,
        steps: &[Step],
        pace: &PathTiming,
    ) -> Result<JointPath, Infeasible> {
        leg(arm, start, steps, 0, pace).map(|leg| leg.joints)
    }

    #[test]
    fn a_path_starts_and_ends_at_rest_and_keeps_the_speed() {
        let arm = Puma260::reference();
        let goal = rolling() + Joints::new(0.5, 0.1, 0.2, 0.0, -0.3, 0.4);
        let path = plan(&arm, &rolling(), &[to(goal), to(rolling())], &pace(0.1, 0.3)).unwrap();
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
        let step = Step { goal: Goal::Tool(there), straight: false, t_s: Some(1.0) };
        let path = plan(&arm, &rolling(), &[step], &pace(0.1, 0.3)).unwrap();
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
        let step = Step { goal: Goal::By([0.003, 0.0, 0.012]), straight: false, t_s: None };
        let path = plan(&arm, &rolling(), &[step, step], &pace(0.1, 0.3)).unwrap();
        let got = arm.tool_pose(&path.at(path.duration_s()).q);
        let wanted = here.apply(DVec3::new(0.006, 0.0, 0.024));
        assert!((got.translation - wanted).length() < 1e-12);
        assert!(got.rotation.abs_diff_eq(here.rotation, 1e-12));
    }

    #[test]
    fn an_empty_queue_and_a_goal_where_the_arm_is_stand_still() {
        let arm = Puma260::reference();
        for steps in [&[][..], &[to(rolling())][..]] {
            let path = plan(&arm, &rolling(), steps, &pace(0.1, 0.3)).unwrap();
            for tick in 0..200 {
                assert_eq!(path.at(0.0025 * f64::from(tick)).q, rolling());
            }
        }
    }

    #[test]
    fn what_the_arm_cannot_do_is_refused() {
        let arm = Puma260::reference();
        let limits = Err(Infeasible::Limits);
        let far =
            Pose::from_rows(&[-1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0], &[0.9, 0.0, 0.0]);
        let steps = [to(rolling()), Step { goal: Goal::Tool(far), straight: false, t_s: None }];
        assert_eq!(
            plan(&arm, &rolling(), &steps, &pace(0.1, 0.3)),
            Err(Infeasible::Unreachable { index: 1 })
        );
        let hasty =
            Step { goal: Goal::Joints(rolling().add_scalar(0.3)), straight: false, t_s: Some(0.2) };
        assert_eq!(plan(&arm, &rolling(), &[hasty], &pace(0.1, 0.3)), limits, "acceleration");
        let fast = Step { goal: Goal::Joints(arm.q_max_rad), straight: false, t_s: Some(1.0) };
        assert_eq!(plan(&arm, &rolling(), &[fast], &pace(0.5, 0.3)), limits, "speed");
        let outside = to(arm.q_max_rad.add_scalar(0.01));
        assert_eq!(plan(&arm, &rolling(), &[outside], &pace(0.1, 0.3)), limits);
        assert_eq!(plan(&arm, &Joints::repeat(f64::NAN), &[], &pace(0.1, 0.3)), limits);
        assert_eq!(plan(&arm, &Joints::repeat(9.0), &[], &pace(0.1, 0.3)), limits);
        let many = [to(rolling()); MAX_POINTS];
        assert_eq!(plan(&arm, &rolling(), &many, &pace(0.1, 0.3)), limits);
        assert!(plan(&arm, &rolling(), &many[1..], &pace(0.1, 0.3)).is_ok(), "exactly full");
        for tau_s in [0.0, -1.0, f64::NAN] {
            assert_eq!(plan(&arm, &rolling(), &[to(rolling())], &pace(tau_s, 0.3)), limits);
        }
    }

    #[test]
    fn the_fastest_checked_speed_obeys_the_acceleration_even_when_turning_round() {
        let arm = Puma260::reference();
        let there = rolling() + Joints::new(-2.5, 1.5, -0.4, 0.9, -0.7, 0.5);
        let steps = [to(there), to(rolling()), to(there)];
        assert!(plan(&arm, &rolling(), &steps, &pace(0.3, 1.0)).is_ok());
        assert!(plan(&arm, &rolling(), &steps, &pace(0.29, 1.0)).is_err());
    }

    #[test]
    fn legs_are_of_one_kind_and_join_at_rest() {
        let arm = Puma260::reference();
        let by = |x: f64| Step { goal: Goal::By([x, 0.0, 0.0]), straight: true, t_s: None };
        let aside = to(rolling() + Joints::new(0.1, 0.0, 0.0, 0.0, 0.0, 0.0));
        let steps = [aside, by(0.01), by(-0.02), aside];
        let pace = pace(0.1, 0.3);
        let one = leg(&arm, &rolling(), &steps, 0, &pace).unwrap();
        assert!(matches!(one.route(), PathRef::Joint(_)) && one.next_step() == 1);
        let start = aside_joints();
        let two = leg(&arm, &start, &steps, 1, &pace).unwrap();
        let PathRef::Cartesian(path) = two.route() else { panic!("a straight leg") };
        assert_eq!((two.next_step(), path.points().len()), (3, 3));
        assert_eq!(path.points()[0], arm.tool_pose(&start));
        let span = path.points()[2].translation - path.points()[0].translation;
        assert!((span.length() - 0.01).abs() < 1e-12);
        // 10 mm and 20 mm at 50 mm/s, and two tau.
        assert!((path.duration_s() - 0.8).abs() < 1e-9, "{}", path.duration_s());
        assert_eq!(leg(&arm, &start, &steps, 3, &pace).unwrap().next_step(), 4);
        let wait = leg(&arm, &start, &steps, 4, &pace).unwrap();
        assert_eq!((wait.next_step(), wait.route().duration_s()), (4, 0.4), "a wait");
        let far = [aside, by(0.01), by(0.9)];
        let refused = leg(&arm, &start, &far, 1, &pace);
        assert_eq!(refused.err(), Some(Infeasible::Unreachable { index: 2 }));
    }

    #[test]
    fn a_leg_laid_over_another_is_as_if_laid_alone() {
        let arm = Puma260::reference();
        let by = |x: f64, straight| Step { goal: Goal::By([x, 0.0, 0.01]), straight, t_s: None };
        let steps = [by(0.01, true), by(-0.02, true), by(0.02, false), by(0.01, false)];
        let pace = pace(0.1, 0.3);
        let mut used = leg(&arm, &aside_joints(), &steps, 0, &pace).unwrap();
        for (first, moves) in [(2, 2), (1, 1), (3, 1), (0, 2)] {
            used.begin(&arm, &rolling(), &steps, first, &pace).unwrap();
            let mut laid = 0;
            while !used.is_whole() {
                used.append_move(&arm, &steps, &pace).unwrap();
                laid += 1;
            }
            let fresh = leg(&arm, &rolling(), &steps, first, &pace).unwrap();
            assert_eq!((laid, used.next_step()), (moves, fresh.next_step()), "one move a job");
            assert_eq!(used.route().duration_s(), fresh.route().duration_s());
            for tick in 0..1000 {
                let t_s = 0.0025 * f64::from(tick);
                match (used.route(), fresh.route()) {
                    (PathRef::Joint(a), PathRef::Joint(b)) => assert_eq!(a.at(t_s), b.at(t_s)),
                    (PathRef::Cartesian(a), PathRef::Cartesian(b)) => {
                        assert_eq!(a.at(t_s), b.at(t_s))
                    }
                    other => panic!("{other:?}"),
                }
            }
        }
    }

    fn aside_joints() -> Joints {
        rolling() + Joints::new(0.1, 0.0, 0.0, 0.0, 0.0, 0.0)
    }
}
