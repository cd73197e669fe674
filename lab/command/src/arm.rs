//! `taktil arm`: the properties of an arm from a URDF file, and a test of its inverse kinematics on
//! random poses inside its limits. A file that describes no serial chain is an error with its line.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use serde_json::json;
use taktil_machine::source::{FileKind, Source};
use taktil_machine::urdf::{self, ArmDescription};
use taktil_machine_console::out;
use taktil_mechanics::Joints;
use taktil_mechanics::chain::{Chain, SearchBudget};
use taktil_mechanics::spatial::JointVector;
use taktil_mechanics::spatial::{rotation_vector, wrap_angle};

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

/// Result of the test of the inverse kinematics.
#[derive(Clone, Copy, Debug, Default)]
struct InverseStatistics {
    closed: bool,
    found: u32,
    starts: u32,
    off_m: f64,
    off_rad: f64,
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
    let described = urdf::read(&source.text, arguments.tip.as_deref())
        .map_err(|invalid| urdf::locate(&source, invalid))?;
    let tried = match described.joints.len() {
        1 => study::<1>(&described, arguments),
        2 => study::<2>(&described, arguments),
        3 => study::<3>(&described, arguments),
        4 => study::<4>(&described, arguments),
        5 => study::<5>(&described, arguments),
        6 => study::<6>(&described, arguments),
        7 => study::<7>(&described, arguments),
        _ => study::<8>(&described, arguments),
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

fn study<const N: usize>(
    described: &ArmDescription,
    arguments: &ArmArgs,
) -> Result<InverseStatistics, taktil_rtcore::Invalid> {
    let arm: Chain<N> = described.chain()?;
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

fn to_json(described: &ArmDescription, tried: &InverseStatistics, poses: u32) -> serde_json::Value {
    json!({
        "name": described.name,
        "tip": described.tip,
        "joints": described.names,
        "closed_form": tried.closed,
        "poses": poses,
        "found": tried.found,
        "starts": tried.starts,
        "own_lost": tried.own_lost,
        "worst_m": tried.off_m,
        "worst_rad": tried.off_rad,
    })
}

fn table(described: &ArmDescription, tried: &InverseStatistics, poses: u32) -> String {
    let mut out =
        format!("{}: {} joints to `{}`\n", described.name, described.names.len(), described.tip);
    let width = described.names.iter().map(String::len).max().unwrap_or(0);
    for (name, joint) in described.names.iter().zip(&described.joints) {
        let _ = writeln!(
            out,
            "  {name:width$}  {:9.4} to {:9.4}, speed {:7.3}, effort {:7.2}, carries {:7.3} kg",
            joint.q_min, joint.q_max, joint.speed_max, joint.effort_max, joint.body.mass_kg
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
