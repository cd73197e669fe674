//! The position servo of the joints at 400 Hz: PD on the error between desired and measured angles,
//! with the torque against gravity as an option. Refuses to ask for torque while the mode does not
//! allow any, while nothing is desired, or when a number is not finite; refuses limits, which are
//! `actuate`'s.
//!
//! The filter of the rate is forgotten while the servo is idle and when the zero of the joints
//! moves, so that neither shows up as a rate.

pub mod config;
pub mod law;

pub use config::Config;

use law::Pd;
use taktil_mechanics::Joints;
use taktil_mechanics::dynamics::Dynamics;
use taktil_rtcore::{Cycle, FaultCode, Input, Invalid, Io, Mode, Output, Ports, Task};
use taktil_signal::{ControlState, Desired, JointState, Torque};

/// Time over which the gravity term comes in when the joints become calibrated under torque (s).
const GRAVITY_RAMP_S: f64 = 0.25;

/// The task.
pub struct JointServo {
    desired: Input<Desired>,
    joints: Input<JointState>,
    control: Input<ControlState>,
    torque: Output<Torque>,
    law: Pd,
    dynamics: Option<Dynamics>,
    assumed: Option<Joints>,
    gravity_share: f64,
    datum: u32,
}

impl JointServo {
    /// Declares `desired`, `joints`, `control` and `torque`.
    ///
    /// # Errors
    /// What [`Config::check`] refuses.
    pub fn new(config: Config, ports: &mut Ports) -> Result<JointServo, Invalid> {
        config.check()?;
        let dynamics = Dynamics::reference();
        Ok(JointServo {
            desired: ports.input("desired"),
            joints: ports.input("joints"),
            control: ports.input("control"),
            torque: ports.output("torque"),
            law: Pd::new(config.gains(&dynamics), config.derivative_filter_hz),
            dynamics: config.gravity.then_some(dynamics),
            assumed: config.assumed_pose_deg.map(|deg| Joints::from(deg.map(f64::to_radians))),
            gravity_share: 0.0,
            datum: 0,
        })
    }

    /// The gravity term (N m): all of it when the servo starts calibrated or from an assumed pose,
    /// ramped in when the joints become calibrated under torque, none before.
    fn gravity_nm(&mut self, q_desired: &Joints, calibrated: bool, dt_s: f64) -> Joints {
        let q = match self.assumed {
            _ if calibrated => Some(*q_desired),
            Some(pose) => Some(pose + q_desired),
            None => None,
        };
        let (Some(dynamics), Some(q)) = (&self.dynamics, q) else {
            self.gravity_share = 0.0;
            return Joints::zeros();
        };
        self.gravity_share = (self.gravity_share + dt_s / GRAVITY_RAMP_S).min(1.0);
        dynamics.gravity(&q) * self.gravity_share
    }

    fn rest(&mut self, calibrated: bool) {
        self.law.reset();
        self.gravity_share = if calibrated || self.assumed.is_some() { 1.0 } else { 0.0 };
    }
}

impl Task for JointServo {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        let control = io.read(&self.control).usable();
        let desired = io.read(&self.desired).usable().filter(|desired| desired.valid == 1);
        let joints = io.read(&self.joints).usable();
        let allowed = control
            .and_then(|control| Mode::from_code(u8::try_from(control.mode).ok()?))
            .is_some_and(Mode::torque_allowed);
        let calibrated = joints.is_some_and(|joints| joints.calibrated == 1);
        let mut out = Torque { tau_nm: [0.0; 6], error_rad: [0.0; 6] };
        let (Some(desired), Some(joints)) = (desired, joints) else {
            self.rest(calibrated);
            io.write(&self.torque, out);
            return Ok(());
        };
        if joints.datum != self.datum {
            self.datum = joints.datum;
            self.law.reset();
        }
        let goal = Joints::from(desired.q_rad);
        let error = goal - Joints::from(joints.q_rad);
        if error.iter().all(|x| x.is_finite()) {
            out.error_rad = error.into();
        }
        if !allowed {
            self.rest(calibrated);
            io.write(&self.torque, out);
            return Ok(());
        }
        let dt_s = cycle.dt.as_secs_f64();
        let gravity = self.gravity_nm(&goal, calibrated, dt_s);
        let torque = self.law.torque_nm(&error, dt_s).map(|torque| torque + gravity);
        let finite = torque.filter(|torque| torque.iter().all(|x| x.is_finite()));
        out.tau_nm = finite.map_or([0.0; 6], Into::into);
        io.write(&self.torque, out);
        finite.map(|_| ()).ok_or(FaultCode::NotFinite)
    }

    fn stop(&mut self) {
        self.law.reset();
    }
}
