//! Detects encoders that do not count: the desired angle of a motor moves away, its torque pulls it
//! after by more than gravity and friction can take, and for 50 ms its encoder has not moved. A
//! motor that is held fast looks the same; a motor that is asked for nothing, or whose torque stays
//! below its friction, shows nothing at all, whatever its encoder does. A motor that presses
//! against something is asked for no motion.

use taktil_mechanics::spatial::JointVector;
use taktil_rtcore::{Fold, StateHash};

use crate::runaway::Load;

/// How long an encoder may stand still under such a torque (s).
const STANDSTILL_MAX_S: f64 = 0.05;
/// Motion that was asked for longer ago does not count (s): what presses against something stiff
/// creeps, and in the end is asked for as much.
const ASKED_WITHIN_S: f64 = 0.1;
/// Change of a reading that is no motion (counts): a disc between two lines flickers.
const FLICKER_COUNTS: i32 = 2;

/// Desired motion that counts, over the departure that does: a fingertip that is pressed against
/// something stiff is asked for less while it stands.
const ASKED_FACTOR: f64 = 2.5;

/// How long each encoder has stood still under torque.
#[derive(Clone, Copy, Debug)]
pub struct StuckEncoderDetector<const N: usize = 6> {
    place: [i32; N],
    /// Desired angles since when it stands (counts).
    desired: JointVector<N>,
    standing_s: [f64; N],
}

impl<const N: usize> Default for StuckEncoderDetector<N> {
    fn default() -> StuckEncoderDetector<N> {
        let desired = JointVector::zeros();
        StuckEncoderDetector { place: [0; N], desired, standing_s: [0.0; N] }
    }
}

impl<const N: usize> Fold for StuckEncoderDetector<N> {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.place).add(self.desired.as_slice()).add(&self.standing_s);
    }
}

impl<const N: usize> StuckEncoderDetector<N> {
    /// Forgets the past.
    pub fn reset(&mut self) {
        self.standing_s = [0.0; N];
    }

    /// Takes readings `after_s` after the last ones, under the torques that the motors had since
    /// (N m). `departure` is in counts measured minus desired. The first motor whose encoder is
    /// stuck is returned, 0 the first.
    pub fn update(
        &mut self,
        counts: &[i32; N],
        departure: &JointVector<N>,
        torque_nm: &JointVector<N>,
        load: &Load<N>,
        after_s: f64,
    ) -> Option<usize> {
        let mut found = None;
        for i in 0..N {
            let side = -departure[i].signum();
            let pulled = load.excess_nm(i, torque_nm[i], side) > 0.0;
            let moved = counts[i].wrapping_sub(self.place[i]);
            let still = (-FLICKER_COUNTS..=FLICKER_COUNTS).contains(&moved);
            let desired = f64::from(moved) - departure[i];
            let lasts = self.standing_s[i] > 0.0 && self.standing_s[i] < ASKED_WITHIN_S;
            if !(pulled && still && lasts) {
                self.place[i] = counts[i];
                self.desired[i] = -departure[i];
                self.standing_s[i] = if pulled { after_s } else { 0.0 };
                continue;
            }
            self.standing_s[i] += after_s;
            let asked = side * (desired - self.desired[i]);
            let is_asked = asked >= ASKED_FACTOR * load.departure_min()[i];
            if is_asked && self.standing_s[i] > STANDSTILL_MAX_S {
                found = found.or(Some(i));
            }
        }
        found
    }
}
