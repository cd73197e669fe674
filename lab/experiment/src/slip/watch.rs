//! Observes a run for what slid, when it was noticed, and how well the place of the load could be
//! known at the best.

use taktil_lab_scene::world::{ObjectTruth, WorldTruth};
use taktil_mechanics::slip::place::place_bound;
use taktil_mechanics::tactile::Image;
use taktil_rtcore::payload::Field;
use taktil_rtcore::record::{Catalog, Observer, Record};
use taktil_rtcore::{FromRecord, Nanos, Payload};
use taktil_signal::{ControlState, Slip, TactileImage, slip};

/// Images before the slip whose mean is the image without noise.
const MEAN_IMAGES: Nanos = Nanos::from_millis(250);
/// A true speed of sliding from which on an alarm is none that is false (m/s).
const SLIP_MIN_M_S: f64 = 0.5e-3;
/// For so long after it, too: the test needs a while to see the end.
const SLIP_MEMORY: Nanos = Nanos::from_millis(250);

/// What came of a run.
#[derive(Clone, Debug, Default)]
pub(crate) struct SlipFindings {
    /// From the first motion of the body over the pad to the alarm (s); absent without one.
    pub(crate) delay_s: Option<f64>,
    /// From the instant at which the friction was exhausted (s).
    pub(crate) sliding_delay_s: Option<f64>,
    /// Speed of slip as it was measured last while it slid, and its error (mm/s).
    pub(crate) velocity_mm_s: Option<f64>,
    pub(crate) velocity_error_mm_s: Option<f64>,
    /// Standard deviation of the place along x in one frame at the best (mm).
    pub(crate) place_bound_mm: Option<f64>,
    /// Alarms without slip.
    pub(crate) false_alarms: u32,
    /// Time in which the test was ready (s).
    pub(crate) ready_s: f64,
    /// Largest statistic over its threshold without slip.
    pub(crate) largest_ratio: f64,
    /// Latched faults.
    pub(crate) faults: u32,
}

/// Keeps what the findings need.
pub(crate) struct SlipWatch {
    slip: Option<usize>,
    object: Option<usize>,
    truth: Option<usize>,
    control: Option<usize>,
    image: Option<(usize, Vec<Field>)>,
    /// When the body begins to move; none where nothing is to slide.
    from: Option<Nanos>,
    sliding_from: Option<Nanos>,
    slid_at: Option<Nanos>,
    /// True speed of slip (mm/s).
    slip_mm_s: f64,
    before: Slip,
    sum: Vec<f64>,
    images: u32,
    size: (usize, usize),
    found: SlipFindings,
}

impl SlipWatch {
    pub(crate) fn new(catalog: &Catalog, from: Option<Nanos>) -> SlipWatch {
        let image = catalog.find("tactile_scan.image");
        SlipWatch {
            slip: catalog.find("tactile_servo.slip"),
            object: catalog.find("world.object"),
            truth: catalog.find("world.truth"),
            control: catalog.find("supervisor.control"),
            image: image.map(|id| (id, catalog.signals[id].fields.to_vec())),
            from,
            sliding_from: None,
            slid_at: None,
            slip_mm_s: 0.0,
            before: Slip::ZERO,
            sum: Vec::new(),
            images: 0,
            size: (0, 0),
            found: SlipFindings::default(),
        }
    }

    fn take_image(&mut self, image: &TactileImage) {
        let at = Nanos(image.acquired_ns);
        let wanted = self.from.is_some_and(|from| at < from && at + MEAN_IMAGES >= from);
        if !wanted {
            return;
        }
        self.size = (usize::from(image.rows), usize::from(image.cols));
        self.sum.resize(image.counts.len(), 0.0);
        self.images += 1;
        for (sum, counts) in self.sum.iter_mut().zip(&image.counts) {
            *sum += f64::from(*counts);
        }
    }

    fn take_slip(&mut self, at: Nanos, slip: &Slip) {
        let ready = slip.seen & slip::TEST_READY != 0;
        if ready {
            let since = slip.acquired_ns - self.before.acquired_ns;
            self.found.ready_s += 1e-9 * since.clamp(0, 20_000_000) as f64;
        }
        let moving = self.from.is_some_and(|from| Nanos(slip.acquired_ns) >= from);
        let slides = moving || self.slid_at.is_some_and(|last| at < last + SLIP_MEMORY);
        let begins = slip.detected == 1 && self.before.detected == 0;
        if !slides {
            self.found.false_alarms += u32::from(begins);
            if slip.detected == 0 && slip.threshold > 0.0 {
                let ratio = slip.statistic / slip.threshold;
                self.found.largest_ratio = self.found.largest_ratio.max(ratio);
            }
        }
        if let Some(from) = self.from.filter(|_| moving) {
            if begins && self.found.delay_s.is_none() {
                self.found.delay_s = Some((at - from).as_secs_f64());
                let sliding = self.sliding_from.unwrap_or(at);
                self.found.sliding_delay_s = Some((at - sliding).as_secs_f64());
            }
            if slip.detected == 1 && self.slip_mm_s > 1e3 * SLIP_MIN_M_S {
                let [x, y] = slip.velocity_mm_s;
                let speed = libm::hypot(x, y);
                self.found.velocity_mm_s = Some(speed);
                self.found.velocity_error_mm_s = Some(speed - self.slip_mm_s);
            }
        }
        self.before = *slip;
    }

    fn take_sliding(&mut self, t: Nanos, speed_m_s: f64) {
        self.slip_mm_s = 1e3 * speed_m_s;
        if speed_m_s > SLIP_MIN_M_S {
            self.slid_at = Some(t);
            if self.from.is_some_and(|from| t >= from) {
                self.sliding_from.get_or_insert(t);
            }
        }
    }

    pub(crate) fn findings(mut self, pitch_mm: f64, noise_counts: f64) -> SlipFindings {
        if self.images > 0 {
            let mean: Vec<f64> = self.sum.iter().map(|sum| sum / f64::from(self.images)).collect();
            if let Ok(image) = Image::new(self.size.0, self.size.1, &mean, None) {
                let [xx, xy, yy] = place_bound(&image, noise_counts);
                // Along x alone, with the place along y known.
                let alone = if yy.is_finite() { xx - xy * xy / yy } else { xx };
                self.found.place_bound_mm = Some(pitch_mm * alone.sqrt()).filter(|v| v.is_finite());
            }
        }
        self.found
    }
}

impl Observer for SlipWatch {
    fn record(&mut self, record: &Record<'_>) {
        let id = Some(record.signal);
        if id == self.slip {
            if let Some(slip) = Slip::decode(record.body) {
                self.take_slip(record.release, &slip);
            }
        } else if id == self.object {
            if let Some(object) = ObjectTruth::decode(record.body) {
                self.take_sliding(Nanos(object.t_ns), object.slip_m_s);
            }
        } else if id == self.truth {
            if let Some(truth) = <WorldTruth>::decode(record.body)
                && self.object.is_none()
            {
                self.take_sliding(Nanos(truth.t_ns), truth.finger_slip_m_s);
            }
        } else if id == self.control {
            if let Some(control) = ControlState::decode(record.body) {
                self.found.faults = control.faults.count_ones();
            }
        } else if let Some((image, fields)) = &self.image
            && record.signal == *image
            && self.from.is_some()
            && let Some(image) = TactileImage::from_record(fields, record.body)
        {
            self.take_image(&image);
        }
    }
}
