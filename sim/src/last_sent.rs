//! The readings that the world last sent to its devices, kept so that a restored world can send
//! them anew. Which of them a controller has read is not recorded.

use taktil_hal::link::Sender;
use taktil_hal::{AdcCode, CHANNELS, LinesIn, Nanos};

use crate::devices::{BoardSpec, Scan, TactileSpec};
use crate::scene::{ScanStamp, TactileConfig};

/// The latest readings, beside those that the world stores anyway.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct LastSent {
    /// The arm's boards.
    pub(crate) board: BoardSpec,
    /// The scans of the finger's array, and of the array opposed to it where one exists.
    pub(crate) feeds: [Option<ScanFeed>; 2],
    /// Motor currents, lines and their instant.
    pub(crate) control: Option<([AdcCode; CHANNELS], LinesIn, Nanos)>,
}

impl LastSent {
    /// The description of each array.
    pub(crate) fn tactile_specs(&self) -> [Option<TactileSpec>; 2] {
        [0, 1].map(|tip: usize| self.feeds[tip].as_ref().map(|feed| feed.spec))
    }
}

/// The description of a tactile array, and the scans that it sent.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ScanFeed {
    pub(crate) spec: TactileSpec,
    /// The delay of its scans.
    pub(crate) delivery: ScanDelivery,
    /// The newest scans, whether taken or on their way: the scan, its stamp and the instant from
    /// which it is visible.
    pub(crate) scans: [Option<(Scan, Nanos, Nanos)>; SCAN_HISTORY_MAX],
}

/// Number of scans that can be on their way, and two before them.
const SCAN_HISTORY_MAX: usize = 32;

/// Delay of the scans, and whether their stamps hide it.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ScanDelivery {
    /// Delay in scan periods.
    pub(crate) delay_scans: u32,
    /// Whether a scan carries the instant of its arrival instead of that of its acquisition.
    pub(crate) hidden: bool,
}

impl ScanDelivery {
    pub(crate) fn of(config: &TactileConfig) -> ScanDelivery {
        ScanDelivery {
            delay_scans: config.delay_scans,
            hidden: config.stamp == ScanStamp::Delivered,
        }
    }

    /// The stamp of a scan that is complete at `t`, and the instant from which it is visible.
    pub(crate) fn instants(&self, t: Nanos, period: Nanos) -> (Nanos, Nanos) {
        let visible = t + period * i64::from(self.delay_scans);
        (if self.hidden { visible } else { t }, visible)
    }
}

impl ScanFeed {
    pub(crate) fn of(config: &TactileConfig) -> ScanFeed {
        let row = Nanos((1e3 * config.row_us).round() as i64);
        let spec = TactileSpec { full_scale: config.full_counts(), row };
        ScanFeed { spec, delivery: ScanDelivery::of(config), ..ScanFeed::default() }
    }

    /// Stores a scan that was sent; the oldest scans are dropped.
    pub(crate) fn record(&mut self, scan: Scan, stamp: Nanos, visible: Nanos) {
        let kept = (self.delivery.delay_scans as usize + 2).min(SCAN_HISTORY_MAX);
        self.scans[..kept].rotate_right(1);
        self.scans[0] = Some((scan, stamp, visible));
    }

    /// Sends, at `now`, the newest scan that was visible and all scans that were not visible yet.
    pub(crate) fn send(&self, to: &mut Sender<Scan>, now: Nanos) {
        let first = self.scans.iter().flatten().position(|(_, _, visible)| *visible <= now);
        let count = first.map_or(SCAN_HISTORY_MAX, |first| first + 1);
        for (scan, stamp, visible) in self.scans[..count].iter().rev().flatten() {
            let _ = to.send(*scan, *stamp, *visible);
        }
    }
}
