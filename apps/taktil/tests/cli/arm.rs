//! `taktil arm` on the URDF files of this repository, and on files that describe no arm.

use crate::process::{Folder, scenes, taktil};

fn arms(name: &str) -> String {
    scenes().join("../arms").join(name).to_str().unwrap().to_owned()
}

#[test]
fn the_arms_of_the_repository_are_recognised_and_reached() {
    let folder = Folder::new();
    for (name, joints, closed) in
        [("puma260.urdf", 6, true), ("ur5e-like.urdf", 6, false), ("seven-joints.urdf", 7, false)]
    {
        let file = arms(name);
        let said =
            taktil(folder.path(), &["arm", &file, "--poses", "100", "--json"]).expect_code(0);
        let answer: serde_json::Value = serde_json::from_str(&said.out).unwrap();
        assert_eq!(answer["closed_form"], closed, "{name}");
        assert_eq!(answer["joints"].as_array().unwrap().len(), joints);
        assert!(answer["found"].as_u64().unwrap() >= 99, "{answer}");
        let most = if closed { 1e-14 } else { 1.1e-10 };
        assert!(answer["worst_m"].as_f64().unwrap() < most, "{answer}");
    }
    let said =
        taktil(folder.path(), &["arm", &arms("puma260.urdf"), "--poses", "10"]).expect_code(0);
    assert!(said.out.contains("puma260: 6 joints to `tool`"), "{}", said.out);
    assert!(said.out.contains("own joints among the branches in 10"), "{}", said.out);
}

#[test]
fn a_file_without_an_arm_is_invalid_input() {
    let folder = Folder::new();
    let scene = scenes().join("hold.toml");
    for arguments in [
        &["arm", "no-such.urdf"][..],
        &["arm", scene.to_str().unwrap()],
        &["arm", &arms("puma260.urdf"), "--tip", "hand"],
        &["arm", &arms("puma260.urdf"), "--poses", "4000000000"],
        &["arm", &arms("puma260.urdf"), "--poses", "-1"],
        &["arm", &arms("puma260.urdf"), "--poses", "0"],
    ] {
        let said = taktil(folder.path(), arguments).expect_code(2);
        assert!(
            said.err.starts_with("error: ") && said.out.is_empty(),
            "{arguments:?}: {}",
            said.err
        );
    }
}
