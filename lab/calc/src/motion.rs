//! Calc operations on joints, motors and time: `encoder`, `paul_joint`, `paul_cartesian`. A path
//! that the mechanics crate cannot plan, and a table of more than [`TICKS_MAX`] set points, are
//! errors.

use taktil_mechanics::Pose;
use taktil_mechanics::paul::cartesian::{Blend, CartesianPath};
use taktil_mechanics::paul::{JointPath, PathError};
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::transmission::Transmission;

use super::Operation;
use super::answer::Answer;
use super::field::{Failure, Field, Kind, Presence};
use super::kinematics::check_rotation;
use super::request::{Args, format_count};

/// Largest number of ticks of one answer.
const TICKS_MAX: f64 = 1e6;

const T_S: Field =
    Field::new("t_s", Kind::Numbers, "s", Presence::Required, "Time of each segment.");
const TAU_S: Field =
    Field::new("tau_s", Kind::Number, "s", Presence::Required, "Half time of each transition.");
const RATE_HZ: Field =
    Field::new("rate_hz", Kind::Number, "Hz", Presence::Default("400"), "Setpoints a second.");
const POSE: &[Field] = &[
    Field::new("r", Kind::Vector(9), "", Presence::Required, "Rotation of the tool row by row."),
    Field::new("p", Kind::Vector(3), "m", Presence::Required, "Tool point."),
];

/// The operations of this subject.
pub(super) const OPERATIONS: &[Operation] = &[
    Operation {
        name: "encoder",
        doc: "Encoder counts of joint angles, or joint angles of counts, \
              with the wrist's coupling. \
              Give one of the two.",
        fields: &[
            Field::new("q", Kind::Vector(6), "rad", Presence::Optional, "Joint angles."),
            Field::new(
                "counts",
                Kind::Counts,
                "",
                Presence::Optional,
                "Encoder counts, 0 at q = 0.",
            ),
        ],
        answers: &[("counts", "[6], with q"), ("q", "[6] rad, with counts")],
        run: encoder,
    },
    Operation {
        name: "paul_joint",
        doc: "Joint move through points with rounded corners, setpoint by setpoint; ends at rest.",
        fields: &[
            Field::new(
                "points",
                Kind::Rows(6),
                "rad",
                Presence::Required,
                "From the start to the goal.",
            ),
            T_S,
            TAU_S,
            RATE_HZ,
        ],
        answers: &[("q", "[n][6] rad"), ("qd", "[n][6] rad/s"), ("qdd", "[n][6] rad/s^2")],
        run: paul_joint,
    },
    Operation {
        name: "paul_cartesian",
        doc: "Straight move of the tool through poses with rounded corners, setpoint by setpoint; \
              ends at rest.",
        fields: &[
            Field::new(
                "poses",
                Kind::Tables(POSE),
                "",
                Presence::Required,
                "From the start to the goal, base frame.",
            ),
            T_S,
            TAU_S,
            RATE_HZ,
            Field::new(
                "blend",
                Kind::Choice(&["paul", "smooth", "so3"]),
                "",
                Presence::Default("\"paul\""),
                "How the orientation passes a corner.",
            ),
            Field::new(
                "start_q",
                Kind::Vector(6),
                "rad",
                Presence::Optional,
                "Joints before the first setpoint: each takes the solution nearest to the last, \
                 within limits or not.",
            ),
        ],
        answers: &[
            ("p", "[n][3] m"),
            ("quaternion", "[n][4] w x y z, w >= 0"),
            ("q", "[n][6] rad, with start_q"),
        ],
        run: paul_cartesian,
    },
];

fn encoder(args: &Args) -> Result<Answer, Failure> {
    let gears = Transmission::reference();
    let mut out = Answer::new();
    match (args.has("q"), args.has("counts")) {
        (true, false) => {
            let q = args.joints("q")?;
            let exact = gears.exact_counts(&q);
            if let Some(joint) = exact.iter().position(|n| n.abs() > f64::from(i32::MAX)) {
                let place = format!("q[{joint}]");
                return Err(Failure::range(
                    &place,
                    format!("`{place}` does not fit 32 bit counts"),
                ));
            }
            let counts = args.timed(|| gears.counts(&q));
            out.value("counts", counts.as_slice().into());
        }
        (false, true) => {
            let counts = args.counts("counts")?;
            let q = args.timed(|| gears.joints(&counts));
            out.number_list("q", q.as_slice());
        }
        (both, _) => {
            let code = if both { "too_many_fields" } else { "missing_field" };
            return Err(Failure::new(code, Some("q"), "give either `q` or `counts`"));
        }
    }
    Ok(out)
}

fn path_failure(error: PathError) -> Failure {
    let (code, field) = match error {
        PathError::TooFewPoints { .. } | PathError::TooManyPoints { .. } => {
            ("wrong_length", "points".to_owned())
        }
        PathError::SegmentCount { .. } => ("wrong_length", "t_s".to_owned()),
        PathError::InvalidPose { point } => ("not_a_rotation", format!("poses[{point}].r")),
        PathError::PointNotFinite { point, joint } => {
            ("wrong_type", format!("points[{point}][{joint}]"))
        }
        PathError::SegmentTime { segment, .. } => ("out_of_range", format!("t_s[{segment}]")),
        _ => ("out_of_range", "tau_s".to_owned()),
    };
    Failure::new(code, Some(&field), error.to_string())
}

/// The instants of a move at which the answer has a row.
struct Ticks {
    last: u32,
    rate_hz: f64,
}

impl Ticks {
    fn from_args(args: &Args, duration_s: f64) -> Result<Ticks, Failure> {
        let rate_hz = args.positive("rate_hz")?;
        // A small tolerance keeps an end on a tick from getting another tick by rounding.
        let last = (duration_s * rate_hz - 1e-6).ceil().max(0.0);
        if last >= TICKS_MAX {
            let what = format!("{} ticks; at most {TICKS_MAX} are answered", format_count(last));
            return Err(Failure::range("rate_hz", what));
        }
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to 1e6")]
        let last = last as u32;
        Ok(Ticks { last, rate_hz })
    }

    fn times(&self) -> impl Iterator<Item = f64> {
        (0..=self.last).map(|tick| f64::from(tick) / self.rate_hz)
    }
}

fn paul_joint(args: &Args) -> Result<Answer, Failure> {
    let points = args.joint_rows("points")?;
    let path = JointPath::new(&points, args.numbers("t_s")?, args.number("tau_s")?)
        .map_err(path_failure)?;
    let ticks = Ticks::from_args(args, path.duration_s())?;
    let setpoints = args.timed(|| ticks.times().map(|t_s| path.at(t_s)).collect::<Vec<_>>());
    let mut out = Answer::new();
    out.number_rows("q", setpoints.iter().map(|s| s.q.as_slice()));
    out.number_rows("qd", setpoints.iter().map(|s| s.qd.as_slice()));
    out.number_rows("qdd", setpoints.iter().map(|s| s.qdd.as_slice()));
    Ok(out)
}

fn paul_cartesian(args: &Args) -> Result<Answer, Failure> {
    let mut poses = Vec::new();
    for (index, table) in args.tables("poses")?.iter().enumerate() {
        let pose = Pose::from_rows(&table.array("r")?, &table.array("p")?);
        check_rotation(&pose, &format!("poses[{index}].r"))?;
        poses.push(pose);
    }
    let blend = match args.choice("blend")? {
        "smooth" => Blend::Smooth,
        "so3" => Blend::So3,
        _ => Blend::Paul,
    };
    let path = CartesianPath::new(&poses, args.numbers("t_s")?, args.number("tau_s")?, blend)
        .map_err(|error| match error {
            PathError::TooFewPoints { .. } | PathError::TooManyPoints { .. } => {
                Failure::new("wrong_length", Some("poses"), error.to_string())
            }
            other => path_failure(other),
        })?;
    let ticks = Ticks::from_args(args, path.duration_s())?;
    let setpoints = args.timed(|| ticks.times().map(|t_s| path.at(t_s)).collect::<Vec<_>>());
    let mut out = Answer::new();
    let places: Vec<[f64; 3]> = setpoints.iter().map(|s| s.pose.translation.to_array()).collect();
    let turns: Vec<[f64; 4]> = setpoints.iter().map(|s| s.pose.quaternion_wxyz()).collect();
    out.number_rows("p", places.iter());
    out.number_rows("quaternion", turns.iter());
    if args.has("start_q") {
        let arm = Puma260::reference();
        let mut joints = vec![args.joints("start_q")?];
        for (t_s, setpoint) in ticks.times().zip(&setpoints) {
            let before = joints[joints.len() - 1];
            let q = arm.inverse_without_limits(&setpoint.pose, &before).ok_or_else(|| {
                let what = format!("no joints reach the tool pose at {t_s} s");
                Failure::new("unreachable", Some("poses"), what)
            })?;
            joints.push(q);
        }
        out.number_rows("q", joints[1..].iter().map(|q| q.as_slice()));
    }
    Ok(out)
}
