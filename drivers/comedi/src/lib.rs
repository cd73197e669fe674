//! Boards behind the kernel's Comedi interface are driven here by ioctl, without the C library:
//! D/A, A/D, counters of encoders and digital lines, with ranges chosen by volts and a calibration
//! of each channel. One list of instructions reads all inputs of a board once a cycle; one writes
//! its D/A converters and one its lines. What the board has is asked from the kernel at opening;
//! what it does not have is refused with the place of the channel in the configuration.
//!
//! # Calls of the system
//!
//! After opening: `ioctl(COMEDI_INSNLIST)` and none other ([`SYSTEM_CALLS`]). The first input half
//! that is sampled with a new release makes one call; a commit makes one; `safe` and drop make up
//! to [`SAFE_ATTEMPTS`]. The call does not sleep for data: the kernel reads converters by polling,
//! for a time that the board's kernel driver bounds. It holds a mutex of the board meanwhile, so
//! that a call of another lane on the same board waits for it, under PREEMPT_RT with priority
//! inheritance; and it takes memory for the list from the kernel's allocator. A lane should
//! therefore have a board for itself where it can.
//!
//! Nothing here allocates, formats or panics after opening. The input halves share the words of
//! the last list under a lock that is tried and never waited for: whoever finds it taken by another
//! lane answers [`Transient`](taktil_hal::ErrorKind::Transient), which [`Monitor`] counts.
//!
//! # Limits
//!
//! - Counts of one reading are read one after the other, microseconds apart, not latched together;
//!   Comedi has no interface for that, nor for a count latched at an index pulse.
//! - Boards have no watchdog of their own, and outputs keep their values when the process dies:
//!   [`write_safe_values`] is for whoever comes after it, and a relay on the feed line for
//!   everything else. The longest silence is that of the relay.
//! - An input that the board freezes cannot be told from one that stands still.
//! - Tests run on a double in memory. On a real node they run with `TAKTIL_COMEDI=/dev/comedi0`,
//!   which the kernel's `comedi_test` suffices for; it has no counters and no lines, so that these,
//!   faults and unplugging are shown by the double only.
//!
//! # Opening a board
//!
//! ```no_run
//! use taktil_drivers_comedi::{AnalogChannel, Config, open};
//! use taktil_hal::{CHANNELS, DacCode, Nanos};
//!
//! let mut config = Config::new("/dev/comedi0", 10);
//! config.analog_out = (0..6).map(AnalogChannel::new).collect();
//! let mut halves = open(&config)?;
//! if let Some(motors) = &mut halves.analog_out {
//!     motors.commit(Nanos::ZERO, &[DacCode(0); CHANNELS])?;
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod board;
mod codes;
mod config;
mod device;
mod error;
mod exchange;
mod inputs;
mod outputs;
mod setup;
mod sharing;
mod uapi;
mod wiring;

use std::fmt;
use std::sync::Arc;

pub use taktil_hal::OpenError;
use taktil_hal::{AnalogIn, AnalogOut, DigitalIn, DigitalOut, Encoders, ForceTorque, SystemCall};

pub use board::Board;
pub use config::{
    AnalogChannel, Config, CounterSetup, EncoderChannel, GAIN_BOUNDS, InputLines, Level, Line,
    OFFSET_MAX_CODES, OutputLines, Reference, SPAN_MAX_V, WATCHDOG_MAX_MS,
};
pub use device::DeviceFile;

pub use exchange::{Monitor, Statistics};
pub use inputs::{ComediAnalogIn, ComediDigitalIn, ComediEncoders, ComediForceTorque};
pub use outputs::{ComediAnalogOut, ComediDigitalOut, SAFE_ATTEMPTS};

use exchange::{Exchange, InputBank};
use inputs::{InputMaker, input_list};
use setup::Setup;
use sharing::Shared;
use wiring::{Converter, Wiring};

/// What the halves ask of the kernel within a job.
pub const SYSTEM_CALLS: &[SystemCall] = &[SystemCall {
    name: "ioctl",
    about: "COMEDI_INSNLIST: the first input half of a release, a commit and `safe` have a list \
            executed; the board's kernel driver polls its converters for a bounded time",
}];

/// The halves of one board, those that its configuration lists.
pub struct Halves {
    /// Joint encoders.
    pub encoders: Option<Box<dyn Encoders>>,
    /// D/A converters.
    pub analog_out: Option<Box<dyn AnalogOut>>,
    /// A/D converters.
    pub analog_in: Option<Box<dyn AnalogIn>>,
    /// The gauges of a force/torque sensor.
    pub force_torque: Option<Box<dyn ForceTorque>>,
    /// Lines from the cell.
    pub digital_in: Option<Box<dyn DigitalIn>>,
    /// Lines to the cell.
    pub digital_out: Option<Box<dyn DigitalOut>>,
    /// What one code of each D/A channel is worth (V).
    pub analog_out_volts_per_code: Vec<f64>,
    /// What one code of each A/D channel is worth (V).
    pub analog_in_volts_per_code: Vec<f64>,
    /// What one code of each gauge is worth (V).
    pub force_torque_volts_per_code: Vec<f64>,
    /// What goes wrong while the board is open.
    pub monitor: Monitor,
}

impl fmt::Debug for Halves {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Halves")
            .field("joints", &self.encoders.as_ref().map(|half| half.joints()))
            .field("analog_out", &self.analog_out.as_ref().map(|half| half.channels()))
            .field("analog_in", &self.analog_in.as_ref().map(|half| half.channels()))
            .field("force_torque", &self.force_torque.is_some())
            .field("digital_in", &self.digital_in.is_some())
            .field("digital_out", &self.digital_out.is_some())
            .finish_non_exhaustive()
    }
}

/// Opens the node that `config` names, locks the subdevices that are used, sets counters and lines
/// up and puts the outputs at their safe values.
///
/// # Errors
/// The configuration is refused, the node cannot be used, the board is another one, another process
/// has locked it, or it does not have a channel, range or direction that is asked for. Until a
/// subdevice is locked nothing is written.
pub fn open(config: &Config) -> Result<Halves, OpenError> {
    config.check()?;
    attach(Arc::new(DeviceFile::open(&config.path)?), config)
}

/// Takes a board that is open already, such as a double of one; `config.path` stands in messages
/// only.
///
/// # Errors
/// As [`open`], the path apart.
pub fn attach(board: Arc<dyn Board>, config: &Config) -> Result<Halves, OpenError> {
    let wiring = Wiring::find(board.as_ref(), config)?;
    let statistics = Shared::new(Statistics::default());
    let setup =
        Setup { board: board.clone(), config, wiring: &wiring, statistics: statistics.clone() };
    setup.lock()?;
    setup.inputs()?;
    let outputs = setup.outputs()?;
    setup.check_directions()?;
    let (list, layout) = input_list(&wiring);
    let exchange = Exchange::new(board, list.clone(), setup.tally());
    let maker = InputMaker {
        wiring: &wiring,
        layout,
        list: &list,
        bank: Shared::new(InputBank::new(exchange)),
        tally: &|| setup.tally(),
    };
    let volts = |converters: &[Converter]| {
        converters.iter().map(|converter| converter.scale.volts_per_code).collect()
    };
    Ok(Halves {
        encoders: maker.encoders(),
        analog_out: outputs.analog_out.map(|half| Box::new(half) as Box<dyn AnalogOut>),
        analog_in: maker.analog_in(),
        force_torque: maker.force_torque(),
        digital_in: maker.digital_in(),
        digital_out: outputs.digital_out.map(|half| Box::new(half) as Box<dyn DigitalOut>),
        analog_out_volts_per_code: volts(&wiring.analog_out),
        analog_in_volts_per_code: volts(&wiring.analog_in),
        force_torque_volts_per_code: volts(&wiring.gauges),
        monitor: Monitor(statistics),
    })
}

/// Opens a board, writes the safe values of its outputs and closes it: drives off and brakes on
/// first, then zero volts. For a program that runs after the process that drove the board has died.
///
/// # Errors
/// As [`open`], as far as the outputs are concerned; another process still drives the board. An
/// error of the lines does not keep the D/A converters from being tried.
pub fn write_safe_values(path: &str, config: &Config) -> Result<(), OpenError> {
    config.check()?;
    let config = Config { path: path.to_owned(), ..config.clone() };
    write_safe_values_to(Arc::new(DeviceFile::open(path)?), &config)
}

/// Writes the safe values of the outputs of a board that is open already.
///
/// # Errors
/// As [`write_safe_values`].
pub fn write_safe_values_to(board: Arc<dyn Board>, config: &Config) -> Result<(), OpenError> {
    let wiring = Wiring::find_outputs(board.as_ref(), config)?;
    let lines = Wiring { analog_out: Vec::new(), ..wiring.clone() };
    let analog = Wiring { lines_out: Vec::new(), ..wiring };
    let write = |wiring: &Wiring| {
        let statistics = Shared::new(Statistics::default());
        let setup = Setup { board: board.clone(), config, wiring, statistics };
        setup.lock()?;
        setup.outputs().map(drop)
    };
    let lines = write(&lines);
    let analog = write(&analog);
    lines.and(analog)
}
