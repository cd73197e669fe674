//! Tests the board through its halves, with the model behind the registers: loop-back, torn and
//! stuck frames, counters that wrap, boards that vanish, and the watchdog.

use std::sync::Arc;

use taktil_drivers_regmap::registers::{
    ADC, DAC_STROBE, DIGITAL_IN, ENCODERS, FORCE_TORQUE, ID, ID_VALUE, INDEX, TACTILE,
};
use taktil_drivers_regmap::{Board, Config, Loopback, RegisterFile};
use taktil_hal::{
    Arrival, CHANNELS, Counts, DacCode, Devices, Error, ErrorKind, LinesIn, LinesOut, Nanos,
    TactileFrame,
};

fn rig(config: &Config) -> (Arc<RegisterFile>, Loopback, Devices) {
    let registers = Arc::new(RegisterFile::anonymous().unwrap());
    let model = Loopback::new(registers.clone(), config).unwrap();
    let devices = Board::attach(registers.clone(), config).unwrap();
    (registers, model, devices)
}

fn ms(n: i64) -> Nanos {
    Nanos::from_millis(n)
}

const DRIVE: LinesOut = LinesOut { enable: true, brake_release: true, watchdog_feed: true };

#[test]
fn analog_in_reads_what_analog_out_puts_out() {
    for (dac_bits, adc_bits) in [(12, 12), (12, 16), (16, 12)] {
        let config = Config { dac_bits, adc_bits, ..Config::default() };
        let (_, mut model, mut devices) = rig(&config);
        let (low, high) = devices.analog_out.as_mut().unwrap().code_range();
        let codes = [low.0, -16, 0, 16, 32, 48, 64, high.0 & !15].map(DacCode);
        devices.analog_out.as_mut().unwrap().commit(ms(0), &wide(codes)).unwrap();
        model.tick(ms(0));
        let scale = f64::from(1 << adc_bits) / f64::from(1 << dac_bits);
        let read = devices.analog_in.as_mut().unwrap().sample(ms(0)).unwrap().value;
        let due = codes.map(|code| f64::from(code.0) * scale);
        assert_eq!(
            read[..8].iter().map(|code| f64::from(code.0)).collect::<Vec<_>>(),
            due,
            "{dac_bits} to {adc_bits} bits"
        );
    }
}

#[test]
fn counters_wrap_and_go_on() {
    let config = Config { counter_bits: 16, ..Config::default() };
    let (_, mut model, mut devices) = rig(&config);
    for step in 0..100i32 {
        let count = step * 20_000;
        model.set_counts([count; CHANNELS]);
        model.tick(ms(i64::from(step)));
        let read = devices.encoders.as_mut().unwrap().sample(ms(i64::from(step))).unwrap().value;
        assert_eq!(read[5].0, count);
    }
    let (_, mut model, mut devices) = rig(&Config::default());
    for (step, count) in [i32::MAX, i32::MIN, -1, 0, 0x1_0000, 0xffff].into_iter().enumerate() {
        let now = ms(step as i64);
        model.set_counts([count; CHANNELS]);
        model.tick(now);
        assert_eq!(devices.encoders.as_mut().unwrap().sample(now).unwrap().value[0].0, count);
    }
}

#[test]
fn one_release_has_one_answer_however_far_the_board_has_moved_on() {
    let (_, mut model, mut devices) = rig(&Config::default());
    let mut frame = TactileFrame::new(16, 16);
    for now in [ms(0), ms(2)] {
        model.set_counts([now.0 as i32; CHANNELS]);
        model.tick(now);
        model.publish_frame(&[1; 256]);
        let counts = devices.encoders.as_mut().unwrap().sample(now).unwrap();
        let lines = devices.digital_in.as_mut().unwrap().sample(now).unwrap();
        assert_eq!(
            devices.tactile.get_mut("tactile").unwrap().sample(now, &mut frame),
            Ok(Arrival::New)
        );
        model.set_counts([-1; CHANNELS]);
        model.set_lines(LinesIn::default());
        model.tick(now + Nanos(1));
        model.publish_frame(&[2; 256]);
        assert_eq!(devices.encoders.as_mut().unwrap().sample(now), Ok(counts));
        assert_eq!(devices.digital_in.as_mut().unwrap().sample(now), Ok(lines));
        assert_eq!(
            devices.tactile.get_mut("tactile").unwrap().sample(now, &mut frame),
            Ok(Arrival::Held)
        );
    }
}

#[test]
fn a_torn_block_is_a_transient_error_and_the_next_whole_one_is_read() {
    let (registers, mut model, mut devices) = rig(&Config::default());
    model.tick(ms(0));
    model.publish_frame(&[7; 256]);
    let mut frame = TactileFrame::new(16, 16);
    for block in [ENCODERS, ADC, FORCE_TORQUE, TACTILE] {
        registers.write(block.begin, registers.read(block.begin).wrapping_add(1));
    }
    let kind = |error: Error| (error.kind, error.channel);
    let torn = (ErrorKind::Transient, Error::ALL_CHANNELS);
    assert_eq!(devices.encoders.as_mut().unwrap().sample(ms(1)).map_err(kind), Err(torn));
    assert_eq!(devices.analog_in.as_mut().unwrap().sample(ms(1)).map_err(kind), Err(torn));
    assert_eq!(devices.force_torque.as_mut().unwrap().sample(ms(1)).map_err(kind), Err(torn));
    assert_eq!(
        devices.tactile.get_mut("tactile").unwrap().sample(ms(1), &mut frame).map_err(kind),
        Err(torn)
    );
    assert_eq!(frame, TactileFrame::new(16, 16));
    model.tick(ms(2));
    model.publish_frame(&[8; 256]);
    assert!(devices.encoders.as_mut().unwrap().sample(ms(2)).is_ok());
    assert!(devices.analog_in.as_mut().unwrap().sample(ms(2)).is_ok());
    assert!(devices.force_torque.as_mut().unwrap().sample(ms(2)).is_ok());
    assert_eq!(
        devices.tactile.get_mut("tactile").unwrap().sample(ms(2), &mut frame),
        Ok(Arrival::New)
    );
    assert_eq!(*frame.values, [8; 256]);
}

#[test]
fn no_frame_is_ever_a_mixture_while_another_thread_scans() {
    let (_, mut model, mut devices) = rig(&Config { tactile_bits: 16, ..Config::default() });
    let scanner = std::thread::spawn(move || {
        for number in 0..20_000u16 {
            model.publish_frame(&[number; 256]);
            for _ in 0..number % 1_000 {
                std::hint::spin_loop();
            }
        }
        model
    });
    let (mut frame, mut frames, mut release, mut last) = (TactileFrame::new(16, 16), 0, 0, None);
    let mut done = false;
    while !done {
        done = scanner.is_finished();
        release += 1;
        match devices.tactile.get_mut("tactile").unwrap().sample(Nanos(release), &mut frame) {
            Ok(Arrival::New) => {
                frames += 1;
                assert!(frame.values.iter().all(|v| *v == frame.values[0]), "{:?}", frame.values);
                assert_eq!(frame.sequence, u32::from(frame.values[0]) + 1);
                assert!(last.is_none_or(|last| last < frame.sequence));
                last = Some(frame.sequence);
            }
            Ok(Arrival::Held) => {}
            Err(error) => assert_eq!(error.kind, ErrorKind::Transient),
        }
    }
    assert!(frames > 0);
    assert_eq!(last, Some(20_000), "the last scan stands still and must be had");
}

#[test]
fn a_stuck_scanner_is_held_and_its_number_wraps_beyond_16_bits() {
    let (registers, mut model, mut devices) = rig(&Config::default());
    let mut frame = TactileFrame::new(16, 16);
    assert_eq!(
        devices.tactile.get_mut("tactile").unwrap().sample(ms(0), &mut frame),
        Ok(Arrival::Held),
        "never scanned"
    );
    model.publish_frame(&[1; 256]);
    assert_eq!(
        devices.tactile.get_mut("tactile").unwrap().sample(ms(1), &mut frame),
        Ok(Arrival::New)
    );
    for n in 2..1_000 {
        assert_eq!(
            devices.tactile.get_mut("tactile").unwrap().sample(ms(n), &mut frame),
            Ok(Arrival::Held)
        );
    }
    assert_eq!((frame.sequence, frame.acquired), (1, ms(1)));
    for (n, number) in (1_000..).zip([0xffff, 0, 2]) {
        registers.write(TACTILE.begin, number);
        registers.write(TACTILE.end, number);
        assert_eq!(
            devices.tactile.get_mut("tactile").unwrap().sample(ms(n), &mut frame),
            Ok(Arrival::New)
        );
    }
    assert_eq!(frame.sequence, 0x1_0002);
}

#[test]
fn words_that_the_board_cannot_mean_are_out_of_range() {
    let (registers, mut model, mut devices) = rig(&Config { adc_channels: 7, ..Config::default() });
    model.tick(ms(0));
    model.publish_frame(&[4095; 256]);
    let kind = |error: Error| (error.kind, error.channel);
    registers.write(ADC.words.get(7).unwrap(), 0xffff);
    assert!(devices.analog_in.as_mut().unwrap().sample(ms(0)).is_ok(), "channel 7 is not wired");
    registers.write(ADC.words.get(6).unwrap(), 0x1000);
    assert_eq!(
        devices.analog_in.as_mut().unwrap().sample(ms(1)).map_err(kind),
        Err((ErrorKind::OutOfRange, 6))
    );
    registers.write(FORCE_TORQUE.words.get(0).unwrap(), 0x8000);
    assert_eq!(
        devices.force_torque.as_mut().unwrap().sample(ms(1)).map_err(kind),
        Err((ErrorKind::OutOfRange, 0))
    );
    registers.write(TACTILE.words.get(200).unwrap(), 4096);
    let answer =
        devices.tactile.get_mut("tactile").unwrap().sample(ms(1), &mut TactileFrame::new(16, 16));
    assert_eq!(answer.map_err(kind), Err((ErrorKind::OutOfRange, 200)));
    registers.write(DIGITAL_IN, 0xffff);
    assert_eq!(
        devices.digital_in.as_mut().unwrap().sample(ms(1)).map_err(|e| e.kind),
        Err(ErrorKind::OutOfRange)
    );
}

#[test]
fn a_frozen_board_is_reported_stale_until_it_recovers() {
    let (_, mut model, mut devices) = rig(&Config { stale_ms: 5, ..Config::default() });
    model.tick(ms(0));
    for now in 0..=5 {
        assert_eq!(devices.encoders.as_mut().unwrap().sample(ms(now)).unwrap().acquired, ms(0));
        assert_eq!(devices.digital_in.as_mut().unwrap().sample(ms(now)).unwrap().acquired, ms(0));
    }
    assert_eq!(
        devices.encoders.as_mut().unwrap().sample(ms(6)).map_err(|e| e.kind).unwrap_err(),
        ErrorKind::Stale
    );
    assert_eq!(
        devices.digital_in.as_mut().unwrap().sample(ms(6)).map_err(|e| e.kind).unwrap_err(),
        ErrorKind::Stale
    );
    model.set_lines(LinesIn { drive_power: true, estop_a_closed: true, estop_b_closed: false });
    model.tick(ms(7));
    assert_eq!(devices.encoders.as_mut().unwrap().sample(ms(7)).unwrap().acquired, ms(7));
    assert!(!devices.digital_in.as_mut().unwrap().sample(ms(7)).unwrap().value.estop_b_closed);
}

#[test]
fn a_board_that_vanishes_is_lost_for_good() {
    let (registers, mut model, mut devices) = rig(&Config::default());
    model.tick(ms(0));
    devices.encoders.as_mut().unwrap().sample(ms(0)).unwrap();
    registers.write(ID, 0xffff);
    let mut frame = TactileFrame::new(16, 16);
    for now in 1..4 {
        let found = [
            devices.encoders.as_mut().unwrap().sample(ms(now)).map(drop),
            devices.analog_in.as_mut().unwrap().sample(ms(now)).map(drop),
            devices.force_torque.as_mut().unwrap().sample(ms(now)).map(drop),
            devices.digital_in.as_mut().unwrap().sample(ms(now)).map(drop),
            devices.tactile.get_mut("tactile").unwrap().sample(ms(now), &mut frame).map(drop),
            devices.analog_out.as_mut().unwrap().commit(ms(now), &[DacCode(1); CHANNELS]),
            devices.digital_out.as_mut().unwrap().commit(ms(now), &DRIVE),
            devices.analog_out.as_mut().unwrap().safe(),
            devices.digital_out.as_mut().unwrap().safe(),
        ];
        assert_eq!(found.map(|answer| answer.map_err(|e| e.kind)), [Err(ErrorKind::Lost); 9]);
        registers.write(ID, ID_VALUE);
    }
}

/// Drives at full scale with brakes up.
fn driven() -> (Loopback, Devices) {
    let (_, mut model, mut devices) = rig(&Config::default());
    devices.analog_out.as_mut().unwrap().commit(ms(0), &[DacCode(2047); CHANNELS]).unwrap();
    devices.digital_out.as_mut().unwrap().commit(ms(0), &DRIVE).unwrap();
    model.tick(ms(0));
    assert_eq!((&model.dac_codes()[..8], model.lines_out()), (&[DacCode(2047); 8][..], DRIVE));
    (model, devices)
}

fn is_safe(model: &Loopback) -> bool {
    let lines = model.lines_out();
    model.dac_codes() == [DacCode(0); CHANNELS] && !lines.enable && !lines.brake_release
}

#[test]
fn dropped_or_panicked_the_board_is_safe_at_once() {
    let (mut model, devices) = driven();
    drop(devices);
    model.tick(ms(1));
    assert!(is_safe(&model));
    let (mut model, devices) = driven();
    let thread = std::thread::spawn(move || {
        let _devices = devices;
        std::panic::resume_unwind(Box::new("a lane that fell over"));
    });
    assert!(thread.join().is_err());
    model.tick(ms(1));
    assert!(is_safe(&model));
}

#[test]
fn killed_without_a_last_word_the_board_is_safe_within_its_longest_silence() {
    let (mut model, mut devices) = driven();
    let silence = devices.analog_out.as_mut().unwrap().longest_silence();
    assert_eq!(silence, ms(10));
    assert_eq!(devices.digital_out.as_mut().unwrap().longest_silence(), silence);
    std::mem::forget(devices);
    model.tick(silence);
    assert!(!is_safe(&model));
    model.tick(silence + Nanos(1));
    assert!(is_safe(&model));
}

#[test]
fn a_constant_feed_line_lets_the_watchdog_expire() {
    let (mut model, mut devices) = driven();
    for now in 1..=11 {
        devices.digital_out.as_mut().unwrap().commit(ms(now), &DRIVE).unwrap();
        devices.analog_out.as_mut().unwrap().commit(ms(now), &[DacCode(5); CHANNELS]).unwrap();
        model.tick(ms(now));
    }
    assert_eq!(model.dac_codes()[..8], [DacCode(5); 8], "the D/A group was committed to");
    assert!(!model.lines_out().enable && !model.lines_out().brake_release);
    devices
        .digital_out
        .as_mut()
        .unwrap()
        .commit(ms(12), &LinesOut { watchdog_feed: false, ..DRIVE })
        .unwrap();
    model.tick(ms(12));
    assert!(model.lines_out().enable);
}

#[test]
fn words_left_by_a_crashed_process_are_not_put_out_when_the_board_is_opened_again() {
    let config = Config::default();
    let (registers, _model, devices) = rig(&config);
    std::mem::forget(devices);
    for register in taktil_drivers_regmap::registers::DAC.iter() {
        registers.write(register, 0x0fff);
    }
    let mut model = Loopback::new(registers.clone(), &config).unwrap();
    model.tick(ms(0));
    assert!(is_safe(&model), "power-up alone drives nothing");
    let strobe = registers.read(DAC_STROBE);
    let _devices = Board::attach(registers.clone(), &config).unwrap();
    assert_eq!(registers.read(DAC_STROBE), strobe.wrapping_add(1));
    model.tick(ms(1));
    assert!(is_safe(&model));
}

#[test]
fn index_pulses_need_a_board_that_latches_them_and_survive_a_wrap() {
    let config = Config { counter_bits: 16, ..Config::default() };
    let (_, _, devices) = rig(&config);
    assert!(!devices.encoders.as_ref().unwrap().has_index());
    let registers = Arc::new(RegisterFile::anonymous().unwrap());
    let mut model = Loopback::new(registers.clone(), &config).unwrap();
    model.enable_index_latch();
    let mut devices = Board::attach(registers.clone(), &config).unwrap();
    assert!(devices.encoders.as_mut().unwrap().has_index());
    assert_eq!(devices.encoders.as_mut().unwrap().index_pulse_reach(), 32_767);
    // Turned up for three wraps of the counters, a pulse every 7000 counts, on channel 1 only.
    let mut now = 0;
    let mut step = |model: &mut Loopback, devices: &mut Devices, count: i32, mark: Option<i32>| {
        now += 1;
        let mut marks = [None; CHANNELS];
        marks[1] = mark.map(Counts);
        marks[7] = mark.map(Counts);
        model.set_counts([count; CHANNELS]);
        model.set_index_pulses(marks);
        model.tick(ms(now));
        devices.encoders.as_mut().unwrap().sample(ms(now)).unwrap();
        devices.encoders.as_mut().unwrap().index_pulses()
    };
    assert_eq!(step(&mut model, &mut devices, 6999, None), [None; CHANNELS]);
    for count in (7000..200_000).step_by(500) {
        let mark = count / 7000 * 7000;
        let found = step(&mut model, &mut devices, count, Some(mark));
        assert_eq!(found[1], Some(Counts(mark)), "at {count}");
        assert_eq!((found[0], found[7]), (None, None), "channel 7 is not wired");
    }
    // Torn for good: the reading fails, and what was known stays.
    registers.write(INDEX.begin, registers.read(INDEX.end).wrapping_add(1));
    let error = devices.encoders.as_mut().unwrap().sample(ms(now + 1)).unwrap_err();
    assert_eq!(error.kind, ErrorKind::Transient);
    assert_eq!(devices.encoders.as_mut().unwrap().index_pulses()[1], Some(Counts(196_000)));
}

/// The codes of all channels that a half can have.
fn wide(codes: [DacCode; 8]) -> [DacCode; CHANNELS] {
    std::array::from_fn(|i| codes.get(i).copied().unwrap_or_default())
}
