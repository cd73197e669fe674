//! The timing of a path: the times of its corners, and which transition or segment runs at an
//! instant. Joint and Cartesian paths share it. It grows segment by segment, so that a job can
//! build a path move by move. Times that are too short for the transitions are refused.

use super::{MAX_POINTS, PathError};

/// Times of the segments and corners, and the half time of the transitions.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Timing {
    /// Time of segment i, from point i to point i + 1 (s).
    segment_times_s: [f64; MAX_POINTS],
    /// Times of the corners (s).
    corners_s: [f64; MAX_POINTS],
    point_count: usize,
    tau_s: f64,
}

/// The part of a path that runs at an instant. The numbers are the corner and the time since it
/// (s).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum PathPhase {
    /// Before the start: at rest at the first point.
    BeforeStart,
    /// The transition at a corner; the time since the corner is between -tau and tau.
    Transition(usize, f64),
    /// The segment that starts at a corner.
    Segment(usize, f64),
    /// After the end: at rest at the last point.
    AfterEnd,
}

impl Timing {
    /// The timing of one point: a rest of two tau.
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

    /// Goes back, in place, to the timing of one point.
    pub(super) fn restart(&mut self, tau_s: f64) -> Result<(), PathError> {
        // Below this tau the rates of a transition overflow, and at rest infinity times zero would
        // be NaN.
        let overflows = !(8.0 / tau_s / tau_s).is_finite();
        if !(tau_s > 0.0 && tau_s.is_finite()) || overflows {
            return Err(PathError::TransitionTime { tau_s });
        }
        (self.point_count, self.tau_s, self.corners_s[0]) = (1, tau_s, tau_s);
        Ok(())
    }

    /// Appends a point, `time_s` (s) after the last one and at the distance `distance` from it
    /// (rad, or m; only its size matters).
    pub(super) fn push(&mut self, time_s: f64, distance: f64) -> Result<(), PathError> {
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
        // The change of speed at a corner is at most the sum of the speeds of two segments, and the
        // acceleration is below 1.5 / tau times that change; 8 leaves a margin.
        if !(corner_s + tau_s).is_finite() || !(8.0 * distance / time_s / tau_s).is_finite() {
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

    /// The part of the path that runs at `t_s` (s); NaN counts as before the start.
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

/// Checks that there are enough and not too many points, and one time less than points.
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
