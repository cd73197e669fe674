//! Tests a sequence of places of the load for a ramp that begins at an unknown instant: a
//! generalised likelihood ratio over a window of onsets (T. L. Lai, "Sequential changepoint
//! detection in quality control and dynamical systems", J. Royal Statistical Society B 57, 1995;
//! A. S. Willsky and H. L. Jones, IEEE Trans. Automatic Control 21, 1976). The threshold follows
//! from the noise and the allowed rate of false alarms, and is not tuned.
//!
//! For an onset `n` frames ago the places before it give a level `L`, and those after it the
//! velocity `v = sum t (r - L) / sum t^2` with a covariance that is the frames' own over `sum t^2`,
//! widened by the level's. Creep is a steady speed up to the tolerance, before the onset and after
//! it: the largest velocity that it can feign is taken off. What is left, squared and over its
//! covariance, has the chi-square distribution of two degrees of freedom where nothing slides,
//! which exceeds `-2 ln a` with the probability `a`; by Boole's inequality the tests of all onsets
//! together give at most their sum of false alarms.

use glam::DVec2;

use super::normal_quantile;
use super::place::Symmetric;

/// Onsets that are tried, in frames before the newest one.
pub(super) const ONSET_FRAMES: [usize; 10] = [1, 2, 3, 4, 6, 8, 12, 16, 24, 32];
/// Frames before an onset that make its level: twice those after it, so that the level's noise
/// adds little and creep before the onset not much.
const LEVEL_FRAMES_PER_ONSET: usize = 2;
/// Fewest and most of them.
const LEVEL_FRAMES_MIN: usize = 8;
const LEVEL_FRAMES_MAX: usize = 32;
/// Frames that are remembered: the longest level before the earliest onset.
const FRAMES_KEPT: usize = 64;
/// Fewest and most frames of the line through the places while it slides.
const LINE_FRAMES_MIN: usize = 8;
const LINE_FRAMES_MAX: usize = 32;
/// Sliding has ended when the line's speed is within so many of its standard deviations of the
/// tolerance.
const END_SIGMAS: f64 = 2.0;
/// The line begins anew when its newest part differs from it by so many standard deviations.
const CHANGE_SIGMAS: f64 = 4.0;
/// A gap of so many frames breaks the sequence.
pub(super) const GAP_FRAMES: f64 = 4.5;

/// What the test is set by.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlipParameters {
    /// Time between two frames (s). Default 0.005.
    pub frame_s: f64,
    /// Most false alarms in an hour of frames. Default 1.
    pub false_alarms_per_h: f64,
    /// Speed that counts as creep (mm/s). Default 0.4.
    pub tolerance_mm_s: f64,
}

impl Default for SlipParameters {
    fn default() -> SlipParameters {
        SlipParameters { frame_s: 0.005, false_alarms_per_h: 1.0, tolerance_mm_s: 0.4 }
    }
}

impl SlipParameters {
    /// The probability of a false alarm that one test may have.
    #[expect(clippy::cast_precision_loss, reason = "a small count")]
    fn test_alarm(&self) -> f64 {
        let alarm = self.false_alarms_per_h * self.frame_s / (3600.0 * ONSET_FRAMES.len() as f64);
        alarm.clamp(f64::MIN_POSITIVE, 1.0)
    }

    /// The statistic above which there is slip: `-2 ln a` where any direction is seen; where one
    /// is, the square of the normal quantile of `a/2`.
    #[must_use]
    pub fn threshold(&self, is_one_direction: bool) -> f64 {
        let alarm = self.test_alarm();
        if is_one_direction {
            let quantile = normal_quantile(0.5 * alarm);
            return quantile * quantile;
        }
        -2.0 * libm::log(alarm)
    }
}

/// One frame: when it was acquired, where the load lies less where it would lie without sliding,
/// and the covariance of its noise.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SlipSample {
    /// Instant (s).
    pub t_s: f64,
    /// Place (mm) along the pad's x and y, from any origin.
    pub place_mm: DVec2,
    /// Covariance (mm^2).
    pub covariance_mm2: Symmetric,
    /// The unit vector along which alone a motion shows; none where any does.
    pub direction: Option<DVec2>,
}

/// What the test says of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SlipVerdict {
    /// The load slides.
    pub is_detected: bool,
    /// There are frames enough to tell.
    pub is_ready: bool,
    /// The largest statistic of all onsets; while it slides, that of the line.
    pub statistic: f64,
    /// The statistic above which slip begins.
    pub threshold: f64,
    /// Velocity of the load over the pad (mm/s) along its x and y: that of the likeliest onset;
    /// while it slides, that of the line.
    pub velocity_mm_s: DVec2,
}

/// The likeliest onset of a ramp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Onset {
    /// Frames since then.
    pub frames: usize,
    /// Its statistic, to be compared with the threshold.
    pub statistic: f64,
    /// Velocity of the ramp (mm/s) along the pad's x and y.
    pub velocity_mm_s: DVec2,
}

/// The test with the frames that it remembers. Updating it does not allocate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlipDetector {
    parameters: SlipParameters,
    /// Thresholds for any direction and for one.
    thresholds: [f64; 2],
    /// The newest frame is the last one of the first `count`.
    frames: [SlipSample; FRAMES_KEPT],
    count: usize,
    /// Frames of the line since the likeliest onset; none while nothing slides.
    line: Option<usize>,
}

/// A velocity (mm/s), its variance over that of a place (1/s^2), and the velocity that creep of
/// 1 mm/s feigns in it.
#[derive(Clone, Copy, Debug)]
struct VelocityEstimate {
    velocity: DVec2,
    variance_factor: f64,
    creep_factor: f64,
}

impl SlipDetector {
    /// A test without frames.
    #[must_use]
    pub fn new(parameters: &SlipParameters) -> SlipDetector {
        SlipDetector {
            parameters: *parameters,
            thresholds: [parameters.threshold(false), parameters.threshold(true)],
            frames: [SlipSample::default(); FRAMES_KEPT],
            count: 0,
            line: None,
        }
    }

    /// Forgets all frames.
    pub fn reset(&mut self) {
        (self.count, self.line) = (0, None);
    }

    /// The numbers on which the next verdict depends, for a hash of the state.
    pub fn for_each_number(&self, mut visit: impl FnMut(f64)) {
        visit(self.line.map_or(-1.0, |frames| frames as f64));
        for frame in &self.frames[..self.count] {
            [frame.t_s, frame.place_mm.x, frame.place_mm.y].into_iter().for_each(&mut visit);
            frame.covariance_mm2.into_iter().for_each(&mut visit);
        }
    }

    /// Takes in a frame. Frames must come in order of time; a long gap, a step back in time and
    /// numbers that are not finite begin a new sequence.
    pub fn update(&mut self, sample: &SlipSample) -> SlipVerdict {
        self.update_with_onset(sample, None)
    }

    /// Takes in a frame of which another test with the same onsets and thresholds has found the
    /// likeliest onset: that one is judged in the place of the frame's own, so that each frame is
    /// tested once. While the load slides it has no part.
    pub fn update_with_onset(&mut self, sample: &SlipSample, found: Option<&Onset>) -> SlipVerdict {
        let finite = sample.t_s.is_finite()
            && sample.place_mm.is_finite()
            && sample.covariance_mm2.iter().all(|value| value.is_finite())
            && sample.direction.is_none_or(|axis| axis.is_finite());
        if !finite {
            self.reset();
            return SlipVerdict::default();
        }
        if let Some(last) = self.frames[..self.count].last() {
            let since_s = sample.t_s - last.t_s;
            if !(since_s > 0.0 && since_s < GAP_FRAMES * self.parameters.frame_s) {
                self.reset();
            }
        }
        if self.count == FRAMES_KEPT {
            self.frames.copy_within(1.., 0);
            self.count -= 1;
        }
        self.frames[self.count] = *sample;
        self.count += 1;
        let threshold = self.thresholds[usize::from(sample.direction.is_some())];
        match self.line {
            Some(frames) => self.follow_line(frames + 1, threshold),
            None => self.test_onsets(threshold, found),
        }
    }

    /// The velocity beyond what creep can feign, in the same direction.
    fn beyond_creep(&self, estimate: &VelocityEstimate) -> DVec2 {
        let velocity = self.seen(estimate.velocity);
        let speed = velocity.length();
        let creep = self.parameters.tolerance_mm_s * estimate.creep_factor;
        if speed > creep { velocity * (1.0 - creep / speed) } else { DVec2::ZERO }
    }

    /// The part of a velocity that shows.
    fn seen(&self, velocity: DVec2) -> DVec2 {
        let direction = self.frames[self.count - 1].direction;
        direction.map_or(velocity, |axis| axis * axis.dot(velocity))
    }

    /// The square of a velocity over the covariance of the newest place, in what shows.
    fn square_over_covariance(&self, v: DVec2) -> f64 {
        let SlipSample { covariance_mm2: [xx, xy, yy], direction, .. } =
            self.frames[self.count - 1];
        if let Some(axis) = direction {
            let (x, y) = (axis.x, axis.y);
            let variance = xx * x * x + 2.0 * xy * x * y + yy * y * y;
            let along = axis.dot(v);
            return if variance > 0.0 { along * along / variance } else { 0.0 };
        }
        let determinant = xx * yy - xy * xy;
        if !(determinant > 0.0 && xx > 0.0) {
            return 0.0;
        }
        (yy * v.x * v.x - 2.0 * xy * v.x * v.y + xx * v.y * v.y) / determinant
    }

    fn statistic(&self, estimate: &VelocityEstimate) -> f64 {
        self.square_over_covariance(self.beyond_creep(estimate)) / estimate.variance_factor
    }

    fn test_onsets(&mut self, threshold: f64, found: Option<&Onset>) -> SlipVerdict {
        let likeliest = found.copied().or_else(|| self.likeliest_onset());
        let Some(Onset { frames, statistic, velocity_mm_s }) = likeliest else {
            return SlipVerdict { threshold, ..SlipVerdict::default() };
        };
        let is_detected = statistic > threshold;
        self.line = is_detected.then_some(frames);
        SlipVerdict { is_detected, is_ready: true, statistic, threshold, velocity_mm_s }
    }

    fn likeliest_onset(&self) -> Option<Onset> {
        let mut likeliest: Option<Onset> = None;
        for frames in ONSET_FRAMES {
            let Some(estimate) = self.velocity_since(frames) else { continue };
            let statistic = self.statistic(&estimate);
            if likeliest.is_none_or(|best| statistic > best.statistic) {
                let velocity_mm_s = self.seen(estimate.velocity);
                likeliest = Some(Onset { frames, statistic, velocity_mm_s });
            }
        }
        likeliest
    }

    /// The velocity of a ramp that began `onset` frames ago, from the level before it.
    #[expect(clippy::cast_precision_loss, reason = "small counts")]
    fn velocity_since(&self, onset: usize) -> Option<VelocityEstimate> {
        let before = self.count.checked_sub(onset)?;
        let level_frames =
            (LEVEL_FRAMES_PER_ONSET * onset).clamp(LEVEL_FRAMES_MIN, LEVEL_FRAMES_MAX).min(before);
        if level_frames < LEVEL_FRAMES_MIN {
            return None;
        }
        let (level, ramp) = self.frames[before - level_frames..self.count].split_at(level_frames);
        let mean =
            level.iter().fold(DVec2::ZERO, |sum, frame| sum + frame.place_mm) / level_frames as f64;
        let start_s = level[level_frames - 1].t_s;
        let level_s =
            level.iter().map(|frame| start_s - frame.t_s).sum::<f64>() / level_frames as f64;
        let (mut times, mut squares, mut moved) = (0.0, 0.0, DVec2::ZERO);
        for frame in ramp {
            let t_s = frame.t_s - start_s;
            times += t_s;
            squares += t_s * t_s;
            moved += t_s * (frame.place_mm - mean);
        }
        let level_part = times * times / (squares * level_frames as f64);
        let variance_factor = (1.0 + level_part) / squares;
        let creep_factor = 1.0 + level_s * times / squares;
        Some(VelocityEstimate { velocity: moved / squares, variance_factor, creep_factor })
    }

    /// The slope of the line through the newest frames.
    #[expect(clippy::cast_precision_loss, reason = "small counts")]
    fn slope(&self, frames: usize) -> VelocityEstimate {
        let newest = &self.frames[self.count.saturating_sub(frames)..self.count];
        let number = newest.len() as f64;
        let origin_s = newest[0].t_s;
        let mean_s = newest.iter().map(|frame| frame.t_s - origin_s).sum::<f64>() / number;
        let (mut squares, mut moved) = (0.0, DVec2::ZERO);
        for frame in newest {
            let t_s = frame.t_s - origin_s - mean_s;
            squares += t_s * t_s;
            moved += t_s * frame.place_mm;
        }
        let squares = squares.max(f64::MIN_POSITIVE);
        VelocityEstimate {
            velocity: moved / squares,
            variance_factor: 1.0 / squares,
            creep_factor: 1.0,
        }
    }

    /// Measures the velocity while it slides, and finds the end.
    fn follow_line(&mut self, frames: usize, threshold: f64) -> SlipVerdict {
        let frames = frames.clamp(LINE_FRAMES_MIN, LINE_FRAMES_MAX).min(self.count);
        let (mut line, newest) = (self.slope(frames), self.slope(LINE_FRAMES_MIN));
        let deviation = self.square_over_covariance(newest.velocity - line.velocity);
        let mut kept = frames;
        if deviation > CHANGE_SIGMAS * CHANGE_SIGMAS * newest.variance_factor {
            (line, kept) = (newest, LINE_FRAMES_MIN);
        }
        let statistic = self.statistic(&line);
        let is_detected = statistic > END_SIGMAS * END_SIGMAS;
        let velocity_mm_s = self.seen(line.velocity);
        if is_detected {
            self.line = Some(kept);
        } else {
            self.reset();
        }
        SlipVerdict { is_detected, is_ready: true, statistic, threshold, velocity_mm_s }
    }
}

#[cfg(test)]
mod tests;
