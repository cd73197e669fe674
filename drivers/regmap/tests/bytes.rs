//! Tests the exact bytes of the register block: big-endian words, offset binary, counter halves,
//! numbers.

use std::fs;
use std::os::unix::fs::FileExt;
use std::path::PathBuf;

use taktil_drivers_regmap::{Board, Config};
use taktil_hal::{
    AdcCode, Arrival, CHANNELS, Counts, DacCode, Devices, LinesIn, LinesOut, Nanos, TactileFrame,
};

/// A board in a plain file, powered up by hand.
fn board(name: &str, config: Config) -> (Devices, fs::File, PathBuf) {
    let path = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("bytes-{name}"));
    let mut bytes = vec![0; 0x402];
    bytes[..4].copy_from_slice(&[0x54, 0x4b, 0x00, 0x01]);
    fs::write(&path, bytes).unwrap();
    let config = Config { path: path.clone(), ..config };
    let devices = Board::open(&config).unwrap();
    let file = fs::OpenOptions::new().write(true).open(&path).unwrap();
    (devices, file, path)
}

fn bytes_at(path: &PathBuf, offset: usize, count: usize) -> Vec<u8> {
    fs::read(path).unwrap()[offset..offset + count].to_vec()
}

const HALF_SCALE: [u8; 16] = [8, 0, 8, 0, 8, 0, 8, 0, 8, 0, 8, 0, 8, 0, 8, 0];

#[test]
fn opening_writes_watchdog_and_safe_outputs() {
    let config = Config { watchdog_ms: 0x1234, ..Config::default() };
    let (_devices, _, path) = board("opening", config);
    assert_eq!(bytes_at(&path, 0x004, 2), [0x12, 0x34]);
    assert_eq!(bytes_at(&path, 0x010, 16), HALF_SCALE);
    assert_eq!(bytes_at(&path, 0x020, 4), [0, 1, 0, 0], "strobed once, lines down");
}

#[test]
fn analog_words_are_big_endian_offset_binary_and_strobed() {
    let (mut devices, _, path) = board("dac", Config { dac_channels: 6, ..Config::default() });
    let mut codes = [-2048, 2047, 0, 1, -1, 0x123, 9, 9].map(DacCode);
    codes[7] = DacCode(i32::MAX);
    devices.analog_out.as_mut().unwrap().commit(Nanos(0), &wide(codes)).unwrap();
    let due = [0, 0, 0x0f, 0xff, 8, 0, 8, 1, 7, 0xff, 9, 0x23, 8, 0, 8, 0];
    assert_eq!(bytes_at(&path, 0x010, 16), due, "channels that are not wired stay safe");
    assert_eq!(bytes_at(&path, 0x020, 2), [0, 2]);
    codes[5] = DacCode(2048);
    devices.analog_out.as_mut().unwrap().commit(Nanos(0), &wide(codes)).unwrap_err();
    assert_eq!(bytes_at(&path, 0x010, 16), due);
    assert_eq!(bytes_at(&path, 0x020, 2), [0, 2], "a refusal does not strobe");
    drop(devices.analog_out);
    assert_eq!(bytes_at(&path, 0x010, 18)[..16], HALF_SCALE);
    assert_eq!(bytes_at(&path, 0x020, 2), [0, 3]);
}

#[test]
fn sixteen_bit_converters_use_the_whole_word() {
    let (mut devices, file, path) =
        board("wide", Config { dac_bits: 16, adc_bits: 16, ..Config::default() });
    assert_eq!(
        devices.analog_out.as_mut().unwrap().code_range(),
        (DacCode(-32768), DacCode(32767))
    );
    let codes = [-32768, 32767, 0, -1, 0, 0, 0, 0].map(DacCode);
    devices.analog_out.as_mut().unwrap().commit(Nanos(0), &wide(codes)).unwrap();
    assert_eq!(bytes_at(&path, 0x010, 8), [0, 0, 0xff, 0xff, 0x80, 0, 0x7f, 0xff]);
    let words = [0, 7, 0xff, 0xff, 0, 0, 0x80, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 7];
    file.write_all_at(&words, 0x060).unwrap();
    let reading = devices.analog_in.as_mut().unwrap().sample(Nanos(0)).unwrap();
    assert_eq!(reading.value[..3], [32767, -32768, 0].map(AdcCode));
}

#[test]
fn lines_are_single_bits() {
    let (mut devices, file, path) = board("lines", Config::default());
    let lines = LinesOut { enable: true, brake_release: false, watchdog_feed: true };
    devices.digital_out.as_mut().unwrap().commit(Nanos(0), &lines).unwrap();
    assert_eq!(bytes_at(&path, 0x022, 2), [0, 0b101]);
    let lines = LinesOut { enable: false, brake_release: true, watchdog_feed: false };
    devices.digital_out.as_mut().unwrap().commit(Nanos(1), &lines).unwrap();
    assert_eq!(bytes_at(&path, 0x022, 2), [0, 0b010]);
    devices.digital_out.as_mut().unwrap().safe().unwrap();
    assert_eq!(bytes_at(&path, 0x022, 2), [0, 0]);
    for (bits, due) in
        [(1, [true, false, false]), (2, [false, true, false]), (4, [false, false, true])]
    {
        file.write_all_at(&[bits, bits], 0x024).unwrap();
        let lines =
            devices.digital_in.as_mut().unwrap().sample(Nanos(i64::from(bits))).unwrap().value;
        let [drive_power, estop_a_closed, estop_b_closed] = due;
        assert_eq!(lines, LinesIn { drive_power, estop_a_closed, estop_b_closed });
    }
}

#[test]
fn counters_are_two_halves_high_first_latched_by_a_strobe() {
    let (mut devices, file, path) = board("encoders", Config { joints: 2, ..Config::default() });
    let mut block = vec![0x00, 0x05];
    block.extend([0x12, 0x34, 0x56, 0x78, 0xff, 0xff, 0xff, 0xfe, 0xee, 0xee, 0xee, 0xee]);
    block.resize(2 + 32, 0xee);
    block.extend([0x00, 0x05]);
    file.write_all_at(&block, 0x032).unwrap();
    let reading = devices.encoders.as_mut().unwrap().sample(Nanos(3)).unwrap();
    let mut due = [Counts(0); CHANNELS];
    due[..2].copy_from_slice(&[Counts(0x1234_5678), Counts(-2)]);
    assert_eq!((reading.value, reading.acquired), (due, Nanos(3)));
    assert_eq!(bytes_at(&path, 0x030, 2), [0, 1], "latched once");
    devices.encoders.as_mut().unwrap().sample(Nanos(3)).unwrap();
    assert_eq!(bytes_at(&path, 0x030, 2), [0, 1], "once per release");
}

#[test]
fn gauges_and_tactels_have_the_stated_positions() {
    let (mut devices, file, _) = board("frames", Config::default());
    let gauges = [0, 1, 8, 1, 8, 2, 8, 3, 8, 4, 8, 5, 0, 0, 0, 1];
    file.write_all_at(&gauges, 0x080).unwrap();
    let reading = devices.force_torque.as_mut().unwrap().sample(Nanos(0)).unwrap();
    assert_eq!(reading.value.codes, [1, 2, 3, 4, 5, -2048].map(AdcCode));
    assert_eq!(reading.value.over_range, [false, false, false, false, false, true]);

    let mut block = vec![0u8; 2 + 512 + 2];
    block[0..2].copy_from_slice(&[0xff, 0xfe]);
    block[2 + 2 * (16 + 2)..][..2].copy_from_slice(&[0x0a, 0xbc]);
    block[2 + 2 * 255..][..2].copy_from_slice(&[0x0f, 0xff]);
    block[514..].copy_from_slice(&[0xff, 0xfe]);
    file.write_all_at(&block, 0x1fe).unwrap();
    let mut frame = TactileFrame::new(16, 16);
    let release = Nanos::from_millis(20);
    assert_eq!(
        devices.tactile.get_mut("tactile").unwrap().sample(release, &mut frame),
        Ok(Arrival::New)
    );
    assert_eq!((frame.values[18], frame.values[255]), (0xabc, 0xfff), "row 1 column 2; the last");
    assert_eq!(frame.values.iter().filter(|value| **value != 0).count(), 2);
    assert_eq!((frame.sequence, frame.acquired), (0xfffe, release));
    assert_eq!(frame.row_acquired[15], release);
    assert_eq!(frame.row_acquired[0], release - Nanos(15 * 312_500));
}

/// The codes of all channels that a half can have.
fn wide(codes: [DacCode; 8]) -> [DacCode; CHANNELS] {
    std::array::from_fn(|i| codes.get(i).copied().unwrap_or_default())
}
