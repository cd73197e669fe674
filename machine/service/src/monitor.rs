//! What the thread of the lanes' records does beside carrying them: it feeds the recorder and the
//! operator's server, tells systemd that the lanes live, and says what becomes of the recording and
//! which faults are latched.
//! All of it is handed on; nothing here touches the disk, systemd or the journal itself.

use taktil_machine_boards::Epoch;
use taktil_machine_console::out;
use taktil_machine_operator::OperatorServer;
use taktil_record::flight::FlightRecorderWriter;
use taktil_record::granted::Grants;
use taktil_rtcore::Nanos;
use taktil_rtcore::live::{Attestation, Hang, RunObserver};
use taktil_rtcore::record::{Catalog, LaneInfo, Observer, Record};

use crate::latched_faults::LatchedFaults;
use crate::recording::ServiceRecording;
use crate::systemd::{SystemdMessage, SystemdNotifier};

/// Exit code of a service in which a task does not return.
pub const EXIT_HUNG: i32 = 3;
/// Time between two watchdog messages to systemd.
const WATCHDOG_PERIOD: Nanos = Nanos::from_millis(100);
/// How long the end of the service waits for systemd and for the journal to read.
pub(crate) const FAREWELL_TIMEOUT: Nanos = Nanos::from_millis(300);

/// Watches the health of the lanes and sends watchdog messages to systemd. Nothing here waits.
pub(crate) struct HealthMonitor<'a> {
    /// Whether the lanes are to end, after which their silence says nothing.
    is_ending: &'a dyn Fn() -> bool,
    lanes_health: Vec<LaneHealth>,
    next: Nanos,
    pub(crate) flight_recorder: Option<FlightRecorderWriter>,
    pub(crate) recording: Option<ServiceRecording>,
    pub(crate) server: Option<OperatorServer>,
    pub(crate) latched: LatchedFaults,
    epoch: Epoch,
    pub(crate) notifier: SystemdNotifier,
    /// What systemd shows while the recording goes well.
    status: &'static str,
}

impl<'a> HealthMonitor<'a> {
    /// Watches the lanes of a machine with this catalog, which are to end when `is_ending` says so.
    pub(crate) fn new(
        catalog: &Catalog,
        is_ending: &'a dyn Fn() -> bool,
        epoch: Epoch,
        notifier: SystemdNotifier,
    ) -> HealthMonitor<'a> {
        let lane = |lane: &LaneInfo| {
            let health = catalog.find(&format!("{}.health", lane.name))?;
            Some(LaneHealth::new(&lane.name, health, lane.period))
        };
        let lanes_health = catalog.lanes.iter().filter_map(lane).collect();
        HealthMonitor {
            is_ending,
            lanes_health,
            next: Nanos::ZERO,
            flight_recorder: None,
            recording: None,
            server: None,
            latched: LatchedFaults::new(catalog),
            epoch,
            notifier,
            status: "",
        }
    }

    /// Closes the recording, in bounded time whatever the disk does.
    pub(crate) fn finish_recording(&mut self) -> anyhow::Result<()> {
        self.recording.take().map_or(Ok(()), ServiceRecording::finish)
    }
}

/// The liveness of one lane.
struct LaneHealth {
    name: String,
    /// Number of the lane's health signal in the catalog.
    health: usize,
    /// The lane counts as silent when its health signal is older than this.
    limit: Nanos,
    heard: bool,
    last: Nanos,
    /// Whether somebody has been told of its silence, since it was heard last.
    is_told: bool,
}

impl LaneHealth {
    /// The limit follows from the lane's own period, so a lane may be slow.
    fn new(name: &str, health: usize, period: Nanos) -> LaneHealth {
        LaneHealth {
            name: name.to_owned(),
            health,
            limit: WATCHDOG_PERIOD.max(period * 2),
            heard: false,
            last: Nanos::ZERO,
            is_told: false,
        }
    }

    /// How long the lane has been silent at `now`, where that is too long.
    fn silence(&mut self, now: Nanos) -> Option<Nanos> {
        if core::mem::take(&mut self.heard) {
            (self.last, self.is_told) = (now, false);
        }
        let silence = now - self.last;
        (silence > self.limit).then_some(silence)
    }

    /// What is to be said of a silence: once, until the lane is heard again.
    fn told(&mut self, now: Nanos) -> Option<String> {
        let silence = self.silence(now)?.as_secs_f64();
        let is_first = !core::mem::replace(&mut self.is_told, true);
        let name = &self.name;
        is_first.then(|| {
            format!("lane {name} has been silent for {silence:.2} s: systemd is told no more")
        })
    }
}

impl Observer for HealthMonitor<'_> {
    fn record(&mut self, record: &Record<'_>) {
        if let Some(lane) = self.lanes_health.iter_mut().find(|lane| lane.health == record.signal) {
            lane.heard = true;
        }
        self.latched.record(record);
        if let Some(recording) = &mut self.recording {
            recording.record(record);
        }
        if let Some(server) = &mut self.server {
            server.record(record);
        }
    }
}

impl RunObserver for HealthMonitor<'_> {
    fn on_attestation(&mut self, attestation: &Attestation) {
        if let Some(flight_recorder) = &mut self.flight_recorder {
            flight_recorder.write_attestation(attestation);
        }
        if !attestation.is_granted() {
            out::warn(format_args!("degraded: {}", attestation.missing.join("; ")));
        }
        if let Some(server) = &self.server {
            server.set_attestation(Grants::new(Some(attestation)).to_json());
        }
        let status =
            if attestation.is_granted() { "lanes granted" } else { "degraded: not real time" };
        self.status = status;
        self.notifier.send(SystemdMessage::Ready(status.into()));
    }

    fn on_epoch(&mut self, origin: Nanos) {
        self.epoch.set(origin);
    }

    fn on_time(&mut self, now: Nanos) {
        if let Some(flight_recorder) = &mut self.flight_recorder {
            flight_recorder.write_wall_time(now);
        }
        if let Some(server) = &self.server {
            server.set_time(now);
        }
        // One silent lane is enough to let the watchdog bite.
        let alive =
            self.lanes_health.iter_mut().fold(true, |all, lane| all & lane.silence(now).is_none());
        if now < self.next {
            return;
        }
        self.next = now + WATCHDOG_PERIOD;
        if let Some(text) = self.latched.look(now) {
            out::warn(text);
        }
        if let Some(change) = self.recording.as_mut().and_then(ServiceRecording::look) {
            match &change {
                Some(why) => out::warn(format_args!("recording stopped by its disk: {why}")),
                None => out::warn("recording goes on"),
            }
            let status = change.map_or(self.status.to_owned(), |why| format!("log: {why}"));
            self.notifier.send(SystemdMessage::Status(status));
        }
        if alive {
            self.notifier.send(SystemdMessage::Watchdog);
        }
        if !(self.is_ending)() {
            self.lanes_health.iter_mut().filter_map(|lane| lane.told(now)).for_each(out::warn);
        }
    }

    fn on_hang(&mut self, hang: &Hang) {
        out::warn(format_args!(
            "error: {hang}; the other lanes have ended safe, the board's watchdog does the rest"
        ));
        self.notifier.send(SystemdMessage::Stopping(hang.to_string()));
        if let Err(error) = self.finish_recording() {
            out::warn(format_args!("error: {error:#}"));
        }
        self.notifier.flush(FAREWELL_TIMEOUT);
        out::flush_errors(FAREWELL_TIMEOUT);
        // A thread that hangs cannot be joined, and its resources cannot be released.
        std::process::exit(EXIT_HUNG);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_silence_is_told_once_and_the_next_one_again() {
        let mut lane = LaneHealth::new("touch", 3, Nanos::from_millis(5));
        let at = Nanos::from_millis;
        for (now, is_heard, alive, told) in [
            (at(100), true, true, None),
            (at(150), false, true, None),
            (at(350), false, false, Some("lane touch has been silent for 0.25 s")),
            (at(450), false, false, None),
            (at(500), true, true, None),
            (at(601), false, false, Some("lane touch has been silent for 0.10 s")),
        ] {
            lane.heard = is_heard;
            assert_eq!(lane.silence(now).is_none(), alive, "{now:?}");
            let said = lane.told(now);
            assert_eq!(said.is_some(), told.is_some(), "{now:?}: {said:?}");
            assert!(said.unwrap_or_default().starts_with(told.unwrap_or_default()));
        }
    }
}
