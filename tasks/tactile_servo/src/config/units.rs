//! Set points, limits and Jacobians in newtons and millimetres, which do not depend on the array.
//! A configuration as it is read may give them in the place of counts and columns; before it is
//! used they are converted, by the counts that a newton makes and by the pitches of the array. What
//! is given in both units is refused. A number of counts or columns that was not given is NaN until
//! then.

use serde::{Deserialize, Deserializer};
use taktil_rtcore::Invalid;

use super::Config;

/// A number that was not given.
pub(super) fn absent() -> f64 {
    f64::NAN
}

/// A diagonal that was not given.
pub(super) fn absent_diagonal() -> [f64; 4] {
    [f64::NAN; 4]
}

/// A number in newtons or millimetres, as it was given, with its key and with what converts it to
/// counts or columns.
struct Physical<'a> {
    key: &'static str,
    number: Option<f64>,
    convert: &'a dyn Fn(f64) -> f64,
}

/// Puts what was given in either unit into `number`, whose key is `key`, or else the default.
fn resolve(
    key: &str,
    number: &mut f64,
    physical: &Physical<'_>,
    default: f64,
) -> Result<(), Invalid> {
    match physical.number {
        Some(value) if !number.is_nan() => {
            let what = format!("is {value}, and {key} is given too");
            return Err(Invalid::new(physical.key, what, "give one of them"));
        }
        Some(value) if !value.is_finite() => {
            return Err(Invalid::new(physical.key, format!("is {value}"), "give a finite number"));
        }
        Some(value) => *number = (physical.convert)(value),
        None if number.is_nan() => *number = default,
        None => {}
    }
    Ok(())
}

/// Puts a diagonal in (mm/mm, N/mm, N mm/mrad, mrad/mrad) in the place of one in columns and
/// counts.
fn resolve_diagonal(
    place: &'static str,
    diagonal: &mut [f64; 4],
    other: Option<[f64; 4]>,
    per_unit: [f64; 4],
    default: [f64; 4],
) -> Result<(), Invalid> {
    let given = diagonal.iter().any(|number| !number.is_nan());
    match other {
        Some(_) if given => {
            let (what, remedy) = (format!("stands beside {place}"), "give one of them");
            Err(Invalid::new(format!("{place}_n_mm"), what, remedy))
        }
        Some(other) => {
            *diagonal = core::array::from_fn(|i| other[i] * per_unit[i]);
            Ok(())
        }
        None => {
            *diagonal = if given { *diagonal } else { default };
            Ok(())
        }
    }
}

impl Config {
    /// The configuration with every number in the units of the array: what was given in newtons
    /// and millimetres is converted and then absent, what was not given at all has its default.
    ///
    /// # Errors
    /// An array that [`Array::check`](super::array::Array::check) refuses, a number of counts that
    /// a newton makes that is not positive, a number given in both units.
    pub fn resolved(mut self) -> Result<Config, Invalid> {
        self.array.check().map_err(|bad| bad.within("array"))?;
        let (array, counts_per_n) = (self.array, self.model.counts_per_n);
        if !(counts_per_n > 0.0 && counts_per_n.is_finite()) {
            let what = format!("is {counts_per_n}");
            return Err(Invalid::new("model.counts_per_n", what, "give more than 0"));
        }
        let counts = |newton: f64| newton * counts_per_n;
        let counts_rows = |n_mm: f64| n_mm * counts_per_n / array.pitch_y_mm;
        let columns = |mm: f64| mm / array.pitch_x_mm;
        let column = |mm: f64| array.middle_column() + mm / array.pitch_x_mm;
        let last = f64::from(array.cols) - 1.0;
        let load = Physical { key: "m0_n", number: self.m0_n, convert: &counts };
        resolve("m0_counts", &mut self.m0_counts, &load, 15_000.0)?;
        let m0 = self.m0_counts;
        // Where the load is given in newtons, what is left out are the same parts of it as by
        // default: a fifteenth and two fifths.
        let (contact, roll_min) = match self.m0_n {
            Some(_) => (m0 / 15.0, 0.4 * m0),
            None => (1_000.0, 6_000.0),
        };
        let physical = Physical { key: "contact_n", number: self.contact_n, convert: &counts };
        resolve("contact_counts", &mut self.contact_counts, &physical, contact)?;
        let physical = Physical { key: "roll_min_n", number: self.roll_min_n, convert: &counts };
        resolve("roll_min_counts", &mut self.roll_min_counts, &physical, roll_min)?;
        let physical = Physical { key: "m_x_n_mm", number: self.m_x_n_mm, convert: &counts_rows };
        resolve("m_x_counts", &mut self.m_x_counts, &physical, 0.0)?;
        let physical = Physical { key: "x_low_mm", number: self.x_low_mm, convert: &column };
        resolve("x_c_low", &mut self.x_c_low, &physical, 2.0)?;
        let physical = Physical { key: "x_high_mm", number: self.x_high_mm, convert: &column };
        resolve("x_c_high", &mut self.x_c_high, &physical, last)?;
        let number = self.x_tolerance_mm;
        let physical = Physical { key: "x_tolerance_mm", number, convert: &columns };
        resolve("x_c_tolerance", &mut self.x_c_tolerance, &physical, 0.5)?;
        let per_unit = [1.0 / array.pitch_x_mm, counts_per_n, counts_per_n / array.pitch_y_mm, 1.0];
        let default = Config::default();
        let other = self.feature_jacobian_n_mm;
        let diagonal = &mut self.feature_jacobian;
        resolve_diagonal("feature_jacobian", diagonal, other, per_unit, default.feature_jacobian)?;
        let pid = &mut self.projector_pid;
        let default = default.projector_pid.jacobian;
        resolve_diagonal("jacobian", &mut pid.jacobian, pid.jacobian_n_mm, per_unit, default)
            .map_err(|bad| bad.within("projector_pid"))?;
        (self.m0_n, self.contact_n, self.roll_min_n, self.m_x_n_mm) = (None, None, None, None);
        (self.x_low_mm, self.x_high_mm, self.x_tolerance_mm) = (None, None, None);
        (self.feature_jacobian_n_mm, self.projector_pid.jacobian_n_mm) = (None, None);
        if let Some(opposed) = &mut self.opposed {
            opposed.array.check().map_err(|bad| bad.within("opposed.array"))?;
            if opposed.x_c.is_nan() {
                opposed.x_c = opposed.array.middle_column();
            }
        }
        Ok(self)
    }

    /// Reads the section of a machine file, in whatever units it gives. A section that cannot be
    /// resolved stays as it is read, and [`Config::check`] says why.
    ///
    /// # Errors
    /// The errors of the format.
    pub fn deserialize_section<'de, D: Deserializer<'de>>(
        from: D,
    ) -> Result<Option<Config>, D::Error> {
        let Some(config) = Option::<Config>::deserialize(from)? else { return Ok(None) };
        Ok(Some(config.clone().resolved().unwrap_or(config)))
    }
}

#[cfg(test)]
mod tests {
    use super::super::array::Array;
    use super::*;

    /// A configuration as it is read when nothing was given.
    fn read() -> Config {
        let mut config = Config {
            m0_counts: absent(),
            contact_counts: absent(),
            roll_min_counts: absent(),
            m_x_counts: absent(),
            x_c_low: absent(),
            x_c_high: absent(),
            x_c_tolerance: absent(),
            feature_jacobian: absent_diagonal(),
            ..Config::default()
        };
        config.projector_pid.jacobian = absent_diagonal();
        config
    }

    #[test]
    fn what_is_not_given_is_the_default() {
        assert_eq!(read().resolved(), Ok(Config::default()));
        let wide = Config { array: Array { cols: 32, ..Array::default() }, ..read() };
        assert_eq!(wide.resolved().unwrap().x_c_high, 31.0);
    }

    #[test]
    fn newtons_and_millimetres_say_what_counts_and_columns_do() {
        let array = Array { rows: 16, cols: 32, pitch_x_mm: 2.0, pitch_y_mm: 4.0 };
        let mut config = Config {
            array,
            m0_n: Some(10.0),
            m_x_n_mm: Some(8.0),
            x_low_mm: Some(-20.0),
            x_high_mm: Some(20.0),
            x_tolerance_mm: Some(1.0),
            feature_jacobian_n_mm: Some([0.5, 10.0, 4.0, 1.0]),
            ..read()
        };
        config.model.counts_per_n = 100.0;
        let config = config.resolved().unwrap();
        assert_eq!((config.m0_counts, config.m_x_counts), (1000.0, 200.0));
        assert_eq!((config.x_c_low, config.x_c_high, config.x_c_tolerance), (6.5, 26.5, 0.5));
        assert_eq!(config.feature_jacobian, [0.25, 1000.0, 100.0, 1.0]);
        assert!((config.contact_counts - 66.67).abs() < 0.01);
        assert_eq!(config.roll_min_counts, 400.0);
        assert_eq!(config.check(), Ok(()));
    }

    #[test]
    fn the_same_number_in_both_units_is_refused() {
        let place = |change: &dyn Fn(&mut Config)| {
            let mut config = read();
            change(&mut config);
            config.resolved().unwrap_err().place
        };
        assert_eq!(place(&|c| (c.m0_counts, c.m0_n) = (15_000.0, Some(1.0))), "m0_n");
        assert_eq!(place(&|c| (c.x_c_low, c.x_low_mm) = (2.0, Some(1.0))), "x_low_mm");
        assert_eq!(place(&|c| (c.contact_counts, c.contact_n) = (2.0, Some(1.0))), "contact_n");
        assert_eq!(place(&|c| c.roll_min_n = Some(f64::NAN)), "roll_min_n");
        let both = |c: &mut Config| {
            c.projector_pid.jacobian = [1.0; 4];
            c.projector_pid.jacobian_n_mm = Some([1.0; 4]);
        };
        assert_eq!(place(&both), "projector_pid.jacobian_n_mm");
        assert_eq!(place(&|c| c.model.counts_per_n = 0.0), "model.counts_per_n");
        assert_eq!(place(&|c| c.array.cols = 1), "array.cols");
    }
}
