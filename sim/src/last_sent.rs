//! What the world last sent to the devices, kept so that a restored world can send it anew. Refuses
//! to know what a controller has taken of it.

use taktil_hal::link::Sender;
use taktil_hal::{AdcCode, CHANNELS, LinesIn, Nanos};

use crate::devices::{BoardSpec, Scan, TactileSpec};
use crate::scene::{ScanStamp, TactileConfig};

/// What the world last told the devices, beside what it keeps anyway.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct LastSent {
    /// Channels of the boards, and the D/A's range.
    pub(crate) board: BoardSpec,
    /// The scans of the finger's array, and of the one opposed to it where there is one.
    pub(crate) feeds: [Option<ScanFeed>; 2],
    /// Motor currents and lines, and when.
    pub(crate) control: Option<([AdcCode; CHANNELS], LinesIn, Nanos)>,
}

impl LastSent {
    /// What each array says of itself.
    pub(crate) fn tactile_specs(&self) -> [Option<TactileSpec>; 2] {
        [0, 1].map(|tip: usize| self.feeds[tip].as_ref().map(|feed| feed.spec))
    }
}

/// What a tactile array says of itself, and the scans that it handed over.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ScanFeed {
    pub(crate) spec: TactileSpec,
    /// How its scans are handed over.
    pub(crate) delivery: ScanDelivery,
    /// The newest scans, on their way or taken: what each carries, and when it is visible.
    pub(crate) scans: [Option<(Scan, Nanos, Nanos)>; SCAN_HISTORY_MAX],
}

/// Scans that can be on their way, and two before them.
const SCAN_HISTORY_MAX: usize = 32;

/// How late scans are, and whether they say so.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ScanDelivery {
    /// How many scans later one arrives.
    pub(crate) late_scans: u32,
    /// It carries the instant of its arrival.
    pub(crate) hidden: bool,
}

impl ScanDelivery {
    pub(crate) fn of(config: &TactileConfig) -> ScanDelivery {
        ScanDelivery { late_scans: config.late_scans, hidden: config.stamp == ScanStamp::Delivered }
    }

    /// What a scan that is whole at `t` carries, and when it is visible.
    pub(crate) fn instants(&self, t: Nanos, period: Nanos) -> (Nanos, Nanos) {
        let visible = t + period * i64::from(self.late_scans);
        (if self.hidden { visible } else { t }, visible)
    }
}

impl ScanFeed {
    pub(crate) fn of(config: &TactileConfig) -> ScanFeed {
        let row = Nanos((1e3 * config.row_us).round() as i64);
        let spec = TactileSpec { full_scale: config.full_counts(), row };
        ScanFeed { spec, delivery: ScanDelivery::of(config), ..ScanFeed::default() }
    }

    /// One more scan went out; one that was taken long ago is forgotten.
    pub(crate) fn record(&mut self, scan: Scan, stamp: Nanos, visible: Nanos) {
        let kept = (self.delivery.late_scans as usize + 2).min(SCAN_HISTORY_MAX);
        self.scans[..kept].rotate_right(1);
        self.scans[0] = Some((scan, stamp, visible));
    }

    /// Hands over, at `now`, of those that were visible the newest, and all that were not yet.
    pub(crate) fn send(&self, to: &mut Sender<Scan>, now: Nanos) {
        let known = |scan: &(Scan, Nanos, Nanos)| scan.2 <= now;
        let first = self.scans.iter().flatten().position(known);
        let begun = first.map_or(SCAN_HISTORY_MAX, |first| first + 1);
        for (scan, stamp, visible) in self.scans[..begun].iter().rev().flatten() {
            let _ = to.send(*scan, *stamp, *visible);
        }
    }
}
