//! Calc operations between joints, motors and time: `encoder`, `paul_joint`. Refuses paths that
//! mechanics refuses, and tables of setpoints without end.

use taktil_mechanics::paul::{JointPath, PathError};
use taktil_mechanics::transmission::Transmission;

use super::Operation;
use super::answer::Answer;
use super::field::{Failure, Field, Kind, Need};
use super::request::Args;

/// Most ticks of one answer.
const TICKS_MAX: f64 = 1e6;

/// What this subject offers.
pub(super) const OPERATIONS: &[Operation] = &[
    Operation {
        name: "encoder",
        doc: "Encoder counts of joint angles, or joint angles of counts, \
              with the wrist's coupling. \
              Give one of the two.",
        fields: &[
            Field::new("q", Kind::Vector(6), "rad", Need::Optional, "Joint angles."),
            Field::new("counts", Kind::Counts, "", Need::Optional, "Encoder counts, 0 at q = 0."),
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
                Need::Required,
                "From the start to the goal.",
            ),
            Field::new("t_s", Kind::Numbers, "s", Need::Required, "Time of each segment."),
            Field::new("tau_s", Kind::Number, "s", Need::Required, "Half time of each transition."),
            Field::new("rate_hz", Kind::Number, "Hz", Need::Default("400"), "Setpoints a second."),
        ],
        answers: &[("q", "[n][6] rad"), ("qd", "[n][6] rad/s"), ("qdd", "[n][6] rad/s^2")],
        run: paul_joint,
    },
];

fn encoder(args: &Args) -> Result<Answer, Failure> {
    let gears = Transmission::reference();
    let mut out = Answer::new();
    match (args.has("q"), args.has("counts")) {
        (true, false) => {
            let q = args.joints("q")?;
            let exact = gears.counts_f64(&q);
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
            out.list("q", q.as_slice());
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
        PathError::PointNotFinite { point, joint } => {
            ("wrong_type", format!("points[{point}][{joint}]"))
        }
        PathError::SegmentTime { segment, .. } => ("out_of_range", format!("t_s[{segment}]")),
        _ => ("out_of_range", "tau_s".to_owned()),
    };
    Failure::new(code, Some(&field), error.to_string())
}

fn paul_joint(args: &Args) -> Result<Answer, Failure> {
    let points = args.joint_rows("points")?;
    let path = JointPath::new(&points, args.numbers("t_s")?, args.number("tau_s")?)
        .map_err(path_failure)?;
    let rate_hz = args.positive("rate_hz")?;
    // A hair of slack: an end that falls on a tick must not get another one for its rounding.
    let last = (path.duration_s() * rate_hz - 1e-6).ceil().max(0.0);
    if last >= TICKS_MAX {
        let what = format!("{last} ticks; at most {TICKS_MAX} are answered");
        return Err(Failure::range("rate_hz", what));
    }
    let run = || {
        let mut setpoints = Vec::new();
        let mut tick = 0.0;
        while tick <= last {
            setpoints.push(path.at(tick / rate_hz));
            tick += 1.0;
        }
        setpoints
    };
    let setpoints = args.timed(run);
    let mut out = Answer::new();
    out.rows("q", setpoints.iter().map(|s| s.q.as_slice()));
    out.rows("qd", setpoints.iter().map(|s| s.qd.as_slice()));
    out.rows("qdd", setpoints.iter().map(|s| s.qdd.as_slice()));
    Ok(out)
}
