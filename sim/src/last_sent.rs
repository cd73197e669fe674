//! The readings that the world last sent to its devices, kept so that a restored world can send
//! them anew. Which of them a controller has read is not recorded.

use taktil_hal::{AdcCode, CHANNELS, LinesIn, Nanos};

use crate::devices::{ARRAYS_MAX, BoardSpec, TactileSpec};
use crate::scan_link::{Scan, ScanSender};
use crate::scene::{ScanStamp, TactileConfig};

/// The latest readings, beside those that the world stores anyway.
#[derive(Clone, Debug, Default)]
pub(crate) struct LastSent {
    /// The arm's boards.
    pub(crate) board: BoardSpec,
    /// The scans of the finger's array and of the array opposed to it where one exists, or of a
    /// hand's arrays.
    pub(crate) feeds: [Option<ScanFeed>; ARRAYS_MAX],
    /// Motor currents, lines and their instant.
    pub(crate) control: Option<([AdcCode; CHANNELS], LinesIn, Nanos)>,
}

impl LastSent {
    /// The description of each array.
    pub(crate) fn tactile_specs(&self) -> [Option<TactileSpec>; ARRAYS_MAX] {
        core::array::from_fn(|tip| self.feeds[tip].as_ref().map(|feed| feed.spec))
    }
}

/// The description of a tactile array, and the scans that it sent.
#[derive(Clone, Debug, Default)]
pub(crate) struct ScanFeed {
    pub(crate) spec: TactileSpec,
    /// The delay of its scans.
    pub(crate) delivery: ScanDelivery,
    /// The newest scans, whether taken or on their way, newest first: as many as can be on their
    /// way, and two before them.
    scans: Box<[Scan]>,
    /// Number of scans that were sent, as far as they are stored.
    count: usize,
}

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
    /// The feed of an array without any scan, by its name among the devices. Allocates.
    pub(crate) fn of(config: &TactileConfig, name: &'static str) -> ScanFeed {
        let row = Nanos((1e3 * config.row_us).round() as i64);
        let geometry = config.geometry();
        let spec = TactileSpec {
            name,
            rows: geometry.rows,
            cols: geometry.cols,
            full_scale: config.full_counts(),
            row,
        };
        let delivery = ScanDelivery::of(config);
        let stored = delivery.delay_scans as usize + 2;
        let scans = vec![Scan::empty(geometry.tactels()); stored].into();
        ScanFeed { spec, delivery, scans, count: 0 }
    }

    /// Stores a scan that is sent, with its stamp and the instant from which it is visible, and
    /// drops the oldest one.
    pub(crate) fn record(
        &mut self,
        sequence: u32,
        values: &[u16],
        stamp: Nanos,
        visible: Nanos,
    ) -> &Scan {
        self.scans.rotate_right(1);
        self.count = (self.count + 1).min(self.scans.len());
        let scan = &mut self.scans[0];
        (scan.sequence, scan.stamp, scan.visible) = (sequence, stamp, visible);
        scan.values.copy_from_slice(values);
        scan
    }

    /// Sends, at `now`, the newest scan that was visible and all scans that were not visible yet.
    pub(crate) fn send(&self, to: &mut ScanSender, now: Nanos) {
        let sent = &self.scans[..self.count];
        let first = sent.iter().position(|scan| scan.visible <= now);
        let count = first.map_or(sent.len(), |first| first + 1);
        sent[..count].iter().rev().for_each(|scan| to.send(scan));
    }
}
