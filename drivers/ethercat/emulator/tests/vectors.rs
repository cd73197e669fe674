//! Frames and mailbox messages byte by byte, beside vectors that were computed from the standard
//! and, where a host was at hand, seen on its cable.

mod rig;

use rig::{Host, STATION_ADDRESS, hex};
use taktil_drivers_ethercat_emulator::{Description, Model, Segment, State, idle_motors};

/// A coupler, an analog output, an encoder and a drive.
fn chain() -> Host {
    let analog = Description::from(Model::AnalogOutput).with_object(0x2ff0, 1, &[0; 300]);
    let rest = [Model::Encoder16, Model::Drive].map(Into::into);
    let devices = [Model::Coupler.into(), analog].into_iter().chain(rest).collect();
    Host::new(Segment::new(devices, idle_motors()))
}

fn answer(host: &mut Host, request: &str, due: &str) {
    let got = host.exchange(&hex(request)).expect("an answer");
    assert_eq!(got, hex(due), "{request}");
}

#[test]
fn four_devices_answer_a_broadcast_and_count() {
    answer(&mut chain(), "0d1007000000000001000000000000", "0d1007000400000001000000110400");
}

#[test]
fn a_station_address_is_given_by_position_and_then_heard() {
    let mut host = chain();
    // Each of four devices adds one to the position, which ends at 3.
    answer(&mut host, "0e100201ffff10000200000001100000", "0e100201030010000200000001100100");
    assert_eq!(host.read(STATION_ADDRESS, 0x0010, 2), (vec![0x01, 0x10], 1));
}

#[test]
fn a_broadcast_write_reaches_all() {
    answer(&mut chain(), "0e100802000020010200000011000000", "0e100802040020010200000011000400");
}

#[test]
fn the_information_memory_gives_eight_bytes_from_a_word_on() {
    let mut host = chain();
    host.prepare(4, STATION_ADDRESS);
    answer(
        &mut host,
        "1210050401100205060000000001080000000000",
        "1210050401100205060000000001080000000100",
    );
    answer(
        &mut host,
        "14100405011008050800000000000000000000000000",
        "1410040501100805080000000200000052302610 0100",
    );
}

/// Leads the analog output to OP by the vectors of its sync manager and FMMU.
fn operational() -> Host {
    let mut host = chain();
    host.prepare(4, STATION_ADDRESS);
    answer(
        &mut host,
        "14100506011010080800000000110800640001000000",
        "14100506011010080800000000110800640001000100",
    );
    answer(
        &mut host,
        "1c1005070110000610000000000000000800000700110002010000000000",
        "1c1005070110000610000000000000000800000700110002010000000100",
    );
    host.write(STATION_ADDRESS, 0x0120, &[4, 0]);
    assert_eq!(host.state(STATION_ADDRESS), (4, 0));
    host.write(STATION_ADDRESS, 0x0120, &[8, 0]);
    assert_eq!(host.state(STATION_ADDRESS), (8, 0));
    host
}

#[test]
fn the_logical_image_puts_volts_out_and_one_device_with_outputs_counts_two() {
    let mut host = operational();
    answer(
        &mut host,
        "14100c080000000008000000004000c0000000000000",
        "14100c080000000008000000004000c0000000000200",
    );
    assert_eq!(host.segment.outputs().volts, [5.0, -5.0, 0.0, 0.0]);
}

#[test]
fn a_device_that_dropped_shows_its_state_with_the_mark_of_an_error() {
    let mut host = operational();
    host.segment.drop_device(1, State::SafeOperational);
    answer(&mut host, "0e100403011030010200000000000000", "0e100403011030010200000014000100");
    assert_eq!(host.segment.outputs().volts, [0.0; 4]);
}

#[test]
fn the_time_of_one_device_is_written_to_all_others() {
    let mut host = operational();
    let request = hex("14100e09001010090800000000000000000000000000");
    let got = host.exchange(&request).expect("an answer");
    assert_eq!(got[..12], request[..12]);
    assert!(got[12..20] != [0; 8] && got[20..] == [4, 0], "{got:02x?}");
}

#[test]
fn two_datagrams_of_a_frame_are_both_executed() {
    let mut host = operational();
    let request = "22100e0a0010100908800000000000000000000000000c0b000000000200000006000000";
    let got = host.exchange(&hex(request)).expect("an answer");
    // The second one writes two of eight bytes: they count, and the other outputs stay.
    assert_eq!((&got[20..22], &got[34..36]), (&[4, 0][..], &[2, 0][..]));
}

#[test]
fn objects_are_read_and_written_by_mailbox() {
    let mut host = chain();
    host.prepare(4, STATION_ADDRESS);
    let mut ask = |request: &str, due: &str| {
        let got = host.mail(STATION_ADDRESS, &hex(request)).expect("an answer");
        let due = hex(due);
        assert_eq!(got[..due.len()], due, "{request}");
        got
    };
    ask("0a000000001300204018100100000000", "0a000000001300304318100102000000");
    ask("0a000000002300202f121c0000000000", "0a0000000023003060121c0000000000");
    ask("0a000000003300204055550000000000", "0a000000003300208055550000000206");
    // The vector shows the first four bytes of 300, the answer fills the mailbox.
    let got = ask("0a0000000043002040f02f0100000000", "7a00000000430030");
    assert_eq!(got[6..20], hex("003041f02f012c01000000000000"));
    let first = 112;
    let segment = ask("0a000000005300206000000000000000", "7a00000000530030 00");
    assert_eq!(segment.len(), 128);
    let last = ask("0a000000006300207000000000000000", "48000000006300 30 11");
    let rest = usize::from(u16::from_le_bytes([last[0], last[1]])) - 3;
    assert_eq!(first + 119 + rest, 300);
    ask("0a000000007300207000000000000000", "0a000000007300208000000000000305");
}

#[test]
fn an_object_of_more_than_four_bytes_is_written_in_segments() {
    let mut host = chain();
    host.prepare(4, STATION_ADDRESS);
    let mail = |host: &mut Host, content: &[u8]| {
        let mut message = (content.len() as u16 + 2).to_le_bytes().to_vec();
        message.extend([0, 0, 0, 3, 0, 0x20]);
        message.extend(content);
        host.mail(STATION_ADDRESS, &message).expect("an answer")[8..].to_vec()
    };
    let mut first = hex("21 f02f01 2c010000");
    first.extend([7; 100]);
    assert_eq!(mail(&mut host, &first)[..4], hex("60 f02f01"));
    let mut next = vec![0x00];
    next.extend([8; 100]);
    assert_eq!(mail(&mut host, &next)[0], 0x20);
    let mut last = vec![0x11];
    last.extend([9; 100]);
    assert_eq!(mail(&mut host, &last)[0], 0x30);
    let read = mail(&mut host, &hex("40 f02f01 00000000"));
    assert_eq!((read[0], read[8], read[107], read[108]), (0x41, 7, 7, 8));
}
