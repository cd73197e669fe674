//! Every board against its emulator in virtual time: what goes on the wire, what arrives, what is
//! refused.

mod bench;

use bench::{Bench, ramp};
use taktil_drivers_serial::{BoardKind, Config, LineState, Phase, Pressure, StartError};
use taktil_drivers_serial_emulator::{Board, FlexiTac, Myrmex, WeissDsa, WeissWts};
use taktil_hal::Nanos;

fn config(board: BoardKind, rows: u16, cols: u16) -> Config {
    Config { board, rows, cols, ..Config::default() }
}

/// All boards at sizes that they have.
fn boards() -> Vec<(Config, Box<dyn Board>)> {
    vec![
        (config(BoardKind::Myrmex, 16, 16), Box::new(Myrmex::new(50.0))),
        (config(BoardKind::Flexitac, 16, 16), Box::new(FlexiTac::new(16, 16, 100.0))),
        (config(BoardKind::Flexitac, 16, 32), Box::new(FlexiTac::new(16, 32, 100.0))),
        (config(BoardKind::Flexitac, 12, 32), Box::new(FlexiTac::new(12, 32, 100.0))),
        (
            Config { rate_hz: 40.0, ..config(BoardKind::Flexitac, 64, 64) },
            Box::new(FlexiTac::new(64, 64, 40.0)),
        ),
        (config(BoardKind::Flexitac, 1, 1), Box::new(FlexiTac::new(1, 1, 100.0))),
        (config(BoardKind::WeissWts, 14, 6), Box::new(WeissWts::new(14, 6, 50.0))),
        (
            Config { rate_hz: 20.0, ..config(BoardKind::WeissDsa, 16, 16) },
            Box::new(WeissDsa::new(16, 16, 50.0)),
        ),
    ]
}

#[test]
fn every_board_starts_and_its_images_arrive_where_they_belong() {
    for (config, board) in boards() {
        let mut bench = Bench::new(&config, board, "");
        bench.run(Nanos::from_millis(3_000));
        let text = format!("{:?} {} x {}", config.board, config.rows, config.cols);
        assert_eq!(bench.session.phase(), Phase::Streaming, "{text}");
        assert_eq!(bench.session.health().state, LineState::Healthy, "{text}");
        assert_eq!(bench.session.health().garbled, 0, "{text}");
        assert!(bench.scans.len() > 40, "{text}: {} scans", bench.scans.len());
        let full_scale = bench.session.geometry().full_scale;
        let cols = usize::from(config.cols);
        for scan in &bench.scans {
            // The emulator scanned at the instant of the stamp: the image tells which it was.
            let mut wanted = vec![0; scan.values.len()];
            ramp(bench.instant_of(scan.acquired), cols, &mut wanted);
            wanted.iter_mut().for_each(|value| *value = (*value).min(full_scale));
            assert_eq!(*scan.values, *wanted, "{text} at {}", scan.acquired);
        }
    }
}

#[test]
fn scans_are_stamped_with_their_instant() {
    for (config, board) in boards() {
        let mut bench = Bench::new(&config, board, "");
        bench.run(Nanos::from_millis(2_500));
        let late = bench.scans.iter().rev().take(40).map(|scan| {
            let error = scan.acquired - bench.instant_of(scan.acquired);
            error.0.abs()
        });
        // Bytes are handed over every 100 us.
        let allowed_ns = 150_000;
        let worst = late.max().unwrap_or(i64::MAX);
        assert!(worst <= allowed_ns, "{:?}: {worst} ns", config.board);
    }
}

#[test]
fn pressure_may_lower_counts() {
    let lowers = Config { pressure: Pressure::Lowers, ..config(BoardKind::Myrmex, 16, 16) };
    let mut bench = Bench::new(&lowers, Box::new(Myrmex::new(100.0)), "");
    bench.image = Box::new(|_, values| values.fill(4_000));
    bench.run(Nanos::from_millis(1_000));
    assert!(bench.scans.iter().all(|scan| scan.values.iter().all(|value| *value == 95)));
    assert!(!bench.scans.is_empty());
}

#[test]
fn optional_answers_of_myrmex_may_stay_away() {
    for board in [
        Myrmex::new(100.0).without_optional_replies(),
        Myrmex::new(100.0).without_optional_replies().with_old_errors(),
        Myrmex::new(100.0).with_sensors(&[12, 512, 6]),
    ] {
        let mut bench = Bench::new(&config(BoardKind::Myrmex, 16, 16), Box::new(board), "");
        bench.run(Nanos::from_millis(2_000));
        assert_eq!(bench.session.phase(), Phase::Streaming);
        assert!(bench.scans.len() > 80, "{}", bench.scans.len());
        assert_eq!(bench.session.health().garbled, 0);
    }
}

#[test]
fn a_board_that_streams_already_is_stopped_first() {
    let mut bench =
        Bench::new(&config(BoardKind::Myrmex, 16, 16), Box::new(Myrmex::new(100.0)), "");
    // Another program has started it and gone.
    bench.line.receive(Nanos::ZERO, &[0xf0, 0xc4, 0, 0xf1, 0xc5]);
    bench.run(Nanos::from_millis(1_500));
    assert_eq!(bench.session.phase(), Phase::Streaming);
    assert_eq!(bench.requests[0], [0xf0, 0xc4, 0, 0, 0x34]);
    let silence = bench.request_times[1] - bench.request_times[0];
    assert!(silence >= Nanos::from_millis(100), "{silence}");
}

#[test]
fn the_dialogue_of_myrmex_is_in_the_order_of_its_makers() {
    let mut bench = Bench::new(&config(BoardKind::Myrmex, 16, 16), Box::new(Myrmex::new(50.0)), "");
    bench.run(Nanos::from_millis(1_000));
    let commands: Vec<u8> = bench.requests.iter().map(|request| request[3]).collect();
    assert_eq!(commands, [0x00, 0xc0, 0xc2, 0xc1, 0xd0, 0xf1]);
}

#[test]
fn the_dialogue_of_dsa_begins_by_switching_off() {
    let config = config(BoardKind::WeissDsa, 16, 16);
    let mut bench = Bench::new(&config, Box::new(WeissDsa::new(16, 16, 20.0)), "");
    bench.run(Nanos::from_millis(1_000));
    assert_eq!(bench.requests[0][..9], [0xaa, 0xaa, 0xaa, 3, 3, 0, 1, 0, 0]);
    let ids: Vec<u8> = bench.requests.iter().map(|request| request[3]).collect();
    assert_eq!(ids, [0x03, 0x01, 0x02, 0x0b, 0x03]);
    // Empty requests of DSA carry no sum.
    assert_eq!(bench.requests[1], [0xaa, 0xaa, 0xaa, 1, 0, 0]);
}

#[test]
fn a_dsa_that_was_just_powered_is_waited_for() {
    let mut board = WeissDsa::new(16, 16, 20.0);
    board.restart(Nanos::ZERO);
    let mut bench = Bench::new(&config(BoardKind::WeissDsa, 16, 16), Box::new(board), "");
    bench.run(Nanos::from_millis(9_500));
    assert_eq!(bench.session.phase(), Phase::Streaming);
}

#[test]
fn wrong_sizes_and_foreign_boards_are_named() {
    let flexitac = |rows, cols| config(BoardKind::Flexitac, rows, cols);
    let wts = |rows, cols| config(BoardKind::WeissWts, rows, cols);
    let quick = |config: Config| Config { start_timeout_ms: 1_000, ..config };
    let short = Myrmex::new(50.0).with_sensors(&[12, 6]);
    let text = FlexiTac::new(16, 16, 100.0).with_diagnostic_text();
    let wanted: Vec<(Config, Box<dyn Board>, StartError)> = vec![
        (flexitac(16, 32), Box::new(FlexiTac::new(16, 16, 100.0)), StartError::HeaderDistance(258)),
        (flexitac(16, 16), Box::new(FlexiTac::new(12, 32, 100.0)), StartError::HeaderDistance(386)),
        (flexitac(16, 16), Box::new(text), StartError::Text),
        (flexitac(16, 16), Box::new(Myrmex::new(50.0)), StartError::NoAnswer("stream")),
        (wts(16, 16), Box::new(WeissWts::new(14, 6, 50.0)), StartError::Size { rows: 14, cols: 6 }),
        (
            Config { full_scale: 1_023, ..wts(14, 6) },
            Box::new(WeissWts::new(14, 6, 50.0)),
            StartError::FullScale(4_095),
        ),
        (config(BoardKind::Myrmex, 16, 16), Box::new(short), StartError::NoSensor),
        (
            config(BoardKind::Myrmex, 16, 16),
            Box::new(FlexiTac::new(16, 16, 100.0)),
            StartError::NotSilent,
        ),
        (
            config(BoardKind::Myrmex, 16, 16),
            Box::new(WeissWts::new(16, 16, 100.0)),
            StartError::NoAnswer("configuration"),
        ),
        (
            Config { sensor: 1, ..config(BoardKind::WeissDsa, 16, 16) },
            Box::new(WeissDsa::new(16, 16, 20.0)),
            StartError::NoMatrix,
        ),
    ];
    for (config, board, error) in wanted {
        let mut bench = Bench::new(&quick(config.clone()), board, "");
        bench.run(Nanos::from_millis(4_000));
        assert_eq!(bench.session.phase(), Phase::Failed(error), "{:?}", config.board);
        assert!(bench.scans.is_empty());
    }
}
