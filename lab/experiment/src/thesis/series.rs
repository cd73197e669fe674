//! What the thesis's figures show, sampled from a run: features as the task computed them, and the
//! finger's pose as the encoders tell it. A calibration that is wrong is wrong in these as well, as
//! it was in the thesis.

use taktil_lab_world::WorldTruth;
use taktil_mechanics::Joints;
use taktil_mechanics::puma260::Puma260;
use taktil_rtcore::Payload;
use taktil_rtcore::record::{Catalog, Observer, Record};
use taktil_signal::{Features, defined};

/// Number of jobs of the servo for each sample: one image at 80 Hz.
const JOBS_PER_SAMPLE: u64 = 5;
/// Bytes of a number in a record.
const NUMBER_BYTES: usize = 8;
/// Fraction of the set point from which on the finger counts as pressing.
const PRESSED_SHARE: f64 = 0.9;
/// The thesis's set point (counts).
const SET_POINT_COUNTS: f64 = 15_000.0;
/// Half the time over which a direction of rolling is judged (s).
const DIRECTION_HALF_S: f64 = 0.2;
/// Speed from which on the finger counts as rolling one way (mm/s).
const ROLLING_MM_S: f64 = 5.0;
/// Half the time around a turning point in which it is the farthest point (s).
const TURNING_HALF_S: f64 = 1.0;

/// The columns of a [`Series`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Column {
    /// Centroid (column number).
    Xc,
    /// Sum of the counts.
    M0,
    /// First moment about the middle row (counts x rows).
    Mx,
    /// Direction of the pin on the sensor as read (deg).
    ThetaZ,
    /// Place of the finger along x0 by the encoders (mm).
    Px,
    /// Place along z0 by the encoders (mm).
    Pz,
    /// Angle of the sensor's x axis against the plane x0-z0 (deg, 0 to 360).
    ThetaXx,
    /// Angle of the sensor's z axis against the plane x0-z0 (deg, 0 to 360).
    ThetaZz,
}

/// Number of columns.
pub const COLUMN_COUNT: usize = 8;

/// Samples of one run.
#[derive(Clone, Debug, Default)]
pub struct Series {
    /// Instants (s).
    pub t_s: Vec<f64>,
    columns: [Vec<f64>; COLUMN_COUNT],
    /// When the finger first pressed (s).
    pub pressed_s: Option<f64>,
    /// First and last instant at which the table turned (s).
    pub table_moves_s: Option<(f64, f64)>,
    /// How often the finger lost contact after it first pressed.
    pub contact_lost: u32,
}

impl Series {
    /// The values of a column.
    #[must_use]
    pub fn column(&self, column: Column) -> &[f64] {
        &self.columns[column as usize]
    }

    /// The finite values of a column from `from_s` to `to_s`.
    pub fn values(&self, column: Column, from_s: f64, to_s: f64) -> impl Iterator<Item = f64> {
        let first = self.t_s.partition_point(|t| *t < from_s);
        let last = self.t_s.partition_point(|t| *t < to_s).max(first);
        self.column(column)[first..last].iter().copied().filter(|value| value.is_finite())
    }

    /// Least and most; `None` without a value.
    #[must_use]
    pub fn range(&self, column: Column, from_s: f64, to_s: f64) -> Option<(f64, f64)> {
        let mut values = self.values(column, from_s, to_s);
        let first = values.next()?;
        Some(values.fold((first, first), |(low, high), v| (low.min(v), high.max(v))))
    }

    /// Mean; `None` without a value.
    #[must_use]
    pub fn mean(&self, column: Column, from_s: f64, to_s: f64) -> Option<f64> {
        mean(self.values(column, from_s, to_s))
    }

    /// Half the width of the band that leaves `share` of the values out on either side.
    #[must_use]
    pub fn half_band(&self, column: Column, from_s: f64, to_s: f64, share: f64) -> Option<f64> {
        let mut values: Vec<f64> = self.values(column, from_s, to_s).collect();
        values.sort_by(f64::total_cmp);
        #[expect(clippy::cast_sign_loss, clippy::cast_possible_truncation, reason = "a share")]
        let left_out = (share * values.len() as f64) as usize;
        let high = values.len().checked_sub(1 + left_out)?;
        Some(0.5 * (values.get(high)? - values.get(left_out)?))
    }

    /// Steepest change of a column over `span_s` within the time, per second, from means over half
    /// a second.
    #[must_use]
    pub fn steepest(&self, column: Column, from_s: f64, to_s: f64, span_s: f64) -> Option<f64> {
        let steps = ((to_s - from_s - span_s) / 0.25).floor().max(0.0);
        let at = |t_s: f64| self.mean(column, t_s - 0.25, t_s + 0.25);
        let mut most: Option<f64> = None;
        let mut step = 0.0;
        while step <= steps {
            let begin = from_s + 0.25 * step;
            if let (Some(a), Some(b)) = (at(begin), at(begin + span_s)) {
                let rate = (b - a) / span_s;
                most = Some(most.map_or(rate, |most| most.max(rate)));
            }
            step += 1.0;
        }
        most
    }

    /// The turning points of p_x after the first press: instants (s) and places (mm).
    #[must_use]
    pub fn turning_points(&self) -> Vec<(f64, f64)> {
        let p_x = self.column(Column::Px);
        let Some(pressed_s) = self.pressed_s else { return Vec::new() };
        let mut found: Vec<(f64, f64)> = Vec::new();
        for (i, (&t, &x)) in self.t_s.iter().zip(p_x).enumerate() {
            let first = self.t_s.partition_point(|s| *s < t - TURNING_HALF_S);
            let last = self.t_s.partition_point(|s| *s <= t + TURNING_HALF_S);
            let whole = t - TURNING_HALF_S >= pressed_s && last < self.t_s.len();
            let near = &p_x[first..last];
            let farthest = near.iter().all(|v| *v <= x) || near.iter().all(|v| *v >= x);
            let again = found.last().is_some_and(|(before, _)| t - before < TURNING_HALF_S);
            if whole && farthest && !again && i > 0 {
                found.push((t, x));
            }
        }
        found
    }

    /// Means of a column while the finger rolls towards +x0 and towards -x0.
    #[must_use]
    pub fn by_direction(&self, column: Column, from_s: f64, to_s: f64) -> Option<(f64, f64)> {
        let p_x = self.column(Column::Px);
        let at = |t: f64| p_x.get(self.t_s.partition_point(|s| *s < t)).copied();
        let rolling = |sign: f64| {
            mean(self.t_s.iter().zip(self.column(column)).filter_map(|(&t, &value)| {
                let ahead = at(t + DIRECTION_HALF_S)?;
                let speed = (ahead - at(t - DIRECTION_HALF_S)?) / (2.0 * DIRECTION_HALF_S);
                let counts = t >= from_s && t < to_s && value.is_finite();
                (counts && sign * speed > ROLLING_MM_S).then_some(value)
            }))
        };
        Some((rolling(1.0)?, rolling(-1.0)?))
    }

    /// Mean of p_z within 2 mm of the farthest point along +x0, less that at the other end.
    #[must_use]
    pub fn rise_mm(&self, from_s: f64, to_s: f64) -> Option<f64> {
        let (low, high) = self.range(Column::Px, from_s, to_s)?;
        let first = self.t_s.partition_point(|t| *t < from_s);
        let last = self.t_s.partition_point(|t| *t < to_s);
        let both =
            || self.column(Column::Px)[first..last].iter().zip(&self.column(Column::Pz)[first..]);
        let near =
            |end: f64| mean(both().filter(|(x, _)| (**x - end).abs() < 2.0).map(|(_, z)| *z));
        Some(near(high)? - near(low)?)
    }
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), v| (sum + v, count + 1.0));
    (count > 0.0).then(|| sum / count)
}

/// Observes a run and samples it.
pub struct Sampler {
    joints: Option<usize>,
    features: Option<usize>,
    truth: Option<usize>,
    arm: Puma260,
    latest: Features,
    table: Option<[f64; 3]>,
    in_contact: bool,
    jobs: u64,
    series: Series,
}

impl Sampler {
    /// A sampler for the signals of a machine.
    #[must_use]
    pub fn new(catalog: &Catalog) -> Sampler {
        Sampler {
            joints: catalog.find("sense.joints"),
            features: catalog.find("tactile_servo.features"),
            truth: catalog.find("world.truth"),
            arm: Puma260::reference(),
            latest: Features::default(),
            table: None,
            in_contact: false,
            jobs: 0,
            series: Series::default(),
        }
    }

    /// Ends the sampling.
    #[must_use]
    pub fn series(self) -> Series {
        self.series
    }

    fn features(&mut self, t_s: f64, features: Features) {
        self.latest = features;
        if features.active != 0 && features.m0 >= PRESSED_SHARE * SET_POINT_COUNTS {
            self.series.pressed_s.get_or_insert(t_s);
        }
    }

    fn truth(&mut self, t_s: f64, truth: &WorldTruth) {
        let table = [truth.table_tilt_x_rad, truth.table_tilt_y_rad, truth.table_pan_rad];
        if self.table.is_some_and(|before| before != table) {
            let moves = self.series.table_moves_s.get_or_insert((t_s, t_s));
            moves.1 = t_s;
        }
        self.table = Some(table);
        let contact = truth.in_contact != 0;
        if self.in_contact && !contact && self.series.pressed_s.is_some() {
            self.series.contact_lost += 1;
        }
        self.in_contact = contact;
    }

    fn joints(&mut self, t_s: f64, body: &[u8]) {
        self.jobs += 1;
        if self.series.pressed_s.is_none() || !self.jobs.is_multiple_of(JOBS_PER_SAMPLE) {
            return;
        }
        let mut q = [0.0; 6];
        for (angle, bytes) in q.iter_mut().zip(body.chunks_exact(NUMBER_BYTES)) {
            *angle = <[u8; NUMBER_BYTES]>::try_from(bytes).map_or(f64::NAN, f64::from_le_bytes);
        }
        let tool = self.arm.tool_pose(&Joints::from(q));
        let (x, z) = (tool.rotation.x_axis, tool.rotation.z_axis);
        let latest = self.latest;
        let of = |bit: u32, value: f64| if latest.defined & bit == 0 { f64::NAN } else { value };
        let sample = [
            of(defined::CENTROID, latest.x_c),
            latest.m0,
            latest.m_x,
            of(defined::THETA_Z, latest.theta_z_rad.to_degrees()),
            tool.translation.x * 1e3,
            tool.translation.z * 1e3,
            positive_degrees(libm::atan2(x.y, x.x)),
            positive_degrees(libm::atan2(z.y, z.z)),
        ];
        self.series.t_s.push(t_s);
        for (column, value) in self.series.columns.iter_mut().zip(sample) {
            column.push(value);
        }
    }
}

/// Degrees from 0 to 360.
fn positive_degrees(radians: f64) -> f64 {
    let deg = radians.to_degrees();
    if deg < 0.0 { deg + 360.0 } else { deg }
}

impl Observer for Sampler {
    fn record(&mut self, record: &Record<'_>) {
        let id = Some(record.signal);
        let t_s = record.release.as_secs_f64();
        if id == self.joints {
            self.joints(t_s, record.body);
        } else if id == self.features {
            if let Some(features) = Features::decode(record.body) {
                self.features(t_s, features);
            }
        } else if id == self.truth
            && let Some(truth) = WorldTruth::decode(record.body)
        {
            self.truth(t_s, &truth);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A finger that rolls to and fro by 10 mm in 2 s each way and climbs a tenth of its way.
    fn to_and_fro() -> Series {
        let mut series = Series { pressed_s: Some(0.0), ..Series::default() };
        for i in 0..800 {
            let t_s = f64::from(i) * 0.0125;
            let phase = t_s.rem_euclid(4.0);
            let (x, forward) =
                if phase < 2.0 { (5.0 * phase, 1.0) } else { (20.0 - 5.0 * phase, -1.0) };
            let x = x + 1e-9 * t_s;
            series.t_s.push(t_s);
            let values =
                [8.5, 15_000.0 + 100.0 * forward, 0.0, f64::NAN, 2.0 * x, 0.2 * x, 180.0, t_s];
            for (column, value) in series.columns.iter_mut().zip(values) {
                column.push(value);
            }
        }
        series
    }

    #[test]
    fn strokes_are_told_apart() {
        let series = to_and_fro();
        let turns = series.turning_points();
        assert_eq!(turns.len(), 4, "{turns:?}");
        let due_t = [2.0, 4.0, 6.0, 8.0];
        let due_x = [20.0, 0.0, 20.0, 0.0];
        for (i, (t, x)) in turns.into_iter().enumerate() {
            assert!((t - due_t[i]).abs() < 0.02 && (x - due_x[i]).abs() < 0.2, "{t} {x}");
        }
        let (forward, back) = series.by_direction(Column::M0, 0.0, 10.0).unwrap();
        // Around a turn the direction lags by the time over which it is judged.
        assert!((forward - 15_100.0).abs() < 5.0 && (back - 14_900.0).abs() < 5.0);
        let rise = series.rise_mm(0.0, 10.0).unwrap();
        assert!((rise - 1.8).abs() < 0.02, "the means lie a millimetre inside: {rise}");
    }

    #[test]
    fn bands_leave_peaks_out_and_gaps_are_no_values() {
        let mut series = to_and_fro();
        let values: Vec<f64> = (0..800).map(|i| f64::from(i % 100) - 49.5).collect();
        series.columns[Column::Mx as usize] = values;
        series.columns[Column::Mx as usize][7] = 1e6;
        let whole = series.half_band(Column::Mx, 0.0, 10.0, 0.0).unwrap();
        assert!(whole > 1e5);
        let band = series.half_band(Column::Mx, 0.0, 10.0, 0.025).unwrap();
        assert!((band - 47.5).abs() < 1.0, "{band}");
        assert_eq!(series.range(Column::ThetaZ, 0.0, 10.0), None);
        assert_eq!(series.mean(Column::ThetaZ, 0.0, 10.0), None);
        assert_eq!(series.half_band(Column::ThetaZ, 0.0, 10.0, 0.0), None);
        assert_eq!(series.mean(Column::M0, 20.0, 30.0), None);
        let rate = series.steepest(Column::ThetaZz, 1.0, 9.0, 2.0).unwrap();
        assert!((rate - 1.0).abs() < 1e-9, "{rate}");
    }
}
