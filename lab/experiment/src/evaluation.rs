//! Evaluates one run of an experiment: errors against the simulator's truth, not against the
//! controller's estimates. They are computed from the passing records. The evaluation begins after
//! the force first reached its set point, and a quantity that was not observed is absent.

use taktil_contact::cylinder::LineContact;
use taktil_contact::layer::Layer;
use taktil_mechanics::Pose;
use taktil_mechanics::rigid_body::GRAVITY_M_S2;
use taktil_mechanics::spatial::{JointVector, rotation_x, rotation_y, rotation_z};
use taktil_rtcore::Payload;
use taktil_rtcore::record::{Catalog, Observer, Record};
use taktil_signal::{Features, JOINTS_MAX, defined};
use taktil_sim::scene::{RubberConfig, WorldConfig};

use taktil_machine::robot::AnyRobot;

use glam::DVec3;
use taktil_lab_scene::score::{Figures, Score, Spread, Targets};
use taktil_lab_world::{WorldTruth, decode_truth, joint_list, truth_joints};

/// Fraction of the force's set point from which on the finger counts as pressing.
const PRESSED_FORCE_SHARE: f64 = 0.9;
/// Time from the first press to the begin of the evaluation, s.
const EVALUATION_DELAY_S: f64 = 1.0;
/// A force counts as settled when its average over about 50 ms stays within this fraction of its
/// set point for [`SETTLING_HOLD_S`].
const SETTLING_BAND_SHARE: f64 = 0.1;
/// Time for which the force has to stay there, s.
const SETTLING_HOLD_S: f64 = 0.5;
/// Number of jobs of the world per sample of a trace.
const JOBS_PER_SAMPLE: u64 = 4;

/// Names of the columns of a [`Trace`] after its time.
pub const TRACE_COLUMNS: [&str; 13] = [
    "x_c", "p_x", "p_z", "theta_xx", "theta_zz", "m0", "theta_z", "force", "yaw", "tilt", "height",
    "pan", "m_x",
];

/// Samples over time, for drawing.
#[derive(Clone, Debug, Default)]
pub struct Trace {
    /// Instants, s.
    pub t_s: Vec<f64>,
    /// Columns in the order of [`TRACE_COLUMNS`].
    pub columns: [Vec<f64>; TRACE_COLUMNS.len()],
}

/// Errors of one run.
#[derive(Clone, Debug, Default)]
pub struct Evaluation {
    /// The figures of every run.
    pub figures: Figures,
    /// True normal force minus set point, N.
    pub force_n: Spread,
    /// Compression of pin and rubbers minus the compression at the set point, mm.
    pub height_mm: Spread,
    /// Rotation of the finger against the pin about the sensor's x, deg.
    pub tilt_deg: Spread,
    /// Yaw of the pin on the sensor, deg: the lag behind a table that rotates.
    pub yaw_deg: Spread,
    /// Measured theta_z minus true yaw, deg.
    pub theta_z_noise_deg: Spread,
    /// Measured theta_z, deg.
    pub theta_z_deg: Spread,
    /// Measured position of the contact minus the true one, mm.
    pub place_mm: Spread,
    /// Norm of the applied joint torques, N m.
    pub torque_nm: Spread,
    /// Change of the applied torques from one job to the next, N m.
    pub torque_change_nm: Spread,
    /// Time from the first contact until the force stays near its set point for half a second, s.
    pub settling_s: Option<f64>,
    /// Ratio of the finger's rotation about z0 to the table's, from the slopes over the last two
    /// seconds of its motion; absent when the table does not rotate.
    pub pan_rate_share: Option<f64>,
    /// Samples, if they were requested.
    pub trace: Trace,
}

/// Observes a run and evaluates it.
pub struct Evaluator {
    score: Score,
    truth: Option<usize>,
    features: Option<usize>,
    applied: Option<usize>,
    robot: AnyRobot,
    set_point_n: f64,
    /// Distance of neighbouring columns (mm).
    pitch_x_mm: f64,
    expected_compression_mm: f64,
    traced: bool,
    latest_features: Option<Features>,
    last: Option<WorldTruth>,
    torque: Option<JointVector<JOINTS_MAX>>,
    first_contact_s: Option<f64>,
    in_band_since_s: Option<f64>,
    pressed_since_s: Option<f64>,
    settled_since_s: Option<f64>,
    smooth_n: f64,
    pan: PanTracking,
    jobs: u64,
    verdict: Evaluation,
}

/// Sums of a straight line through (rotation of the table, rotation of the finger) while the table
/// moves.
#[derive(Clone, Copy, Default)]
struct PanTracking {
    last: f64,
    from: Option<(f64, f64)>,
    to: (f64, f64),
}

/// Compression (mm) of a rubber under a line load on a cylinder.
fn compression_mm(rubber: &RubberConfig, radius_mm: f64, load_n_mm: f64) -> Option<f64> {
    let layer = Layer::new(rubber.thickness_mm, rubber.youngs_mpa, rubber.poisson).ok()?;
    let deepest = (0.2 * rubber.thickness_mm).min(0.4 * radius_mm);
    let contact = LineContact::new(&layer, radius_mm, deepest).ok()?;
    Some(contact.penetration_mm(load_n_mm))
}

impl Evaluator {
    /// An evaluator for the signals of a machine with this arm over this world; with samples for
    /// drawing when `traced`.
    #[must_use]
    pub fn new(
        catalog: &Catalog,
        targets: Targets,
        robot: &AnyRobot,
        world: &WorldConfig,
        traced: bool,
    ) -> Evaluator {
        let set_point_n = targets.m0 / targets.counts_per_n;
        let pitch_x_mm = targets.pitch_x_mm;
        let pin = &world.pin;
        let weight_n = pin.mass_kg * GRAVITY_M_S2;
        let on_pad = set_point_n / pin.length_mm.min(2e3 * world.tactile.geometry().half_y_m());
        let on_table = (set_point_n + weight_n) / pin.length_mm;
        let due = |rubber, load| compression_mm(rubber, pin.radius_mm, load).unwrap_or(0.0);
        Evaluator {
            score: Score::new(catalog, targets, robot.clone()),
            truth: catalog.find("world.truth"),
            features: catalog.find("tactile_servo.features"),
            applied: catalog.find("actuate.applied"),
            robot: robot.clone(),
            set_point_n,
            pitch_x_mm,
            expected_compression_mm: due(&world.finger.rubber, on_pad)
                + due(&world.table.rubber, on_table),
            traced,
            latest_features: None,
            last: None,
            torque: None,
            first_contact_s: None,
            in_band_since_s: None,
            pressed_since_s: None,
            settled_since_s: None,
            smooth_n: 0.0,
            pan: PanTracking::default(),
            jobs: 0,
            verdict: Evaluation::default(),
        }
    }

    /// Ends the evaluation and returns its result.
    #[must_use]
    pub fn verdict(mut self) -> Evaluation {
        self.score.finish();
        let mut verdict = self.verdict;
        verdict.settling_s =
            self.settled_since_s.zip(self.first_contact_s).map(|(near, first)| near - first);
        verdict.pan_rate_share = self.pan.from.and_then(|(table, finger)| {
            let run = self.pan.to.0 - table;
            (run.abs() > 0.02).then(|| (self.pan.to.1 - finger) / run)
        });
        verdict.figures = self.score.figures;
        verdict
    }

    fn truth(&mut self, truth: &WorldTruth, pose: &Pose) {
        let t_s = truth.t_ns as f64 * 1e-9;
        let force = truth.finger_normal_n - self.set_point_n;
        let active =
            self.latest_features.is_some_and(|latest_features| latest_features.active != 0);
        if active && truth.in_contact != 0 {
            self.first_contact_s.get_or_insert(t_s);
        }
        self.update_settling(t_s, truth.finger_normal_n);
        let x = pose.rotation.x_axis;
        self.track_pan(truth, libm::atan2(-x.y, -x.x));
        let height = self.height_mm(truth, pose.rotation.z_axis);
        let judged =
            active && self.pressed_since_s.is_some_and(|from| t_s >= from + EVALUATION_DELAY_S);
        if judged {
            let verdict = &mut self.verdict;
            verdict.force_n.add(force);
            verdict.height_mm.add(height);
            verdict.tilt_deg.add(truth.pin_tilt_rad.to_degrees());
            verdict.yaw_deg.add(truth.pin_yaw_rad.to_degrees());
        }
        self.jobs += 1;
        if self.traced
            && self.pressed_since_s.is_some()
            && self.jobs.is_multiple_of(JOBS_PER_SAMPLE)
        {
            let z = pose.rotation.z_axis;
            let latest_features = self.latest_features.unwrap_or_default();
            let of = |bit: u32, value: f64| {
                if latest_features.defined & bit == 0 { f64::NAN } else { value }
            };
            let values = [
                of(defined::CENTROID, latest_features.x_c),
                pose.translation.x * 1e3,
                pose.translation.z * 1e3,
                positive_degrees(libm::atan2(x.y, x.x)),
                positive_degrees(libm::atan2(z.y, z.z)),
                latest_features.m0,
                of(defined::THETA_Z, latest_features.theta_z_rad.to_degrees()),
                truth.finger_normal_n,
                truth.pin_yaw_rad.to_degrees(),
                truth.pin_tilt_rad.to_degrees(),
                height,
                truth.table_pan_rad.to_degrees(),
                latest_features.m_x,
            ];
            self.verdict.trace.t_s.push(t_s);
            for (column, value) in self.verdict.trace.columns.iter_mut().zip(values) {
                column.push(value);
            }
        }
        self.last = Some(*truth);
    }

    fn update_settling(&mut self, t_s: f64, force_n: f64) {
        self.smooth_n += 0.05 * (force_n - self.smooth_n);
        let near =
            (self.smooth_n - self.set_point_n).abs() < SETTLING_BAND_SHARE * self.set_point_n;
        if force_n >= PRESSED_FORCE_SHARE * self.set_point_n && self.first_contact_s.is_some() {
            self.pressed_since_s.get_or_insert(t_s);
        }
        if self.settled_since_s.is_some() {
            return;
        }
        match (near, self.in_band_since_s) {
            (true, None) => self.in_band_since_s = Some(t_s),
            (true, Some(since)) if t_s - since > SETTLING_HOLD_S => {
                self.settled_since_s = Some(since)
            }
            (false, _) => self.in_band_since_s = None,
            _ => {}
        }
    }

    /// Adds the rotation of the finger while the table rotates.
    fn track_pan(&mut self, truth: &WorldTruth, turned: f64) {
        let pan = truth.table_pan_rad;
        if pan != self.pan.last && self.pressed_since_s.is_some() {
            self.pan.from.get_or_insert((pan, turned));
            self.pan.to = (pan, turned);
        }
        self.pan.last = pan;
    }

    fn height_mm(&self, truth: &WorldTruth, face: DVec3) -> f64 {
        let normal = rotation_z(truth.table_pan_rad)
            * rotation_y(-truth.table_tilt_y_rad)
            * rotation_x(truth.table_tilt_x_rad)
            * DVec3::Z;
        let [tool, pin] = [truth.tool_m, truth.pin_m].map(DVec3::from_array);
        let compressed = -truth.gap_m + (tool - pin).dot(normal) - (pin - tool).dot(face);
        compressed * 1e3 - self.expected_compression_mm
    }

    fn features(&mut self, features: &Features) {
        self.latest_features = Some(*features);
        let Some(truth) = self.last else { return };
        let judged = self
            .pressed_since_s
            .is_some_and(|from| truth.t_ns as f64 * 1e-9 >= from + EVALUATION_DELAY_S);
        if !judged || features.active == 0 || truth.in_contact == 0 {
            return;
        }
        let verdict = &mut self.verdict;
        if features.defined & defined::THETA_Z != 0 {
            let read = features.theta_z_rad.to_degrees();
            verdict.theta_z_deg.add(read);
            verdict.theta_z_noise_deg.add(read - truth.pin_yaw_rad.to_degrees());
        }
        if features.defined & defined::CENTROID != 0 {
            verdict.place_mm.add((features.x_c - truth.contact_x) * self.pitch_x_mm);
        }
    }

    fn applied(&mut self, torque: JointVector<JOINTS_MAX>) {
        let joints = self.robot.joints().min(JOINTS_MAX);
        if self.pressed_since_s.is_some() {
            self.verdict.torque_nm.add(torque.rows(0, joints).norm());
            if let Some(before) = self.torque {
                self.verdict.torque_change_nm.add((torque - before).rows(0, joints).norm());
            }
        }
        self.torque = Some(torque);
    }
}

/// Degrees from 0 to 360.
fn positive_degrees(radians: f64) -> f64 {
    let deg = radians.to_degrees();
    if deg < 0.0 { deg + 360.0 } else { deg }
}

impl Observer for Evaluator {
    fn record(&mut self, record: &Record<'_>) {
        self.score.record(record);
        let id = Some(record.signal);
        if id == self.truth {
            let joints = self.robot.joints();
            let q = truth_joints(record.body, joints);
            let pose = q.as_slice().get(..joints).and_then(|q| self.robot.tool_pose(q));
            let truth = decode_truth(record.body, joints, false);
            if let Some((truth, pose)) = truth.zip(pose) {
                self.truth(&truth, &pose);
            }
        } else if id == self.features {
            if let Some(features) = Features::decode(record.body) {
                self.features(&features);
            }
        } else if id == self.applied {
            self.applied(joint_list(record.body, 0, self.robot.joints()));
        }
    }
}
