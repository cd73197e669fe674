//! Tests the task in a machine in virtual time with a scripted sensor.

use taktil_hal::{AdcCode, Error, ErrorKind, FORCE_TORQUE_CHANNELS, ForceTorque, Nanos, Reading};
use taktil_rtcore::{FaultCode, FaultSet, Payload};
use taktil_signal::Wrench;
use taktil_tasks_wrist_scan::{Config, WristScan};
use taktil_tests_script::{Bench, SERVO_PERIOD};

struct Sensor(fn(i64) -> Result<i32, ErrorKind>);

impl ForceTorque for Sensor {
    fn sample(
        &mut self,
        release: Nanos,
    ) -> Result<Reading<[AdcCode; FORCE_TORQUE_CHANNELS]>, Error> {
        match (self.0)(release.0 / SERVO_PERIOD.0) {
            Ok(code) => {
                Ok(Reading { value: [AdcCode(code); FORCE_TORQUE_CHANNELS], acquired: release })
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
