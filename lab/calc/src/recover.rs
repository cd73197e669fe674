//! Calc operation `recover`: loads or width of a flat bar from two moments of the base stress, in
//! the four cases of the thesis. Moments that no contact produces are an error.

use serde_json::{Value, json};
use taktil_contact::layer::Layer;
use taktil_contact::plane::recovery::{BarOverSensor, Estimate, Recovery, RecoveryError};
use taktil_contact::plane::{Friction, Load};

use super::Operation;
use super::answer::Answer;
use super::field::{Failure, Field, Kind, Presence};
use super::refusal::failure;
use super::request::Args;

/// Default standard deviation of a moment, as a fraction of the moment.
const DEFAULT_SIGMA_SHARE: f64 = 0.01;

const fn optional(name: &'static str, unit: &'static str, doc: &'static str) -> Field {
    Field::new(name, Kind::Number, unit, Presence::Optional, doc)
}

const fn default(
    name: &'static str,
    unit: &'static str,
    text: &'static str,
    doc: &'static str,
) -> Field {
    Field::new(name, Kind::Number, unit, Presence::Default(text), doc)
}

/// The operations of this subject.
pub(super) const OPERATIONS: &[Operation] = &[Operation {
    name: "recover",
    doc: "Loads or width of a flat bar from moments M1, M2 of szz over the base. Cases: 1 width \
          known, 2 loads known, 3 both known, 4 neither.",
    fields: &[
        Field::new("case", Kind::Size(4), "", Presence::Required, "1 to 4."),
        Field::new("m1", Kind::Number, "N", Presence::Required, "First moment of szz."),
        Field::new("m2", Kind::Number, "N mm", Presence::Required, "Second moment of szz."),
        optional("m1_sigma", "N", "Its standard deviation; 1 % of it when absent."),
        optional("m2_sigma", "N mm", "Its standard deviation; 1 % of it when absent."),
        default("origin_mm", "mm", "12.7", "Place of the bar's middle from the moments' origin."),
        optional("p_n_mm", "N/mm", "Normal load, cases 2 and 3."),
        default("q_n_mm", "N/mm", "0", "Tangential load, cases 2 and 3."),
        optional("width_mm", "mm", "Width, cases 1 and 3."),
        default("height_mm", "mm", "6.35", "Height of the loads over the surface."),
        default("t_mm", "mm", "0.8", "Thickness of the layer."),
        default("nu", "", "0.49", "Poisson's ratio, in (-1, 0.5]."),
        default("youngs_mpa", "MPa", "27.58", "Young's modulus."),
        Field::new(
            "friction",
            Kind::Choice(&["none", "prop"]),
            "",
            Presence::Default("\"prop\""),
            "Shear under the bar.",
        ),
    ],
    answers: &[
        ("p_n_mm", "N/mm, null in case 4"),
        ("q_n_mm", "N/mm, null in case 4"),
        ("width_mm", "mm, null in case 4"),
        ("sigma", "{p_n_mm, q_n_mm, width_mm}, 0 for what was given"),
        ("residual", "{m1, m2}: of the answer less the given"),
        ("consistent", "whether both misses are within 3 sigma"),
        ("constraint", "{p, q, value, sigma}: p P + q Q = value, of that sigma, in case 4"),
    ],
    run: recover,
}];

fn required_positive(args: &Args, name: &str) -> Result<f64, Failure> {
    if args.has(name) {
        return args.positive(name);
    }
    let what = format!("`{name}` is missing: this case takes it as known");
    Err(Failure::new("missing_field", Some(name), what))
}

fn measured_moment(args: &Args, name: &str, sigma: &str) -> Result<Estimate, Failure> {
    let value = args.number(name)?;
    let sigma =
        if args.has(sigma) { args.positive(sigma)? } else { DEFAULT_SIGMA_SHARE * value.abs() };
    Ok(Estimate { value, sigma })
}

fn recover(args: &Args) -> Result<Answer, Failure> {
    let layer = Layer {
        thickness_mm: args.number("t_mm")?,
        youngs_mpa: args.number("youngs_mpa")?,
        poisson: args.number("nu")?,
    };
    let friction = match args.choice("friction")? {
        "none" => Friction::None,
        _ => Friction::Proportional,
    };
    let setting = BarOverSensor {
        layer,
        height_mm: args.number("height_mm")?,
        origin_mm: args.number("origin_mm")?,
        friction,
    };
    setting.check().map_err(|invalid| recovery_failure(RecoveryError::Invalid(invalid)))?;
    let m = [measured_moment(args, "m1", "m1_sigma")?, measured_moment(args, "m2", "m2_sigma")?];
    let load = |args: &Args| -> Result<Load, Failure> {
        Ok(Load { p_n_mm: required_positive(args, "p_n_mm")?, q_n_mm: args.number("q_n_mm")? })
    };
    let case = args.size("case")?;
    if case == 4 {
        let [p, q, value] = args.timed(|| setting.constraint(m)).map_err(recovery_failure)?;
        let mut out = Answer::new();
        for name in ["p_n_mm", "q_n_mm", "width_mm"] {
            out.optional_number(name, None);
        }
        let sigma = m[0].sigma;
        out.value("constraint", json!({"p": p, "q": q, "value": value, "sigma": sigma}));
        return Ok(out);
    }
    let found = match case {
        1 => {
            let width = required_positive(args, "width_mm")?;
            args.timed(|| setting.loads(width, m))
        }
        2 => {
            let load = load(args)?;
            args.timed(|| setting.width(&load, m))
        }
        _ => {
            let (width, load) = (required_positive(args, "width_mm")?, load(args)?);
            args.timed(|| setting.check_consistency(width, &load, m))
        }
    };
    Ok(recovered_answer(&found.map_err(recovery_failure)?, m))
}

fn recovered_answer(found: &Recovery, m: [Estimate; 2]) -> Answer {
    let mut out = Answer::new();
    let all = [("p_n_mm", found.p), ("q_n_mm", found.q), ("width_mm", found.width)];
    for (name, measured) in all {
        out.number(name, measured.value);
    }
    out.number_object("sigma", &all.map(|(name, measured)| (name, measured.sigma)));
    out.number_object("residual", &[("m1", found.misses[0]), ("m2", found.misses[1])]);
    let within = |k: usize| found.misses[k].abs() <= 3.0 * m[k].sigma + 1e-9;
    out.value("consistent", Value::from(within(0) && within(1)));
    out
}

fn recovery_failure(error: RecoveryError) -> Failure {
    match error {
        RecoveryError::Invalid(invalid) => match invalid.place.as_str() {
            "width_mm" | "height_mm" => {
                let what = format!("`{}`: {}; {}", invalid.place, invalid.what, invalid.remedy);
                Failure::range(&invalid.place, what)
            }
            _ => failure(&invalid),
        },
        RecoveryError::NoContact => {
            let what = "no contact of such a bar makes these moments; check their origin and signs";
            Failure::new("unreachable", Some("m2"), what)
        }
    }
}
