//! `taktil calc` as a filter between pipes: one answer for each request, in order, with invalid
//! requests between them. The reference data are tested through the library.

use std::io::Write;
use std::process::{Command, Stdio};

use serde_json::Value;

use crate::process::{ProcessOutput, TAKTIL};

fn calc(input: &[u8]) -> ProcessOutput {
    let mut command = Command::new(TAKTIL);
    command.arg("calc").stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().unwrap();
    let mut pipe = child.stdin.take().unwrap();
    let input = input.to_vec();
    let writer = std::thread::spawn(move || pipe.write_all(&input));
    let said = ProcessOutput::of(&child.wait_with_output().unwrap());
    let _ = writer.join();
    said
}

fn answers(said: &ProcessOutput) -> Vec<Value> {
    said.out.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[test]
fn requests_are_answered_in_order_and_bad_ones_do_not_end_it() {
    let said = calc(
        b"{\"id\":1,\"op\":\"fk\",\"q\":[0,0.7,-2.7,-3.1,1.2,3.1]}\n\
          not json\n\
          {\"id\":2,\"op\":\"fly\"}\n\
          {\"id\":3,\"op\":\"fk\",\"q\":[0,0.7]}\n\
          {\"id\":4,\"op\":\"encoder\",\"q\":[0,0,0,0,0,0]}\n",
    )
    .expect_code(0);
    let all = answers(&said);
    assert_eq!(all.len(), 5, "{}", said.out);
    let ok: Vec<bool> = all.iter().map(|answer| answer["ok"].as_bool().unwrap()).collect();
    assert_eq!(ok, [true, false, false, false, true], "{}", said.out);
    let ids: Vec<&Value> = all.iter().map(|answer| &answer["id"]).collect();
    assert_eq!(ids, [&1.into(), &Value::Null, &2.into(), &3.into(), &4.into()]);
}

#[test]
fn the_inverse_finds_the_angles_of_the_forward_kinematics() {
    let q = [0.1, 0.7, -2.6, -3.0, 1.2, 3.0];
    let forward = calc(format!("{{\"op\":\"fk\",\"q\":{}}}\n", Value::from(q.to_vec())).as_bytes());
    let pose = &answers(&forward.expect_code(0))[0];
    assert_eq!(pose["ok"], true, "{pose}");
    let request = format!("{{\"op\":\"ik\",\"r\":{},\"p\":{}}}\n", pose["r"], pose["p_wrist"]);
    let back = &answers(&calc(request.as_bytes()).expect_code(0))[0];
    assert_eq!(back["ok"], true, "{pose} {back}");
    let branches = back["branches"].as_array().unwrap();
    let near = branches.iter().any(|branch| {
        let found = branch["q"].as_array().unwrap();
        found.iter().zip(q).all(|(a, b)| {
            let turn = std::f64::consts::TAU;
            let off = (a.as_f64().unwrap() - b).rem_euclid(turn);
            off.min(turn - off) < 1e-9
        })
    });
    assert!(near, "{back}");
}

#[test]
fn an_empty_input_has_an_empty_answer_and_garbage_a_refusal() {
    assert_eq!(calc(b"").expect_code(0).out, "");
    let said = calc(b"\xff\xfe\x00\n").expect_code(0);
    assert_eq!(answers(&said)[0]["ok"], false, "{}", said.out);
}

#[test]
fn the_list_names_every_operation() {
    let folder = crate::process::Folder::new();
    let said = crate::process::taktil(folder.path(), &["calc", "--list"]).expect_code(0);
    for op in ["fk", "jacobian", "ik", "encoder", "paul_joint", "features"] {
        assert!(said.out.contains(op), "`{op}` is not listed");
    }
}
