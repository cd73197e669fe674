//! Encodes the packets of a cycle and of recovery, once, when a card is opened.

use super::{Cycle, Places, REQUEST_NUMBER_ADDRESS, SCRATCH_ELEMENTS, Slots, WRITE_NUMBER_ADDRESS};
use crate::config::Config;
use crate::lbp16::{Packet, Place, Space};
use crate::modules::gpio::{self, FIELD_WORD, Levels, PORTS_MAX, SPINDLE_WORD};
use crate::modules::sserial::{self, USER_REGISTERS};
use crate::modules::{encoder, pwm, read_instances, watchdog};
use crate::wiring::{SerialWiring, Wiring};

/// Adds the writing of one register.
fn put(packet: &mut Packet, address: u16, word: u32) -> Place {
    packet.write(Space::Registers, address, &[word])
}

impl Cycle {
    /// Encodes all packets; `session` is the mark that the card is given when it is opened.
    pub(crate) fn new(config: &Config, wiring: &Wiring) -> Cycle {
        let units = wiring.pwm.iter().flat_map(|pwm| &pwm.units);
        let serial = wiring.serial.as_ref();
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
            remotes: serial.map_or_else(Vec::new, |serial| serial.remotes.clone()),
            modulation: wiring.pwm.as_ref().map(|pwm| pwm.modulation),
            modulators: units.fold(0, |mask, unit| mask | (1 << (unit & 31))),
            encoders: config.encoders,
            index_wired: config.index,
            watchdog_word: watchdog::time_word(config.watchdog_ms, wiring.watchdog.clock_hz),
        };
        cycle.build_read(wiring);
        cycle.build_write(wiring);
        let outputs = wiring.outputs.as_ref();
        let inactive = outputs.map(|lines| lines.levels(&taktil_hal::LinesOut::SAFE));
        cycle.build_recovery(wiring, &inactive.unwrap_or_default());
        if let Some(serial) = serial {
            cycle.build_serial(serial, &inactive.unwrap_or_default());
        }
        cycle.build_index(config, wiring);
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
            let mut one = |register, port, channel| {
                read.read(Space::Registers, serial.address(register, port, channel), 1)
            };
            for (port, _) in serial.ports() {
                places.command[port] = Some(one(sserial::COMMAND_REGISTER, port, 0));
                places.failed[port] = Some(one(sserial::DATA_REGISTER, port, 0));
            }
            for (index, remote) in serial.remotes.iter().enumerate() {
                places.remotes[index] = [remote.field, remote.analog].map(|used| {
                    used.map(|channel| one(sserial::STATUS_REGISTER, remote.port, channel))
                });
                let field = remote.field;
                places.field[index] =
                    field.map(|channel| one(sserial::USER_REGISTER, remote.port, channel));
            }
        }
        for bit in wiring.inputs.iter().flat_map(|lines| lines.bits()) {
            if bit.word < PORTS_MAX && places.ports[bit.word].is_none() {
                let address = wiring.ports.address(gpio::DATA_REGISTER, bit.word);
                places.ports[bit.word] = Some(read.read(Space::Registers, address, 1));
            }
        }
        places.scratch = read.read(Space::Timers, REQUEST_NUMBER_ADDRESS, SCRATCH_ELEMENTS);
    }

    fn build_write(&mut self, wiring: &Wiring) {
        let (write, slots) = (&mut self.write, &mut self.slots);
        if let Some(serial) = &wiring.serial {
            for (index, remote) in serial.remotes.iter().enumerate() {
                let mut user = |register, channel| {
                    let register = sserial::USER_REGISTER + register as u32;
                    put(write, serial.address(register, remote.port, channel), 0)
                };
                slots.field[index] = remote.field.map(|channel| user(0, channel));
                slots.analog[index] = remote
                    .analog
                    .map(|channel| core::array::from_fn(|register| user(register, channel)));
            }
        }
        if let Some(pwm) = &wiring.pwm {
            for (slot, unit) in slots.pwm.iter_mut().zip(&pwm.units) {
                *slot = Some(put(write, pwm.module.address(pwm::VALUE_REGISTER, *unit), 0));
            }
            slots.pwm_enable = Some(put(write, pwm.module.address(pwm::ENABLE_REGISTER, 0), 0));
        }
        for bit in wiring.outputs.iter().flat_map(|lines| lines.bits()) {
            if bit.word < PORTS_MAX && slots.ports[bit.word].is_none() {
                let address = wiring.ports.address(gpio::DATA_REGISTER, bit.word);
                slots.ports[bit.word] = Some(put(write, address, 0));
            }
        }
        for (port, _) in wiring.serial.iter().flat_map(SerialWiring::ports) {
            let address = wiring.serial.as_ref().map_or(0, |serial| serial.command_address(port));
            slots.command[port] = Some(put(write, address, sserial::IGNORED_COMMAND));
        }
        let feed = wiring.watchdog.address(watchdog::FEED_REGISTER, 0);
        slots.feed = put(write, feed, watchdog::NO_FEED_WORD);
        slots.number = write.write(Space::Timers, WRITE_NUMBER_ADDRESS, &[0]);
    }

    fn build_recovery(&mut self, wiring: &Wiring, inactive: &Levels) {
        let watchdog = |register| wiring.watchdog.address(register, 0);
        let rearm = &mut self.rearm;
        if let Some(serial) = &wiring.serial {
            put_remotes_off(rearm, serial, inactive);
        }
        if let Some(pwm) = &wiring.pwm {
            for unit in &pwm.units {
                put(rearm, pwm.module.address(pwm::VALUE_REGISTER, *unit), pwm::ZERO_WORD);
            }
            put(rearm, pwm.module.address(pwm::ENABLE_REGISTER, 0), 0);
        }
        for (port, level) in inactive.iter().enumerate().take(wiring.ports.instances) {
            put(rearm, wiring.ports.address(gpio::DATA_REGISTER, port), *level);
        }
        for port in 0..wiring.ports.instances {
            // Whoever had the card before may have left open drains and inverted levels behind.
            let words = [
                (gpio::OPEN_DRAIN_REGISTER, wiring.open_drains[port]),
                (gpio::INVERT_REGISTER, 0),
                (gpio::ALTERNATE_REGISTER, wiring.alternates[port]),
                (gpio::DIRECTION_REGISTER, wiring.directions[port]),
            ];
            for (register, word) in words {
                put(rearm, wiring.ports.address(register, port), word);
            }
        }
        // The word that the watchdog is loaded with; off until the first output is asked for.
        self.rearm_time = put(rearm, watchdog(watchdog::TIME_REGISTER), watchdog::OFF_WORD);
        put(rearm, watchdog(watchdog::STATUS_REGISTER), 0);
        put(&mut self.arm, watchdog(watchdog::TIME_REGISTER), self.watchdog_word);
        put(&mut self.arm, watchdog(watchdog::STATUS_REGISTER), 0);
        put(&mut self.feed, watchdog(watchdog::FEED_REGISTER), watchdog::FEED_WORD);
        put(&mut self.bite, watchdog(watchdog::TIME_REGISTER), watchdog::BITE_WORD);
    }

    fn build_serial(&mut self, serial: &SerialWiring, inactive: &Levels) {
        for remote in &serial.remotes {
            for channel in remote.used() {
                // Mode 0: inputs, outputs and analog codes as they are used here.
                let address = serial.address(sserial::STATUS_REGISTER, remote.port, channel);
                put(&mut self.start, address, 0);
            }
        }
        for (port, mask) in serial.ports() {
            let command = serial.command_address(port);
            put(&mut self.stop, command, sserial::STOP_COMMAND);
            put(&mut self.start, command, sserial::START_COMMAND | mask);
        }
        for (index, remote) in serial.remotes.iter().enumerate() {
            if let Some(channel) = remote.field {
                let user = serial.address(sserial::USER_REGISTER, remote.port, channel);
                put(&mut self.poll, user, inactive[FIELD_WORD + index]);
            }
        }
        for (port, _) in serial.ports() {
            let mask = crate::wiring::of_port(serial.field_mask(), port);
            if mask != 0 {
                put(&mut self.poll, serial.command_address(port), sserial::DO_IT_COMMAND | mask);
            }
        }
    }

    fn build_index(&mut self, config: &Config, wiring: &Wiring) {
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
}

/// Adds the writing of the safe values of all 7I77s.
fn put_remotes_off(packet: &mut Packet, serial: &SerialWiring, inactive: &Levels) {
    for (index, remote) in serial.remotes.iter().enumerate() {
        let spindle = inactive[SPINDLE_WORD] >> index & 1 == 1;
        let analog = sserial::pack(&[0; crate::config::REMOTE_OUTPUTS], false, spindle);
        let mut field = [0; USER_REGISTERS];
        field[0] = inactive[FIELD_WORD + index];
        for (channel, words) in [(remote.field, field), (remote.analog, analog)] {
            let Some(channel) = channel else { continue };
            for (register, word) in (sserial::USER_REGISTER..).zip(words) {
                put(packet, serial.address(register, remote.port, channel), word);
            }
        }
    }
}
