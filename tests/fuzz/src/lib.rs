//! Numbers from the bytes that a fuzzer makes: any finite ones, and those that mathematics finds
//! hard. All numbers are finite, because the targets promise something else for those that are not.

use glam::DVec3;
use nalgebra::SVector;
use taktil_mechanics::Pose;
use taktil_mechanics::spatial::{rotation_x, rotation_y, rotation_z};

/// Reads numbers until the bytes are used up; then zeros.
#[derive(Clone, Debug)]
pub struct Numbers<'a> {
    bytes: &'a [u8],
}

impl<'a> Numbers<'a> {
    /// From these bytes.
    #[must_use]
    pub fn new(bytes: &'a [u8]) -> Numbers<'a> {
        Numbers { bytes }
    }

    /// Whether there are any left.
    #[must_use]
    pub fn any(&self) -> bool {
        !self.bytes.is_empty()
    }

    /// The next byte.
    pub fn byte(&mut self) -> u8 {
        let (first, rest) = self.bytes.split_first().unwrap_or((&0, &[]));
        self.bytes = rest;
        *first
    }

    /// Any finite number up to `most` in size: near a multiple of a right angle, of ordinary size,
    /// or by its bits.
    pub fn number(&mut self, most: f64) -> f64 {
        let kind = self.byte();
        let mut word = [0; 8];
        let value = match kind % 4 {
            0 => f64::from(self.byte().cast_signed()) / 32.0,
            1 => {
                let turns = f64::from(self.byte().cast_signed() % 9);
                let off = f64::from(self.byte().cast_signed());
                // From 1e-18 to about 1 away.
                let small = 10f64.powi(-i32::from(self.byte() % 19));
                turns * core::f64::consts::FRAC_PI_2 + off / 128.0 * small
            }
            2 => f64::from(i32::from(self.byte()) << 8 | i32::from(self.byte())) / 10_000.0 - 3.2,
            _ => {
                word.fill_with(|| self.byte());
                f64::from_le_bytes(word)
            }
        };
        if value.is_finite() { value.clamp(-most, most) } else { 0.0 }
    }

    /// A vector of such numbers.
    pub fn vector<const N: usize>(&mut self, most: f64) -> SVector<f64, N> {
        SVector::from_fn(|_, _| self.number(most))
    }

    /// A pose: turned by three angles, anywhere.
    pub fn pose(&mut self, most: f64) -> Pose {
        let turned = rotation_z(self.number(10.0))
            * rotation_y(self.number(10.0))
            * rotation_x(self.number(10.0));
        let at = DVec3::new(self.number(most), self.number(most), self.number(most));
        Pose { rotation: turned, translation: at }
    }
}

/// Ends the run with the place when a number is not finite.
pub fn finite<'a>(place: &str, numbers: impl IntoIterator<Item = &'a f64>) {
    for (index, number) in numbers.into_iter().enumerate() {
        assert!(number.is_finite(), "{place}[{index}] is {number}");
    }
}

/// The same for a pose, whose rotation must be one.
pub fn rigid(place: &str, pose: &Pose) {
    finite(place, &pose.translation.to_array());
    let off = pose.rotation * pose.rotation.transpose() - glam::DMat3::IDENTITY;
    let worst = off.to_cols_array().into_iter().fold(0.0, |most: f64, x| most.max(x.abs()));
    assert!(worst < 1e-12, "{place} turns by no rotation: {worst}");
}
