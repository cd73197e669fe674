//! `taktil arm`: the properties of an arm from a URDF file, and a test of its inverse kinematics on
//! random poses inside its limits. A file that describes no serial chain is an error with its line.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use glam::DMat3;
use serde_json::json;
use taktil_machine::source::{FileKind, Source};
use taktil_machine::urdf::{self, ArmDescription, CONTINUOUS_ANGLE_MAX_RAD, Selection};
use taktil_machine_console::out;
use taktil_mechanics::chain::{Chain, SearchBudget};
use taktil_mechanics::spatial::JointVector;
use taktil_mechanics::spatial::{rotation_vector, wrap_angle};
use taktil_mechanics::{Joints, Pose};
use taktil_rtcore::Invalid;

use taktil_machine_console::option::BadOption;

/// Largest number of poses.
const POSES_MAX: u32 = 10_000_000;

/// What the command line says.
#[derive(Args, Clone, Debug)]
pub struct ArmArgs {
    /// URDF file; see sim/arms
    pub file: PathBuf,
    /// Link at the end of the chain, where the file has several
    #[arg(long, value_name = "LINK")]
    pub tip: Option<String>,
    /// Holds a joint that does not move: NAME=PLACE, in rad or m. Those beside and behind the chain
    /// that are not named are held as near to zero as their limits let them
    #[arg(long, value_name = "JOINT=PLACE", value_parser = held_joint)]
    pub hold: Vec<(String, f64)>,
    /// Joint values, one for each joint (rad or m), at which the tool's pose and the torques
    /// against gravity are printed
    #[arg(long, value_name = "Q,Q,...", value_delimiter = ',', allow_hyphen_values = true)]
    pub at: Option<Vec<f64>>,
    /// Random poses on which the inverse is tried
    #[arg(long, value_name = "N", default_value_t = 1000)]
    pub poses: u32,
    /// Seed of the poses
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// One JSON object on stdout instead of the table
    #[arg(long)]
    pub json: bool,
}

/// An arm at given joint values.
#[derive(Clone, Debug)]
struct Place {
    /// The tool's frame in the base frame (m).
    tool: Pose,
    /// Torques that hold the arm against gravity (N m, N).
    gravity: Vec<f64>,
}

/// Result of the test of the inverse kinematics.
#[derive(Clone, Debug, Default)]
struct InverseStatistics {
    closed: bool,
    found: u32,
    starts: u32,
    off_m: f64,
    off_rad: f64,
    /// Where the tool is at the joint values that were asked for.
    place: Option<Place>,
    /// Poses of a closed form whose own joints were not among the branches, within 1e-6 rad.
    own_lost: u32,
}

/// Reads the file, tests the inverse and prints the result. The exit code is 1 when an arm with a
/// closed form misses a pose.
///
/// # Errors
/// A file that cannot be used, or too many poses.
pub fn run(arguments: &ArmArgs) -> anyhow::Result<ExitCode> {
    if !(1..=POSES_MAX).contains(&arguments.poses) {
        let what = format!("--poses {}: give 1 to {POSES_MAX}", arguments.poses);
        return Err(BadOption(what).into());
    }
    let source = Source::read(&arguments.file, FileKind::Arm)?;
    let selection = Selection {
        tip: arguments.tip.clone(),
        hold: arguments.hold.iter().cloned().collect(),
        hold_others: true,
        ..Selection::default()
    };
    let described =
        urdf::read(&source.text, &selection).map_err(|invalid| urdf::locate(&source, invalid))?;
    let tried = match described.joints.len() {
        1 => study::<1>(&described, arguments),
        2 => study::<2>(&described, arguments),
        3 => study::<3>(&described, arguments),
        4 => study::<4>(&described, arguments),
        5 => study::<5>(&described, arguments),
        6 => study::<6>(&described, arguments),
        7 => study::<7>(&described, arguments),
        8 => study::<8>(&described, arguments),
        9 => study::<9>(&described, arguments),
        n => {
            let what = format!("has {n} moving joints on the way to `{}`", described.tip);
            let remedy = "an arm has at most 9: name another tip, or --hold those before the arm";
            Err(Invalid::new("", what, remedy))
        }
    };
    let tried = tried.map_err(|invalid| urdf::locate(&source, invalid))?;
    if arguments.json {
        out::line(to_json(&described, &tried, arguments.poses))?;
    } else {
        out::text(table(&described, &tried, arguments.poses))?;
    }
    let failed = tried.closed && (tried.found < arguments.poses || tried.own_lost > 0);
    Ok(ExitCode::from(u8::from(failed)))
}

/// A joint that is held, as `--hold` names it.
fn held_joint(text: &str) -> Result<(String, f64), String> {
    let (name, at) = text.rsplit_once('=').ok_or("give JOINT=PLACE, as finger=0.02")?;
    let at = at.trim().parse().map_err(|_| format!("`{at}` is no number of radians or metres"))?;
    Ok((name.trim().to_owned(), at))
}

fn study<const N: usize>(
    described: &ArmDescription,
    arguments: &ArmArgs,
) -> Result<InverseStatistics, Invalid> {
    let arm: Chain<N> = described.kinematic_chain()?;
    let place = arguments.at.as_deref().map(|at| place(&arm, at)).transpose()?;
    let mut state = arguments.seed;
    let mut unit = move || {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        #[expect(clippy::cast_precision_loss, reason = "53 bits fit")]
        let unit = (state >> 11) as f64 / 9_007_199_254_740_992.0;
        unit
    };
    let mut draw = || {
        let limits = arm.limits();
        // A joint without limits is drawn over one turn in either direction.
        JointVector::<N>::from_fn(|i, _| {
            let (low, high) = (limits.q_min[i].max(-7.0), limits.q_max[i].min(7.0));
            low + (high - low) * unit()
        })
    };
    let mut tried = InverseStatistics {
        closed: arm.spherical_wrist().is_some(),
        place,
        ..InverseStatistics::default()
    };
    for _ in 0..arguments.poses {
        let (q, before) = (draw(), draw());
        let pose = arm.tool_pose(&q);
        let mut note = |got: &JointVector<N>| {
            let at = arm.tool_pose(got);
            let off = (at.translation - pose.translation).length();
            tried.off_m = tried.off_m.max(off);
            tried.off_rad =
                tried.off_rad.max(rotation_vector(&pose.rotation, &at.rotation).length());
        };
        if let Some(wrist) = arm.spherical_wrist() {
            let own = Joints::from_fn(|i, _| q[i]);
            let branches = wrist.inverse_kinematics(&pose, Some(&own));
            for branch in &branches {
                note(&JointVector::<N>::from_fn(|i, _| branch.q[i]));
            }
            let apart = |b: &Joints| (b - own).map(wrap_angle).amax();
            tried.found += u32::from(!branches.is_empty());
            tried.own_lost += u32::from(!branches.iter().any(|b| apart(&b.q) < 1e-6));
        } else if let Ok(found) = arm.inverse_kinematics(&pose, &before, &SearchBudget::default()) {
            note(&found.q);
            tried.found += 1;
            tried.starts += found.starts;
        }
    }
    Ok(tried)
}

/// The arm at joint values (rad or m).
fn place<const N: usize>(arm: &Chain<N>, at: &[f64]) -> Result<Place, Invalid> {
    let q = <[f64; N]>::try_from(at).ok().filter(|q| q.iter().all(|x| x.abs() < 1e6));
    let Some(q) = q.map(JointVector::from) else {
        let what = format!("--at has {} values, or one that is none", at.len());
        return Err(Invalid::new("", what, format!("give {N} numbers with commas between")));
    };
    let gravity = arm.gravity_torque(&q).as_slice().to_vec();
    Ok(Place { tool: arm.tool_pose(&q), gravity })
}

fn to_json(described: &ArmDescription, tried: &InverseStatistics, poses: u32) -> serde_json::Value {
    json!({
        "name": described.name,
        "tip": described.tip,
        "joints": described.names,
        "held": described.held.iter().map(|joint| json!({"name": joint.name, "at": joint.at}))
            .collect::<Vec<_>>(),
        "lacks_range": described.lacking(|lacks| lacks.range),
        "lacks_speed": described.lacking(|lacks| lacks.speed),
        "lacks_effort": described.lacking(|lacks| lacks.effort),
        "massless_links": described.massless,
        "notes": described.notes,
        "closed_form": tried.closed,
        "poses": poses,
        "found": tried.found,
        "starts": tried.starts,
        "own_lost": tried.own_lost,
        "worst_m": tried.off_m,
        "worst_rad": tried.off_rad,
        "at": tried.place.as_ref().map(|place| json!({
            "position_m": place.tool.translation.to_array(),
            "rotation_by_rows": place.tool.rotation.transpose().to_cols_array(),
            "gravity_nm": place.gravity,
        })),
    })
}

fn table(described: &ArmDescription, tried: &InverseStatistics, poses: u32) -> String {
    let mut out =
        format!("{}: {} joints to `{}`\n", described.name, described.names.len(), described.tip);
    let width = described.names.iter().map(String::len).max().unwrap_or(0);
    for (i, name) in described.names.iter().enumerate() {
        let _ = writeln!(out, "  {name:width$}  {}", joint_line(described, i));
    }
    for remark in described.remarks() {
        let _ = writeln!(out, "{remark}");
    }
    if let Some(place) = &tried.place {
        let at = place.tool.translation * 1e3;
        let turn = rotation_vector(&DMat3::IDENTITY, &place.tool.rotation);
        let gravity: Vec<String> = place.gravity.iter().map(|x| format!("{x:.3}")).collect();
        let _ = writeln!(
            out,
            "there the tool is at {:.3} {:.3} {:.3} mm, turned by {:.4} {:.4} {:.4} rad; against \
             gravity {} N m",
            at.x,
            at.y,
            at.z,
            turn.x,
            turn.y,
            turn.z,
            gravity.join(" ")
        );
    }
    let _ = if tried.closed {
        writeln!(
            out,
            "spherical wrist: inverse in closed form; {} of {poses} random poses, own joints among \
             the branches in {}; worst {:.1e} m, {:.1e} rad",
            tried.found,
            poses - tried.own_lost,
            tried.off_m,
            tried.off_rad
        )
    } else {
        writeln!(
            out,
            "no closed form: inverse by damped steps; {} of {poses} random poses from random \
             joints, {:.2} starts on average; worst {:.1e} m, {:.1e} rad",
            tried.found,
            f64::from(tried.starts) / f64::from(tried.found.max(1)),
            tried.off_m,
            tried.off_rad
        )
    };
    out
}

/// Range, speed, effort and mass of a joint; a dash where the file does not say.
fn joint_line(described: &ArmDescription, i: usize) -> String {
    let (joint, lacks) = (&described.joints[i], &described.lacks[i]);
    let range = if lacks.range {
        format!("{:>9}    {:>9}", "-", "-")
    } else if joint.q_max >= CONTINUOUS_ANGLE_MAX_RAD {
        format!("{:>22}", "without ends")
    } else {
        format!("{:9.4} to {:9.4}", joint.q_min, joint.q_max)
    };
    let number = |unknown: bool, x: f64, width: usize, digits: usize| {
        if unknown { format!("{:>width$}", "-") } else { format!("{x:width$.digits$}") }
    };
    format!(
        "{range}, speed {}, effort {}, carries {:7.3} kg",
        number(lacks.speed, joint.speed_max, 7, 3),
        number(lacks.effort, joint.effort_max, 7, 2),
        joint.body.mass_kg
    )
}
