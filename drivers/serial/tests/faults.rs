//! Faults by plan in virtual time: counted, judged, survived.

mod bench;

use bench::Bench;
use taktil_drivers_serial::{BoardKind, Config, LineState, Phase};
use taktil_drivers_serial_emulator::{Board, FlexiTac, Line, Myrmex, WeissDsa, WeissWts};
use taktil_hal::Nanos;

fn boards() -> Vec<(Config, Box<dyn Board>)> {
    let config = |board| Config { board, ..Config::default() };
    vec![
        (config(BoardKind::Myrmex), Box::new(Myrmex::new(100.0))),
        (config(BoardKind::Flexitac), Box::new(FlexiTac::new(16, 16, 100.0))),
        (config(BoardKind::WeissWts), Box::new(WeissWts::new(16, 16, 100.0))),
        (
            Config { rate_hz: 15.0, compress: false, ..config(BoardKind::WeissDsa) },
            Box::new(WeissDsa::new(16, 16, 15.0)),
        ),
    ]
}

#[test]
fn losses_are_counted_and_judged() {
    for (config, board) in boards() {
        let mut bench = Bench::new(&config, board, "kind=loss at=3 value=0.2");
        bench.run(Nanos::from_millis(3_000));
        assert_eq!(bench.session.health().missing, 0, "{:?}", config.board);
        bench.run(Nanos::from_millis(9_000));
        let health = bench.session.health();
        assert_eq!(health.state, LineState::Degraded, "{:?}", config.board);
        let share = health.missing as f64 / (6.0 * config.rate_hz);
        assert!((0.1..0.3).contains(&share), "{:?}: {share}", config.board);
        let gaps = bench.scans.windows(2).map(|pair| pair[1].sequence - pair[0].sequence - 1);
        assert_eq!(u64::from(gaps.sum::<u32>()), health.missing);
    }
}

#[test]
fn damaged_messages_are_left_out_where_a_sum_tells() {
    for (config, board) in boards() {
        let faults = "kind=corruption at=2 for=3 value=0.3; kind=truncation at=2 for=3 value=0.1";
        let mut bench = Bench::new(&config, board, faults);
        bench.run(Nanos::from_millis(8_000));
        let health = bench.session.health();
        assert!(health.garbled > 0, "{:?}", config.board);
        assert_eq!(health.state, LineState::Healthy, "{:?}", config.board);
        if config.board != BoardKind::Flexitac {
            // The ramp stays below 160: anything above is damage that was let through.
            let damaged = bench.scans.iter().filter(|scan| scan.values.iter().any(|v| *v >= 160));
            assert_eq!(damaged.count(), 0, "{:?}", config.board);
        }
        let settled = bench.scans.iter().filter(|scan| scan.acquired > Nanos::from_millis(6_000));
        let due = (2.0 * config.rate_hz) as usize;
        assert!(settled.count() + 5 > due - due / 10, "{:?}", config.board);
    }
}

#[test]
fn silence_restart_and_the_cable_are_survived() {
    for fault in ["kind=silence at=2 for=1", "kind=restart at=2", "kind=unplugged at=2 for=1"] {
        for (config, board) in boards() {
            let mut bench = Bench::new(&config, board, fault);
            bench.run(Nanos::from_millis(2_900));
            let text = format!("{:?}, {fault}", config.board);
            let health = bench.session.health();
            if fault.contains("restart") {
                // FlexiTac streams by itself again, before anybody misses it.
                let silent = u64::from(config.board != BoardKind::Flexitac);
                assert_eq!(health.losses, silent, "{text}");
            } else {
                assert_eq!((health.state, health.losses), (LineState::Lost, 1), "{text}");
            }
            bench.run(Nanos::from_millis(14_000));
            assert_eq!(bench.session.phase(), Phase::Streaming, "{text}");
            assert_eq!(bench.session.health().state, LineState::Healthy, "{text}");
            let last = bench.scans.last().unwrap().acquired;
            assert!(last > Nanos::from_millis(13_800), "{text}: last scan {last}");
            assert!(bench.scans.is_sorted_by_key(|scan| scan.acquired), "{text}");
        }
    }
}

#[test]
fn delays_do_not_move_stamps_into_the_past_or_backwards() {
    let faults = "kind=delay at=2 for=0.5 value=0.004; kind=duplication at=3 for=1 value=0.2";
    for (config, board) in boards() {
        let mut bench = Bench::new(&config, board, faults);
        bench.run(Nanos::from_millis(6_000));
        assert!(bench.scans.is_sorted_by_key(|scan| scan.acquired));
        assert!(bench.scans.is_sorted_by(|a, b| a.sequence < b.sequence));
        assert_eq!(bench.session.health().state, LineState::Healthy, "{:?}", config.board);
    }
}

#[test]
fn what_a_serial_line_cannot_do_is_refused() {
    let plan = bench::plan("kind=reordering at=0 value=0.5");
    let refused = Line::new(Box::new(Myrmex::new(100.0)), "pad", plan.clone(), 1).err().unwrap();
    assert_eq!(refused.place, "kind");
    let other = bench::plan("kind=reordering target=mesa at=0 value=0.5");
    assert!(Line::new(Box::new(Myrmex::new(100.0)), "pad", other, 1).is_ok());
}
