//! Invalid requests: each is answered with an error, and the filter goes on.

use serde_json::{Value, json};

use crate::ask::{ask, ask_text};

fn answer_to(request: &Value) -> Value {
    let mut answers = ask_text(format!("{request}\n").as_bytes());
    assert_eq!(answers.len(), 1);
    answers.remove(0)
}

/// Checks that the request fails with this code and field, and that its id returns.
fn rejects(mut request: Value, code: &str, field: Option<&str>) {
    request["id"] = json!({"any": [1, "thing", null]});
    let answer = answer_to(&request);
    assert_eq!(answer["ok"], false, "{request} was taken: {answer}");
    assert_eq!(answer["id"], request["id"]);
    let error = &answer["error"];
    assert_eq!(
        (error["code"].as_str(), error["field"].as_str()),
        (Some(code), field),
        "{request}: {error}"
    );
    // The message is long enough to explain, and holds no number of three hundred digits.
    let message = error["message"].as_str().unwrap();
    assert!((11..300).contains(&message.len()), "{error}");
}

fn fk_with(key: &str, value: Value) -> Value {
    let mut request = json!({"op": "fk", "q": [0, 0, 0, 0, 0, 0]});
    request[key] = value;
    request
}

#[test]
fn bad_lines_are_answered_and_do_not_stop_the_filter() {
    let text: &[u8] = b"\n   \r\n{\"op\": \"fk\", \"q\": [0,0,0,0,0,0], \"id\": 1}\r\n\
        not json\n{\"op\": \n\
        [1, 2]\nnull\n\"fk\"\n\xFF\xFE\n{\"op\": \"fk\", \"q\": [NaN,0,0,0,0,0], \"id\": 2}\n\
        {\"op\": \"fk\", \"q\": [1e999,0,0,0,0,0], \"id\": 3}\n\n\
        {\"op\": \"fk\", \"q\": [0,0,0,0,0,0], \"id\": 4}";
    let answers = ask_text(text);
    let codes: Vec<Value> = answers.iter().map(|a| a["error"]["code"].clone()).collect();
    let bad = "bad_json";
    let shape = "not_an_object";
    assert_eq!(json!(codes), json!([null, bad, bad, shape, shape, shape, bad, bad, bad, null]));
    assert_eq!(answers[0]["id"], 1);
    assert_eq!(answers[9]["id"], 4, "a last line without its end counts");
    assert!(ask_text(b"").is_empty());
    assert!(ask_text(b"\n\n  \n").is_empty());
}

#[test]
fn a_duplicate_key_is_an_error_and_the_filter_goes_on() {
    let text = b"{\"op\":\"fk\",\"q\":[0,0,0,0,0,0],\"q\":[1,0,0,0,0,0]}\n\
        {\"op\":\"contact_3d\",\"shape\":{\"sphere\":{\"radius_mm\":5,\"radius_mm\":9}},\
        \"t_mm\":0.8,\"nu\":0.4,\"force_n\":1}\n\
        {\"op\":\"fk\",\"q\":[0,0,0,0,0,0]}\n";
    let answers = ask_text(text);
    assert_eq!(answers.len(), 3);
    for (answer, key) in answers.iter().zip(["`q`", "`radius_mm`"]) {
        assert_eq!(answer["error"]["code"], "bad_json", "{answer}");
        let message = answer["error"]["message"].as_str().unwrap();
        assert!(message.contains(key) && message.contains("twice"), "{message}");
    }
    assert_eq!(answers[2]["ok"], true);
}

#[test]
fn deep_and_long_lines_do_not_end_the_filter() {
    let deep = format!("{}{}\n", "[".repeat(100_000), "]".repeat(100_000));
    let long = format!("{{\"op\": \"{}\"}}\n", "x".repeat(1 << 20));
    let too_long = " ".repeat((64 << 20) + 5) + "{\"op\": \"fk\"}\n";
    let good = "{\"op\": \"encoder\", \"counts\": [0, 0, 0, 0, 0, 0]}\n";
    let text = [&deep, &long, &too_long, good].concat();
    let answers = ask_text(text.as_bytes());
    let codes: Vec<&Value> = answers.iter().map(|a| &a["error"]["code"]).collect();
    assert_eq!(json!(codes), json!(["bad_json", "unknown_op", "line_too_long", null]));
}

#[test]
fn unknown_missing_and_mistyped_fields_are_named() {
    rejects(json!({}), "missing_field", Some("op"));
    rejects(json!({"op": 3}), "wrong_type", Some("op"));
    rejects(json!({"op": "fly"}), "unknown_op", Some("op"));
    rejects(json!({"op": "FK", "q": [0, 0, 0, 0, 0, 0]}), "unknown_op", Some("op"));
    rejects(json!({"op": "fk"}), "missing_field", Some("q"));
    rejects(fk_with("Q", json!(1)), "unknown_field", Some("Q"));
    rejects(fk_with("q", json!(null)), "wrong_type", Some("q"));
    rejects(fk_with("q", json!("0 0 0 0 0 0")), "wrong_type", Some("q"));
    rejects(fk_with("q", json!({"0": 1})), "wrong_type", Some("q"));
    rejects(fk_with("q", json!([])), "wrong_length", Some("q"));
    rejects(fk_with("q", json!([0, 0, 0, 0, 0])), "wrong_length", Some("q"));
    rejects(fk_with("q", json!([0, 0, 0, 0, 0, 0, 0])), "wrong_length", Some("q"));
    rejects(fk_with("q", json!([0, 0, null, 0, 0, 0])), "wrong_type", Some("q[2]"));
    rejects(fk_with("q", json!([0, 0, 0, 0, 0, "1"])), "wrong_type", Some("q[5]"));
    rejects(fk_with("q", json!([[0], 0, 0, 0, 0, 0])), "wrong_type", Some("q[0]"));
    rejects(fk_with("tool_z_m", json!(null)), "wrong_type", Some("tool_z_m"));
    rejects(fk_with("tool_z_m", json!("long")), "wrong_type", Some("tool_z_m"));
    for huge in [1e300, -1e300, 2.5e17] {
        rejects(fk_with("tool_z_m", json!(huge)), "out_of_range", Some("tool_z_m"));
    }
    rejects(fk_with("model", json!("puma560")), "unknown_value", Some("model"));
    rejects(fk_with("model", json!(260)), "wrong_type", Some("model"));
    rejects(fk_with("timing", json!("yes")), "wrong_type", Some("timing"));
    rejects(fk_with("timing", json!(null)), "wrong_type", Some("timing"));
    for repeat in [json!(0), json!(-1), json!(1.5), json!(1e12)] {
        rejects(fk_with("repeat", repeat), "out_of_range", Some("repeat"));
    }
    rejects(fk_with("repeat", json!("many")), "wrong_type", Some("repeat"));
}

#[test]
fn each_operation_rejects_impossible_requests() {
    let q = json!([0, 0, 0, 0, 0, 0]);
    let eye = json!([1, 0, 0, 0, 1, 0, 0, 0, 1]);
    rejects(json!({"op": "jacobian", "q": q, "frame": "world"}), "unknown_value", Some("frame"));
    for r in [[0; 9], [1, 0, 0, 0, 1, 0, 0, 0, -1], [2, 0, 0, 0, 2, 0, 0, 0, 2]] {
        rejects(json!({"op": "ik", "r": r, "p": [0.3, 0, 0]}), "not_a_rotation", Some("r"));
    }
    rejects(json!({"op": "ik", "r": eye, "p": [0.3, 0]}), "wrong_length", Some("p"));
    rejects(
        json!({"op": "ik", "r": eye, "p": [0.3, 0, 0], "previous": [0]}),
        "wrong_length",
        Some("previous"),
    );
    rejects(json!({"op": "dls", "q": q, "twist": q, "lambda": 0}), "singular", Some("lambda"));
    rejects(
        json!({"op": "dls", "q": q, "twist": q, "lambda": -0.3}),
        "out_of_range",
        Some("lambda"),
    );
    rejects(json!({"op": "encoder"}), "missing_field", Some("q"));
    rejects(json!({"op": "encoder", "q": q, "counts": q}), "too_many_fields", Some("q"));
    rejects(json!({"op": "encoder", "q": [1e9, 0, 0, 0, 0, 0]}), "out_of_range", Some("q[0]"));
    rejects(
        json!({"op": "encoder", "counts": [0.5, 0, 0, 0, 0, 0]}),
        "wrong_type",
        Some("counts[0]"),
    );
    rejects(
        json!({"op": "encoder", "counts": [0, 3_000_000_000_u32, 0, 0, 0, 0]}),
        "wrong_type",
        Some("counts[1]"),
    );
    let huge = json!([1e200, 1e200, 0, 0, 0, 0]);
    rejects(json!({"op": "rnea", "q": q, "qd": huge, "qdd": q}), "not_finite", None);
    rejects(
        json!({"op": "rnea", "q": q, "qd": q, "qdd": q, "terms": "all"}),
        "unknown_value",
        Some("terms"),
    );
    rejects(json!({"op": "features", "image": []}), "wrong_length", Some("image"));
    rejects(
        json!({"op": "features", "image": [1, 2, 3], "rows": 2, "cols": 2}),
        "wrong_length",
        Some("image"),
    );
    rejects(
        json!({"op": "features", "image": [1], "rows": 0, "cols": 1}),
        "out_of_range",
        Some("rows"),
    );
    rejects(
        json!({"op": "features", "image": [1], "rows": 1, "cols": 1, "threshold": -1}),
        "out_of_range",
        Some("threshold"),
    );
    rejects(
        json!({"op": "features", "image": [1e308], "rows": 1, "cols": 1, "baseline": -1e308}),
        "out_of_range",
        Some("image[0]"),
    );
    rejects(
        json!({"op": "features", "image": [1, null], "rows": 1, "cols": 2}),
        "wrong_type",
        Some("image[1]"),
    );
}

#[test]
fn tool_paths_are_checked() {
    let pose = |x: f64| json!({"r": [-1, 0, 0, 0, 1, 0, 0, 0, -1], "p": [x, -0.06, -0.1]});
    let base = json!({"op": "paul_cartesian", "poses": [pose(0.32), pose(0.3)], "t_s": [1],
        "tau_s": 0.1});
    let with = |key: &str, value: Value| {
        let mut request = base.clone();
        request[key] = value;
        request
    };
    ask(std::slice::from_ref(&base));
    rejects(with("poses", json!([])), "wrong_length", Some("poses"));
    rejects(with("poses", json!([pose(0.3)])), "wrong_length", Some("poses"));
    rejects(with("poses", json!([pose(0.3), 7])), "wrong_type", Some("poses[1]"));
    rejects(with("poses", json!(7)), "wrong_type", Some("poses"));
    let lost = json!({"r": [1, 0, 0, 0, 1, 0, 0, 0, 1]});
    rejects(with("poses", json!([pose(0.3), lost])), "missing_field", Some("poses[1].p"));
    let stretched = json!({"r": [2, 0, 0, 0, 1, 0, 0, 0, 1], "p": [0, 0, 0]});
    rejects(with("poses", json!([pose(0.3), stretched])), "not_a_rotation", Some("poses[1].r"));
    let odd = json!({"r": [1, 0, 0, 0, 1, 0, 0, 0, 1], "p": [0, 0, 0], "t": 1});
    rejects(with("poses", json!([odd, pose(0.3)])), "unknown_field", Some("poses[0].t"));
    rejects(with("blend", json!("rough")), "unknown_value", Some("blend"));
    rejects(with("tau_s", json!(0.6)), "out_of_range", Some("tau_s"));
    rejects(with("t_s", json!([1e300])), "out_of_range", Some("rate_hz"));
    let start = json!([0, 0.7, -2.6, 0, 0.6, 0]);
    let mut far = with("poses", json!([pose(0.32), pose(9.0)]));
    far["start_q"] = start;
    rejects(far, "unreachable", Some("poses"));
}

#[test]
fn paths_and_motions_are_checked() {
    let base = json!({"op": "paul_joint", "t_s": [1], "tau_s": 0.1,
        "points": [[0, 0, 0, 0, 0, 0], [1, 0, 0, 0, 0, 0]]});
    let with = |key: &str, value: Value| {
        let mut request = base.clone();
        request[key] = value;
        request
    };
    ask(std::slice::from_ref(&base));
    rejects(with("points", json!([])), "wrong_length", Some("points"));
    rejects(with("points", json!([[0, 0, 0, 0, 0, 0]])), "wrong_length", Some("points"));
    rejects(with("points", json!([[0, 0, 0, 0, 0, 0], [1]])), "wrong_length", Some("points[1]"));
    rejects(with("points", json!([[0, 0, 0, 0, 0, 0], 7])), "wrong_type", Some("points[1]"));
    rejects(
        with("points", json!([[0, 0, 0, 0, 0, 0], [0, 0, 0, 0, null, 0]])),
        "wrong_type",
        Some("points[1][4]"),
    );
    rejects(with("t_s", json!([1, 1])), "wrong_length", Some("t_s"));
    rejects(with("t_s", json!([0])), "out_of_range", Some("t_s[0]"));
    rejects(with("t_s", json!([1e300])), "out_of_range", Some("rate_hz"));
    rejects(with("tau_s", json!(0.6)), "out_of_range", Some("tau_s"));
    rejects(with("tau_s", json!(-0.1)), "out_of_range", Some("tau_s"));
    rejects(with("rate_hz", json!(0)), "out_of_range", Some("rate_hz"));
    rejects(with("rate_hz", json!(1e9)), "out_of_range", Some("rate_hz"));
    let q = json!([0, 0, 0, 0, 0, 0]);
    let motion = json!({"op": "free_motion", "q": q, "qd": q, "t_end_s": 0.01, "sample_s": 0.01});
    let with = |key: &str, value: Value| {
        let mut request = motion.clone();
        request[key] = value;
        request
    };
    ask(&[motion.clone(), with("torque", json!(null)), with("t_end_s", json!(0.001))]);
    rejects(with("t_end_s", json!(0)), "out_of_range", Some("t_end_s"));
    rejects(with("sample_s", json!(-1)), "out_of_range", Some("sample_s"));
    rejects(with("step_s", json!(1e-12)), "out_of_range", Some("step_s"));
    rejects(with("t_end_s", json!(1e300)), "out_of_range", Some("sample_s"));
    rejects(with("method", json!("euler")), "unknown_value", Some("method"));
    rejects(with("torque", json!([1])), "wrong_type", Some("torque"));
    rejects(with("torque", json!({"hold": q})), "missing_field", Some("torque.amp"));
    let table = json!({"hold": q, "amp": q, "freq": q, "phase": q, "power": 1});
    rejects(with("torque", table), "unknown_field", Some("torque.power"));
    rejects(with("qd", json!([1e200, 0, 0, 0, 0, 0])), "not_finite", None);
}

#[test]
fn layers_are_checked_under_the_names_of_the_request() {
    let base = json!({"op": "layer_line", "t_mm": 0.8, "nu": 0.49, "p_n_mm": 1, "q_n_mm": 0,
        "depth_mm": 0.8, "x_mm": [0]});
    let with = |key: &str, value: Value| {
        let mut request = base.clone();
        request[key] = value;
        request
    };
    ask(&[base.clone(), with("x_mm", json!([])), with("t_mm", json!("inf"))]);
    rejects(with("t_mm", json!("thick")), "wrong_type", Some("t_mm"));
    rejects(with("t_mm", json!(0)), "out_of_range", Some("t_mm"));
    rejects(with("nu", json!(0.6)), "out_of_range", Some("nu"));
    rejects(with("youngs_mpa", json!(-1)), "out_of_range", Some("youngs_mpa"));
    rejects(with("depth_mm", json!(1.0)), "out_of_range", Some("depth_mm"));
    rejects(with("depth_mm", json!(-0.1)), "out_of_range", Some("depth_mm"));
    rejects(with("x_mm", json!(0)), "wrong_type", Some("x_mm"));
    rejects(with("x_mm", json!([0, null])), "wrong_type", Some("x_mm[1]"));
    ask(&[with("x_mm", json!([1e300, -1e300]))]);
}

#[test]
fn numbers_read_back_bit_for_bit() {
    let q = [0.1 + 0.2, -1.0 / 3.0, f64::MIN_POSITIVE, 5e-324, 1e22, -0.0];
    let answer = answer_to(&json!({"op": "fk", "q": q, "id": [q[0], 12_345_678_901_234_567_u64]}));
    assert_eq!(answer["id"], json!([q[0], 12_345_678_901_234_567_u64]));
    let arm = taktil_mechanics::puma260::Puma260::reference();
    let want = arm.tool_pose(&q.into()).translation.to_array();
    for (i, want) in want.iter().enumerate() {
        assert_eq!(answer["p_tool"][i].as_f64().unwrap().to_bits(), want.to_bits());
    }
}

#[test]
fn timing_is_returned_on_request() {
    let zero = [0.0; 6];
    let request = json!({"op": "rnea", "q": zero, "qd": zero, "qdd": zero});
    let plain = &ask(std::slice::from_ref(&request))[0];
    assert!(plain.get("ns").is_none());
    let mut timed = request;
    timed["timing"] = true.into();
    timed["repeat"] = 1000.into();
    let timed = &ask(&[timed])[0];
    assert!(timed["ns"].as_u64().is_some_and(|ns| ns < 1_000_000_000), "{timed}");
    assert_eq!(plain["tau_nm"], timed["tau_nm"]);
}

#[test]
fn a_closed_output_is_no_error() {
    struct Closed;
    impl std::io::Write for Closed {
        fn write(&mut self, _: &[u8]) -> std::io::Result<usize> {
            Err(std::io::ErrorKind::BrokenPipe.into())
        }
        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }
    let text = b"{\"op\": \"fk\"}\n{\"op\": \"fk\"}\n";
    taktil_lab_calc::filter(&mut &text[..], &mut Closed).unwrap();
}

#[test]
fn numbers_too_large_are_named_with_a_remedy() {
    let shape = json!({"cylinder": {"radius_mm": 22.9}});
    rejects(
        json!({"op": "contact_2d", "shape": shape, "load": {"p_n_mm": 1}, "method": "fem",
            "t_mm": 0.8, "nu": 0.49, "mesh": [1e300, 4]}),
        "out_of_range",
        Some("mesh"),
    );
    let large = json!({"op": "features", "image": [1, 1e308, -5e307], "rows": 1, "cols": 3});
    rejects(large.clone(), "out_of_range", Some("image[1]"));
    let message = answer_to(&large)["error"]["message"].as_str().unwrap().to_owned();
    assert!(message.contains("`image[1]`") && message.contains("scale"), "{message}");
}

#[test]
fn errors_state_the_given_and_the_expected_value() {
    for (op, came) in
        [(json!(5), "a number"), (json!([]), "a list"), (json!(true), "true or false")]
    {
        rejects(json!({"op": op}), "wrong_type", Some("op"));
        let message =
            answer_to(&json!({"op": op}))["error"]["message"].as_str().unwrap().to_owned();
        assert_eq!(message, format!("`op` is {came}; wanted: a text"));
    }
    let contact = |fields: Value| {
        let mut request = json!({"op": "contact_2d", "t_mm": 0.8, "nu": 0.49,
            "shape": {"flat": {"width_mm": 12.7}}, "load": {"p_n_mm": 1}});
        for (key, value) in fields.as_object().unwrap() {
            request[key] = value.clone();
        }
        request
    };
    rejects(contact(json!({"move": {"dz_mm": 0.01}})), "conflict", Some("load"));
    rejects(contact(json!({"load": null})), "missing_field", Some("load"));
    for x in [json!([0, 1, 1]), json!([0, 2, 1])] {
        let shape = json!({"profile": {"x_mm": x, "z_mm": [0, 0, 0]}});
        rejects(contact(json!({"shape": shape})), "not_ascending", Some("shape.profile.x_mm[2]"));
    }
    let shape = json!({"profile": {"x_mm": [0, 1], "z_mm": [0, 0, 0]}});
    rejects(contact(json!({"shape": shape})), "wrong_length", Some("shape.profile"));
}

#[test]
fn a_bar_between_the_nodes_of_its_mesh_is_not_said_to_topple() {
    let bar = |width: f64, mesh: Value| {
        json!({"op": "contact_2d", "shape": {"flat": {"width_mm": width}}, "load": {"p_n_mm": 1},
            "method": "fem", "t_mm": 0.8, "nu": 0.49, "mesh": mesh})
    };
    for (width, mesh) in [(0.01, json!([64, 4])), (0.5, json!([64, 4])), (0.3, json!([63, 4]))] {
        rejects(bar(width, mesh), "out_of_range", Some("mesh"));
    }
    assert_eq!(answer_to(&bar(0.5, json!([63, 4])))["ok"], true);
}

/// On such a layer the second moment of a bar is that of its load, however wide the bar is.
#[test]
fn a_layer_that_hides_the_width_does_not_panic() {
    for nu in [0.3, 0.5] {
        for t_mm in [1e9, 1e12, 1e29] {
            let answer =
                answer_to(&json!({"op": "recover", "case": 2, "m1": -4.72, "m2": 1, "t_mm": t_mm,
                "p_n_mm": 0.35, "q_n_mm": 0.05, "nu": nu}));
            let code = answer["error"]["code"].as_str();
            assert_eq!((&answer["ok"], code), (&json!(false), Some("unreachable")), "{answer}");
        }
    }
}
