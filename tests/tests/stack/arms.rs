//! Arms from URDF files under the same tasks as the PUMA 260: their programmes run to their end,
//! and what an arm cannot do is refused with the joint's name before anything moves. These arms
//! have no sense of touch.

use glam::DVec3;
use taktil_lab_scene::assembly::Assembly;
use taktil_lab_scene::scene::Scene;
use taktil_lab_world::ArmTruth;
use taktil_rtcore::Nanos;
use taktil_signal::{Desired, JointState, MoveCheck, State};
use taktil_tests::bench::{RecordedRun, SceneDraft, TemporaryFolder, run};
use toml::{Table, Value};

fn truth<const N: usize>(kept: &RecordedRun) -> Vec<ArmTruth<N>> {
    kept.of::<ArmTruth<N>>("world.truth").into_iter().map(|row| row.1).collect()
}

/// A run that came to its end in order: the check passed, nothing failed, the arm rests where its
/// counts were initialised. Gives the true tool in mm.
fn tool_path_of_complete_run<const N: usize>(
    kept: &RecordedRun,
    moves: u32,
    home_deg: [f64; N],
) -> Vec<DVec3> {
    let control = kept.last_control();
    assert_eq!((control.faults, control.refused), (0, 0), "{control:?}");
    assert_eq!(State::from_code(control.state), Some(State::IdleCalibrated));
    let check = kept.of::<MoveCheck>("trajectory.check").last().unwrap().1;
    assert_eq!((check.verdict, check.moves, check.reason), (2, moves, 0), "{check:?}");
    assert!(check.speed_share < 0.9 && check.torque_share < 0.9, "{check:?}");
    assert!(check.singular.iter().all(|distance| *distance > 0.01), "{check:?}");
    let truth = truth::<N>(kept);
    let end = truth.last().unwrap();
    for (joint, home_deg) in home_deg.iter().enumerate() {
        let off_deg = end.q_rad[joint].to_degrees() - home_deg;
        assert!(off_deg.abs() < 0.1, "joint {}: {off_deg} deg", joint + 1);
        assert!(end.qd_rad_s[joint].abs() < 1e-3);
    }
    // The encoders say what is true, to a count and a tick.
    let seen = kept.of::<JointState<N>>("sense.joints").last().unwrap().1;
    let off = (0..N).map(|i| (seen.q_rad[i] - end.q_rad[i]).abs()).fold(0.0, f64::max);
    assert!(off < 1e-4, "{off}");
    truth.iter().map(|at| DVec3::from_array(at.tool_m) * 1e3).collect()
}

/// How near the tool came to a place (mm).
fn distance_mm(tools: &[DVec3], place: [f64; 3]) -> f64 {
    let place = DVec3::from_array(place);
    tools.iter().map(|tool| (*tool - place).length()).fold(f64::INFINITY, f64::min)
}

#[test]
fn an_arm_like_the_ur5e_runs_its_programme() {
    let kept = run(&SceneDraft::of("ur5e-lines.toml").scene(), 1);
    let tools = tool_path_of_complete_run::<6>(&kept, 6, [0.0, -75.0, 90.0, -105.0, -90.0, 0.0]);
    // Ends of legs are hit, the corner between two lines is rounded.
    for (corner, within_mm) in [
        ([-450.0, -150.0, 350.0], 1.0),
        ([-450.0, -150.0, 250.0], 4.0),
        ([-450.0, 0.0, 250.0], 4.0),
        ([-400.0, -150.0, 350.0], 1.0),
    ] {
        let off = distance_mm(&tools, corner);
        assert!(off < within_mm, "{corner:?}: {off} mm");
    }
    // Down the first line x and y stand still.
    let line: Vec<&DVec3> = tools
        .iter()
        .filter(|p| (260.0..340.0).contains(&p.z) && (p.x + 450.0).abs() < 5.0 && p.y < -145.0)
        .collect();
    assert!(line.len() > 100, "the line was run: {}", line.len());
    for p in &line {
        let off = (p.x + 450.0).abs().max((p.y + 150.0).abs());
        assert!(off < 0.5, "{off} mm at {p}");
    }
}

#[test]
fn an_arm_of_seven_joints_runs_its_programme() {
    let kept = run(&SceneDraft::of("seven-lines.toml").scene(), 1);
    let tools =
        tool_path_of_complete_run::<7>(&kept, 4, [0.0, -30.0, 0.0, -120.0, 0.0, 90.0, 45.0]);
    // The tool's z looks down: 60 mm along -z is up, then aside by 80 and 40.
    let top = tools.iter().map(|p| p.z).fold(f64::NEG_INFINITY, f64::max);
    let start = tools[0];
    assert!(top > start.z + 20.0, "{start}, up to {top}");
    let desired = kept.of::<Desired<7>>("setpoint.desired");
    let moved = desired.iter().map(|row| row.1.q_rad[6]).fold(f64::NEG_INFINITY, f64::max);
    assert!(moved.to_degrees() > 49.9, "joint 7 was moved: {moved}");
}

#[test]
fn a_run_of_another_arm_repeats_bit_for_bit() {
    for name in ["ur5e-lines.toml", "seven-lines.toml"] {
        let mut scene = SceneDraft::of(name).scene();
        scene.duration = Nanos::from_millis(2500);
        let (one, two) = (run(&scene, 1), run(&scene, 1));
        assert!(one.bodies("world.truth") == two.bodies("world.truth"), "{name}");
    }
}

fn move_list(moves: &[&str]) -> Value {
    let one = |text: &&str| Value::Table(text.parse::<Table>().unwrap());
    Value::Array(moves.iter().map(one).collect())
}

/// What is said of a scene that cannot be.
fn complaint(draft: &SceneDraft) -> String {
    let folder = TemporaryFolder::new();
    let path = folder.path().join("scene.toml");
    std::fs::write(&path, draft.text()).unwrap();
    let loaded =
        Scene::load(&path).and_then(|scene| Assembly::new(&scene).with_seed(1).build().map(|_| ()));
    loaded.unwrap_err().to_string()
}

#[test]
fn what_the_arm_cannot_do_is_refused_by_the_joint_s_name() {
    let ur5e = || SceneDraft::of("ur5e-lines.toml");
    let far = move_list(&["joints_deg = [0.0, 0.0, 190.0, 0.0, 0.0, 0.0]"]);
    let text = complaint(&ur5e().set("robot.trajectory.moves", far));
    assert!(text.contains("190 is outside the limits of joint 3 (`joint3`)"), "{text}");
    let short = move_list(&["joints_deg = [0.0, 0.0, 0.0, 0.0, 0.0]"]);
    let text = complaint(&ur5e().set("robot.trajectory.moves", short));
    assert!(text.contains("has 5 numbers, the arm has 6 joints"), "{text}");
    let away = move_list(&["tool = { p_mm = [2000.0, 0.0, 0.0] }"]);
    let text = complaint(&ur5e().set("robot.trajectory.moves", away));
    assert!(text.contains("cannot be reached"), "{text}");
    let text = complaint(&ur5e().set("world.pin.present", true));
    assert!(text.contains("world.pin.present: puts something on the table"), "{text}");
    let ball = "of = [{ kind = \"sphere\" }]".parse::<Table>().unwrap();
    let text = complaint(&ur5e().set("world.object", ball["of"].clone()));
    assert!(text.contains("world.object: puts something on the table"), "{text}");
    let text = complaint(&ur5e().set("start", "x = 1".parse::<Table>().unwrap()));
    assert!(text.contains("unknown field"), "{text}");
    let finger = "finger_mm = [325.0, -127.0, -124.0]".parse::<Table>().unwrap();
    let text = complaint(&ur5e().set("start", finger));
    assert!(text.contains("is a place for a finger, but this arm carries none"), "{text}");
    let bent = "joints_deg = [0.0, 0.0, 200.0, 0.0, 0.0, 0.0]".parse::<Table>().unwrap();
    let text = complaint(&ur5e().set("start", bent));
    assert!(text.contains("200 is outside the limits of joint 3 (`joint3`)"), "{text}");
    let text = complaint(
        &SceneDraft::of("seven-lines.toml").set("robot.joint_servo.damping", vec![1.0; 6]),
    );
    assert!(text.contains("damping") && text.contains("the arm has 7 joints"), "{text}");
}

#[test]
fn a_line_out_of_reach_moves_nothing_and_names_the_instant() {
    // Within the sum of the lengths, so that only the look along it can tell.
    let line = move_list(&["straight = true\nby_mm = [0.0, 0.0, -500.0]"]);
    let kept =
        run(&SceneDraft::of("ur5e-lines.toml").set("robot.trajectory.moves", line).scene(), 1);
    let check = kept.of::<MoveCheck>("trajectory.check").last().unwrap().1;
    assert_eq!(check.verdict, 3, "{check:?}");
    assert!(check.reason != 0 && check.t_s > 0.0, "{check:?}");
    let tools = truth::<6>(&kept);
    let half = &tools[tools.len() / 2..];
    let first = DVec3::from_array(half[0].tool_m);
    let off = half.iter().map(|at| (DVec3::from_array(at.tool_m) - first).length());
    assert!(off.fold(0.0, f64::max) < 1e-4, "it stands");
}
