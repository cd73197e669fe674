//! A node of the double that answers as a `Board`, and the configuration of a robot's board with
//! all halves wired.
#![allow(dead_code, reason = "each program takes what it needs")]
#![expect(clippy::disallowed_types, reason = "a test's double is shared with the test")]

use std::sync::{Arc, Mutex, MutexGuard};

use nix::errno::Errno;
use taktil_drivers_comedi::board::{
    Board, ChannelInfo, DeviceInfo, InstructionList, Range, SubdeviceInfo,
};
use taktil_drivers_comedi::{
    AnalogChannel, Config, CounterSetup, EncoderChannel, Halves, InputLines, Level, Line,
    OpenError, OutputLines, attach,
};
use taktil_drivers_comedi_double::{Call, Double};
use taktil_hal::fault::{Fault, FaultPlan};

/// Channels of the lines: inputs in the first group, outputs in the second.
pub(crate) const FIRST_OUTPUT_LINE: u16 = 8;

/// A double that a test and a driver share.
#[derive(Clone, Debug)]
pub(crate) struct SharedDouble(Arc<Mutex<Double>>);

/// One open node of a double.
#[derive(Debug)]
pub(crate) struct Node {
    double: SharedDouble,
    number: u32,
}

impl SharedDouble {
    pub(crate) fn new(double: Double) -> SharedDouble {
        SharedDouble(Arc::new(Mutex::new(double)))
    }

    pub(crate) fn look(&self) -> MutexGuard<'_, Double> {
        self.0.lock().expect("no test panics while it looks")
    }

    pub(crate) fn node(&self) -> Result<Arc<dyn Board>, Errno> {
        let number = self.look().open().map_err(Errno::from_raw)?;
        Ok(Arc::new(Node { double: self.clone(), number }))
    }

    pub(crate) fn open(&self, config: &Config) -> Result<Halves, OpenError> {
        attach(self.node().expect("the double is plugged in"), config)
    }

    pub(crate) fn plan(&self, faults: &[&str]) {
        let faults = faults.iter().map(|text| text.parse::<Fault>().unwrap()).collect();
        self.look().set_plan(FaultPlan::new(faults), 1).unwrap();
    }
}

impl Drop for Node {
    fn drop(&mut self) {
        self.double.look().close(self.number);
    }
}

impl Board for Node {
    fn device_info(&self) -> Result<DeviceInfo, Errno> {
        let names = self.double.look().names(self.number).map_err(Errno::from_raw)?;
        let [driver, board] = names;
        Ok(DeviceInfo { driver, board })
    }

    fn subdevices(&self) -> Result<Vec<SubdeviceInfo>, Errno> {
        let all = self.double.look().subdevice_facts(self.number).map_err(Errno::from_raw)?;
        let info = all.iter().map(|facts| SubdeviceInfo {
            kind: facts.kind,
            channels: facts.channels,
            flags: facts.flags,
        });
        Ok(info.collect())
    }

    fn channels(&self, subdevice: u32) -> Result<Vec<ChannelInfo>, Errno> {
        let double = self.double.look();
        let ranges = double.ranges(self.number, subdevice).map_err(Errno::from_raw)?.len();
        let range_type = subdevice << 24 | ranges as u32;
        let all = double.largest_samples(self.number, subdevice).map_err(Errno::from_raw)?;
        Ok(all.into_iter().map(|maxdata| ChannelInfo { maxdata, range_type }).collect())
    }

    fn ranges(&self, range_type: u32) -> Result<Vec<Range>, Errno> {
        let double = self.double.look();
        let ranges = double.ranges(self.number, range_type >> 24).map_err(Errno::from_raw)?;
        let range = ranges.iter().map(|range| Range {
            min_millionths: range.min_uv,
            max_millionths: range.max_uv,
            flags: 0,
        });
        Ok(range.collect())
    }

    fn lock(&self, subdevice: u32) -> Result<(), Errno> {
        self.double.look().lock(self.number, subdevice).map_err(Errno::from_raw)
    }

    fn execute(&self, list: &mut InstructionList) -> Result<usize, Errno> {
        let calls = list.instructions_mut().iter_mut().map(|instruction| Call {
            kind: instruction.kind,
            subdevice: instruction.subdevice,
            channel: instruction.channel,
            words: instruction.words_mut(),
        });
        self.double.look().execute(self.number, calls).map_err(Errno::from_raw)
    }
}

fn line(channel: u16, active: Level) -> Line {
    Line { subdevice: None, channel, active }
}

/// Six joints, D/A channels, A/D channels, a wrist and lines of the double's robot board.
pub(crate) fn robot_config() -> Config {
    let mut config = Config::new("/dev/comedi0", 10);
    config.encoders =
        (0..6).map(|channel| EncoderChannel::new(channel, CounterSetup::Armed)).collect();
    config.analog_out = (0..6).map(AnalogChannel::new).collect();
    config.analog_in = (0..4).map(AnalogChannel::new).collect();
    config.force_torque = (8..14)
        .map(|channel| AnalogChannel { low_v: -5.0, high_v: 5.0, ..AnalogChannel::new(channel) })
        .collect();
    config.lines_in = Some(InputLines {
        drive_power: line(0, Level::Low),
        estop_a_closed: line(1, Level::Low),
        estop_b_closed: line(2, Level::Low),
    });
    config.lines_out = Some(OutputLines {
        enable: line(FIRST_OUTPUT_LINE, Level::High),
        brake_release: line(FIRST_OUTPUT_LINE + 1, Level::Low),
        watchdog_feed: line(FIRST_OUTPUT_LINE + 2, Level::High),
    });
    config
}
