//! Joins a configuration with a card's tables: which modules serve which half, which pins they
//! drive, and where that cannot be.

mod serial;

use taktil_hal::CHANNELS;

use crate::config::{Analog, Config, EncoderKind, Terminal};
use crate::hostmot2::{Module, Pin, Tables, tag};
use crate::modules::gpio::{InputLines, OutputLines, PORTS_MAX};
use crate::modules::pwm::Modulation;
use taktil_drivers_exchange::Refusal;

pub(crate) use serial::{Remote, SerialWiring, at_port, of_port};

/// Pulse-width modulators as they are used.
#[derive(Clone, Debug)]
pub(crate) struct PwmWiring {
    pub(crate) module: Module,
    pub(crate) modulation: Modulation,
    /// The modulator of each channel.
    pub(crate) units: Vec<usize>,
}

/// What of a card is used.
#[derive(Clone, Debug)]
pub(crate) struct Wiring {
    pub(crate) board_name: String,
    pub(crate) watchdog: Module,
    pub(crate) ports: Module,
    pub(crate) encoders: Option<Module>,
    pub(crate) serial: Option<SerialWiring>,
    pub(crate) pwm: Option<PwmWiring>,
    pub(crate) inputs: Option<InputLines>,
    pub(crate) outputs: Option<OutputLines>,
    /// Directions of the pins, a word for each port.
    pub(crate) directions: [u32; PORTS_MAX],
    /// Pins that their modules drive, a word for each port.
    pub(crate) alternates: [u32; PORTS_MAX],
    /// Pins that only pull down, a word for each port.
    pub(crate) open_drains: [u32; PORTS_MAX],
}

impl Wiring {
    /// Finds everything that the configuration asks for.
    pub(crate) fn new(config: &Config, tables: &Tables) -> Result<Wiring, Refusal> {
        let watchdog = tables.require("watchdog_ms", "watchdog", &[tag::WATCHDOG_TAG], 1)?;
        let ports = tables.require("address", "port of pins", &[tag::IO_PORT_TAG], 1)?;
        if ports.instances > PORTS_MAX {
            let what = format!("the card has {} ports of pins", ports.instances);
            return Err(Refusal::new("address", what, "at most 8 are known"));
        }
        let (kind, kinds): (_, &[u8]) = match config.encoder_kind {
            EncoderKind::Any => ("encoder", &[tag::ENCODER_TAG, tag::MUXED_ENCODER_TAG]),
            EncoderKind::Plain => ("plain encoder", &[tag::ENCODER_TAG]),
            EncoderKind::Muxed => ("muxed encoder", &[tag::MUXED_ENCODER_TAG]),
        };
        let encoders = match config.encoders {
            0 => None,
            wired => Some(tables.require("encoders", kind, kinds, wired)?.clone()),
        };
        let mut wiring = Wiring {
            board_name: tables.idrom.board_name.clone(),
            watchdog: watchdog.clone(),
            ports: ports.clone(),
            encoders,
            serial: SerialWiring::new(config, tables)?,
            pwm: pwm(config, tables)?,
            inputs: config.lines_in.as_ref().map(|lines| InputLines::new(lines, tables)),
            outputs: config.lines_out.as_ref().map(|lines| OutputLines::new(lines, tables)),
            directions: [0; PORTS_MAX],
            alternates: [0; PORTS_MAX],
            open_drains: [0; PORTS_MAX],
        };
        wiring.drive_pins(tables)?;
        wiring.check_lines(config, tables)?;
        Ok(wiring)
    }

    /// Whether a module that is used drives or reads the pin.
    fn is_used(&self, pin: Pin) -> bool {
        let counts = |tag| self.encoders.as_ref().is_some_and(|module| module.tag == tag);
        match pin.tag {
            tag::ENCODER_TAG => counts(tag::ENCODER_TAG),
            tag::MUXED_ENCODER_SELECT_TAG | tag::MUXED_ENCODER_TAG => {
                counts(tag::MUXED_ENCODER_TAG)
            }
            tag::SMART_SERIAL_TAG => {
                self.serial.as_ref().is_some_and(|serial| serial.is_channel_of(pin))
            }
            tag::PWM_TAG => self.pwm.as_ref().is_some_and(|pwm| pwm.units.contains(&pin.unit)),
            _ => false,
        }
    }

    /// Directions of the pins that the used modules drive. Pins of a module that nobody uses stay
    /// inputs: another module or a line may be wired there.
    fn drive_pins(&mut self, tables: &Tables) -> Result<(), Refusal> {
        let pins = tables.pins.iter().copied().enumerate();
        for (index, pin) in pins.filter(|(_, pin)| pin.is_output()) {
            if !self.is_used(pin) {
                continue;
            }
            let (port, mask) = tables.port_and_bit(index);
            if port >= self.ports.instances {
                let what = format!("pin {index} lies outside the card's ports");
                return Err(Refusal::new("address", what, "load a configuration that is whole"));
            }
            self.directions[port] |= mask;
            self.alternates[port] |= mask;
        }
        Ok(())
    }

    /// Refuses lines that stand where something else is. Outputs first: an input may share its
    /// terminal with another input.
    fn check_lines(&mut self, config: &Config, tables: &Tables) -> Result<(), Refusal> {
        let modules = self.directions;
        let mut lines = config.lines();
        lines.sort_by_key(|(_, _, output)| !output);
        for (index, (place, line, output)) in lines.iter().enumerate() {
            let at = |line: &crate::config::Line| {
                (line.at, line.number, if line.at == Terminal::Pin { 0 } else { line.remote })
            };
            let mut others = lines[..index].iter().filter(|(_, _, output)| *output);
            if *output && others.any(|(_, other, _)| at(other) == at(line)) {
                let what = format!("the output {:?} {} is used twice", line.at, line.number);
                return Err(Refusal::new(place, what, "give each output a place of its own"));
            }
            if line.at != Terminal::Pin {
                continue;
            }
            let (port, mask) = tables.port_and_bit(line.number as usize);
            let pin = tables.pins.get(line.number as usize).copied();
            let Some(pin) = pin.filter(|_| port < self.ports.instances) else {
                let what = format!("this {} has no pin {}", self.board_name, line.number);
                return Err(Refusal::new(place, what, "give a pin of its pin table"));
            };
            if modules[port] & mask != 0 {
                let what = format!("pin {} is driven by a module of the card", line.number);
                return Err(Refusal::new(place, what, "give a pin that is free"));
            }
            if *output && self.is_used(pin) {
                // Whatever is wired to the module's input drives the pin from the other side.
                let what = format!("pin {} is an input of a module of the card", line.number);
                return Err(Refusal::new(place, what, "give a pin that is free"));
            }
            if *output {
                self.directions[port] |= mask;
                self.open_drains[port] |= if line.open_drain { mask } else { 0 };
            } else if self.directions[port] & mask != 0 {
                let what = format!("pin {} is an output", line.number);
                return Err(Refusal::new(place, what, "give each line a pin of its own"));
            }
        }
        Ok(())
    }
}

fn pwm(config: &Config, tables: &Tables) -> Result<Option<PwmWiring>, Refusal> {
    if config.analog != Analog::Pwm {
        return Ok(None);
    }
    let places = config.output_places();
    let units: Vec<usize> = places.iter().take(CHANNELS).map(|place| place.output).collect();
    let needed = units.iter().max().map_or(0, |last| last + 1);
    let module = tables.require("analog", "pulse-width modulator", &[tag::PWM_TAG], needed)?;
    let Some(modulation) = Modulation::at(config.pwm_hz, module.clock_hz) else {
        let what = format!("{} Hz cannot be made from {} Hz", config.pwm_hz, module.clock_hz);
        return Err(Refusal::new("pwm_hz", what, "give a lower frequency"));
    };
    Ok(Some(PwmWiring { module: module.clone(), modulation, units }))
}
