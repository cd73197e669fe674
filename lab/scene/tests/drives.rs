//! Arms whose drives close a loop themselves, in simulation: for each of the three loops a move
//! arrives, nothing jumps when the drives are enabled, a fault of a drive is one of the machine,
//! and a run repeats bit for bit.

use std::path::Path;

use taktil_lab_scene::assembly::Assembly;
use taktil_lab_scene::run_virtual;
use taktil_lab_scene::scene::Scene;
use taktil_lab_world::ArmTruth;
use taktil_machine::source::{FileKind, Located, Source};
use taktil_machine::tape::DriveWord;
use taktil_rtcore::record::{Observer, Record};
use taktil_rtcore::{FaultCode, Mode, Nanos, Payload};
use taktil_signal::{ControlState, Desired, Drives, JointState};

const LOOPS: [&str; 3] = ["torque", "velocity", "position"];

/// A scene of an arm like the UR5e whose drives close this loop, with more at its end.
fn scene(drive_loop: &str, more: &str) -> Result<Scene, Located> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../sim/scenes");
    let machine = Source::read(&folder.join("machine/ur5e-like.toml"), FileKind::Machine)?;
    let text = format!(
        r#"
title = "Drives that close a loop"
machine = "machine/ur5e-like.toml"
duration_s = 5.0
seed = 1
[start]
joints_deg = [0.0, -75.0, 90.0, -105.0, -90.0, 0.0]
[world.pin]
present = false
[world.tactile]
present = false
[[operator]]
verb = "enable"
[[operator]]
verb = "calibrate"
[[operator]]
verb = "trajectory"
[robot.actuate]
drive_loop = "{drive_loop}"
[robot.trajectory]
tau_s = 0.11
[[robot.trajectory.moves]]
joints_deg = [12.0, -80.0, 95.0, -100.0, -95.0, 15.0]
{more}
"#
    );
    let read =
        |file: &str| Source::read(&folder.join(file), FileKind::Arm).map_err(|bad| bad.to_string());
    Scene::of(Source { path: folder.join("drives.toml"), text }, Some(machine), &read)
}

/// The signals that the tests look at.
#[derive(Default)]
struct Kept {
    names: [Option<usize>; 6],
    control: Vec<ControlState>,
    desired: Vec<Desired>,
    joints: Vec<JointState>,
    truth: Vec<ArmTruth<6>>,
    drives: Vec<(Nanos, Drives)>,
    words: Vec<(Nanos, DriveWord)>,
    bytes: Vec<u8>,
}

impl Observer for Kept {
    fn record(&mut self, record: &Record<'_>) {
        let [control, desired, joints, truth, drives, words] =
            self.names.map(|name| name == Some(record.signal));
        let at = record.release;
        if control {
            self.control.extend(ControlState::decode(record.body));
        } else if desired {
            self.desired.extend(Desired::decode(record.body));
        } else if joints {
            self.joints.extend(JointState::decode(record.body));
        } else if truth {
            self.truth.extend(ArmTruth::decode(record.body));
            self.bytes.extend_from_slice(record.body);
        } else if drives {
            self.drives.extend(Drives::decode(record.body).map(|report| (at, report)));
        } else if words {
            self.words.extend(DriveWord::decode(record.body).map(|word| (at, word)));
        }
    }
}

fn run(scene: &Scene, until: Nanos) -> Kept {
    let mut machine = Assembly::new(scene).build().unwrap_or_else(|bad| panic!("{bad}"));
    let find = |name: &str| machine.catalog().find(name);
    let names = [
        "supervisor.control",
        "setpoint.desired",
        "sense.joints",
        "world.truth",
        "sense.drives",
        "hal.drive_out",
    ];
    let mut kept = Kept { names: names.map(find), ..Kept::default() };
    assert!(kept.names.iter().all(Option::is_some), "{:?}", kept.names);
    run_virtual(&mut machine, until, &mut kept).unwrap();
    kept
}

#[test]
fn a_move_arrives_with_each_loop_and_nothing_jumps_at_the_start() {
    for drive_loop in LOOPS {
        let scene = scene(drive_loop, "").unwrap();
        let kept = run(&scene, scene.duration);
        let control = kept.control.last().unwrap();
        assert_eq!((control.faults, control.refused), (0, 0), "{drive_loop}: {control:?}");
        let due = [12.0, -80.0, 95.0, -100.0, -95.0, 15.0_f64];
        let end = kept.truth.last().unwrap();
        for (joint, due) in due.iter().enumerate() {
            let off_deg = end.q_rad[joint].to_degrees() - due;
            assert!(off_deg.abs() < 0.1, "{drive_loop}, joint {}: {off_deg} deg", joint + 1);
        }
        // Half a second after power came, before the move: the arm has not left its start.
        let (_, first) = kept.drives.iter().find(|(_, report)| report.all_follow()).unwrap();
        let start = first.position_counts;
        let early = kept.drives.iter().filter(|(at, _)| *at < Nanos::from_millis(150));
        let most = early.flat_map(|(_, report)| {
            core::array::from_fn::<i32, 6, _>(|i| report.position_counts[i] - start[i])
        });
        let most = most.map(i32::abs).max().unwrap();
        // The gear of 101 makes 1149 counts of a degree.
        assert!(most < 60, "{drive_loop}: {most} counts");
        let lag = kept.desired.iter().zip(&kept.joints).map(|(desired, joints)| {
            (0..6).map(|i| (desired.q_rad[i] - joints.q_rad[i]).abs()).fold(0.0, f64::max)
        });
        let lag_deg = lag.fold(0.0, f64::max).to_degrees();
        assert!(lag_deg < 3.0, "{drive_loop}: {lag_deg} deg");
    }
}

#[test]
fn the_same_seed_gives_the_same_bits() {
    for drive_loop in LOOPS {
        let scene = scene(drive_loop, "").unwrap();
        let until = Nanos::from_millis(800);
        assert!(run(&scene, until).bytes == run(&scene, until).bytes, "{drive_loop}");
    }
}

#[test]
fn a_fault_of_a_drive_is_one_of_the_machine_and_takes_reset_and_enable() {
    // Drive 3 is asked for a place more than a turn of its motor away, and stops following.
    let more = r#"
[[operator]]
verb = "reset"
at_s = 2.0
[[operator]]
verb = "enable"
at_s = 2.3
[[world.fault]]
kind = "jump"
target = "drive_out.3"
at_s = 1.0
for_s = 0.1
value = 9000.0
"#;
    let scene = scene("position", more).unwrap();
    let kept = run(&scene, Nanos::from_secs(3));
    let faulty = kept.control.iter().find(|control| control.first_fault != 0).unwrap();
    assert_eq!(faulty.first_fault, FaultCode::DriveFault as u32, "{faulty:?}");
    let (_, report) = kept.drives.iter().find(|(_, report)| report.has_fault()).unwrap();
    assert_eq!(report.fault_code, [0, 0, 0x8611, 0, 0, 0]);
    let between = |from_ms: i64, to_ms: i64| {
        let span = Nanos::from_millis(from_ms)..Nanos::from_millis(to_ms);
        move |at: Nanos| span.contains(&at)
    };
    // It stays until the reset, which enables nothing, and the next enable is one act.
    let is_waiting = between(1_200, 1_990);
    let waiting = kept.drives.iter().filter(|(at, _)| is_waiting(*at));
    assert!(waiting.clone().all(|(_, report)| report.state[2] == Drives::<6>::FAULT_STATE));
    let is_reset = between(2_050, 2_290);
    let mut reset = kept.drives.iter().filter(|(at, _)| is_reset(*at));
    assert!(reset.all(|(_, report)| report.state == [0; 6]), "off, and no fault");
    let is_word = between(1_000, 2_290);
    let words = kept.words.iter().filter(|(at, _)| is_word(*at));
    let resets: Vec<bool> = words.map(|(_, word)| word.reset == 1).collect();
    let edges = resets.windows(2).filter(|pair| !pair[0] && pair[1]).count();
    assert_eq!(edges, 1, "one reset for one act");
    let last = kept.control.last().unwrap();
    assert_eq!((last.mode(), last.faults), (Mode::Hold, 0), "{last:?}");
    assert!(kept.drives.last().unwrap().1.all_follow());
}

#[test]
fn a_drive_that_reports_a_fault_takes_all_of_them() {
    for drive_loop in LOOPS {
        let dead =
            "[[world.fault]]\nkind = \"dead\"\ntarget = \"drive_in.2\"\nat_s = 1.0\nfor_s = 0.2\n";
        let scene = scene(drive_loop, dead).unwrap();
        let kept = run(&scene, Nanos::from_millis(1_600));
        let last = kept.control.last().unwrap();
        assert_eq!(last.first_fault, FaultCode::DriveFault as u32, "{drive_loop}");
        assert_eq!(last.mode(), Mode::Fault);
        let (_, report) = kept.drives.last().unwrap();
        assert_eq!(report.state, [0; 6], "{drive_loop}: no drive has torque");
        let (_, word) = kept.words.last().unwrap();
        assert_eq!((word.request, word.reset), (0, 0), "{drive_loop}");
    }
}

#[test]
fn a_loop_that_is_none_is_refused_with_the_three() {
    let refused = scene("current", "").err().unwrap().to_string();
    assert!(refused.contains("drive_loop") || refused.contains("current"), "{refused}");
}
