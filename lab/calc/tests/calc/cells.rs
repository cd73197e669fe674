//! Contacts that `contact_2d` solves on cells, which cover the contact under any load. The tests
//! compare results over the contact, not single cells.

use serde_json::{Value, json};

use crate::ask::ask_text;

fn contact(fields: &Value) -> Value {
    let mut request = json!({"op": "contact_2d", "t_mm": 0.8, "nu": 0.49});
    for (key, value) in fields.as_object().unwrap() {
        request[key] = value.clone();
    }
    ask_text(format!("{request}\n").as_bytes()).remove(0)
}

fn number(answer: &Value, path: &str) -> f64 {
    answer.pointer(path).and_then(Value::as_f64).unwrap_or_else(|| panic!("{path}: {answer}"))
}

fn cylinder(radius_mm: f64) -> Value {
    json!({"cylinder": {"radius_mm": radius_mm}})
}

/// A circle, 40 mm wide, in chords of 0.1 mm.
fn circle(radius: f64) -> Value {
    let x: Vec<f64> = (-200..=200).map(|i| 0.1 * f64::from(i)).collect();
    let z: Vec<f64> = x.iter().map(|x| radius - (radius * radius - x * x).sqrt()).collect();
    json!({"profile": {"x_mm": x, "z_mm": z}})
}

/// Checks the ends, as a fraction of the width, and the peak stress.
fn agree(found: &Value, exact: &Value, bars: [f64; 2]) {
    let width = number(exact, "/x_right_mm") - number(exact, "/x_left_mm");
    for end in ["/x_left_mm", "/x_right_mm"] {
        let miss = (number(found, end) - number(exact, end)).abs() / width;
        assert!(miss < bars[0], "{end}: {miss} {found} {exact}");
    }
    let peak = "/features/compressive/szz_peak";
    let miss = (number(found, peak) / number(exact, peak) - 1.0).abs();
    assert!(miss < bars[1], "peak: {miss} {found} {exact}");
}

/// Shear widens a contact on one side to several times its width without shear: the cells have to
/// reach that far.
#[test]
fn cells_reach_as_far_as_a_sheared_contact() {
    for (p, q) in [(0.7_f64, 2.1_f64), (0.7, -2.1), (5.0, 15.0), (0.05, 0.1), (5.0, 1.0)] {
        let load = json!({"p_n_mm": p, "q_n_mm": q});
        let ask = |shape: Value, friction: Value| {
            contact(&json!({"shape": shape, "load": load, "friction": friction}))
        };
        let exact = ask(cylinder(23.0), json!("prop"));
        agree(&ask(circle(23.0), json!("prop")), &exact, [0.02, 2e-3]);
        // Almost all of the contact slips.
        let limit = json!({"coulomb": (q / p).abs() * 1.000_05});
        agree(&ask(cylinder(23.0), limit.clone()), &exact, [0.02, 2e-3]);
        agree(&ask(circle(23.0), limit), &exact, [0.02, 2e-3]);
    }
}

#[test]
fn a_circle_held_by_friction_is_the_same_as_profile_and_as_cylinder() {
    for friction in [json!({"coulomb": 0.5}), json!({"coulomb": 1.5}), json!({"coulomb": 4.0})] {
        for drive in [
            ("load", json!({"p_n_mm": 5, "q_n_mm": 2.4})),
            ("load", json!({"p_n_mm": 0.7, "q_n_mm": -0.1})),
            ("move", json!({"dz_mm": 0.03, "dx_mm": 0.02})),
            ("move", json!({"dz_mm": 0.01, "dx_mm": -0.5})),
        ] {
            let ask = |shape: Value| {
                contact(&json!({"shape": shape, drive.0: drive.1, "friction": friction}))
            };
            agree(&ask(circle(23.0)), &ask(cylinder(23.0)), [0.02, 5e-3]);
        }
    }
}

/// A profile is searched first: one that is far wider than its contact, on a thin layer, gets cells
/// at its contact.
#[test]
fn a_profile_of_a_thousand_thicknesses_is_searched() {
    let x: Vec<f64> = (-1000..=1000).map(|i| 0.05 * f64::from(i)).collect();
    let z: Vec<f64> = x.iter().map(|x| 60.0 - (3600.0 - x * x).sqrt()).collect();
    let profile = json!({"profile": {"x_mm": x, "z_mm": z}});
    let ask = |shape: Value| {
        let load = json!({"p_n_mm": 1, "q_n_mm": 0.5});
        contact(&json!({"shape": shape, "load": load, "friction": "prop", "t_mm": 0.1}))
    };
    agree(&ask(profile), &ask(cylinder(60.0)), [0.02, 2e-3]);
}

/// A profile may be in contact up to its own end; a circle is vertical at its end and touches
/// before.
#[test]
fn contacts_end_inside_their_cells_or_with_the_shape() {
    let short = json!({"profile": {"x_mm": [-0.5, 0, 0.5], "z_mm": [0.001, 0, 0.001]}});
    let load = json!({"p_n_mm": 1, "q_n_mm": 1});
    let answer = contact(&json!({"shape": short, "load": load, "friction": "prop"}));
    assert_eq!(number(&answer, "/x_right_mm"), 0.5, "{answer}");
    for (p, is_whole) in [(2.0, true), (10.0, true), (100.0, false)] {
        let load = json!({"p_n_mm": p, "q_n_mm": 3.0 * p});
        let friction = json!({"coulomb": 3.15});
        let shape = cylinder(0.2);
        let answer = contact(&json!({"shape": shape, "load": load, "friction": friction}));
        assert_eq!(answer["ok"], is_whole, "{answer}");
        if is_whole {
            assert!(number(&answer, "/x_right_mm") < 0.98 * 0.2, "{answer}");
        } else {
            assert_eq!(answer["error"]["code"], "unreachable", "{answer}");
        }
    }
}

/// The cylinder's own solver grows its contact in infinitesimal steps, the solver on cells in
/// finite ones.
#[test]
fn a_circle_that_sticks_is_the_cylinder() {
    for (radius, p) in [(23.0, 0.5), (23.0, 5.0), (40.0, 2.0)] {
        let x: Vec<f64> = (-40..=40).map(|i| 0.01 * f64::from(i)).collect();
        let under = |shape: Value| {
            let load = json!({"p_n_mm": p});
            let answer =
                contact(&json!({"shape": shape, "load": load, "friction": "stick", "x_mm": x}));
            let szz = answer["szz"].as_array().unwrap_or_else(|| panic!("{answer}"));
            szz.iter().filter_map(Value::as_f64).fold(0.0, f64::min)
        };
        let off = under(circle(radius)) / under(cylinder(radius)) - 1.0;
        assert!(off.abs() < 3e-3, "{radius} {p}: {off:e}");
    }
}
