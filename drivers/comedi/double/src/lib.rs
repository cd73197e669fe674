//! A Comedi board in memory behaves towards a driver as the kernel behaves towards a program, one
//! instruction at a time: converters, counters that wrap, digital lines with directions, locks,
//! errors by number, and faults by plan. On its other side whoever holds it turns discs, applies
//! voltages and looks at the outputs. It is written from the kernel's header and knows no driver.
//!
//! ```
//! use taktil_drivers_comedi_double::{Call, Double};
//!
//! let mut double = Double::comedi_test();
//! let node = double.open()?;
//! let (mut written, mut read) = ([40_000], [0]);
//! let list = [
//!     Call { kind: 0x0800_0001, subdevice: 1, channel: 3, words: &mut written },
//!     Call { kind: 0x0400_0000, subdevice: 0, channel: 3, words: &mut read },
//! ];
//! assert_eq!(double.execute(node, list.into_iter())?, 2);
//! assert_eq!(read, [40_000]);
//! # Ok::<(), i32>(())
//! ```

mod execution;
mod faults;
mod subdevice;

use taktil_hal::Nanos;
use taktil_hal::fault::{FaultKind, FaultPlan, SplitMix};

pub use faults::EXECUTED_FAULTS;
pub use subdevice::{Kind, Subdevice, VoltRange};

/// The system's error numbers that the double answers.
pub mod errno {
    /// The subdevice is not usable (`EIO`).
    pub const IO_ERROR: i32 = 5;
    /// The subdevice is locked by another node (`EACCES`).
    pub const ACCESS_DENIED: i32 = 13;
    /// The subdevice is busy or locked (`EBUSY`).
    pub const BUSY_DEVICE: i32 = 16;
    /// The board is gone (`ENODEV`).
    pub const NO_DEVICE: i32 = 19;
    /// The board cannot do that (`EINVAL`).
    pub const INVALID_ARGUMENT: i32 = 22;
    /// A conversion did not end in time (`ETIMEDOUT`).
    pub const TIMED_OUT: i32 = 110;
}

/// One instruction of a list, its words in the memory of the caller.
#[derive(Debug)]
pub struct Call<'a> {
    /// What to do: a number of the header's `INSN_` group.
    pub kind: u32,
    /// Which subdevice.
    pub subdevice: u32,
    /// Channel, range and analog reference, packed.
    pub channel: u32,
    /// What goes to the board, and what comes from it.
    pub words: &'a mut [u32],
}

/// What the double says of one of its subdevices.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SubdeviceFacts {
    /// A number of the header's `enum comedi_subdevice_type`.
    pub kind: u32,
    /// Number of channels.
    pub channels: u32,
    /// The header's `SDF_` flags.
    pub flags: u32,
}

/// A board in memory.
#[derive(Debug)]
pub struct Double {
    driver: String,
    board: String,
    name: String,
    subdevices: Vec<Subdevice>,
    /// A/D subdevice whose channels are wired to those of a D/A subdevice, the second.
    loopback: Option<[usize; 2]>,
    plan: FaultPlan,
    random: SplitMix,
    now: Nanos,
    next_node: u32,
    /// Nodes below this one were open when the board was unplugged.
    dead_below: u32,
    restarts: Vec<bool>,
    is_frozen: bool,
}

impl Double {
    /// A board without subdevices, attached to a driver of the kernel; `name` is what faults of a
    /// plan are aimed at.
    #[must_use]
    pub fn new(name: &str, driver: &str, board: &str) -> Double {
        Double {
            driver: driver.to_owned(),
            board: board.to_owned(),
            name: name.to_owned(),
            subdevices: Vec::new(),
            loopback: None,
            plan: FaultPlan::default(),
            random: SplitMix::new(0),
            now: Nanos::ZERO,
            next_node: 0,
            dead_below: 0,
            restarts: Vec::new(),
            is_frozen: false,
        }
    }

    /// The kernel's `comedi_test` as far as single instructions go: 8 A/D and 8 D/A channels of 16
    /// bits, ranges of 10 and 5 V either way, and each A/D channel reads the D/A channel of its
    /// number.
    #[must_use]
    pub fn comedi_test() -> Double {
        let ranges = [VoltRange::symmetric(10), VoltRange::symmetric(5)];
        let mut double = Double::new("comedi", "comedi_test", "comedi_test")
            .with(Subdevice::new(Kind::AnalogIn, 8, 16).with_ranges(&ranges))
            .with(Subdevice::new(Kind::AnalogOut, 8, 16).with_ranges(&ranges));
        double.loopback = Some([0, 1]);
        double
    }

    /// A board for a robot: subdevices 0 A/D (16 channels, 16 bits), 1 D/A (8 channels, 16 bits), 2
    /// lines of both directions (24, directed in groups of 8), 3 counters (8) of `counter_bits`
    /// that have to be armed. Inputs that nothing is wired to read high.
    #[must_use]
    pub fn robot_board(counter_bits: u32) -> Double {
        let ranges = [VoltRange::symmetric(10), VoltRange::symmetric(5)];
        Double::new("comedi", "double_driver", "double-6")
            .with(Subdevice::new(Kind::AnalogIn, 16, 16).with_ranges(&ranges))
            .with(Subdevice::new(Kind::AnalogOut, 8, 16).with_ranges(&ranges[..1]))
            .with(Subdevice::new(Kind::DigitalIo, 24, 1).directed_in_groups(8))
            .with(Subdevice::new(Kind::Counter, 8, counter_bits).armed_by_instruction())
    }

    /// The same board with one more subdevice.
    #[must_use]
    pub fn with(mut self, subdevice: Subdevice) -> Double {
        self.subdevices.push(subdevice);
        self
    }

    /// Plans faults; chances are drawn from `seed`.
    ///
    /// # Errors
    /// The plan has a fault for this board that it cannot execute.
    pub fn set_plan(&mut self, plan: FaultPlan, seed: u64) -> Result<(), taktil_hal::Invalid> {
        plan.check_kinds(&self.name, &EXECUTED_FAULTS)?;
        self.restarts = vec![false; plan.faults().len()];
        self.plan = plan;
        self.random = SplitMix::new(seed);
        self.advance(self.now);
        Ok(())
    }

    /// Moves the board's time on; it never runs backwards.
    pub fn advance(&mut self, now: Nanos) {
        self.now = self.now.max(now);
        if self.is_active(FaultKind::Unplugged) {
            self.dead_below = self.next_node;
            self.subdevices.iter_mut().for_each(Subdevice::restart);
        }
        let frozen = self.is_active(FaultKind::Frozen);
        if frozen && !self.is_frozen {
            self.show_inputs();
        }
        self.is_frozen = frozen;
        for at in 0..self.restarts.len() {
            let fault = &self.plan.faults()[at];
            let begins = fault.kind == FaultKind::Restart && fault.is_active(&self.name, self.now);
            if begins && !self.restarts[at] {
                self.restarts[at] = true;
                self.subdevices.iter_mut().for_each(Subdevice::restart);
            }
        }
    }

    fn is_active(&self, kind: FaultKind) -> bool {
        self.plan.strength(kind, &self.name, self.now).is_some()
    }

    /// Whether a fault with a probability befalls this moment.
    fn befalls(&mut self, kind: FaultKind) -> bool {
        let chance = self.plan.strength(kind, &self.name, self.now);
        chance.is_some_and(|chance| self.random.unit() < chance)
    }

    /// Opens the board's device node.
    ///
    /// # Errors
    /// [`errno::NO_DEVICE`] while the board is unplugged.
    pub fn open(&mut self) -> Result<u32, i32> {
        if self.is_active(FaultKind::Unplugged) {
            return Err(errno::NO_DEVICE);
        }
        self.next_node += 1;
        Ok(self.next_node - 1)
    }

    /// Closes a node: its locks are free again, the outputs stay.
    pub fn close(&mut self, node: u32) {
        for subdevice in &mut self.subdevices {
            if subdevice.owner == Some(node) {
                subdevice.owner = None;
            }
        }
    }

    fn check_node(&self, node: u32) -> Result<(), i32> {
        if node < self.dead_below || node >= self.next_node {
            return Err(errno::NO_DEVICE);
        }
        Ok(())
    }

    /// The names of the kernel's driver and of the board.
    ///
    /// # Errors
    /// [`errno::NO_DEVICE`] when the board is gone.
    pub fn names(&self, node: u32) -> Result<[String; 2], i32> {
        self.check_node(node)?;
        Ok([self.driver.clone(), self.board.clone()])
    }

    /// All subdevices.
    ///
    /// # Errors
    /// [`errno::NO_DEVICE`] when the board is gone.
    pub fn subdevice_facts(&self, node: u32) -> Result<Vec<SubdeviceFacts>, i32> {
        self.check_node(node)?;
        Ok(self.subdevices.iter().map(Subdevice::facts).collect())
    }

    /// The largest sample of each channel of a subdevice.
    ///
    /// # Errors
    /// [`errno::NO_DEVICE`], or [`errno::INVALID_ARGUMENT`] for a subdevice that does not exist.
    pub fn largest_samples(&self, node: u32, subdevice: u32) -> Result<Vec<u32>, i32> {
        self.check_node(node)?;
        let found = self.subdevices.get(subdevice as usize).ok_or(errno::INVALID_ARGUMENT)?;
        Ok(vec![found.maxdata; found.values.len()])
    }

    /// The ranges of a channel.
    ///
    /// # Errors
    /// As [`Double::largest_samples`].
    pub fn ranges(&self, node: u32, subdevice: u32) -> Result<&[VoltRange], i32> {
        self.check_node(node)?;
        let found = self.subdevices.get(subdevice as usize).ok_or(errno::INVALID_ARGUMENT)?;
        Ok(&found.ranges)
    }

    /// Locks a subdevice for a node.
    ///
    /// # Errors
    /// [`errno::BUSY_DEVICE`] when it is locked, by whichever node, or the board is busy.
    pub fn lock(&mut self, node: u32, subdevice: u32) -> Result<(), i32> {
        self.check_node(node)?;
        let busy = self.is_active(FaultKind::Silence);
        let found = self.subdevices.get_mut(subdevice as usize).ok_or(errno::INVALID_ARGUMENT)?;
        if busy || found.owner.is_some() {
            return Err(errno::BUSY_DEVICE);
        }
        found.owner = Some(node);
        Ok(())
    }

    /// Turns a disc: the count of an encoder since power-up, however far. A counter that is not
    /// armed does not follow.
    pub fn set_count(&mut self, subdevice: usize, channel: usize, count: i64) {
        if let Some(found) = self.subdevices.get_mut(subdevice) {
            found.turn(channel, count);
        }
    }

    /// Applies a voltage to an A/D channel, as the sample that it converts to.
    pub fn set_sample(&mut self, subdevice: usize, channel: usize, sample: u32) {
        if let Some(found) = self.subdevices.get_mut(subdevice)
            && let Some(value) = found.values.get_mut(channel)
        {
            *value = sample;
        }
    }

    /// The sample that a D/A channel puts out, or that an A/D channel has; 0 where there is none.
    #[must_use]
    pub fn sample(&self, subdevice: usize, channel: usize) -> u32 {
        let found = self.subdevices.get(subdevice);
        found.and_then(|found| found.values.get(channel)).copied().unwrap_or(0)
    }

    /// Applies a level to a line; `None` cuts the wire.
    pub fn set_level(&mut self, subdevice: usize, channel: usize, level: Option<bool>) {
        if let Some(found) = self.subdevices.get_mut(subdevice) {
            found.apply(channel, level);
        }
    }

    /// The level to which the board drives a line; `None` when it does not.
    #[must_use]
    pub fn level(&self, subdevice: usize, channel: usize) -> Option<bool> {
        self.subdevices.get(subdevice).and_then(|found| found.driven(channel))
    }

    /// Whether some node has locked a subdevice.
    #[must_use]
    pub fn is_locked(&self, subdevice: usize) -> bool {
        self.subdevices.get(subdevice).is_some_and(|found| found.owner.is_some())
    }
}
