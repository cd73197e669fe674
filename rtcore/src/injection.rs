//! The faults of a plan that befall tasks and lanes: a task that panics or writes numbers that are
//! not finite, lanes whose jobs are late, take long or do not come. Targets are `task.NAME`,
//! `lane.NAME` and `clock`. Faults of devices are put in outside, around their halves.

use taktil_hal::Invalid;
use taktil_hal::fault::{Fault, FaultKind, FaultPlan};

use crate::fault::FaultCode;
use crate::lane::Lane;
use crate::machine::Machine;
use crate::port::{CellCopy, Io};
use crate::record::Catalog;
use crate::schedule::LaneSpec;
use crate::state::StateHash;
use crate::task::{Cycle, Task};

/// The kinds that can befall a task.
pub const TASK_KINDS: [FaultKind; 2] = [FaultKind::Panic, FaultKind::NotFinite];
/// The kinds that can befall a lane.
pub const LANE_KINDS: [FaultKind; 3] =
    [FaultKind::Lateness, FaultKind::Overrun, FaultKind::Silence];
/// The target of a fault of the clock, which befalls every lane but that of a simulated world.
pub const CLOCK_TARGET: &str = "clock";

/// A task with faults.
struct FaultyTask {
    task: Box<dyn Task>,
    faults: Vec<Fault>,
    /// Its outputs: their cells, and what they held after the step before.
    outputs: Vec<(usize, CellCopy)>,
}

impl Task for FaultyTask {
    fn start(&mut self) -> Result<(), FaultCode> {
        self.task.start()
    }

    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        let befalls = |kind| {
            let mut faults = self.faults.iter();
            faults.any(|fault| fault.kind == kind && fault.is_under_way(cycle.release))
        };
        if befalls(FaultKind::Panic) {
            std::panic::panic_any("a fault by plan");
        }
        let befallen = befalls(FaultKind::NotFinite);
        let outcome = self.task.step(cycle, io);
        for (cell, copy) in &mut self.outputs {
            if befallen {
                io.spoil(*cell, copy);
            } else {
                io.copy(*cell, copy);
            }
        }
        outcome
    }

    fn fold(&self, hash: &mut StateHash) {
        self.task.fold(hash);
    }

    fn stop(&mut self) {
        self.task.stop();
    }
}

/// Does nothing; stands in a slot while its task is being wrapped.
struct NoTask;

impl Task for NoTask {
    fn step(&mut self, _cycle: &Cycle, _io: &mut Io<'_>) -> Result<(), FaultCode> {
        Ok(())
    }
}

/// Puts faults into a task of a lane.
fn put_into(lane: &mut Lane, name: &str, faults: &[Fault], catalog: &Catalog) {
    let own = |signal: u16| {
        let signal = catalog.signals.get(usize::from(signal))?;
        let (owner, _) = signal.name.rsplit_once('.')?;
        (owner == name).then_some(signal.size)
    };
    let signals = lane.ports.signals.iter();
    let outputs: Vec<_> = signals
        .filter_map(|(cell, signal)| own(*signal).map(|size| (*cell, CellCopy::new(size))))
        .collect();
    for slot in lane.tasks.iter_mut().filter(|slot| slot.name == name) {
        let task = core::mem::replace(&mut slot.task, Box::new(NoTask));
        let (faults, outputs) = (faults.to_vec(), outputs.clone());
        slot.task = Box::new(FaultyTask { task, faults, outputs });
    }
}

/// Refuses a kind that is not among `kinds`.
fn check_kind(fault: &Fault, kinds: &[FaultKind]) -> Result<(), Invalid> {
    if kinds.contains(&fault.kind) {
        return Ok(());
    }
    let what = format!("`{}` cannot befall `{}`", fault.kind.name(), fault.target);
    Err(Invalid::new("kind", what, format!("it is one of: {}", FaultKind::words(kinds))))
}

impl Machine {
    /// Puts the faults of `plan` that befall tasks and lanes into the machine; others are left to
    /// others. Faults of lanes act in virtual time only ([`crate::virtual_time`]), and never on the
    /// lane called `spared`, which simulates the world.
    ///
    /// # Errors
    /// A task or lane that there is not, a kind that cannot befall it. The place is
    /// `fault[i].KEY`.
    pub fn inject(&mut self, plan: &FaultPlan, spared: &str) -> Result<(), Invalid> {
        for (index, fault) in plan.faults().iter().enumerate() {
            self.inject_one(fault, spared).map_err(|bad| bad.within(&format!("fault[{index}]")))?;
        }
        for lane in &mut self.lanes {
            let names: Vec<String> = lane.tasks.iter().map(|slot| slot.name.clone()).collect();
            for name in names {
                let befalls = |fault: &&Fault| fault.target.strip_prefix("task.") == Some(&name);
                let faults: Vec<Fault> = plan.faults().iter().filter(befalls).cloned().collect();
                if !faults.is_empty() {
                    put_into(lane, &name, &faults, &self.catalog);
                }
            }
        }
        Ok(())
    }

    fn inject_one(&mut self, fault: &Fault, spared: &str) -> Result<(), Invalid> {
        let count = self.lanes.len();
        if let Some(name) = fault.target.strip_prefix("task.") {
            check_kind(fault, &TASK_KINDS)?;
            let mut slots = self.lanes.iter().flat_map(|lane| &lane.tasks);
            if !slots.any(|slot| slot.name == name) {
                return Err(no_target(fault, "task"));
            }
            return Ok(());
        }
        let is_clock = fault.target == CLOCK_TARGET;
        let name = match fault.target.strip_prefix("lane.") {
            None if is_clock => {
                check_kind(fault, &[FaultKind::ClockGap])?;
                ""
            }
            None => return Ok(()),
            Some(name) => {
                check_kind(fault, &LANE_KINDS)?;
                name
            }
        };
        let befalls = |spec: &LaneSpec| spec.name != spared && (is_clock || spec.name == name);
        let specs = self.lanes.iter().map(|lane| &lane.plan.spec);
        let befallen: Vec<usize> =
            specs.enumerate().filter(|(_, spec)| befalls(spec)).map(|(index, _)| index).collect();
        if befallen.is_empty() {
            return Err(no_target(fault, "lane"));
        }
        self.timing_faults.lanes.resize(count, Vec::new());
        for index in befallen {
            self.timing_faults.lanes[index].push(fault.clone());
        }
        Ok(())
    }
}

fn no_target(fault: &Fault, what: &str) -> Invalid {
    let what = format!("there is no {what} for `{}`", fault.target);
    Invalid::new("target", what, "name one of the machine file")
}
