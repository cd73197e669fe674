//! Operations on rubber and touch: `features` on reference images, and `layer_line` against known
//! properties.

use core::f64::consts::{FRAC_PI_2, PI};

use serde_json::{Value, json};

use crate::ask::{Table, ask, flat};

const PITCH_MM: f64 = 1.5875;

#[test]
fn features_of_the_reference_images() {
    let images = Table::read("contact/tactile3d_images.csv", 26);
    let wanted = Table::read("contact/tactile3d_features.csv", 52);
    let mut angles = 0;
    for row in 0..images.len() {
        let name = images.word(row, "case");
        let want = (0..wanted.len())
            .find(|r| wanted.word(*r, "case") == name && wanted.word(*r, "sampling") == "average")
            .unwrap();
        // The file runs along y first, counts tension positive and measures from the middle.
        let image: Vec<f64> =
            (0..256).map(|n| -images.number(row, &format!("s_{}_{}", n % 16, n / 16))).collect();
        let answer = &ask(&[json!({"op": "features", "image": image})])[0];
        let number = |key: &str| answer[key].as_f64().unwrap();
        let (area, lever) = (PITCH_MM * PITCH_MM, 12.7);
        let force = wanted.number(want, "M0").abs();
        // The images are printed with nine digits.
        let near = |got: f64, column: &str, size: f64| {
            let off = (got - wanted.number(want, column)).abs();
            assert!(off < 3e-9 * size, "{name} {column}: {got}, off by {off:e}");
        };
        near(-number("m0") * area, "M0", force);
        near(-number("m_x_centred") * area * PITCH_MM, "Mx", force * lever);
        near((number("x_c") - 8.5) * PITCH_MM, "xc", lever);
        near((number("y_c") - 8.5) * PITCH_MM, "yc", lever);
        let m0 = number("m0");
        let central = |m: &str, a: &str, b: &str| number(m) - number(a) * number(b) / m0;
        let second = area * PITCH_MM * PITCH_MM;
        near(-central("m_yy", "m_y", "m_y") * second, "mu_xx", force * lever * lever);
        near(-central("m_xx", "m_x", "m_x") * second, "mu_yy", force * lever * lever);
        near(-central("m_xy", "m_x", "m_y") * second, "mu_xy", force * lever * lever);
        let round = name.starts_with("sphere") && name.ends_with("x0_y0");
        assert_eq!(answer["defined"], json!({"x_c": true, "theta_z": !round}), "{name}");
        if round {
            assert_eq!(answer["theta_z_rad"], Value::Null, "{name}");
            continue;
        }
        let off = number("theta_z_rad") + FRAC_PI_2 - wanted.number(want, "theta_long_rad");
        let off = off - PI * (off / PI).round();
        assert!(off.abs() < 2e-7, "{name}: {off:e}");
        angles += 1;
    }
    assert_eq!(angles, 23);
}

#[test]
fn features_of_small_images() {
    let answers = ask(&[
        // Value 1 at row 1, column 3; value 2 at row 2, column 1; baseline 10.
        json!({"op": "features", "image": [10, 10, 11, 12, 10, 10], "rows": 2, "cols": 3,
            "baseline": 10}),
        json!({"op": "features", "image": [0, 0, 0, 0], "rows": 2, "cols": 2}),
        json!({"op": "features", "image": [-5, 1, 3, 2], "rows": 1, "cols": 4}),
        json!({"op": "features", "image": [-5, 1, 3, 2], "rows": 1, "cols": 4, "threshold": 2}),
        json!({"op": "features", "image": [-5, 1, 3, 2], "rows": 1, "cols": 4, "threshold": 1e-9}),
        json!({"op": "features", "image": [7], "rows": 1, "cols": 1}),
    ]);
    let first = &answers[0];
    for (key, want) in [("m0", 3), ("m_x", 5), ("m_y", 5), ("m_xx", 9), ("m_yy", 11), ("m_xy", 7)] {
        assert_eq!(first[key].as_f64(), Some(f64::from(want)), "{key}");
    }
    assert_eq!(first["m_x_centred"].as_f64(), Some(0.5));
    assert_eq!(first["x_c"].as_f64(), Some(5.0 / 3.0));
    for key in ["x_c", "y_c", "theta_z_rad"] {
        assert_eq!(answers[1][key], Value::Null);
    }
    assert_eq!(answers[1]["defined"], json!({"x_c": false, "theta_z": false}));
    let sums: Vec<f64> = answers[2..5].iter().map(|a| a["m0"].as_f64().unwrap()).collect();
    assert_eq!(sums, [1.0, 5.0, 6.0], "at 0 every value counts; above it, values from it on");
    assert_eq!(answers[5]["x_c"].as_f64(), Some(1.0));
    assert_eq!(answers[5]["defined"]["theta_z"], false, "one tactel has no direction");
}

fn line(t: Value, depth: f64, x: &[f64], p: f64, q: f64) -> Value {
    json!({"op": "layer_line", "t_mm": t, "nu": 0.49, "p_n_mm": p, "q_n_mm": q,
        "depth_mm": depth, "x_mm": x})
}

#[test]
fn a_line_load_is_carried_by_the_base() {
    let x: Vec<f64> = (-4000..=4000).map(|i| f64::from(i) * 0.01).collect();
    let answers = ask(&[
        line(json!(0.8), 0.8, &x, 1.0, 0.0),
        line(json!(0.8), 0.8, &x, 0.0, 1.0),
        line(json!("inf"), 0.8, &[0.0, 0.8], 1.0, 0.0),
        line(json!(0.8), 0.0, &[0.0], 1.0, 0.0),
    ]);
    let sum = |values: &[f64]| values.iter().sum::<f64>() * 0.01;
    let szz = flat(&answers[0]["szz"]);
    assert!((sum(&szz) + 1.0).abs() < 1e-9, "{}", sum(&szz));
    assert!(sum(&flat(&answers[0]["sxz"])).abs() < 1e-9);
    assert!((sum(&flat(&answers[1]["sxz"])).abs() - 1.0).abs() < 1e-9);
    assert!(flat(&answers[0]["uz_mm"]).iter().all(|u| u.abs() < 1e-12), "the base does not move");
    // Flamant: -2 P d^3 / (pi r^4).
    let flamant = flat(&answers[2]["szz"]);
    assert!((flamant[0] + 2.0 / (PI * 0.8)).abs() < 1e-14);
    assert!((flamant[1] + 0.5 / (PI * 0.8)).abs() < 1e-14);
    assert_eq!(answers[2]["uz_mm"], json!([null, null]));
    assert_eq!(answers[3]["uz_mm"], json!([null]), "infinite under the load");
}
