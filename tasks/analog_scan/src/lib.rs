//! The task that reads the A/D converters and publishes their codes, and the values that they stand
//! for, so that tasks and logs see them. After a failed read the task publishes nothing, so that
//! readers see the last values as held.
//!
//! - In: no port; the A/D board.
//! - Out: `values`.
//! - Rate: every job of its lane.
//! - Source: value = scale x (code - zero), the calibration of a linear transducer.
//!
//! A board that does not answer, or that answers without a new reading for longer than the limit,
//! raises [`FaultCode::AnalogLost`].

use serde::Deserialize;
use taktil_hal::{AnalogIn, ErrorKind};
use taktil_rtcore::{Cycle, FaultCode, Invalid, Io, Nanos, Output, Ports, StateHash, Task};
use taktil_signal::AnalogInputs;

taktil_rtcore::explained! {
    /// `[analog_scan]`. Lists have one number for each channel of the board.
    #[derive(Clone, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Config {
        /// What one code stands for, in the unit of the channel. Default 1: the codes themselves.
        pub scale_per_code: Option<Vec<f64>>,
        /// Code at which the value is 0. Default 0.
        pub zero_codes: Option<Vec<f64>>,
        /// Without a new reading for longer than this the board counts as lost (ms). Default 20.
        pub stale_ms: f64,
    }
}

impl Default for Config {
    fn default() -> Config {
        Config { scale_per_code: None, zero_codes: None, stale_ms: 20.0 }
    }
}

/// Largest scale and zero of a channel.
const VALUE_MAX: f64 = 1e12;

impl Config {
    fn list(
        place: &str,
        given: Option<&Vec<f64>>,
        channels: usize,
        usual: f64,
    ) -> Result<Box<[f64]>, Invalid> {
        let list = given.cloned().unwrap_or_else(|| vec![usual; channels]);
        if list.len() != channels {
            let what = format!("{} numbers for a board of {channels} channels", list.len());
            return Err(Invalid::new(place, what, format!("give {channels}")));
        }
        if let Some(i) = list.iter().position(|x| !(-VALUE_MAX..=VALUE_MAX).contains(x)) {
            let what = format!("{} is out of range", list[i]);
            return Err(Invalid::new(format!("{place}[{i}]"), what, "give a finite number"));
        }
        Ok(list.into())
    }
}

/// The task.
pub struct AnalogScan {
    values: Output<AnalogInputs>,
    board: Box<dyn AnalogIn>,
    scale: Box<[f64]>,
    zero: Box<[f64]>,
    stale_after: Nanos,
    /// What the port carries, filled in place.
    next: AnalogInputs,
    /// When the task was first called, and when the newest reading was taken.
    first: Option<Nanos>,
    newest: Option<Nanos>,
}

impl AnalogScan {
    /// Declares `values`, with one element for each channel of the board.
    ///
    /// # Errors
    /// A list of another length than the board has channels, a number that is not finite, a limit
    /// that is not positive and at most 10 s.
    #[expect(clippy::cast_possible_truncation, reason = "checked to be at most 10 s")]
    pub fn new(
        config: &Config,
        board: Box<dyn AnalogIn>,
        ports: &mut Ports,
    ) -> Result<AnalogScan, Invalid> {
        let channels = board.channels();
        let scale = Config::list("scale_per_code", config.scale_per_code.as_ref(), channels, 1.0)?;
        let zero = Config::list("zero_codes", config.zero_codes.as_ref(), channels, 0.0)?;
        if !(config.stale_ms > 0.0 && config.stale_ms <= 10_000.0) {
            let what = format!("{} ms is no limit", config.stale_ms);
            return Err(Invalid::new("stale_ms", what, "give more than 0 and at most 10000 ms"));
        }
        let next = AnalogInputs::new(channels);
        Ok(AnalogScan {
            values: ports.array_output("values", &next),
            board,
            scale,
            zero,
            stale_after: Nanos((config.stale_ms * 1e6).round() as i64),
            next,
            first: None,
            newest: None,
        })
    }
}

impl Task for AnalogScan {
    fn start(&mut self) -> Result<(), FaultCode> {
        (self.first, self.newest) = (None, None);
        Ok(())
    }

    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        let since = self.newest.unwrap_or(*self.first.get_or_insert(cycle.release));
        let late = || match cycle.release - since > self.stale_after {
            true => Err(FaultCode::AnalogLost),
            false => Ok(()),
        };
        let reading = match self.board.sample(cycle.release) {
            Ok(reading) => reading,
            Err(error) if error.kind == ErrorKind::Lost => return Err(FaultCode::AnalogLost),
            Err(_) => return late(),
        };
        if self.newest.is_some_and(|newest| reading.acquired <= newest) {
            return late();
        }
        self.newest = Some(reading.acquired);
        self.next.acquired_ns = reading.acquired.0;
        for (i, code) in reading.value.iter().enumerate().take(self.scale.len()) {
            self.next.codes[i] = code.0;
            self.next.values[i] = self.scale[i] * (f64::from(code.0) - self.zero[i]);
        }
        io.write_array(&self.values, &self.next);
        Ok(())
    }

    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.first).add(&self.newest);
    }
}
