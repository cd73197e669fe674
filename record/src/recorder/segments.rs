//! The thread's side of a recorder: files one after another, and what happens when the disk is
//! full, fails, or has to make room.

use std::collections::BTreeMap;
use std::io::{Seek, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use taktil_rtcore::Nanos;
use taktil_rtcore::linux::wall_clock;
use taktil_rtcore::record::{Catalog, Observer, Record};

use super::note::{Ending, Note};
use super::{Progress, RecordingOptions, decode_gap, folder};
use crate::companion::Companion;
use crate::file::LogFile;
use crate::writer::WriteFailure;
use crate::{CHUNK_SPAN, Gap, METADATA_END, McapLog, TIME_BASE_KEY};

/// Time from a failure of the disk to the next trial, and between two looks at its room.
const DISK_CHECK_PERIOD: Nanos = Nanos::from_secs(1);
/// Share of the floor that must be free beyond it before recording goes on: a disk at the floor
/// would begin a file for each tenth of a second.
const FLOOR_HYSTERESIS: u64 = 10;

/// What the thread asks of a disk; the tests have one that fails when it is told to.
pub(super) trait Disk: Send + 'static {
    /// A file that is being written.
    type File: LogOutput;
    /// Opens a file for one writer.
    ///
    /// # Errors
    /// As [`LogFile::open`].
    fn open(&self, path: &Path) -> anyhow::Result<Self::File>;
    /// Renames what is at a path after the instant at which it was written last.
    ///
    /// # Errors
    /// As [`folder::set_aside`].
    fn set_aside(&self, path: &Path) -> anyhow::Result<Option<PathBuf>>;
    /// Deletes a recording that was set aside.
    ///
    /// # Errors
    /// What the kernel refuses.
    fn remove(&self, path: &Path) -> std::io::Result<()>;
    /// Bytes that this user may still write into a folder; none when that is unknown.
    fn free_bytes(&self, folder: &Path) -> Option<u64>;
}

/// A file that is being written.
pub(super) trait LogOutput: Write + Seek + Send {
    /// Closes a file whose last write failed, in a few bytes and without an index.
    ///
    /// # Errors
    /// Not even these could be written; nothing of them is left.
    fn close_short(&mut self, why: &str) -> std::io::Result<()>;
}

/// The disk of the kernel.
pub(super) struct KernelDisk;

impl Disk for KernelDisk {
    type File = LogFile;

    fn open(&self, path: &Path) -> anyhow::Result<LogFile> {
        LogFile::open(path)
    }

    fn set_aside(&self, path: &Path) -> anyhow::Result<Option<PathBuf>> {
        folder::set_aside(path)
    }

    fn remove(&self, path: &Path) -> std::io::Result<()> {
        std::fs::remove_file(path)
    }

    fn free_bytes(&self, folder: &Path) -> Option<u64> {
        let found = nix::sys::statvfs::statvfs(folder).ok()?;
        Some(found.blocks_available().saturating_mul(found.fragment_size()))
    }
}

impl LogOutput for LogFile {
    fn close_short(&mut self, why: &str) -> std::io::Result<()> {
        LogFile::close_short(self, why)
    }
}

/// The file that is being written.
struct OpenSegment<F: LogOutput> {
    log: McapLog<F>,
    /// Release of its first record.
    first: Nanos,
}

/// Why nothing is written, and when that is tried again.
struct Trouble {
    text: String,
    is_full: bool,
    retry: Nanos,
}

/// Files one after another.
pub(super) struct Segments<D: Disk> {
    disk: D,
    options: RecordingOptions,
    catalog: Catalog,
    metadata: BTreeMap<String, String>,
    /// Metadata that came later, for each file.
    added: Vec<(String, String)>,
    note: Note,
    shared: Arc<Mutex<Progress>>,
    segment: Option<OpenSegment<D::File>>,
    /// What is missing since the last record that was written.
    gap: Option<Gap>,
    trouble: Option<Trouble>,
    own: Progress,
    /// Bytes of files that were closed.
    closed_bytes: u64,
    /// This pass of the thread, and the last one in which a record came (kernel's clock).
    now: Nanos,
    heard: Nanos,
    next_check: Nanos,
    /// Makes the messages of channels for viewers.
    companion: Option<Box<dyn Companion>>,
    /// The wall clock at logical time zero, where there is a companion.
    time_base: Option<Nanos>,
}

impl<D: Disk> Segments<D> {
    pub(super) fn new(
        disk: D,
        options: RecordingOptions,
        catalog: &Catalog,
        metadata: BTreeMap<String, String>,
        note: Note,
        shared: Arc<Mutex<Progress>>,
    ) -> Segments<D> {
        let recording = format!("{}-{}", std::process::id(), wall_clock().0);
        let recording = ("recording".to_owned(), recording);
        Segments {
            disk,
            options,
            catalog: catalog.clone(),
            // What all files of one recording have in common, and no two recordings.
            metadata: metadata.into_iter().chain([recording]).collect(),
            added: Vec::new(),
            note,
            shared,
            segment: None,
            gap: None,
            trouble: None,
            own: Progress::default(),
            closed_bytes: 0,
            now: Nanos::ZERO,
            heard: Nanos::ZERO,
            next_check: Nanos::ZERO,
            companion: None,
            time_base: None,
        }
    }

    /// With channels for viewers.
    pub(super) fn with_companion(self, companion: Option<Box<dyn Companion>>) -> Segments<D> {
        Segments { companion, ..self }
    }

    /// A pass of the thread begins.
    pub(super) fn begin_pass(&mut self, now: Nanos) {
        self.now = now;
    }

    /// A pass of the thread that took so many records ends.
    pub(super) fn end_pass(&mut self, count: usize) {
        if count > 0 {
            self.heard = self.now;
        } else if self.now - self.heard >= CHUNK_SPAN
            && let Some(segment) = &mut self.segment
            && segment.log.has_open_chunk()
        {
            segment.log.flush();
            self.check_segment();
        }
        if self.segment.is_some() && self.now >= self.next_check {
            self.next_check = self.now + DISK_CHECK_PERIOD;
            if let Some(full) = self.lack_of_room(self.options.free_bytes) {
                self.stop_full(full);
            }
        }
        self.publish();
    }

    fn publish(&mut self) {
        let open = self.segment.as_ref().map_or(0, |segment| segment.log.bytes());
        self.own.bytes = self.closed_bytes + open;
        self.own.file = self.segment.as_ref().map(|_| self.options.path.clone());
        self.own.failure = self.trouble.as_ref().map(|trouble| trouble.text.clone());
        self.own.at = self.now;
        // Nobody holds the lock for longer than a copy takes.
        let mut shared = self.shared.lock().unwrap_or_else(PoisonError::into_inner);
        shared.clone_from(&self.own);
    }

    /// What is said when fewer than `least` bytes are free.
    fn lack_of_room(&self, least: u64) -> Option<String> {
        let folder = folder::folder_of(&self.options.path);
        let free = self.disk.free_bytes(folder).filter(|free| *free < least)?;
        Some(format!(
            "{} MB are free in {}, {} MB are the least",
            free / 1_000_000,
            folder.display(),
            least / 1_000_000
        ))
    }

    /// Metadata for this file and those that follow.
    pub(super) fn add_metadata(&mut self, name: String, json: String) {
        if let Some(segment) = &mut self.segment {
            segment.log.write_metadata(&name, &json);
        }
        self.added.push((name, json));
    }

    /// Ends the file; the next record begins another one.
    pub(super) fn pause(&mut self) {
        self.close(&BTreeMap::new());
        self.trouble = None;
        self.publish();
    }

    /// Ends the recording.
    ///
    /// # Errors
    /// Why the disk has not everything.
    pub(super) fn finish(&mut self, result: &BTreeMap<String, String>) -> Result<(), String> {
        let written = self.segment.is_some();
        self.close(result);
        self.publish();
        match &self.trouble {
            Some(trouble) => Err(format!("the log is not complete: {}", trouble.text)),
            None => {
                if written {
                    self.note.write(Ending::Finished, &self.options.path, "");
                }
                Ok(())
            }
        }
    }

    /// Closes the file as a whole log.
    fn close(&mut self, result: &BTreeMap<String, String>) {
        let Some(mut segment) = self.segment.take() else { return };
        self.closed_bytes += segment.log.bytes();
        segment.log.close(result);
        // Closing fails as writing does: what is missing then is the open chunk.
        if segment.log.write_failure().is_some() {
            self.give_up(segment);
        }
    }

    /// Ends the file because the disk has no room, while there is enough for its summary.
    fn stop_full(&mut self, text: String) {
        if let Some(segment) = &mut self.segment {
            segment.log.write_metadata(METADATA_END, &end_text("disk full", &text));
        }
        self.close(&BTreeMap::new());
        self.note.write(Ending::DiskFull, &self.options.path, &text);
        let retry = self.now + DISK_CHECK_PERIOD;
        self.trouble = Some(Trouble { text, is_full: true, retry });
    }

    /// Leaves a file that cannot be written any more as whole as it can be.
    fn give_up(&mut self, segment: OpenSegment<D::File>) {
        let log = segment.log;
        let failure = log.write_failure().cloned().unwrap_or_else(|| WriteFailure {
            text: "the log could not be closed".to_owned(),
            is_full: false,
        });
        let text = format!("{}: {}", self.options.path.display(), failure.text);
        if let Some(from) = log.lost_from() {
            self.own.lost += log.lost();
            let to = from + CHUNK_SPAN;
            self.add_gap(Gap { from, to, records: log.lost(), cause: text.clone() });
        }
        if let Some(mut file) = log.into_file() {
            // What does not fit stands in the note.
            let cause = if failure.is_full { "disk full" } else { "failure" };
            let _ = file.close_short(&end_text(cause, &failure.text));
        }
        let ending = if failure.is_full { Ending::DiskFull } else { Ending::Failed };
        self.note.write(ending, &self.options.path, &text);
        let retry = self.now + DISK_CHECK_PERIOD;
        self.trouble = Some(Trouble { text, is_full: failure.is_full, retry });
    }

    fn add_gap(&mut self, more: Gap) {
        match &mut self.gap {
            None => self.gap = Some(more),
            Some(gap) => {
                (gap.from, gap.to) = (gap.from.min(more.from), gap.to.max(more.to));
                gap.records += more.records;
            }
        }
    }

    /// Looks whether the last write went through, and whether the file has its size.
    fn check_segment(&mut self) {
        let Some(segment) = &self.segment else { return };
        if segment.log.write_failure().is_some() {
            self.closed_bytes += segment.log.bytes();
            if let Some(segment) = self.segment.take() {
                self.give_up(segment);
            }
        }
    }

    /// Begins a file; why not, otherwise.
    fn open(&mut self, release: Nanos) -> Result<(), Trouble> {
        let trouble = |text: String, is_full: bool, now: Nanos| Trouble {
            text,
            is_full,
            retry: now + DISK_CHECK_PERIOD,
        };
        let full = self.trouble.as_ref().is_some_and(|trouble| trouble.is_full);
        let margin = if full { self.options.free_bytes / FLOOR_HYSTERESIS } else { 0 };
        if let Some(text) = self.lack_of_room(self.options.free_bytes + margin) {
            return Err(trouble(text, true, self.now));
        }
        let path = &self.options.path;
        let failed = |error: anyhow::Error| trouble(format!("{error:#}"), false, self.now);
        self.disk.set_aside(path).map_err(failed)?;
        let room = self.options.budget_bytes.saturating_sub(self.options.rotate_bytes);
        let old = folder::old_segments(path);
        for segment in folder::surplus(&old, room) {
            // One that cannot be deleted is counted again next time.
            let _ = self.disk.remove(&segment.path);
        }
        self.note.write(Ending::Recording, path, "");
        let file = self.disk.open(path).map_err(failed)?;
        let mut metadata = self.metadata.clone();
        metadata.insert("segment".to_owned(), (self.own.segments + 1).to_string());
        metadata.insert("began_unix_ns".to_owned(), wall_clock().0.to_string());
        let base = *self.time_base.get_or_insert_with(|| wall_clock() - release);
        if self.companion.is_some() {
            metadata.insert(TIME_BASE_KEY.to_owned(), base.0.to_string());
        }
        let mut log = McapLog::start(file, path, &self.catalog, &metadata).map_err(failed)?;
        if let Some(companion) = &mut self.companion {
            log.add_companion(&**companion, base);
            companion.begin(base + release, &mut |channel, body| {
                log.write_companion(channel, release, body);
            });
            log.attach_companion_files(&**companion);
        }
        for (name, json) in &self.added {
            log.write_metadata(name, json);
        }
        if let Some(gap) = &self.gap {
            log.write_gap(gap);
        }
        if let Some(failure) = log.write_failure() {
            return Err(trouble(failure.text.clone(), failure.is_full, self.now));
        }
        self.gap = None;
        self.own.segments += 1;
        self.segment = Some(OpenSegment { log, first: release });
        self.trouble = None;
        Ok(())
    }

    /// Whether there is a file for a record; begins one if it is time.
    fn is_ready(&mut self, release: Nanos) -> bool {
        if self.segment.is_some() {
            return true;
        }
        if self.trouble.as_ref().is_some_and(|trouble| self.now < trouble.retry) {
            return false;
        }
        match self.open(release) {
            Ok(()) => true,
            Err(trouble) => {
                let ending = if trouble.is_full { Ending::DiskFull } else { Ending::Failed };
                self.note.write(ending, &self.options.path, &trouble.text);
                self.trouble = Some(trouble);
                false
            }
        }
    }
}

impl<D: Disk> Observer for Segments<D> {
    fn record(&mut self, record: &Record<'_>) {
        if record.signal == self.catalog.signals.len() {
            // Its records were counted in front of the queue.
            if let Some(gap) = decode_gap(record.body) {
                match &mut self.segment {
                    Some(segment) => segment.log.write_gap(&gap),
                    None => self.add_gap(gap),
                }
            }
            return;
        }
        if !self.is_ready(record.release) {
            self.own.lost += 1;
            match &mut self.gap {
                Some(gap) => gap.extend(record.release),
                None => {
                    let cause = self.trouble.as_ref().map_or("", |trouble| &*trouble.text);
                    self.gap = Some(Gap::new(record.release, cause));
                }
            }
            return;
        }
        let Some(segment) = &mut self.segment else { return };
        segment.log.record(record);
        if let (Some(companion), Some(base)) = (&mut self.companion, self.time_base) {
            companion.record(record, base + record.release, &mut |channel, body| {
                segment.log.write_companion(channel, record.release, body);
            });
        }
        let old = |after: Nanos| record.release - segment.first >= after;
        let due = segment.log.bytes() >= self.options.rotate_bytes
            || self.options.rotate_after.is_some_and(old);
        if due {
            self.close(&BTreeMap::new());
        } else {
            self.check_segment();
        }
    }
}

/// The value of the metadata record that says why a file ends.
fn end_text(cause: &str, text: &str) -> String {
    serde_json::json!({ "cause": cause, "text": text }).to_string()
}
