//! The world of a recorded run is reconstructed at any instant, bit for bit, or an error is
//! reported.

mod common;

use std::path::{Path, PathBuf};
use std::process::Command;

use common::Folder;
use taktil_lab_command::run::{Options, run};
use taktil_lab_scene::seek::seek;
use taktil_lab_world::WorldTruth;
use taktil_record::Log;
use taktil_rtcore::Payload;

fn scenes() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../sim/scenes")
}

/// The log of a scene, recorded in virtual time.
fn log_of(scene: PathBuf, folder: &Folder, for_s: f64) -> Vec<u8> {
    let log = folder.0.join("log.mcap");
    let options = Options {
        scene,
        fast: true,
        for_s: Some(for_s),
        log: Some(log.clone()),
        json: true,
        ..Options::default()
    };
    run(&options).unwrap();
    std::fs::read(log).unwrap()
}

/// The rolling scene with sensors that have internal state.
fn recorded(name: &str) -> Log {
    let machine = scenes().join("machine/puma260.toml");
    let text = std::fs::read_to_string(scenes().join("roll-pin.toml")).unwrap();
    let text = text.replace("machine/puma260.toml", machine.to_str().unwrap())
        + "\n[world.tactile]\nelectronics = \"network\"\n[world.wrist]\nnoise_codes = 2.0\n";
    let folder = Folder::new(&format!("seek-{name}"));
    let scene = folder.0.join("scene.toml");
    std::fs::write(&scene, text).unwrap();
    Log::from_bytes(log_of(scene, &folder, 2.5)).unwrap()
}

/// The exit code, standard output and standard error of `taktil sim seek` on a log.
fn seek_output(folder: &Folder, bytes: &[u8], more: &[&str]) -> (Option<i32>, String, String) {
    let path = folder.0.join("told.mcap");
    std::fs::write(&path, bytes).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_taktil"));
    let output = command.args(["sim", "seek"]).arg(path).args(more).output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (output.status.code(), text(&output.stdout), text(&output.stderr))
}

/// Instants and hashes at the beginning of the truth records.
fn states(log: &Log) -> Vec<[u8; 16]> {
    let channel = log.find("world.truth").unwrap();
    let messages = log.messages().filter(|message| message.channel == channel);
    messages.map(|message| *message.body.first_chunk().unwrap()).collect()
}

#[test]
fn every_recorded_state_is_reproduced_in_any_order_of_instants() {
    let log = recorded("whole");
    let channel = log.find("world.truth").unwrap();
    let recorded: Vec<WorldTruth> = log
        .messages()
        .filter(|message| message.channel == channel)
        .map(|message| WorldTruth::decode(&message.body[..<WorldTruth>::SIZE]).unwrap())
        .collect();
    let some = [recorded[900], recorded[3], recorded[500]];
    let at_s: Vec<f64> = some.iter().map(|truth| 1e-9 * truth.t_ns as f64).collect();
    let outcome = seek(&log, &at_s).unwrap();
    assert_eq!(outcome.first_difference, None);
    assert_eq!(outcome.equal, recorded.len() as u64);
    for (found, truth) in outcome.found.iter().zip(&some) {
        assert_eq!(found.truth.t.0, truth.t_ns);
        assert_eq!(found.state, truth.state_hash);
        assert_eq!(found.truth.pin.to_array(), truth.pin_m);
        assert!(found.pin);
    }
    // Instants between two recorded states, and the last one.
    let between = seek(&log, &[2.000_1]).unwrap();
    assert_eq!(between.found[0].truth.t.0, 2_000_100_000);
    assert_eq!(between.equal, recorded.len() as u64, "who looks changes nothing");
    assert_eq!(seek(&log, &[]).unwrap().found[0].state, recorded.last().unwrap().state_hash);
}

#[test]
fn instants_that_the_record_does_not_reach_are_refused() {
    let log = recorded("refused");
    for at in [-1.0, 3.0, f64::NAN, f64::INFINITY] {
        let why = seek(&log, &[at]).unwrap_err();
        assert!(why.contains("--at") && why.contains("reaches from 0 to 2.5"), "{why}");
    }
}

#[test]
fn the_states_of_another_arm_are_reproduced_with_its_joints() {
    let folder = Folder::new("seek-ur5e");
    let bytes = log_of(scenes().join("ur5e-lines.toml"), &folder, 4.0);
    let log = Log::from_bytes(bytes.clone()).unwrap();
    let outcome = seek(&log, &[3.0, 0.0]).unwrap();
    assert_eq!((outcome.first_difference, outcome.equal), (None, states(&log).len() as u64));
    let start = [0.0, -75.0, 90.0, -105.0, -90.0, 0.0].map(f64::to_radians);
    assert_eq!(outcome.found[1].q_rad, start);
    assert_eq!(outcome.found[0].qd_rad_s.len(), 6);
    assert_ne!(outcome.found[0].q_rad, start, "it moved by hand");
    assert!(outcome.found[0].truth.object.is_none());
    let (code, text, warned) = seek_output(&folder, &bytes, &["--json", "--at", "3"]);
    assert_eq!(code, Some(0), "{warned}");
    let json: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(json["q_rad"], serde_json::json!(outcome.found[0].q_rad));
    assert!(json["object"].is_null());
}

#[test]
fn the_contact_of_an_object_is_printed() {
    let folder = Folder::new("seek-object");
    let bytes = log_of(scenes().join("hold-contact.toml"), &folder, 4.0);
    let found = &seek(&Log::from_bytes(bytes.clone()).unwrap(), &[]).unwrap().found[0];
    let felt = found.truth.object.unwrap();
    assert!(felt.normal_n > 0.0, "{felt:?}");
    let (code, text, _) = seek_output(&folder, &bytes, &[]);
    assert_eq!(code, Some(0));
    assert!(text.contains(&format!("object      {:.3} N at", felt.normal_n)), "{text}");
    assert!(!text.contains("contact     none"), "{text}");
    // This scene has no pin, so the output has none.
    assert!(!text.contains("pin (mm)"), "{text}");
    let (_, text, _) = seek_output(&folder, &bytes, &["--json"]);
    let json: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert!(json["pin_m"].is_null() && json["pin_yaw_rad"].is_null(), "{text}");
    assert_eq!(json["object"]["normal_n"], felt.normal_n);
    assert_eq!(json["object"]["slip_m_s"], felt.slip_m_s);
}

#[test]
fn a_state_that_is_not_reproduced_is_named_and_ends_with_1() {
    let folder = Folder::new("seek-flipped");
    let mut bytes = log_of(scenes().join("hold.toml"), &folder, 0.5);
    let log = Log::from_bytes(bytes.clone()).unwrap();
    let all = states(&log);
    let wanted = all[120];
    let fields = &log.channels()[log.find("world.truth").unwrap()].fields;
    let size = fields.last().unwrap().offset;
    let at = bytes.windows(16).position(|window| window == wanted).unwrap();
    bytes[at + 11] ^= 0x10;
    // The checksum over stamp and payload, as the log's writer computes it.
    let start = at - 16;
    let crc = crc32fast::hash(&bytes[start..start + size]);
    bytes[start + size..start + size + 4].copy_from_slice(&crc.to_le_bytes());
    let log = Log::from_bytes(bytes.clone()).unwrap();
    assert!(log.damage().is_none());
    let outcome = seek(&log, &[]).unwrap();
    let t_ns = i64::from_le_bytes(*wanted.first_chunk().unwrap());
    assert_eq!(outcome.first_difference.map(|t| t.0), Some(t_ns));
    assert_eq!(outcome.equal, all.len() as u64 - 1);
    let (code, _, warned) = seek_output(&folder, &bytes, &[]);
    assert_eq!(code, Some(1), "{warned}");
    assert!(warned.contains(&format!("from {} s on", 1e-9 * t_ns as f64)), "{warned}");
}
