//! Whether the law drives the arm, and the goal that follows from it. A law that could not take the
//! arm over says that it is done.

use taktil_mechanics::spatial::JointVector;
use taktil_rtcore::Payload;
use taktil_signal::Goal;

use crate::encoder_hold::Drift;
use crate::joint_integrator::JointIntegrator;

/// Whether the law drives the arm.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Activation<const N: usize> {
    /// The machine is in another state.
    Inactive,
    /// The law drives, from joints with this datum.
    Active { integrator: JointIntegrator<N>, datum: u32, drift: Drift },
    /// The law could not take the arm over, or the zero of the joints moved.
    Refused,
}

impl<const N: usize> Activation<N> {
    /// The goal of the next job of `dt_s` seconds; `is_ended` says whether the law has nothing left
    /// to do.
    pub(crate) fn next_goal(&mut self, dt_s: f64, is_ended: bool) -> Goal<N> {
        match self {
            Activation::Inactive => Goal::ZERO,
            Activation::Refused => Goal { done: 1, ..Goal::ZERO },
            Activation::Active { integrator, .. } => {
                let (q, step) = integrator.advance();
                let qd = if dt_s > 0.0 { step / dt_s } else { JointVector::zeros() };
                let done = u32::from(is_ended);
                Goal { q_rad: q.into(), qd_rad_s: qd.into(), valid: 1, done }
            }
        }
    }
}
