//! Programmed moves of the whole stack: the true tool runs along the straight lines that were asked
//! for, and a queue that the arm cannot follow moves nothing.

use glam::DVec3;
use taktil_lab_world::WorldTruth;
use taktil_rtcore::{FaultCode, FaultSet, Nanos};
use taktil_signal::{ControlState, Goal, MoveCheck, MoveQueue, State};
use toml::{Table, Value};

use taktil_tests::bench::{RecordedRun, SceneDraft, run};

fn tool_positions(kept: &RecordedRun) -> Vec<(Nanos, DVec3)> {
    let truth = kept.of::<WorldTruth>("world.truth");
    truth.iter().map(|row| (row.0, DVec3::from_array(row.1.tool_m) * 1e3)).collect()
}

#[test]
fn the_true_tool_runs_straight_lines() {
    let kept = run(&SceneDraft::of("lines.toml").scene(), 1);
    assert_eq!(kept.last_control().faults, 0);
    let check = kept.of::<MoveCheck>("trajectory.check").last().unwrap().1;
    assert_eq!((check.verdict, check.moves, check.reason), (2, 6, 0), "{check:?}");
    let tools = tool_positions(&kept);
    // Along the first side of the square, y and z stand still to the servo's own error.
    let side: Vec<&DVec3> = tools
        .iter()
        .map(|row| &row.1)
        .filter(|p| (312.0..338.0).contains(&p.x) && (p.y + 127.0).abs() < 3.0 && p.z > -112.0)
        .collect();
    assert!(side.len() > 100, "the side was run: {}", side.len());
    for p in &side {
        assert!((p.y + 127.0).abs() < 0.3 && (p.z + 109.0).abs() < 0.3, "{p}");
    }
    // All corners but the rounded ones are passed, and the end is reached.
    let near = |corner: DVec3| {
        tools.iter().map(|row| (row.1 - corner).length()).fold(f64::INFINITY, f64::min)
    };
    for corner in [[305.0, -127.0, -109.0], [345.0, -87.0, -109.0], [325.0, -127.0, -124.0]] {
        assert!(near(DVec3::from_array(corner)) < 3.0, "{corner:?}: {}", near(corner.into()));
    }
    let end = tools.last().unwrap().1;
    assert!((end - DVec3::new(325.0, -127.0, -124.0)).length() < 0.5, "{end}");
}

#[test]
fn a_queue_that_meets_a_limit_moves_nothing_and_names_the_joint() {
    let mut turn = Table::new();
    let mut tool = Table::new();
    let p_mm: Vec<Value> = [325.0, -127.0, -124.0].map(Value::from).to_vec();
    tool.insert("p_mm".into(), p_mm.into());
    tool.insert("yaw_deg".into(), 120.0.into());
    turn.insert("straight".into(), true.into());
    turn.insert("tool".into(), Value::Table(tool.clone()));
    tool.insert("yaw_deg".into(), (-120.0).into());
    let mut other = turn.clone();
    other.insert("tool".into(), Value::Table(tool));
    // One way round or the other, joint 6 has to meet its limit.
    let refused: Vec<(RecordedRun, MoveCheck)> = [turn, other]
        .into_iter()
        .map(|table| {
            let moves = vec![Value::Table(table)];
            let draft = SceneDraft::of("lines.toml").set("robot.trajectory.moves", moves);
            let kept = run(&draft.scene(), 1);
            let check = kept.of::<MoveCheck>("trajectory.check").last().unwrap().1;
            (kept, check)
        })
        .filter(|(_, check)| check.verdict == 3)
        .collect();
    let [(kept, check)] = &refused[..] else { panic!("{} refused", refused.len()) };
    assert_eq!((check.reason, check.joint, check.moves), (1, 6, 1), "{check:?}");
    assert!(check.t_s > 1.0, "it is met on the way: {check:?}");
    let control = kept.of::<ControlState>("supervisor.control").last().unwrap().1;
    assert_eq!(control.state, State::IdleCalibrated as u32, "a refusal is no fault");
    let told = kept
        .of::<ControlState>("supervisor.control")
        .iter()
        .any(|row| FaultSet(row.1.faults).contains(FaultCode::MoveRefused));
    assert!(told || control.faults == 0);
    for (_, goal) in kept.of::<Goal>("trajectory.goal") {
        assert!(goal.valid == 0 || goal.qd_rad_s == [0.0; 6], "nothing moved: {goal:?}");
    }
}

/// The scene with its programme stopped on its way by words of the script, for this long.
fn interrupted_run(name: &str, at_s: f64, for_s: f64) -> RecordedRun {
    let mut steps: Vec<Value> = Vec::new();
    let mut step = |pairs: &[(&str, Value)]| {
        let table: Table =
            pairs.iter().map(|(key, value)| ((*key).to_owned(), value.clone())).collect();
        steps.push(Value::Table(table));
    };
    for verb in ["enable", "calibrate", "trajectory"] {
        step(&[("verb", verb.into())]);
    }
    step(&[("command", "pause".into()), ("at_s", at_s.into())]);
    step(&[("command", "resume".into()), ("at_s", (at_s + for_s).into())]);
    run(&SceneDraft::of(name).set("operator", steps).scene(), 1)
}

#[test]
fn a_programme_stops_on_its_path_and_continues() {
    let plain = run(&SceneDraft::of("lines.toml").first_requests(3).scene(), 1);
    let goals = |kept: &RecordedRun| -> Vec<(Nanos, Goal)> {
        let all = kept.of::<Goal>("trajectory.goal");
        all.into_iter().filter(|row| row.1.valid == 1).collect()
    };
    let apart =
        |a: &Goal, b: &Goal| (0..6).map(|i| (a.q_rad[i] - b.q_rad[i]).abs()).fold(0.0, f64::max);
    let free = goals(&plain);
    // In the joint move, in a line, at a corner between lines, and between two legs.
    for at_s in [0.75, 1.6, 2.4, 3.3, 4.6] {
        let kept = interrupted_run("lines.toml", at_s, 1.0);
        assert_eq!(kept.last_control().faults, 0, "{at_s}");
        let got = goals(&kept);
        // It stood, for most of a second.
        let still = got
            .windows(2)
            .filter(|w| apart(&w[0].1, &w[1].1) == 0.0 && w[0].1.qd_rad_s == [0.0; 6]);
        let stood = still.count() as f64 / 400.0;
        let before =
            free.windows(2).filter(|w| apart(&w[0].1, &w[1].1) == 0.0).count() as f64 / 400.0;
        assert!((0.2..1.2).contains(&(stood - before)), "{at_s}: {stood} s against {before} s");
        // Never off the path: each place is near one of the run without a stop, and in order.
        let mut way: Vec<Goal> = free.iter().map(|row| row.1).collect();
        way.dedup_by(|a, b| a.q_rad == b.q_rad);
        let mut behind = 0;
        for (_, goal) in &got {
            let ahead = way[behind..].iter().take(12).enumerate();
            let near = ahead.min_by(|a, b| apart(a.1, goal).total_cmp(&apart(b.1, goal)));
            let (skip, place) = near.expect("the path goes on");
            // The neighbours of a place are half a tick away at most: 0.3 of 280 deg/s.
            assert!(apart(place, goal) < 1.9e-3, "{at_s}: {}", apart(place, goal));
            behind += skip;
        }
        // No jump of the speed beyond what the arm's acceleration allows in a tick.
        for pair in got.windows(2).filter(|w| w[1].0 - w[0].0 == Nanos::from_micros(2500)) {
            for joint in 0..6 {
                let change = (pair[1].1.qd_rad_s[joint] - pair[0].1.qd_rad_s[joint]).abs();
                assert!(change < 24.5 * 0.0025 * 1.05, "{at_s}: joint {joint} by {change} rad/s");
            }
        }
        let (end, wanted) = (got.last().unwrap().1, free.last().unwrap().1);
        assert!(apart(&end, &wanted) < 1e-9, "{at_s}: it got there");
        let typed = kept.of::<MoveQueue>("trajectory.queue").last().unwrap().1;
        assert_eq!((typed.received, typed.paused), (2, 0));
    }
}
