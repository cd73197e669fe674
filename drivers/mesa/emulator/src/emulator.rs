//! A card on a link with faults: datagrams in, datagrams out, each at its instant.

use std::collections::VecDeque;

use taktil_hal::Nanos;
use taktil_hal::fault::{FaultCounts, FaultKind, FaultPlan, SplitMix};

use crate::card::{Card, Inputs, Outputs, Plant};
use crate::channel::IndexPulses;
use crate::firmware::Firmware;
use crate::parser::Parser;

/// The kinds of faults that a card on its link executes: all.
pub const EXECUTED_FAULTS: [FaultKind; FaultKind::LINK.len()] = FaultKind::LINK;

/// What passed through the link, and what a card counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Traffic {
    /// Datagrams that came, those lost to a fault included.
    pub requests: u64,
    /// Datagrams that left.
    pub answers: u64,
    /// Messages and readings that faults befell.
    pub faults: FaultCounts,
}

/// An answer on its way.
#[derive(Clone, Debug)]
struct Answer {
    due: Nanos,
    bytes: Vec<u8>,
}

/// A card, the plant behind it and the link before it.
pub struct Emulator {
    card: Card,
    parser: Parser,
    /// Absent where the caller moves the plant; see [`Emulator::set_inputs`].
    plant: Option<Plant>,
    plan: FaultPlan,
    target: String,
    random: SplitMix,
    answers: VecDeque<Answer>,
    /// An answer that the next one overtakes.
    overtaken: Option<Vec<u8>>,
    restarts: Vec<Nanos>,
    board_name: [u8; 8],
    traffic: Traffic,
}

impl std::fmt::Debug for Emulator {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Emulator").field("card", &self.card).finish_non_exhaustive()
    }
}

impl Emulator {
    /// Switches a card on. The faults of `plan` that befall `target` are executed, drawn from
    /// `seed`; an index pulse comes every `turn_counts` counts of a disc, never for 0.
    #[must_use]
    pub fn new(firmware: Firmware, turn_counts: i64, plant: Plant) -> Emulator {
        let mut emulator = Emulator::without_plant(firmware);
        let pulses = IndexPulses { first: 0, turn: turn_counts };
        emulator.card.pulses = vec![pulses; emulator.card.encoder_count()];
        emulator.plant = Some(plant);
        emulator
    }

    /// Switches a card on whose plant the caller moves: what it put out stands in
    /// [`Emulator::outputs`], what its inputs read is told by [`Emulator::set_inputs`], and
    /// [`Emulator::next_change`] says when to look.
    #[must_use]
    pub fn without_plant(firmware: Firmware) -> Emulator {
        let board_name = firmware.board_name;
        Emulator {
            card: Card::new(firmware),
            parser: Parser::new(board_name),
            plant: None,
            plan: FaultPlan::default(),
            target: String::new(),
            random: SplitMix::new(0),
            answers: VecDeque::new(),
            overtaken: None,
            restarts: Vec::new(),
            board_name,
            traffic: Traffic::default(),
        }
    }

    /// The same card behind discs with these index pulses, by channel; none where the list ends.
    #[must_use]
    pub fn with_index_pulses(mut self, pulses: &[IndexPulses]) -> Emulator {
        self.card.pulses = pulses.to_vec();
        self
    }

    /// The same card on a link with the faults of `plan` that befall `target`; which messages they
    /// hit is drawn from `seed`.
    #[must_use]
    pub fn with_faults(mut self, plan: FaultPlan, target: &str, seed: u64) -> Emulator {
        let ours = |fault: &&taktil_hal::fault::Fault| {
            fault.kind == FaultKind::Restart && (fault.target.is_empty() || fault.target == target)
        };
        self.restarts = plan.faults().iter().filter(ours).map(|fault| fault.at).collect();
        self.restarts.sort();
        self.plan = plan;
        self.target = target.to_owned();
        self.random = SplitMix::new(seed);
        self
    }

    fn strength(&self, kind: FaultKind, now: Nanos) -> Option<f64> {
        self.plan.strength(kind, &self.target, now)
    }

    fn befalls(&mut self, kind: FaultKind, now: Nanos) -> bool {
        match self.strength(kind, now) {
            Some(probability) => {
                let befallen = self.random.unit() < probability;
                if befallen {
                    self.traffic.faults.add(kind);
                }
                befallen
            }
            None => false,
        }
    }

    /// Whether a datagram at `now` cannot pass; counts it.
    fn is_cut_off(&mut self, now: Nanos) -> bool {
        let kinds = [FaultKind::Silence, FaultKind::Unplugged];
        let cut = kinds.into_iter().find(|kind| self.strength(*kind, now).is_some());
        cut.map(|kind| self.traffic.faults.add(kind)).is_some()
    }

    fn advance(&mut self, now: Nanos) {
        while self.restarts.first().is_some_and(|at| *at <= now) {
            self.restarts.remove(0);
            self.traffic.faults.add(FaultKind::Restart);
            self.card.restart();
            self.parser = Parser::new(self.board_name);
        }
        self.card.advance(now);
        if let Some(plant) = &mut self.plant {
            let inputs = plant(now, &self.card.outputs());
            self.take_inputs(now, inputs);
        }
    }

    fn take_inputs(&mut self, now: Nanos, inputs: Inputs) {
        if self.strength(FaultKind::Frozen, now).is_some() {
            self.traffic.faults.add(FaultKind::Frozen);
        } else {
            self.card.take_inputs(now, inputs);
        }
    }

    /// Tells what the inputs read at `now`, for a card without a plant of its own.
    pub fn set_inputs(&mut self, now: Nanos, inputs: Inputs) {
        self.advance(now);
        self.take_inputs(now, inputs);
    }

    /// The next instant at which the card changes its outputs by itself: a command to the remotes
    /// ends, a watchdog bites, the plan restarts it.
    #[must_use]
    pub fn next_change(&self) -> Option<Nanos> {
        self.restarts.first().copied().into_iter().chain(self.card.next_change()).min()
    }

    /// Takes a datagram that arrives at `now`, which must not run backwards.
    pub fn receive(&mut self, now: Nanos, packet: &[u8]) {
        self.advance(now);
        self.traffic.requests += 1;
        if self.is_cut_off(now) || self.befalls(FaultKind::Loss, now) {
            return;
        }
        self.execute(now, packet);
        if self.befalls(FaultKind::Duplication, now) {
            self.execute(now, packet);
        }
    }

    fn execute(&mut self, now: Nanos, packet: &[u8]) {
        let Some(mut bytes) = self.parser.execute(&mut self.card, now, packet) else { return };
        if self.befalls(FaultKind::Loss, now) {
            return;
        }
        if self.befalls(FaultKind::Corruption, now) {
            let bit = self.random.next_u64() as usize % (8 * bytes.len());
            bytes[bit / 8] ^= 1 << (bit % 8);
        }
        if self.befalls(FaultKind::Truncation, now) {
            bytes.truncate(self.random.next_u64() as usize % bytes.len());
        }
        let delay = self.strength(FaultKind::Delay, now);
        if delay.is_some() {
            self.traffic.faults.add(FaultKind::Delay);
        }
        let delay = delay.unwrap_or(0.0);
        let due = now + Nanos((1e9 * delay) as i64);
        if self.overtaken.is_none() && self.befalls(FaultKind::Reordering, now) {
            self.overtaken = Some(bytes);
            return;
        }
        let twice = self.befalls(FaultKind::Duplication, now);
        for _ in 0..=usize::from(twice) {
            self.send(Answer { due, bytes: bytes.clone() });
        }
        if let Some(bytes) = self.overtaken.take() {
            self.send(Answer { due, bytes });
        }
    }

    fn send(&mut self, answer: Answer) {
        // Answers leave in the order in which they are due; equal ones in the order of sending.
        let at = self.answers.partition_point(|other| other.due <= answer.due);
        self.answers.insert(at, answer);
    }

    /// Gives the answers that are due at `now`, oldest first.
    pub fn poll(&mut self, now: Nanos, answers: &mut Vec<Vec<u8>>) {
        while let Some(answer) = self.answers.pop_front_if(|answer| answer.due <= now) {
            if !self.is_cut_off(now) {
                self.traffic.answers += 1;
                answers.push(answer.bytes);
            }
        }
    }

    /// When the next answer is due, if one is on its way.
    #[must_use]
    pub fn next_due(&self) -> Option<Nanos> {
        self.answers.front().map(|answer| answer.due)
    }

    /// What the card puts out at `now`.
    pub fn outputs(&mut self, now: Nanos) -> Outputs {
        self.advance(now);
        self.card.outputs()
    }

    /// The word of a register of the FPGA at `now`.
    #[must_use]
    pub fn register(&self, now: Nanos, address: u16) -> u32 {
        self.card.read(address, now)
    }

    /// How often the FPGA's watchdog has bitten.
    #[must_use]
    pub fn bites(&self) -> u64 {
        self.card.bites
    }

    /// What passed through the link since power came on.
    #[must_use]
    pub fn traffic(&self) -> Traffic {
        self.traffic
    }

    /// How many exchanges put new values at the 7I77's analog outputs.
    #[must_use]
    pub fn exchanges(&self) -> u64 {
        self.card.serial.iter().map(|port| port.exchanges).sum()
    }

    /// How many commands to smart serial came while another one was under way.
    #[must_use]
    pub fn overrun_commands(&self) -> u64 {
        self.card.serial.iter().map(|port| port.overrun_commands).sum()
    }
}
