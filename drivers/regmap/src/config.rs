//! The configuration of a register board as a machine file states it. Signs and scales are not part
//! of it: they belong to the software that knows the wiring.

use std::path::{Path, PathBuf};

use serde::Deserialize;
use taktil_hal::{FORCE_TORQUE_CHANNELS, Invalid};

use crate::description::Description;
use crate::description::within;
use crate::registers::{BLOCK_BYTES, LAYOUT_CHANNELS};
use crate::shipped::{BOARD_FILE_SUFFIX, check_name};

taktil_hal::explained! {
    /// A register board. Only `path` has no default. Without `board` and `registers` it is one of
    /// the project's own layout.
    #[derive(Clone, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Config {
        /// A UIO device such as `/dev/uio0`, the memory of a PCI device such as
        /// `/sys/bus/pci/devices/0000:03:00.0/resource2`, or a plain file that a model of the board
        /// serves.
        pub path: PathBuf,
        /// The description of the board's registers: a file that ends in `.toml`, or the name of
        /// one that comes with the driver: `dvme-628`, `lxvme-s01`, `vme-8605`, `vme-arm`,
        /// `taktil`. By default the project's own layout.
        pub board: String,
        /// The description itself, in place of `board`.
        pub registers: Option<Description>,
        /// Vendor and device of the PCI device that `path` has to be a resource of, such as
        /// `10b5:9050`. By default any.
        pub pci_id: Option<String>,
        /// The name of the UIO device that `path` has to be. By default any.
        pub uio_name: Option<String>,
        /// Which of a UIO device's memory maps holds the block; 0 for a plain file. Default 0.
        pub map: u8,
        /// Where the block starts in the map or file, in bytes, a multiple of a register's bytes.
        /// Default 0.
        pub offset_bytes: usize,
        /// How many bytes to map from there, of the project's own layout: at least and by default
        /// [`BLOCK_BYTES`].
        pub length_bytes: usize,
        /// The board's counters that are wired to the joints' encoders, in the order of the joints.
        /// By default all, in their order. Not for the project's own layout.
        pub encoder_channels: Vec<usize>,
        /// The board's D/A channels that are wired, in the order of the outputs; the others keep
        /// the safe value. By default all. Not for the project's own layout.
        pub analog_out_channels: Vec<usize>,
        /// The board's A/D channels that are wired, in the order of the inputs. By default all. Not
        /// for the project's own layout.
        pub analog_in_channels: Vec<usize>,
        /// The board's A/D channels to which the six gauges of a force/torque sensor are wired. By
        /// default none is.
        pub gauge_channels: Vec<usize>,
        /// Encoders wired, 1 to 8. Default 6. Project's own layout only.
        pub joints: usize [1.0, LAYOUT_CHANNELS as f64],
        /// D/A channels wired, 1 to 8. Default 8. Project's own layout only.
        pub dac_channels: usize [1.0, LAYOUT_CHANNELS as f64],
        /// A/D channels wired, 1 to 8. Default 8. Project's own layout only.
        pub adc_channels: usize [1.0, LAYOUT_CHANNELS as f64],
        /// Width of the D/A converters, 2 to 16 bits. Default 12. Project's own layout only.
        pub dac_bits: u32 [2.0, 16.0],
        /// Width of the A/D converters, 2 to 16 bits. Default 12. Project's own layout only.
        pub adc_bits: u32 [2.0, 16.0],
        /// Width of the force/torque gauges' converters, 2 to 16 bits. Default 12. Project's own
        /// layout only.
        pub gauge_bits: u32 [2.0, 16.0],
        /// Width of the encoder counters, 8 to 32 bits; narrower ones are carried across their
        /// wrap. Default 32. Project's own layout only.
        pub counter_bits: u32 [8.0, 32.0],
        /// Width of a tactel's count, 2 to 16 bits. Default 12. Project's own layout only.
        pub tactile_bits: u32 [2.0, 16.0],
        /// How long a scan of the tactile array takes, in microseconds: the rows of a frame are
        /// stamped evenly over it. Default 5000. Project's own layout only.
        pub tactile_scan_us: u32 [1.0, 1e6],
        /// After how long without a commit (D/A) or a change of the feed line (digital lines) a
        /// board with a watchdog goes safe by itself, in milliseconds. Default 10: four cycles of
        /// 2.5 ms.
        pub watchdog_ms: u16 [1.0, TIME_MAX_MS as f64],
        /// For a board with outputs and no watchdog: after how long without a sign of life whatever
        /// stands behind it (a relay on the feed line, the amplifiers' own supervision) takes the
        /// drives off, in milliseconds. It has no default, because the board itself never does.
        pub relay_ms: Option<u16> [1.0, TIME_MAX_MS as f64],
        /// After how long without a new number on a block its readings count as stale, in
        /// milliseconds. Default 10.
        pub stale_ms: u16 [1.0, TIME_MAX_MS as f64],
    }
}

/// The longest watchdog time and the longest staleness (ms).
pub const TIME_MAX_MS: u16 = 10_000;
/// The longest scan of the tactile array (us).
const TACTILE_SCAN_MAX_US: u32 = 1_000_000;

impl Default for Config {
    fn default() -> Config {
        Config {
            path: PathBuf::new(),
            board: String::new(),
            registers: None,
            pci_id: None,
            uio_name: None,
            map: 0,
            offset_bytes: 0,
            length_bytes: BLOCK_BYTES,
            encoder_channels: Vec::new(),
            analog_out_channels: Vec::new(),
            analog_in_channels: Vec::new(),
            gauge_channels: Vec::new(),
            joints: 6,
            dac_channels: LAYOUT_CHANNELS,
            adc_channels: LAYOUT_CHANNELS,
            dac_bits: 12,
            adc_bits: 12,
            gauge_bits: 12,
            counter_bits: 32,
            tactile_bits: 12,
            tactile_scan_us: 5_000,
            watchdog_ms: 10,
            relay_ms: None,
            stale_ms: 10,
        }
    }
}

impl Config {
    /// A described board behind a path: `board` is the name of a description that comes with the
    /// driver, or a file.
    #[must_use]
    pub fn described(path: impl Into<PathBuf>, board: &str) -> Config {
        Config { path: path.into(), board: board.to_owned(), ..Config::default() }
    }

    /// Whether the registers are described by `board` or `registers`, not by the project's own
    /// layout.
    #[must_use]
    pub fn is_described(&self) -> bool {
        self.registers.is_some() || !self.board.is_empty()
    }

    /// The same configuration with a relative file in `board` taken from a folder: that of the file
    /// in which the configuration stands.
    #[must_use]
    pub fn beside(mut self, folder: &Path) -> Config {
        if self.board.ends_with(BOARD_FILE_SUFFIX) {
            self.board = folder.join(&self.board).display().to_string();
        }
        self
    }

    /// Checks every field against the bounds that it states. A file named by `board` is not read.
    ///
    /// # Errors
    /// The first value that is outside the bounds its field states.
    pub fn check(&self) -> Result<(), Invalid> {
        if self.path.as_os_str().is_empty() {
            let remedy = "name a UIO device such as /dev/uio0, a PCI resource, or a file";
            return Err(Invalid::new("path", "no path is given", remedy));
        }
        self.check_window()?;
        self.check_board()
    }

    /// Checks everything but where the board is.
    pub(crate) fn check_board(&self) -> Result<(), Invalid> {
        self.check_identity()?;
        within("watchdog_ms", self.watchdog_ms, 1..=TIME_MAX_MS)?;
        within("stale_ms", self.stale_ms, 1..=TIME_MAX_MS)?;
        if let Some(relay_ms) = self.relay_ms {
            within("relay_ms", relay_ms, 1..=TIME_MAX_MS)?;
        }
        for (key, channels) in self.selections() {
            for (at, channel) in channels.iter().enumerate() {
                if channels[..at].contains(channel) {
                    let what = format!("channel {channel} is listed twice");
                    let remedy = "list each channel once";
                    return Err(Invalid::new(format!("{key}[{at}]"), what, remedy));
                }
            }
        }
        if !self.gauge_channels.is_empty() && self.gauge_channels.len() != FORCE_TORQUE_CHANNELS {
            let what = format!("{} channels are listed", self.gauge_channels.len());
            let remedy = "list the six channels of the gauges, or none";
            return Err(Invalid::new("gauge_channels", what, remedy));
        }
        if self.is_described() { self.check_described() } else { self.check_own_layout() }
    }

    /// The lists of channels with their keys.
    pub(crate) fn selections(&self) -> [(&'static str, &[usize]); 4] {
        [
            ("encoder_channels", &self.encoder_channels),
            ("analog_out_channels", &self.analog_out_channels),
            ("analog_in_channels", &self.analog_in_channels),
            ("gauge_channels", &self.gauge_channels),
        ]
    }

    fn check_identity(&self) -> Result<(), Invalid> {
        if self.pci_id.is_some() && self.uio_name.is_some() {
            let remedy = "give the one that fits `path`";
            return Err(Invalid::new("uio_name", "is given beside `pci_id`", remedy));
        }
        let Some(id) = &self.pci_id else { return Ok(()) };
        let hexadecimal =
            |part: &str| part.len() == 4 && part.chars().all(|digit| digit.is_ascii_hexdigit());
        if id
            .split_once(':')
            .is_some_and(|(vendor, device)| hexadecimal(vendor) && hexadecimal(device))
        {
            return Ok(());
        }
        let remedy = "give vendor:device as `lspci -n` does, such as 10b5:9050";
        Err(Invalid::new("pci_id", format!("`{id}` is no pair of numbers"), remedy))
    }

    fn check_own_layout(&self) -> Result<(), Invalid> {
        for (key, channels) in self.selections().into_iter().take(3) {
            if !channels.is_empty() {
                let remedy = "set `joints`, `dac_channels` and `adc_channels`, or name a `board`";
                return Err(Invalid::new(key, "does not go with the project's layout", remedy));
            }
        }
        within("joints", self.joints, 1..=LAYOUT_CHANNELS)?;
        within("dac_channels", self.dac_channels, 1..=LAYOUT_CHANNELS)?;
        within("adc_channels", self.adc_channels, 1..=LAYOUT_CHANNELS)?;
        within("dac_bits", self.dac_bits, 2..=16)?;
        within("adc_bits", self.adc_bits, 2..=16)?;
        within("gauge_bits", self.gauge_bits, 2..=16)?;
        within("tactile_bits", self.tactile_bits, 2..=16)?;
        within("counter_bits", self.counter_bits, 8..=32)?;
        within("tactile_scan_us", self.tactile_scan_us, 1..=TACTILE_SCAN_MAX_US)
    }

    /// The keys of the project's own layout have their defaults, and the description is sound.
    fn check_described(&self) -> Result<(), Invalid> {
        let own = Config::default();
        let given = [
            ("length_bytes", self.length_bytes != own.length_bytes),
            ("joints", self.joints != own.joints),
            ("dac_channels", self.dac_channels != own.dac_channels),
            ("adc_channels", self.adc_channels != own.adc_channels),
            ("dac_bits", self.dac_bits != own.dac_bits),
            ("adc_bits", self.adc_bits != own.adc_bits),
            ("gauge_bits", self.gauge_bits != own.gauge_bits),
            ("counter_bits", self.counter_bits != own.counter_bits),
            ("tactile_bits", self.tactile_bits != own.tactile_bits),
            ("tactile_scan_us", self.tactile_scan_us != own.tactile_scan_us),
        ];
        if let Some((key, _)) = given.into_iter().find(|(_, given)| *given) {
            let remedy = "the description states it; for wired channels take `..._channels`";
            return Err(Invalid::new(key, "does not go with a described board", remedy));
        }
        if let (Some(_), false) = (&self.registers, self.board.is_empty()) {
            let remedy = "name a description or write it here, not both";
            return Err(Invalid::new("registers", "is given beside `board`", remedy));
        }
        match &self.registers {
            Some(description) => description.check().map_err(|bad| bad.within("registers")),
            None => check_name(&self.board),
        }
    }

    fn check_window(&self) -> Result<(), Invalid> {
        let length = isize::MAX.cast_unsigned();
        within("length_bytes", self.length_bytes, BLOCK_BYTES..=length)?;
        if !self.is_described() && !self.offset_bytes.is_multiple_of(2) {
            let what = format!("{} is odd", self.offset_bytes);
            let remedy = "registers are 16-bit words: give an even offset";
            return Err(Invalid::new("offset_bytes", what, remedy));
        }
        within("offset_bytes", self.offset_bytes, 0..=length - self.length_bytes)
    }
}
