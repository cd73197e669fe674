//! The output halves: D/A words and lines, safe on opening, on request and on drop. A code out of
//! range is refused before any instruction is executed.

use std::sync::Arc;

use taktil_hal::{AnalogOut, CHANNELS, DacCode, DigitalOut, Error, ErrorKind, LinesOut, Nanos};

use crate::board::{Board, Instruction};
use crate::codes::Scale;
use crate::exchange::{Exchange, Tally, whole};
use crate::inputs::{is_same_port, line_bank};
use crate::uapi::WRITE_INSTRUCTION;
use crate::wiring::{Converter, DigitalLine, common_codes};

const ANALOG_OUT_NAME: &str = "comedi.analog_out";
const DIGITAL_OUT_NAME: &str = "comedi.digital_out";

/// Zero volts: no current through any motor.
const SAFE_CODE: DacCode = DacCode(0);
/// How often a safe value is written to a board that is busy.
pub const SAFE_ATTEMPTS: usize = 3;

/// D/A converters. One list writes all channels, one after the other; when the board refuses one,
/// those before it have changed, and the next commit writes all again.
#[derive(Debug)]
pub struct ComediAnalogOut {
    scales: Box<[Scale]>,
    range: [i32; 2],
    longest_silence: Nanos,
    exchange: Exchange,
}

impl ComediAnalogOut {
    pub(crate) fn new(
        board: Arc<dyn Board>,
        channels: &[Converter],
        longest_silence: Nanos,
        tally: Tally,
    ) -> ComediAnalogOut {
        let write = |channel: &Converter| {
            let word = channel.scale.sample(SAFE_CODE.0);
            let Converter { subdevice, channel_word, .. } = *channel;
            Instruction::new(WRITE_INSTRUCTION, subdevice, channel_word, &[word])
        };
        ComediAnalogOut {
            scales: channels.iter().map(|channel| channel.scale).collect(),
            range: common_codes(channels),
            longest_silence,
            exchange: Exchange::new(board, channels.iter().map(write).collect(), tally),
        }
    }

    fn set_words(&mut self, codes: &[DacCode; CHANNELS]) {
        let instructions = self.exchange.list.instructions_mut();
        for ((instruction, scale), code) in instructions.iter_mut().zip(&self.scales).zip(codes) {
            instruction.words_mut()[0] = scale.sample(code.0);
        }
    }

    pub(crate) fn write_safe(&mut self) -> Result<(), ErrorKind> {
        self.set_words(&[SAFE_CODE; CHANNELS]);
        self.exchange.insist(SAFE_ATTEMPTS)
    }
}

impl AnalogOut for ComediAnalogOut {
    fn channels(&self) -> usize {
        self.scales.len()
    }

    fn code_range(&self) -> (DacCode, DacCode) {
        let [low, high] = self.range;
        (DacCode(low), DacCode(high))
    }

    fn commit(&mut self, _release: Nanos, codes: &[DacCode; CHANNELS]) -> Result<(), Error> {
        let [low, high] = self.range;
        for (channel, code) in (0u16..).zip(codes.iter().take(self.scales.len())) {
            if !(low..=high).contains(&code.0) {
                return Err(Error::on_channel(ErrorKind::OutOfRange, ANALOG_OUT_NAME, channel));
            }
        }
        self.set_words(codes);
        self.exchange.execute().map_err(whole(ANALOG_OUT_NAME))
    }

    fn safe(&mut self) -> Result<(), Error> {
        self.write_safe().map_err(whole(ANALOG_OUT_NAME))
    }

    fn safe_value(&self) -> DacCode {
        SAFE_CODE
    }

    fn longest_silence(&self) -> Nanos {
        self.longest_silence
    }
}

impl Drop for ComediAnalogOut {
    fn drop(&mut self) {
        // Nobody is left to be told.
        let _ = self.write_safe();
    }
}

/// What one instruction of the lines' list sets.
#[derive(Clone, Copy, Debug)]
struct LineBank {
    /// For enable, brake release and feed: their bit in this bank, or none.
    bits: [u32; 3],
    /// The bits among these whose lower level means true.
    inverted: u32,
}

impl LineBank {
    /// The mask of these lines and their levels for these values.
    fn words(&self, lines: [Option<bool>; 3]) -> [u32; 2] {
        let (mut mask, mut levels) = (0, 0);
        for (bit, value) in self.bits.into_iter().zip(lines) {
            if let Some(value) = value {
                mask |= bit;
                levels |= if value { bit } else { 0 };
            }
        }
        [mask, (levels ^ self.inverted) & mask]
    }
}

/// Lines to the cell. Lines of one bank change together; lines of several banks change one after
/// the other within one list.
#[derive(Debug)]
pub struct ComediDigitalOut {
    banks: Box<[LineBank]>,
    longest_silence: Nanos,
    exchange: Exchange,
}

impl ComediDigitalOut {
    /// The half of three lines: enable, brake release and feed.
    pub(crate) fn new(
        board: Arc<dyn Board>,
        lines: &[DigitalLine],
        longest_silence: Nanos,
        tally: Tally,
    ) -> ComediDigitalOut {
        let mut instructions: Vec<Instruction> = Vec::new();
        let mut banks: Vec<LineBank> = Vec::new();
        for (number, line) in lines.iter().enumerate().take(3) {
            let bank = line_bank(*line, 0, 0);
            let known = instructions.iter().position(|known| is_same_port(known, &bank));
            let at = known.unwrap_or_else(|| {
                instructions.push(bank);
                banks.push(LineBank { bits: [0; 3], inverted: 0 });
                banks.len() - 1
            });
            banks[at].bits[number] = line.bit();
            banks[at].inverted |= if line.is_inverted { line.bit() } else { 0 };
        }
        ComediDigitalOut {
            banks: banks.into_boxed_slice(),
            longest_silence,
            exchange: Exchange::new(board, instructions, tally),
        }
    }

    fn set_words(&mut self, lines: [Option<bool>; 3]) {
        let instructions = self.exchange.list.instructions_mut();
        for (instruction, bank) in instructions.iter_mut().zip(&self.banks) {
            instruction.words_mut().copy_from_slice(&bank.words(lines));
        }
    }

    /// Enable and brake release down; the mask leaves the feed line where it is.
    pub(crate) fn write_safe(&mut self) -> Result<(), ErrorKind> {
        self.set_words([Some(false), Some(false), None]);
        self.exchange.insist(SAFE_ATTEMPTS)
    }
}

impl DigitalOut for ComediDigitalOut {
    fn commit(&mut self, _release: Nanos, lines: &LinesOut) -> Result<(), Error> {
        let LinesOut { enable, brake_release, watchdog_feed } = *lines;
        self.set_words([enable, brake_release, watchdog_feed].map(Some));
        self.exchange.execute().map_err(whole(DIGITAL_OUT_NAME))
    }

    fn safe(&mut self) -> Result<(), Error> {
        self.write_safe().map_err(whole(DIGITAL_OUT_NAME))
    }

    fn longest_silence(&self) -> Nanos {
        self.longest_silence
    }
}

impl Drop for ComediDigitalOut {
    fn drop(&mut self) {
        // Nobody is left to be told.
        let _ = self.write_safe();
    }
}
