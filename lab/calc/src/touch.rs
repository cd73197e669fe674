//! Calc operation on tactile images: `features`. An image whose length is not rows times columns is
//! an error.

use serde_json::json;
use taktil_mechanics::tactile::{Image, Moments, features as features_of, moments};

use super::Operation;
use super::answer::Answer;
use super::field::{Failure, Field, Kind, Presence};
use super::request::Args;

/// Largest number of rows or columns.
const SIDE_MAX: usize = 1024;

/// The operations of this subject.
pub(super) const OPERATIONS: &[Operation] = &[Operation {
    name: "features",
    doc: "Moments and features of a tactile image, positive under compression; x = column number \
          1..cols, y = row number 1..rows.",
    fields: &[
        Field::new(
            "image",
            Kind::Numbers,
            "counts",
            Presence::Required,
            "rows*cols values row by row.",
        ),
        Field::new("rows", Kind::Size(SIDE_MAX), "", Presence::Default("16"), "Rows."),
        Field::new("cols", Kind::Size(SIDE_MAX), "", Presence::Default("16"), "Columns."),
        Field::new(
            "baseline",
            Kind::Number,
            "counts",
            Presence::Default("0"),
            "Taken from every value first.",
        ),
        Field::new(
            "threshold",
            Kind::Number,
            "counts",
            Presence::Default("0"),
            "Above 0: smaller values count 0. At 0 every value counts, negative ones too.",
        ),
    ],
    answers: &[
        ("m0", "sum s"),
        ("m_x", "sum y s"),
        ("m_y", "sum x s"),
        ("m_xx", "sum y^2 s"),
        ("m_yy", "sum x^2 s"),
        ("m_xy", "sum x y s"),
        ("x_c", "column number or null"),
        ("y_c", "row number or null"),
        ("m_x_centred", "about the middle line"),
        ("theta_z_rad", "rad, 0 along y, positive towards -x; or null"),
        ("defined", "{x_c, theta_z}"),
    ],
    run: features,
}];

fn features(args: &Args) -> Result<Answer, Failure> {
    let (rows, cols) = (args.size("rows")?, args.size("cols")?);
    let baseline = args.number("baseline")?;
    let threshold = args.number("threshold")?;
    if threshold < 0.0 {
        let what = format!("`threshold` is {threshold}; 0 lets every value in");
        return Err(Failure::range("threshold", what));
    }
    let lowest = if threshold > 0.0 { threshold } else { f64::NEG_INFINITY };
    let values: Vec<f64> = args.numbers("image")?.iter().map(|value| value - baseline).collect();
    let image = Image::new(rows, cols, &values, None)
        .map_err(|error| Failure::new("wrong_length", Some("image"), error.to_string()))?;
    if let Some(index) = values.iter().position(|value| !value.is_finite()) {
        let place = format!("image[{index}]");
        return Err(Failure::range(&place, format!("`{place}` less the baseline overflows")));
    }
    let (m, f) = args.timed(|| {
        let m = moments(&image, lowest);
        (m, features_of(&m))
    });
    refuse_overflow(&m, &values)?;
    let mut out = Answer::new();
    out.number("m0", m.m0);
    out.number("m_x", m.m_x);
    out.number("m_y", m.m_y);
    out.number("m_xx", m.m_xx);
    out.number("m_yy", m.m_yy);
    out.number("m_xy", m.m_xy);
    out.optional_number("x_c", f.x_c);
    out.optional_number("y_c", f.y_c);
    out.number("m_x_centred", m.m_x_centred);
    out.optional_number("theta_z_rad", f.theta_z_rad);
    let defined = json!({"x_c": f.x_c.is_some(), "theta_z": f.theta_z_rad.is_some()});
    out.value("defined", defined);
    Ok(out)
}

/// Values whose moments overflow are an error; the message names the largest value and the remedy.
fn refuse_overflow(m: &Moments, values: &[f64]) -> Result<(), Failure> {
    let all = [m.m0, m.m_x, m.m_y, m.m_xx, m.m_yy, m.m_xy, m.m_x_centred];
    if all.iter().all(|moment| moment.is_finite()) {
        return Ok(());
    }
    let size = |n: &usize| values[*n].abs();
    let largest = (0..values.len()).max_by(|a, b| size(a).total_cmp(&size(b))).unwrap_or(0);
    let place = format!("image[{largest}]");
    let what = format!(
        "`{place}` less the baseline is {:e}: the moments overflow, scale the image down",
        values[largest]
    );
    Err(Failure::range(&place, what))
}
