//! Bytes of RDT beside vectors computed elsewhere, and a parser that bears every datagram.

mod rig;

use proptest::prelude::*;
use rig::{CYCLE_PERIOD, Rig, config};
use taktil_drivers_netft::rdt::{Command, RECORD_BYTES, Record, request};
use taktil_hal::ForceTorque;

fn bytes(hex: &str) -> Vec<u8> {
    let digits: Vec<u32> = hex.chars().map(|digit| digit.to_digit(16).unwrap()).collect();
    digits.chunks(2).map(|pair| (16 * pair[0] + pair[1]) as u8).collect()
}

#[test]
fn requests_are_the_published_ones() {
    assert_eq!(request(Command::Start, 0)[..], bytes("1234000200000000"));
    assert_eq!(request(Command::Stop, 0)[..], bytes("1234000000000000"));
    assert_eq!(request(Command::Bias, 0)[..], bytes("1234004200000000"));
    assert_eq!(request(Command::Start, 0x0102_0304)[..], bytes("1234000201020304"));
}

#[test]
fn a_record_is_read_as_it_was_measured() {
    // 1, -2 and 10 N, 0.1, 0 and -0.05 Nm at a million counts each.
    let hex = "000000070000100000000000000f4240ffe17b8000989680000186a000000000ffff3cb0";
    let counts = [1_000_000, -2_000_000, 10_000_000, 100_000, 0, -50_000];
    let record = Record { rdt_sequence: 7, ft_sequence: 4096, status: 0, counts };
    assert_eq!(Record::parse(&bytes(hex)), Some(record));
    let rig = Rig::new(1000, &["kind=silence"]);
    let mut half = rig.open(&config(1000));
    rig.inject(&bytes(hex));
    let reading = half.sample(CYCLE_PERIOD).unwrap();
    assert_eq!(reading.value.codes.map(|code| code.0), counts);
}

proptest! {
    #[test]
    fn every_datagram_is_a_record_or_none(datagram in prop::collection::vec(any::<u8>(), 0..80)) {
        let record = Record::parse(&datagram);
        prop_assert_eq!(record.is_some(), datagram.len() == RECORD_BYTES);
        if let Some(record) = record {
            let mut again = Vec::new();
            for word in [record.rdt_sequence, record.ft_sequence, record.status] {
                again.extend(word.to_be_bytes());
            }
            again.extend(record.counts.iter().flat_map(|count| count.to_be_bytes()));
            prop_assert_eq!(again, datagram);
        }
    }

    #[test]
    fn no_datagrams_break_the_half(
        datagrams in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..40), 0..60),
        sizes in prop::collection::vec(prop::bool::ANY, 60),
    ) {
        let rig = Rig::new(1000, &["kind=silence"]);
        let mut half = rig.open(&config(1000));
        let count = datagrams.len() as u64;
        for (at, (mut datagram, whole)) in datagrams.into_iter().zip(sizes).enumerate() {
            if whole {
                datagram.resize(RECORD_BYTES, 0x5a);
            }
            rig.inject(&datagram);
            let _ = half.sample(CYCLE_PERIOD * at as i64);
        }
        let seen = half.counts();
        prop_assert_eq!(seen.records + seen.old + seen.strange, count);
    }
}
