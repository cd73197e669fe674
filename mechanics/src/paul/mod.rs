//! Paul's joint motion: straight segments between points, rounded at the corners by a quartic that
//! keeps speed and acceleration continuous (Paul 1981, chapter 5; Paul 1979). A path that could not
//! be followed is refused point by point while it is built; its evaluation cannot fail. A path is
//! built in place and never copied, because it is a few kB and a lane appends one point a job.
//!
//! Motion starts at t = 0. Corner i is at `c_i = tau + T_1 + .. + T_i`. Within tau of a corner the
//! transition runs, elsewhere the segment, and the move ends at `c_n + tau`. Inner points are
//! rounded and not reached: at the corner the path is 3/16 tau dv away from the point, where dv is
//! the change of speed.

pub mod cartesian;
mod drive_transform;
mod timing;

use core::fmt;

use crate::spatial::JointVector;
use timing::{PathPhase, Timing, check_counts};

/// Largest number of points of a path.
pub const MAX_POINTS: usize = 32;

/// A setpoint of the joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setpoint<const N: usize = 6> {
    /// Joint angles (rad).
    pub q: JointVector<N>,
    /// Joint speeds (rad/s).
    pub qd: JointVector<N>,
    /// Joint accelerations (rad/s^2).
    pub qdd: JointVector<N>,
}

impl<const N: usize> Setpoint<N> {
    /// The setpoint at rest at `q` (rad).
    #[must_use]
    pub fn rest(q: &JointVector<N>) -> Setpoint<N> {
        Setpoint { q: *q, qd: JointVector::zeros(), qdd: JointVector::zeros() }
    }
}

/// The reason why points and times do not make a path.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum PathError {
    /// Fewer than two points.
    TooFewPoints {
        /// Number of points.
        points: usize,
    },
    /// More than [`MAX_POINTS`].
    TooManyPoints {
        /// Number of points.
        points: usize,
    },
    /// The number of segment times is not one less than the number of points.
    SegmentCount {
        /// Number of segments between the points.
        expected: usize,
        /// Number of times.
        actual: usize,
    },
    /// A joint of a point is NaN or infinite.
    PointNotFinite {
        /// Index of the point.
        point: usize,
        /// Index of the joint.
        joint: usize,
    },
    /// A pose is not finite, or its matrix is not a rotation.
    InvalidPose {
        /// Index of the point.
        point: usize,
    },
    /// A segment time is NaN, infinite, zero or negative.
    SegmentTime {
        /// Index of the segment.
        segment: usize,
        /// The time (s).
        time_s: f64,
    },
    /// The transition half time tau is NaN, infinite, zero or negative, or so short that the
    /// reciprocal of its square is not finite.
    TransitionTime {
        /// The time (s).
        tau_s: f64,
    },
    /// The speed of a segment, or the acceleration of its transitions, is not finite.
    Overflow {
        /// Index of the segment.
        segment: usize,
    },
    /// The transitions at both ends of a segment would overlap: tau is longer than half its time.
    TransitionsOverlap {
        /// Index of the segment.
        segment: usize,
        /// The time of the segment (s).
        time_s: f64,
        /// tau (s).
        tau_s: f64,
    },
}

impl fmt::Display for PathError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            PathError::TooFewPoints { points } => {
                write!(f, "a path needs two points, there are {points}")
            }
            PathError::TooManyPoints { points } => {
                write!(f, "a path holds {MAX_POINTS} points, there are {points}")
            }
            PathError::SegmentCount { expected: wanted, actual: given } => {
                write!(f, "the points make {wanted} segments, there are {given} times")
            }
            PathError::PointNotFinite { point, joint } => {
                write!(f, "joint {} of point {point} is not a finite number", joint + 1)
            }
            PathError::InvalidPose { point } => {
                write!(
                    f,
                    "point {point} is not a pose: its rotation has columns that are not of length \
                     1, square to each other and right-handed, or a number is not finite"
                )
            }
            PathError::Overflow { segment } => {
                write!(f, "segment {segment} is too long for its time: its speed is no number")
            }
            PathError::SegmentTime { segment, time_s } => {
                write!(f, "segment {segment} takes {time_s} s; it must be positive and finite")
            }
            PathError::TransitionTime { tau_s } => {
                write!(f, "tau is {tau_s} s; it must be positive and finite, and not next to 0")
            }
            PathError::TransitionsOverlap { segment, time_s, tau_s } => {
                write!(
                    f,
                    "tau of {tau_s} s is more than half of the {time_s} s of segment {segment}"
                )
            }
        }
    }
}

impl std::error::Error for PathError {}

/// A path through joint angles, of fixed size. With one point it is a rest that lasts two tau.
#[derive(Clone, Debug, PartialEq)]
pub struct JointPath<const N: usize = 6> {
    points: [JointVector<N>; MAX_POINTS],
    timing: Timing,
}

impl<const N: usize> JointPath<N> {
    /// A path through `points` (rad), where segment i takes `t_s[i]` (s) and every point has a
    /// transition of half time `tau_s` (s). The arm rests before the first and after the last
    /// point.
    ///
    /// # Errors
    /// [`PathError`]. A segment without length is allowed: it is a wait.
    pub fn new(
        points: &[JointVector<N>],
        t_s: &[f64],
        tau_s: f64,
    ) -> Result<JointPath<N>, PathError> {
        check_counts(points.len(), t_s.len())?;
        let mut path = JointPath::rest(&points[0], tau_s)?;
        for (q, time_s) in points[1..].iter().zip(t_s) {
            path.push(q, *time_s)?;
        }
        Ok(path)
    }

    /// A path of one point, at rest at `q` (rad), to which points can be appended.
    ///
    /// # Errors
    /// Those of [`JointPath::restart`].
    pub fn rest(q: &JointVector<N>, tau_s: f64) -> Result<JointPath<N>, PathError> {
        let points = [JointVector::zeros(); MAX_POINTS];
        let mut path = JointPath { points, timing: Timing::new(tau_s)? };
        path.restart(q, tau_s)?;
        Ok(path)
    }

    /// Replaces the path in place by a rest at `q` (rad).
    ///
    /// # Errors
    /// [`PathError::PointNotFinite`], [`PathError::TransitionTime`].
    pub fn restart(&mut self, q: &JointVector<N>, tau_s: f64) -> Result<(), PathError> {
        self.timing.restart(tau_s)?;
        self.set_point(0, q)
    }

    /// Appends, in place, a segment that reaches `q` (rad) after `time_s` (s) and ends there.
    ///
    /// # Errors
    /// [`PathError`] where the path is full, a joint is not finite, or the time is not positive or
    /// too short for two transitions. The path must not be used after an error.
    pub fn push(&mut self, q: &JointVector<N>, time_s: f64) -> Result<(), PathError> {
        let point = self.timing.point_count();
        self.set_point(point, q)?;
        let distance = (q - self.points[point - 1]).amax();
        self.timing.push(time_s, distance)
    }

    fn set_point(&mut self, point: usize, q: &JointVector<N>) -> Result<(), PathError> {
        if let Some(joint) = q.iter().position(|x| !x.is_finite()) {
            return Err(PathError::PointNotFinite { point, joint });
        }
        let full = PathError::TooManyPoints { points: point + 1 };
        *self.points.get_mut(point).ok_or(full)? = *q;
        Ok(())
    }

    /// Duration of the move (s): all segments and two tau.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.timing.duration_s()
    }

    /// Times of the corners (s).
    #[must_use]
    pub fn corners_s(&self) -> &[f64] {
        self.timing.corners_s()
    }

    /// Half time tau of the transitions (s).
    #[must_use]
    pub fn tau_s(&self) -> f64 {
        self.timing.tau_s()
    }

    /// The points of the path (rad).
    #[must_use]
    pub fn points(&self) -> &[JointVector<N>] {
        &self.points[..self.timing.point_count()]
    }

    /// The setpoint at `t_s` (s). Before the start, and for NaN, it is the first point at rest;
    /// from the end on it is the last point at rest.
    #[must_use]
    pub fn at(&self, t_s: f64) -> Setpoint<N> {
        match self.timing.phase(t_s) {
            PathPhase::BeforeStart => Setpoint::rest(&self.points[0]),
            PathPhase::AfterEnd => Setpoint::rest(&self.points[self.timing.point_count() - 1]),
            PathPhase::Transition(corner, since) => self.transition(corner, since),
            PathPhase::Segment(corner, since) => {
                let qd = self.velocity_after(corner);
                Setpoint { q: self.points[corner] + qd * since, qd, qdd: JointVector::zeros() }
            }
        }
    }

    /// The setpoint on the quartic of the transition at a corner, `since` (s) after the corner,
    /// from -tau to tau.
    fn transition(&self, corner: usize, since: f64) -> Setpoint<N> {
        let tau = self.timing.tau_s();
        let b = &self.points[corner];
        let h = (since + tau) / (2.0 * tau);
        let before = self.velocity_before(corner) * -tau;
        let after = self.velocity_after(corner) * tau;
        let change = after + before;
        Setpoint {
            q: (change * ((2.0 - h) * h * h) - before * 2.0) * h + b + before,
            qd: (change * ((1.5 - h) * 2.0 * h * h) - before) / tau,
            qdd: change * ((1.0 - h) * 3.0 * h / (tau * tau)),
        }
    }

    /// Velocity of the segment that ends at a corner (rad/s); 0 at the first corner.
    fn velocity_before(&self, corner: usize) -> JointVector<N> {
        if corner == 0 { JointVector::zeros() } else { self.velocity_after(corner - 1) }
    }

    /// Velocity of the segment that starts at a corner (rad/s); 0 at the last corner.
    fn velocity_after(&self, corner: usize) -> JointVector<N> {
        if corner + 1 >= self.timing.point_count() {
            return JointVector::zeros();
        }
        (self.points[corner + 1] - self.points[corner]) / self.timing.segment_time_s(corner)
    }

    /// Largest speed of each joint on the whole path (rad/s), which is that of its fastest segment.
    #[must_use]
    pub fn peak_speed(&self) -> JointVector<N> {
        (0..self.timing.point_count())
            .fold(JointVector::zeros(), |largest, i| largest.sup(&self.velocity_after(i).abs()))
    }

    /// Largest acceleration of each joint on the whole path (rad/s^2), over all corners.
    #[must_use]
    pub fn peak_acceleration(&self) -> JointVector<N> {
        let corners = 0..self.timing.point_count();
        corners.fold(JointVector::zeros(), |largest, i| largest.sup(&self.corner_acceleration(i)))
    }

    /// Largest acceleration of each joint at corner `corner` (rad/s^2): 3/4 dv/tau. The value of
    /// the last corner changes when a point is appended.
    #[must_use]
    pub fn corner_acceleration(&self, corner: usize) -> JointVector<N> {
        let change = self.velocity_after(corner) - self.velocity_before(corner);
        change.abs() * (0.75 / self.timing.tau_s())
    }

    /// Absolute speed of each joint in segment `segment` (rad/s).
    #[must_use]
    pub fn segment_speed(&self, segment: usize) -> JointVector<N> {
        self.velocity_after(segment).abs()
    }
}

/// The shortest time (s) of a segment from `from` to `to` (rad) whose joints stay within
/// `speed_max` (rad/s) and which is long enough for two transitions of half time `tau_s` (s).
/// Infinite where a joint moves whose largest speed is not positive.
#[must_use]
pub fn segment_time_s<const N: usize>(
    from: &JointVector<N>,
    to: &JointVector<N>,
    speed_max: &JointVector<N>,
    tau_s: f64,
) -> f64 {
    let mut time = 2.0 * tau_s;
    for i in 0..N {
        let distance = (to[i] - from[i]).abs();
        if distance > 0.0 {
            let limit = speed_max[i];
            time = time.max(if limit > 0.0 { distance / limit } else { f64::INFINITY });
        }
    }
    time
}
