//! Leading an arm along a route tick by tick, and on until it rests on its goal: a tool path that
//! passes a wrist singularity may end before the joints have caught up. The same code looks at a
//! move before it starts and makes it, so that what was granted is what is run. Refuses to go on
//! for ever: an arm that is not on its goal [`SETTLE_S`] after the route's end is lost.

use crate::arm::{Arm, Follow, Lost};
use crate::paul::cartesian::CartesianPath;
use crate::paul::{JointPath, Setpoint};
use crate::puma260::Puma260;
use crate::spatial::JointVector;

/// Longest that an arm may take to come to rest on its goal after the route's end (s).
pub const SETTLE_S: f64 = 2.0;
/// An arm that rests is no farther than this from its goal (m, rad).
pub const REST_TOLERANCE: f64 = 1e-6;
/// Nearer than this is rounding: the goal is met (m, rad).
const ROUNDING: f64 = 1e-9;
/// Joints that move less in a tick get no nearer (rad).
const STUCK_RAD: f64 = 1e-9;

/// A path of either kind, which somebody else holds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Route<'a, const N: usize = 6> {
    /// Through joint angles.
    Joints(&'a JointPath<N>),
    /// Along straight lines of the tool.
    Tool(&'a CartesianPath),
}

impl<const N: usize> Route<'_, N> {
    /// How long it takes (s), settling left out.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        match self {
            Route::Joints(path) => path.duration_s(),
            Route::Tool(path) => path.duration_s(),
        }
    }
}

/// How far an arm has been led.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lead<const N: usize = 6, A: Arm<N> = Puma260> {
    follower: A::Follower,
    /// Joint speeds of the last tick (rad/s).
    qd: JointVector<N>,
    /// The route's time in the last tick (s).
    t_s: f64,
    /// For how long the tool has been wanted at one place and not come to rest there (s).
    late_s: f64,
}

/// One tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Led<const N: usize = 6> {
    /// The joints; along a tool path their speeds and accelerations are differences.
    pub at: Setpoint<N>,
    /// Distance of the tool point from its path (m); 0 along a joint path.
    pub off_m: f64,
    /// Angle between the tool and its path (rad); 0 along a joint path.
    pub off_rad: f64,
    /// The route has ended, and the arm rests on its goal from the next tick on.
    pub over: bool,
    /// How long the arm has been settling (s).
    pub late_s: f64,
    /// Where the route's time stands, the joints can rest from the next tick on.
    pub still: bool,
}

impl<const N: usize, A: Arm<N>> Lead<N, A> {
    /// From rest at `q` (rad).
    #[must_use]
    pub fn new(arm: &A, q: &JointVector<N>) -> Lead<N, A> {
        Lead::moving(arm, q, &JointVector::zeros(), 0.0)
    }

    /// From `q` (rad), where the joints have the speeds `qd` (rad/s), at `t_s` (s) of a route.
    #[must_use]
    pub fn moving(arm: &A, q: &JointVector<N>, qd: &JointVector<N>, t_s: f64) -> Lead<N, A> {
        Lead { follower: arm.follower(q), qd: *qd, t_s, late_s: 0.0 }
    }

    /// The joints to which it has led along a tool path (rad).
    #[must_use]
    pub fn joints(&self) -> &JointVector<N> {
        self.follower.joints()
    }

    /// Joint speeds of the last tick (rad/s).
    #[must_use]
    pub fn speeds(&self) -> &JointVector<N> {
        &self.qd
    }

    /// For how long the arm has been on its way to a place that does not move any more (s).
    #[must_use]
    pub fn late_s(&self) -> f64 {
        self.late_s
    }

    /// Leads on to `t_s` (s) of `route`, one tick of `dt_s` (s) after the last.
    ///
    /// # Errors
    /// Along a tool path [`Lost`]; the joints stay as they were when it is the follower's.
    pub fn step(
        &mut self,
        arm: &A,
        route: Route<'_, N>,
        t_s: f64,
        dt_s: f64,
    ) -> Result<Led<N>, Lost> {
        let ended = t_s >= route.duration_s();
        let path = match route {
            Route::Joints(path) => {
                let at = path.at(t_s);
                (self.qd, self.t_s) = (at.qd, t_s);
                let none =
                    Led { at, off_m: 0.0, off_rad: 0.0, over: ended, late_s: 0.0, still: true };
                return Ok(none);
            }
            Route::Tool(path) => path,
        };
        let before = *self.follower.joints();
        let got = self.follower.step(&path.at(t_s).pose, dt_s)?;
        let qd = (got.q - before) / dt_s;
        let at = Setpoint { q: got.q, qd, qdd: (qd - self.qd) / dt_s };
        // Two ticks at one place make one of them late.
        let waits = t_s == self.t_s || (ended && self.t_s >= route.duration_s());
        let late_s = if waits { self.late_s + dt_s } else { 0.0 };
        let still = (0..N).all(|i| slow(arm, i, &qd, dt_s));
        let off = got.off_m.max(got.off_rad);
        let stuck = (qd * dt_s).amax() <= STUCK_RAD;
        let over = ended && still && (off <= ROUNDING || (stuck && off <= REST_TOLERANCE));
        if ended && !over && late_s > SETTLE_S {
            return Err(if stuck { Lost::OutOfReach } else { behind(arm, &qd) });
        }
        (self.qd, self.t_s) = (qd, t_s);
        self.late_s = if over { 0.0 } else { late_s };
        Ok(Led { at, off_m: got.off_m, off_rad: got.off_rad, over, late_s, still })
    }
}

/// Whether a joint can stop within one tick.
fn slow<const N: usize, A: Arm<N>>(arm: &A, joint: usize, qd: &JointVector<N>, dt_s: f64) -> bool {
    qd[joint].abs() <= arm.acceleration_max()[joint] * dt_s
}

/// The joint that still has the farthest to go, told by its share of its speed.
fn behind<const N: usize, A: Arm<N>>(arm: &A, qd: &JointVector<N>) -> Lost {
    let share = |joint: &usize| qd[*joint].abs() / arm.speed_max()[*joint];
    let joint = (0..N).max_by(|a, b| share(a).total_cmp(&share(b))).unwrap_or(0);
    Lost::Behind { joint }
}
