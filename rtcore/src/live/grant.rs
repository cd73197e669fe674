//! Asks the kernel for what lanes need, and reads back what it granted. No task is started, so that
//! the same can be asked without running anything.

use std::thread;

use super::Contract;
use crate::attest::Attestation;
use crate::contract::{Demands, Item, Shortfall};
use crate::facts::{Facts, LaneGrant};
use crate::linux::{
    CpuLatencyRequest, facts, kernel, lock_memory, pin_to, set_deadline, set_fifo, thread_grant,
    unlock_memory,
};
use crate::machine::Machine;
use crate::schedule::{LaneSpec, Reservation};

/// Adds what the lanes' threads and the kernel say, once all threads stand.
pub(super) fn complete_attestation(
    attestation: &mut Attestation,
    mut asked: Vec<Shortfall>,
    answers: impl Iterator<Item = (Vec<Shortfall>, LaneGrant)>,
    demands: &Demands,
) {
    for (short, grant) in answers {
        asked.extend(short);
        attestation.lanes.push(grant);
    }
    let dma_latency_held = attestation.facts.dma_latency_held;
    attestation.facts = Facts { dma_latency_held, ..facts() };
    attestation.assess(asked, demands);
}

/// Asks the kernel for everything that a lane needs, for the calling thread.
pub(super) fn request_grant(
    spec: &LaneSpec,
    reservation: Option<Reservation>,
) -> (Vec<Shortfall>, LaneGrant) {
    let mut short = Vec::new();
    let mut note = |item, outcome: Result<(), String>| {
        short.extend(
            outcome.err().map(|why| Shortfall::new(item, format!("lane {}: {why}", spec.name))),
        );
    };
    if let Some(cpu) = spec.cpu {
        note(Item::Cpu, pin_to(cpu));
    }
    let asked = match &reservation {
        Some(reservation) => set_deadline(reservation),
        None => set_fifo(spec.priority),
    };
    note(Item::Fifo, asked);
    (short, thread_grant(&spec.name))
}

/// What the kernel would grant the machine now: everything is asked for and given back, no task is
/// started and no job is run.
#[must_use]
pub fn trial_attestation(machine: &Machine, contract: Contract) -> Attestation {
    let (preempt_rt, virtual_machine) = kernel();
    let mut attestation = Attestation { preempt_rt, virtual_machine, ..Attestation::default() };
    let mut asked =
        Vec::from_iter(lock_memory().err().map(|why| Shortfall::new(Item::Memory, why)));
    attestation.facts.dma_latency_held = CpuLatencyRequest::hold().is_some();
    let mut answers = Vec::new();
    for lane in &machine.lanes {
        let answer = thread::scope(|scope| {
            let (spec, reservation) = (&lane.plan.spec, lane.plan.reservation);
            let asks = move || request_grant(spec, reservation);
            let thread = thread::Builder::new().spawn_scoped(scope, asks).ok()?;
            thread.join().ok()
        });
        let nobody =
            || Shortfall::new(Item::Fifo, format!("lane {}: no thread", lane.plan.spec.name));
        match answer {
            Some(answer) => answers.push(answer),
            None => asked.push(nobody()),
        }
    }
    complete_attestation(&mut attestation, asked, answers.into_iter(), &contract.demands());
    unlock_memory();
    attestation
}
