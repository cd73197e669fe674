//! Drawn objects in a hand, through the whole stack: held within the friction cones, told of
//! beyond them.

use std::process::ExitCode;

use clap::Parser;
use taktil_lab_experiment::hand::{HandOptions, run};

/// The options as the command line has them.
#[derive(Parser)]
struct Line {
    #[command(flatten)]
    options: HandOptions,
}

fn outcome(words: &[&str]) -> anyhow::Result<ExitCode> {
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");
    let scene = format!("{root}/sim/scenes/hand/hold.toml");
    let line = ["hand", "--scene", &scene].into_iter().chain(words.iter().copied());
    run(&Line::try_parse_from(line).unwrap().options)
}

#[test]
fn drawn_objects_are_held_and_pushes_beyond_the_cones_are_told() {
    let code = outcome(&["--seeds", "3"]).unwrap();
    assert_eq!(format!("{code:?}"), format!("{:?}", ExitCode::SUCCESS));
}

/// A knuckle turns back while these objects are gripped, and stands for a while. Neither finger is
/// to be taken for one with a stuck encoder.
#[test]
fn objects_at_which_a_knuckle_turns_back_are_held_too() {
    for seed in ["16", "20"] {
        let code = outcome(&["--seed", seed]).unwrap();
        assert_eq!(format!("{code:?}"), format!("{:?}", ExitCode::SUCCESS), "seed {seed}");
    }
}

#[test]
fn bad_options_are_refused() {
    assert!(outcome(&["--seeds", "0"]).unwrap_err().to_string().contains("--seeds 0"));
    let pin = concat!(env!("CARGO_MANIFEST_DIR"), "/../../sim/scenes/roll-pin.toml");
    let line = Line::try_parse_from(["hand", "--scene", pin]).unwrap();
    assert!(run(&line.options).unwrap_err().to_string().contains("not a hand"));
}
