//! Executes instructions on the double's subdevices in the order of the kernel's checks: node,
//! subdevice, lock, channel and range, business, then the instruction itself.

use taktil_hal::fault::FaultKind;

use crate::subdevice::{Kind, Subdevice};
use crate::{Call, Double, errno};

/// Read words from a channel.
const READ_KIND: u32 = 0x0400_0000;
/// Write words to a channel.
const WRITE_KIND: u32 = 0x0800_0001;
/// Set lines by mask and read them.
const BITS_KIND: u32 = 0x0c00_0002;
/// Configure.
const CONFIG_KIND: u32 = 0x0c00_0003;
/// Lines in a word.
const WORD_LINES: usize = 32;

impl Double {
    /// Executes a list in order; returns how many instructions were executed.
    ///
    /// # Errors
    /// That of the first instruction that failed; those before it have acted.
    pub fn execute<'a>(
        &mut self,
        node: u32,
        calls: impl ExactSizeIterator<Item = Call<'a>>,
    ) -> Result<usize, i32> {
        self.check_node(node)?;
        let count = calls.len();
        let short = count > 0 && self.befalls(FaultKind::Truncation);
        let limit = if short { (self.random.next_u64() % count as u64) as usize } else { count };
        let late = count > 0 && self.befalls(FaultKind::Loss);
        let fails_at = if late { (self.random.next_u64() % count as u64) as usize } else { count };
        for (at, call) in calls.take(limit).enumerate() {
            if at == fails_at {
                return Err(errno::TIMED_OUT);
            }
            self.instruction(node, call)?;
        }
        Ok(limit)
    }

    fn instruction(&mut self, node: u32, call: Call<'_>) -> Result<(), i32> {
        let busy = self.is_active(FaultKind::Silence);
        let Call { kind, subdevice, channel: packed, words } = call;
        let number = subdevice as usize;
        let found = self.subdevices.get(number).ok_or(errno::INVALID_ARGUMENT)?;
        if found.owner.is_some_and(|owner| owner != node) {
            return Err(errno::ACCESS_DENIED);
        }
        let channel = packed as usize & 0xffff;
        let range = packed as usize >> 16 & 0xff;
        let ranges = if matches!(found.kind, Kind::AnalogIn | Kind::AnalogOut) {
            found.ranges.len()
        } else {
            1
        };
        if channel >= found.values.len() || range >= ranges {
            return Err(errno::INVALID_ARGUMENT);
        }
        if busy {
            return Err(errno::BUSY_DEVICE);
        }
        match kind {
            READ_KIND => {
                let value = self.shown(number, channel);
                words.fill(value);
                Ok(())
            }
            WRITE_KIND => self.subdevices[number].write(channel, words),
            BITS_KIND => self.bits(number, channel, words),
            CONFIG_KIND => self.subdevices[number].configure(channel, words),
            _ => Err(errno::INVALID_ARGUMENT),
        }
    }

    /// What there is on a channel: what is wired to it, or the channel itself.
    fn present(&self, subdevice: usize, channel: usize) -> u32 {
        match self.loopback {
            Some([input, output]) if input == subdevice => self.sample(output, channel),
            _ => self.subdevices[subdevice].present(channel),
        }
    }

    /// What an instruction sees of a channel.
    fn shown(&mut self, subdevice: usize, channel: usize) -> u32 {
        let is_output = self.subdevices[subdevice].kind == Kind::AnalogOut
            || self.subdevices[subdevice].driven(channel).is_some();
        let present = self.present(subdevice, channel);
        let shown = &mut self.subdevices[subdevice].shown[channel];
        if !self.is_frozen || is_output {
            *shown = present;
        }
        *shown
    }

    /// Takes what there is on all inputs as what they show.
    pub(crate) fn show_inputs(&mut self) {
        for subdevice in 0..self.subdevices.len() {
            for channel in 0..self.subdevices[subdevice].shown.len() {
                let present = self.present(subdevice, channel);
                self.subdevices[subdevice].shown[channel] = present;
            }
        }
    }

    fn bits(&mut self, number: usize, base: usize, words: &mut [u32]) -> Result<(), i32> {
        let [mask, levels] = words else { return Err(errno::INVALID_ARGUMENT) };
        if !self.subdevices[number].is_digital() {
            return Err(errno::INVALID_ARGUMENT);
        }
        let end = (base + WORD_LINES).min(self.subdevices[number].values.len());
        let mut answer = 0;
        for channel in base..end {
            let bit = 1 << (channel - base);
            let found = &mut self.subdevices[number];
            if *mask & bit != 0 && found.kind != Kind::DigitalIn {
                found.values[channel] = u32::from(*levels & bit != 0);
            }
            if self.shown(number, channel) != 0 {
                answer |= bit;
            }
        }
        *levels = answer;
        Ok(())
    }
}

impl Subdevice {
    fn write(&mut self, channel: usize, words: &[u32]) -> Result<(), i32> {
        if words.iter().any(|word| *word > self.maxdata) {
            return Err(errno::INVALID_ARGUMENT);
        }
        match self.kind {
            Kind::AnalogOut | Kind::DigitalOut | Kind::DigitalIo => {
                if let Some(word) = words.last() {
                    self.values[channel] = *word;
                }
                Ok(())
            }
            Kind::Counter => {
                if let Some(word) = words.last() {
                    self.reset_counter(channel, *word);
                }
                Ok(())
            }
            Kind::AnalogIn | Kind::DigitalIn => Err(errno::INVALID_ARGUMENT),
        }
    }

    fn configure(&mut self, channel: usize, words: &mut [u32]) -> Result<(), i32> {
        match (self.kind, words) {
            (Kind::DigitalIo, [direction @ (0 | 1)]) => {
                self.direct(channel, *direction == 1);
                Ok(())
            }
            (Kind::DigitalIo, [28, answer]) => {
                *answer = u32::from(self.outputs[channel]);
                Ok(())
            }
            // Reset: at zero and at rest.
            (Kind::Counter, [34]) => {
                self.reset_counter(channel, 0);
                self.armed[channel] = false;
                Ok(())
            }
            (Kind::Counter, [31, _]) => {
                self.armed[channel] = true;
                Ok(())
            }
            // Mode, gate and other sources are taken as they are.
            (Kind::Counter, [4097, _] | [2001 | 2005, _, _]) => Ok(()),
            (Kind::Counter, [1003, _, preload, _]) => {
                self.reset_counter(channel, *preload);
                self.armed[channel] = true;
                Ok(())
            }
            (Kind::Counter, [preload @ 0]) => {
                self.reset_counter(channel, *preload);
                self.armed[channel] = true;
                Ok(())
            }
            _ => Err(errno::INVALID_ARGUMENT),
        }
    }
}
