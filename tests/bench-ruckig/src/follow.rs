//! The simulated PUMA 260 under the joint servo, which follows joint set points at 400 Hz: counts,
//! converters, friction and the actuation delay are included.

use anyhow::{Context, anyhow};
use taktil_hal::{CHANNELS, DacCode, Devices, LinesOut, Nanos};
use taktil_mechanics::Joints;
use taktil_mechanics::friction::Friction;
use taktil_mechanics::puma260::dynamics::Dynamics;
use taktil_mechanics::robot::Robot;
use taktil_mechanics::transmission::{Drive, Transmission};
use taktil_sim::{Timing, World, WorldConfig, build};
use taktil_tasks_joint_servo::Config;
use taktil_tasks_joint_servo::law::{FeedForward, Pd};

/// The servo's period.
pub const SERVO_PERIOD: Nanos = Nanos::from_micros(2_500);
/// Ticks for the brakes to let go and the arm to settle, and ticks watched after a move.
const SETTLING_TICKS: i64 = 200;

/// How far the arm was from its set points.
#[derive(Clone, Copy, Debug, Default)]
pub struct TrackingError {
    /// Root mean square over joints and ticks of the move (rad).
    pub rms_rad: f64,
    /// The largest (rad).
    pub peak_rad: f64,
    /// The largest in half a second after the move (rad).
    pub after_rad: f64,
    /// Largest torque asked over the drives' peak.
    pub torque_share: f64,
}

struct SimulatedServo {
    world: World,
    devices: Devices,
    tick: i64,
    law: Pd,
    feed_forward: FeedForward,
    zero: [i32; 6],
}

impl SimulatedServo {
    fn new(home: &Joints) -> anyhow::Result<SimulatedServo> {
        let mut config = WorldConfig::default();
        config.pin.present = false;
        config.table.height_mm = Some(-900.0);
        config.arm.home_deg = home.map(f64::to_degrees).into();
        let (world, devices) =
            build(&config, &Timing::default(), 1).map_err(|bad| anyhow!("{bad:?}"))?;
        // As the scenes have it, with computed torque.
        let servo =
            Config { damping: Some(vec![0.5; 6]), derivative_filter_hz: 30.0, ..Config::default() };
        let tuning = servo.tuning(&Robot::puma260()).map_err(|bad| anyhow!("{bad:?}"))?;
        let (arm, links) = (Friction::reference(), Dynamics::reference());
        Ok(SimulatedServo {
            world,
            devices,
            tick: 0,
            law: tuning.law(),
            feed_forward: FeedForward::new(arm, links, 0.8, servo.friction_speed_rad_s, 1.0),
            zero: Transmission::reference().counts(home),
        })
    }

    /// One period towards a set point; how far the true joints are from it at its start, and the
    /// share of the drives' peak torque that was asked for.
    fn step(&mut self, q: &Joints, qd: &Joints) -> anyhow::Result<(Joints, f64)> {
        let (now, dt_s) = (SERVO_PERIOD * self.tick, SERVO_PERIOD.as_secs_f64());
        let gears = Transmission::reference();
        let off = self.world.truth().q - q;
        let counts = self.devices.require_encoders()?.sample(now)?.value;
        let read = gears.joints(&core::array::from_fn(|i| counts[i].0 + self.zero[i]));
        let torque = self.law.torque_nm(&(q - read), dt_s).context("the law gave no number")?
            + Dynamics::reference().gravity_torque(q)
            + self.feed_forward.torque_nm(q, qd, dt_s);
        let (drive, motor) = (Drive::reference(), gears.motor_torque(&torque));
        let mut codes = [DacCode(0); CHANNELS];
        for i in 0..6 {
            codes[i] = DacCode(drive.dac_code(motor[i], i));
        }
        let watchdog_feed = self.tick % 2 == 0;
        let lines = LinesOut { enable: true, brake_release: true, watchdog_feed };
        self.devices.require_digital_out()?.commit(now, &lines)?;
        self.devices.require_analog_out()?.commit(now, &codes)?;
        self.tick += 1;
        self.world.advance(SERVO_PERIOD * self.tick);
        let share = torque.abs().component_div(&drive.peak_joint_torque(&gears)).max();
        Ok((off, share))
    }
}

/// Moves the arm along set points, one a tick, and stays at the last one.
///
/// # Errors
/// The simulator refuses the pose; there are no set points.
pub fn follow(points: &[(Joints, Joints)]) -> anyhow::Result<TrackingError> {
    let (first, _) = points.first().context("no set points")?;
    let (last, _) = points.last().context("no set points")?;
    let rest = Joints::zeros();
    let mut rig = SimulatedServo::new(first)?;
    for _ in 0..SETTLING_TICKS {
        rig.step(first, &rest)?;
    }
    let (mut missed, mut square) = (TrackingError::default(), 0.0);
    for (q, qd) in points {
        let (off, share) = rig.step(q, qd)?;
        square += off.norm_squared();
        missed.peak_rad = missed.peak_rad.max(off.amax());
        missed.torque_share = missed.torque_share.max(share);
    }
    missed.rms_rad = (square / (6.0 * points.len() as f64)).sqrt();
    for _ in 0..SETTLING_TICKS {
        missed.after_rad = missed.after_rad.max(rig.step(last, &rest)?.0.amax());
    }
    Ok(missed)
}
