//! Checks that a restored world goes on bit for bit, whatever the state of its sensors and whenever
//! the snapshot was taken, that one can seek in a history, and that parallel worlds do not
//! influence each other.

mod common;

use common::lowered;
use taktil_hal::{
    Arrival, CHANNELS, DacCode, Devices, IndexPulses, LinesOut, Nanos, TACTILE, TACTILE_OPPOSED,
    TactileFrame,
};
use taktil_mechanics::puma260::dynamics::Dynamics;
use taktil_mechanics::transmission::{Drive, Transmission};
use taktil_sim::fidelity::{ArmModel, ContactModel, Integrator};
use taktil_sim::scene::{
    Axis, Electronics, Fault, FaultKind, Motion, MotionKind, ObjectConfig, ObjectKind, ScanStamp,
};
use taktil_sim::{OutputRecord, Timing, World, WorldConfig, WorldHistory, build};

const CONTROL_PERIOD: Nanos = Nanos::from_micros(2_500);

/// Half of the codes that hold the arm, with a ripple: the arm sinks onto the pin.
fn word(tick: i64) -> OutputRecord {
    let home = WorldConfig::default().arm.home_deg.map(f64::to_radians);
    let gravity = Dynamics::reference().gravity_torque(&home.into());
    let motor = Transmission::reference().motor_torque(&(0.5 * gravity));
    let mut codes = [DacCode(0); CHANNELS];
    for i in 0..6 {
        codes[i] = DacCode(Drive::reference().dac_code(motor[i], i) + (tick % 7) as i32);
    }
    let lines = LinesOut { enable: true, brake_release: true, watchdog_feed: tick % 2 == 0 };
    OutputRecord { release: CONTROL_PERIOD * tick, codes, drives: None, lines }
}

/// What is observed of a world after a tick: its state, and the frames that the controller gets.
type Observation = (u64, [Option<Box<[u16]>>; 2], [i32; CHANNELS], Option<IndexPulses>);

fn go(world: &mut World, devices: &mut Devices, ticks: core::ops::Range<i64>) -> Vec<Observation> {
    let mut frame = TactileFrame::new(16, 16);
    ticks
        .map(|tick| {
            word(tick).commit(devices).unwrap();
            world.advance(CONTROL_PERIOD * (tick + 1));
            let scans = [TACTILE, TACTILE_OPPOSED].map(|name| {
                let arrival = devices.tactile.get_mut(name)?.sample(world.now(), &mut frame);
                matches!(arrival, Ok(Arrival::New)).then(|| frame.values.clone())
            });
            let counts = devices
                .encoders
                .as_mut()
                .unwrap()
                .sample(world.now())
                .unwrap()
                .value
                .map(|count| count.0);
            let marks = devices
                .encoders
                .as_mut()
                .unwrap()
                .has_index()
                .then(|| devices.encoders.as_mut().unwrap().index_pulses());
            (world.state_hash(), scans, counts, marks)
        })
        .collect()
}

/// A prescribed arm that is lowered onto the pin, with the automatic integrator and with explicit
/// steps.
fn on_a_course() -> [WorldConfig; 2] {
    let mut led = WorldConfig::default();
    led.fidelity.arm = ArmModel::Kinematic;
    let [a, b, c, d, e, f] = lowered(15.2);
    led.arm.trajectory_deg = vec![[0.5, a, b, c, d, e, f]];
    let mut by_steps = led.clone();
    by_steps.fidelity.integrator = Integrator::Euler;
    by_steps.substep_us = 80.0;
    [led, by_steps]
}

/// A pin between two fingertips, with independent rows and in three dimensions.
fn between_two() -> [WorldConfig; 2] {
    let mut strips = WorldConfig::default();
    strips.opposed.present = true;
    strips.opposed.tactile.electronics = Electronics::Memory;
    strips.opposed.tactile.row_us = 100.0;
    let mut solved = strips.clone();
    solved.fidelity.contact = ContactModel::Layer3d;
    [strips, solved]
}

/// Scenes that together contain everything that a world can store.
fn scenes() -> Vec<(&'static str, WorldConfig)> {
    let plain = WorldConfig::default;
    let mut solved = plain();
    solved.fidelity.contact = ContactModel::Layer3d;
    let mut sensors = plain();
    sensors.tactile.electronics = Electronics::Network;
    sensors.tactile.row_us = 150.0;
    sensors.wrist.noise_codes = 2.0;
    let mut late = plain();
    late.tactile.delay_scans = 3;
    let mut hidden = late.clone();
    hidden.tactile.stamp = ScanStamp::Delivered;
    let [opposed, opposed_solved] = between_two();
    let mut faulty = plain();
    let fault = |kind, at_s, for_s, fraction| Fault {
        for_s: Some(for_s),
        joint: (kind == FaultKind::DeadEncoder).then_some(2),
        fraction,
        ..Fault::at(kind, at_s)
    };
    faulty.fault = vec![
        fault(FaultKind::DropFrames, 0.1, 2.0, Some(0.5)),
        fault(FaultKind::DeadEncoder, 0.3, 0.3, None),
        fault(FaultKind::FrozenWrist, 0.5, 0.2, None),
    ];
    let mut moving = plain();
    moving.table.motion = vec![Motion {
        amplitude_mm: Some(2.0),
        frequency_hz: Some(2.0),
        ..Motion::of(Axis::Slide, MotionKind::Sine)
    }];
    moving.fidelity.contact = ContactModel::Layer2d;
    let mut explicit = plain();
    explicit.fidelity.integrator = Integrator::Euler;
    explicit.substep_us = 80.0;
    let on = |kind| {
        let mut config = WorldConfig { object: vec![ObjectConfig::of(kind)], ..plain() };
        config.pin.present = false;
        config
    };
    let mut pulsed = plain();
    pulsed.arm.index_counts = Some(vec![5.0, 40.0, 3.0, 11.0, 60.0, 7.0]);
    let [led, led_by_steps] = on_a_course();
    let mut springy = plain();
    springy.fidelity.arm = ArmModel::Compliant;
    vec![
        ("plain", plain()),
        ("late", late),
        ("hidden", hidden),
        ("sphere", on(ObjectKind::Sphere)),
        ("edge", on(ObjectKind::Edge)),
        ("bar", on(ObjectKind::Bar)),
        ("springy", springy),
        ("index", pulsed),
        ("kinematic", led),
        ("kinematic, euler", led_by_steps),
        ("opposed, layer-3d", opposed_solved),
        ("layer-3d", solved),
        ("sensors", sensors),
        ("opposed", opposed),
        ("faults", faulty),
        ("table", moving),
        ("euler", explicit),
    ]
}

#[test]
fn a_restored_world_continues_bit_for_bit_in_every_scene_at_any_tick() {
    const END_TICK: i64 = 320;
    for (name, config) in scenes() {
        let (mut world, mut devices) = build(&config, &Timing::default(), 3).unwrap();
        let mut kept = Vec::new();
        let mut told = Vec::new();
        for tick in 0..END_TICK {
            if [0, 1, 97, 240, 301].contains(&tick) {
                kept.push((tick, world.snapshot()));
            }
            told.extend(go(&mut world, &mut devices, tick..tick + 1));
        }
        assert!(world.truth().in_contact, "{name} never touches");
        if config.arm.index_counts.is_some() {
            let marks = |seen: &Observation| seen.3.expect("pulses are reported");
            let came = marks(&told[END_TICK as usize - 1]).iter().flatten().count();
            assert!(came > 0, "{name}: no pulse came");
            assert_ne!(marks(&told[0]), marks(&told[END_TICK as usize - 1]));
        }
        for (tick, snapshot) in &kept {
            for _ in 0..2 {
                let (mut again, mut halves) = snapshot.restore();
                assert_eq!(again.now(), snapshot.now());
                // The latest readings are sent anew.
                let first = halves.encoders.as_mut().unwrap().sample(again.now()).unwrap();
                assert_eq!(first.acquired, CONTROL_PERIOD * *tick);
                if *tick > 0 {
                    let mut frame = TactileFrame::new(16, 16);
                    for array in halves.tactile.values_mut() {
                        let _ = array.sample(again.now(), &mut frame);
                    }
                }
                let rest = go(&mut again, &mut halves, *tick..END_TICK);
                assert!(rest == told[*tick as usize..], "{name}: another way after tick {tick}");
            }
        }
    }
}

#[test]
fn commands_on_their_way_act_at_their_instant() {
    let (mut world, mut devices) = build(&WorldConfig::default(), &Timing::default(), 3).unwrap();
    go(&mut world, &mut devices, 0..40);
    word(40).commit(&mut devices).unwrap();
    // The instant is between release and effect, and is no event.
    world.advance(CONTROL_PERIOD * 40 + Nanos::from_micros(700));
    let before = world.analog_out();
    let snapshot = world.snapshot();
    let (mut again, _halves) = snapshot.restore();
    for world in [&mut world, &mut again] {
        world.advance(CONTROL_PERIOD * 40 + Nanos::from_micros(1_250));
        assert_eq!(world.analog_out(), before);
        world.advance(CONTROL_PERIOD * 41);
        assert_ne!(world.analog_out(), before);
    }
    assert_eq!(world.state_hash(), again.state_hash());
}

#[test]
fn seeking_in_a_history_gives_the_state_of_that_instant() {
    let (mut world, mut devices) = build(&WorldConfig::default(), &Timing::default(), 3).unwrap();
    let mut history = WorldHistory::default();
    assert!(history.seek(Nanos::ZERO).unwrap().is_none());
    let mut hashes = Vec::new();
    for tick in 0..300 {
        if tick % 100 == 0 {
            history.push_snapshot(world.snapshot());
        }
        history.push_output(word(tick));
        hashes.extend(go(&mut world, &mut devices, tick..tick + 1).iter().map(|seen| seen.0));
    }
    for tick in [299, 0, 100, 157, 99] {
        let to = CONTROL_PERIOD * (tick + 1);
        let (found, _devices) = history.seek(to).unwrap().expect("after the first snapshot");
        assert_eq!(found.now(), to);
        assert_eq!(found.state_hash(), hashes[tick as usize], "tick {tick}");
    }
}

#[test]
fn parallel_worlds_do_not_influence_each_other() {
    let alone = || {
        let (mut world, mut devices) =
            build(&WorldConfig::default(), &Timing::default(), 3).unwrap();
        go(&mut world, &mut devices, 0..200)
    };
    let one = alone();
    let many: Vec<Vec<Observation>> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..4).map(|_| scope.spawn(alone)).collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).collect()
    });
    assert!(many.iter().all(|seen| *seen == one));
}
