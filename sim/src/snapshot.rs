//! A world at an instant, from which it goes on bit for bit, alone or many times over; and a story
//! of such instants with the words between them, in which one can seek. Refuses to know what a
//! controller has taken of what it was told: a revived world tells the latest of it anew.

use taktil_hal::link::Stamped;
use taktil_hal::{CHANNELS, DacCode, Devices, Error, LinesOut, Nanos};

use crate::devices::{WorldEnds, connect};
use crate::world::World;

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
