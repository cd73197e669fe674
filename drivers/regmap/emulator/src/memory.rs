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
        let bytes = self.bus.bytes;
        let all = word.to_le_bytes();
        let Some(place) = self.image.get_mut(offset..offset + bytes) else { return Ok(()) };
        place.copy_from_slice(&all[..bytes]);
        if self.bus.big {
            place.reverse();
        }
        self.file
            .write_all_at(&self.image[offset..offset + bytes], self.offset_bytes + offset as u64)
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
            let divisor = self.bus.modulus().pow(from_low as u32);
            let word = whole / divisor % self.bus.modulus();
            self.set(self.place(row, channel, from_low), word)?;
        }
        Ok(())
    }
}
