//! The drives by their frames: what they answer to published vectors, and what a plan of faults
//! makes of it.

use taktil_drivers_can_emulator::{BusFrame, Emulator, Kind};
use taktil_hal::Nanos;
use taktil_hal::fault::FaultPlan;

fn bytes(hex: &str) -> Vec<u8> {
    let digits: Vec<u32> = hex.chars().map(|digit| digit.to_digit(16).unwrap()).collect();
    digits.chunks(2).map(|pair| (16 * pair[0] + pair[1]) as u8).collect()
}

/// Drive 5 of a kind, after what it says by itself.
fn emulator(kind: Kind, faults: &[&str]) -> Emulator {
    let plan = FaultPlan::new(faults.iter().map(|text| text.parse().unwrap()).collect());
    let mut emulator = Emulator::new(kind, &[5]).with_faults(plan, "can", 1);
    emulator.poll(Nanos::ZERO, &mut Vec::new());
    emulator
}

/// Hands a frame over at `ms` and gives what comes at once: identifiers and data.
fn say(emulator: &mut Emulator, ms: i64, id: u32, hex: &str) -> Vec<(u32, Vec<u8>)> {
    let (now, mut frames) = (Nanos::from_millis(ms), Vec::new());
    emulator.receive(now, &BusFrame::classic(id, &bytes(hex)).bytes());
    emulator.poll(now, &mut frames);
    let read = |bytes: &Vec<u8>| {
        let frame = BusFrame::from_bytes(bytes).unwrap();
        (frame.id(), frame.data)
    };
    frames.iter().map(read).collect()
}

#[test]
fn objects_are_read_written_and_refused() {
    let mut drive = emulator(Kind::CanOpen(1_270), &[]);
    let mut ask = |hex| {
        let answers = say(&mut drive, 1, 0x605, hex);
        assert_eq!((answers.len(), answers[0].0), (1, 0x585), "{hex}");
        answers[0].1.clone()
    };
    assert_eq!(ask("4000100000000000"), bytes("4300100092010200"), "profile 402");
    assert_eq!(ask("4076600000000000"), bytes("43766000f6040000"), "1270 mNm");
    assert_eq!(ask("2f6060000a000000"), bytes("6060600000000000"));
    assert_eq!(ask("4060600000000000"), bytes("4f6060000a000000"));
    assert_eq!(ask("2b6060000a000000"), bytes("8060600010000706"), "another length");
    assert_eq!(ask("4055550000000000"), bytes("8055550000000206"), "no such object");
    assert_eq!(ask("4018100700000000"), bytes("8018100711000906"), "no such sub-index");
    assert_eq!(ask("2b41600000000000"), bytes("8041600002000106"), "it can only be read");
    assert_eq!(ask("2300140105020000"), bytes("6000140100000000"), "a frame is switched on");
    assert_eq!(ask("2f00160001000000"), bytes("8000160022000008"), "it is on: no change");
}

#[test]
fn a_drive_sends_by_sync_only_when_it_was_started() {
    let mut drive = emulator(Kind::CanOpen(1_000), &[]);
    // The frame off, its content the statusword, then on.
    for hex in ["2300180185010080", "2f001a0000000000", "23001a0110004160", "2f001a0001000000"] {
        assert_eq!(say(&mut drive, 2, 0x605, hex)[0].1[0], 0x60, "{hex}");
    }
    say(&mut drive, 2, 0x605, "2f00180201000000");
    say(&mut drive, 2, 0x605, "2300180185010040");
    assert_eq!(say(&mut drive, 3, 0x080, ""), [], "pre-operational");
    assert_eq!(say(&mut drive, 4, 0x000, "0105"), []);
    assert_eq!(say(&mut drive, 5, 0x080, ""), [(0x185, bytes("5002"))], "switch on disabled");
}

#[test]
fn a_controller_answers_registers_and_is_left_by_stopping_only() {
    let mut drive = emulator(Kind::Moteus, &[]);
    let mut ask = |ms: i64, hex: &str| {
        let (now, mut frames) = (Nanos::from_millis(ms), Vec::new());
        let frame = BusFrame { word: 0x8000_8005, is_fd: true, data: bytes(hex) };
        drive.receive(now, &frame.bytes());
        drive.poll(now, &mut frames);
        let frame = BusFrame::from_bytes(&frames[0]).unwrap();
        assert_eq!((frames.len(), frame.id()), (1, 0x500));
        frame.data
    };
    assert_eq!(ask(1, "1100"), bytes("20010000"), "stopped");
    assert_eq!(ask(2, "01000a1100"), bytes("2001000a"), "position mode");
    // The watchdog of 0.1 s, and modes that do not leave it.
    assert_eq!(ask(200, "1100"), bytes("2001000b"));
    assert_eq!(ask(201, "01000a1100"), bytes("2001000b"));
    assert_eq!(ask(202, "0100001100"), bytes("20010000"));
}

#[test]
fn an_axis_answers_remote_frames_and_its_watchdog_is_an_error() {
    let mut drive = emulator(Kind::Odrive, &[]);
    let request = BusFrame { word: 0x4000_00a9, is_fd: false, data: Vec::new() };
    let mut frames = Vec::new();
    drive.receive(Nanos::from_millis(1), &request.bytes());
    drive.poll(Nanos::from_millis(1), &mut frames);
    let frame = BusFrame::from_bytes(&frames[0]).unwrap();
    assert_eq!((frame.id(), frame.data), (0x0a9, bytes("0000000000000000")));
    let state = say(&mut drive, 2, 0x0a7, "08000000");
    assert_eq!(state, [(0x0a1, bytes("0000000008000000"))]);
    assert!(drive.outputs(0).is_enabled);
    drive.advance(Nanos::from_millis(60));
    assert!(!drive.outputs(0).is_enabled);
    let state = say(&mut drive, 61, 0x0a7, "08000000");
    assert_eq!(state.last().unwrap().1, bytes("0008000001000000"), "the error stays");
}

#[test]
fn faults_befall_frames_and_drives() {
    for (fault, due) in [
        ("kind=loss value=1", 0),
        ("kind=silence", 0),
        ("kind=silence target=can.1", 0),
        ("kind=silence target=can.2", 1),
        ("kind=duplication value=1", 4),
    ] {
        let mut drive = emulator(Kind::CanOpen(1_000), &[&format!("{fault} at=0.0005")]);
        let answers = say(&mut drive, 1, 0x605, "4000100000000000");
        assert_eq!(answers.len(), due, "{fault}");
    }
    let mut drive = emulator(Kind::CanOpen(1_000), &["kind=unplugged at=0.001"]);
    let report = say(&mut drive, 1, 0x605, "4000100000000000");
    assert_eq!(report, [(0x2000_0024 & 0x1fff_ffff, bytes("0020000000000000"))]);
}
