//! Several 7I77s behind one card, on one smart-serial port and on two, with channels, terminals and
//! spindle enables by configuration; open drains and pins of modules.

mod rig;

use rig::{CYCLE_PERIOD, Rig, field, pin, with_7i77, with_pwm};
use taktil_drivers_mesa::{
    Analog, Board, Config, Halves, Line, LinesInConfig, LinesOutConfig, OutputPlace, RemotePlace,
    Terminal,
};
use taktil_drivers_mesa_emulator::{Firmware, Outputs};
use taktil_hal::{AnalogOut, CHANNELS, DacCode, DigitalIn, DigitalOut, Encoders, LinesOut, Nanos};

/// Analog outputs of the three 7I77s, as far as the traits have channels for them.
const OUTPUTS_COUNT: usize = if CHANNELS < 18 { CHANNELS } else { 18 };

fn remotes() -> Vec<RemotePlace> {
    [(0, 0), (0, 3), (1, 0)].map(|(port, channel)| RemotePlace { port, channel }).to_vec()
}

/// Three 7I77s behind a 7I80; the first output of each is one of the first three channels.
fn three() -> Config {
    let place = |channel| OutputPlace { remote: channel % 3, output: channel / 3 };
    Config {
        address: "10.10.10.10:27181".to_owned(),
        board: "7I80".to_owned(),
        remotes: remotes(),
        analog_channels: OUTPUTS_COUNT,
        outputs: (0..OUTPUTS_COUNT).map(place).collect(),
        encoders: CHANNELS.min(12),
        lines_in: Some(LinesInConfig {
            drive_power: field(3),
            estop_a: Line { remote: 1, ..field(4) },
            estop_b: Line { remote: 2, inverted: true, ..field(5) },
        }),
        lines_out: Some(LinesOutConfig {
            enable: Line { at: Terminal::Spindle, remote: 2, ..field(0) },
            brake_release: Line { remote: 1, ..field(7) },
            watchdog_feed: Some(field(2)),
        }),
        ..Config::default()
    }
}

struct Lane {
    rig: Rig,
    halves: Halves,
    release: Nanos,
    feed: bool,
}

impl Lane {
    fn new(firmware: Firmware, config: &Config) -> Lane {
        let rig = Rig::new(firmware);
        rig.set_fields(&[1 << 3, 1 << 4, 0]);
        rig.set_counts([0; 6]);
        let halves = rig.open(config).unwrap();
        Lane { rig, halves, release: Nanos::from_millis(100), feed: false }
    }

    fn begin(&mut self) {
        self.release += CYCLE_PERIOD;
        self.rig.advance(self.release);
        self.halves.encoders.as_mut().unwrap().sample(self.release).unwrap();
    }

    fn commit_codes(&mut self, codes: &[DacCode; CHANNELS]) {
        self.halves.analog_out.as_mut().unwrap().commit(self.release, codes).unwrap();
    }

    fn commit_lines(&mut self, enable: bool, brake_release: bool) {
        self.feed = !self.feed;
        let lines = LinesOut { enable, brake_release, watchdog_feed: self.feed };
        self.halves.digital_out.as_mut().unwrap().commit(self.release, &lines).unwrap();
    }

    fn outputs(&self) -> Outputs {
        self.rig.outputs()
    }
}

fn codes() -> [DacCode; CHANNELS] {
    core::array::from_fn(|channel| DacCode(100 * (channel as i32 + 1)))
}

#[test]
fn channels_terminals_and_enables_of_three_7i77s_are_where_the_list_says() {
    let mut lane = Lane::new(Firmware::with_three_7i77(), &three());
    for _ in 0..3 {
        lane.begin();
        lane.commit_codes(&codes());
        lane.commit_lines(true, true);
    }
    let outputs = lane.outputs();
    assert_eq!(outputs.remotes.len(), 3);
    for channel in 0..OUTPUTS_COUNT {
        let volts = outputs.remotes[channel % 3].volts[channel / 3];
        assert!(
            (volts - 10.0 * 100.0 * (channel as f64 + 1.0) / 4_095.0).abs() < 1e-9,
            "{channel}"
        );
    }
    let spindles: Vec<bool> = outputs.remotes.iter().map(|remote| remote.spindle).collect();
    assert_eq!(spindles, [false, false, true]);
    assert_eq!(outputs.remotes[1].field, 1 << 7);
    let reading = lane.halves.digital_in.as_mut().unwrap().sample(lane.release).unwrap();
    assert!(reading.value.drive_power && reading.value.estop_a_closed);
    assert!(reading.value.estop_b_closed);
    lane.rig.set_fields(&[1 << 3, 0, 1 << 5]);
    for _ in 0..3 {
        lane.begin();
        lane.commit_codes(&codes());
        lane.commit_lines(true, true);
    }
    let reading = lane.halves.digital_in.as_mut().unwrap().sample(lane.release).unwrap();
    assert!(reading.value.drive_power && !reading.value.estop_a_closed);
    assert!(!reading.value.estop_b_closed);
    let seen = lane.halves.monitor.diagnostics();
    assert_eq!((seen.slow_exchanges, seen.failed_exchanges, seen.timeouts), (0, 0, 0), "{seen:?}");
    assert_eq!(lane.rig.world.lock().unwrap().emulator.overrun_commands(), 0);
}

#[test]
fn without_a_list_the_outputs_follow_one_7i77_after_the_other() {
    let config = Config { outputs: Vec::new(), lines_in: None, lines_out: None, ..three() };
    let mut lane = Lane::new(Firmware::with_three_7i77(), &config);
    lane.begin();
    lane.commit_codes(&codes());
    let outputs = lane.outputs();
    for channel in 0..OUTPUTS_COUNT {
        let volts = outputs.remotes[channel / 6].volts[channel % 6];
        assert!(
            (volts - 10.0 * 100.0 * (channel as f64 + 1.0) / 4_095.0).abs() < 1e-9,
            "{channel}"
        );
    }
}

#[test]
fn going_safe_switches_a_spindle_enable_off_at_once_and_leaves_the_volts() {
    let mut lane = Lane::new(Firmware::with_three_7i77(), &three());
    for _ in 0..3 {
        lane.begin();
        lane.commit_codes(&codes());
        lane.commit_lines(true, false);
    }
    assert!(lane.outputs().remotes[2].spindle);
    lane.halves.digital_out.as_mut().unwrap().safe().unwrap();
    let outputs = lane.outputs();
    assert!(!outputs.remotes[2].spindle);
    assert!(outputs.remotes[0].volts[0] > 0.2);
    lane.halves.analog_out.as_mut().unwrap().safe().unwrap();
    assert!(lane.outputs().remotes.iter().all(|remote| remote.volts == [0.0; 6]));
}

/// The lines have died: neither their terminals nor their spindle enable are kept alive by codes.
#[test]
fn a_spindle_enable_falls_with_the_lines_that_are_silent() {
    let config = Config { watchdog_ms: 5_000, ..three() };
    let mut lane = Lane::new(Firmware::with_three_7i77(), &config);
    for _ in 0..3 {
        lane.begin();
        lane.commit_codes(&codes());
        lane.commit_lines(true, true);
    }
    for _ in 0..24 {
        lane.release += CYCLE_PERIOD;
        lane.rig.advance(lane.release);
        let _ = lane.halves.encoders.as_mut().unwrap().sample(lane.release);
        let _ = lane.halves.analog_out.as_mut().unwrap().commit(lane.release, &codes());
    }
    assert!(!lane.outputs().remotes[2].spindle);
}

/// A spindle enable alone, without any analog output, does not switch the volts on.
#[test]
fn a_spindle_enable_needs_no_analog_output() {
    let mut config = Config { analog: Analog::None, lines_in: None, ..three() };
    config.outputs = Vec::new();
    let mut lane = Lane::new(Firmware::with_three_7i77(), &config);
    for _ in 0..3 {
        lane.begin();
        lane.commit_lines(true, false);
    }
    let outputs = lane.outputs();
    assert!(outputs.remotes[2].spindle && !outputs.remotes[2].analog_enabled);
    assert!(!outputs.remotes[0].analog_enabled);
}

#[test]
fn outputs_at_places_that_do_not_exist_are_refused() {
    let base = three;
    let mut twice = base();
    twice.outputs[1] = twice.outputs[0].clone();
    let mut beyond = base();
    beyond.outputs[2].output = 6;
    let mut nowhere = base();
    nowhere.outputs[2].remote = 3;
    let mut line = base();
    line.lines_in.as_mut().unwrap().estop_a.remote = 3;
    let mut spindle_in = base();
    spindle_in.lines_in.as_mut().unwrap().estop_a.at = Terminal::Spindle;
    let mut drain = base();
    drain.lines_out.as_mut().unwrap().enable.open_drain = true;
    let mut port = base();
    port.remotes[2].port = 4;
    let mut overlapping = base();
    overlapping.remotes[1].channel = 1;
    let few = Config { remotes: remotes()[..1].to_vec(), outputs: Vec::new(), ..with_7i77() };
    let few = Config { analog_channels: 7, ..few };
    let many = Config { remotes: vec![RemotePlace::default(); 9], ..base() };
    let short = Config { outputs: base().outputs[1..].to_vec(), ..base() };
    for (config, place) in [
        (twice, "outputs[1]"),
        (beyond, "outputs[2].output"),
        (nowhere, "outputs[2].remote"),
        (line, "lines_in.estop_a.remote"),
        (spindle_in, "lines_in.estop_a.at"),
        (drain, "lines_out.enable.open_drain"),
        (port, "remotes[2].port"),
        (overlapping, "remotes[1].channel"),
        (few, "analog_channels"),
        (many, "remotes"),
        (short, "outputs"),
    ] {
        let error = Board::open(&config).expect_err(place);
        assert_eq!(error.place(), place, "{error}");
    }
}

#[test]
fn a_7i77_or_a_port_that_the_card_does_not_have_is_named() {
    let mut firmware = Firmware::with_three_7i77();
    firmware.remotes[9] = ([0; 4], 0);
    let error = Rig::new(firmware).open(&three()).expect_err("no remote");
    assert!(error.to_string().contains("smart-serial channel 1 of port 1"), "{error}");
    let mut firmware = Firmware::with_three_7i77();
    firmware.modules.iter_mut().filter(|m| m.tag == 193).for_each(|m| m.instances = 1);
    let error = Rig::new(firmware).open(&three()).expect_err("one port");
    assert!(error.to_string().contains("1 x smart serial and 2 are configured"), "{error}");
}

/// The registers of a port's pins: directions, alternates, open drains, inversions.
fn port_words(rig: &Rig, port: u16) -> [u32; 4] {
    [0x1100, 0x1200, 0x1300, 0x1400].map(|address: u16| rig.register(address + 4 * port))
}

#[test]
fn an_open_drain_only_pulls_down_and_survives_a_bite() {
    let mut config = with_pwm();
    let lines = config.lines_out.as_mut().unwrap();
    lines.enable = Line { open_drain: true, inverted: true, ..pin(50) };
    lines.brake_release = Line { inverted: true, ..pin(51) };
    let mut lane = Lane::new(Firmware::with_pwm(), &config);
    let drain = 1 << (50 % 24);
    let [direction, alternate, open_drain, inverted] = port_words(&lane.rig, 2);
    assert_eq!((open_drain, inverted, alternate & drain), (drain, 0, 0));
    assert_ne!(direction & drain, 0);
    // High is floating: the line is off.
    assert_ne!(lane.rig.register(0x1008) & drain, 0);
    lane.begin();
    lane.commit_codes(&[DacCode(0); CHANNELS]);
    lane.commit_lines(true, false);
    assert_eq!(lane.outputs().pins[2] & drain, 0, "pulled down");
    // A bite forgets directions and open drains; the driver writes both again.
    lane.release += Nanos::from_millis(90);
    lane.rig.advance(lane.release);
    assert_eq!(lane.outputs().open_drains[2], 0);
    for _ in 0..10 {
        lane.release += CYCLE_PERIOD;
        lane.rig.advance(lane.release);
        let _ = lane.halves.encoders.as_mut().unwrap().sample(lane.release);
    }
    assert_eq!(port_words(&lane.rig, 2)[2], drain);
}

/// What a program before has left in the registers must not turn levels over.
#[test]
fn inversions_and_open_drains_of_a_program_before_are_cleared() {
    let rig = Rig::new(Firmware::with_pwm());
    {
        let mut world = rig.world.lock().unwrap();
        for address in [0x1300_u16, 0x1400] {
            let mut packet = vec![0x83, 0xc2];
            packet.extend(address.to_le_bytes());
            packet.extend([0xff; 12]);
            let now = world.now;
            world.emulator.receive(now, &packet);
        }
    }
    assert_eq!(port_words(&rig, 1)[2..], [u32::MAX; 2]);
    let _halves = rig.open(&with_pwm()).unwrap();
    assert_eq!(port_words(&rig, 1)[2..], [0; 2]);
}

#[test]
fn pins_of_modules_that_nobody_uses_are_free_and_others_are_not() {
    // Modulator 5 is not used, its pins 33..=35 take lines; encoder pins take no output.
    let mut config = Config { analog_channels: 5, ..with_pwm() };
    config.lines_out.as_mut().unwrap().enable = pin(33);
    let rig = Rig::new(Firmware::with_pwm());
    let _halves = rig.open(&config).unwrap();
    let [direction, alternate, ..] = port_words(&rig, 1);
    assert_eq!((direction >> 9 & 1, alternate >> 9 & 1), (1, 0));
    assert_eq!(direction >> 10 & 3, 0, "no module drives the others");
    config.lines_out.as_mut().unwrap().enable = pin(0);
    let error = Rig::new(Firmware::with_pwm()).open(&config).expect_err("an encoder's pin");
    assert!(error.to_string().contains("pin 0 is an input of a module"), "{error}");
}

#[test]
fn modulators_are_chosen_by_the_list() {
    let outputs = [5, 0].map(|output| OutputPlace { remote: 0, output }).to_vec();
    let config = Config { analog_channels: 2, outputs, ..with_pwm() };
    let mut lane = Lane::new(Firmware::with_pwm(), &config);
    lane.begin();
    lane.commit_codes(&core::array::from_fn(|channel| DacCode(4_095 - 4_095 * channel as i32)));
    lane.commit_lines(false, false);
    let duties = lane.outputs().pwm;
    assert!((duties[5] - 1.0).abs() < 1e-9 && duties[..5].iter().all(|duty| *duty == 0.0));
}
