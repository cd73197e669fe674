//! Evaluates a run: strokes, ranges, errors of the features from their set points, and the
//! simulator's truth. Everything is computed from the passing records, in constant memory, in the
//! order of their releases: a live run and one in virtual time have the same figures. A figure
//! without a sample is absent, not zero.

use taktil_lab_world::{LayerTruth, WorldTruth, decode_truth, truth_is_of_free_arm, truth_of_hand};
use taktil_rtcore::payload::FieldType;
use taktil_rtcore::record::{Catalog, Observer, Record};
use taktil_rtcore::{FaultSet, Mode, Payload};
use taktil_signal::{ControlState, Features, MoveCheck, PhaseChange, State, defined};

use taktil_machine::robot::AnyRobot;
use taktil_machine::with_robot;

use super::release_order::{KeptRecord, ReleaseOrder};

/// Fraction of the force's set point from which on a run counts as rolling.
const PRESSED_FORCE_SHARE: f64 = 0.9;
/// Time after the entry of a state from which on its holding error is evaluated, ns.
const SETTLING_NS: i64 = 500_000_000;

/// Smallest and largest value.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Span(pub Option<(f64, f64)>);

impl Span {
    /// Adds a value.
    pub fn add(&mut self, value: f64) {
        let (low, high) = self.0.unwrap_or((value, value));
        self.0 = Some((low.min(value), high.max(value)));
    }

    /// Largest minus smallest.
    #[must_use]
    pub fn width(&self) -> Option<f64> {
        self.0.map(|(low, high)| high - low)
    }
}

/// Mean, root mean square, peak and the last value of an error.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spread {
    n: u64,
    sum: f64,
    squares: f64,
    peak: f64,
    recent: f64,
}

/// Weight of a new value in the slow average for the steady state; it corresponds to a second of a
/// lane at 400 Hz.
const STEADY_STATE_WEIGHT: f64 = 1.0 / 400.0;

impl Spread {
    /// Adds a value.
    pub fn add(&mut self, value: f64) {
        self.recent +=
            if self.n == 0 { value } else { (value - self.recent) * STEADY_STATE_WEIGHT };
        self.n += 1;
        self.sum += value;
        self.squares += value * value;
        self.peak = self.peak.max(value.abs());
    }

    fn of(&self, value: f64) -> Option<f64> {
        (self.n > 0).then_some(value)
    }

    /// Mean.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "counts of samples")]
    pub fn mean(&self) -> Option<f64> {
        self.of(self.sum / self.n.max(1) as f64)
    }

    /// Root mean square.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "counts of samples")]
    pub fn rms(&self) -> Option<f64> {
        self.of((self.squares / self.n.max(1) as f64).sqrt())
    }

    /// Largest magnitude.
    #[must_use]
    pub fn peak(&self) -> Option<f64> {
        self.of(self.peak)
    }

    /// Average over about the last 400 values.
    #[must_use]
    pub fn steady(&self) -> Option<f64> {
        self.of(self.recent)
    }
}

/// Set points of the features, and the scale of the electronics.
#[derive(Clone, Debug, PartialEq)]
pub struct Targets {
    /// Desired sum of counts.
    pub m0: f64,
    /// Counts that one newton makes.
    pub counts_per_n: f64,
    /// Distance of neighbouring columns, mm.
    pub pitch_x_mm: f64,
    /// Distance of neighbouring rows, mm.
    pub pitch_y_mm: f64,
    /// True when there is a pin, so that its truth is valid.
    pub pin: bool,
    /// Torque per angle of a servo without a gravity term, N m/rad; absent with a gravity term.
    pub plain_kp_nm_rad: Option<Vec<f64>>,
    /// Names of the phases of the touch task; empty without one.
    pub phase_names: Vec<String>,
}

/// Changes of phase that are kept.
const PHASE_CHANGES_MAX: usize = 200;

/// All figures of a run.
#[derive(Clone, Debug, Default)]
pub struct Figures {
    /// Reversals of the rolling direction.
    pub strokes: u32,
    /// Measured centroid in column numbers while rolling.
    pub x_c: Span,
    /// Distance of neighbouring columns, mm.
    pub pitch_x_mm: f64,
    /// Finger position along x0 and z0 while rolling, mm, from the encoders.
    pub p_x_mm: Span,
    /// Along z0.
    pub p_z_mm: Span,
    /// Angle of the sensor's x axis about z0 while rolling, deg, in [0, 360).
    pub theta_xx_deg: Span,
    /// Angle of the sensor's z axis about x0 while rolling, deg, in [0, 360).
    pub theta_zz_deg: Span,
    /// M0 while rolling.
    pub m0: Spread,
    /// M0 minus its set point.
    pub m0_error: Spread,
    /// Centroid minus the pin's contact line on the sensor, tactels.
    pub x_c_error: Spread,
    /// M_x, whose set point is 0.
    pub m_x_error: Spread,
    /// theta_z, whose set point is 0, deg.
    pub theta_z_error_deg: Spread,
    /// True normal force, N.
    pub force_n: Spread,
    /// True force minus its set point.
    pub force_error_n: Spread,
    /// True yaw of the pin on the sensor, deg.
    pub yaw_error_deg: Spread,
    /// True tilt of the finger against the pin, deg.
    pub tilt_error_deg: Spread,
    /// True compression minus its mean, mm: see [`Figures::height_error_mm`].
    pub gap_mm: Spread,
    gap_span_mm: Span,
    /// Largest sliding speed at either side of the pin while rolling, mm/s; absent without a pin.
    pub slip_mm_s: Option<f64>,
    /// How often the finger lost contact while rolling.
    pub contact_lost: u32,
    /// Desired minus measured angle per joint while torque was allowed, deg.
    pub tracking_deg: Vec<Spread>,
    /// True tool point minus the desired one while holding in IDLE/CALIBRATED, mm.
    pub hold_error_mm: Spread,
    /// Desired minus measured angle per joint while holding, deg.
    pub hold_error_deg: Vec<Spread>,
    /// Expected deflection of a plain PD servo while holding: gravity torque over Kp, deg; absent
    /// with a gravity term or without holding.
    pub droop_expected_deg: Option<Vec<f64>>,
    /// Latched faults at the end.
    pub faults: FaultSet,
    /// The first fault's code.
    pub first_fault: u32,
    /// Requests that the supervisor refused.
    pub refused: u32,
    /// State of the machine at the end.
    pub state: State,
    /// Names of the joints.
    pub names: Vec<String>,
    /// The last check of the queue of moves.
    pub moves: Option<MoveCheck>,
    /// The first changes of phase of the touch task.
    pub phases: Vec<PhaseChange>,
    /// Names of its phases.
    pub phase_names: Vec<String>,
    /// Contacts solved in three dimensions, and contacts for which that failed; absent where the
    /// scene does not request it.
    pub layer: Option<(u64, u64)>,
    /// True when the arm was controlled by touch at some time.
    pub touched: bool,
    /// True when the force reached its set point, so that rolling took place.
    pub rolled: bool,
}

impl Figures {
    /// Root mean square and peak of the finger's height about its mean, mm.
    #[must_use]
    pub fn height_error_mm(&self) -> Option<(f64, f64)> {
        let (mean, rms) = (self.gap_mm.mean()?, self.gap_mm.rms()?);
        let (low, high) = self.gap_span_mm.0?;
        Some(((rms * rms - mean * mean).max(0.0).sqrt(), (high - mean).max(mean - low)))
    }
}

struct Ids {
    features: Option<usize>,
    joints: Option<usize>,
    desired: Option<usize>,
    torque: Option<usize>,
    control: Option<usize>,
    truth: Option<usize>,
    check: Option<usize>,
    layer: Option<usize>,
    phase: Option<usize>,
}

impl Ids {
    /// Those that the machine has.
    fn all(&self) -> Vec<usize> {
        let Ids { features, joints, desired, torque, control, truth, check, layer, phase } = *self;
        [features, joints, desired, torque, control, truth, check, layer, phase]
            .into_iter()
            .flatten()
            .collect()
    }
}

/// Observes records and computes [`Figures`].
pub struct Score {
    ids: Ids,
    targets: Targets,
    robot: AnyRobot,
    /// The truth is that of an arm that touches nothing.
    moves_freely: bool,
    control: ControlState,
    order: ReleaseOrder,
    desired: Option<Vec<f64>>,
    truth: Option<WorldTruth>,
    active: bool,
    holding: bool,
    /// The figures so far.
    pub figures: Figures,
}

impl Score {
    /// A score for the signals of a machine with this arm.
    #[must_use]
    pub fn new(catalog: &Catalog, targets: Targets, robot: AnyRobot) -> Score {
        let joints = robot.joints();
        let figures = Figures {
            tracking_deg: vec![Spread::default(); joints],
            hold_error_deg: vec![Spread::default(); joints],
            pitch_x_mm: targets.pitch_x_mm,
            phase_names: targets.phase_names.clone(),
            names: (0..joints).map(|joint| robot.joint_label(joint)).collect(),
            ..Figures::default()
        };
        let ids = Ids {
            features: catalog.find("tactile_servo.features"),
            joints: catalog.find("sense.joints"),
            desired: catalog.find("setpoint.desired"),
            torque: catalog.find("joint_servo.torque"),
            control: catalog.find("supervisor.control"),
            truth: catalog.find("world.truth"),
            check: catalog.find("trajectory.check"),
            layer: catalog.find("world.layer"),
            phase: catalog.find("tactile_servo.phase"),
        };
        Score {
            order: ReleaseOrder::new(catalog, &ids.all()),
            ids,
            targets,
            robot,
            moves_freely: truth_is_of_free_arm(catalog),
            control: ControlState::default(),
            desired: None,
            truth: None,
            active: false,
            holding: false,
            figures,
        }
    }

    /// The list number `index` of a payload that begins with lists of one number for each joint.
    fn list(&self, body: &[u8], index: usize) -> Vec<f64> {
        let (joints, size) = (self.robot.joints(), f64::KIND.size());
        let numbers = body.chunks_exact(size).skip(index * joints).take(joints);
        numbers.map(f64::read_le).collect()
    }

    /// The simulator's truth; for an arm without contact and for a hand, the position of its tool.
    fn truth_of(&self, body: &[u8]) -> Option<WorldTruth> {
        let of_arm = || decode_truth(body, self.robot.joints(), self.moves_freely);
        with_robot!(&self.robot,
            puma260: _robot => of_arm(),
            chain: _robot => of_arm(),
            hand: robot => truth_of_hand(robot, body)
        )
    }

    fn rolling(&self) -> bool {
        self.active && self.figures.rolled
    }

    fn features(&mut self, features: &Features) {
        self.active = features.active != 0;
        self.figures.touched |= self.active;
        let contact = features.defined & defined::CONTACT != 0;
        if !self.active || !contact {
            return;
        }
        let figures = &mut self.figures;
        figures.rolled |= features.m0 >= PRESSED_FORCE_SHARE * self.targets.m0;
        if !figures.rolled {
            return;
        }
        figures.strokes = features.reversals;
        figures.m0.add(features.m0);
        figures.m0_error.add(features.m0 - self.targets.m0);
        figures.m_x_error.add(features.m_x);
        if features.defined & defined::CENTROID != 0 {
            figures.x_c.add(features.x_c);
            let pin = self.targets.pin;
            if let Some(truth) = self.truth.filter(|truth| pin && truth.in_contact != 0) {
                figures.x_c_error.add(features.x_c - truth.contact_x);
            }
        }
        if features.defined & defined::THETA_Z != 0 {
            figures.theta_z_error_deg.add(features.theta_z_rad.to_degrees());
        }
    }

    fn joints(&mut self, body: &[u8]) {
        if !self.rolling() {
            return;
        }
        let Some(tool) = self.robot.tool_pose(&self.list(body, 0)) else { return };
        let circle = |radians: f64| {
            let deg = radians.to_degrees();
            if deg < 0.0 { deg + 360.0 } else { deg }
        };
        let (x, z) = (tool.rotation.x_axis, tool.rotation.z_axis);
        let figures = &mut self.figures;
        figures.p_x_mm.add(tool.translation.x * 1e3);
        figures.p_z_mm.add(tool.translation.z * 1e3);
        figures.theta_xx_deg.add(circle(libm::atan2(x.y, x.x)));
        figures.theta_zz_deg.add(circle(libm::atan2(z.y, z.z)));
    }

    fn truth(&mut self, truth: WorldTruth) {
        let before = self.truth.replace(truth);
        if self.rolling() {
            let set_point_n = self.targets.m0 / self.targets.counts_per_n;
            let figures = &mut self.figures;
            figures.force_n.add(truth.finger_normal_n);
            figures.force_error_n.add(truth.finger_normal_n - set_point_n);
            if self.targets.pin {
                figures.yaw_error_deg.add(truth.pin_yaw_rad.to_degrees());
                figures.tilt_error_deg.add(truth.pin_tilt_rad.to_degrees());
                figures.gap_mm.add(truth.gap_m * 1e3);
                figures.gap_span_mm.add(truth.gap_m * 1e3);
                let slip = truth.finger_slip_m_s.max(truth.table_slip_m_s) * 1e3;
                figures.slip_mm_s = Some(figures.slip_mm_s.unwrap_or(0.0).max(slip));
            }
            if before.is_some_and(|before| before.in_contact != 0) && truth.in_contact == 0 {
                figures.contact_lost += 1;
            }
        }
        let holding = self.control.state == State::IdleCalibrated as u32
            && self.control.mode() == Mode::Hold
            && truth.t_ns > self.control.entered_ns + SETTLING_NS;
        let desired = self.desired.as_ref().filter(|_| holding);
        if let Some(wanted) = desired.and_then(|desired| self.robot.tool_pose(desired)) {
            let wanted = wanted.translation;
            let found = glam::DVec3::from_array(truth.tool_m);
            self.figures.hold_error_mm.add((found - wanted).length() * 1e3);
        }
        self.holding = holding;
    }

    fn torque(&mut self, body: &[u8]) {
        let error = self.list(body, 1);
        if let (true, Some(desired)) = (self.holding, &self.desired) {
            for (spread, error) in self.figures.hold_error_deg.iter_mut().zip(&error) {
                spread.add(error.to_degrees());
            }
            if let Some(kp) = &self.targets.plain_kp_nm_rad {
                let stands: Vec<f64> = desired.iter().zip(&error).map(|(q, e)| q - e).collect();
                let gravity = self.robot.gravity_nm(&stands).unwrap_or_default();
                let droop = gravity.iter().zip(kp).map(|(nm, kp)| (nm / kp).to_degrees());
                self.figures.droop_expected_deg = Some(droop.collect());
            }
        }
        if self.control.mode().brakes_released() {
            for (spread, error) in self.figures.tracking_deg.iter_mut().zip(&error) {
                spread.add(error.to_degrees());
            }
        }
    }

    fn control(&mut self, control: ControlState) {
        self.control = control;
        self.figures.faults = FaultSet(control.faults);
        self.figures.first_fault = control.first_fault;
        self.figures.refused = control.refused;
        self.figures.state = State::from_code(control.state).unwrap_or_default();
    }

    /// Takes in what waits for records of other lanes: the run is over.
    pub fn finish(&mut self) {
        while let Some(record) = self.order.pop_last() {
            self.take(&record);
        }
    }

    fn take(&mut self, record: &KeptRecord) {
        let (id, body) = (Some(record.signal), record.body.as_slice());
        if id == self.ids.truth {
            if let Some(truth) = self.truth_of(body) {
                self.truth(truth);
            }
        } else if id == self.ids.joints {
            self.joints(body);
        } else if id == self.ids.desired {
            self.desired = Some(self.list(body, 0));
        } else if id == self.ids.torque {
            self.torque(body);
        } else if id == self.ids.control {
            if let Some(control) = ControlState::decode(body) {
                self.control(control);
            }
        } else if id == self.ids.check {
            self.figures.moves = MoveCheck::decode(body);
        } else if id == self.ids.phase {
            let room = self.figures.phases.len() < PHASE_CHANGES_MAX;
            self.figures.phases.extend(PhaseChange::decode(body).filter(|_| room));
        } else if id == self.ids.layer {
            let layer = LayerTruth::decode(body);
            self.figures.layer =
                layer.map(|layer| (layer.spatial_solutions, layer.spatial_failures));
        } else if id == self.ids.features
            && let Some(features) = Features::decode(body)
        {
            self.features(&features);
        }
    }
}

impl Observer for Score {
    fn record(&mut self, record: &Record<'_>) {
        self.order.push(record);
        while let Some(record) = self.order.pop() {
            self.take(&record);
        }
    }
}

#[cfg(test)]
mod tests;
