//! A tactile array with faults: frames that are lost, torn, repeated, late or garbled, tactels that
//! are dead or hot, and a device that does not answer.

use taktil_hal::fault::FaultKind;
use taktil_hal::{Arrival, Error, ErrorKind, Nanos, TactileArray, TactileFrame};

use crate::analog::input_failure;
use crate::target_faults::TargetFaults;

/// The kinds that can befall a tactile array.
pub const TACTILE_KINDS: [FaultKind; 12] = [
    FaultKind::Loss,
    FaultKind::Duplication,
    FaultKind::Delay,
    FaultKind::Corruption,
    FaultKind::Truncation,
    FaultKind::Torn,
    FaultKind::Frozen,
    FaultKind::Dead,
    FaultKind::Hot,
    FaultKind::Failing,
    FaultKind::Silence,
    FaultKind::Unplugged,
];

const DEVICE: &str = "fault.tactile";
/// Bits of a tactel's count of which one is inverted.
const CORRUPTED_BITS: usize = 16;

/// A tactile array behind faults.
pub(crate) struct FaultyTactileArray {
    half: Box<dyn TactileArray>,
    faults: TargetFaults,
    /// The newest scan of the device.
    scan: TactileFrame,
    /// The frame that was handed out last, and whether there was one.
    shown: TactileFrame,
    has_shown: bool,
    /// When the scan becomes due that a delay holds back.
    due: Option<Nanos>,
    asked: Option<Nanos>,
    repeats: bool,
}

impl FaultyTactileArray {
    pub(crate) fn new(half: Box<dyn TactileArray>, faults: TargetFaults) -> FaultyTactileArray {
        let (scan, shown) = (TactileFrame::of(half.as_ref()), TactileFrame::of(half.as_ref()));
        FaultyTactileArray {
            half,
            faults,
            scan,
            shown,
            has_shown: false,
            due: None,
            asked: None,
            repeats: false,
        }
    }

    /// Whether a scan is there that is to be handed out at `release`.
    fn arrival(&mut self, release: Nanos) -> Result<bool, Error> {
        let arrival = self.half.sample(release, &mut self.scan);
        if self.faults.is_active(FaultKind::Unplugged, release) {
            return Err(Error::whole(ErrorKind::Lost, DEVICE));
        }
        // A device without a word holds its last frame for ever.
        if self.faults.is_active(FaultKind::Silence, release) {
            return Ok(false);
        }
        input_failure(&mut self.faults, release, DEVICE)?;
        let fresh = arrival? == Arrival::New;
        if fresh && self.faults.happens(FaultKind::Loss, release) {
            return Ok(false);
        }
        if fresh && self.faults.happens(FaultKind::Truncation, release) {
            return Err(Error::whole(ErrorKind::Transient, DEVICE));
        }
        match self.faults.strength(FaultKind::Delay, 0, release) {
            Some(delay_s) if fresh => {
                self.due = Some(Nanos(release.0.saturating_add((delay_s * 1e9) as i64)));
                Ok(false)
            }
            _ if fresh => {
                self.due = None;
                Ok(true)
            }
            _ => Ok(self.due.take_if(|due| *due <= release).is_some()),
        }
    }

    /// Spoils the scan that is to be handed out.
    fn spoil(&mut self, release: Nanos) -> Result<(), Error> {
        let (cols, full) = (usize::from(self.scan.cols()), self.half.full_scale());
        if self.has_shown && self.faults.happens(FaultKind::Torn, release) {
            let half = self.scan.tactels() / 2 / cols.max(1) * cols;
            self.scan.values[half..].copy_from_slice(&self.shown.values[half..]);
        }
        for (channel, value) in self.scan.values.iter_mut().enumerate() {
            if self.faults.has(FaultKind::Frozen, channel, release) {
                *value = if self.has_shown { self.shown.values[channel] } else { 0 };
            }
            if self.faults.has(FaultKind::Dead, channel, release) {
                *value = 0;
            }
            if self.faults.has(FaultKind::Hot, channel, release) {
                *value = full;
            }
        }
        if self.faults.happens(FaultKind::Corruption, release) {
            let (tactel, bit) =
                (self.faults.below(self.scan.tactels()), self.faults.below(CORRUPTED_BITS));
            let spoilt = self.scan.values[tactel] ^ (1 << bit);
            // A driver that sees a count which cannot be does not hand the frame out.
            if spoilt > full {
                return Err(Error::on_channel(ErrorKind::OutOfRange, DEVICE, tactel as u16));
            }
            self.scan.values[tactel] = spoilt;
        }
        Ok(())
    }
}

/// Copies one frame over another of the same size; allocates nothing.
fn copy_frame(from: &TactileFrame, to: &mut TactileFrame) {
    to.sequence = from.sequence;
    to.acquired = from.acquired;
    to.values.copy_from_slice(&from.values);
    to.valid.copy_from_slice(&from.valid);
    to.row_acquired.copy_from_slice(&from.row_acquired);
}

impl TactileArray for FaultyTactileArray {
    fn rows(&self) -> usize {
        self.half.rows()
    }

    fn cols(&self) -> usize {
        self.half.cols()
    }

    fn full_scale(&self) -> u16 {
        self.half.full_scale()
    }

    fn longest_wait(&self) -> Nanos {
        self.half.longest_wait()
    }

    fn sample(&mut self, release: Nanos, frame: &mut TactileFrame) -> Result<Arrival, Error> {
        if !frame.fits(self) {
            return Err(Error::whole(ErrorKind::OutOfRange, DEVICE));
        }
        if self.asked.replace(release) == Some(release) {
            return Ok(Arrival::Held);
        }
        if self.arrival(release)? {
            self.spoil(release)?;
            copy_frame(&self.scan, &mut self.shown);
            copy_frame(&self.scan, frame);
            self.has_shown = true;
            self.repeats = self.faults.happens(FaultKind::Duplication, release);
            return Ok(Arrival::New);
        }
        if core::mem::take(&mut self.repeats) {
            copy_frame(&self.shown, frame);
            return Ok(Arrival::New);
        }
        Ok(Arrival::Held)
    }
}
