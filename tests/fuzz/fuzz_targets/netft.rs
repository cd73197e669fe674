//! Whatever arrives from the address of a force/torque box: records of any content and number,
//! datagrams of any length, refusals. The half answers with bounded work, with readings that do not
//! run backwards, and stays lost once it is.
#![no_main]

use std::collections::VecDeque;
use std::io;

use libfuzzer_sys::fuzz_target;
use taktil_drivers_netft::rdt::{RECORD_BYTES, Record};
use taktil_drivers_netft::{Arrival, Config, NetFt, Port};
use taktil_fuzz::Numbers;
use taktil_hal::{ErrorKind, ForceTorque, Nanos};

/// Jobs of a box.
const JOBS_COUNT: usize = 64;

/// Datagrams that have arrived.
struct Link(VecDeque<Option<Vec<u8>>>);

/// The link of the half, which takes what the target put there.
#[derive(Clone)]
struct SharedLink(std::sync::Arc<std::sync::Mutex<Link>>);

impl Port for SharedLink {
    fn send(&mut self, packet: &[u8]) -> io::Result<()> {
        assert_eq!(packet, [0x12, 0x34, 0, 2, 0, 0, 0, 0], "a half asks for a start only");
        Ok(())
    }

    fn receive(&mut self, buffer: &mut [u8]) -> Arrival {
        match self.0.lock().expect("one thread").0.pop_front() {
            None => Arrival::Nothing,
            Some(None) => Arrival::Refusal,
            Some(Some(bytes)) => {
                let count = bytes.len().min(buffer.len());
                buffer[..count].copy_from_slice(&bytes[..count]);
                Arrival::Datagram(count)
            }
        }
    }
}

/// A datagram: a record whose numbers mostly go on, or anything.
fn datagram(numbers: &mut Numbers<'_>, sequence: &mut u32) -> Option<Vec<u8>> {
    let kind = numbers.byte();
    match kind & 7 {
        0 => None,
        1 => Some((0..usize::from(numbers.byte()) % 64).map(|_| numbers.byte()).collect()),
        2 => {
            let bytes: Vec<u8> = (0..RECORD_BYTES).map(|_| numbers.byte()).collect();
            assert!(Record::parse(&bytes).is_some());
            Some(bytes)
        }
        _ => {
            *sequence = sequence.wrapping_add(u32::from(kind >> 5));
            let mut bytes = [0; RECORD_BYTES];
            bytes[..4].copy_from_slice(&sequence.to_be_bytes());
            bytes[4..8].copy_from_slice(&sequence.to_be_bytes());
            bytes[8] = u8::from(kind & 8 != 0);
            bytes[12..16].copy_from_slice(&[numbers.byte(), numbers.byte(), 0, 1]);
            Some(bytes.to_vec())
        }
    }
}

fuzz_target!(|bytes: &[u8]| {
    assert_eq!(Record::parse(bytes).is_some(), bytes.len() == RECORD_BYTES);
    let mut numbers = Numbers::new(bytes);
    let kind = numbers.byte();
    let config = Config { bias: kind & 1 == 1, force_range_counts: 1 << 20, ..Config::default() };
    let link = SharedLink(std::sync::Arc::new(std::sync::Mutex::new(Link(VecDeque::new()))));
    let mut half = NetFt::new(Box::new(link.clone()), &config);
    let (mut sequence, mut newest, mut is_lost) = (u32::from(kind) << 24, None, false);
    for job in 1..=JOBS_COUNT {
        if numbers.any() {
            let count = numbers.byte() % 16;
            let mut link = link.0.lock().expect("one thread");
            for _ in 0..count {
                link.0.push_back(datagram(&mut numbers, &mut sequence));
            }
        }
        let release = Nanos::from_millis(job as i64);
        let answer = half.sample(release);
        assert_eq!(half.sample(release), answer, "the same release gives the same answer");
        match answer {
            Ok(reading) => {
                assert!(!is_lost && reading.acquired <= release);
                assert!(newest.is_none_or(|newest| reading.acquired >= newest));
                newest = Some(reading.acquired);
            }
            Err(error) => is_lost |= error.kind == ErrorKind::Lost,
        }
    }
    let seen = half.counts();
    assert!(seen.invalid <= seen.records, "{seen:?}");
});
