//! A load at ordinary priority: one thread for each CPU computes, one thread moves memory, and one
//! writes to the disk. The load ends when it is dropped. It does not fill the disk, because it
//! overwrites the same few megabytes.

use std::fs::File;
use std::io::{Seek, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use anyhow::Context;

/// Size of the memory that is copied back and forth: more than a cache holds.
const MEMORY_BYTES: usize = 16 << 20;
/// Number of bytes written between two waits for the disk.
const BLOCK_BYTES: usize = 1 << 20;
/// Number of blocks of the file before it is overwritten.
const FILE_BLOCKS: u32 = 16;
/// Number of steps of the computation between two checks of the stop flag.
const STEPS_PER_CHECK: u32 = 1 << 16;

/// The threads of the load.
pub(super) struct Load {
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
    path: PathBuf,
}

impl Load {
    /// Starts the threads of the load.
    ///
    /// # Errors
    /// A thread, or a file in the system's temporary folder, cannot be created.
    pub(super) fn start() -> anyhow::Result<Load> {
        let path = std::env::temp_dir().join(format!("taktil-jitter-{}", std::process::id()));
        let file = File::create(&path)
            .with_context(|| format!("--load: cannot write {}", path.display()))?;
        let stop = Arc::new(AtomicBool::new(false));
        let mut load = Load { stop, threads: Vec::new(), path };
        let cpus = std::thread::available_parallelism().map_or(1, usize::from);
        for _ in 0..cpus {
            load.thread("load-cpu", compute)?;
        }
        load.thread("load-memory", copy)?;
        load.thread("load-disk", move |stop| write(file, stop))?;
        Ok(load)
    }

    fn thread(
        &mut self,
        name: &str,
        work: impl FnOnce(&AtomicBool) + Send + 'static,
    ) -> anyhow::Result<()> {
        let stop = Arc::clone(&self.stop);
        let builder = std::thread::Builder::new().name(name.to_owned());
        self.threads.push(builder.spawn(move || work(&stop)).context("--load: no thread")?);
        Ok(())
    }

    #[cfg(test)]
    fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for Load {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::SeqCst);
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
        let _ = std::fs::remove_file(Path::new(&self.path));
    }
}

fn compute(stop: &AtomicBool) {
    let mut word = 1u64;
    while !stop.load(Ordering::Relaxed) {
        for _ in 0..STEPS_PER_CHECK {
            word = word.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        }
        word = std::hint::black_box(word);
    }
}

fn copy(stop: &AtomicBool) {
    let (mut from, mut to) = (vec![1u8; MEMORY_BYTES], vec![2u8; MEMORY_BYTES]);
    while !stop.load(Ordering::Relaxed) {
        to.copy_from_slice(std::hint::black_box(&from));
        core::mem::swap(&mut from, &mut to);
    }
}

fn write(mut file: File, stop: &AtomicBool) {
    let block = vec![0x5a_u8; BLOCK_BYTES];
    let mut blocks = 0;
    while !stop.load(Ordering::Relaxed) {
        if blocks == FILE_BLOCKS {
            blocks = 0;
            if file.rewind().is_err() {
                return;
            }
        }
        // A full disk ends only this part of the load.
        if file.write_all(&block).and_then(|()| file.sync_data()).is_err() {
            return;
        }
        blocks += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_load_ends_and_leaves_nothing() {
        let load = Load::start().unwrap();
        let path = load.path().to_owned();
        assert!(path.exists());
        assert!(load.threads.len() >= 3);
        drop(load);
        assert!(!path.exists());
    }
}
