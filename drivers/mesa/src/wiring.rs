//! Joins a configuration with a card's tables: which modules serve which half, which pins they
//! drive, and where that cannot be.

use taktil_hal::CHANNELS;

use crate::config::{Analog, Config, Terminal};
use crate::error::Unfit;
use crate::hostmot2::{Module, Tables, tag};
use crate::modules::gpio::{InputLines, OutputLines, PORTS_MAX};
use crate::modules::pwm::Modulation;

/// Smart serial as it is used.
#[derive(Clone, Debug)]
pub(crate) struct SerialWiring {
    pub(crate) module: Module,
    /// Channel of the field terminals, where lines stand there.
    pub(crate) field: Option<usize>,
    /// Channel of the analog outputs, where they are used.
    pub(crate) analog: Option<usize>,
}

impl SerialWiring {
    /// A bit for the channel of the field terminals, or none.
    pub(crate) fn field_mask(&self) -> u32 {
        self.field.map_or(0, |channel| 1 << channel)
    }

    /// A bit for the channel of the analog outputs, or none.
    pub(crate) fn analog_mask(&self) -> u32 {
        self.analog.map_or(0, |channel| 1 << channel)
    }

    /// The address of a channel's register.
    pub(crate) fn address(&self, register: u32, channel: usize) -> u16 {
        self.module.address(register, 0).wrapping_add(4 * channel as u16)
    }
}

/// What of a card is used.
#[derive(Clone, Debug)]
pub(crate) struct Wiring {
    pub(crate) board_name: String,
    pub(crate) watchdog: Module,
    pub(crate) ports: Module,
    pub(crate) encoders: Option<Module>,
    pub(crate) serial: Option<SerialWiring>,
    pub(crate) pwm: Option<(Module, Modulation)>,
    pub(crate) inputs: Option<InputLines>,
    pub(crate) outputs: Option<OutputLines>,
    /// Directions of the pins, a word for each port.
    pub(crate) directions: [u32; PORTS_MAX],
    /// Pins that their modules drive, a word for each port.
    pub(crate) alternates: [u32; PORTS_MAX],
}

impl Wiring {
    /// Finds everything that the configuration asks for.
    pub(crate) fn new(config: &Config, tables: &Tables) -> Result<Wiring, Unfit> {
        let watchdog = tables.require("watchdog_ms", "watchdog", &[tag::WATCHDOG_TAG], 1)?;
        let ports = tables.require("address", "port of pins", &[tag::IO_PORT_TAG], 1)?;
        if ports.instances > PORTS_MAX {
            let what = format!("the card has {} ports of pins", ports.instances);
            return Err(Unfit::new("address", what, "at most 8 are known"));
        }
        let kinds = [tag::ENCODER_TAG, tag::MUXED_ENCODER_TAG];
        let encoders = match config.encoders {
            0 => None,
            wired => Some(tables.require("encoders", "encoder", &kinds, wired)?.clone()),
        };
        let mut wiring = Wiring {
            board_name: tables.idrom.board_name.clone(),
            watchdog: watchdog.clone(),
            ports: ports.clone(),
            encoders,
            serial: serial(config, tables)?,
            pwm: pwm(config, tables)?,
            inputs: config.lines_in.as_ref().map(|lines| InputLines::new(lines, tables)),
            outputs: config.lines_out.as_ref().map(|lines| OutputLines::new(lines, tables)),
            directions: [0; PORTS_MAX],
            alternates: [0; PORTS_MAX],
        };
        wiring.drive_pins(tables)?;
        wiring.check_lines(config, tables)?;
        Ok(wiring)
    }

    /// Directions of the pins that the used modules drive.
    fn drive_pins(&mut self, tables: &Tables) -> Result<(), Unfit> {
        let mut tags = Vec::new();
        if self.encoders.is_some() {
            tags.push(tag::MUXED_ENCODER_SELECT_TAG);
        }
        if self.serial.is_some() {
            tags.push(tag::SMART_SERIAL_TAG);
        }
        if self.pwm.is_some() {
            tags.push(tag::PWM_TAG);
        }
        for (pin, _) in tables.output_pins(&tags) {
            let (port, mask) = tables.port_and_bit(pin);
            if port >= self.ports.instances {
                let what = format!("pin {pin} lies outside the card's ports");
                return Err(Unfit::new("address", what, "load a configuration that is whole"));
            }
            self.directions[port] |= mask;
            self.alternates[port] |= mask;
        }
        Ok(())
    }

    /// Refuses lines that stand where something else is. Outputs first: an input may share its
    /// terminal with another input.
    fn check_lines(&mut self, config: &Config, tables: &Tables) -> Result<(), Unfit> {
        let modules = self.directions;
        let mut lines = config.lines();
        lines.sort_by_key(|(_, _, output)| !output);
        for (index, (place, line, output)) in lines.iter().enumerate() {
            let others = || lines[..index].iter().filter(|(_, _, output)| *output);
            let twice =
                others().any(|(_, other, _)| (other.at, other.number) == (line.at, line.number));
            if *output && twice {
                let what = format!("the output {:?} {} is used twice", line.at, line.number);
                return Err(Unfit::new(place, what, "give each output a place of its own"));
            }
            if line.at == Terminal::Field {
                continue;
            }
            let (port, mask) = tables.port_and_bit(line.number as usize);
            if port >= self.ports.instances || line.number as usize >= tables.pins.len() {
                let what = format!("this {} has no pin {}", self.board_name, line.number);
                return Err(Unfit::new(place, what, "give a pin of its pin table"));
            }
            if modules[port] & mask != 0 {
                let what = format!("pin {} is driven by a module of the card", line.number);
                return Err(Unfit::new(place, what, "give a pin that is free"));
            }
            if *output {
                self.directions[port] |= mask;
            } else if self.directions[port] & mask != 0 {
                let what = format!("pin {} is an output", line.number);
                return Err(Unfit::new(place, what, "give each line a pin of its own"));
            }
        }
        Ok(())
    }
}

fn serial(config: &Config, tables: &Tables) -> Result<Option<SerialWiring>, Unfit> {
    let analog = config.analog == Analog::Remote;
    if !analog && !config.has_field_lines() {
        return Ok(None);
    }
    let module = tables.require("analog", "smart serial", &[tag::SMART_SERIAL_TAG], 1)?;
    let field = config.has_field_lines().then_some(config.serial_channel);
    let analog = analog.then_some(config.serial_channel + 1);
    let wiring = SerialWiring { module: module.clone(), field, analog };
    // Functions 1 to 15 of receiving pins are channels 0 to 14.
    let last = field.max(analog).unwrap_or(0);
    let has_channel = tables.pins.iter().any(|pin| {
        pin.tag == tag::SMART_SERIAL_TAG && pin.unit == 0 && usize::from(pin.function) == last + 1
    });
    if !has_channel {
        let board = &tables.idrom.board_name;
        let what = format!("smart serial of this {board} has no channel {last}");
        return Err(Unfit::new("serial_channel", what, "load a configuration for the 7I77"));
    }
    Ok(Some(wiring))
}

fn pwm(config: &Config, tables: &Tables) -> Result<Option<(Module, Modulation)>, Unfit> {
    if config.analog != Analog::Pwm {
        return Ok(None);
    }
    let channels = config.analog_channels.min(CHANNELS);
    let module = tables.require("analog", "pulse-width modulator", &[tag::PWM_TAG], channels)?;
    let Some(modulation) = Modulation::at(config.pwm_hz, module.clock_hz) else {
        let what = format!("{} Hz cannot be made from {} Hz", config.pwm_hz, module.clock_hz);
        return Err(Unfit::new("pwm_hz", what, "give a lower frequency"));
    };
    Ok(Some((module.clone(), modulation)))
}
