//! The clock of a path: where its corners are and which piece of it runs at an instant. Shared by
//! joint and Cartesian paths. Grows segment by segment, so that a job can lay a path move by move.
//! Refuses times that leave no room for the transitions.

use super::{MAX_POINTS, PathError};

/// Segment times, corners and the half time of the transitions.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Timing {
    /// Segment i leads from point i to point i + 1 (s).
    segment_times_s: [f64; MAX_POINTS],
    /// When each corner is (s).
    corners_s: [f64; MAX_POINTS],
    point_count: usize,
    tau_s: f64,
}

/// The piece of a path that runs at an instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum PathPhase {
    /// Before the start, at rest in the first point.
    BeforeStart,
    /// The transition about a corner, from -tau to tau after it (s).
    Transition(usize, f64),
    /// The segment that leaves a corner, so long after it (s).
    Segment(usize, f64),
    /// After the end, at rest in the last point.
    AfterEnd,
}

impl Timing {
    /// A clock for one point: two tau of rest.
    pub(super) fn new(tau_s: f64) -> Result<Timing, PathError> {
        let mut timing = Timing {
            segment_times_s: [0.0; MAX_POINTS],
            corners_s: [0.0; MAX_POINTS],
            point_count: 1,
            tau_s: 0.0,
        };
        timing.restart(tau_s)?;
        Ok(timing)
    }

    /// One point again, in place.
    pub(super) fn restart(&mut self, tau_s: f64) -> Result<(), PathError> {
        // Over a time next to nothing the rates within a transition are no numbers, and at rest
        // they are multiplied by zero.
        let beyond = !(8.0 / tau_s / tau_s).is_finite();
        if !(tau_s > 0.0 && tau_s.is_finite()) || beyond {
            return Err(PathError::TransitionTime { tau_s });
        }
        (self.point_count, self.tau_s, self.corners_s[0]) = (1, tau_s, tau_s);
        Ok(())
    }

    /// One more point, `time_s` (s) after the last and `way` from it, in whatever it is measured.
    pub(super) fn push(&mut self, time_s: f64, way: f64) -> Result<(), PathError> {
        let (segment, tau_s) = (self.point_count - 1, self.tau_s);
        if self.point_count == MAX_POINTS {
            return Err(PathError::TooManyPoints { points: self.point_count + 1 });
        }
        if !(time_s > 0.0 && time_s.is_finite()) {
            return Err(PathError::SegmentTime { segment, time_s });
        }
        if tau_s > 0.5 * time_s {
            return Err(PathError::TransitionsOverlap { segment, time_s, tau_s });
        }
        let corner_s = self.corners_s[segment] + time_s;
        // A corner's change of speed is that of two segments at most, and more than its 1.5 / tau
        // is never its acceleration.
        if !(corner_s + tau_s).is_finite() || !(8.0 * way / time_s / tau_s).is_finite() {
            return Err(PathError::Overflow { segment });
        }
        self.segment_times_s[segment] = time_s;
        self.corners_s[self.point_count] = corner_s;
        self.point_count += 1;
        Ok(())
    }

    pub(super) fn corners_s(&self) -> &[f64] {
        &self.corners_s[..self.point_count]
    }

    pub(super) fn point_count(&self) -> usize {
        self.point_count
    }

    pub(super) fn tau_s(&self) -> f64 {
        self.tau_s
    }

    pub(super) fn segment_time_s(&self, segment: usize) -> f64 {
        self.segment_times_s[segment]
    }

    pub(super) fn duration_s(&self) -> f64 {
        self.corners_s[self.point_count - 1] + self.tau_s
    }

    /// What runs at `t_s`; NaN counts as before the start.
    pub(super) fn phase(&self, t_s: f64) -> PathPhase {
        if t_s.is_nan() || t_s <= 0.0 {
            return PathPhase::BeforeStart;
        }
        if t_s >= self.duration_s() {
            return PathPhase::AfterEnd;
        }
        let mut corner = 0;
        while corner + 1 < self.point_count && t_s >= self.corners_s[corner + 1] - self.tau_s {
            corner += 1;
        }
        let since = t_s - self.corners_s[corner];
        if since <= self.tau_s || corner + 1 == self.point_count {
            PathPhase::Transition(corner, since)
        } else {
            PathPhase::Segment(corner, since)
        }
    }
}

/// Refuses too few and too many points, and times that are not one less than the points.
pub(super) fn check_counts(points: usize, times: usize) -> Result<(), PathError> {
    if points < 2 {
        return Err(PathError::TooFewPoints { points });
    }
    if points > MAX_POINTS {
        return Err(PathError::TooManyPoints { points });
    }
    if times != points - 1 {
        return Err(PathError::SegmentCount { expected: points - 1, actual: times });
    }
    Ok(())
}
