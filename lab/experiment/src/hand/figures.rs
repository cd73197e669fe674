//! What is seen of a run with a hand: how far the object moved in the palm's frame, how far it was
//! lifted, margins and loads by touch and by the contacts, and faults.

use taktil_lab_world::HandTruth;
use taktil_machine::robot::AnyRobot;
use taktil_machine::with_robot;
use taktil_mechanics::Pose;
use taktil_mechanics::hand::Hand;
use taktil_mechanics::robot::Robot;
use taktil_mechanics::spatial::{JointVector, rotation_vector};
use taktil_rtcore::record::{Catalog, Observer, Record};
use taktil_rtcore::{FaultCode, FaultSet, Payload};
use taktil_signal::{ControlState, GraspState};

use super::{FINGER_COUNT, JUDGED_NS, LIFTED_SHARE_MIN, MOVED_MAX_MM, TURNED_MAX_DEG};

/// The truth of an instant.
struct ObjectTruth {
    t_ns: i64,
    /// Place and axes of the object in the palm's frame (m).
    in_palm: Pose,
    /// Height of its centre (mm).
    height_mm: f64,
    support_n: f64,
    normal_n: [f64; FINGER_COUNT],
    tangential_n: [f64; FINGER_COUNT],
    effort: [f64; FINGER_COUNT],
}

/// The truth in a record of the world of a hand.
fn truth_of<const F: usize, const N: usize>(
    robot: &Robot<N, Hand<F, N>>,
    body: &[u8],
) -> Option<ObjectTruth> {
    let truth = HandTruth::<N>::decode(body)?;
    let palm = robot.arm.palm(&JointVector::from(truth.q_rad)).pose;
    let axes = glam::DMat3::from_cols_array(&truth.object_axes);
    let object = Pose::new(axes, glam::DVec3::from_array(truth.object_m));
    Some(ObjectTruth {
        t_ns: truth.t_ns,
        in_palm: palm.inverse().compose(&object),
        height_mm: 1e3 * truth.object_m[2],
        support_n: truth.support_n,
        normal_n: truth.normal_n,
        tangential_n: truth.tangential_n,
        effort: truth.effort,
    })
}

/// What was seen of a run.
#[derive(Clone, Debug, Default)]
pub(super) struct HandFigures {
    faults: FaultSet,
    /// The first fault and when it was latched.
    pub(super) first_fault: Option<(FaultCode, i64)>,
    pub(super) grasped: bool,
    /// Height of the object on its support (mm).
    rest_mm: Option<f64>,
    /// Where the object was in the palm's frame when it began to be judged.
    start: Option<Pose>,
    /// How far it has been lifted (mm), and whether its support bears it.
    pub(super) lifted_mm: f64,
    is_supported: bool,
    pub(super) moved_mm: f64,
    pub(super) turned_deg: f64,
    /// Fingers that lost the object, summed over the instants at which one did.
    pub(super) losses: u32,
    touching: [bool; FINGER_COUNT],
    /// Smallest margin by touch (N), and the strongest grip that was wanted (N).
    pub(super) margin_n: f64,
    pub(super) grip_n: f64,
    /// The smallest margin of the contacts' true forces by the same coefficient of friction (N).
    pub(super) true_margin_n: Option<f64>,
    /// Largest share of the true cone.
    pub(super) effort: f64,
    /// When the margin first was negative, and when a contact first slid.
    pub(super) told_ns: Option<i64>,
    pub(super) slid_ns: Option<i64>,
}

impl HandFigures {
    /// Whether the object was held, and lifted by an arm that lifts it by so much (mm).
    pub(super) fn is_held(&self, lift_mm: Option<f64>) -> bool {
        let is_lifted = lift_mm.is_none_or(|lift_mm| {
            !self.is_supported && self.lifted_mm >= LIFTED_SHARE_MIN * lift_mm
        });
        self.grasped
            && is_lifted
            && self.faults.is_empty()
            && self.losses == 0
            && self.moved_mm <= MOVED_MAX_MM
            && self.turned_deg <= TURNED_MAX_DEG
    }

    /// Takes the truth of an instant; `friction` is the coefficient that the law counts on.
    fn truth(&mut self, truth: &ObjectTruth, friction: f64) {
        let touching = truth.normal_n.map(|normal| normal > 0.0);
        let rest_mm = *self.rest_mm.get_or_insert(truth.height_mm);
        if truth.t_ns < JUDGED_NS {
            self.touching = touching;
            return;
        }
        let from = *self.start.get_or_insert(truth.in_palm);
        let moved = truth.in_palm.translation - from.translation;
        self.moved_mm = self.moved_mm.max(1e3 * moved.length());
        let turned = rotation_vector(&from.rotation, &truth.in_palm.rotation).length();
        self.turned_deg = self.turned_deg.max(turned.to_degrees());
        (self.lifted_mm, self.is_supported) = (truth.height_mm - rest_mm, truth.support_n > 0.0);
        for (was, is) in self.touching.iter().zip(&touching) {
            self.losses += u32::from(*was && !is);
        }
        self.touching = touching;
        let margins = truth.normal_n.iter().zip(&truth.tangential_n);
        let least = margins.map(|(n, t)| friction * n - t).fold(f64::INFINITY, f64::min);
        self.true_margin_n = Some(self.true_margin_n.map_or(least, |before| before.min(least)));
        let most = truth.effort.iter().copied().fold(0.0, f64::max);
        self.effort = self.effort.max(most);
        if most > 1.0 {
            self.slid_ns.get_or_insert(truth.t_ns);
        }
    }

    fn control(&mut self, t_ns: i64, control: &ControlState) {
        self.faults = FaultSet(self.faults.0 | control.faults);
        let first = u16::try_from(control.first_fault).ok().and_then(FaultCode::from_code);
        self.first_fault = self.first_fault.or(first.map(|fault| (fault, t_ns)));
    }

    fn grasp(&mut self, state: &GraspState) {
        const HOLDING_PHASE: u32 = taktil_tasks_grasp::law::Phase::Holding as u32;
        if state.at_ns < JUDGED_NS || state.phase != HOLDING_PHASE {
            return;
        }
        self.margin_n = match self.grasped {
            true => self.margin_n.min(state.least_margin_n),
            false => state.least_margin_n,
        };
        self.grasped = true;
        self.grip_n = self.grip_n.max(state.grip_n);
        if state.beyond != 0 {
            self.told_ns.get_or_insert(state.at_ns);
        }
    }
}

/// Judges a run from its records.
pub(super) struct HandEvaluation<'a> {
    robot: &'a AnyRobot,
    /// Coefficient of friction that the law counts on.
    friction: f64,
    truth: Option<usize>,
    grasp: Option<usize>,
    control: Option<usize>,
    pub(super) verdict: HandFigures,
}

impl<'a> HandEvaluation<'a> {
    pub(super) fn new(robot: &'a AnyRobot, catalog: &Catalog, friction: f64) -> HandEvaluation<'a> {
        HandEvaluation {
            robot,
            friction,
            truth: catalog.find("world.truth"),
            grasp: catalog.find("grasp.state"),
            control: catalog.find("supervisor.control"),
            verdict: HandFigures::default(),
        }
    }
}

impl Observer for HandEvaluation<'_> {
    fn record(&mut self, record: &Record<'_>) {
        let id = Some(record.signal);
        if id == self.truth {
            let truth = with_robot!(self.robot,
                puma260: _robot => None,
                chain: _robot => None,
                hand: robot => truth_of(robot, record.body)
            );
            if let Some(truth) = truth {
                self.verdict.truth(&truth, self.friction);
            }
        } else if id == self.grasp {
            if let Some(state) = GraspState::decode(record.body) {
                self.verdict.grasp(&state);
            }
        } else if id == self.control
            && let Some(control) = ControlState::decode(record.body)
        {
            self.verdict.control(record.release.0, &control);
        }
    }
}
