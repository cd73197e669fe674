//! Describes a rectangular array of square tactels.

use super::super::{Invalid, positive};
use super::pin::PlanarPose;

/// Most tactels of an array.
const TACTELS_MAX: usize = 1 << 20;

/// Tactels in rows (along y) and columns (along x), both ascending, centred on the origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Array {
    /// Number of rows.
    pub rows: usize,
    /// Number of columns.
    pub cols: usize,
    /// Side of a tactel and distance of neighbours, mm.
    pub pitch_mm: f64,
}

impl Array {
    /// The 16 by 16 tactels on one square inch of the thesis, pitch 25.4/16 mm.
    pub const THESIS: Self = Self { rows: 16, cols: 16, pitch_mm: 1.5875 };

    /// Checks the sizes.
    ///
    /// # Errors
    /// No row, no column, more than 2^20 tactels, or a pitch that is not finite and above zero.
    pub fn check(&self) -> Result<(), Invalid> {
        positive("pitch_mm", self.pitch_mm)?;
        let tactels = self.rows.saturating_mul(self.cols);
        if (1..=TACTELS_MAX).contains(&tactels) {
            return Ok(());
        }
        let what = format!("{} rows of {} tactels", self.rows, self.cols);
        Err(Invalid::new("rows", what, "give 1 to 2^20 tactels"))
    }

    /// Checks that an image belongs to this array.
    ///
    /// # Errors
    /// As [`Array::check`], and an image that does not have one value per tactel.
    pub(crate) fn check_image(&self, image: &[f64]) -> Result<(), Invalid> {
        self.check()?;
        if image.len() == self.len() {
            return Ok(());
        }
        let what = format!("{} values for {} tactels", image.len(), self.len());
        Err(Invalid::new("image", what, "give one value per tactel"))
    }

    /// Number of tactels.
    #[must_use]
    pub fn len(&self) -> usize {
        self.rows * self.cols
    }

    /// Whether there is no tactel.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// x of a column's centre, mm.
    #[must_use]
    pub fn x_mm(&self, column: usize) -> f64 {
        (column as f64 - 0.5 * (self.cols as f64 - 1.0)) * self.pitch_mm
    }

    /// y of a row's centre, mm.
    #[must_use]
    pub fn y_mm(&self, row: usize) -> f64 {
        (row as f64 - 0.5 * (self.rows as f64 - 1.0)) * self.pitch_mm
    }

    /// The two ends of the part of a line that lies over the array, in mm from the line's origin
    /// along its direction (-sin, cos); absent when the line does not cross the array.
    #[must_use]
    pub fn chord_mm(&self, pose: PlanarPose) -> Option<[f64; 2]> {
        let (s, c) = (libm::sin(pose.rot_rad), libm::cos(pose.rot_rad));
        let half = self.half_sides_mm();
        let mut chord = [f64::NEG_INFINITY, f64::INFINITY];
        for (place, direction, half) in [(pose.x_mm, -s, half[0]), (pose.y_mm, c, half[1])] {
            // A line parallel to this pair of sides lies between them or misses the array.
            if direction.abs() < 1e-12 {
                if place.abs() >= half {
                    return None;
                }
                continue;
            }
            let ends = [(-half - place) / direction, (half - place) / direction];
            chord[0] = chord[0].max(ends[0].min(ends[1]));
            chord[1] = chord[1].min(ends[0].max(ends[1]));
        }
        (chord[0] < chord[1]).then_some(chord)
    }

    /// Half the array along x and along y, mm.
    #[must_use]
    pub fn half_sides_mm(&self) -> [f64; 2] {
        [self.cols, self.rows].map(|n| 0.5 * n as f64 * self.pitch_mm)
    }

    /// Half the diagonal of the whole array, mm.
    #[must_use]
    pub fn half_diagonal_mm(&self) -> f64 {
        let (x, y) = (self.cols as f64 * self.pitch_mm, self.rows as f64 * self.pitch_mm);
        0.5 * (x * x + y * y).sqrt()
    }
}
