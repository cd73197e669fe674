//! Calc operations on the arm's geometry: `fk`, `jacobian`, `ik`, `dls`. A tool longer than
//! [`TOOL_MAX_M`] and a matrix that is not a rotation are errors.

use serde_json::json;
use taktil_mechanics::dls::{damped_least_squares, singular_values};
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::{Matrix6, Pose};

use super::Operation;
use super::answer::Answer;
use super::field::{Failure, Field, Kind, Presence};
use super::request::Args;

/// Longest tool that is accepted (m).
const TOOL_MAX_M: f64 = 10.0;
/// Largest deviation of `R R^T` from the identity.
const ROTATION_TOLERANCE: f64 = 1e-6;

const MODEL: Field = Field::new(
    "model",
    Kind::Choice(&["puma260"]),
    "",
    Presence::Default("\"puma260\""),
    "The arm.",
);
const Q: Field = Field::new("q", Kind::Vector(6), "rad", Presence::Required, "Joint angles.");
const TOOL: Field = Field::new(
    "tool_z_m",
    Kind::Number,
    "m",
    Presence::Default("0.2"),
    "Wrist centre to tool point along the approach axis.",
);

/// The operations of this subject.
pub(super) const OPERATIONS: &[Operation] = &[
    Operation {
        name: "fk",
        doc: "Where the wrist centre and the tool point are.",
        fields: &[MODEL, Q, TOOL],
        answers: &[("r", "[9] rotation row by row"), ("p_wrist", "[3] m"), ("p_tool", "[3] m")],
        run: fk,
    },
    Operation {
        name: "jacobian",
        doc: "Jacobian of the tool point, rows vx vy vz wx wy wz.",
        fields: &[
            Q,
            Field::new(
                "frame",
                Kind::Choice(&["base", "tool"]),
                "",
                Presence::Default("\"base\""),
                "Axes of both halves.",
            ),
            TOOL,
        ],
        answers: &[
            ("j", "[36] row by row"),
            ("det", "m^3"),
            ("sigma_max", ""),
            ("sigma_min", ""),
            ("singular_distance", "{shoulder, elbow, wrist} 0 at the singularity"),
        ],
        run: jacobian,
    },
    Operation {
        name: "ik",
        doc: "All joint angles that reach a pose of T6, in [-pi, pi).",
        fields: &[
            Field::new("r", Kind::Vector(9), "", Presence::Required, "Rotation of T6 row by row."),
            Field::new("p", Kind::Vector(3), "m", Presence::Required, "Wrist centre."),
            Field::new(
                "previous",
                Kind::Vector(6),
                "rad",
                Presence::Optional,
                "Joints before: chooses the nearest branch, holds free ones.",
            ),
        ],
        answers: &[
            ("branches", "[{shoulder, elbow, wrist, q, in_limits, singular_flags}]"),
            ("nearest", "index, with previous; null when no branch is within the limits"),
        ],
        run: ik,
    },
    Operation {
        name: "dls",
        doc: "Joint speeds for a tool-point twist by damped least squares, base frame.",
        fields: &[
            Q,
            Field::new(
                "twist",
                Kind::Vector(6),
                "m/s, rad/s",
                Presence::Required,
                "vx vy vz wx wy wz.",
            ),
            Field::new("lambda", Kind::Number, "", Presence::Required, "Damping, mixed units."),
            TOOL,
        ],
        answers: &[("qd", "[6] rad/s"), ("residual", "|J qd - twist|")],
        run: dls,
    },
];

fn arm_from_args(args: &Args) -> Result<Puma260, Failure> {
    let tool_z_m = args.number("tool_z_m")?;
    if tool_z_m.abs() > TOOL_MAX_M {
        let what = format!("`tool_z_m` is {tool_z_m:?}; tools up to {TOOL_MAX_M} m are taken");
        return Err(Failure::range("tool_z_m", what));
    }
    Ok(Puma260 { tool_z_m, ..Puma260::reference() })
}

fn fk(args: &Args) -> Result<Answer, Failure> {
    let arm = arm_from_args(args)?;
    let q = args.joints("q")?;
    let (wrist, tool) = args.timed(|| (arm.wrist_pose(&q), arm.tool_pose(&q)));
    let mut out = Answer::new();
    out.number_list("r", &wrist.rotation_rows());
    out.number_list("p_wrist", &wrist.translation.to_array());
    out.number_list("p_tool", &tool.translation.to_array());
    Ok(out)
}

fn row_major(m: &Matrix6) -> [f64; 36] {
    core::array::from_fn(|i| m[(i / 6, i % 6)])
}

fn jacobian(args: &Args) -> Result<Answer, Failure> {
    let arm = arm_from_args(args)?;
    let q = args.joints("q")?;
    let in_tool = args.choice("frame")? == "tool";
    let j = args.timed(|| if in_tool { arm.jacobian_tool(&q) } else { arm.jacobian_base(&q) });
    let sigma = singular_values(&j);
    let distance = arm.singularity_distance(&q);
    let mut out = Answer::new();
    out.number_list("j", &row_major(&j));
    out.number("det", arm.jacobian_determinant(&q));
    out.number("sigma_max", sigma[0]);
    out.number("sigma_min", sigma[5]);
    out.number_object(
        "singular_distance",
        &[("shoulder", distance.shoulder), ("elbow", distance.elbow), ("wrist", distance.wrist)],
    );
    Ok(out)
}

/// A pose whose rotation, given in the field `place`, is not orthonormal is an error.
pub(super) fn check_rotation(pose: &Pose, place: &str) -> Result<(), Failure> {
    let r = pose.rotation;
    let off = (r.transpose() * r - Pose::IDENTITY.rotation).abs();
    let worst = off.to_cols_array().into_iter().fold(0.0, f64::max);
    if worst <= ROTATION_TOLERANCE && r.determinant() > 0.0 {
        return Ok(());
    }
    let what = format!(
        "`{place}` is not a rotation: its columns are not of length 1, square to each other and \
         right-handed"
    );
    Err(Failure::new("not_a_rotation", Some(place), what))
}

fn ik(args: &Args) -> Result<Answer, Failure> {
    let arm = Puma260::reference();
    let pose = Pose::from_rows(&args.array("r")?, &args.array("p")?);
    check_rotation(&pose, "r")?;
    let previous = if args.has("previous") { Some(args.joints("previous")?) } else { None };
    let branches = args.timed(|| arm.inverse_kinematics(&pose, previous.as_ref()));
    let mut list = Vec::new();
    for branch in branches.iter() {
        list.push(json!({
            "shoulder": branch.shoulder,
            "elbow": branch.elbow,
            "wrist": branch.wrist,
            "q": branch.q.as_slice(),
            "in_limits": branch.in_limits,
            "singular_flags": branch.singular_flags,
        }));
    }
    let mut out = Answer::new();
    out.value("branches", list.into());
    if let Some(previous) = previous {
        out.value(
            "nearest",
            json!(arm.nearest_branch(&branches, &previous).map(|(index, _)| index)),
        );
    }
    Ok(out)
}

fn dls(args: &Args) -> Result<Answer, Failure> {
    let arm = arm_from_args(args)?;
    let q = args.joints("q")?;
    let twist = args.joints("twist")?;
    let lambda = args.number("lambda")?;
    if lambda < 0.0 {
        let what = format!("a damping of {lambda} is below 0; give 0 or more");
        return Err(Failure::range("lambda", what));
    }
    let j = arm.jacobian_base(&q);
    let qd = args.timed(|| damped_least_squares(&j, &twist, lambda)).ok_or_else(|| {
        let what =
            "the arm is singular here and `lambda` does not damp it, or the numbers overflow";
        Failure::new("singular", Some("lambda"), what)
    })?;
    let mut out = Answer::new();
    out.number_list("qd", qd.as_slice());
    out.number("residual", (j * qd - twist).norm());
    Ok(out)
}
