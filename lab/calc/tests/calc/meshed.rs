//! `contact_2d` on finite elements: too much work is an error at once, contacts end at the ends of
//! the face and of the layer, moves without a reaction are errors, and an indenter beside the layer
//! touches nothing.

use serde_json::{Value, json};

use crate::ask::ask_text;

fn on_mesh(fields: &Value) -> Value {
    let mut request = json!({"op": "contact_2d", "method": "fem", "t_mm": 0.8, "nu": 0.49});
    for (key, value) in fields.as_object().unwrap() {
        request[key] = value.clone();
    }
    ask_text(format!("{request}\n").as_bytes()).remove(0)
}

fn refusal_message(fields: &Value, code: &str, field: &str) -> String {
    let answer = on_mesh(fields);
    let error = &answer["error"];
    assert_eq!((&error["code"], &error["field"]), (&json!(code), &json!(field)), "{answer}");
    error["message"].as_str().unwrap().to_owned()
}

fn number(answer: &Value, place: &str) -> f64 {
    answer.pointer(place).and_then(Value::as_f64).unwrap_or_else(|| panic!("{place}: {answer}"))
}

#[test]
fn a_mesh_that_would_take_long_is_refused_at_once_by_one_limit() {
    let roll = json!({"cylinder": {"radius_mm": 22.9}});
    let mut told = Vec::new();
    for mesh in [
        json!([300, 300]),
        json!([999, 50]),
        json!([999, 1]),
        json!([2, 100_000_000]),
        json!([2, 513]),
        json!([513, 1]),
        json!([150, 150]),
        json!([512, 33]),
        json!([1, 4]),
        json!([64, 0]),
        json!([64.5, 4]),
        json!([1e300, 1e300]),
        json!([-64, -4]),
    ] {
        let fields = json!({"shape": roll, "load": {"p_n_mm": 1}, "mesh": mesh});
        let message = refusal_message(&fields, "out_of_range", "mesh");
        told.push(message.split("wanted").nth(1).unwrap_or_else(|| panic!("{message}")).to_owned());
    }
    assert!(told.iter().all(|remedy| *remedy == told[0]), "one limit: {told:?}");
    for mesh in [json!([2, 512]), json!([512, 2]), json!([64, 64])] {
        let knife = json!({"shape": {"knife": {}}, "load": {"p_n_mm": 1}, "mesh": mesh});
        assert_eq!(on_mesh(&knife)["ok"], true, "{mesh}");
    }
}

#[test]
fn a_contact_ends_where_its_face_and_the_layer_end() {
    for (width, half) in [(12.7, 6.35), (25.4, 12.7), (40.0, 12.7)] {
        let bar = json!({"flat": {"width_mm": width}});
        let fields =
            json!({"shape": bar, "load": {"p_n_mm": 1}, "x_mm": [half - 0.05, half + 0.05]});
        let answer = on_mesh(&fields);
        assert_eq!(answer["mode"], "full", "{answer}");
        assert!((number(&answer, "/x_left_mm") + half).abs() < 1e-9, "{answer}");
        assert!((number(&answer, "/x_right_mm") - half).abs() < 1e-9, "{answer}");
        assert!(number(&answer, "/pressure/0") > 0.0, "{answer}");
        assert_eq!(number(&answer, "/pressure/1"), 0.0, "{answer}");
    }
    // This corner of the layer is half an element long.
    let tip = json!({"profile": {"x_mm": [12.6, 14, 17], "z_mm": [0.1, 0.0, 0.1]}});
    let answer = on_mesh(&json!({"shape": tip, "load": {"p_n_mm": 0.01}}));
    assert!((number(&answer, "/x_left_mm") - 12.6).abs() < 1e-9, "{answer}");
    assert!((number(&answer, "/x_right_mm") - 12.7).abs() < 1e-9, "{answer}");
    // The pressure over the layer sums to the load, with no gap at its end.
    let x: Vec<f64> = (0..2540).map(|i| -12.695 + 0.01 * f64::from(i)).collect();
    let bar = json!({"flat": {"width_mm": 25.4}});
    let answer = on_mesh(&json!({"shape": bar, "load": {"p_n_mm": 1}, "x_mm": x}));
    let sum: f64 = answer["pressure"].as_array().unwrap().iter().filter_map(Value::as_f64).sum();
    assert!((0.01 * sum - 1.0).abs() < 2e-3, "{sum}");
}

#[test]
fn a_move_along_x_that_no_friction_carries_is_refused_as_on_the_layer() {
    let wedge = json!({"profile": {"x_mm": [-3, 0, 3], "z_mm": [0.3, 0, 0.3]}});
    for shape in [json!({"flat": {"width_mm": 12.7}}), json!({"cylinder": {"radius_mm": 9}}), wedge]
    {
        for (friction, motion) in [
            ("none", json!({"dz_mm": 0.01, "dx_mm": 0.01})),
            ("prop", json!({"dz_mm": 0.01, "dx_mm": 0.01})),
            ("prop", json!({"dz_mm": 0.01})),
        ] {
            for method in ["fem", "layer"] {
                let fields =
                    json!({"shape": shape, "move": motion, "friction": friction, "method": method});
                let message = refusal_message(&fields, "unreachable", "move");
                assert!(message.contains("`move`") && message.contains("coulomb"), "{message}");
            }
        }
        let held =
            json!({"shape": shape, "move": {"dz_mm": 0.01, "dx_mm": 0.001}, "friction": "stick"});
        assert!(number(&on_mesh(&held), "/q_n_mm") > 0.0);
    }
}

#[test]
fn a_profile_past_the_layer_touches_nothing_and_carries_nothing() {
    for x in [[17.0, 20.0, 23.0], [-23.0, -20.0, -17.0], [12.71, 13.0, 14.0]] {
        let tip = json!({"profile": {"x_mm": x, "z_mm": [0.1, 0.0, 0.1]}});
        let open = on_mesh(&json!({"shape": tip, "move": {"dz_mm": 0.01}, "x_mm": [0, 12.7]}));
        assert_eq!((&open["mode"], &open["ok"]), (&json!("open"), &json!(true)), "{open}");
        assert_eq!(number(&open, "/szz/1"), 0.0);
        let message = refusal_message(
            &json!({"shape": tip, "load": {"p_n_mm": 0.01}}),
            "unreachable",
            "load",
        );
        assert!(message.contains("nothing of the indenter is over the layer"), "{message}");
        let none = on_mesh(&json!({"shape": tip, "load": {"p_n_mm": 0}}));
        assert_eq!(none["mode"], "open", "{none}");
    }
    let between = json!({"profile": {"x_mm": [0.1, 0.15, 0.2], "z_mm": [0.1, 0.0, 0.1]}});
    let message = refusal_message(
        &json!({"shape": between, "load": {"p_n_mm": 0.01}}),
        "out_of_range",
        "mesh",
    );
    assert!(message.contains("no node under the profile"), "{message}");
}

/// A point that sticks keeps the displacement that the surface had when a step found it in contact,
/// so the two ways agree as closely as their steps are small.
#[test]
fn a_load_without_slip_and_its_descent_give_the_same_contact() {
    for (radius, nu, p, mesh) in [
        (23.0, 0.49, 0.8, json!([64, 4])),
        (60.0, 0.49, 0.8, json!([100, 6])),
        (5.0, 0.3, 3.0, json!([128, 8])),
        (23.0, 0.4999, 2.0, json!([96, 6])),
    ] {
        let with = |key: &str, drive: Value| {
            let mut fields = json!({"shape": {"cylinder": {"radius_mm": radius}}, "nu": nu,
                "friction": "stick", "mesh": mesh});
            fields[key] = drive;
            on_mesh(&fields)
        };
        let down = number(&with("load", json!({"p_n_mm": p})), "/delta_mm");
        let back = with("move", json!({"dz_mm": down}));
        let off = number(&back, "/p_n_mm") / p - 1.0;
        assert!(off.abs() < 4e-3, "{radius} {nu} {p} {mesh}: {off:e}");
    }
}
