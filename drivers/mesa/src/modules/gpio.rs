//! Lines as bits: of the field terminals of a 7I77, and of pins of the card's ports.

use taktil_hal::{LinesIn, LinesOut};

use crate::config::{Line, LinesInConfig, LinesOutConfig, REMOTES_MAX, Terminal};
use crate::hostmot2::Tables;

/// Register: levels.
pub(crate) const DATA_REGISTER: u32 = 0;
/// Register: a bit for each pin that is driven.
pub(crate) const DIRECTION_REGISTER: u32 = 1;
/// Register: a bit for each pin that its module drives.
pub(crate) const ALTERNATE_REGISTER: u32 = 2;
/// Register: a bit for each pin that only pulls down.
pub(crate) const OPEN_DRAIN_REGISTER: u32 = 3;
/// Register: a bit for each pin whose level is inverted.
pub(crate) const INVERT_REGISTER: u32 = 4;

/// Most ports of a card.
pub(crate) const PORTS_MAX: usize = 8;
/// The words of the 7I77s' field terminals stand behind those of the ports.
pub(crate) const FIELD_WORD: usize = PORTS_MAX;
/// The word of the spindle enables, a bit for each 7I77, stands behind those.
pub(crate) const SPINDLE_WORD: usize = FIELD_WORD + REMOTES_MAX;
/// Words of levels.
pub(crate) const LEVEL_WORDS: usize = SPINDLE_WORD + 1;
/// Words of levels: the ports, the field terminals, the spindle enables.
pub(crate) type Levels = [u32; LEVEL_WORDS];

/// A line as a bit of a word.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Bit {
    pub(crate) word: usize,
    pub(crate) mask: u32,
    inverted: bool,
}

impl Bit {
    pub(crate) fn new(line: &Line, tables: &Tables) -> Bit {
        let (word, mask) = match line.at {
            Terminal::Field => (FIELD_WORD + line.remote, 1 << (line.number & 31)),
            Terminal::Spindle => (SPINDLE_WORD, 1 << (line.remote & 31)),
            Terminal::Pin => tables.port_and_bit(line.number as usize),
        };
        Bit { word: word.min(SPINDLE_WORD), mask, inverted: line.inverted }
    }

    fn is_true(self, levels: &Levels) -> bool {
        (levels[self.word] & self.mask != 0) != self.inverted
    }

    fn put(self, levels: &mut Levels, value: bool) {
        if value != self.inverted {
            levels[self.word] |= self.mask;
        } else {
            levels[self.word] &= !self.mask;
        }
    }
}

/// The lines from the cell.
#[derive(Clone, Copy, Debug)]
pub(crate) struct InputLines {
    drive_power: Bit,
    estop_a: Bit,
    estop_b: Bit,
}

impl InputLines {
    pub(crate) fn new(config: &LinesInConfig, tables: &Tables) -> InputLines {
        InputLines {
            drive_power: Bit::new(&config.drive_power, tables),
            estop_a: Bit::new(&config.estop_a, tables),
            estop_b: Bit::new(&config.estop_b, tables),
        }
    }

    pub(crate) fn bits(self) -> [Bit; 3] {
        [self.drive_power, self.estop_a, self.estop_b]
    }

    pub(crate) fn lines(self, levels: &Levels) -> LinesIn {
        LinesIn {
            drive_power: self.drive_power.is_true(levels),
            estop_a_closed: self.estop_a.is_true(levels),
            estop_b_closed: self.estop_b.is_true(levels),
        }
    }
}

/// The lines to the cell.
#[derive(Clone, Copy, Debug)]
pub(crate) struct OutputLines {
    enable: Bit,
    brake_release: Bit,
    feed: Option<Bit>,
}

impl OutputLines {
    pub(crate) fn new(config: &LinesOutConfig, tables: &Tables) -> OutputLines {
        OutputLines {
            enable: Bit::new(&config.enable, tables),
            brake_release: Bit::new(&config.brake_release, tables),
            feed: config.watchdog_feed.as_ref().map(|line| Bit::new(line, tables)),
        }
    }

    pub(crate) fn bits(self) -> impl Iterator<Item = Bit> {
        [Some(self.enable), Some(self.brake_release), self.feed].into_iter().flatten()
    }

    pub(crate) fn levels(self, lines: &LinesOut) -> Levels {
        let mut levels = Levels::default();
        self.enable.put(&mut levels, lines.enable);
        self.brake_release.put(&mut levels, lines.brake_release);
        if let Some(feed) = self.feed {
            feed.put(&mut levels, lines.watchdog_feed);
        }
        levels
    }
}
