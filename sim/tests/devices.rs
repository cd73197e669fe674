//! Tests the hal halves of the bench with the conformance suite of the hal, and the watchdogs.

use std::cell::{Cell, RefCell};

use taktil_hal::conformance::{
    CycleDriver, check_analog_out_drop, check_analog_out_observed, check_devices,
    check_digital_out_drop, check_digital_out_observed,
};
use taktil_hal::{Arrival, CHANNELS, Counts, DacCode, Devices, LinesOut, Nanos};
use taktil_sim::scene::ScanStamp;
use taktil_sim::{LONGEST_SILENCE, Timing, World, WorldConfig, build};

const CONTROL_PERIOD: Nanos = Nanos::from_micros(2_500);
const ACTUATION_DELAY: Nanos = Nanos::from_micros(1_250);

fn bench() -> (World, Devices) {
    build(&WorldConfig::default(), &Timing::default(), 3).unwrap()
}

fn lines(enable: bool, brake_release: bool, watchdog_feed: bool) -> LinesOut {
    LinesOut { enable, brake_release, watchdog_feed }
}

#[test]
fn all_halves_pass_the_conformance_suite() {
    let mut opposed = WorldConfig::default();
    opposed.opposed.present = true;
    for config in [WorldConfig::default(), opposed] {
        let (mut world, mut devices) = build(&config, &Timing::default(), 3).unwrap();
        assert_eq!(devices.tactile.contains_key("tactile_opposed"), config.opposed.present);
        let mut bench = CycleDriver::new(Nanos::ZERO, CONTROL_PERIOD, |t| world.advance(t));
        assert_eq!(check_devices(&mut devices, &mut bench), []);
    }
}

#[test]
fn outputs_reach_the_world_and_go_safe() {
    let (world, mut devices) = bench();
    let (world, last) = (RefCell::new(world), Cell::new(Nanos::ZERO));
    let advance = |t: Nanos| {
        last.set(t);
        world.borrow_mut().advance(t);
    };
    // A command acts one delay after its release, a safe value at once; a moment later it has been
    // taken.
    let settle = || {
        let mut world = world.borrow_mut();
        let due = world.now().max(last.get() + ACTUATION_DELAY);
        world.advance(due + Nanos(1));
    };
    let mut codes = || {
        settle();
        world.borrow().analog_out().map(DacCode)
    };
    let mut orders = || {
        settle();
        world.borrow().digital_out()
    };
    let mut feed = CycleDriver::new(Nanos::ZERO, CONTROL_PERIOD, advance);
    let found = check_analog_out_observed(
        devices.analog_out.as_deref_mut().unwrap(),
        &mut feed,
        &mut codes,
    );
    assert_eq!(found, []);
    let found = check_analog_out_drop(devices.analog_out.unwrap(), &mut feed, &mut codes);
    assert_eq!(found, []);

    let (fresh, mut devices) = bench();
    *world.borrow_mut() = fresh;
    let mut feed = CycleDriver::new(Nanos::ZERO, CONTROL_PERIOD, advance);
    let found = check_digital_out_observed(
        devices.digital_out.as_deref_mut().unwrap(),
        &mut feed,
        &mut orders,
    );
    assert_eq!(found, []);
    let found = check_digital_out_drop(devices.digital_out.unwrap(), &mut feed, &mut orders);
    assert_eq!(found, []);
}

#[test]
fn encoders_read_zero_at_power_up() {
    let (_world, mut devices) = bench();
    let reading = devices.encoders.as_mut().unwrap().sample(Nanos::ZERO).unwrap();
    assert_eq!((reading.value, reading.acquired), ([Counts(0); CHANNELS], Nanos::ZERO));
    assert!(
        devices.encoders.as_mut().unwrap().sample(Nanos(-1)).is_ok(),
        "what was read once is held"
    );
    let (_world, mut devices) = bench();
    assert!(
        devices.encoders.as_mut().unwrap().sample(Nanos(-1)).is_err(),
        "nothing exists before the start"
    );
}

#[test]
fn readings_carry_the_instants_of_the_world() {
    let (mut world, mut devices) = bench();
    world.advance(Nanos::from_millis(20));
    let at = |us| Nanos::from_micros(us);
    assert_eq!(devices.encoders.as_mut().unwrap().sample(at(7_400)).unwrap().acquired, at(5_000));
    assert_eq!(devices.encoders.as_mut().unwrap().sample(at(7_500)).unwrap().acquired, at(7_500));
    assert_eq!(devices.encoders.as_mut().unwrap().sample(at(90_000)).unwrap().acquired, at(20_000));
    let mut frame = taktil_hal::TactileFrame::new(16, 16);
    devices.tactile.get_mut("tactile").unwrap().sample(at(14_999), &mut frame).unwrap();
    assert_eq!((frame.acquired, frame.sequence), (at(10_000), 2));
    assert_eq!(world.dropped(), 0);
}

#[test]
fn late_scans_carry_the_instant_of_acquisition_or_of_arrival() {
    for (late, stamp) in
        [(0, ScanStamp::Scanned), (2, ScanStamp::Scanned), (2, ScanStamp::Delivered)]
    {
        let mut config = WorldConfig::default();
        (config.tactile.delay_scans, config.tactile.stamp) = (late, stamp);
        let (mut world, mut devices) = build(&config, &Timing::default(), 3).unwrap();
        let delay = Nanos::from_millis(5) * i64::from(late);
        let mut frame = taktil_hal::TactileFrame::new(16, 16);
        for scan in 0..6 {
            let due = Nanos::from_millis(5) * scan + delay;
            world.advance(due);
            let early =
                devices.tactile.get_mut("tactile").unwrap().sample(due - Nanos(1), &mut frame);
            assert!(scan == 0 && late == 0 || early == Ok(Arrival::Held), "{late}: scan {scan}");
            assert_eq!(
                devices.tactile.get_mut("tactile").unwrap().sample(due, &mut frame),
                Ok(Arrival::New),
                "{late}"
            );
            assert_eq!(i64::from(frame.sequence), scan, "{late}");
            let hidden = if stamp == ScanStamp::Delivered { Nanos::ZERO } else { delay };
            assert_eq!(frame.acquired, due - hidden, "{late} {stamp:?}");
        }
    }
}

#[test]
fn words_act_from_their_own_instants() {
    let run = |instants: &[i64]| {
        let (mut world, mut devices) = bench();
        devices
            .digital_out
            .as_mut()
            .unwrap()
            .commit(Nanos::ZERO, &lines(true, true, true))
            .unwrap();
        let mut codes = [DacCode(0); CHANNELS];
        codes[0] = DacCode(1000);
        devices.analog_out.as_mut().unwrap().commit(Nanos::ZERO, &codes).unwrap();
        devices
            .analog_out
            .as_mut()
            .unwrap()
            .commit(CONTROL_PERIOD, &[DacCode(0); CHANNELS])
            .unwrap();
        for us in instants {
            world.advance(Nanos::from_micros(*us));
        }
        world.truth().qd[0]
    };
    // The joint is driven from 1.25 to 3.75 ms, whatever the division of the advance.
    let (whole, cut) = (run(&[20_000]), run(&[1_250, 3_750, 20_000]));
    assert!(whole > 0.0 && (whole - cut).abs() < 1e-12, "{whole} {cut}");
    assert!(run(&[1_250]).abs() < 1e-12, "nothing acts before its instant");
}

#[test]
fn silence_drops_the_drives_and_sets_the_brakes() {
    let (mut world, mut devices) = bench();
    let codes = [DacCode(1500), DacCode(0), DacCode(0), DacCode(0), DacCode(0), DacCode(0)];
    let mut word = [DacCode(0); CHANNELS];
    word[..6].copy_from_slice(&codes);
    let mut feed = false;
    for k in 0..40 {
        feed = !feed;
        let t = CONTROL_PERIOD * k;
        devices.digital_out.as_mut().unwrap().commit(t, &lines(true, true, feed)).unwrap();
        devices.analog_out.as_mut().unwrap().commit(t, &word).unwrap();
        world.advance(t + CONTROL_PERIOD);
    }
    let running = world.truth();
    assert!(running.enabled && !running.braked && running.qd[0].abs() > 0.1);
    // The last command acts at 39 periods + delay; 50 ms later everything is off.
    let last = CONTROL_PERIOD * 39 + ACTUATION_DELAY;
    world.advance(last + LONGEST_SILENCE);
    assert_eq!(world.analog_out()[0], 1500, "not a moment too early");
    world.advance(last + LONGEST_SILENCE + Nanos(1));
    let dead = world.truth();
    assert_eq!(world.analog_out(), [0; CHANNELS]);
    assert!(!dead.enabled && dead.braked && dead.qd.norm() == 0.0);
    let place = dead.q;
    world.advance(last + LONGEST_SILENCE + Nanos::from_secs(1));
    assert_eq!(world.truth().q, place);
}

#[test]
fn a_feed_line_that_does_not_toggle_lets_the_watchdog_expire() {
    let (mut world, mut devices) = bench();
    for k in 0..40 {
        let t = CONTROL_PERIOD * k;
        devices.digital_out.as_mut().unwrap().commit(t, &lines(true, true, true)).unwrap();
        devices.analog_out.as_mut().unwrap().commit(t, &[DacCode(0); CHANNELS]).unwrap();
        world.advance(t + CONTROL_PERIOD);
    }
    assert!(world.truth().braked && !world.truth().enabled);
}

#[test]
fn power_comes_on_at_the_time_in_the_scene() {
    let mut config = WorldConfig::default();
    config.arm.power_on_s = 0.02;
    let (mut world, mut devices) = build(&config, &Timing::default(), 3).unwrap();
    devices.digital_out.as_mut().unwrap().commit(Nanos::ZERO, &lines(true, true, true)).unwrap();
    world.advance(Nanos::from_millis(15));
    assert!(
        !devices
            .digital_in
            .as_mut()
            .unwrap()
            .sample(Nanos::from_millis(15))
            .unwrap()
            .value
            .drive_power
    );
    assert!(world.truth().braked);
    world.advance(Nanos::from_millis(21));
    let seen = devices.digital_in.as_mut().unwrap().sample(Nanos::from_millis(21)).unwrap().value;
    assert!(seen.drive_power && seen.estop_a_closed && seen.estop_b_closed);
    assert!(!world.truth().braked);
}
