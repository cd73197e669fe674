//! Emulates a board of registers: it serves the registers of a description through a file that the
//! driver maps, from another thread or process. It reads the description with a reader of its own
//! and shares no code with the driver.
//!
//! [`Emulator::step`] does what the board does up to an instant, so that a test advances it in
//! virtual time; [`serve`] does so by a clock. Behind the board stands a [`Plant`], a function from
//! what the board puts out to what its inputs read. Faults happen by a
//! [`FaultPlan`](taktil_hal::fault::FaultPlan): [`Emulator::set_faults`] says which.
//!
//! # What a file is not
//!
//! A write to the register of a board acts at once; one to a file acts when the emulator looks at
//! it next. A strobe is therefore seen once, and the board shows that by putting the register back,
//! as self-clearing bits do. A latch or a conversion whose end the board does not show (no
//! `busy_offset`), or whose busy bit stands in another register than its start, may be read before
//! the emulator has seen it: then the reading is that of the step before. Counters of a latch
//! without a busy bit are shown at every step. Of two strobes of one register between two steps the
//! first is lost.
//!
//! ```
//! use taktil_drivers_regmap_emulator::{Emulator, Inputs};
//! use taktil_hal::Nanos;
//!
//! let description = r#"
//!     name = "converters"
//!     bus_bits = 16
//!     byte_order = "big"
//!     length_bytes = 0x20
//!     [analog_out]
//!     offset = 0
//!     channels = 2
//!     bits = 12
//!     format = "offset-binary"
//!     [analog_in]
//!     offset = 0x10
//!     channels = 2
//!     bits = 12
//!     format = "twos-complement"
//! "#;
//! let path = std::env::temp_dir().join(format!("taktil-emulator-{}", std::process::id()));
//! let echo = Box::new(|_: Nanos, outputs: &taktil_drivers_regmap_emulator::Outputs| Inputs {
//!     codes: outputs.codes.clone(),
//!     ..Inputs::default()
//! });
//! let mut board = Emulator::new("board", description, &path, 0, echo)?;
//! let driver = std::fs::File::options().write(true).open(&path)?;
//! std::os::unix::fs::FileExt::write_all_at(&driver, &[0x07, 0xff], 2)?;
//! board.step(Nanos::ZERO)?;
//! assert_eq!(board.outputs().codes, [0, -1]);
//! assert_eq!(std::fs::read(&path)?[0x10..0x14], [0, 0, 0x0f, 0xff]);
//! std::fs::remove_file(&path)?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod emulator;
mod layout;
mod memory;
mod serve;
mod text;

pub use emulator::{CONVERSION_TIME, Emulator, FAULT_KINDS, Inputs, Outputs, Plant};
pub use serve::serve;
