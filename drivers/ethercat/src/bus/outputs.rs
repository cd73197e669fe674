//! The output side of a segment: which half exchanges at the end of a cycle, what a half puts out
//! that has fallen silent, the way back to operation and the way to the safe values.

use taktil_drivers_exchange::{Exchange, Failure, Half};
use taktil_hal::{CHANNELS, DriveCommand, DriveRequest, ErrorKind, LinesOut, Nanos};

use super::exchange::StateRequest;
use super::{ACKNOWLEDGE_SAFE_WORD, Acts, Bus, Commit, OPERATE_WORD, RESET_WORD};
use crate::config::ExchangeTimes;
use crate::drive::{Demand, DriveUnit, Told, Wish};
use crate::health::{Counts, Diagnostics};
use crate::wiring::{AnalogPlace, LinePlace};

impl Bus {
    /// Takes the codes of a cycle, which are in range.
    pub(crate) fn commit_codes(
        &mut self,
        release: Nanos,
        codes: &[i32; CHANNELS],
    ) -> Result<(), Failure> {
        self.codes = *codes;
        let asks = codes.iter().any(|code| *code != 0);
        self.analog = Commit { release: Some(release), alive: release, active: true, asks };
        let outcome = self.close(release, Half::Motors).map_err(Failure::whole);
        let outcome = outcome.and_then(|()| match self.failing_channel(release) {
            Some(channel) => Err(Failure::on_channel(ErrorKind::Transient, channel)),
            None => Ok(()),
        });
        self.line_failure.motors = outcome.is_err();
        outcome
    }

    /// Takes the command of a cycle to the drives, whose targets are in range.
    pub(crate) fn commit_drives(
        &mut self,
        release: Nanos,
        command: &DriveCommand,
    ) -> Result<(), Failure> {
        let DriveCommand { targets, request, reset } = *command;
        self.codes = targets;
        self.acts = Some(Acts { request, reset });
        let asks = request == DriveRequest::Follow;
        self.is_blocked &= asks;
        self.analog = Commit { release: Some(release), alive: release, active: true, asks };
        self.close(release, Half::Motors).map_err(Failure::whole)?;
        let is_failing = |drive: &DriveUnit| drive.is_failing(release);
        match self.drives.iter().position(is_failing) {
            Some(channel) => Err(Failure::on_channel(ErrorKind::Transient, channel)),
            None => Ok(()),
        }
    }

    /// The first channel whose drive is wanted and does not follow.
    fn failing_channel(&self, release: Nanos) -> Option<usize> {
        let is_failing = |place: &AnalogPlace| match place {
            AnalogPlace::Drive(number) => {
                self.drives.get(*number).is_some_and(|drive| drive.is_failing(release))
            }
            AnalogPlace::Terminal(_) => false,
        };
        self.wiring.analog_out.iter().position(is_failing)
    }

    /// Takes the lines of a cycle.
    pub(crate) fn commit_lines(&mut self, release: Nanos, lines: &LinesOut) -> Result<(), Failure> {
        let fed = lines.watchdog_feed != self.lines.watchdog_feed;
        let asks = lines.enable || lines.brake_release;
        // The first wish is a sign of life, whatever its feed line says.
        let alive = if fed || !self.digital.asks { release } else { self.digital.alive };
        self.is_blocked &= lines.enable || self.acts.is_some();
        self.line_failure.note(self.lines.enable, lines.enable);
        let is_silent = asks && release - alive > self.spans.silence;
        let active = if is_silent { self.digital.active } else { asks };
        self.digital = Commit { release: Some(release), alive, active, asks };
        self.lines = *lines;
        if is_silent && !active {
            self.lines = LinesOut { watchdog_feed: lines.watchdog_feed, ..LinesOut::SAFE };
        }
        let outcome = self.close(release, Half::Lines).map_err(Failure::whole);
        self.line_failure.lines = outcome.is_err();
        outcome
    }

    /// Says whether the half of the lines is there, which commits last then.
    pub(crate) fn set_lines(&mut self, is_there: bool) {
        (self.closer, self.unsent) = (is_there.then_some(Half::Lines), None);
        self.health.has_lines = is_there;
    }

    /// Exchanges, unless the other half is known to commit after this one.
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
            return self.readiness();
        }
        if other_release == Some(release) {
            self.closer = Some(half);
        }
        self.unsent = None;
        self.end_cycle(release)
    }

    fn end_cycle(&mut self, release: Nanos) -> Result<(), ErrorKind> {
        if self.lost {
            return Err(ErrorKind::Lost);
        }
        self.watch(release);
        let exchanged = self.exchanged.filter(|(at, _)| *at == release);
        if !self.operates && exchanged.is_some() && !self.recovery.is_made {
            self.recover();
            return self.readiness();
        }
        let outcome = match (self.exchange, exchanged) {
            // The outputs go with the next reading.
            (ExchangeTimes::Once | ExchangeTimes::Pipelined, Some((_, outcome))) => outcome,
            _ => self.exchange(release, true),
        };
        // A segment that was silent for long gets its outputs again before readings are trusted.
        match outcome {
            Err(ErrorKind::Stale) => Err(ErrorKind::Transient),
            Err(kind) => Err(kind),
            Ok(()) => self.readiness(),
        }
    }

    /// Whether what is asked for can act.
    fn readiness(&self) -> Result<(), ErrorKind> {
        let asks = self.analog.asks || self.digital.asks;
        if (self.operates || !asks) && !self.is_blocked {
            Ok(())
        } else {
            Err(ErrorKind::Transient)
        }
    }

    /// Asks all devices to operate, and then, one after the other, those that do not: what has an
    /// error wants it acknowledged first.
    fn recover(&mut self) {
        self.recovery.is_made = true;
        let device = self.recovery.has_asked_all.then_some(self.recovery.device);
        if device.is_some() {
            self.recovery.acknowledges = !self.recovery.acknowledges;
        }
        self.recovery.has_asked_all = true;
        self.recovery.asks_operation = device.is_none() || !self.recovery.acknowledges;
        let word = if self.recovery.asks_operation { OPERATE_WORD } else { ACKNOWLEDGE_SAFE_WORD };
        self.state.begin(&mut self.master, StateRequest { device, word });
        if self.exchange != ExchangeTimes::Pipelined {
            self.finish_recovery(self.spans.wait);
        }
    }

    /// Collects the answer to a request of a state, if there was one.
    pub(super) fn finish_recovery(&mut self, wait: Nanos) {
        let answer = self.state.collect(&mut self.master, wait);
        self.state.give_up();
        self.health.seen.recoveries +=
            u64::from(matches!(answer, Some(Ok(()))) && self.recovery.asks_operation);
    }

    /// Puts a half at its safe values that has not committed in time.
    pub(super) fn watch(&mut self, release: Nanos) {
        if self.analog.active && release - self.analog.alive > self.spans.silence {
            self.codes = [0; CHANNELS];
            self.health.seen.silences += u64::from(self.analog.asks);
            if let Some(acts) = &mut self.acts {
                // Drives that close a loop stop by themselves; they wait for a new request.
                self.is_blocked |= acts.request == DriveRequest::Follow;
                acts.request = DriveRequest::QuickStop;
            }
            (self.analog.active, self.analog.asks) = (false, false);
        }
        if self.digital.active && release - self.digital.alive > self.spans.silence {
            self.is_blocked |= self.wants_drives();
            self.lines = LinesOut { watchdog_feed: self.lines.watchdog_feed, ..LinesOut::SAFE };
            self.digital.active = false;
            self.health.seen.silences += 1;
        }
    }

    /// Whether the drives are wanted, whatever keeps them.
    pub(super) fn wants_drives(&self) -> bool {
        match self.acts {
            Some(acts) => acts.request == DriveRequest::Follow,
            None => self.lines.enable,
        }
    }

    /// What is wanted of the drives. Where the line is at the drives as well, both have to say so.
    fn wish(&self) -> Wish {
        let by_line = self.wiring.lines_out.is_some_and(|one| one.enable == LinePlace::Drives);
        let may_follow = self.operates && !self.is_blocked;
        let Some(Acts { request, reset }) = self.acts else {
            return Wish::Line(by_line && self.lines.enable && may_follow);
        };
        let is_held = !may_follow || (by_line && !self.lines.enable);
        let request = match request {
            DriveRequest::Follow if is_held => DriveRequest::QuickStop,
            request => request,
        };
        Wish::Acts { request, reset }
    }

    /// Writes all outputs into the image.
    pub(super) fn put_out(&mut self, release: Nanos, steps: bool) {
        let wish = self.wish();
        let (enable, is_absolute) = (wish.is_to_follow(), self.acts.is_some());
        let gave_up = self.line_failure.gave_up;
        let device = self.master.device();
        for (number, drive) in self.drives.iter_mut().enumerate() {
            let Ok(one) = self.group.subdevice(device, drive.device()) else { continue };
            let place = AnalogPlace::Drive(number);
            let channel = match self.acts {
                Some(_) => Some(number),
                None => self.wiring.analog_out.iter().position(|one| *one == place),
            };
            if steps {
                drive.step(release, wish, Told { has_channel: channel.is_some(), gave_up });
            }
            let mut outputs = one.outputs_raw_mut();
            if !self.operates {
                drive.write_off(&mut outputs);
                continue;
            }
            let code = channel.and_then(|channel| self.codes.get(channel)).copied();
            let code = code.filter(|_| self.analog.active);
            drive.write(Demand { enable, code, is_absolute }, &mut outputs);
        }
        for (place, code) in self.wiring.analog_out.iter().zip(self.codes) {
            if let AnalogPlace::Terminal(field) = place
                && let Ok(one) = self.group.subdevice(device, field.device)
            {
                let is_off = !self.operates || self.acts.is_some();
                let code = if is_off { 0 } else { code };
                field.set(&mut one.outputs_raw_mut(), code.cast_unsigned());
            }
        }
        let safe = LinesOut { watchdog_feed: self.lines.watchdog_feed, ..LinesOut::SAFE };
        let lines = if self.operates && !self.is_blocked { self.lines } else { safe };
        if let Some(places) = self.wiring.lines_out {
            for (field, level) in places.levels(&lines).into_iter().flatten() {
                if let Ok(one) = self.group.subdevice(device, field.device) {
                    field.set(&mut one.outputs_raw_mut(), u32::from(level));
                }
            }
        }
    }
}

impl Exchange for Bus {
    type Shown = Counts;

    fn publish(&self, shown: &Counts, collisions: u64) {
        shown.store(Diagnostics { collisions, ..self.seen() }, self.health.has_lines);
    }

    fn safe(&mut self, half: Half) -> Result<(), Failure> {
        match half {
            Half::Motors => {
                self.codes = [0; CHANNELS];
                (self.analog.active, self.analog.asks) = (false, false);
                if let Some(acts) = &mut self.acts {
                    *acts = Acts::default();
                    self.is_blocked = false;
                }
            }
            Half::Lines => {
                self.lines = LinesOut { watchdog_feed: self.lines.watchdog_feed, ..LinesOut::SAFE };
                (self.digital.active, self.digital.asks) = (false, false);
                self.is_blocked = false;
            }
        }
        let release = self.exchanged.map_or(Nanos::ZERO, |(at, _)| at);
        match self.put_out_at_once(release) {
            Err(ErrorKind::Stale) => Err(ErrorKind::Transient.into()),
            other => other.map_err(Failure::whole),
        }
    }
}

impl Drop for Bus {
    /// Safe values, then INIT: no device is driven by anybody.
    fn drop(&mut self) {
        let _ = self.safe(Half::Lines);
        let _ = self.safe(Half::Motors);
        self.state.begin(&mut self.master, StateRequest { device: None, word: RESET_WORD });
        let _ = self.state.collect(&mut self.master, self.spans.wait);
    }
}
