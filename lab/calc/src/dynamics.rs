//! Calc operations on the arm's dynamics: `rnea`, `free_motion`. A motion that needs more than
//! [`STEPS_MAX`] steps or [`SAMPLES_MAX`] rows is an error.

use core::f64::consts::TAU;

use taktil_mechanics::Joints;
use taktil_mechanics::friction::Friction;
use taktil_mechanics::puma260::dynamics::{Dynamics, State, free_motion as integrate};

use super::Operation;
use super::answer::Answer;
use super::field::{Failure, Field, Kind, Presence};
use super::request::{Args, format_count};

/// Largest number of integration steps of one request.
const STEPS_MAX: f64 = 1e6;
/// Largest number of rows of one answer.
const SAMPLES_MAX: f64 = 1e5;

const fn joint_vector(name: &'static str, unit: &'static str, doc: &'static str) -> Field {
    Field::new(name, Kind::Vector(6), unit, Presence::Required, doc)
}

const TORQUE: &[Field] = &[
    joint_vector("hold", "N m", "Constant part."),
    joint_vector("amp", "N m", "Amplitude."),
    joint_vector("freq", "Hz", "Frequency."),
    joint_vector("phase", "rad", "Phase at t = 0, where the oscillation is made to start at 0."),
];

/// The operations of this subject.
pub(super) const OPERATIONS: &[Operation] = &[
    Operation {
        name: "rnea",
        doc: "Joint torques for a motion, by recursive Newton-Euler.",
        fields: &[
            joint_vector("q", "rad", "Joint angles."),
            joint_vector("qd", "rad/s", "Joint speeds."),
            joint_vector("qdd", "rad/s^2", "Joint accelerations."),
            Field::new(
                "terms",
                Kind::Choice(&["rigid", "grav", "full"]),
                "",
                Presence::Default("\"rigid\""),
                "Links and tool; gravity alone; with rotors and friction.",
            ),
        ],
        answers: &[("tau_nm", "[6] N m")],
        run: rnea,
    },
    Operation {
        name: "free_motion",
        doc: "Motion under torques: \
              hold + amp (sin(2 pi freq t + phase) - sin phase) - viscous qd; \
              without `torque` none and no friction.",
        fields: &[
            joint_vector("q", "rad", "Joint angles at the start."),
            joint_vector("qd", "rad/s", "Joint speeds at the start."),
            Field::new(
                "torque",
                Kind::Table(TORQUE),
                "",
                Presence::Optional,
                "What drives the joints.",
            ),
            Field::new(
                "t_end_s",
                Kind::Number,
                "s",
                Presence::Required,
                "Time of the last row, also between two samples.",
            ),
            Field::new("sample_s", Kind::Number, "s", Presence::Required, "Time between rows."),
            Field::new("step_s", Kind::Number, "s", Presence::Default("0.001"), "Longest step."),
            Field::new(
                "method",
                Kind::Choice(&["rk4"]),
                "",
                Presence::Default("\"rk4\""),
                "Fixed steps of fourth order.",
            ),
        ],
        answers: &[
            ("t_s", "[n] s"),
            ("q", "[n][6] rad"),
            ("qd", "[n][6] rad/s"),
            ("kinetic_j", "[n] J, rotors included"),
            ("potential_j", "[n] J, 0 at the height of the base frame"),
        ],
        run: free_motion,
    },
];

/// Fraction of a sample below which a difference in time is rounding.
const ROUNDING_SHARE: f64 = 1e-9;

fn rnea(args: &Args) -> Result<Answer, Failure> {
    let arm = Dynamics::reference();
    let friction = Friction::reference();
    let (q, qd, qdd) = (args.joints("q")?, args.joints("qd")?, args.joints("qdd")?);
    let terms = args.choice("terms")?;
    let tau = args.timed(|| match terms {
        "grav" => arm.gravity_torque(&q),
        "full" => {
            let rotors = arm.reflected_inertia_kg_m2.component_mul(&qdd);
            arm.inverse_dynamics(&q, &qd, &qdd) + rotors + friction.torque_nm(&qd)
        }
        _ => arm.inverse_dynamics(&q, &qd, &qdd),
    });
    let mut out = Answer::new();
    out.number_list("tau_nm", tau.as_slice());
    Ok(out)
}

/// The torque (N m) of a request as a function of time and speed.
#[derive(Clone, Copy)]
struct TorqueProfile {
    hold: Joints,
    amp: Joints,
    freq_hz: Joints,
    phase_rad: Joints,
    viscous: Joints,
}

impl TorqueProfile {
    fn from_args(table: Option<&Args>) -> Result<TorqueProfile, Failure> {
        let zero = Joints::zeros();
        let Some(table) = table else {
            let none = TorqueProfile {
                hold: zero,
                amp: zero,
                freq_hz: zero,
                phase_rad: zero,
                viscous: zero,
            };
            return Ok(none);
        };
        Ok(TorqueProfile {
            hold: table.joints("hold")?,
            amp: table.joints("amp")?,
            freq_hz: table.joints("freq")?,
            phase_rad: table.joints("phase")?,
            viscous: Friction::reference().viscous_nms_rad,
        })
    }

    fn torque_nm(&self, t_s: f64, qd: &Joints) -> Joints {
        Joints::from_fn(|i, _| {
            let phase = self.phase_rad[i];
            let swing = libm::sin(TAU * self.freq_hz[i] * t_s + phase) - libm::sin(phase);
            self.hold[i] + self.amp[i] * swing - self.viscous[i] * qd[i]
        })
    }
}

fn free_motion(args: &Args) -> Result<Answer, Failure> {
    let arm = Dynamics::reference();
    let start = State { q: args.joints("q")?, qd: args.joints("qd")? };
    let drive = TorqueProfile::from_args(args.table("torque"))?;
    let _ = args.choice("method")?;
    let (end_s, sample_s) = (args.positive("t_end_s")?, args.positive("sample_s")?);
    let step_s = args.positive("step_s")?;
    // An end that is a whole number of samples up to rounding counts as a whole number.
    let samples = (end_s / sample_s * (1.0 + 1e-12) + ROUNDING_SHARE).floor();
    if samples > SAMPLES_MAX {
        let what = format!("{} rows; at most {SAMPLES_MAX} are answered", format_count(samples));
        return Err(Failure::range("sample_s", what));
    }
    // An end between two samples gets a row of its own.
    let whole_s = samples * sample_s;
    let rest_s = end_s - whole_s;
    if (sample_s / step_s).max(1.0) * samples + rest_s / step_s > STEPS_MAX {
        let what = format!("more than {STEPS_MAX} steps; lengthen `step_s` or shorten `t_end_s`");
        return Err(Failure::range("step_s", what));
    }
    let run = || {
        let mut states = vec![(0.0, start)];
        let (mut state, mut row) = (start, 0.0);
        while row < samples {
            let (t_s, next_s) = (row * sample_s, (row + 1.0) * sample_s);
            let mut torque = |t: f64, _: &Joints, qd: &Joints| drive.torque_nm(t, qd);
            state = integrate(&arm, &state, t_s, sample_s, step_s, &mut torque);
            states.push((next_s, state));
            row += 1.0;
        }
        if rest_s > ROUNDING_SHARE * sample_s.min(end_s) {
            let mut torque = |t: f64, _: &Joints, qd: &Joints| drive.torque_nm(t, qd);
            state = integrate(&arm, &state, whole_s, rest_s, step_s, &mut torque);
            states.push((end_s, state));
        }
        states
    };
    let states = args.timed(run);
    let mut out = Answer::new();
    let times: Vec<f64> = states.iter().map(|(t_s, _)| *t_s).collect();
    out.number_list("t_s", &times);
    out.number_rows("q", states.iter().map(|(_, s)| s.q.as_slice()));
    out.number_rows("qd", states.iter().map(|(_, s)| s.qd.as_slice()));
    let kinetic: Vec<f64> = states.iter().map(|(_, s)| arm.kinetic_energy_j(&s.q, &s.qd)).collect();
    let potential: Vec<f64> = states.iter().map(|(_, s)| arm.potential_energy_j(&s.q)).collect();
    out.number_list("kinetic_j", &kinetic);
    out.number_list("potential_j", &potential);
    Ok(out)
}
