//! The register file of the FPGA: what reads and writes of each address do, and how time acts on
//! watchdog, counters and remotes.

use std::collections::BTreeMap;
use std::fmt;

use taktil_hal::Nanos;

use crate::channel::{Channel, IndexPulses};
use crate::firmware::Firmware;
use crate::firmware::tag::{self, ENCODER_TAG, MUXED_ENCODER_TAG};
use crate::remote::{CHANNELS_MAX, RemoteOutputs, SmartSerial, USER_REGISTERS};

/// What the card puts out.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Outputs {
    /// Volts at the first 7I77's analog outputs.
    pub volts: [f64; 6],
    /// Whether these are switched on.
    pub analog_enabled: bool,
    /// Outputs at the first 7I77's field terminals, a bit each.
    pub field: u16,
    /// What all 7I77s put out, the first one among them.
    pub remotes: Vec<RemoteOutputs>,
    /// Duty of the pulse-width modulators, -1 to 1; 0 where pins or enable do not let it out.
    pub pwm: Vec<f64>,
    /// Levels that general outputs drive, a word for each port; 0 where an open drain floats.
    pub pins: Vec<u32>,
    /// Which pins are open drains, a word for each port.
    pub open_drains: Vec<u32>,
    /// Which pins are driven at all, a word for each port.
    pub driven: Vec<u32>,
}

/// What the card's inputs read.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Inputs {
    /// Counts of the discs.
    pub counts: Vec<i64>,
    /// Inputs at the first 7I77's field terminals, a bit each.
    pub field: u32,
    /// Inputs at the field terminals of further 7I77s.
    pub further_fields: Vec<u32>,
    /// Levels at the pins that are not driven, a word for each port.
    pub pins: Vec<u32>,
}

/// What stands behind the card: from an instant and its outputs to its inputs.
pub type Plant = Box<dyn FnMut(Nanos, &Outputs) -> Inputs + Send>;

/// What stands at an address.
#[derive(Clone, Copy, Debug)]
struct Target {
    tag: u8,
    register: u8,
    instance: usize,
    /// Channel of a smart-serial port.
    channel: usize,
}

#[derive(Clone, Debug, Default)]
struct Port {
    data: u32,
    direction: u32,
    alternate: u32,
    open_drain: u32,
    invert: u32,
}

#[derive(Clone, Debug)]
struct Watchdog {
    time: u32,
    /// When the timer's sign changes; `None` while it is negative.
    end: Option<Nanos>,
    status: u32,
}

/// A card whose power is on.
pub(crate) struct Card {
    firmware: Firmware,
    constants: BTreeMap<u16, u32>,
    targets: BTreeMap<u16, Target>,
    ports: Vec<Port>,
    watchdog: Watchdog,
    encoders: Vec<Channel>,
    divisor: u16,
    filter: u32,
    pwm: Vec<[u32; 2]>,
    pwm_rates: [u32; 2],
    pwm_enable: u32,
    /// Smart serial, a port each.
    pub(crate) serial: Vec<SmartSerial>,
    leds: u32,
    pub(crate) inputs: Inputs,
    /// Where the index pulses of each channel come.
    pub(crate) pulses: Vec<IndexPulses>,
    /// How often the watchdog has bitten.
    pub(crate) bites: u64,
}

impl fmt::Debug for Card {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Card").field("ports", &self.ports).finish_non_exhaustive()
    }
}

/// The timer of a watchdog that is switched off.
const WATCHDOG_OFF: u32 = 0x8000_0000;

impl Card {
    /// Switches power on, with discs that have no index pulses.
    pub(crate) fn new(firmware: Firmware) -> Card {
        let instances = |wanted: &[u8]| {
            let modules = firmware.modules.iter().filter(|entry| wanted.contains(&entry.tag));
            modules.map(|entry| usize::from(entry.instances)).max().unwrap_or(0)
        };
        let mut card = Card {
            constants: firmware.constants().into_iter().collect(),
            targets: targets(&firmware),
            ports: vec![Port::default(); instances(&[tag::IO_PORT_TAG])],
            watchdog: Watchdog { time: 0, end: None, status: 0 },
            encoders: vec![Channel::default(); instances(&[ENCODER_TAG, MUXED_ENCODER_TAG])],
            divisor: 0,
            filter: 0,
            pwm: vec![[0; 2]; instances(&[tag::PWM_TAG])],
            pwm_rates: [0; 2],
            pwm_enable: 0,
            serial: vec![SmartSerial::default(); instances(&[tag::SMART_SERIAL_TAG])],
            leds: 0,
            inputs: Inputs::default(),
            pulses: Vec::new(),
            bites: 0,
            firmware,
        };
        card.restart();
        card
    }

    /// Forgets everything that power-up forgets.
    pub(crate) fn restart(&mut self) {
        self.ports.iter_mut().for_each(|port| *port = Port::default());
        self.watchdog = Watchdog { time: WATCHDOG_OFF, end: None, status: 0 };
        self.encoders.iter_mut().for_each(Channel::restart);
        self.pwm.iter_mut().for_each(|registers| *registers = [0; 2]);
        (self.divisor, self.filter, self.pwm_rates, self.pwm_enable) = (0, 0, [0; 2], 0);
        let mut remotes = self.firmware.remotes.chunks(CHANNELS_MAX);
        for port in &mut self.serial {
            *port = SmartSerial::new(remotes.next().unwrap_or(&[]));
        }
        self.leds = 0;
    }

    /// How many encoder channels it has.
    pub(crate) fn encoder_count(&self) -> usize {
        self.encoders.len()
    }

    /// Moves on to `now`: the watchdog, then the remotes.
    pub(crate) fn advance(&mut self, now: Nanos) {
        if self.watchdog.end.is_some_and(|end| end <= now) {
            self.watchdog.end = None;
            self.watchdog.status = 1;
            self.bites += 1;
            for port in &mut self.ports {
                (port.direction, port.open_drain) = (0, 0);
            }
        }
        for port in 0..self.serial.len() {
            let wired = self.wired_channels(port);
            self.serial[port].advance(now, wired);
        }
    }

    /// When its watchdog or its remotes will next do something by themselves.
    pub(crate) fn next_change(&self) -> Option<Nanos> {
        let remotes = self.serial.iter().filter_map(SmartSerial::next_change);
        remotes.chain(self.watchdog.end).min()
    }

    /// The plant has moved on: what the inputs read at `now`.
    pub(crate) fn take_inputs(&mut self, now: Nanos, inputs: Inputs) {
        let ticks = self.ticks(now);
        for (index, (channel, count)) in self.encoders.iter_mut().zip(&inputs.counts).enumerate() {
            let pulses = self.pulses.get(index).copied().unwrap_or_default();
            channel.advance(*count, ticks, pulses);
        }
        let mut fields = core::iter::once(&inputs.field).chain(&inputs.further_fields).copied();
        for port in &mut self.serial {
            let count = port.outputs().len();
            port.field_inputs = fields.by_ref().take(count).collect();
        }
        self.inputs = inputs;
    }

    /// The time-stamp counter.
    fn ticks(&self, now: Nanos) -> u16 {
        let cycles = i128::from(now.0) * i128::from(self.firmware.clock_low_hz) / 1_000_000_000;
        (cycles / (i128::from(self.divisor) + 2)) as u16
    }

    /// Whether the pin drives what its module gives.
    fn is_driven(&self, index: usize) -> bool {
        let width = self.firmware.port_width.max(1) as usize;
        let bit = 1 << (index % width);
        self.ports
            .get(index / width)
            .is_some_and(|port| port.direction & bit != 0 && port.alternate & bit != 0)
    }

    fn wired_channels(&self, port: usize) -> u32 {
        let mut wired = 0xff;
        for (index, pin) in self.firmware.pins.iter().enumerate() {
            let ours = pin.tag == tag::SMART_SERIAL_TAG && usize::from(pin.unit) == port;
            let transmits = ours && pin.function & 0x80 != 0;
            let channel = u32::from(pin.function & 0x0f).wrapping_sub(1);
            if transmits && channel < 8 && !self.is_driven(index) {
                wired &= !(1 << channel);
            }
        }
        wired
    }

    fn duty(&self, unit: usize) -> f64 {
        let let_out = self.firmware.pins.iter().enumerate().all(|(index, pin)| {
            let ours = pin.tag == tag::PWM_TAG && usize::from(pin.unit) == unit;
            !ours || self.is_driven(index)
        });
        if !let_out || self.pwm_enable >> unit & 1 == 0 {
            return 0.0;
        }
        let [value, mode] = self.pwm[unit];
        let bits = 9 + (mode & 3);
        let part = f64::from(value >> 16 & 0x0fff) / f64::from((1u32 << bits) - 1);
        if value >> 31 == 1 { -part } else { part }
    }

    pub(crate) fn outputs(&self) -> Outputs {
        let remotes: Vec<RemoteOutputs> =
            self.serial.iter().flat_map(SmartSerial::outputs).collect();
        let first = remotes.first().copied().unwrap_or_default();
        let general = |port: &Port| port.direction & !port.alternate;
        Outputs {
            volts: first.volts,
            analog_enabled: first.analog_enabled,
            field: first.field,
            remotes,
            pwm: (0..self.pwm.len()).map(|unit| self.duty(unit)).collect(),
            pins: self.ports.iter().map(|p| (p.data ^ p.invert) & general(p)).collect(),
            open_drains: self.ports.iter().map(|port| port.open_drain).collect(),
            driven: self.ports.iter().map(|port| port.direction).collect(),
        }
    }

    /// The word at an address, which is a multiple of 4.
    pub(crate) fn read(&self, address: u16, now: Nanos) -> u32 {
        if let Some(word) = self.constants.get(&address) {
            return *word;
        }
        let Some(target) = self.targets.get(&address) else { return 0 };
        let (register, instance) = (target.register, target.instance);
        match (target.tag, register) {
            (tag::WATCHDOG_TAG, 0) => {
                let rest = self.watchdog.end.map(|end| i128::from((end - now).0));
                let clock = i128::from(self.firmware.clock_low_hz);
                rest.map_or(WATCHDOG_OFF, |rest| (rest * clock / 1_000_000_000) as u32)
            }
            (tag::WATCHDOG_TAG, 1) => self.watchdog.status,
            (tag::IO_PORT_TAG, _) => self.read_port(register, instance),
            (ENCODER_TAG | MUXED_ENCODER_TAG, 0) => self.encoders[instance].count_word(),
            (ENCODER_TAG | MUXED_ENCODER_TAG, 1) => self.encoders[instance].control_word(),
            (ENCODER_TAG | MUXED_ENCODER_TAG, 2) => u32::from(self.divisor),
            (ENCODER_TAG | MUXED_ENCODER_TAG, 3) => u32::from(self.ticks(now)),
            (ENCODER_TAG | MUXED_ENCODER_TAG, _) => self.filter,
            (tag::PWM_TAG, 0 | 1) => self.pwm[instance][usize::from(register)],
            (tag::PWM_TAG, 2 | 3) => self.pwm_rates[usize::from(register) - 2],
            (tag::PWM_TAG, _) => self.pwm_enable,
            (tag::SMART_SERIAL_TAG, 0) => self.serial[instance].command_word(),
            (tag::SMART_SERIAL_TAG, 1) => self.serial[instance].data_word(),
            (tag::SMART_SERIAL_TAG, 2) => self.serial[instance].status_word(target.channel),
            (tag::SMART_SERIAL_TAG, _) => {
                self.serial[instance].user_word(target.channel, usize::from(register) - 3)
            }
            (tag::LED_TAG, _) => self.leds,
            _ => 0,
        }
    }

    fn read_port(&self, register: u8, instance: usize) -> u32 {
        let port = &self.ports[instance];
        let level = self.inputs.pins.get(instance).copied().unwrap_or(0);
        match register {
            0 => (port.data & port.direction) | (level & !port.direction),
            1 => port.direction,
            2 => port.alternate,
            3 => port.open_drain,
            _ => port.invert,
        }
    }

    /// Writes a word at an address, which is a multiple of 4.
    pub(crate) fn write(&mut self, address: u16, word: u32, now: Nanos) {
        let Some(target) = self.targets.get(&address).copied() else { return };
        let (register, instance) = (target.register, target.instance);
        match (target.tag, register) {
            (tag::WATCHDOG_TAG, 0) => {
                self.watchdog.time = word;
                self.load_watchdog(now);
            }
            (tag::WATCHDOG_TAG, 1) => self.watchdog.status = word & 1,
            (tag::WATCHDOG_TAG, _) if word >> 24 == 0x5a => self.load_watchdog(now),
            (tag::IO_PORT_TAG, _) => {
                let port = &mut self.ports[instance];
                let place = match register {
                    0 => &mut port.data,
                    1 => &mut port.direction,
                    2 => &mut port.alternate,
                    3 => &mut port.open_drain,
                    _ => &mut port.invert,
                };
                *place = word;
            }
            (ENCODER_TAG | MUXED_ENCODER_TAG, 0) => self.encoders[instance].clear(),
            (ENCODER_TAG | MUXED_ENCODER_TAG, 1) => self.encoders[instance].write_control(word),
            (ENCODER_TAG | MUXED_ENCODER_TAG, 2) => self.divisor = word as u16,
            (ENCODER_TAG | MUXED_ENCODER_TAG, 4) => self.filter = word,
            (tag::PWM_TAG, 0 | 1) => self.pwm[instance][usize::from(register)] = word,
            (tag::PWM_TAG, 2 | 3) => self.pwm_rates[usize::from(register) - 2] = word,
            (tag::PWM_TAG, _) => self.pwm_enable = word,
            (tag::SMART_SERIAL_TAG, 0) => self.serial[instance].write_command(now, word),
            (tag::SMART_SERIAL_TAG, 3..) => {
                self.serial[instance].write_user(target.channel, usize::from(register) - 3, word);
            }
            (tag::LED_TAG, _) => self.leds = word,
            _ => {}
        }
    }

    fn load_watchdog(&mut self, now: Nanos) {
        let cycles = i64::from(self.watchdog.time) + 1;
        let time = Nanos(cycles * 1_000_000_000 / i64::from(self.firmware.clock_low_hz));
        self.watchdog.end = (self.watchdog.time < WATCHDOG_OFF).then(|| now + time);
    }
}

/// Addresses of all registers, from the tables that the card shows.
fn targets(firmware: &Firmware) -> BTreeMap<u16, Target> {
    let [instance_0, instance_1, register_0, register_1] = firmware.strides;
    let mut all = BTreeMap::new();
    for entry in &firmware.modules {
        let register_stride = if entry.strides & 0x0f == 0 { register_0 } else { register_1 };
        let instance_stride = if entry.strides >> 4 == 0 { instance_0 } else { instance_1 };
        for register in 0..entry.registers {
            let many = entry.multiple >> register & 1 == 1 || entry.tag == tag::SMART_SERIAL_TAG;
            let instances = if many { usize::from(entry.instances) } else { 1 };
            for instance in 0..instances {
                let of_channel = entry.tag == tag::SMART_SERIAL_TAG && register >= 2;
                for channel in 0..if of_channel { CHANNELS_MAX } else { 1 } {
                    let address = u32::from(entry.base)
                        .wrapping_add(u32::from(register).wrapping_mul(register_stride))
                        .wrapping_add((instance as u32).wrapping_mul(instance_stride))
                        .wrapping_add(4 * channel as u32);
                    let target = Target { tag: entry.tag, register, instance, channel };
                    if usize::from(register) < 3 + USER_REGISTERS {
                        all.insert(address as u16, target);
                    }
                }
            }
        }
    }
    all
}
