//! Rows, columns and pitches of a tactile array, and the rectangular pad that its tactels cover:
//! columns count along the sensor's x, rows along its y, and the pad's middle is the sensor's
//! origin.

use glam::DVec2;

/// The sizes of an array.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArrayGeometry {
    /// Number of rows, along the sensor's y.
    pub rows: usize,
    /// Number of columns, along the sensor's x.
    pub cols: usize,
    /// Distance of neighbouring columns (m).
    pub pitch_x_m: f64,
    /// Distance of neighbouring rows (m).
    pub pitch_y_m: f64,
}

impl ArrayGeometry {
    /// 16 rows and columns on one square inch.
    pub const THESIS: ArrayGeometry =
        ArrayGeometry { rows: 16, cols: 16, pitch_x_m: 1.5875e-3, pitch_y_m: 1.5875e-3 };

    /// Number of tactels.
    #[must_use]
    pub fn tactels(&self) -> usize {
        self.rows * self.cols
    }

    /// Half the pad along x (m).
    #[must_use]
    pub fn half_x_m(&self) -> f64 {
        0.5 * self.cols as f64 * self.pitch_x_m
    }

    /// Half the pad along y (m).
    #[must_use]
    pub fn half_y_m(&self) -> f64 {
        0.5 * self.rows as f64 * self.pitch_y_m
    }

    /// Half the pad along x and along y (m).
    pub(crate) fn half_sides_m(&self) -> DVec2 {
        DVec2::new(self.half_x_m(), self.half_y_m())
    }

    /// Half the pad's diagonal (m).
    #[must_use]
    pub fn half_diagonal_m(&self) -> f64 {
        self.half_sides_m().length()
    }

    /// Area of a tactel (mm^2).
    #[must_use]
    pub fn tactel_mm2(&self) -> f64 {
        1e6 * self.pitch_x_m * self.pitch_y_m
    }

    /// Centre of a column, from the middle of the pad (m).
    #[must_use]
    pub fn column_m(&self, index: usize) -> f64 {
        (index as f64 - 0.5 * (self.cols as f64 - 1.0)) * self.pitch_x_m
    }

    /// Centre of a row, from the middle of the pad (m).
    #[must_use]
    pub fn row_m(&self, index: usize) -> f64 {
        (index as f64 - 0.5 * (self.rows as f64 - 1.0)) * self.pitch_y_m
    }

    /// A place along x (m from the middle of the pad) in numbers of columns, from 1.
    #[must_use]
    pub fn column_number(&self, x_m: f64) -> f64 {
        x_m / self.pitch_x_m + 0.5 * (self.cols + 1) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_of_the_pad_lies_between_its_first_and_last_tactels() {
        for (rows, cols) in [(1, 1), (1, 64), (12, 32), (16, 16), (64, 64)] {
            let array = ArrayGeometry { rows, cols, pitch_x_m: 2e-3, pitch_y_m: 5e-3 };
            assert!((array.column_m(0) + array.column_m(cols - 1)).abs() < 1e-15);
            assert!((array.row_m(0) + array.row_m(rows - 1)).abs() < 1e-15);
            assert!((array.column_m(0) + array.half_x_m() - 1e-3).abs() < 1e-15);
            assert!((array.row_m(0) + array.half_y_m() - 2.5e-3).abs() < 1e-15);
            let last = array.column_number(array.column_m(cols - 1));
            assert!((last - cols as f64).abs() < 1e-12, "{last}");
        }
        assert_eq!(ArrayGeometry::THESIS.tactels(), 256);
    }
}
