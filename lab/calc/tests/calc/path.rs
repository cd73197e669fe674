//! Bodies that move along in space through the filter: against the exact sphere, split layers,
//! Coulomb's limit, equilibrium, and one error line for each impossible request.

use serde_json::{Value, json};

use crate::ask::{ask, ask_text, flat};

fn ball() -> Value {
    json!({
        "op": "contact_path_3d", "shape": {"sphere": {"radius_mm": 10, "x_mm": 0.0, "y_mm": 0.0}},
        "layers": [{"t_mm": 0.8, "nu": 0.49}],
        "cells": {"columns": 40, "rows": 40, "spacing_mm": 0.05}, "friction": 0.4,
        "steps": [{"force_n": 2.0}, {"force_n": 2.0, "dx_mm": 0.004}], "show": "cells",
    })
}

/// The ball with some fields replaced.
fn with(fields: Value) -> Value {
    let mut request = ball();
    for (name, value) in fields.as_object().unwrap() {
        request[name] = value.clone();
    }
    request
}

fn last(answer: &Value, name: &str) -> f64 {
    *flat(&answer[name]).last().unwrap()
}

fn peak(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |most: f64, value| most.max(value.abs()))
}

fn largest_difference(a: &Value, b: &Value) -> f64 {
    let (a, b) = (flat(a), flat(b));
    assert_eq!(a.len(), b.len());
    let most = a.iter().zip(&b).fold(0.0, |most: f64, (a, b)| most.max((a - b).abs()));
    most / peak(&a)
}

#[test]
fn a_smooth_ball_is_the_exact_sphere() {
    let steps = json!([{"force_n": 2.0}]);
    let path = with(json!({"friction": 0, "steps": steps}));
    let exact = json!({
        "op": "contact_3d", "shape": {"sphere": {"radius_mm": 10, "x_mm": 0.0, "y_mm": 0.0}},
        "t_mm": 0.8, "nu": 0.49, "force_n": 2.0,
    });
    let heights: Vec<f64> = (0..1600)
        .map(|n| {
            let at = |i: usize| 0.05 * (i as f64 - 19.5);
            let square = at(n % 40) * at(n % 40) + at(n / 40) * at(n / 40);
            10.0 - (100.0 - square).sqrt()
        })
        .collect();
    let given = with(json!({
        "friction": 0, "steps": steps, "shape": {"heights": {"heights_mm": heights}},
    }));
    let answers = ask(&[path, exact, given]);
    let [path, exact, given] = [0, 1, 2].map(|i| &answers[i]);
    assert!(largest_difference(&exact["image"], &path["image"]) < 2e-3);
    assert!((last(path, "delta_mm") / exact["delta_mm"].as_f64().unwrap() - 1.0).abs() < 2e-3);
    assert!((last(path, "force_n") - 2.0).abs() < 1e-9);
    assert!(largest_difference(&path["image"], &given["image"]) < 1e-6);
    assert_eq!([last(path, "stick_area_mm2"), last(path, "along_n")], [0.0; 2]);
}

#[test]
fn split_layers_equal_one_layer_and_soft_layers_yield() {
    let layers = |below: Value| with(json!({"layers": [{"t_mm": 0.4, "nu": 0.49}, below]}));
    let answers = ask(&[
        ball(),
        layers(json!({"t_mm": 0.4, "nu": 0.49})),
        layers(json!({"t_mm": 0.4, "nu": 0.3, "youngs_mpa": 5.0})),
    ]);
    for name in ["image", "pressure_mpa", "traction_mpa", "along_n", "delta_mm"] {
        assert!(largest_difference(&answers[0][name], &answers[1][name]) < 1e-5, "{name}");
    }
    assert!(last(&answers[2], "delta_mm") > 1.5 * last(&answers[0], "delta_mm"));
}

/// After a long way everything slides, and the image shifts by the thickness times the ratio of the
/// tangential to the normal force.
#[test]
fn a_body_that_moves_far_slides_and_slides_back() {
    let steps = json!([
        {"force_n": 2.0}, {"force_n": 2.0, "dx_mm": 0.002}, {"force_n": 2.0, "dx_mm": 0.05},
        {"force_n": 2.0, "dx_mm": -0.1}, {"force_n": 2.0, "dy_mm": 0.1},
    ]);
    let cells = json!({"columns": 48, "rows": 48, "spacing_mm": 0.05});
    let answer = &ask(&[with(json!({"steps": steps, "cells": cells, "rows": 60, "cols": 60,
                    "pitch_mm": 0.4}))])[0];
    let along = flat(&answer["along_n"]);
    assert!(along[2] > 0.05 && along[2] < 0.3, "{along:?}");
    for (n, wanted) in [(2, [0.8, 0.0]), (3, [-0.8, 0.0])] {
        assert!((along[2 * n] - wanted[0]).abs() < 2e-3, "{along:?}");
        assert!((along[2 * n + 1] - wanted[1]).abs() < 2e-3, "{along:?}");
    }
    let size = libm::hypot(along[8], along[9]);
    assert!((size - 0.8).abs() < 2e-3 && along[9] > 0.7, "{along:?}");
    let (pressure, place) = (flat(&answer["pressure_mpa"]), |i: usize| 0.05 * (i as f64 - 23.5));
    let first: f64 = pressure.iter().enumerate().map(|(n, p)| p * place(n / 48)).sum();
    let centre = first / pressure.iter().sum::<f64>();
    let leaning = answer["features"]["yc"].as_f64().unwrap() - centre;
    assert!((leaning - 0.8 * along[9] / 2.0).abs() < 2e-3, "{leaning} {along:?}");
    assert!(flat(&answer["residual"]).iter().all(|left| *left < 1e-4), "{answer}");
    assert_eq!(flat(&answer["slip_area_mm2"]).len(), 5);
}

#[test]
fn pins_and_bars_have_the_same_pose_as_in_other_operations() {
    let pin = json!({"radius_mm": 20, "length_mm": 3.2, "x_mm": 0.1, "y_mm": -0.2, "rot_rad": 0.5,
                     "tilt_rad": 0.004});
    let cells = json!({"columns": 80, "rows": 80, "spacing_mm": 0.05});
    let steps = json!([{"penetration_mm": 0.02}]);
    let path = with(json!({"shape": {"cylinder": pin.clone()}, "cells": cells, "steps": steps,
                           "friction": 0}));
    let bar = json!({"width_mm": 1.0, "length_mm": 2.0, "x_mm": 0.0, "y_mm": 0.0,
                     "rot_rad": 0.3});
    let turned = with(json!({
        "shape": {"bar": bar}, "steps": [{"force_n": 1.0}, {"force_n": 1.0, "turn_rad": 0.002}],
        "cells": {"columns": 52, "rows": 52, "spacing_mm": 0.05}, "friction": 3,
    }));
    let exact = json!({"op": "contact_3d", "shape": {"cylinder": pin}, "t_mm": 0.8, "nu": 0.49,
                       "penetration_mm": 0.02});
    let answers = ask(&[path, exact, turned]);
    let force = answers[1]["force_n"].as_f64().unwrap();
    assert!((last(&answers[0], "force_n") / force - 1.0).abs() < 2e-2, "{force}");
    for name in ["xc", "yc", "theta_long_rad"] {
        let of = |answer: &Value| answer["features"][name].as_f64().unwrap();
        assert!((of(&answers[0]) - of(&answers[1])).abs() < 1e-2, "{name}");
    }
    // The turned body turns the image, and no tangential force remains.
    assert!(last(&answers[2], "torque_n_mm") > 0.01);
    assert!(peak(&flat(&answers[2]["along_n"])) < 0.02, "{}", answers[2]["along_n"]);
}

/// A body let up to where friction had sunk the rubber still touches it once that is gone.
#[test]
fn unloading_far_equals_a_new_contact() {
    let bar = json!({
        "shape": {"bar": {"width_mm": 1, "length_mm": 2, "x_mm": 0, "y_mm": 0, "tilt_rad": 0.02}},
        "layers": [{"t_mm": 0.8, "nu": 0.3}], "friction": 1.0,
        "cells": {"columns": 48, "rows": 80, "spacing_mm": 0.05},
        "steps": [{"penetration_mm": 0.02}, {"penetration_mm": 0.02, "dy_mm": 0.05},
                  {"penetration_mm": -0.018}],
    });
    let mut anew = bar.clone();
    anew["steps"] = json!([{"penetration_mm": 0.02}, {"force_n": 0.0, "dy_mm": 0.05},
                           {"penetration_mm": -0.018}]);
    let answers = ask(&[with(bar), with(anew)]);
    let [let_up, wanted] = [0, 1].map(|i| last(&answers[i], "force_n"));
    assert!(wanted > 0.015 && (let_up / wanted - 1.0).abs() < 0.1, "{let_up} {wanted}");
    assert_eq!(last(&answers[0], "delta_mm"), -0.018);
}

#[test]
fn a_body_without_contact_moves_freely() {
    let placed = with(json!({
        "shape": {"sphere": {"radius_mm": 10, "x_mm": 0.05, "y_mm": 0.0}},
        "steps": [{"force_n": 2.0}],
    }));
    let carried = with(json!({"steps": [{"force_n": 2.0, "dx_mm": 0.05}]}));
    let lifted = with(json!({
        "steps": [{"force_n": 2.0}, {"penetration_mm": -0.5}, {"force_n": 2.0, "dx_mm": 0.05}],
    }));
    let answers = ask(&[placed, carried, lifted]);
    for answer in &answers[1..] {
        assert!(largest_difference(&answers[0]["image"], &answer["image"]) < 1e-6);
        assert!(last(answer, "along_n").abs() < 1e-9, "{}", answer["along_n"]);
    }
    assert_eq!(flat(&answers[2]["delta_mm"])[1], -0.5);
}

/// A stiff cover spreads a load over a wide area, but an array shows it only within the reach of
/// the cells.
#[test]
fn a_stiff_cover_has_an_image_on_any_array() {
    let skin = with(json!({
        "shape": {"sphere": {"radius_mm": 3000, "x_mm": 0, "y_mm": 0}},
        "layers": [{"t_mm": 1, "nu": 0.3, "youngs_mpa": 82740}, {"t_mm": 0.1, "nu": 0.3}],
        "cells": {"columns": 32, "rows": 32, "spacing_mm": 0.5}, "friction": 0,
        "steps": [{"force_n": 100}],
    }));
    let mut requests = vec![];
    for pitch_mm in [0.5, 1.1, 1.5875, 3.0] {
        let mut request = skin.clone();
        (request["pitch_mm"], request["rows"], request["cols"]) =
            (json!(pitch_mm), json!(40), json!(40));
        requests.push(request);
    }
    let answers = ask(&requests);
    // The widest array carries the whole load.
    let whole = answers[3]["features"]["M0"].as_f64().unwrap();
    assert!((whole + 100.0).abs() < 1e-2, "{whole}");
}

/// Requests with these fields fail with this code and field.
fn refused_by_name(cases: &[(Value, &str, &str)]) {
    for (fields, code, field) in cases {
        let answer = &ask_text(with(fields.clone()).to_string().as_bytes())[0];
        let error = &answer["error"];
        assert_eq!([&error["code"], &error["field"]], [code, field], "{fields}: {answer}");
    }
}

#[test]
fn impossible_steps_and_layers_are_one_error_line() {
    let ten = vec![json!({"force_n": 1.0}); 300];
    refused_by_name(&[
        (json!({"steps": []}), "out_of_range", "steps"),
        (json!({"steps": [{}]}), "missing_field", "steps[0].force_n"),
        (
            json!({"steps": [{"force_n": 1.0, "penetration_mm": 0.1}]}),
            "conflict",
            "steps[0].force_n",
        ),
        (
            json!({"steps": [{"force_n": 1.0}, {"force_n": -1.0}]}),
            "out_of_range",
            "steps[1].force_n",
        ),
        (json!({"steps": [{"force_n": 1.0, "dx_mm": 1e300}]}), "out_of_range", "steps[0].dx_mm"),
        (json!({"steps": [{"force_n": 1.0, "dy_mm": -1e31}]}), "out_of_range", "steps[0].dy_mm"),
        (json!({"steps": [{"force_n": 1e-18}]}), "unreachable", "steps[0].force_n"),
        (
            json!({"shape": {"bar": {"width_mm": 1, "length_mm": 2, "x_mm": 0, "y_mm": 0,
                                     "tilt_rad": 0.3}}}),
            "out_of_range",
            "shape.bar.tilt_rad",
        ),
        (
            json!({"shape": {"heights": {"heights_mm": vec![1e300; 1600]}}}),
            "out_of_range",
            "shape.heights.heights_mm",
        ),
        (
            json!({"shape": {"sphere": {"radius_mm": 1e250, "x_mm": 1e200, "y_mm": 0}}}),
            "out_of_range",
            "shape.sphere",
        ),
        (json!({"steps": [{"force_n": 1.0, "dx_mm": 5.0}]}), "out_of_range", "cells.columns"),
        (json!({"steps": ten}), "out_of_range", "steps"),
        (json!({"steps": [{"force_n": 900.0}]}), "out_of_range", "cells.columns"),
        (json!({"layers": []}), "out_of_range", "layers"),
        (json!({"layers": [{"t_mm": 0.8, "nu": 0.51}]}), "out_of_range", "layers[0].nu"),
        (
            json!({"layers": [{"t_mm": 0.8, "nu": 0.5}, {"t_mm": -0.8, "nu": 0.5}]}),
            "out_of_range",
            "layers[1].t_mm",
        ),
        (
            json!({"layers": [{"t_mm": 0.001, "nu": 0.5}, {"t_mm": 1.0, "nu": 0.5}]}),
            "out_of_range",
            "layers",
        ),
    ]);
}

#[test]
fn impossible_bodies_and_cells_are_one_error_line() {
    refused_by_name(&[
        (json!({"friction": -0.1}), "out_of_range", "friction"),
        (
            json!({"cells": {"columns": 512, "rows": 512, "spacing_mm": 0.02}}),
            "out_of_range",
            "cells",
        ),
        (json!({"cells": {"columns": 3, "spacing_mm": 0.1}}), "out_of_range", "cells.columns"),
        (json!({"cells": {"spacing_mm": 0.5}}), "out_of_range", "cells.spacing_mm"),
        (json!({"cells": {"spacing_mm": 0.0}}), "out_of_range", "cells.spacing_mm"),
        (json!({"shape": {}}), "wrong_type", "shape"),
        (
            json!({"shape": {"heights": {"heights_mm": [0.0]}}}),
            "wrong_length",
            "shape.heights.heights_mm",
        ),
        (
            json!({"shape": {"bar": {"width_mm": -1, "length_mm": 2, "x_mm": 0, "y_mm": 0}}}),
            "out_of_range",
            "shape.bar.width_mm",
        ),
        (
            json!({"shape": {"sphere": {"radius_mm": 1e-9, "x_mm": 0, "y_mm": 0}}}),
            "out_of_range",
            "shape.sphere",
        ),
        (json!({"pitch_mm": 0.0}), "out_of_range", "pitch_mm"),
        (json!({"dx_mm": 1.0}), "unknown_field", "dx_mm"),
    ]);
    // A body that is lifted off leaves no image of which features could be computed.
    let answer = &ask(&[with(json!({"steps": [{"force_n": 2.0}, {"force_n": 0.0}]}))])[0];
    assert_eq!(peak(&flat(&answer["image"])), 0.0);
    assert_eq!(answer["features"]["xc"], Value::Null);
}
