//! The task that reads the tactile array and publishes images: counts above a baseline, in
//! proportion to the load where the response of the array was calibrated ([`response`]), the
//! validity of every tactel and the time of every row. The baseline is taken from the first frames,
//! while the finger is free. Each frame is published once: without a new frame the task writes
//! nothing, so that a reader sees the last image as held.
//!
//! - In: no port; the tactile array.
//! - Out: `image`, `baseline`.
//! - Rate: every job of the touch lane, 200 Hz.
//! - Source: S. Yaniger, "Force sensing resistors", Electro 1991, for the response.
//!
//! Faults: damaged frames are dropped ([`FaultCode::TactileGarbled`]). Without a new frame for
//! longer than the limit, or when the device says so, every job raises [`FaultCode::TactileStale`]
//! until a frame arrives. A device that is gone, or more than half of whose tactels are not valid,
//! raises [`FaultCode::TactileLost`], because a finger without a working sensor must not press.

pub mod config;
pub mod free_finger;
pub mod law;
pub mod response;

pub use config::Config;

use law::{Baseline, SaturationLimits};
pub use response::Response;
use taktil_hal::{Arrival, ErrorKind, MAX_ROWS, TactileArray, TactileFrame};
use taktil_rtcore::{Cycle, FaultCode, Invalid, Io, Nanos, Output, Ports, StateHash, Task};
use taktil_signal::{TactileBaseline, TactileImage};

/// The task.
pub struct TactileScan {
    image: Output<TactileImage>,
    told: Output<TactileBaseline>,
    array: Box<dyn TactileArray>,
    frame: TactileFrame,
    /// What the ports carry, filled in place.
    next_image: TactileImage,
    next_told: TactileBaseline,
    baseline: Baseline,
    stale_after: Nanos,
    /// When the newest frame was acquired; before the first one, when the task was first called.
    newest: Option<Nanos>,
    /// Instant of the last frame (ns) of a baseline that is known but not published yet.
    due: Option<i64>,
}

impl TactileScan {
    /// Declares `image` and `baseline`.
    ///
    /// # Errors
    /// What [`Config::check`] and [`Config::dead_mask`] refuse, and an array without tactels.
    pub fn new(
        config: Config,
        array: Box<dyn TactileArray>,
        ports: &mut Ports,
    ) -> Result<TactileScan, Invalid> {
        config.check()?;
        let (rows, cols) = (array.rows(), array.cols());
        let frame = TactileFrame::new(rows, cols);
        if frame.tactels() == 0 || frame.tactels() != rows * cols {
            return Err(Invalid::new(
                "",
                format!("the tactile array says it has {rows} x {cols} tactels"),
                format!("choose a device with 1 to {MAX_ROWS} rows and columns"),
            ));
        }
        let next_image = TactileImage::new(frame.rows(), frame.cols());
        let next_told = TactileBaseline::new(frame.tactels());
        let rails = SaturationLimits {
            low_counts: config.rest_min_counts,
            high_counts: config.rest_max_ratio * f64::from(array.full_scale()),
        };
        if let Some(response) = &config.response {
            response.check(array.full_scale()).map_err(|bad| bad.within("response"))?;
        }
        let dead = config.dead_mask(rows, cols)?;
        let frames = config.baseline_frames..=config.baseline_frames_max;
        let baseline =
            Baseline::new(frames, dead, rails).linearised(config.response, array.full_scale());
        Ok(TactileScan {
            image: ports.array_output("image", &next_image),
            told: ports.array_output("baseline", &next_told),
            array,
            frame,
            next_image,
            next_told,
            baseline,
            stale_after: config.stale_after(),
            newest: None,
            due: None,
        })
    }

    fn read_frame(&mut self, io: &mut Io<'_>) -> Result<(), FaultCode> {
        self.newest = Some(self.frame.acquired);
        match self.due {
            // The baseline is published one job after the one that closed it, because both in one
            // job would be the longest job by far.
            Some(acquired_ns) if self.baseline.is_ready() => {
                self.baseline.report(acquired_ns, &mut self.next_told);
                io.write_array(&self.told, &self.next_told);
                self.due = None;
            }
            _ => {}
        }
        if !self.baseline.is_closed() {
            let before = self.baseline.is_ready();
            self.baseline.add_frame(&self.frame);
            // The baseline is published when it can be used, and once more when it is final.
            if self.baseline.is_closed() || self.baseline.is_ready() != before {
                self.due = Some(self.frame.acquired.0);
            }
        }
        self.baseline.image(&self.frame, &mut self.next_image);
        io.write_array(&self.image, &self.next_image);
        let tactels = self.frame.tactels();
        if self.baseline.is_ready() && 2 * self.baseline.trusted() < tactels {
            return Err(FaultCode::TactileLost);
        }
        Ok(())
    }
}

impl Task for TactileScan {
    fn start(&mut self) -> Result<(), FaultCode> {
        self.baseline.rearm();
        (self.newest, self.due) = (None, None);
        Ok(())
    }

    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        let newest = *self.newest.get_or_insert(cycle.release);
        let outcome = match self.array.sample(cycle.release, &mut self.frame) {
            Ok(Arrival::New) => return self.read_frame(io),
            Ok(Arrival::Held) => Ok(()),
            Err(error) => Err(match error.kind {
                ErrorKind::Transient | ErrorKind::OutOfRange => FaultCode::TactileGarbled,
                ErrorKind::Stale => FaultCode::TactileStale,
                ErrorKind::Lost => FaultCode::TactileLost,
            }),
        };
        let stale = cycle.release - newest > self.stale_after;
        if stale && outcome != Err(FaultCode::TactileLost) {
            return Err(FaultCode::TactileStale);
        }
        outcome
    }

    fn fold(&self, hash: &mut StateHash) {
        // The frame is read only in the job that filled it.
        hash.add(&self.baseline).add(&self.newest).add(&self.due);
    }
}
