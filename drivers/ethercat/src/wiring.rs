//! Where everything is: the places of the configuration, found in the process data that the devices
//! have.

use taktil_drivers_cia402::Object;
use taktil_drivers_exchange::Refusal;
use taktil_hal::{CHANNELS, LinesIn, LinesOut};

use crate::config::{Config, Kind, Line, LineKind, Place};
use crate::drive::DrivePlaces;
use crate::field::{Field, ProcessData, find};

/// Volts at an analog output terminal for one code.
pub const TERMINAL_VOLTS_PER_CODE: f64 = 10.0 / 32_768.0;
/// Highest code of an analog terminal.
pub(crate) const TERMINAL_CODE_MAX: i32 = 32_767;
/// Lowest code of an analog terminal.
pub(crate) const TERMINAL_CODE_MIN: i32 = -32_768;
/// Channels of an analog terminal.
const ANALOG_CHANNELS: usize = 4;
/// Lines of a digital terminal.
const DIGITAL_LINES: usize = 8;

/// Where an analog channel goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum AnalogPlace {
    /// The target of a drive, by its number among the drives.
    Drive(usize),
    /// A terminal.
    Terminal(Field),
}

/// Where a line is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum LinePlace {
    /// All drives.
    Drives,
    /// A terminal, with whether it is low when it is true.
    Terminal(Field, bool),
}

impl LinePlace {
    /// A line of a terminal.
    pub(crate) fn read(self, bytes: &[u8]) -> bool {
        match self {
            LinePlace::Drives => false,
            LinePlace::Terminal(field, inverted) => (field.raw(bytes) == 1) != inverted,
        }
    }
}

/// The lines from the cell.
#[derive(Clone, Copy, Debug)]
pub(crate) struct InputPlaces {
    pub(crate) drive_power: LinePlace,
    pub(crate) estop_a: LinePlace,
    pub(crate) estop_b: LinePlace,
}

impl InputPlaces {
    /// The lines, by a function that reads each.
    pub(crate) fn lines(&self, read: impl Fn(LinePlace) -> bool) -> LinesIn {
        LinesIn {
            drive_power: read(self.drive_power),
            estop_a_closed: read(self.estop_a),
            estop_b_closed: read(self.estop_b),
        }
    }
}

/// The lines to the cell.
#[derive(Clone, Copy, Debug)]
pub(crate) struct OutputPlaces {
    pub(crate) enable: LinePlace,
    pub(crate) brake_release: Option<LinePlace>,
    pub(crate) watchdog_feed: Option<LinePlace>,
}

impl OutputPlaces {
    /// The terminals with the level of each.
    pub(crate) fn levels(&self, lines: &LinesOut) -> [Option<(Field, bool)>; 3] {
        let level = |place: Option<LinePlace>, value: bool| match place {
            Some(LinePlace::Terminal(field, inverted)) => Some((field, value != inverted)),
            _ => None,
        };
        [
            level(Some(self.enable), lines.enable),
            level(self.brake_release, lines.brake_release),
            level(self.watchdog_feed, lines.watchdog_feed),
        ]
    }
}

/// Everything with its place.
#[derive(Clone, Debug, Default)]
pub(crate) struct Wiring {
    pub(crate) analog_out: Vec<AnalogPlace>,
    pub(crate) encoders: Vec<Field>,
    pub(crate) analog_in: Vec<Field>,
    pub(crate) lines_in: Option<InputPlaces>,
    pub(crate) lines_out: Option<OutputPlaces>,
    /// The drives in their order.
    pub(crate) drives: Vec<DrivePlaces>,
    /// What the working counter has to be when every device serves an exchange.
    pub(crate) counter: u16,
}

impl Wiring {
    /// Finds everything that the configuration names.
    pub(crate) fn new(config: &Config, data: &[ProcessData]) -> Result<Wiring, Refusal> {
        let mut wiring = Wiring::default();
        let mut drive_devices = Vec::new();
        for (position, (device, data)) in config.devices.iter().zip(data).enumerate() {
            if device.kind == Kind::Drive {
                let places = DrivePlaces::new(position, device.mode, data);
                wiring.drives.push(places.map_err(|object| unmapped(position, object))?);
                drive_devices.push(position);
            }
        }
        let finder = Finder { config, data, drives: &drive_devices };
        let places = |given: &[Place], defaults: &[Kind]| {
            if given.is_empty() { finder.defaults(defaults) } else { given.to_vec() }
        };
        let has_drives = !drive_devices.is_empty();
        let analog = if has_drives { Kind::Drive } else { Kind::El4134 };
        for place in places(&config.analog_out, &[analog]).iter().take(CHANNELS) {
            wiring.analog_out.push(finder.analog_out(place)?);
        }
        let encoders: &[Kind] =
            if has_drives { &[Kind::Drive] } else { &[Kind::El5101, Kind::El5151] };
        for place in places(&config.encoders, encoders).iter().take(CHANNELS) {
            wiring.encoders.push(finder.encoder(place)?);
        }
        for place in places(&config.analog_in, &[Kind::El3104]).iter().take(CHANNELS) {
            wiring.analog_in.push(finder.analog_in(place)?);
        }
        if let Some(lines) = &config.lines_in {
            wiring.lines_in = Some(InputPlaces {
                drive_power: finder.line("lines_in", &lines.drive_power, false)?,
                estop_a: finder.line("lines_in", &lines.estop_a, false)?,
                estop_b: finder.line("lines_in", &lines.estop_b, false)?,
            });
        }
        if let Some(lines) = &config.lines_out {
            let terminal = |line: &Option<Line>| {
                line.as_ref().map(|line| finder.terminal_line("lines_out", line, true)).transpose()
            };
            wiring.lines_out = Some(OutputPlaces {
                enable: finder.line("lines_out", &lines.enable, true)?,
                brake_release: terminal(&lines.brake_release)?,
                watchdog_feed: terminal(&lines.watchdog_feed)?,
            });
        }
        wiring.check_kinds()?;
        Ok(wiring)
    }

    /// One half has one range of codes.
    fn check_kinds(&self) -> Result<(), Refusal> {
        let drives = self.analog_out.iter().filter(|one| matches!(one, AnalogPlace::Drive(_)));
        let drives = drives.count();
        if drives > 0 && drives < self.analog_out.len() {
            let what = "drives and analog outputs have codes of different worth";
            return Err(Refusal::new("analog_out", what, "list channels of one kind"));
        }
        Ok(())
    }
}

fn unmapped(position: usize, object: Object) -> Refusal {
    let what = format!(
        "the drive at position {position} has no object {:#06x} in its process data",
        object.index
    );
    let remedy = "leave `map` out, so that its process data are set up, or map the object there";
    Refusal::new("devices", what, remedy)
}

struct Finder<'a> {
    config: &'a Config,
    data: &'a [ProcessData],
    drives: &'a [usize],
}

impl Finder<'_> {
    /// All channels of all devices of some kinds.
    fn defaults(&self, kinds: &[Kind]) -> Vec<Place> {
        let devices = self.config.devices.iter().enumerate();
        let fitting = devices.filter(|(_, device)| kinds.contains(&device.kind));
        let places = fitting.flat_map(|(position, device)| {
            let channels = match device.kind {
                Kind::El4134 | Kind::El3104 => ANALOG_CHANNELS,
                _ => 1,
            };
            (0..channels).map(move |channel| Place { device: position, channel })
        });
        places.collect()
    }

    /// The kind of the device at a place that a list names.
    fn kind(&self, list: &'static str, place: &Place) -> Result<Kind, Refusal> {
        let device = self.config.devices.get(place.device).map(|device| device.kind);
        device.ok_or_else(|| wrong(list, place, "there is no such device"))
    }

    fn analog_out(&self, place: &Place) -> Result<AnalogPlace, Refusal> {
        match self.kind("analog_out", place)? {
            Kind::Drive => {
                let number = self.drives.iter().position(|one| *one == place.device);
                let number = number.filter(|_| place.channel == 0);
                let number = number.ok_or_else(|| {
                    wrong("analog_out", place, "a drive has one channel, number 0")
                })?;
                Ok(AnalogPlace::Drive(number))
            }
            Kind::El4134 => {
                let index = 0x7000 + 0x10 * place.channel as u16;
                let outputs = &self.data[place.device].outputs;
                let field = find(place.device, outputs, &[(index, 0x11), (index, 1)]);
                let field = field.ok_or_else(|| {
                    wrong("analog_out", place, "the terminal has no such channel")
                })?;
                Ok(AnalogPlace::Terminal(field))
            }
            _ => Err(wrong("analog_out", place, "the device there puts no torque or volts out")),
        }
    }

    fn encoder(&self, place: &Place) -> Result<Field, Refusal> {
        let inputs = &self.data[place.device].inputs;
        let alternatives: &[(u16, u8)] = match self.kind("encoders", place)? {
            Kind::Drive => &[(0x6064, 0)],
            Kind::El5101 => &[(0x6010, 0x11), (0x6000, 2)],
            Kind::El5151 => &[(0x6000, 0x11)],
            _ => return Err(wrong("encoders", place, "the device there has no encoder")),
        };
        let field = find(place.device, inputs, alternatives).filter(|_| place.channel == 0);
        field.ok_or_else(|| wrong("encoders", place, "the device maps no counter there"))
    }

    fn analog_in(&self, place: &Place) -> Result<Field, Refusal> {
        if self.kind("analog_in", place)? != Kind::El3104 {
            return Err(wrong("analog_in", place, "the device there has no analog inputs"));
        }
        let index = 0x6000 + 0x10 * place.channel as u16;
        let field = find(place.device, &self.data[place.device].inputs, &[(index, 0x11)]);
        field.ok_or_else(|| wrong("analog_in", place, "the terminal has no such channel"))
    }

    fn line(&self, list: &'static str, line: &Line, is_output: bool) -> Result<LinePlace, Refusal> {
        if line.at == LineKind::Terminal {
            return self.terminal_line(list, line, is_output);
        }
        if self.drives.is_empty() {
            let what = "a line is at the drives, and there are none";
            return Err(Refusal::new(list, what, "list the drives in `devices`"));
        }
        Ok(LinePlace::Drives)
    }

    fn terminal_line(
        &self,
        list: &'static str,
        line: &Line,
        is_output: bool,
    ) -> Result<LinePlace, Refusal> {
        let place = Place { device: line.device, channel: line.channel };
        let kind = self.kind(list, &place)?;
        let fits = kind == if is_output { Kind::El2008 } else { Kind::El1008 };
        if line.at != LineKind::Terminal || !fits || place.channel >= DIGITAL_LINES {
            let direction = if is_output { "outputs" } else { "inputs" };
            let what = format!("the device there is no terminal with digital {direction}");
            return Err(wrong(list, &place, &what));
        }
        let field = Field { device: place.device, bit: place.channel, bits: 1 };
        Ok(LinePlace::Terminal(field, line.inverted))
    }
}

fn wrong(list: &'static str, place: &Place, what: &str) -> Refusal {
    let what = format!("device {}, channel {}: {what}", place.device, place.channel);
    Refusal::new(
        list,
        what,
        "name a device of `devices`, counted from 0, and a channel that it has",
    )
}
