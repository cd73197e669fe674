//! Readings of threads that do not know when the run began: they are stamped by the kernel's
//! monotonic clock, and a lane sees them on the run's own time.

use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};

use taktil_hal::{Arrival, Error, Nanos, TactileArray, TactileFrame};

/// When the run's time is 0, on the kernel's monotonic clock; shared by whoever starts the run and
/// the halves that need it. 0 before the run.
#[derive(Clone, Debug, Default)]
pub struct Epoch(Arc<AtomicI64>);

impl Epoch {
    /// The run begins at `origin` of the monotonic clock.
    pub fn set(&self, origin: Nanos) {
        self.0.store(origin.0, Ordering::Release);
    }

    fn get(&self) -> Nanos {
        Nanos(self.0.load(Ordering::Acquire))
    }
}

/// An array whose frames are stamped since boot.
pub(crate) struct EpochArray {
    pub(crate) half: Box<dyn TactileArray>,
    pub(crate) epoch: Epoch,
}

impl TactileArray for EpochArray {
    fn longest_wait(&self) -> Nanos {
        self.half.longest_wait()
    }

    fn rows(&self) -> usize {
        self.half.rows()
    }

    fn cols(&self) -> usize {
        self.half.cols()
    }

    fn full_scale(&self) -> u16 {
        self.half.full_scale()
    }

    fn sample(&mut self, release: Nanos, frame: &mut TactileFrame) -> Result<Arrival, Error> {
        let origin = self.epoch.get();
        let answer = self.half.sample(release + origin, frame);
        if answer == Ok(Arrival::New) {
            frame.acquired -= origin;
            for row in &mut frame.row_acquired {
                *row -= origin;
            }
        }
        answer
    }
}
