//! The world of a recorded run, met again at any instant: bit for bit, or not at all.

use std::path::Path;

use taktil::log::Log;
use taktil::run::world::WorldTruth;
use taktil::run::{Options, run};
use taktil::sim::seek::seek;
use taktil_rtcore::Payload;

/// The rolling scene with sensors that remember, recorded in virtual time.
fn recorded(name: &str) -> Log {
    let scenes = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../sim/scenes");
    let text = std::fs::read_to_string(scenes.join("roll-pin.toml")).unwrap();
    let machine = scenes.join("machine/puma260.toml");
    let text = text.replace("machine/puma260.toml", machine.to_str().unwrap())
        + "\n[world.tactile]\nelectronics = \"network\"\n[world.wrist]\nnoise_codes = 2.0\n";
    let folder = std::env::temp_dir().join(format!("taktil-seek-{name}-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let (scene, log) = (folder.join("scene.toml"), folder.join("log.mcap"));
    std::fs::write(&scene, text).unwrap();
    let options = Options {
        scene,
        fast: true,
        for_s: Some(2.5),
        log: Some(log.clone()),
        json: true,
        ..Options::default()
    };
    run(&options).unwrap();
    let log = Log::open(&log).unwrap();
    std::fs::remove_dir_all(&folder).unwrap();
    log
}

#[test]
fn every_recorded_state_is_met_again_and_instants_may_come_in_any_order() {
    let log = recorded("whole");
    let channel = log.find("world.truth").unwrap();
    let recorded: Vec<WorldTruth> = log
        .messages()
        .filter(|message| message.channel == channel)
        .map(|message| WorldTruth::decode(&message.body[..WorldTruth::SIZE]).unwrap())
        .collect();
    let some = [recorded[900], recorded[3], recorded[500]];
    let at_s: Vec<f64> = some.iter().map(|truth| 1e-9 * truth.t_ns as f64).collect();
    let outcome = seek(&log, &at_s).unwrap();
    assert_eq!(outcome.parted, None);
    assert_eq!(outcome.equal, recorded.len() as u64);
    for (found, truth) in outcome.found.iter().zip(&some) {
        assert_eq!(found.truth.t.0, truth.t_ns);
        assert_eq!(found.state, truth.state_hash);
        assert_eq!(found.truth.pin.to_array(), truth.pin_m);
    }
    // Between two recorded states, and the last one.
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
