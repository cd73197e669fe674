//! The task that reads the force/torque sensor at the wrist and publishes the wrench on the tool.
//! The wrench is measured from a baseline, which is taken from the first readings, while the finger
//! is free. After a failed read the task publishes nothing, so that readers see the last wrench as
//! held.
//!
//! Where a gauge stands at an end of its converter's range the wrench is unknown. It is published
//! all the same, as the least load that there is, but marked ([`WRENCH_OVER_RANGE`]), so that no
//! reader takes it for a wrench; such a reading is no part of the baseline.
//!
//! - In: no port; the sensor.
//! - Out: `wrench`.
//! - Rate: every job of its lane; the default machine runs it in the servo lane, 400 Hz.
//! - Source: the calibration matrix of the sensor's maker ([`law::Calibration`]).
//!
//! A sensor that does not answer, or that answers without a new reading for longer than the limit,
//! raises [`FaultCode::WristLost`]. One that is over range in three readings in a row raises
//! [`FaultCode::WristOverRange`], and the wrench is marked [`WRENCH_SATURATED`] from there on.

pub mod law;

use law::{Baseline, Calibration};
use serde::Deserialize;
use taktil_hal::{ErrorKind, FORCE_TORQUE_CHANNELS, ForceTorque};
use taktil_mechanics::Joints;
use taktil_mechanics::spatial::linear_and_angular;
use taktil_rtcore::{Cycle, FaultCode, Invalid, Io, Nanos, Output, Ports, StateHash, Task};
use taktil_signal::{WRENCH_OVER_RANGE, WRENCH_SATURATED, Wrench};

taktil_rtcore::explained! {
    /// `[wrist_scan]`. Every key has a default.
    #[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Config {
        /// Readings whose mean is the rest level; the finger must be free while they come. Default
        /// 80: 0.2 s at 400 Hz.
        pub baseline_readings: u32,
        /// Codes of each gauge (row) for each component of the wrench on the tool in tool axes (Fx,
        /// Fy, Fz per N, Mx, My, Mz per N m). Default: 20 and 1000 on the diagonal.
        pub codes_per_n_nm: [[f64; 6]; 6],
        /// Without a new reading for longer than this the sensor counts as lost (ms). Default 20.
        pub stale_ms: f64,
    }
}

impl Default for Config {
    fn default() -> Config {
        let one = |i: usize, j: usize| match (i == j, i < 3) {
            (false, _) => 0.0,
            (true, true) => 20.0,
            (true, false) => 1000.0,
        };
        Config {
            baseline_readings: 80,
            codes_per_n_nm: core::array::from_fn(|i| core::array::from_fn(|j| one(i, j))),
            stale_ms: 20.0,
        }
    }
}

/// Most readings of a baseline: 25 s at 400 Hz.
const READINGS_MAX: u32 = 10_000;
/// Readings in a row at an end of the range from which on it is no spike: a load that lasts.
const SATURATED_READINGS: u32 = 3;

impl Config {
    /// # Errors
    /// No readings or more than 10 000, a matrix that is not finite or cannot be inverted, a limit
    /// that is not positive and at most 10 s.
    pub fn check(&self) -> Result<Calibration, Invalid> {
        if self.baseline_readings == 0 || self.baseline_readings > READINGS_MAX {
            let what = format!("{} readings make no baseline", self.baseline_readings);
            return Err(Invalid::new("baseline_readings", what, "give 1 to 10000"));
        }
        if !(self.stale_ms > 0.0 && self.stale_ms <= 10_000.0) {
            let what = format!("{} ms is no limit", self.stale_ms);
            return Err(Invalid::new("stale_ms", what, "give more than 0 and at most 10000 ms"));
        }
        Calibration::new(&self.codes_per_n_nm)
    }
}

/// The task.
pub struct WristScan {
    wrench: Output<Wrench>,
    sensor: Box<dyn ForceTorque>,
    calibration: Calibration,
    readings: u32,
    baseline: Baseline,
    stale_after: Nanos,
    /// When the task was first called, and when the newest reading was taken.
    first: Option<Nanos>,
    newest: Option<Nanos>,
    /// Readings in a row, up to now, in which a gauge was over range; counted up to
    /// [`SATURATED_READINGS`].
    over_range: u32,
}

impl WristScan {
    /// Declares `wrench`.
    ///
    /// # Errors
    /// What [`Config::check`] refuses.
    #[expect(clippy::cast_possible_truncation, reason = "checked to be at most 10 s")]
    pub fn new(
        config: Config,
        sensor: Box<dyn ForceTorque>,
        ports: &mut Ports,
    ) -> Result<WristScan, Invalid> {
        let calibration = config.check()?;
        Ok(WristScan {
            wrench: ports.output("wrench"),
            sensor,
            calibration,
            readings: config.baseline_readings,
            baseline: Baseline::new(config.baseline_readings),
            stale_after: Nanos((config.stale_ms * 1e6).round() as i64),
            first: None,
            newest: None,
            over_range: 0,
        })
    }
}

impl Task for WristScan {
    fn start(&mut self) -> Result<(), FaultCode> {
        self.baseline = Baseline::new(self.readings);
        (self.first, self.newest, self.over_range) = (None, None, 0);
        Ok(())
    }

    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        let since = self.newest.unwrap_or(*self.first.get_or_insert(cycle.release));
        let late = || match cycle.release - since > self.stale_after {
            true => Err(FaultCode::WristLost),
            false => Ok(()),
        };
        let reading = match self.sensor.sample(cycle.release) {
            Ok(reading) => reading,
            Err(error) if error.kind == ErrorKind::Lost => return Err(FaultCode::WristLost),
            Err(_) => return late(),
        };
        if self.newest.is_some_and(|newest| reading.acquired <= newest) {
            return late();
        }
        self.newest = Some(reading.acquired);
        let within = reading.value.is_within_range();
        self.over_range = if within { 0 } else { SATURATED_READINGS.min(self.over_range + 1) };
        let is_saturated = self.over_range == SATURATED_READINGS;
        let codes: [i32; FORCE_TORQUE_CHANNELS] = reading.value.codes.map(|code| code.0);
        if within {
            self.baseline.add_reading(&codes);
        }
        let ready = self.baseline.is_ready();
        let above = Joints::from_fn(|i, _| f64::from(codes[i])) - self.baseline.codes();
        let wrench = if ready { self.calibration.wrench(&above) } else { Joints::zeros() };
        let (force, moment) = linear_and_angular(&wrench);
        let out = Wrench {
            acquired_ns: reading.acquired.0,
            force_n: force.to_array(),
            moment_nm: moment.to_array(),
            baseline_ready: match (ready, within) {
                (false, _) => 0,
                (true, true) => 1,
                (true, false) if is_saturated => WRENCH_SATURATED,
                (true, false) => WRENCH_OVER_RANGE,
            },
        };
        io.write(&self.wrench, out);
        if is_saturated { Err(FaultCode::WristOverRange) } else { Ok(()) }
    }

    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.baseline).add(&self.first).add(&self.newest);
        // A state that is there only while a gauge is over range.
        if self.over_range > 0 {
            hash.add(&self.over_range);
        }
    }
}
