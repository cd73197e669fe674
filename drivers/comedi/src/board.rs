//! States what a Comedi board answers, as a trait with types: the device node implements it, and so
//! does a double in memory. Nothing here knows a robot.
//!
//! What a board refuses it refuses with the number of a system error, as the kernel does.

use core::fmt;

use nix::errno::Errno;
use taktil_hal::{CHANNELS, FORCE_TORQUE_CHANNELS};

use crate::uapi::{self, Insn};

/// Words that the longest instruction of this driver carries.
pub const INSTRUCTION_WORDS_MAX: usize = 4;
/// Instructions that a list holds at most: counters, A/D channels, gauges and three lines.
pub const LIST_INSTRUCTIONS_MAX: usize = 2 * CHANNELS + FORCE_TORQUE_CHANNELS + 3;

/// Which driver of the kernel is attached, and to what.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct DeviceInfo {
    /// The kernel's driver, such as `ni_pcimio`.
    pub driver: String,
    /// The board, such as `pci-6221`.
    pub board: String,
}

/// One subdevice.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SubdeviceInfo {
    /// What it is: a number of the header's `enum comedi_subdevice_type`.
    pub kind: u32,
    /// How many channels it has.
    pub channels: u32,
    /// The header's `SDF_` flags.
    pub flags: u32,
}

impl SubdeviceInfo {
    /// What it is, in words.
    #[must_use]
    pub fn kind_name(&self) -> &'static str {
        uapi::SUBDEVICE_KINDS.get(self.kind as usize).copied().unwrap_or("unknown")
    }
}

/// One channel of a subdevice.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ChannelInfo {
    /// The largest sample; samples are 0 to this.
    pub maxdata: u32,
    /// What [`Board::ranges`] is asked with; its low 16 bits are the number of ranges.
    pub range_type: u32,
}

/// One range of a converter.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Range {
    /// What sample 0 stands for, in millionths of the unit.
    pub min_millionths: i32,
    /// What the largest sample stands for, in millionths of the unit.
    pub max_millionths: i32,
    /// The unit in the low byte (0: volts), and the header's `RF_` flags.
    pub flags: u32,
}

/// One instruction, with room for its words.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Instruction {
    /// What to do: a number of the header's `INSN_` group.
    pub kind: u32,
    /// Which subdevice.
    pub subdevice: u32,
    /// Channel, range and analog reference as the header's `CR_PACK` packs them.
    pub channel: u32,
    words: [u32; INSTRUCTION_WORDS_MAX],
    length: u32,
}

impl Instruction {
    /// An instruction that carries these words, of which at most [`INSTRUCTION_WORDS_MAX`] count.
    #[must_use]
    pub fn new(kind: u32, subdevice: u32, channel: u32, words: &[u32]) -> Instruction {
        let mut room = [0; INSTRUCTION_WORDS_MAX];
        let mut length = 0;
        for (to, from) in room.iter_mut().zip(words) {
            *to = *from;
            length += 1;
        }
        Instruction { kind, subdevice, channel, words: room, length }
    }

    /// The words that go to the board, or came from it.
    #[must_use]
    pub fn words(&self) -> &[u32] {
        &self.words[..self.length as usize]
    }

    /// The same words, to be changed.
    pub fn words_mut(&mut self) -> &mut [u32] {
        &mut self.words[..self.length as usize]
    }

    /// The first word; 0 for an instruction without words.
    #[must_use]
    pub fn first(&self) -> u32 {
        self.words[0]
    }
}

/// A list of instructions that the board executes in one call, with the memory that the call needs.
pub struct InstructionList {
    instructions: Box<[Instruction]>,
    /// The same instructions as the kernel reads them; filled by the device node.
    raw: Box<[Insn]>,
}

impl InstructionList {
    /// A list of these instructions, of which at most [`LIST_INSTRUCTIONS_MAX`] count.
    #[must_use]
    pub fn new(mut instructions: Vec<Instruction>) -> InstructionList {
        instructions.truncate(LIST_INSTRUCTIONS_MAX);
        let raw = vec![Insn::default(); instructions.len()].into_boxed_slice();
        InstructionList { instructions: instructions.into_boxed_slice(), raw }
    }

    /// The instructions in the order of their execution.
    #[must_use]
    pub fn instructions(&self) -> &[Instruction] {
        &self.instructions
    }

    /// The same instructions, to be changed; their number stays.
    pub fn instructions_mut(&mut self) -> &mut [Instruction] {
        &mut self.instructions
    }

    /// The instructions, and as many places for them in the form of the kernel.
    pub(crate) fn parts(&mut self) -> (&mut [Instruction], &mut [Insn]) {
        (&mut self.instructions, &mut self.raw)
    }
}

impl fmt::Debug for InstructionList {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.instructions.iter()).finish()
    }
}

/// A board as the kernel shows it through one open device node.
///
/// The calls may come from several threads at once. A board that is gone answers
/// [`Errno::ENODEV`] for ever after.
pub trait Board: Send + Sync + fmt::Debug {
    /// Which driver is attached to what.
    ///
    /// # Errors
    /// The system's; [`Errno::ENODEV`] when no driver is attached to the node.
    fn device_info(&self) -> Result<DeviceInfo, Errno>;

    /// All subdevices, by their numbers.
    ///
    /// # Errors
    /// The system's.
    fn subdevices(&self) -> Result<Vec<SubdeviceInfo>, Errno>;

    /// All channels of a subdevice.
    ///
    /// # Errors
    /// The system's; [`Errno::EINVAL`] for a subdevice that does not exist.
    fn channels(&self, subdevice: u32) -> Result<Vec<ChannelInfo>, Errno>;

    /// The ranges of a channel, by their numbers.
    ///
    /// # Errors
    /// The system's; [`Errno::EINVAL`] for a range type that no channel has.
    fn ranges(&self, range_type: u32) -> Result<Vec<Range>, Errno>;

    /// Keeps others from a subdevice until the node is closed.
    ///
    /// # Errors
    /// [`Errno::EBUSY`] when it is locked, by whomever, or busy.
    fn lock(&self, subdevice: u32) -> Result<(), Errno>;

    /// Executes a list in order and returns how many instructions were executed. Neither allocates
    /// nor formats.
    ///
    /// # Errors
    /// That of the first instruction that failed; those before it have acted.
    fn execute(&self, list: &mut InstructionList) -> Result<usize, Errno>;
}
