//! `taktil diff`: one flipped byte anywhere in one message is found with its tick, field and
//! element; what cannot be read is never called equal.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use taktil_hal::Nanos;
use taktil_lab_command::diff::{Change, Comparison, to_json};
use taktil_record::{Log, McapLog};
use taktil_rtcore::Payload;
use taktil_rtcore::record::{Catalog, LaneInfo, Observer, Record, Signal};

taktil_rtcore::payload! {
    /// Padding in the middle, arrays and scalars.
    pub struct Mixed {
        /// a
        pub flag: u8,
        /// b
        pub angles_rad: [f64; 3],
        /// c
        pub small: i16,
        /// d
        pub pixels: [f32; 2],
    }
}

taktil_rtcore::payload! {
    /// A payload with the same signal name and other fields.
    pub struct Other {
        /// a
        pub flag: u16,
    }
}

/// Opcode of a message record of the format.
const MESSAGE_OPCODE: u8 = 0x05;
/// MCAP: a chunk, behind whose header messages stand.
const CHUNK_OPCODE: u8 = 0x06;
/// Bytes of a chunk's header without a compression, and the place of its checksum there.
const CHUNK_HEADER: usize = 40;
const CHUNK_CRC_AT: usize = 24;
/// Opcode of the record with the checksum over all before it.
const DATA_END_OPCODE: u8 = 0x0F;
const RECORD_HEADER: usize = 9;
const BEFORE_STAMP: usize = 22 + 4;
/// Offset of the payload in a message.
const PAYLOAD_OFFSET: usize = 16;

fn file(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("diff");
    std::fs::create_dir_all(&folder).unwrap();
    folder.join(name)
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

fn catalog(names: &[&str]) -> Catalog {
    let lane = LaneInfo { name: "servo".into(), period: Nanos(2_500_000), ..LaneInfo::default() };
    Catalog {
        signals: names.iter().map(|name| signal::<Mixed>(name, 0)).collect(),
        lanes: vec![lane],
    }
}

fn mixed_payload(signal: usize, tick: u64) -> Mixed {
    let x = tick as f64 + 0.25 * signal as f64;
    Mixed {
        flag: tick as u8,
        angles_rad: [x, -x, 0.0],
        small: -(tick as i16),
        pixels: [x as f32, 1.5],
    }
}

/// A log of `ticks` jobs with one message of each signal in `names`; `change` may modify every
/// value and returns whether it is written.
fn log(names: &[&str], ticks: u64, change: impl Fn(usize, u64, &mut Mixed) -> bool) -> Vec<u8> {
    use std::sync::atomic::{AtomicUsize, Ordering};
    static NEXT: AtomicUsize = AtomicUsize::new(0);
    let path = file(&format!("made-{}.mcap", NEXT.fetch_add(1, Ordering::Relaxed)));
    let about = BTreeMap::from([("seed".to_owned(), "7".to_owned())]);
    // A log is not replaced by one without records.
    let _ = std::fs::remove_file(&path);
    let mut log = McapLog::create(&path, &catalog(names), &about).unwrap();
    for tick in 0..ticks {
        for signal in 0..names.len() {
            let mut value = mixed_payload(signal, tick);
            if !change(signal, tick, &mut value) {
                continue;
            }
            let mut body = vec![0; Mixed::SIZE];
            value.encode(&mut body);
            let release = Nanos(tick as i64 * 2_500_000);
            log.record(&Record { signal, tick, release, body: &body });
        }
    }
    log.finish().unwrap();
    std::fs::read(path).unwrap()
}

const NAMES: [&str; 3] = ["sense.joints", "joint_servo.torque", "servo.health"];

fn plain() -> Vec<u8> {
    log(&NAMES, 20, |_, _, _| true)
}

/// Start and length of the checked part (stamp and payload) of the message number `nth` of a file.
fn message(bytes: &[u8], nth: usize) -> (usize, usize) {
    let mut at = 8;
    let mut seen = 0;
    loop {
        let length = u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap()) as usize;
        if bytes[at] == CHUNK_OPCODE {
            at += RECORD_HEADER + CHUNK_HEADER;
            continue;
        }
        if bytes[at] == MESSAGE_OPCODE {
            if seen == nth {
                let start = at + RECORD_HEADER + BEFORE_STAMP;
                return (start, length - BEFORE_STAMP - 4);
            }
            seen += 1;
        }
        at += RECORD_HEADER + length;
    }
}

/// Flips bits of one byte of a message; with `mended`, its header and every checksum are corrected.
fn flip(bytes: &mut [u8], nth: usize, offset: usize, bits: u8, mended: bool) {
    let (start, size) = message(bytes, nth);
    assert!(offset < size);
    bytes[start + offset] ^= bits;
    if !mended {
        return;
    }
    let crc = crc32fast::hash(&bytes[start..start + size]);
    bytes[start + size..start + size + 4].copy_from_slice(&crc.to_le_bytes());
    let release = i64::from_le_bytes(bytes[start + 8..start + 16].try_into().unwrap());
    let time = u64::try_from(release).unwrap_or(0).to_le_bytes();
    bytes.copy_within(start..start + 4, start - 24);
    bytes[start - 20..start - 12].copy_from_slice(&time);
    bytes[start - 12..start - 4].copy_from_slice(&time);
    let mut at = 8;
    while bytes.get(at).is_some_and(|opcode| *opcode != DATA_END_OPCODE) {
        let length = u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap()) as usize;
        let end = at + RECORD_HEADER + length;
        if bytes[at] == CHUNK_OPCODE && (at..end).contains(&start) && end <= bytes.len() {
            let crc = crc32fast::hash(&bytes[at + RECORD_HEADER + CHUNK_HEADER..end]);
            let place = at + RECORD_HEADER + CHUNK_CRC_AT;
            bytes[place..place + 4].copy_from_slice(&crc.to_le_bytes());
        }
        at = end;
    }
    // A file that was cut has no such record.
    if at >= bytes.len() {
        return;
    }
    let crc = crc32fast::hash(&bytes[..at]);
    bytes[at + RECORD_HEADER..at + RECORD_HEADER + 4].copy_from_slice(&crc.to_le_bytes());
}

fn compare(a: &[u8], b: &[u8]) -> Comparison {
    Comparison::new(&Log::from_bytes(a.to_vec()).unwrap(), &Log::from_bytes(b.to_vec()).unwrap())
}

fn taktil(a: &Path, b: &Path, more: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_taktil")).arg("diff").args([a, b]).args(more).output().unwrap()
}

#[test]
fn equal_logs_are_equal() {
    let found = compare(&plain(), &plain());
    assert!(found.equal());
    assert_eq!(found.first(), None);
    assert_eq!((found.compared.len(), found.messages()), (3, (60, 60)));
    assert_eq!(to_json(&found)["equal"], true);
}

#[test]
fn a_flipped_byte_of_any_field_is_found_with_its_place() {
    let a = plain();
    let fields = Log::from_bytes(a.clone()).unwrap().channels()[1].fields.clone();
    let nth = 3 * 11 + 1;
    for field in &fields[1..fields.len() - 1] {
        for element in 0..field.count {
            for byte in 0..field.kind.size() {
                let mut b = a.clone();
                flip(&mut b, nth, field.offset + element * field.kind.size() + byte, 0x40, true);
                let found = compare(&a, &b);
                let place = format!("{}[{element}] byte {byte}", field.name);
                assert!(!found.equal(), "{place}");
                // A message at an instant of a hundred years is damage before it is a difference.
                let is_absurd = field.name == "release_ns" && byte == 7;
                assert_eq!(found.damage[0], None, "{place}");
                assert_eq!(found.damage[1].is_some(), is_absurd, "{place}: {:?}", found.damage);
                if is_absurd {
                    continue;
                }
                let first = found.first().unwrap();
                assert_eq!(first.task_and_port(), ("joint_servo", "torque"), "{place}");
                assert_eq!(first.tick, 11, "{place}");
                let Change::Field { field: name, index, a, b } = &first.change else {
                    panic!("{place}: {first:?}");
                };
                assert_eq!((name, *index), (&field.name, field.array.then_some(element)));
                assert_ne!(a, b, "{place}");
                let changed: usize = found.compared.iter().map(|s| s.changed + s.alone).sum();
                assert_eq!(changed, 1, "{place}");
            }
        }
    }
}

#[test]
fn a_flipped_byte_of_padding_is_not_overlooked() {
    let a = plain();
    let mut b = a.clone();
    flip(&mut b, 4, PAYLOAD_OFFSET + 3, 1, true);
    let found = compare(&a, &b);
    let Change::Field { field, index, .. } = &found.first().unwrap().change else { panic!() };
    assert_eq!((field.as_str(), *index), ("(padding)", Some(PAYLOAD_OFFSET + 3)));
}

#[test]
fn another_tick_is_a_message_too_many_on_each_side() {
    let a = plain();
    let mut b = a.clone();
    flip(&mut b, 3 * 5, 0, 0x20, true);
    let found = compare(&a, &b);
    assert_eq!(found.compared[0].alone, 2);
    let first = found.first().unwrap();
    assert_eq!((first.tick, &first.change), (5, &Change::OnlyInA));
}

#[test]
fn a_flip_without_a_mended_crc_is_damage() {
    let a = plain();
    let mut b = a.clone();
    flip(&mut b, 3 * 11 + 1, PAYLOAD_OFFSET + 8, 1, false);
    let found = compare(&a, &b);
    assert!(!found.equal());
    let damage = found.damage[1].as_deref().unwrap();
    assert!(damage.contains("CRC") && damage.contains("tick 11"), "{damage}");
    assert_eq!(found.damage[0], None);
    let first = found.first().unwrap();
    let Change::Field { field, index, .. } = &first.change else { panic!("{first:?}") };
    assert_eq!((first.tick, field.as_str(), *index), (11, "angles_rad", Some(0)));
    assert_eq!(first.signal, "joint_servo.torque");
}

#[test]
fn zeros_and_nans_are_compared_by_their_bits() {
    let a = log(&NAMES, 3, |_, _, _| true);
    let b = log(&NAMES, 3, |signal, tick, value| {
        if (signal, tick) == (0, 1) {
            value.angles_rad[2] = -0.0;
        }
        true
    });
    let Change::Field { a, b, .. } = compare(&a, &b).first().unwrap().change.clone() else {
        panic!()
    };
    assert_eq!(a, "0.0 (0x0000000000000000)");
    assert_eq!(b, "-0.0 (0x8000000000000000)");
    let nan = |bits| {
        log(&NAMES, 3, move |_, _, value: &mut Mixed| {
            value.angles_rad[1] = f64::from_bits(bits);
            true
        })
    };
    let (quiet, payload) = (0x7ff8_0000_0000_0000, 0x7ff8_0000_0000_0001);
    assert!(compare(&nan(quiet), &nan(quiet)).equal());
    let found = compare(&nan(quiet), &nan(payload));
    let first = found.first().unwrap();
    assert_eq!((first.signal.as_str(), first.tick), (NAMES[0], 0), "ties go by the catalog");
    let Change::Field { a, b, index, .. } = &first.change else { panic!() };
    assert_eq!(*index, Some(1));
    assert_ne!(a, b);
}

#[test]
fn the_first_in_time_wins_over_the_first_in_the_catalog() {
    let b = log(&NAMES, 20, |signal, tick, value| {
        if (signal, tick) == (0, 9) || (signal, tick) == (2, 8) {
            value.small += 1;
        }
        true
    });
    let found = compare(&plain(), &b);
    let first = found.first().unwrap();
    assert_eq!((first.signal.as_str(), first.tick, first.release_ns), (NAMES[2], 8, 20_000_000));
}

#[test]
fn a_dropped_message_does_not_shift_the_rest() {
    let b = log(&NAMES, 20, |signal, tick, _| (signal, tick) != (1, 4));
    let found = compare(&plain(), &b);
    assert_eq!((found.compared[1].alone, found.compared[1].changed), (1, 0));
    assert_eq!(found.compared[1].messages, (20, 19));
    assert_eq!(found.first().unwrap().change, Change::OnlyInA);
    assert_eq!(compare(&b, &plain()).first().unwrap().change, Change::OnlyInB);
}

#[test]
fn lengths_and_signals_of_one_side_are_reported() {
    let longer = log(&NAMES, 25, |_, _, _| true);
    let found = compare(&plain(), &longer);
    assert!(!found.equal());
    let first = found.first().unwrap();
    assert_eq!((first.tick, &first.change), (20, &Change::OnlyInB));
    let names = ["sense.joints", "operator.request"];
    let found = compare(&plain(), &log(&names, 20, |_, _, _| true));
    assert_eq!(found.only_a, ["joint_servo.torque", "servo.health"]);
    assert_eq!(found.only_b, ["operator.request"]);
    assert_eq!(found.first(), None);
    assert!(!found.equal());
}

#[test]
fn other_fields_are_not_compared() {
    let path = file("other.mcap");
    let mut catalog = catalog(&NAMES);
    catalog.signals[1] = signal::<Other>(NAMES[1], 0);
    // A log is not replaced by one without records.
    let _ = std::fs::remove_file(&path);
    McapLog::create(&path, &catalog, &BTreeMap::new()).unwrap().finish().unwrap();
    let found = compare(&log(&NAMES, 0, |_, _, _| true), &std::fs::read(path).unwrap());
    assert_eq!(found.other_fields, [NAMES[1]]);
    assert!(!found.equal());
    assert!(found.remarks.iter().any(|remark| remark.contains("seed")), "{:?}", found.remarks);
}

#[test]
fn cut_files_are_compared_and_never_called_equal() {
    let a = plain();
    let (start, _) = message(&a, 31);
    let cut = &a[..start + 3];
    let found = compare(&a, cut);
    assert!(found.damage[1].is_some());
    assert_eq!(found.messages(), (60, 31));
    assert_eq!(found.compared.iter().map(|signal| signal.changed).sum::<usize>(), 0);
    let both = compare(cut, cut);
    assert!(both.same_readable() && !both.equal());
    // A difference before the cut is found all the same.
    let mut b = cut.to_vec();
    flip(&mut b, 2, PAYLOAD_OFFSET, 1, true);
    assert_eq!(compare(&a, &b).first().unwrap().tick, 0);
    for length in (8..a.len()).step_by(13) {
        assert!(!compare(&a, &a[..length]).equal(), "cut at {length}");
    }
}

#[test]
fn the_command_line_answers_0_1_and_2() {
    let (a, b, cut) = (file("a.mcap"), file("b.mcap"), file("cut.mcap"));
    let mut bytes = plain();
    std::fs::write(&a, &bytes).unwrap();
    std::fs::write(&cut, &bytes[..bytes.len() / 2]).unwrap();
    flip(&mut bytes, 3 * 11 + 1, PAYLOAD_OFFSET + 8 + 8, 1, true);
    std::fs::write(&b, &bytes).unwrap();

    let equal = taktil(&a, &a, &[]);
    assert_eq!(equal.status.code(), Some(0));
    let said = String::from_utf8(equal.stdout).unwrap();
    assert!(said.contains("equal: 3 signals, 60 messages"), "{said}");

    let differs = taktil(&a, &b, &[]);
    assert_eq!(differs.status.code(), Some(1));
    let said = String::from_utf8(differs.stdout).unwrap();
    for words in ["tick   11", "0.027500000 s", "joint_servo", "torque", "angles_rad[1]"] {
        assert!(said.contains(words), "`{words}` is not in\n{said}");
    }
    let json = taktil(&a, &b, &["--json"]);
    assert_eq!(json.status.code(), Some(1));
    let json: serde_json::Value = serde_json::from_slice(&json.stdout).unwrap();
    assert_eq!(json["first"]["tick"], 11);
    assert_eq!(json["first"]["field"], "angles_rad");
    assert_eq!(json["first"]["index"], 1);

    let short = taktil(&a, &cut, &[]);
    assert_eq!(short.status.code(), Some(1));
    assert!(String::from_utf8(short.stdout).unwrap().contains("B is cut or damaged"));

    let (missing, empty, text) = (file("no-such"), file("empty"), file("text"));
    std::fs::write(&empty, "").unwrap();
    std::fs::write(&text, "t_s,x\n0,1\n").unwrap();
    for bad in [&missing, &empty, &text, &PathBuf::from(env!("CARGO_TARGET_TMPDIR"))] {
        assert_eq!(taktil(&a, bad, &[]).status.code(), Some(2), "{}", bad.display());
        assert_eq!(taktil(bad, &a, &["--json"]).status.code(), Some(2), "{}", bad.display());
    }
}
