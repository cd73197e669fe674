//! The threads of drivers are held to the contract as lanes are: what the kernel did not grant one
//! of them refuses the start where its item is hard, and is told where it is soft.

mod process;

use std::path::{Path, PathBuf};
use std::sync::Once;
use std::sync::atomic::AtomicBool;

use taktil_hal::OpenError;
use taktil_machine::own::Section;
use taktil_machine_boards::{Driver, DriverThread, Epoch, Opened, register};
use taktil_machine_service::service::Service;

use process::{Folder, NO_FLIGHT, Rig};

/// A driver with a thread and nothing else.
static DRIVERS: [Driver; 1] = [Driver {
    name: "beside",
    open: open_beside,
    keys: Vec::new,
    make_safe: None,
    system_calls: &[],
}];

/// No host has so many processors, nor a mask with room for one of this number.
const CPU_OF_NO_HOST: usize = 1_000_000;

fn open_beside(_: &Section, _: &Epoch) -> Result<Opened, OpenError> {
    let thread = DriverThread { name: "beside", run: Box::new(|| ()) };
    Ok(Opened { threads: vec![thread], ..Opened::default() })
}

/// A service over a board and a device with a thread that asks for this much, under a contract.
fn service(folder: &Folder, contract: &str, thread: &str) -> Service {
    static REGISTERED: Once = Once::new();
    REGISTERED.call_once(|| register(&DRIVERS).unwrap());
    let machine = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../sim/scenes/machine/puma260.toml")
        .canonicalize()
        .unwrap();
    let text = format!(
        "machine = {machine:?}\ncontract = {contract}\n\
         [robot.device.cell]\ndriver = \"regmap\"\npath = {:?}\n\
         [robot.device.extra]\ndriver = \"beside\"\nthread = {thread}\n{NO_FLIGHT}",
        folder.join("board.bin")
    );
    let path: PathBuf = folder.join("taktild.toml");
    std::fs::write(&path, text).unwrap();
    Service::load(&path).unwrap_or_else(|bad| panic!("{bad}"))
}

/// The outcome of a run that is stopped before its first job, where it is not refused before.
fn outcome(contract: &str, thread: &str) -> Result<String, String> {
    let folder = Folder::new();
    let rig = Rig::new(&folder);
    let mut service = service(&folder, contract, thread);
    let described = service.describe();
    let ended = service.run_until(&AtomicBool::new(true));
    rig.assert_registers_are_safe();
    ended.map(|()| described).map_err(|error| format!("{error:#}"))
}

/// A contract in which one item has a weight and no other one matters.
fn contract(item: &str, weight: &str) -> String {
    let items = ["fifo", "cpu", "memory", "preempt_rt"];
    let listed = items.map(|name| {
        let weight = if name == item { weight } else { "none" };
        format!("{name} = \"{weight}\"")
    });
    format!("{{ {} }}", listed.join(", "))
}

#[test]
fn a_cpu_that_a_drivers_thread_did_not_get_refuses_the_start_only_where_it_is_hard() {
    let thread = format!("{{ cpu = {CPU_OF_NO_HOST} }}");
    let refused = outcome(&contract("cpu", "hard"), &thread).unwrap_err();
    assert!(
        refused.contains("not granted to the thread of device extra: CPU 1000000"),
        "{refused}"
    );
    assert!(refused.contains("taktil doctor"), "{refused}");
    for (item, weight) in [("cpu", "soft"), ("cpu", "none"), ("fifo", "soft")] {
        let described = outcome(&contract(item, weight), &thread).unwrap();
        assert!(described.contains("thread of device extra: CPU 1000000"), "{described}");
    }
}

#[test]
fn a_thread_that_asks_for_nothing_lacks_nothing() {
    let described = outcome(&contract("cpu", "soft"), "{ }").unwrap();
    assert!(!described.contains("thread of device"), "{described}");
}
