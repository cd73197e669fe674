//! Finds which channels of smart serial are used, and what stands at each of them.

use crate::config::{Analog, Config, REMOTE_OUTPUTS, REMOTES_MAX, Terminal};
use crate::hostmot2::{Module, Pin, Tables, tag};
use crate::modules::sserial;
use taktil_drivers_exchange::Refusal;

/// Bits of a port in a mask of channels.
const PORT_BITS: usize = 8;
/// The mask of the channels of one port.
const PORT_MASK: u32 = 0xff;

/// What is used of one 7I77.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Remote {
    pub(crate) port: usize,
    /// Channel of the field terminals, where lines stand there.
    pub(crate) field: Option<usize>,
    /// Channel of the analog outputs, where they or the spindle enable are used.
    pub(crate) analog: Option<usize>,
    /// The analog channel that each output serves.
    pub(crate) channels: [Option<usize>; REMOTE_OUTPUTS],
}

impl Remote {
    /// Channels that are used.
    pub(crate) fn used(self) -> impl Iterator<Item = usize> {
        [self.field, self.analog].into_iter().flatten()
    }

    /// A bit for each of these channels: eight bits for each port.
    fn mask(self, channel: Option<usize>) -> u32 {
        channel.map_or(0, |channel| 1 << (PORT_BITS * self.port + channel))
    }
}

/// Smart serial as it is used.
#[derive(Clone, Debug)]
pub(crate) struct SerialWiring {
    pub(crate) module: Module,
    pub(crate) remotes: Vec<Remote>,
    /// A line stands at a spindle-enable output.
    pub(crate) has_spindle: bool,
}

impl SerialWiring {
    /// Finds the channels that the configuration asks for; `None` where it asks for none.
    pub(crate) fn new(config: &Config, tables: &Tables) -> Result<Option<SerialWiring>, Refusal> {
        let is_analog = config.analog == Analog::Remote;
        if !is_analog && !config.has_remote_lines() {
            return Ok(None);
        }
        let remotes = config.remotes.iter().enumerate().take(REMOTES_MAX);
        let remotes: Vec<Remote> = remotes.map(|(index, _)| remote(config, index)).collect();
        let used = || remotes.iter().filter(|remote| remote.used().next().is_some());
        let instances = used().map(|remote| remote.port + 1).max().unwrap_or(1);
        let kinds = [tag::SMART_SERIAL_TAG];
        let module = tables.require("analog", "smart serial", &kinds, instances)?.clone();
        for (port, channel) in used().flat_map(|r| r.used().map(|channel| (r.port, channel))) {
            let is_channel = |pin: &Pin| is_pin_of(*pin, port, channel);
            if !tables.pins.iter().any(is_channel) {
                let board = &tables.idrom.board_name;
                let what = format!("smart serial of this {board} has no channel {channel}");
                let what = if port == 0 { what } else { format!("{what} at port {port}") };
                return Err(Refusal::new("remotes", what, "load a configuration for the 7I77"));
            }
        }
        let has_spindle = config.has_lines_at(Terminal::Spindle);
        Ok(Some(SerialWiring { module, remotes, has_spindle }))
    }

    /// A bit for each channel of field terminals.
    pub(crate) fn field_mask(&self) -> u32 {
        self.remotes.iter().fold(0, |mask, remote| mask | remote.mask(remote.field))
    }

    /// A bit for each channel of analog outputs.
    pub(crate) fn analog_mask(&self) -> u32 {
        self.remotes.iter().fold(0, |mask, remote| mask | remote.mask(remote.analog))
    }

    /// A bit for each channel of spindle-enable outputs.
    pub(crate) fn spindle_mask(&self) -> u32 {
        if self.has_spindle { self.analog_mask() } else { 0 }
    }

    /// The ports that are used, each with the bits of its channels.
    pub(crate) fn ports(&self) -> impl Iterator<Item = (usize, u32)> {
        let all = self.field_mask() | self.analog_mask();
        let ports = (0..u32::BITS as usize / PORT_BITS).map(move |port| (port, of_port(all, port)));
        ports.filter(|(_, mask)| *mask != 0)
    }

    /// The address of a register of a channel.
    pub(crate) fn address(&self, register: u32, port: usize, channel: usize) -> u16 {
        self.module.address(register, port).wrapping_add(4 * channel as u16)
    }

    /// The address of a port's command register.
    pub(crate) fn command_address(&self, port: usize) -> u16 {
        self.address(sserial::COMMAND_REGISTER, port, 0)
    }

    /// Whether a pin belongs to a channel that is used.
    pub(crate) fn is_channel_of(&self, pin: Pin) -> bool {
        self.remotes
            .iter()
            .any(|remote| remote.used().any(|channel| is_pin_of(pin, remote.port, channel)))
    }
}

/// The bits of one port, from bit 0 on.
pub(crate) const fn of_port(mask: u32, port: usize) -> u32 {
    (mask >> (PORT_BITS * port)) & PORT_MASK
}

/// The bits of one port at their place.
pub(crate) const fn at_port(bits: u32, port: usize) -> u32 {
    (bits & PORT_MASK) << (PORT_BITS * port)
}

/// Whether a pin belongs to a channel: the low half of its function counts channels from 1.
fn is_pin_of(pin: Pin, port: usize, channel: usize) -> bool {
    let counted = usize::from(pin.function & 0x0f);
    pin.tag == tag::SMART_SERIAL_TAG && pin.unit == port && counted == channel + 1
}

fn remote(config: &Config, index: usize) -> Remote {
    let place = &config.remotes[index];
    let lines = config.lines();
    let has_lines = |at| lines.iter().any(|wired| wired.1.at == at && wired.1.remote == index);
    let mut channels = [None; REMOTE_OUTPUTS];
    if config.analog == Analog::Remote {
        let places = config.output_places().into_iter().enumerate();
        for (channel, output) in places.filter(|(_, output)| output.remote == index) {
            channels[output.output.min(REMOTE_OUTPUTS - 1)] = Some(channel);
        }
    }
    let is_analog = channels.iter().any(Option::is_some) || has_lines(Terminal::Spindle);
    Remote {
        port: place.port,
        field: has_lines(Terminal::Field).then_some(place.channel),
        analog: is_analog.then_some(place.channel + 1),
        channels,
    }
}
