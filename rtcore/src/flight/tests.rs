//! Tests that written records are read back, wherever the writer stopped, and that damage is
//! reported.

use std::io::Write;
use taktil_hal::Nanos;

use super::*;
use crate::record::{LaneInfo, Signal};

/// Two lanes: 1 ms with signals of 10 and 64 bytes, 5 ms with one of 24.
fn catalog() -> Catalog {
    let signal = |name: &str, lane, size| Signal {
        name: name.into(),
        lane,
        type_name: "T".into(),
        fields: (&[]).into(),
        size,
    };
    let lane = |name: &str, ms| LaneInfo {
        name: name.into(),
        period: Nanos::from_millis(ms),
        ..LaneInfo::default()
    };
    Catalog {
        signals: vec![signal("a.x", 0, 10), signal("a.y", 0, 64), signal("b.z", 1, 24)],
        lanes: vec![lane("fast", 1), lane("slow", 5)],
    }
}

/// A file of one test, removed at its end; none where there is no memory to put it.
struct Shm(std::path::PathBuf);

impl Shm {
    fn new(name: &str) -> Shm {
        Shm(Path::new("/dev/shm").join(format!("taktil-flight-{name}-{}", std::process::id())))
    }

    fn record(&self, seconds: f64) -> Option<(Vec<FlightRing>, GrantWriter)> {
        match record(&self.0, &catalog(), seconds, "about it") {
            Ok((recorder, notebook)) => Some((recorder.into_lanes(), notebook)),
            Err(refused) => {
                let _ = writeln!(std::io::stderr(), "SKIPPED: {refused}");
                None
            }
        }
    }

    fn bytes(&self) -> Vec<u8> {
        std::fs::read(&self.0).unwrap()
    }
}

impl Drop for Shm {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

/// As a lane hands a record to observers.
fn message(signal: u16, tick: u64, body: &[u8]) -> Vec<u8> {
    let mut message = signal.to_le_bytes().to_vec();
    message.extend([0, 0]);
    message.extend(u32::try_from(body.len()).unwrap().to_le_bytes());
    message.extend(tick.to_le_bytes());
    message.extend((1_000_000 * i64::try_from(tick).unwrap()).to_le_bytes());
    message.extend(body);
    message
}

fn job(lane: &mut FlightRing, tick: u64) {
    lane.begin_job(tick);
    let byte = tick.to_le_bytes()[0];
    lane.enter_task(1);
    lane.append(&message(0, tick, &[byte; 10]));
    lane.enter_task(2);
    lane.append(&message(1, tick, &[byte; 64]));
    lane.enter_task(0);
}

#[test]
fn the_newest_records_are_there_after_any_number_of_jobs() {
    let file = Shm::new("newest");
    let Some((mut lanes, mut notebook)) = file.record(0.01) else { return };
    notebook.write_granted("everything");
    for tick in 0..500 {
        job(&mut lanes[0], tick);
        let found = read(&file.bytes()).unwrap();
        assert_eq!((found.about.as_str(), found.granted.as_str()), ("about it", "everything"));
        let lane = &found.lanes[0];
        assert_eq!((lane.tick, lane.running, &lane.damage), (tick, None, &None));
        let records: Vec<_> = lane.records().collect();
        assert!(
            records.len() >= 2 * usize::try_from(tick + 1).unwrap().min(9),
            "{}",
            records.len()
        );
        for pair in records.windows(2) {
            assert_eq!(pair[1].tick, pair[0].tick + u64::from(pair[0].signal == 1));
        }
        let last = records.last().unwrap();
        assert_eq!(
            (last.signal, last.tick, last.body),
            (1, tick, &[tick.to_le_bytes()[0]; 64][..])
        );
        assert_eq!(last.release, Nanos::from_millis(i64::try_from(tick).unwrap()));
        assert_eq!(found.lanes[1].records().count(), 0);
    }
}

#[test]
fn a_writer_that_stops_anywhere_leaves_whole_records() {
    let file = Shm::new("anywhere");
    let Some((mut lanes, _notebook)) = file.record(0.01) else { return };
    for tick in 0..40 {
        job(&mut lanes[0], tick);
    }
    let before = read(&file.bytes()).unwrap().lanes[0].records().count();
    // As if it were killed after the tail was moved, amid the copy and before the head was moved.
    let lane = &mut lanes[0];
    lane.begin_job(40);
    lane.enter_task(2);
    let capacity = lane.ring.len() as u64;
    while lane.head + 96 > lane.tail + capacity {
        lane.tail += lane.size_at(lane.tail);
    }
    lane.words.store_ordered(TAIL_AT, lane.tail);
    lane.copy(lane.head, &[0xEE; 50]);
    let found = read(&file.bytes()).unwrap().lanes.remove(0);
    assert_eq!((found.tick, found.running, &found.damage), (40, Some(1), &None));
    let records: Vec<_> = found.records().collect();
    assert!(records.len() >= before - 3 && records.len() <= before);
    assert_eq!(records.last().unwrap().tick, 39, "the newest whole job");
}

#[test]
fn every_damage_is_one_sentence_and_no_panic() {
    let file = Shm::new("damage");
    let Some((mut lanes, _notebook)) = file.record(0.01) else { return };
    for tick in 0..40 {
        job(&mut lanes[0], tick);
    }
    let good = file.bytes();
    let why = |bytes: &[u8]| read(bytes).unwrap_err();
    assert_eq!(why(&[]), "it is empty");
    assert!(why(b"no such thing").starts_with("it is no flight recording"));
    assert!(why(&vec![0; 100_000]).starts_with("it is no flight recording"));
    assert!(why(&good[..good.len() - 1]).starts_with("it is cut"));
    assert!(why(&good[..5000]).contains("cut before the text"));
    let mut other = good.clone();
    other[8] = 9;
    assert!(why(&other).contains("version 9"));
    // Any byte may be anything: a refusal or fewer records, never a panic.
    let mut state = 0x1234_5678_9ABC_DEF1_u64;
    for _ in 0..4000 {
        let mut bytes = good.clone();
        for _ in 0..4 {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            let near = if state.is_multiple_of(2) { HEADER_PAGE_BYTES } else { bytes.len() };
            let at = (state >> 8) as usize % near;
            bytes[at] = state.to_le_bytes()[7];
        }
        if let Ok(found) = read(&bytes) {
            let _ = found.lanes.iter().map(|lane| lane.records().count()).sum::<usize>();
        }
    }
    // A length in the middle: what stands before it is kept.
    let first = usize::try_from(u64::from_le_bytes(good[48..56].try_into().unwrap())).unwrap();
    let mut torn = good;
    torn[first + LANE_BLOCK_BYTES..].fill(0xFF);
    let lane = &read(&torn).unwrap().lanes[0];
    assert!(lane.damage.as_ref().is_some_and(|words| words.contains("damaged")), "{lane:?}");
}

#[test]
fn a_file_that_ends_anywhere_is_refused_or_read() {
    let file = Shm::new("cut");
    let Some((mut lanes, _notebook)) = file.record(0.01) else { return };
    for tick in 0..40 {
        job(&mut lanes[0], tick);
        job(&mut lanes[1], tick / 5);
    }
    let good = file.bytes();
    let mut ends: Vec<usize> = (0..HEADER_PAGE_BYTES + 64).collect();
    ends.extend((1..1000).map(|part| good.len() * part / 1000));
    for end in ends {
        assert!(read(&good[..end]).is_err(), "cut at {end}: a lane lies behind");
    }
    assert_eq!(read(&good).unwrap().lanes.len(), 2);
}

#[test]
fn numbers_of_a_damaged_file_are_neither_sizes_nor_instants() {
    let file = Shm::new("numbers");
    let Some((mut lanes, _notebook)) = file.record(0.01) else { return };
    for tick in 0..40 {
        job(&mut lanes[0], tick);
    }
    let good = file.bytes();
    // Every lane is the whole file: copies of it would be a hundred times its size.
    let mut rings = good.clone();
    rings[12..16].copy_from_slice(&200_u32.to_le_bytes());
    for lane in 0..200 {
        let size = (good.len() - LANE_BLOCK_BYTES) as u64;
        let at = LANE_TABLE_AT + 16 * lane;
        rings[at..at + 8].copy_from_slice(&0_u64.to_le_bytes());
        rings[at + 8..at + 16].copy_from_slice(&size.to_le_bytes());
    }
    assert_eq!(read(&rings).unwrap_err(), "its header is damaged: rings overlap");
    // The oldest record that is left has a number, a job or an instant at the end of its word.
    let first = usize::try_from(u64::from_le_bytes(good[48..56].try_into().unwrap())).unwrap();
    let ring = first + LANE_BLOCK_BYTES;
    let tail = u64::from_le_bytes(good[first..first + 8].try_into().unwrap());
    let size = u64::from_le_bytes(good[56..64].try_into().unwrap());
    let oldest = ring + usize::try_from(tail % size).unwrap();
    for (offset, word) in [(0, u64::MAX), (16, u64::MAX), (24, 1 << 63), (24, i64::MAX as u64)] {
        let mut altered = good.clone();
        altered[oldest + offset..oldest + offset + 8].copy_from_slice(&word.to_le_bytes());
        let lane = &read(&altered).unwrap().lanes[0];
        assert!(lane.damage.is_some() && lane.records().count() <= 1, "{offset}: {lane:?}");
    }
}

#[test]
fn what_cannot_be_recorded_is_refused_with_its_place() {
    let path = Path::new("/dev/shm/taktil-flight-never");
    let place = |seconds| record(path, &catalog(), seconds, "").err().unwrap().place;
    for bad in [f64::NAN, f64::INFINITY, 0.0, -1.0, 3601.0] {
        assert_eq!(place(bad), "seconds", "{bad}");
    }
    let mut wide = catalog();
    wide.signals[0].size = 1 << 20;
    assert_eq!(record(path, &wide, 3600.0, "").err().unwrap().remedy, "record fewer seconds");
    let disk = record(Path::new("/proc/x"), &catalog(), 1.0, "").err().unwrap();
    assert_eq!(
        (disk.place.as_str(), disk.remedy.as_str()),
        ("path", "name a file in /run or /dev/shm")
    );
    assert!(!path.exists());
}
