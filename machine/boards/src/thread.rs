//! Threads of drivers that exchange with their boards beside the lanes.

use std::thread::JoinHandle;

use taktil_hal::Invalid;
use taktil_machine::device::ThreadConfig;
use taktil_rtcore::linux;

/// The work of a thread, which ends when the halves of its board are dropped.
pub struct DriverThread {
    /// What it does, for the thread's name.
    pub name: &'static str,
    /// The work.
    pub run: Box<dyn FnOnce() + Send>,
}

impl std::fmt::Debug for DriverThread {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("DriverThread").field("name", &self.name).finish_non_exhaustive()
    }
}

/// A thread at work.
#[derive(Debug)]
pub struct RunningThread {
    /// Name of the device.
    pub device: String,
    /// What the kernel did not grant of the section's `thread`, if anything.
    pub missing: Option<String>,
    handle: JoinHandle<()>,
}

impl RunningThread {
    /// Whether it has ended.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        self.handle.is_finished()
    }
}

impl DriverThread {
    /// Starts the thread, scheduled as the section says as far as the kernel grants it.
    pub(crate) fn start(
        self,
        device: &str,
        config: &ThreadConfig,
    ) -> Result<RunningThread, Invalid> {
        let (granted, grants) = std::sync::mpsc::channel();
        let (config, run) = (*config, self.run);
        let name = format!("{}-{device}", self.name);
        let spawned = std::thread::Builder::new().name(name).spawn(move || {
            let blocked = linux::block_signals();
            let pinned = config.cpu.map_or(Ok(()), linux::pin_to);
            let priority = config.priority.map_or(Ok(()), linux::set_fifo);
            // Whoever started the thread waits for this.
            let _ = granted.send(blocked.and(pinned).and(priority).err());
            run();
        });
        let handle = spawned.map_err(|error| {
            Invalid::new("thread", format!("cannot be started ({error})"), "end other programs")
        })?;
        let missing = grants.recv().unwrap_or_default();
        Ok(RunningThread { device: device.to_owned(), missing, handle })
    }
}
