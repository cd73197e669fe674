//! The configuration of a tactile array on a serial line as a machine file states it, and what
//! follows from it for the board named there.

use serde::Deserialize;
use taktil_hal::{Invalid, Nanos};

/// The most rows of an array.
pub const ROWS_MAX: u16 = 64;
/// The most columns of an array.
pub const COLS_MAX: u16 = 64;

taktil_hal::explained! {
    /// Which board is at the end of the line.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
    #[serde(rename_all = "kebab-case")]
    pub enum BoardKind {
        /// Myrmex v2, 16 x 16 tactels of 12 bits, AGNI serial protocol over USB.
        #[default]
        Myrmex,
        /// FlexiTac, one byte a tactel, 2 Mbaud, streams by itself.
        Flexitac,
        /// Weiss WTS over USB.
        WeissWts,
        /// Weiss DSA over RS232.
        WeissDsa,
    }
}

taktil_hal::explained! {
    /// What pressure does to a count on the wire. It is not public for Myrmex v2.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
    #[serde(rename_all = "kebab-case")]
    pub enum Pressure {
        /// Counts grow under pressure.
        #[default]
        Raises,
        /// Counts fall under pressure: they are handed out as full scale less count.
        Lowers,
    }
}

taktil_hal::explained! {
    /// A tactile array on a serial line. Only `path` and `board` have no useful default.
    #[derive(Clone, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Config {
        /// The port, best by a name that stays, such as `/dev/serial/by-id/...`.
        pub path: String,
        /// The board. Default `myrmex`.
        pub board: BoardKind,
        /// Rows. Default 16, which Myrmex needs.
        pub rows: u16 [1.0, 64.0],
        /// Columns. Default 16, which Myrmex needs.
        pub cols: u16 [1.0, 64.0],
        /// Speed of the line (baud). Default 0: the board's own, 2000000 for FlexiTac, 115200 for
        /// the others; USB ports take any and ignore it.
        pub baud: u32 [0.0, 4e6],
        /// Scans a second (Hz), which Myrmex and Weiss are told. Default 100.
        pub rate_hz: f64 [10.0, 1000.0],
        /// How long a scan of all rows takes (us). Default 0: the period of `rate_hz`.
        pub scan_us: u32 [0.0, 1e6],
        /// How long a message takes on the wire (us). Default 0: its length at the speed of the
        /// line, or at 1 byte/us over USB.
        pub transfer_us: u32 [0.0, 1e6],
        /// A constant delay behind the wire that nothing here can see, such as an adapter's timer
        /// (us). Default 0.
        pub latency_us: u32 [0.0, 1e5],
        /// The count at which a tactel saturates. Default 0: the board's own, 4095, or 255 for
        /// FlexiTac.
        pub full_scale: u16 [0.0, 65535.0],
        /// What pressure does to a count on the wire. Default `raises`.
        pub pressure: Pressure,
        /// Number of the logical sensor of Myrmex, from 1; default 0: the first one with 512 bytes.
        /// Number of the matrix of DSA, from 0. Unused otherwise.
        pub sensor: u8 [0.0, 201.0],
        /// Whether DSA compresses runs of equal counts. Default true: without it a real line
        /// carries 21.9 scans/s of 16 x 16.
        pub compress: bool,
        /// How long the start-up dialogue may take (ms). Default 10000: DSA is deaf for 8 s after
        /// power-up.
        pub start_timeout_ms: u32 [100.0, 60000.0],
        /// Share of missing or damaged scans in a window above which the line is degraded.
        /// Default 0.02.
        pub degraded_share: f64 [0.0, 1.0],
        /// Share of missing or damaged scans in a window above which the line is lost. Default 0.5.
        pub lost_share: f64 [0.0, 1.0],
        /// Length of a window (ms). Default 1000.
        pub window_ms: u32 [10.0, 60000.0],
        /// Silence after which the line is lost and the dialogue begins again (ms). Default 500.
        pub lost_after_ms: u32 [10.0, 60000.0],
        /// First pause before a vanished port is opened again (ms); it doubles up to
        /// `retry_max_ms`. Default 50.
        pub retry_min_ms: u32 [1.0, 60000.0],
        /// Longest pause before a vanished port is opened again (ms). Default 1000.
        pub retry_max_ms: u32 [1.0, 60000.0],
        /// Scans that may wait for the lane. Default 32.
        pub queue_scans: u32 [2.0, 1024.0],
    }
}

impl Default for Config {
    fn default() -> Config {
        Config {
            path: String::new(),
            board: BoardKind::default(),
            rows: 16,
            cols: 16,
            baud: 0,
            rate_hz: 100.0,
            scan_us: 0,
            transfer_us: 0,
            latency_us: 0,
            full_scale: 0,
            pressure: Pressure::default(),
            sensor: 0,
            compress: true,
            start_timeout_ms: 10_000,
            degraded_share: 0.02,
            lost_share: 0.5,
            window_ms: 1_000,
            lost_after_ms: 500,
            retry_min_ms: 50,
            retry_max_ms: 1_000,
            queue_scans: 32,
        }
    }
}

/// Shape and timing of an array, with every default resolved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ArrayGeometry {
    /// Rows, 1 to [`ROWS_MAX`].
    pub rows: usize,
    /// Columns, 1 to [`COLS_MAX`].
    pub cols: usize,
    /// The count at which a tactel saturates.
    pub full_scale: u16,
    /// What pressure does to a count on the wire.
    pub pressure: Pressure,
    /// Nominal period of scans.
    pub period: Nanos,
    /// From the read of one row to that of the next.
    pub row_period: Nanos,
    /// Time of one byte on the wire.
    pub byte_time: Nanos,
    /// Time of a message on the wire, where it does not follow from its length.
    pub transfer: Option<Nanos>,
    /// A constant delay behind the wire.
    pub latency: Nanos,
}

/// Time of one byte over USB at full speed, about what bulk transfers reach.
const USB_BYTE_TIME: Nanos = Nanos(1_000);
/// Bits of a byte on a line without parity: start, eight, stop.
const BITS_A_BYTE: i64 = 10;

impl Config {
    /// Checks every field against the range it states, and against what a frame of this build can
    /// carry.
    ///
    /// # Errors
    /// The first value that cannot be used, with the way out.
    pub fn check(&self) -> Result<(), Invalid> {
        self.check_array()?;
        if self.path.is_empty() {
            let remedy = "name a port such as /dev/ttyACM0";
            return Err(Invalid::new("path", "no path is given", remedy));
        }
        Ok(())
    }

    /// Checks everything but the port and the limits of frames.
    pub(crate) fn check_array(&self) -> Result<(), Invalid> {
        for key in <Config as taktil_hal::explain::Explain>::keys() {
            let (Some((low, high)), Some(value)) = (key.range, self.number(&key.path)) else {
                continue;
            };
            if !(low..=high).contains(&value) {
                let what = format!("{value} is out of bounds");
                return Err(Invalid::new(key.path, what, format!("give {low} to {high}")));
            }
        }
        if self.board == BoardKind::Myrmex && (self.rows, self.cols) != (16, 16) {
            let what = format!("Myrmex v2 has 16 x 16 tactels, not {} x {}", self.rows, self.cols);
            return Err(Invalid::new("rows", what, "leave out `rows` and `cols`"));
        }
        if self.retry_min_ms > self.retry_max_ms {
            let what = format!("{} ms is above `retry_max_ms`", self.retry_min_ms);
            return Err(Invalid::new("retry_min_ms", what, "give less, or raise `retry_max_ms`"));
        }
        if self.board == BoardKind::Flexitac && self.full_scale > 255 {
            let what = format!("{} is more than a byte holds", self.full_scale);
            return Err(Invalid::new("full_scale", what, "give 1 to 255"));
        }
        Ok(())
    }

    fn number(&self, key: &str) -> Option<f64> {
        Some(match key {
            "rows" => f64::from(self.rows),
            "cols" => f64::from(self.cols),
            "baud" => f64::from(self.baud),
            "rate_hz" => self.rate_hz,
            "scan_us" => f64::from(self.scan_us),
            "transfer_us" => f64::from(self.transfer_us),
            "latency_us" => f64::from(self.latency_us),
            "full_scale" => f64::from(self.full_scale),
            "sensor" => f64::from(self.sensor),
            "start_timeout_ms" => f64::from(self.start_timeout_ms),
            "degraded_share" => self.degraded_share,
            "lost_share" => self.lost_share,
            "window_ms" => f64::from(self.window_ms),
            "lost_after_ms" => f64::from(self.lost_after_ms),
            "retry_min_ms" => f64::from(self.retry_min_ms),
            "retry_max_ms" => f64::from(self.retry_max_ms),
            "queue_scans" => f64::from(self.queue_scans),
            _ => return None,
        })
    }

    /// The speed that the port is set to (baud).
    #[must_use]
    pub fn line_baud(&self) -> u32 {
        match (self.baud, self.board) {
            (0, BoardKind::Flexitac) => 2_000_000,
            (0, _) => 115_200,
            (baud, _) => baud,
        }
    }

    /// Shape and timing, with defaults resolved.
    #[must_use]
    pub fn geometry(&self) -> ArrayGeometry {
        let (rows, cols) = (usize::from(self.rows), usize::from(self.cols));
        let (own_scale, usb) = match self.board {
            BoardKind::Myrmex | BoardKind::WeissWts => (4_095, true),
            BoardKind::Flexitac => (255, false),
            BoardKind::WeissDsa => (4_095, false),
        };
        let line = Nanos(BITS_A_BYTE * 1_000_000_000 / i64::from(self.line_baud().max(1)));
        let byte_time = if usb { USB_BYTE_TIME } else { line };
        let period = Nanos((1e9 / self.rate_hz) as i64);
        let given = |us: u32| (us > 0).then(|| Nanos::from_micros(i64::from(us)));
        let scan = given(self.scan_us).unwrap_or(period);
        ArrayGeometry {
            rows,
            cols,
            full_scale: if self.full_scale == 0 { own_scale } else { self.full_scale },
            pressure: self.pressure,
            period,
            row_period: Nanos(scan.0 / rows.max(1) as i64),
            byte_time,
            transfer: given(self.transfer_us),
            latency: Nanos::from_micros(i64::from(self.latency_us)),
        }
    }
}
