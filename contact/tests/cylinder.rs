//! Compares the rigid cylinder on the bonded layer with exact reference data, and checks properties
//! that hold for every contact.

mod contact_data;

use contact_data::rows;
use taktil_contact::cylinder::LineContact;
use taktil_contact::layer::Layer;

const E_MPA: f64 = 27.58;

fn contact(t: f64, nu: f64, radius: f64, most: f64) -> LineContact {
    let layer = Layer::new(t, E_MPA, nu).expect("a sound layer");
    LineContact::new(&layer, radius, most).expect("a sound contact")
}

fn near(found: f64, expected: f64, relative: f64) -> bool {
    (found - expected).abs() <= relative * expected.abs()
}

/// Calls `check` with a contact for each run of rows that share the first three columns.
fn by_contact(
    rows: &[Vec<f64>],
    most: &dyn Fn(&[Vec<f64>]) -> f64,
    check: &dyn Fn(&LineContact, &[f64]),
) {
    for group in rows.chunk_by(|a, b| a[..3] == b[..3]) {
        let contact = contact(group[0][1], group[0][0], group[0][2], most(group));
        group.iter().for_each(|row| check(&contact, row));
    }
}

#[test]
fn a_contact_without_its_base_is_the_same_at_the_surface() {
    let layer = Layer::new(0.8, 2.0, 0.49).unwrap();
    let whole = LineContact::new(&layer, 23.0, 0.16).unwrap();
    let blind = LineContact::without_base(&layer, 23.0, 0.16).unwrap();
    for i in 1..40 {
        let delta = 0.005 * f64::from(i);
        assert_eq!(whole.load_n_mm(delta), blind.load_n_mm(delta));
        assert_eq!(whole.half_width_mm(delta), blind.half_width_mm(delta));
        let stick = |contact: &LineContact| contact.tangential_stiffness_n_mm2(delta);
        assert_eq!(stick(&whole), stick(&blind));
        let shares = [-1e-9, 1e-9].map(|u| blind.base_share(delta, u));
        assert_eq!(shares, [0.0, 1.0], "it stays under its line");
        assert!(blind.base_share(delta, 0.0).is_finite());
    }
    assert!(LineContact::without_base(&layer, 23.0, 0.9).is_err());
    assert!(LineContact::without_base(&layer, f64::NAN, 0.1).is_err());
}

#[test]
fn load_width_and_base_stress_are_those_of_the_reference() {
    let rows = rows(include_str!("fixtures/contact/cylinder_relation.csv"));
    let deepest = |group: &[Vec<f64>]| 1.1 * group.iter().map(|row| row[5]).fold(0.0, f64::max);
    by_contact(&rows, &deepest, &|contact, row| {
        let (t, b, load, delta) = (row[1], row[3], row[4], row[5]);
        assert!(near(contact.load_n_mm(delta), load, 2e-6), "P of {row:?}");
        assert!(near(contact.half_width_mm(delta), b, 2e-6), "b of {row:?}");
        assert!(near(contact.penetration_mm(load), delta, 2e-6), "delta of {row:?}");
        for (u, szz) in [(0.0, row[7]), (0.5 * b, row[8]), (b, row[9]), (b + t, row[10])] {
            let h = 1e-3 * t;
            let rise = contact.base_share(delta, u + h) - contact.base_share(delta, u - h);
            let miss = load * rise / (2.0 * h) + szz;
            assert!(miss.abs() < 2e-4 * row[7].abs(), "szz at {u} of {row:?}: {miss}");
        }
        // Second moment of the base stress, by parts.
        let step = 0.02;
        let beyond = |i: i32| {
            let u = (f64::from(i) + 0.5) * step;
            4.0 * u * (1.0 - contact.base_share(delta, u)) * step
        };
        let second: f64 = -load * (0..1500).map(beyond).sum::<f64>();
        assert!(near(second, row[11], 2e-3), "M2 of {row:?}: {second}");
    });
}

#[test]
fn thick_layers_are_those_of_the_reference() {
    let rows = rows(include_str!("fixtures/contact/cylinder_loads.csv"));
    by_contact(&rows, &|_| 0.4, &|contact, row| {
        let (load, b, delta) = (row[3], row[4], row[5]);
        assert!(near(contact.load_n_mm(delta), load, 1e-5), "P of {row:?}");
        assert!(near(contact.half_width_mm(delta), b, 1e-5), "b of {row:?}");
        assert!(near(contact.penetration_mm(load), delta, 1e-5), "delta of {row:?}");
    });
}

#[test]
fn stuck_contacts_are_as_stiff_as_those_of_the_reference() {
    let rows = rows(include_str!("fixtures/contact/cylinder_stick_relation.csv"));
    by_contact(&rows, &|_| 0.25, &|contact, row| {
        let (mut low, mut high) = (0.0, 0.25);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if contact.half_width_mm(middle) < row[3] { low = middle } else { high = middle }
        }
        let found = contact.tangential_stiffness_n_mm2(low);
        assert!(near(found, row[7], 1e-4), "{row:?}: {found}");
    });
}

#[test]
fn base_shares_are_the_integral_of_the_reference_profiles() {
    let rows = rows(include_str!("fixtures/contact/cylinder_profiles.csv"));
    for group in rows.chunk_by(|a, b| a[..4] == b[..4]) {
        let (load, step) = (group[0][3], group[1][4] - group[0][4]);
        let contact = contact(group[0][1], group[0][0], group[0][2], 0.1);
        let delta = contact.penetration_mm(load);
        let mut integral = 0.0;
        for pair in group.windows(3).step_by(2) {
            // Simpson's rule from 0 to the third point.
            integral -= step / 3.0 * (pair[0][6] + 4.0 * pair[1][6] + pair[2][6]);
            let u = pair[2][4];
            let right = contact.base_share(delta, u);
            assert!((right - 0.5 - integral / load).abs() < 5e-5, "{u} of {:?}", &group[0][..4]);
            assert!((contact.base_share(delta, -u) - (1.0 - right)).abs() < 1e-15);
        }
        assert!(near(integral, 0.5 * load, 5e-3), "most of the load arrives");
    }
}

#[test]
fn stiffness_is_the_loads_derivative_and_that_of_a_flat_punch() {
    let contact = contact(0.8, 0.49, 25.4, 0.2);
    for i in 1..400 {
        let delta = 0.21 * f64::from(i) / 400.0 + 1e-7;
        let h = 1e-6 * delta;
        let found = (contact.load_n_mm(delta + h) - contact.load_n_mm(delta - h)) / (2.0 * h);
        let stiffness = contact.stiffness_n_mm2(delta);
        assert!(near(found, stiffness, 1e-5), "{delta}: {found} {stiffness}");
    }
    let (mut low, mut high) = (0.0, 0.2);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if contact.half_width_mm(middle) < 1.5 { low = middle } else { high = middle }
    }
    let stiffness = contact.stiffness_n_mm2(low);
    assert!(near(stiffness, 510.001, 2e-5), "{stiffness}");
}

#[test]
fn everything_rises_with_penetration() {
    for (t, nu, radius, most) in [
        (0.8, 0.49, 25.4, 0.3),
        (0.5, 0.3, 100.0, 0.2),
        (25.0, 0.5, 5.0, 2.0),
        (3.0, 0.45, 10.0, 1e-5),
    ] {
        let contact = contact(t, nu, radius, most);
        let mut before = [0.0; 4];
        for i in 1..20_000 {
            let part = f64::from(i) / 15_000.0;
            let delta = most * part * part * part;
            let now = [
                contact.load_n_mm(delta),
                contact.stiffness_n_mm2(delta),
                contact.half_width_mm(delta),
                contact.tangential_stiffness_n_mm2(delta),
            ];
            assert!(now[0] > before[0], "load at {delta} of t {t}");
            // The grid is coarse, cell over cell, in the smallest penetrations.
            let slack = if delta < 2e-5 * most { 3e-5 } else { 1e-12 };
            for (k, (now, before)) in now.iter().zip(&before).enumerate().skip(1) {
                assert!(*now >= before - slack * before, "{k} at {delta} of t {t}: {now} {before}");
            }
            assert!(near(contact.penetration_mm(now[0]), delta, 1e-12), "inverse at {delta}");
            before = now;
        }
    }
}

#[test]
fn the_smallest_contacts_are_those_of_hertz() {
    for (t, nu, radius) in [(25.0, 0.3, 5.0), (25.0, 0.5, 100.0), (0.8, 0.49, 25.4)] {
        let contact = contact(t, nu, radius, 1e-7);
        let b = contact.half_width_mm(1e-7);
        let load = core::f64::consts::PI * E_MPA * b * b / (4.0 * radius * (1.0 - nu * nu));
        let found = contact.load_n_mm(1e-7);
        assert!(b > 0.0 && near(found, load, 2e-4), "{t} {nu}: {found} {load}");
    }
}

#[test]
fn beyond_the_table_the_load_is_linear_and_the_rest_stays() {
    let contact = contact(0.8, 0.49, 25.4, 0.1);
    let (load, stiffness) = (contact.load_n_mm(0.1), contact.stiffness_n_mm2(0.1));
    assert_eq!(contact.penetration_max_mm(), 0.1);
    assert!(near(contact.load_n_mm(0.3), load + 0.2 * stiffness, 1e-14));
    assert!(near(contact.stiffness_n_mm2(0.3), stiffness, 1e-12));
    assert!(near(contact.penetration_mm(load + 0.2 * stiffness), 0.3, 1e-14));
    assert_eq!(contact.half_width_mm(1e9), contact.half_width_mm(0.1));
    assert_eq!(contact.base_share(1e9, 0.4), contact.base_share(0.1, 0.4));
    assert_eq!(
        contact.tangential_stiffness_n_mm2(f64::INFINITY),
        contact.tangential_stiffness_n_mm2(0.1)
    );
    assert!(contact.load_n_mm(1e150).is_finite());
}

#[test]
fn without_contact_there_is_no_load_and_no_panic() {
    let contact = contact(0.8, 0.49, 25.4, 0.1);
    for delta in [0.0, -0.0, -1e-3, f64::NEG_INFINITY, f64::NAN] {
        assert_eq!(contact.load_n_mm(delta), 0.0);
        assert_eq!(contact.stiffness_n_mm2(delta), 0.0);
        assert_eq!(contact.half_width_mm(delta), 0.0);
        assert_eq!(contact.penetration_mm(delta), 0.0);
        assert_eq!(contact.tangential_stiffness_n_mm2(delta), 0.0);
        assert!((contact.base_share(delta, 0.0) - 0.5).abs() < 1e-15);
    }
    assert!(contact.load_n_mm(f64::MIN_POSITIVE) >= 0.0);
    for load in [f64::MIN_POSITIVE * f64::EPSILON, f64::MIN_POSITIVE, 1e-30] {
        assert!((0.0..1e-9).contains(&contact.penetration_mm(load)), "{load}");
    }
    assert!(contact.load_n_mm(1e-30) >= 0.0 && contact.half_width_mm(1e-30) >= 0.0);
    assert!(contact.base_share(0.05, f64::NAN).is_nan());
}

#[test]
fn base_shares_run_from_nothing_to_all() {
    let contact = contact(0.8, 0.49, 25.4, 0.1);
    for delta in [0.0, 1e-6, 0.03, 0.1, 1.0] {
        for far in [25.0, 1e6, f64::INFINITY] {
            assert_eq!(contact.base_share(delta, far), 1.0);
            assert_eq!(contact.base_share(delta, -far), 0.0);
        }
        let shares = contact.base_shares(delta);
        let mut before = 0.0;
        for i in -2500..=2500 {
            let u = f64::from(i) * 0.01;
            let share = shares.left_of(u);
            assert_eq!(share, contact.base_share(delta, u));
            assert!(share >= before - 1e-6, "no base tension at nu 0.49: {delta} {u}");
            assert!(share - before < 0.04, "no jump: {delta} {u}");
            before = share;
        }
    }
    let layer = Layer::new(0.8, E_MPA, 0.49).expect("a sound layer");
    let slope = (contact.base_share(0.0, 1e-3) - contact.base_share(0.0, -1e-3)) / 2e-3;
    assert!(near(slope, -layer.base_szz_line(0.0), 1e-4), "a line load at zero penetration");
}

#[test]
fn extreme_geometry_is_solved_or_refused() {
    for (t, nu, radius, most) in [
        (25.0, 0.5, 100.0, 5.0),
        (25.0, 0.3, 5.0, 1.5),
        (0.5, 0.5, 100.0, 0.2),
        (0.3, 0.49, 5.0, 0.15),
        (1e-2, 0.3, 5.0, 1e-4),
    ] {
        let contact = contact(t, nu, radius, most);
        assert!(contact.load_n_mm(most) > 0.0 && contact.half_width_mm(most) < radius);
        assert!(contact.load_n_mm(0.5 * most) < 0.5 * contact.load_n_mm(most), "it stiffens");
    }
    let layer = Layer::new(25.0, E_MPA, 0.5).expect("a sound layer");
    for (radius, most) in [(5.0, 10.0), (5.0, 25.0), (0.1, 1.0)] {
        let refused = LineContact::new(&layer, radius, most).expect_err("too deep");
        assert_eq!(refused.place, "penetration_max_mm");
    }
    let thin = Layer::new(0.05, E_MPA, 0.5).expect("a sound layer");
    assert!(LineContact::new(&thin, 100.0, 0.04).is_err(), "wider than 80 thicknesses");
}

#[test]
fn invalid_cylinders_are_refused_with_the_field_named() {
    let layer = Layer::new(0.8, E_MPA, 0.49).expect("a sound layer");
    for bad in [f64::NAN, f64::INFINITY, 0.0, -1.0] {
        let place = |r: f64, d: f64| LineContact::new(&layer, r, d).expect_err("bad").place;
        assert_eq!(place(bad, 0.1), "radius_mm");
        assert_eq!(place(25.4, bad), "penetration_max_mm");
    }
    let unchecked = Layer { poisson: f64::NAN, ..layer };
    assert_eq!(LineContact::new(&unchecked, 25.4, 0.1).expect_err("nu").place, "poisson");
}
