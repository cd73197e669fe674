//! The service's recording: the recorder, what the operator wants of it, and what is said of it.
#![expect(clippy::disallowed_types, reason = "the lock is tried, and held for a copy")]

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use serde_json::{Value, json};
use taktil_machine_operator::RecordingControl;
use taktil_record::recorder::{Recorder, RecorderHealth};
use taktil_rtcore::Invalid;
use taktil_rtcore::record::{Observer, Record};

/// How long the end of the service waits for the disk.
const FINISH_TIMEOUT: Duration = Duration::from_secs(2);

/// Where the operator's server and the thread of the records meet: neither waits for the other.
pub(crate) struct RecordingDesk {
    is_wanted: AtomicBool,
    health: Mutex<RecorderHealth>,
}

impl RecordingControl for RecordingDesk {
    fn set_recording(&self, on: bool) -> Result<(), Invalid> {
        self.is_wanted.store(on, Ordering::Relaxed);
        Ok(())
    }

    fn report(&self) -> Value {
        let health = self.health.lock().unwrap_or_else(PoisonError::into_inner).clone();
        json!({
            "recording": health.recording,
            "wanted": self.is_wanted.load(Ordering::Relaxed),
            "file": health.file,
            "files": health.segments,
            "bytes": health.bytes,
            "records_lost": health.lost,
            "queue_fill": health.queue_fill,
            "stalled_s": health.stalled_s,
            "failure": health.failure,
        })
    }
}

/// A recorder that does what the operator wants.
pub(crate) struct ServiceRecording {
    recorder: Recorder,
    desk: Arc<RecordingDesk>,
    wanted: bool,
    failure: Option<String>,
}

impl ServiceRecording {
    /// Records from the first job on.
    pub(crate) fn new(recorder: Recorder) -> ServiceRecording {
        let health = Mutex::new(RecorderHealth::default());
        let desk = Arc::new(RecordingDesk { is_wanted: AtomicBool::new(true), health });
        ServiceRecording { recorder, desk, wanted: true, failure: None }
    }

    /// The side of the operator's server.
    pub(crate) fn desk(&self) -> Arc<RecordingDesk> {
        Arc::clone(&self.desk)
    }

    /// Does what the operator wants and reports how it goes. Returns a change that people should
    /// hear of: why nothing is recorded any more, or that it goes on.
    pub(crate) fn look(&mut self) -> Option<Option<String>> {
        let wanted = self.desk.is_wanted.load(Ordering::Relaxed);
        if wanted != self.wanted && self.recorder.set_recording(wanted) {
            self.wanted = wanted;
        }
        let health = self.recorder.health();
        let failure = health.failure.clone();
        // A report that is being read is replaced the next time.
        if let Ok(mut newest) = self.desk.health.try_lock() {
            *newest = health;
        }
        let has_changed = failure.is_some() != self.failure.is_some();
        self.failure.clone_from(&failure);
        has_changed.then_some(failure)
    }

    /// Closes the recording.
    ///
    /// # Errors
    /// As [`Recorder::finish`].
    pub(crate) fn finish(self) -> anyhow::Result<()> {
        self.recorder.finish(BTreeMap::new(), FINISH_TIMEOUT)
    }
}

impl Observer for ServiceRecording {
    fn record(&mut self, record: &Record<'_>) {
        self.recorder.record(record);
    }
}
