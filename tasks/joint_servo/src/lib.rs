//! The task that servoes the joint positions: PD on the error between desired and measured angles,
//! with feed-forward torques against gravity and along the desired motion. Friction that is
//! learned, a rate observer and a notch filter are options. The task asks for no torque while the
//! mode does not allow any, while nothing is desired, and when a number is not finite. Torque
//! limits belong to `actuate`.
//!
//! - In: `desired`, `joints`, `control`.
//! - Out: `torque`.
//! - Rate: every job of the servo lane, 400 Hz.
//! - Source: PD with gravity compensation, M. Takegaki and S. Arimoto, "A new feedback method for
//!   dynamic control of manipulators", J. Dyn. Sys. Meas. Control 103, 1981.
//!
//! The task resets the filter of the rate while the servo is idle and when the zero of the joints
//! moves, so that neither appears as a rate.

pub mod config;
pub mod friction;
pub mod law;
pub mod notch;
pub mod observer;

pub use config::{Config, Tuning};

use friction::LearnedFriction;
use law::{FeedForward, Gains, Pd};
use taktil_mechanics::arm::{Arm, ArmDynamics};
use taktil_mechanics::puma260::dynamics::Dynamics;
use taktil_mechanics::robot::Robot;
use taktil_mechanics::spatial::JointVector;
use taktil_rtcore::{Cycle, FaultCode, Input, Invalid, Io, Output, Param, Ports, StateHash, Task};
use taktil_signal::{ControlState, Desired, JointState, Torque};

/// Time over which the gravity term comes in when the joints become calibrated under torque (s).
const GRAVITY_RAMP_S: f64 = 0.25;

/// Largest plausible torque of a joint (N m): a larger one means an error in the law. The limits of
/// the drives are much lower, and `actuate` applies them.
const TORQUE_PLAUSIBLE_MAX_NM: f64 = 1e4;

/// Whether a torque is plausible.
fn is_plausible<const N: usize>(torque: &Torque<N>) -> bool {
    torque.tau_nm.iter().all(|tau| tau.abs() <= TORQUE_PLAUSIBLE_MAX_NM)
}

/// The task.
pub struct JointServo<const N: usize = 6, L: ArmDynamics<N> = Dynamics> {
    desired: Input<Desired<N>>,
    joints: Input<JointState<N>>,
    control: Input<ControlState>,
    torque: Output<Torque<N>>,
    law: Pd<N>,
    feed_forward: FeedForward<N, L>,
    adaptive_friction: Option<LearnedFriction<N>>,
    dynamics: Option<L>,
    assumed: Option<JointVector<N>>,
    gravity_share: f64,
    datum: u32,
    parameters: Parameters<N>,
}

/// The parameters that may be edited while the servo runs: those by which the configuration gives
/// its gains.
struct Parameters<const N: usize> {
    tuning: Tuning<N>,
    stiffness: [Param; N],
    damping: [Param; N],
    filter: Param,
    /// Values when the parameters were read last.
    last_values: ([f64; N], [f64; N], f64),
}

impl<const N: usize> Parameters<N> {
    fn new(tuning: &Tuning<N>, ports: &mut Ports) -> Parameters<N> {
        let (stiffness_name, stiffness) = match tuning.kp_nm_rad {
            Some(kp) => ("kp_nm_rad", kp),
            None => ("bandwidth_rad_s", tuning.bandwidth_rad_s),
        };
        let (damping_name, damping) = match tuning.kd_nms_rad {
            Some(kd) => ("kd_nms_rad", kd),
            None => ("damping", tuning.damping),
        };
        Parameters {
            tuning: *tuning,
            stiffness: ports.tunables(stiffness_name, stiffness),
            damping: ports.tunables(damping_name, damping),
            filter: ports.tunable("derivative_filter_hz", tuning.filter_hz),
            last_values: (stiffness, damping, tuning.filter_hz),
        }
    }

    /// Gains and filter after an edit; nothing when there was none.
    fn changed(&mut self, io: &Io<'_>) -> Option<(Gains<N>, f64)> {
        let now = (
            io.parameters(&self.stiffness),
            io.parameters(&self.damping),
            io.parameter(self.filter),
        );
        if now == self.last_values {
            return None;
        }
        self.last_values = now;
        let tuning = &mut self.tuning;
        *tuning.kp_nm_rad.as_mut().unwrap_or(&mut tuning.bandwidth_rad_s) = now.0;
        *tuning.kd_nms_rad.as_mut().unwrap_or(&mut tuning.damping) = now.1;
        Some((tuning.gains(), now.2))
    }
}

impl<const N: usize, L: ArmDynamics<N>> JointServo<N, L> {
    /// Declares `desired`, `joints`, `control` and `torque`, and as parameters `bandwidth_rad_s` or
    /// `kp_nm_rad`, `damping` or `kd_nms_rad` (one a joint, whichever the gains are given by) and
    /// `derivative_filter_hz`.
    ///
    /// # Errors
    /// What [`Config::check`] and [`Config::tuning`] refuse.
    pub fn new<A: Arm<N, Dynamics = L>>(
        config: Config,
        robot: &Robot<N, A>,
        ports: &mut Ports,
    ) -> Result<JointServo<N, L>, Invalid> {
        config.check()?;
        let tuning = config.tuning(robot)?;
        let parameters = Parameters::new(&tuning, ports);
        let adaptive_friction = config.friction_learner(&tuning);
        let Config { friction, friction_speed_rad_s, acceleration, gravity, .. } = config;
        Ok(JointServo {
            desired: ports.input("desired"),
            joints: ports.input("joints"),
            control: ports.input("control"),
            torque: ports.output_within("torque", is_plausible),
            law: tuning.law(),
            feed_forward: FeedForward::new(
                robot.friction,
                robot.dynamics.clone(),
                friction,
                friction_speed_rad_s,
                acceleration,
            ),
            adaptive_friction,
            dynamics: gravity.then(|| robot.dynamics.clone()),
            assumed: tuning.assumed_rad,
            gravity_share: 0.0,
            datum: 0,
            parameters,
        })
    }

    /// The gravity term (N m): all of it when the servo starts calibrated or from an assumed pose,
    /// ramped in when the joints become calibrated under torque, none before.
    fn gravity_nm(
        &mut self,
        q_desired: &JointVector<N>,
        calibrated: bool,
        dt_s: f64,
    ) -> JointVector<N> {
        let q = match self.assumed {
            _ if calibrated => Some(*q_desired),
            Some(pose) => Some(pose + q_desired),
            None => None,
        };
        let (Some(dynamics), Some(q)) = (&self.dynamics, q) else {
            self.gravity_share = 0.0;
            return JointVector::zeros();
        };
        self.gravity_share = (self.gravity_share + dt_s / GRAVITY_RAMP_S).min(1.0);
        dynamics.gravity_torque(&q) * self.gravity_share
    }

    /// Forgets what was before.
    fn reset_past(&mut self) {
        self.law.reset();
        self.feed_forward.reset();
        if let Some(learned) = &mut self.adaptive_friction {
            learned.reset();
        }
    }

    fn reset_idle(&mut self, calibrated: bool) {
        self.reset_past();
        self.gravity_share = if calibrated || self.assumed.is_some() { 1.0 } else { 0.0 };
    }
}

impl<const N: usize, L: ArmDynamics<N>> Task for JointServo<N, L> {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        if let Some((gains, filter_hz)) = self.parameters.changed(io) {
            self.law.retune(gains, filter_hz);
        }
        let control = io.read(&self.control).usable();
        let desired = io.read(&self.desired).usable().filter(|desired| desired.valid == 1);
        let joints = io.read(&self.joints).usable();
        let allowed = control.is_some_and(|control| control.mode().torque_allowed());
        let calibrated = joints.is_some_and(|joints| joints.calibrated == 1);
        let mut out = Torque::<N>::default();
        let (Some(desired), Some(joints)) = (desired, joints) else {
            self.reset_idle(calibrated);
            io.write(&self.torque, out);
            return Ok(());
        };
        if joints.datum != self.datum {
            self.datum = joints.datum;
            self.reset_past();
        }
        let goal = JointVector::from(desired.q_rad);
        let measured = JointVector::from(joints.q_rad);
        let error = goal - measured;
        if error.iter().all(|x| x.is_finite()) {
            out.error_rad = error.into();
        }
        if !allowed {
            self.reset_idle(calibrated);
            io.write(&self.torque, out);
            return Ok(());
        }
        let dt_s = cycle.dt.as_secs_f64();
        let mut model = self.gravity_nm(&goal, calibrated, dt_s);
        if calibrated {
            model += self.feed_forward.torque_nm(&goal, &JointVector::from(desired.qd_rad_s), dt_s);
        }
        let mut torque = self.law.torque_nm(&error, dt_s);
        if let (Some(learned), Some(torque)) = (&mut self.adaptive_friction, &mut torque) {
            *torque += learned.torque_nm(&goal, dt_s);
            learned.learn(&measured, torque, dt_s);
        }
        let torque = torque.map(|torque| torque + model);
        let finite = torque.filter(|torque| torque.iter().all(|x| x.is_finite()));
        out.tau_nm = finite.map_or([0.0; N], Into::into);
        io.write(&self.torque, out);
        finite.map(|_| ()).ok_or(FaultCode::NotFinite)
    }

    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.law).add(&self.feed_forward).add(&self.gravity_share).add(&self.datum);
        if let Some(learned) = &self.adaptive_friction {
            hash.add(learned);
        }
    }

    fn stop(&mut self) {
        self.reset_past();
    }
}
