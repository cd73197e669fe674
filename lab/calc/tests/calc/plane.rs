//! `contact_2d`: shapes, friction laws and methods against known properties, and one error line for
//! each impossible request.

use serde_json::{Value, json};

use crate::ask::ask_text;

fn contact(fields: Value) -> Value {
    let mut request = json!({"op": "contact_2d", "t_mm": 0.8, "nu": 0.49});
    for (key, value) in fields.as_object().unwrap() {
        request[key] = value.clone();
    }
    ask_text(format!("{request}\n").as_bytes()).remove(0)
}

fn number(answer: &Value, path: &str) -> f64 {
    answer.pointer(path).and_then(Value::as_f64).unwrap_or_else(|| panic!("{path}: {answer}"))
}

fn near(answer: &Value, path: &str, expected: f64, bar: f64) {
    let found = number(answer, path);
    assert!((found - expected).abs() <= bar, "{path}: {found} not {expected}");
}

#[test]
fn a_tilted_bar_of_the_reference() {
    // Reference data: prop, W 12.7, h 6.35, P 0.175, Q 0.0438.
    let answer = contact(json!({
        "shape": {"flat": {"width_mm": 12.7, "height_mm": 6.35}},
        "load": {"p_n_mm": 0.175, "q_n_mm": 0.0438}, "friction": "prop", "level": "fine",
        "x_mm": [0, 6.35, 9.0], "threshold_mpa": [0.001, 1.0], "timing": true, "repeat": 3,
    }));
    assert_eq!(answer["mode"], "full");
    near(&answer, "/slope", 3.719_444_828e-6, 1e-13);
    near(&answer, "/delta_mm", 4.190_873_135e-5, 1e-11);
    near(&answer, "/features/full/m0", -0.175, 1e-12);
    near(&answer, "/features/full/m1", -0.313_17, 1e-10);
    near(&answer, "/features/full/m2", -2.430_459_760, 1e-7);
    near(&answer, "/features/full/m3", -8.525_917_374, 1e-7);
    near(&answer, "/features/full/x_c", 1.789_542_857, 1e-9);
    near(&answer, "/features/compressive/m1", -0.313_012_671, 1e-8);
    near(&answer, "/features/compressive/x_peak", 4.559_362, 1e-5);
    near(&answer, "/features/compressive/szz_peak", -0.020_612_899, 1e-9);
    near(&answer, "/features/compressive/widths_mm/0", 14.222_5, 1e-4);
    near(&answer, "/features/compressive/widths_mm/1", 0.0, 0.0);
    assert_eq!(answer["pressure"][1], Value::Null);
    assert_eq!(answer["pressure"][2], json!(0.0));
    assert!(number(&answer, "/residual") < 1e-10 && number(&answer, "/ns") > 0.0);
}

#[test]
fn the_cylinder_by_load_and_by_move() {
    // Reference data: R 25.4, t 0.8, P 0.35.
    let roll = json!({"cylinder": {"radius_mm": 25.4}});
    let pressed = contact(json!({"shape": roll, "load": {"p_n_mm": 0.35}, "x_mm": [0]}));
    near(&pressed, "/x_right_mm", 0.481_873_955, 1e-7);
    near(&pressed, "/delta_mm", 0.005_257_918_5, 1e-9);
    near(&pressed, "/pressure/0", 0.468_861_964, 1e-7);
    near(&pressed, "/szz/0", -0.291_923_548, 1e-7);
    let moved = contact(json!({"shape": roll, "move": {"dz_mm": 0.005_257_918_544}}));
    near(&moved, "/p_n_mm", 0.35, 1e-7);
    // No slip, b = 1.5, R = 22.9 of the reference; shear by load and by move agree.
    let roll = json!({"cylinder": {"radius_mm": 22.9}});
    let held = contact(json!({
        "shape": roll, "move": {"dz_mm": 0.0326, "dx_mm": 0.001}, "friction": "stick"
    }));
    let (p, q) = (number(&held, "/p_n_mm"), number(&held, "/q_n_mm"));
    let again = contact(json!({
        "shape": roll, "load": {"p_n_mm": p, "q_n_mm": q}, "friction": "stick"
    }));
    near(&again, "/delta_mm", 0.0326, 1e-6);
    near(&again, "/features/full/m1", number(&held, "/features/full/m1"), 1e-6);
}

#[test]
fn a_knife_is_a_line_load_and_its_moments_are_statics() {
    let load = json!({"p_n_mm": 0.175, "q_n_mm": 0.0438});
    for method in ["layer", "fem"] {
        let answer = contact(json!({
            "shape": {"knife": {}}, "load": load, "method": method, "mesh": [128, 8], "x_mm": [0]
        }));
        assert_eq!(answer["delta_mm"], Value::Null);
        near(&answer, "/features/full/m0", -0.175, 1e-10);
        near(&answer, "/features/full/m1", -0.8 * 0.0438, 1e-10);
        near(&answer, "/szz/0", -0.175 * 1.026_139_419, 0.015);
    }
}

/// On very thin and very thick layers the features and the stresses far away are those of the line
/// load.
#[test]
fn a_knife_on_layers_of_any_thickness() {
    for t in [1e-4, 1e-3, 0.008, 0.5] {
        let answer = contact(json!({
            "shape": {"knife": {}}, "load": {"p_n_mm": 0.7, "q_n_mm": 0.05}, "t_mm": t, "x_mm": [0]
        }));
        // Q shifts the peak by t/6 and raises it by a thousandth.
        let peak = number(&answer, "/features/compressive/szz_peak");
        near(&answer, "/features/compressive/szz_peak", -0.575_094 / t, 1e-6 / t);
        assert!(peak < number(&answer, "/szz/0") && peak > 1.01 * number(&answer, "/szz/0"));
        near(&answer, "/features/compressive/m0", -0.7, 1e-8);
        near(&answer, "/features/compressive/m1", -0.05 * t, 1e-8 * t);
    }
    let x = json!([0, 9000, 12_000, 50_000, -120_000]);
    let answer = contact(json!({
        "shape": {"knife": {}}, "load": {"p_n_mm": 0.7, "q_n_mm": 0.05}, "t_mm": 1e4, "x_mm": x
    }));
    let line = json!({"op": "layer_line", "t_mm": 1e4, "nu": 0.49, "depth_mm": 1e4, "x_mm": x,
        "p_n_mm": 0.7, "q_n_mm": 0.05});
    let line = ask_text(format!("{line}\n").as_bytes()).remove(0);
    for place in 0..5 {
        let path = format!("/szz/{place}");
        near(&answer, &path, number(&line, &path), 1e-17);
    }
    near(&answer, "/szz/2", -3.334_009_8e-6, 1e-12);
}

#[test]
fn methods_agree_with_each_other() {
    let bar = json!({"flat": {"width_mm": 12.7, "height_mm": 6.35}});
    let load = json!({"p_n_mm": 0.7, "q_n_mm": 0.4});
    let ask = |method: &str, friction: Value| {
        contact(json!({
            "shape": bar, "load": load, "method": method, "friction": friction, "mesh": [128, 8],
            "level": "fast", "x_mm": [2.0],
        }))
    };
    let exact = ask("layer", json!("prop"));
    let mesh = ask("fem", json!("prop"));
    assert_eq!(exact["mode"], "left");
    assert_eq!(mesh["mode"], "left");
    near(&mesh, "/x_left_mm", number(&exact, "/x_left_mm"), 0.3);
    near(&mesh, "/szz/0", number(&exact, "/szz/0"), 0.03 * number(&exact, "/szz/0").abs());
    near(&mesh, "/features/full/m1", -0.4 * (6.35 + 0.8), 1e-6);
    for friction in [json!({"coulomb": 0.9}), json!({"coulomb": 3})] {
        let held = ask("layer", friction.clone());
        assert_eq!(held["ok"], true, "{friction}: {held}");
        near(&held, "/p_n_mm", 0.7, 1e-9);
        near(&held, "/q_n_mm", 0.4, 1e-9);
        near(&held, "/features/full/m1", -0.4 * (6.35 + 0.8), 1e-6);
    }
}

#[test]
fn the_contact_of_any_profile_is_found() {
    // The profiles are a wedge with its tip at x = 1, and a trough that rests on two edges.
    let wedge = json!({"profile": {"x_mm": [-3, 1, 5], "z_mm": [0.4, 0.0, 0.4]}});
    let answer = contact(json!({"shape": wedge, "move": {"dz_mm": 0.05}, "x_mm": [1.0]}));
    assert_eq!(answer["mode"], "free");
    assert!(number(&answer, "/x_left_mm") < 1.0 && number(&answer, "/x_right_mm") > 1.0);
    near(&answer, "/features/full/x_c", 1.0, 0.05);
    let trough =
        json!({"profile": {"x_mm": [-3, -1, 0, 1, 3], "z_mm": [0.5, 0.0, 0.05, 0.0, 0.5]}});
    let answer = contact(json!({"shape": trough, "load": {"p_n_mm": 0.5}, "x_mm": [0, 1, 0.9]}));
    near(&answer, "/p_n_mm", 0.5, 1e-9);
    near(&answer, "/pressure/0", 0.0, 0.0);
    assert!(number(&answer, "/pressure/1") > 0.1);
}

/// However much of a profile is given, the cells cover its contact.
#[test]
fn a_circle_given_as_a_profile_is_the_cylinder() {
    let x: Vec<f64> = (0..=4000).map(|i| 0.003 * f64::from(i) - 6.0).collect();
    let z: Vec<f64> = x.iter().map(|x| 23.0 - (529.0 - x * x).sqrt()).collect();
    let points = json!({"profile": {"x_mm": x, "z_mm": z}});
    let round = json!({"cylinder": {"radius_mm": 23}});
    for wanted in [
        json!({"load": {"p_n_mm": 0.003}}),
        json!({"load": {"p_n_mm": 4.0}}),
        json!({"move": {"dz_mm": 0.01}}),
    ] {
        let of = |shape: &Value| {
            let mut fields = wanted.clone();
            fields["shape"] = shape.clone();
            fields["x_mm"] = json!([0, 0.3, -1.5]);
            contact(fields)
        };
        let (found, exact) = (of(&points), of(&round));
        let peak = number(&exact, "/szz/0").abs();
        for place in ["/szz/0", "/szz/1", "/szz/2"] {
            near(&found, place, number(&exact, place), 3e-4 * peak);
        }
        for (place, bar) in [("/delta_mm", 5e-4), ("/p_n_mm", 5e-4), ("/x_right_mm", 0.02)] {
            near(&found, place, number(&exact, place), bar * number(&exact, place));
        }
    }
}

#[test]
fn a_profile_far_wider_than_its_contact_is_resolved() {
    let wedge = json!({"profile": {"x_mm": [-900, 1, 1000], "z_mm": [90, 0, 100]}});
    for level in ["fast", "default", "fine"] {
        let of = |fields: Value| {
            let mut fields = fields;
            fields["level"] = json!(level);
            contact(fields)
        };
        let tip = of(json!({"shape": wedge, "move": {"dz_mm": 0.02}}));
        near(&tip, "/features/full/x_c", 1.0, 0.01);
        // The same tip on a profile that is no wider than necessary.
        let short = json!({"profile": {"x_mm": [0, 1, 2], "z_mm": [0.1, 0, 0.1]}});
        let same = of(json!({"shape": short, "move": {"dz_mm": 0.02}}));
        near(&tip, "/p_n_mm", number(&same, "/p_n_mm"), 0.01 * number(&same, "/p_n_mm"));
    }
}

#[test]
fn impossible_requests_are_one_error_line_and_the_filter_goes_on() {
    let bar = json!({"flat": {"width_mm": 12.7}});
    let roll = json!({"cylinder": {"radius_mm": 1.0}});
    let held = json!({"p_n_mm": 1, "q_n_mm": 0.4});
    let wrong = [
        (json!({"shape": {"ball": {}}, "load": {"p_n_mm": 1}}), "unknown_field", "shape.ball"),
        (json!({"shape": {}, "load": {"p_n_mm": 1}}), "wrong_type", "shape"),
        (json!({"shape": bar, "t_mm": -0.8, "load": {"p_n_mm": 1}}), "out_of_range", "t_mm"),
        (json!({"shape": bar, "nu": 0.51, "load": {"p_n_mm": 1}}), "out_of_range", "nu"),
        (json!({"shape": bar, "load": {"p_n_mm": -1}}), "out_of_range", "load"),
        (json!({"shape": bar, "load": {"p_n_mm": 1, "q_n_mm": 2}}), "topples", "load"),
        (json!({"shape": roll, "load": {"p_n_mm": 1e9}}), "unreachable", "load"),
        (json!({"shape": bar}), "missing_field", "load"),
        (
            json!({"shape": roll, "load": {"p_n_mm": 1}, "move": {"dz_mm": 0.01}}),
            "conflict",
            "load",
        ),
        (json!({"shape": {"knife": {}}, "move": {"dz_mm": 1}}), "unreachable", "move"),
        (json!({"shape": bar, "move": {"dz_mm": 1, "dx_mm": 1}}), "unreachable", "move"),
        (json!({"shape": roll, "move": {"dz_mm": 5}}), "unreachable", "move"),
        (json!({"shape": bar, "load": {"p_n_mm": 1e7}}), "unreachable", "load"),
        (json!({"shape": bar, "move": {"dz_mm": 0.9}}), "unreachable", "move"),
        (json!({"shape": bar, "load": {"p_n_mm": 1e7}, "method": "fem"}), "unreachable", "load"),
        (
            json!({"shape": bar, "load": {"p_n_mm": 1e7}, "friction": {"coulomb": 0.3}}),
            "unreachable",
            "load",
        ),
        (
            json!({"shape": roll, "move": {"dz_mm": 0.01, "dx_mm": 1e31}, "friction": "stick"}),
            "out_of_range",
            "move",
        ),
        (json!({"shape": bar, "load": {"p_n_mm": 1}, "depth_mm": 0.9}), "out_of_range", "depth_mm"),
        (json!({"shape": bar, "load": held, "friction": {"coulomb": 0.3}}), "slides", "load"),
        (
            json!({"shape": bar, "load": {"p_n_mm": 1}, "friction": {"coulomb": -1}}),
            "out_of_range",
            "friction.coulomb",
        ),
        (
            json!({"shape": bar, "load": {"p_n_mm": 1}, "friction": "glue"}),
            "unknown_value",
            "friction",
        ),
        (
            json!({"shape": bar, "load": {"p_n_mm": 1}, "method": "fem", "mesh": [0, 4]}),
            "out_of_range",
            "mesh",
        ),
        (
            json!({"shape": {"flat": {"width_mm": 12.7}, "knife": {}}, "load": {"p_n_mm": 1}}),
            "wrong_type",
            "shape",
        ),
    ];
    for (fields, code, field) in wrong {
        let answer = contact(fields.clone());
        assert_eq!(answer["ok"], false, "{fields}: {answer}");
        assert_eq!(answer["error"]["code"], code, "{fields}: {answer}");
        assert_eq!(answer["error"]["field"], field, "{fields}: {answer}");
    }
    let open = contact(json!({"shape": bar, "load": {"p_n_mm": 0}, "x_mm": [0]}));
    assert_eq!(open["mode"], "open");
    near(&open, "/szz/0", 0.0, 0.0);
}

#[test]
fn loads_and_widths_are_recovered_from_moments() {
    let bar = json!({"flat": {"width_mm": 12.7, "height_mm": 6.35}});
    let load = json!({"p_n_mm": 0.35, "q_n_mm": 0.05});
    let made = contact(json!({"shape": bar, "load": load, "friction": "prop"}));
    let m = |k: &str| number(&made, &format!("/features/full/{k}"));
    // The moments are about the sensor's left end, 12.7 mm from the bar's middle.
    let (m1, m2) = (m("m1") + 12.7 * m("m0"), m("m2") + 25.4 * m("m1") + 161.29 * m("m0"));
    let recover = |fields: Value| {
        let mut request = json!({"op": "recover", "m1": m1, "m2": m2});
        for (key, value) in fields.as_object().unwrap() {
            request[key] = value.clone();
        }
        ask_text(format!("{request}\n").as_bytes()).remove(0)
    };
    let loads = recover(json!({"case": 1, "width_mm": 12.7, "m1_sigma": 0.01, "m2_sigma": 0.1}));
    near(&loads, "/p_n_mm", 0.35, 1e-5);
    near(&loads, "/q_n_mm", 0.05, 1e-5);
    assert!(number(&loads, "/sigma/p_n_mm") > 0.0 && number(&loads, "/sigma/width_mm") == 0.0);
    let width = recover(json!({"case": 2, "p_n_mm": 0.35, "q_n_mm": 0.05}));
    near(&width, "/width_mm", 12.7, 1e-3);
    assert_eq!(width["consistent"], true);
    let all = json!({"case": 3, "p_n_mm": 0.35, "q_n_mm": 0.05, "width_mm": 12.7});
    assert_eq!(recover(all)["consistent"], true);
    let off = json!({"case": 3, "p_n_mm": 0.4, "q_n_mm": 0.05, "width_mm": 12.7});
    assert_eq!(recover(off)["consistent"], false);
    // Without friction Q enters by its moment about the surface alone, as in `contact_2d`.
    let made = contact(json!({"shape": bar, "load": load}));
    let m = |k: &str| number(&made, &format!("/features/full/{k}"));
    let (n1, n2) = (m("m1") + 12.7 * m("m0"), m("m2") + 25.4 * m("m1") + 161.29 * m("m0"));
    let loads =
        recover(json!({"case": 1, "width_mm": 12.7, "friction": "none", "m1": n1, "m2": n2}));
    near(&loads, "/p_n_mm", 0.35, 1e-5);
    near(&loads, "/q_n_mm", 0.05, 1e-5);
    let rest = recover(json!({"case": 4}));
    let line = |k: &str| number(&rest, &format!("/constraint/{k}"));
    assert!((line("p") * 0.35 + line("q") * 0.05 - line("value")).abs() < 1e-9);
    assert_eq!(rest["width_mm"], Value::Null);
    for (fields, code, field) in [
        (json!({"case": 5}), "out_of_range", "case"),
        (json!({"case": 1}), "missing_field", "width_mm"),
        (json!({"case": 2}), "missing_field", "p_n_mm"),
        (json!({"case": 1, "width_mm": -1}), "out_of_range", "width_mm"),
        (json!({"case": 1, "width_mm": 12.7, "t_mm": -1}), "out_of_range", "t_mm"),
        (json!({"case": 1, "width_mm": 12.7, "origin_mm": 0}), "out_of_range", "origin_mm"),
        (json!({"case": 1, "width_mm": 12.7, "m1": 50}), "unreachable", "m2"),
    ] {
        let answer = recover(fields.clone());
        assert_eq!(answer["error"]["code"], code, "{fields}: {answer}");
        assert_eq!(answer["error"]["field"], field, "{fields}: {answer}");
    }
}
