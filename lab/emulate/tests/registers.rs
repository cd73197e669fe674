//! The production driver of register boards over the emulated boards' file in virtual time: codes
//! move the motors, counts, tactels and gauges come back, and faults befall them.

mod common;

use std::path::PathBuf;

use common::{CYCLE_PERIOD, pressed_scene};
use taktil_drivers_regmap::{Board, Config, Halves};
use taktil_hal::fault::FaultPlan;
use taktil_hal::{Arrival, CHANNELS, DacCode, LinesOut, Nanos, TactileFrame};
use taktil_lab_emulate::{BoardKind, EmulatedRobot, Traffic};

/// A code that moves joint 1 against its friction: a third of full scale.
const PUSH_CODE: i32 = 700;
/// From the start of a latch and a conversion to their reading.
const CONVERSION_PAUSE: Nanos = Nanos::from_micros(1_000);

/// A file that goes when the test ends.
struct SharedFile(PathBuf);

impl Drop for SharedFile {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

/// A robot behind one board, opened by the driver.
struct Rig {
    robot: EmulatedRobot,
    halves: Halves,
    release: Nanos,
    cycles: i64,
    _file: SharedFile,
}

impl Rig {
    fn new(name: &str, kind: BoardKind, config: Config, faults: &[&str]) -> Rig {
        let path = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(name);
        let file = SharedFile(path.clone());
        let _ = std::fs::remove_file(&path);
        let plan = FaultPlan::new(faults.iter().map(|text| text.parse().unwrap()).collect());
        let mut robot = EmulatedRobot::new(&pressed_scene(""), &[kind], &plan, 1).unwrap();
        assert!(robot.is_memory(0) && !robot.is_card(0));
        robot.attach_file(0, &path).unwrap();
        robot.advance(Nanos::from_millis(20));
        let halves = Board::open_halves(&Config { path, ..config }).unwrap();
        Rig { robot, halves, release: Nanos::from_millis(20), cycles: 0, _file: file }
    }

    /// A cycle with a code for joint 1 and the drives on or off; its count, unless it was refused.
    fn cycle(&mut self, code: i32, on: bool) -> Option<i32> {
        self.release += CYCLE_PERIOD;
        self.cycles += 1;
        self.robot.advance(self.release);
        self.halves.start.start(self.release);
        self.robot.advance(self.release + CONVERSION_PAUSE);
        let reading = self.halves.encoders.as_mut().unwrap().sample(self.release);
        let mut codes = [DacCode(0); CHANNELS];
        codes[0] = DacCode(code);
        self.halves.analog_out.as_mut().unwrap().commit(self.release, &codes).unwrap();
        if let Some(lines) = &mut self.halves.digital_out {
            let feed = self.cycles % 2 == 0;
            let orders = LinesOut { enable: on, brake_release: on, watchdog_feed: feed };
            lines.commit(self.release, &orders).unwrap();
        }
        reading.ok().map(|reading| reading.value[0].0)
    }
}

fn cell(name: &str, faults: &[&str]) -> Rig {
    Rig::new(name, BoardKind::Regmap, Config::default(), faults)
}

#[test]
fn codes_turn_the_motor_and_touch_and_gauges_come_back() {
    for sign in [1, -1] {
        let mut rig = cell(&format!("cell{sign}"), &[]);
        for _ in 0..40 {
            assert_eq!(rig.cycle(0, false), Some(0), "the brakes hold");
        }
        let lines = rig.halves.digital_in.as_mut().unwrap().sample(rig.release).unwrap().value;
        assert!(lines.drive_power && lines.estop_a_closed && lines.estop_b_closed, "{lines:?}");
        let array = rig.halves.tactile.as_mut().unwrap();
        let mut frame = TactileFrame::of(array.as_ref());
        assert_eq!(array.sample(rig.release, &mut frame), Ok(Arrival::New));
        let most = frame.values.iter().max().unwrap();
        assert!(*most > 600 && frame.values[0] < 600, "the pin presses {most}");
        let gauges = rig.halves.force_torque.as_mut().unwrap().sample(rig.release).unwrap().value;
        let gauges = gauges.codes;
        assert!(gauges.iter().any(|code| code.0 != 0), "{gauges:?}");
        let mut count = 0;
        for _ in 0..80 {
            count = rig.cycle(sign * PUSH_CODE, true).unwrap();
        }
        assert!(sign * count > 50, "{count} counts for {sign}");
        let currents = rig.halves.analog_in.as_mut().unwrap().sample(rig.release).unwrap().value;
        assert!(sign * currents[0].0 > 500, "{currents:?}");
        let Some(Traffic::Memory { changes, scans }) = rig.robot.traffic(0) else { panic!() };
        assert!(changes > 80 && scans > 20, "{changes} changes, {scans} scans");
    }
}

#[test]
fn the_arm_of_three_boards_shows_counts_and_gauges_and_needs_no_lines() {
    let config = Config {
        gauge_channels: vec![0, 1, 2, 3, 4, 5],
        analog_in_channels: vec![6],
        relay_ms: Some(50),
        ..Config::described("", "vme-arm")
    };
    let mut rig = Rig::new("arm", BoardKind::VmeArm, config, &[]);
    for _ in 0..40 {
        assert!(rig.cycle(0, false).is_some());
    }
    let before = rig.cycle(0, false).unwrap();
    let mut count = before;
    for _ in 0..80 {
        count = rig.cycle(PUSH_CODE, false).unwrap();
    }
    assert!(count - before > 50, "{before} to {count}");
    let gauges = rig.halves.force_torque.as_mut().unwrap().sample(rig.release).unwrap().value;
    let gauges = gauges.codes;
    assert!(gauges.iter().any(|code| code.0 != 0), "{gauges:?}");
    let current = rig.halves.analog_in.as_mut().unwrap().sample(rig.release).unwrap().value[0];
    assert!(current.0 > 500, "{current:?}");
}

#[test]
fn counters_freeze_by_plan_while_the_motor_turns() {
    let mut rig = cell("frozen", &["kind=frozen target=regmap.encoders at=0.2"]);
    for _ in 0..160 {
        let _ = rig.cycle(PUSH_CODE, true);
    }
    let frozen = rig.cycle(PUSH_CODE, true).unwrap();
    let moved = rig.robot.world().encoder_counts()[0].0;
    assert!(moved > frozen + 50, "{moved} counts, {frozen} shown");
}

#[test]
fn two_boards_for_one_set_of_motors_and_strange_targets_are_refused() {
    let scene = pressed_scene("");
    let refused = |boards: &[BoardKind], faults: &[&str]| {
        let plan = FaultPlan::new(faults.iter().map(|text| text.parse().unwrap()).collect());
        let bad = EmulatedRobot::new(&scene, boards, &plan, 1).err().unwrap();
        bad.to_string()
    };
    let both = refused(&[BoardKind::Mesa, BoardKind::Regmap], &[]);
    assert!(both.contains("one set of motors"), "{both}");
    let target = refused(&[BoardKind::Regmap], &["kind=frozen target=vme-arm.encoders"]);
    assert!(target.contains("no board `vme-arm.encoders`"), "{target}");
    let kind = refused(&[BoardKind::Regmap], &["kind=loss value=0.1"]);
    assert!(kind.contains("loss"), "{kind}");
}
