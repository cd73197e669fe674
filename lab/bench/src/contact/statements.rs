//! Prints the thesis's statements on plane contact beside the numbers of the exact layer.

use std::fmt::Write;

use taktil_contact::field::{LineLoad, line};
use taktil_contact::half_plane::line_stresses;
use taktil_contact::layer::Layer;
use taktil_contact::plane::features::moments;
use taktil_contact::plane::noslip::NoSlip;
use taktil_contact::plane::{Friction, Indenter, Load, Shape, Spectrum};
use taktil_contact::stack::Stack;
use taktil_contact::{Accuracy, Invalid};

/// One pound per inch in N/mm; the loads of the thesis are simple fractions and multiples of it.
pub(super) const LB_PER_IN: f64 = 0.175_127;
/// Young's modulus of the thesis's rubber in MPa.
const YOUNGS_MPA: f64 = 27.58;
/// Length of the sensor, over which the thesis's moments are taken.
const SENSOR_LENGTH_MM: f64 = 25.4;

pub(super) fn contact_error(invalid: Invalid) -> anyhow::Error {
    anyhow::anyhow!("{invalid}")
}

pub(super) fn thesis_layer(t: f64, nu: f64) -> anyhow::Result<Layer> {
    Layer::new(t, YOUNGS_MPA, nu).map_err(contact_error)
}

/// The table of statements, with one line for each number.
///
/// # Errors
/// An error of the contact modules; none occurs with these numbers.
pub(super) fn table() -> anyhow::Result<String> {
    let mut out = String::from("statement | thesis | exact layer\n");
    for part in [
        knife_statements()?,
        bar_statements()?,
        cylinder_statements()?,
        superposition_statements()?,
        regression_statements()?,
        lift_off_statements()?,
    ] {
        out.push_str(&part);
    }
    out.push_str(&later_work_statements()?);
    Ok(out)
}

fn knife_statements() -> anyhow::Result<String> {
    let load = LineLoad { p_n_mm: 0.5 * LB_PER_IN, q_n_mm: 0.0 };
    let under = line_stresses(&load, 0.0, 0.8);
    let side = line_stresses(&load, 0.8, 0.8);
    let thin = &line(&thesis_layer(0.8, 0.49)?, &load, 0.8, &[0.0]).map_err(contact_error)?[0];
    let kpa = |s: Option<f64>| 1e3 * s.unwrap_or(f64::NAN);
    let x: Vec<f64> = (0..1000).map(|i| 0.01 * f64::from(i)).collect();
    let base = line(&thesis_layer(0.8, 0.49)?, &load, 0.8, &x).map_err(contact_error)?;
    let most = base.iter().filter_map(|p| p.szz_mpa).fold(f64::NEG_INFINITY, f64::max);
    let thick = line(&thesis_layer(25.4, 0.49)?, &load, 0.8, &x).map_err(contact_error)?;
    let off = x
        .iter()
        .zip(&thick)
        .map(|(x, p)| (kpa(p.szz_mpa) - 1e3 * line_stresses(&load, *x, 0.8).szz_mpa).abs())
        .fold(0.0, f64::max);
    let mut out = String::new();
    writeln!(out, "C1 half plane, s_zz at 0, kPa | -65 | {:.1}", 1e3 * under.szz_mpa)?;
    writeln!(out, "C1 half plane, s_xx at 0.8 mm, kPa | -18 | {:.1}", 1e3 * side.sxx_mpa)?;
    writeln!(out, "C1 thin layer, s_zz at 0, kPa | -100 | {:.1}", kpa(thin.szz_mpa))?;
    writeln!(out, "C1 thin layer, s_xx at 0, kPa | -90 | {:.1}", kpa(thin.sxx_mpa))?;
    writeln!(out, "C1 thin layer, largest s_zz at the base, kPa | above 0 | {:.1e}", 1e3 * most)?;
    writeln!(out, "C1 25.4 mm thick less half plane, s_zz, kPa | close | {off:.4}")?;
    let soft = &line(&thesis_layer(0.8, 0.499_999)?, &load, 0.8, &[0.0]).map_err(contact_error)?[0];
    let change = kpa(soft.szz_mpa) / kpa(thin.szz_mpa) - 1.0;
    writeln!(out, "C11 s_zz at nu 0.499999 over 0.49 | close | {:+.2} %", 1e2 * change)?;
    let skew = LineLoad { q_n_mm: 0.5 * load.p_n_mm, ..load };
    let m = moments(&thesis_layer(0.8, 0.49)?, &[[0.0, skew.p_n_mm, skew.q_n_mm]], 0.8).m;
    writeln!(
        out,
        "C5 knife, M0/P and M1/(t Q) | -1, - | {:.6}, {:.6}",
        m[0] / skew.p_n_mm,
        m[1] / (0.8 * skew.q_n_mm)
    )?;
    Ok(out)
}

fn pressed_indenter(t: f64, nu: f64, shape: Shape, load: Load) -> anyhow::Result<(Indenter, f64)> {
    let mut body = Indenter::new(&thesis_layer(t, nu)?, shape, Friction::None, Accuracy::Fine)
        .map_err(contact_error)?;
    let contact = body.press(&load)?;
    Ok((body, contact.delta_mm))
}

fn bar_statements() -> anyhow::Result<String> {
    let mut out = String::new();
    let shape = Shape::Flat { width_mm: 12.7, height_mm: 6.35 };
    let load = Load { p_n_mm: 1.96, q_n_mm: 0.0 };
    for (t, thesis) in [(0.8, "highest at the centre"), (12.7, "highest at the edges")] {
        let (body, _) = pressed_indenter(t, 0.49, shape, load)?;
        let (centre, off) = (1e3 * body.pressure_mpa(0.0), 1e3 * body.pressure_mpa(5.0));
        writeln!(out, "C2 bar, t = {t}: p at 0 and 5 mm, kPa | {thesis} | {centre:.1}, {off:.1}")?;
    }
    for nu in [0.49, 0.495, 0.4999] {
        let (_, delta) = pressed_indenter(0.8, nu, shape, Load { p_n_mm: 1.0, q_n_mm: 0.0 })?;
        writeln!(out, "C11 bar, descent per load at nu {nu}, mm^2/N | close | {delta:.3e}")?;
    }
    Ok(out)
}

fn cylinder_statements() -> anyhow::Result<String> {
    let mut out = String::new();
    let shape = Shape::Cylinder { radius_mm: 25.4 };
    for (t, thesis) in [(0.8, "higher"), (3.2, "as 12.8"), (12.8, "as 3.2"), (1e9, "lowest")] {
        let (body, _) = pressed_indenter(t, 0.49, shape, Load { p_n_mm: 0.7, q_n_mm: 0.0 })?;
        let p = 1e3 * body.pressure_mpa(0.0);
        let layer = if t < 1e6 { format!("t = {t}") } else { "half plane".to_owned() };
        writeln!(out, "C3 cylinder, {layer}: largest p, kPa | {thesis} | {p:.1}")?;
    }
    let shape = Shape::Cylinder { radius_mm: 22.9 };
    let held = NoSlip::widen(&thesis_layer(0.8, 0.49)?, shape, 1.5)
        .map_err(|e| anyhow::anyhow!("{e:?}"))?;
    let moved = |dx: f64| moments(held.layer(), &held.point_forces(dx), 0.8).m;
    let change = (moved(1e-3)[0] - moved(0.0)[0]) / 1e-3;
    let change = if change == 0.0 { "0".to_owned() } else { format!("{change:.1e}") };
    writeln!(out, "C8 no slip, b = 1.5: dM0/dx, N/mm^2 | 0 | {change}")?;
    writeln!(out, "C8 no slip, b = 1.5: dM1/dx, N/mm | not 0 | {:.2}", held.first_moment_n_mm)?;
    writeln!(out, "C10 no slip, b = 1.5: dQ/dx, N/mm^2 | - | {:.2}", held.tangential_n_mm2)?;
    Ok(out)
}

/// Error of the assumption that the stress is linear in Q, as a fraction of the peak.
fn superposition_statements() -> anyhow::Result<String> {
    let mut out = String::new();
    let layer = thesis_layer(0.8, 0.49)?;
    for height in [6.35, 12.7] {
        let shape = Shape::Flat { width_mm: 12.7, height_mm: height };
        for (p, q, thesis) in [(0.53, 0.09, "holds"), (0.53, 0.16, "is off"), (0.18, 0.14, "fails")]
        {
            let at = |q: f64| -> anyhow::Result<Vec<f64>> {
                let mut body = Indenter::new(&layer, shape, Friction::Proportional, Accuracy::Fine)
                    .map_err(contact_error)?;
                body.press(&Load { p_n_mm: p, q_n_mm: q })?;
                let stress = Spectrum::new(&layer, &body.point_forces(0.8), 0.8, 40.0);
                Ok((-80..=80).map(|i| stress.szz(0.125 * f64::from(i))).collect())
            };
            let figure = match at(q) {
                Err(_) => "topples".to_owned(),
                Ok(real) => {
                    let (none, little) = (at(0.0)?, at(0.01 * q)?);
                    let peak = real.iter().fold(0.0_f64, |most, s| most.max(-s));
                    let parts = real.iter().zip(none.iter().zip(&little));
                    let off = parts
                        .map(|(real, (none, little))| real - none - 100.0 * (little - none))
                        .fold(0.0_f64, |most, d| most.max(d.abs()));
                    format!("{:.0} %", 1e2 * off / peak)
                }
            };
            writeln!(out, "C9 superposition at ({p}, {q}), h = {height} | {thesis} | {figure}")?;
        }
    }
    Ok(out)
}

/// Second moment of the base stress about the bar's middle (N mm).
fn second_moment(layer: &Layer, width_mm: f64, height_mm: f64, load: Load) -> anyhow::Result<f64> {
    let shape = Shape::Flat { width_mm, height_mm };
    let mut body = Indenter::new(layer, shape, Friction::Proportional, Accuracy::Default)
        .map_err(contact_error)?;
    body.press(&load)?;
    Ok(moments(layer, &body.point_forces(0.8), 0.8).m[2])
}

/// The regressions (4.3) and (4.4) on the exact layer.
fn regression_statements() -> anyhow::Result<String> {
    let mut out = String::new();
    for height in [6.35, 12.7] {
        let (fit, lost) = regression(height)?;
        let lever = SENSOR_LENGTH_MM * (height + 0.8);
        let arm = 0.5 * SENSOR_LENGTH_MM * SENSOR_LENGTH_MM;
        writeln!(out, "C7 M1 = a P + b Q, h = {height} | 319.9, -339.3 | {arm:.1}, {:.1}", -lever)?;
        writeln!(
            out,
            "C7 M2 = a P + b Q + c W P + d, h = {height} | 3786, -9324, 10.5, -19 | \
             {:.0}, {:.0}, {:.1}, {:.0} ({lost} topple)",
            fit[0], fit[1], fit[2], fit[3]
        )?;
    }
    Ok(out)
}

/// Coefficients a to d of (4.4), M2 = a P + b Q + c W P + d, of bars as high as given (mm) on the
/// exact layer, and how many of them topple.
pub(super) fn regression(height: f64) -> anyhow::Result<([f64; 4], usize)> {
    let layer = thesis_layer(0.8, 0.49)?;
    let (mut rows, mut lost) = (Vec::new(), 0);
    for width in [7.9, 10.3, 12.7, 15.1] {
        for i in 1..=4 {
            for k in 1..=10 {
                let (p, q) = (LB_PER_IN * f64::from(i), 0.05 * LB_PER_IN * f64::from(k));
                let load = Load { p_n_mm: p, q_n_mm: q };
                let Ok(about_middle) = second_moment(&layer, width, height, load) else {
                    lost += 1;
                    continue;
                };
                let first = -(height + 0.8) * q;
                let m2 = about_middle + SENSOR_LENGTH_MM * first
                    - 0.25 * SENSOR_LENGTH_MM * SENSOR_LENGTH_MM * p;
                // The thesis counts P negative.
                rows.push(([-p, q, -width * p, 1.0], SENSOR_LENGTH_MM * m2));
            }
        }
    }
    Ok((least_squares(&rows), lost))
}

/// Least squares of four unknowns by the normal equations.
fn least_squares(rows: &[([f64; 4], f64)]) -> [f64; 4] {
    let mut a = [[0.0; 5]; 4];
    for (row, value) in rows {
        for i in 0..4 {
            for j in 0..4 {
                a[i][j] += row[i] * row[j];
            }
            a[i][4] += row[i] * value;
        }
    }
    for pivot in 0..4 {
        let source = a[pivot];
        for row in a.iter_mut().skip(pivot + 1) {
            let factor = row[pivot] / source[pivot];
            for (entry, known) in row.iter_mut().zip(source) {
                *entry -= factor * known;
            }
        }
    }
    let mut x = [0.0; 4];
    for i in (0..4).rev() {
        let known: f64 = (i + 1..4).map(|j| a[i][j] * x[j]).sum();
        x[i] = (a[i][4] - known) / a[i][i];
    }
    x
}

/// Statement on several bonded layers, which the thesis leaves for later work.
fn later_work_statements() -> anyhow::Result<String> {
    let mut out = String::new();
    let shape = Shape::Flat { width_mm: 12.7, height_mm: 6.35 };
    let load = Load { p_n_mm: 1.0, q_n_mm: 0.0 };
    let (_, whole) = pressed_indenter(0.8, 0.49, shape, load)?;
    for (skin, name) in [(YOUNGS_MPA, "of the same rubber"), (0.1 * YOUNGS_MPA, "a tenth as stiff")]
    {
        let layers =
            [Layer { youngs_mpa: skin, ..thesis_layer(0.3, 0.49)? }, thesis_layer(0.5, 0.49)?];
        let stack = Stack::new(&layers).map_err(contact_error)?;
        let mut body = Indenter::on_stack(&stack, shape, Friction::None, Accuracy::Fine)
            .map_err(contact_error)?;
        let part = body.press(&load)?.delta_mm / whole;
        writeln!(out, "C12 bar's descent, upper 0.3 of 0.8 mm {name} | later work | {part:.6}")?;
    }
    Ok(out)
}

/// Statements on the loads at which bars lift off, and on the centroid.
fn lift_off_statements() -> anyhow::Result<String> {
    let mut out = String::new();
    for width in [6.35, 7.9, 12.7, 15.1] {
        let shape = Shape::Flat { width_mm: width, height_mm: 6.35 };
        let mut body =
            Indenter::new(&thesis_layer(0.8, 0.49)?, shape, Friction::None, Accuracy::Default)
                .map_err(contact_error)?;
        let (mut low, mut high) = (0.0, 0.499 * width / 6.35);
        for _ in 0..40 {
            let middle = 0.5 * (low + high);
            let contact = body.press(&Load { p_n_mm: 1.0, q_n_mm: middle })?;
            let whole = contact.x_right_mm - contact.x_left_mm > width * (1.0 - 1e-9);
            if whole { low = middle } else { high = middle }
        }
        writeln!(out, "C6 bar W = {width}, frictionless: lifts at Q/P | - | {low:.4}")?;
    }
    writeln!(out, "C6 centroid M1/M0 over (h + t) Q/P, any width | linear | 1 (statics)")?;
    Ok(out)
}
