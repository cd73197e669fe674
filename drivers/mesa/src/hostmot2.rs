//! Reads the tables in which a HostMot2 card describes itself: cookie, config name, IDROM, modules
//! and pins. Every address comes from the module table; no register map is assumed. Source:
//! `hostmotid.vhd`, `idrom.vhd` and `IDROMConst.vhd` of hostmot2-firmware.

use taktil_drivers_exchange::Refusal;

/// Where cookie, config name and place of the IDROM stand.
pub(crate) const IDENTITY_ADDRESS: u16 = 0x0100;
/// Words of the identity.
pub(crate) const IDENTITY_WORDS: usize = 4;
/// Words of the IDROM's head.
pub(crate) const IDROM_WORDS: usize = 16;
/// Most entries of the module table.
pub(crate) const MODULES_MAX: usize = 32;
/// Words of an entry.
pub(crate) const MODULE_WORDS: usize = 3;
/// Most pins of a card.
pub(crate) const PINS_MAX: usize = 144;

/// What the cookie reads.
const COOKIE_WORD: u32 = 0x55aa_cafe;
/// The config name.
const CONFIG_NAME: &[u8; 8] = b"HOSTMOT2";
/// Types of IDROM that are known.
const IDROM_TYPES: [u32; 2] = [2, 3];

/// Kinds of modules that the driver uses.
pub(crate) mod tag {
    pub(crate) const WATCHDOG_TAG: u8 = 2;
    pub(crate) const IO_PORT_TAG: u8 = 3;
    pub(crate) const ENCODER_TAG: u8 = 4;
    pub(crate) const PWM_TAG: u8 = 6;
    pub(crate) const MUXED_ENCODER_TAG: u8 = 12;
    pub(crate) const MUXED_ENCODER_SELECT_TAG: u8 = 13;
    pub(crate) const SMART_SERIAL_TAG: u8 = 193;
}

/// What a kind of module is called, for people.
pub(crate) fn module_name(kind: u8) -> String {
    let name = match kind {
        1 => "interrupts",
        tag::WATCHDOG_TAG => "watchdog",
        tag::IO_PORT_TAG => "lines",
        tag::ENCODER_TAG => "encoders",
        5 => "step generators",
        tag::PWM_TAG => "pulse-width modulators",
        tag::MUXED_ENCODER_TAG => "muxed encoders",
        tag::MUXED_ENCODER_SELECT_TAG => "select of muxed encoders",
        128 => "light",
        tag::SMART_SERIAL_TAG => "smart-serial ports",
        other => return format!("module {other}"),
    };
    name.to_owned()
}

/// The head of the IDROM.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct IdRom {
    /// The board's name, eight letters.
    pub board_name: String,
    /// Where the module table stands.
    pub modules_address: u16,
    /// Where the pin table stands.
    pub pins_address: u16,
    /// How many pins there are.
    pub pins: usize,
    /// Pins of a port.
    pub port_width: usize,
    /// Low clock (Hz).
    pub clock_low_hz: u32,
    /// High clock (Hz).
    pub clock_high_hz: u32,
    /// Strides of instances 0 and 1 in bytes.
    pub instance_strides: [u32; 2],
    /// Strides of registers 0 and 1 in bytes.
    pub register_strides: [u32; 2],
}

/// An entry of the module table.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Module {
    /// Kind of module.
    pub tag: u8,
    /// Its version.
    pub version: u8,
    /// Its clock (Hz).
    pub clock_hz: u32,
    /// How many there are.
    pub instances: usize,
    base: u32,
    register_stride: u32,
    instance_stride: u32,
}

/// An entry of the pin table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pin {
    /// Kind of module that may use the pin; 0 for none.
    pub tag: u8,
    /// Which instance.
    pub unit: usize,
    /// What the pin is to it; bit 7 for outputs.
    pub function: u8,
}

impl Pin {
    /// Takes a word of the pin table apart.
    #[must_use]
    pub const fn parse(word: u32) -> Pin {
        let [function, tag, unit, _] = word.to_le_bytes();
        Pin { tag, unit: unit as usize, function }
    }

    /// Whether the module drives the pin.
    #[must_use]
    pub const fn is_output(self) -> bool {
        self.tag != 0 && self.function & 0x80 != 0
    }
}

/// The letters of some words.
fn letters(words: &[u32]) -> [u8; 8] {
    let mut all = [0; 8];
    for (bytes, word) in all.chunks_exact_mut(4).zip(words) {
        bytes.copy_from_slice(&word.to_le_bytes());
    }
    all
}

/// Letters for a message.
pub(crate) fn text(letters: &[u8]) -> String {
    letters.iter().filter(|c| c.is_ascii_graphic()).map(|c| char::from(*c)).collect()
}

/// Checks cookie and config name and gives the place of the IDROM.
pub(crate) fn idrom_address(words: &[u32; IDENTITY_WORDS]) -> Result<u16, Refusal> {
    let [cookie, name_low, name_high, address] = *words;
    if cookie != COOKIE_WORD {
        let what = format!("the cookie reads {cookie:#010x}, not {COOKIE_WORD:#010x}");
        return Err(Refusal::new("address", what, "what answers is no HostMot2 card: check it"));
    }
    let name = letters(&[name_low, name_high]);
    if &name != CONFIG_NAME {
        let what = format!("the configuration is named {:?}, not \"HOSTMOT2\"", text(&name));
        return Err(Refusal::new("address", what, "load a HostMot2 configuration into the card"));
    }
    u16::try_from(address).map_err(|_| {
        let what = format!("the IDROM is said to stand at {address:#x}, outside the registers");
        Refusal::new("address", what, "load a HostMot2 configuration into the card")
    })
}

impl IdRom {
    /// Reads the head of the IDROM that stands at `address`.
    pub(crate) fn parse(words: &[u32; IDROM_WORDS], address: u16) -> Result<IdRom, Refusal> {
        let kind = words[0];
        if !IDROM_TYPES.contains(&kind) {
            let what = format!("the IDROM is of type {kind}; types 2 and 3 are known");
            return Err(Refusal::new("address", what, "load a configuration with such an IDROM"));
        }
        let place = |offset: u32| {
            u16::try_from(u64::from(address) + u64::from(offset)).map_err(|_| {
                let what = format!("a table is said to stand {offset:#x} behind the IDROM");
                Refusal::new("address", what, "load a HostMot2 configuration into the card")
            })
        };
        let (pins, width) = (words[8] as usize, words[9] as usize);
        if pins > PINS_MAX || !(1..=32).contains(&width) {
            let what = format!("the IDROM tells of {pins} pins in ports of {width}");
            return Err(Refusal::new("address", what, "at most 144 pins in ports of 32 are known"));
        }
        if words[10] == 0 || words[11] == 0 {
            let what = "the IDROM tells of a clock of 0 Hz";
            return Err(Refusal::new(
                "address",
                what,
                "load a HostMot2 configuration into the card",
            ));
        }
        Ok(IdRom {
            board_name: text(&letters(&words[3..5])),
            modules_address: place(words[1])?,
            pins_address: place(words[2])?,
            pins,
            port_width: width,
            clock_low_hz: words[10],
            clock_high_hz: words[11],
            instance_strides: [words[12], words[13]],
            register_strides: [words[14], words[15]],
        })
    }

    /// Refuses a card none of whose names holds the configured one: that of the IDROM has room for
    /// four letters behind the maker's, the other one is that of the card's own firmware.
    pub(crate) fn require_board(&self, board: &str, other_name: &str) -> Result<(), Refusal> {
        if self.board_name.contains(board) || other_name.contains(board) {
            return Ok(());
        }
        let is = if other_name.is_empty() { &self.board_name } else { other_name };
        let what = format!("the card is a {is}, not a {board}");
        Err(Refusal::new("board", what, "correct `board` or `address`"))
    }
}

impl Module {
    /// Reads an entry of the module table; `None` for its end.
    #[must_use]
    pub fn parse(words: [u32; MODULE_WORDS], idrom: &IdRom) -> Option<Module> {
        let [tag, version, clock, instances] = words[0].to_le_bytes();
        let strides = words[1] >> 24;
        // The low nibble selects the stride of registers, the high one that of instances.
        let (registers, units) = (strides & 0x0f, strides >> 4);
        (tag != 0).then(|| Module {
            tag,
            version,
            clock_hz: if clock == 2 { idrom.clock_high_hz } else { idrom.clock_low_hz },
            instances: usize::from(instances),
            base: words[1] & 0xffff,
            register_stride: idrom.register_strides[usize::from(registers != 0)],
            instance_stride: idrom.instance_strides[usize::from(units != 0)],
        })
    }

    /// The address of a register of an instance; a bad table gives an address that wraps.
    #[must_use]
    pub const fn address(&self, register: u32, instance: usize) -> u16 {
        let registers = register.wrapping_mul(self.register_stride);
        let instances = (instance as u32).wrapping_mul(self.instance_stride);
        self.base.wrapping_add(registers).wrapping_add(instances) as u16
    }
}

/// All tables of a card.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Tables {
    /// The head of the IDROM.
    pub idrom: IdRom,
    /// The module table.
    pub modules: Vec<Module>,
    /// The pin table.
    pub pins: Vec<Pin>,
}

impl Tables {
    /// The first module of one of these kinds that has at least `instances`.
    pub(crate) fn require(
        &self,
        place: &'static str,
        name: &str,
        tags: &[u8],
        instances: usize,
    ) -> Result<&Module, Refusal> {
        let board = &self.idrom.board_name;
        let of_kind = || self.modules.iter().filter(|module| tags.contains(&module.tag));
        if let Some(module) = of_kind().find(|module| module.instances >= instances) {
            return Ok(module);
        }
        let Some(has) = of_kind().map(|module| module.instances).max() else {
            let what = format!("the configuration of this {board} has no {name}");
            return Err(Refusal::new(place, what, "load a configuration with it, or leave it out"));
        };
        let what = format!(
            "the configuration of this {board} has {has} x {name} and {instances} are configured"
        );
        Err(Refusal::new(place, what, "load one with more, or configure fewer"))
    }

    /// Port and bit of a pin.
    pub(crate) fn port_and_bit(&self, pin: usize) -> (usize, u32) {
        (pin / self.idrom.port_width, 1 << (pin % self.idrom.port_width))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn idrom() -> IdRom {
        let words = [
            3,
            0x40,
            0x200,
            0x4153_454d,
            0x3239_4937,
            9,
            144,
            2,
            34,
            17,
            100,
            200,
            4,
            0x40,
            0x100,
            8,
        ];
        IdRom::parse(&words, 0x400).unwrap()
    }

    #[test]
    fn nibbles_select_the_strides() {
        let idrom = idrom();
        let at = |strides: u32, register, instance| {
            let words = [0x0101_00c1, (strides << 24) | (6 << 16) | 0x5a00, 0];
            Module::parse(words, &idrom).unwrap().address(register, instance)
        };
        assert_eq!(at(0x00, 2, 3), 0x5a00 + 0x200 + 12);
        assert_eq!(at(0x10, 2, 3), 0x5a00 + 0x200 + 0xc0);
        assert_eq!(at(0x01, 2, 3), 0x5a00 + 16 + 12);
        assert_eq!(at(0x11, 2, 3), 0x5a00 + 16 + 0xc0);
    }

    #[test]
    fn the_table_ends_with_tag_0_and_clocks_are_chosen_by_their_tag() {
        assert_eq!(Module::parse([0; 3], &idrom()), None);
        let clock = |tag: u32| Module::parse([6 | (tag << 16), 0, 0], &idrom()).unwrap().clock_hz;
        assert_eq!([clock(1), clock(2)], [100, 200]);
    }

    #[test]
    fn board_names_and_tables_are_read() {
        let idrom = idrom();
        assert_eq!(idrom.board_name, "MESA7I92");
        assert_eq!([idrom.modules_address, idrom.pins_address], [0x440, 0x600]);
        assert!(idrom.require_board("7I92", "").is_ok() && idrom.require_board("", "").is_ok());
        assert!(idrom.require_board("7I92T", "7I92T").is_ok());
        let refusal = idrom.require_board("7I80", "").unwrap_err();
        assert!(refusal.what.contains("MESA7I92") && refusal.place == "board");
    }

    #[test]
    fn absurd_tables_are_refused_and_do_not_panic() {
        let good = [3, 0x40, 0x200, 0, 0, 9, 144, 2, 34, 17, 100, 200, 4, 0x40, 0x100, 8];
        for (at, word) in [(0, 4), (0, 1), (1, u32::MAX), (8, 145), (9, 0), (9, 33), (10, 0)] {
            let mut words = good;
            words[at] = word;
            assert!(IdRom::parse(&words, 0x400).is_err(), "{at}: {word}");
        }
        assert!(idrom_address(&[0, 0, 0, 0]).unwrap_err().what.contains("cookie"));
        let other = [COOKIE_WORD, 0x5453_4f48, 0x3354_4f4d, 0x400];
        assert!(idrom_address(&other).unwrap_err().what.contains("HOSTMOT3"));
        let module = [u32::MAX; 3];
        let module = Module::parse(module, &idrom()).unwrap();
        let _ = module.address(u32::MAX, usize::MAX);
    }
}
