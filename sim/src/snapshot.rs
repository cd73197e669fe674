//! A world at an instant, from which it goes on bit for bit, alone or many times over; and a story
//! of such instants with the words between them, in which one can seek. Refuses to know what a
//! controller has taken of what it was told: a revived world tells the latest of it anew.

use taktil_hal::link::{Sender, Stamped};
use taktil_hal::{AdcCode, CHANNELS, DacCode, Devices, Error, LinesIn, LinesOut, Nanos};

use crate::devices::{Scan, WorldEnds, connect};
use crate::scene::{Stamp, TactileConfig};
use crate::world::World;

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
    fn tell(&self, to: &mut Sender<Scan>, now: Nanos) {
        let known = |scan: &(Scan, Nanos, Nanos)| scan.2 <= now;
        let first = self.scans.iter().flatten().position(known);
        let begun = first.map_or(SCANS, |first| first + 1);
        for (scan, stamp, visible) in self.scans[..begun].iter().rev().flatten() {
            let _ = to.send(*scan, *stamp, *visible);
        }
    }
}

/// A world at an instant. Everything that decides what happens next is in it: bodies, bristles,
/// warm starts, what each tactel remembers, every stream of chance, words on their way.
#[derive(Debug)]
pub struct Snapshot {
    world: World,
    codes: Vec<Stamped<[i32; CHANNELS]>>,
    orders: Vec<Stamped<LinesOut>>,
}

impl World {
    /// The same world at other ends.
    fn twin(&self, ends: WorldEnds) -> World {
        World {
            t: self.t,
            timing: self.timing,
            power_on: self.power_on,
            bench: self.bench.clone(),
            arrays: self.arrays.clone(),
            wrist: self.wrist.clone(),
            faults: self.faults.clone(),
            ends,
            next_control: self.next_control,
            sequences: self.sequences,
            counts: self.counts,
            index: self.index,
            gauges: self.gauges,
            codes: self.codes,
            orders: self.orders,
            last_word: self.last_word,
            last_feed: self.last_feed,
            told: self.told,
        }
    }

    /// The world as it stands, with the words that are on their way to it; nothing of it changes.
    /// Allocates: not for a lane.
    #[must_use]
    pub fn snapshot(&mut self) -> Snapshot {
        let (mut codes, mut orders) = (Vec::new(), Vec::new());
        self.ends.codes.look(|word| codes.push(*word));
        self.ends.orders.look(|word| orders.push(*word));
        Snapshot { world: self.twin(WorldEnds::nowhere()), codes, orders }
    }
}

impl Snapshot {
    /// When it was taken.
    #[must_use]
    pub fn now(&self) -> Nanos {
        self.world.t
    }

    /// A world that goes on from here, with devices of its own that hold what was last told.
    #[must_use]
    pub fn revive(&self) -> (World, Devices) {
        let told = &self.world.told;
        let delay = self.world.timing.actuation_delay;
        let (mut ends, mut devices) =
            connect(delay, told.board, self.world.index.is_some(), told.facts());
        if let Some((currents, lines, at)) = told.control {
            WorldEnds::tell(&mut ends.counts, self.world.counts, at);
            if let (Some(marks), Some(index)) = (&mut ends.marks, &self.world.index) {
                WorldEnds::tell(marks, index.marks(), at);
            }
            WorldEnds::tell(&mut ends.currents, currents, at);
            WorldEnds::tell(&mut ends.lines, lines, at);
            if self.world.wrist.is_some() {
                WorldEnds::tell(&mut ends.gauges, self.world.gauges, at);
            }
        }
        for (to, feed) in ends.scans.iter_mut().zip(&told.feeds) {
            if let Some(feed) = feed {
                feed.tell(to, self.world.t);
            }
        }
        // As they were when they were written: the devices' ranges let them pass then.
        for word in &self.codes {
            let _ = devices.analog_out.commit(word.stamp, &word.value.map(DacCode));
        }
        for word in &self.orders {
            let _ = devices.digital_out.commit(word.stamp, &word.value);
        }
        (self.world.twin(ends), devices)
    }
}

/// What a controller wrote at a release.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Written {
    /// The release.
    pub release: Nanos,
    /// The D/A word.
    pub codes: [DacCode; CHANNELS],
    /// The lines.
    pub lines: LinesOut,
}

impl Written {
    /// Hands it to devices.
    ///
    /// # Errors
    /// What they refuse.
    pub fn commit(&self, devices: &mut Devices) -> Result<(), Error> {
        devices.analog_out.commit(self.release, &self.codes)?;
        devices.digital_out.commit(self.release, &self.lines)
    }
}

/// Snapshots in order, and the words written between them.
#[derive(Debug, Default)]
pub struct Story {
    snapshots: Vec<Snapshot>,
    written: Vec<Written>,
}

impl Story {
    /// Keeps a snapshot; one that is not later than the last is not kept.
    pub fn keep(&mut self, snapshot: Snapshot) {
        if self.snapshots.last().is_none_or(|last| last.now() < snapshot.now()) {
            self.snapshots.push(snapshot);
        }
    }

    /// Keeps what was written, in the order of releases; what comes out of order is not kept.
    pub fn write(&mut self, written: Written) {
        if self.written.last().is_none_or(|last| last.release < written.release) {
            self.written.push(written);
        }
    }

    /// The world at an instant: the last snapshot before it, moved on under the words that were
    /// written. None before the first snapshot.
    ///
    /// # Errors
    /// A word that the devices refuse, which they did not when it was written.
    pub fn seek(&self, to: Nanos) -> Result<Option<(World, Devices)>, Error> {
        let after = self.snapshots.partition_point(|snapshot| snapshot.now() <= to);
        let Some(snapshot) = after.checked_sub(1).and_then(|i| self.snapshots.get(i)) else {
            return Ok(None);
        };
        let (mut world, mut devices) = snapshot.revive();
        // A word of that very instant may be among those on their way: twice is once.
        let from = self.written.partition_point(|written| written.release < snapshot.now());
        for written in self.written.iter().skip(from).take_while(|w| w.release < to) {
            world.advance(written.release);
            written.commit(&mut devices)?;
        }
        world.advance(to);
        Ok(Some((world, devices)))
    }
}
