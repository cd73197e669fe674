//! What the driver makes of a board that fails: what it notices, what it cannot notice, and that it
//! goes on afterwards.

mod rig;

use rig::{CYCLE_PERIOD, Rig, config, place, text};
use taktil_drivers_regmap::{Board, Config, Description, Halves, write_safe_values};
use taktil_hal::{CHANNELS, DacCode, Error, ErrorKind, LinesOut, Nanos};

/// The release of a cycle.
fn at(cycle: i64) -> Nanos {
    CYCLE_PERIOD * cycle
}

fn kind<T>(answer: Result<T, Error>) -> Result<(), ErrorKind> {
    answer.map(drop).map_err(|error| error.kind)
}

fn codes(rig: &Rig, halves: &mut Halves, release: Nanos) -> Result<i32, Error> {
    rig.job(release);
    halves.analog_in.as_mut().unwrap().sample(release).map(|reading| reading.value[0].0)
}

fn count(rig: &Rig, halves: &mut Halves, release: Nanos, count: i64) -> Result<i32, Error> {
    rig.inputs.lock().unwrap().counts = vec![count; 8];
    rig.job(release);
    halves.encoders.as_mut().unwrap().sample(release).map(|reading| reading.value[0].0)
}

#[test]
fn a_converter_that_stays_busy_is_a_transient_error_until_it_is_not() {
    for fault in ["silence", "delay value=0.01"] {
        let (rig, mut halves) = Rig::shipped("busy", "vme-8605");
        rig.inputs.lock().unwrap().codes = vec![7; 8];
        rig.plan(&[&format!("kind={fault} target=board.analog_in at=0.01 for=0.01")]);
        assert_eq!(codes(&rig, &mut halves, at(1)), Ok(7));
        rig.inputs.lock().unwrap().codes = vec![8; 8];
        for cycle in 4..=7 {
            assert_eq!(kind(codes(&rig, &mut halves, at(cycle))), Err(ErrorKind::Transient));
        }
        let after = [12, 13].map(|cycle| codes(&rig, &mut halves, at(cycle)));
        assert_eq!(after, [Ok(8), Ok(8)], "{fault}");
    }
}

#[test]
fn a_latch_that_never_ends_is_a_transient_error() {
    let (rig, mut halves) = Rig::shipped("latch", "lxvme-s01");
    rig.plan(&["kind=silence target=board.encoders at=0.01 for=0.01"]);
    assert_eq!(count(&rig, &mut halves, at(1), 100), Ok(100));
    for cycle in 4..8 {
        assert_eq!(kind(count(&rig, &mut halves, at(cycle), 200)), Err(ErrorKind::Transient));
    }
    assert_eq!(count(&rig, &mut halves, at(8), 300), Ok(300));
}

#[test]
fn frozen_inputs_of_a_board_without_numbers_stand_still_unnoticed() {
    let (rig, mut halves) = Rig::shipped("frozen", "vme-8605");
    rig.plan(&["kind=frozen target=board.analog_in at=0.01 for=0.01"]);
    for (cycle, due) in [(1, 1), (4, 1), (7, 1), (8, 8)] {
        rig.inputs.lock().unwrap().codes = vec![cycle as i32; 8];
        assert_eq!(codes(&rig, &mut halves, at(cycle)), Ok(due));
    }
}

#[test]
fn a_board_with_numbers_that_says_nothing_is_stale() {
    let (rig, mut halves) = Rig::shipped("stale", "taktil");
    rig.plan(&["kind=silence target=board at=0.01 for=0.05"]);
    assert_eq!(kind(codes(&rig, &mut halves, at(3))), Ok(()));
    assert_eq!(kind(codes(&rig, &mut halves, at(6))), Ok(()), "it is 7.5 ms old");
    assert_eq!(kind(codes(&rig, &mut halves, at(10))), Err(ErrorKind::Stale));
    assert_eq!(kind(codes(&rig, &mut halves, at(30))), Ok(()));
}

#[test]
fn torn_counters_are_refused_by_number_or_by_step() {
    for (board, channel) in [("taktil", Error::ALL_CHANNELS), ("lxvme-s01", 0)] {
        let (rig, mut halves) = Rig::shipped(&format!("torn-{board}"), board);
        rig.plan(&["kind=corruption target=board.encoders at=0.01 for=0.002 value=1"]);
        assert_eq!(count(&rig, &mut halves, at(1), 65_530), Ok(65_530));
        assert_eq!(count(&rig, &mut halves, at(3), 65_532), Ok(65_532));
        let torn = count(&rig, &mut halves, at(4), 65_540).unwrap_err();
        assert_eq!((torn.kind, torn.channel), (ErrorKind::Transient, channel), "{board}");
        assert_eq!(count(&rig, &mut halves, at(5), 65_545), Ok(65_545));
    }
}

#[test]
fn a_jump_that_the_next_reading_confirms_is_believed() {
    let (rig, mut halves) = Rig::shipped("jump", "lxvme-s01");
    assert_eq!(count(&rig, &mut halves, at(1), 1_000_000), Ok(1_000_000), "the first is any");
    assert_eq!(kind(count(&rig, &mut halves, at(2), 1_050_000)), Err(ErrorKind::Transient));
    assert_eq!(kind(count(&rig, &mut halves, at(3), 900_000)), Err(ErrorKind::Transient));
    assert_eq!(count(&rig, &mut halves, at(4), 900_100), Ok(900_100));
    assert_eq!(count(&rig, &mut halves, at(5), 900_200), Ok(900_200));
}

#[test]
fn a_board_that_is_pulled_is_lost_on_every_half_and_stays_so() {
    for board in ["taktil", "lxvme-s01", "vme-8605", "vme-arm"] {
        let config = config(&format!("lost-{board}"), board);
        let rig = Rig::new(&config, text(board));
        let mut halves = rig.open(&config).unwrap();
        rig.plan(&["kind=unplugged target=board at=0.01 for=0.01"]);
        for (cycle, due) in [(1, Ok(())), (5, Err(ErrorKind::Lost)), (20, Err(ErrorKind::Lost))] {
            rig.job(at(cycle));
            if let Some(half) = &mut halves.encoders {
                assert_eq!(kind(half.sample(at(cycle))), due, "{board} {cycle}");
            }
            if let Some(half) = &mut halves.analog_in {
                assert_eq!(kind(half.sample(at(cycle))), due, "{board} {cycle}");
            }
            if let Some(half) = &mut halves.analog_out {
                assert_eq!(kind(half.commit(at(cycle), &[DacCode(1); CHANNELS])), due);
            }
            if let Some(half) = &mut halves.digital_out {
                assert_eq!(kind(half.commit(at(cycle), &LinesOut::SAFE)), due);
            }
        }
        drop(halves);
        assert!(rig.open(&config).is_ok(), "{board} is opened anew");
    }
}

#[test]
fn a_pulled_board_of_write_only_registers_is_not_noticed() {
    let (rig, mut halves) = Rig::shipped("write-only", "dvme-628");
    rig.plan(&["kind=unplugged target=board at=0.01"]);
    rig.step(at(5));
    let half = halves.analog_out.as_mut().unwrap();
    assert_eq!(half.commit(at(5), &[DacCode(1); CHANNELS]), Ok(()));
}

#[test]
fn converters_that_stick_are_noticed_only_where_the_registers_read_back() {
    let (rig, mut halves) = Rig::shipped("stuck", "dvme-628");
    rig.plan(&["kind=silence target=board.analog_out at=0.01 for=0.01"]);
    let half = halves.analog_out.as_mut().unwrap();
    for (cycle, due) in [(1, 1), (4, 1), (7, 1), (8, 8)] {
        assert_eq!(half.commit(at(cycle), &[DacCode(cycle as i32); CHANNELS]), Ok(()));
        rig.step(at(cycle));
        assert_eq!(rig.look().codes, [due; 8]);
    }
    let text = text("dvme-628").replace("[analog_out]", "[analog_out]\nread_back = true");
    let mut config = config("read-back", "");
    config.registers = Some(Description::from_toml(&text).unwrap());
    let rig = Rig::new(&config, &text);
    let mut half = rig.open(&config).unwrap().analog_out.unwrap();
    rig.plan(&["kind=restart target=board at=0.01 for=0.001"]);
    let drive = [DacCode(500); CHANNELS];
    assert_eq!(half.commit(at(1), &drive), Ok(()));
    assert_eq!(half.commit(at(2), &drive), Ok(()));
    rig.step(at(4));
    let lost = half.commit(at(5), &drive).unwrap_err();
    assert_eq!((lost.kind, lost.channel), (ErrorKind::Transient, 0));
    assert_eq!(half.commit(at(6), &drive), Ok(()));
    rig.step(at(6));
    assert_eq!(rig.look().codes, [500; 8]);
}

#[test]
fn encoders_start_the_conversion_which_is_not_started_again() {
    let config = Config { gauge_channels: (0..6).collect(), ..config("early", "vme-arm") };
    let rig = Rig::new(&config, text("vme-arm"));
    let mut halves = Board::open_halves(&config).unwrap();
    let command = || std::fs::read(&config.path).unwrap()[0x100..0x102].to_vec();
    rig.inputs.lock().unwrap().codes = (0..8).map(|channel| 10 * channel).collect();
    assert_eq!(command(), [0, 0]);
    let latch = halves.encoders.as_mut().unwrap().sample(at(1));
    assert_eq!(kind(latch), Err(ErrorKind::Transient), "nobody has latched yet");
    assert_eq!(command(), [0x80, 0], "the conversion runs");
    rig.step(at(1));
    rig.step(at(1) + Nanos(25_000));
    assert_eq!(command(), [0, 0], "it is done");
    let read = halves.analog_in.as_mut().unwrap().sample(at(1)).unwrap();
    let gauges = halves.force_torque.as_mut().unwrap().sample(at(1)).unwrap();
    assert_eq!(command(), [0, 0], "nobody started another one");
    assert_eq!(read.value[..6], gauges.value.codes, "both are of one conversion");
    assert_eq!(read.value[5].0, 50);
    assert!(halves.encoders.as_mut().unwrap().sample(at(1)).is_ok());
}

#[test]
fn killed_without_a_last_word_a_board_with_a_watchdog_goes_safe_and_another_one_does_not() {
    let drive = LinesOut { enable: true, brake_release: true, watchdog_feed: true };
    let (rig, mut halves) = Rig::shipped("killed", "taktil");
    halves.analog_out.as_mut().unwrap().commit(at(0), &[DacCode(99); CHANNELS]).unwrap();
    halves.digital_out.as_mut().unwrap().commit(at(0), &drive).unwrap();
    let silence = halves.analog_out.as_ref().unwrap().longest_silence();
    std::mem::forget(halves);
    rig.step(at(0));
    rig.step(silence);
    assert_eq!((rig.look().codes, rig.look().lines), (vec![99; 8], drive));
    rig.step(silence + Nanos(1));
    assert_eq!(rig.look().codes, [0; 8]);
    assert!(!rig.look().lines.enable && !rig.look().lines.brake_release);

    let config = config("killed-dvme", "dvme-628");
    let rig = Rig::new(&config, text("dvme-628"));
    let mut halves = rig.open(&config).unwrap();
    halves.analog_out.as_mut().unwrap().commit(at(0), &[DacCode(99); CHANNELS]).unwrap();
    assert_eq!(halves.analog_out.as_ref().unwrap().longest_silence(), Nanos::from_millis(10));
    rig.step(Nanos::from_secs(100));
    assert_eq!(rig.look().codes, [99; 8], "nothing but a relay takes it off");
    drop(halves);
    write_safe_values(&config).unwrap();
    assert_eq!(rig.look().codes, [0; 8]);
}

#[test]
fn a_watchdog_is_fed_by_its_kick_and_set_up_before_outputs_drive() {
    let text = "name = \"kicked\"\nbus_bits = 32\nbyte_order = \"little\"\nlength_bytes = 0x20\n\
                [[setup]]\noffset = 0x10\nvalue = 0xabcd\n\
                [watchdog]\noffset = 0x0\nunit_us = 500\nkick_offset = 0x4\nkick_value = 0x5a\n\
                [analog_out]\noffset = 0x8\nchannels = 1\nbits = 16\nformat = \"twos-complement\"\n\
                safe_code = -5\n";
    let registers = Some(Description::from_toml(text).unwrap());
    let config = Config { registers, watchdog_ms: 20, path: place("kicked"), ..Config::default() };
    let rig = Rig::new(&config, text);
    let mut half = rig.open(&config).unwrap().analog_out.unwrap();
    let bytes = std::fs::read(&config.path).unwrap();
    assert_eq!((&bytes[..4], &bytes[0x10..0x14]), (&[40, 0, 0, 0][..], &[0xcd, 0xab, 0, 0][..]));
    assert_eq!(half.longest_silence(), Nanos::from_millis(20));
    rig.step(at(0));
    assert_eq!(rig.look().codes, [-5], "opening is no sign of life");
    half.commit(at(1), &[DacCode(30_000); CHANNELS]).unwrap();
    rig.step(at(1));
    assert_eq!(rig.look().codes, [30_000]);
    rig.step(at(9));
    assert_eq!(rig.look().codes, [30_000]);
    rig.step(at(10));
    assert_eq!(rig.look().codes, [-5]);
    let odd = Config { watchdog_ms: 10_000, ..config.clone() };
    drop(half);
    assert!(rig.open(&odd).is_ok());
    let text = text.replace("unit_us = 500", "unit_us = 300");
    let registers = Some(Description::from_toml(&text).unwrap());
    let bad = Board::open_halves(&Config { registers, ..config }).expect_err("20 ms / 300 us");
    assert_eq!(bad.place(), "watchdog_ms");
}
