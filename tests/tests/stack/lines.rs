//! Programmed moves of the whole stack: the true tool runs straight where it was told to, and a
//! queue that the arm cannot follow moves nothing. Refuses gains of its own.

use glam::DVec3;
use taktil::run::world::WorldTruth;
use taktil_rtcore::{FaultCode, FaultSet, Nanos};
use taktil_signal::{ControlState, Goal, MoveCheck, State};
use toml::{Table, Value};

use taktil_tests::bench::{Draft, Kept, run};

fn tools(kept: &Kept) -> Vec<(Nanos, DVec3)> {
    let truth = kept.of::<WorldTruth>("world.truth");
    truth.iter().map(|row| (row.0, DVec3::from_array(row.1.tool_m) * 1e3)).collect()
}

#[test]
fn the_true_tool_runs_straight_lines() {
    let kept = run(&Draft::of("lines.toml").scene(), 1);
    assert_eq!(kept.last_control().faults, 0);
    let check = kept.of::<MoveCheck>("trajectory.check").last().unwrap().1;
    assert_eq!((check.verdict, check.moves, check.reason), (2, 6, 0), "{check:?}");
    let tools = tools(&kept);
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
fn a_queue_that_meets_a_limit_moves_nothing_and_says_which_joint() {
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
    let refused: Vec<(Kept, MoveCheck)> = [turn, other]
        .into_iter()
        .map(|table| {
            let moves = vec![Value::Table(table)];
            let draft = Draft::of("lines.toml").set("robot.trajectory.moves", moves);
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
