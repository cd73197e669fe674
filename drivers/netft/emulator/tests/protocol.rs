//! The box by its bytes: what it answers to each request, and what a plan of faults makes of it.

use taktil_drivers_netft_emulator::Emulator;
use taktil_hal::Nanos;
use taktil_hal::fault::FaultPlan;

const START_REQUEST: [u8; 8] = [0x12, 0x34, 0, 2, 0, 0, 0, 0];
const STOP_REQUEST: [u8; 8] = [0x12, 0x34, 0, 0, 0, 0, 0, 0];
const BIAS_REQUEST: [u8; 8] = [0x12, 0x34, 0, 0x42, 0, 0, 0, 0];

/// A box of 1000 records a second whose sensor reads 100 to 600.
fn emulator(faults: &[&str]) -> Emulator {
    let plan = FaultPlan::new(faults.iter().map(|text| text.parse().unwrap()).collect());
    let sensor = |_| [100, 200, 300, 400, 500, 600];
    Emulator::new(1000, Box::new(sensor)).with_faults(plan, "netft", 1)
}

fn ms(ms: i64) -> Nanos {
    Nanos::from_millis(ms)
}

/// Records up to an instant as their nine words.
fn records(emulator: &mut Emulator, until: Nanos) -> Vec<[i32; 9]> {
    let mut bytes = Vec::new();
    emulator.poll(until, &mut bytes);
    let word = |record: &Vec<u8>, at: usize| {
        i32::from_be_bytes(record[4 * at..4 * at + 4].try_into().unwrap())
    };
    bytes.iter().map(|record| core::array::from_fn(|at| word(record, at))).collect()
}

#[test]
fn records_come_from_start_to_stop_and_count_from_one() {
    let mut emulator = emulator(&[]);
    assert_eq!(records(&mut emulator, ms(5)).len(), 0);
    emulator.receive(ms(5), &START_REQUEST);
    let seen = records(&mut emulator, ms(8));
    assert_eq!(seen[0], [1, 6, 0, 100, 200, 300, 400, 500, 600]);
    assert_eq!(seen.iter().map(|record| record[0]).collect::<Vec<_>>(), [1, 2, 3]);
    emulator.receive(ms(8), &STOP_REQUEST);
    assert_eq!((records(&mut emulator, ms(20)).len(), emulator.next_due()), (0, None));
    emulator.receive(ms(20), &[0x12, 0x34, 0, 2, 0, 0, 0, 2]);
    let seen = records(&mut emulator, ms(30));
    assert_eq!(
        seen.iter().map(|record| record[..2].to_vec()).collect::<Vec<_>>(),
        [[1, 21], [2, 22]]
    );
}

#[test]
fn a_bias_makes_the_load_of_now_the_zero_until_a_restart() {
    let mut emulator = emulator(&["kind=restart at=0.1"]);
    emulator.receive(ms(1), &BIAS_REQUEST);
    emulator.receive(ms(2), &START_REQUEST);
    assert_eq!(records(&mut emulator, ms(3))[0][3..], [0; 6]);
    assert_eq!(records(&mut emulator, ms(300)).len(), 97, "a box that restarted is silent");
    emulator.receive(ms(300), &START_REQUEST);
    assert_eq!(records(&mut emulator, ms(301))[0], [1, 201, 0, 100, 200, 300, 400, 500, 600]);
}

#[test]
fn what_is_no_request_is_ignored() {
    let mut emulator = emulator(&[]);
    for packet in [&START_REQUEST[..7], &[0x12, 0x35, 0, 2, 0, 0, 0, 0], &[], &[0; 9]] {
        emulator.receive(ms(1), packet);
    }
    assert_eq!(records(&mut emulator, ms(10)).len(), 0);
}

#[test]
fn faults_befall_records() {
    for (fault, due) in [
        ("kind=loss value=1", 0),
        ("kind=duplication value=1", 20),
        ("kind=silence", 0),
        ("kind=delay value=0.004", 6),
    ] {
        let mut emulator = emulator(&[&format!("{fault} at=0.0005")]);
        emulator.receive(Nanos::ZERO, &START_REQUEST);
        assert_eq!(records(&mut emulator, ms(10)).len(), due, "{fault}");
        assert!(emulator.traffic().faults.iter().next().is_some(), "{fault}");
    }
    let mut emulator = emulator(&["kind=reordering value=1 at=0.0005"]);
    emulator.receive(Nanos::ZERO, &START_REQUEST);
    let order: Vec<i32> = records(&mut emulator, ms(4)).iter().map(|record| record[0]).collect();
    assert_eq!(order, [2, 1, 4, 3]);
}
