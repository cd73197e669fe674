//! Hostile logs and flight recordings: good ones that were cut and altered, and some that were
//! written to mislead.

use std::collections::BTreeMap;
use std::path::Path;

use taktil_record::McapLog;
use taktil_rtcore::Nanos;
use taktil_rtcore::payload::{Field, Primitive};
use taktil_rtcore::record::{Catalog, LaneInfo, Observer, Record, Signal};

use crate::draws::Draws;

/// Cuts and alterations that are drawn.
const DRAWN_COUNT: usize = 24;

/// The bytes with something wrong in them, and what that is.
pub(crate) fn altered(bytes: &[u8], seed: u64) -> Vec<(String, Vec<u8>)> {
    let mut draws = Draws::new(seed);
    let mut all = Vec::new();
    for _ in 0..DRAWN_COUNT {
        let at = draws.below(bytes.len());
        all.push((format!("cut at byte {at}"), bytes[..at].to_vec()));
    }
    for number in 0..DRAWN_COUNT {
        let mut altered = bytes.to_vec();
        for _ in 0..=number {
            let at = draws.below(altered.len());
            altered[at] ^= 1 << draws.below(8);
        }
        all.push((format!("{} bits flipped", number + 1), altered));
    }
    for value in [0, 0x7f, 0xff] {
        for _ in 0..6 {
            let mut altered = bytes.to_vec();
            let at = draws.below(altered.len().min(20_000));
            altered.iter_mut().skip(at).take(8).for_each(|byte| *byte = value);
            all.push((format!("eight bytes of {value} at {at}"), altered));
        }
    }
    let half = bytes.len() / 2;
    all.push(("twice".into(), [bytes, bytes].concat()));
    all.push((
        "halves exchanged".into(),
        [&bytes[..16], &bytes[half..], &bytes[16..half]].concat(),
    ));
    all.push(("zeros behind it".into(), [bytes, &[0; 4096]].concat()));
    all.push(("zeros from the middle on".into(), [&bytes[..half], &vec![0; half]].concat()));
    all
}

/// Logs that a writer has made with names and instants that no run has.
pub(crate) fn misleading(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let (least, most) = (i64::MIN, i64::MAX);
    let long = "n".repeat(1 << 18);
    let instants = |name: &str, ticks: &[(u64, i64)]| (name.to_owned(), log(folder, "a.b", ticks));
    vec![
        instants("instants at both ends of time", &[(0, least), (1, most), (u64::MAX, 0)]),
        instants("instants that run backwards", &[(9, 1 << 40), (8, 1 << 30), (7, -(1 << 40))]),
        instants("ticks at the end of numbers", &[(u64::MAX, 1), (u64::MAX - 1, 2), (0, 3)]),
        instants("one message", &[(0, 0)]),
        instants("no message", &[]),
        ("a long name".to_owned(), log(folder, &long, &[(0, 0), (1, 1)])),
        ("escape sequences as a name".to_owned(), log(folder, "\u{1b}[2J.\u{9b}x", &[(0, 0)])),
        ("a folder as a name".to_owned(), log(folder, "../../x/./y", &[(0, 0), (1, 1_000_000)])),
        ("the name of a state".to_owned(), log(folder, "servo.state", &[(0, 0), (1, 1)])),
        ("the name of a mode".to_owned(), log(folder, "supervisor.control", &[(0, 0), (1, 1)])),
        ("the name of joints".to_owned(), log(folder, "sense.joints", &[(0, 0), (1, 1)])),
    ]
}

/// A log of one signal, whose values are no numbers.
fn log(folder: &Path, signal: &str, jobs: &[(u64, i64)]) -> Vec<u8> {
    const FIELDS: &[Field] = &[
        Field { name: "q_rad", kind: Primitive::F64, count: 3, array: true },
        Field { name: "word", kind: Primitive::U64, count: 1, array: false },
    ];
    let lane = LaneInfo { name: "servo".into(), period: Nanos(0), ..LaneInfo::default() };
    let signal = Signal {
        name: signal.to_owned(),
        lane: 0,
        type_name: "JointState".into(),
        fields: FIELDS.into(),
        size: 32,
    };
    let catalog = Catalog { signals: vec![signal], lanes: vec![lane] };
    let path = folder.join("misleading.mcap");
    let words = ["scene", "scene_text", "machine_text", "seed", "mode", "devices", "taktil"];
    let metadata: BTreeMap<String, String> =
        words.into_iter().map(|word| (word.to_owned(), "\u{1b}[2J\n".repeat(1000))).collect();
    let mut log = McapLog::create(&path, &catalog, &metadata).unwrap();
    for (tick, release) in jobs {
        let body = [f64::NAN, f64::INFINITY, -1e308, f64::from_bits(u64::MAX)];
        let body: Vec<u8> = body.iter().flat_map(|x| x.to_le_bytes()).collect();
        log.record(&Record { signal: 0, tick: *tick, release: Nanos(*release), body: &body });
        // Each in a chunk of its own: a writer subtracts instants within one.
        log.flush();
    }
    log.finish().unwrap();
    let bytes = std::fs::read(&path).unwrap();
    std::fs::remove_file(&path).unwrap();
    bytes
}

/// Flight recordings with something wrong in the numbers of their header.
pub(crate) fn misleading_flights(bytes: &[u8]) -> Vec<(String, Vec<u8>)> {
    let mut all = Vec::new();
    // The places of the header: version, lanes, texts, the first two lanes.
    for at in [8, 12, 16, 24, 32, 40, 48, 56, 64, 72] {
        for value in [0_u64, 253, u64::from(u32::MAX), u64::MAX - 8] {
            let mut altered = bytes.to_vec();
            let word = value.to_le_bytes();
            let width = if at < 16 { 4 } else { 8 };
            altered[at..at + width].copy_from_slice(&word[..width]);
            all.push((format!("{value} at byte {at}"), altered));
        }
    }
    // Every lane is the whole file.
    let mut altered = bytes.to_vec();
    altered[12..16].copy_from_slice(&253_u32.to_le_bytes());
    let size = bytes.len() as u64 - 64;
    for lane in 0..253 {
        altered[48 + 16 * lane..][..8].copy_from_slice(&0_u64.to_le_bytes());
        altered[56 + 16 * lane..][..8].copy_from_slice(&size.to_le_bytes());
    }
    all.push(("rings that overlap".to_owned(), altered));
    all
}
