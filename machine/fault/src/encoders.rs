//! Encoders with faults: counters that stop, jump, count backwards, lose counts or start anew, and
//! a board that does not answer.

use taktil_hal::fault::FaultKind;
use taktil_hal::{CHANNELS, Counts, Encoders, Error, ErrorKind, IndexPulses, Nanos, Reading};

use crate::target_faults::{Answer, TargetFaults};

/// The kinds that can befall encoders.
pub const ENCODER_KINDS: [FaultKind; 11] = [
    FaultKind::Jump,
    FaultKind::Frozen,
    FaultKind::Inversion,
    FaultKind::LostCounts,
    FaultKind::Dead,
    FaultKind::Torn,
    FaultKind::Corruption,
    FaultKind::Failing,
    FaultKind::Silence,
    FaultKind::Unplugged,
    FaultKind::Restart,
];

/// Bits of a count of which one is inverted: those of a 16-bit counter.
const CORRUPTED_BITS: usize = 16;
/// Bits of a torn count that are new.
const TORN_MASK: i32 = 0xff;
const DEVICE: &str = "fault.encoders";

/// A bank of encoders behind faults.
pub(crate) struct FaultyEncoders {
    half: Box<dyn Encoders>,
    faults: TargetFaults,
    answered: Option<(Nanos, Answer<[Counts; CHANNELS]>)>,
    /// Counts of the board at the reading before.
    read: Option<[i32; CHANNELS]>,
    /// Counts that were handed out last.
    shown: [i32; CHANNELS],
    /// What the faults so far took from each count.
    lost: [f64; CHANNELS],
    /// Begin of the restart that was carried out last.
    restarted: Option<Nanos>,
}

impl FaultyEncoders {
    pub(crate) fn new(half: Box<dyn Encoders>, faults: TargetFaults) -> FaultyEncoders {
        FaultyEncoders {
            half,
            faults,
            answered: None,
            read: None,
            shown: [0; CHANNELS],
            lost: [0.0; CHANNELS],
            restarted: None,
        }
    }

    fn answer(&mut self, release: Nanos) -> Result<Reading<[Counts; CHANNELS]>, Error> {
        let reading = self.half.sample(release);
        if self.faults.is_active(FaultKind::Unplugged, release) {
            return Err(Error::whole(ErrorKind::Lost, DEVICE));
        }
        if self.faults.is_active(FaultKind::Silence, release) {
            return Err(Error::whole(ErrorKind::Stale, DEVICE));
        }
        if self.faults.happens(FaultKind::Failing, release) {
            return Err(Error::whole(ErrorKind::Transient, DEVICE));
        }
        let mut reading = reading?;
        let board = reading.value.map(|count| count.0);
        let before = self.read.replace(board).unwrap_or(board);
        let restart = self.faults.newest_begin(FaultKind::Restart, release);
        if restart != self.restarted {
            self.restarted = restart;
            self.lost = board.map(f64::from);
        }
        let torn = self.faults.happens(FaultKind::Torn, release);
        let corrupted = self.faults.happens(FaultKind::Corruption, release);
        let bit = if corrupted { self.faults.below(CORRUPTED_BITS) } else { 0 };
        for channel in 0..self.half.joints().min(CHANNELS) {
            let moved = f64::from(board[channel].wrapping_sub(before[channel]));
            let mut count = self.count(channel, board[channel], moved, release);
            let shown = self.shown[channel];
            if torn {
                count = (shown & !TORN_MASK) | (count & TORN_MASK);
            }
            if corrupted {
                count ^= 1 << bit;
            }
            self.shown[channel] = count;
            reading.value[channel] = Counts(count);
        }
        Ok(reading)
    }

    /// The count of one channel, which moved by so many counts since the reading before.
    fn count(&mut self, channel: usize, board: i32, moved: f64, now: Nanos) -> i32 {
        if self.faults.has(FaultKind::Inversion, channel, now) {
            self.lost[channel] += 2.0 * moved;
        } else if let Some(part) = self.faults.strength(FaultKind::LostCounts, channel, now) {
            self.lost[channel] += part * moved;
        }
        if self.faults.has(FaultKind::Dead, channel, now) {
            return 0;
        }
        if self.faults.has(FaultKind::Frozen, channel, now) {
            return self.shown[channel];
        }
        let jump = self.faults.strength(FaultKind::Jump, channel, now).unwrap_or(0.0);
        board.wrapping_sub(self.lost[channel] as i32).wrapping_add(jump as i32)
    }
}

impl Encoders for FaultyEncoders {
    fn joints(&self) -> usize {
        self.half.joints()
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<[Counts; CHANNELS]>, Error> {
        if let Some((_, answer)) = self.answered.filter(|(at, _)| *at == release) {
            return answer;
        }
        let answer = self.answer(release);
        self.answered = Some((release, answer));
        answer
    }

    fn longest_wait(&self) -> Nanos {
        self.half.longest_wait()
    }

    fn has_index(&self) -> bool {
        self.half.has_index()
    }

    fn index_pulses(&self) -> IndexPulses {
        self.half.index_pulses()
    }

    fn index_pulse_reach(&self) -> i32 {
        self.half.index_pulse_reach()
    }
}
