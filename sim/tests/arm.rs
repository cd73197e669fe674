//! Tests the arm behind its codes: gravity, friction that sticks, energy, counts. One seed gives
//! one run.

use taktil_hal::{CHANNELS, DacCode, Devices, LinesOut, Nanos};
use taktil_mechanics::Joints;
use taktil_mechanics::puma260::dynamics::{Dynamics, LINKS, TOOL};
use taktil_mechanics::transmission::{Drive, Transmission};
use taktil_sim::fidelity::ArmModel;
use taktil_sim::{Timing, World, WorldConfig, build};

const CONTROL_PERIOD: Nanos = Nanos::from_micros(2_500);

fn free_of_pin() -> WorldConfig {
    let mut config = WorldConfig::default();
    config.pin.present = false;
    config
}

/// Runs `cycles` control periods; `law` sees the world and gives the codes.
fn run(
    world: &mut World,
    devices: &mut Devices,
    cycles: i64,
    mut law: impl FnMut(&World) -> [DacCode; CHANNELS],
) {
    for k in 0..cycles {
        let t = CONTROL_PERIOD * k;
        let order = LinesOut { enable: true, brake_release: true, watchdog_feed: k % 2 == 0 };
        devices.digital_out.as_mut().unwrap().commit(t, &order).unwrap();
        devices.analog_out.as_mut().unwrap().commit(t, &law(world)).unwrap();
        devices.encoders.as_mut().unwrap().sample(t).unwrap();
        world.advance(t + CONTROL_PERIOD);
    }
}

fn codes_of(torque: &Joints) -> [DacCode; CHANNELS] {
    let motor = Transmission::reference().motor_torque(torque);
    let drive = Drive::reference();
    let mut codes = [DacCode(0); CHANNELS];
    for i in 0..6 {
        codes[i] = DacCode(drive.dac_code(motor[i], i));
    }
    codes
}

#[test]
fn a_braked_arm_does_not_move() {
    let (mut world, _devices) = build(&WorldConfig::default(), &Timing::default(), 1).unwrap();
    let start = world.truth().q;
    world.advance(Nanos::from_secs(1));
    assert_eq!(world.truth().q, start);
}

#[test]
fn scaled_masses_are_those_of_the_simulated_arm_alone() {
    for scale in [0.5, 1.5] {
        let mut config = free_of_pin();
        (config.arm.link_mass_scale, config.arm.tool_mass_scale) = ([scale; 6], scale);
        let bodies = LINKS.map(|link| link.with_density_factor(scale));
        let heavy = Dynamics::from_bodies(bodies, &TOOL.with_density_factor(scale));
        let moved = |dynamics: &Dynamics| {
            let (mut world, mut devices) = build(&config, &Timing::default(), 1).unwrap();
            let start = world.truth().q;
            let hold = codes_of(&dynamics.gravity_torque(&start));
            run(&mut world, &mut devices, 80, |_| hold);
            (world.truth().q - start).amax()
        };
        // Friction that sticks yields a little, and a code is off by half a unit at most.
        assert!(moved(&heavy) < 1e-5, "{scale}: {}", moved(&heavy));
        assert!(moved(&Dynamics::reference()) > 0.02, "{scale}: what the controller believes");
    }
}

#[test]
fn gravity_torque_and_friction_hold_the_arm_still() {
    let (mut world, mut devices) = build(&free_of_pin(), &Timing::default(), 1).unwrap();
    let start = world.truth();
    let gravity = Dynamics::reference().gravity_torque(&start.q);
    // The arm stands for 4 s under constant codes that are off by half a unit at most; friction
    // takes the rest.
    run(&mut world, &mut devices, 1600, |_| codes_of(&gravity));
    let end = world.truth();
    assert!((end.tool - start.tool).length() < 1e-4, "{}", end.tool - start.tool);
    assert!(end.qd.norm() < 1e-6, "{}", end.qd.norm());
    let counts = devices.encoders.as_mut().unwrap().sample(CONTROL_PERIOD * 1600).unwrap().value;
    assert!(counts.iter().all(|c| c.0.abs() <= 2), "{counts:?}");
}

#[test]
fn without_torque_the_arm_falls_onto_its_stops_and_stays_finite() {
    let (mut world, mut devices) = build(&free_of_pin(), &Timing::default(), 1).unwrap();
    run(&mut world, &mut devices, 1200, |_| [DacCode(0); CHANNELS]);
    let truth = world.truth();
    assert!(truth.tool.z < -0.3 && truth.tool.is_finite(), "{}", truth.tool);
    assert!(truth.qd.norm() < 1.0, "{}", truth.qd.norm());
}

#[test]
fn an_arm_without_friction_keeps_its_energy() {
    let mut config = free_of_pin();
    config.fidelity.arm = ArmModel::Rigid;
    let (mut world, mut devices) = build(&config, &Timing::default(), 1).unwrap();
    let (start, before_j) = (world.truth(), world.energy_j());
    run(&mut world, &mut devices, 80, |_| [DacCode(0); CHANNELS]);
    let end = world.truth();
    assert!(end.tool.z - start.tool.z < -0.05, "it swings: {}", end.tool.z - start.tool.z);
    let drift = (world.energy_j() - before_j).abs();
    assert!(drift < 1e-9, "{drift:e} J in 0.2 s of fall");
}

#[test]
fn torques_move_the_joints_in_their_direction_and_counts_follow() {
    for joint in 0..6 {
        let (mut world, mut devices) = build(&free_of_pin(), &Timing::default(), 1).unwrap();
        let start = world.truth().q;
        let model = Dynamics::reference();
        let push = Drive::reference().peak_joint_torque(&Transmission::reference())[joint] * 0.4;
        run(&mut world, &mut devices, 60, |world| {
            let mut torque = model.gravity_torque(&world.truth().q);
            torque[joint] += push;
            codes_of(&torque)
        });
        let end = world.truth().q;
        assert!(end[joint] - start[joint] > 0.005, "joint {}: {}", joint + 1, end - start);
        let gears = Transmission::reference();
        let (now, then) = (gears.counts(&end), gears.counts(&start));
        let seen = devices.encoders.as_mut().unwrap().sample(CONTROL_PERIOD * 60).unwrap().value;
        for i in 0..6 {
            assert_eq!(seen[i].0, now[i] - then[i], "joint {}", i + 1);
        }
    }
}

#[test]
fn currents_are_echoed_on_the_analog_inputs() {
    let (mut world, mut devices) = build(&free_of_pin(), &Timing::default(), 1).unwrap();
    let gravity = Dynamics::reference().gravity_torque(&world.truth().q);
    let codes = codes_of(&gravity);
    run(&mut world, &mut devices, 4, |_| codes);
    let seen = devices.analog_in.as_mut().unwrap().sample(CONTROL_PERIOD * 4).unwrap().value;
    assert!((0..CHANNELS).all(|i| seen[i].0 == codes[i].0), "{seen:?}");
}

#[test]
fn one_seed_is_one_run() {
    let hash = |seed: u64| {
        let (mut world, mut devices) =
            build(&WorldConfig::default(), &Timing::default(), seed).unwrap();
        let mut frame = taktil_hal::TactileFrame::new(16, 16);
        let gravity = Dynamics::reference().gravity_torque(&world.truth().q);
        run(&mut world, &mut devices, 200, |_| codes_of(&(0.7 * gravity)));
        devices.tactile.get_mut("tactile").unwrap().sample(world.now(), &mut frame).unwrap();
        (world.state_hash(), frame.values)
    };
    let (one, again, other) = (hash(1), hash(1), hash(2));
    assert_eq!(one, again);
    assert_ne!(one.0, other.0);
    assert_ne!(one.1, other.1);
}

#[test]
fn the_pinned_digest_does_not_depend_on_build_or_machine() {
    let (mut world, mut devices) = build(&WorldConfig::default(), &Timing::default(), 1).unwrap();
    // The arm sags onto the pin.
    let gravity = Dynamics::reference().gravity_torque(&world.truth().q);
    run(&mut world, &mut devices, 400, |_| codes_of(&(0.5 * gravity)));
    assert!(world.truth().in_contact);
    // A change of the physics changes this number; then the new one is written here. A number that
    // differs between debug and release or between machines is a fault.
    assert_eq!(world.state_hash(), 0xc84c_274b_5097_ecb6, "digest {:#018x}", world.state_hash());
}
