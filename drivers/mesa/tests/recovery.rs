//! What bites and what comes after it: the card's watchdog, the remote's, and the order in which
//! outputs come back.

mod rig;

use rig::{CYCLE_PERIOD, Rig, field_word, with_7i77, with_pwm};
use taktil_drivers_mesa::{Config, Halves};
use taktil_drivers_mesa_emulator::Firmware;
use taktil_hal::{
    AnalogOut, CHANNELS, DacCode, DigitalIn, DigitalOut, Encoders, Error, ErrorKind, LinesIn,
    LinesOut, Nanos,
};

/// A robot's lane over the four halves.
struct Lane {
    rig: Rig,
    halves: Halves,
    release: Nanos,
    feed: bool,
}

const CODES: [DacCode; CHANNELS] = [DacCode(2_000); CHANNELS];

impl Lane {
    fn new(firmware: Firmware, config: &Config) -> Lane {
        let rig = Rig::new(firmware);
        let halves = rig.open(config).unwrap();
        rig.set_counts([0; 6]);
        rig.set_field(field_word(LinesIn { drive_power: true, ..LinesIn::default() }));
        let release = Nanos::from_millis(100);
        Lane { rig, halves, release, feed: false }
    }

    /// One job; the answers of the inputs and of the outputs.
    fn job(&mut self) -> (Result<(), Error>, Result<(), Error>) {
        self.release += CYCLE_PERIOD;
        self.rig.advance(self.release);
        self.feed = !self.feed;
        let (release, halves) = (self.release, &mut self.halves);
        let inputs = halves.encoders.as_mut().unwrap().sample(release).map(drop);
        let lines = halves.digital_in.as_mut().unwrap().sample(release).map(drop);
        let lines_out = LinesOut { enable: true, brake_release: true, watchdog_feed: self.feed };
        let codes = halves.analog_out.as_mut().unwrap().commit(release, &CODES);
        let digital = halves.digital_out.as_mut().unwrap().commit(release, &lines_out);
        (inputs.and(lines), codes.and(digital))
    }

    fn pause(&mut self, span: Nanos) {
        self.release += span;
        self.rig.advance(self.release);
    }

    fn bites(&self) -> u64 {
        self.rig.world.lock().unwrap().emulator.bites()
    }

    /// Datagrams since the last call.
    fn sent(&self) -> Vec<Vec<u8>> {
        std::mem::take(&mut self.rig.world.lock().unwrap().sent)
    }
}

const DRIVEN_VOLTS: f64 = 10.0 * 2_000.0 / 4_095.0;

fn is_transient(answer: Result<(), Error>) -> bool {
    answer.is_err_and(|error| error.kind == ErrorKind::Transient)
}

#[test]
fn a_cycle_is_one_request_and_one_write_packet() {
    for (firmware, config) in
        [(Firmware::with_7i77(), with_7i77()), (Firmware::with_pwm(), with_pwm())]
    {
        let mut lane = Lane::new(firmware, &config);
        for _ in 0..5 {
            assert_eq!(lane.job(), (Ok(()), Ok(())));
        }
        let _ = lane.sent();
        for _ in 0..10 {
            assert_eq!(lane.job(), (Ok(()), Ok(())));
        }
        let sent = lane.sent();
        assert_eq!(sent.len(), 20);
        assert!(sent.iter().all(|packet| packet.len() <= 1_472));
        let seen = lane.halves.monitor.diagnostics();
        assert_eq!((seen.timeouts, seen.lost_writes, seen.slow_exchanges), (0, 0, 0), "{seen:?}");
        assert_eq!(lane.rig.world.lock().unwrap().emulator.overrun_commands(), 0);
    }
}

/// A pause of 60 ms with a card whose own watchdog is set longer: only the 7I77's has bitten.
#[test]
fn a_pause_beyond_the_remote_watchdog_needs_a_stop_and_a_start_and_zeros_first() {
    let config = Config { watchdog_ms: 500, ..with_7i77() };
    let mut lane = Lane::new(Firmware::with_7i77(), &config);
    (0..10).for_each(|_| assert_eq!(lane.job().1, Ok(())));
    assert!((lane.rig.outputs().volts[0] - DRIVEN_VOLTS).abs() < 1e-9);
    lane.pause(Nanos::from_millis(60));
    assert_eq!(lane.rig.outputs().volts, [0.0; 6], "the remote's watchdog");
    assert_eq!(lane.bites(), 0);
    let _ = lane.sent();
    // The driver sees the fault in its next answer; until the outputs are back it says so.
    let (mut refused, mut back) = (0, false);
    for _ in 0..20 {
        let outcome = lane.job().1;
        let volts = lane.rig.outputs().volts[0];
        match outcome {
            Ok(()) => {
                assert!((volts - DRIVEN_VOLTS).abs() < 1e-9);
                back = true;
                break;
            }
            Err(error) => assert_eq!(error.kind, ErrorKind::Transient),
        }
        assert_eq!(volts, 0.0, "values before stop, start and zeros");
        refused += 1;
    }
    assert!(back && refused >= 3, "{refused}");
    let command = |packet: &Vec<u8>| {
        let at = packet.windows(4).position(|head| head == [0x81, 0xc2, 0x00, 0x5a])?;
        Some(u32::from_le_bytes(*packet[at + 4..].first_chunk::<4>()?))
    };
    let commands: Vec<u32> = lane.sent().iter().filter_map(command).collect();
    assert_eq!(commands, [0x0800, 0x0903, 0x1003, 0x1003]);
    let seen = lane.halves.monitor.diagnostics();
    assert_eq!((seen.remote_faults, seen.bites), (1, 0), "{seen:?}");
}

#[test]
fn after_a_bite_zeros_and_directions_come_before_the_status() {
    for (firmware, config, is_pwm) in
        [(Firmware::with_7i77(), with_7i77(), false), (Firmware::with_pwm(), with_pwm(), true)]
    {
        let mut lane = Lane::new(firmware, &config);
        (0..10).for_each(|_| assert_eq!(lane.job().1, Ok(())));
        let outputs = lane.rig.outputs();
        assert!(if is_pwm { outputs.pwm[0] > 0.4 } else { outputs.volts[0] > 4.0 });
        lane.pause(Nanos::from_millis(90));
        let outputs = lane.rig.outputs();
        assert_eq!((outputs.volts, outputs.driven[0]), ([0.0; 6], 0));
        assert!(outputs.pwm.iter().all(|duty| *duty == 0.0));
        assert_eq!(lane.bites(), 1);
        let _ = lane.sent();
        assert!(is_transient(lane.job().1));
        // What was put out before the bite stands in the registers: it must not come out again.
        let outputs = lane.rig.outputs();
        assert_eq!(outputs.volts, [0.0; 6]);
        assert!(outputs.pwm.iter().all(|duty| *duty == 0.0));
        assert_ne!(outputs.driven[0], 0, "directions are back");
        let sent = lane.sent();
        let place = |packet: &Vec<u8>, address: [u8; 2]| {
            packet.windows(4).position(|head| head == [0x81, 0xc2, address[0], address[1]])
        };
        let rearm = sent.iter().find(|packet| place(packet, [0x00, 0x11]).is_some()).unwrap();
        let zero = if is_pwm { [0x00, 0x40] } else { [0x04, 0x5d] };
        let zero = place(rearm, zero).unwrap();
        let (direction, status) =
            (place(rearm, [0x00, 0x11]).unwrap(), place(rearm, [0x00, 0x0d]).unwrap());
        assert!(zero < direction && direction < status);
        assert_eq!(rearm[zero + 4..zero + 8], [0; 4]);
        let back = (0..20).position(|_| lane.job() == (Ok(()), Ok(())));
        assert!(back.is_some(), "the outputs do not come back");
        let outputs = lane.rig.outputs();
        assert!(if is_pwm { outputs.pwm[0] > 0.4 } else { outputs.volts[0] > 4.0 });
        let seen = lane.halves.monitor.diagnostics();
        assert_eq!(seen.bites, 1, "{seen:?}");
        assert_eq!(lane.rig.register(0x0d00), 0);
    }
}

#[test]
fn who_lets_go_lets_the_watchdog_bite_at_once() {
    let mut lane = Lane::new(Firmware::with_7i77(), &with_7i77());
    (0..10).for_each(|_| assert_eq!(lane.job().1, Ok(())));
    let Lane { rig, halves, .. } = lane;
    drop(halves);
    let outputs = rig.outputs();
    assert_eq!(outputs.volts, [0.0; 6]);
    assert!(!outputs.analog_enabled);
    assert_eq!(outputs.driven, [0, 0]);
    assert_eq!(rig.world.lock().unwrap().emulator.bites(), 1);
}

/// A feed line that stands still must not be kept alive by the codes, nor the other way round.
#[test]
fn a_half_that_falls_silent_is_let_down_though_the_other_one_lives() {
    for silent_lines in [true, false] {
        let mut lane = Lane::new(Firmware::with_7i77(), &with_7i77());
        (0..10).for_each(|_| assert_eq!(lane.job().1, Ok(())));
        for _ in 0..60 {
            lane.release += CYCLE_PERIOD;
            lane.rig.advance(lane.release);
            let (release, halves) = (lane.release, &mut lane.halves);
            let _ = halves.encoders.as_mut().unwrap().sample(release);
            if silent_lines {
                let _ = halves.analog_out.as_mut().unwrap().commit(release, &CODES);
            } else {
                lane.feed = !lane.feed;
                let lines =
                    LinesOut { enable: true, brake_release: true, watchdog_feed: lane.feed };
                let _ = halves.digital_out.as_mut().unwrap().commit(release, &lines);
            }
        }
        assert!(lane.bites() > 0, "lines silent: {silent_lines}");
    }
}

#[test]
fn lines_of_terminals_are_as_old_as_the_exchange_that_read_them() {
    let mut lane = Lane::new(Firmware::with_7i77(), &with_7i77());
    for _ in 0..5 {
        lane.job().0.unwrap();
    }
    let before = lane.release;
    lane.release += CYCLE_PERIOD;
    lane.rig.advance(lane.release);
    let reading = lane.halves.digital_in.as_mut().unwrap().sample(lane.release).unwrap();
    assert_eq!(reading.acquired, before);
    assert!(reading.value.drive_power && !reading.value.estop_a_closed);
    assert!(!reading.value.estop_b_closed);
}

#[test]
fn an_early_request_is_collected_by_the_sample_and_not_asked_twice() {
    let mut lane = Lane::new(Firmware::with_7i77(), &with_7i77());
    lane.job().0.unwrap();
    let before = lane.halves.monitor.diagnostics().requests;
    let release = lane.release + CYCLE_PERIOD;
    lane.rig.advance(release);
    lane.halves.monitor.request(release);
    lane.halves.monitor.request(release);
    let encoders = lane.halves.encoders.as_mut().unwrap();
    encoders.request(release);
    encoders.sample(release).unwrap();
    encoders.request(release);
    let seen = lane.halves.monitor.diagnostics();
    assert_eq!(seen.requests, before + 1);
}

/// Who waits with everything at its safe values is bitten by nothing.
#[test]
fn a_lane_that_only_reads_after_going_safe_is_not_bitten() {
    for (firmware, config) in
        [(Firmware::with_7i77(), with_7i77()), (Firmware::with_pwm(), with_pwm())]
    {
        let mut lane = Lane::new(firmware, &config);
        (0..10).for_each(|_| assert_eq!(lane.job().1, Ok(())));
        lane.halves.analog_out.as_mut().unwrap().safe().unwrap();
        lane.halves.digital_out.as_mut().unwrap().safe().unwrap();
        for _ in 0..100 {
            lane.release += CYCLE_PERIOD;
            lane.rig.advance(lane.release);
            lane.halves.encoders.as_mut().unwrap().sample(lane.release).unwrap();
            lane.halves.digital_in.as_mut().unwrap().sample(lane.release).unwrap();
        }
        assert_eq!(lane.bites(), 0);
        let outputs = lane.rig.outputs();
        assert_eq!((outputs.volts, outputs.analog_enabled), ([0.0; 6], false));
    }
}
