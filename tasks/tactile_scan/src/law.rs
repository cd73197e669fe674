//! Converts raw frames to images: it subtracts the rest level of every tactel as an explicit
//! baseline, and marks the tactels that are trusted. Values are not clipped at zero, because that
//! would turn noise into load; thresholds and features are left to other tasks.
//!
//! A tactel is trusted when the device marks it as valid, the configuration does not list it as
//! dead, and its rest level lies between the limits of the converter. A tactel at full scale stays
//! valid: it carries at least that load, and without it every sum would lack its most heavily
//! loaded tactel. Linearised readings keep at least the raw value there.

use core::ops::RangeInclusive;

use taktil_hal::{MAX_ROWS, MAX_TACTELS, TactileFrame};
use taktil_rtcore::{Fold, Payload, StateHash};
use taktil_signal::{TACTEL_SATURATED, TactileBaseline, TactileImage};

use crate::free_finger::{FRAMES_PER_BLOCK, FrameSums, FreeFingerTest};
use crate::response::{Curve, Response};

/// Limits between which the rest level of a tactel must lie (counts).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SaturationLimits {
    /// Below this a tactel is stuck low.
    pub low_counts: f64,
    /// Above this it is stuck high or was pressed.
    pub high_counts: f64,
}

/// Collects frames of the free finger and provides their mean as soon as there are enough of them;
/// it then includes later frames until something touches ([`crate::free_finger`]).
#[derive(Clone, Debug)]
pub struct Baseline {
    least: u32,
    most: u32,
    /// Frames of the mean; the last whole block, which waits for the one after it; and that one.
    seen: FrameSums,
    waiting: FrameSums,
    newest: FrameSums,
    /// Whether a block was added whose means are not computed yet. They are computed in the next
    /// job, because both in one job would be the longest job by far.
    grown: bool,
    closed: bool,
    means: [f64; MAX_TACTELS],
    trusted: [bool; MAX_TACTELS],
    noise_counts: f64,
    /// Number of trusted tactels.
    believed: usize,
    /// Digest of means, trust and noise.
    known: u64,
    dead: [bool; MAX_TACTELS],
    rails: SaturationLimits,
    response: Option<Response>,
    /// The response with its knee, known with the noise.
    curve: Option<Curve>,
    full_scale: u16,
}

impl Fold for Baseline {
    fn fold(&self, hash: &mut StateHash) {
        // A closed baseline does not change, so its digest is computed when it changes. Older
        // frames are part of the sums that were folded before.
        hash.add(&self.known).add(&self.closed).add(&self.seen.frames).add(&self.grown);
        if !self.is_ready() {
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
    pub fn new(
        frames: RangeInclusive<u32>,
        dead: [bool; MAX_TACTELS],
        rails: SaturationLimits,
    ) -> Baseline {
        let least = (*frames.start()).max(1);
        Baseline {
            least,
            most: (*frames.end()).max(least),
            seen: FrameSums::EMPTY,
            waiting: FrameSums::EMPTY,
            newest: FrameSums::EMPTY,
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
        (self.seen, self.waiting, self.newest) =
            (FrameSums::EMPTY, FrameSums::EMPTY, FrameSums::EMPTY);
        (self.grown, self.closed) = (false, false);
        self.noise_counts = 0.0;
        self.trusted = [false; MAX_TACTELS];
        self.believed = 0;
    }

    /// Whether enough frames were seen.
    #[must_use]
    pub fn is_ready(&self) -> bool {
        self.seen.frames >= self.least
    }

    /// Whether the baseline is final: something touched, or it has the largest number of frames.
    #[must_use]
    pub fn is_closed(&self) -> bool {
        self.closed
    }

    /// Baseline of a tactel (counts); 0 before [`Baseline::is_ready`].
    #[must_use]
    pub fn mean_counts(&self, index: usize) -> f64 {
        if self.is_ready() { self.means.get(index).copied().unwrap_or(0.0) } else { 0.0 }
    }

    /// Number of tactels that are trusted.
    #[must_use]
    pub fn trusted(&self) -> usize {
        self.believed
    }

    /// Standard deviation of a tactel that may be believed (counts); 0 before
    /// [`Baseline::is_ready`].
    #[must_use]
    pub fn noise_counts(&self) -> f64 {
        self.noise_counts
    }

    /// The report of the baseline, whose last frame was acquired at this instant (ns).
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "at most 256 tactels; f32 for counts")]
    pub fn report(&self, acquired_ns: i64, tactels: usize) -> TactileBaseline {
        let mut told = TactileBaseline {
            acquired_ns,
            frames: self.seen.frames,
            trusted: self.believed as u32,
            noise_counts: self.noise_counts,
            ..TactileBaseline::ZERO
        };
        if self.is_ready() {
            for (told, mean) in told.mean_counts.iter_mut().zip(&self.means).take(tactels) {
                *told = *mean as f32;
            }
        }
        for (told, trusted) in told.valid.iter_mut().zip(&self.trusted).take(tactels) {
            *told = u8::from(*trusted);
        }
        told
    }

    /// Takes one more frame; without effect once `Baseline::closed`. The newest of
    /// [`FRAMES_PER_BLOCK`] to twice as many frames count only when the finger proves to have been
    /// free after them.
    pub fn add_frame(&mut self, frame: &TactileFrame) {
        if self.closed {
            return;
        }
        if !self.is_ready() {
            self.seen.add_frame(frame);
            if self.is_ready() {
                self.finish(frame.tactels());
                self.closed = self.seen.frames + FRAMES_PER_BLOCK > self.most;
            }
            return;
        }
        if self.grown {
            self.grown = false;
            self.finish(frame.tactels());
            self.closed = self.seen.frames + FRAMES_PER_BLOCK > self.most;
            if self.closed {
                return;
            }
        }
        let Baseline { means, trusted, noise_counts, .. } = self;
        let rest = FreeFingerTest {
            means,
            trusted,
            noise_counts: *noise_counts,
            frames: self.seen.frames,
        };
        let free = rest.is_free_frame(frame);
        self.newest.add_frame(frame);
        let whole = self.newest.frames >= FRAMES_PER_BLOCK;
        if !free || (whole && !rest.is_free_block(&self.newest)) {
            self.closed = true;
        } else if whole {
            let before = core::mem::replace(&mut self.waiting, self.newest);
            self.newest = FrameSums::EMPTY;
            if before.frames > 0 {
                self.seen.add(&before);
                self.grown = true;
            }
        }
    }

    /// Computes means and trust from all frames so far, and the noise from the first ones: forty
    /// frames of 256 tactels determine it to half a percent, and more of them would only make the
    /// job longer.
    fn finish(&mut self, tactels: usize) {
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

    /// The counts of a tactel above its rest level, proportional to the load if the response is
    /// known.
    fn above_baseline(&self, index: usize, value: u16) -> f64 {
        let counts = f64::from(value) - self.means[index];
        match &self.curve {
            None => counts,
            // At full scale the load is at least that of the reading, whatever the curve gives.
            Some(curve) if value >= self.full_scale => curve.linearised_counts(counts).max(counts),
            Some(curve) => curve.linearised_counts(counts),
        }
    }

    /// The image of a frame: counts above the rest level, 0 where the tactel is not believed. All
    /// zero and nothing believed before [`Baseline::is_ready`].
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "f32 holds a count to 1/256 of a count")]
    pub fn image(&self, frame: &TactileFrame) -> TactileImage {
        let mut image = TactileImage {
            acquired_ns: frame.acquired.0,
            sequence: frame.sequence,
            rows: frame.rows,
            cols: frame.cols,
            baseline_ready: u32::from(self.is_ready()),
            noise_counts: self.curve.map_or(self.noise_counts, |c| c.noise(self.noise_counts))
                as f32,
            ..TactileImage::ZERO
        };
        let rows = usize::from(frame.rows).min(MAX_ROWS);
        for (offset, row) in image.row_offset_ns.iter_mut().zip(&frame.row_acquired[..rows]) {
            let nanos = row.0.saturating_sub(frame.acquired.0);
            *offset = nanos.clamp(i64::from(i32::MIN), i64::from(i32::MAX)) as i32;
        }
        if !self.is_ready() {
            return image;
        }
        for index in 0..frame.tactels() {
            if frame.valid[index] && self.trusted[index] {
                image.counts[index] = self.above_baseline(index, frame.values[index]) as f32;
                // Saturation is a property of the raw reading; the calibrated response changes the
                // value that is shown.
                let saturated = frame.values[index] >= self.full_scale;
                image.valid[index] = if saturated { TACTEL_SATURATED } else { 1 };
            }
        }
        image
    }
}

#[cfg(test)]
mod tests;
