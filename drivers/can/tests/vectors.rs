//! Frames beside vectors that were computed elsewhere, from the standards' and the makers' texts.

use taktil_drivers_can::canopen::{self, Emergency, Management, emergency, process_data};
use taktil_drivers_can::moteus::{Encoding, Subframes, position_scale, registers};
use taktil_drivers_can::{Frame, odrive, sdo};

fn bytes(hex: &str) -> Vec<u8> {
    let digits: Vec<u32> = hex.chars().map(|digit| digit.to_digit(16).unwrap()).collect();
    digits.chunks(2).map(|pair| (16 * pair[0] + pair[1]) as u8).collect()
}

fn assert_frame(frame: &Frame, id: u32, hex: &str) {
    assert_eq!((frame.id, frame.data()), (id, &bytes(hex)[..]), "{frame:?}");
}

#[test]
fn frames_of_canopen() {
    assert_frame(&canopen::management(Management::Start, 5), 0x000, "0105");
    assert_frame(&canopen::management(Management::PreOperational, 0), 0x000, "8000");
    assert_frame(&canopen::sync(), 0x080, "");
    assert_frame(&canopen::heartbeat(5), 0x705, "05");
    let values = [(0x000f, 16), (100_000, 32)];
    assert_frame(&process_data(0x200, 5, &values), 0x205, "0f00a0860100");
    assert_frame(&sdo::download(5, 0x6060, 0, 8, 8), 0x605, "2f60600008000000");
    assert_frame(&sdo::upload(5, 0x1018, 1), 0x605, "4018100100000000");
    let message = Frame::classic(0x085, &bytes("3081110000000000"));
    assert_eq!(emergency(&message, 5), Some(Emergency { code: 0x8130, register: 0x11 }));
    assert_eq!(emergency(&message, 6), None);
}

#[test]
fn frames_of_moteus() {
    let command = Subframes::default()
        .write_int8(0x00, &[10])
        .write_float(0x20, &[0.5, 0.0, 0.0])
        .read(Encoding::Int16, 0x00, 4);
    assert_eq!(command.data(), bytes("01000a0f200000003f0000000000000000140400"));
    let frame = command.frame(0, 1, true);
    assert_eq!((frame.id, frame.is_extended, frame.is_flexible), (0x8001, true, true));
    let stop = Subframes::default().write_int8(0x00, &[0]).frame(0, 1, true);
    assert_frame(&stop, 0x8001, "010000");

    let reply = bytes("2404000a008813e803f6ff");
    let values: Vec<(u32, Option<f64>)> =
        registers(&reply).map(|told| (told.register, told.raw)).collect();
    assert_eq!(values, [(0, Some(10.0)), (1, Some(5000.0)), (2, Some(1000.0)), (3, Some(-10.0))]);
    let turns = values[1].1.unwrap() * position_scale(Encoding::Int16);
    // One multiplication by a number that is no binary fraction.
    assert!((turns - 0.5).abs() < 1e-15, "{turns}");
}

#[test]
fn numbers_that_a_controller_does_not_have_are_none() {
    let all = |hex| registers(&bytes(hex)).map(|told| told.raw).collect::<Vec<_>>();
    assert_eq!(all("210180"), [None]);
    assert_eq!(all("25010080"), [None]);
    assert_eq!(all("290100000080"), [None]);
    assert_eq!(all("2d010000c07f"), [None]);
    assert_eq!(all("5050210105"), [Some(5.0)], "padding stands between subframes");
    assert_eq!(all("22010506"), [Some(5.0), Some(6.0)]);
    assert_eq!(all("2d010000803f5050"), [Some(1.0)]);
    for cut in ["", "21", "2101", "24", "2404", "240400", "24040001", "30", "24ffffffffff"] {
        assert_eq!(all(cut), [], "{cut}");
    }
}

#[test]
fn frames_of_odrive() {
    assert_frame(&odrive::input_velocity(3, 2.0, 0.25), 0x06d, "000000400000803e");
    assert_frame(&odrive::input_position(3, 1.5, 500, 100), 0x06c, "0000c03ff4016400");
    assert_frame(&odrive::axis_state(3, 8), 0x067, "08000000");
    let frame = Frame::classic(0x069, &bytes("000080bf0000003f"));
    assert_eq!(odrive::estimates(&frame, 3), Some((-1.0, 0.5)));
    assert_eq!(odrive::estimates(&frame, 2), None);
    let broken = Frame::classic(0x069, &bytes("0000c07f0000003f"));
    assert_eq!(odrive::estimates(&broken, 3), None, "no number");
}
