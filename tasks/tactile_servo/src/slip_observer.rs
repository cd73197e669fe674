//! Observes whether what is touched slides over the pad: follows the load from image to image,
//! takes away the motion over the pad that a contact without sliding has by the hand's own motion,
//! and tests what is left ([`taktil_mechanics::slip`]). Beside the test stands the energy of the
//! image's fast changes, which vibrations raise and slow motions do not.

use glam::DVec2;
use taktil_mechanics::Pose;
use taktil_mechanics::slip::detector::{SlipDetector, SlipParameters, SlipSample, SlipVerdict};
use taktil_mechanics::slip::matched::{MatchedSample, MatchedTest};
use taktil_mechanics::slip::place::{Place, PlaceTracker, SeenMotion, Symmetric};
use taktil_mechanics::tactile::{Image, features, moments};
use taktil_rtcore::{Fold, StateHash};
use taktil_signal::{Slip, TactileImage, slip};

use crate::config::Config;
use crate::config::array::Array;
use crate::config::slip::SlipConfig;
use crate::perception::TouchFeatures;

/// Poses of the tool that are remembered: 80 ms at 400 Hz, 32 ms at 1 kHz.
const POSES_KEPT: usize = 32;
/// The square of a second difference of white noise is six times its variance.
const SECOND_DIFFERENCE_VARIANCE: f64 = 6.0;
/// Smallest noise that is taken for granted (counts): that of rounding to whole counts.
const NOISE_MIN_COUNTS: f64 = 0.289;

/// The tool at an instant.
#[derive(Clone, Copy, Debug)]
struct TimedPose {
    t_ns: i64,
    tool: Pose,
}

/// The observer with what it remembers. Its images are allocated when it is made.
pub(crate) struct SlipObserver {
    config: SlipConfig,
    array: Array,
    poses: [Option<TimedPose>; POSES_KEPT],
    newest: usize,
    tracker: Option<PlaceTracker>,
    detector: SlipDetector,
    /// The test by the load's own shape, for a load that stands still.
    matched: MatchedTest,
    /// Tool at the image before.
    before: Option<Pose>,
    /// Where the contact would be over the pad without sliding, from where it was first (mm).
    rolled_mm: DVec2,
    touching_images: u32,
    /// Images of a contact that are left out at its begin.
    settling_images: u32,
    onsets: u32,
    was_detected: bool,
    /// The counts of the two images before, the newer first.
    earlier: [Box<[f32]>; 2],
    earlier_images: u32,
}

impl Fold for SlipObserver {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.touching_images).add(&self.onsets).add(&self.was_detected);
        hash.add(&self.rolled_mm.to_array()[..]).add(&self.tracker.is_some());
        if let Some(tracker) = &self.tracker {
            hash.add(&tracker.centre().to_array()[..]).add(&tracker.shape()[..]);
        }
        self.detector.for_each_number(|number| {
            hash.add(&number);
        });
        self.matched.for_each_number(|number| {
            hash.add(&number);
        });
    }
}

impl SlipObserver {
    /// An observer for checked configurations. Allocates the images that it remembers.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked first")]
    pub(crate) fn new(config: &SlipConfig, servo: &Config) -> SlipObserver {
        let parameters = SlipParameters {
            frame_s: 1e-3 * servo.image_period_ms,
            false_alarms_per_h: config.false_alarms_per_h,
            tolerance_mm_s: config.tolerance_mm_s,
        };
        let tactels = servo.array.tactels();
        let (rows, columns) = (servo.array.row_count(), tactels / servo.array.row_count());
        let pitch_mm = DVec2::new(servo.array.pitch_x_mm, servo.array.pitch_y_mm);
        SlipObserver {
            config: *config,
            array: servo.array,
            poses: [None; POSES_KEPT],
            newest: 0,
            tracker: None,
            detector: SlipDetector::new(&parameters),
            matched: MatchedTest::new(&parameters, rows, columns, pitch_mm),
            before: None,
            rolled_mm: DVec2::ZERO,
            touching_images: 0,
            settling_images: (1e3 * config.settling_s / servo.image_period_ms) as u32,
            onsets: 0,
            was_detected: false,
            earlier: [vec![0.0; tactels].into(), vec![0.0; tactels].into()],
            earlier_images: 0,
        }
    }

    /// Remembers where the tool was at the release of a job.
    pub(crate) fn record_pose(&mut self, t_ns: i64, tool: &Pose) {
        self.newest = (self.newest + 1) % POSES_KEPT;
        self.poses[self.newest] = Some(TimedPose { t_ns, tool: *tool });
    }

    /// The tool at an instant, between the poses of the two jobs about it; the nearest one outside.
    fn tool_at(&self, t_ns: i64) -> Option<Pose> {
        let mut later: Option<TimedPose> = None;
        for back in 0..POSES_KEPT {
            let pose = self.poses[(self.newest + POSES_KEPT - back) % POSES_KEPT]?;
            if pose.t_ns <= t_ns {
                let Some(later) = later.filter(|later| later.t_ns > pose.t_ns) else {
                    return Some(pose.tool);
                };
                let share = (t_ns - pose.t_ns) as f64 / (later.t_ns - pose.t_ns) as f64;
                let translation = pose.tool.translation.lerp(later.tool.translation, share);
                let (a, b) = (pose.tool.rotation, later.tool.rotation);
                return Some(Pose { rotation: a + share * (b - a), translation });
            }
            later = Some(pose);
        }
        later.map(|pose| pose.tool)
    }

    /// Motion over the pad (mm) of a contact at `contact_mm` from the pad's middle that does not
    /// slide, while the tool moves from one pose to another.
    fn rolling_mm(&self, from: &Pose, to: &Pose, contact_mm: DVec2) -> DVec2 {
        let back = from.rotation.transpose();
        let moved = 1e3 * (back * (to.translation - from.translation));
        let turned = back * to.rotation;
        let (about_x, about_y, about_z) = (turned.y_axis.z, turned.z_axis.x, turned.x_axis.y);
        let pad = moved.truncate() + about_z * DVec2::new(-contact_mm.y, contact_mm.x);
        let [share_x, share_y] = self.config.rolling_share;
        let [radius_y, radius_x] = self.config.radius_mm;
        DVec2::new(-share_x * pad.x - radius_y * about_y, -share_y * pad.y + radius_x * about_x)
    }

    /// Takes in a new image with its features and says what it shows.
    pub(crate) fn observe(
        &mut self,
        image: &TactileImage,
        touch: &TouchFeatures,
        threshold_counts: f64,
    ) -> Slip {
        let energy = self.high_pass_energy(image);
        let tool = self.tool_at(image.acquired_ns);
        let usable = touch.trusted && touch.contact && self.array.fits(image);
        let (Some(tool), true) = (tool, usable) else {
            self.forget();
            return self.report(image, &SlipVerdict::default(), None, energy);
        };
        self.touching_images = self.touching_images.saturating_add(1);
        if self.touching_images <= self.settling_images {
            return self.report(image, &SlipVerdict::default(), None, energy);
        }
        let Some((place, place_mm)) = self.follow(image, &tool, threshold_counts) else {
            self.forget();
            return self.report(image, &SlipVerdict::default(), None, energy);
        };
        let verdict = self.test(image, &place, place_mm);
        self.report(image, &verdict, Some(&place), energy)
    }

    /// Tests whether the load slides, whose place in this image is known. While it stands still, by
    /// its own shape; a motion of it leaves a blurred one, which is then forgotten.
    fn test(&mut self, image: &TactileImage, place: &Place, place_mm: DVec2) -> SlipVerdict {
        let [x, y] = [self.array.pitch_x_mm, self.array.pitch_y_mm];
        let [xx, xy, yy] = place.covariance;
        let t_s = 1e-9 * image.acquired_ns as f64;
        // A normal to the load's line, in millimetres.
        let seen = match place.seen {
            SeenMotion::Along(axis) => {
                SeenMotion::Along((axis / DVec2::new(x, y)).normalize_or_zero())
            }
            other => other,
        };
        let onset = self.matched.update(&MatchedSample {
            t_s,
            counts: &image.counts,
            valid: &image.valid,
            noise_counts: f64::from(image.noise_counts).max(NOISE_MIN_COUNTS),
            rolled_mm: self.rolled_mm,
            seen,
        });
        let direction = match seen {
            SeenMotion::Nothing => {
                self.detector.reset();
                return SlipVerdict::default();
            }
            SeenMotion::Along(axis) => Some(axis),
            SeenMotion::All => None,
        };
        let sample = SlipSample {
            t_s,
            place_mm: place_mm - self.rolled_mm,
            covariance_mm2: [x * x * xx, x * y * xy, y * y * yy],
            direction,
        };
        let verdict = self.detector.update_with_onset(&sample, onset.as_ref());
        if self.was_detected && !verdict.is_detected {
            self.matched.reset();
        }
        verdict
    }

    fn forget(&mut self) {
        (self.tracker, self.before, self.touching_images) = (None, None, 0);
        self.rolled_mm = DVec2::ZERO;
        self.detector.reset();
        self.matched.reset();
    }

    /// The place of the load in tactel numbers, and in mm from the middle of the pad.
    fn follow(
        &mut self,
        image: &TactileImage,
        tool: &Pose,
        threshold_counts: f64,
    ) -> Option<(Place, DVec2)> {
        let pitch = DVec2::new(self.array.pitch_x_mm, self.array.pitch_y_mm);
        let middle = DVec2::new(self.array.middle_column(), self.array.middle_row());
        let mut tracker = match self.tracker {
            Some(tracker) => tracker,
            None => first_weight(image, threshold_counts)?,
        };
        let contact_mm = pitch * (tracker.centre() - middle);
        let before = self.before.replace(*tool);
        let rolled =
            before.map_or(DVec2::ZERO, |before| self.rolling_mm(&before, tool, contact_mm));
        let noise = f64::from(image.noise_counts).max(NOISE_MIN_COUNTS);
        let counts = (&*image.counts, &*image.valid);
        let place = tracker.update(counts, usize::from(image.cols), noise, rolled / pitch)?;
        self.tracker = Some(tracker);
        self.rolled_mm += rolled;
        Some((place, pitch * (place.centre - middle)))
    }

    /// Mean square of the second difference of the counts over what noise makes of it: 1 where
    /// nothing changes fast, 0 before three images.
    fn high_pass_energy(&mut self, image: &TactileImage) -> f64 {
        let [one, two] = &mut self.earlier;
        if image.counts.len() != one.len() {
            self.earlier_images = 0;
            return 0.0;
        }
        let (mut sum, mut number) = (0.0, 0.0);
        for (((counts, valid), one), two) in
            image.counts.iter().zip(&image.valid).zip(one.iter_mut()).zip(two.iter_mut())
        {
            let second = f64::from(*counts) - 2.0 * f64::from(*one) + f64::from(*two);
            if *valid != 0 && second.is_finite() {
                sum += second * second;
                number += 1.0;
            }
            (*two, *one) = (*one, *counts);
        }
        self.earlier_images = (self.earlier_images + 1).min(3);
        let noise = f64::from(image.noise_counts).max(NOISE_MIN_COUNTS);
        let energy = sum / (number * SECOND_DIFFERENCE_VARIANCE * noise * noise);
        if self.earlier_images == 3 && energy.is_finite() { energy } else { 0.0 }
    }

    fn report(
        &mut self,
        image: &TactileImage,
        verdict: &SlipVerdict,
        place: Option<&Place>,
        energy: f64,
    ) -> Slip {
        self.onsets += u32::from(verdict.is_detected && !self.was_detected);
        self.was_detected = verdict.is_detected;
        let bit = |set: bool, bit: u32| if set { bit } else { 0 };
        let [along_x, along_y] = match place.map(|place| place.seen) {
            Some(SeenMotion::All) => [true; 2],
            Some(SeenMotion::Along(axis)) => [axis.x.abs() >= 0.5, axis.y.abs() >= 0.5],
            Some(SeenMotion::Nothing) | None => [false; 2],
        };
        Slip {
            acquired_ns: image.acquired_ns,
            velocity_mm_s: verdict.velocity_mm_s.to_array(),
            statistic: verdict.statistic,
            threshold: verdict.threshold,
            high_pass_energy: energy,
            detected: u32::from(verdict.is_detected),
            seen: bit(verdict.is_ready, slip::TEST_READY)
                | bit(along_x, slip::ALONG_X)
                | bit(along_y, slip::ALONG_Y),
            onsets: self.onsets,
            sequence: image.sequence,
        }
    }
}

/// The weight of a first image: centroid and central second moments above the threshold.
fn first_weight(image: &TactileImage, threshold_counts: f64) -> Option<PlaceTracker> {
    let (rows, cols) = (usize::from(image.rows), usize::from(image.cols));
    let view = Image::new(rows, cols, &image.counts, Some(&image.valid)).ok()?;
    let threshold = if threshold_counts > 0.0 { threshold_counts } else { f64::NEG_INFINITY };
    let found = features(&moments(&view, threshold));
    let covariance: Symmetric = [found.mu_yy, found.mu_xy, found.mu_xx].map(|mu| mu / found.m0);
    PlaceTracker::new(DVec2::new(found.x_c?, found.y_c?), covariance)
}

#[cfg(test)]
mod tests;
