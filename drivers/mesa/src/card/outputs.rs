//! The output side of a card: which half sends the write packet of a cycle, what of it is a sign of
//! life, and the way to the safe values.

use taktil_drivers_exchange::{Exchange, Failure, Half};
use taktil_hal::{CHANNELS, ErrorKind, LinesOut, Nanos};

use super::{Card, Commit};
use crate::config::COMMAND_READS_MAX;
use crate::link::{CardNumbers, Diagnostics};
use crate::modules::gpio::SPINDLE_WORD;
use crate::recovery::Phase;

impl Card {
    /// Takes the codes of a cycle, which are in range.
    pub(crate) fn commit_codes(
        &mut self,
        release: Nanos,
        codes: &[i32; CHANNELS],
    ) -> Result<(), ErrorKind> {
        self.drive.codes = *codes;
        self.drive.analog_on = true;
        self.analog = Commit { release: Some(release), alive: true, active: true };
        self.close(release, Half::Motors)
    }

    /// Takes the lines of a cycle.
    pub(crate) fn commit_lines(
        &mut self,
        release: Nanos,
        lines: &LinesOut,
    ) -> Result<(), ErrorKind> {
        let fed = lines.watchdog_feed != self.lines.watchdog_feed;
        self.set_lines(lines);
        self.digital = Commit {
            release: Some(release),
            alive: fed || self.digital.alive,
            active: lines.enable || lines.brake_release,
        };
        self.close(release, Half::Lines)
    }

    fn set_lines(&mut self, lines: &LinesOut) {
        self.lines = *lines;
        if let Some(outputs) = &self.outputs {
            self.drive.levels = outputs.levels(lines);
        }
    }

    /// Sends the write packet, unless the other half is known to commit after this one.
    fn close(&mut self, release: Nanos, half: Half) -> Result<(), ErrorKind> {
        let (other, other_release) = match half {
            Half::Motors => (Half::Lines, self.digital.release),
            Half::Lines => (Half::Motors, self.analog.release),
        };
        if self.unsent == Some(half) {
            // It did not, last time.
            self.closer = None;
        }
        if self.closer == Some(other) && other_release != Some(release) {
            self.unsent = Some(half);
            return if self.phase == Phase::Running { Ok(()) } else { Err(ErrorKind::Transient) };
        }
        if other_release == Some(release) {
            self.closer = Some(half);
        }
        self.put_out(release)
    }

    fn put_out(&mut self, release: Nanos) -> Result<(), ErrorKind> {
        if self.lost {
            return Err(ErrorKind::Lost);
        }
        if self.phase != Phase::Running {
            self.unsent = None;
            return Err(ErrorKind::Transient);
        }
        self.settle(release);
        if self.link.level.is_failed() {
            self.clear_drive();
        }
        let (analog, digital) = (self.analog, self.digital);
        let analog_lives = analog.alive || !analog.active;
        let lines_live = digital.alive || !digital.active;
        let mut channels = 0;
        channels |= if analog_lives { self.analog_mask } else { 0 };
        channels |= if lines_live { self.field_mask } else { 0 };
        // A spindle enable is a line that lives on an analog channel.
        channels &= if lines_live { u32::MAX } else { !self.spindle_mask };
        let sent = self.write(release, channels, analog_lives && lines_live);
        if !sent || self.link.level.is_failed() || self.phase != Phase::Running {
            return Err(ErrorKind::Transient);
        }
        Ok(())
    }

    /// Waits until smart serial has finished the exchange before, where one was started in this
    /// cycle or was seen unfinished in it.
    pub(super) fn settle(&mut self, release: Nanos) {
        let unheard = self.sampled.is_some_and(|(at, outcome)| at == release && outcome.is_err());
        if unheard && self.exchange.is_some_and(|(began, _)| began < release) {
            // It is a whole cycle old and takes a small part of one. A silent card is not waited
            // for a second time.
            self.exchange = None;
        }
        for _ in 0..COMMAND_READS_MAX {
            if self.exchange.is_none() {
                return;
            }
            self.send_request();
            // What it gives is taken in; the sample of the cycle stays what it was.
            if self.collect_within(release, self.settle_wait).is_err() {
                return;
            }
        }
    }

    /// Sends the write packet; whether the system took it.
    pub(super) fn write(&mut self, release: Nanos, channels: u32, alive: bool) -> bool {
        if self.taken_over {
            return false;
        }
        if !self.armed {
            self.armed = true;
            self.cycle.let_watchdog_run();
            let sent = self.port.send(self.cycle.arm.bytes());
            self.link.seen.send_failures += u64::from(sent.is_err());
        }
        self.unsent = None;
        (self.analog.alive, self.digital.alive) = (false, false);
        self.write_number = self.write_number.wrapping_add(1);
        self.written = true;
        self.wrote = true;
        // An exchange that is still under way would swallow this one.
        let exchanges = channels != 0 && self.exchange.is_none();
        let exchange = if exchanges { channels } else { 0 };
        self.cycle.set_outputs(&self.drive, exchange, alive, self.write_number);
        let sent = self.port.send(self.cycle.write.bytes()).is_ok();
        self.link.seen.send_failures += u64::from(!sent);
        if exchanges {
            self.exchange = Some((release, channels));
            self.exchanged = true;
        }
        sent
    }

    pub(super) fn clear_drive(&mut self) {
        (self.drive.codes, self.drive.analog_on) = ([0; CHANNELS], false);
        let feed = self.lines.watchdog_feed;
        self.set_lines(&LinesOut { watchdog_feed: feed, ..LinesOut::SAFE });
    }
}

impl Exchange for Card {
    type Shown = CardNumbers;

    fn publish(&self, shown: &CardNumbers, collisions: u64) {
        shown.store(Diagnostics { collisions, ..self.link.seen() }, self.speeds());
    }

    fn safe(&mut self, half: Half) -> Result<(), Failure> {
        let spindles = self.drive.levels[SPINDLE_WORD];
        match half {
            Half::Motors => {
                (self.drive.codes, self.drive.analog_on) = ([0; CHANNELS], false);
                self.analog.active = false;
            }
            Half::Lines => {
                let feed = self.lines.watchdog_feed;
                self.set_lines(&LinesOut { watchdog_feed: feed, ..LinesOut::SAFE });
                self.digital.active = false;
            }
        }
        if !self.lost && self.phase != Phase::Running {
            // On the way back from a bite everything is at its safe value.
            return Ok(());
        }
        let release = self.sampled.map_or(Nanos::ZERO, |(at, _)| at);
        if !self.lost {
            self.settle(release);
        }
        let mut channels = if self.analog.active { 0 } else { self.analog_mask };
        channels |= if self.digital.active { 0 } else { self.field_mask };
        // A spindle enable goes off at once, although its channel carries codes that are in use.
        let is_off = self.drive.levels[SPINDLE_WORD] != spindles;
        channels |= if is_off { self.spindle_mask } else { 0 };
        // Going safe is no sign of life.
        let sent = self.write(release, channels, false);
        match (self.lost, sent) {
            (true, _) => Err(Failure::LOST),
            (false, false) => Err(Failure::whole(ErrorKind::Transient)),
            (false, true) => Ok(()),
        }
    }
}

impl Drop for Card {
    /// Safe values, then a bite: no output stays driven by anybody.
    fn drop(&mut self) {
        if self.taken_over {
            // The outputs are another program's, which has put them at their safe values first.
            return;
        }
        let release = self.sampled.map_or(Nanos::ZERO, |(at, _)| at);
        let _ = self.safe(Half::Motors);
        let _ = self.safe(Half::Lines);
        if !self.lost {
            self.settle(release);
        }
        let _ = self.port.send(self.cycle.bite.bytes());
    }
}
