//! Boards whose registers are mapped into memory: D/A converters, encoder counters, A/D converters,
//! gauges, a tactile frame, digital lines, a watchdog. Behind the path is a UIO device, the memory
//! of a PCI device, or a plain file that a model serves. Which register is what stands in a file,
//! so that a board needs a description and no code. Signs, scales and everything else that depends
//! on what is wired to the board belong to the tasks above.
//!
//! # Describing a board
//!
//! 1. Find the memory. A PCI board: `lspci -nn -v` shows vendor and device and the size of each
//!    region; region 2 is `/sys/bus/pci/devices/ADDRESS/resource2`, switched on by writing 1 to
//!    `enable` beside it. A VME board behind a bridge, or any board with a UIO driver:
//!    `/dev/uioN`, whose regions `/sys/class/uio/uioN/maps` lists. The process needs to read and
//!    write that file; the board's memory is not cached.
//! 2. Write down, from the manual, the width of the bus and its order of bytes, and for each bank
//!    the offset of its first register, the width of a value and how it is coded. `boards/` of this
//!    crate holds descriptions to begin with:
//!
//!    | name | board |
//!    |---|---|
//!    | `dvme-628` | D/A, left-justified codes, write-only registers, no watchdog |
//!    | `lxvme-s01` | decoders, 24 bits in two registers, a latch with a busy bit |
//!    | `vme-8605` | A/D with a start register and a busy bit |
//!    | `vme-arm` | these three in one window |
//!    | `taktil` | the project's own layout, a whole cell with numbered blocks and a watchdog |
//!
//! 3. Name it: `board = "mine.toml"` in the section of the device, or write the same keys below
//!    `registers` there. [`Description`] lists all of them. Whatever does not fit together (a
//!    register outside the window or in two banks, bits beyond the bus) is refused with its key.
//!    Several boards behind one bridge are one description, as `vme-arm`, or a section each with
//!    its `offset_bytes`; the registers of two sections must not overlap.
//! 4. Try the description on the emulator, which reads the same file with a reader of its own:
//!    `cargo run -p taktil-drivers-regmap-emulator --example registers mine.toml /dev/shm/board`
//!    serves it behind the path `/dev/shm/board`. Then try it on the board with the drives off.
//!
//! ```
//! use taktil_drivers_regmap::{Config, Description};
//!
//! let text = r#"
//!     path = "/sys/bus/pci/devices/0000:03:00.0/resource2"
//!     pci_id = "10b5:9050"
//!     encoder_channels = [0, 1, 2, 3, 4, 5]
//!
//!     [registers]
//!     name = "counter board of the lab"
//!     bus_bits = 32
//!     byte_order = "little"
//!     length_bytes = 0x100
//!
//!     [registers.encoders]
//!     offset = 0x20
//!     channels = 8
//!     bits = 24
//!     latch_offset = 0x10
//!     hold = "latch"
//! "#;
//! let config: Config = toml::from_str(text)?;
//! config.check()?;
//!
//! let wrong = text.replace("bits = 24", "bits = 24\nshift = 9");
//! let config: Config = toml::from_str(&wrong)?;
//! assert_eq!(config.check().unwrap_err().place, "registers.encoders.shift");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # What a cycle does
//!
//! System calls after opening: none ([`SYSTEM_CALLS`] is empty). An input half that is sampled with
//! a new release strobes the latch or starts the conversion, looks at the busy bit as often as
//! `polls` says, and reads. A conversion can be started early in the job: by the encoders of the
//! same board (`start_by`), or through [`Halves::start`] by whoever has something else to do
//! meanwhile. Longest operation: a tactile frame read [`TORN_RETRIES`] + 1 times over; or `polls`
//! looks, at most [`BUSY_POLLS_MAX`], [`TORN_RETRIES`] + 1 times, if another lane starts a
//! conversion each time. A look takes `read_ns` at most: the halves declare the product as their
//! longest wait, and the analysis of the schedule counts it.
//!
//! # Limits
//!
//! - A board without a register that says who it is (`presence`) is never noticed to be gone.
//! - A board without a watchdog keeps its outputs when the process is killed, until
//!   [`write_safe_values`] is called or a relay drops: `relay_ms` states that time, and it is the
//!   longest silence. With a watchdog that is `watchdog_ms`, which the board keeps.
//! - Codes that stand still cannot be told from a frozen converter, unless the board publishes a
//!   number with them.
//! - A D/A channel that does not follow is noticed only as far as its register reads back.
//! - A value of several registers is written in the order of their offsets.
//! - A converter that is started channel by channel, with one data register, is not described.
//!
//! # The project's own layout
//!
//! Without `board` and `registers` a section means the layout of the module [`registers`], which
//! [`Loopback`] models.
//!
//! ```
//! use std::sync::Arc;
//! use taktil_drivers_regmap::{Board, Config, Loopback, RegisterFile};
//! use taktil_hal::{CHANNELS, DacCode, Nanos};
//!
//! let registers = Arc::new(RegisterFile::anonymous()?);
//! let config = Config::default();
//! let mut model = Loopback::new(registers.clone(), &config)?;
//! let mut devices = Board::attach(registers, &config)?;
//! devices.require_analog_out()?.commit(Nanos::ZERO, &[DacCode(-700); CHANNELS])?;
//! model.tick(Nanos::ZERO);
//! let codes = devices.analog_in.unwrap().sample(Nanos::ZERO)?.value;
//! assert_eq!(codes[3].0, -700);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod acquisition;
mod block;
mod boards;
mod bus;
mod codes;
mod config;
pub mod description;
mod encoders;
mod error;
mod inputs;
mod io;
mod loopback;
mod outputs;
pub mod registers;
mod shipped;
mod tactile;
mod wiring;

use std::fmt;
use std::sync::Arc;

pub use taktil_hal::OpenError;
use taktil_hal::{
    AnalogIn, AnalogOut, Devices, DigitalIn, DigitalOut, Encoders, ForceTorque, Invalid,
    SystemCall, TACTILE, TactileArray,
};

pub use acquisition::AcquisitionStart;
pub use block::TORN_RETRIES;
pub use config::{Config, TIME_MAX_MS};
pub use description::{BUSY_POLLS_MAX, Description};

pub use encoders::RegisterEncoders;
pub use inputs::{RegisterAnalogIn, RegisterDigitalIn, RegisterForceTorque};
pub use io::RegisterFile;
pub use loopback::Loopback;
pub use outputs::{RegisterAnalogOut, RegisterDigitalOut};
pub use shipped::SHIPPED_BOARDS;
pub use tactile::RegisterTactile;

use bus::{Bus, State};
use wiring::{HalfMaker, Wiring};

/// What the halves ask of the kernel within a job: nothing, they load and store.
pub const SYSTEM_CALLS: &[SystemCall] = &[];

/// The halves of one board, those that its description has registers for.
pub struct Halves {
    /// Joint encoders.
    pub encoders: Option<Box<dyn Encoders>>,
    /// D/A converters.
    pub analog_out: Option<Box<dyn AnalogOut>>,
    /// A/D converters.
    pub analog_in: Option<Box<dyn AnalogIn>>,
    /// A tactile array.
    pub tactile: Option<Box<dyn TactileArray>>,
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
    /// Starts the board's latch and conversion before its halves are sampled. Like a half it keeps
    /// the board open and locked.
    pub start: AcquisitionStart,
}

impl fmt::Debug for Halves {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Halves")
            .field("joints", &self.encoders.as_ref().map(|half| half.joints()))
            .field("analog_out", &self.analog_out.as_ref().map(|half| half.channels()))
            .field("analog_in", &self.analog_in.as_ref().map(|half| half.channels()))
            .field("tactile_rows", &self.tactile.as_ref().map(|half| half.rows()))
            .field("force_torque", &self.force_torque.is_some())
            .field("digital_in", &self.digital_in.is_some())
            .field("digital_out", &self.digital_out.is_some())
            .finish_non_exhaustive()
    }
}

/// Opens a board and splits it into its halves.
#[derive(Debug)]
pub struct Board;

impl Board {
    /// Maps the board that `config` names, locks it for this process and puts its outputs at their
    /// safe values; for a board that is a whole cell, as the project's own layout is.
    ///
    /// # Errors
    /// As [`Board::open_halves`], or the board lacks a half.
    pub fn open(config: &Config) -> Result<Devices, OpenError> {
        devices(Board::open_halves(config)?)
    }

    /// Maps the board that `config` names, locks it for this process and puts its outputs at their
    /// safe values.
    ///
    /// # Errors
    /// The config or the description is refused, the path cannot be used, another process drives
    /// the board, or what is there is not this board. Nothing was written then, except perhaps the
    /// watchdog's time.
    pub fn open_halves(config: &Config) -> Result<Halves, OpenError> {
        config.check()?;
        let description = boards::description(config)?;
        let wiring = Wiring::find(config, &description)?;
        let length_bytes = boards::window_bytes(config, &description);
        let registers = RegisterFile::map(config, length_bytes, description.bus_bytes())?;
        registers.lock_outputs(&config.path)?;
        split(Arc::new(registers), config, &description, wiring)
    }

    /// Takes a block that is mapped already, for a model of the board in the same process;
    /// `config.path` appears in messages only.
    ///
    /// # Errors
    /// As [`Board::open`], the path apart.
    pub fn attach(registers: Arc<RegisterFile>, config: &Config) -> Result<Devices, OpenError> {
        devices(Board::attach_halves(registers, config)?)
    }

    /// Takes a block that is mapped already; registers beyond its end read all ones.
    ///
    /// # Errors
    /// As [`Board::open_halves`], the path apart.
    pub fn attach_halves(
        registers: Arc<RegisterFile>,
        config: &Config,
    ) -> Result<Halves, OpenError> {
        config.check_board()?;
        let description = boards::description(config)?;
        let wiring = Wiring::find(config, &description)?;
        split(registers, config, &description, wiring)
    }
}

/// Opens a board, writes the safe values of its outputs and closes it: for a program that runs
/// after the process that drove a board without a watchdog has died.
///
/// # Errors
/// As [`Board::open_halves`].
pub fn write_safe_values(config: &Config) -> Result<(), OpenError> {
    Board::open_halves(config).map(drop)
}

fn split(
    registers: Arc<RegisterFile>,
    config: &Config,
    description: &Description,
    wiring: Wiring,
) -> Result<Halves, OpenError> {
    let bus = Bus::new(registers, description);
    verify_identity(&bus, config, description)?;
    set_watchdog(&bus, config, description)?;
    let maker = HalfMaker::new(bus.clone(), config, description, wiring);
    if !description.setup.is_empty() {
        // The set-up may switch outputs on: they are made safe before it, and after it again.
        drop((maker.digital_out(), maker.analog_out()));
        for written in &description.setup {
            bus.write(written.offset, written.value);
            bus.order_writes();
        }
    }
    let [analog_out_volts_per_code, analog_in_volts_per_code, force_torque_volts_per_code] =
        maker.volts_per_code();
    Ok(Halves {
        encoders: maker.encoders().map(|half| Box::new(half) as _),
        analog_out: maker.analog_out().map(|half| Box::new(half) as _),
        analog_in: maker.analog_in().map(|half| Box::new(half) as _),
        tactile: maker.tactile().map(|half| Box::new(half) as _),
        force_torque: maker.force_torque().map(|half| Box::new(half) as _),
        digital_in: maker.digital_in().map(|half| Box::new(half) as _),
        digital_out: maker.digital_out().map(|half| Box::new(half) as _),
        analog_out_volts_per_code,
        analog_in_volts_per_code,
        force_torque_volts_per_code,
        start: AcquisitionStart(maker.acquisitions()),
    })
}

/// All halves of a whole cell.
fn devices(halves: Halves) -> Result<Devices, OpenError> {
    for (there, half) in [
        (halves.encoders.is_some(), "encoders"),
        (halves.analog_out.is_some(), "analog_out"),
        (halves.analog_in.is_some(), "analog_in"),
        (halves.tactile.is_some(), "tactile"),
        (halves.force_torque.is_some(), "force_torque"),
        (halves.digital_in.is_some(), "digital_in"),
        (halves.digital_out.is_some(), "digital_out"),
    ] {
        if !there {
            return Err(lacking(half));
        }
    }
    Ok(Devices {
        encoders: halves.encoders,
        analog_out: halves.analog_out,
        analog_in: halves.analog_in,
        tactile: halves.tactile.map(|array| (TACTILE.to_owned(), array)).into_iter().collect(),
        force_torque: halves.force_torque,
        digital_in: halves.digital_in,
        digital_out: halves.digital_out,
        ..Devices::default()
    })
}

fn lacking(half: &str) -> OpenError {
    let remedy = "describe its registers, or open the board as a part of a cell";
    Invalid::new("board", format!("has no `{half}`"), remedy).into()
}

/// Checks that the registers are those of the described board.
fn verify_identity(bus: &Bus, config: &Config, description: &Description) -> Result<(), OpenError> {
    for expected in description.identity.iter().chain(&description.presence) {
        if State::expected(description, expected).holds(bus) {
            continue;
        }
        let mask = expected.mask.unwrap_or_else(|| description.bus_mask());
        let digits = 2 + 2 * description.bus_bytes();
        let found = bus.read(expected.offset) & mask;
        let name = expected.register.clone();
        let name = name.unwrap_or_else(|| format!("{:#x}", expected.offset));
        let what = format!(
            "register {name} reads {found:#0digits$x}, not {:#0digits$x}: no {}",
            expected.value, description.name
        );
        let remedy =
            "check that the board is powered and `map`, `offset_bytes` and `board` are right";
        return Err(error::device(&config.path, what, remedy));
    }
    Ok(())
}

/// Sets the watchdog's time, and checks that the board takes it.
fn set_watchdog(bus: &Bus, config: &Config, description: &Description) -> Result<(), OpenError> {
    let Some(watchdog) = &description.watchdog else { return Ok(()) };
    let time_us = u32::from(config.watchdog_ms) * 1_000;
    let steps = time_us / watchdog.unit_us;
    if !time_us.is_multiple_of(watchdog.unit_us)
        || steps == 0
        || steps & !description.bus_mask() != 0
    {
        let what = format!("{} ms is no number of its register", config.watchdog_ms);
        let most = u64::from(description.bus_mask()) * u64::from(watchdog.unit_us) / 1_000;
        let remedy = format!("give multiples of {} us up to {most} ms", watchdog.unit_us);
        return Err(Invalid::new("watchdog_ms", what, remedy).into());
    }
    bus.write(watchdog.offset, steps);
    let taken = bus.read(watchdog.offset);
    if taken != steps {
        let what = format!("watchdog of {steps} steps was set, {taken} reads back");
        let remedy = "choose a `watchdog_ms` that the board supports";
        return Err(error::device(&config.path, what, remedy));
    }
    Ok(())
}
