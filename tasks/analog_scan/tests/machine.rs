//! Tests the task in a machine in virtual time over a scripted board.

use taktil_hal::{AdcCode, AnalogIn, CHANNELS, Error, ErrorKind, Nanos, Reading};
use taktil_rtcore::{FaultCode, FaultSet};
use taktil_signal::AnalogInputs;
use taktil_tasks_analog_scan::{AnalogScan, Config};
use taktil_tests_script::{Bench, SERVO_PERIOD};

struct Board {
    channels: usize,
    answer: fn(i64) -> Result<i32, ErrorKind>,
}

impl AnalogIn for Board {
    fn channels(&self) -> usize {
        self.channels
    }

    fn code_range(&self) -> (AdcCode, AdcCode) {
        (AdcCode(-2048), AdcCode(2047))
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<[AdcCode; CHANNELS]>, Error> {
        let code = (self.answer)(release.0 / SERVO_PERIOD.0);
        let code = code.map_err(|kind| Error::whole(kind, "script"))?;
        let value = std::array::from_fn(|i| {
            AdcCode(if i < self.channels { code + i32::try_from(i).unwrap() } else { 0 })
        });
        Ok(Reading { value, acquired: release })
    }
}

fn run(channels: usize, config: Config, answer: fn(i64) -> Result<i32, ErrorKind>) -> Outcome {
    let mut bench = Bench::new();
    let lane = bench.servo();
    let board = Box::new(Board { channels, answer });
    bench.task(lane, "analog_scan", |ports| AnalogScan::new(&config, board, ports));
    let run = bench.run(SERVO_PERIOD * 20);
    Outcome { values: run.values_with_ticks("analog_scan.values"), faults: run.faults() }
}

struct Outcome {
    values: Vec<(u64, AnalogInputs)>,
    faults: FaultSet,
}

#[test]
fn a_board_of_any_width_is_seen_code_by_code_and_scaled() {
    for channels in [1, 8, 15, CHANNELS] {
        let config = Config {
            scale_per_code: Some(vec![0.5; channels]),
            zero_codes: Some(vec![10.0; channels]),
            ..Config::default()
        };
        let found = run(channels, config, |job| Ok(100 * i32::try_from(job).unwrap()));
        assert!(found.faults.is_empty());
        assert_eq!(found.values.len(), 20);
        let (_, third) = &found.values[3];
        assert_eq!((third.codes.len(), third.values.len()), (channels, channels));
        assert_eq!(third.codes[channels - 1], 300 + i32::try_from(channels).unwrap() - 1);
        assert!((third.values[0] - 145.0).abs() < 1e-12, "{}", third.values[0]);
    }
}

#[test]
fn a_failed_read_holds_the_last_values_and_a_silent_board_is_lost() {
    let found = run(2, Config::default(), |job| match job {
        4 => Err(ErrorKind::Transient),
        _ => Ok(1),
    });
    assert!(found.faults.is_empty());
    assert_eq!(found.values.len(), 19);
    for kind in [ErrorKind::Lost, ErrorKind::Stale] {
        let silent: fn(i64) -> Result<i32, ErrorKind> = match kind {
            ErrorKind::Lost => |job| if job < 3 { Ok(1) } else { Err(ErrorKind::Lost) },
            _ => |job| if job < 3 { Ok(1) } else { Err(ErrorKind::Stale) },
        };
        let found = run(2, Config::default(), silent);
        assert!(found.faults.contains(FaultCode::AnalogLost), "{kind:?}");
        assert_eq!(found.values.len(), 3);
    }
}

#[test]
fn lists_that_do_not_fit_the_board_are_refused() {
    let place = |config: Config| {
        let mut bench = Bench::new();
        let lane = bench.servo();
        let board = Box::new(Board { channels: 3, answer: |_| Ok(0) });
        let bad =
            bench.refused(lane, "analog_scan", |ports| AnalogScan::new(&config, board, ports));
        bad.place
    };
    let list = |list: Vec<f64>| Config { scale_per_code: Some(list), ..Config::default() };
    assert!(place(list(vec![1.0; 2])).ends_with("scale_per_code"));
    assert!(place(list(vec![1.0, f64::NAN, 1.0])).ends_with("scale_per_code[1]"));
    let zero = Config { zero_codes: Some(vec![f64::INFINITY; 3]), ..Config::default() };
    assert!(place(zero).ends_with("zero_codes[0]"));
    assert!(place(Config { stale_ms: 0.0, ..Config::default() }).ends_with("stale_ms"));
}
