//! Threads of drivers that exchange with their boards beside the lanes.

use std::thread::JoinHandle;

use taktil_hal::Invalid;
use taktil_machine::device::ThreadConfig;
use taktil_rtcore::contract::Item;
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

/// Something that the kernel did not grant to a thread.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MissingGrant {
    /// The item of the contract under which it falls.
    pub item: Item,
    /// What was asked for and what became of it, for people.
    pub text: String,
}

/// A thread at work.
#[derive(Debug)]
pub struct RunningThread {
    /// Name of the device.
    pub device: String,
    /// What the kernel did not grant of the section's `thread`, if anything.
    pub missing: Option<MissingGrant>,
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
            let missing = |item| move |text| MissingGrant { item, text };
            let blocked = linux::block_signals().map_err(missing(Item::Fifo));
            let pinned = config.cpu.map_or(Ok(()), linux::pin_to).map_err(missing(Item::Cpu));
            let priority = config.priority.map_or(Ok(()), linux::set_fifo);
            let priority = priority.map_err(missing(Item::Fifo));
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
