//! A program without the counting allocator: what needs it is not taken for checked.

use clap::Parser;
use taktil_lab_check_task::command::{CheckTaskArgs, check};
use taktil_lab_check_task::report::{Check, Outcome};
use taktil_machine::own::{self, OwnTask, Section};
use taktil_machine::robot::AnyRobot;
use taktil_rtcore::{Cycle, FaultCode, Invalid, Io, Ports, Task};

struct Idle;

impl Task for Idle {
    fn step(&mut self, _: &Cycle, _: &mut Io<'_>) -> Result<(), FaultCode> {
        Ok(())
    }
}

fn make(_: &Section, _: &AnyRobot, _: &mut Ports) -> Result<Box<dyn Task>, Invalid> {
    Ok(Box::new(Idle))
}

static TASKS: &[OwnTask] = &[OwnTask { name: "idle", make }];

#[derive(Parser)]
struct CommandLine {
    #[command(flatten)]
    arguments: CheckTaskArgs,
}

#[test]
fn heap_calls_and_leaks_are_not_checked_without_the_allocator() {
    own::register(TASKS).unwrap();
    let machine = concat!(env!("CARGO_MANIFEST_DIR"), "/../../sim/scenes/machine/puma260.toml");
    let insert = "lane = \"servo\"\nbefore = \"setpoint\"\nbudget_us = 10";
    let text =
        format!("title = \"Idle\"\nmachine = \"{machine}\"\n[robot.insert.idle]\n{insert}\n");
    let file = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("check-task-idle.toml");
    std::fs::write(&file, text).unwrap();
    let words = ["check-task", "--ticks", "1000", "--scene", file.to_str().unwrap()];
    let CommandLine { arguments } = CommandLine::parse_from(words);
    let report = check(own::find("idle").unwrap(), &arguments, false).unwrap();
    let failed: Vec<Check> = report.failed().collect();
    assert_eq!(failed, [Check::HeapCalls, Check::Leak], "{}", report.text());
    assert!(report.text().contains("NOT CHECKED: add `#[global_allocator]"));
    let stale = report.outcome(Check::StaleInputs);
    assert!(matches!(stale, Some(Outcome::Skipped(_))), "{stale:?}");
}
