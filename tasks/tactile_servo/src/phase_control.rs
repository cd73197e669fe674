//! Carries a task in phases through the jobs of the servo: gives the state machine what the images,
//! the wrist and the test for slip say, makes its motions, and reports what it does. An image is
//! taken into account before the law answers it, so that a phase begins with the image that led to
//! it.

use taktil_mechanics::arm::Arm;
use taktil_rtcore::{Cycle, FaultCode, Fold, Io, Output, Ports, StateHash};
use taktil_signal::{Contact, JointState, PhaseChange, Slip, Wrench};

use crate::TactileServo;
use crate::activation::Activation;
use crate::config::Config;
use crate::config::law_name::LawName;
use crate::law::phases::Sensed;

/// What a task in phases goes by besides the features, and its port.
pub(crate) struct PhasePorts {
    phase: Output<PhaseChange>,
    /// Speed of slip (mm/s) while it is detected.
    slip_mm_s: Option<f64>,
    /// Force along the finger's z by the wrist (N), while it is known.
    wrist_n: Option<f64>,
    /// The state machine was advanced in this job already.
    is_advanced: bool,
}

impl Fold for PhasePorts {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.slip_mm_s).add(&self.wrist_n);
    }
}

impl PhasePorts {
    /// Declares `phase` for the law `phases`.
    pub(crate) fn new(config: &Config, ports: &mut Ports) -> Option<PhasePorts> {
        (config.law == LawName::Phases).then(|| PhasePorts {
            phase: ports.output("phase"),
            slip_mm_s: None,
            wrist_n: None,
            is_advanced: false,
        })
    }

    pub(crate) fn begin_job(&mut self) {
        self.is_advanced = false;
    }

    /// Takes in what the test for slip says of an image.
    pub(crate) fn take_slip(&mut self, slip: &Slip) {
        let [x, y] = slip.velocity_mm_s;
        self.slip_mm_s = (slip.detected == 1).then(|| (x * x + y * y).sqrt());
    }

    /// Takes in the newest wrench.
    pub(crate) fn take_wrench(&mut self, wrench: Option<&Wrench>) {
        let known = wrench.filter(|wrench| wrench.is_known());
        self.wrist_n = known.map(|wrench| -wrench.force_n[2]);
    }
}

impl<const N: usize, A: Arm<N>> TactileServo<N, A> {
    /// Advances a task in phases by a job whose image has just come; nothing with another law.
    pub(crate) fn advance_phases_with_image(&mut self, cycle: &Cycle, io: &mut Io<'_>) {
        if self.phases.is_some() && matches!(self.activation, Activation::Active { .. }) {
            self.control_features = self.image_features;
            self.advance_phases(cycle, io);
        }
    }

    fn advance_phases(&mut self, cycle: &Cycle, io: &mut Io<'_>) {
        let (Some(ports), Some(law)) = (&mut self.phases, self.law.phases_mut()) else { return };
        let sensed = Sensed {
            touch: &self.control_features,
            slip_mm_s: ports.slip_mm_s,
            wrist_n: ports.wrist_n,
        };
        let events = law.advance(&sensed, cycle.dt.as_secs_f64());
        ports.is_advanced = true;
        let at_ns = cycle.release.0;
        if let Some(contact) = events.contact {
            io.write(&self.contact, Contact { at_ns, ..contact });
        }
        if let Some(change) = events.change {
            io.write(&ports.phase, PhaseChange { at_ns, ..change });
        }
    }

    /// The step of one job of a task in phases: the motion of a phase without features.
    pub(crate) fn advance_phase_job(
        &mut self,
        joints: &JointState<N>,
        cycle: &Cycle,
        io: &mut Io<'_>,
    ) -> Result<(), FaultCode> {
        if self.phases.as_ref().is_some_and(|ports| !ports.is_advanced) {
            self.advance_phases(cycle, io);
        }
        if !self.control_features.trusted {
            return Ok(());
        }
        let dt_s = cycle.dt.as_secs_f64();
        let Some(step) = self.law.phases_mut().and_then(|law| law.unservoed_step(dt_s)) else {
            return Ok(());
        };
        let [x, _, z, theta_x, _, theta_z] = step;
        let share = self.add_displacement(&[x, z, theta_x, theta_z], joints, 1, dt_s);
        self.record_phase_motion(&step, share.unwrap_or(0.0));
        share.map(|_| ())
    }

    /// Tells a task in phases what was carried out of a step (mm, mrad).
    pub(crate) fn record_phase_motion(&mut self, step: &[f64; 6], share: f64) {
        if let Some(law) = self.law.phases_mut() {
            law.add_motion(step, share);
        }
    }
}
