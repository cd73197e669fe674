//! Contact in three dimensions through the filter: reference images, features, Jacobians, and one
//! error line for each impossible request.

use core::f64::consts::FRAC_PI_2;

use serde_json::{Value, json};

use crate::ask::{Table, ask, ask_text, flat};

fn request(table: &Table, row: usize) -> Value {
    let number = |name: &str| table.number(row, name);
    let (x, y) = (number("x0"), number("y0"));
    let radius = number("R_mm");
    let rot = number("rot_deg").to_radians();
    let mut request = json!({
        "op": "contact_3d", "t_mm": number("t_mm"), "nu": number("nu"),
        "sampling": if table.word(row, "sampling") == "average" { "area" } else { "centre" },
    });
    match table.word(row, "shape") {
        "sphere" => {
            request["shape"] = json!({"sphere": {"radius_mm": radius, "x_mm": x, "y_mm": y}});
            request["force_n"] = json!(number("F_or_P"));
        }
        "inf_cylinder" => {
            request["shape"] =
                json!({"cylinder": {"radius_mm": radius, "x_mm": x, "y_mm": y, "rot_rad": rot}});
            request["force_n"] = json!(number("F_or_P"));
        }
        _ => {
            request["shape"] = json!({"cylinder": {
                "radius_mm": radius, "length_mm": number("L_mm"), "x_mm": x, "y_mm": y,
                "rot_rad": rot, "tilt_rad": number("tilt_rad"),
            }});
            request["penetration_mm"] = json!(number("delta_mm"));
        }
    }
    request
}

#[test]
fn every_reference_contact_comes_out_of_the_filter() {
    let table = Table::read("contact/tactile3d_features.csv", 52);
    let requests: Vec<Value> = (0..table.len()).map(|row| request(&table, row)).collect();
    for (row, answer) in ask(&requests).iter().enumerate() {
        let name = format!("{} {}", table.word(row, "case"), table.word(row, "sampling"));
        assert_eq!(flat(&answer["image"]).len(), 256, "{name}");
        let pin = table.word(row, "shape") == "cylinder";
        let bar = if pin { 1e-3 } else { 1e-7 };
        let near = |got: f64, wanted: f64, bar: f64| {
            assert!((got / wanted - 1.0).abs() < bar, "{name}: {got} for {wanted}");
        };
        near(answer["force_n"].as_f64().unwrap(), table.number(row, "F_or_P"), bar);
        near(answer["delta_mm"].as_f64().unwrap(), table.number(row, "delta_mm"), bar);
        assert!(answer["residual"].as_f64().unwrap() < 2e-4, "{name}");
        // Sums over the image; the reference itself is inaccurate at the ends of the short pin.
        let short = pin && table.number(row, "L_mm") < 20.0;
        let bar = if short { 6e-3 } else { 5e-4 };
        for column in ["M0", "M0_c"] {
            let got = answer["features"][column].as_f64().unwrap();
            near(got, table.number(row, column), bar);
        }
        for column in ["xc", "yc", "xc_c", "yc_c"] {
            let off = answer["features"][column].as_f64().unwrap() - table.number(row, column);
            assert!(off.abs() < if short { 5e-3 } else { 1e-3 }, "{name} {column}: {off}");
        }
    }
}

/// A valid request.
fn good() -> Value {
    json!({
        "op": "contact_3d", "shape": {"sphere": {"radius_mm": 10}}, "t_mm": 0.8, "nu": 0.49,
        "force_n": 5, "rows": 2, "cols": 2,
    })
}

/// Each request fails with this code and field, and the valid one after it is answered.
fn all_refused(good: &Value, bad: &[(Value, &str, &str)]) {
    let mut text = String::new();
    for (request, _, _) in bad {
        text.push_str(&format!("{request}\n{good}\n"));
    }
    let answers = ask_text(text.as_bytes());
    assert_eq!(answers.len(), 2 * bad.len());
    for ((request, code, field), pair) in bad.iter().zip(answers.chunks_exact(2)) {
        let error = &pair[0]["error"];
        let found = (error["code"].as_str().unwrap_or(""), error["field"].as_str().unwrap_or(""));
        assert_eq!(found, (*code, *field), "{request}: {}", pair[0]);
        assert_eq!(pair[1]["ok"], true);
    }
}

#[test]
fn impossible_requests_are_one_error_line_and_the_filter_goes_on() {
    let good = good();
    let with = |key: &str, value: Value| {
        let mut request = good.clone();
        request[key] = value;
        request
    };
    let both = with("penetration_mm", json!(0.01));
    let bad = [
        (with("shape", json!({"cone": {}})), "unknown_field", "shape.cone"),
        (with("shape", json!({})), "wrong_type", "shape"),
        (with("shape", json!({"sphere": {}})), "missing_field", "shape.sphere.radius_mm"),
        (
            with("shape", json!({"sphere": {"radius_mm": -1}})),
            "out_of_range",
            "shape.sphere.radius_mm",
        ),
        (with("t_mm", json!(-0.8)), "out_of_range", "t_mm"),
        (with("nu", json!(0.500_001)), "out_of_range", "nu"),
        (with("nu", json!(-1.0)), "out_of_range", "nu"),
        (with("youngs_mpa", json!(0)), "out_of_range", "youngs_mpa"),
        (with("force_n", json!(1e9)), "out_of_range", "force_n"),
        (with("force_n", json!(-1)), "out_of_range", "force_n"),
        (with("pitch_mm", json!(0)), "out_of_range", "pitch_mm"),
        (with("sampling", json!("mean")), "unknown_value", "sampling"),
        (with("level", json!("best")), "unknown_value", "level"),
        (with("part", json!("tensile")), "unknown_value", "part"),
        (with("shape", json!({"edge": {"tilt_rad": 0.1}})), "unknown_field", "shape.edge.tilt_rad"),
        (
            json!({"op": "contact_3d", "shape": {"cylinder": {"radius_mm": 23, "length_mm": 30}},
                "t_mm": 0.8, "nu": 0.49, "youngs_mpa": 1e11, "force_n": 5}),
            "unreachable",
            "force_n",
        ),
        (both, "conflict", "force_n"),
        (
            json!({"op": "contact_3d", "shape": {"edge": {}}, "t_mm": 0.8, "nu": 0.49,
                "penetration_mm": 0.1}),
            "out_of_range",
            "penetration_mm",
        ),
        (
            json!({"op": "contact_3d", "t_mm": 0.8, "nu": 0.49, "penetration_mm": 0.01,
                "shape": {"cylinder": {"radius_mm": 9, "length_mm": 9, "tilt_rad": 0.5}}}),
            "out_of_range",
            "shape.cylinder.tilt_rad",
        ),
    ];
    all_refused(&good, &bad);
}

#[test]
fn impossible_jacobians_are_rejected() {
    let good = good();
    let mut wrong = good.clone();
    wrong["nu"] = json!(0.6);
    let bad = [
        (json!({"op": "feature_jacobian", "contact": wrong}), "out_of_range", "contact.nu"),
        (json!({"op": "feature_jacobian", "contact": {"op": "fk"}}), "unknown_op", "contact.op"),
        (
            json!({"op": "feature_jacobian", "contact": good, "motions": ["dx", "up"]}),
            "unknown_value",
            "motions[1]",
        ),
        (
            json!({"op": "feature_jacobian", "contact": good, "features": []}),
            "out_of_range",
            "features",
        ),
    ];
    all_refused(&good, &bad);
}

#[test]
fn an_empty_contact_has_no_centroid_and_tables_are_not_timed() {
    let mut request = json!({
        "op": "contact_3d", "shape": {"cylinder": {"radius_mm": 23, "length_mm": 10}},
        "t_mm": 0.8, "nu": 0.49, "penetration_mm": -0.1, "rows": 3, "cols": 5,
    });
    let empty = &ask(&[request.clone()])[0];
    assert_eq!(flat(&empty["image"]), vec![0.0; 15]);
    assert_eq!(empty["features"]["xc"], Value::Null);
    assert_eq!(empty["force_n"], 0.0);
    request["penetration_mm"] = json!(0.02);
    request["timing"] = json!(true);
    request["repeat"] = json!(3);
    for start in ["cold", "warm"] {
        request["start"] = json!(start);
        let answer = &ask(&[request.clone()])[0];
        assert!(answer["ns"].as_u64().unwrap() > 0);
        assert!(answer["force_n"].as_f64().unwrap() > 1.0);
    }
}

#[test]
fn a_jacobian_of_the_thesis_through_the_filter() {
    let contact = json!({
        "shape": {"cylinder": {"radius_mm": 23, "length_mm": 50}}, "t_mm": 0.8, "nu": 0.49,
        "penetration_mm": 0.03,
    });
    let six = json!(["dx", "dy", "dz", "rx", "ry", "rz"]);
    let answers = ask(&[
        json!({"op": "feature_jacobian", "contact": contact}),
        json!({"op": "feature_jacobian", "contact": contact, "features": ["m0", "x_c"],
            "motions": six}),
        json!({"op": "feature_jacobian", "motions": ["dx", "dz"], "features": ["M0", "xc"],
            "contact": {"shape": {"edge": {}}, "t_mm": 0.8, "nu": 0.49, "force_n": 1}}),
    ]);
    let j = flat(&answers[0]["j"]);
    assert_eq!(j.len(), 16);
    assert!(answers[0]["condition"].as_f64().unwrap() > 1e3);
    let error = flat(&answers[0]["error_estimate"]);
    assert!(error[5] < 1e-2 * j[5].abs());
    let wide = flat(&answers[1]["j"]);
    assert_eq!(wide.len(), 12);
    assert!((wide[2] / j[5] - 1.0).abs() < 1e-3, "dM0/dz is the same in both");
    // A line load has an infinite penetration, so its depth has no derivative.
    assert_eq!(answers[2]["j"][1], Value::Null);
    assert_eq!(answers[2]["condition"], Value::Null);
    assert!(answers[2]["j"][2].as_f64().unwrap() > 0.5);
}

#[test]
fn a_compressive_image_is_the_image_without_its_tension() {
    // A layer that is thin under its tactels and compressible has tension around the ball.
    let request = |part: &str| {
        json!({
            "op": "contact_3d", "t_mm": 1.2, "nu": 0.2, "force_n": 2.0, "pitch_mm": 0.6,
            "shape": {"sphere": {"radius_mm": 5.0, "x_mm": 0, "y_mm": 0}}, "part": part
        })
    };
    let answers = ask(&[request("full"), request("compressive")]);
    let [full, felt] = [flat(&answers[0]["image"]), flat(&answers[1]["image"])];
    assert!(full.iter().any(|s| *s > 0.0), "nothing to leave out");
    assert!(full.iter().zip(&felt).all(|(s, f)| *f == s.min(0.0)));
    assert_eq!(answers[0]["features"], answers[1]["features"]);
}

/// Over a pad a pin is cut to the piece over the array, also when it is turned, moved or tilted.
#[test]
fn a_pin_longer_than_the_pad_is_cut_at_it() {
    let cylinder = |length: f64, [x, y, rot, tilt]: [f64; 4], drive: (&str, f64), beyond: &str| {
        let mut request = json!({
            "op": "contact_3d", "t_mm": 0.8, "nu": 0.49, "level": "fast", "beyond": beyond,
            "shape": {"cylinder": {"radius_mm": 23, "length_mm": length, "x_mm": x, "y_mm": y,
                "rot_rad": rot, "tilt_rad": tilt}},
        });
        request[drive.0] = json!(drive.1);
        request
    };
    let depth = ("penetration_mm", 0.03);
    // Each case has the length and the middle of the pin's piece over the array of 25.4 mm.
    let shifted = 6.0_f64;
    let cases = [
        ([0.0, 0.0, 0.0, 0.0], 25.4, 0.0),
        ([1.0, 0.0, 0.0, 1e-3], 25.4, 0.0),
        ([0.0, 0.0, 0.5, -1e-3], 25.4 / libm::cos(0.5), 0.0),
        ([2.0, shifted, 0.0, 1e-3], 25.4, -shifted),
    ];
    for (pose, length, middle) in cases {
        let [x, y, rot, tilt] = pose;
        let piece = [x, y + middle, rot, tilt];
        let deeper = ("penetration_mm", depth.1 + middle * libm::tan(tilt));
        let asked = [
            cylinder(200.0, pose, depth, "nothing"),
            cylinder(length, piece, deeper, "layer"),
            cylinder(length, piece, deeper, "nothing"),
        ];
        let answers = ask(&asked);
        let [cut, short, same] = [0, 1, 2].map(|n| answers[n]["force_n"].as_f64().unwrap());
        // The images differ in the fourth digit, because the tables are computed for depths about
        // the origin, which differs.
        assert!((cut / short - 1.0).abs() < 1e-3 && cut > 1.0, "{pose:?}: {cut} for {short}");
        assert!((same / short - 1.0).abs() < 1e-9, "{pose:?}: {same} for {short}");
        let [cut, short] = [0, 1].map(|n| flat(&answers[n]["image"]));
        let peak = short.iter().fold(0.0_f64, |most, v| most.max(v.abs()));
        let off = cut.iter().zip(&short).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off < 1e-3 * peak, "{pose:?}: {off} of {peak}");
    }
    // A long pin with a slight tilt touches at the end of the pad, not beside it.
    let tilted = [0.0, 0.0, 0.0, 1e-3];
    let asked = [
        cylinder(200.0, tilted, ("force_n", 5.0), "nothing"),
        cylinder(200.0, tilted, ("force_n", 5.0), "layer"),
        cylinder(10.0, [30.0, 0.0, 0.0, 0.0], depth, "nothing"),
    ];
    let answers = ask(&asked);
    let sum = |n: usize| answers[n]["features"]["M0"].as_f64().unwrap().abs();
    assert!(sum(0) > 1.0 && sum(1) < 1e-3 * sum(0), "{} {}", sum(0), sum(1));
    assert_eq!(answers[2]["force_n"], 0.0);
    let beside = cylinder(10.0, [30.0, 0.0, 0.0, 0.0], ("force_n", 5.0), "nothing");
    let refused = &ask_text(format!("{beside}\n").as_bytes())[0];
    assert_eq!(refused["ok"], false);
    assert!(refused.to_string().contains("over the array"), "{refused}");
}

/// Over a pad an indenter is cut along its axis, not across it: an indenter that protrudes over a
/// side is an error, on either side of the point where its axis leaves the pad.
#[test]
fn an_indenter_that_protrudes_over_a_side_is_rejected() {
    let bar = |width: f64, [x, y, rot]: [f64; 3], drive: (&str, f64)| {
        let mut request = json!({
            "op": "contact_3d", "t_mm": 0.8, "nu": 0.49, "level": "fast", "beyond": "nothing",
            "shape": {"bar": {"width_mm": width, "length_mm": 10, "x_mm": x, "y_mm": y,
                "rot_rad": rot}},
        });
        request[drive.0] = json!(drive.1);
        request
    };
    let deep = ("penetration_mm", 0.01);
    let fits = [bar(3.0, [11.1, 0.0, 0.0], deep), bar(3.0, [0.0, 11.1, FRAC_PI_2], deep)];
    for answer in ask(&fits) {
        assert!(answer["force_n"].as_f64().unwrap() > 10.0, "{answer}");
    }
    let cylinder = |x: f64, depth: f64| {
        json!({
            "op": "contact_3d", "t_mm": 0.8, "nu": 0.49, "level": "fast", "beyond": "nothing",
            "penetration_mm": depth,
            "shape": {"cylinder": {"radius_mm": 23, "length_mm": 10, "x_mm": x}},
        })
    };
    let hanging = [
        (bar(3.0, [12.69, 0.0, 0.0], deep), "x_mm"),
        (bar(3.0, [12.71, 0.0, 0.0], deep), "x_mm"),
        (bar(3.0, [12.71, 0.0, 0.0], ("force_n", 5.0)), "x_mm"),
        (bar(30.0, [0.0, 0.0, 0.0], deep), "x_mm"),
        (bar(3.0, [0.0, 12.0, FRAC_PI_2], deep), "y_mm"),
        (cylinder(12.5, 0.02), "x_mm"),
        (cylinder(12.9, 0.02), "x_mm"),
    ];
    for (request, place) in hanging {
        let refused = &ask_text(format!("{request}\n").as_bytes())[0];
        assert_eq!(refused["ok"], false, "{request}: {refused}");
        let field = refused["error"]["field"].as_str().unwrap();
        assert!(field.ends_with(place), "{request}: {refused}");
        assert!(refused.to_string().contains("over the array"), "{refused}");
    }
    let clear = [bar(3.0, [14.3, 0.0, 0.0], deep), cylinder(14.0, 0.02)];
    for answer in ask(&clear) {
        assert_eq!(answer["force_n"], 0.0);
    }
}

/// The image of an indenter far away has no centroid.
#[test]
fn an_indenter_far_off_the_array_has_no_centroid() {
    let sphere = json!({
        "op": "contact_3d", "t_mm": 0.8, "nu": 0.49, "force_n": 5,
        "shape": {"sphere": {"radius_mm": 10, "x_mm": 100}},
    });
    let answer = &ask(&[sphere])[0];
    for name in ["xc", "yc", "mu_xx", "theta_long_rad", "xc_c", "theta_long_rad_c"] {
        assert!(answer["features"][name].is_null(), "{name}: {answer}");
    }
    assert_eq!(answer["force_n"], 5.0);
}
