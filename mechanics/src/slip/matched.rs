//! Tests a load that stands still on the pad for a ramp by matched filters made from the load's own
//! image: the most powerful test of a known shape in white noise weighs each tactel by the change
//! that a displacement makes there (D. O. North, Proc. IEEE 51, 1963, reprint of 1943; S. M. Kay,
//! *Detection Theory*, 1998, section 4.3). The shape is the mean of images before the earliest
//! onset that is tried, its change by a displacement is its spatial derivative, and what a change
//! of the load as a whole adds is taken away.
//!
//! A Gaussian weight of the load's place and shape ([`super::place`]) is that filter for a load of
//! Gaussian shape. A wide flat load has edges only: such a weight adds the noise of its inside.
//!
//! The images themselves are remembered, and each new one gives new filters, by which all images
//! are read again: thus no test compares places that were measured by different weights. Before an
//! onset the load may creep steadily, by the tolerance at most: a line through all places before
//! the onset says how fast, and its noise is a part of the ramp's.

use glam::DVec2;

use super::detector::{GAP_FRAMES, ONSET_FRAMES, Onset, SlipParameters};
use super::place::{SeenMotion, Symmetric, derivative, inverse};
use crate::tactile::Image;

/// Images that are remembered: about half a second at 200 Hz. A line through more of them would
/// make the noise of the ramp smaller by less than a twentieth.
const IMAGES_KEPT: usize = 96;
/// The newest images, which are no part of the shape: those since the earliest onset.
const IMAGES_SINCE_ONSET: usize = ONSET_FRAMES[ONSET_FRAMES.len() - 1];
/// Fewest images of the shape: the noise of their mean then adds less than a twentieth to that of
/// the place.
const SHAPE_IMAGES_MIN: usize = 16;
/// Farthest that the hand's own motion may have rolled the load while images were remembered (mm):
/// a shape that is the mean of images farther apart is blurred.
const ROLLED_MAX_MM: f64 = 0.05;
/// Partial sums of a product of two images: they are independent, so that one does not wait for
/// the other.
const LANE_COUNT: usize = 8;

/// One image: what is known of it beside its counts.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Frame {
    t_s: f64,
    /// Where the load would lie by the hand's own motion (mm).
    rolled_mm: DVec2,
}

/// One image of the pad, and what is known of it.
#[derive(Clone, Copy, Debug)]
pub struct MatchedSample<'a> {
    /// Instant (s).
    pub t_s: f64,
    /// Counts of the tactels, row by row.
    pub counts: &'a [f32],
    /// Marks of the tactels: 0 for one that does not count.
    pub valid: &'a [u8],
    /// Standard deviation of a tactel (counts).
    pub noise_counts: f64,
    /// Where the load would lie by the hand's own motion, from any origin (mm).
    pub rolled_mm: DVec2,
    /// In which directions a motion shows; a line's normal in millimetres.
    pub seen: SeenMotion,
}

/// The test with the images that it remembers. They are allocated when it is made.
#[derive(Clone, Debug)]
pub struct MatchedTest {
    parameters: SlipParameters,
    columns: usize,
    pitch_mm: DVec2,
    /// Images one after another; the newest is at `newest`, older ones before it, round and round.
    images: Box<[f32]>,
    marks: Box<[u8]>,
    frames: [Frame; IMAGES_KEPT],
    newest: usize,
    count: usize,
    /// Sum of the images of the shape.
    sum: Box<[f64]>,
    shape: Box<[f64]>,
    slopes: [Box<[f64]>; 2],
    filters: [Box<[f32]>; 2],
    /// Places by the newest filters, the oldest first (mm).
    places_mm: [DVec2; IMAGES_KEPT],
}

/// Sums over the first frames: their number, and sums of times, places and products.
#[derive(Clone, Copy, Debug, Default)]
struct LineSums {
    count: f64,
    t: f64,
    tt: f64,
    place: DVec2,
    moved: DVec2,
}

impl LineSums {
    fn with(self, t_s: f64, place: DVec2) -> LineSums {
        LineSums {
            count: self.count + 1.0,
            t: self.t + t_s,
            tt: self.tt + t_s * t_s,
            place: self.place + place,
            moved: self.moved + t_s * place,
        }
    }

    fn less(self, other: &LineSums) -> LineSums {
        LineSums {
            count: self.count - other.count,
            t: self.t - other.t,
            tt: self.tt - other.tt,
            place: self.place - other.place,
            moved: self.moved - other.moved,
        }
    }
}

/// The sum of the products of two images.
fn product(a: &[f32], b: &[f32]) -> f32 {
    let (a_parts, b_parts) = (a.chunks_exact(LANE_COUNT), b.chunks_exact(LANE_COUNT));
    let rest = a_parts.remainder().iter().zip(b_parts.remainder()).map(|(a, b)| a * b).sum::<f32>();
    let mut sums = [0.0_f32; LANE_COUNT];
    for (a, b) in a_parts.zip(b_parts) {
        for (sum, (a, b)) in sums.iter_mut().zip(a.iter().zip(b)) {
            *sum += a * b;
        }
    }
    sums.iter().sum::<f32>() + rest
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

impl MatchedTest {
    /// A test without images, for a pad of so many rows and columns at these distances (mm).
    /// Allocates its images.
    #[must_use]
    pub fn new(
        parameters: &SlipParameters,
        rows: usize,
        columns: usize,
        pitch_mm: DVec2,
    ) -> MatchedTest {
        let tactels = rows * columns;
        MatchedTest {
            parameters: *parameters,
            columns,
            pitch_mm,
            images: vec![0.0; IMAGES_KEPT * tactels].into(),
            marks: vec![0; tactels].into(),
            frames: [Frame::default(); IMAGES_KEPT],
            newest: 0,
            count: 0,
            sum: vec![0.0; tactels].into(),
            shape: vec![0.0; tactels].into(),
            slopes: [vec![0.0; tactels].into(), vec![0.0; tactels].into()],
            filters: [vec![0.0; tactels].into(), vec![0.0; tactels].into()],
            places_mm: [DVec2::ZERO; IMAGES_KEPT],
        }
    }

    /// Forgets all images.
    pub fn reset(&mut self) {
        self.count = 0;
        self.sum.fill(0.0);
    }

    /// The numbers by which two tests differ, for a hash of the state: times and places. Every
    /// image is in the places.
    pub fn for_each_number(&self, mut visit: impl FnMut(f64)) {
        for (back, place) in self.places_mm[..self.count].iter().enumerate() {
            [self.frame(back).t_s, place.x, place.y].into_iter().for_each(&mut visit);
        }
    }

    /// The place in the ring of the image so many before the newest.
    fn slot(&self, back: usize) -> usize {
        (self.newest + IMAGES_KEPT - back) % IMAGES_KEPT
    }

    fn frame(&self, back: usize) -> &Frame {
        &self.frames[self.slot(back)]
    }

    /// Takes in an image. Where the load stands still, and there are images enough, the likeliest
    /// onset of a ramp; `None` otherwise. An image of another size, a gap and numbers that are not
    /// finite begin a new sequence. It does not allocate, and takes the same steps each time.
    pub fn update(&mut self, sample: &MatchedSample<'_>) -> Option<Onset> {
        let tactels = self.marks.len();
        let fits = sample.counts.len() == tactels && sample.valid.len() == tactels;
        let finite = sample.t_s.is_finite()
            && sample.rolled_mm.is_finite()
            && sample.noise_counts.is_finite()
            && sample.noise_counts > 0.0;
        if !(fits && finite) || matches!(sample.seen, SeenMotion::Nothing) {
            self.reset();
            return None;
        }
        self.append(sample);
        if self.count < IMAGES_SINCE_ONSET + SHAPE_IMAGES_MIN || !self.stands_still() {
            return None;
        }
        let covariance = self.match_filters(sample.noise_counts, sample.seen)?;
        self.measure_places(matches!(sample.seen, SeenMotion::All));
        self.likeliest_onset(covariance, sample.seen)
    }

    /// Puts an image into the ring, and the one that has become old enough into the shape.
    fn append(&mut self, sample: &MatchedSample<'_>) {
        let tactels = self.marks.len();
        let since_s = sample.t_s - self.frame(0).t_s;
        let follows = since_s > 0.0 && since_s < GAP_FRAMES * self.parameters.frame_s;
        if self.count > 0 && (!follows || *self.marks != *sample.valid) {
            self.reset();
        }
        self.marks.copy_from_slice(sample.valid);
        let next = (self.newest + 1) % IMAGES_KEPT;
        if self.count == IMAGES_KEPT {
            // The oldest image makes room for the newest.
            let oldest = &self.images[next * tactels..][..tactels];
            for (sum, value) in self.sum.iter_mut().zip(oldest) {
                *sum -= f64::from(*value);
            }
            self.count -= 1;
        }
        let place = &mut self.images[next * tactels..][..tactels];
        for ((kept, value), mark) in place.iter_mut().zip(sample.counts).zip(sample.valid) {
            *kept = if *mark != 0 && value.is_finite() { *value } else { 0.0 };
        }
        self.newest = next;
        self.frames[next] = Frame { t_s: sample.t_s, rolled_mm: sample.rolled_mm };
        self.count += 1;
        if self.count > IMAGES_SINCE_ONSET {
            let slot = self.slot(IMAGES_SINCE_ONSET);
            let old = &self.images[slot * tactels..][..tactels];
            for (sum, value) in self.sum.iter_mut().zip(old) {
                *sum += f64::from(*value);
            }
        }
    }

    fn stands_still(&self) -> bool {
        let mut low = self.frame(0).rolled_mm;
        let mut high = low;
        for back in 1..self.count {
            low = low.min(self.frame(back).rolled_mm);
            high = high.max(self.frame(back).rolled_mm);
        }
        (high - low).length() <= ROLLED_MAX_MM
    }

    /// Makes the filters from the shape; the covariance of a place by them (mm^2).
    #[expect(clippy::cast_precision_loss, reason = "a small count")]
    #[expect(clippy::cast_possible_truncation, reason = "filters need no more than f32")]
    fn match_filters(&mut self, noise_counts: f64, seen: SeenMotion) -> Option<Symmetric> {
        let part = 1.0 / (self.count - IMAGES_SINCE_ONSET) as f64;
        for (shape, sum) in self.shape.iter_mut().zip(&self.sum) {
            *shape = part * sum;
        }
        self.differentiate()?;
        let [x, y] = &self.slopes;
        let [xx, xy, yy] = [dot(x, x), dot(x, y), dot(y, y)];
        let variance = noise_counts * noise_counts;
        // A displacement changes the image by the slopes with the opposite sign.
        let (rows, covariance) = match seen {
            SeenMotion::Along(axis) => {
                let information =
                    axis.x * axis.x * xx + 2.0 * axis.x * axis.y * xy + axis.y * axis.y * yy;
                let back = 1.0 / information;
                ([axis * -back, DVec2::ZERO], [variance * back, 0.0, variance * back])
            }
            _ => {
                let [a, b, c] = inverse([xx, xy, yy])?;
                ([DVec2::new(-a, -b), DVec2::new(-b, -c)], [a, b, c].map(|value| variance * value))
            }
        };
        let usable = covariance.iter().all(|value| value.is_finite());
        for (filter, row) in self.filters.iter_mut().zip(rows) {
            for (value, (x, y)) in filter.iter_mut().zip(x.iter().zip(y)) {
                *value = (row.x * x + row.y * y) as f32;
            }
        }
        usable.then_some(covariance)
    }

    /// The derivatives of the shape along x and y (counts/mm), without the part that a change of
    /// the load as a whole makes; zero for tactels that do not count.
    fn differentiate(&mut self) -> Option<()> {
        let columns = self.columns;
        let rows = self.shape.len() / columns;
        let image = Image::new(rows, columns, &self.shape, None).ok()?;
        let at = |r: usize, c: usize| image.value(r, c).unwrap_or(0.0);
        let [x, y] = &mut self.slopes;
        for r in 0..rows {
            for c in 0..columns {
                let index = r * columns + c;
                if self.marks[index] == 0 {
                    (x[index], y[index]) = (0.0, 0.0);
                    continue;
                }
                x[index] = derivative(c, columns, |c| at(r, c)) / self.pitch_mm.x;
                y[index] = derivative(r, rows, |r| at(r, c)) / self.pitch_mm.y;
            }
        }
        let square = dot(&self.shape, &self.shape);
        for slope in &mut self.slopes {
            let share = dot(slope, &self.shape) / square;
            for (slope, shape) in slope.iter_mut().zip(&self.shape) {
                *slope -= share * shape;
            }
        }
        (square > 0.0).then_some(())
    }

    /// Reads all images by the filters: places less the hand's own motion, the oldest first. Along
    /// a line there is one filter, and x is the way along its normal.
    fn measure_places(&mut self, has_both: bool) {
        let tactels = self.marks.len();
        for index in 0..self.count {
            let slot = self.slot(self.count - 1 - index);
            let image = &self.images[slot * tactels..][..tactels];
            let x = f64::from(product(&self.filters[0], image));
            let y = if has_both { f64::from(product(&self.filters[1], image)) } else { 0.0 };
            self.places_mm[index] = DVec2::new(x, y);
        }
    }

    fn likeliest_onset(&self, covariance: Symmetric, seen: SeenMotion) -> Option<Onset> {
        let precision = inverse(covariance)?;
        let axis = if let SeenMotion::Along(axis) = seen { Some(axis) } else { None };
        let now_s = self.frame(0).t_s;
        let mut sums = [LineSums::default(); IMAGES_KEPT + 1];
        for index in 0..self.count {
            let frame = self.frame(self.count - 1 - index);
            let rolled =
                axis.map_or(frame.rolled_mm, |axis| DVec2::new(axis.dot(frame.rolled_mm), 0.0));
            let place = self.places_mm[index] - rolled;
            sums[index + 1] = sums[index].with(frame.t_s - now_s, place);
        }
        let mut likeliest: Option<Onset> = None;
        for frames in ONSET_FRAMES {
            let start_s = self.frame(frames).t_s - now_s;
            let (velocity, variance_factor) =
                self.ramp(&sums[self.count - frames], &sums[self.count], start_s);
            let speed = velocity.length();
            let beyond = (speed - self.parameters.tolerance_mm_s).max(0.0);
            let [a, b, c] = precision;
            let square = a * velocity.x * velocity.x
                + 2.0 * b * velocity.x * velocity.y
                + c * velocity.y * velocity.y;
            let share = if speed > 0.0 { beyond / speed } else { 0.0 };
            let statistic = share * share * square / variance_factor;
            if !statistic.is_finite() {
                return None;
            }
            if likeliest.is_none_or(|best| statistic > best.statistic) {
                let velocity_mm_s = axis.map_or(velocity, |axis| axis * velocity.x);
                likeliest = Some(Onset { frames, statistic, velocity_mm_s });
            }
        }
        likeliest
    }

    /// The velocity of a ramp (mm/s) after the line through the frames before it, and its variance
    /// over that of a place (1/s^2). `before` are sums up to the ramp's start, `all` to its end.
    fn ramp(&self, before: &LineSums, all: &LineSums, start_s: f64) -> (DVec2, f64) {
        let middle_s = before.t / before.count;
        let spread = before.tt - before.count * middle_s * middle_s;
        let level = before.place / before.count;
        let most = self.parameters.tolerance_mm_s;
        let creep = ((before.moved - middle_s * before.place) / spread).clamp_length_max(most);
        let after = all.less(before);
        // Sums of the time since the start, of its square and of its product with the level's.
        let times = after.t - after.count * start_s;
        let squares = after.tt - 2.0 * start_s * after.t + after.count * start_s * start_s;
        let levers = squares + (start_s - middle_s) * times;
        let moved = after.moved - start_s * after.place;
        let velocity = (moved - level * times - creep * levers) / squares;
        let level_part = times * times / before.count + levers * levers / spread;
        (velocity, (1.0 + level_part / squares) / squares)
    }
}

#[cfg(test)]
mod tests;
