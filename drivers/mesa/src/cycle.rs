//! The packets of a card's cycle: one that reads everything and one that writes everything, encoded
//! once and changed in place, and the few that recovery needs.

use taktil_hal::CHANNELS;

use crate::config::Config;
use crate::lbp16::{Packet, Place, Space};
use crate::modules::encoder::{self, ChannelWords};
use crate::modules::gpio::{self, FIELD_WORD, Levels, PORTS_MAX};
use crate::modules::sserial::{self, USER_REGISTERS};
use crate::modules::{pwm, read_instances, watchdog};
use crate::wiring::{SerialWiring, Wiring};

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
    /// The command that smart serial has not finished; 0 for none.
    pub(crate) command: u32,
    /// A bit for each channel whose exchange failed.
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
    command: Place,
    failed: Place,
    remotes: [Option<Place>; 2],
    field: Option<Place>,
    ports: [Option<Place>; PORTS_MAX],
    scratch: Place,
}

/// Places in the write packet.
#[derive(Clone, Debug, Default)]
struct Slots {
    field: Option<Place>,
    analog: Option<[Place; USER_REGISTERS]>,
    pwm: [Option<Place>; CHANNELS],
    pwm_enable: Option<Place>,
    ports: [Option<Place>; PORTS_MAX],
    command: Option<Place>,
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
    serial: Option<SerialWiring>,
    modulation: Option<pwm::Modulation>,
    encoders: usize,
    index_wired: bool,
    watchdog_word: u32,
}

/// Adds the writing of one register.
fn put(packet: &mut Packet, address: u16, word: u32) -> Place {
    packet.write(Space::Registers, address, &[word])
}

impl Cycle {
    /// Encodes all packets; `session` is the mark that the card is given when it is opened.
    pub(crate) fn new(config: &Config, wiring: &Wiring) -> Cycle {
        let mut cycle = Cycle {
            read: Packet::default(),
            places: Places::default(),
            write: Packet::default(),
            slots: Slots::default(),
            rearm: Packet::default(),
            rearm_time: Place::default(),
            arm: Packet::default(),
            feed: Packet::default(),
            bite: Packet::default(),
            stop: Packet::default(),
            start: Packet::default(),
            poll: Packet::default(),
            index: Vec::new(),
            serial: wiring.serial.clone(),
            modulation: wiring.pwm.as_ref().map(|(_, modulation)| *modulation),
            encoders: config.encoders,
            index_wired: config.index,
            watchdog_word: watchdog::time_word(config.watchdog_ms, wiring.watchdog.clock_hz),
        };
        cycle.build_read(wiring);
        cycle.build_write(config, wiring);
        cycle.build_recovery(config, wiring);
        cycle
    }

    fn build_read(&mut self, wiring: &Wiring) {
        let (read, places) = (&mut self.read, &mut self.places);
        places.request_number = read.write(Space::Timers, REQUEST_NUMBER_ADDRESS, &[0]);
        let status = wiring.watchdog.address(watchdog::STATUS_REGISTER, 0);
        places.watchdog = read.read(Space::Registers, status, 1);
        if let Some(module) = &wiring.encoders {
            // The stamps' clock before the counts: no edge is newer than it by then.
            let stamp = module.address(encoder::STAMP_REGISTER, 0);
            places.stamp = read.read(Space::Registers, stamp, 1);
            places.counts = read_instances(read, module, encoder::COUNT_REGISTER, self.encoders);
            if self.index_wired {
                places.controls =
                    read_instances(read, module, encoder::CONTROL_REGISTER, self.encoders);
            }
        }
        if let Some(serial) = &wiring.serial {
            let mut one = |register, channel| {
                read.read(Space::Registers, serial.address(register, channel), 1)
            };
            places.command = one(sserial::COMMAND_REGISTER, 0);
            places.failed = one(sserial::DATA_REGISTER, 0);
            places.remotes = [serial.field, serial.analog]
                .map(|used| used.map(|channel| one(sserial::STATUS_REGISTER, channel)));
            places.field = serial.field.map(|channel| one(sserial::USER_REGISTER, channel));
        }
        for bit in wiring.inputs.iter().flat_map(|lines| lines.bits()) {
            if bit.word < PORTS_MAX && places.ports[bit.word].is_none() {
                let address = wiring.ports.address(gpio::DATA_REGISTER, bit.word);
                places.ports[bit.word] = Some(read.read(Space::Registers, address, 1));
            }
        }
        places.scratch = read.read(Space::Timers, REQUEST_NUMBER_ADDRESS, SCRATCH_ELEMENTS);
    }

    fn build_write(&mut self, config: &Config, wiring: &Wiring) {
        let (write, slots) = (&mut self.write, &mut self.slots);
        if let Some(serial) = &wiring.serial {
            slots.field = serial
                .field
                .map(|channel| put(write, serial.address(sserial::USER_REGISTER, channel), 0));
            slots.analog = serial.analog.map(|channel| {
                core::array::from_fn(|register| {
                    let register = sserial::USER_REGISTER + register as u32;
                    put(write, serial.address(register, channel), 0)
                })
            });
        }
        if let Some((module, _)) = &wiring.pwm {
            for (unit, slot) in slots.pwm.iter_mut().enumerate().take(config.analog_channels) {
                *slot = Some(put(write, module.address(pwm::VALUE_REGISTER, unit), 0));
            }
            slots.pwm_enable = Some(put(write, module.address(pwm::ENABLE_REGISTER, 0), 0));
        }
        for bit in wiring.outputs.iter().flat_map(|lines| lines.bits()) {
            if bit.word < PORTS_MAX && slots.ports[bit.word].is_none() {
                let address = wiring.ports.address(gpio::DATA_REGISTER, bit.word);
                slots.ports[bit.word] = Some(put(write, address, 0));
            }
        }
        slots.command = wiring.serial.as_ref().map(|serial| {
            put(write, serial.address(sserial::COMMAND_REGISTER, 0), sserial::IGNORED_COMMAND)
        });
        let feed = wiring.watchdog.address(watchdog::FEED_REGISTER, 0);
        slots.feed = put(write, feed, watchdog::NO_FEED_WORD);
        slots.number = write.write(Space::Timers, WRITE_NUMBER_ADDRESS, &[0]);
    }

    fn build_recovery(&mut self, config: &Config, wiring: &Wiring) {
        let watchdog = |register| wiring.watchdog.address(register, 0);
        let inactive = wiring.outputs.map(|lines| lines.levels(&taktil_hal::LinesOut::SAFE));
        let field_off = inactive.map_or(0, |levels| levels[FIELD_WORD]);
        let rearm = &mut self.rearm;
        let serial = wiring.serial.as_ref();
        for channel in serial.iter().flat_map(|serial| [serial.field, serial.analog]).flatten() {
            for register in 0..USER_REGISTERS as u32 {
                let off = register == 0 && serial.is_some_and(|s| s.field == Some(channel));
                let register = sserial::USER_REGISTER + register;
                let address = serial.map_or(0, |serial| serial.address(register, channel));
                put(rearm, address, if off { field_off } else { 0 });
            }
        }
        if let Some((module, _)) = &wiring.pwm {
            for unit in 0..config.analog_channels {
                put(rearm, module.address(pwm::VALUE_REGISTER, unit), pwm::ZERO_WORD);
            }
            put(rearm, module.address(pwm::ENABLE_REGISTER, 0), 0);
        }
        for port in 0..wiring.ports.instances {
            let level = inactive.map_or(0, |levels| levels[port]);
            put(rearm, wiring.ports.address(gpio::DATA_REGISTER, port), level);
        }
        for port in 0..wiring.ports.instances {
            let address = wiring.ports.address(gpio::ALTERNATE_REGISTER, port);
            put(rearm, address, wiring.alternates[port]);
            let address = wiring.ports.address(gpio::DIRECTION_REGISTER, port);
            put(rearm, address, wiring.directions[port]);
        }
        // The word that the watchdog is loaded with; off until the first output is asked for.
        self.rearm_time = put(rearm, watchdog(watchdog::TIME_REGISTER), watchdog::OFF_WORD);
        put(rearm, watchdog(watchdog::STATUS_REGISTER), 0);
        put(&mut self.arm, watchdog(watchdog::TIME_REGISTER), self.watchdog_word);
        put(&mut self.arm, watchdog(watchdog::STATUS_REGISTER), 0);
        put(&mut self.feed, watchdog(watchdog::FEED_REGISTER), watchdog::FEED_WORD);
        put(&mut self.bite, watchdog(watchdog::TIME_REGISTER), watchdog::BITE_WORD);
        if let Some(serial) = serial {
            let command = serial.address(sserial::COMMAND_REGISTER, 0);
            put(&mut self.stop, command, sserial::STOP_COMMAND);
            let used = [serial.field, serial.analog];
            for channel in used.into_iter().flatten() {
                // Mode 0: inputs, outputs and analog codes as they are used here.
                put(&mut self.start, serial.address(sserial::STATUS_REGISTER, channel), 0);
            }
            let mask = serial.field_mask() | serial.analog_mask();
            put(&mut self.start, command, sserial::START_COMMAND | mask);
            if let Some(channel) = serial.field {
                let user = serial.address(sserial::USER_REGISTER, channel);
                put(&mut self.poll, user, field_off);
                let exchange = sserial::DO_IT_COMMAND | serial.field_mask();
                put(&mut self.poll, command, exchange);
            }
        }
        if let Some(module) = wiring.encoders.as_ref().filter(|_| config.index) {
            let packet = |channel| {
                let mut packet = Packet::default();
                let address = module.address(encoder::CONTROL_REGISTER, channel);
                put(&mut packet, address, encoder::EVERY_PULSE_CONTROL);
                packet
            };
            self.index = (0..config.encoders).map(packet).collect();
        }
    }

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

    /// The number of the request that an answer belongs to; `None` for a wrong length.
    pub(crate) fn request_number(&self, answer: &[u8]) -> Option<u32> {
        let whole = answer.len() == self.read.answer_bytes();
        whole.then(|| self.places.scratch.read(answer))
    }

    /// What an answer says.
    pub(crate) fn status(&self, answer: &[u8]) -> Status {
        let places = &self.places;
        let word = |place: Option<Place>| place.map_or(0, |place| place.read(answer));
        let mut status = Status {
            bitten: places.watchdog.read(answer) & 1 == 1,
            write_number: places.scratch.word(1).read(answer),
            session: places.scratch.word(2).read(answer),
            ..Status::default()
        };
        if self.encoders > 0 {
            status.stamp = places.stamp.read(answer) as u16;
        }
        if self.serial.is_some() {
            status.command = places.command.read(answer);
            status.failed = places.failed.read(answer);
            status.remotes = places.remotes.iter().fold(0, |all, place| all | word(*place));
        }
        for (level, place) in status.levels.iter_mut().zip(places.ports) {
            *level = word(place);
        }
        status.levels[FIELD_WORD] = word(places.field);
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

    /// Fills the write packet. `command` goes to smart serial, `alive` is a sign of life for the
    /// watchdog.
    pub(crate) fn set_outputs(&mut self, drive: &Drive, command: u32, alive: bool, number: u32) {
        let Cycle { write, slots, modulation, .. } = self;
        if let Some(place) = slots.field {
            write.set(place, drive.levels[FIELD_WORD]);
        }
        if let Some(places) = slots.analog {
            let words = sserial::pack(&drive.codes, drive.analog_on);
            places.into_iter().zip(words).for_each(|(place, word)| write.set(place, word));
        }
        if let (Some(modulation), Some(enable)) = (*modulation, slots.pwm_enable) {
            let mut wired = 0;
            for (unit, (place, code)) in slots.pwm.iter().zip(drive.codes).enumerate() {
                if let Some(place) = place {
                    write.set(*place, modulation.word(code));
                    wired |= 1 << unit;
                }
            }
            write.set(enable, if drive.analog_on { wired } else { 0 });
        }
        for (place, level) in slots.ports.iter().zip(drive.levels) {
            if let Some(place) = place {
                write.set(*place, level);
            }
        }
        if let Some(place) = slots.command {
            write.set(place, command);
        }
        let feed = if alive { watchdog::FEED_WORD } else { watchdog::NO_FEED_WORD };
        write.set(slots.feed, feed);
        write.set(slots.number, number);
    }
}
