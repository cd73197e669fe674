//! Converts raw frames to images: it subtracts the rest level of every tactel as an explicit
//! baseline, and marks the tactels that are trusted. Values are not clipped at zero, because that
//! would turn noise into load; thresholds and features are left to other tasks.
//!
//! A tactel is trusted when the device marks it as valid, the configuration does not list it as
//! dead, and its rest level lies between the limits of the converter. A tactel at full scale stays
//! valid: it carries at least that load, and without it every sum would lack its most heavily
//! loaded tactel. Linearised readings keep at least the raw value there.

use core::ops::RangeInclusive;

use taktil_hal::TactileFrame;
use taktil_rtcore::{Fold, StateHash};
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
    means: Box<[f64]>,
    trusted: Box<[bool]>,
    noise_counts: f64,
    /// Number of trusted tactels.
    believed: usize,
    /// Digest of means, trust and noise.
    known: u64,
    dead: Box<[bool]>,
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
    /// A baseline of `frames` frames (at least 1 and 1), of the least number in any case, of an
    /// array of as many tactels as `dead` has, which marks those that are never believed.
    /// Allocates.
    #[must_use]
    pub fn new(
        frames: RangeInclusive<u32>,
        dead: Box<[bool]>,
        rails: SaturationLimits,
    ) -> Baseline {
        let tactels = dead.len();
        let least = (*frames.start()).max(1);
        Baseline {
            least,
            most: (*frames.end()).max(least),
            seen: FrameSums::new(tactels),
            waiting: FrameSums::new(tactels),
            newest: FrameSums::new(tactels),
            grown: false,
            closed: false,
            means: vec![0.0; tactels].into(),
            trusted: vec![false; tactels].into(),
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
        self.seen.clear();
        self.waiting.clear();
        self.newest.clear();
        (self.grown, self.closed) = (false, false);
        self.noise_counts = 0.0;
        self.trusted.fill(false);
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

    /// Reports the baseline, whose last frame was acquired at this instant (ns), to `told`.
    #[expect(clippy::cast_possible_truncation, reason = "at most 4096 tactels; f32 for counts")]
    pub fn report(&self, acquired_ns: i64, told: &mut TactileBaseline) {
        told.acquired_ns = acquired_ns;
        told.frames = self.seen.frames;
        told.trusted = self.believed as u32;
        told.noise_counts = self.noise_counts;
        for (told, mean) in told.mean_counts.iter_mut().zip(&self.means) {
            *told = if self.is_ready() { *mean as f32 } else { 0.0 };
        }
        for (told, trusted) in told.valid.iter_mut().zip(&self.trusted) {
            *told = u8::from(*trusted);
        }
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
            // The block that waited counts now, the newest one waits.
            if self.waiting.frames > 0 {
                self.seen.add(&self.waiting);
                self.grown = true;
            }
            core::mem::swap(&mut self.waiting, &mut self.newest);
            self.newest.clear();
        }
    }

    /// Computes means and trust from all frames so far, and the noise from the first ones: forty
    /// frames of 256 tactels determine it to half a percent, and more of them would only make the
    /// job longer.
    fn finish(&mut self, tactels: usize) {
        let first = self.believed == 0;
        let (mut variance, mut number_of_tactels) = (0.0, 0.0);
        self.trusted.fill(false);
        for index in 0..tactels.min(self.dead.len()) {
            if self.dead[index] {
                continue;
            }
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
        hash.add(&*self.means).add(&*self.trusted).add(&self.noise_counts);
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

    /// Fills `image` from a frame: counts above the rest level, 0 where the tactel is not believed.
    /// All zero and nothing believed before [`Baseline::is_ready`].
    #[expect(clippy::cast_possible_truncation, reason = "f32 holds a count to 1/256 of a count")]
    pub fn image(&self, frame: &TactileFrame, image: &mut TactileImage) {
        image.acquired_ns = frame.acquired.0;
        image.sequence = frame.sequence;
        (image.rows, image.cols) = (frame.rows(), frame.cols());
        image.baseline_ready = u32::from(self.is_ready());
        image.noise_counts =
            self.curve.map_or(self.noise_counts, |c| c.noise(self.noise_counts)) as f32;
        for (offset, row) in image.row_offset_ns.iter_mut().zip(&frame.row_acquired) {
            let nanos = row.0.saturating_sub(frame.acquired.0);
            *offset = nanos.clamp(i64::from(i32::MIN), i64::from(i32::MAX)) as i32;
        }
        image.counts.fill(0.0);
        image.valid.fill(0);
        if !self.is_ready() {
            return;
        }
        for index in 0..frame.tactels().min(image.counts.len()).min(self.trusted.len()) {
            if frame.valid[index] && self.trusted[index] {
                image.counts[index] = self.above_baseline(index, frame.values[index]) as f32;
                // Saturation is a property of the raw reading; the calibrated response changes the
                // value that is shown.
                let saturated = frame.values[index] >= self.full_scale;
                image.valid[index] = if saturated { TACTEL_SATURATED } else { 1 };
            }
        }
    }
}

#[cfg(test)]
mod tests;
