//! Every row of the arm's reference data passes the filter within the tolerances of the data.

use serde_json::{Value, json};
use taktil_mechanics::Joints;
use taktil_mechanics::transmission::Transmission;

use crate::ask::{Table, ask, assert_near, flat, toml_table};

#[test]
fn fk() {
    let table = Table::read("kinematics/fk.csv", 200);
    let requests: Vec<Value> = (0..table.len())
        .map(|row| json!({"op": "fk", "model": "puma260", "q": table.numbers(row, "q1", 6)}))
        .collect();
    for (row, answer) in ask(&requests).iter().enumerate() {
        assert_near(&flat(&answer["r"]), &table.numbers(row, "r11", 9), 1e-12, "r");
        assert_near(&flat(&answer["p_wrist"]), &table.numbers(row, "px", 3), 1e-12, "p_wrist");
        assert_near(&flat(&answer["p_tool"]), &table.numbers(row, "tool_px", 3), 1e-12, "p_tool");
    }
}

#[test]
fn jacobian_base() {
    let places = Table::read("kinematics/fk.csv", 200);
    let table = Table::read("kinematics/jacobian_base.csv", 200);
    let requests: Vec<Value> = (0..table.len())
        .map(|row| json!({"op": "jacobian", "q": places.numbers(row, "q1", 6), "frame": "base"}))
        .collect();
    for (row, answer) in ask(&requests).iter().enumerate() {
        assert_near(&flat(&answer["j"]), &table.numbers(row, "j11", 36), 1e-12, "j");
        let got = ["det", "sigma_max", "sigma_min"].map(|name| answer[name].as_f64().unwrap());
        // The reference is printed with 12 digits.
        let want = table.numbers(row, "det", 3);
        assert_near(&got[..1], &want[..1], 1e-12, "det");
        assert_near(&got[1..], &want[1..], 1e-11, "sigma");
        let factors = ["shoulder", "elbow", "wrist"]
            .map(|name| answer["singular_distance"][name].as_f64().unwrap());
        let product = 0.2032 * 0.2032 * 0.4064 * factors.iter().product::<f64>();
        assert_near(&[product], &[got[0]], 1e-15, "det from its factors");
    }
}

#[test]
fn jacobian_tool() {
    let places = Table::read("kinematics/fk.csv", 200);
    let table = Table::read("kinematics/jacobian_tool.csv", 60);
    let requests: Vec<Value> = (0..table.len())
        .map(|row| json!({"op": "jacobian", "q": places.numbers(row, "q1", 6), "frame": "tool"}))
        .collect();
    for (row, answer) in ask(&requests).iter().enumerate() {
        assert_near(&flat(&answer["j"]), &table.numbers(row, "j11", 36), 1e-12, "j");
    }
}

#[test]
fn ik_finds_every_branch_and_each_meets_its_pose() {
    let poses = Table::read("kinematics/ik_poses.csv", 100);
    let branches = Table::read("kinematics/ik_branches.csv", 800);
    let requests: Vec<Value> = (0..poses.len())
        .map(|row| {
            let (r, p) = (poses.numbers(row, "r11", 9), poses.numbers(row, "px", 3));
            json!({"op": "ik", "r": r, "p": p})
        })
        .collect();
    let answers = ask(&requests);
    let mut back = Vec::new();
    for (row, answer) in answers.iter().enumerate() {
        let found = answer["branches"].as_array().unwrap();
        assert_eq!(found.len() as f64, poses.number(row, "n_branches"));
        let inside = found.iter().filter(|b| b["in_limits"] == true).count();
        assert_eq!(inside as f64, poses.number(row, "n_in_limits"));
        for want in 8 * row..8 * row + 8 {
            let flags = ["shoulder", "elbow", "wrist"].map(|name| branches.number(want, name));
            let of = |b: &Value| ["shoulder", "elbow", "wrist"].map(|n| b[n].as_f64().unwrap());
            let branch = found.iter().find(|b| of(b) == flags).expect("a branch is missing");
            let q = flat(&branch["q"]);
            assert_near(&q, &branches.numbers(want, "q1", 6), 1e-11, "q");
            assert_eq!(branch["in_limits"] == true, branches.number(want, "in_limits") == 1.0);
            assert_eq!(branch["singular_flags"], branches.number(want, "singular_flags") as u64);
            back.push(json!({"op": "fk", "q": q}));
        }
    }
    for (index, answer) in ask(&back).iter().enumerate() {
        let row = index / 8;
        assert_near(&flat(&answer["r"]), &poses.numbers(row, "r11", 9), 1e-12, "r");
        assert_near(&flat(&answer["p_wrist"]), &poses.numbers(row, "px", 3), 1e-12, "p");
    }
}

#[test]
fn ik_names_the_branch_nearest_to_the_joints_before() {
    let poses = Table::read("kinematics/ik_poses.csv", 100);
    let branches = Table::read("kinematics/ik_branches.csv", 800);
    let mut requests = Vec::new();
    let mut wanted = Vec::new();
    for row in 0..branches.len() {
        if branches.number(row, "in_limits") == 1.0 && branches.number(row, "singular_flags") == 0.0
        {
            let pose = row / 8;
            let previous = branches.numbers(row, "q1", 6);
            requests.push(json!({"op": "ik", "r": poses.numbers(pose, "r11", 9),
                "p": poses.numbers(pose, "px", 3), "previous": previous}));
            wanted.push(previous);
        }
    }
    assert!(wanted.len() > 100);
    let answers = ask(&requests);
    for (answer, previous) in answers.iter().zip(&wanted) {
        let index = answer["nearest"].as_u64().unwrap() as usize;
        let q = flat(&answer["branches"][index]["q"]);
        // Another branch may be nearer where a full turn brings it inside the limits.
        let within = q.iter().zip(previous).all(|(a, b)| (a - b).abs() < 1e-9);
        let arm = taktil_mechanics::puma260::Puma260::reference();
        let reachable = arm.within_limits(&Joints::from_column_slice(previous));
        assert!(within || !reachable, "{q:?} for {previous:?}");
    }
    let far = json!({"op": "ik", "r": [1, 0, 0, 0, 1, 0, 0, 0, 1], "p": [5, 0, 0],
        "previous": [0, 0, 0, 0, 0, 0]});
    let answer = &ask(&[far])[0];
    assert_eq!(answer["branches"], json!([]));
    assert_eq!(answer["nearest"], Value::Null);
}

#[test]
fn encoder_both_ways() {
    let table = Table::read("kinematics/encoder.csv", 50);
    let gears = Transmission::reference();
    let forth: Vec<Value> = (0..table.len())
        .map(|row| json!({"op": "encoder", "q": table.numbers(row, "q1", 6)}))
        .collect();
    let back: Vec<Value> = (0..table.len())
        .map(|row| {
            let counts: Vec<i64> = table.numbers(row, "n1", 6).iter().map(|n| *n as i64).collect();
            json!({"op": "encoder", "counts": counts})
        })
        .collect();
    for (row, answer) in ask(&forth).iter().enumerate() {
        let exact = gears.exact_counts(&Joints::from_column_slice(&table.numbers(row, "q1", 6)));
        let pairs = flat(&answer["counts"]).into_iter().zip(table.numbers(row, "n1", 6));
        for (i, (got, want)) in pairs.enumerate() {
            let halfway = ((exact[i] - exact[i].floor()) - 0.5).abs() < 1e-6;
            assert!(got == want || (halfway && (got - want).abs() == 1.0), "row {row} joint {i}");
        }
    }
    for (row, answer) in ask(&back).iter().enumerate() {
        assert_near(&flat(&answer["q"]), &table.numbers(row, "qback1", 6), 1e-12, "q");
    }
}

#[test]
fn paul_joint_moves_with_their_derivatives() {
    let moves = toml_table("kinematics/moves.toml");
    for (number, ticks) in [(1, 352), (2, 670), (3, 512)] {
        let name = format!("joint_move_{number}");
        let of = |key: &str| serde_json::to_value(&moves[&name][key]).unwrap();
        let request =
            json!({"op": "paul_joint", "points": of("via"), "t_s": of("T"), "tau_s": of("tau")});
        let answer = &ask(&[request])[0];
        let table = Table::read(&format!("kinematics/{name}.csv"), ticks);
        assert_eq!(answer["q"].as_array().unwrap().len(), ticks, "{name}");
        for row in 0..ticks {
            assert_eq!(table.number(row, "tick"), row as f64);
            assert_near(&flat(&answer["q"][row]), &table.numbers(row, "q1", 6), 1e-9, &name);
        }
        let slopes = Table::read(&format!("kinematics/{name}_deriv.csv"), ticks.div_ceil(10));
        for row in 0..slopes.len() {
            let tick = slopes.number(row, "tick") as usize;
            assert_near(&flat(&answer["qd"][tick]), &slopes.numbers(row, "qd1", 6), 1e-9, &name);
            assert_near(&flat(&answer["qdd"][tick]), &slopes.numbers(row, "qdd1", 6), 1e-8, &name);
        }
    }
}

#[test]
fn paul_cartesian_moves_and_blends() {
    let moves = toml_table("kinematics/moves.toml");
    let cases = [
        ("cart_move_1", "cart_move_1", "paul", 400),
        ("cart_move_2", "cart_move_2", "paul", 480),
        ("cart_blend", "cart_blend_paul", "paul", 620),
        ("cart_blend", "cart_blend_smooth", "smooth", 310),
        ("cart_blend", "cart_blend_so3", "so3", 310),
    ];
    for (name, file, blend, ticks) in cases {
        let of = |key: &str| serde_json::to_value(&moves[name][key]).unwrap();
        let poses: Vec<Value> = of("via")
            .as_array()
            .unwrap()
            .iter()
            .map(|via| {
                let (r, p) = via.as_array().unwrap().split_at(9);
                json!({"r": r, "p": p})
            })
            .collect();
        let table = Table::read(&format!("kinematics/{file}.csv"), ticks + 1);
        let mut request = json!({"op": "paul_cartesian", "poses": poses, "t_s": of("T"),
            "tau_s": of("tau"), "blend": blend});
        let with_joints = blend == "paul";
        if with_joints {
            request["start_q"] = json!(table.numbers(0, "q1", 6));
        }
        let answer = &ask(&[request])[0];
        for row in 0..table.len() {
            let tick = table.number(row, "tick") as usize;
            assert_near(&flat(&answer["p"][tick]), &table.numbers(row, "px", 3), 2e-9, file);
            let turn = flat(&answer["quaternion"][tick]);
            assert_near(&turn, &table.numbers(row, "qw", 4), 5e-9, file);
            if with_joints {
                assert_near(&flat(&answer["q"][tick]), &table.numbers(row, "q1", 6), 5e-9, file);
            }
        }
        assert_eq!(answer.get("q").is_some(), with_joints);
    }
}

#[test]
fn dls() {
    let table = Table::read("kinematics/dls.csv", 30);
    let requests: Vec<Value> = (0..table.len())
        .map(|row| {
            json!({"op": "dls", "q": table.numbers(row, "q1", 6),
                "twist": table.numbers(row, "vx", 6), "lambda": table.number(row, "lambda")})
        })
        .collect();
    for (row, answer) in ask(&requests).iter().enumerate() {
        assert_near(&flat(&answer["qd"]), &table.numbers(row, "qd1", 6), 1e-9, "qd");
        let residual = answer["residual"].as_f64().unwrap();
        assert_near(&[residual], &[table.number(row, "residual_norm")], 1e-9, "residual");
    }
}

#[test]
fn rnea() {
    let table = Table::read("kinematics/rnea.csv", 100);
    for (terms, column) in [("rigid", "tau1"), ("grav", "grav1"), ("full", "full1")] {
        let requests: Vec<Value> = (0..table.len())
            .map(|row| {
                json!({"op": "rnea", "q": table.numbers(row, "q1", 6),
                    "qd": table.numbers(row, "qd1", 6),
                    "qdd": table.numbers(row, "qdd1", 6),
                    "terms": terms})
            })
            .collect();
        for (row, answer) in ask(&requests).iter().enumerate() {
            assert_near(&flat(&answer["tau_nm"]), &table.numbers(row, column, 6), 1e-10, terms);
        }
    }
}

#[test]
fn free_motion_with_and_without_torque() {
    let torque = serde_json::to_value(toml_table("kinematics/sim_driven.toml")).unwrap();
    for (name, rows, torque) in [("sim_passive", 51, Value::Null), ("sim_driven", 101, torque)] {
        let table = Table::read(&format!("kinematics/{name}.csv"), rows);
        let request = json!({"op": "free_motion", "q": table.numbers(0, "q1", 6),
            "qd": table.numbers(0, "qd1", 6), "torque": torque,
            "t_end_s": table.number(rows - 1, "t"), "sample_s": table.number(1, "t")});
        let answer = &ask(&[request])[0];
        assert_eq!(answer["t_s"].as_array().unwrap().len(), rows, "{name}");
        for row in 0..rows {
            let at = |key: &str| flat(&answer[key][row]);
            assert_near(&at("t_s"), &[table.number(row, "t")], 1e-12, name);
            assert_near(&at("q"), &table.numbers(row, "q1", 6), 1e-6, name);
            assert_near(&at("qd"), &table.numbers(row, "qd1", 6), 1e-5, name);
            assert_near(&at("kinetic_j"), &[table.number(row, "kinetic")], 1e-5, name);
            assert_near(&at("potential_j"), &[table.number(row, "potential")], 1e-5, name);
        }
    }
}

#[test]
fn a_free_motion_ends_where_it_was_asked_to_between_samples_too() {
    let q = [0.0, 0.7, -2.6, 0.0, 0.4, 0.0];
    let ends = |t_end_s: f64, sample_s: f64| {
        let request = json!({"op": "free_motion", "q": q, "qd": [0, 0, 0, 0, 0, 0],
            "t_end_s": t_end_s, "sample_s": sample_s, "step_s": 0.0005});
        let answer = ask(&[request]).remove(0);
        let times = flat(&answer["t_s"]);
        let last = flat(&answer["q"].as_array().unwrap()[times.len() - 1]);
        (times, last)
    };
    let (times, cut) = ends(0.05, 0.03);
    assert_eq!(times, [0.0, 0.03, 0.05]);
    let (_, whole) = ends(0.05, 0.05);
    assert_near(&cut, &whole, 1e-9, "the same motion in other pieces");
    assert_eq!(ends(0.01, 1e9).0, [0.0, 0.01]);
    // Rounding does not add a row.
    assert_eq!(ends(0.3, 0.1).0.len(), 4);
    assert_eq!(ends(0.7, 0.1).0.len(), 8);
}
