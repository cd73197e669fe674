//! Records a machine by a thread of its own, the only one that touches the disk. In front of it
//! stands a bounded queue: whoever hands records in neither waits nor asks the kernel, whatever the
//! disk does. What does not fit is counted, and stands in the log as a [`Gap`] when it goes on.
//!
//! The newest segment is always at the path that was given. It is made when the first record of a
//! job comes, so that a start that fails changes nothing; a recording that is there already is
//! renamed after the instant at which it was written last (`run-20261127T084500Z.mcap`), never
//! overwritten. Beside it lies `run.mcap.state`, which its writer keeps locked: it says how the
//! recording ended, in room that was there from the start, thus also of a disk that is full.
#![expect(clippy::disallowed_types, reason = "its thread is there to wait; its front never does")]

mod config;
mod folder;
mod note;
#[cfg(test)]
mod nth_failure;
mod segments;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, TryLockError};
use std::time::Duration;

use anyhow::{anyhow, bail};
use taktil_rtcore::linux::monotonic;
use taktil_rtcore::record::{Catalog, Observer, Record};
use taktil_rtcore::record_ring::{RecordReader, RecordSender, queue};
use taktil_rtcore::{Invalid, Nanos};

pub use config::{LogConfig, RecordingOptions};
pub use note::{Ending, PreviousRecording};

use crate::Gap;
use crate::companion::Companion;
use note::Note;
use segments::{Disk, KernelDisk, Segments};

/// Requests that may wait for the thread.
const COMMANDS_MAX: usize = 32;
/// Longest sleep of the thread while no record comes: a small part of what may be missing.
const POLL_PERIOD: Duration = Duration::from_millis(5);
/// Time without an answer of the disk that is reported as a failure.
const STALL_TOLERANCE: Nanos = Nanos::from_secs(1);
/// Bytes of a gap in the queue: first and last release, number of records.
const GAP_BYTES: usize = 24;

/// What the thread is asked to do.
enum Command {
    Metadata { name: String, json: String },
    Pause,
    Finish(BTreeMap<String, String>),
}

/// What the thread says of itself.
#[derive(Clone, Debug, Default)]
struct Progress {
    file: Option<PathBuf>,
    segments: u64,
    bytes: u64,
    lost: u64,
    failure: Option<String>,
    /// The last instant at which it was seen to work.
    at: Nanos,
}

/// How a recording goes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RecorderHealth {
    /// Records reach the disk, or will when the first one comes.
    pub recording: bool,
    /// Somebody wants them to: false after [`Recorder::set_recording`] with false.
    pub wanted: bool,
    /// The file that is being written; none before the first record and while nothing is written.
    pub file: Option<PathBuf>,
    /// Files begun so far.
    pub segments: u64,
    /// Bytes of messages written so far, in all of them.
    pub bytes: u64,
    /// Records that are in no file.
    pub lost: u64,
    /// How full the queue is, 0 to 1.
    pub queue_fill: f64,
    /// Time since the thread was last seen to work (s).
    pub stalled_s: f64,
    /// Why nothing is written, in words.
    pub failure: Option<String>,
}

/// Records that did not fit the queue.
#[derive(Clone, Copy)]
struct QueueGap {
    from: Nanos,
    to: Nanos,
    records: u64,
}

/// A recording under way: an observer that never waits. Dropping it ends the recording without
/// waiting for it; [`Recorder::finish`] waits a bounded time.
pub struct Recorder {
    sender: RecordSender,
    commands: SyncSender<Command>,
    done: Receiver<Result<(), String>>,
    progress: Arc<Mutex<Progress>>,
    newest: Progress,
    /// Number of the record that stands for a gap: behind the signals of the catalog.
    gap_signal: usize,
    gap: Option<QueueGap>,
    wanted: bool,
    previous: Option<PreviousRecording>,
}

impl Recorder {
    /// Takes the path for this process and starts the thread. `metadata` (configuration, versions,
    /// devices) stands at the beginning of every file.
    ///
    /// # Errors
    /// A path that is no place for a log, or at which another process records: then nothing was
    /// changed. The place is `path`.
    pub fn start(
        options: RecordingOptions,
        catalog: &Catalog,
        metadata: BTreeMap<String, String>,
    ) -> Result<Recorder, Invalid> {
        Recorder::start_on(KernelDisk, options, catalog, metadata)
    }

    /// As [`Recorder::start`], with channels for viewers beside those of the signals.
    ///
    /// # Errors
    /// As [`Recorder::start`].
    pub fn start_with_companion(
        options: RecordingOptions,
        catalog: &Catalog,
        metadata: BTreeMap<String, String>,
        companion: Box<dyn Companion>,
    ) -> Result<Recorder, Invalid> {
        Recorder::start_thread(KernelDisk, options, catalog, metadata, Some(companion))
    }

    fn start_on<D: Disk>(
        disk: D,
        options: RecordingOptions,
        catalog: &Catalog,
        metadata: BTreeMap<String, String>,
    ) -> Result<Recorder, Invalid> {
        Recorder::start_thread(disk, options, catalog, metadata, None)
    }

    fn start_thread<D: Disk>(
        disk: D,
        options: RecordingOptions,
        catalog: &Catalog,
        metadata: BTreeMap<String, String>,
        companion: Option<Box<dyn Companion>>,
    ) -> Result<Recorder, Invalid> {
        folder::check_place(&options.path)?;
        let (note, previous) = Note::take(&options.path)?;
        let (sender, reader) = queue(options.queue_bytes, catalog);
        let progress = Arc::new(Mutex::new(Progress { at: monotonic(), ..Progress::default() }));
        let segments = Segments::new(disk, options, catalog, metadata, note, Arc::clone(&progress));
        let segments = segments.with_companion(companion);
        let (commands, orders) = sync_channel(COMMANDS_MAX);
        let (reply, done) = sync_channel(1);
        let body = move || {
            let ended = write_records(segments, reader, &orders);
            // Nobody waits for it when the recorder was dropped.
            let _ = reply.send(ended);
        };
        std::thread::Builder::new().name("recorder".into()).spawn(body).map_err(|error| {
            Invalid::new("path", format!("no thread can be started: {error}"), "free some memory")
        })?;
        Ok(Recorder {
            sender,
            commands,
            done,
            newest: Progress { at: monotonic(), ..Progress::default() },
            progress,
            gap_signal: catalog.signals.len(),
            gap: None,
            wanted: true,
            previous,
        })
    }

    /// How the recording before this one at the same path ended, if there was one.
    #[must_use]
    pub fn previous(&self) -> Option<&PreviousRecording> {
        self.previous.as_ref()
    }

    /// Writes a metadata record with one value, `json`, into this file and those that follow;
    /// false when too many requests are waiting.
    pub fn write_metadata(&mut self, name: &str, json: &str) -> bool {
        let command = Command::Metadata { name: name.to_owned(), json: json.to_owned() };
        self.commands.try_send(command).is_ok()
    }

    /// Ends the file and records nothing, or goes on with a new one; false when too many requests
    /// are waiting, which means that the disk does not answer.
    pub fn set_recording(&mut self, wanted: bool) -> bool {
        // What is handed in from then on begins a new file.
        let taken = wanted || self.commands.try_send(Command::Pause).is_ok();
        if taken {
            self.wanted = wanted;
        }
        taken
    }

    /// How it goes. Waits for nobody: what the thread is just writing down is reported next time.
    pub fn health(&mut self) -> RecorderHealth {
        match self.progress.try_lock() {
            Ok(progress) => self.newest.clone_from(&progress),
            Err(TryLockError::Poisoned(progress)) => self.newest.clone_from(&progress.into_inner()),
            Err(TryLockError::WouldBlock) => {}
        }
        let stalled = monotonic() - self.newest.at;
        let ended = self.sender.is_abandoned();
        let silent = match () {
            () if ended => Some("the recorder's thread has ended".to_owned()),
            () if stalled >= STALL_TOLERANCE => {
                Some(format!("the disk has not answered for {:.1} s", stalled.as_secs_f64()))
            }
            () => None,
        };
        let failure = silent.or_else(|| self.newest.failure.clone());
        RecorderHealth {
            recording: self.wanted && failure.is_none(),
            wanted: self.wanted,
            file: self.newest.file.clone(),
            segments: self.newest.segments,
            bytes: self.newest.bytes,
            lost: self.sender.lost() + self.newest.lost,
            queue_fill: self.sender.queued_bytes() as f64 / self.sender.capacity_bytes() as f64,
            stalled_s: stalled.as_secs_f64(),
            failure,
        }
    }

    /// Writes what is waiting and `result` (digest, cause of the end; may be empty), closes the
    /// file, and comes back after `timeout` whatever the disk does.
    ///
    /// # Errors
    /// Records are missing, the disk failed, or it did not answer in time; the text says which.
    pub fn finish(
        mut self,
        result: BTreeMap<String, String>,
        timeout: Duration,
    ) -> anyhow::Result<()> {
        // A gap that is still open reaches the log if there is room for it.
        self.send_gap();
        // Without a free place the thread ends when it finds nobody in front of it any more.
        let _ = self.commands.try_send(Command::Finish(result));
        let health = self.health();
        let Recorder { sender, commands, done, .. } = self;
        drop((sender, commands));
        match done.recv_timeout(timeout) {
            Ok(ended) => ended.map_err(|why| anyhow!("{why}"))?,
            Err(RecvTimeoutError::Timeout) => bail!(
                "the log was not closed within {:.1} s: the disk does not answer; what it has \
                 taken can be read",
                timeout.as_secs_f64()
            ),
            Err(RecvTimeoutError::Disconnected) => bail!("the recorder's thread has ended early"),
        }
        if health.lost > 0 {
            bail!("{} records are not in the log; `taktil log info` shows where", health.lost);
        }
        Ok(())
    }

    /// Hands the gap to the thread; false while there is no room for it. A queue that was full is
    /// left alone until half of it is free, or there would be a gap for every other record.
    fn send_gap(&mut self) -> bool {
        let Some(gap) = self.gap else { return true };
        if self.sender.queued_bytes() > self.sender.capacity_bytes() / 2 {
            return false;
        }
        let mut body = [0; GAP_BYTES];
        body[..8].copy_from_slice(&gap.from.0.to_le_bytes());
        body[8..16].copy_from_slice(&gap.to.0.to_le_bytes());
        body[16..].copy_from_slice(&gap.records.to_le_bytes());
        let record = Record { signal: self.gap_signal, tick: 0, release: gap.from, body: &body };
        let sent = self.sender.try_send(&record);
        if sent {
            self.gap = None;
        }
        sent
    }
}

impl Observer for Recorder {
    fn record(&mut self, record: &Record<'_>) {
        if !self.wanted {
            return;
        }
        let fits = self.send_gap() && self.sender.send(record);
        if fits {
            return;
        }
        let release = record.release;
        match &mut self.gap {
            // Counted as lost although it was not tried.
            Some(gap) => {
                (gap.from, gap.to) = (gap.from.min(release), gap.to.max(release));
                gap.records += 1;
                self.sender.count_lost();
            }
            None => self.gap = Some(QueueGap { from: release, to: release, records: 1 }),
        }
    }
}

/// The gap that a record of the queue stands for.
fn decode_gap(body: &[u8]) -> Option<Gap> {
    let word = |at: usize| Some(u64::from_le_bytes(body.get(at..at + 8)?.try_into().ok()?));
    Some(Gap {
        from: Nanos(word(0)?.cast_signed()),
        to: Nanos(word(8)?.cast_signed()),
        records: word(16)?,
        cause: "the queue was full: the disk is slow".to_owned(),
    })
}

/// The thread: takes records out of the queue and requests from the recorder until the end.
fn write_records<D: Disk>(
    mut segments: Segments<D>,
    mut reader: RecordReader,
    orders: &Receiver<Command>,
) -> Result<(), String> {
    loop {
        segments.begin_pass(monotonic());
        let count = reader.drain(&mut segments);
        segments.end_pass(count);
        let order = match orders.recv_timeout(POLL_PERIOD) {
            Err(RecvTimeoutError::Timeout) => continue,
            order => order,
        };
        // What was handed in before the request is written before it.
        reader.drain(&mut segments);
        match order {
            Ok(Command::Metadata { name, json }) => segments.add_metadata(name, json),
            Ok(Command::Pause) => segments.pause(),
            Ok(Command::Finish(result)) => return segments.finish(&result),
            Err(_) => return segments.finish(&BTreeMap::new()),
        }
    }
}
