//! The check of a whole move before it starts: the arm is led along it tick by tick until it rests
//! on its goal, and the first thing that it could not do is named with joint and time. Refuses
//! nothing for being slow: what a move costs (time, speed, torque, distance from singularities,
//! deviation) comes back as figures.
//!
//! [`FeasibilityCheck`] does so a few ticks at a time, for a lane that has a deadline; [`FeasibilityReport::of`]
//! does it at once.

use core::fmt;

use crate::arm::{Arm, ArmDynamics, FollowError};
use crate::puma260::Puma260;
use crate::spatial::JointVector;
use crate::tracking::{PathRef, PathTracker};

/// Most ticks that a preview walks.
const TICKS_MAX: f64 = 1e7;
/// The torque is looked at in one of so many ticks: it costs more than all the rest.
const TORQUE_CHECK_TICKS: u32 = 4;
/// Rounding that a limit forgives, relative.
const LIMIT_ROUNDING: f64 = 1e-9;

/// The arm, and what a move may ask of it.
#[derive(Clone, Debug)]
pub struct FeasibilityCriteria<const N: usize = 6, A: Arm<N> = Puma260> {
    /// Limits of angle, speed and acceleration, and the tool.
    pub arm: A,
    /// ArmDynamics, tool and motors, for the torque.
    pub dynamics: A::Dynamics,
    /// Largest torque of each joint (N m); infinite where it does not matter.
    pub torque_max_nm: JointVector<N>,
    /// Largest distance of the tool point from its path (m), past a wrist singularity.
    pub position_error_max_m: f64,
    /// Largest angle between the tool and its path (rad), past a wrist singularity.
    pub orientation_error_max_rad: f64,
    /// Time between two looks: the control period (s).
    pub tick_s: f64,
}

/// A figure and when it was reached.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extremum {
    /// The figure.
    pub value: f64,
    /// When, from the start of the move (s).
    pub t_s: f64,
}

/// What a move that can be made will cost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeasibilityReport<const N: usize = 6> {
    /// How long it takes (s), settling included.
    pub duration_s: f64,
    /// How long after the route's end the arm comes to rest on its goal (s); 0 unless it passed a
    /// wrist singularity shortly before.
    pub settling_s: f64,
    /// Largest speed of each joint over its limit.
    pub speed_ratio: [Extremum; N],
    /// Largest torque of each joint over its limit, 0 for a limit without end.
    pub torque_ratio: [Extremum; N],
    /// Smallest scaled distances from the singularities of shoulder, elbow and wrist, in size.
    pub singularity: [Extremum; 3],
    /// Largest distance of the tool point from its path (m).
    pub position_error_m: Extremum,
    /// Largest angle between the tool and its path (rad).
    pub orientation_error_rad: Extremum,
    /// Joints at the end (rad).
    pub end_q: JointVector<N>,
}

/// Why a move is not started.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Infeasible {
    /// The arm cannot follow.
    NotFollowed {
        /// Why.
        error: FollowError,
        /// When (s).
        t_s: f64,
    },
    /// This joint (0 is the first) would need more torque than it has, by this ratio.
    Torque {
        /// Index of the joint.
        joint: usize,
        /// Torque wanted over the torque there is.
        ratio: f64,
        /// When (s).
        t_s: f64,
    },
    /// Past a wrist singularity the tool would leave its path by more than is allowed.
    PathDeviation {
        /// Distance of the tool point (m).
        position_error_m: f64,
        /// Angle of the tool (rad).
        orientation_error_rad: f64,
        /// When (s).
        t_s: f64,
    },
    /// The move does not start where the arm is.
    StartMismatch {
        /// Distance of the tool point (m) or, for a joint path, of the farthest joint (rad).
        distance: f64,
    },
    /// The tick is not a positive time, or the move has more than ten million of them.
    InvalidTick,
}

impl fmt::Display for Infeasible {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Infeasible::NotFollowed { error: why, t_s } => {
                write!(f, "{why} after {t_s:.3} s of the move")
            }
            Infeasible::Torque { joint, ratio, t_s } => write!(
                f,
                "joint {} would need {ratio:.2} times its torque after {t_s:.3} s of the move",
                joint + 1
            ),
            Infeasible::PathDeviation {
                position_error_m: off_m,
                orientation_error_rad: off_rad,
                t_s,
            } => write!(
                f,
                "past the wrist singularity the tool would be {:.3} mm and {off_rad:.4} rad off \
                 its path after {t_s:.3} s of the move",
                off_m * 1e3
            ),
            Infeasible::StartMismatch { distance: off } => {
                write!(f, "the move starts {off:.4} m or rad from where the arm is")
            }
            Infeasible::InvalidTick => {
                write!(f, "the time between two looks does not fit the move")
            }
        }
    }
}

impl core::error::Error for Infeasible {}

/// How far the start of a move may be from the arm (m, rad).
const START_TOLERANCE_M_RAD: f64 = 1e-6;

/// Refuses to start `route` anywhere but at joints `start` (rad).
fn check_start<const N: usize, A: Arm<N>>(
    route: PathRef<'_, N>,
    start: &JointVector<N>,
    arm: &A,
) -> Result<(), Infeasible> {
    let (off, turned) = match route {
        PathRef::Joint(path) => ((path.points()[0] - start).amax(), false),
        PathRef::Cartesian(path) => {
            let (wanted, here) = (path.points()[0], arm.tool_pose(start));
            let turn = wanted.rotation.transpose() * here.rotation;
            let square = turn.abs_diff_eq(glam::DMat3::IDENTITY, START_TOLERANCE_M_RAD);
            ((wanted.translation - here.translation).length(), !square)
        }
    };
    if off.is_nan() || off > START_TOLERANCE_M_RAD || turned {
        return Err(Infeasible::StartMismatch { distance: off });
    }
    Ok(())
}

/// Gathers figures along the way.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Evaluation<const N: usize> {
    report: FeasibilityReport<N>,
    /// Joints one tick ago (rad).
    previous_q: JointVector<N>,
    /// Joints at the last look at the torque and the one before (rad).
    torque_samples: [JointVector<N>; 2],
    /// Ticks since the last look at the torque.
    ticks_since_torque: u32,
}

impl<const N: usize> Evaluation<N> {
    fn new(start: &JointVector<N>, duration_s: f64) -> Evaluation<N> {
        let least = Extremum { value: 0.0, t_s: 0.0 };
        let preview = FeasibilityReport {
            duration_s,
            settling_s: 0.0,
            speed_ratio: [least; N],
            torque_ratio: [least; N],
            singularity: [Extremum { value: f64::INFINITY, t_s: 0.0 }; 3],
            position_error_m: least,
            orientation_error_rad: least,
            end_q: *start,
        };
        Evaluation {
            report: preview,
            previous_q: *start,
            torque_samples: [*start; 2],
            ticks_since_torque: 0,
        }
    }

    /// Takes in the joints at `t_s`: their speed since the last tick, now and then their torque.
    fn step<A: Arm<N>>(
        &mut self,
        q: &JointVector<N>,
        t_s: f64,
        terms: &FeasibilityCriteria<N, A>,
    ) -> Result<(), Infeasible> {
        let FeasibilityCriteria { arm, tick_s, .. } = terms;
        let speed = (q - self.previous_q) / *tick_s;
        for joint in 0..N {
            let share = speed[joint].abs() / arm.speed_max()[joint];
            update_maximum(&mut self.report.speed_ratio[joint], share, t_s);
            if share > 1.0 + LIMIT_ROUNDING {
                let why = FollowError::SpeedLimit { joint, ratio: share };
                return Err(Infeasible::NotFollowed { error: why, t_s });
            }
        }
        self.ticks_since_torque += 1;
        if self.ticks_since_torque == TORQUE_CHECK_TICKS {
            self.ticks_since_torque = 0;
            self.check_torque(q, t_s, terms)?;
        }
        for (least, part) in self.report.singularity.iter_mut().zip(arm.singularity_distances(q)) {
            if part < least.value {
                *least = Extremum { value: part, t_s };
            }
        }
        self.previous_q = *q;
        self.report.end_q = *q;
        Ok(())
    }

    /// The torque at the last look, from the joints before, at and after it.
    fn check_torque<A: Arm<N>>(
        &mut self,
        q: &JointVector<N>,
        t_s: f64,
        terms: &FeasibilityCriteria<N, A>,
    ) -> Result<(), Infeasible> {
        let FeasibilityCriteria { dynamics, torque_max_nm, tick_s, .. } = terms;
        let span_s = tick_s * f64::from(TORQUE_CHECK_TICKS);
        let [at, before] = self.torque_samples;
        let velocity = (q - before) / (2.0 * span_s);
        let acceleration = (q - at * 2.0 + before) / (span_s * span_s);
        // Not plain inverse dynamics of the links: the motors' own inertia counts too.
        let torque =
            dynamics.mass_matrix(&at) * acceleration + dynamics.bias_torque(&at, &velocity);
        self.torque_samples = [*q, at];
        for joint in 0..N {
            let ratio = torque[joint].abs() / torque_max_nm[joint];
            update_maximum(&mut self.report.torque_ratio[joint], ratio, t_s);
            if ratio > 1.0 + LIMIT_ROUNDING {
                return Err(Infeasible::Torque { joint, ratio, t_s });
            }
        }
        Ok(())
    }
}

fn update_maximum(peak: &mut Extremum, value: f64, t_s: f64) {
    if value > peak.value {
        *peak = Extremum { value, t_s };
    }
}

fn tick_count(duration_s: f64, tick_s: f64) -> Result<u32, Infeasible> {
    let ticks = (duration_s / tick_s).ceil();
    if !(tick_s > 0.0 && ticks < TICKS_MAX) {
        return Err(Infeasible::InvalidTick);
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to 1e7")]
    let ticks = ticks as u32;
    // Two looks more, so that the deceleration is looked at from both sides.
    Ok(ticks + 2 * TORQUE_CHECK_TICKS)
}

/// How far an inspection is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FeasibilityStatus {
    /// There is more to look at.
    InProgress,
    /// The move can be made; [`FeasibilityCheck::preview`] says at what cost.
    Feasible,
    /// It cannot.
    Infeasible(Infeasible),
}

/// How far a move has been looked at. The route stays with whoever holds it and is handed in each
/// time; it must be the one of the beginning.
#[derive(Clone, Debug, PartialEq)]
pub struct FeasibilityCheck<const N: usize = 6, A: Arm<N> = Puma260> {
    evaluation: Evaluation<N>,
    tracker: PathTracker<N, A>,
    /// The route's time before the first tick (s).
    start_s: f64,
    tick: u32,
    /// Ticks of the route, and a few more.
    ticks: u32,
    /// The tick from which on the arm rests on its goal.
    finished_tick: Option<u32>,
}

impl<const N: usize, A: Arm<N>> FeasibilityCheck<N, A> {
    /// Begins to look at `route` from joints `start` (rad), a tool path on the branch of `start`.
    ///
    /// # Errors
    /// A route that starts elsewhere, and a tick that does not fit it.
    pub fn new(
        route: PathRef<'_, N>,
        start: &JointVector<N>,
        terms: &FeasibilityCriteria<N, A>,
    ) -> Result<FeasibilityCheck<N, A>, Infeasible> {
        check_start(route, start, &terms.arm)?;
        Ok(FeasibilityCheck {
            evaluation: Evaluation::new(start, route.duration_s()),
            tracker: PathTracker::new(&terms.arm, start),
            start_s: 0.0,
            tick: 0,
            ticks: tick_count(route.duration_s(), terms.tick_s)?,
            finished_tick: None,
        })
    }

    /// Begins to look at what is left of `route` from `from_s` (s) on, where the arm has been led
    /// by `lead`.
    ///
    /// # Errors
    /// A tick that does not fit the route.
    pub fn remaining(
        route: PathRef<'_, N>,
        lead: &PathTracker<N, A>,
        from_s: f64,
        terms: &FeasibilityCriteria<N, A>,
    ) -> Result<FeasibilityCheck<N, A>, Infeasible> {
        let q = lead.joints();
        let left_s = route.duration_s() - from_s;
        let mut walk = Evaluation::new(q, route.duration_s());
        walk.torque_samples[1] =
            q - lead.joint_velocity() * (terms.tick_s * f64::from(TORQUE_CHECK_TICKS));
        let ticks = tick_count(left_s, terms.tick_s)?;
        Ok(FeasibilityCheck {
            evaluation: walk,
            tracker: *lead,
            start_s: from_s,
            tick: 0,
            ticks,
            finished_tick: None,
        })
    }

    /// What has been found so far: the whole cost once the move has passed.
    #[must_use]
    pub fn report(&self) -> &FeasibilityReport<N> {
        &self.evaluation.report
    }

    /// Looks at so many more ticks; `route` and `terms` are those of the beginning.
    pub fn advance(
        &mut self,
        ticks: u32,
        route: PathRef<'_, N>,
        terms: &FeasibilityCriteria<N, A>,
    ) -> FeasibilityStatus {
        for _ in 0..ticks {
            if self.is_complete() {
                break;
            }
            self.tick += 1;
            let t_s = self.start_s + f64::from(self.tick) * terms.tick_s;
            if let Err(refusal) = self.check_tick(t_s, route, terms) {
                return FeasibilityStatus::Infeasible(refusal);
            }
        }
        if self.is_complete() { FeasibilityStatus::Feasible } else { FeasibilityStatus::InProgress }
    }

    /// True once the arm has rested on its goal for as long as it takes to have looked at the
    /// torque that brought it to rest.
    fn is_complete(&self) -> bool {
        let rested = |over| self.tick >= self.ticks.max(over + 2 * TORQUE_CHECK_TICKS - 1);
        self.finished_tick.is_some_and(rested)
    }

    fn check_tick(
        &mut self,
        t_s: f64,
        route: PathRef<'_, N>,
        terms: &FeasibilityCriteria<N, A>,
    ) -> Result<(), Infeasible> {
        let FeasibilityCheck { evaluation: walk, tracker: lead, finished_tick: over, .. } = self;
        if over.is_some() {
            let rest = walk.report.end_q;
            return walk.step(&rest, t_s, terms);
        }
        let lost = |why| Infeasible::NotFollowed { error: why, t_s };
        let led = lead.step(&terms.arm, route, t_s, terms.tick_s).map_err(lost)?;
        let (q, off_m, off_rad) = (led.setpoint.q, led.position_error_m, led.orientation_error_rad);
        match route {
            PathRef::Joint(_) => {
                let (low, high) = (terms.arm.q_min(), terms.arm.q_max());
                if let Some(joint) = (0..N).find(|&i| q[i] < low[i] || q[i] > high[i]) {
                    return Err(lost(FollowError::JointLimit { joint }));
                }
            }
            PathRef::Cartesian(_) => {
                update_maximum(&mut walk.report.position_error_m, off_m, t_s);
                update_maximum(&mut walk.report.orientation_error_rad, off_rad, t_s);
                if off_m > terms.position_error_max_m || off_rad > terms.orientation_error_max_rad {
                    return Err(Infeasible::PathDeviation {
                        position_error_m: off_m,
                        orientation_error_rad: off_rad,
                        t_s,
                    });
                }
            }
        }
        if led.is_finished {
            *over = Some(self.tick);
            walk.report.settling_s = led.settling_s;
            walk.report.duration_s += led.settling_s;
        }
        walk.step(&q, t_s, terms)
    }
}

impl<const N: usize> FeasibilityReport<N> {
    /// Walks a whole route from joints `start` (rad).
    ///
    /// # Errors
    /// The first thing that the arm cannot do.
    pub fn of<A: Arm<N>>(
        route: PathRef<'_, N>,
        start: &JointVector<N>,
        terms: &FeasibilityCriteria<N, A>,
    ) -> Result<FeasibilityReport<N>, Infeasible> {
        let mut inspection = FeasibilityCheck::new(route, start, terms)?;
        loop {
            match inspection.advance(u32::MAX, route, terms) {
                FeasibilityStatus::InProgress => {}
                FeasibilityStatus::Feasible => return Ok(*inspection.report()),
                FeasibilityStatus::Infeasible(refusal) => return Err(refusal),
            }
        }
    }
}
