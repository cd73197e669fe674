//! Runs one scene at one fidelity level by the whole stack. Records its trajectory, job by job, and
//! the work of the physics, and compares it with the trajectory at the finest level. The comparison
//! begins when the finger presses.

use taktil_mechanics::Joints;
use taktil_mechanics::puma260::Puma260;
use taktil_rtcore::record::{Catalog, Observer, Record};
use taktil_rtcore::{Nanos, Payload, linux};
use taktil_signal::{Features, defined};

use taktil_lab_scene::assembly::Assembly;
use taktil_lab_scene::scene::Scene;
use taktil_lab_scene::score::Targets;
use taktil_lab_scene::{run_virtual, targets};
use taktil_lab_world::{WorldStatistics, WorldTruth};

/// The compared quantities, with units.
pub const MEASURES: [&str; 8] = [
    "x_c, mm",
    "y_c, mm",
    "theta_z, deg",
    "p_x, mm",
    "p_z, mm",
    "theta_xx, deg",
    "theta_zz, deg",
    "yaw, deg",
];
/// The range of [`MEASURES`] whose entries are angles on a circle (deg).
const CIRCULAR_MEASURES: core::ops::Range<usize> = 5..7;
/// Fraction of the force's set point from which on the finger counts as pressing.
const PRESSED_FORCE_SHARE: f64 = 0.9;
/// Time from the first press in the finest run to the begin of the comparison (s).
const COMPARISON_DELAY_S: f64 = 1.0;

/// The state of a run at one instant; NaN where a quantity is undefined.
#[derive(Clone, Copy, Debug, Default)]
pub struct TrajectoryRow {
    /// The instant.
    pub at: Nanos,
    /// M0 and the true force, in percent of their set points.
    pub pressed: [f64; 2],
    /// The values of [`MEASURES`].
    pub values: Values,
    /// The joints (rad).
    pub q_rad: [f64; 6],
}

/// The values of [`MEASURES`] at one instant.
pub type Values = [f64; MEASURES.len()];

/// The trajectory of a run.
#[derive(Debug, Default)]
pub struct Trajectory {
    /// One row for each job of the world, from the start.
    pub rows: Vec<TrajectoryRow>,
    /// Counts of the physics at the end.
    pub work: WorldStatistics,
}

/// Differences from the finest run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Differences<const N: usize> {
    /// Largest difference; infinite where only one of both runs has a value, NaN where neither ever
    /// has one.
    pub most: [f64; N],
    /// Root mean square.
    pub rms: [f64; N],
}

/// Accumulates differences.
pub struct DifferenceSums<const N: usize> {
    most: [f64; N],
    squares: [f64; N],
    counts: [u32; N],
}

impl<const N: usize> Default for DifferenceSums<N> {
    fn default() -> DifferenceSums<N> {
        DifferenceSums { most: [0.0; N], squares: [0.0; N], counts: [0; N] }
    }
}

impl<const N: usize> DifferenceSums<N> {
    /// Adds the differences at one instant; NaN where neither run has a value.
    pub fn add(&mut self, off: [f64; N]) {
        for (i, off) in off.into_iter().enumerate().filter(|(_, off)| !off.is_nan()) {
            self.most[i] = self.most[i].max(off);
            self.squares[i] += off * off;
            self.counts[i] += 1;
        }
    }

    /// The accumulated differences; NaN where there was nothing to compare.
    #[must_use]
    pub fn differences(&self) -> Differences<N> {
        let known = |i: usize, value: f64| if self.counts[i] == 0 { f64::NAN } else { value };
        Differences {
            most: core::array::from_fn(|i| known(i, self.most[i])),
            rms: core::array::from_fn(|i| (self.squares[i] / f64::from(self.counts[i])).sqrt()),
        }
    }
}

/// Observes a run and records its trajectory.
struct TrajectoryRecorder {
    truth: Option<usize>,
    features: Option<usize>,
    work: Option<usize>,
    arm: Puma260,
    targets: Targets,
    seen: Features,
    course: Trajectory,
}

impl TrajectoryRecorder {
    fn truth(&mut self, truth: &WorldTruth) {
        let seen = &self.seen;
        let of = |bit: u32, value: f64| if seen.defined & bit == 0 { f64::NAN } else { value };
        let pose = self.arm.tool_pose(&Joints::from(truth.q_rad));
        let (x, z) = (pose.rotation.x_axis, pose.rotation.z_axis);
        let force_n = self.targets.m0 / self.targets.counts_per_n;
        let values = [
            of(defined::CENTROID, self.targets.pitch_x_mm * seen.x_c),
            of(defined::CENTROID, self.targets.pitch_y_mm * seen.y_c),
            of(defined::THETA_Z, seen.theta_z_rad.to_degrees()),
            1e3 * truth.tool_m[0],
            1e3 * truth.tool_m[2],
            libm::atan2(x.y, x.x).to_degrees(),
            libm::atan2(z.y, z.z).to_degrees(),
            truth.pin_yaw_rad.to_degrees(),
        ];
        let pressed = [100.0 * seen.m0 / self.targets.m0, 100.0 * truth.finger_normal_n / force_n];
        let (at, q_rad) = (Nanos(truth.t_ns), truth.q_rad);
        self.course.rows.push(TrajectoryRow { at, pressed, values, q_rad });
    }
}

impl Observer for TrajectoryRecorder {
    fn record(&mut self, record: &Record<'_>) {
        let id = Some(record.signal);
        if id == self.truth {
            if let Some(truth) = WorldTruth::decode(record.body) {
                self.truth(&truth);
            }
        } else if id == self.features {
            self.seen = Features::decode(record.body).unwrap_or(self.seen);
        } else if id == self.work {
            self.course.work = WorldStatistics::decode(record.body).unwrap_or(self.course.work);
        }
    }
}

/// An observer that ignores all records.
struct NullObserver;

impl Observer for NullObserver {
    fn record(&mut self, _: &Record<'_>) {}
}

/// Runs a scene; returns its trajectory and the wall time (s), recording included.
///
/// # Errors
/// A scene that cannot be assembled, or a task that does not start.
pub fn recorded_run(scene: &Scene, until: Nanos, seed: u64) -> anyhow::Result<(Trajectory, f64)> {
    let mut machine = Assembly::new(scene).with_seed(seed).with_work_counts().build()?;
    let catalog: &Catalog = machine.catalog();
    let mut watch = TrajectoryRecorder {
        truth: catalog.find("world.truth"),
        features: catalog.find("tactile_servo.features"),
        work: catalog.find("world.statistics"),
        arm: Puma260::reference(),
        targets: targets(scene),
        seen: Features::default(),
        course: Trajectory::default(),
    };
    let spent_s = run_observed_s(&mut machine, until, &mut watch)?;
    Ok((watch.course, spent_s))
}

/// Wall time of a run without a recorder (s); the loading of the scene is not included.
///
/// # Errors
/// As [`recorded_run`].
pub fn run_time_s(scene: &Scene, until: Nanos, seed: u64) -> anyhow::Result<f64> {
    let mut machine = Assembly::new(scene).with_seed(seed).build()?;
    run_observed_s(&mut machine, until, &mut NullObserver)
}

fn run_observed_s(
    machine: &mut taktil_rtcore::Machine,
    until: Nanos,
    observer: &mut dyn Observer,
) -> anyhow::Result<f64> {
    let start = linux::monotonic();
    run_virtual(machine, until, observer)?;
    Ok((linux::monotonic() - start).as_secs_f64())
}

impl Trajectory {
    /// The instant from which on runs are compared with this one; `None` where the finger never
    /// presses.
    #[must_use]
    pub fn comparison_start(&self) -> Option<Nanos> {
        let pressed = self.rows.iter().find(|row| row.pressed[1] >= 100.0 * PRESSED_FORCE_SHARE);
        pressed.map(|row| row.at + Nanos((1e9 * COMPARISON_DELAY_S) as i64))
    }

    /// Root mean square of M0 and of the force about their set points from an instant on (%).
    #[must_use]
    pub fn rms_about_set_points(&self, from: Nanos) -> [f64; 2] {
        let judged = || self.rows.iter().filter(|row| row.at >= from);
        let count = judged().count().max(1) as f64;
        [0, 1].map(|i| {
            let off = |row: &TrajectoryRow| row.pressed[i] - 100.0;
            let squares: f64 = judged().map(|row| off(row) * off(row)).sum();
            (squares / count).sqrt()
        })
    }

    /// Differences of this run from the finest one, from an instant on.
    #[must_use]
    pub fn differences_to(
        &self,
        finest: &Trajectory,
        from: Nanos,
    ) -> Differences<{ MEASURES.len() }> {
        let mut apart = DifferenceSums::default();
        let pairs = self.rows.iter().zip(&finest.rows).filter(|(row, _)| row.at >= from);
        for (row, exact) in pairs {
            apart.add(core::array::from_fn(|i| difference(i, row.values[i], exact.values[i])));
        }
        apart.differences()
    }
}

/// Distance of two values of a measure; for angles on a circle, the shorter way round.
fn difference(measure: usize, a: f64, b: f64) -> f64 {
    let off = distance(a, b);
    if CIRCULAR_MEASURES.contains(&measure) { off.min(360.0 - off) } else { off }
}

/// Distance of two values: NaN if both are undefined, infinite if one is.
#[must_use]
pub fn distance(a: f64, b: f64) -> f64 {
    if a.is_nan() == b.is_nan() { (a - b).abs() } else { f64::INFINITY }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn course(rows: &[Values]) -> Trajectory {
        let at = |i: usize| Nanos::from_millis(i as i64);
        let row = |(i, values): (usize, &Values)| TrajectoryRow {
            at: at(i),
            values: *values,
            ..TrajectoryRow::default()
        };
        Trajectory { rows: rows.iter().enumerate().map(row).collect(), ..Trajectory::default() }
    }

    #[test]
    fn differences_are_those_of_the_judged_rows_and_short_on_the_circle() {
        let mut rows = [[0.0; 8]; 3];
        let exact = course(&rows);
        rows[0] = [9.0; 8];
        rows[1][0] = 3.0;
        rows[2][5] = 359.0;
        let apart = course(&rows).differences_to(&exact, Nanos::from_millis(1));
        assert_eq!((apart.most[0], apart.rms[0]), (3.0, 4.5_f64.sqrt()));
        assert_eq!((apart.most[5], apart.most[1]), (1.0, 0.0));
    }

    #[test]
    fn a_feature_that_only_one_run_has_is_infinitely_off() {
        let (mut ours, mut exact) = ([[0.0; 8]; 2], [[0.0; 8]; 2]);
        ours[0][2] = f64::NAN;
        (ours[1][1], exact[1][1]) = (f64::NAN, f64::NAN);
        let apart = course(&ours).differences_to(&course(&exact), Nanos::ZERO);
        assert_eq!((apart.most[2], apart.rms[2]), (f64::INFINITY, f64::INFINITY));
        let nothing = course(&[[f64::NAN; 8]]);
        let apart_of_nothing = nothing.differences_to(&nothing, Nanos::ZERO);
        assert!(apart_of_nothing.most[0].is_nan() && apart_of_nothing.rms[0].is_nan());
        assert_eq!(apart.most[1], 0.0);
    }

    #[test]
    fn comparison_begins_after_the_finger_first_presses() {
        let mut run = course(&[[0.0; 8]; 3]);
        assert_eq!(run.comparison_start(), None);
        run.rows[1].pressed = [104.0, 91.0];
        assert_eq!(run.comparison_start(), Some(Nanos::from_millis(1_001)));
        run.rows[2].pressed = [100.0, 103.0];
        assert_eq!(
            run.rms_about_set_points(Nanos::from_millis(1)),
            [8.0_f64.sqrt(), 45.0_f64.sqrt()]
        );
    }
}
