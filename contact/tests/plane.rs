//! Compares plane contact of bars and cylinders with exact reference data and statics, and tests
//! hard cases.

mod contact_data;

use contact_data::{rows, words};
use taktil_contact::Accuracy;
use taktil_contact::layer::Layer;
use taktil_contact::plane::features::{compressive, moments};
use taktil_contact::plane::{Contact, Friction, Indenter, Load, Mode, Refusal, Shape, Spectrum};

const E_MPA: f64 = 27.58;

fn layer(t: f64, nu: f64) -> Layer {
    Layer::new(t, E_MPA, nu).expect("a sound layer")
}

fn indenter(layer: &Layer, shape: Shape, friction: Friction, level: Accuracy) -> Indenter {
    Indenter::new(layer, shape, friction, level).expect("a sound indenter")
}

fn bar(width_mm: f64, height_mm: f64) -> Shape {
    Shape::Flat { width_mm, height_mm }
}

fn load(p_n_mm: f64, q_n_mm: f64) -> Load {
    Load { p_n_mm, q_n_mm }
}

fn near(found: f64, expected: f64, bar: f64, what: &str) {
    assert!((found - expected).abs() <= bar, "{what}: {found} not {expected}, bar {bar:e}");
}

/// Error of the level in parts of the peak.
const ERROR_BOUNDS: [(Accuracy, f64); 3] =
    [(Accuracy::Fast, 5e-3), (Accuracy::Default, 1e-5), (Accuracy::Fine, 1e-8)];

#[test]
fn flat_bars_are_those_of_the_reference() {
    for (level, error) in ERROR_BOUNDS {
        for row in rows(include_str!("fixtures/contact/punch_flat.csv")) {
            let (t, a) = (row[1], 0.5 * row[2]);
            let layer = layer(t, row[0]);
            let mut bar = indenter(&layer, bar(row[2], 0.0), Friction::None, level);
            let contact = bar.press(&load(row[3], 0.0)).expect("a contact");
            assert_eq!(contact.mode, Mode::Full);
            // The reference's displacements carry a constant of up to 1e-10/(pi G) per load.
            near(contact.delta_mm, row[4], error * row[4] + 3e-12, "delta");
            near(bar.edge_strengths_mpa()[1], row[5], error * row[5], "edge");
            for (f, p) in [0.0, 0.2, 0.4, 0.6, 0.8, 0.9, 0.95, 0.99].iter().zip(&row[6..14]) {
                near(bar.pressure_mpa(-f * a), *p, error * p, "pressure");
            }
            let stress = Spectrum::new(&layer, &bar.point_forces(t), t, 3.0 * a);
            let x = [0.0, 0.25 * a, 0.5 * a, 0.75 * a, 0.9 * a, a, 1.1 * a, a + t, a + 2.0 * t];
            for (x, szz) in x.iter().zip(&row[14..23]) {
                near(stress.szz(-x), *szz, error * row[14].abs(), "szz");
            }
            let again = bar.descend(contact.delta_mm).expect("a contact");
            near(again.p_n_mm, row[3], 1e-12, "P of delta");
        }
    }
}

#[test]
fn bars_on_layers_of_any_thickness() {
    let rows = rows(include_str!("fixtures/contact/punch_thickness.csv"));
    for group in rows.chunk_by(|a, b| a[0] == b[0]) {
        let (first, depth) = (&group[0], 0.8);
        let layer = layer(first[0], first[1]);
        let mut bar = indenter(&layer, bar(first[2], 0.0), Friction::None, Accuracy::Fine);
        bar.press(&load(first[3], 0.0)).expect("a contact");
        let stress = Spectrum::new(&layer, &bar.point_forces(depth), depth, 40.0);
        for row in group {
            near(stress.szz(row[4]), row[6], 1e-8 * first[6].abs(), "szz");
            let p = bar.pressure_mpa(row[4]);
            // At the corner itself the pressure is infinite.
            assert!(p.is_infinite() || (p - row[5]).abs() < 1e-8 * (1.0 + row[5]), "{row:?} {p}");
        }
    }
}

#[test]
fn cylinders_are_those_of_the_reference() {
    for (level, error) in ERROR_BOUNDS {
        let text = include_str!("fixtures/contact/cylinder_relation.csv");
        for row in &rows(text) {
            let (t, b) = (row[1], row[3]);
            let layer = layer(t, row[0]);
            let shape = Shape::Cylinder { radius_mm: row[2] };
            let mut roller = indenter(&layer, shape, Friction::None, level);
            let contact = roller.press(&load(row[4], 0.0)).expect("a contact");
            near(contact.x_right_mm, b, error * b, "b");
            near(contact.x_left_mm, -b, error * b, "-b");
            near(contact.delta_mm, row[5], error * row[5] + 3e-12 * row[4], "delta");
            near(roller.pressure_mpa(0.0), row[6], error * row[6], "p0");
            let stress = Spectrum::new(&layer, &roller.point_forces(t), t, b + 2.0 * t);
            for (x, szz) in [0.0, 0.5 * b, b, b + t].iter().zip(&row[7..11]) {
                near(stress.szz(*x), *szz, error * row[7].abs(), "szz");
            }
            let m = moments(&layer, &roller.point_forces(t), t).m;
            near(m[0], -row[4], 1e-10 * row[4], "M0");
            near(m[2], row[11], error * row[11].abs(), "M2");
            let again = roller.descend(row[5]).expect("a contact");
            near(again.p_n_mm, row[4], 2.0 * error * row[4], "P of delta");
        }
    }
}

#[test]
fn profiles_of_cylinders_down_to_the_half_plane() {
    let rows = rows(include_str!("fixtures/contact/cylinder_profiles.csv"));
    for group in rows.chunk_by(|a, b| a[..4] == b[..4]) {
        let first = &group[0];
        let layer = layer(first[1], first[0]);
        let shape = Shape::Cylinder { radius_mm: first[2] };
        let mut roller = indenter(&layer, shape, Friction::None, Accuracy::Fine);
        roller.press(&load(first[3], 0.0)).expect("a contact");
        let stress = Spectrum::new(&layer, &roller.point_forces(0.8), 0.8, 40.0);
        for row in group {
            near(roller.pressure_mpa(row[4]), row[5], 1e-8 * first[5], "p");
            near(stress.szz(row[4]), row[6], 1e-8 * first[5], "szz");
        }
    }
}

/// One row of the tilted bars.
struct Tilted {
    layer: Layer,
    shape: Shape,
    load: Load,
    mode: String,
    /// All columns; NaN for words.
    numbers: Vec<f64>,
}

fn tilted(text: &str) -> Vec<Tilted> {
    let row = |cells: Vec<String>| {
        let numbers: Vec<f64> = cells.iter().map(|c| c.parse().unwrap_or(f64::NAN)).collect();
        Tilted {
            layer: layer(numbers[2], numbers[1]),
            shape: bar(numbers[3], numbers[4]),
            load: load(numbers[5], numbers[6]),
            mode: cells[7].clone(),
            numbers,
        }
    };
    words(text).into_iter().map(row).collect()
}

fn check_tilted(row: &Tilted, contact: &Contact, error: f64) {
    let n = &row.numbers;
    let mode = match contact.mode {
        Mode::Full => "full",
        Mode::LeftLifted => "left",
        _ => "none of these",
    };
    assert_eq!(mode, row.mode, "{n:?}");
    let width = n[3];
    near(contact.x_left_mm, n[8], error * width, "x_left");
    near(contact.x_right_mm, n[9], 1e-12, "x_right");
    let descent = n[12].abs() + n[11].abs() * width;
    near(contact.slope * width, n[11] * width, 10.0 * error * descent, "slope");
    near(contact.delta_mm, n[12], 10.0 * error * descent + 3e-12, "delta");
}

#[test]
fn tilted_bars_are_those_of_the_reference() {
    let tables = [
        (Friction::Proportional, include_str!("fixtures/contact/punch_tilt_prop.csv")),
        (Friction::None, include_str!("fixtures/contact/punch_tilt_none.csv")),
    ];
    for (friction, text) in tables {
        let mut modes = [0, 0, 0];
        for row in &tilted(text) {
            for (level, error) in
                [(Accuracy::Fast, 2e-3), (Accuracy::Default, 1e-6), (Accuracy::Fine, 1e-8)]
            {
                let mut bar = indenter(&row.layer, row.shape, friction, level);
                let outcome = bar.press(&row.load);
                if row.mode == "topples" {
                    assert_eq!(outcome, Err(Refusal::Toppling));
                    modes[2] += 1;
                    continue;
                }
                let contact = outcome.expect("an equilibrium");
                modes[usize::from(contact.mode == Mode::LeftLifted)] += 1;
                check_tilted(row, &contact, error);
                if level != Accuracy::Fast {
                    check_features(row, &bar, level);
                }
                // The mirror image, warm and cold.
                let mirrored = load(row.load.p_n_mm, -row.load.q_n_mm);
                let other = bar.press(&mirrored).expect("the mirror image");
                near(other.x_right_mm, -contact.x_left_mm, 10.0 * error, "mirrored");
            }
        }
        assert!(modes[0] > 100 && modes[1] > 20, "{modes:?}");
    }
}

/// Error of the default accuracy in parts of the fine one's.
const DEFAULT_TO_FINE_ERROR: f64 = 10.0;

/// Moments and the peak carry the error of the accuracy; M0 and M1 are statics.
fn check_features(row: &Tilted, bar: &Indenter, level: Accuracy) {
    let n = &row.numbers;
    let (t, peak) = (n[2], -n[24]);
    let coarse = if level == Accuracy::Fine { 1.0 } else { DEFAULT_TO_FINE_ERROR };
    let forces = bar.point_forces(t);
    let m = moments(&row.layer, &forces, t).m;
    near(m[0], -row.load.p_n_mm, 1e-10, "M0");
    near(m[1], n[14], 1e-10, "M1");
    near(m[2], n[15], 1e-7 * coarse, "M2");
    near(m[3], n[16], 1e-6 * coarse, "M3");
    let stress = Spectrum::new(&row.layer, &forces, t, 40.0);
    let thresholds = [0.01 * peak, 0.1 * peak, 0.5 * peak, 1e-3];
    let part = compressive(&stress, row.load.q_n_mm == 0.0, &thresholds);
    for (k, found) in part.moments.m.iter().enumerate() {
        near(*found, n[18 + k], 2e-7 * coarse, "compressive moment");
    }
    // The place of a flat peak has a larger error than the stress.
    let aside = if level == Accuracy::Fine { 1e-6 } else { 1e-5 };
    near(part.x_peak_mm, n[23], aside, "x_peak");
    near(part.szz_peak_mpa, n[24], 1e-8 * coarse * peak, "peak");
    for (k, found) in part.widths_mm.iter().enumerate() {
        // The reference interpolates its widths to about 3e-5 mm.
        near(*found, n[25 + k], 1e-4, "width");
    }
}

#[test]
fn pressures_and_base_stresses_of_tilted_bars() {
    let solve = |row: &[f64], width: f64| {
        let layer = layer(row[1], row[0]);
        let mut bar = indenter(&layer, bar(width, row[3]), Friction::Proportional, Accuracy::Fine);
        bar.press(&load(row[4], row[5])).expect("a contact");
        (layer, bar)
    };
    let text = include_str!("fixtures/contact/punch_tilt_base_profiles.csv");
    for group in rows(text).chunk_by(|a, b| a[..6] == b[..6]) {
        let (layer, bar) = solve(&group[0], group[0][2]);
        let stress = Spectrum::new(&layer, &bar.point_forces(0.8), 0.8, 40.0);
        let peak = group.iter().map(|row| -row[7]).fold(0.0, f64::max);
        for row in group {
            near(stress.szz(row[6]), row[7], 1e-7 * peak, "szz");
        }
    }
    let text = include_str!("fixtures/contact/punch_tilt_pressure.csv");
    for group in rows(text).chunk_by(|a, b| a[..8] == b[..8]) {
        let (_, bar) = solve(&group[0], group[0][2]);
        for row in group {
            near(bar.pressure_mpa(row[8]), row[9], 3e-7 * (0.1 + row[9]), "p");
        }
    }
}

#[test]
fn loading_is_stiff_as_the_flat_punch_of_the_same_width() {
    let layer = layer(0.8, 0.49);
    let shape = Shape::Cylinder { radius_mm: 25.4 };
    let mut roller = indenter(&layer, shape, Friction::None, Accuracy::Fine);
    let delta = roller.press(&load(8.984, 0.0)).expect("a contact").delta_mm;
    let mut at = |d: f64| {
        let c = roller.descend(d).expect("a contact");
        (c.p_n_mm, c.x_right_mm)
    };
    let h = 1e-5;
    let slope = (at(delta + h).0 - at(delta - h).0) / (2.0 * h);
    let b = at(delta).1;
    let mut punch = indenter(&layer, bar(2.0 * b, 0.0), Friction::None, Accuracy::Fine);
    let stiffness = punch.descend(1.0).expect("a contact").p_n_mm;
    near(slope, stiffness, 1e-6 * stiffness, "dP/d delta");
    let mut known = indenter(&layer, bar(3.0, 0.0), Friction::None, Accuracy::Fine);
    near(known.descend(1.0).expect("a contact").p_n_mm, 510.001_00, 1e-5, "b = 1.5");
}

/// Under q = f p with f above about 2 the layer is pulled off the bar inside the contact, and a
/// solution with tension there is an error.
#[test]
fn a_bar_that_friction_parts_from_the_layer_inside_its_contact_is_refused() {
    let mut parted = 0;
    for (nu, width, ratio, part) in [
        (0.45, 3.0128, -6.0, 0.99),
        (0.4999, 4.981, 6.0, 0.8),
        (0.4999, 39.28, 6.04, 0.99),
        (0.5, 8.97, 6.0, 0.9),
        (0.49, 9.23, 3.0, 0.9),
        (0.49, 9.23, 2.0, 0.9),
        (0.3, 3.0, 3.0, 0.99),
        (0.4999, 0.5, 3.0, 0.5),
    ] {
        let height = part * 0.5 * width / libm::fabs(ratio);
        for level in [Accuracy::Fast, Accuracy::Default, Accuracy::Fine] {
            let layer = layer(1.0, nu);
            let mut bar = indenter(&layer, bar(width, height), Friction::Proportional, level);
            let contact = match bar.press(&load(1e-3, 1e-3 * ratio)) {
                Ok(contact) => contact,
                Err(refusal) => {
                    assert_eq!(refusal, Refusal::SplitContact, "{nu} {width} {ratio}");
                    assert_eq!(bar.contact().mode, Mode::Open);
                    parted += 1;
                    continue;
                }
            };
            let [left, right] = [contact.x_left_mm, contact.x_right_mm];
            for i in 1..400 {
                let x = left + (right - left) * f64::from(i) / 400.0;
                let p = bar.pressure_mpa(x) * (right - left) / 1e-3;
                assert!(p > -1e-2, "{level:?} {nu} {width} {ratio}: {p} at {x}");
            }
        }
    }
    assert_eq!(parted, 15, "five of them, at each level");
}

/// Loads and descents so small that their powers underflow count as none.
#[test]
fn a_negligible_load_is_no_contact() {
    let layer = layer(0.8, 0.49);
    for shape in [bar(6.0, 2.0), Shape::Cylinder { radius_mm: 23.0 }] {
        let mut any = indenter(&layer, shape, Friction::None, Accuracy::Default);
        for small in [5e-324, 1e-308, 1e-101] {
            assert_eq!(any.press(&load(small, 0.0)).expect("none").mode, Mode::Open);
            assert_eq!(any.descend(small).expect("none").mode, Mode::Open);
            assert_eq!(any.press(&load(small, 1e-3)), Err(Refusal::Tension));
        }
        let least = any.press(&load(1e-99, 0.0)).expect("a contact");
        assert!(least.residual < 1e-6 && least.p_n_mm == 1e-99, "{least:?}");
    }
}

/// At the least depth for which the point forces of a traction are valid, the stress equals the
/// pressure up to the square of that depth over the contact's width.
#[test]
fn close_under_the_surface_the_stress_is_the_pressure() {
    let layer = layer(0.8, 0.49);
    for level in [Accuracy::Default, Accuracy::Fine] {
        let shape = Shape::Cylinder { radius_mm: 23.0 };
        let mut roller = indenter(&layer, shape, Friction::None, level);
        let half = roller.press(&load(1.0, 0.0)).expect("a contact").x_right_mm;
        let depth = roller.shallowest_mm();
        assert!(depth < 3e-3 * half, "{depth}");
        let stress = Spectrum::new(&layer, &roller.point_forces(depth), depth, 2.0);
        for i in 0..100 {
            let x = 0.5 * half * f64::from(i) / 100.0;
            let p = roller.pressure_mpa(x);
            near(stress.szz(x), -p, 3e-5 * p, "szz");
        }
    }
}
