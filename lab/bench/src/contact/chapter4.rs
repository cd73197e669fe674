//! Draws the figures of chapter 4 of the thesis on the exact layer: the knife edge under skew loads
//! (4.2 to 4.4), the tilting bar (4.5 to 4.7) and its features (4.9 to 4.14). Figures 4.1, 4.8 and
//! 4.15 show no numbers. A bar that topples leaves a gap in its curve.

use core::f64::consts::PI;

use taktil_contact::Accuracy;
use taktil_contact::field::{LineLoad, line};
use taktil_contact::plane::compliance::SurfaceCompliance;
use taktil_contact::plane::features::{Compressive, Moments, compressive, moments};
use taktil_contact::plane::frictional::{FrictionLaw, FrictionalContact, LoadStep};
use taktil_contact::plane::{Friction, Indenter, Load, PointForce, Shape, Spectrum};

use super::chapter3::symmetric_grid;
use super::curves::{Chart, Curve, stacked_charts};
use super::statements::{LB_PER_IN, contact_error, regression, thesis_layer};
use taktil_lab_plot::svg::Figure;

/// Thickness of the thesis's layer, at whose base the sensor lies.
pub(super) const THICKNESS_MM: f64 = 0.8;
/// Length over which the thesis's moments are taken; the sensor's middle is at half of it.
const SENSOR_LENGTH_MM: f64 = 25.4;
/// Lever arm of the loads that the thesis's numbers imply; the thesis states 6.35.
const LEVER_MM: f64 = 12.7;
/// The four widths of the bars.
const WIDTHS_MM: [f64; 4] = [7.9, 10.3, 12.7, 15.1];
/// The four normal loads, in the thesis's unit.
const LOAD_MULTIPLES: [f64; 4] = [1.0, 2.0, 3.0, 4.0];
/// Threshold of the contact's width in MPa.
const THRESHOLD_MPA: f64 = 2e-3;

/// Every figure with the name of its file.
pub(super) fn figures() -> anyhow::Result<Vec<(&'static str, Figure)>> {
    let mut out = vec![
        ("fig-4-2-knife-normal.svg", knife_normal_chart()?.figure()),
        ("fig-4-3-knife-skew.svg", knife_skew_figure()?),
        ("fig-4-4-knife-moments.svg", knife_moment_figure()?),
        ("fig-4-5-bar-friction.svg", friction_chart()?.figure()),
        ("fig-4-6-bar-normal.svg", bar_normal_chart()?.figure()),
        ("fig-4-7-bar-skew.svg", bar_skew_figure()?),
    ];
    out.extend(feature_figures()?);
    Ok(out)
}

/// A multiple of the thesis's unit of load in N/mm.
pub(super) fn load_n_mm(count: f64) -> f64 {
    LB_PER_IN * count
}

fn knife_stress_kpa(load: LineLoad, x: &[f64]) -> anyhow::Result<Vec<f64>> {
    let points =
        line(&thesis_layer(THICKNESS_MM, 0.49)?, &load, THICKNESS_MM, x).map_err(contact_error)?;
    Ok(points.iter().map(|p| 1e3 * p.szz_mpa.unwrap_or(f64::NAN)).collect())
}

fn stress_chart(title: &str, curves: Vec<Curve>, remarks: &[&str]) -> Chart {
    Chart {
        title: title.to_owned(),
        x: "x (mm)",
        y: "base s_zz (kPa)",
        curves,
        remarks: remarks.iter().map(|&r| r.to_owned()).collect(),
    }
}

fn knife_normal_chart() -> anyhow::Result<Chart> {
    let x = symmetric_grid(5.0, 400);
    let mut curves = Vec::new();
    for count in [1.0, 2.0, 3.0, 4.0] {
        let load = LineLoad { p_n_mm: load_n_mm(count), q_n_mm: 0.0 };
        curves.push(Curve::new(format!("P = {:.3}", load.p_n_mm), &x, knife_stress_kpa(load, &x)?));
    }
    Ok(stress_chart(
        "Knife edge, normal load alone (N/mm)",
        curves,
        &["thesis: symmetric, the peak grows with P: so it is, exactly in proportion"],
    ))
}

fn knife_skew_figure() -> anyhow::Result<Figure> {
    let x = symmetric_grid(5.0, 400);
    let (mut a, mut b) = (Vec::new(), Vec::new());
    for count in [1.0, 2.0, 3.0, 4.0] {
        let load = LineLoad { p_n_mm: load_n_mm(count), q_n_mm: load_n_mm(0.5) };
        a.push(Curve::new(format!("P = {:.3}", load.p_n_mm), &x, knife_stress_kpa(load, &x)?));
    }
    for count in [0.0, 0.5, 1.0, 2.0] {
        let load = LineLoad { p_n_mm: load_n_mm(2.0), q_n_mm: load_n_mm(count) };
        b.push(Curve::new(format!("Q = {:.3}", load.q_n_mm), &x, knife_stress_kpa(load, &x)?));
    }
    let by: Vec<f64> = b[1..].iter().map(|curve| curve.minimum() / b[0].minimum()).collect();
    let factors = format!(
        "thesis: the peak does not vary with Q; here by factors of {:.3}, {:.3}, {:.3} at",
        by[0], by[1], by[2]
    );
    let charts = [
        stress_chart("(a) Knife edge, Q = 0.088 N/mm: P varies", a, &[]),
        stress_chart(
            "(b) Knife edge, P = 0.350 N/mm: Q varies",
            b,
            &[&factors, "Q/P = 0.25, 0.5, 1: holds up to Q/P = 0.25"],
        ),
    ];
    Ok(stacked_charts("Knife edge under skew loads", &charts))
}

fn knife_moment_figure() -> anyhow::Result<Figure> {
    let layer = thesis_layer(THICKNESS_MM, 0.49)?;
    let loads: Vec<f64> = (0..=10).map(|k| load_n_mm(0.1 * f64::from(k))).collect();
    let (mut zeroth, mut first) = (Vec::new(), Vec::new());
    for (colour, count) in [1.0, 2.0, 4.0].into_iter().enumerate() {
        let p = load_n_mm(count);
        let mut rows: [Vec<f64>; 4] = Default::default();
        for q in &loads {
            let forces = [[0.0, p, *q]];
            let whole = moments(&layer, &forces, THICKNESS_MM);
            let stress = Spectrum::new(&layer, &forces, THICKNESS_MM, 30.0);
            let part = compressive(&stress, *q == 0.0, &[]).moments;
            for (row, value) in rows.iter_mut().zip([whole.m[0], part.m[0], whole.m[1], part.m[1]])
            {
                row.push(value);
            }
        }
        let [m0, m0c, m1, m1c] = rows;
        let label = |what: &str| format!("P = {p:.3}, {what}");
        zeroth.push(Curve::new(label("all"), &loads, m0).with_colour(colour));
        zeroth
            .push(Curve::new(label("compressive"), &loads, m0c).with_colour(colour).with_dashes());
        first.push(Curve::new(label("all"), &loads, m1).with_colour(colour));
        first.push(Curve::new(label("compressive"), &loads, m1c).with_colour(colour).with_dashes());
    }
    let chart = |title: &str, y, curves, remarks: &[&str]| Chart {
        title: title.to_owned(),
        x: "Q (N/mm)",
        y,
        curves,
        remarks: remarks.iter().map(|&r| r.to_owned()).collect(),
    };
    let charts = [
        chart(
            "(a) Knife edge: zeroth moment",
            "M0 (N/mm)",
            zeroth,
            &["thesis: linear in P, independent of Q: exact with tension, else up to Q/P = 0.25"],
        ),
        chart(
            "(b) Knife edge: first moment about the edge",
            "M1 (N)",
            first,
            &["thesis: varies with P and Q, compressive part; with tension it is -t Q whatever P"],
        ),
    ];
    Ok(stacked_charts("Moments under a knife edge", &charts))
}

/// A solved bar: its forces on the layer and the stress at the base; `None` where it topples.
pub(super) fn bar_solution(
    width_mm: f64,
    height_mm: f64,
    [p_n_mm, q_n_mm]: [f64; 2],
) -> anyhow::Result<Option<(Vec<PointForce>, Spectrum)>> {
    let layer = thesis_layer(THICKNESS_MM, 0.49)?;
    let shape = Shape::Flat { width_mm, height_mm };
    let mut body = Indenter::new(&layer, shape, Friction::Proportional, Accuracy::Default)
        .map_err(contact_error)?;
    if body.press(&Load { p_n_mm, q_n_mm }).is_err() {
        return Ok(None);
    }
    let forces = body.point_forces(THICKNESS_MM);
    let stress = Spectrum::new(&layer, &forces, THICKNESS_MM, 40.0);
    Ok(Some((forces, stress)))
}

pub(super) fn bar_stress_kpa(
    width_mm: f64,
    height_mm: f64,
    load: [f64; 2],
    x: &[f64],
) -> anyhow::Result<Vec<f64>> {
    let found = bar_solution(width_mm, height_mm, load)?;
    Ok(found.map_or_else(
        || vec![f64::NAN; x.len()],
        |(_, stress)| x.iter().map(|x| 1e3 * stress.szz(*x)).collect(),
    ))
}

/// Friction proportional to the pressure, compared with a surface that does not slip.
fn friction_chart() -> anyhow::Result<Chart> {
    let layer = thesis_layer(THICKNESS_MM, 0.49)?;
    let x = symmetric_grid(10.0, 400);
    let load = Load { p_n_mm: load_n_mm(3.0), q_n_mm: load_n_mm(0.25) };
    let cells = 96_u32;
    let edge = |i: u32| -6.35 * libm::cos(PI * f64::from(i) / f64::from(cells));
    let edges: Vec<f64> = (0..=cells).map(edge).collect();
    let mut curves = Vec::new();
    let laws = [
        ("in proportion to the pressure", FrictionLaw::Proportional(load.q_n_mm / load.p_n_mm)),
        ("held along x, no slip", FrictionLaw::Coulomb(f64::INFINITY)),
        ("none", FrictionLaw::Free),
    ];
    for (name, law) in laws {
        let bed = SurfaceCompliance::of_layer(&layer, &edges).map_err(contact_error)?;
        let mut grip =
            FrictionalContact::new(bed, vec![0.0; cells as usize], law).map_err(contact_error)?;
        grip.step(&LoadStep::Loads { load, height_mm: 6.35 })?;
        let parts = grip.normal_n_mm().iter().zip(grip.tangential_n_mm());
        let forces: Vec<PointForce> =
            grip.compliance().x_mm.iter().zip(parts).map(|(x, (p, q))| [*x, *p, *q]).collect();
        let stress = Spectrum::new(&layer, &forces, THICKNESS_MM, 40.0);
        curves.push(Curve::new(name, &x, x.iter().map(|x| 1e3 * stress.szz(*x))));
    }
    let [proportional, held] = [&curves[0].points, &curves[1].points];
    let peak = proportional.iter().fold(0.0_f64, |most, (_, s)| most.max(-s));
    let pairs = proportional.iter().zip(held);
    let off = pairs.map(|((_, a), (_, b))| (a - b).abs()).fold(0.0, f64::max);
    let remark = format!(
        "thesis: shows the first two beside each other; here {:.0} % of the peak apart at most",
        1e2 * off / peak
    );
    Ok(stress_chart(
        "Bar 12.7 mm wide, (P, Q) = (0.525, 0.044) N/mm, h = 6.35 mm: three laws of friction",
        curves,
        &[&remark],
    ))
}

fn bar_normal_chart() -> anyhow::Result<Chart> {
    let x = symmetric_grid(12.7, 500);
    let mut curves = Vec::new();
    for count in [1.0, 2.0, 3.0, 4.0] {
        let load = [load_n_mm(count), 0.0];
        let label = format!("P = {:.3}", load[0]);
        curves.push(Curve::new(label, &x, bar_stress_kpa(12.7, LEVER_MM, load, &x)?));
    }
    Ok(stress_chart(
        "Bar 12.7 mm wide, normal load alone (N/mm)",
        curves,
        &["thesis: flat under the bar with its peak in the middle, in proportion to P: so it is"],
    ))
}

fn bar_skew_figure() -> anyhow::Result<Figure> {
    let x = symmetric_grid(12.7, 500);
    let (mut a, mut b) = (Vec::new(), Vec::new());
    for q in [0.0, 0.0175, 0.0350, 0.0613] {
        a.push(Curve::new(
            format!("Q = {q}"),
            &x,
            bar_stress_kpa(12.7, LEVER_MM, [load_n_mm(1.0), q], &x)?,
        ));
    }
    for count in [1.0, 2.0, 3.0, 4.0] {
        let load = [load_n_mm(count), load_n_mm(0.25)];
        let label = format!("P = {:.3}", load[0]);
        b.push(Curve::new(label, &x, bar_stress_kpa(12.7, LEVER_MM, load, &x)?));
    }
    let charts = [
        stress_chart(
            "(a) Bar 12.7 mm wide and high, P = 0.175 N/mm: Q varies",
            a,
            &["thesis: at Q = 0.0613 it spans 12 to 20 mm (-0.7 to 7.3 here): so it does"],
        ),
        stress_chart(
            "(b) Bar 12.7 mm wide and high, Q = 0.044 N/mm: P varies",
            b,
            &["thesis: skewed, higher and narrower the larger Q/P: so it is"],
        ),
    ];
    Ok(stacked_charts("Bar under skew loads", &charts))
}

/// Features of one bar under one load.
struct BarFeatures {
    whole: Moments,
    part: Compressive,
}

/// Presses all bars under the given tangential loads.
fn feature_rows(loads: &[f64]) -> anyhow::Result<BarFeatureTable> {
    let layer = thesis_layer(THICKNESS_MM, 0.49)?;
    let one = |width: f64, p: f64, q: f64| -> anyhow::Result<Option<BarFeatures>> {
        let found = bar_solution(width, LEVER_MM, [p, q])?;
        Ok(found.map(|(forces, stress)| BarFeatures {
            whole: moments(&layer, &forces, THICKNESS_MM),
            part: compressive(&stress, false, &[THRESHOLD_MPA]),
        }))
    };
    let of_width = |width: f64| -> anyhow::Result<Vec<Vec<Option<BarFeatures>>>> {
        LOAD_MULTIPLES
            .map(|count| loads.iter().map(|q| one(width, load_n_mm(count), *q)).collect())
            .into_iter()
            .collect()
    };
    WIDTHS_MM.into_iter().map(of_width).collect()
}

/// Moment of an order about the sensor's left end, divided by its length, in the thesis's units.
fn moment_about_end(m: &[f64; 4], order: usize) -> f64 {
    let half = 0.5 * SENSOR_LENGTH_MM;
    let sum = match order {
        1 => m[1] + half * m[0],
        2 => m[2] + 2.0 * half * m[1] + half * half * m[0],
        _ => m[3] + 3.0 * half * (m[2] + half * m[1]) + half * half * half * m[0],
    };
    SENSOR_LENGTH_MM * sum
}

/// All bars under all loads: by width, then P, then Q.
type BarFeatureTable = Vec<Vec<Vec<Option<BarFeatures>>>>;

/// Name of the file, title, axis, the feature that is drawn, and the remarks on it.
type FeatureFigure = (
    &'static str,
    &'static str,
    &'static str,
    fn(&BarFeatures) -> f64,
    fn(&BarFeatureTable) -> anyhow::Result<Vec<String>>,
);

/// Largest distance (mm) of the peak from the bar's edge, under the largest Q without toppling.
fn peak_edge_distance_mm(rows: &BarFeatureTable) -> f64 {
    let of_width = |(width, by_load): (&f64, &Vec<Vec<Option<BarFeatures>>>)| {
        let last = by_load[0].iter().flatten().last();
        last.map_or(f64::NAN, |row| (0.5 * width - row.part.x_peak_mm.abs()).abs())
    };
    WIDTHS_MM.iter().zip(rows).map(of_width).fold(0.0, f64::max)
}

/// Smallest and largest moment, over the widths of the bars, under the smallest loads.
fn moment_range(rows: &BarFeatureTable, order: usize) -> [f64; 2] {
    let all = rows.iter().filter_map(|by_load| by_load[0][0].as_ref());
    all.map(|row| moment_about_end(&row.whole.m, order))
        .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], m| [low.min(m), high.max(m)])
}

/// Remarks on figure 4.12; the coefficients follow from statics.
fn first_moment_remarks(rows: &BarFeatureTable) -> Vec<String> {
    let (arm, lever) =
        (0.5 * SENSOR_LENGTH_MM * SENSOR_LENGTH_MM, SENSOR_LENGTH_MM * (LEVER_MM + THICKNESS_MM));
    vec![
        format!(
            "thesis (4.3): 319.9 P - 339.3 Q - 0.016, P negative; here {arm:.1} and {lever:.1}, \
             statics"
        ),
        format!("thesis: smallest about -60; here {:.1} whatever W", moment_range(rows, 1)[1]),
    ]
}

/// Remarks on figure 4.13.
fn second_moment_remarks(rows: &BarFeatureTable) -> anyhow::Result<Vec<String>> {
    let ([p, q, wp, rest], _) = regression(LEVER_MM)?;
    let [low, high] = moment_range(rows, 2);
    Ok(vec![
        format!(
            "thesis (4.4): 3786 P - 9324 Q + 10.5 W P - 19; here {p:.0}, {q:.0}, {wp:.1}, {rest:.0}"
        ),
        format!("thesis: smallest -750; here {high:.0} to {low:.0} by W"),
    ])
}

/// The trend_text of a curve in words; steps below a hundredth of a millimetre do not count.
fn trend_text(values: &[f64]) -> &'static str {
    const CHANGE_MIN_MM: f64 = 0.01;
    let known: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    let (Some(first), Some(last)) = (known.first(), known.last()) else { return "topples" };
    let most = known.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let least = known.iter().copied().fold(f64::INFINITY, f64::min);
    let [up, down] = [most - first > CHANGE_MIN_MM, first - least > CHANGE_MIN_MM];
    let [from_most, from_least] = [most - last > CHANGE_MIN_MM, last - least > CHANGE_MIN_MM];
    match (up, from_most, down, from_least) {
        (true, true, ..) => "rises, then falls",
        (_, _, true, true) => "falls, then rises",
        (true, ..) => "rises",
        (_, _, true, _) => "falls",
        _ => "stays",
    }
}

/// Figure 4.9: a chart for each bar, with a curve for each normal load.
fn width_figure(rows: &BarFeatureTable, loads: &[f64]) -> Figure {
    let chart = |(width, by_load): (&f64, &Vec<Vec<Option<BarFeatures>>>)| {
        let read = |row: &Option<BarFeatures>| {
            row.as_ref().and_then(|row| row.part.widths_mm.first().copied()).unwrap_or(f64::NAN)
        };
        let (mut curves, mut courses) = (Vec::new(), Vec::new());
        for (count, row) in LOAD_MULTIPLES.iter().zip(by_load) {
            let values: Vec<f64> = row.iter().map(read).collect();
            courses.push(format!("{:.3} {}", load_n_mm(*count), trend_text(&values)));
            curves.push(Curve::new(format!("P = {:.3}", load_n_mm(*count)), loads, values));
        }
        Chart {
            title: format!("Width of the contact above 2 kPa: bar W = {width} mm, h = 12.7 mm"),
            x: "Q (N/mm)",
            y: "w_s (mm)",
            curves,
            remarks: vec![
                "thesis: falls as Q grows until it bottoms out, the less the larger P".to_owned(),
                format!("here, by P: {}", courses.join("; ")),
            ],
        }
    };
    let charts: Vec<Chart> = WIDTHS_MM.iter().zip(rows).map(chart).collect();
    stacked_charts("Width of the contact", &charts)
}

const FEATURES: [FeatureFigure; 5] = [
    (
        "fig-4-10-peak.svg",
        "Place of the largest compression",
        "x_m (mm)",
        |row| row.part.x_peak_mm,
        |rows| {
            let edge = peak_edge_distance_mm(rows);
            Ok(vec![format!(
                "thesis: varies little with W: not when skewed; before it topples a bar has it \
                 within {edge:.1} mm of its edge"
            )])
        },
    ),
    (
        "fig-4-11-centroid.svg",
        "Centroid of the stress",
        "x_c (mm)",
        |row| row.whole.centroid_mm().unwrap_or(f64::NAN),
        |_| {
            let text =
                "thesis: linear in Q, whatever W: exactly (h + t) Q/P; levelling off is not found";
            Ok(vec![text.to_owned()])
        },
    ),
    (
        "fig-4-12-first-moment.svg",
        "First moment about the sensor's end over 25.4 mm",
        "M1 (N mm)",
        |row| moment_about_end(&row.whole.m, 1),
        |rows| Ok(first_moment_remarks(rows)),
    ),
    (
        "fig-4-13-second-moment.svg",
        "Second moment about the sensor's end over 25.4 mm",
        "M2 (N mm^2)",
        |row| moment_about_end(&row.whole.m, 2),
        second_moment_remarks,
    ),
    (
        "fig-4-14-third-moment.svg",
        "Third moment about the sensor's end over 25.4 mm",
        "M3 (N mm^3)",
        |row| moment_about_end(&row.whole.m, 3),
        |_| {
            let text =
                "thesis: nearly linear in Q: about the end it is, about the middle it is not";
            Ok(vec![text.to_owned()])
        },
    ),
];

fn feature_figures() -> anyhow::Result<Vec<(&'static str, Figure)>> {
    let loads: Vec<f64> = (1..=10).map(|k| load_n_mm(0.05 * f64::from(k))).collect();
    let rows = feature_rows(&loads)?;
    let chart =
        |(name, title, y, read, said): &FeatureFigure| -> anyhow::Result<(&'static str, Figure)> {
            let mut curves = Vec::new();
            for (colour, (width, by_load)) in WIDTHS_MM.iter().zip(&rows).enumerate() {
                for k in [0, LOAD_MULTIPLES.len() - 1] {
                    let values = by_load[k].iter().map(|row| row.as_ref().map_or(f64::NAN, *read));
                    let label = format!("W = {width}, P = {:.3}", load_n_mm(LOAD_MULTIPLES[k]));
                    let curve = Curve::new(label, &loads, values).with_colour(colour);
                    curves.push(if k == 0 { curve.with_dashes() } else { curve });
                }
            }
            let chart = Chart {
                title: format!("{title}: bars, h = 12.7 mm"),
                x: "Q (N/mm)",
                y,
                curves,
                remarks: said(&rows)?,
            };
            Ok((*name, chart.figure()))
        };
    let mut out = vec![("fig-4-9-width.svg", width_figure(&rows, &loads))];
    out.extend(FEATURES.iter().map(chart).collect::<anyhow::Result<Vec<_>>>()?);
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::trend_text;

    #[test]
    fn a_caption_says_how_its_curve_runs() {
        assert_eq!(trend_text(&[3.0, 2.0, 1.0, f64::NAN]), "falls");
        assert_eq!(trend_text(&[1.0, 2.0, 3.0]), "rises");
        assert_eq!(trend_text(&[1.0, 3.0, 2.0]), "rises, then falls");
        assert_eq!(trend_text(&[3.0, 1.0, 2.0]), "falls, then rises");
        assert_eq!(trend_text(&[3.0, 3.001, 2.999]), "stays");
        assert_eq!(trend_text(&[f64::NAN]), "topples");
    }
}
