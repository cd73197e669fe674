//! The shared file in which the registers stand: read as a whole, written word by word.

use std::fs::{File, OpenOptions};
use std::io;
use std::os::unix::fs::FileExt;
use std::path::Path;

use crate::layout::{Bus, Row};

/// The registers of a board in a file that others map.
#[derive(Debug)]
pub(crate) struct Memory {
    file: File,
    offset_bytes: u64,
    /// What the registers held when they were last read or written here.
    image: Vec<u8>,
    bus: Bus,
}

impl Memory {
    /// Opens the file, or makes it, and lets it be as long as the board needs.
    pub(crate) fn open(
        path: &Path,
        offset_bytes: u64,
        length: usize,
        bus: Bus,
    ) -> io::Result<Memory> {
        let file =
            OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path)?;
        let end = offset_bytes + length as u64;
        if file.metadata()?.len() < end {
            file.set_len(end)?;
        }
        let mut memory = Memory { file, offset_bytes, image: vec![0; length], bus };
        memory.refresh()?;
        Ok(memory)
    }

    /// Reads all registers.
    pub(crate) fn refresh(&mut self) -> io::Result<()> {
        self.file.read_exact_at(&mut self.image, self.offset_bytes)
    }

    /// Gives all registers the same byte.
    pub(crate) fn fill(&mut self, byte: u8) -> io::Result<()> {
        self.image.fill(byte);
        self.file.write_all_at(&self.image, self.offset_bytes)
    }

    /// The word of a register when all were last read; 0 outside.
    pub(crate) fn word(&self, offset: usize) -> u64 {
        let bytes = self.image.get(offset..offset + self.bus.bytes).unwrap_or(&[]);
        let fold = |word, byte: &u8| (word << 8) | u64::from(*byte);
        if self.bus.big { bytes.iter().fold(0, fold) } else { bytes.iter().rev().fold(0, fold) }
    }

    /// Writes a register.
    pub(crate) fn write(&mut self, offset: usize, word: u64) -> io::Result<()> {
        if !self.keep(offset, word) {
            return Ok(());
        }
        let bytes = offset..offset + self.bus.bytes;
        self.file.write_all_at(&self.image[bytes], self.offset_bytes + offset as u64)
    }

    /// Takes a word into the image alone; returns whether there is such a register.
    fn keep(&mut self, offset: usize, word: u64) -> bool {
        let bytes = self.bus.bytes;
        let all = word.to_le_bytes();
        let Some(place) = self.image.get_mut(offset..offset + bytes) else { return false };
        place.copy_from_slice(&all[..bytes]);
        if self.bus.big {
            place.reverse();
        }
        true
    }

    /// Writes a register unless it holds that word already.
    pub(crate) fn set(&mut self, offset: usize, word: u64) -> io::Result<()> {
        if self.word(offset) == word % self.bus.modulus() {
            Ok(())
        } else {
            self.write(offset, word)
        }
    }

    /// The place of a word of a value, counted from the lowest.
    fn place(&self, row: &Row, channel: usize, from_low: usize) -> usize {
        let word = if self.bus.high_first { row.words - 1 - from_low } else { from_low };
        row.offset + channel * row.stride + word * self.bus.stride
    }

    /// All bits of the registers of a channel.
    pub(crate) fn whole(&self, row: &Row, channel: usize) -> u64 {
        (0..row.words).rev().fold(0, |whole, from_low| {
            whole * self.bus.modulus() + self.word(self.place(row, channel, from_low))
        })
    }

    /// Writes the registers of a channel, the lowest `words` of them.
    pub(crate) fn set_whole(
        &mut self,
        row: &Row,
        channel: usize,
        whole: u64,
        words: usize,
    ) -> io::Result<()> {
        for from_low in 0..words.min(row.words) {
            let word = self.word_of(whole, from_low);
            self.set(self.place(row, channel, from_low), word)?;
        }
        Ok(())
    }

    /// Writes the registers of the first channels of a row, in one piece where nothing stands
    /// between them: 256 tactels one by one are as many calls of the system.
    pub(crate) fn set_row(&mut self, row: &Row, wholes: &[u64]) -> io::Result<()> {
        let channels = wholes.len().min(row.channels);
        let is_dense =
            self.bus.stride == self.bus.bytes && row.stride == row.words * self.bus.bytes;
        let bytes = row.offset..row.offset + channels * row.stride;
        if !is_dense || bytes.end > self.image.len() {
            return wholes[..channels]
                .iter()
                .enumerate()
                .try_for_each(|(channel, whole)| self.set_whole(row, channel, *whole, row.words));
        }
        let mut differs = false;
        for (channel, whole) in wholes[..channels].iter().enumerate() {
            for from_low in 0..row.words {
                let word = self.word_of(*whole, from_low);
                let place = self.place(row, channel, from_low);
                differs |= self.word(place) != word;
                self.keep(place, word);
            }
        }
        if differs {
            let from = self.offset_bytes + bytes.start as u64;
            self.file.write_all_at(&self.image[bytes], from)?;
        }
        Ok(())
    }

    /// A word of a value, counted from the lowest.
    fn word_of(&self, whole: u64, from_low: usize) -> u64 {
        let bits = 8 * self.bus.bytes * from_low;
        u32::try_from(bits).ok().and_then(|bits| whole.checked_shr(bits)).unwrap_or(0)
            % self.bus.modulus()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layout::Coding;

    /// Rows of two words a channel, one with nothing between its channels, one with a register of
    /// another's between each two.
    #[test]
    fn a_row_in_one_piece_is_the_row_word_by_word() {
        let folder = std::env::temp_dir().join(format!("taktil-row-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a folder");
        for (high_first, big) in [(true, true), (false, true), (true, false), (false, false)] {
            let bus = Bus { bytes: 2, big, high_first, stride: 2 };
            for stride in [4, 6] {
                let coding = Coding::Straight;
                let row = Row {
                    offset: 4,
                    channels: 3,
                    stride,
                    words: 2,
                    bits: 32,
                    shift: 0,
                    coding,
                    inverted: false,
                    numbers: None,
                };
                let paths = ["piece", "words"].map(|name| folder.join(name));
                let mut boards = paths.each_ref().map(|path| {
                    let mut board = Memory::open(path, 8, 32, bus).expect("a file");
                    board.fill(0x5a).expect("a file");
                    board
                });
                let wholes = [0x1234_5678, 0xffff_0001, 7];
                boards[0].set_row(&row, &wholes).expect("a file");
                for (channel, whole) in wholes.iter().enumerate() {
                    boards[1].set_whole(&row, channel, *whole, 2).expect("a file");
                }
                let [piece, words] = paths.each_ref().map(|path| std::fs::read(path).expect("one"));
                assert_eq!(piece, words, "{high_first} {big} {stride}");
                assert_eq!([0, 1, 2].map(|channel| boards[0].whole(&row, channel)), wholes);
            }
        }
        std::fs::remove_dir_all(&folder).expect("its own folder");
    }
}
