//! The emulated card answers as the firmware does: spaces, sizes, pointers, errors that swallow an
//! answer, watchdogs and pins.

use taktil_drivers_mesa_emulator::{Emulator, Firmware, Inputs, REMOTE_SILENCE};
use taktil_hal::Nanos;
use taktil_hal::fault::{FaultPlan, SplitMix};

const START_TIME: Nanos = Nanos::from_millis(1);

fn card(firmware: Firmware) -> Emulator {
    let counts = |_: Nanos, _: &_| Inputs {
        counts: vec![5; 6],
        field: 0xa5,
        pins: vec![0; 3],
        ..Inputs::default()
    };
    Emulator::new(firmware, 0, Box::new(counts))
}

/// What a packet of these 16-bit words is answered with.
fn ask(card: &mut Emulator, now: Nanos, words: &[u16]) -> Option<Vec<u8>> {
    let packet: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
    card.receive(now, &packet);
    let mut answers = Vec::new();
    card.poll(now, &mut answers);
    assert!(answers.len() <= 1);
    answers.pop()
}

fn put(card: &mut Emulator, now: Nanos, address: u16, word: u32) {
    let words = [0xc281, address, word as u16, (word >> 16) as u16];
    assert_eq!(ask(card, now, &words), None, "a packet without reads is never answered");
}

#[test]
fn the_vector_of_the_manual_is_answered() {
    let mut card = card(Firmware::with_7i77());
    assert_eq!(ask(&mut card, START_TIME, &[0x4282, 0x0104]), Some(b"HOSTMOT2".to_vec()));
    assert_eq!(ask(&mut card, START_TIME, &[0x4281, 0x0100]), Some(vec![0xfe, 0xca, 0xaa, 0x55]));
    assert_eq!(ask(&mut card, START_TIME, &[0x5d82, 0x0000]), Some(b"7I92".to_vec()));
}

#[test]
fn any_error_swallows_the_answer_and_not_the_writes_before_it() {
    let mut card = card(Firmware::with_7i77());
    let good = [0x4281, 0x0100];
    let bad: [&[u16]; 9] = [
        &[0x4280, 0x0100],         // count 0
        &[0x4181, 0x0100],         // 16 bits from the registers
        &[0x4081, 0x0100],         // 8 bits
        &[0x5281, 0x0010],         // 32 bits from the timers
        &[0x4d81, 0x0000],         // space 3
        &[0x5581, 0x0000],         // space 5
        &[0x5181, 0x0020],         // behind the end of the timers
        &[0xdd81, 0x0000, 0x0000], // a write to the card's name
        &[0xc281, 0x1100, 0x0001], // half a word
    ];
    for bad in bad {
        let words = [&good[..], bad].concat();
        assert_eq!(ask(&mut card, START_TIME, &words), None, "{bad:04x?}");
        assert!(ask(&mut card, START_TIME, &good).is_some());
    }
    let words = [0xc281, 0x1100, 0x1234, 0x0000, 0x4280, 0x0000];
    assert_eq!(ask(&mut card, START_TIME, &words), None);
    assert_eq!(card.register(START_TIME, 0x1100), 0x1234);
    // The counters of errors: of the parser, of memory, of writes.
    let counters = ask(&mut card, START_TIME, &[0x5983, 0x0002]).unwrap();
    assert_eq!(counters, [8, 0, 1, 0, 1, 0]);
}

#[test]
fn every_space_goes_on_where_it_was_also_in_the_next_packet() {
    let mut card = card(Firmware::with_7i77());
    assert_eq!(ask(&mut card, START_TIME, &[0x4281, 0x0104]).unwrap(), b"HOST");
    assert_eq!(ask(&mut card, START_TIME, &[0xd181, 0x0010, 0x1234]), None);
    assert_eq!(ask(&mut card, START_TIME, &[0x0281]).unwrap(), b"MOT2");
    assert_eq!(ask(&mut card, START_TIME, &[0x9181, 0x5678]), None);
    assert_eq!(ask(&mut card, START_TIME, &[0x5182, 0x0010]).unwrap(), [0x34, 0x12, 0x78, 0x56]);
    // Without increment it stays.
    assert_eq!(ask(&mut card, START_TIME, &[0x4202, 0x0104]).unwrap(), b"HOSTHOST");
}

#[test]
fn information_areas_tell_cookie_pointer_and_name() {
    let mut card = card(Firmware::with_7i77());
    let area = ask(&mut card, START_TIME, &[0x6188, 0x0000]).unwrap();
    assert_eq!(area[..2], [0x00, 0x5a]);
    assert_eq!(&area[8..], b"HostMot2");
    assert_eq!(ask(&mut card, START_TIME, &[0x6288, 0x0000]), None, "16 bits only");
    assert_eq!(ask(&mut card, START_TIME, &[0x6189, 0x0000]), None, "eight words");
    assert_eq!(ask(&mut card, START_TIME, &[0xe181, 0x0000, 1]), None);
}

#[test]
fn an_answer_that_fits_no_frame_is_dropped() {
    let mut card = card(Firmware::with_7i77());
    let reads = |n: usize| [0x42fe, 0x0400].repeat(n);
    assert_eq!(ask(&mut card, START_TIME, &reads(2)).unwrap().len(), 1_008);
    assert_eq!(ask(&mut card, START_TIME, &reads(3)), None);
}

#[test]
fn a_bite_clears_directions_and_nothing_else() {
    let mut card = card(Firmware::with_pwm());
    let at = |ms| START_TIME + Nanos::from_millis(ms);
    put(&mut card, START_TIME, 0x4000, 0x0800_0000);
    put(&mut card, START_TIME, 0x4100, 3);
    put(&mut card, START_TIME, 0x4400, 1);
    assert_eq!(card.outputs(START_TIME).pwm[0], 0.0, "no pin drives it");
    for port in 0..3 {
        put(&mut card, START_TIME, 0x1200 + 4 * port, 0x00ff_ffff);
        put(&mut card, START_TIME, 0x1100 + 4 * port, 0x00ff_ffff);
    }
    let duty = card.outputs(START_TIME).pwm[0];
    assert!((duty - 2_048.0 / 4_095.0).abs() < 1e-12);
    put(&mut card, START_TIME, 0x0c00, 999_999); // 10 ms
    put(&mut card, at(9), 0x0e00, 0x1234_5678); // no sign of life
    put(&mut card, at(9), 0x0e00, 0x5a00_0000);
    assert_eq!(card.outputs(at(18)).pwm[0], duty);
    assert_eq!(card.outputs(at(20)).pwm[0], 0.0);
    assert_eq!(card.register(at(20), 0x0d00), 1);
    assert_eq!(
        [0x1100, 0x1200, 0x4000].map(|a| card.register(at(20), a)),
        [0, 0x00ff_ffff, 0x0800_0000]
    );
    // A sign of life restarts the timer after a bite, too; the status stays.
    put(&mut card, at(21), 0x0e00, 0x5a00_0000);
    put(&mut card, at(21), 0x1100, 0x00ff_ffff);
    assert_eq!(card.outputs(at(22)).pwm[0], duty, "the old value is out again");
    assert_eq!(card.register(at(22), 0x0d00), 1);
    put(&mut card, at(22), 0x0d00, 0);
    assert_eq!(card.register(at(22), 0x0d00), 0);
    card.outputs(at(40));
    assert_eq!(card.bites(), 2);
}

#[test]
fn a_remote_acts_on_exchanges_and_its_watchdog_needs_a_stop_and_a_start() {
    let mut card = card(Firmware::with_7i77());
    let mut now = START_TIME;
    let mut step = |card: &mut Emulator, address: u16, word: u32| {
        put(card, now, address, word);
        now += Nanos::from_millis(5);
        card.outputs(now)
    };
    step(&mut card, 0x1200, 0x1_ffff);
    step(&mut card, 0x1100, 0x0ff);
    step(&mut card, 0x5a00, 0x0f03);
    assert_eq!(card.register(START_TIME, 0x5e04), u32::from_le_bytes(*b"7I77"));
    step(&mut card, 0x5a00, 0x0800);
    step(&mut card, 0x5a00, 0x0903);
    step(&mut card, 0x5d04, 4_095);
    let outputs = step(&mut card, 0x5a00, 0x1003);
    assert_eq!(outputs.volts[0], 0.0, "not enabled");
    step(&mut card, 0x5f04, 1 << 14);
    let outputs = step(&mut card, 0x5a00, 0x1003);
    assert_eq!((outputs.volts[0], outputs.analog_enabled), (10.0, true));
    for _ in 0..=REMOTE_SILENCE.0 / 5_000_000 {
        step(&mut card, 0x0200, 0);
    }
    let outputs = step(&mut card, 0x5a00, 0x1003);
    assert_eq!(outputs.volts[0], 0.0, "an exchange does not help");
    step(&mut card, 0x5a00, 0x0800);
    let outputs = step(&mut card, 0x5a00, 0x0903);
    assert_eq!(outputs.volts[0], 0.0, "zeros until the next exchange");
    assert_eq!(step(&mut card, 0x5a00, 0x1003).volts[0], 10.0);
    // Without directions nothing reaches the remote.
    step(&mut card, 0x1100, 0);
    step(&mut card, 0x5a00, 0x1003);
    assert_eq!(card.register(START_TIME, 0x5b00), 3);
    assert_ne!(card.register(START_TIME, 0x5c04) & 0x2000, 0);
}

#[test]
fn no_packet_makes_the_card_panic() {
    let plan: Vec<_> = [
        "kind=corruption value=0.5",
        "kind=truncation value=0.5",
        "kind=reordering value=0.5",
        "kind=duplication value=0.5",
        "kind=delay value=0.001",
        "kind=restart at=0.001",
    ]
    .iter()
    .map(|text| text.parse().unwrap())
    .collect();
    let mut random = SplitMix::new(1);
    for firmware in [Firmware::with_7i77(), Firmware::with_pwm()] {
        let mut card = card(firmware).with_faults(FaultPlan::new(plan.clone()), "x", 1);
        let mut answers = Vec::new();
        for round in 0..20_000 {
            let length = random.next_u64() as usize % 64;
            let mut packet: Vec<u8> = (0..length).map(|_| random.next_u64() as u8).collect();
            if let [low, high, ..] = packet.as_mut_slice()
                && round % 2 == 0
            {
                (*low, *high) = (0x80 | (*low & 0x0f), 0x42 | (*high & 0x80));
            }
            let now = Nanos(round * 100_000);
            card.receive(now, &packet);
            card.poll(now, &mut answers);
            assert!(answers.iter().all(|answer| answer.len() <= 1_472));
            answers.clear();
        }
    }
}
