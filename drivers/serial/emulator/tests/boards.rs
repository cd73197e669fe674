//! The emulated boards answer published requests with published bytes.

use taktil_drivers_serial_emulator::{Board, Myrmex, WeissDsa, WeissWts};
use taktil_hal::Nanos;

fn answers(board: &mut dyn Board, request: &[u8]) -> Vec<Vec<u8>> {
    let mut out = Vec::new();
    board.receive(Nanos::ZERO, request, &mut out);
    out
}

#[test]
fn myrmex_hears_the_published_commands() {
    let mut board = Myrmex::new(100.0);
    let configuration = answers(&mut board, &[0xf0, 0xc4, 0, 0xc0, 0xf4]);
    assert_eq!(configuration[0][..10], [0xf0, 0xc4, 0, 1, 0, 1, 0, 0, 0, 2]);
    assert_eq!(configuration[0].iter().fold(0, |sum, byte| sum ^ byte), 0);
    assert_eq!(answers(&mut board, &[0xf0, 0xc4, 0, 0xc1, 0xf5])[0][2], 0xf1);
    assert_eq!(answers(&mut board, &[0xf0, 0xc4, 0, 0xc2, 0xf6])[0][2], 0xf2);
    assert!(answers(&mut board, &[0xf0, 0xc4, 1, 0xd0, 2, 0, 0x32, 0, 0xd5]).is_empty());
    assert!(answers(&mut board, &[0xf0, 0xc4, 0, 0xf1, 0xc5]).is_empty());
    assert_eq!(board.scan_due(), Nanos::from_millis(5));
    let mut scans = Vec::new();
    board.scan(&[9; 256], &mut scans);
    assert_eq!((scans.len(), scans[0].len()), (1, 520));
    assert!(answers(&mut board, &[0xf0, 0xc4, 0, 0, 0x34]).is_empty());
    assert_eq!(board.scan_due(), Nanos::MAX);
    assert_eq!(
        answers(&mut board, &[0xf0, 0xc4, 0, 0xc0, 0xf5])[0],
        [0xf0, 0xc4, 0xfe, 0xf0, 0x3a]
    );
}

#[test]
fn weiss_boards_hear_the_published_requests_and_no_others() {
    let mut wts = WeissWts::new(16, 16, 100.0);
    let matrix = answers(&mut wts, &[0xaa, 0xaa, 0xaa, 0x30, 0, 0, 0xca, 0xcf]);
    assert_eq!((matrix[0][3], matrix[0].len()), (0x30, 6 + 12 + 2));
    assert!(answers(&mut wts, &[0xaa, 0xaa, 0xaa, 0x30, 0, 0, 0xca, 0xce]).is_empty());
    answers(&mut wts, &[0xaa, 0xaa, 0xaa, 0x21, 3, 0, 0, 5, 0, 0xea, 0xb9]);
    assert_eq!(wts.scan_due(), Nanos::from_millis(5));

    let mut dsa = WeissDsa::new(16, 16, 100.0);
    let on = answers(&mut dsa, &[0xaa, 0xaa, 0xaa, 3, 3, 0, 0x80, 0x1e, 0, 0x8e, 0x1c]);
    assert_eq!(on[0].len(), 6 + 2 + 2);
    assert_eq!(dsa.scan_due(), Nanos(1_000_000_000 / 30));
    for (id, payload_bytes) in [(1, 18), (2, 12)] {
        let answer = answers(&mut dsa, &[0xaa, 0xaa, 0xaa, id, 0, 0]);
        assert_eq!(answer[0].len(), 6 + payload_bytes + 2);
    }
    let mut scans = Vec::new();
    dsa.scan(&[9; 256], &mut scans);
    assert_eq!(scans[0].len(), 525);
}

#[test]
fn a_dsa_that_was_just_powered_greets_and_is_deaf() {
    let mut board = WeissDsa::new(16, 16, 20.0);
    board.restart(Nanos::ZERO);
    assert!(answers(&mut board, &[0xaa, 0xaa, 0xaa, 1, 0, 0]).is_empty());
    let mut out = Vec::new();
    board.greet(Nanos::from_millis(7_820), &mut out);
    assert_eq!(out, vec![b"\x1b[5n".to_vec(); 3]);
    board.receive(Nanos::from_millis(8_000), &[0xaa, 0xaa, 0xaa, 1, 0, 0], &mut out);
    assert_eq!(out.len(), 4);
}
