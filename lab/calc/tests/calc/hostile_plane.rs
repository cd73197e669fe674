//! Numbers at which `contact_2d` once failed: it answers them correctly, or with one error line
//! that names the field, at once, and the filter goes on. Values are not compared with references.

use serde_json::{Value, json};

use crate::ask::{ask_text, flat};

fn contact(fields: Value) -> Value {
    let mut request = json!({"op": "contact_2d", "t_mm": 0.8, "nu": 0.49});
    for (name, value) in fields.as_object().unwrap() {
        request[name] = value.clone();
    }
    request
}

/// A profile of three points.
fn profile_contact(x: [f64; 3], z: [f64; 3], drive: &str, value: Value) -> Value {
    let shape = json!({"profile": {"x_mm": x, "z_mm": z}});
    contact(json!({"shape": shape, drive: value, "level": "fast"}))
}

fn bar(height: f64, p: f64, q: f64, friction: Value) -> Value {
    let shape = json!({"flat": {"width_mm": 6, "height_mm": height}});
    contact(json!({"shape": shape, "load": {"p_n_mm": p, "q_n_mm": q}, "friction": friction}))
}

#[test]
fn unsolvable_requests_are_named_at_once() {
    let (load, down) = (json!({"p_n_mm": 1}), json!({"dz_mm": 0.05}));
    let roll = json!({"cylinder": {"radius_mm": 23}});
    let at = |depth: f64, friction: Value| {
        contact(json!({"shape": roll, "load": load, "depth_mm": depth, "friction": friction}))
    };
    let cases = [
        (
            profile_contact([-3.0, 0.0, 1e308], [1.0, 0.0, 1.0], "load", load.clone()),
            "shape.profile.x_mm[2]",
        ),
        (
            profile_contact([-3.0, 0.0, 3.0], [1e308, 0.0, 1.0], "move", down.clone()),
            "shape.profile.z_mm[0]",
        ),
        // This contact is six thousand thicknesses wide.
        (profile_contact([-3.0, 0.0, 1e5], [1.0, 0.0, 1.0], "move", down.clone()), "shape"),
        (bar(-1.0, 1.0, 0.1, json!({"coulomb": 0.3})), "shape.flat.height_mm"),
        (bar(1e9, 1.0, 0.3, json!("none")), "load"),
        (bar(2.0, -1.0, 0.3, json!("prop")), "load"),
        (bar(2.0, 1.0, 0.4, json!({"coulomb": 0.3})), "load"),
        (bar(2.0, 1e-308, 0.4, json!("stick")), "load"),
        (contact(json!({"shape": roll, "move": {"dz_mm": 30}})), "move"),
        (contact(json!({"shape": roll, "load": {"p_n_mm": 1e5}})), "load"),
        (contact(json!({"shape": {"knife": {}}, "load": {"p_n_mm": 1e31}})), "load"),
        (at(1e-308, json!("none")), "depth_mm"),
        (at(8e-4, json!("none")), "depth_mm"),
        (at(0.04, json!("stick")), "depth_mm"),
        (at(0.02, json!({"coulomb": 0.3})), "depth_mm"),
    ];
    let text: String = cases.iter().map(|(request, _)| format!("{request}\n")).collect();
    let answers = ask_text(text.as_bytes());
    assert_eq!(answers.len(), cases.len(), "one line each");
    for ((request, field), answer) in cases.iter().zip(&answers) {
        let error = &answer["error"];
        assert_eq!(answer["ok"], false, "{request}: {answer}");
        assert_eq!(error["field"], *field, "{request}: {answer}");
        let message = error["message"].as_str().unwrap();
        assert!(message.contains(&format!("`{field}`")), "{request}: {answer}");
    }
}

#[test]
fn a_negligible_load_makes_no_contact() {
    let roll = json!({"cylinder": {"radius_mm": 23}});
    for friction in ["none", "prop", "stick"] {
        for small in [1e-308, 5e-324] {
            let load = json!({"p_n_mm": small});
            let request = contact(json!({"shape": roll, "load": load, "friction": friction}));
            let answer = &ask_text(request.to_string().as_bytes())[0];
            assert_eq!(answer["mode"], "open", "{friction}: {answer}");
        }
    }
}

/// Friction of six times the pressure separates this bar from the layer inside its contact: the
/// cells find the pieces, and nothing pulls.
#[test]
fn a_bar_in_two_pieces_presses_everywhere() {
    let x: Vec<f64> = (0..200).map(|i| (f64::from(i) + 0.5) * 0.025 - 2.5).collect();
    for (width, q) in [(4.981, 6.0), (4.981, -6.0), (4.981, 1.0)] {
        let height = 0.8 * 0.5 * width / f64::abs(q);
        let shape = json!({"flat": {"width_mm": width, "height_mm": height}});
        let request = contact(json!({
            "shape": shape, "t_mm": 1.0, "nu": 0.4999, "friction": "prop", "x_mm": x,
            "load": {"p_n_mm": 1e-3, "q_n_mm": 1e-3 * q},
        }));
        let answer = &ask_text(request.to_string().as_bytes())[0];
        assert_eq!(answer["ok"], true, "{answer}");
        let least = flat(&answer["pressure"]).into_iter().fold(f64::INFINITY, f64::min);
        assert!(least >= 0.0, "{q}: {least}");
        let moment = answer["features"]["full"]["m1"].as_f64().unwrap();
        let statics = -1e-3 * q * (height + 1.0);
        assert!((moment - statics).abs() < 1e-9 * statics.abs(), "{q}: {moment} {statics}");
    }
}

/// A request outside small strain, beyond the cells of a level or without a needed friction gets
/// the error that names this reason.
#[test]
fn errors_state_the_cause_and_the_remedy() {
    let bar = |q: f64, friction: Value| {
        let shape = json!({"flat": {"width_mm": 12.7, "height_mm": 6.35}});
        let load = json!({"p_n_mm": 0.7, "q_n_mm": 0.7 * q});
        contact(json!({"shape": shape, "load": load, "friction": friction}))
    };
    let slick = |shape: Value, method: &str| {
        let load = json!({"p_n_mm": 1, "q_n_mm": 0.1});
        contact(json!({"shape": shape, "load": load, "method": method}))
    };
    let roll = json!({"cylinder": {"radius_mm": 23}});
    let tip = json!({"profile": {"x_mm": [-3, 0, 3], "z_mm": [1, 0, 1]}});
    let far = json!({"profile": {"x_mm": [-3, 0, 1e5], "z_mm": [1, 0, 1]}});
    let wide = json!({"flat": {"width_mm": 1000, "height_mm": 1}});
    let (load, thin) = (json!({"p_n_mm": 1}), json!([0.5, -0.1]));
    let cases = [
        (bar(0.999_999, json!("none")), "unreachable", "load", "slope"),
        (bar(-0.999_999, json!("prop")), "unreachable", "load", "slope"),
        (bar(0.999_9, json!({"coulomb": 2})), "unreachable", "load", "does not topple"),
        (bar(1.0, json!({"coulomb": 2})), "topples", "load", "topples"),
        (slick(roll.clone(), "layer"), "slides", "load.q_n_mm", "leave it out"),
        (slick(roll.clone(), "fem"), "slides", "load.q_n_mm", "leave it out"),
        (slick(tip, "layer"), "slides", "load.q_n_mm", "leave it out"),
        (
            contact(json!({"shape": far, "move": {"dz_mm": 0.05}, "level": "fast"})),
            "out_of_range",
            "shape",
            "press less",
        ),
        (
            contact(json!({"shape": wide, "load": load})),
            "out_of_range",
            "shape.flat.width_mm",
            "narrower bar or a thicker layer",
        ),
        (
            contact(json!({"shape": roll, "load": load, "threshold_mpa": thin})),
            "out_of_range",
            "threshold_mpa[1]",
            "0 or more",
        ),
    ];
    for (request, code, field, word) in cases {
        let answer = &ask_text(request.to_string().as_bytes())[0];
        assert_eq!(answer["error"]["code"], code, "{request}: {answer}");
        assert_eq!(answer["error"]["field"], field, "{request}: {answer}");
        let message = answer["error"]["message"].as_str().unwrap();
        assert!(message.contains(word) && !message.contains("take cells"), "{answer}");
    }
    // A bar without friction takes the moment of Q; a bar that is meant to lean is answered.
    let answer = &ask_text(bar(0.99, json!("none")).to_string().as_bytes())[0];
    assert!(answer["slope"].as_f64().unwrap() > 0.05, "{answer}");
}

/// A glued cylinder can be moved along without end, and its answer states the tension at its edge;
/// all other contacts may separate.
#[test]
fn a_glued_cylinder_states_the_tension_at_its_edge() {
    let pull = |dx: f64, friction: Value| {
        let shape = json!({"cylinder": {"radius_mm": 23}});
        let drive = json!({"dz_mm": 0.005, "dx_mm": dx});
        let request = contact(json!({"shape": shape, "move": drive, "friction": friction}));
        let answer = &ask_text(request.to_string().as_bytes())[0];
        [&answer["pull_n_mm"], &answer["p_n_mm"]].map(|value| value.as_f64().unwrap())
    };
    assert_eq!(pull(0.0, json!("stick"))[0], 0.0);
    let [small, p] = pull(1e-4, json!("stick"));
    assert!(small < 1e-3 * p, "{small} {p}");
    let [large, p] = pull(0.2, json!("stick"));
    assert!(large > p, "{large} {p}");
    assert_eq!(pull(0.2, json!({"coulomb": 1}))[0], 0.0);
}
