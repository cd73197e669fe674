//! From raw frames to images: the rest level of every tactel as an explicit baseline, and which
//! tactels may be believed. Refuses clipping at zero (it would turn noise into load), thresholds
//! and features.
//!
//! A tactel is believed when the device vouches for it, the configuration does not list it as dead
//! and its rest level lies between the rails. A tactel at full scale stays valid: it carries at
//! least that load, and leaving it out would take the heaviest tactel out of every sum; what
//! saturation does to the features is a matter of the load, not of validity; once readings are made
//! linear it still reads no less than it did.

use core::ops::RangeInclusive;

use taktil_hal::{MAX_ROWS, MAX_TACTELS, TactileFrame};
use taktil_rtcore::{Fold, Payload, StateHash};
use taktil_signal::{TACTEL_SATURATED, TactileBaseline, TactileImage};

use crate::response::{Curve, Response};
use crate::rest::{BLOCK, Rest, Sums};

/// What the rest level of a tactel must lie in (counts).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rails {
    /// Below this a tactel is stuck low.
    pub low_counts: f64,
    /// Above this it is stuck high or was pressed.
    pub high_counts: f64,
}

/// Collects frames of the free finger and holds their mean: as soon as there are enough of them,
/// and then of all that come until something touches ([`crate::rest`]).
#[derive(Clone, Debug)]
pub struct Baseline {
    least: u32,
    most: u32,
    /// Frames of the mean; the last whole block, which waits for the one after it; and that one.
    seen: Sums,
    waiting: Sums,
    newest: Sums,
    /// A block was added whose means are not known yet: they are made in the next job, since both
    /// at once would be the longest job by far.
    grown: bool,
    closed: bool,
    means: [f64; MAX_TACTELS],
    trusted: [bool; MAX_TACTELS],
    noise_counts: f64,
    /// How many are trusted.
    believed: usize,
    /// Stands for means, trust and noise.
    known: u64,
    dead: [bool; MAX_TACTELS],
    rails: Rails,
    response: Option<Response>,
    /// The response with its knee, known with the noise.
    curve: Option<Curve>,
    full_scale: u16,
}

impl Fold for Baseline {
    fn fold(&self, hash: &mut StateHash) {
        // Once it is closed the baseline does not change: what it came to is folded when it does.
        // Older frames are in the sums that were folded before.
        hash.add(&self.known).add(&self.closed).add(&self.seen.frames).add(&self.grown);
        if !self.ready() {
            hash.add(&self.seen);
        } else if !self.closed && self.newest.frames > 0 {
            hash.add(&self.newest);
        }
    }
}

impl Baseline {
    /// A baseline of `frames` frames (at least 1 and 1), of the least number in any case; tactels
    /// marked in `dead` are never believed.
    #[must_use]
    pub fn new(frames: RangeInclusive<u32>, dead: [bool; MAX_TACTELS], rails: Rails) -> Baseline {
        let least = (*frames.start()).max(1);
        Baseline {
            least,
            most: (*frames.end()).max(least),
            seen: Sums::NONE,
            waiting: Sums::NONE,
            newest: Sums::NONE,
            grown: false,
            closed: false,
            means: [0.0; MAX_TACTELS],
            trusted: [false; MAX_TACTELS],
            noise_counts: 0.0,
            believed: 0,
            known: 0,
            dead,
            rails,
            response: None,
            curve: None,
            full_scale: u16::MAX,
        }
    }

    /// With a calibrated response to be taken out of the readings of an array of this full scale.
    #[must_use]
    pub fn linearised(self, response: Option<Response>, full_scale: u16) -> Baseline {
        Baseline { response, full_scale, ..self }
    }

    /// Begins anew: the next frames must show the free finger.
    pub fn rearm(&mut self) {
        (self.seen, self.waiting, self.newest) = (Sums::NONE, Sums::NONE, Sums::NONE);
        (self.grown, self.closed) = (false, false);
        self.noise_counts = 0.0;
        self.trusted = [false; MAX_TACTELS];
        self.believed = 0;
    }

    /// Whether enough frames were seen.
    #[must_use]
    pub fn ready(&self) -> bool {
        self.seen.frames >= self.least
    }

    /// Whether it changes no more: something touched, or it is of the most frames.
    #[must_use]
    pub fn closed(&self) -> bool {
        self.closed
    }

    /// Rest level of a tactel (counts); 0 before [`Baseline::ready`].
    #[must_use]
    pub fn mean_counts(&self, index: usize) -> f64 {
        if self.ready() { self.means.get(index).copied().unwrap_or(0.0) } else { 0.0 }
    }

    /// How many tactels may be believed.
    #[must_use]
    pub fn trusted(&self) -> usize {
        self.believed
    }

    /// Standard deviation of a tactel that may be believed (counts); 0 before [`Baseline::ready`].
    #[must_use]
    pub fn noise_counts(&self) -> f64 {
        self.noise_counts
    }

    /// What it came to, acquired last at this instant (ns).
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "at most 256 tactels; f32 for counts")]
    pub fn told(&self, acquired_ns: i64, tactels: usize) -> TactileBaseline {
        let mut told = TactileBaseline {
            acquired_ns,
            frames: self.seen.frames,
            trusted: self.believed as u32,
            noise_counts: self.noise_counts,
            ..TactileBaseline::ZERO
        };
        if self.ready() {
            for (told, mean) in told.mean_counts.iter_mut().zip(&self.means).take(tactels) {
                *told = *mean as f32;
            }
        }
        for (told, trusted) in told.valid.iter_mut().zip(&self.trusted).take(tactels) {
            *told = u8::from(*trusted);
        }
        told
    }

    /// Takes one more frame; without effect once [`Baseline::closed`]. The newest of
    /// [`BLOCK`] to twice as many frames count only when the finger proves to have been free after
    /// them.
    pub fn learn(&mut self, frame: &TactileFrame) {
        if self.closed {
            return;
        }
        if !self.ready() {
            self.seen.learn(frame);
            if self.ready() {
                self.settle(frame.tactels());
                self.closed = self.seen.frames + BLOCK > self.most;
            }
            return;
        }
        if self.grown {
            self.grown = false;
            self.settle(frame.tactels());
            self.closed = self.seen.frames + BLOCK > self.most;
            if self.closed {
                return;
            }
        }
        let Baseline { means, trusted, noise_counts, .. } = self;
        let rest = Rest { means, trusted, noise_counts: *noise_counts, frames: self.seen.frames };
        let free = rest.is_frame(frame);
        self.newest.learn(frame);
        let whole = self.newest.frames >= BLOCK;
        if !free || (whole && !rest.is_block(&self.newest)) {
            self.closed = true;
        } else if whole {
            let before = core::mem::replace(&mut self.waiting, self.newest);
            self.newest = Sums::NONE;
            if before.frames > 0 {
                self.seen.add(&before);
                self.grown = true;
            }
        }
    }

    /// Means and trust of the frames so far, and the noise of the first ones: forty frames of 256
    /// tactels say it to half a percent, and more of them would only make the job longer.
    fn settle(&mut self, tactels: usize) {
        let first = self.believed == 0;
        let (mut variance, mut number_of_tactels) = (0.0, 0.0);
        self.trusted = [false; MAX_TACTELS];
        for index in (0..tactels).filter(|index| !self.dead[*index]) {
            // A tactel that was valid less than half of the time has no rest level.
            let Some(mean) = self.seen.mean(index) else { continue };
            self.means[index] = mean;
            self.trusted[index] = (self.rails.low_counts..=self.rails.high_counts).contains(&mean);
            if !first || !self.trusted[index] {
                continue;
            }
            if let Some(own) = self.seen.variance(index) {
                variance += own;
                number_of_tactels += 1.0;
            }
        }
        if number_of_tactels > 0.0 {
            self.noise_counts = (variance / number_of_tactels).sqrt();
        }
        self.believed = self.trusted.iter().filter(|trusted| **trusted).count();
        self.curve = self.response.map(|response| response.curve(self.noise_counts));
        let mut hash = StateHash::new();
        hash.add(&self.means).add(&self.trusted).add(&self.noise_counts);
        self.known = hash.value();
    }

    /// What a tactel reads above its rest level, in proportion to the load where the response is
    /// known (counts).
    fn above(&self, index: usize, value: u16) -> f64 {
        let counts = f64::from(value) - self.means[index];
        match &self.curve {
            None => counts,
            // At the rail there is at least that load, whatever the curve says.
            Some(curve) if value >= self.full_scale => curve.linear(counts).max(counts),
            Some(curve) => curve.linear(counts),
        }
    }

    /// The image of a frame: counts above the rest level, 0 where the tactel is not believed. All
    /// zero and nothing believed before [`Baseline::ready`].
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "f32 holds a count to 1/256 of a count")]
    pub fn image(&self, frame: &TactileFrame) -> TactileImage {
        let mut image = TactileImage {
            acquired_ns: frame.acquired.0,
            sequence: frame.sequence,
            rows: frame.rows,
            cols: frame.cols,
            baseline_ready: u32::from(self.ready()),
            noise_counts: self.curve.map_or(self.noise_counts, |c| c.noise(self.noise_counts))
                as f32,
            ..TactileImage::ZERO
        };
        let rows = usize::from(frame.rows).min(MAX_ROWS);
        for (offset, row) in image.row_offset_ns.iter_mut().zip(&frame.row_acquired[..rows]) {
            let nanos = row.0.saturating_sub(frame.acquired.0);
            *offset = nanos.clamp(i64::from(i32::MIN), i64::from(i32::MAX)) as i32;
        }
        if !self.ready() {
            return image;
        }
        for index in 0..frame.tactels() {
            if frame.valid[index] && self.trusted[index] {
                image.counts[index] = self.above(index, frame.values[index]) as f32;
                // The rail is one of raw readings: a calibrated response moves where it shows.
                let saturated = frame.values[index] >= self.full_scale;
                image.valid[index] = if saturated { TACTEL_SATURATED } else { 1 };
            }
        }
        image
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use taktil_hal::Nanos;

    const RAILS: Rails = Rails { low_counts: 1.0, high_counts: 2000.0 };

    fn frame(level: u16) -> TactileFrame {
        let mut frame = TactileFrame::empty();
        frame.rows = 16;
        frame.cols = 16;
        frame.values = [level; MAX_TACTELS];
        frame.valid = [true; MAX_TACTELS];
        frame
    }

    fn learnt(frames: &[TactileFrame]) -> Baseline {
        let number = u32::try_from(frames.len()).unwrap();
        let mut baseline = Baseline::new(number..=number, [false; MAX_TACTELS], RAILS);
        for frame in frames {
            baseline.learn(frame);
        }
        baseline
    }

    #[test]
    fn the_baseline_is_the_mean_of_exactly_the_first_frames() {
        let mut baseline = Baseline::new(3..=3, [false; MAX_TACTELS], RAILS);
        for (level, ready) in [(100, false), (101, false), (103, true), (4000, true)] {
            baseline.learn(&frame(level));
            assert_eq!(baseline.ready(), ready);
        }
        assert!((baseline.mean_counts(255) - 304.0 / 3.0).abs() < 1e-12);
        baseline.rearm();
        assert!(!baseline.ready() && baseline.mean_counts(0) == 0.0);
        (0..3).for_each(|_| baseline.learn(&frame(50)));
        assert!((baseline.mean_counts(0) - 50.0).abs() < f64::EPSILON);
    }

    /// Frames of alternating level, so that the noise is 10 counts, with a load on the middle rows.
    fn loaded(job: u32, counts: u16) -> TactileFrame {
        let mut frame = frame(if job.is_multiple_of(2) { 290 } else { 310 });
        frame.values[96..144].iter_mut().for_each(|value| *value += counts);
        // Each frame has both signs, as noise has.
        frame.values.iter_mut().skip(1).step_by(2).for_each(|value| {
            *value = if job.is_multiple_of(2) { *value + 20 } else { *value - 20 };
        });
        frame
    }

    #[test]
    fn frames_count_until_something_touches_and_none_of_a_slow_touch() {
        let mut baseline = Baseline::new(40..=400, [false; MAX_TACTELS], RAILS);
        // Free for 200 frames; then a load that grows by a count on each of 48 tactels a frame.
        let mut closed = 0;
        for job in 0..400 {
            let load = u16::try_from(job.clamp(200, 300) - 200).unwrap();
            baseline.learn(&loaded(job, load));
            assert!(baseline.ready() == (job >= 39));
            closed += u32::from(!baseline.closed());
        }
        assert!(baseline.closed() && (200..216).contains(&closed), "{closed}");
        let told = baseline.told(0, MAX_TACTELS);
        assert!((168..=200).contains(&told.frames), "{}", told.frames);
        assert!((baseline.mean_counts(100) - 300.0).abs() < 0.01, "{}", baseline.mean_counts(100));
        assert!((baseline.noise_counts() - 10.0).abs() < 0.15, "of the first forty");
        baseline.learn(&frame(900));
        assert!((baseline.mean_counts(100) - 300.0).abs() < 0.01, "closed for good");
        baseline.rearm();
        assert!(!baseline.closed() && !baseline.ready());
        (0..40).for_each(|job| baseline.learn(&loaded(job, 7)));
        assert!(baseline.ready() && !baseline.closed(), "a restart begins anew");
        assert!((baseline.mean_counts(100) - 307.0).abs() < 0.01);
    }

    #[test]
    fn without_a_touch_it_ends_with_the_most_frames_and_a_tactel_that_blinks_ends_it_sooner() {
        let frames = |blinks: bool| {
            let mut baseline = Baseline::new(40..=400, [false; MAX_TACTELS], RAILS);
            for job in 0..1000 {
                let mut frame = loaded(job, 0);
                if blinks && job == 150 {
                    frame.values[9] = 2_500;
                }
                frame.valid[11] = job < 90;
                baseline.learn(&frame);
            }
            assert!(baseline.closed());
            let told = baseline.told(0, MAX_TACTELS);
            assert!((baseline.mean_counts(9) - 300.0).abs() < 0.01);
            (told.frames, told.valid[11])
        };
        assert_eq!(frames(false), (392, 0), "whole blocks of sixteen; seldom valid, not believed");
        assert_eq!(frames(true), (120, 1));
    }

    #[test]
    fn the_noise_is_measured_with_the_rest_level_and_told_once() {
        let frames: Vec<TactileFrame> = [290, 310, 290, 310].map(frame).to_vec();
        let baseline = learnt(&frames);
        let due = (4.0 * 100.0_f64 / 3.0).sqrt();
        assert!((baseline.noise_counts() - due).abs() < 1e-12, "{}", baseline.noise_counts());
        let told = baseline.told(17, MAX_TACTELS);
        assert_eq!((told.acquired_ns, told.frames, told.trusted), (17, 4, 256));
        assert_eq!((told.mean_counts[200], told.valid[200]), (300.0, 1));
        assert!((f64::from(baseline.image(&frame(300)).noise_counts) - due).abs() < 1e-5);
        assert_eq!(learnt(&[frame(300)]).noise_counts(), 0.0, "one frame has no spread");
        let mut odd = Baseline::new(1..=1, [true; MAX_TACTELS], RAILS);
        odd.learn(&frame(300));
        assert_eq!((odd.noise_counts(), odd.told(0, MAX_TACTELS).trusted), (0.0, 0));
    }

    #[test]
    fn counts_below_the_rest_level_stay_negative() {
        let baseline = learnt(&[frame(300), frame(300)]);
        let mut pressed = frame(300);
        pressed.values[17] = 1300;
        pressed.values[18] = 250;
        pressed.values[19] = 4095;
        let image = baseline.image(&pressed);
        assert_eq!(image.counts[16..20], [0.0, 1000.0, -50.0, 3795.0]);
        assert_eq!((image.valid[19], image.baseline_ready), (1, 1), "no rail is known");
    }

    #[test]
    fn a_calibrated_response_is_taken_out_and_the_rail_stays_the_rail() {
        let frames: Vec<TactileFrame> = [290, 310, 290, 310].map(frame).to_vec();
        let response = Response { exponent: 0.8, full_counts: 4095.0, threshold_counts: 0.0 };
        let mut linear = Baseline::new(4..=4, [false; MAX_TACTELS], RAILS);
        linear = linear.linearised(Some(response), 4095);
        frames.iter().for_each(|frame| linear.learn(frame));
        let mut pressed = frame(300);
        (pressed.values[1], pressed.values[2], pressed.values[3]) = (1300, 4095, 4094);
        let image = linear.image(&pressed);
        let due = 4095.0 * libm::pow(1000.0 / 4095.0, 1.25);
        assert!((f64::from(image.counts[1]) - due).abs() < 1e-3, "{}", image.counts[1]);
        assert_eq!((image.counts[0], image.counts[2]), (0.0, 3795.0));
        assert!(image.counts[3] < 3794.0, "only the rail is lifted: {}", image.counts[3]);
        let plain = learnt(&frames).noise_counts();
        assert!(f64::from(image.noise_counts) < plain, "noise is scaled as readings are");
    }

    #[test]
    fn saturation_is_told_by_the_raw_reading_whatever_the_curve_makes_of_it() {
        for (exponent, full_counts) in [(1.0, 4095.0), (0.6, 2000.0), (0.7, 4095.0), (1.6, 4095.0)]
        {
            let mut scan = Baseline::new(1..=1, [false; MAX_TACTELS], RAILS);
            let response = Response { exponent, full_counts, threshold_counts: 0.0 };
            scan = scan.linearised(Some(response), 4095);
            let mut rest = frame(300);
            rest.values[5] = 1200;
            scan.learn(&rest);
            let mut pressed = rest;
            (pressed.values[3], pressed.values[4], pressed.values[5]) = (3700, 4095, 4095);
            let image = scan.image(&pressed);
            assert_eq!(image.valid[2..6], [1, 1, TACTEL_SATURATED, TACTEL_SATURATED], "{exponent}");
        }
    }

    #[test]
    fn before_the_baseline_an_image_shows_nothing() {
        let baseline = Baseline::new(2..=2, [false; MAX_TACTELS], RAILS);
        let image = baseline.image(&frame(3000));
        assert!(image.counts.iter().all(|count| *count == 0.0));
        assert!(image.valid.iter().all(|valid| *valid == 0));
        assert_eq!(image.baseline_ready, 0);
    }

    #[test]
    fn dead_stuck_and_doubtful_tactels_are_not_believed() {
        let mut odd = frame(300);
        odd.values[1] = 0;
        odd.values[2] = 4095;
        odd.valid[3] = false;
        let mut dead = [false; MAX_TACTELS];
        dead[0] = true;
        let mut baseline = Baseline::new(2..=2, dead, RAILS);
        baseline.learn(&odd);
        baseline.learn(&odd);
        let mut now = frame(400);
        now.valid[4] = false;
        let image = baseline.image(&now);
        assert_eq!(image.valid[..6], [0, 0, 0, 0, 0, 1]);
        assert_eq!(image.counts[..6], [0.0, 0.0, 0.0, 0.0, 0.0, 100.0]);
        assert_eq!(baseline.trusted(), 252);
    }

    #[test]
    fn limits_of_the_rails_are_inside() {
        for (level, valid) in [(0, 0), (1, 1), (2000, 1), (2001, 0)] {
            assert_eq!(learnt(&[frame(level)]).image(&frame(level)).valid[7], valid, "{level}");
        }
    }

    #[test]
    fn times_of_rows_are_carried_relative_to_the_frame() {
        let mut frame = frame(300);
        frame.acquired = Nanos(10_000_000);
        for (row, at) in frame.row_acquired.iter_mut().enumerate() {
            *at = Nanos(5_000_000 + 312_500 * i64::try_from(row + 1).unwrap());
        }
        frame.row_acquired[1] = Nanos(i64::MIN);
        frame.sequence = 77;
        let image = learnt(&[frame.clone()]).image(&frame);
        assert_eq!((image.acquired_ns, image.sequence), (10_000_000, 77));
        assert_eq!(image.row_offset_ns[0], -4_687_500);
        assert_eq!(image.row_offset_ns[15], 0);
        assert_eq!(image.row_offset_ns[1], i32::MIN);
    }

    #[test]
    fn a_frame_of_absurd_size_does_no_harm() {
        let mut absurd = frame(300);
        (absurd.rows, absurd.cols) = (u16::MAX, u16::MAX);
        let image = learnt(&[absurd.clone()]).image(&absurd);
        assert_eq!(image.valid[255], 1);
    }
}
