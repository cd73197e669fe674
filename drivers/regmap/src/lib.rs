//! A board that is a block of 16-bit big-endian registers in memory, like the VME boards of the
//! thesis: D/A, encoders, A/D, tactile frame, force/torque gauges, digital lines, watchdog. Behind
//! the path is a UIO device, or a plain file served by [`Loopback`] or another model. Signs, scales
//! and everything else that depends on what is wired to the board belong to the tasks above.
//!
//! System calls after opening: none. Longest operation: a tactile frame read
//! [`TORN_RETRIES`] + 1 times over, 1034 single-word reads; every other one stays below 100.
//!
//! Longest silence of both output groups: `watchdog_ms` of the config, kept by the board.
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
//! assert_eq!(devices.analog_in.sample(Nanos::ZERO)?.value[3].0, -700);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod block;
mod codes;
mod config;
mod error;
mod inputs;
mod io;
mod loopback;
mod outputs;
pub mod registers;
mod tactile;

use std::sync::Arc;

pub use taktil_hal::OpenError;
use taktil_hal::{Devices, TactileArray};

pub use block::TORN_RETRIES;
pub use config::Config;

pub use inputs::{RegisterAnalogIn, RegisterDigitalIn, RegisterEncoders, RegisterForceTorque};
pub use io::RegisterFile;
pub use loopback::Loopback;
pub use outputs::{RegisterAnalogOut, RegisterDigitalOut};
pub use tactile::RegisterTactile;

use registers::{ID, ID_VALUE, VERSION, VERSION_VALUE, WATCHDOG_MS};

/// Opens a board and splits it into its halves.
#[derive(Debug)]
pub struct Board;

impl Board {
    /// Maps the board that `config` names, locks it for this process and puts its outputs at their
    /// safe values.
    ///
    /// # Errors
    /// The config is refused, the path cannot be used, another process drives the board, or what is
    /// there is not this board. Nothing was written then, except perhaps the watchdog's time.
    pub fn open(config: &Config) -> Result<Devices, OpenError> {
        let registers = RegisterFile::open(config)?;
        registers.lock_outputs(&config.path)?;
        Board::split(Arc::new(registers), config)
    }

    /// Takes a block that is mapped already, for a model of the board in the same process;
    /// `config.path` appears in messages only.
    ///
    /// # Errors
    /// As [`Board::open`], the path apart.
    pub fn attach(registers: Arc<RegisterFile>, config: &Config) -> Result<Devices, OpenError> {
        config.check_board()?;
        Board::split(registers, config)
    }

    fn split(registers: Arc<RegisterFile>, config: &Config) -> Result<Devices, OpenError> {
        verify_identity(&registers, config)?;
        let shared = || registers.clone();
        let tactile: Box<dyn TactileArray> = Box::new(RegisterTactile::new(shared(), config));
        Ok(Devices {
            encoders: Some(Box::new(RegisterEncoders::new(shared(), config))),
            analog_out: Some(Box::new(RegisterAnalogOut::new(shared(), config))),
            analog_in: Some(Box::new(RegisterAnalogIn::new(shared(), config))),
            tactile: [(taktil_hal::TACTILE.to_owned(), tactile)].into(),
            force_torque: Some(Box::new(RegisterForceTorque::new(shared(), config))),
            digital_in: Some(Box::new(RegisterDigitalIn::new(shared(), config))),
            digital_out: Some(Box::new(RegisterDigitalOut::new(shared(), config))),
        })
    }
}

/// Checks that the registers are those of this board and layout, and that the board takes the
/// watchdog's time.
fn verify_identity(registers: &RegisterFile, config: &Config) -> Result<(), OpenError> {
    let (id, version) = (registers.read(ID), registers.read(VERSION));
    if id != ID_VALUE {
        let what = format!("register ID reads {id:#06x}, not {ID_VALUE:#06x}");
        let remedy = "check that the board is powered and `map` and `offset_bytes` are right";
        return Err(error::device(&config.path, what, remedy));
    }
    if version != VERSION_VALUE {
        let what = format!("has register layout {version}; layout {VERSION_VALUE} is known");
        return Err(error::device(&config.path, what, "use a driver of that layout"));
    }
    registers.write(WATCHDOG_MS, config.watchdog_ms);
    let taken = registers.read(WATCHDOG_MS);
    if taken != config.watchdog_ms {
        let what = format!("watchdog of {} ms was set, {taken} ms reads back", config.watchdog_ms);
        let remedy = "choose a `watchdog_ms` that the board supports";
        return Err(error::device(&config.path, what, remedy));
    }
    Ok(())
}
