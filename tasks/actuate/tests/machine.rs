//! Tests `actuate` in a machine in virtual time: the outputs to two scripted boards, job by job.

use taktil_hal::link::{Receiver, Sender, link};
use taktil_hal::{AnalogOut, CHANNELS, DacCode, DigitalOut, Error, ErrorKind, LinesOut};
use taktil_mechanics::robot::Robot;
use taktil_rtcore::status::ModeStatus;
use taktil_rtcore::{Cycle, FaultCode, Io, Mode, Nanos, Output, Payload, Task};
use taktil_signal::{Applied, ControlState, JointState, Torque};
use taktil_tasks_actuate::{Actuate, Config, Motors};
use taktil_tests_script::{Bench, SERVO_PERIOD};

const JOBS_RUN: usize = 100;

/// What a board was told: codes or lines, or to go safe.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Told {
    Codes([DacCode; CHANNELS]),
    Lines(LinesOut),
    Safe,
}

/// A board that passes on what it is told and fails when the script says so.
struct Board {
    told: Sender<Told>,
    fails: fn(i64) -> Option<ErrorKind>,
    width: i32,
    /// The last release, so that `safe` has a stamp.
    now: Nanos,
}

impl Board {
    fn tell(&mut self, release: Nanos, told: Told) -> Result<(), Error> {
        self.now = release;
        if let Some(kind) = (self.fails)(release.0 / SERVO_PERIOD.0) {
            return Err(Error::whole(kind, "test.board"));
        }
        self.told.send(told, release, release).expect("the test reads later");
        Ok(())
    }
}

impl AnalogOut for Board {
    fn channels(&self) -> usize {
        CHANNELS
    }
    fn code_range(&self) -> (DacCode, DacCode) {
        (DacCode(-self.width), DacCode(self.width - 1))
    }
    fn commit(&mut self, release: Nanos, codes: &[DacCode; CHANNELS]) -> Result<(), Error> {
        self.tell(release, Told::Codes(*codes))
    }
    fn safe(&mut self) -> Result<(), Error> {
        self.told.send(Told::Safe, self.now, self.now).expect("room");
        Ok(())
    }
    fn safe_value(&self) -> DacCode {
        DacCode(0)
    }
    fn longest_silence(&self) -> Nanos {
        Nanos::from_millis(10)
    }
}

impl DigitalOut for Board {
    fn commit(&mut self, release: Nanos, lines: &LinesOut) -> Result<(), Error> {
        self.tell(release, Told::Lines(*lines))
    }
    fn safe(&mut self) -> Result<(), Error> {
        AnalogOut::safe(self)
    }
    fn longest_silence(&self) -> Nanos {
        Nanos::from_millis(10)
    }
}

/// What the tasks before `actuate` say in one job; `None`: nothing.
#[derive(Clone, Copy)]
struct Before {
    mode: Mode,
    control: bool,
    joints: bool,
    torque: Option<Torque>,
}

/// In HOLD, asking 1 N m of joint 1, following exactly.
fn holding() -> Before {
    let torque = Torque { tau_nm: [1.0, 0.0, 0.0, 0.0, 0.0, 0.0], error_rad: [0.0; 6] };
    Before { mode: Mode::Hold, control: true, joints: true, torque: Some(torque) }
}

/// The tasks before `actuate`, all in one.
struct Others {
    script: fn(u64) -> Before,
    control: Output<ControlState>,
    status: Output<ModeStatus>,
    joints: Output<JointState>,
    torque: Output<Torque>,
}

impl Task for Others {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        let now = (self.script)(cycle.tick);
        let mode = now.mode.code();
        io.write(&self.status, ModeStatus { mode, ..ModeStatus::ZERO });
        if now.control {
            io.write(&self.control, ControlState { mode, ..ControlState::ZERO });
        }
        if now.joints {
            io.write(&self.joints, JointState::ZERO);
        }
        if let Some(torque) = now.torque {
            io.write(&self.torque, torque);
        }
        Ok(())
    }
}

/// What came out.
struct Seen {
    applied: Vec<Applied>,
    faults: Vec<FaultCode>,
    codes: Vec<(Nanos, Told)>,
    lines: Vec<(Nanos, Told)>,
}

impl Seen {
    /// Code of channel 1 in job `job`; `None` when the board got none.
    fn code(&self, job: i64) -> Option<i32> {
        self.codes.iter().find_map(|(at, told)| match told {
            Told::Codes(codes) if at.0 == job * SERVO_PERIOD.0 => Some(codes[0].0),
            _ => None,
        })
    }

    fn line(&self, job: i64) -> Option<LinesOut> {
        self.lines.iter().find_map(|(at, told)| match told {
            Told::Lines(lines) if at.0 == job * SERVO_PERIOD.0 => Some(*lines),
            _ => None,
        })
    }

    fn is_watchdog_fed(&self, job: i64) -> bool {
        let feed = |job| self.line(job).expect("lines come").watchdog_feed;
        feed(job) != feed(job - 1)
    }
}

fn drained(mut from: Receiver<Told>) -> Vec<(Nanos, Told)> {
    std::iter::from_fn(|| from.next(Nanos::MAX)).map(|told| (told.stamp, told.value)).collect()
}

fn never(_: i64) -> Option<ErrorKind> {
    None
}

fn board(fails: fn(i64) -> Option<ErrorKind>, width: i32) -> (Box<Board>, Receiver<Told>) {
    let (told, read) = link(2 * JOBS_RUN + 10);
    (Box::new(Board { told, fails, width, now: Nanos::ZERO }), read)
}

fn run(
    script: fn(u64) -> Before,
    analog_fails: fn(i64) -> Option<ErrorKind>,
    digital_fails: fn(i64) -> Option<ErrorKind>,
) -> Seen {
    let (analog, codes) = board(analog_fails, 2048);
    let (digital, lines) = board(digital_fails, 2048);
    let mut bench = Bench::new();
    let lane = bench.servo();
    bench.task(lane, "others", |ports| {
        Ok(Others {
            script,
            control: ports.output("control"),
            status: ports.output("mode"),
            joints: ports.output("joints"),
            torque: ports.output("torque"),
        })
    });
    bench.task(lane, "actuate", |ports| {
        let config = Config { torque_limit_nm: Some(vec![2.0; 6]), ..Config::default() };
        Actuate::new(config, &Robot::puma260(), Motors::Converters(analog), digital, ports)
    });
    for port in ["control", "joints", "torque"] {
        bench.bind(&format!("actuate.{port}"), &format!("others.{port}"));
    }
    bench.mode_from("others.mode");
    let run = bench.run(SERVO_PERIOD * i64::try_from(JOBS_RUN).unwrap());
    let last_values = Seen {
        applied: run.of("actuate.applied"),
        faults: run.faults().iter().collect(),
        codes: drained(codes),
        lines: drained(lines),
    };
    assert_eq!(last_values.codes.last().map(|told| told.1), Some(Told::Safe), "left safe");
    assert_eq!(last_values.lines.last().map(|told| told.1), Some(Told::Safe), "left safe");
    last_values
}

#[test]
fn torque_brakes_and_enable_follow_the_mode() {
    let last_values =
        run(|tick| Before { mode: Mode::ALL[(tick / 10 % 8) as usize], ..holding() }, never, never);
    assert_eq!(
        (last_values.faults.as_slice(), last_values.applied.len()),
        ([].as_slice(), JOBS_RUN)
    );
    for job in 0..JOBS_RUN {
        let mode = Mode::ALL[job / 10 % 8];
        let at = i64::try_from(job).unwrap();
        let lines = last_values.line(at).unwrap();
        assert_eq!(last_values.code(at).unwrap() > 0, mode.torque_allowed(), "job {job}, {mode:?}");
        assert_eq!(lines.enable, mode.torque_allowed(), "job {job}, {mode:?}");
        assert_eq!(lines.brake_release, mode.brakes_released(), "job {job}, {mode:?}");
        let applied = last_values.applied[job];
        assert_eq!(applied.dac[0], last_values.code(at).unwrap());
        assert_eq!(applied.gate_open == 1, mode.torque_allowed());
        assert_eq!((applied.tau_nm[0] - 1.0).abs() < 0.01, mode.torque_allowed());
        assert!(job == 0 || last_values.is_watchdog_fed(at), "job {job}: fed in every mode");
    }
}

#[test]
fn a_torque_that_does_not_come_is_bridged_for_one_job() {
    let last_values = run(
        |tick| Before { torque: holding().torque.filter(|_| tick != 50), ..holding() },
        never,
        never,
    );
    assert_eq!(last_values.faults, []);
    assert_eq!(last_values.code(50), last_values.code(49));
    assert!(
        last_values.is_watchdog_fed(49)
            && !last_values.is_watchdog_fed(50)
            && last_values.is_watchdog_fed(51)
    );
}

#[test]
fn a_missing_torque_counts_as_a_silent_lane() {
    let silent = |tick| (50..52).contains(&tick);
    let last_values = run(
        |tick| Before {
            torque: holding().torque.filter(|_| !(50..52).contains(&tick)),
            ..holding()
        },
        never,
        never,
    );
    assert_eq!(last_values.faults, [FaultCode::LaneSilent]);
    for job in 45..55 {
        assert_eq!(last_values.is_watchdog_fed(job), !silent(job), "job {job}");
        let lines = last_values.line(job).unwrap();
        assert_eq!(
            (last_values.code(job) == Some(0), lines.enable),
            (job == 51, job != 51),
            "job {job}"
        );
        assert_eq!(lines.brake_release, job != 51, "job {job}");
    }
}

#[test]
fn a_torque_that_is_not_a_number_never_reaches_the_board() {
    let last_values = run(
        |tick| {
            let mut now = holding();
            if let Some(torque) = now.torque.as_mut().filter(|_| tick == 50) {
                torque.tau_nm[0] = f64::NAN;
            }
            now
        },
        never,
        never,
    );
    assert_eq!(last_values.faults, [FaultCode::NotFinite]);
    assert_eq!(last_values.code(50), last_values.code(49), "the last good one stays for a job");
}

#[test]
fn control_that_does_not_come_shuts_the_gate_and_starves_the_watchdog() {
    let last_values = run(|tick| Before { control: tick < 50, ..holding() }, never, never);
    assert_eq!(last_values.faults, [FaultCode::LaneSilent]);
    for job in 50..100 {
        assert_eq!(last_values.code(job), Some(0));
        assert!(!last_values.is_watchdog_fed(job), "job {job}");
    }
}

#[test]
fn joints_that_do_not_come_starve_the_watchdog_only() {
    let last_values = run(|tick| Before { joints: tick != 50, ..holding() }, never, never);
    assert_eq!(last_values.faults, []);
    assert!(
        last_values.code(50).unwrap() > 0
            && !last_values.is_watchdog_fed(50)
            && last_values.is_watchdog_fed(51)
    );
}

#[test]
fn a_joint_that_does_not_follow_is_a_fault_and_too_much_torque_is_limited() {
    let last_values = run(
        |tick| {
            let mut now = holding();
            if let Some(torque) = &mut now.torque {
                // A step is speed that is asked for; the window is narrow again one job later.
                let far = (50..52).contains(&tick);
                torque.error_rad[4] = if far { 5.1_f64.to_radians() } else { 0.08 };
                torque.tau_nm[0] = if tick == 60 { -1e9 } else { 1.0 };
            }
            now
        },
        never,
        never,
    );
    assert_eq!(last_values.faults, [FaultCode::FollowingError]);
    assert_eq!((last_values.applied[59].limited, last_values.applied[60].limited), (0, 1));
    assert!((last_values.applied[60].tau_nm[0] + 2.0).abs() < 0.01);
}

#[test]
fn a_lost_converter_takes_enable_and_brakes_with_it_in_the_same_job() {
    let last_values = run(|_| holding(), |job| (job >= 50).then_some(ErrorKind::Lost), never);
    assert_eq!(last_values.faults, [FaultCode::AnalogOutLost]);
    let (before, after) = (last_values.line(49).unwrap(), last_values.line(50).unwrap());
    assert!(before.enable && before.brake_release && !after.enable && !after.brake_release);
    let last_values = run(|_| holding(), |job| (job == 50).then_some(ErrorKind::Transient), never);
    assert_eq!(last_values.faults, [], "one failed write is borne");
    assert!(last_values.line(50).unwrap().enable);
}

#[test]
fn lost_lines_take_the_torque_with_them_in_the_same_job() {
    let last_values = run(|_| holding(), never, |job| (job == 50).then_some(ErrorKind::Lost));
    assert_eq!(last_values.faults, [FaultCode::DigitalLost]);
    let safe_in = |job: i64| {
        last_values
            .codes
            .iter()
            .any(|(at, told)| at.0 == job * SERVO_PERIOD.0 && *told == Told::Safe)
    };
    assert!(safe_in(50) && !safe_in(49));
}

#[test]
fn a_task_that_is_dropped_leaves_the_boards_safe() {
    let (analog, codes) = board(never, 2048);
    let (digital, lines) = board(never, 2048);
    let mut bench = Bench::new();
    let lane = bench.servo();
    bench.task(lane, "actuate", |ports| {
        Actuate::new(
            Config::default(),
            &Robot::puma260(),
            Motors::Converters(analog),
            digital,
            ports,
        )
    });
    drop(bench);
    assert_eq!(drained(codes), [(Nanos::ZERO, Told::Safe)]);
    assert_eq!(drained(lines), [(Nanos::ZERO, Told::Safe)]);
}

#[test]
fn a_converter_narrower_than_the_drives_is_refused() {
    let (analog, _codes) = board(never, 1024);
    let (digital, _lines) = board(never, 2048);
    let mut bench = Bench::new();
    let lane = bench.servo();
    let refused = bench.refused(lane, "actuate", |ports| {
        Actuate::new(
            Config::default(),
            &Robot::puma260(),
            Motors::Converters(analog),
            digital,
            ports,
        )
    });
    assert!(refused.what.contains("1023"), "{refused}");
}
