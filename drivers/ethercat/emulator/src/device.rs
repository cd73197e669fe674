//! One device of a segment: its controller, its state machine of the application layer with the
//! watchdog of outputs, its mailbox, and the process data that join them with the application.

use taktil_hal::Nanos;

use crate::application::Application;
use crate::bits::{field, set_field, signed};
use crate::controller::{
    AL_CODE_ADDRESS, AL_CONTROL_ADDRESS, AL_STATUS_ADDRESS, Controller, Event, LogicalCommand,
};
use crate::description::{
    Description, Entry, MAILBOX_BYTES, MAILBOX_IN_ADDRESS, MAILBOX_OUT_ADDRESS, Purpose,
};
use crate::dictionary::Dictionary;
use crate::information;

/// States of the application layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum State {
    /// Nothing but registers.
    Init,
    /// Mailboxes.
    PreOperational,
    /// Inputs too.
    SafeOperational,
    /// Outputs too.
    Operational,
}

impl State {
    const fn code(self) -> u16 {
        match self {
            State::Init => 1,
            State::PreOperational => 2,
            State::SafeOperational => 4,
            State::Operational => 8,
        }
    }

    const fn from_code(code: u16) -> Option<State> {
        match code {
            1 => Some(State::Init),
            2 => Some(State::PreOperational),
            4 => Some(State::SafeOperational),
            8 => Some(State::Operational),
            _ => None,
        }
    }

    /// The state above.
    const fn next(self) -> State {
        match self {
            State::Init => State::PreOperational,
            State::PreOperational => State::SafeOperational,
            State::SafeOperational | State::Operational => State::Operational,
        }
    }
}

/// A refusal is marked in the state.
const ERROR_BIT: u16 = 0x10;
/// The state that boot loaders use.
const BOOTSTRAP_CODE: u16 = 3;

/// Codes of the application layer.
mod refusal {
    pub(super) const TRANSITION_CODE: u16 = 0x0011;
    pub(super) const UNKNOWN_STATE_CODE: u16 = 0x0012;
    pub(super) const BOOTSTRAP_CODE: u16 = 0x0013;
    pub(super) const MAILBOX_CODE: u16 = 0x0016;
    pub(super) const WATCHDOG_CODE: u16 = 0x001b;
    pub(super) const OUTPUTS_CODE: u16 = 0x001d;
    pub(super) const INPUTS_CODE: u16 = 0x001e;
    pub(super) const MAPPING_CODE: u16 = 0x0025;
    pub(super) const SYNC_CODE: u16 = 0x002c;
    pub(super) const NO_SYNC_CODE: u16 = 0x002d;
}

/// A device on a segment.
#[derive(Debug)]
pub(crate) struct Device {
    pub(crate) description: Description,
    pub(crate) controller: Controller,
    pub(crate) application: Application,
    dictionary: Dictionary,
    outputs: Vec<Entry>,
    inputs: Vec<Entry>,
    state: State,
    /// When outputs came last.
    heard: Nanos,
    /// Outputs that wait for SYNC0.
    waiting: bool,
    pub(crate) sync: SyncFigures,
}

/// How a device that acts by SYNC0 got its outputs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SyncFigures {
    /// Pulses in operation.
    pub pulses: u64,
    /// Pulses before which no outputs had come since the one before.
    pub misses: u64,
    /// Grows by 3 with each miss, and falls by 1 with each other pulse.
    level: u64,
}

/// The level of missed pulses at which a device gives operation up.
const SYNC_LEVEL_MAX: u64 = 12;

impl Device {
    pub(crate) fn new(description: Description, position: usize, devices: usize) -> Device {
        let controller = Controller::new(information::image(&description), position, devices);
        let mut device = Device {
            application: Application::new(description.model),
            dictionary: Dictionary::new(&description),
            controller,
            description,
            outputs: Vec::new(),
            inputs: Vec::new(),
            state: State::Init,
            heard: Nanos::ZERO,
            waiting: false,
            sync: SyncFigures::default(),
        };
        device.map();
        device.load();
        device
    }

    /// Tells the application the objects that the description sets.
    fn load(&mut self) {
        for object in &self.description.objects {
            let mut value = [0; 8];
            let count = object.bytes.len().min(8);
            value[..count].copy_from_slice(&object.bytes[..count]);
            let value = i64::from_le_bytes(value);
            self.application.write(object.index, object.subindex, value);
        }
    }

    /// Everything is as after power-up.
    pub(crate) fn restart(&mut self) {
        self.controller.reset();
        self.application.reset();
        self.dictionary = Dictionary::new(&self.description);
        self.state = State::Init;
        self.map();
        self.load();
    }

    pub(crate) fn state(&self) -> State {
        self.state
    }

    /// The process data as the dictionary maps them; `false` when it maps what is not there.
    fn map(&mut self) -> bool {
        let maps = (self.dictionary.mapping(true), self.dictionary.mapping(false));
        match maps {
            (Some(outputs), Some(inputs)) => {
                (self.outputs, self.inputs) = (outputs, inputs);
                true
            }
            _ => false,
        }
    }

    /// The sync manager of process data in a direction.
    fn manager(&self, purpose: Purpose) -> Option<usize> {
        self.description.sync_managers.iter().position(|one| one.purpose == purpose)
    }

    /// Whether the host drives outputs here.
    fn has_outputs(&self) -> bool {
        !self.outputs.is_empty()
    }

    /// Reads a register or a part of the process memory for the host.
    pub(crate) fn read(&mut self, address: u16, data: &mut [u8], now: Nanos) -> bool {
        let event = self.controller.read(address, data, now);
        if event == Some(Event::MailboxRead) {
            self.fill_mailbox();
        }
        event.is_some()
    }

    /// Writes such a place for the host.
    pub(crate) fn write(&mut self, address: u16, data: &[u8], now: Nanos) -> bool {
        match self.controller.write(address, data, now) {
            None => return false,
            Some(Event::MailboxWritten) => self.take_message(),
            Some(Event::OutputsWritten) => self.take_outputs(now),
            Some(Event::StateRequested) => {
                let control = self.controller.word(AL_CONTROL_ADDRESS);
                self.request(control, now);
            }
            Some(Event::None | Event::MailboxRead) => {}
        }
        true
    }

    /// Exchanges the logical image; the counter that this adds.
    pub(crate) fn exchange(
        &mut self,
        logical: u32,
        command: LogicalCommand,
        outgoing: &[u8],
        data: &mut [u8],
        now: Nanos,
    ) -> u16 {
        if self.state < State::SafeOperational {
            return 0;
        }
        let done = self.controller.exchange(logical, command, outgoing, data, now);
        if done.has_outputs {
            self.take_outputs(now);
        }
        let write_weight = if command.reads { 2 } else { 1 };
        u16::from(done.has_read) + write_weight * u16::from(done.has_written)
    }

    fn take_message(&mut self) {
        if self.state < State::PreOperational || !self.description.has_mailbox {
            return;
        }
        let message = self.controller.bytes(MAILBOX_OUT_ADDRESS, MAILBOX_BYTES).to_vec();
        let may_map = self.state == State::PreOperational;
        self.dictionary.receive(&message, &mut self.application, may_map);
        self.fill_mailbox();
    }

    fn fill_mailbox(&mut self) {
        let Some(number) = self.manager(Purpose::MailboxIn) else { return };
        if !self.controller.is_mailbox_full(number)
            && let Some(message) = self.dictionary.answer()
        {
            self.controller.fill_mailbox(number, &message);
        }
    }

    /// The device sends an emergency by itself.
    pub(crate) fn send_emergency(&mut self, code: u16) {
        if self.description.has_mailbox && self.state >= State::PreOperational {
            self.dictionary.push_emergency(code);
            self.fill_mailbox();
        }
    }

    fn take_outputs(&mut self, now: Nanos) {
        self.heard = now;
        if self.state != State::Operational {
            return;
        }
        match self.controller.has_sync() {
            Some(_) => self.waiting = true,
            None => self.act(),
        }
    }

    /// Lets time pass up to `now` for a device that acts by SYNC0.
    pub(crate) fn pulse(&mut self, now: Nanos) {
        let pulses = self.controller.pulses(now).count;
        if pulses == 0 || self.state != State::Operational || !self.has_outputs() {
            return;
        }
        let missed = pulses - u64::from(std::mem::take(&mut self.waiting));
        if missed < pulses {
            self.act();
        }
        self.sync.pulses += pulses;
        self.sync.misses += missed;
        let level = (self.sync.level + 3 * missed).saturating_sub(pulses - missed);
        self.sync.level = level;
        if level >= SYNC_LEVEL_MAX {
            self.drop_to(State::SafeOperational, refusal::SYNC_CODE);
        }
    }

    /// The outputs that came last act.
    fn act(&mut self) {
        let Some(number) = self.manager(Purpose::Outputs) else { return };
        let manager = self.controller.manager(number);
        let bytes = self.controller.bytes(manager.address, manager.length);
        let mut first = 0;
        for entry in &self.outputs {
            let value = signed(field(bytes, first, entry.bits), entry.bits);
            self.application.write(entry.index, entry.subindex, value);
            first += usize::from(entry.bits);
        }
    }

    /// Puts the application's values where the host reads them.
    pub(crate) fn give_inputs(&mut self) {
        if self.state < State::SafeOperational {
            return;
        }
        let Some(number) = self.manager(Purpose::Inputs) else { return };
        let manager = self.controller.manager(number);
        let bytes = self.controller.bytes_mut(manager.address, manager.length);
        let mut first = 0;
        for entry in &self.inputs {
            let value = self.application.read(entry.index, entry.subindex).unwrap_or(0);
            set_field(bytes, first, entry.bits, value.cast_unsigned());
            first += usize::from(entry.bits);
        }
    }

    /// Lets the watchdog of outputs bite when its time is over.
    pub(crate) fn watch(&mut self, now: Nanos) {
        let Some(longest) = self.controller.output_watchdog() else { return };
        let is_watched = self.manager(Purpose::Outputs).is_some_and(|number| {
            self.controller.manager(number).has_watchdog() && self.has_outputs()
        });
        if self.state == State::Operational && is_watched && now - self.heard > longest {
            self.controller.count_bite();
            self.clear_outputs();
            self.set_state(State::SafeOperational, Some(refusal::WATCHDOG_CODE));
        }
    }

    fn clear_outputs(&mut self) {
        if let Some(number) = self.manager(Purpose::Outputs) {
            let manager = self.controller.manager(number);
            self.controller.bytes_mut(manager.address, manager.length).fill(0);
        }
        self.application.stop();
    }

    fn set_state(&mut self, state: State, refused: Option<u16>) {
        if self.state == State::Operational && state != State::Operational {
            self.application.stop();
        }
        self.state = state;
        let error = if refused.is_some() { ERROR_BIT } else { 0 };
        self.controller.set_word(AL_STATUS_ADDRESS, state.code() | error);
        self.controller.set_word(AL_CODE_ADDRESS, refused.unwrap_or(0));
    }

    /// Drops to a lower state by itself, with a code, as after an internal error.
    pub(crate) fn drop_to(&mut self, state: State, code: u16) {
        if state < self.state {
            self.clear_outputs();
            self.set_state(state, Some(code));
        }
    }

    /// What the host asks of the state machine.
    fn request(&mut self, control: u16, now: Nanos) {
        let has_error = self.controller.word(AL_STATUS_ADDRESS) & ERROR_BIT != 0;
        let Some(wanted) = State::from_code(control & 0x0f) else {
            let is_bootstrap = control & 0x0f == BOOTSTRAP_CODE;
            let code =
                if is_bootstrap { refusal::BOOTSTRAP_CODE } else { refusal::UNKNOWN_STATE_CODE };
            return self.set_state(self.state, Some(code));
        };
        if has_error && control & ERROR_BIT == 0 && wanted >= self.state {
            return;
        }
        if wanted > self.state.next() {
            return self.set_state(self.state, Some(refusal::TRANSITION_CODE));
        }
        let refused = if wanted > self.state { self.refusal(wanted) } else { None };
        if refused.is_some() {
            return self.set_state(self.state, refused);
        }
        if wanted == State::Operational {
            self.heard = now;
            (self.waiting, self.sync.level) = (true, 0);
        }
        self.set_state(wanted, None);
    }

    /// Why a step up is refused.
    fn refusal(&mut self, wanted: State) -> Option<u16> {
        match wanted {
            State::PreOperational if self.description.has_mailbox => {
                let managers = [self.controller.manager(0), self.controller.manager(1)];
                let places = [MAILBOX_OUT_ADDRESS, MAILBOX_IN_ADDRESS];
                let fits = managers.iter().zip(places).all(|(one, address)| {
                    one.is_enabled && one.address == address && one.length == MAILBOX_BYTES
                });
                (!fits).then_some(refusal::MAILBOX_CODE)
            }
            State::SafeOperational => {
                if !self.map() {
                    return Some(refusal::MAPPING_CODE);
                }
                let outputs = (Purpose::Outputs, &self.outputs, refusal::OUTPUTS_CODE);
                let inputs = (Purpose::Inputs, &self.inputs, refusal::INPUTS_CODE);
                [outputs, inputs].into_iter().find_map(|(purpose, entries, code)| {
                    let bits: u16 = entries.iter().map(|entry| u16::from(entry.bits)).sum();
                    let manager = self.controller.manager(self.manager(purpose)?);
                    let fits = manager.is_enabled && manager.length == bits.div_ceil(8);
                    (bits > 0 && !fits).then_some(code)
                })
            }
            State::Operational if self.controller.has_sync() == Some(false) => {
                Some(refusal::NO_SYNC_CODE)
            }
            _ => None,
        }
    }
}
