//! The shipped machine file of an arm on an EtherCAT segment: every key is known, the segment's
//! section is accepted by its driver, and each half that the tasks need is served.
#![cfg(feature = "ethercat")]

use std::path::Path;

use taktil_drivers_ethercat::{Config, DriveMode, Kind};
use taktil_machine::config::MachineConfig;
use taktil_machine::shipped;

#[test]
fn the_shipped_arm_on_a_segment_is_accepted_key_by_key() {
    let path = Path::new("sim/scenes/machine/puma260-ethercat.toml");
    let text = shipped::find(path, false).expect("it is shipped").text;
    let machine: MachineConfig = toml::from_str(text).unwrap();
    let (keys, own) = machine.device["arm"].split().unwrap();
    assert_eq!(keys.driver, "ethercat");
    let config: Config = own.read().unwrap();
    config.check().unwrap();
    let drives: Vec<_> = config.devices.iter().filter(|one| one.kind == Kind::Drive).collect();
    assert_eq!(drives.len(), 6);
    assert!(drives.iter().all(|one| one.mode == DriveMode::Position));
    let lane = &machine.lane["servo"];
    assert_eq!(i64::from(config.period_us), lane.period_us);
    lane.spec("servo").unwrap();
    let serves = keys.serves.unwrap();
    for (task, half) in
        [("sense", "drive_in"), ("actuate", "drive_out"), ("clock_lock", "board_clock")]
    {
        assert!(lane.tasks.iter().any(|one| one == task), "{task}");
        assert!(serves.iter().any(|one| one == half), "{half}");
    }
    assert!(config.sync.is_some(), "the clock is served with `sync` only");
    // Every task has a budget, so that the schedule is analysed.
    assert!(lane.tasks.iter().all(|task| lane.budget_us.contains_key(task)));
    let lock = machine.clock_lock.unwrap();
    let period = taktil_rtcore::Nanos::from_micros(lane.period_us);
    assert!(lock.lock(period, period).is_ok());
}
