//! Measures the driver's own time in a cycle: six encoders read and six D/A channels written on a
//! board that answers at once. Prints the median and the largest of alternating slices.
//!
//! ```sh
//! cargo run --release -p taktil-drivers-comedi --example comedi_own_time
//! ```
//!
//! `comedi_own_time --instructions CYCLES` executes so many cycles and prints nothing, for a tool
//! that counts.
#![expect(clippy::disallowed_methods, reason = "an instrument measures time")]

use std::hint::black_box;
use std::io::Write;
use std::sync::Arc;
use std::time::Instant;

use nix::errno::Errno;
use taktil_drivers_comedi::board::{
    Board, ChannelInfo, DeviceInfo, InstructionList, Range, SubdeviceInfo,
};
use taktil_drivers_comedi::{AnalogChannel, Config, CounterSetup, EncoderChannel, attach};
use taktil_hal::{CHANNELS, DacCode, Nanos};

/// Cycles of one slice.
const SLICE_CYCLES: i64 = 1_000;
/// Slices of each kind.
const SLICES_COUNT: usize = 201;

/// A board that does nothing, so that what is measured is the driver's.
#[derive(Debug)]
struct Idle;

impl Board for Idle {
    fn device_info(&self) -> Result<DeviceInfo, Errno> {
        Ok(DeviceInfo::default())
    }

    fn subdevices(&self) -> Result<Vec<SubdeviceInfo>, Errno> {
        Ok([2, 6].map(|kind| SubdeviceInfo { kind, channels: 8, flags: 0 }).to_vec())
    }

    fn channels(&self, _subdevice: u32) -> Result<Vec<ChannelInfo>, Errno> {
        Ok(vec![ChannelInfo { maxdata: 0xffff, range_type: 1 }; 8])
    }

    fn ranges(&self, _range_type: u32) -> Result<Vec<Range>, Errno> {
        let range = Range { min_millionths: -10_000_000, max_millionths: 10_000_000, flags: 0 };
        Ok(vec![range])
    }

    fn lock(&self, _subdevice: u32) -> Result<(), Errno> {
        Ok(())
    }

    fn execute(&self, list: &mut InstructionList) -> Result<usize, Errno> {
        Ok(black_box(list).instructions().len())
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut config = Config::new("/dev/comedi0", 10);
    config.encoders = (0..6).map(|at| EncoderChannel::new(at, CounterSetup::Running)).collect();
    let calibrated =
        |at| AnalogChannel { gain: 1.01, offset_codes: -3.0, ..AnalogChannel::new(at) };
    config.analog_out = (0..6).map(calibrated).collect();
    let mut halves = attach(Arc::new(Idle), &config)?;
    let mut encoders = halves.encoders.take().ok_or("no encoders")?;
    let mut out = halves.analog_out.take().ok_or("no outputs")?;
    let mut next = 0;
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if let [option, cycles] = arguments.as_slice()
        && option == "--instructions"
    {
        for _ in 0..cycles.parse::<u32>()? {
            next += 2_500_000;
            black_box(encoders.sample(Nanos(next))?);
            out.commit(Nanos(next), black_box(&[DacCode(1_234); CHANNELS]))?;
        }
        return Ok(());
    }
    let mut times = [Vec::new(), Vec::new()];
    for slice in 0..2 * SLICES_COUNT {
        let begin = Instant::now();
        for _ in 0..SLICE_CYCLES {
            next += 2_500_000;
            let release = Nanos(next);
            if slice % 2 == 0 {
                black_box(encoders.sample(release)?);
            } else {
                out.commit(release, black_box(&[DacCode(1_234); CHANNELS]))?;
            }
        }
        times[slice % 2].push(begin.elapsed().as_nanos() as f64 / SLICE_CYCLES as f64);
    }
    for (name, times) in ["six encoders", "six D/A channels"].iter().zip(&mut times) {
        times.sort_by(f64::total_cmp);
        let (median, largest) = (times[SLICES_COUNT / 2], times[SLICES_COUNT - 1]);
        writeln!(std::io::stdout(), "{name}: median {median:.0} ns, largest {largest:.0} ns")?;
    }
    Ok(())
}
