//! The bus: drives of one kind, motors behind them, and faults by plan before them.

use std::collections::VecDeque;

use taktil_hal::Nanos;
use taktil_hal::fault::{Fault, FaultCounts, FaultKind, FaultPlan, SplitMix};

use crate::canopen::CanOpen;
use crate::moteus::Moteus;
use crate::motor::Motor;
use crate::odrive::Odrive;
use crate::wire::{BusFrame, error_report};

/// The kinds of faults that a bus and its drives execute.
pub const EXECUTED_FAULTS: [FaultKind; 8] = [
    FaultKind::Loss,
    FaultKind::Duplication,
    FaultKind::Delay,
    FaultKind::Silence,
    FaultKind::Unplugged,
    FaultKind::Restart,
    FaultKind::Frozen,
    FaultKind::Failing,
];

/// Counts of a turn of a drive of CANopen.
pub(crate) const TURN_COUNTS: f64 = 65_536.0;
/// Class of an error report: nobody acknowledges, and the controller's state.
const UNACKNOWLEDGED_CLASS: u32 = 0x24;
/// The state: error passive in sending.
const PASSIVE_STATE: u8 = 0x20;

/// What the drives of a bus are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// CANopen with CiA 402, of this rated torque (mNm).
    CanOpen(u32),
    /// moteus.
    Moteus,
    /// ODrive.
    Odrive,
}

/// What a drive puts out.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outputs {
    /// Whether it follows torques.
    pub is_enabled: bool,
    /// Whether the host leads it towards that.
    pub is_wanted: bool,
    /// The torque that was asked for, in thousandths of the rated torque, or in mNm.
    pub target: i16,
    /// The torque at its shaft (Nm).
    pub torque_nm: f64,
    /// Its digital outputs, object 60FE:01.
    pub digital: u32,
    /// Signs of life of the host that it heard.
    pub host_signs: u64,
}

/// What passed over the bus.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Traffic {
    /// Frames of the host, those lost to a fault included.
    pub heard: u64,
    /// Frames of the drives that left.
    pub said: u64,
    /// Frames and readings that faults befell.
    pub faults: FaultCounts,
}

#[derive(Clone, Debug)]
enum Device {
    CanOpen(Box<CanOpen>),
    Moteus(Box<Moteus>),
    Odrive(Box<Odrive>),
}

#[derive(Clone, Debug)]
struct Node {
    device: Device,
    motor: Motor,
}

/// A frame on its way.
#[derive(Clone, Debug)]
struct Late {
    due: Nanos,
    bytes: Vec<u8>,
}

/// A bus with drives.
#[derive(Clone, Debug)]
pub struct Emulator {
    nodes: Vec<Node>,
    now: Nanos,
    /// Whether the caller moves what is behind the drives.
    is_moved: bool,
    plan: FaultPlan,
    target: String,
    random: SplitMix,
    /// Restarts to come: when, and of which drive.
    restarts: Vec<(Nanos, Option<u16>)>,
    is_unplugged: bool,
    way: VecDeque<Late>,
    traffic: Traffic,
}

impl Emulator {
    /// Switches drives of a kind on, with these numbers.
    #[must_use]
    pub fn new(kind: Kind, ids: &[u8]) -> Emulator {
        let device = |id: u8| match kind {
            Kind::CanOpen(rated) => Device::CanOpen(Box::new(CanOpen::new(id, rated, TURN_COUNTS))),
            Kind::Moteus => Device::Moteus(Box::new(Moteus::new(id))),
            Kind::Odrive => Device::Odrive(Box::new(Odrive::new(id))),
        };
        let node = |id: &u8| Node { device: device(*id), motor: Motor::default() };
        Emulator {
            nodes: ids.iter().map(node).collect(),
            now: Nanos::ZERO,
            is_moved: false,
            plan: FaultPlan::default(),
            target: String::new(),
            random: SplitMix::new(0),
            restarts: Vec::new(),
            is_unplugged: false,
            way: VecDeque::new(),
            traffic: Traffic::default(),
        }
    }

    /// The same bus, behind whose drives the caller moves something: see
    /// [`Emulator::set_position`].
    #[must_use]
    pub fn without_motors(mut self) -> Emulator {
        self.is_moved = true;
        self
    }

    /// The same bus with the faults of `plan` that befall `target`; which frames they hit is drawn
    /// from `seed`.
    #[must_use]
    pub fn with_faults(mut self, plan: FaultPlan, target: &str, seed: u64) -> Emulator {
        let ours = |fault: &&Fault| {
            fault.kind == FaultKind::Restart && (fault.target.is_empty() || fault.target == target)
        };
        let restarts = plan.faults().iter().filter(ours);
        self.restarts = restarts.map(|fault| (fault.at, fault.channel)).collect();
        self.restarts.sort();
        (self.plan, self.target) = (plan, target.to_owned());
        self.random = SplitMix::new(seed);
        self
    }

    /// The strongest fault of a kind that befalls the drive of a place, or the bus for `None`.
    fn strength(&self, kind: FaultKind, place: Option<usize>, now: Nanos) -> Option<f64> {
        let befalls = |fault: &&Fault| {
            let is_here = match (fault.channel, place) {
                (None, _) => true,
                (Some(_), Some(place)) => fault.has_channel(place),
                (Some(_), None) => false,
            };
            fault.kind == kind && fault.is_active(&self.target, now) && is_here
        };
        let values = self.plan.faults().iter().filter(befalls).map(|fault| fault.value);
        values.reduce(f64::max)
    }

    fn befalls(&mut self, kind: FaultKind, place: Option<usize>, now: Nanos) -> bool {
        let Some(probability) = self.strength(kind, place, now) else { return false };
        let is_befallen = self.random.unit() < probability;
        if is_befallen {
            self.traffic.faults.add(kind);
        }
        is_befallen
    }

    fn is_cut_off(&mut self, place: Option<usize>, now: Nanos) -> bool {
        let kinds = [FaultKind::Silence, FaultKind::Unplugged];
        let cut = kinds.into_iter().find(|kind| self.strength(*kind, place, now).is_some());
        cut.map(|kind| self.traffic.faults.add(kind)).is_some()
    }

    /// Lets the drives run up to `now`, which must not run backwards.
    pub fn advance(&mut self, now: Nanos) {
        while let Some((at, channel)) = self.restarts.first().copied().filter(|(at, _)| *at <= now)
        {
            self.restarts.remove(0);
            self.traffic.faults.add(FaultKind::Restart);
            self.run(at.max(self.now));
            for (place, node) in self.nodes.iter_mut().enumerate() {
                if channel.is_none_or(|one| usize::from(one) == place + 1) {
                    node.restart();
                }
            }
        }
        self.run(now);
    }

    fn run(&mut self, now: Nanos) {
        let is_unplugged = self.strength(FaultKind::Unplugged, None, now).is_some();
        if is_unplugged && !self.is_unplugged {
            // The host's controller tells that nobody acknowledges its frames.
            self.say(now, &error_report(UNACKNOWLEDGED_CLASS, PASSIVE_STATE));
        }
        self.is_unplugged = is_unplugged;
        for place in 0..self.nodes.len() {
            let is_failing = self.befalls(FaultKind::Failing, Some(place), now);
            let is_frozen = self.strength(FaultKind::Frozen, Some(place), now).is_some();
            if is_frozen {
                self.traffic.faults.add(FaultKind::Frozen);
            }
            let span = now - self.now;
            let node = &mut self.nodes[place];
            if !self.is_moved {
                node.motor.turn(span, node.device.torque_nm());
            }
            node.set_fault(is_failing);
            if !is_frozen && !self.is_moved {
                node.show();
            }
            node.advance(now);
            self.collect(place, now);
        }
        self.now = self.now.max(now);
    }

    /// Tells where the shaft of a drive is (counts), for drives without motors.
    pub fn set_position(&mut self, place: usize, counts: i32, counts_per_turn: f64) {
        let is_frozen = self.strength(FaultKind::Frozen, Some(place), self.now).is_some();
        let Some(node) = self.nodes.get_mut(place).filter(|_| !is_frozen) else { return };
        let turns = f64::from(counts) / counts_per_turn;
        match &mut node.device {
            Device::CanOpen(drive) => drive.set_counts(counts),
            Device::Moteus(drive) => drive.set_motion(turns, 0.0),
            Device::Odrive(drive) => drive.set_motion(turns, 0.0),
        }
    }

    /// Switches the power of all stages; drives of CANopen only tell it.
    pub fn set_voltage(&mut self, is_on: bool) {
        for node in &mut self.nodes {
            if let Device::CanOpen(drive) = &mut node.device {
                drive.set_voltage(is_on);
            }
        }
    }

    /// Puts a frame on the bus as if a node or the controller had sent it.
    pub fn inject(&mut self, now: Nanos, frame: &BusFrame) {
        self.say(now, frame);
    }

    /// Takes bytes of a frame of the host's that arrive at `now`.
    pub fn receive(&mut self, now: Nanos, bytes: &[u8]) {
        self.advance(now);
        self.traffic.heard += 1;
        let Some(frame) = BusFrame::from_bytes(bytes) else { return };
        let is_lost = self.is_cut_off(None, now) || self.befalls(FaultKind::Loss, None, now);
        if is_lost {
            return;
        }
        let times = 1 + usize::from(self.befalls(FaultKind::Duplication, None, now));
        for place in 0..self.nodes.len() {
            if self.strength(FaultKind::Silence, Some(place), now).is_some() {
                continue;
            }
            for _ in 0..times {
                self.nodes[place].receive(now, &frame);
            }
            self.collect(place, now);
        }
    }

    /// Sends what a drive has to say.
    fn collect(&mut self, place: usize, now: Nanos) {
        for frame in self.nodes[place].outbox() {
            let is_lost = self.is_cut_off(Some(place), now)
                || self.befalls(FaultKind::Loss, Some(place), now);
            if is_lost {
                continue;
            }
            let times = 1 + usize::from(self.befalls(FaultKind::Duplication, Some(place), now));
            let delay = self.strength(FaultKind::Delay, Some(place), now);
            if delay.is_some() {
                self.traffic.faults.add(FaultKind::Delay);
            }
            let due = now + Nanos((1e9 * delay.unwrap_or(0.0)) as i64);
            for _ in 0..times {
                self.say(due, &frame);
            }
        }
    }

    fn say(&mut self, due: Nanos, frame: &BusFrame) {
        let at = self.way.partition_point(|other| other.due <= due);
        self.way.insert(at, Late { due, bytes: frame.bytes() });
    }

    /// Gives the frames that are due at `now` as bytes, oldest first.
    pub fn poll(&mut self, now: Nanos, frames: &mut Vec<Vec<u8>>) {
        self.advance(now);
        while let Some(late) = self.way.pop_front_if(|late| late.due <= now) {
            self.traffic.said += 1;
            frames.push(late.bytes);
        }
    }

    /// The next instant at which a drive does something by itself or a frame is due.
    #[must_use]
    pub fn next_due(&self) -> Option<Nanos> {
        let way = self.way.front().map(|late| late.due);
        let restart = self.restarts.first().map(|(at, _)| *at);
        let nodes = self.nodes.iter().filter_map(Node::next_event).min();
        [way, restart, nodes].into_iter().flatten().min()
    }

    /// What a drive puts out, as far as the bus has run.
    #[must_use]
    pub fn outputs(&self, place: usize) -> Outputs {
        self.nodes.get(place).map_or_else(Outputs::default, Node::outputs)
    }

    /// The motor behind a drive.
    #[must_use]
    pub fn motor(&self, place: usize) -> Motor {
        self.nodes.get(place).map_or_else(Motor::default, |node| node.motor)
    }

    /// How many drives there are.
    #[must_use]
    pub fn drives(&self) -> usize {
        self.nodes.len()
    }

    /// What passed over the bus since power came on.
    #[must_use]
    pub fn traffic(&self) -> Traffic {
        self.traffic
    }
}

impl Device {
    fn torque_nm(&self) -> f64 {
        match self {
            Device::CanOpen(drive) => drive.torque_nm(),
            Device::Moteus(drive) => drive.torque_nm(),
            Device::Odrive(drive) => drive.torque_nm(),
        }
    }
}

impl Node {
    fn restart(&mut self) {
        match &mut self.device {
            Device::CanOpen(drive) => drive.restart(),
            Device::Moteus(drive) => drive.restart(),
            Device::Odrive(drive) => drive.restart(),
        }
    }

    fn set_fault(&mut self, is_there: bool) {
        match &mut self.device {
            Device::CanOpen(drive) => drive.set_fault(is_there),
            Device::Moteus(drive) => drive.set_fault(is_there),
            Device::Odrive(drive) => drive.set_fault(is_there),
        }
    }

    fn show(&mut self) {
        let Motor { turns, speed, .. } = self.motor;
        match &mut self.device {
            Device::CanOpen(drive) => drive.set_motion(turns, speed),
            Device::Moteus(drive) => drive.set_motion(turns, speed),
            Device::Odrive(drive) => drive.set_motion(turns, speed),
        }
    }

    fn advance(&mut self, now: Nanos) {
        match &mut self.device {
            Device::CanOpen(drive) => drive.advance(now),
            Device::Moteus(drive) => drive.advance(now),
            Device::Odrive(drive) => drive.advance(now),
        }
    }

    fn receive(&mut self, now: Nanos, frame: &BusFrame) {
        match &mut self.device {
            Device::CanOpen(drive) => drive.receive(now, frame),
            Device::Moteus(drive) => drive.receive(now, frame),
            Device::Odrive(drive) => drive.receive(now, frame),
        }
    }

    fn next_event(&self) -> Option<Nanos> {
        match &self.device {
            Device::CanOpen(drive) => drive.next_event(),
            Device::Moteus(drive) => drive.next_event(),
            Device::Odrive(drive) => drive.next_event(),
        }
    }

    fn outbox(&mut self) -> Vec<BusFrame> {
        std::mem::take(match &mut self.device {
            Device::CanOpen(drive) => &mut drive.outbox,
            Device::Moteus(drive) => &mut drive.outbox,
            Device::Odrive(drive) => &mut drive.outbox,
        })
    }

    fn outputs(&self) -> Outputs {
        let torque_nm = self.device.torque_nm();
        match &self.device {
            Device::CanOpen(drive) => Outputs {
                is_enabled: drive.is_enabled(),
                is_wanted: drive.is_wanted(),
                target: drive.target(),
                torque_nm,
                digital: drive.digital_outputs(),
                host_signs: drive.host_signs,
            },
            Device::Moteus(drive) => {
                let (is_enabled, target) = (drive.is_enabled(), drive.target());
                let is_wanted = is_enabled;
                Outputs { is_enabled, is_wanted, target, torque_nm, ..Outputs::default() }
            }
            Device::Odrive(drive) => {
                let (is_enabled, target) = (drive.is_enabled(), drive.target());
                let is_wanted = is_enabled;
                Outputs { is_enabled, is_wanted, target, torque_nm, ..Outputs::default() }
            }
        }
    }
}
