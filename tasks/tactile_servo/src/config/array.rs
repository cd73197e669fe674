//! `[tactile_servo.array]`: the array whose images the servo goes by. A device says how many rows
//! and columns it has, but not how far apart they are.

use serde::Deserialize;
use taktil_rtcore::Invalid;
use taktil_signal::TactileImage;

/// Most rows and most columns.
pub const ROWS_MAX: usize = 64;
/// Half the width of the band about a line of load (mm) and the fewest columns that it is: a layer
/// of about a millimetre spreads a pin's load so far.
const BAND_HALF_MM: f64 = 3.96875;
const BAND_HALF_COLUMNS_MIN: f64 = 2.5;
/// Fewest columns: the contact is rolled to and fro between two of them, inside the array.
const COLS_MIN: u32 = 4;

taktil_rtcore::explained! {
    /// `[tactile_servo.array]`: rows, columns and pitches of an array. An image of another size is
    /// not trusted.
    #[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Array {
        /// Number of rows, 1 to 64, along the sensor's y. Default 16.
        pub rows: u32,
        /// Number of columns, 4 to 64, along the sensor's x. Default 16.
        pub cols: u32,
        /// Distance of neighbouring columns (mm). Default 1.5875.
        pub pitch_x_mm: f64,
        /// Distance of neighbouring rows (mm). Default 1.5875.
        pub pitch_y_mm: f64,
    }
}

impl Default for Array {
    fn default() -> Array {
        Array { rows: 16, cols: 16, pitch_x_mm: 1.5875, pitch_y_mm: 1.5875 }
    }
}

impl Array {
    /// # Errors
    /// A value outside the range that its message states; NaN is outside every range.
    pub fn check(&self) -> Result<(), Invalid> {
        let most = ROWS_MAX as u32;
        if !(1..=most).contains(&self.rows) {
            let what = format!("is {}", self.rows);
            return Err(Invalid::new("rows", what, format!("give 1 to {most}")));
        }
        if !(COLS_MIN..=most).contains(&self.cols) {
            let what = format!(
                "is {}, but the contact is rolled to and fro between two columns inside the array",
                self.cols
            );
            let remedy = format!("servo by an array of {COLS_MIN} to {most} columns");
            return Err(Invalid::new("cols", what, remedy));
        }
        for (place, pitch_mm) in [("pitch_x_mm", self.pitch_x_mm), ("pitch_y_mm", self.pitch_y_mm)]
        {
            if !(0.1..=50.0).contains(&pitch_mm) {
                return Err(Invalid::new(place, format!("is {pitch_mm}"), "give 0.1 to 50"));
            }
        }
        Ok(())
    }

    /// Whether an image has as many rows and columns.
    #[must_use]
    pub fn fits(&self, image: &TactileImage) -> bool {
        (u32::from(image.rows), u32::from(image.cols)) == (self.rows, self.cols)
            && image.counts.len() == image.valid.len()
            && image.counts.len() == self.tactels()
            && image.row_offset_ns.len() == self.row_count()
    }

    /// Number of rows.
    #[must_use]
    pub fn row_count(&self) -> usize {
        (self.rows as usize).min(ROWS_MAX)
    }

    /// Number of columns.
    #[must_use]
    pub fn col_count(&self) -> usize {
        self.cols as usize
    }

    /// Number of tactels.
    #[must_use]
    pub fn tactels(&self) -> usize {
        self.rows as usize * self.cols as usize
    }

    /// Middle of the rows (row number, from 1).
    #[must_use]
    pub fn middle_row(&self) -> f64 {
        0.5 * (f64::from(self.rows) + 1.0)
    }

    /// Middle of the columns (column number, from 1).
    #[must_use]
    pub fn middle_column(&self) -> f64 {
        0.5 * (f64::from(self.cols) + 1.0)
    }

    /// Half the width of the band about a line of load (columns): 2.5 of the default pitch.
    #[must_use]
    pub fn band_half_columns(&self) -> f64 {
        (BAND_HALF_MM / self.pitch_x_mm).max(BAND_HALF_COLUMNS_MIN)
    }

    /// Distance of neighbouring rows over that of neighbouring columns: a slope in columns a row is
    /// this times the tangent of its angle.
    #[must_use]
    pub fn rows_per_column(&self) -> f64 {
        self.pitch_y_mm / self.pitch_x_mm
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrays_of_every_size_are_taken_and_others_refused_with_their_place() {
        let check = |change: &dyn Fn(&mut Array)| {
            let mut array = Array::default();
            change(&mut array);
            array.check().map_err(|bad| bad.place)
        };
        assert_eq!(check(&|_| ()), Ok(()));
        assert_eq!(check(&|a| (a.rows, a.cols) = (1, 64)), Ok(()));
        assert_eq!(check(&|a| (a.rows, a.cols) = (64, 64)), Ok(()));
        assert_eq!(check(&|a| a.rows = 0), Err("rows".to_owned()));
        assert_eq!(check(&|a| a.rows = 65), Err("rows".to_owned()));
        assert_eq!(check(&|a| (a.rows, a.cols) = (1, 1)), Err("cols".to_owned()));
        for bad in [f64::NAN, 0.0, -1.0, f64::INFINITY] {
            assert_eq!(check(&|a| a.pitch_x_mm = bad), Err("pitch_x_mm".to_owned()));
            assert_eq!(check(&|a| a.pitch_y_mm = bad), Err("pitch_y_mm".to_owned()));
        }
    }

    #[test]
    fn only_images_of_its_size_fit() {
        let array = Array { rows: 12, cols: 32, ..Array::default() };
        assert!(array.fits(&TactileImage::new(12, 32)));
        for (rows, cols) in [(32, 12), (16, 16), (0, 0), (12, 31)] {
            assert!(!array.fits(&TactileImage::new(rows, cols)), "{rows} x {cols}");
        }
        let torn = TactileImage { valid: vec![1; 3].into(), ..TactileImage::new(12, 32) };
        assert!(!array.fits(&torn));
    }
}
