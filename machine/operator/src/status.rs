//! The whole status of a machine as JSON: what it does, what is allowed now and why the rest is
//! not, faults, joints, tool, touch and timing.

use std::sync::Arc;

use serde_json::{Value, json};
use taktil_machine::operator::command::CommandContext;
use taktil_machine::operator::status::Status;
use taktil_rtcore::fault::Class;
use taktil_rtcore::lateness::{LatenessCounts, lateness_edges};
use taktil_rtcore::record::{Catalog, LaneInfo};
use taktil_rtcore::status::{LaneHealth, PaceStatus};
use taktil_rtcore::{FaultCode, FaultSet, Mode, Nanos};
use taktil_signal::{Drives, Features, Lines, State, Verb};
use taktil_tasks_supervisor::law::{Guard, refusal};

use crate::signals::SignalTable;

/// Everything about the machine that its signals tell.
pub(crate) fn machine_status(
    status: &Status,
    table: &SignalTable,
    lanes: &[LaneTiming],
    context: &CommandContext,
) -> Value {
    let control = &status.control;
    let state = State::from_code(control.state).map_or("?", State::name);
    json!({
        "t_ns": table.newest_release().0,
        "state": state,
        "mode": mode_name(control.mode()),
        "allowed": allowed(status, table),
        "faults": faults(status, table),
        "drives": drives(table),
        "lines": lines(table),
        "joints": joints(table, context),
        "tool": tool(table, context),
        "moves": {
            "queued": status.typed.queued,
            "moving": status.typed.moving == 1,
            "paused": status.typed.paused == 1,
        },
        "jog": status.jog_obstacle(|joint| context.robot.joint_label(joint)),
        "touch": touch(table),
        "clock": clock(table),
        "timing": timing(table, lanes),
    })
}

fn mode_name(mode: Mode) -> String {
    format!("{mode:?}").to_uppercase()
}

/// Each verb, with `null` where it is allowed and otherwise the reason why not.
fn allowed(status: &Status, table: &SignalTable) -> Value {
    let Some(state) = State::from_code(status.control.state) else { return Value::Null };
    let guard = guard(status, table);
    let reason = |verb: &Verb| (verb.name().to_owned(), json!(refusal(state, *verb, &guard)));
    Verb::ALL[1..].iter().map(reason).collect::<serde_json::Map<_, _>>().into()
}

/// Why a verb is not possible now, with the remedy; `None` where it is.
pub(crate) fn refusal_reason(
    status: &Status,
    table: &SignalTable,
    verb: Verb,
) -> Option<&'static str> {
    let state = State::from_code(status.control.state)?;
    refusal(state, verb, &guard(status, table))
}

fn guard(status: &Status, table: &SignalTable) -> Guard {
    let control = &status.control;
    let faults = FaultSet(control.faults);
    let has_image = table.numbers("tactile_scan.image.baseline_ready").first() == Some(&1.0);
    Guard {
        mode: control.mode(),
        faults,
        calibrated: table.single("sense.joints.calibrated") == Some(1.0),
        denied: false,
        done: false,
        blind: !has_image || faults.contains(FaultCode::TactileLost),
    }
}

/// The latched faults, the first one marked; those of drives with the codes that the drives tell.
pub(crate) fn faults(status: &Status, table: &SignalTable) -> Value {
    let first = status.control.first_fault;
    let about = |fault: FaultCode| {
        json!({
            "code": fault as u16,
            "name": format!("{fault:?}"),
            "text": fault.text(),
            "reaction": reaction(fault.class()),
            "first": u32::from(fault as u16) == first,
            "clear": clearing(fault.class()),
            "evidence": (fault == FaultCode::DriveFault).then(|| drive_faults(table)),
        })
    };
    FaultSet(status.control.faults).iter().map(about).collect()
}

/// The drives that have a fault, with their own codes.
fn drive_faults(table: &SignalTable) -> Value {
    let states = table.numbers("sense.drives.state");
    let codes = table.numbers("sense.drives.fault_code");
    let has_fault = |(_, state): &(usize, &f64)| **state == f64::from(Drives::<6>::FAULT_STATE);
    let one = |(at, _): (usize, &f64)| {
        let code = codes.get(at).copied().unwrap_or(0.0);
        json!({ "drive": at + 1, "code": format!("{:#06x}", code as u16) })
    };
    states.iter().enumerate().filter(has_fault).map(one).collect()
}

/// The states of drives that close a loop; null where there are none.
fn drives(table: &SignalTable) -> Value {
    let states = table.numbers("sense.drives.state");
    if states.is_empty() {
        return Value::Null;
    }
    let name = |state: &f64| {
        let names = ["off", "enabling", "following", "stopping", "fault"];
        names.get(*state as usize).copied().unwrap_or("?")
    };
    json!({ "states": states.iter().map(name).collect::<Vec<_>>(), "faults": drive_faults(table) })
}

fn reaction(class: Class) -> &'static str {
    match class {
        Class::Note => "recorded",
        Class::Degrade => "motion that needs it ends",
        Class::ControlledStop => "controlled stop, then drives off",
        Class::DriveOff => "drives off at once",
    }
}

fn clearing(class: Class) -> &'static str {
    match class {
        Class::Note => "`reset` forgets it",
        Class::Degrade => "remove the cause, then `reset`",
        Class::ControlledStop | Class::DriveOff => {
            "remove the cause, then `reset`, and `enable` as a second act"
        }
    }
}

fn lines(table: &SignalTable) -> Value {
    let Some(lines) = table.decoded::<Lines>("sense.lines") else { return Value::Null };
    json!({
        "drive_power": lines.drive_power == 1,
        "estop_a_closed": lines.estop_a_closed == 1,
        "estop_b_closed": lines.estop_b_closed == 1,
    })
}

fn joints(table: &SignalTable, context: &CommandContext) -> Value {
    let robot = &context.robot;
    let measured = table.numbers("sense.joints.q_rad");
    let speed = table.numbers("sense.joints.qd_rad_s");
    let desired = table.numbers("setpoint.desired.q_rad");
    let torque = table.numbers("actuate.applied.tau_nm");
    let degrees = |values: &[f64], at: usize| values.get(at).map(|angle| angle.to_degrees());
    let limits = robot.limits_rad();
    let torque_max = robot.torque_max_nm();
    let joint = |at: usize| {
        let error = desired.get(at).zip(measured.get(at)).map(|(d, m)| (d - m).to_degrees());
        json!({
            "name": robot.joint_label(at),
            "q_deg": degrees(&measured, at),
            "desired_deg": degrees(&desired, at),
            "error_deg": error,
            "speed_deg_s": degrees(&speed, at),
            "torque_nm": torque.get(at),
            "torque_max_nm": torque_max.get(at),
            "low_deg": limits.get(at).map(|limit| limit.0.to_degrees()),
            "high_deg": limits.get(at).map(|limit| limit.1.to_degrees()),
        })
    };
    (0..robot.joints()).map(joint).collect()
}

/// The tool frame by the measured joints; null until their zero is known.
fn tool(table: &SignalTable, context: &CommandContext) -> Value {
    if table.single("sense.joints.calibrated") != Some(1.0) {
        return Value::Null;
    }
    let Some(pose) = context.robot.tool_pose(&table.numbers("sense.joints.q_rad")) else {
        return Value::Null;
    };
    let rotation = pose.rotation.to_cols_array_2d();
    json!({
        "p_mm": pose.translation.to_array().map(|metres| 1e3 * metres),
        "normal": rotation[0],
        "orientation": rotation[1],
        "approach": rotation[2],
    })
}

fn touch(table: &SignalTable) -> Value {
    let image = "tactile_scan.image";
    let rows = table.single(&format!("{image}.rows"));
    let features = table.decoded::<Features>("tactile_servo.features");
    if rows.is_none() && features.is_none() {
        return Value::Null;
    }
    let features = features.map(|features| {
        json!({
            "m0_counts": features.m0,
            "x_c": features.x_c,
            "y_c": features.y_c,
            "theta_z_deg": features.theta_z_rad.to_degrees(),
            "defined": features.defined,
        })
    });
    json!({
        "rows": rows,
        "cols": table.single(&format!("{image}.cols")),
        "baseline_ready": table.single(&format!("{image}.baseline_ready")) == Some(1.0),
        "acquired_ns": table.single(&format!("{image}.acquired_ns")),
        "features": features,
    })
}

/// A lane, and how late its jobs began.
#[derive(Clone, Debug)]
pub(crate) struct LaneTiming {
    pub(crate) name: String,
    pub(crate) period: Nanos,
    pub(crate) lateness: Option<Arc<LatenessCounts>>,
}

impl LaneTiming {
    /// The lanes of a catalog with their counts, in the same order.
    pub(crate) fn of(catalog: &Catalog, lateness: Vec<Arc<LatenessCounts>>) -> Vec<LaneTiming> {
        let counts = lateness.into_iter().map(Some).chain(std::iter::repeat(None));
        let lane = |(lane, lateness): (&LaneInfo, _)| LaneTiming {
            name: lane.name.clone(),
            period: lane.period,
            lateness,
        };
        catalog.lanes.iter().zip(counts).map(lane).collect()
    }
}

/// How the releases follow the clock of a board; null in a machine that follows none.
fn clock(table: &SignalTable) -> Value {
    let Some(pace) = table.decoded::<PaceStatus>("clock_lock.pace") else { return Value::Null };
    json!({
        "locked": pace.locked == 1,
        "phase_ns": pace.phase_ns,
        "correction_ns": pace.correction_ns,
        "slips": pace.slips,
        "clamped": pace.clamped == 1,
        "missing": pace.missing,
    })
}

/// Jobs and misses of each lane, and how late its jobs began.
fn timing(table: &SignalTable, lanes: &[LaneTiming]) -> Value {
    let edges: Vec<i64> = lateness_edges().iter().map(|edge| edge.0).collect();
    let lane = |lane: &LaneTiming| {
        let health = table.decoded::<LaneHealth>(&format!("{}.health", lane.name));
        let lateness = lane.lateness.as_ref().map(|lateness| {
            json!({
                "edges_ns": edges,
                "counts": lateness.counts(),
                "max_ns": lateness.most().0,
            })
        });
        json!({
            "lane": lane.name,
            "period_ns": lane.period.0,
            "jobs": health.map(|health| health.jobs),
            "missed": health.map(|health| health.missed),
            "silent": health.map(|health| health.silent != 0),
            "lateness": lateness,
        })
    };
    lanes.iter().map(lane).collect()
}
