//! Tracking of a path tick by tick, until the arm rests at its goal. A tool path that passes a
//! wrist singularity may end before the joints have caught up with it; then the tracker goes on
//! until the arm has settled, for at most [`SETTLING_TIME_MAX_S`].
//!
//! The same code checks a move before it starts ([`feasibility`](crate::feasibility)) and makes it,
//! so that the motion that was checked is the motion that runs.

use crate::arm::{Arm, FollowError, PathFollower};
use crate::paul::cartesian::CartesianPath;
use crate::paul::{JointPath, Setpoint};
use crate::puma260::Puma260;
use crate::spatial::JointVector;

/// Longest time that an arm may take to come to rest at its goal after the end of the path (s).
pub const SETTLING_TIME_MAX_S: f64 = 2.0;
/// Largest error of the tool pose of an arm that rests at its goal (m for the position, rad for the
/// orientation).
pub const GOAL_TOLERANCE_M_RAD: f64 = 1e-6;
/// An error of the tool pose below this is rounding: the goal is reached at once (m, rad).
const GOAL_ROUNDING_M_RAD: f64 = 1e-9;
/// Joints that move less than this in one tick do not come nearer to the goal any more (rad).
const STANDSTILL_STEP_RAD: f64 = 1e-9;

/// A borrowed path, through joint angles or of the tool.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PathRef<'a, const N: usize = 6> {
    /// A path through joint angles.
    Joint(&'a JointPath<N>),
    /// A path of the tool along straight lines.
    Cartesian(&'a CartesianPath),
}

impl<const N: usize> PathRef<'_, N> {
    /// The duration of the path (s), without the time to settle.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        match self {
            PathRef::Joint(path) => path.duration_s(),
            PathRef::Cartesian(path) => path.duration_s(),
        }
    }
}

/// The state of an arm that tracks a path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathTracker<const N: usize = 6, A: Arm<N> = Puma260> {
    follower: A::Follower,
    /// Joint speeds of the last tick (rad/s).
    qd: JointVector<N>,
    /// Time on the path in the last tick (s).
    t_s: f64,
    /// For how long the path has stood still while the arm had not yet come to rest (s).
    settling_s: f64,
}

/// The result of one tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackerStep<const N: usize = 6> {
    /// The setpoint of the joints. Along a tool path its speeds and accelerations are differences
    /// of the last ticks.
    pub setpoint: Setpoint<N>,
    /// Distance of the tool point from its path (m); 0 along a joint path.
    pub position_error_m: f64,
    /// Angle between the tool and its path (rad); 0 along a joint path.
    pub orientation_error_rad: f64,
    /// The path has ended, and the arm rests at its goal from the next tick on.
    pub is_finished: bool,
    /// For how long the arm has been settling (s).
    pub settling_s: f64,
    /// If the time on the path stood still now, every joint could rest from the next tick on.
    pub can_stop: bool,
}

impl<const N: usize, A: Arm<N>> PathTracker<N, A> {
    /// A tracker at the start of a path, from rest at `q` (rad).
    #[must_use]
    pub fn new(arm: &A, q: &JointVector<N>) -> PathTracker<N, A> {
        PathTracker::with_velocity(arm, q, &JointVector::zeros(), 0.0)
    }

    /// A tracker at the time `t_s` (s) of a path, from joints `q` (rad) that move at `qd` (rad/s).
    #[must_use]
    pub fn with_velocity(
        arm: &A,
        q: &JointVector<N>,
        qd: &JointVector<N>,
        t_s: f64,
    ) -> PathTracker<N, A> {
        PathTracker { follower: arm.follower(q), qd: *qd, t_s, settling_s: 0.0 }
    }

    /// The joints of the last tick along a tool path (rad).
    #[must_use]
    pub fn joints(&self) -> &JointVector<N> {
        self.follower.joints()
    }

    /// Joint speeds of the last tick (rad/s).
    #[must_use]
    pub fn joint_velocity(&self) -> &JointVector<N> {
        &self.qd
    }

    /// For how long the arm has been settling at a pose that does not move any more (s).
    #[must_use]
    pub fn settling_s(&self) -> f64 {
        self.settling_s
    }

    /// Goes on to the time `t_s` (s) of `path`, one tick of `dt_s` (s) after the last one.
    ///
    /// # Errors
    /// [`FollowError`] along a tool path. Where the follower reports it, the joints of the last
    /// tick are kept.
    pub fn step(
        &mut self,
        arm: &A,
        path: PathRef<'_, N>,
        t_s: f64,
        dt_s: f64,
    ) -> Result<TrackerStep<N>, FollowError> {
        let has_ended = t_s >= path.duration_s();
        let path = match path {
            PathRef::Joint(path) => {
                let setpoint = path.at(t_s);
                (self.qd, self.t_s) = (setpoint.qd, t_s);
                return Ok(TrackerStep {
                    setpoint,
                    position_error_m: 0.0,
                    orientation_error_rad: 0.0,
                    is_finished: has_ended,
                    settling_s: 0.0,
                    can_stop: true,
                });
            }
            PathRef::Cartesian(path) => path,
        };
        let previous_q = *self.follower.joints();
        let followed = self.follower.step(&path.at(t_s).pose, dt_s)?;
        let qd = (followed.q - previous_q) / dt_s;
        let setpoint = Setpoint { q: followed.q, qd, qdd: (qd - self.qd) / dt_s };
        // The arm settles only in ticks whose pose is that of the tick before.
        let is_standing = t_s == self.t_s || (has_ended && self.t_s >= path.duration_s());
        let settling_s = if is_standing { self.settling_s + dt_s } else { 0.0 };
        let can_stop = (0..N).all(|i| can_stop(arm, i, &qd, dt_s));
        let error = followed.position_error_m.max(followed.orientation_error_rad);
        let is_stuck = (qd * dt_s).amax() <= STANDSTILL_STEP_RAD;
        // A follower that makes no more progress rests at its goal within the wider tolerance.
        let is_at_goal =
            error <= GOAL_ROUNDING_M_RAD || (is_stuck && error <= GOAL_TOLERANCE_M_RAD);
        let is_finished = has_ended && can_stop && is_at_goal;
        if has_ended && !is_finished && settling_s > SETTLING_TIME_MAX_S {
            return Err(if is_stuck { FollowError::OutOfReach } else { not_settled(arm, &qd) });
        }
        (self.qd, self.t_s) = (qd, t_s);
        self.settling_s = if is_finished { 0.0 } else { settling_s };
        Ok(TrackerStep {
            setpoint,
            position_error_m: followed.position_error_m,
            orientation_error_rad: followed.orientation_error_rad,
            is_finished,
            settling_s,
            can_stop,
        })
    }
}

/// Whether a joint can stop within one tick of `dt_s` (s) at its largest acceleration.
fn can_stop<const N: usize, A: Arm<N>>(
    arm: &A,
    joint: usize,
    qd: &JointVector<N>,
    dt_s: f64,
) -> bool {
    qd[joint].abs() <= arm.acceleration_max()[joint] * dt_s
}

/// The error that names the joint which still moves fastest in relation to its largest speed.
fn not_settled<const N: usize, A: Arm<N>>(arm: &A, qd: &JointVector<N>) -> FollowError {
    let speed_ratio = |joint: &usize| qd[*joint].abs() / arm.speed_max()[*joint];
    let joint = (0..N).max_by(|a, b| speed_ratio(a).total_cmp(&speed_ratio(b))).unwrap_or(0);
    FollowError::NotSettled { joint }
}
