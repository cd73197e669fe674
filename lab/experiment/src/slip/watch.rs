//! Observes a run for what slid and when it was noticed.

use taktil_lab_world::{ObjectTruth, WorldTruth};
use taktil_rtcore::record::{Catalog, Observer, Record};
use taktil_rtcore::{Nanos, Payload};
use taktil_signal::{ControlState, Slip, slip};

use super::DELAY_MAX_S;

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
    /// Standard deviation of the place along the slip in one frame at the best (mm).
    pub(crate) place_bound_mm: Option<f64>,
    /// Sum of the squares of how far the body had gone in each image that was known within the
    /// time that is required (mm^2).
    pub(crate) squares_mm2: f64,
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
    /// When the body begins to move; none where nothing is to slide.
    from: Option<Nanos>,
    sliding_from: Option<Nanos>,
    slid_at: Option<Nanos>,
    /// True speed of slip (mm/s), its instant, and how far the body has gone since it slides (mm).
    slip_mm_s: f64,
    truth_at: Nanos,
    slid_mm: f64,
    before: Slip,
    found: SlipFindings,
}

impl SlipWatch {
    pub(crate) fn new(catalog: &Catalog, from: Option<Nanos>) -> SlipWatch {
        SlipWatch {
            slip: catalog.find("tactile_servo.slip"),
            object: catalog.find("world.object"),
            truth: catalog.find("world.truth"),
            control: catalog.find("supervisor.control"),
            from,
            sliding_from: None,
            slid_at: None,
            slip_mm_s: 0.0,
            truth_at: Nanos::ZERO,
            slid_mm: 0.0,
            before: Slip::ZERO,
            found: SlipFindings::default(),
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
        self.add_square(at, slip);
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

    /// Adds what a new image can show of the slip to what is known within the required time.
    fn add_square(&mut self, at: Nanos, slip: &Slip) {
        let Some(from) = self.sliding_from else { return };
        let is_new = slip.acquired_ns != self.before.acquired_ns;
        if is_new && (at - from).as_secs_f64() <= DELAY_MAX_S {
            // The truth is of another instant than the image.
            let since_s = (Nanos(slip.acquired_ns) - self.truth_at).as_secs_f64();
            let gone_mm = (self.slid_mm + self.slip_mm_s * since_s).max(0.0);
            self.found.squares_mm2 += gone_mm * gone_mm;
        }
    }

    fn take_sliding(&mut self, t: Nanos, speed_m_s: f64) {
        if self.sliding_from.is_some() {
            self.slid_mm += self.slip_mm_s * (t - self.truth_at).as_secs_f64();
        }
        (self.slip_mm_s, self.truth_at) = (1e3 * speed_m_s, t);
        if speed_m_s > SLIP_MIN_M_S {
            self.slid_at = Some(t);
            if self.from.is_some_and(|from| t >= from) {
                self.sliding_from.get_or_insert(t);
            }
        }
    }

    pub(crate) fn findings(self) -> SlipFindings {
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
        } else if id == self.control
            && let Some(control) = ControlState::decode(record.body)
        {
            self.found.faults = control.faults.count_ones();
        }
    }
}
