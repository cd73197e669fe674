//! The packets of a card's cycle: one that reads everything and one that writes everything, encoded
//! once and changed in place, and the few that recovery needs.

mod build;

use taktil_hal::CHANNELS;

use crate::config::{REMOTES_MAX, SERIAL_PORTS_MAX};
use crate::lbp16::{Packet, Place, Space};
use crate::modules::encoder::ChannelWords;
use crate::modules::gpio::{FIELD_WORD, LEVEL_WORDS, Levels, PORTS_MAX, SPINDLE_WORD};
use crate::modules::sserial::{self, USER_REGISTERS};
use crate::modules::{pwm, watchdog};
use crate::wiring::{Remote, at_port, of_port};

/// Scratch words of the card: the number of the request that an answer belongs to, the number of
/// the newest write packet, and a mark that a card which restarted has lost.
const REQUEST_NUMBER_ADDRESS: u16 = 0x10;
/// Scratch words of the newest write packet's number.
const WRITE_NUMBER_ADDRESS: u16 = 0x14;
/// Scratch words of the mark.
const SESSION_ADDRESS: u16 = 0x18;
/// Elements from the first scratch word to the last: three numbers of two each.
const SCRATCH_ELEMENTS: usize = 6;

/// What is put out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Drive {
    /// Codes of the analog outputs.
    pub(crate) codes: [i32; CHANNELS],
    /// Whether the analog outputs are switched on.
    pub(crate) analog_on: bool,
    /// Levels of the lines.
    pub(crate) levels: Levels,
}

/// What an answer says, the encoders' words apart.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Status {
    /// The watchdog has bitten.
    pub(crate) bitten: bool,
    /// The commands that smart serial has not finished, together; 0 for none.
    pub(crate) command: u32,
    /// A bit for each channel whose exchange failed, eight bits for each port.
    pub(crate) failed: u32,
    /// States of the used channels, together.
    pub(crate) remotes: u32,
    /// Levels of the inputs.
    pub(crate) levels: Levels,
    /// The stamps' clock of the encoders.
    pub(crate) stamp: u16,
    /// The number of the newest write packet that arrived.
    pub(crate) write_number: u32,
    /// The mark.
    pub(crate) session: u32,
}

/// Places in the answer.
#[derive(Clone, Debug, Default)]
struct Places {
    request_number: Place,
    watchdog: Place,
    stamp: Place,
    counts: [Place; CHANNELS],
    controls: [Place; CHANNELS],
    command: [Option<Place>; SERIAL_PORTS_MAX],
    failed: [Option<Place>; SERIAL_PORTS_MAX],
    remotes: [[Option<Place>; 2]; REMOTES_MAX],
    field: [Option<Place>; REMOTES_MAX],
    ports: [Option<Place>; PORTS_MAX],
    scratch: Place,
}

/// Places in the write packet.
#[derive(Clone, Debug, Default)]
struct Slots {
    field: [Option<Place>; REMOTES_MAX],
    analog: [Option<[Place; USER_REGISTERS]>; REMOTES_MAX],
    pwm: [Option<Place>; CHANNELS],
    pwm_enable: Option<Place>,
    ports: [Option<Place>; PORTS_MAX],
    command: [Option<Place>; SERIAL_PORTS_MAX],
    feed: Place,
    number: Place,
}

/// All packets of a card.
#[derive(Clone, Debug)]
pub(crate) struct Cycle {
    pub(crate) read: Packet,
    places: Places,
    pub(crate) write: Packet,
    slots: Slots,
    /// Zero everything, then directions, then clear the watchdog, in this order.
    pub(crate) rearm: Packet,
    rearm_time: Place,
    /// Starts the watchdog.
    pub(crate) arm: Packet,
    /// A sign of life alone.
    pub(crate) feed: Packet,
    /// Lets the watchdog bite at once.
    pub(crate) bite: Packet,
    pub(crate) stop: Packet,
    pub(crate) start: Packet,
    /// Exchanges with the field terminals alone, their outputs off.
    pub(crate) poll: Packet,
    /// For each encoder, to latch every index pulse.
    pub(crate) index: Vec<Packet>,
    remotes: Vec<Remote>,
    modulation: Option<pwm::Modulation>,
    /// A bit for each modulator that is used.
    modulators: u32,
    encoders: usize,
    index_wired: bool,
    watchdog_word: u32,
}

impl Cycle {
    /// The packet that gives the card its mark.
    pub(crate) fn mark(session: u32) -> Packet {
        let mut packet = Packet::default();
        packet.write(Space::Timers, SESSION_ADDRESS, &[session]);
        packet
    }

    /// From now on a rearmed card's watchdog runs.
    pub(crate) fn let_watchdog_run(&mut self) {
        self.rearm.set(self.rearm_time, self.watchdog_word);
    }

    /// All packets, to see whether they fit a frame.
    pub(crate) fn packets(&self) -> [&Packet; 3] {
        [&self.read, &self.write, &self.rearm]
    }

    /// Gives the read packet its number.
    pub(crate) fn set_request(&mut self, number: u32) {
        self.read.set(self.places.request_number, number);
    }

    /// The number of the request that an answer belongs to; `None` for one that is too short.
    pub(crate) fn request_number(&self, answer: &[u8]) -> Option<u32> {
        self.read.is_answered_by(answer).then(|| self.places.scratch.read(answer))
    }

    /// What an answer says.
    pub(crate) fn status(&self, answer: &[u8]) -> Status {
        let places = &self.places;
        let word = |place: &Option<Place>| place.map_or(0, |place| place.read(answer));
        let mut status = Status {
            bitten: places.watchdog.read(answer) & 1 == 1,
            write_number: places.scratch.word(1).read(answer),
            session: places.scratch.word(2).read(answer),
            ..Status::default()
        };
        if self.encoders > 0 {
            status.stamp = places.stamp.read(answer) as u16;
        }
        for (port, (command, failed)) in places.command.iter().zip(&places.failed).enumerate() {
            status.command |= word(command);
            status.failed |= at_port(word(failed), port);
        }
        for place in places.remotes.iter().flatten() {
            status.remotes |= word(place);
        }
        let levels = places.ports.iter().chain(&places.field);
        for (level, place) in status.levels.iter_mut().zip(levels) {
            *level = word(place);
        }
        status
    }

    /// The words of the encoders.
    pub(crate) fn encoder_words(&self, answer: &[u8]) -> [ChannelWords; CHANNELS] {
        let mut words = [ChannelWords::default(); CHANNELS];
        for (i, word) in words.iter_mut().enumerate().take(self.encoders) {
            word.count = self.places.counts[i].read(answer);
            if self.index_wired {
                word.control = self.places.controls[i].read(answer);
            }
        }
        words
    }

    /// Fills the write packet. `exchange` has a bit for each channel of smart serial to exchange
    /// with, `alive` is a sign of life for the watchdog.
    pub(crate) fn set_outputs(&mut self, drive: &Drive, exchange: u32, alive: bool, number: u32) {
        let Cycle { write, slots, remotes, modulation, .. } = self;
        let fields = &drive.levels[FIELD_WORD..SPINDLE_WORD];
        for (place, level) in slots.field.iter().zip(fields) {
            if let Some(place) = place {
                write.set(*place, *level);
            }
        }
        for (index, (places, remote)) in slots.analog.iter().zip(remotes).enumerate() {
            if let Some(places) = places {
                let code = |channel: Option<usize>| channel.map_or(0, |at| drive.codes[at]);
                let is_analog = drive.analog_on && remote.channels.iter().any(Option::is_some);
                let spindle = drive.levels[SPINDLE_WORD] >> index & 1 == 1;
                let words = sserial::pack(&remote.channels.map(code), is_analog, spindle);
                places.iter().zip(words).for_each(|(place, word)| write.set(*place, word));
            }
        }
        if let (Some(modulation), Some(enable)) = (*modulation, slots.pwm_enable) {
            for (place, code) in slots.pwm.iter().zip(drive.codes) {
                if let Some(place) = place {
                    write.set(*place, modulation.word(code));
                }
            }
            write.set(enable, if drive.analog_on { self.modulators } else { 0 });
        }
        for (place, level) in slots.ports.iter().zip(drive.levels) {
            if let Some(place) = place {
                write.set(*place, level);
            }
        }
        for (port, place) in slots.command.iter().enumerate() {
            if let Some(place) = place {
                let channels = of_port(exchange, port);
                let command = match channels {
                    0 => sserial::IGNORED_COMMAND,
                    channels => sserial::DO_IT_COMMAND | channels,
                };
                write.set(*place, command);
            }
        }
        let feed = if alive { watchdog::FEED_WORD } else { watchdog::NO_FEED_WORD };
        write.set(slots.feed, feed);
        write.set(slots.number, number);
    }
}

/// Words of levels that an answer carries: the ports and the field terminals.
const _: () = assert!(PORTS_MAX + REMOTES_MAX < LEVEL_WORDS);
