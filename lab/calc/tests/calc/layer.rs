//! Point loads on layers through the filter: the closed form of a half space, the equilibrium of
//! the base, and one error line for each impossible request.

use core::f64::consts::PI;

use serde_json::{Value, json};

use crate::ask::{ask, ask_text, flat};

fn request(fields: &Value) -> Value {
    let mut request = json!({
        "op": "layer_point", "layers": [{"t_mm": 0.3, "nu": 0.49}, {"t_mm": 0.5, "nu": 0.3}],
        "p_n": 1.5, "q_n": 0.4, "depth_mm": 0.8, "x_mm": [0.3], "y_mm": [-0.2],
    });
    for (name, value) in fields.as_object().unwrap() {
        request[name] = value.clone();
    }
    request
}

#[test]
fn point_loads_on_layers_are_answered() {
    let deep = json!({"layers": [{"t_mm": 4000.0, "nu": 0.4}], "depth_mm": 1.0,
                      "x_mm": [0.6], "y_mm": [0.8]});
    let places: Vec<[f64; 2]> =
        (0..3600).map(|n| [n % 60, n / 60].map(|i| 0.25 * (f64::from(i) - 29.5))).collect();
    let [x, y] = [0, 1].map(|i| places.iter().map(|place| place[i]).collect::<Vec<f64>>());
    let answers = ask(&[request(&deep), request(&json!({"x_mm": x, "y_mm": y}))]);
    // R = sqrt 2, and the traction on a plane points at the load.
    let unit = 3.0 / (2.0 * PI * 4.0 * 2.0_f64.sqrt());
    let pull = unit * (0.4 * 0.6 + 1.5);
    let stress = flat(&answers[0]["stress"]);
    for (n, wanted) in [(2, -pull), (3, 0.8 * pull), (4, 0.6 * pull)] {
        assert!((stress[n] - wanted).abs() < 1e-6, "{n}: {stress:?}");
    }
    assert_eq!(flat(&answers[0]["displacement_mm"]).len(), 3);
    // The base carries the normal force, the tangential force and the moment.
    let stress = flat(&answers[1]["stress"]);
    let (mut sums, area) = ([0.0; 4], 0.0625);
    for (n, [x, _]) in places.iter().enumerate() {
        let [szz, syz, sxz] = [2, 3, 4].map(|k| area * stress[6 * n + k]);
        for (sum, more) in sums.iter_mut().zip([szz, syz, sxz, x * szz]) {
            *sum += more;
        }
    }
    for (found, wanted) in sums.iter().zip([-1.5, 0.0, 0.4, -0.4 * 0.8]) {
        assert!((found - wanted).abs() < 2e-3, "{sums:?}");
    }
}

#[test]
fn each_impossible_layer_is_one_error_line() {
    for (fields, code, field) in [
        (json!({"layers": []}), "out_of_range", "layers"),
        (json!({"layers": [{"t_mm": 0.0, "nu": 0.3}]}), "out_of_range", "layers[0].t_mm"),
        (json!({"layers": [{"t_mm": 1.0, "nu": 0.6}]}), "out_of_range", "layers[0].nu"),
        (json!({"layers": [{"t_mm": 1.0}]}), "missing_field", "layers[0].nu"),
        (json!({"depth_mm": 0.0}), "out_of_range", "depth_mm"),
        (json!({"depth_mm": 0.9}), "out_of_range", "depth_mm"),
        (json!({"depth_mm": 1e-12}), "out_of_range", "depth_mm"),
        (json!({"y_mm": [1.0, 2.0]}), "wrong_length", "y_mm"),
        (json!({"x_mm": 1.0}), "wrong_type", "x_mm"),
        (json!({"p_n": "much"}), "wrong_type", "p_n"),
    ] {
        let answer = &ask_text(request(&fields).to_string().as_bytes())[0];
        let error = &answer["error"];
        assert_eq!([&error["code"], &error["field"]], [code, field], "{fields}: {answer}");
    }
}
