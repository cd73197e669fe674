//! What a card says of itself: identity, IDROM, module table and pin table. All fields are open, so
//! that a test can make a card that differs in one of them.

/// One entry of the module table.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ModuleEntry {
    /// Kind of module (general tag).
    pub tag: u8,
    /// Its version.
    pub version: u8,
    /// 1 for the low clock, 2 for the high one.
    pub clock: u8,
    /// How many there are.
    pub instances: u8,
    /// Address of its first register.
    pub base: u16,
    /// How many kinds of registers it has.
    pub registers: u8,
    /// Selectors of strides: low nibble for registers, high nibble for instances.
    pub strides: u8,
    /// A bit for each register that exists once an instance.
    pub multiple: u32,
}

/// One entry of the pin table.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PinEntry {
    /// The pin's function in its module; bit 7 for outputs.
    pub function: u8,
    /// Kind of module.
    pub tag: u8,
    /// Instance of the module.
    pub unit: u8,
    /// Kind of its first function, 3 for general input and output.
    pub primary: u8,
}

/// The tables of a card.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Firmware {
    /// The word at 0x0100.
    pub cookie: u32,
    /// Eight letters at 0x0104.
    pub config_name: [u8; 8],
    /// Where the IDROM stands.
    pub idrom: u16,
    /// Its type.
    pub idrom_type: u32,
    /// Eight letters: the board.
    pub board_name: [u8; 8],
    /// Pins of a port.
    pub port_width: u32,
    /// Low and high clock (Hz).
    pub clock_low_hz: u32,
    /// High clock (Hz).
    pub clock_high_hz: u32,
    /// Instance strides 0 and 1, register strides 0 and 1, in bytes.
    pub strides: [u32; 4],
    /// The module table.
    pub modules: Vec<ModuleEntry>,
    /// The pin table.
    pub pins: Vec<PinEntry>,
    /// Letters and unit numbers of the remotes on the smart-serial channels, eight for each port;
    /// zeros for none.
    pub remotes: Vec<([u8; 4], u32)>,
}

/// Tags of the modules that are emulated.
pub(crate) mod tag {
    pub(crate) const WATCHDOG_TAG: u8 = 2;
    pub(crate) const IO_PORT_TAG: u8 = 3;
    pub(crate) const ENCODER_TAG: u8 = 4;
    pub(crate) const PWM_TAG: u8 = 6;
    pub(crate) const MUXED_ENCODER_TAG: u8 = 12;
    pub(crate) const MUXED_SELECT_TAG: u8 = 13;
    pub(crate) const LED_TAG: u8 = 128;
    pub(crate) const SMART_SERIAL_TAG: u8 = 193;
}

fn module(tag: u8, instances: u8, base: u16, registers: u8, multiple: u32) -> ModuleEntry {
    ModuleEntry { tag, version: 2, clock: 1, instances, base, registers, strides: 0, multiple }
}

fn pin(tag: u8, unit: u8, function: u8) -> PinEntry {
    PinEntry { function, tag, unit, primary: tag::IO_PORT_TAG }
}

impl Firmware {
    /// A 7I92 with a 7I77 on its first connector: six muxed encoders, smart serial with field
    /// inputs and outputs on channel 0 and analog outputs on channel 1.
    #[must_use]
    pub fn with_7i77() -> Firmware {
        let mut serial = module(tag::SMART_SERIAL_TAG, 1, 0x5a00, 6, 0x3c);
        serial.strides = 0x10;
        let modules = vec![
            module(tag::WATCHDOG_TAG, 1, 0x0c00, 3, 0),
            module(tag::IO_PORT_TAG, 2, 0x1000, 5, 0x1f),
            module(tag::MUXED_ENCODER_TAG, 6, 0x3500, 5, 0x03),
            module(tag::MUXED_SELECT_TAG, 1, 0, 0, 0),
            serial,
            module(tag::LED_TAG, 1, 0x0200, 1, 0),
        ];
        let mut pins = vec![
            pin(tag::SMART_SERIAL_TAG, 0, 0x93),
            pin(tag::SMART_SERIAL_TAG, 0, 0x83),
            pin(tag::SMART_SERIAL_TAG, 0, 0x03),
            pin(tag::SMART_SERIAL_TAG, 0, 0x82),
            pin(tag::SMART_SERIAL_TAG, 0, 0x02),
            pin(tag::SMART_SERIAL_TAG, 0, 0x81),
            pin(tag::SMART_SERIAL_TAG, 0, 0x01),
            pin(tag::MUXED_SELECT_TAG, 0, 0x81),
        ];
        for unit in 0..3 {
            pins.extend((1..=3).map(|function| pin(tag::MUXED_ENCODER_TAG, unit, function)));
        }
        // The second connector: general input and output.
        pins.resize(34, PinEntry { primary: tag::IO_PORT_TAG, ..PinEntry::default() });
        Firmware {
            cookie: 0x55aa_cafe,
            config_name: *b"HOSTMOT2",
            idrom: 0x0400,
            idrom_type: 3,
            board_name: *b"MESA7I92",
            port_width: 17,
            clock_low_hz: 100_000_000,
            clock_high_hz: 200_000_000,
            strides: [4, 0x40, 0x100, 4],
            modules,
            pins,
            remotes: vec![(*b"7I77", 0x1200_0123), (*b"7I77", 0x1100_0123), ([0; 4], 0)],
        }
    }

    /// A 7I80 with three 7I77s: twelve muxed encoders, two 7I77s on the channels 0, 1 and 3, 4 of
    /// the first smart-serial port, one on the channels 0 and 1 of the second port.
    #[must_use]
    pub fn with_three_7i77() -> Firmware {
        let mut firmware = Firmware::with_7i77();
        for entry in &mut firmware.modules {
            match entry.tag {
                tag::IO_PORT_TAG => entry.instances = 3,
                tag::MUXED_ENCODER_TAG => entry.instances = 12,
                tag::SMART_SERIAL_TAG => entry.instances = 2,
                _ => {}
            }
        }
        let mut pins = Vec::new();
        for (unit, channels) in [(0, 1..=6), (1, 1..=3)] {
            for channel in channels {
                pins.push(pin(tag::SMART_SERIAL_TAG, unit, 0x80 | channel));
                pins.push(pin(tag::SMART_SERIAL_TAG, unit, channel));
            }
        }
        for select in 0..2 {
            pins.push(pin(tag::MUXED_SELECT_TAG, select, 0x81));
        }
        for unit in 0..6 {
            pins.extend((1..=3).map(|function| pin(tag::MUXED_ENCODER_TAG, unit, function)));
        }
        pins.resize(72, PinEntry { primary: tag::IO_PORT_TAG, ..PinEntry::default() });
        let (field, analog, none) = ((*b"7I77", 0x1200_0200), (*b"7I77", 0x1100_0200), ([0; 4], 0));
        Firmware {
            board_name: *b"MESA7I80",
            port_width: 24,
            pins,
            remotes: vec![
                field, analog, none, field, analog, none, none, none, field, analog, none,
            ],
            ..firmware
        }
    }

    /// A 7I80 with six plain encoders and six pulse-width modulators, as SVxx configurations have
    /// them.
    #[must_use]
    pub fn with_pwm() -> Firmware {
        let mut pwm = module(tag::PWM_TAG, 6, 0x4000, 5, 0x03);
        pwm.clock = 2;
        let modules = vec![
            module(tag::WATCHDOG_TAG, 1, 0x0c00, 3, 0),
            module(tag::IO_PORT_TAG, 3, 0x1000, 5, 0x1f),
            module(tag::ENCODER_TAG, 6, 0x3000, 5, 0x03),
            pwm,
            module(tag::LED_TAG, 1, 0x0200, 1, 0),
        ];
        let mut pins = Vec::new();
        for unit in 0..6 {
            pins.extend((1..=3).map(|function| pin(tag::ENCODER_TAG, unit, function)));
            pins.extend((0x81..=0x83).map(|function| pin(tag::PWM_TAG, unit, function)));
        }
        pins.resize(72, PinEntry { primary: tag::IO_PORT_TAG, ..PinEntry::default() });
        Firmware {
            idrom_type: 2,
            board_name: *b"MESA7I80",
            port_width: 24,
            modules,
            pins,
            remotes: Vec::new(),
            ..Firmware::with_7i77()
        }
    }

    /// The words that never change, with their addresses.
    pub(crate) fn constants(&self) -> Vec<(u16, u32)> {
        let letters = |name: &[u8]| {
            [0, 4]
                .map(|at| u32::from_le_bytes([name[at], name[at + 1], name[at + 2], name[at + 3]]))
        };
        let [config_low, config_high] = letters(&self.config_name);
        let [board_low, board_high] = letters(&self.board_name);
        let (modules, pins) = (0x40, 0x200);
        let ports = self.modules.iter().find(|entry| entry.tag == tag::IO_PORT_TAG);
        let ports = ports.map_or(0, |entry| u32::from(entry.instances));
        let [instance_0, instance_1, register_0, register_1] = self.strides;
        let head = [
            self.idrom_type,
            modules,
            pins,
            board_low,
            board_high,
            9,
            144,
            ports,
            self.pins.len() as u32,
            self.port_width,
            self.clock_low_hz,
            self.clock_high_hz,
            instance_0,
            instance_1,
            register_0,
            register_1,
        ];
        let identity = [self.cookie, config_low, config_high, u32::from(self.idrom)];
        let mut all: Vec<(u16, u32)> = (0x0100u16..).step_by(4).zip(identity).collect();
        all.extend((self.idrom..).step_by(4).zip(head));
        let entries = self.modules.iter().flat_map(|entry| {
            let bytes = [entry.tag, entry.version, entry.clock, entry.instances];
            let place = u32::from(entry.base)
                | (u32::from(entry.registers) << 16)
                | (u32::from(entry.strides) << 24);
            [u32::from_le_bytes(bytes), place, entry.multiple]
        });
        all.extend((self.idrom + modules as u16..).step_by(4).zip(entries));
        let pin_words = self
            .pins
            .iter()
            .map(|pin| u32::from_le_bytes([pin.function, pin.tag, pin.unit, pin.primary]));
        all.extend((self.idrom + pins as u16..).step_by(4).zip(pin_words));
        all
    }
}
