//! Drives ethercrab from the calling thread: its futures are polled here, its frames go out and
//! come in between two polls, and a wait that is over drops what has not been answered. There is no
//! task of its own and no reactor.
//!
//! What ethercrab needs for as long as a program runs is leaked when a segment is opened: its
//! frames and itself, some 25 kB. A program opens a segment once.

use core::any::Any;
use core::future::Future;
use core::pin::pin;
use core::task::{Context, Poll, Waker};
use core::time::Duration;
use std::panic::{AssertUnwindSafe, catch_unwind};

use ethercrab::error::Error;
use ethercrab::subdevice_group::PreOp;
use ethercrab::{
    DefaultLock, MainDevice, MainDeviceConfig, PduRx, PduStorage, PduTx, ReceiveAction,
    RetryBehaviour, SubDeviceGroup, Timeouts,
};
use taktil_hal::Nanos;

use crate::config::DEVICES_MAX;
use crate::emergency::emergency_code;
use crate::port::Port;
use crate::ticks;

/// Bytes of process data, in both directions.
pub(crate) const IMAGE_BYTES_MAX: usize = 1_024;
/// Frames that ethercrab may have under way.
const FRAMES_MAX: usize = 16;
/// Payload of one frame.
pub(crate) const FRAME_PAYLOAD_BYTES: usize = 1_400;
/// Room for a frame that arrives.
const BUFFER_BYTES: usize = 1_536;
/// How long one frame of the set-up is waited for before it is sent again.
const SETUP_FRAME_TIME: Duration = Duration::from_millis(20);
/// How often a frame of the set-up is sent again: each emergency message that waits in a mailbox
/// takes one of them.
const SETUP_RETRIES_MAX: usize = 20;
/// From one look at a state to the next while the set-up waits for it.
const SETUP_LOOK_TIME: Duration = Duration::from_millis(1);
/// How long a mailbox answer is waited for.
const MAILBOX_TIME: Duration = Duration::from_millis(1_000);
/// How long one access to an information memory may take.
const INFORMATION_TIME: Duration = Duration::from_millis(200);
/// Longest sleep of the set-up between two polls.
const SETUP_WAIT: Nanos = Nanos::from_micros(500);
/// Frames that follow the segment's time when it is set up.
const CLOCK_FRAMES_COUNT: u32 = 100;
/// Most polls of one exchange: each frame that arrives leads to one.
const POLLS_MAX: usize = 64;

/// Frames and their buffers.
type Storage = PduStorage<FRAMES_MAX, { PduStorage::element_size(FRAME_PAYLOAD_BYTES) }>;

/// The devices of a segment in a state.
pub(crate) type Group<S> = SubDeviceGroup<DEVICES_MAX, IMAGE_BYTES_MAX, DefaultLock, S>;

/// What was counted on the cable.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct CableCounts {
    /// Frames that answer nothing that is still waited for, or that cannot be read.
    pub(crate) stray_frames: u64,
    /// Frames that the system did not take.
    pub(crate) send_failures: u64,
    /// Emergency messages that were set aside while the segment was set up.
    pub(crate) emergencies: u64,
}

/// ethercrab with its cable.
pub(crate) struct Master {
    port: Box<dyn Port>,
    tx: PduTx<'static>,
    rx: PduRx<'static>,
    device: &'static MainDevice<'static>,
    buffer: [u8; BUFFER_BYTES],
    elapsed: Nanos,
    pub(crate) counts: CableCounts,
    /// The newest emergency code.
    pub(crate) emergency: u16,
}

/// Why a step of the set-up failed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum SetupError<E> {
    /// Its time was over, and no frame had come.
    Silence,
    /// Its time was over, and frames had come.
    Endless,
    /// A panic at what the devices said, with its text.
    Unreadable(String),
    /// What ethercrab says.
    Refused(E),
}

impl Master {
    /// A master at the end of a cable; nothing is sent.
    pub(crate) fn new(port: Box<dyn Port>, open_wait: Nanos) -> Option<Master> {
        let storage: &'static Storage = Box::leak(Box::new(Storage::new()));
        let (tx, rx, frames) = storage.try_split().ok()?;
        let timeouts = Timeouts {
            state_transition: Duration::from_nanos(open_wait.0.max(0).cast_unsigned()),
            pdu: SETUP_FRAME_TIME,
            eeprom: INFORMATION_TIME,
            wait_loop_delay: SETUP_LOOK_TIME,
            mailbox_echo: MAILBOX_TIME,
            mailbox_response: MAILBOX_TIME,
        };
        let config = MainDeviceConfig {
            dc_static_sync_iterations: CLOCK_FRAMES_COUNT,
            retry_behaviour: RetryBehaviour::Count(SETUP_RETRIES_MAX),
        };
        let device = Box::leak(Box::new(MainDevice::new(frames, timeouts, config)));
        Some(Master {
            port,
            tx,
            rx,
            device,
            buffer: [0; BUFFER_BYTES],
            elapsed: Nanos::ZERO,
            counts: CableCounts::default(),
            emergency: 0,
        })
    }

    /// ethercrab.
    pub(crate) fn device(&self) -> &'static MainDevice<'static> {
        self.device
    }

    /// Runs a step of the set-up to its end, at most for `limit`.
    ///
    /// ethercrab trusts lengths and addresses in the devices' information memories. Damaged ones
    /// make it panic, because its arithmetic is checked in every profile: without that they would
    /// lead it round in circles until the time is over. The master is good for nothing but being
    /// dropped then.
    pub(crate) fn set_up<T, E>(
        &mut self,
        limit: Nanos,
        step: impl Future<Output = Result<T, E>>,
    ) -> Result<T, SetupError<E>> {
        let mut step = pin!(step);
        let mut context = Context::from_waker(Waker::noop());
        self.elapsed = self.port.elapsed();
        let end = self.elapsed + limit;
        let mut is_heard = false;
        while self.elapsed <= end {
            ticks::set(self.elapsed);
            let polled = catch_unwind(AssertUnwindSafe(|| step.as_mut().poll(&mut context)));
            let polled = polled.map_err(|panic| SetupError::Unreadable(text_of(&*panic)))?;
            if let Poll::Ready(outcome) = polled {
                return outcome.map_err(SetupError::Refused);
            }
            self.send();
            self.port.start_wait(SETUP_WAIT);
            if let Some(bytes) = self.port.receive(&mut self.buffer) {
                let frame = &self.buffer[..bytes.min(BUFFER_BYTES)];
                // The library ends the program at an emergency message. The frame is lost to it: it
                // asks again, and the mailbox then holds the answer that is waited for.
                if let Some(code) = emergency_code(frame) {
                    self.counts.emergencies += 1;
                    self.emergency = code;
                } else {
                    is_heard |= take(&mut self.rx, frame, &mut self.counts);
                }
            }
            self.elapsed = self.port.elapsed();
        }
        Err(if is_heard { SetupError::Endless } else { SetupError::Silence })
    }

    /// Polls a request for the first time and hands its frames over; its answer, where it ends
    /// without any.
    pub(crate) fn start<A>(
        &mut self,
        mut poll: impl FnMut(&mut Context<'_>) -> Poll<A>,
    ) -> Option<A> {
        // The timers inside stand still: whoever collects the answer ends the request.
        ticks::set(self.elapsed);
        if let Poll::Ready(answer) = poll(&mut Context::from_waker(Waker::noop())) {
            return Some(answer);
        }
        self.send();
        None
    }

    /// Takes the frames that have come, and waits for more at most for `wait`, until a request that
    /// was started is complete; `None` when that was not enough.
    pub(crate) fn wait_for<A>(
        &mut self,
        wait: Nanos,
        mut poll: impl FnMut(&mut Context<'_>) -> Poll<A>,
    ) -> Option<A> {
        let mut context = Context::from_waker(Waker::noop());
        ticks::set(self.elapsed);
        self.port.start_wait(wait);
        for _ in 0..POLLS_MAX {
            // The answer may have come while that of another request was taken.
            if let Poll::Ready(answer) = poll(&mut context) {
                return Some(answer);
            }
            // A request of several frames sends the next one.
            self.send();
            let bytes = self.port.receive(&mut self.buffer)?;
            take(&mut self.rx, &self.buffer[..bytes.min(BUFFER_BYTES)], &mut self.counts);
        }
        None
    }

    /// Hands all frames over that wait for it.
    fn send(&mut self) {
        for _ in 0..FRAMES_MAX {
            let Some(frame) = self.tx.next_sendable_frame() else { return };
            let port = &mut self.port;
            let mut is_lost = false;
            let _ = frame.send_blocking(|bytes| {
                // A frame that is not taken is lost on the cable: nobody sends it again by itself.
                is_lost = port.send(bytes).is_err();
                Ok(bytes.len())
            });
            self.counts.send_failures += u64::from(is_lost);
        }
    }
}

/// What a panic says.
fn text_of(panic: &(dyn Any + Send)) -> String {
    let fixed = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
    fixed.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_default()
}

/// Hands a frame to ethercrab; whether it answers something that is waited for.
fn take(rx: &mut PduRx<'static>, frame: &[u8], counts: &mut CableCounts) -> bool {
    let is_answer = rx.receive_frame(frame) == Ok(ReceiveAction::Processed);
    counts.stray_frames += u64::from(!is_answer);
    is_answer
}

/// Finds the devices and leads them to PREOP.
pub(crate) async fn discover(
    device: &'static MainDevice<'static>,
) -> Result<Box<Group<PreOp>>, Error> {
    let group = device.init_single_group::<DEVICES_MAX, IMAGE_BYTES_MAX>(ticks::nanos).await?;
    Ok(Box::new(group))
}
