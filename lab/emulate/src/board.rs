//! The boards that can be emulated: their names, what they serve of a robot, and the faults that
//! can befall them. A new board has a variant here, and an arm wherever the compiler then misses
//! one.

use std::fmt;
use std::str::FromStr;

use taktil_drivers_can_emulator as can;
use taktil_drivers_ethercat_emulator as ethercat;
use taktil_drivers_mesa_emulator as mesa;
use taktil_drivers_netft_emulator as netft;
use taktil_drivers_regmap_emulator as regmap;
use taktil_drivers_serial_emulator as serial;
use taktil_drivers_serial_emulator::{Board, FlexiTac, Myrmex, WeissDsa, WeissWts};
use taktil_hal::Nanos;
use taktil_hal::fault::{FaultCounts, FaultKind};

/// A board that can be emulated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BoardKind {
    /// A HostMot2 card (7I92) with a 7I77, on UDP: encoders, analog outputs and lines.
    Mesa,
    /// Myrmex v2, 16 x 16 tactels of 12 bits, on a serial line.
    Myrmex,
    /// FlexiTac, one byte a tactel, on a serial line.
    Flexitac,
    /// Weiss WTS, 12 bits, on a serial line.
    WeissWts,
    /// Weiss DSA, 12 bits, on a serial line.
    WeissDsa,
    /// A board of registers of the project's own layout, in a file: a whole cell.
    Regmap,
    /// The boards of an arm in one window on a VME bus, in a file: encoders, D/A, A/D, no lines.
    VmeArm,
    /// A segment of drives by CiA 402 and a terminal with lines, on a network interface.
    Ethercat,
    /// Drives of CANopen, one for each motor, on a CAN bus: torques, positions, lines.
    Can,
    /// An ATI Net F/T box on UDP: the gauges of the wrist.
    Netft,
}

impl BoardKind {
    /// All boards, in the order of their declaration.
    pub const ALL: [BoardKind; 10] = [
        BoardKind::Mesa,
        BoardKind::Myrmex,
        BoardKind::Flexitac,
        BoardKind::WeissWts,
        BoardKind::WeissDsa,
        BoardKind::Regmap,
        BoardKind::VmeArm,
        BoardKind::Ethercat,
        BoardKind::Can,
        BoardKind::Netft,
    ];

    /// Its name on the command line and in a plan of faults.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            BoardKind::Mesa => "mesa",
            BoardKind::Myrmex => "myrmex",
            BoardKind::Flexitac => "flexitac",
            BoardKind::WeissWts => "weiss-wts",
            BoardKind::WeissDsa => "weiss-dsa",
            BoardKind::Regmap => "regmap",
            BoardKind::VmeArm => "vme-arm",
            BoardKind::Ethercat => "ethercat",
            BoardKind::Can => "can",
            BoardKind::Netft => "netft",
        }
    }

    /// Whether it is a tactile array on a serial line.
    #[must_use]
    pub const fn is_tactile(self) -> bool {
        match self {
            BoardKind::Mesa
            | BoardKind::Regmap
            | BoardKind::VmeArm
            | BoardKind::Can
            | BoardKind::Ethercat
            | BoardKind::Netft => false,
            BoardKind::Myrmex | BoardKind::Flexitac | BoardKind::WeissWts | BoardKind::WeissDsa => {
                true
            }
        }
    }

    /// Whether it drives the scene's motors, of which there is one set.
    #[must_use]
    pub const fn is_motor_board(self) -> bool {
        !self.is_tactile() && !matches!(self, BoardKind::Netft)
    }

    /// The description of a board of registers; `None` for a board that is none.
    pub(crate) const fn registers(self) -> Option<&'static str> {
        match self {
            BoardKind::Regmap => Some(include_str!("../../../drivers/regmap/boards/taktil.toml")),
            BoardKind::VmeArm => Some(include_str!("../../../drivers/regmap/boards/vme-arm.toml")),
            _ => None,
        }
    }

    /// The kinds of faults that can befall it.
    #[must_use]
    pub const fn fault_kinds(self) -> &'static [FaultKind] {
        match self {
            BoardKind::Mesa => &mesa::EXECUTED_FAULTS,
            BoardKind::Ethercat => &ethercat::EXECUTED_FAULTS,
            BoardKind::Regmap | BoardKind::VmeArm => &regmap::FAULT_KINDS,
            BoardKind::Can => &can::EXECUTED_FAULTS,
            BoardKind::Netft => &netft::EXECUTED_FAULTS,
            BoardKind::Myrmex | BoardKind::Flexitac | BoardKind::WeissWts | BoardKind::WeissDsa => {
                &serial::EXECUTED_FAULTS
            }
        }
    }

    /// Width of a tactel's count on a serial line (bits); 0 for a board that is on none.
    #[must_use]
    pub(crate) const fn tactel_bits(self) -> u32 {
        match self {
            BoardKind::Mesa
            | BoardKind::Regmap
            | BoardKind::VmeArm
            | BoardKind::Can
            | BoardKind::Ethercat
            | BoardKind::Netft => 0,
            BoardKind::Flexitac => 8,
            BoardKind::Myrmex | BoardKind::WeissWts | BoardKind::WeissDsa => 12,
        }
    }

    /// A tactile board of `rows` x `cols` tactels that scans at `rate_hz` until it is told
    /// otherwise; `None` for a board that is none.
    pub(crate) fn tactile_board(
        self,
        rows: usize,
        cols: usize,
        rate_hz: f64,
    ) -> Option<Box<dyn Board>> {
        let (short_rows, short_cols) = (u16::try_from(rows).ok()?, u16::try_from(cols).ok()?);
        Some(match self {
            BoardKind::Mesa
            | BoardKind::Regmap
            | BoardKind::VmeArm
            | BoardKind::Can
            | BoardKind::Ethercat
            | BoardKind::Netft => return None,
            BoardKind::Myrmex => Box::new(Myrmex::new(rate_hz)),
            BoardKind::Flexitac => Box::new(FlexiTac::new(rows, cols, rate_hz)),
            BoardKind::WeissWts => Box::new(WeissWts::new(short_rows, short_cols, rate_hz)),
            BoardKind::WeissDsa => Box::new(WeissDsa::new(short_rows, short_cols, rate_hz)),
        })
    }
}

impl fmt::Display for BoardKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for BoardKind {
    type Err = String;

    fn from_str(text: &str) -> Result<BoardKind, String> {
        BoardKind::ALL.into_iter().find(|kind| kind.name() == text).ok_or_else(|| {
            let names = BoardKind::ALL.map(BoardKind::name).join(", ");
            format!("no board is called so; name some of: {names}")
        })
    }
}

/// What passed between a board and its host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Traffic {
    /// A card.
    Card {
        /// Datagrams and the faults that befell them.
        link: mesa::Traffic,
        /// How often the FPGA's watchdog has bitten.
        bites: u64,
        /// Commands to smart serial that came while another one was under way.
        overrun_commands: u64,
        /// The longest time for which its outputs stayed on after an exchange with its host.
        unattended: Nanos,
    },
    /// An EtherCAT segment.
    Segment {
        /// Frames and the faults that befell them.
        link: ethercat::Traffic,
        /// How often the watchdog of a device has bitten.
        bites: u64,
    },
    /// A tactile array on a serial line.
    Line(serial::Traffic),
    /// A board of registers.
    Memory {
        /// How often what it puts out has changed.
        changes: u64,
        /// Scans of the tactile array that were shown.
        scans: u64,
    },
    /// Drives on a CAN bus.
    Bus(can::Traffic),
    /// A force/torque box.
    Wrist(netft::Traffic),
}

impl Traffic {
    /// The messages and readings that faults befell; a board of registers does not count them.
    #[must_use]
    pub fn faults(&self) -> FaultCounts {
        match self {
            Traffic::Card { link, .. } => link.faults,
            Traffic::Segment { link, .. } => link.faults,
            Traffic::Line(line) => line.faults,
            Traffic::Memory { .. } => FaultCounts::default(),
            Traffic::Bus(bus) => bus.faults,
            Traffic::Wrist(wrist) => wrist.faults,
        }
    }
}

impl fmt::Display for Traffic {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Traffic::Card { link, bites, overrun_commands, unattended } => write!(
                f,
                "{} requests, {} answers, {bites} watchdog bites, {overrun_commands} commands too \
                 early, outputs on without a host for {:.2} ms at most",
                link.requests,
                link.answers,
                unattended.as_micros_f64() / 1e3
            )?,
            Traffic::Segment { link, bites } => write!(
                f,
                "{} frames, {} of them cyclic, {} answers, {bites} watchdog bites",
                link.frames, link.cyclic, link.answers
            )?,
            Traffic::Memory { changes, scans } => {
                write!(f, "{changes} changes of the outputs, {scans} scans shown")?;
            }
            Traffic::Bus(bus) => {
                write!(f, "{} frames of the host, {} of the drives", bus.heard, bus.said)?;
            }
            Traffic::Wrist(wrist) => {
                write!(f, "{} requests, {} records", wrist.requests, wrist.records)?;
            }
            Traffic::Line(line) => write!(
                f,
                "{} scans, {} messages out, {} bytes in",
                line.scans, line.messages, line.bytes_in
            )?,
        }
        if matches!(self, Traffic::Memory { .. }) {
            return Ok(());
        }
        f.write_str("; faults: ")?;
        let faults = self.faults();
        let mut any = false;
        for (kind, count) in faults.iter() {
            write!(f, "{}{} {count}", if any { ", " } else { "" }, kind.name())?;
            any = true;
        }
        f.write_str(if any { "" } else { "none" })
    }
}
