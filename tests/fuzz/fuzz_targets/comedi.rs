//! Whatever the kernel tells of a Comedi board: kinds, channels, largest samples and ranges of any
//! content, words of any value, and errors. The driver refuses the board with a place and a remedy,
//! or runs; it never writes a sample that is larger than the channel takes.
#![no_main]

use std::sync::{Arc, Mutex};

use libfuzzer_sys::fuzz_target;
use nix::errno::Errno;
use taktil_drivers_comedi::board::{
    Board, ChannelInfo, DeviceInfo, InstructionList, Range, SubdeviceInfo,
};
use taktil_drivers_comedi::{
    AnalogChannel, Config, CounterSetup, EncoderChannel, InputLines, Level, Line, OutputLines,
    attach,
};
use taktil_fuzz::Numbers;
use taktil_hal::{CHANNELS, DacCode, ErrorKind, LinesOut, Nanos};

/// Instructions of the kernel's interface.
const READ_INSTRUCTION: u32 = 0x0400_0000;
/// Writes a sample.
const WRITE_INSTRUCTION: u32 = 0x0800_0001;
/// Jobs of a board.
const JOBS_COUNT: i64 = 8;

/// A board that is as the bytes say.
#[derive(Debug)]
struct Whatever {
    bytes: Mutex<Vec<u8>>,
    device: DeviceInfo,
    subdevices: Vec<SubdeviceInfo>,
    channels: Vec<ChannelInfo>,
    ranges: Vec<Range>,
}

fn word(numbers: &mut Numbers<'_>) -> u32 {
    match numbers.byte() & 7 {
        0 => (0..4).fold(0, |word, _| (word << 8) | u32::from(numbers.byte())),
        1 => u32::MAX,
        2 => 0x00ff_ffff,
        3 => 0xffff,
        4 => 0x0fff,
        _ => u32::from(numbers.byte()),
    }
}

impl Whatever {
    fn new(numbers: &mut Numbers<'_>) -> Whatever {
        let letters = |numbers: &mut Numbers<'_>| {
            (0..4).map(|_| char::from(numbers.byte())).collect::<String>()
        };
        let device = DeviceInfo { driver: letters(numbers), board: letters(numbers) };
        let count = 3 + usize::from(numbers.byte() % 6);
        let subdevices = (0..count)
            .map(|_| {
                let (kind, channels) = (u32::from(numbers.byte() % 14), word(numbers) % 40);
                SubdeviceInfo { kind, channels, flags: word(numbers) }
            })
            .collect();
        let channels = (0..40)
            .map(|_| ChannelInfo { maxdata: word(numbers), range_type: word(numbers) })
            .collect();
        let ranges = (0..usize::from(numbers.byte() % 5))
            .map(|_| Range {
                min_millionths: word(numbers).cast_signed().wrapping_neg(),
                max_millionths: word(numbers).cast_signed(),
                flags: if numbers.byte() & 1 == 0 { 0 } else { word(numbers) },
            })
            .collect();
        Whatever { bytes: Mutex::default(), device, subdevices, channels, ranges }
    }

    fn byte(&self) -> u8 {
        self.bytes.lock().expect("one thread").pop().unwrap_or(0)
    }
}

impl Board for Whatever {
    fn device_info(&self) -> Result<DeviceInfo, Errno> {
        Ok(self.device.clone())
    }

    fn subdevices(&self) -> Result<Vec<SubdeviceInfo>, Errno> {
        Ok(self.subdevices.clone())
    }

    fn channels(&self, subdevice: u32) -> Result<Vec<ChannelInfo>, Errno> {
        let info = self.subdevices.get(subdevice as usize).ok_or(Errno::EINVAL)?;
        Ok(self.channels[..info.channels as usize].to_vec())
    }

    fn ranges(&self, _range_type: u32) -> Result<Vec<Range>, Errno> {
        Ok(self.ranges.clone())
    }

    fn lock(&self, _subdevice: u32) -> Result<(), Errno> {
        if self.byte() == 0xff { Err(Errno::EBUSY) } else { Ok(()) }
    }

    fn execute(&self, list: &mut InstructionList) -> Result<usize, Errno> {
        let fault = self.byte();
        match fault {
            0xf8 => return Err(Errno::ENODEV),
            0xf9 => return Err(Errno::EIO),
            0xfa => return Err(Errno::EINTR),
            _ => {}
        }
        let count = list.instructions().len();
        for instruction in list.instructions_mut() {
            let channel = (instruction.channel & 0xffff) as usize;
            if instruction.kind == WRITE_INSTRUCTION {
                let most = self.channels[channel].maxdata;
                assert!(instruction.first() <= most, "{} of {most}", instruction.first());
            } else if instruction.kind == READ_INSTRUCTION {
                for word in instruction.words_mut() {
                    *word = (0..4).fold(0, |word, _| (word << 8) | u32::from(self.byte()));
                }
            }
        }
        Ok(if fault == 0xfb { count / 2 } else { count })
    }
}

fn config(kind: u8) -> Config {
    let setups = [
        CounterSetup::Running,
        CounterSetup::Armed,
        CounterSetup::Quadrature,
        CounterSetup::Preload,
    ];
    let mut config = Config::new("/dev/comedi0", 10);
    if kind & 1 == 0 {
        let setup = setups[usize::from(kind >> 6)];
        config.encoders = (0..6).map(|channel| EncoderChannel::new(channel, setup)).collect();
    }
    let calibrated =
        |channel| AnalogChannel { gain: 1.01, offset_codes: -3.0, ..AnalogChannel::new(channel) };
    if kind & 2 == 0 {
        config.analog_out = (0..6).map(calibrated).collect();
    }
    if kind & 4 == 0 {
        config.analog_in = (0..4).map(calibrated).collect();
        config.force_torque = (4..10).map(AnalogChannel::new).collect();
    }
    if kind & 8 == 0 {
        let line = |channel| Line { subdevice: None, channel, active: Level::Low };
        config.lines_in = Some(InputLines {
            drive_power: line(0),
            estop_a_closed: line(1),
            estop_b_closed: line(2),
        });
        config.lines_out =
            Some(OutputLines { enable: line(3), brake_release: line(4), watchdog_feed: line(5) });
    }
    config
}

fuzz_target!(|bytes: &[u8]| {
    let mut numbers = Numbers::new(bytes);
    let config = config(numbers.byte());
    let board = Whatever::new(&mut numbers);
    let mut rest = Vec::new();
    while numbers.any() {
        rest.push(numbers.byte());
    }
    rest.reverse();
    *board.bytes.lock().expect("one thread") = rest;
    let mut halves = match attach(Arc::new(board), &config) {
        Ok(halves) => halves,
        Err(refused) => {
            let text = refused.to_string();
            assert!(text.contains("; "), "{text}");
            return;
        }
    };
    let volts = halves.analog_out_volts_per_code.iter().chain(&halves.analog_in_volts_per_code);
    assert!(volts.clone().all(|volts| volts.is_finite()));
    for job in 1..=JOBS_COUNT {
        let release = Nanos::from_micros(2_500) * job;
        if let Some(half) = &mut halves.encoders {
            let _ = half.sample(release).map(|reading| assert!(reading.acquired <= release));
        }
        if let Some(half) = &mut halves.analog_in {
            let (low, high) = half.code_range();
            if let Ok(reading) = half.sample(release) {
                let wired = &reading.value[..half.channels()];
                assert!(wired.iter().all(|code| (low..=high).contains(code)), "{wired:?}");
            }
        }
        if let Some(half) = &mut halves.force_torque {
            let _ = half.sample(release);
        }
        if let Some(half) = &mut halves.digital_in {
            let _ = half.sample(release);
        }
        if let Some(half) = &mut halves.analog_out {
            let (low, high) = half.code_range();
            let code = if job % 2 == 0 { low } else { high };
            let _ = half.commit(release, &[code; CHANNELS]);
            let beyond = half.commit(release, &[DacCode(high.0.saturating_add(1)); CHANNELS]);
            assert!(high.0 == i32::MAX || beyond.is_err_and(|e| e.kind != ErrorKind::Stale));
        }
        if let Some(half) = &mut halves.digital_out {
            let lines = LinesOut { enable: true, brake_release: true, watchdog_feed: job % 2 == 0 };
            let _ = half.commit(release, &lines);
        }
    }
});
