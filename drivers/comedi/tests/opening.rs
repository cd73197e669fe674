//! What a board does not have, and what another process holds, is refused with the place of the
//! channel and a remedy; what is wired wrong is refused before anything is written.

mod rig;

use rig::{
    ANALOG_OUT_SUBDEVICE, LINES_SUBDEVICE, SharedDouble, codes_out, lines_out, robot_config,
};
use taktil_drivers_comedi::{
    AnalogChannel, Config, CounterSetup, EncoderChannel, Level, Reference, write_safe_values_to,
};
use taktil_drivers_comedi_double::{Double, Kind, Subdevice, VoltRange};
use taktil_hal::explain::Explain;
use taktil_hal::{CHANNELS, DacCode, LinesOut, Nanos};

fn refusal(double: Double, change: impl FnOnce(&mut Config)) -> String {
    let double = SharedDouble::new(double);
    let mut config = robot_config();
    change(&mut config);
    let error = double.open(&config).unwrap_err();
    assert!(!double.look().is_locked(ANALOG_OUT_SUBDEVICE), "a refused board stays unlocked");
    error.to_string()
}

fn robot_refusal(change: impl FnOnce(&mut Config)) -> String {
    refusal(Double::robot_board(24), change)
}

#[test]
fn a_subdevice_that_is_missing_is_named() {
    let text = refusal(Double::comedi_test(), |_| {});
    assert!(text.starts_with("lines_out.enable.subdevice: board `comedi_test` has no digital"));
    let text = refusal(Double::comedi_test(), |config| config.lines_out = None);
    assert!(
        text.starts_with("encoders[0].subdevice: board `comedi_test` has no counter"),
        "{text}"
    );
    let text = robot_refusal(|config| config.encoders[2].subdevice = Some(0));
    assert!(text.contains("encoders[2].subdevice: subdevice 0 is analog input, not counter"));
    let text = robot_refusal(|config| config.analog_out[1].subdevice = Some(9));
    assert!(text.starts_with("analog_out[1].subdevice: 9 is beyond the board's 4"), "{text}");
}

#[test]
fn a_channel_that_is_missing_is_named() {
    let text = robot_refusal(|config| config.analog_out[5].channel = 8);
    assert!(text.starts_with("analog_out[5].channel: subdevice 1 has no channel 8, it has 8"));
    let text = robot_refusal(|config| config.encoders[0].channel = 8);
    assert!(text.starts_with("encoders[0].channel: "), "{text}");
    let text =
        robot_refusal(|config| config.lines_in.as_mut().unwrap().estop_a_closed.channel = 24);
    assert!(text.starts_with("lines_in.estop_a_closed.channel: "), "{text}");
}

#[test]
fn more_channels_than_a_half_carries_are_refused_by_name() {
    let many = |count: u16| (0..count).map(AnalogChannel::new).collect();
    let text = robot_refusal(|config| config.analog_in = many(CHANNELS as u16 + 1));
    assert!(text.starts_with(&format!("analog_in[{CHANNELS}]: ")), "{text}");
    let text = robot_refusal(|config| config.force_torque = many(5));
    assert!(text.starts_with("force_torque: 5 channels are listed; list the six"), "{text}");
}

#[test]
fn a_range_that_is_missing_is_refused_with_those_that_there_are() {
    let text = robot_refusal(|config| config.analog_in[1].high_v = 12.0);
    let due = "analog_in[1]: no range holds -10 to 12 V; set `low_v` and `high_v` to fit one of: \
               -10 to 10 V, -5 to 5 V";
    assert_eq!(text, due);
    let text = robot_refusal(|config| config.analog_in[1].low_v = f64::NAN);
    assert!(text.starts_with("analog_in[1].low_v: NaN is out of bounds"), "{text}");
    let text = robot_refusal(|config| config.analog_in[1].gain = 0.1);
    assert!(text.starts_with("analog_in[1].gain: 0.1 is out of bounds; give 0.5 to 2"), "{text}");
    let text = robot_refusal(|config| config.analog_in[1].reference = Reference::Differential);
    assert!(text.starts_with("analog_in[1].reference: subdevice 0 cannot"), "{text}");
}

#[test]
fn an_output_without_zero_volts_is_refused() {
    let ranges = [VoltRange { min_uv: 1_000_000, max_uv: 5_000_000 }];
    let double = Double::new("comedi", "d", "b")
        .with(Subdevice::new(Kind::AnalogOut, 2, 12).with_ranges(&ranges));
    let mut config = Config::new("/dev/comedi0", 10);
    config.analog_out = vec![AnalogChannel { low_v: 1.0, high_v: 5.0, ..AnalogChannel::new(0) }];
    let text = SharedDouble::new(double).open(&config).unwrap_err().to_string();
    assert!(text.starts_with("analog_out[0]: the range does not hold 0 V"), "{text}");
}

#[test]
fn a_channel_that_serves_twice_is_refused() {
    let text = robot_refusal(|config| config.analog_out[4].channel = 2);
    assert!(text.starts_with("analog_out[4]: is the channel of analog_out[2] too"), "{text}");
    let text = robot_refusal(|config| {
        let enable = config.lines_out.as_ref().unwrap().enable.clone();
        config.lines_in.as_mut().unwrap().drive_power = enable;
    });
    assert!(text.starts_with("lines_in.drive_power: channel 8 of subdevice 2 is an output"));
}

#[test]
fn an_input_among_outputs_of_one_group_is_refused() {
    let text = robot_refusal(|config| config.lines_in.as_mut().unwrap().drive_power.channel = 12);
    let due = "channel 12 of subdevice 2 took the direction of another line";
    assert!(text.contains(due) && text.contains("different groups"), "{text}");
}

#[test]
fn a_counter_of_an_odd_modulus_is_refused() {
    let double = Double::new("comedi", "d", "b")
        .with(Subdevice::new(Kind::Counter, 1, 16).with_largest_sample(9_999));
    let mut config = Config::new("/dev/comedi0", 10);
    config.encoders = vec![EncoderChannel::new(0, CounterSetup::Running)];
    let text = SharedDouble::new(double).open(&config).unwrap_err().to_string();
    assert!(text.starts_with("encoders[0]: the counter goes to 9999"), "{text}");
}

#[test]
fn another_board_is_refused_and_driver_or_board_are_accepted() {
    let text = robot_refusal(|config| config.board = Some("pci-6221".to_owned()));
    assert!(text.starts_with("board: driver `double_driver` with board `double-6` is attached"));
    for name in ["double_driver", "double-6"] {
        let double = SharedDouble::new(Double::robot_board(24));
        let config = Config { board: Some(name.to_owned()), ..robot_config() };
        double.open(&config).unwrap();
    }
}

#[test]
fn a_board_of_another_process_is_refused_and_left_alone() {
    let double = SharedDouble::new(Double::robot_board(24));
    let mut first = double.open(&robot_config()).unwrap();
    let codes = [DacCode(700); CHANNELS];
    first.analog_out.as_mut().unwrap().commit(Nanos::ZERO, &codes).unwrap();
    let text = double.open(&robot_config()).unwrap_err().to_string();
    assert!(text.starts_with("/dev/comedi0: locking subdevice 0 failed (EBUSY"), "{text}");
    assert!(text.contains("another process"), "{text}");
    let text = write_safe_values_to(double.node().unwrap(), &robot_config()).unwrap_err();
    assert!(text.to_string().contains("another process"), "{text}");
    assert_eq!(codes_out(&double)[..6], codes[..6]);
    drop(first);
    double.open(&robot_config()).unwrap();
}

#[test]
fn an_unplugged_board_is_refused_with_the_remedy() {
    let double = SharedDouble::new(Double::robot_board(24));
    let node = double.node().unwrap();
    double.plan(&["kind=unplugged"]);
    let text = taktil_drivers_comedi::attach(node, &robot_config()).unwrap_err().to_string();
    assert!(text.contains("ENODEV") && text.contains("no board is attached"), "{text}");
}

#[test]
fn a_board_that_was_never_safe_is_safe_after_opening() {
    let double = SharedDouble::new(Double::robot_board(24));
    let _halves = double.open(&robot_config()).unwrap();
    assert_eq!(codes_out(&double)[..6], [DacCode(0); 6]);
    assert_eq!(codes_out(&double)[6], DacCode(-1), "an unused channel stays as at power-up");
    assert_eq!(lines_out(&double), LinesOut::SAFE);
    assert_eq!(
        double.look().level(LINES_SUBDEVICE, 9),
        Some(true),
        "the brake's lower level lifts it"
    );
    assert_eq!(double.look().level(LINES_SUBDEVICE, 0), None, "an input is not driven");
}

#[test]
fn safe_values_are_written_after_the_process_died() {
    let double = SharedDouble::new(Double::robot_board(24));
    let mut halves = double.open(&robot_config()).unwrap();
    let lines = LinesOut { enable: true, brake_release: true, watchdog_feed: true };
    halves.digital_out.as_mut().unwrap().commit(Nanos::ZERO, &lines).unwrap();
    let codes = [DacCode(-9_000); CHANNELS];
    halves.analog_out.as_mut().unwrap().commit(Nanos::ZERO, &codes).unwrap();
    // A killed process drops nothing; the kernel closes its node, and nodes count from 0.
    std::mem::forget(halves);
    double.look().close(0);
    assert_eq!((lines_out(&double), codes_out(&double)[0]), (lines, DacCode(-9_000)));
    write_safe_values_to(double.node().unwrap(), &robot_config()).unwrap();
    assert_eq!(codes_out(&double)[..6], [DacCode(0); 6]);
    assert_eq!(lines_out(&double), LinesOut { watchdog_feed: true, ..LinesOut::SAFE });
}

#[test]
fn a_calibrated_output_is_safe_at_true_zero() {
    let double = SharedDouble::new(Double::robot_board(24));
    let mut config = robot_config();
    config.analog_out[0].offset_codes = 25.0;
    let _halves = double.open(&config).unwrap();
    assert_eq!(codes_out(&double)[..2], [DacCode(25), DacCode(0)]);
}

#[test]
fn a_section_of_a_file_is_read_and_mistyped_keys_are_refused() {
    let text = r#"
        path = "/dev/comedi0"
        board = "pci-6221"
        watchdog_ms = 10
        encoders = [{ subdevice = 11, setup = "armed", source_a = 9 }, { channel = 1 }]
        analog_out = [{ channel = 0 }, { channel = 1, low_v = 0.0, reference = "common" }]
        [lines_in]
        drive_power = { channel = 0, active = "low" }
        estop_a_closed = { channel = 1, active = "low" }
        estop_b_closed = { subdevice = 3, channel = 2, active = "high" }
    "#;
    let config: Config = toml::from_str(text).unwrap();
    config.check().unwrap();
    assert_eq!(config.encoders[1], EncoderChannel::new(1, CounterSetup::Running));
    assert_eq!(config.analog_out[0], AnalogChannel::new(0));
    assert_eq!(config.lines_in.unwrap().estop_b_closed.active, Level::High);
    assert!(toml::from_str::<Config>(&text.replace("source_a", "source_c")).is_err());
    assert!(toml::from_str::<Config>(&text.replace("channel = 0, active", "active")).is_err());
    assert!(toml::from_str::<Config>(&text.replace(", active = \"high\"", "")).is_err());
}

#[test]
fn every_key_explains_itself() {
    let keys = Config::keys();
    assert!(keys.iter().all(|key| key.path.ends_with("[]") || !key.about.is_empty()), "{keys:?}");
    let gain = keys.iter().find(|key| key.path == "analog_in[].gain").unwrap();
    assert_eq!(gain.range, Some((0.5, 2.0)));
}

#[test]
fn volts_of_a_code_follow_the_chosen_range() {
    let double = SharedDouble::new(Double::robot_board(24));
    let halves = double.open(&robot_config()).unwrap();
    let close = |volts: f64, due: f64| (volts - due).abs() < 1e-12;
    assert!(close(halves.analog_in_volts_per_code[0], 20.0 / 65_535.0));
    assert!(close(halves.force_torque_volts_per_code[0], 10.0 / 65_535.0));
}
