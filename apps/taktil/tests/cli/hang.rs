//! A task that never returns ends `taktil run` with exit code 1, the name of the task and a closed
//! log. The child is this test's program; it runs the library as the command does, with an operator
//! task that hangs.

use std::path::PathBuf;
use std::process::{Command, ExitCode, Stdio};

use taktil_lab_command::run::{self, Options};
use taktil_machine::operator::RemoteOperator;
use taktil_record::{Log, METADATA_RESULT};
use taktil_signal::{ControlState, MoveQueue};
use taktil_tests_script::Hanging;

use crate::process::{Folder, Running, scenes};

/// Environment variable with the path of the child's log.
const CHILD_LOG_VARIABLE: &str = "TAKTIL_TEST_HANGS";

#[test]
fn the_run_whose_operator_hangs() {
    let Some(log) = std::env::var_os(CHILD_LOG_VARIABLE) else {
        println!("nothing to do: this is the child of another test");
        return;
    };
    let scene = scenes().join("roll-pin.toml");
    let options = Options { scene, log: Some(PathBuf::from(log)), ..Options::default() };
    let ended = run::run_with(&options, |_| {
        Box::new(|ports| {
            // The wiring of the machine connects these ports.
            let _ = ports.input_delayed::<ControlState>("control");
            let _ = ports.input_delayed::<MoveQueue>("queue");
            Ok(Box::new(Hanging { until_then: RemoteOperator::new(None, ports), tick: 100 }))
        })
    });
    panic!("it cannot end by itself: {:?}", ended.map(|code| code == ExitCode::SUCCESS));
}

#[test]
fn a_lane_that_hangs_ends_the_run_with_1_its_name_and_a_closed_log() {
    let folder = Folder::new();
    let path = folder.join("hung.mcap");
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.args(["--exact", "hang::the_run_whose_operator_hangs", "--nocapture"]);
    command.env(CHILD_LOG_VARIABLE, &path).stdout(Stdio::null()).stderr(Stdio::piped());
    let mut running = Running(command.spawn().unwrap());
    let mut said = String::new();
    let mut stderr = running.0.stderr.take().unwrap();
    std::io::Read::read_to_string(&mut stderr, &mut said).unwrap();
    assert_eq!(running.wait().code(), Some(1), "{said}");
    let told = "error: task `operator` in lane servo does not return; the run is over";
    assert!(said.contains(told) && !said.contains("panicked"), "{said}");
    let log = Log::open(&path).unwrap();
    assert!(log.damage().is_none(), "{:?}", log.damage());
    let ended = &log.metadata()[METADATA_RESULT]["hung"];
    assert_eq!(ended, "task `operator` in lane servo does not return");
    let health = log.find("world.health").unwrap();
    let world = log.messages().filter(|m| m.channel == health).count();
    assert!(world >= 99, "records of the other lanes are there: {world}");
}
