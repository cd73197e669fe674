//! What cannot be opened, and what the message says about it.

mod rig;

use rig::{Rig, field, pin, with_7i77, with_pwm};
use taktil_drivers_mesa::{Analog, Board, Config, EncoderKind, OpenError, Port, RemotePlace};
use taktil_drivers_mesa_emulator::{Firmware, ModuleEntry};
use taktil_hal::CHANNELS;

/// The message must name the address, say `what`, point at `place` and offer a remedy.
fn refused(firmware: Firmware, config: &Config, place: &str, what: &str) {
    let error = Rig::new(firmware).open(config).expect_err(what);
    let text = error.to_string();
    assert_eq!(error.place(), place, "{text}");
    assert!(text.starts_with("10.10.10.10:27181: "), "{text}");
    assert!(text.contains(what), "{text}");
    assert!(text.split("; ").nth(1).is_some_and(|remedy| remedy.len() > 10), "{text}");
}

fn without(tag: u8) -> Firmware {
    let mut firmware = Firmware::with_7i77();
    firmware.modules.retain(|module| module.tag != tag);
    firmware
}

#[test]
fn a_stranger_is_refused_by_what_it_says() {
    let base = Firmware::with_7i77;
    let config = with_7i77();
    refused(Firmware { cookie: 1, ..base() }, &config, "address", "the cookie reads 0x00000001");
    let other = Firmware { config_name: *b"HOSTMOT3", ..base() };
    refused(other, &config, "address", "HOSTMOT3");
    refused(Firmware { idrom_type: 4, ..base() }, &config, "address", "of type 4");
    refused(Firmware { idrom_type: 1, ..base() }, &config, "address", "of type 1");
    let other = Firmware { board_name: *b"MESA7I80", ..base() };
    refused(other, &config, "board", "the card is a 7I80, not a 7I92");
}

#[test]
fn both_known_types_of_idrom_are_taken() {
    for idrom_type in [2, 3] {
        let rig = Rig::new(Firmware { idrom_type, ..Firmware::with_7i77() });
        assert!(rig.open(&with_7i77()).is_ok(), "{idrom_type}");
    }
}

#[test]
fn a_module_that_is_missing_or_has_too_few_channels_is_named() {
    let config = with_7i77();
    refused(without(2), &config, "watchdog_ms", "has no watchdog");
    refused(without(3), &config, "address", "has no port of pins");
    refused(without(12), &config, "encoders", "has no encoder");
    refused(without(193), &config, "analog", "has no smart serial");
    let eight = Config { encoders: 8, ..with_7i77() };
    refused(Firmware::with_7i77(), &eight, "encoders", "has 6 x encoder and 8 are configured");
    let pwm = Config { analog: Analog::Pwm, ..with_7i77() };
    refused(Firmware::with_7i77(), &pwm, "analog", "has no pulse-width modulator");
    let seven = Config { analog_channels: 7, ..with_pwm() };
    refused(Firmware::with_pwm(), &seven, "analog", "has 6 x pulse-width modulator");
    let other_channel =
        Config { remotes: vec![RemotePlace { port: 0, channel: 2 }], ..with_7i77() };
    refused(Firmware::with_7i77(), &other_channel, "remotes", "has no channel 3");
}

#[test]
fn a_remote_that_is_missing_or_another_one_is_named() {
    let config = with_7i77();
    let mut firmware = Firmware::with_7i77();
    firmware.remotes[1] = ([0; 4], 0);
    refused(firmware, &config, "remotes", "no remote answers on smart-serial channel 1");
    let mut firmware = Firmware::with_7i77();
    firmware.remotes[0].0 = *b"7I76";
    refused(firmware, &config, "remotes", "\"7I76\", number 0x12000123");
    let mut firmware = Firmware::with_7i77();
    firmware.remotes.swap(0, 1);
    refused(firmware, &config, "remotes", "not the field terminals of a 7I77");
}

#[test]
fn a_pin_that_is_not_free_is_named() {
    let mut config = with_pwm();
    let lines = config.lines_out.as_mut().unwrap();
    // Pin 3 is a modulator's output.
    lines.enable = pin(3);
    refused(Firmware::with_pwm(), &config, "lines_out.enable", "pin 3 is driven by a module");
    let mut config = with_pwm();
    config.lines_in.as_mut().unwrap().estop_a = pin(72);
    refused(Firmware::with_pwm(), &config, "lines_in.estop_a", "has no pin 72");
    let mut config = with_pwm();
    config.lines_out.as_mut().unwrap().enable = pin(49);
    refused(Firmware::with_pwm(), &config, "lines_in.estop_a", "pin 49 is an output");
    let mut config = with_7i77();
    config.lines_out.as_mut().unwrap().enable = field(1);
    refused(Firmware::with_7i77(), &config, "lines_out.brake_release", "is used twice");
}

#[test]
fn silence_is_told_with_what_to_check() {
    let rig = Rig::new(Firmware::with_7i77()).with_faults(&["kind=silence"], 1);
    let error = rig.open(&with_7i77()).expect_err("nobody answers");
    assert_eq!(error.place(), "address");
    assert!(error.to_string().contains("no card answers within 200 ms"), "{error}");
    assert!(error.to_string().contains("jumpers"), "{error}");
}

#[test]
fn an_opening_survives_a_bad_link() {
    let faults = [
        "kind=loss value=0.1",
        "kind=duplication value=0.1",
        "kind=reordering value=0.1",
        "kind=truncation value=0.05",
    ];
    for seed in 0..20 {
        let rig = Rig::new(Firmware::with_7i77()).with_faults(&faults, seed);
        if let Err(error) = rig.open(&with_7i77()) {
            panic!("{seed}: {error}");
        }
    }
}

/// Every address is the table's: a card with other bases, strides and selectors works as well.
#[test]
fn other_addresses_and_strides_are_found_by_the_table() {
    let mut firmware = Firmware::with_7i77();
    firmware.strides = [8, 0x80, 0x100, 0x400];
    firmware.idrom = 0x0800;
    for ModuleEntry { tag, base, strides, .. } in &mut firmware.modules {
        match tag {
            2 => *base = 0x0f00,
            3 => (*base, *strides) = (0x1400, 0x00),
            12 => (*base, *strides) = (0x6000, 0x11),
            193 => (*base, *strides) = (0x7000, 0x10),
            _ => {}
        }
    }
    let rig = Rig::new(firmware);
    let mut halves = rig.open(&with_7i77()).unwrap();
    rig.set_counts([1, 2, 3, 4, 5, 6].map(|joint| 100 * joint));
    use taktil_hal::{AnalogOut, Counts, DacCode, Encoders, Nanos};
    let release = Nanos::from_millis(500);
    rig.advance(release);
    let counts = halves.encoders.as_mut().unwrap().sample(release).unwrap().value;
    assert_eq!(counts[..6], [100, 200, 300, 400, 500, 600].map(Counts));
    let analog = halves.analog_out.as_mut().unwrap();
    analog.commit(release, &[DacCode(-4_096); CHANNELS]).unwrap();
    assert_eq!(rig.outputs().volts, [-10.0; 6]);
}

#[test]
fn answers_that_were_padded_on_the_way_are_taken() {
    let rig = Rig::new(Firmware::with_7i77());
    rig.world.lock().unwrap().padding = 18;
    rig.set_counts([7; 6]);
    let mut halves = rig.open(&with_7i77()).unwrap();
    use taktil_hal::{Counts, Encoders, Nanos};
    let release = Nanos::from_millis(500);
    rig.advance(release);
    let reading = halves.encoders.as_mut().unwrap().sample(release).unwrap();
    assert_eq!(reading.value[5], Counts(7));
    assert_eq!(halves.monitor.diagnostics().malformed_answers, 0);
}

/// A card whose firmware answers nothing but its own counts of errors.
struct Refuser {
    asked: bool,
}

impl Port for Refuser {
    fn send(&mut self, packet: &[u8]) -> std::io::Result<()> {
        // Three words of 16 bits of space 6, from byte 2 on.
        self.asked = packet == [0x83, 0x59, 0x02, 0x00];
        Ok(())
    }

    fn start_wait(&mut self, _wait: taktil_hal::Nanos) {}

    fn receive(&mut self, buffer: &mut [u8]) -> Option<usize> {
        if !std::mem::take(&mut self.asked) {
            return None;
        }
        buffer[..6].copy_from_slice(&[10, 0, 2, 0, 0, 1]);
        Some(6)
    }
}

#[test]
fn a_card_that_refuses_packets_is_told_by_its_own_counts() {
    let error = Board::attach(Box::new(Refuser { asked: false }), &with_7i77()).expect_err("no");
    assert_eq!(error.place(), "address");
    let what = "it counts 10 errors of commands, 2 of addresses, 256 of writes; load a firmware";
    assert!(error.to_string().contains(what), "{error}");
}

/// Modules in any order, strange ones among them, and two kinds of encoders.
#[test]
fn a_table_in_another_order_with_unknown_modules_is_understood() {
    let mut firmware = Firmware::with_7i77();
    firmware.modules.reverse();
    let plain = ModuleEntry { tag: 4, instances: 2, base: 0x3000, ..firmware.modules[0].clone() };
    let plain = ModuleEntry { registers: 5, multiple: 3, strides: 0, ..plain };
    let unknown = ModuleEntry { tag: 0x77, instances: 9, base: 0x7700, ..plain.clone() };
    firmware.modules.insert(0, unknown);
    firmware.modules.insert(1, plain);
    (firmware.clock_low_hz, firmware.clock_high_hz) = (72_000_000, 180_000_000);
    let open = |kind, encoders| {
        let config = Config { encoder_kind: kind, encoders, ..with_7i77() };
        Rig::new(firmware.clone()).open(&config)
    };
    assert!(open(EncoderKind::Any, 6).is_ok(), "the first module has two only");
    assert!(open(EncoderKind::Muxed, 1).is_ok());
    assert!(open(EncoderKind::Plain, 2).is_ok());
    let error = open(EncoderKind::Plain, 3).expect_err("two");
    assert!(error.to_string().contains("has 2 x plain encoder"), "{error}");
}

#[test]
fn a_config_out_of_bounds_is_refused_by_its_place() {
    let good = with_7i77();
    let mut bad_line = with_7i77();
    bad_line.lines_out.as_mut().unwrap().enable = field(16);
    let bad = [
        ("address", Config::default()),
        ("address", Config { address: "10.10.10.10".to_owned(), ..good.clone() }),
        ("encoders", Config { encoders: CHANNELS + 1, ..good.clone() }),
        ("analog_channels", Config { analog_channels: 7, ..good.clone() }),
        ("analog_channels", Config { analog_channels: 0, ..good.clone() }),
        (
            "remotes[0].channel",
            Config { remotes: vec![RemotePlace { port: 0, channel: 7 }], ..good.clone() },
        ),
        ("step_max_counts", Config { step_max_counts: 0, ..good.clone() }),
        ("pwm_hz", Config { pwm_hz: 10, ..good.clone() }),
        ("period_us", Config { period_us: 0, ..good.clone() }),
        ("wait_share", Config { wait_share: 1.0, ..good.clone() }),
        ("wait_share", Config { wait_share: f64::NAN, ..good.clone() }),
        ("lost_ms", Config { lost_ms: 0, ..good.clone() }),
        ("watchdog_ms", Config { watchdog_ms: 0, ..good.clone() }),
        ("remote_watchdog_ms", Config { remote_watchdog_ms: 0, ..good.clone() }),
        ("open_wait_ms", Config { open_wait_ms: 0, ..good }),
        ("lines_out.enable.number", bad_line),
    ];
    for (place, config) in bad {
        let error = Board::open(&config).expect_err(place);
        assert_eq!(error.place(), place);
        assert!(matches!(error, OpenError::Invalid(_)), "{place}");
    }
}

#[test]
fn a_machine_file_needs_the_address_alone_and_no_unknown_key() {
    let config: Config = toml::from_str("address = \"10.10.10.10:27181\"").unwrap();
    config.check().unwrap();
    let lines = "address = \"[::1]:27181\"\nanalog = \"pwm\"\n[lines_out]\n\
                 enable = { at = \"pin\", number = 5 }\n\
                 brake_release = { at = \"field\", number = 0, inverted = true }";
    toml::from_str::<Config>(lines).unwrap().check().unwrap();
    for text in ["address = \"x\"\nsign = -1", "analog = \"7i76\"", "encoders = -1"] {
        assert!(toml::from_str::<Config>(text).is_err(), "{text}");
    }
    use taktil_hal::explain::Explain;
    let keys = Config::keys();
    assert!(keys.iter().all(|key| !key.about.is_empty()), "{keys:?}");
    assert!(keys.iter().any(|key| key.path == "lines_in.estop_a.number"));
}
