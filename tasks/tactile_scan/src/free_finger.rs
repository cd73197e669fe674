//! Sums of frames, and the test that tells a finger in contact from a free one: a frame, or the
//! mean of a block of frames, that lies further from the baseline than its noise explains. The test
//! does not ask what touches: a load anywhere, on one tactel or thinly on all of them, ends the
//! baseline.
//!
//! Frames come in blocks. A block is added to the sums of the baseline only when the whole block
//! after it was free as well, so that a load that grows slowly is noticed before its first frames
//! count.

use taktil_hal::TactileFrame;
use taktil_rtcore::{Fold, StateHash};

/// Frames of a block: 0.08 s at 200 Hz.
pub const FRAMES_PER_BLOCK: u32 = 16;
/// Standard deviations by which the sum of all tactels, and one tactel, may lie off the rest level.
const SUM_SIGMAS: f64 = 4.5;
const TACTEL_SIGMAS: f64 = 6.0;
/// Variance of a reading that is a whole number, rounded up (counts^2).
const ROUNDING_VARIANCE_COUNTS2: f64 = 1.0;

/// Sums of valid readings of each tactel, exact in integers.
#[derive(Clone, Debug)]
pub struct FrameSums {
    /// Frames that were taken in.
    pub frames: u32,
    sums: Box<[u64]>,
    squares: Box<[u64]>,
    numbers: Box<[u32]>,
}

impl Fold for FrameSums {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.frames).add(&*self.sums).add(&*self.squares).add(&*self.numbers);
    }
}

impl FrameSums {
    /// The sums of no frame of an array of that many tactels; allocates.
    #[must_use]
    pub fn new(tactels: usize) -> FrameSums {
        FrameSums {
            frames: 0,
            sums: vec![0; tactels].into(),
            squares: vec![0; tactels].into(),
            numbers: vec![0; tactels].into(),
        }
    }

    /// Forgets all frames.
    pub fn clear(&mut self) {
        self.frames = 0;
        self.sums.fill(0);
        self.squares.fill(0);
        self.numbers.fill(0);
    }

    /// Takes one more frame in.
    pub fn add_frame(&mut self, frame: &TactileFrame) {
        for index in 0..frame.tactels().min(self.sums.len()) {
            if frame.valid[index] {
                let value = u64::from(frame.values[index]);
                self.sums[index] += value;
                self.squares[index] += value * value;
                self.numbers[index] += 1;
            }
        }
        self.frames += 1;
    }

    /// Takes all frames of another in.
    pub fn add(&mut self, other: &FrameSums) {
        for index in 0..self.sums.len() {
            self.sums[index] += other.sums[index];
            self.squares[index] += other.squares[index];
            self.numbers[index] += other.numbers[index];
        }
        self.frames += other.frames;
    }

    /// Mean of a tactel (counts) that was valid in at least half of the frames.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "sums of 16-bit counts stay far below 2^53")]
    pub fn mean(&self, index: usize) -> Option<f64> {
        let number = self.numbers[index];
        let known = number > 0 && 2 * u64::from(number) >= u64::from(self.frames);
        known.then(|| self.sums[index] as f64 / f64::from(number))
    }

    /// Variance of a tactel (counts^2), with two readings or more.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "a spread of 16-bit counts")]
    pub fn variance(&self, index: usize) -> Option<f64> {
        let number = self.numbers[index];
        // n sum x^2 - (sum x)^2 in integers: exact, and never negative; below 2^64 for 16-bit
        // counts and 65 535 frames.
        let (n, sum) = (u64::from(number), self.sums[index]);
        let spread = n * self.squares[index] - sum * sum;
        (number > 1).then(|| spread as f64 / (f64::from(number) * f64::from(number - 1)))
    }
}

/// The rest level so far, with which frames are compared.
#[derive(Clone, Copy, Debug)]
pub struct FreeFingerTest<'a> {
    /// Baseline of each tactel (counts), and which have one.
    pub means: &'a [f64],
    /// Whether each tactel is trusted.
    pub trusted: &'a [bool],
    /// Standard deviation of a reading (counts).
    pub noise_counts: f64,
    /// Frames that it is the mean of.
    pub frames: u32,
}

impl FreeFingerTest<'_> {
    /// Whether readings that are means of `frames` frames, by tactel, show a finger that is free.
    fn is_free(&self, reading: impl Fn(usize) -> Option<f64>, frames: u32) -> bool {
        let parts = 1.0 / f64::from(frames.max(1)) + 1.0 / f64::from(self.frames.max(1));
        let sigma =
            ((self.noise_counts * self.noise_counts + ROUNDING_VARIANCE_COUNTS2) * parts).sqrt();
        let (mut sum, mut number, mut most) = (0.0, 0.0, 0.0_f64);
        for index in (0..self.means.len()).filter(|index| self.trusted[*index]) {
            if let Some(value) = reading(index) {
                let off = value - self.means[index];
                sum += off;
                number += 1.0;
                most = most.max(off.abs());
            }
        }
        let limit: f64 = SUM_SIGMAS * sigma * f64::sqrt(number);
        sum.abs() <= limit && most <= TACTEL_SIGMAS * sigma
    }

    /// Whether a frame shows a free finger.
    #[must_use]
    pub fn is_free_frame(&self, frame: &TactileFrame) -> bool {
        let tactels = frame.tactels();
        let reading = |index: usize| {
            let valid = index < tactels && frame.valid[index];
            valid.then(|| f64::from(frame.values[index]))
        };
        self.is_free(reading, 1)
    }

    /// Whether a block of frames does.
    #[must_use]
    pub fn is_free_block(&self, block: &FrameSums) -> bool {
        self.is_free(|index| block.mean(index), block.frames)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames of noise of standard deviation 50 about 300 counts by a congruence (Knuth's MMIX),
    /// with `load` counts on top of each tactel.
    fn frame(seed: &mut u64, load: impl Fn(usize) -> f64) -> TactileFrame {
        let mut frame = TactileFrame::new(16, 16);
        frame.valid.fill(true);
        for (index, value) in frame.values.iter_mut().enumerate() {
            let mut sum = -6.0;
            for _ in 0..12 {
                *seed = seed
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1_442_695_040_888_963_407);
                sum += (*seed >> 40) as f64 / f64::from(1 << 24);
            }
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "positive")]
            let counts = (300.0 + 50.0 * sum + load(index)).round() as u16;
            *value = counts;
        }
        frame
    }

    fn rest(means: &[f64; 256]) -> FreeFingerTest<'_> {
        FreeFingerTest { means, trusted: &[true; 256], noise_counts: 50.0, frames: 40 }
    }

    #[test]
    fn noise_is_free_and_a_load_is_not_on_one_tactel_nor_thin_on_all() {
        let means = [300.0; 256];
        let (rest, mut seed) = (rest(&means), 5);
        let taken = |seed: &mut u64, load: fn(usize) -> f64| {
            (0..200).filter(|_| !rest.is_free_frame(&frame(seed, load))).count()
        };
        assert_eq!(taken(&mut seed, |_| 0.0), 0);
        assert_eq!(taken(&mut seed, |index| if index == 77 { 600.0 } else { 0.0 }), 200);
        assert_eq!(taken(&mut seed, |_| 30.0), 200);
        assert_eq!(taken(&mut seed, |_| -30.0), 200, "unloaded is no rest either");
        // The load is too small to be detected in one frame, but large enough for the mean of
        // sixteen.
        let mut block = FrameSums::new(256);
        (0..FRAMES_PER_BLOCK).for_each(|_| block.add_frame(&frame(&mut seed, |_| 0.0)));
        assert!(rest.is_free_block(&block));
        let mut block = FrameSums::new(256);
        (0..FRAMES_PER_BLOCK).for_each(|_| block.add_frame(&frame(&mut seed, |_| 8.0)));
        assert!(!rest.is_free_block(&block));
    }

    #[test]
    fn tactels_that_are_not_believed_or_not_valid_say_nothing() {
        let means = [300.0; 256];
        let mut trusted = [true; 256];
        trusted[3] = false;
        let rest = FreeFingerTest { trusted: &trusted, ..rest(&means) };
        let mut frame = frame(&mut 9, |index| if index == 3 { 3_000.0 } else { 0.0 });
        assert!(rest.is_free_frame(&frame));
        frame.values[4] = 4_000;
        assert!(!rest.is_free_frame(&frame));
        frame.valid[4] = false;
        assert!(rest.is_free_frame(&frame));
    }

    #[test]
    fn sums_of_two_are_the_sums_of_all() {
        let (mut seed, mut all, mut first, mut second) =
            (1, FrameSums::new(256), FrameSums::new(256), FrameSums::new(256));
        for count in 0..10 {
            let frame = frame(&mut seed, |_| 0.0);
            all.add_frame(&frame);
            if count < 4 { first.add_frame(&frame) } else { second.add_frame(&frame) }
        }
        first.add(&second);
        assert_eq!((first.frames, first.mean(7)), (10, all.mean(7)));
        assert_eq!(first.variance(7), all.variance(7));
        assert_eq!(FrameSums::new(256).mean(0), None);
    }
}
