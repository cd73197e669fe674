//! The index pulses of the encoder discs: one in each turn of each motor, latched by the simulated
//! board with its count. A pulse is latched only once the disc has turned past it.

use taktil_hal::{CHANNELS, Counts, IndexPulses};

use crate::hash::Hash;
use crate::manipulator::JOINTS_MAX;
use crate::scene::{Invalid, invalid};

/// Where the index pulses of an encoder's disc come, in counts of that encoder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct IndexPulsePlaces {
    /// The place of one of them.
    pub first: Counts,
    /// From one to the next (counts).
    pub turn_counts: i32,
}

/// Places of the pulses of each channel, and the pulses that were latched.
#[derive(Clone, Copy, Debug)]
pub(crate) struct IndexPulseModel {
    joints: usize,
    pulses: [IndexPulsePlaces; CHANNELS],
    /// Whole turns past that pulse, rounded down, at the latest counts.
    turns: [i32; CHANNELS],
    marks: IndexPulses,
}

impl IndexPulseModel {
    /// Discs whose pulses come `before` counts before the counts of the home pose.
    pub(crate) fn new(
        before: &[f64],
        home: &[i32],
        per_rev: &[f64],
    ) -> Result<IndexPulseModel, Invalid> {
        if before.len() != home.len() {
            let what = format!("has {} numbers, the arm has {} joints", before.len(), home.len());
            return Err(invalid("arm.index_counts", what, "give one for each joint"));
        }
        let mut pulses = [IndexPulsePlaces { first: Counts(0), turn_counts: 1 }; CHANNELS];
        for (i, pulse) in pulses.iter_mut().enumerate().take(home.len().min(CHANNELS)) {
            // The ranges were checked, so that both numbers fit.
            let (before, turn) = (before[i].round() as i32, per_rev[i].round() as i32);
            *pulse = IndexPulsePlaces {
                first: Counts(home[i].wrapping_sub(before)),
                turn_counts: turn.max(1),
            };
        }
        let mut index = IndexPulseModel {
            joints: home.len(),
            pulses,
            turns: [0; CHANNELS],
            marks: [None; CHANNELS],
        };
        for i in 0..CHANNELS {
            index.turns[i] = index.turns_past(i, 0);
        }
        Ok(index)
    }

    /// Where the pulses come, one element a joint.
    pub(crate) fn places(&self) -> Vec<IndexPulsePlaces> {
        self.pulses[..self.joints.min(CHANNELS)].to_vec()
    }

    fn turns_past(&self, i: usize, count: i32) -> i32 {
        let IndexPulsePlaces { first, turn_counts } = self.pulses[i];
        count.wrapping_sub(first.0).div_euclid(turn_counts)
    }

    /// Turns the discs to these counts and returns the newest pulses since power-up.
    pub(crate) fn update(&mut self, counts: &[Counts; CHANNELS]) -> IndexPulses {
        for (i, Counts(count)) in counts.iter().enumerate().take(self.joints) {
            let (before, now) = (self.turns[i], self.turns_past(i, *count));
            if now != before {
                // Upwards the last pulse passed is the one below the count, downwards the one above
                // it.
                let IndexPulsePlaces { first, turn_counts } = self.pulses[i];
                let newest = if now > before { now } else { now + 1 };
                self.marks[i] =
                    Some(Counts(first.0.wrapping_add(newest.wrapping_mul(turn_counts))));
                self.turns[i] = now;
            }
        }
        self.marks
    }

    pub(crate) fn index_pulses(&self) -> IndexPulses {
        self.marks
    }

    pub(crate) fn digest(&self, hash: &mut Hash) {
        for (mark, turns) in self.marks.iter().zip(self.turns).take(JOINTS_MAX) {
            hash.word(u64::from(turns.cast_unsigned()));
            hash.word(mark.map_or(u64::MAX, |Counts(count)| u64::from(count.cast_unsigned())));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn turned(index: &mut IndexPulseModel, count: i32) -> Option<i32> {
        index.update(&[Counts(count); CHANNELS])[0].map(|Counts(count)| count)
    }

    #[test]
    fn a_pulse_is_latched_when_it_is_passed_and_kept() {
        // Home at count 30, the pulse 10 before it: pulses at ..., -80, 20, 120, ...
        let mut index = IndexPulseModel::new(&[10.0], &[30], &[100.0]).unwrap();
        assert_eq!(turned(&mut index, 19), None);
        assert_eq!(turned(&mut index, 20), Some(20));
        assert_eq!(turned(&mut index, 119), Some(20));
        assert_eq!(turned(&mut index, 10), Some(20), "downwards past the same pulse");
        assert_eq!(turned(&mut index, -81), Some(-80));
        assert_eq!(turned(&mut index, 330), Some(320), "several in one look: the newest");
        assert_eq!(index.index_pulses()[1], None, "a channel that is not wired has none");
    }

    #[test]
    fn one_number_for_each_joint() {
        let bad = IndexPulseModel::new(&[0.0; 6], &[0; 7], &[100.0; 7]).unwrap_err();
        assert_eq!(bad.place, "arm.index_counts");
    }
}
