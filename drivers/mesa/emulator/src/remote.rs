//! Emulates smart serial with a 7I77 behind it: the processor's command register, the channels'
//! registers, and in each remote a watchdog of its own that only a stop and a start clear.

use taktil_hal::Nanos;

/// How long a remote waits for the next exchange before it switches its outputs off.
pub const REMOTE_SILENCE: Nanos = Nanos::from_millis(50);
/// How long an exchange with the remotes takes.
pub const EXCHANGE_TIME: Nanos = Nanos::from_micros(60);
/// How long starting the channels takes.
pub const START_TIME: Nanos = Nanos::from_millis(2);
/// How long stopping the channels takes.
const STOP_TIME: Nanos = Nanos::from_micros(20);

/// Channels of a port.
pub(crate) const CHANNELS_MAX: usize = 8;
/// User registers of a channel.
pub(crate) const USER_REGISTERS: usize = 3;
/// Full scale of an analog output (V).
const FULL_SCALE_V: f64 = 10.0;
/// Width of an analog output's code.
const CODE_BITS: u32 = 13;
/// Place of the bit that switches the analog outputs on.
const ANALOG_ENABLE_BIT: u32 = 78;
/// Place of the bit that switches the spindle-enable output on.
const SPINDLE_ENABLE_BIT: u32 = 79;

/// What one 7I77 puts out.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RemoteOutputs {
    /// Volts at the analog outputs.
    pub volts: [f64; 6],
    /// Whether these are switched on.
    pub analog_enabled: bool,
    /// The spindle-enable output.
    pub spindle: bool,
    /// Outputs at the field terminals, a bit each.
    pub field: u16,
}

/// Status: a remote has a fault; which one stands in bits 31 to 24.
const STATUS_REMOTE_FAULT: u32 = 1 << 8;
/// Status: the exchange failed.
const STATUS_COMMUNICATION: u32 = 1 << 13;
/// Status: nothing answers.
const STATUS_NO_REMOTE: u32 = 1 << 14;
/// Status: the channel is not started.
const STATUS_NOT_READY: u32 = 1 << 15;
/// Remote fault: its watchdog has bitten.
const FAULT_WATCHDOG: u32 = 1 << 24;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Mode {
    #[default]
    Stopped,
    Setup,
    Running,
}

/// One channel with its remote.
#[derive(Clone, Debug, Default)]
struct Channel {
    name: [u8; 4],
    unit: u32,
    mode: Mode,
    written: [u32; USER_REGISTERS],
    read: [u32; USER_REGISTERS],
    status: u32,
    /// What the remote acts on.
    acting: [u32; USER_REGISTERS],
    /// The newest exchange since the start.
    fed: Option<Nanos>,
}

impl Channel {
    fn exists(&self) -> bool {
        self.unit != 0
    }

    fn is_analog(&self) -> bool {
        self.unit >> 24 == 0x11
    }

    /// What an analog channel puts out.
    fn act(&self, outputs: &mut RemoteOutputs) {
        let [low, middle, high] = self.acting.map(u128::from);
        let bits = low | (middle << 32) | (high << 64);
        outputs.spindle = bits >> SPINDLE_ENABLE_BIT & 1 == 1;
        outputs.analog_enabled = bits >> ANALOG_ENABLE_BIT & 1 == 1;
        if !outputs.analog_enabled {
            return;
        }
        outputs.volts = core::array::from_fn(|output| {
            let field = (bits >> (CODE_BITS as usize * output)) as u32 & ((1 << CODE_BITS) - 1);
            let code = (field << (32 - CODE_BITS)).cast_signed() >> (32 - CODE_BITS);
            let scale = if code < 0 { 4096.0 } else { 4095.0 };
            FULL_SCALE_V * f64::from(code) / scale
        });
    }

    fn bite_if_silent(&mut self, now: Nanos) {
        if self.fed.is_some_and(|fed| now - fed > REMOTE_SILENCE) {
            self.acting = [0; USER_REGISTERS];
            self.status |= STATUS_REMOTE_FAULT | FAULT_WATCHDOG;
        }
    }
}

/// A command that the processor has not finished.
#[derive(Clone, Copy, Debug)]
struct Pending {
    word: u32,
    done: Nanos,
}

/// A smart-serial port.
#[derive(Clone, Debug, Default)]
pub(crate) struct SmartSerial {
    channels: Vec<Channel>,
    pending: Option<Pending>,
    data: u32,
    /// Inputs of the field terminals, a word for each 7I77 of the port.
    pub(crate) field_inputs: Vec<u32>,
    /// Commands that came while another one was under way.
    pub(crate) overrun_commands: u64,
    /// Exchanges after which the analog outputs acted on what was written.
    pub(crate) exchanges: u64,
}

impl SmartSerial {
    pub(crate) fn new(remotes: &[([u8; 4], u32)]) -> SmartSerial {
        let channel = |(name, unit): &([u8; 4], u32)| Channel {
            name: *name,
            unit: *unit,
            status: STATUS_NOT_READY,
            ..Channel::default()
        };
        SmartSerial { channels: remotes.iter().map(channel).collect(), ..SmartSerial::default() }
    }

    /// Moves on to `now`; `wired` has a bit for each channel whose transmit pins are driven.
    pub(crate) fn advance(&mut self, now: Nanos, wired: u32) {
        if let Some(pending) = self.pending
            && pending.done <= now
        {
            self.pending = None;
            self.finish(pending, wired);
        }
        for channel in &mut self.channels {
            channel.bite_if_silent(now);
        }
    }

    /// When a command ends, or a remote that is not fed any more switches its outputs off.
    pub(crate) fn next_change(&self) -> Option<Nanos> {
        let pending = self.pending.map(|pending| pending.done);
        let silent = |channel: &Channel| {
            let fed = channel.fed.filter(|_| channel.status & STATUS_REMOTE_FAULT == 0);
            fed.map(|fed| fed + REMOTE_SILENCE + Nanos(1))
        };
        self.channels.iter().filter_map(silent).chain(pending).min()
    }

    fn finish(&mut self, pending: Pending, wired: u32) {
        let mask = pending.word & 0xff;
        match pending.word & 0xff00 {
            0x0800 => {
                let selected = if mask == 0 { 0xff } else { mask };
                self.each(selected, |channel| {
                    channel.mode = Mode::Stopped;
                    channel.fed = None;
                    channel.acting = [0; USER_REGISTERS];
                    channel.status = STATUS_NOT_READY;
                });
                self.data = 0;
            }
            0x0900 => self.start(mask, Mode::Running, wired),
            0x0f00 => self.start(mask, Mode::Setup, wired),
            0x1000 => self.exchange(mask, pending.done, wired),
            _ => {}
        }
    }

    fn each(&mut self, mask: u32, mut act: impl FnMut(&mut Channel)) {
        for (index, channel) in self.channels.iter_mut().enumerate() {
            if mask >> index & 1 == 1 {
                act(channel);
            }
        }
    }

    fn start(&mut self, mask: u32, mode: Mode, wired: u32) {
        self.data = 0;
        for (index, channel) in self.channels.iter_mut().enumerate() {
            if mask >> index & 1 == 0 {
                continue;
            }
            let answers = channel.exists() && wired >> index & 1 == 1;
            channel.status = if answers { 0 } else { STATUS_NO_REMOTE | STATUS_NOT_READY };
            channel.acting = [0; USER_REGISTERS];
            channel.fed = None;
            channel.mode = if answers { mode } else { Mode::Stopped };
            channel.read = match (answers, mode) {
                // Places of the process and global tables of contents: not 0.
                (true, Mode::Setup) => {
                    [channel.unit, u32::from_le_bytes(channel.name), 0x0b00_0a00]
                }
                _ => [0; USER_REGISTERS],
            };
            self.data |= u32::from(!answers) << index;
        }
    }

    fn exchange(&mut self, mask: u32, now: Nanos, wired: u32) {
        self.data = 0;
        let mut fields = self.field_inputs.iter().copied();
        for (index, channel) in self.channels.iter_mut().enumerate() {
            let is_field = channel.exists() && !channel.is_analog();
            let inputs = if is_field { fields.next().unwrap_or(0) } else { 0 };
            if mask >> index & 1 == 0 {
                continue;
            }
            channel.bite_if_silent(now);
            if channel.mode != Mode::Running || wired >> index & 1 == 0 {
                channel.status |= STATUS_COMMUNICATION;
                self.data |= 1 << index;
                continue;
            }
            channel.status &= !STATUS_COMMUNICATION;
            if channel.status & STATUS_REMOTE_FAULT == 0 {
                channel.acting = channel.written;
                channel.fed = Some(now);
                self.exchanges += u64::from(channel.is_analog());
            }
            if is_field {
                channel.read[0] = inputs;
            }
        }
    }

    pub(crate) fn command_word(&self) -> u32 {
        self.pending.map_or(0, |pending| pending.word)
    }

    pub(crate) fn data_word(&self) -> u32 {
        self.data
    }

    pub(crate) fn status_word(&self, channel: usize) -> u32 {
        self.channels.get(channel).map_or(0, |channel| channel.status)
    }

    pub(crate) fn user_word(&self, channel: usize, register: usize) -> u32 {
        self.channels.get(channel).map_or(0, |channel| channel.read[register])
    }

    pub(crate) fn write_user(&mut self, channel: usize, register: usize, word: u32) {
        if let Some(channel) = self.channels.get_mut(channel) {
            channel.written[register] = word;
        }
    }

    pub(crate) fn write_command(&mut self, now: Nanos, word: u32) {
        if word >> 31 == 1 {
            return;
        }
        if self.pending.is_some() {
            self.overrun_commands += 1;
            return;
        }
        let time = match word & 0xff00 {
            0x0900 | 0x0f00 => START_TIME,
            0x0800 => STOP_TIME,
            _ => EXCHANGE_TIME,
        };
        self.pending = Some(Pending { word, done: now + time });
    }

    /// What the 7I77s of this port put out, in the order of their channels.
    pub(crate) fn outputs(&self) -> Vec<RemoteOutputs> {
        let exists = |channel: &&Channel| channel.exists();
        let is_field = |channel: &&Channel| !channel.is_analog();
        let fields = self.channels.iter().filter(exists).filter(is_field);
        let mut outputs: Vec<RemoteOutputs> = fields
            .map(|channel| RemoteOutputs {
                field: channel.acting[0] as u16,
                ..RemoteOutputs::default()
            })
            .collect();
        for (index, channel) in self.channels.iter().filter(|c| c.is_analog()).enumerate() {
            if outputs.len() == index {
                outputs.push(RemoteOutputs::default());
            }
            channel.act(&mut outputs[index]);
        }
        outputs
    }
}
