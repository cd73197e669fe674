//! A whole segment: the devices in their order, the plant behind them, and the faults that befall
//! the cable and the devices by plan.

use std::collections::VecDeque;

use taktil_hal::fault::{FaultCounts, FaultKind, FaultPlan, SplitMix};
use taktil_hal::{Invalid, Nanos};

use crate::datagram::{execute, is_cyclic, is_frame};
use crate::description::{Description, Model};
use crate::device::{Device, State, SyncFigures};
use crate::drive::PLANNED_ERROR_CODE;
use crate::plant::{Inputs, Outputs, Plant, Shaft};

/// The faults that can befall a segment. A channel of the target is the position of a device: the
/// cable is pulled before it, it restarts, or, for `failing`, it is a drive that has a fault. A
/// fault without a channel befalls the whole.
pub const EXECUTED_FAULTS: [FaultKind; 9] = [
    FaultKind::Loss,
    FaultKind::Duplication,
    FaultKind::Delay,
    FaultKind::Corruption,
    FaultKind::Silence,
    FaultKind::Unplugged,
    FaultKind::Restart,
    FaultKind::Frozen,
    FaultKind::Failing,
];
/// Code of a device that has dropped to a lower state by itself.
const INTERNAL_ERROR_CODE: u16 = 0x0001;
/// Devices on a segment.
pub const DEVICES_MAX: usize = 64;

/// What passed on the cable.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Traffic {
    /// Frames of EtherCAT that came from the host.
    pub frames: u64,
    /// Those of them that carried the logical image.
    pub cyclic: u64,
    /// Frames that went back.
    pub answers: u64,
    /// The frames and devices that faults befell.
    pub faults: FaultCounts,
}

/// A segment.
pub struct Segment {
    devices: Vec<Device>,
    plant: Option<Plant>,
    plan: FaultPlan,
    target: String,
    random: SplitMix,
    /// Answers with the instants at which they are due.
    due: VecDeque<(Nanos, Vec<u8>)>,
    traffic: Traffic,
    now: Nanos,
    inputs: Inputs,
    /// Faults of the plan that have begun.
    begun: Vec<bool>,
}

impl std::fmt::Debug for Segment {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Segment").field("devices", &self.devices.len()).finish_non_exhaustive()
    }
}

impl Segment {
    /// A segment of these devices after power-up, with a plant behind it.
    ///
    /// # Panics
    /// When there is no device, or more than [`DEVICES_MAX`].
    #[must_use]
    pub fn new(devices: Vec<Description>, plant: Plant) -> Segment {
        Segment { plant: Some(plant), ..Segment::without_plant(devices) }
    }

    /// A segment whose inputs are told by [`Segment::set_inputs`].
    ///
    /// # Panics
    /// As [`Segment::new`].
    #[must_use]
    pub fn without_plant(devices: Vec<Description>) -> Segment {
        let count = devices.len();
        assert!((1..=DEVICES_MAX).contains(&count), "1 to {DEVICES_MAX} devices, not {count}");
        let build = |(position, device)| Device::new(device, position, count);
        Segment {
            devices: devices.into_iter().enumerate().map(build).collect(),
            plant: None,
            plan: FaultPlan::default(),
            target: String::new(),
            random: SplitMix::new(1),
            due: VecDeque::new(),
            traffic: Traffic::default(),
            now: Nanos::ZERO,
            inputs: Inputs::default(),
            begun: Vec::new(),
        }
    }

    /// The same segment, which the faults of a plan befall under a name.
    ///
    /// # Errors
    /// A fault that no segment can have, or one of a device that is not there.
    pub fn with_faults(
        mut self,
        plan: FaultPlan,
        target: &str,
        seed: u64,
    ) -> Result<Segment, Invalid> {
        for fault in plan.faults().iter().filter(|fault| fault.target == target) {
            if !EXECUTED_FAULTS.contains(&fault.kind) {
                let what = format!("`{}` cannot happen to `{target}`", fault.kind.name());
                let words = FaultKind::words(&EXECUTED_FAULTS);
                return Err(Invalid::new("kind", what, format!("it is one of: {words}")));
            }
            if fault.channel.is_some_and(|one| usize::from(one) > self.devices.len()) {
                let what = format!("the segment has {} devices", self.devices.len());
                return Err(Invalid::new("target", what, "the first device is 1"));
            }
        }
        self.begun = vec![false; plan.faults().len()];
        (self.plan, self.target, self.random) = (plan, target.to_owned(), SplitMix::new(seed));
        Ok(self)
    }

    /// The same segment, where a word of a device's information memory has another value. Devices
    /// count from 0; one that is not there changes nothing.
    #[must_use]
    pub fn with_damaged_information(mut self, device: usize, word: u16, value: u16) -> Segment {
        if let Some(device) = self.devices.get_mut(device) {
            device.controller.damage_information(word, value);
        }
        self
    }

    /// What has passed so far.
    #[must_use]
    pub fn traffic(&self) -> Traffic {
        self.traffic
    }

    /// Bites of the watchdogs of outputs, of all devices.
    #[must_use]
    pub fn bites(&self) -> u64 {
        self.devices.iter().map(|device| device.controller.bites()).sum()
    }

    /// The states of the devices, in their order.
    #[must_use]
    pub fn states(&self) -> Vec<State> {
        self.devices.iter().map(Device::state).collect()
    }

    /// Whether each drive's power section is on, in the order of the drives.
    #[must_use]
    pub fn enabled_drives(&self) -> Vec<bool> {
        let drives = self.devices.iter().filter_map(|device| device.application.drive.as_ref());
        drives.map(crate::drive::Drive::is_enabled).collect()
    }

    /// The target torque of each drive as the host sent it last (0.1 % of the rated one), whether
    /// it acts or not.
    #[must_use]
    pub fn target_torques(&self) -> Vec<i16> {
        let drives = self.devices.iter().filter_map(|device| device.application.drive.as_ref());
        drives.map(crate::drive::Drive::target_torque).collect()
    }

    /// The controlword of each drive as the host sent it last.
    #[must_use]
    pub fn controls(&self) -> Vec<u16> {
        let drives = self.devices.iter().filter_map(|device| device.application.drive.as_ref());
        drives.map(crate::drive::Drive::control).collect()
    }

    /// From now on the clock of the device at a position, counted from 0, is fast by so many
    /// millionths.
    pub fn set_clock_drift(&mut self, position: usize, ppm: i64) {
        let now = self.now;
        if let Some(device) = self.devices.get_mut(position) {
            device.controller.set_drift(ppm, now);
        }
    }

    /// The time of the segment at `now`, as the device at a position has it (ns).
    #[must_use]
    pub fn system_time_ns(&self, position: usize, now: Nanos) -> Option<u64> {
        self.devices.get(position).map(|device| device.controller.system_time(now))
    }

    /// How the devices that act by SYNC0 got their outputs, in the order of all devices.
    #[must_use]
    pub fn sync_figures(&self) -> Vec<SyncFigures> {
        self.devices.iter().map(|device| device.sync).collect()
    }

    /// The device at a position, counted from 0, drops by itself to a state below its own.
    pub fn drop_device(&mut self, position: usize, state: State) {
        if let Some(device) = self.devices.get_mut(position) {
            device.drop_to(state, INTERNAL_ERROR_CODE);
        }
    }

    /// The device at a position, counted from 0, sends an emergency message by its mailbox.
    pub fn send_emergency(&mut self, position: usize, code: u16) {
        if let Some(device) = self.devices.get_mut(position) {
            device.send_emergency(code);
        }
    }

    /// What the devices put out.
    #[must_use]
    pub fn outputs(&self) -> Outputs {
        let mut outputs = Outputs::default();
        for device in &self.devices {
            match device.description.model {
                Model::AnalogOutput => outputs.volts.extend(device.application.volts()),
                Model::DigitalOutput => outputs.lines.push(device.application.lines),
                _ => {}
            }
            if let Some(drive) = &device.application.drive {
                outputs.torques.push(f64::from(drive.torque_permille()) * 1e-3);
            }
        }
        outputs
    }

    /// Lets time pass up to `now`: watchdogs, the plant, what the devices read.
    pub fn advance(&mut self, now: Nanos) {
        let now = now.max(self.now);
        self.now = now;
        self.begin_faults(now);
        for device in &mut self.devices {
            device.pulse(now);
            device.watch(now);
        }
        let outputs = self.outputs();
        if let Some(plant) = &mut self.plant {
            let inputs = plant(now, &outputs);
            self.set_inputs(now, inputs);
        } else {
            self.read_plant(now);
        }
    }

    /// What the devices read from `now` on.
    pub fn set_inputs(&mut self, now: Nanos, inputs: Inputs) {
        if self.strength(FaultKind::Frozen, now).is_none() {
            self.inputs = inputs;
        }
        self.read_plant(now.max(self.now));
    }

    fn read_plant(&mut self, now: Nanos) {
        let inputs = &self.inputs;
        let mut counts = inputs.counts.iter();
        let mut lines = inputs.lines.iter();
        let mut volts = inputs.volts.chunks(4);
        let mut shafts = inputs.shafts.iter();
        for device in &mut self.devices {
            let application = &mut device.application;
            match device.description.model {
                Model::Encoder16 | Model::Encoder32 => {
                    application.set_count(counts.next().copied().unwrap_or(0));
                }
                Model::DigitalInput => application.lines = lines.next().copied().unwrap_or(0),
                Model::AnalogInput => application.set_volts(volts.next().unwrap_or(&[])),
                Model::Drive => {
                    let shaft = shafts.next().copied().unwrap_or(Shaft::default());
                    application.follow(now, shaft, inputs.has_supply);
                }
                Model::Coupler | Model::DigitalOutput | Model::AnalogOutput => {}
            }
        }
    }

    /// How strongly a fault of the whole segment acts.
    fn strength(&self, kind: FaultKind, now: Nanos) -> Option<f64> {
        let faults = self.plan.faults().iter().filter(|fault| fault.channel.is_none());
        let active =
            faults.filter(|fault| fault.kind == kind && fault.is_active(&self.target, now));
        active.map(|fault| fault.value).reduce(f64::max)
    }

    /// Executes what happens once, at the begin of a fault, or lasts on a device.
    fn begin_faults(&mut self, now: Nanos) {
        for (fault, begun) in self.plan.faults().iter().zip(&mut self.begun) {
            if !fault.is_active(&self.target, now) {
                continue;
            }
            let is_new = !std::mem::replace(begun, true);
            let befallen = self.devices.iter_mut().enumerate();
            for (_, device) in befallen.filter(|(position, _)| fault.has_channel(*position)) {
                match fault.kind {
                    FaultKind::Restart if is_new => {
                        device.restart();
                        self.traffic.faults.add(FaultKind::Restart);
                    }
                    FaultKind::Failing if is_new => {
                        if let Some(drive) = &mut device.application.drive {
                            drive.fail(PLANNED_ERROR_CODE);
                            self.traffic.faults.add(FaultKind::Failing);
                        }
                    }
                    _ => {}
                }
            }
        }
    }

    /// How many devices a frame reaches: the cable may be pulled before one of them.
    fn reached(&self, now: Nanos) -> usize {
        let faults = self.plan.faults().iter();
        let pulled = faults.filter(|fault| {
            fault.kind == FaultKind::Unplugged && fault.is_active(&self.target, now)
        });
        let before = pulled.map(|fault| fault.channel.map_or(0, |one| usize::from(one) - 1));
        before.min().unwrap_or(self.devices.len())
    }

    fn happens(&mut self, kind: FaultKind, now: Nanos) -> bool {
        let Some(probability) = self.strength(kind, now) else { return false };
        let is_hit = self.random.unit() < probability;
        if is_hit {
            self.traffic.faults.add(kind);
        }
        is_hit
    }

    /// Takes a frame of the host that arrives at `now`. Its answer is due at once, unless a fault
    /// keeps it.
    pub fn receive(&mut self, now: Nanos, frame: &[u8]) {
        self.advance(now);
        let now = self.now;
        if !is_frame(frame) {
            return;
        }
        self.traffic.frames += 1;
        self.traffic.cyclic += u64::from(is_cyclic(frame));
        let reached = self.reached(now);
        if self.strength(FaultKind::Silence, now).is_some() {
            self.traffic.faults.add(FaultKind::Silence);
            return;
        }
        if reached < self.devices.len() {
            self.traffic.faults.add(FaultKind::Unplugged);
        }
        if reached == 0 {
            return;
        }
        if self.happens(FaultKind::Loss, now) {
            return;
        }
        let mut answer = frame.to_vec();
        for device in &mut self.devices {
            device.controller.set_devices(reached);
            // Nobody but a frame looks at the inputs, and a device is shown its shaft far oftener.
            device.give_inputs();
        }
        execute(&mut self.devices[..reached], &mut answer, now);
        if self.happens(FaultKind::Corruption, now) {
            let bit = self.random.below(8 * answer.len());
            answer[bit / 8] ^= 1 << (bit % 8);
        }
        let delay = self.strength(FaultKind::Delay, now).map_or(Nanos::ZERO, |seconds| {
            self.traffic.faults.add(FaultKind::Delay);
            Nanos((seconds * 1e9) as i64)
        });
        if self.happens(FaultKind::Duplication, now) {
            self.due.push_back((now + delay, answer.clone()));
        }
        self.due.push_back((now + delay, answer));
    }

    /// When the next answer is due.
    #[must_use]
    pub fn next_due(&self) -> Option<Nanos> {
        self.due.iter().map(|(due, _)| *due).min()
    }

    /// The answers that are due at `now`.
    pub fn poll(&mut self, now: Nanos, answers: &mut Vec<Vec<u8>>) {
        let mut rest = VecDeque::new();
        for (due, answer) in self.due.drain(..) {
            if due <= now {
                self.traffic.answers += 1;
                answers.push(answer);
            } else {
                rest.push_back((due, answer));
            }
        }
        self.due = rest;
    }
}
