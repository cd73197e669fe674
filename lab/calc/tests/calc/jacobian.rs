//! `feature_jacobian` of plane contacts through the filter: against differences of `contact_2d`,
//! against reference data, undefined entries, and one error line for each impossible request.

use serde_json::{Value, json};

use crate::ask::{ask, ask_text, flat};

fn contact(fields: Value) -> Value {
    let mut request = json!({"op": "contact_2d", "t_mm": 0.8, "nu": 0.49});
    for (key, value) in fields.as_object().unwrap() {
        request[key] = value.clone();
    }
    request
}

fn jacobian(contact: &Value, more: Value) -> Value {
    let mut request = json!({"op": "feature_jacobian", "contact": contact});
    for (key, value) in more.as_object().unwrap() {
        request[key] = value.clone();
    }
    request
}

/// Features of a contact by their names in the answer.
fn features(request: &Value) -> Vec<f64> {
    let answer = ask(std::slice::from_ref(request)).remove(0);
    let full = &answer["features"]["full"];
    let part = &answer["features"]["compressive"];
    let of = |from: &Value, name: &str| from[name].as_f64().unwrap();
    vec![
        of(full, "m0"),
        of(full, "m1"),
        of(full, "m2"),
        of(full, "m3"),
        of(part, "m0"),
        of(part, "m2"),
        of(part, "szz_peak"),
    ]
}

const NAMES: [&str; 7] = ["m0", "m1", "m2", "m3", "m0_c", "m2_c", "szz_peak"];

#[test]
fn a_descent_is_the_difference_of_two_contacts() {
    for (shape, dz) in [
        (json!({"flat": {"width_mm": 7.9}}), 0.001),
        (json!({"cylinder": {"radius_mm": 18.0}}), 0.03),
        (json!({"profile": {"x_mm": [-2, 0, 2], "z_mm": [0.1, 0, 0.1]}}), 0.02),
    ] {
        for method in ["layer", "fem"] {
            let at = |dz: f64| {
                contact(json!({"shape": shape, "move": {"dz_mm": dz}, "level": "fine",
                    "method": method, "mesh": [128, 8]}))
            };
            let asked = json!({"features": NAMES, "motions": ["dz"]});
            let found = flat(&ask(&[jacobian(&at(dz), asked)])[0]["j"]);
            let h = 1e-4 * dz;
            let (more, less) = (features(&at(dz + h)), features(&at(dz - h)));
            for i in 0..NAMES.len() {
                let expected = (more[i] - less[i]) / (2.0 * h);
                let bar = 2e-5 * (expected.abs() + more[i].abs() / dz) + 1e-6 * found[0].abs();
                let off = (found[i] - expected).abs();
                assert!(off < bar, "{shape} {method} {}: {} {expected}", NAMES[i], found[i]);
            }
        }
    }
}

#[test]
fn the_thesis_two_by_two_and_its_condition() {
    // Glued, b = 1.5, R = 22.9 of the reference: P = 11.123 at R = 25.4 scales with 1/R.
    let roll = json!({"cylinder": {"radius_mm": 22.9}});
    let glued = contact(json!({
        "shape": roll, "load": {"p_n_mm": 11.123 * 25.4 / 22.9}, "friction": "stick"
    }));
    let answer = &ask(&[jacobian(&glued, json!({}))])[0];
    let (j, errors) = (flat(&answer["j"]), flat(&answer["error_estimate"]));
    assert!(j[0].abs() < 1e-6 && (j[1] / -676.947 - 1.0).abs() < 1e-3, "{j:?}");
    assert!((j[2] / -68.2 - 1.0).abs() < 1e-2 && j[3].abs() < 1e-6, "{j:?}");
    assert!(errors.iter().all(|error| *error < 1e-3 * 676.9), "{errors:?}");
    // The matrix is diagonal up to the order of its rows: the condition is the ratio of its two
    // entries.
    let condition = answer["condition"].as_f64().unwrap();
    assert!((condition / (j[1] / j[2]) - 1.0).abs() < 1e-6, "{condition}");
    // Without friction the image slides along with the cylinder: dM1/dx = M0.
    let free = contact(json!({"shape": roll, "load": {"p_n_mm": 2}, "level": "fine"}));
    let free = &ask(&[jacobian(&free, json!({"features": ["m1", "x_c", "x_peak"]}))])[0];
    let j = flat(&free["j"]);
    assert!((j[0] + 2.0).abs() < 1e-9 && j[2] == 1.0 && j[4] == 1.0, "{j:?}");
}

#[test]
fn a_tilted_bar_under_every_friction() {
    let bar = json!({"flat": {"width_mm": 12.7}});
    let asked = json!({"features": ["m0", "m1"], "motions": ["dz", "ry"]});
    let of = |friction: Value, level: &str| {
        let q = if friction == "stick" { 0.05 } else { 0.3 };
        let load = json!({"p_n_mm": 0.7, "q_n_mm": q});
        let held = contact(json!({
            "shape": bar, "load": load, "friction": friction, "level": level
        }));
        let answer = ask(&[jacobian(&held, asked.clone())]).remove(0);
        let (j, errors) = (flat(&answer["j"]), flat(&answer["error_estimate"]));
        assert!(answer["condition"].as_f64().unwrap() > 1.0);
        (j, errors)
    };
    for friction in [json!("none"), json!("prop")] {
        let ((a, _), (b, errors)) = (of(friction.clone(), "fine"), of(friction, "default"));
        for i in 0..4 {
            assert!((a[i] - b[i]).abs() <= 1.01 * errors[i] + 1e-9 * a[i].abs(), "{a:?} {b:?}");
            assert!(errors[i] < 1e-4 * b[i].abs(), "{b:?} {errors:?}");
        }
        assert!(a[0] < 0.0 && a[3] < 0.0, "{a:?}");
    }
    for friction in [json!({"coulomb": 0.9}), json!({"coulomb": 3.0}), json!("stick")] {
        let (j, errors) = of(friction, "fast");
        assert!(j.iter().chain(&errors).all(|value| value.is_finite()));
        assert!(j[0] < 0.0 && j[3] < 0.0, "{j:?}");
    }
}

/// The edge of a contact on cells is known to one cell: the stated error covers the difference from
/// the exact entry on a coarse mesh, and is at most a hundred times too large.
#[test]
fn errors_stated_on_places_cover_the_exact_entry() {
    let asked = json!({"features": ["m0", "m2", "szz_peak"], "motions": ["dz"]});
    let x: Vec<f64> = (-300..=300).map(|i| 0.03 * f64::from(i)).collect();
    for (radius, p) in [(23.0_f64, 0.7), (23.0, 5.0), (10.0, 2.0), (23.0, 0.1)] {
        let z: Vec<f64> = x.iter().map(|x| radius - (radius * radius - x * x).sqrt()).collect();
        let roll = json!({"cylinder": {"radius_mm": radius}});
        let profile = json!({"profile": {"x_mm": x, "z_mm": z}});
        let load = json!({"p_n_mm": p});
        let exact = jacobian(
            &contact(json!({"shape": roll, "load": load, "level": "fine"})),
            asked.clone(),
        );
        let mut requests = vec![exact];
        for level in ["fast", "default", "fine"] {
            let on = contact(json!({"shape": profile, "load": load, "level": level}));
            requests.push(jacobian(&on, asked.clone()));
        }
        for mesh in [[48, 3], [64, 4], [128, 8]] {
            let on = json!({"shape": roll, "load": load, "method": "fem", "mesh": mesh});
            requests.push(jacobian(&contact(on), asked.clone()));
        }
        let answers = ask(&requests);
        let exact = flat(&answers[0]["j"]);
        for (answer, request) in answers.iter().zip(&requests).skip(1) {
            // On one or two nodes no error is known.
            if p < 0.5 && answer["error_estimate"][0].is_null() {
                assert_eq!(request["contact"]["method"], "fem", "{request}");
                continue;
            }
            let errors = flat(&answer["error_estimate"]);
            for (i, found) in flat(&answer["j"]).iter().enumerate() {
                let off = (found - exact[i]).abs();
                assert!(off <= errors[i], "{request}: {found} {} {}", exact[i], errors[i]);
                let most = if request["contact"]["method"] == "fem" { 10.0 } else { 0.15 };
                assert!(errors[i] < most * exact[i].abs(), "{request}: {errors:?} {exact:?}");
            }
        }
    }
}

/// The descent of a glued cylinder under shear is that of `contact_2d` by a move.
#[test]
fn the_descent_of_a_sheared_cylinder_is_that_of_its_contacts() {
    let roll = json!({"cylinder": {"radius_mm": 22.9}});
    let at = |dz: f64, dx: f64| {
        let drive = json!({"dz_mm": dz, "dx_mm": dx});
        contact(json!({"shape": roll, "move": drive, "friction": "stick"}))
    };
    let asked = json!({"features": NAMES, "motions": ["dz", "dx"]});
    let answer = &ask(&[jacobian(&at(0.005, 0.02), asked)])[0];
    let (j, errors) = (flat(&answer["j"]), flat(&answer["error_estimate"]));
    for (column, h, [z, x]) in [(0, 2e-6, [1.0, 0.0]), (1, 1e-5, [0.0, 1.0])] {
        let side = |side: f64| features(&at(0.005 + side * h * z, 0.02 + side * h * x));
        let (more, less) = (side(1.0), side(-1.0));
        for row in 0..NAMES.len() {
            let (found, error) = (j[2 * row + column], errors[2 * row + column]);
            let expected = (more[row] - less[row]) / (2.0 * h);
            let bar = error + 2e-4 * expected.abs() + 2e-4;
            assert!((found - expected).abs() < bar, "{}: {found} {expected} {error}", NAMES[row]);
            assert!(error < 1e-3 * (1.0 + found.abs()), "{}: {found} {error}", NAMES[row]);
        }
    }
}

#[test]
fn undefined_entries_are_null() {
    let knife = contact(json!({"shape": {"knife": {}}, "load": {"p_n_mm": 1, "q_n_mm": 0.2}}));
    let six = json!({"motions": ["dx", "dy", "dz", "rx", "ry", "rz"], "features": ["m1", "x_c"]});
    let answer = &ask(&[jacobian(&knife, six.clone())])[0];
    let null = Value::Null;
    assert_eq!(answer["j"][0].as_f64().map(|j| (j + 1.0).abs() < 1e-12), Some(true));
    assert_eq!(answer["j"][1], json!(0.0));
    for column in 2..6 {
        assert_eq!((&answer["j"][column], &answer["error_estimate"][column]), (&null, &null));
    }
    assert_eq!(answer["condition"], null);
    for shape in [
        json!({"knife": {}}),
        json!({"flat": {"width_mm": 5}}),
        json!({"cylinder": {"radius_mm": 5}}),
    ] {
        for friction in ["none", "prop", "stick"] {
            let open = contact(json!({
                "shape": shape, "load": {"p_n_mm": 0}, "friction": friction
            }));
            let answer = &ask(&[jacobian(&open, six.clone())])[0];
            assert!(answer["j"].as_array().unwrap().iter().all(Value::is_null), "{answer}");
            assert_eq!(answer["condition"], null);
        }
    }
}

#[test]
fn impossible_requests_are_one_error_line_and_the_filter_goes_on() {
    let bar = json!({"flat": {"width_mm": 12.7}});
    let good = contact(json!({"shape": bar, "load": {"p_n_mm": 1}}));
    let bad = |fields: Value| contact(fields);
    let wrong = [
        (jacobian(&good, json!({"features": ["mu_xx"]})), "unknown_value", "features[0]"),
        (jacobian(&good, json!({"features": ["m0", "up"]})), "unknown_value", "features[1]"),
        (jacobian(&good, json!({"motions": ["dw"]})), "unknown_value", "motions[0]"),
        (jacobian(&good, json!({"motions": []})), "out_of_range", "motions"),
        (
            jacobian(&bad(json!({"shape": bar, "load": {"p_n_mm": 1}, "t_mm": -1})), json!({})),
            "out_of_range",
            "contact.t_mm",
        ),
        (
            jacobian(&bad(json!({"shape": bar, "load": {"p_n_mm": 1}, "nu": 0.6})), json!({})),
            "out_of_range",
            "contact.nu",
        ),
        (
            jacobian(&bad(json!({"shape": {"ball": {}}, "load": {"p_n_mm": 1}})), json!({})),
            "unknown_field",
            "contact.shape.ball",
        ),
        (
            jacobian(&bad(json!({"shape": bar, "load": {"p_n_mm": 1, "q_n_mm": 2}})), json!({})),
            "topples",
            "contact.load",
        ),
        (
            jacobian(
                &bad(json!({"shape": {"cylinder": {"radius_mm": 1}}, "load": {"p_n_mm": 1e9}})),
                json!({}),
            ),
            "unreachable",
            "contact.load",
        ),
        (json!({"op": "feature_jacobian"}), "missing_field", "contact"),
        (json!({"op": "feature_jacobian", "contact": 3}), "wrong_type", "contact"),
    ];
    for (request, code, field) in wrong {
        let text = format!("{request}\n{}\n", jacobian(&good, json!({})));
        let answers = ask_text(text.as_bytes());
        let error = &answers[0]["error"];
        assert_eq!((&error["code"], &error["field"]), (&json!(code), &json!(field)), "{error}");
        assert_eq!(answers[1]["ok"], true, "{}", answers[1]);
    }
}
