//! What the world last sent to the devices, kept so that a restored world can send it anew. Refuses
//! to know what a controller has taken of it.

use taktil_hal::link::Sender;
use taktil_hal::{AdcCode, CHANNELS, LinesIn, Nanos};

use crate::devices::Scan;
use crate::scene::{Stamp, TactileConfig};

/// What the world last told the devices, beside what it keeps anyway.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Told {
    /// Channels of the boards, and the D/A's range.
    pub(crate) board: (usize, (i32, i32)),
    /// The scans of the finger's array, and of the one opposed to it where there is one.
    pub(crate) feeds: [Option<Feed>; 2],
    /// Motor currents and lines, and when.
    pub(crate) control: Option<([AdcCode; CHANNELS], LinesIn, Nanos)>,
}

impl Told {
    /// What each array says of itself.
    pub(crate) fn facts(&self) -> [Option<(u16, Nanos)>; 2] {
        [0, 1].map(|tip: usize| self.feeds[tip].as_ref().map(|feed| feed.facts))
    }
}

/// What a tactile array says of itself, and the scans that it handed over.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Feed {
    /// Its largest reading, and the time from row to row.
    pub(crate) facts: (u16, Nanos),
    /// How its scans are handed over.
    pub(crate) delivery: Delivery,
    /// The newest scans, on their way or taken: what each carries, and when it is visible.
    pub(crate) scans: [Option<(Scan, Nanos, Nanos)>; SCANS],
}

/// Scans that can be on their way, and two before them.
const SCANS: usize = 32;

/// How late scans are, and whether they say so.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Delivery {
    /// How many scans later one arrives.
    pub(crate) late_scans: u32,
    /// It carries the instant of its arrival.
    pub(crate) hidden: bool,
}

impl Delivery {
    pub(crate) fn of(config: &TactileConfig) -> Delivery {
        Delivery { late_scans: config.late_scans, hidden: config.stamp == Stamp::Delivered }
    }

    /// What a scan that is whole at `t` carries, and when it is visible.
    pub(crate) fn instants(&self, t: Nanos, period: Nanos) -> (Nanos, Nanos) {
        let visible = t + period * i64::from(self.late_scans);
        (if self.hidden { visible } else { t }, visible)
    }
}

impl Feed {
    pub(crate) fn of(config: &TactileConfig) -> Feed {
        let row = Nanos((1e3 * config.row_us).round() as i64);
        let facts = (config.full_counts(), row);
        Feed { facts, delivery: Delivery::of(config), ..Feed::default() }
    }

    /// One more scan went out; one that was taken long ago is forgotten.
    pub(crate) fn scan(&mut self, scan: Scan, stamp: Nanos, visible: Nanos) {
        let kept = (self.delivery.late_scans as usize + 2).min(SCANS);
        self.scans[..kept].rotate_right(1);
        self.scans[0] = Some((scan, stamp, visible));
    }

    /// Hands over, at `now`, of those that were visible the newest, and all that were not yet.
    pub(crate) fn tell(&self, to: &mut Sender<Scan>, now: Nanos) {
        let known = |scan: &(Scan, Nanos, Nanos)| scan.2 <= now;
        let first = self.scans.iter().flatten().position(known);
        let begun = first.map_or(SCANS, |first| first + 1);
        for (scan, stamp, visible) in self.scans[..begun].iter().rev().flatten() {
            let _ = to.send(*scan, *stamp, *visible);
        }
    }
}
