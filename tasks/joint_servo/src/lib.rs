//! The position servo of the joints at 400 Hz: PD on the error between desired and measured angles,
//! with the torques against gravity and along the desired motion as options. Refuses to ask for
//! torque while the mode does not allow any, while nothing is desired, or when a number is not
//! finite; refuses limits, which are `actuate`'s.
//!
//! The filter of the rate is forgotten while the servo is idle and when the zero of the joints
//! moves, so that neither shows up as a rate.

pub mod config;
pub mod law;
pub mod observer;

pub use config::Config;

use law::{Ahead, Gains, Pd};
use taktil_mechanics::Joints;
use taktil_mechanics::dynamics::Dynamics;
use taktil_rtcore::{
    Cycle, FaultCode, Input, Invalid, Io, Mode, Output, Param, Ports, StateHash, Task,
};
use taktil_signal::{ControlState, Desired, JointState, Torque};

/// Time over which the gravity term comes in when the joints become calibrated under torque (s).
const GRAVITY_RAMP_S: f64 = 0.25;

/// A torque beyond this at any joint is a mistake of the law and no wish of it (N m): what the
/// drives can do is `actuate`'s affair, and less.
const ABSURD_NM: f64 = 1e4;

/// A torque that a law can mean.
fn sound(torque: &Torque) -> bool {
    torque.tau_nm.iter().all(|tau| tau.abs() <= ABSURD_NM)
}

/// The task.
pub struct JointServo {
    desired: Input<Desired>,
    joints: Input<JointState>,
    control: Input<ControlState>,
    torque: Output<Torque>,
    law: Pd,
    ahead: Ahead,
    dynamics: Option<Dynamics>,
    assumed: Option<Joints>,
    gravity_share: f64,
    datum: u32,
    knobs: Knobs,
}

/// What may be edited while the servo runs: what the configuration gives its gains by.
struct Knobs {
    config: Config,
    inertia_kg_m2: Joints,
    stiffness: [Param; 6],
    damping: [Param; 6],
    filter: Param,
    /// Values at the last look.
    seen: ([f64; 6], [f64; 6], f64),
}

impl Knobs {
    fn new(config: &Config, dynamics: &Dynamics, ports: &mut Ports) -> Knobs {
        let (stiffness_name, stiffness) = match config.kp_nm_rad {
            Some(kp) => ("kp_nm_rad", kp),
            None => ("bandwidth_rad_s", config.bandwidth_rad_s),
        };
        let (damping_name, damping) = match config.kd_nms_rad {
            Some(kd) => ("kd_nms_rad", kd),
            None => ("damping", config.damping),
        };
        Knobs {
            inertia_kg_m2: config.inertia(dynamics),
            config: config.clone(),
            stiffness: ports.tunables(stiffness_name, stiffness),
            damping: ports.tunables(damping_name, damping),
            filter: ports.tunable("derivative_filter_hz", config.derivative_filter_hz),
            seen: (stiffness, damping, config.derivative_filter_hz),
        }
    }

    /// Gains and filter after an edit; nothing when there was none.
    fn edited(&mut self, io: &Io<'_>) -> Option<(Gains, f64)> {
        let now = (
            io.parameters(&self.stiffness),
            io.parameters(&self.damping),
            io.parameter(self.filter),
        );
        if now == self.seen {
            return None;
        }
        self.seen = now;
        let config = &mut self.config;
        *config.kp_nm_rad.as_mut().unwrap_or(&mut config.bandwidth_rad_s) = now.0;
        *config.kd_nms_rad.as_mut().unwrap_or(&mut config.damping) = now.1;
        Some((config.gains_for(&self.inertia_kg_m2), now.2))
    }
}

impl JointServo {
    /// Declares `desired`, `joints`, `control` and `torque`, and as parameters `bandwidth_rad_s` or
    /// `kp_nm_rad`, `damping` or `kd_nms_rad` (six each, whichever the gains are given by) and
    /// `derivative_filter_hz`.
    ///
    /// # Errors
    /// What [`Config::check`] refuses.
    pub fn new(config: Config, ports: &mut Ports) -> Result<JointServo, Invalid> {
        config.check()?;
        let dynamics = Dynamics::reference();
        let knobs = Knobs::new(&config, &dynamics, ports);
        Ok(JointServo {
            desired: ports.input("desired"),
            joints: ports.input("joints"),
            control: ports.input("control"),
            torque: ports.output_within("torque", sound),
            law: config.law(&dynamics),
            ahead: Ahead::new(config.friction, config.friction_speed_rad_s, config.acceleration),
            dynamics: config.gravity.then_some(dynamics),
            assumed: config.assumed_pose_deg.map(|deg| Joints::from(deg.map(f64::to_radians))),
            gravity_share: 0.0,
            datum: 0,
            knobs,
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
        self.ahead.reset();
        self.gravity_share = if calibrated || self.assumed.is_some() { 1.0 } else { 0.0 };
    }
}

impl Task for JointServo {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        if let Some((gains, filter_hz)) = self.knobs.edited(io) {
            self.law.retune(gains, filter_hz);
        }
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
            self.ahead.reset();
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
        let mut model = self.gravity_nm(&goal, calibrated, dt_s);
        if calibrated {
            model += self.ahead.torque_nm(&goal, &Joints::from(desired.qd_rad_s), dt_s);
        }
        let torque = self.law.torque_nm(&error, dt_s).map(|torque| torque + model);
        let finite = torque.filter(|torque| torque.iter().all(|x| x.is_finite()));
        out.tau_nm = finite.map_or([0.0; 6], Into::into);
        io.write(&self.torque, out);
        finite.map(|_| ()).ok_or(FaultCode::NotFinite)
    }

    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.law).add(&self.ahead).add(&self.gravity_share).add(&self.datum);
    }

    fn stop(&mut self) {
        self.law.reset();
        self.ahead.reset();
    }
}
