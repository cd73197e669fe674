//! Tests `sense` in a machine in virtual time with scripted boards.

use taktil_hal::{
    CHANNELS, Counts, DigitalIn, Encoders, Error, ErrorKind, IndexPulses, LinesIn, Reading,
};
use taktil_mechanics::robot::Robot;
use taktil_rtcore::{FaultCode, Nanos, Payload};
use taktil_signal::{ControlState, HomeCheck, JointState, Lines};
use taktil_tasks_sense::index::IndexConfig;
use taktil_tasks_sense::{Config, Sense};
use taktil_tests_script::{Bench, SERVO_PERIOD};

/// Boards latch a little before they are asked.
const LATCHED_BEFORE: Nanos = Nanos::from_micros(100);

/// Answers by the number of the job.
struct Script<T> {
    answer: fn(i64) -> Result<T, ErrorKind>,
    joints: usize,
}

impl<T> Script<T> {
    fn sample(&self, release: Nanos) -> Result<Reading<T>, Error> {
        let value = (self.answer)(release.0 / SERVO_PERIOD.0);
        let acquired = release - LATCHED_BEFORE;
        value
            .map(|value| Reading { value, acquired })
            .map_err(|kind| Error::whole(kind, "test.board"))
    }
}

impl Encoders for Script<[Counts; CHANNELS]> {
    fn joints(&self) -> usize {
        self.joints
    }
    fn sample(&mut self, release: Nanos) -> Result<Reading<[Counts; CHANNELS]>, Error> {
        Script::sample(self, release)
    }
}

impl DigitalIn for Script<LinesIn> {
    fn sample(&mut self, release: Nanos) -> Result<Reading<LinesIn>, Error> {
        Script::sample(self, release)
    }
}

/// What came out, with the number of the job.
struct Seen {
    joints: Vec<(u64, JointState)>,
    lines: Vec<(u64, Lines)>,
}

impl Seen {
    fn joints_at(&self, tick: u64) -> Option<JointState> {
        self.joints.iter().find(|(at, _)| *at == tick).map(|(_, joints)| *joints)
    }
}

const POWERED: LinesIn = LinesIn { drive_power: true, estop_a_closed: true, estop_b_closed: false };

/// Runs 100 jobs; returns what came out and the faults that the lane saw.
fn run(
    encoders: fn(i64) -> Result<[Counts; CHANNELS], ErrorKind>,
    lines: fn(i64) -> Result<LinesIn, ErrorKind>,
) -> (Seen, Vec<FaultCode>) {
    let mut bench = Bench::new();
    let lane = bench.servo();
    bench.task(lane, "sense", |ports| {
        let encoders = Box::new(Script { answer: encoders, joints: 6 });
        let lines = Box::new(Script { answer: lines, joints: 0 });
        Sense::new(Config::default(), &Robot::puma260(), encoders, lines, ports)
    });
    // Says in job 10 that the arm stands in its home pose.
    bench.feed(lane, "control", |tick| {
        Some(ControlState { calibrate: u32::from(tick == 10), ..ControlState::ZERO })
    });
    bench.bind_feeds("sense", &["control"]);
    let run = bench.run(SERVO_PERIOD * 100);
    let seen = Seen {
        joints: run.values_with_ticks("sense.joints"),
        lines: run.values_with_ticks("sense.lines"),
    };
    (seen, run.faults().iter().collect())
}

fn steady(job: i64) -> [Counts; CHANNELS] {
    [Counts(2 * i32::try_from(job).unwrap()); CHANNELS]
}

#[test]
fn joints_and_lines_come_in_every_job_and_the_zero_one_job_after_the_word() {
    let (seen, faults) = run(|job| Ok(steady(job)), |_| Ok(POWERED));
    assert_eq!((seen.joints.len(), seen.lines.len(), faults.len()), (100, 100, 0));
    let expected = Lines { drive_power: 1, estop_a_closed: 1, estop_b_closed: 0 };
    assert!(seen.lines.iter().all(|(_, lines)| *lines == expected));
    for (tick, joints) in &seen.joints {
        let datum = u32::from(*tick >= 11);
        assert_eq!((joints.datum, joints.calibrated), (datum, datum), "job {tick}");
        assert_eq!(joints.counts, [2 * i32::try_from(*tick).unwrap(); 6]);
        let speed = if *tick == 0 { 0.0 } else { 2.0 / 7435.7 / 0.0025 };
        assert!((joints.qd_rad_s[0] - speed).abs() < 1e-4, "job {tick}");
    }
    let home = seen.joints_at(11).unwrap();
    assert!((home.q_rad[2].to_degrees() + 180.0).abs() < 1e-9);
    assert!((home.q_rad[4].to_degrees() - 90.0).abs() < 1e-9);
}

#[test]
fn one_failed_read_holds_two_are_a_lost_board() {
    let (seen, faults) = run(
        |job| if matches!(job, 20 | 22) { Err(ErrorKind::Transient) } else { Ok(steady(job)) },
        |job| if matches!(job, 30 | 32) { Err(ErrorKind::Transient) } else { Ok(POWERED) },
    );
    assert_eq!(faults, []);
    assert!(seen.joints_at(20).is_none(), "nothing is invented");
    let speed = seen.joints_at(21).unwrap().qd_rad_s[0];
    assert!((speed - 2.0 / 7435.7 / 0.0025).abs() < 1e-4, "over two periods");
    let (_, faults) = run(
        |job| if (20..22).contains(&job) { Err(ErrorKind::Transient) } else { Ok(steady(job)) },
        |job| if job == 30 { Err(ErrorKind::Lost) } else { Ok(POWERED) },
    );
    assert_eq!(faults, [FaultCode::EncoderLost, FaultCode::DigitalLost]);
}

#[test]
fn a_calibration_waits_for_a_sample_that_can_be_believed() {
    let (seen, _) = run(
        |job| if job == 11 { Err(ErrorKind::Transient) } else { Ok(steady(job)) },
        |_| Ok(POWERED),
    );
    assert_eq!(seen.joints_at(10).unwrap().calibrated, 0);
    let home = seen.joints_at(12).unwrap();
    assert_eq!((home.calibrated, home.datum), (1, 1));
    assert!((home.q_rad[2].to_degrees() + 180.0).abs() < 1e-9);
}

#[test]
fn a_jump_is_a_fault_and_is_not_published() {
    let (seen, faults) = run(
        |job| Ok(if job >= 50 { [Counts(5000); CHANNELS] } else { steady(0) }),
        |_| Ok(POWERED),
    );
    assert_eq!(faults, [FaultCode::EncoderJump]);
    assert!(seen.joints_at(50).is_none());
    assert_eq!(seen.joints_at(51).unwrap().calibrated, 0);
}

#[test]
fn a_calibration_that_a_jump_has_answered_does_not_happen_later() {
    // The word of job 10 meets the jump of job 11: home may be anywhere from then on.
    let (seen, faults) = run(
        |job| Ok(if job >= 11 { [Counts(5000); CHANNELS] } else { steady(0) }),
        |_| Ok(POWERED),
    );
    assert_eq!(faults, [FaultCode::EncoderJump]);
    assert!(seen.joints_at(11).is_none());
    assert!(seen.joints.iter().all(|(_, joints)| joints.calibrated == 0 && joints.datum == 0));
}

#[test]
fn boards_that_have_nothing_to_say_yet_are_waited_for() {
    let (seen, faults) = run(
        |job| if job < 5 { Err(ErrorKind::Stale) } else { Ok(steady(job)) },
        |job| if job < 9 { Err(ErrorKind::Transient) } else { Ok(POWERED) },
    );
    assert_eq!(faults, []);
    assert_eq!((seen.joints[0].0, seen.lines[0].0), (5, 9));
}

#[test]
fn a_board_with_too_few_encoders_is_refused() {
    let mut bench = Bench::new();
    let lane = bench.servo();
    let refused = bench.refused(lane, "sense", |ports| {
        let encoders = Box::new(Script { answer: |job| Ok(steady(job)), joints: 5 });
        let lines = Box::new(Script { answer: |_| Ok(POWERED), joints: 0 });
        Sense::new(Config::default(), &Robot::puma260(), encoders, lines, ports)
    });
    assert!(refused.what.contains('5'), "{refused}");
}

/// Encoders that latch index pulses: the first one of motor 3 only before a job of its own.
struct Latching {
    counts: Script<[Counts; CHANNELS]>,
    marks: fn(i64) -> IndexPulses,
    release: Nanos,
}

impl Encoders for Latching {
    fn joints(&self) -> usize {
        6
    }
    fn sample(&mut self, release: Nanos) -> Result<Reading<[Counts; CHANNELS]>, Error> {
        self.release = release;
        self.counts.sample(release)
    }
    fn has_index(&self) -> bool {
        true
    }
    fn index_pulses(&self) -> IndexPulses {
        (self.marks)(self.release.0 / SERVO_PERIOD.0)
    }
}

/// What a task wrote, each with its tick.
type Ticked<T> = Vec<(u64, T)>;

/// Joints, what the pulses said, and the faults, when calibration is asked for in jobs 10 and 60.
fn latched(
    marks: fn(i64) -> IndexPulses,
    index: IndexConfig,
) -> (Ticked<JointState>, Ticked<HomeCheck>, Vec<FaultCode>) {
    let mut bench = Bench::new();
    let lane = bench.servo();
    let ignored = index.ignore;
    bench.task(lane, "sense", |ports| {
        let counts = Script { answer: |_| Ok([Counts(30); CHANNELS]), joints: 6 };
        let encoders = Box::new(Latching { counts, marks, release: Nanos::ZERO });
        let lines = Box::new(Script { answer: |_| Ok(POWERED), joints: 0 });
        let config = Config { index, ..Config::default() };
        Sense::new(config, &Robot::puma260(), encoders, lines, ports)
    });
    bench.feed(lane, "control", |tick| {
        Some(ControlState { calibrate: u32::from(matches!(tick, 10 | 60)), ..ControlState::ZERO })
    });
    bench.bind_feeds("sense", &["control"]);
    let run = bench.run(SERVO_PERIOD * 100);
    let told = if ignored { Vec::new() } else { run.values_with_ticks("sense.home") };
    (run.values_with_ticks("sense.joints"), told, run.faults().iter().collect())
}

#[test]
fn a_calibration_snaps_to_the_nearest_pulses_and_reports_the_distance() {
    // Home is 20 counts past a pulse; pulses are at 3 + 1000 k and 3 + 800 k: home at count 23.
    let config = IndexConfig { home_counts: Some(vec![20.0; 6]), ..IndexConfig::default() };
    let (joints, told, faults) = latched(|_| [Some(Counts(3 - 8000)); CHANNELS], config);
    assert_eq!(faults, []);
    assert_eq!((told.len(), told[0].0), (2, 11));
    assert_eq!((told[0].1.error_counts, told[0].1.refused, told[0].1.motor), ([7; 6], 0, 0));
    let after = joints.iter().find(|row| row.0 == 11).unwrap().1;
    assert_eq!((after.calibrated, after.datum), (1, 1));
    let robot = Robot::puma260();
    let off = robot.gears.joints(&[7; 6]);
    for i in 0..6 {
        assert!((after.q_rad[i] - robot.home_rad[i] - off[i]).abs() < 1e-12, "joint {i}");
        assert!((told[0].1.error_rad[i] - off[i]).abs() < 1e-15);
    }
}

#[test]
fn a_calibration_without_every_pulse_or_far_from_them_is_refused_and_may_be_asked_again() {
    let marks = |job: i64| {
        let mut marks = [Some(Counts(30)); CHANNELS];
        marks[2] = (job >= 50).then_some(Counts(30));
        marks
    };
    let (joints, told, faults) = latched(marks, IndexConfig::default());
    assert_eq!(faults, [FaultCode::IndexMissing]);
    assert_eq!((told[0].1.refused, told[0].1.motor), (FaultCode::IndexMissing as u32, 3));
    assert!(joints.iter().all(|(tick, row)| row.calibrated == u32::from(*tick >= 61)));
    assert!(joints.iter().all(|(tick, row)| row.datum == u32::from(*tick >= 61)));
    let far = |_: i64| [Some(Counts(30 - 300)); CHANNELS];
    let (joints, told, faults) = latched(far, IndexConfig::default());
    assert_eq!(faults, [FaultCode::IndexFar]);
    assert_eq!((told[1].1.motor, told[1].1.error_counts[0]), (1, 300));
    assert!(joints.iter().all(|(_, row)| row.calibrated == 0));
    // A zero that was found before stays, and with it what the servo knows of gravity.
    let later = |job: i64| [Some(Counts(if job < 50 { 30 } else { 330 })); CHANNELS];
    let (joints, _, faults) = latched(later, IndexConfig::default());
    assert_eq!(faults, [FaultCode::IndexFar]);
    for (tick, row) in joints {
        let found = u32::from(tick >= 11);
        assert_eq!((row.calibrated, row.datum), (found, found), "{tick}");
    }
    let config = IndexConfig { ignore: true, ..IndexConfig::default() };
    let (joints, _, faults) = latched(far, config);
    assert_eq!(faults, []);
    assert_eq!(joints.last().unwrap().1.calibrated, 1, "by eye");
}
