//! The law with the simulated hand and nothing between them but a servo: an object is grasped, held
//! when its support goes, pushed, and turned.

use glam::{DMat3, DVec3};
use taktil_hal::{CHANNELS, DacCode, Devices, LinesOut, Nanos, TactileFrame};
use taktil_mechanics::Pose;
use taktil_mechanics::arm::ArmDynamics;
use taktil_mechanics::chain::{Chain, JointSpec};
use taktil_mechanics::friction::Friction;
use taktil_mechanics::hand::ThreeFingers;
use taktil_mechanics::rigid_body::Body;
use taktil_mechanics::robot::Robot;
use taktil_mechanics::spatial::{JointVector, rotation_z};
use taktil_mechanics::transmission::{Drive, Transmission};
use taktil_signal::TactileImage;
use taktil_sim::scene::{HeldShape, PushConfig};
use taktil_sim::{Timing, World, WorldConfig, build_with_hand};
use taktil_tasks_grasp::Config;
use taktil_tasks_grasp::law::{Inputs, Law, Phase};
use taktil_tasks_grasp::touch::{Touch, touch};

/// Period of the jobs.
const JOB_PERIOD: Nanos = Nanos::from_micros(2500);
/// Torque of a motor behind its gear for one code (N m).
const CODE_NM: f64 = 2.0 / 32768.0;
/// The servo: stiffness (N m/rad) and damping (N m s/rad).
const SERVO_NM_RAD: f64 = 28.0;
const SERVO_NMS_RAD: f64 = 0.6;
/// Rest level of the arrays (counts).
const REST_COUNTS: f32 = 100.0;

fn finger(azimuth_rad: f64) -> Chain<3> {
    let base = rotation_z(azimuth_rad);
    let link = |mass_kg: f64, length_m: f64| {
        let long = mass_kg * length_m * length_m / 12.0;
        Body::diagonal(mass_kg, [0.0, 0.0, -0.5 * length_m], [long, long, 0.1 * long])
    };
    let joint = |origin: Pose, axis: DVec3, body: Body, range: [f64; 2]| JointSpec {
        origin,
        axis,
        body,
        q_min: range[0],
        q_max: range[1],
        speed_max: 5.0,
        effort_max: 2.0,
        reflected_inertia: 4e-3,
        ..JointSpec::default()
    };
    let at = |z| Pose::new(DMat3::IDENTITY, DVec3::new(0.0, 0.0, z));
    let root = Pose::new(base, base * DVec3::new(0.005, 0.0, 0.0));
    let joints = [
        joint(root, DVec3::X, link(0.02, 0.02), [-0.6, 0.6]),
        joint(at(0.0), DVec3::Y, link(0.06, 0.065), [-1.3, 0.6]),
        joint(at(-0.065), DVec3::Y, link(0.04, 0.05), [-0.6, 1.6]),
    ];
    let face = DMat3::from_cols(-DVec3::Y, DVec3::Z, -DVec3::X);
    Chain::new(&joints, &Pose::new(face, DVec3::new(-0.008, 0.0, -0.05))).unwrap()
}

fn robot() -> Robot<9, ThreeFingers> {
    let third = core::f64::consts::TAU / 3.0;
    let arm = ThreeFingers::new([finger(0.0), finger(third), finger(2.0 * third)]).unwrap();
    let all = |x: f64| JointVector::<9>::from_element(x);
    let home = JointVector::from_fn(|i, _| [0.0, -42f64.to_radians(), 42f64.to_radians()][i % 3]);
    Robot {
        torque_max_nm: *arm.effort_max(),
        dynamics: arm,
        arm,
        gears: Transmission::uncoupled(&all(10.0), &all(16384.0)),
        drive: Drive { torque_constant_nm_a: all(0.1), current_max_a: all(2.0), dac_bits: 16 },
        friction: Friction { coulomb_nm: all(0.002), viscous_nms_rad: all(0.005) },
        home_rad: home,
        nominal_rad: home,
        joint_names: Vec::new(),
    }
}

/// The simulated hand, its devices, a servo and the law.
struct Bench {
    robot: Robot<9, ThreeFingers>,
    world: World,
    devices: Devices,
    law: Law<3, 9>,
    config: Config,
    torque: JointVector<9>,
    goal: JointVector<9>,
    last_goal: JointVector<9>,
    last_q: JointVector<9>,
    speed: JointVector<9>,
    touch: [Touch; 3],
    frame: TactileFrame,
    feed: bool,
    tick: i64,
}

impl Bench {
    fn new(config: Config, edit: impl FnOnce(&mut WorldConfig)) -> Bench {
        let robot = robot();
        let mut world = WorldConfig::default();
        world.pin.present = false;
        (world.tactile.noise_counts, world.tactile.rest_counts) = (10.0, f64::from(REST_COUNTS));
        world.hand.support_mm = -133.7;
        edit(&mut world);
        let home = robot.home_rad;
        let (world, devices) =
            build_with_hand(&world, &Timing::default(), 1, &robot, home.as_slice()).unwrap();
        let law = Law::new(robot.arm, config.tuning().unwrap(), &home);
        Bench {
            robot,
            world,
            devices,
            law,
            config,
            torque: JointVector::zeros(),
            goal: home,
            last_goal: home,
            last_q: home,
            speed: JointVector::zeros(),
            touch: [Touch::default(); 3],
            frame: TactileFrame::new(16, 16),
            feed: false,
            tick: 0,
        }
    }

    /// What finger `f` feels, if a new frame is there.
    fn read_touch(&mut self, f: usize, release: Nanos) {
        let name = format!("tactile_finger{}", f + 1);
        let array = self.devices.require_tactile(&name).unwrap();
        let arrival = array.sample(release, &mut self.frame).unwrap();
        if arrival != taktil_hal::Arrival::New {
            return;
        }
        let mut image = TactileImage::new(16, 16);
        (image.baseline_ready, image.noise_counts) = (1, 10.0);
        image.valid.fill(1);
        for (count, value) in image.counts.iter_mut().zip(&self.frame.values) {
            *count = f32::from(*value) - REST_COUNTS;
        }
        self.touch[f] = touch(&image, &self.config.scale());
    }

    /// One job: sense, law, servo, actuate.
    fn job(&mut self) {
        let release = JOB_PERIOD * self.tick;
        self.world.advance(release);
        let reading = self.devices.require_encoders().unwrap().sample(release).unwrap();
        let turn = core::f64::consts::TAU / (10.0 * 16384.0);
        let home = self.robot.home_rad;
        let q = JointVector::from_fn(|i, _| home[i] + turn * f64::from(reading.value[i].0));
        for f in 0..3 {
            self.read_touch(f, release);
        }
        let dt_s = JOB_PERIOD.as_secs_f64();
        // The drives come on and the brakes off at first, as a supervisor has it.
        if self.tick > 40 {
            let inputs = Inputs { q, torque_nm: self.torque, touch: self.touch, dt_s };
            self.last_goal = self.goal;
            self.goal = self.law.step(&inputs);
        }
        self.speed += ((q - self.last_q) / dt_s - self.speed) * 0.6;
        self.last_q = q;
        let wanted = (self.goal - self.last_goal) / dt_s;
        self.torque = (self.goal - q) * SERVO_NM_RAD
            + (wanted - self.speed) * SERVO_NMS_RAD
            + self.robot.arm.gravity_torque(&self.goal);
        let mut codes = [DacCode(0); CHANNELS];
        for (i, code) in codes.iter_mut().enumerate().take(9) {
            code.0 = (self.torque[i] / CODE_NM).round().clamp(-32768.0, 32767.0) as i32;
        }
        self.devices.require_analog_out().unwrap().commit(release, &codes).unwrap();
        self.feed = !self.feed;
        let lines = LinesOut { enable: true, brake_release: true, watchdog_feed: self.feed };
        self.devices.require_digital_out().unwrap().commit(release, &lines).unwrap();
        self.tick += 1;
    }

    fn run_until(&mut self, seconds: f64) {
        while (JOB_PERIOD * self.tick).as_secs_f64() < seconds {
            self.job();
        }
    }

    fn report(&self, about: &str) {
        let truth = self.world.hand().unwrap();
        let forces = self.law.forces();
        println!(
            "{about}: {:?} object {:.5} {:.5} {:.5}, touch {:?}, true {:?}, tangential {:?} true \
             {:?}, effort {:?}, margins {:?}, grip {:?}",
            self.law.phase(),
            truth.object_m.x,
            truth.object_m.y,
            truth.object_m.z,
            forces.map(|force| (force.normal_n * 100.0).round() / 100.0),
            truth.fingers.map(|finger| (finger.normal_n * 100.0).round() / 100.0),
            forces.map(|force| (force.tangential.length() * 100.0).round() / 100.0),
            truth
                .fingers
                .map(|f| (libm::hypot(f.friction[0], f.friction[1]) * 100.0).round() / 100.0),
            truth.fingers.map(|finger| (finger.effort * 100.0).round() / 100.0),
            self.law.margins_n().map(|margin| (margin * 100.0).round() / 100.0),
            self.law.grip(),
        );
    }
}

fn push(from_s: f64, to_s: f64, force_n: [f64; 3]) -> PushConfig {
    PushConfig { from_s, to_s, force_n, at_mm: [0.0; 3], ramp_s: 0.1 }
}

#[test]
fn a_ball_is_grasped_and_held_under_pushes() {
    let mut bench = Bench::new(Config::default(), |world| {
        world.hand.support_until_s = Some(4.0);
        world.hand.push = vec![push(5.0, 6.0, [1.0, 0.0, 0.0]), push(6.5, 7.5, [0.0, -0.8, -1.0])];
    });
    bench.run_until(3.5);
    bench.report("3.5 s");
    assert_eq!(bench.law.phase(), Phase::Holding);
    bench.run_until(4.5);
    bench.report("4.5 s");
    let held = bench.world.hand().unwrap().object_m;
    for until in [5.5, 6.2, 7.0, 8.0] {
        bench.run_until(until);
        bench.report(&format!("{until} s"));
        let moved = (bench.world.hand().unwrap().object_m - held).length();
        assert!(moved < 3e-3, "{moved}");
        assert!(bench.law.margins_n().iter().all(|margin| *margin > 0.0));
    }
}

#[test]
fn a_push_beyond_the_cones_is_told_and_the_ball_is_lost() {
    let mut bench = Bench::new(Config::default(), |world| {
        world.hand.support_until_s = Some(4.0);
        world.hand.push = vec![PushConfig { ramp_s: 0.5, ..push(5.0, 7.0, [0.0, 0.0, -30.0]) }];
    });
    bench.run_until(5.0);
    let (mut told, mut slid) = (None, None);
    while told.is_none() || slid.is_none() {
        bench.job();
        if bench.law.margins_n().iter().any(|margin| *margin < 0.0) {
            told.get_or_insert(bench.tick);
        }
        if bench.world.hand().unwrap().fingers.iter().any(|finger| finger.effort > 1.0) {
            slid.get_or_insert(bench.tick);
        }
        assert!(bench.tick < 4000, "told {told:?}, slid {slid:?}");
    }
    println!("told at {told:?}, slid at {slid:?} (jobs of 2.5 ms)");
    assert!(told < slid);
}

#[test]
fn a_ball_is_turned_between_the_fingers() {
    let config = Config {
        plan_after_s: 3.0,
        turn_deg: [0.0, 0.0, 12.0],
        turn_deg_s: 8.0,
        ..Config::default()
    };
    let mut bench = Bench::new(config, |world| world.hand.support_until_s = Some(4.0));
    bench.run_until(4.5);
    bench.run_until(8.0);
    bench.report("turned");
    let axes = bench.world.hand().unwrap().object_axes;
    let turned = libm::atan2(axes.x_axis.y, axes.x_axis.x).to_degrees();
    println!("turned by {turned:.2} deg");
    assert!((turned - 12.0).abs() < 2.0, "{turned}");
}

#[test]
fn a_cylinder_is_held_too() {
    let mut bench = Bench::new(Config::default(), |world| {
        let hand = &mut world.hand;
        (hand.shape, hand.length_mm, hand.mass_kg) = (HeldShape::Cylinder, 50.0, 0.2);
        (hand.support_mm, hand.support_until_s) = (-133.7, Some(4.0));
        hand.push = vec![push(5.0, 6.0, [0.8, 0.8, 0.5])];
    });
    bench.run_until(4.5);
    bench.report("4.5 s");
    let held = bench.world.hand().unwrap().object_m;
    bench.run_until(7.0);
    bench.report("7.0 s");
    let moved = (bench.world.hand().unwrap().object_m - held).length();
    assert!(moved < 3e-3, "{moved}");
}
