//! One exchange of process data: what is sent, when its answer is collected, and what the answer
//! says of the devices.
//!
//! The image of the process data is locked while its frame is under way: outputs are put into it
//! before the frame is sent, inputs are taken out of it once the answer has been collected or
//! given up.

use std::sync::Arc;

use ethercrab::error::Error as LibraryError;
use ethercrab::subdevice_group::SafeOp;
use ethercrab::{Command, MainDevice, SubDeviceState};
use taktil_drivers_exchange::Failure;
use taktil_hal::{ErrorKind, Nanos};

use super::Bus;
use crate::config::ExchangeTimes;
use crate::master::Group;
use crate::transfer::Transfer;

/// Register that asks for a state.
const AL_CONTROL_ADDRESS: u16 = 0x0120;

/// What the answer to a frame with the process data says.
#[derive(Clone, Copy, Debug)]
pub(super) struct ImageAnswer {
    counter: u16,
    /// All devices are in OP.
    operates: bool,
    /// The first device that is not.
    outside: Option<usize>,
    /// When the frame passed the reference clock (ns).
    time_ns: Option<u64>,
}

impl ImageAnswer {
    fn new(devices: usize, counter: u16, states: &[SubDeviceState], time_ns: Option<u64>) -> Self {
        let outside = states.iter().position(|state| *state != SubDeviceState::Op);
        let operates = states.len() == devices && outside.is_none();
        ImageAnswer { counter, operates, outside, time_ns }
    }
}

/// A request of a state.
#[derive(Clone, Copy, Debug)]
pub(super) struct StateRequest {
    /// The device that is asked; `None` for all of them.
    pub(super) device: Option<usize>,
    /// The word for its register of the state.
    pub(super) word: u16,
}

type Images = Transfer<(), Result<ImageAnswer, LibraryError>>;
type States = Transfer<StateRequest, Result<(), LibraryError>>;

/// The requests of a segment: process data, with the time of the reference clock where there is
/// one, and states.
pub(super) fn transfers(
    device: &'static MainDevice<'static>,
    group: &Arc<Group<SafeOp>>,
    has_clock: bool,
) -> (Images, States) {
    let all = group.clone();
    let images = Transfer::new(move |()| {
        let group = all.clone();
        async move {
            if has_clock {
                let answer = group.tx_rx_sync_system_time(device).await?;
                let (counter, time_ns) = (answer.working_counter, answer.extra);
                Ok(ImageAnswer::new(group.len(), counter, &answer.subdevice_states, time_ns))
            } else {
                let answer = group.tx_rx(device).await?;
                let counter = answer.working_counter;
                Ok(ImageAnswer::new(group.len(), counter, &answer.subdevice_states, None))
            }
        }
    });
    let all = group.clone();
    let states = Transfer::new(move |StateRequest { device: asked, word }| {
        let group = all.clone();
        async move {
            match asked {
                Some(index) => {
                    let one = group.subdevice(device, index)?;
                    one.register_write(AL_CONTROL_ADDRESS, word).await.map(|_: u16| ())
                }
                None => {
                    let request = Command::bwr(AL_CONTROL_ADDRESS).ignore_wkc();
                    request.send(device, word).await
                }
            }
        }
    });
    (images, states)
}

impl Bus {
    /// Exchanges the process data for the job released at `release`; `steps`: the machines of the
    /// drives are stepped as well. The outcome is that of the frame whose answer is collected.
    pub(super) fn exchange(&mut self, release: Nanos, steps: bool) -> Result<(), ErrorKind> {
        let outcome = match (self.lost, self.exchange) {
            (true, _) => Err(ErrorKind::Lost),
            (false, ExchangeTimes::Pipelined) => self.exchange_pipelined(release, steps),
            (false, ExchangeTimes::Twice | ExchangeTimes::Once) => {
                self.send(release, steps);
                self.collect(release, self.spans.wait)
            }
        };
        self.exchanged = Some((release, outcome));
        outcome
    }

    /// Collects the answer to the frame of the cycle before, as far as it has come, and sends the
    /// next frame.
    fn exchange_pipelined(&mut self, release: Nanos, steps: bool) -> Result<(), ErrorKind> {
        self.finish_recovery(Nanos::ZERO);
        // The first frame has none before it, and its outputs are on their way all the same.
        let mut outcome = Ok(());
        self.reading = Err(Failure::whole(ErrorKind::Transient));
        if self.image.is_under_way() {
            outcome = self.collect(release, Nanos::ZERO);
            self.reading = match outcome {
                Ok(()) => self.snapshot(self.sent),
                Err(kind) => Err(Failure::whole(kind)),
            };
        }
        if !self.lost {
            self.send(release, steps);
        }
        outcome
    }

    /// Puts the outputs out, whatever is under way, and also where the devices count as gone:
    /// whoever still hears it goes safe.
    pub(super) fn put_out_at_once(&mut self, release: Nanos) -> Result<(), ErrorKind> {
        let is_pipelined = self.exchange == ExchangeTimes::Pipelined;
        if !self.lost && !is_pipelined {
            return self.exchange(release, true);
        }
        if self.image.is_under_way() {
            match self.image.collect(&mut self.master, Nanos::ZERO) {
                Some(answer) => drop(self.judge(release, Some(answer))),
                // The frame was given no cycle to come back.
                None => self.health.seen.timeouts += 1,
            }
        }
        self.send(release, true);
        if !is_pipelined {
            let _ = self.image.collect(&mut self.master, self.spans.wait);
            self.image.give_up();
        }
        if self.lost { Err(ErrorKind::Lost) } else { Ok(()) }
    }

    /// Writes the outputs into the image and sends it; a frame that is under way is given up.
    pub(super) fn send(&mut self, release: Nanos, steps: bool) {
        self.image.give_up();
        self.put_out(release, steps);
        self.recovery.is_followed = self.recovery.is_made;
        self.health.seen.exchanges += 1;
        self.sent = release;
        self.image.begin(&mut self.master, ());
    }

    /// Collects the answer of the frame that is under way; who has not answered within `wait` is
    /// not waited for any more.
    fn collect(&mut self, release: Nanos, wait: Nanos) -> Result<(), ErrorKind> {
        let answer = self.image.collect(&mut self.master, wait);
        self.image.give_up();
        self.judge(release, answer)
    }

    fn judge(
        &mut self,
        release: Nanos,
        answer: Option<Result<ImageAnswer, LibraryError>>,
    ) -> Result<(), ErrorKind> {
        self.frame_time_ns = None;
        // What a frame from before the request says of the states is not its effect.
        self.recovery.is_made &= !core::mem::take(&mut self.recovery.is_followed);
        let is_good = match answer {
            Some(Ok(answer)) => {
                self.frame_time_ns = answer.time_ns;
                self.take_states(&answer);
                let is_whole = answer.counter == self.wiring.counter;
                self.health.seen.wrong_counters += u64::from(!is_whole);
                is_whole
            }
            Some(Err(error)) => {
                self.count(&error);
                false
            }
            None => {
                self.health.seen.timeouts += 1;
                false
            }
        };
        if is_good {
            self.health.seen.answers += 1;
            self.health.level.hit(release);
            self.take_reports();
            return if self.health.level.is_failed() { Err(ErrorKind::Stale) } else { Ok(()) };
        }
        self.lost |= self.health.level.miss(release) > self.spans.lost_after;
        Err(if self.lost {
            ErrorKind::Lost
        } else if self.health.level.is_failed() {
            ErrorKind::Stale
        } else {
            ErrorKind::Transient
        })
    }

    fn count(&mut self, error: &LibraryError) {
        // A device that is gone answers neither the image nor the question for its state.
        let is_counter = matches!(error, LibraryError::WorkingCounter { .. });
        self.health.seen.wrong_counters += u64::from(is_counter);
        self.health.seen.broken_exchanges += u64::from(!is_counter);
    }

    fn take_states(&mut self, answer: &ImageAnswer) {
        if self.operates && !answer.operates {
            self.health.seen.state_drops += 1;
            self.is_blocked |= self.wants_drives();
        }
        self.operates = answer.operates;
        self.recovery.has_asked_all &= !answer.operates;
        if let Some(device) = answer.outside {
            if device != self.recovery.device {
                self.recovery.acknowledges = false;
            }
            self.recovery.device = device;
        }
    }

    /// Lets the drives report.
    fn take_reports(&mut self) {
        let device = self.master.device();
        for drive in &mut self.drives {
            let Ok(one) = self.group.subdevice(device, drive.device()) else { continue };
            if drive.report(&one.inputs_raw()) {
                self.health.seen.drive_faults += 1;
                self.health.seen.newest_fault_device = drive.device() as u64 + 1;
                self.health.seen.newest_fault_code = 0;
            }
            let is_newest = self.health.seen.newest_fault_device == drive.device() as u64 + 1;
            if is_newest && drive.error != 0 {
                self.health.seen.newest_fault_code = u64::from(drive.error);
            }
        }
    }
}
