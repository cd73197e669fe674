//! Applications of cu29 as contestants. Its log goes to memory (`/dev/shm`), so that no disk is
//! measured. Its defaults stay, except that logging is off where the name says so.

use std::path::{Path, PathBuf};

use anyhow::Context;
use taktil_lab_bench::LONG_CHAIN_HOPS;
use taktil_lab_bench::measure::BenchmarkCase;

/// Where its logs lie; removed at the end.
pub struct Folder(PathBuf);

impl Folder {
    /// A new one in memory, or wherever temporary files go.
    pub fn new() -> anyhow::Result<Folder> {
        let memory = Path::new("/dev/shm");
        let root = if memory.is_dir() { memory.to_owned() } else { std::env::temp_dir() };
        let path = root.join(format!("taktil-bench-executor-{}", std::process::id()));
        std::fs::create_dir_all(&path).with_context(|| format!("{}", path.display()))?;
        Ok(Folder(path))
    }

    /// Its path.
    pub fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Bytes of one file of the log.
const LOG_SLAB_BYTES: usize = 64 * 1024 * 1024;

macro_rules! app {
    ($module:ident, $config:tt) => {
        mod $module {
            use std::path::Path;

            use anyhow::anyhow;
            use cu29::prelude::*;
            use taktil_lab_bench::measure::Stopwatch;
            use taktil_rtcore::Nanos;

            #[copper_runtime(config = $config)]
            struct App {}

            /// Starts it; what comes back runs so many cycles.
            pub fn start(folder: &Path) -> anyhow::Result<Box<dyn FnMut(u64) -> Nanos>> {
                let path = folder.join(concat!(stringify!($module), ".copper"));
                let mut app = App::builder()
                    .with_log_path(path, Some(super::LOG_SLAB_BYTES))
                    .and_then(|builder| builder.build())
                    .map_err(|error| anyhow!("{error}"))?
                    .start()
                    .map_err(|_| anyhow!("cu29 did not start"))?;
                Ok(Box::new(move |cycles| {
                    let mut watch = Stopwatch::default();
                    watch.lap(true);
                    for _ in 0..cycles {
                        app.run_one_iteration().expect("a chain of empty tasks does not fail");
                    }
                    watch.lap(false);
                    watch.total()
                }))
            }
        }
    };
}

app!(i32_0_off, "graphs/i32-0-off.ron");
app!(i32_6_off, "graphs/i32-6-off.ron");
app!(i32_0_default, "graphs/i32-0-default.ron");
app!(i32_6_default, "graphs/i32-6-default.ron");
app!(f64x6_0_off, "graphs/f64x6-0-off.ron");
app!(f64x6_6_off, "graphs/f64x6-6-off.ron");
app!(f64x6_0_default, "graphs/f64x6-0-default.ron");
app!(f64x6_6_default, "graphs/f64x6-6-default.ron");

/// All of them, in the order of ours.
pub fn all(folder: &Path) -> anyhow::Result<Vec<BenchmarkCase>> {
    let off = "logging off";
    let default = "its default logging";
    let case = |payload, configuration, hops, run| BenchmarkCase {
        executor: "cu29",
        payload,
        configuration,
        hops,
        run,
    };
    Ok(vec![
        case("i32", off, 0, i32_0_off::start(folder)?),
        case("i32", off, LONG_CHAIN_HOPS, i32_6_off::start(folder)?),
        case("i32", default, 0, i32_0_default::start(folder)?),
        case("i32", default, LONG_CHAIN_HOPS, i32_6_default::start(folder)?),
        case("[f64; 6]", off, 0, f64x6_0_off::start(folder)?),
        case("[f64; 6]", off, LONG_CHAIN_HOPS, f64x6_6_off::start(folder)?),
        case("[f64; 6]", default, 0, f64x6_0_default::start(folder)?),
        case("[f64; 6]", default, LONG_CHAIN_HOPS, f64x6_6_default::start(folder)?),
    ])
}
