//! Frames: an image is published only from a frame that came new and whole, its number is newer
//! than the one before, and a machine that moves by touch does not go on without.

use taktil_hal::Nanos;
use taktil_hal::fault::FaultKind;
use taktil_rtcore::Mode;
use taktil_signal::State;

use super::{Findings, Weather, mode_of, state_of};
use crate::evidence::{Tick, Touch};

/// Longest time without a good frame in which the arm may go on by touch: the age at which a frame
/// is stale, the time for which its loss is bridged, and two periods of the lane and the servo.
const BLIND_TIME: Nanos = Nanos::from_millis(65);
/// Age at which the touch lane counts as silent, and what a reaction takes.
const SILENT_TIME: Nanos = Nanos::from_millis(130);

/// What the rules about touch remember.
#[derive(Debug, Default)]
pub(super) struct TouchCheck {
    /// When the last good frame came.
    good: Option<Nanos>,
    /// When the lane had its last job.
    job: Option<Nanos>,
    sequence: Option<u32>,
}

impl TouchCheck {
    pub(super) fn frame(&mut self, touch: &Touch, weather: &Weather, findings: &mut Findings) {
        let now = touch.release;
        self.job = Some(now);
        let good = touch.answered && touch.new;
        if touch.image && !good {
            findings.report("an image is of a new frame", now, || {
                format!("published with answered {} new {}", touch.answered, touch.new)
            });
        }
        if good {
            let repeated = self.sequence.is_some_and(|last| touch.sequence == last);
            let broken = |name: &str, kind| name == "tactile" && kind == FaultKind::Duplication;
            if repeated && !weather.has(now, Nanos::from_millis(20), broken) {
                findings.report("frames are counted", now, || format!("{} twice", touch.sequence));
            }
            self.sequence = Some(touch.sequence);
            self.good = Some(now);
        }
    }

    pub(super) fn tick(&mut self, tick: &Tick, weather: &Weather, findings: &mut Findings) {
        let now = tick.release;
        self.silence(tick, weather, findings);
        let by_touch = state_of(tick) == Some(State::TactileServo)
            && mode_of(tick) == Some(Mode::Moving)
            && !weather.has_panicked(now)
            && !weather.is_late(now);
        if !by_touch {
            return;
        }
        if let Some(good) = self.good.filter(|good| now - *good > BLIND_TIME) {
            findings.report("no motion by touch without frames", now, || {
                format!("the last one came {} ago", now - good)
            });
        }
    }

    /// A lane that has no jobs any more stops an arm in whatever state.
    fn silence(&self, tick: &Tick, weather: &Weather, findings: &mut Findings) {
        let now = tick.release;
        let goes_on = matches!(mode_of(tick), Some(Mode::Hold | Mode::Moving));
        if !goes_on || weather.has_panicked(now) || weather.is_late(now) {
            return;
        }
        if let Some(job) = self.job.filter(|job| now - *job > SILENT_TIME) {
            findings.report("a silent touch lane stops the arm", now, || {
                format!("its last job was {} ago", now - job)
            });
        }
    }
}
