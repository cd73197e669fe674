//! Recordings: what was written reads back bit for bit, also when the file was cut anywhere,
//! damaged or padded with zeros.

mod chunks;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use taktil_hal::Nanos;
use taktil_lab_command::diff::Comparison;
use taktil_record::{Log, METADATA_RESULT, METADATA_RUN, McapLog};
use taktil_rtcore::record::{Catalog, LaneInfo, Observer, Record, Signal};
use taktil_rtcore::{ArrayPayload, Payload};
use taktil_signal::{Features, JointState, TactileImage};

taktil_rtcore::payload! {
    /// Every alignment, with padding in the middle and at the end.
    pub struct Mixed {
        /// a
        pub flag: u8,
        /// b
        pub angles_rad: [f64; 2],
        /// c
        pub small: i16,
        /// d
        pub pixels: [f32; 3],
        /// e
        pub word: u64,
        /// f
        pub last: u8,
    }
}

fn signal<T: Payload>(name: &str, lane: usize) -> Signal {
    Signal {
        name: name.into(),
        lane,
        type_name: T::NAME.into(),
        fields: T::FIELDS.into(),
        size: T::SIZE,
    }
}

fn catalog() -> Catalog {
    let lane = |name: &str, period| LaneInfo {
        name: name.into(),
        period: Nanos(period),
        ..LaneInfo::default()
    };
    Catalog {
        signals: vec![
            signal::<JointState>("sense.joints", 0),
            signal::<Features>("tactile_servo.features", 0),
            signal::<Mixed>("odd.mixed", 0),
            image_signal("tactile_scan.image", 1),
        ],
        lanes: vec![lane("servo", 2_500_000), lane("touch", 5_000_000)],
    }
}

fn file(name: &str) -> PathBuf {
    let directory = Path::new(env!("CARGO_TARGET_TMPDIR")).join("log");
    std::fs::create_dir_all(&directory).unwrap();
    directory.join(name)
}

fn append_value<T: Payload>(log: &mut McapLog, signal: usize, tick: u64, period: i64, value: &T) {
    let mut body = vec![0; T::SIZE];
    value.encode(&mut body);
    let release = Nanos(tick as i64 * period);
    log.record(&Record { signal, tick, release, body: &body });
}

fn image_signal(name: &str, lane: usize) -> Signal {
    let image = TactileImage::new(16, 16);
    let (type_name, fields, size) = (image.type_name(), image.fields().into(), image.size());
    Signal { name: name.into(), lane, type_name, fields, size }
}

fn append_array(log: &mut McapLog, signal: usize, tick: u64, period: i64, value: &TactileImage) {
    let mut body = vec![0; value.size()];
    value.encode(&mut body);
    let release = Nanos(tick as i64 * period);
    log.record(&Record { signal, tick, release, body: &body });
}

fn mixed_payload(tick: u64) -> Mixed {
    Mixed {
        flag: tick as u8,
        angles_rad: [0.1 * tick as f64, -1.0 / (1.0 + tick as f64)],
        small: -(tick as i16),
        pixels: [1.5, -2.25, tick as f32],
        word: tick << 33,
        last: 255 - tick as u8,
    }
}

fn joints(tick: u64) -> JointState {
    let mut state = JointState::ZERO;
    for i in 0..6 {
        state.q_rad[i] = (tick as f64 + i as f64) / 3.0;
        state.counts[i] = tick as i32 * 7 - i as i32;
    }
    state.datum = 1;
    state
}

fn write(path: &Path, ticks: u64, seed: &str, finish: bool) {
    let metadata = BTreeMap::from([
        ("seed".to_owned(), seed.to_owned()),
        ("scene".to_owned(), "[pin]\nradius_mm = 23.0\n".to_owned()),
    ]);
    let mut log = McapLog::create(path, &catalog(), &metadata).unwrap();
    for tick in 0..ticks {
        append_value(&mut log, 0, tick, 2_500_000, &joints(tick));
        append_value(&mut log, 2, tick, 2_500_000, &mixed_payload(tick));
        if tick % 2 == 0 {
            let mut image = TactileImage::new(16, 16);
            image.counts[17] = tick as f32;
            append_array(&mut log, 3, tick / 2, 5_000_000, &image);
        }
    }
    if finish {
        let result = BTreeMap::from([("digest".to_owned(), "00ff".to_owned())]);
        log.finish_with(&result).unwrap();
    } else {
        log.flush();
        std::mem::forget(log);
    }
}

#[test]
fn what_is_written_reads_back() {
    let path = file("round_trip.mcap");
    write(&path, 20, "7", true);
    let log = Log::open(&path).unwrap();
    assert_eq!(log.damage(), None);
    assert_eq!(log.foreign_messages(), 0);
    assert_eq!(log.metadata()[METADATA_RUN]["seed"], "7");
    assert_eq!(log.metadata()[METADATA_RESULT]["digest"], "00ff");
    let topics: Vec<&str> = log.channels().iter().map(|c| c.topic.as_str()).collect();
    assert_eq!(
        topics,
        ["/sense/joints", "/tactile_servo/features", "/odd/mixed", "/tactile_scan/image"]
    );
    assert_eq!(
        (log.channels()[3].lane.as_str(), log.channels()[3].period_ns),
        ("touch", 5_000_000)
    );
    assert_eq!(log.channels()[0].type_name, "JointState");
    assert_eq!(log.messages().count(), 20 + 20 + 10);
    for message in log.messages().filter(|m| m.channel == 2) {
        let body = &message.body[..Mixed::SIZE];
        assert_eq!(Mixed::decode(body), Some(mixed_payload(message.tick)));
        assert_eq!(message.release_ns, message.tick as i64 * 2_500_000);
    }
    let series = log.series("odd.mixed").unwrap();
    assert_eq!(series.len(), 20);
    assert_eq!(series.t_s[3], 0.0075);
    for (row, &tick) in series.tick.iter().enumerate() {
        let value = mixed_payload(tick);
        assert_eq!(series.column("angles_rad").unwrap().row(row), value.angles_rad);
        assert_eq!(series.values("small", 0)[row], f64::from(value.small));
        assert_eq!(series.values("pixels", 2)[row], f64::from(value.pixels[2]));
        assert_eq!(series.values("word", 0)[row], value.word as f64);
        assert_eq!(series.values("last", 0)[row], f64::from(value.last));
        assert_eq!(series.values("flag", 0)[row], f64::from(value.flag));
    }
    assert_eq!(log.series("/sense/joints").unwrap().values("counts", 5)[2], 9.0);
    assert!(log.series("tactile_servo.features").unwrap().is_empty());
    assert!(log.series("nobody.nothing").is_none());
    assert_eq!(log.end_s(), 19.0 * 0.0025);
}

#[test]
fn two_runs_write_the_same_messages_whatever_the_metadata() {
    let (a, b) = (file("same_a.mcap"), file("same_b.mcap"));
    write(&a, 30, "1", true);
    write(&b, 30, "a much longer piece of text", true);
    let (a, b) = (Log::open(&a).unwrap(), Log::open(&b).unwrap());
    assert!(a.messages().eq(b.messages()));
    assert_ne!(a.metadata(), b.metadata());
}

#[test]
fn a_cut_file_gives_everything_before_the_cut() {
    let path = file("cut.mcap");
    write(&path, 12, "7", true);
    let bytes = std::fs::read(&path).unwrap();
    let whole = Log::from_bytes(bytes.clone()).unwrap();
    let all: Vec<_> = whole.messages().collect();
    let mut before = 0;
    let cuts = (1..bytes.len()).step_by(7).chain([1, 2, 8, 9, bytes.len() - 1]);
    let mut cuts: Vec<usize> = cuts.collect();
    cuts.sort_unstable();
    for cut in cuts {
        let log = Log::from_bytes(bytes[..cut].to_vec()).unwrap();
        let damage = log.damage().unwrap_or_else(|| panic!("cut at {cut} was not seen"));
        assert!(damage.offset <= cut.max(8), "{damage} after the cut at {cut}");
        let got: Vec<_> = log.messages().collect();
        assert!(got.iter().eq(all.iter().take(got.len())), "other messages at cut {cut}");
        assert!(got.len() >= before, "a longer file gave fewer messages");
        // At most the record that was cut is lost, which is one message of an image.
        assert!(cut - damage.offset.min(cut) < 2_000 || got.len() == all.len());
        before = got.len();
    }
    assert_eq!(before, all.len());
}

#[test]
fn a_run_that_was_killed_loses_nothing_that_was_flushed() {
    let path = file("killed.mcap");
    write(&path, 40, "7", false);
    let log = Log::open(&path).unwrap();
    assert_eq!(log.messages().count(), 40 + 40 + 20);
    assert!(log.damage().unwrap().what.contains("cut short"));
}

#[test]
fn zeros_at_the_end_are_seen() {
    let path = file("zeros.mcap");
    write(&path, 5, "7", false);
    let mut bytes = std::fs::read(&path).unwrap();
    let length = bytes.len();
    bytes.extend_from_slice(&[0; 4096]);
    let log = Log::from_bytes(bytes).unwrap();
    let damage = log.damage().unwrap();
    assert_eq!((damage.offset, damage.what.as_str()), (length, "only zeros follow"));
    assert_eq!(log.messages().count(), 13);
}

#[test]
fn a_flipped_bit_is_found_and_located() {
    let path = file("flip.mcap");
    write(&path, 10, "7", true);
    let bytes = std::fs::read(&path).unwrap();
    let log = Log::from_bytes(bytes.clone()).unwrap();
    let target = log.messages().nth(7).unwrap();
    let at = bytes.windows(target.data.len()).position(|w| w == target.data).unwrap();
    for offset in [at + 16, at + target.data.len() - 5, at + target.data.len() - 1] {
        let mut bad = bytes.clone();
        bad[offset] ^= 0x10;
        let log = Log::from_bytes(bad).unwrap();
        let damage = log.damage().expect("the flip was not seen");
        assert!(damage.what.contains("fails its CRC"), "{damage}");
        assert!(damage.what.contains(&log.channels()[target.channel].topic), "{damage}");
        assert!(damage.what.contains(&format!("tick {}", target.tick)), "{damage}");
        assert!(damage.offset < at && at - damage.offset < 64, "{damage}, message at {at}");
        assert_eq!(log.messages().count(), 7);
    }
}

#[test]
fn no_bit_of_a_closed_file_changes_unseen() {
    let path = file("bits.mcap");
    write(&path, 2, "7", true);
    let bytes = std::fs::read(&path).unwrap();
    let whole = Log::from_bytes(bytes.clone()).unwrap();
    let mut bad = bytes.clone();
    for (at, bit) in (0..bytes.len()).flat_map(|at| (0..8).map(move |bit| (at, bit))) {
        bad[at] ^= 1 << bit;
        // A file that is no longer a log is an error.
        if let Ok(log) = Log::from_bytes(bad.clone()) {
            assert!(log.damage().is_some(), "bit {bit} of byte {at} of {}", bytes.len());
            assert!(!Comparison::new(&whole, &log).equal(), "bit {bit} of byte {at}");
        }
        bad[at] = bytes[at];
    }
}

#[test]
fn a_header_that_disagrees_with_its_stamp_is_found_in_a_cut_file_too() {
    let path = file("header.mcap");
    write(&path, 10, "7", false);
    let bytes = std::fs::read(&path).unwrap();
    let log = Log::from_bytes(bytes.clone()).unwrap();
    let target = log.messages().nth(7).unwrap();
    let stamp = bytes.windows(target.data.len()).position(|w| w == target.data).unwrap();
    // Sequence, time of logging and time of publishing precede the encapsulation.
    for (name, at) in [("sequence", 24), ("log time", 20), ("publish time", 12), ("its end", 5)] {
        let mut bad = bytes.clone();
        bad[stamp - at] ^= 0x10;
        let log = Log::from_bytes(bad).unwrap();
        let damage = log.damage().unwrap();
        assert!(damage.what.contains("header is not that of its stamp"), "{name}: {damage}");
        assert!(damage.what.contains(&format!("tick {}", target.tick)), "{name}: {damage}");
        assert_eq!(log.messages().count(), 7, "{name}");
    }
}

#[test]
fn a_file_of_a_writer_that_makes_no_checksum_is_whole() {
    let path = file("no_checksum.mcap");
    write(&path, 2, "7", true);
    let mut bytes = std::fs::read(&path).unwrap();
    // DataEnd is the only record of four bytes; the footer at the end has its own.
    let end = bytes.windows(9).rposition(|w| w == [0x0F, 4, 0, 0, 0, 0, 0, 0, 0]).unwrap();
    bytes[end + 9..end + 13].fill(0);
    let footer = bytes.len() - mcap::MAGIC.len() - 4;
    bytes[footer..footer + 4].fill(0);
    assert_eq!(Log::from_bytes(bytes).unwrap().damage(), None);
}

#[test]
fn any_flipped_byte_is_survived() {
    let path = file("fuzz.mcap");
    write(&path, 2, "7", true);
    let bytes = std::fs::read(&path).unwrap();
    for at in 0..bytes.len() {
        for value in [0x00, 0xFF, bytes[at] ^ 0x01] {
            let mut bad = bytes.clone();
            bad[at] = value;
            // A damaged length neither panics nor allocates all memory.
            if let Ok(log) = Log::from_bytes(bad) {
                for channel in log.channels() {
                    let _ = log.series(&channel.signal);
                }
            }
        }
    }
}

#[test]
fn a_file_that_is_not_a_log_is_rejected_in_plain_words() {
    let said = |path: &Path| format!("{:#}", Log::open(path).unwrap_err());
    let directory = file("x").parent().unwrap().to_owned();
    assert!(said(&directory).contains("is a directory"));
    assert!(said(&file("missing.mcap")).contains("cannot read the log"));
    let empty = file("empty.mcap");
    std::fs::write(&empty, b"").unwrap();
    assert!(said(&empty).contains("it is empty"));
    let text = file("text.mcap");
    std::fs::write(&text, b"t_s,q1\n").unwrap();
    assert!(said(&text).contains("not an MCAP file"));
    for path in [&empty, &text] {
        assert!(said(path).contains(&path.display().to_string()));
    }
}

#[test]
fn places_that_cannot_be_written_are_refused() {
    let none = BTreeMap::new();
    let directory = file("x").parent().unwrap().to_owned();
    let error = McapLog::create(&directory, &catalog(), &none).err().unwrap();
    assert!(format!("{error:#}").contains("is a directory"), "{error:#}");
    let error =
        McapLog::create(&directory.join("no/such/a.mcap"), &catalog(), &none).err().unwrap();
    assert!(format!("{error:#}").contains("does its directory exist"), "{error:#}");
}

#[test]
fn records_that_do_not_fit_the_catalog_are_counted_and_told() {
    let path = file("misfit.mcap");
    let mut log = McapLog::create(&path, &catalog(), &BTreeMap::new()).unwrap();
    log.record(&Record { signal: 0, tick: 0, release: Nanos::ZERO, body: &[0; 3] });
    log.record(&Record { signal: 99, tick: 0, release: Nanos::ZERO, body: &[] });
    assert_eq!((log.written(), log.lost()), (0, 2));
    assert!(log.finish().is_err());
    assert_eq!(Log::open(&path).unwrap().damage(), None, "the file itself is whole");
}

const PYTHON: &str = r#"
import sys
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
n = 0
with open(sys.argv[1], "rb") as stream:
    reader = make_reader(stream, decoder_factories=[DecoderFactory()])
    assert reader.get_header().profile == "ros2"
    for schema, channel, message, value in reader.iter_decoded_messages():
        n += 1
        assert value.tick == message.sequence
        assert value.release_ns == message.log_time == message.publish_time
        if channel.topic == "/odd/mixed":
            t = value.tick
            assert value.flag == t and value.last == 255 - t and value.small == -t
            assert list(value.angles_rad) == [0.1 * t, -1.0 / (1.0 + t)], value.angles_rad
            assert list(value.pixels) == [1.5, -2.25, float(t)] and value.word == t << 33
        if channel.topic == "/sense/joints":
            assert list(value.counts) == [value.tick * 7 - i for i in range(6)]
            assert value.q_rad[2] == (value.tick + 2) / 3.0
        if channel.topic == "/tactile_scan/image":
            assert value.counts[17] == 2.0 * value.tick and value.rows == 16
print(n)
"#;

#[test]
fn the_python_reader_reads_it() {
    let python =
        |arguments: &[&str]| std::process::Command::new("python3").args(arguments).output().ok();
    let there = python(&["-c", "import mcap.reader, mcap_ros2.decoder"]);
    if there.is_none_or(|output| !output.status.success()) {
        taktil_tests_script::report_skip(
            "the Python reader: no python3 with mcap, mcap-ros2-support",
        );
        return;
    }
    let path = file("python.mcap");
    write(&path, 20, "7", true);
    let output = python(&["-c", PYTHON, path.to_str().unwrap()]).unwrap();
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{errors}");
    assert_eq!(String::from_utf8_lossy(&output.stdout).trim(), "50");
}
