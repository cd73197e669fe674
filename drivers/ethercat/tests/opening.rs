//! What is refused when a segment is opened, and that each refusal names place, value and remedy.

mod rig;

use rig::{CYCLE_PERIOD, Lane, Rig, drive, six_drives, terminal, terminals};
use taktil_drivers_ethercat::{
    Config, DeviceConfig, DriveMode, ExchangeTimes, Kind, Place, Segment,
};
use taktil_drivers_ethercat_emulator::{Description, Model};
use taktil_hal::{AnalogOut, CHANNELS, DacCode};

/// What a case changes.
type Change<'a> = &'a dyn Fn(&mut Config);

/// The place of a refusal, and its text.
fn refusal(rig: &Rig, config: &Config) -> (String, String) {
    let bad = rig.open(config).expect_err("it is refused");
    (bad.place().to_owned(), bad.to_string())
}

#[test]
fn another_product_another_number_of_devices_and_silence_are_named() {
    let (devices, config) = terminals();
    let mut other = devices.clone();
    other[1] = other[1].clone().with_identity(0x0fc2_3052, 0x0010_0000);
    let (place, text) = refusal(&Rig::new(other), &config);
    assert_eq!(place, "devices");
    assert!(text.contains("position 1: product 0x10263052 is listed"), "{text}");
    assert!(text.contains("product 0xfc23052, revision 0x100000"), "{text}");
    let (_, text) = refusal(&Rig::new(devices[..6].to_vec()), &config);
    assert!(text.contains("6 devices, 7 are listed"), "{text}");
    let mut listed = config.clone();
    listed.devices[3].alias = Some(9);
    listed.devices[3].revision = Some(0x0014_0000);
    let (_, text) = refusal(&Rig::new(devices.clone()), &listed);
    assert!(text.contains("position 3: alias 0x9 is listed"), "{text}");
    let mut aliased = devices.clone();
    aliased[3] = aliased[3].clone().with_alias(9);
    assert!(Rig::new(aliased).open(&listed).is_ok());
    let silent = Rig::new(devices).with_faults(&["kind=silence target=ethercat"]);
    let (place, text) = refusal(&silent, &config);
    assert_eq!(place, "interface");
    assert!(text.contains("devices cannot be set up") || text.contains("no device"), "{text}");
}

#[test]
fn frames_that_are_lost_while_it_is_opened_are_sent_again() {
    let (devices, config) = six_drives();
    let rig = Rig::new(devices).with_faults(&["kind=loss target=ethercat value=0.05"]);
    assert!(rig.open(&config).is_ok());
}

#[test]
fn an_emergency_message_while_it_is_opened_is_set_aside() {
    let (devices, config) = six_drives();
    for frames in [31, 40, 97, 101] {
        let rig = Rig::new(devices.clone());
        rig.world().emergency_frames = frames;
        let halves = rig.open(&config).unwrap_or_else(|bad| panic!("{frames}: {bad}"));
        let seen = halves.monitor.diagnostics();
        assert!(seen.emergencies > 3, "{seen:?}");
    }
}

#[test]
fn values_out_of_bounds_are_named_with_their_place() {
    let (devices, config) = six_drives();
    let rig = Rig::new(devices);
    let with = |change: Change<'_>| {
        let mut config = config.clone();
        change(&mut config);
        refusal(&rig, &config)
    };
    let cases: [(&str, Change<'_>); 12] = [
        ("devices", &|config| config.devices.clear()),
        ("devices[1].product", &|config| config.devices[1].product = None),
        ("devices[2].code_max", &|config| config.devices[2].mode = DriveMode::Velocity),
        ("devices[2].code_max", &|config| config.devices[2].code_max = Some(0)),
        ("period_us", &|config| config.period_us = 50),
        ("wait_share", &|config| config.wait_share = 0.5),
        ("watchdog_ms", &|config| config.watchdog_ms = 1),
        ("lost_ms", &|config| config.lost_ms = 0),
        ("encoders[1]", &|config| {
            config.encoders =
                vec![Place { device: 1, channel: 0 }, Place { device: 1, channel: 0 }];
        }),
        ("encoders[0].device", &|config| {
            config.encoders = vec![Place { device: 7, channel: 0 }];
        }),
        ("lines_in.estop_a.device", &|config| {
            config.lines_in.as_mut().unwrap().estop_a.device = 9;
        }),
        ("encoders", &|config| config.encoders = vec![Place { device: 0, channel: 0 }]),
    ];
    for (place, change) in cases {
        let (found, text) = with(change);
        assert_eq!(found, place, "{text}");
    }
    let (place, text) = with(&|config| {
        config.lines_out.as_mut().unwrap().brake_release = Some(terminal(1, 0));
    });
    assert_eq!(place, "lines_out");
    assert!(text.contains("device 1, channel 0: the device there is no terminal"), "{text}");
}

#[test]
fn an_interface_that_is_not_there_is_named() {
    let (_, config) = six_drives();
    for (interface, word) in [("", "is no interface"), ("no-such-if", "no raw socket")] {
        let config = Config { interface: interface.to_owned(), ..config.clone() };
        let bad = Segment::open(&config).unwrap_err();
        assert_eq!(bad.place(), "interface");
        assert!(bad.to_string().contains(word), "{bad}");
    }
}

#[test]
fn a_drive_that_does_not_know_the_mode_or_lacks_an_object_is_refused() {
    let (mut devices, config) = six_drives();
    devices[2] = devices[2].clone().with_object(0x6502, 0, &0x80_u32.to_le_bytes());
    let (place, text) = refusal(&Rig::new(devices.clone()), &config);
    assert_eq!(place, "devices");
    assert!(text.contains("position 2 does not know the mode cyclic synchronous torque"), "{text}");
    devices[2] = devices[2].clone().with_object(0x1600, 4, &0_u32.to_le_bytes());
    let mut unmapped = config.clone();
    let as_built = |one: &mut DeviceConfig| one.map = false;
    unmapped.devices.iter_mut().for_each(as_built);
    devices[2] = Description::from(Model::Drive);
    assert!(Rig::new(devices).open(&unmapped).is_ok(), "its own mapping holds all that is needed");
}

#[test]
fn drives_and_terminals_may_share_a_segment_but_not_a_half() {
    let (mut devices, mut config) = six_drives();
    devices.push(Model::AnalogOutput.into());
    config.devices.push(DeviceConfig::of(Kind::El4134));
    let rig = Rig::new(devices);
    assert_eq!(rig.open(&config).unwrap().analog_out.unwrap().channels(), 6);
    config.analog_out = vec![Place { device: 7, channel: 3 }, Place { device: 7, channel: 0 }];
    let mut lane = Lane::new(rig.open(&config).unwrap());
    assert_eq!(lane.halves.analog_out_volts_per_code.len(), 2);
    lane.cycles(&rig, 40, false, 0);
    let mut codes = [DacCode(0); CHANNELS];
    codes[0] = DacCode(16_384);
    for _ in 0..2 {
        lane.release += CYCLE_PERIOD;
        lane.halves.analog_out.as_mut().unwrap().commit(lane.release, &codes).unwrap();
    }
    assert_eq!(rig.outputs().volts, [0.0, 0.0, 0.0, 5.0]);
    config.analog_out[1] = Place { device: 1, channel: 0 };
    assert_eq!(refusal(&rig, &config).0, "analog_out");
}

#[test]
fn with_one_exchange_a_cycle_outputs_go_with_the_next_reading() {
    let (devices, mut config) = six_drives();
    config.exchange = ExchangeTimes::Once;
    let rig = Rig::with_motors(devices);
    let mut lane = Lane::new(rig.open(&config).unwrap());
    lane.cycles(&rig, 30, false, 0);
    let last = lane.cycles(&rig, 12, true, 0);
    assert!(last.analog.is_ok() && last.counts.is_ok(), "{last:?}");
    let before = rig.world().sent;
    lane.cycle(&rig, true, 700);
    assert_eq!(rig.world().sent - before, 1);
    assert_eq!(rig.world().segment.target_torques(), [0; 6]);
    lane.cycle(&rig, true, 0);
    assert_eq!(rig.world().segment.target_torques(), [700; 6]);
}

#[test]
fn velocity_and_position_are_followed_in_units_of_the_drive() {
    for mode in [DriveMode::Velocity, DriveMode::Position] {
        let mut config = six_drives().1;
        for device in &mut config.devices[1..] {
            *device = DeviceConfig { mode, code_max: Some(2_000), ..drive() };
        }
        let rig = Rig::with_motors(six_drives().0);
        let mut lane = Lane::new(rig.open(&config).unwrap());
        lane.cycles(&rig, 30, false, 0);
        let start = lane.cycles(&rig, 10, true, 0).counts.unwrap();
        let target = 400;
        let settled = lane.cycles(&rig, 3_000, true, target).counts.unwrap();
        let after = lane.cycles(&rig, 1_000, true, target).counts.unwrap();
        let (moved, drift) = (settled[0] - start[0], after[0] - settled[0]);
        match mode {
            // The drive's proportional loop leaves a fifth to friction.
            DriveMode::Velocity => assert!((250..400).contains(&drift), "{drift} counts in 1 s"),
            _ => assert!((moved - 400).abs() < 20 && drift.abs() < 3, "{moved}, {drift}"),
        }
    }
}
