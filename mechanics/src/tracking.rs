//! Leading an arm along a route tick by tick, and on until it rests on its goal: a tool path that
//! passes a wrist singularity may end before the joints have caught up. The same code looks at a
//! move before it starts and makes it, so that what was granted is what is run. Refuses to go on
//! for ever: an arm that is not on its goal [`SETTLE_S`] after the route's end is lost.

use crate::arm::{Arm, FollowError, PathFollower};
use crate::paul::cartesian::CartesianPath;
use crate::paul::{JointPath, Setpoint};
use crate::puma260::Puma260;
use crate::spatial::JointVector;

/// Longest that an arm may take to come to rest on its goal after the route's end (s).
pub const SETTLING_TIME_MAX_S: f64 = 2.0;
/// An arm that rests is no farther than this from its goal (m, rad).
pub const GOAL_TOLERANCE_M_RAD: f64 = 1e-6;
/// Nearer than this is rounding: the goal is met (m, rad).
const GOAL_ROUNDING_M_RAD: f64 = 1e-9;
/// Joints that move less in a tick get no nearer (rad).
const STANDSTILL_STEP_RAD: f64 = 1e-9;

/// A path of either kind, which somebody else holds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PathRef<'a, const N: usize = 6> {
    /// Through joint angles.
    Joint(&'a JointPath<N>),
    /// Along straight lines of the tool.
    Cartesian(&'a CartesianPath),
}

impl<const N: usize> PathRef<'_, N> {
    /// How long it takes (s), settling left out.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        match self {
            PathRef::Joint(path) => path.duration_s(),
            PathRef::Cartesian(path) => path.duration_s(),
        }
    }
}

/// How far an arm has been led.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathTracker<const N: usize = 6, A: Arm<N> = Puma260> {
    follower: A::Follower,
    /// Joint speeds of the last tick (rad/s).
    qd: JointVector<N>,
    /// The route's time in the last tick (s).
    t_s: f64,
    /// For how long the tool has been wanted at one place and not come to rest there (s).
    settling_s: f64,
}

/// One tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackerStep<const N: usize = 6> {
    /// The joints; along a tool path their speeds and accelerations are differences.
    pub setpoint: Setpoint<N>,
    /// Distance of the tool point from its path (m); 0 along a joint path.
    pub position_error_m: f64,
    /// Angle between the tool and its path (rad); 0 along a joint path.
    pub orientation_error_rad: f64,
    /// The route has ended, and the arm rests on its goal from the next tick on.
    pub is_finished: bool,
    /// How long the arm has been settling (s).
    pub settling_s: f64,
    /// Where the route's time stands, the joints can rest from the next tick on.
    pub can_stop: bool,
}

impl<const N: usize, A: Arm<N>> PathTracker<N, A> {
    /// From rest at `q` (rad).
    #[must_use]
    pub fn new(arm: &A, q: &JointVector<N>) -> PathTracker<N, A> {
        PathTracker::with_velocity(arm, q, &JointVector::zeros(), 0.0)
    }

    /// From `q` (rad), where the joints have the speeds `qd` (rad/s), at `t_s` (s) of a route.
    #[must_use]
    pub fn with_velocity(
        arm: &A,
        q: &JointVector<N>,
        qd: &JointVector<N>,
        t_s: f64,
    ) -> PathTracker<N, A> {
        PathTracker { follower: arm.follower(q), qd: *qd, t_s, settling_s: 0.0 }
    }

    /// The joints to which it has led along a tool path (rad).
    #[must_use]
    pub fn joints(&self) -> &JointVector<N> {
        self.follower.joints()
    }

    /// Joint speeds of the last tick (rad/s).
    #[must_use]
    pub fn joint_velocity(&self) -> &JointVector<N> {
        &self.qd
    }

    /// For how long the arm has been on its way to a place that does not move any more (s).
    #[must_use]
    pub fn settling_s(&self) -> f64 {
        self.settling_s
    }

    /// Leads on to `t_s` (s) of `route`, one tick of `dt_s` (s) after the last.
    ///
    /// # Errors
    /// Along a tool path [`FollowError`]; the joints stay as they were when it is the follower's.
    pub fn step(
        &mut self,
        arm: &A,
        route: PathRef<'_, N>,
        t_s: f64,
        dt_s: f64,
    ) -> Result<TrackerStep<N>, FollowError> {
        let ended = t_s >= route.duration_s();
        let path = match route {
            PathRef::Joint(path) => {
                let at = path.at(t_s);
                (self.qd, self.t_s) = (at.qd, t_s);
                let none = TrackerStep {
                    setpoint: at,
                    position_error_m: 0.0,
                    orientation_error_rad: 0.0,
                    is_finished: ended,
                    settling_s: 0.0,
                    can_stop: true,
                };
                return Ok(none);
            }
            PathRef::Cartesian(path) => path,
        };
        let before = *self.follower.joints();
        let got = self.follower.step(&path.at(t_s).pose, dt_s)?;
        let qd = (got.q - before) / dt_s;
        let at = Setpoint { q: got.q, qd, qdd: (qd - self.qd) / dt_s };
        // Two ticks at one place make one of them late.
        let waits = t_s == self.t_s || (ended && self.t_s >= route.duration_s());
        let late_s = if waits { self.settling_s + dt_s } else { 0.0 };
        let still = (0..N).all(|i| can_stop(arm, i, &qd, dt_s));
        let off = got.position_error_m.max(got.orientation_error_rad);
        let stuck = (qd * dt_s).amax() <= STANDSTILL_STEP_RAD;
        let over = ended
            && still
            && (off <= GOAL_ROUNDING_M_RAD || (stuck && off <= GOAL_TOLERANCE_M_RAD));
        if ended && !over && late_s > SETTLING_TIME_MAX_S {
            return Err(if stuck { FollowError::OutOfReach } else { not_settled(arm, &qd) });
        }
        (self.qd, self.t_s) = (qd, t_s);
        self.settling_s = if over { 0.0 } else { late_s };
        Ok(TrackerStep {
            setpoint: at,
            position_error_m: got.position_error_m,
            orientation_error_rad: got.orientation_error_rad,
            is_finished: over,
            settling_s: late_s,
            can_stop: still,
        })
    }
}

/// Whether a joint can stop within one tick.
fn can_stop<const N: usize, A: Arm<N>>(
    arm: &A,
    joint: usize,
    qd: &JointVector<N>,
    dt_s: f64,
) -> bool {
    qd[joint].abs() <= arm.acceleration_max()[joint] * dt_s
}

/// The joint that still has the farthest to go, told by its share of its speed.
fn not_settled<const N: usize, A: Arm<N>>(arm: &A, qd: &JointVector<N>) -> FollowError {
    let share = |joint: &usize| qd[*joint].abs() / arm.speed_max()[*joint];
    let joint = (0..N).max_by(|a, b| share(a).total_cmp(&share(b))).unwrap_or(0);
    FollowError::NotSettled { joint }
}
