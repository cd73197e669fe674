//! The check of a whole move before it starts. It tracks the path tick by tick until the arm rests
//! at its goal. The first limit that the move would exceed is reported with joint and time. A
//! feasible move is reported with its figures: duration, speeds, torques, distances from
//! singularities and errors of the path.
//!
//! [`FeasibilityCheck`] checks a few ticks in each call, for a lane that has a deadline;
//! [`FeasibilityReport::of`] checks the whole move in one call.

use core::fmt;

use crate::arm::{Arm, ArmDynamics, FollowError};
use crate::puma260::Puma260;
use crate::spatial::JointVector;
use crate::tracking::{PathRef, PathTracker, TrackerStep};

/// Most ticks of a move; a longer one is reported as [`Infeasible::InvalidTick`].
const TICKS_MAX: f64 = 1e7;
/// The torque is computed once in so many ticks, because it costs more than all other checks.
const TORQUE_CHECK_TICKS: u32 = 4;
/// Relative excess over a limit that counts as rounding.
const LIMIT_ROUNDING: f64 = 1e-9;

/// The arm and the limits against which a move is checked.
#[derive(Clone, Debug)]
pub struct FeasibilityCriteria<const N: usize = 6, A: Arm<N> = Puma260> {
    /// Limits of angle, speed and acceleration, and the tool.
    pub arm: A,
    /// Dynamics of links, tool and motors, for the torques.
    pub dynamics: A::Dynamics,
    /// Largest torque of each joint (N m); infinite where it is not limited.
    pub torque_max_nm: JointVector<N>,
    /// Largest distance of the tool point from its path (m), past a wrist singularity.
    pub position_error_max_m: f64,
    /// Largest angle between the tool and its path (rad), past a wrist singularity.
    pub orientation_error_max_rad: f64,
    /// The time between two checked setpoints: the control period (s).
    pub tick_s: f64,
}

/// The largest or smallest value of a figure during a move, and its time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extremum {
    /// The value.
    pub value: f64,
    /// Time from the start of the move (s).
    pub t_s: f64,
}

/// The figures of a feasible move.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeasibilityReport<const N: usize = 6> {
    /// Duration of the move (s), settling included.
    pub duration_s: f64,
    /// Time from the end of the path until the arm rests at its goal (s). It is 0 unless the path
    /// passed a wrist singularity shortly before its end.
    pub settling_s: f64,
    /// Largest speed of each joint divided by its limit.
    pub speed_ratio: [Extremum; N],
    /// Largest torque of each joint divided by its limit; 0 where the limit is infinite.
    pub torque_ratio: [Extremum; N],
    /// Smallest distances from the singularities of shoulder, elbow and wrist, as
    /// [`Arm::singularity_distances`] scales them.
    pub singularity: [Extremum; 3],
    /// Largest distance of the tool point from its path (m).
    pub position_error_m: Extremum,
    /// Largest angle between the tool and its path (rad).
    pub orientation_error_rad: Extremum,
    /// Joints at the end of the move (rad).
    pub end_q: JointVector<N>,
}

/// The reason why a move is not feasible.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Infeasible {
    /// The arm cannot follow the path.
    NotFollowed {
        /// The reason.
        error: FollowError,
        /// Time from the start of the move (s).
        t_s: f64,
    },
    /// This joint (0 is the first) would need more than its largest torque.
    Torque {
        /// Index of the joint.
        joint: usize,
        /// Required torque over the largest torque, above 1.
        ratio: f64,
        /// Time from the start of the move (s).
        t_s: f64,
    },
    /// Past a wrist singularity the tool would leave its path by more than is allowed.
    PathDeviation {
        /// Distance of the tool point from its path (m).
        position_error_m: f64,
        /// Angle between the tool and its path (rad).
        orientation_error_rad: f64,
        /// Time from the start of the move (s).
        t_s: f64,
    },
    /// The path does not start at the present joints of the arm.
    StartMismatch {
        /// Distance of the tool point (m) or, for a joint path, the largest distance of a joint
        /// (rad).
        distance: f64,
    },
    /// The tick is not a positive time, or the move has more than ten million ticks.
    InvalidTick,
}

impl fmt::Display for Infeasible {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Infeasible::NotFollowed { error, t_s } => {
                write!(f, "{error} after {t_s:.3} s of the move")
            }
            Infeasible::Torque { joint, ratio, t_s } => write!(
                f,
                "joint {} would need {ratio:.2} times its torque after {t_s:.3} s of the move",
                joint + 1
            ),
            Infeasible::PathDeviation { position_error_m, orientation_error_rad, t_s } => write!(
                f,
                "past the wrist singularity the tool would be {:.3} mm and \
                 {orientation_error_rad:.4} rad off its path after {t_s:.3} s of the move",
                position_error_m * 1e3
            ),
            Infeasible::StartMismatch { distance } => {
                write!(f, "the move starts {distance:.4} m or rad from where the arm is")
            }
            Infeasible::InvalidTick => {
                write!(f, "the time between two looks does not fit the move")
            }
        }
    }
}

impl core::error::Error for Infeasible {}

/// Largest distance between the start of a path and the arm (m for the tool point, rad for joints;
/// for the orientation of the tool the largest difference of an element of its rotation matrix).
const START_TOLERANCE_M_RAD: f64 = 1e-6;

/// Checks that `path` starts at the joints `start` (rad).
fn check_start<const N: usize, A: Arm<N>>(
    path: PathRef<'_, N>,
    start: &JointVector<N>,
    arm: &A,
) -> Result<(), Infeasible> {
    let (distance, is_rotated) = match path {
        PathRef::Joint(path) => ((path.points()[0] - start).amax(), false),
        PathRef::Cartesian(path) => {
            let (first, present) = (path.points()[0], arm.tool_pose(start));
            let rotation = first.rotation.transpose() * present.rotation;
            let is_aligned = rotation.abs_diff_eq(glam::DMat3::IDENTITY, START_TOLERANCE_M_RAD);
            ((first.translation - present.translation).length(), !is_aligned)
        }
    };
    if distance.is_nan() || distance > START_TOLERANCE_M_RAD || is_rotated {
        return Err(Infeasible::StartMismatch { distance });
    }
    Ok(())
}

/// The figures of a move up to the present tick.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Evaluation<const N: usize> {
    report: FeasibilityReport<N>,
    /// Joints of the last tick (rad).
    previous_q: JointVector<N>,
    /// Joints at the last two samples for the torque, the newer one first (rad).
    torque_samples: [JointVector<N>; 2],
    /// Ticks since the last sample for the torque.
    ticks_since_torque: u32,
}

impl<const N: usize> Evaluation<N> {
    fn new(start: &JointVector<N>, duration_s: f64) -> Evaluation<N> {
        let zero = Extremum { value: 0.0, t_s: 0.0 };
        let report = FeasibilityReport {
            duration_s,
            settling_s: 0.0,
            speed_ratio: [zero; N],
            torque_ratio: [zero; N],
            singularity: [Extremum { value: f64::INFINITY, t_s: 0.0 }; 3],
            position_error_m: zero,
            orientation_error_rad: zero,
            end_q: *start,
        };
        Evaluation {
            report,
            previous_q: *start,
            torque_samples: [*start; 2],
            ticks_since_torque: 0,
        }
    }

    /// Checks the joints `q` (rad) of the tick at `t_s` (s): in every tick their speed since the
    /// last one and their distance from singularities, in one of [`TORQUE_CHECK_TICKS`] the torque.
    fn step<A: Arm<N>>(
        &mut self,
        q: &JointVector<N>,
        t_s: f64,
        criteria: &FeasibilityCriteria<N, A>,
    ) -> Result<(), Infeasible> {
        let FeasibilityCriteria { arm, tick_s, .. } = criteria;
        let speed = (q - self.previous_q) / *tick_s;
        for joint in 0..N {
            let ratio = speed[joint].abs() / arm.speed_max()[joint];
            update_maximum(&mut self.report.speed_ratio[joint], ratio, t_s);
            if ratio > 1.0 + LIMIT_ROUNDING {
                let error = FollowError::SpeedLimit { joint, ratio };
                return Err(Infeasible::NotFollowed { error, t_s });
            }
        }
        self.ticks_since_torque += 1;
        if self.ticks_since_torque == TORQUE_CHECK_TICKS {
            self.ticks_since_torque = 0;
            self.check_torque(q, t_s, criteria)?;
        }
        for (smallest, distance) in
            self.report.singularity.iter_mut().zip(arm.singularity_distances(q))
        {
            if distance < smallest.value {
                *smallest = Extremum { value: distance, t_s };
            }
        }
        self.previous_q = *q;
        self.report.end_q = *q;
        Ok(())
    }

    /// Checks the torque at the last sample. Its velocity and acceleration are central differences
    /// of the samples before and after it; `q` (rad) is the one after it.
    fn check_torque<A: Arm<N>>(
        &mut self,
        q: &JointVector<N>,
        t_s: f64,
        criteria: &FeasibilityCriteria<N, A>,
    ) -> Result<(), Infeasible> {
        let FeasibilityCriteria { dynamics, torque_max_nm, tick_s, .. } = criteria;
        let span_s = tick_s * f64::from(TORQUE_CHECK_TICKS);
        let [middle, first] = self.torque_samples;
        let velocity = (q - first) / (2.0 * span_s);
        let acceleration = (q - middle * 2.0 + first) / (span_s * span_s);
        // The mass matrix includes the inertia of the motors, which the inverse dynamics of the
        // links does not.
        let torque =
            dynamics.mass_matrix(&middle) * acceleration + dynamics.bias_torque(&middle, &velocity);
        self.torque_samples = [*q, middle];
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

/// Raises a maximum to `value` at `t_s` (s) if it is below it.
fn update_maximum(maximum: &mut Extremum, value: f64, t_s: f64) {
    if value > maximum.value {
        *maximum = Extremum { value, t_s };
    }
}

/// The number of ticks of a move that lasts `duration_s` (s), with the ticks after its end in which
/// the torque is still computed.
fn tick_count(duration_s: f64, tick_s: f64) -> Result<u32, Infeasible> {
    let ticks = (duration_s / tick_s).ceil();
    if !(tick_s > 0.0 && ticks < TICKS_MAX) {
        return Err(Infeasible::InvalidTick);
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to 1e7")]
    let ticks = ticks as u32;
    // Two more samples of the torque, so that the deceleration has a sample on either side.
    Ok(ticks + 2 * TORQUE_CHECK_TICKS)
}

/// The state of a check.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FeasibilityStatus {
    /// Not all ticks have been checked.
    InProgress,
    /// The move is feasible; [`FeasibilityCheck::report`] returns its figures.
    Feasible,
    /// The move is not feasible.
    Infeasible(Infeasible),
}

/// A check in progress. It does not hold the path: the caller passes the same path to every call.
#[derive(Clone, Debug, PartialEq)]
pub struct FeasibilityCheck<const N: usize = 6, A: Arm<N> = Puma260> {
    evaluation: Evaluation<N>,
    tracker: PathTracker<N, A>,
    /// Time on the path before the first tick (s).
    start_s: f64,
    tick: u32,
    /// Ticks of the path and of the samples after its end.
    ticks: u32,
    /// The tick from which on the arm rests at its goal.
    finished_tick: Option<u32>,
}

impl<const N: usize, A: Arm<N>> FeasibilityCheck<N, A> {
    /// A check of the whole `path` from rest at the joints `start` (rad). A tool path is followed
    /// on the branch of the inverse kinematics to which `start` belongs.
    ///
    /// # Errors
    /// [`Infeasible::StartMismatch`] and [`Infeasible::InvalidTick`].
    pub fn new(
        path: PathRef<'_, N>,
        start: &JointVector<N>,
        criteria: &FeasibilityCriteria<N, A>,
    ) -> Result<FeasibilityCheck<N, A>, Infeasible> {
        check_start(path, start, &criteria.arm)?;
        Ok(FeasibilityCheck {
            evaluation: Evaluation::new(start, path.duration_s()),
            tracker: PathTracker::new(&criteria.arm, start),
            start_s: 0.0,
            tick: 0,
            ticks: tick_count(path.duration_s(), criteria.tick_s)?,
            finished_tick: None,
        })
    }

    /// A check of the rest of `path` from the time `start_s` (s) on, to which `tracker` has tracked
    /// it.
    ///
    /// # Errors
    /// [`Infeasible::InvalidTick`].
    pub fn remaining(
        path: PathRef<'_, N>,
        tracker: &PathTracker<N, A>,
        start_s: f64,
        criteria: &FeasibilityCriteria<N, A>,
    ) -> Result<FeasibilityCheck<N, A>, Infeasible> {
        let q = tracker.joints();
        let remaining_s = path.duration_s() - start_s;
        let mut evaluation = Evaluation::new(q, path.duration_s());
        evaluation.torque_samples[1] =
            q - tracker.joint_velocity() * (criteria.tick_s * f64::from(TORQUE_CHECK_TICKS));
        let ticks = tick_count(remaining_s, criteria.tick_s)?;
        Ok(FeasibilityCheck {
            evaluation,
            tracker: *tracker,
            start_s,
            tick: 0,
            ticks,
            finished_tick: None,
        })
    }

    /// The figures of the ticks checked so far; those of the whole move once it is
    /// [`FeasibilityStatus::Feasible`].
    #[must_use]
    pub fn report(&self) -> &FeasibilityReport<N> {
        &self.evaluation.report
    }

    /// Checks at most `ticks` more ticks; `path` and `criteria` must be those of the first call.
    pub fn advance(
        &mut self,
        ticks: u32,
        path: PathRef<'_, N>,
        criteria: &FeasibilityCriteria<N, A>,
    ) -> FeasibilityStatus {
        for _ in 0..ticks {
            if self.is_complete() {
                break;
            }
            self.tick += 1;
            let t_s = self.start_s + f64::from(self.tick) * criteria.tick_s;
            if let Err(reason) = self.check_tick(t_s, path, criteria) {
                return FeasibilityStatus::Infeasible(reason);
            }
        }
        if self.is_complete() { FeasibilityStatus::Feasible } else { FeasibilityStatus::InProgress }
    }

    /// Whether the arm has rested at its goal for long enough that the torque which brought it to
    /// rest has been checked.
    fn is_complete(&self) -> bool {
        let is_last = |finished| self.tick >= self.ticks.max(finished + 2 * TORQUE_CHECK_TICKS - 1);
        self.finished_tick.is_some_and(is_last)
    }

    /// Checks the tick at `t_s` (s) of the path.
    fn check_tick(
        &mut self,
        t_s: f64,
        path: PathRef<'_, N>,
        criteria: &FeasibilityCriteria<N, A>,
    ) -> Result<(), Infeasible> {
        let FeasibilityCheck { evaluation, tracker, finished_tick, .. } = self;
        if finished_tick.is_some() {
            // The arm rests; only the torque that brought it to rest is still to be checked.
            let rest = evaluation.report.end_q;
            return evaluation.step(&rest, t_s, criteria);
        }
        let not_followed = |error| Infeasible::NotFollowed { error, t_s };
        let step = tracker.step(&criteria.arm, path, t_s, criteria.tick_s).map_err(not_followed)?;
        let TrackerStep { position_error_m, orientation_error_rad, .. } = step;
        let q = step.setpoint.q;
        match path {
            PathRef::Joint(_) => {
                let (low, high) = (criteria.arm.q_min(), criteria.arm.q_max());
                if let Some(joint) = (0..N).find(|&i| q[i] < low[i] || q[i] > high[i]) {
                    return Err(not_followed(FollowError::JointLimit { joint }));
                }
            }
            PathRef::Cartesian(_) => {
                let report = &mut evaluation.report;
                update_maximum(&mut report.position_error_m, position_error_m, t_s);
                update_maximum(&mut report.orientation_error_rad, orientation_error_rad, t_s);
                if position_error_m > criteria.position_error_max_m
                    || orientation_error_rad > criteria.orientation_error_max_rad
                {
                    return Err(Infeasible::PathDeviation {
                        position_error_m,
                        orientation_error_rad,
                        t_s,
                    });
                }
            }
        }
        if step.is_finished {
            *finished_tick = Some(self.tick);
            evaluation.report.settling_s = step.settling_s;
            evaluation.report.duration_s += step.settling_s;
        }
        evaluation.step(&q, t_s, criteria)
    }
}

impl<const N: usize> FeasibilityReport<N> {
    /// Checks the whole `path` from rest at the joints `start` (rad) in one call.
    ///
    /// # Errors
    /// The first reason why the move is not feasible.
    pub fn of<A: Arm<N>>(
        path: PathRef<'_, N>,
        start: &JointVector<N>,
        criteria: &FeasibilityCriteria<N, A>,
    ) -> Result<FeasibilityReport<N>, Infeasible> {
        let mut check = FeasibilityCheck::new(path, start, criteria)?;
        loop {
            match check.advance(u32::MAX, path, criteria) {
                FeasibilityStatus::InProgress => {}
                FeasibilityStatus::Feasible => return Ok(*check.report()),
                FeasibilityStatus::Infeasible(reason) => return Err(reason),
            }
        }
    }
}
