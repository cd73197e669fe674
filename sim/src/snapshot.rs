//! Snapshots of a world, from which it can be continued bit for bit any number of times, and a
//! history of snapshots and outputs in which one can seek. A snapshot does not record which
//! readings a controller has read: a restored world sends the latest ones again.

use taktil_hal::link::Stamped;
use taktil_hal::{CHANNELS, DacCode, Devices, DriveCommand, Error, LinesOut, Nanos};

use crate::devices::{WorldLinks, connect};
use crate::drives::{DriveLinks, connect_drives};
use crate::world::World;

/// A world at an instant with everything that decides its future: bodies, bristles, warm starts,
/// the state of each tactel, every stream of random numbers, commands on their way.
#[derive(Debug)]
pub struct Snapshot {
    world: World,
    codes: Vec<Stamped<[i32; CHANNELS]>>,
    lines_out: Vec<Stamped<LinesOut>>,
    commands: Vec<Stamped<DriveCommand>>,
}

impl World {
    /// A copy of the world with other links to its devices.
    fn with_links(&self, links: WorldLinks) -> World {
        World {
            t: self.t,
            timing: self.timing,
            power_on: self.power_on,
            plant: self.plant.clone(),
            arrays: self.arrays.clone(),
            wrist: self.wrist.clone(),
            faults: self.faults.clone(),
            is_hand: self.is_hand,
            links,
            next_control: self.next_control,
            sequences: self.sequences,
            counts: self.counts,
            index: self.index,
            gauges: self.gauges,
            codes: self.codes,
            lines_out: self.lines_out,
            last_code_time: self.last_code_time,
            last_feed_time: self.last_feed_time,
            last_sent: self.last_sent.clone(),
            drives: self
                .drives
                .as_ref()
                .map(|drives| Box::new(drives.with_links(DriveLinks::disconnected()))),
        }
    }

    /// A snapshot of the world and of the commands on their way to it; the world does not change.
    /// Allocates, so that it must not be called from a lane.
    #[must_use]
    pub fn snapshot(&mut self) -> Snapshot {
        let (mut codes, mut lines_out) = (Vec::new(), Vec::new());
        self.links.codes.for_each_pending(|word| codes.push(*word));
        self.links.lines_out.for_each_pending(|word| lines_out.push(*word));
        let mut commands = Vec::new();
        if let Some(drives) = &mut self.drives {
            drives.links.commands.for_each_pending(|word| commands.push(*word));
        }
        Snapshot { world: self.with_links(WorldLinks::disconnected()), codes, lines_out, commands }
    }
}

impl Snapshot {
    /// The instant of the snapshot.
    #[must_use]
    pub fn now(&self) -> Nanos {
        self.world.t
    }

    /// A world that goes on from here, with devices of its own that hold the latest readings.
    #[must_use]
    pub fn restore(&self) -> (World, Devices) {
        let last_sent = &self.world.last_sent;
        let delay = self.world.timing.actuation_delay;
        let (mut links, mut devices) =
            connect(delay, last_sent.board, self.world.index.is_some(), last_sent.tactile_specs());
        if let Some((currents, lines, at)) = last_sent.control {
            WorldLinks::send(&mut links.counts, self.world.counts, at);
            if let (Some(marks), Some(index)) = (&mut links.marks, &self.world.index) {
                WorldLinks::send(marks, index.index_pulses(), at);
            }
            WorldLinks::send(&mut links.currents, currents, at);
            WorldLinks::send(&mut links.lines, lines, at);
            if self.world.wrist.is_some() {
                WorldLinks::send(&mut links.gauges, self.world.gauges, at);
            }
        }
        for (to, feed) in links.scans.iter_mut().zip(&last_sent.feeds) {
            if let Some(feed) = feed {
                feed.send(to, self.world.t);
            }
        }
        // The devices accepted these commands when they were written, so that they accept them
        // again.
        for word in &self.codes {
            let codes = word.value.map(DacCode);
            let _ = devices.require_analog_out().and_then(|half| half.commit(word.stamp, &codes));
        }
        for word in &self.lines_out {
            let _ =
                devices.require_digital_out().and_then(|half| half.commit(word.stamp, &word.value));
        }
        let mut world = self.world.with_links(links);
        if let Some(drives) = &mut world.drives {
            drives.links = connect_drives(delay, drives.spec, &mut devices);
            if let Some((reports, at)) = drives.sent {
                WorldLinks::send(&mut drives.links.reports, reports, at);
            }
            for word in &self.commands {
                let half = devices.require_drive_out();
                let _ = half.and_then(|half| half.commit(word.stamp, &word.value));
            }
        }
        (world, devices)
    }
}

/// The outputs that a controller wrote at one release.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OutputRecord {
    /// The release.
    pub release: Nanos,
    /// The D/A word; of no meaning where drives close a loop.
    pub codes: [DacCode; CHANNELS],
    /// The word to drives that close a loop, where there are some.
    pub drives: Option<DriveCommand>,
    /// The lines.
    pub lines: LinesOut,
}

impl OutputRecord {
    /// Writes the outputs to devices.
    ///
    /// # Errors
    /// The error of the device that refuses its output.
    pub fn commit(&self, devices: &mut Devices) -> Result<(), Error> {
        devices
            .analog_out
            .as_mut()
            .map_or(Ok(()), |half| half.commit(self.release, &self.codes))?;
        if let (Some(command), Some(half)) = (&self.drives, &mut devices.drive_out) {
            half.commit(self.release, command)?;
        }
        devices.digital_out.as_mut().map_or(Ok(()), |half| half.commit(self.release, &self.lines))
    }
}

/// Snapshots in order of time, and the outputs that were written between them.
#[derive(Debug, Default)]
pub struct WorldHistory {
    snapshots: Vec<Snapshot>,
    written: Vec<OutputRecord>,
}

impl WorldHistory {
    /// Appends a snapshot; a snapshot that is not later than the last one is discarded.
    pub fn push_snapshot(&mut self, snapshot: Snapshot) {
        if self.snapshots.last().is_none_or(|last| last.now() < snapshot.now()) {
            self.snapshots.push(snapshot);
        }
    }

    /// Appends outputs in the order of their releases; outputs out of order are discarded.
    pub fn push_output(&mut self, written: OutputRecord) {
        if self.written.last().is_none_or(|last| last.release < written.release) {
            self.written.push(written);
        }
    }

    /// The world at an instant: the last snapshot before it, advanced under the outputs that were
    /// written. None before the first snapshot.
    ///
    /// # Errors
    /// A device refuses outputs that it accepted when they were written.
    pub fn seek(&self, to: Nanos) -> Result<Option<(World, Devices)>, Error> {
        let after = self.snapshots.partition_point(|snapshot| snapshot.now() <= to);
        let Some(snapshot) = after.checked_sub(1).and_then(|i| self.snapshots.get(i)) else {
            return Ok(None);
        };
        let (mut world, mut devices) = snapshot.restore();
        // Outputs of that very instant may also be among the commands on their way; writing them
        // twice has the effect of once.
        let from = self.written.partition_point(|written| written.release < snapshot.now());
        for written in self.written.iter().skip(from).take_while(|w| w.release < to) {
            world.advance(written.release);
            written.commit(&mut devices)?;
        }
        world.advance(to);
        Ok(Some((world, devices)))
    }
}
