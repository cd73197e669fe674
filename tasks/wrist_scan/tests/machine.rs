//! Tests the task in a machine in virtual time with a scripted sensor.

use taktil_hal::{
    AdcCode, Error, ErrorKind, FORCE_TORQUE_CHANNELS, ForceTorque, GaugeCodes, Nanos, Reading,
};
use taktil_rtcore::{FaultCode, FaultSet, Payload};
use taktil_signal::{WRENCH_OVER_RANGE, WRENCH_SATURATED, Wrench};
use taktil_tasks_wrist_scan::{Config, WristScan};
use taktil_tests_script::{Bench, SERVO_PERIOD};

struct Sensor(fn(i64) -> Result<i32, ErrorKind>);

impl ForceTorque for Sensor {
    fn sample(&mut self, release: Nanos) -> Result<Reading<GaugeCodes>, Error> {
        match (self.0)(release.0 / SERVO_PERIOD.0) {
            Ok(code) => {
                let (low, high) = (AdcCode(-2048), AdcCode(2047));
                let value = GaugeCodes::within(low, high, [AdcCode(code); FORCE_TORQUE_CHANNELS]);
                Ok(Reading { value, acquired: release })
            }
            Err(kind) => Err(Error { kind, device: "script", channel: Error::ALL_CHANNELS }),
        }
    }
}

fn run(answer: fn(i64) -> Result<i32, ErrorKind>, jobs: i64) -> (Vec<(u64, Wrench)>, FaultSet) {
    let mut bench = Bench::new();
    let servo = bench.servo();
    let config = Config { baseline_readings: 10, ..Config::default() };
    bench
        .task(servo, "wrist_scan", |ports| WristScan::new(config, Box::new(Sensor(answer)), ports));
    let run = bench.run(SERVO_PERIOD * jobs);
    (run.values_with_ticks("wrist_scan.wrench"), run.faults())
}

#[test]
fn the_load_is_what_is_above_the_rest_level() {
    let (seen, faults) = run(|job| Ok(if job < 10 { 100 } else { 400 }), 20);
    assert!(faults.is_empty());
    assert_eq!((seen[8].1.baseline_ready, seen[8].1.force_n), (0, [0.0; 3]));
    let (tick, last) = seen[19];
    assert_eq!((tick, last.baseline_ready, last.acquired_ns), (19, 1, SERVO_PERIOD.0 * 19));
    assert_eq!((last.force_n, last.moment_nm), ([15.0; 3], [0.3; 3]));
}

#[test]
fn unread_values_are_not_published_and_a_lost_board_is_reported() {
    let (seen, faults) = run(|job| if job == 12 { Err(ErrorKind::Transient) } else { Ok(100) }, 20);
    assert!(faults.is_empty() && seen.len() == 19);
    let (seen, faults) = run(|job| if job >= 12 { Err(ErrorKind::Stale) } else { Ok(100) }, 30);
    assert!(faults.contains(FaultCode::WristLost) && seen.len() == 12);
    let (_, faults) = run(|job| if job == 3 { Err(ErrorKind::Lost) } else { Ok(100) }, 8);
    assert!(faults.contains(FaultCode::WristLost));
    assert_eq!(Wrench::ZERO.baseline_ready, 0);
}

#[test]
fn a_gauge_at_the_end_of_its_range_marks_the_wrench_and_is_a_fault_when_it_lasts() {
    let mark = |seen: &[(u64, Wrench)]| {
        seen.iter().map(|(_, wrench)| wrench.baseline_ready).collect::<Vec<_>>()
    };
    // Two readings are a spike: marked, and no fault.
    let (seen, faults) = run(|job| Ok(if matches!(job, 12 | 13) { 2047 } else { 100 }), 20);
    assert!(faults.is_empty(), "{faults:?}");
    let (over, all) = (WRENCH_OVER_RANGE, mark(&seen));
    assert_eq!(all[9..16], [1, 1, 1, over, over, 1, 1]);
    assert!(!seen[12].1.is_known() && seen[12].1.force_n[0] > 97.0, "the least load is told");
    // The third one in a row is a fault; with the load gone the wrench is known again.
    let (seen, faults) = run(|job| Ok(if (12..16).contains(&job) { -2048 } else { 100 }), 20);
    assert!(faults.contains(FaultCode::WristOverRange));
    let saturated = WRENCH_SATURATED;
    assert_eq!(mark(&seen)[11..17], [1, over, over, saturated, saturated, 1]);
    assert!(seen[19].1.is_known());
}

#[test]
fn a_reading_over_range_is_no_part_of_the_rest_level() {
    let (seen, faults) = run(|job| Ok(if job < 4 { 2047 } else { 100 }), 20);
    assert!(faults.contains(FaultCode::WristOverRange));
    assert_eq!((seen[12].1.baseline_ready, seen[13].1.baseline_ready), (0, 1));
    assert_eq!(seen[19].1.force_n, [0.0; 3], "the rest level is that of the readings in range");
}

#[test]
fn bad_numbers_are_refused_with_their_place() {
    let place = |change: fn(&mut Config)| {
        let mut config = Config::default();
        change(&mut config);
        config.check().unwrap_err().place
    };
    assert!(Config::default().check().is_ok());
    assert_eq!(place(|c| c.baseline_readings = 0), "baseline_readings");
    assert_eq!(place(|c| c.stale_ms = f64::NAN), "stale_ms");
    assert_eq!(place(|c| c.codes_per_n_nm[2] = [0.0; 6]), "codes_per_n_nm");
}
