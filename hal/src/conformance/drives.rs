//! Checks of the output half of drives that close a loop: refusals that name their channel, a way
//! to no torque from any state. Whether a drive follows is not judged, because that takes its
//! motor.

use super::inputs::check_channels;
use super::outputs::{accepted, check_silence};
use super::{CycleDriver, Report, Violation};
use crate::drive::{DriveCommand, DriveOut, DriveRequest};
use crate::reading::CHANNELS;

/// Whether one of the drives has torque, seen from outside.
type ObservePower<'a> = Option<&'a mut dyn FnMut() -> bool>;

/// Cycles in which a drive is asked to follow: fewer than any drive may take.
const FOLLOW_CYCLES: usize = 2;

/// Exercises the output half of drives over the whole range of their targets, and leaves them
/// without torque. Answers alone are judged.
pub fn check_drive_out(device: &mut dyn DriveOut, bench: &mut CycleDriver<'_>) -> Vec<Violation> {
    DriveOutCheck { report: Report::default(), device, bench, observe: None }.run()
}

/// Like [`check_drive_out`], and looks after every call for the safe state whether `observe` sees
/// torque. `observe` may let a simulated world move on until the last word has acted.
pub fn check_drive_out_observed(
    device: &mut dyn DriveOut,
    bench: &mut CycleDriver<'_>,
    observe: &mut dyn FnMut() -> bool,
) -> Vec<Violation> {
    DriveOutCheck { report: Report::default(), device, bench, observe: Some(observe) }.run()
}

/// Asks the drives to follow for some cycles, drops the half and expects no torque.
pub fn check_drive_out_drop(
    mut device: Box<dyn DriveOut>,
    bench: &mut CycleDriver<'_>,
    observe: &mut dyn FnMut() -> bool,
) -> Vec<Violation> {
    let mut report = Report::default();
    let follow = DriveCommand { request: DriveRequest::Follow, ..DriveCommand::SAFE };
    for _ in 0..bench.cycles() {
        let _ = device.commit(bench.release(), &follow);
    }
    drop(device);
    let has_torque = observe();
    report
        .require(!has_torque, "drop-is-safe", || "after drop a drive still has torque".to_owned());
    report.found
}

struct DriveOutCheck<'a, 'b> {
    report: Report,
    device: &'a mut dyn DriveOut,
    bench: &'a mut CycleDriver<'b>,
    observe: ObservePower<'a>,
}

impl DriveOutCheck<'_, '_> {
    fn run(mut self) -> Vec<Violation> {
        let channels = self.device.channels();
        let constants = (self.device.control_loop(), self.device.target_range());
        let silence = self.device.longest_silence();
        let (low, high) = constants.1;
        self.report.require(low < high, "range-ordered", || format!("{low} to {high}"));
        self.safe("before the first commit");
        for target in [low, high, 0_i32.clamp(low, high.max(low))] {
            self.commit(DriveRequest::Off, [target; CHANNELS]);
        }
        for request in DriveRequest::ALL {
            self.refusals(request, low, high);
        }
        let mut unused = [i32::MAX; CHANNELS];
        unused.iter_mut().take(channels).for_each(|target| *target = low);
        self.commit(DriveRequest::Off, unused);
        for _ in 0..FOLLOW_CYCLES {
            self.commit(DriveRequest::Follow, [0; CHANNELS]);
        }
        self.safe("after a request to follow");
        self.safe("a second time");
        self.commit(DriveRequest::QuickStop, [0; CHANNELS]);
        self.safe("after a quick stop");
        check_channels(&mut self.report, channels, self.device.channels());
        check_silence(&mut self.report, silence, self.device.longest_silence());
        let after = (self.device.control_loop(), self.device.target_range());
        self.report.require(after == constants, "constants-constant", || {
            format!("loop and range of targets became {after:?}")
        });
        self.report.found
    }

    fn commit(&mut self, request: DriveRequest, targets: [i32; CHANNELS]) {
        let command = DriveCommand { targets, request, reset: false };
        let answer = self.device.commit(self.bench.release(), &command);
        accepted(&mut self.report, "range-accepted", answer);
    }

    /// A target outside on either side is refused with its channel, whatever is asked for.
    fn refusals(&mut self, request: DriveRequest, low: i32, high: i32) {
        for channel in 0..self.device.channels().min(CHANNELS) {
            for target in [low.checked_sub(1), high.checked_add(1)].into_iter().flatten() {
                let mut targets = [0_i32.clamp(low, high.max(low)); CHANNELS];
                targets[channel] = target;
                let command = DriveCommand { targets, request, reset: false };
                let answer = self.device.commit(self.bench.release(), &command);
                self.report.refusal(channel, format_args!("target {target}"), answer);
            }
        }
        self.safe("after a refused commit");
    }

    fn safe(&mut self, when: &str) {
        accepted(&mut self.report, "safe-from-any-state", self.device.safe());
        if let Some(observe) = self.observe.as_mut() {
            let has_torque = observe();
            self.report.require(!has_torque, "safe-reached", || {
                format!("{when} a drive still has torque")
            });
        }
    }
}
