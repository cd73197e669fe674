//! Runs the whole bench under a simple servo: PD control with gravity compensation on the joints, a
//! force loop on the image. It is not the project's controller, only evidence that one can work
//! against this physics.

mod common;

use common::nominal;
use glam::DVec3;
use taktil_hal::{CHANNELS, DacCode, Devices, LinesOut, Nanos, TactileFrame};
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::puma260::dynamics::Dynamics;
use taktil_mechanics::transmission::{Drive, Transmission};
use taktil_mechanics::{Joints, Pose};
use taktil_sim::{ArrayGeometry, Timing, World, WorldConfig, build};

const CONTROL_PERIOD: Nanos = Nanos::from_micros(2_500);
const BANDWIDTH_RAD_S: f64 = 80.0;
const WANTED_COUNTS: f64 = 15_000.0;

struct Servo {
    world: World,
    devices: Devices,
    tick: i64,
    home: Joints,
    last: Joints,
    gain: Joints,
    frame: TactileFrame,
    m0: f64,
}

impl Servo {
    fn new(config: &WorldConfig) -> Servo {
        let (world, devices) = build(config, &Timing::default(), 5).unwrap();
        let home = world.truth().q;
        let inertia = Dynamics::reference().mass_matrix(&home).diagonal();
        let gain = inertia * (BANDWIDTH_RAD_S * BANDWIDTH_RAD_S);
        let frame = TactileFrame::new(16, 16);
        Servo { world, devices, tick: 0, home, last: home, gain, frame, m0: 0.0 }
    }

    /// One control period towards desired joints.
    fn step(&mut self, desired: &Joints) {
        let t = CONTROL_PERIOD * self.tick;
        let counts = self.devices.encoders.as_mut().unwrap().sample(t).unwrap().value;
        let gears = Transmission::reference();
        let zero = gears.counts(&self.home);
        let q = gears.joints(&core::array::from_fn(|i| counts[i].0 + zero[i]));
        let speed = (q - self.last) / CONTROL_PERIOD.as_secs_f64();
        self.last = q;
        let damping = self.gain * (1.4 / BANDWIDTH_RAD_S);
        let torque = self.gain.component_mul(&(desired - q)) - damping.component_mul(&speed)
            + Dynamics::reference().gravity_torque(&q);
        let motor = gears.motor_torque(&torque);
        let mut codes = [DacCode(0); CHANNELS];
        for i in 0..6 {
            codes[i] = DacCode(Drive::reference().dac_code(motor[i], i));
        }
        let feed = self.tick % 2 == 0;
        let order = LinesOut { enable: true, brake_release: true, watchdog_feed: feed };
        self.devices.digital_out.as_mut().unwrap().commit(t, &order).unwrap();
        self.devices.analog_out.as_mut().unwrap().commit(t, &codes).unwrap();
        self.devices.tactile.get_mut("tactile").unwrap().sample(t, &mut self.frame).unwrap();
        self.m0 = self.frame.values.iter().map(|v| f64::from(*v) - 300.0).sum();
        self.world.advance(t + CONTROL_PERIOD);
        self.tick += 1;
    }

    fn joints_at(&self, place: DVec3) -> Joints {
        let arm = Puma260::reference();
        let wrist = arm.tool_to_wrist(&Pose::new(nominal(), place));
        let branches = arm.inverse_kinematics(&wrist, Some(&self.last));
        arm.nearest_branch(&branches, &self.last).expect("the place is within reach").1
    }
}

#[test]
fn a_held_arm_stays_within_a_tenth_of_a_millimetre() {
    let mut servo = Servo::new(&WorldConfig::default());
    let (home, start) = (servo.home, servo.world.truth().tool);
    for _ in 0..800 {
        servo.step(&home);
        let off = servo.world.truth().tool - start;
        assert!(off.length() < 1e-4, "{off}");
    }
}

#[test]
fn the_arm_rolls_the_pin_by_force_and_position() {
    let mut servo = Servo::new(&WorldConfig::default());
    let mut place = servo.world.truth().tool;
    let middle = place.x;
    let (mut samples, mut touched) = (Vec::new(), 0_i64);
    for _ in 0..3600 {
        let step = if servo.m0 < 3000.0 && touched == 0 {
            -5e-5
        } else {
            touched += 1;
            (2e-9 * (servo.m0 - WANTED_COUNTS)).clamp(-2e-5, 2e-5)
        };
        place.z += step;
        // Strokes of +-15 mm at 10 mm/s at most, once the force has settled.
        let phase = 10.0 / 15.0 * CONTROL_PERIOD.as_secs_f64() * (touched - 400).max(0) as f64;
        place.x = middle + 0.015 * libm::sin(phase);
        let desired = servo.joints_at(place);
        servo.step(&desired);
        if touched > 400 {
            samples.push(servo.world.truth());
        }
    }
    let span = |of: &dyn Fn(&taktil_sim::Truth) -> f64| {
        let values = samples.iter().map(of);
        let (low, high) =
            values.fold((f64::MAX, f64::MIN), |(low, high), x| (low.min(x), high.max(x)));
        (low, high)
    };
    let finger = span(&|t| t.tool.x);
    let contact =
        span(&|t| t.contact_x_tactels.expect("contact is kept") * ArrayGeometry::THESIS.pitch_x_m);
    let force = span(&|t| t.finger_normal_n);
    let ratio = (finger.1 - finger.0) / (contact.1 - contact.0);
    println!("finger {finger:?} m, contact {contact:?} m, ratio {ratio:.4}, force {force:?} N");
    println!("yaw {:?} tilt {:?}", span(&|t| t.pin_yaw_rad), span(&|t| t.tilt_rad));
    assert!((ratio - 2.0).abs() < 0.04, "{ratio}");
    assert!(force.0 > 8.0 && force.1 < 24.0, "{force:?}");
    assert!(samples.len() > 2000 && samples.iter().all(|t| !t.beyond_small_strain));
}
