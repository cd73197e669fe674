//! The object dictionary of an emulated drive, as far as a host needs it, and the server that
//! answers for it.

use std::collections::BTreeMap;

/// An object: its value, how wide it is, and who may write it.
#[derive(Clone, Copy, Debug)]
struct Entry {
    value: u32,
    bytes: u8,
    is_writable: bool,
}

/// The dictionary.
#[derive(Clone, Debug)]
pub(crate) struct Objects {
    entries: BTreeMap<(u16, u8), Entry>,
}

impl Objects {
    /// What a drive has after power came on.
    pub(crate) fn new(node: u8, rated_torque_mnm: u32) -> Objects {
        let mut all = Objects { entries: BTreeMap::new() };
        let id = u32::from(node);
        for (index, sub, bytes, value) in [
            (0x1000, 0, 4, 0x0002_0192),
            (0x1018, 1, 4, 0x0000_7461),
            (0x603f, 0, 2, 0),
            (0x6041, 0, 2, 0),
            (0x6061, 0, 1, 0),
            (0x6064, 0, 4, 0),
            (0x606c, 0, 4, 0),
            (0x6077, 0, 2, 0),
            (0x6502, 0, 4, 0x0000_0380),
        ] {
            all.add(index, sub, bytes, value, false);
        }
        for (index, sub, bytes, value) in [
            (0x1005, 0, 4, 0x80),
            (0x1006, 0, 4, 0),
            (0x1016, 1, 4, 0),
            (0x1017, 0, 2, 0),
            (0x6007, 0, 2, 1),
            (0x6040, 0, 2, 0),
            (0x605a, 0, 2, 2),
            (0x6060, 0, 1, 0),
            (0x6071, 0, 2, 0),
            (0x6076, 0, 4, rated_torque_mnm),
            (0x607a, 0, 4, 0),
            (0x60ff, 0, 4, 0),
            (0x60c2, 1, 1, 1),
            (0x60c2, 2, 1, 0xfd),
            (0x60fe, 1, 4, 0),
            (0x60fe, 2, 4, 0),
        ] {
            all.add(index, sub, bytes, value, true);
        }
        for (number, base) in [(0, 0x200), (1, 0x300), (2, 0x400), (3, 0x500)] {
            all.exchange(0x1400 + number, base + id);
        }
        for (number, base) in [(0, 0x180), (1, 0x280), (2, 0x380), (3, 0x480)] {
            all.exchange(0x1800 + number, 0x4000_0000 + base + id);
        }
        all
    }

    fn add(&mut self, index: u16, sub: u8, bytes: u8, value: u32, is_writable: bool) {
        self.entries.insert((index, sub), Entry { value, bytes, is_writable });
    }

    fn exchange(&mut self, index: u16, identifier: u32) {
        self.add(index, 1, 4, 0x8000_0000 | identifier, true);
        self.add(index, 2, 1, 0xff, true);
        for sub in 0..=8 {
            self.add(index + 0x200, sub, if sub == 0 { 1 } else { 4 }, 0, true);
        }
    }

    /// The value of an object; 0 for one that is not there.
    pub(crate) fn get(&self, index: u16, sub: u8) -> u32 {
        self.entries.get(&(index, sub)).map_or(0, |entry| entry.value)
    }

    /// Puts a value there, whoever may write it.
    pub(crate) fn set(&mut self, index: u16, sub: u8, value: u32) {
        if let Some(entry) = self.entries.get_mut(&(index, sub)) {
            let unused = 8 * (4 - u32::from(entry.bytes));
            entry.value = (value << unused) >> unused;
        }
    }

    /// The objects that a frame carries: index, sub-index and bytes.
    pub(crate) fn mapping(&self, contents: u16) -> Vec<(u16, u8, u8)> {
        let count = self.get(contents, 0).min(8) as u8;
        let object = |sub| {
            let word = self.get(contents, sub);
            ((word >> 16) as u16, (word >> 8) as u8, (word as u8) / 8)
        };
        (1..=count).map(object).collect()
    }

    /// Answers a request for an object.
    pub(crate) fn serve(&mut self, request: &[u8]) -> Option<Vec<u8>> {
        let [command, low, high, sub, a, b, c, d] = *request else { return None };
        let index = u16::from_le_bytes([low, high]);
        let abort = |reason: u32| {
            let mut answer = vec![0x80, low, high, sub];
            answer.extend(reason.to_le_bytes());
            Some(answer)
        };
        let Some(entry) = self.entries.get(&(index, sub)).copied() else {
            let has_index = self.entries.keys().any(|key| key.0 == index);
            return abort(if has_index { 0x0609_0011 } else { 0x0602_0000 });
        };
        match command >> 5 {
            2 => {
                let mut answer = vec![0x43 | (4 - entry.bytes) << 2, low, high, sub];
                answer.extend(entry.value.to_le_bytes());
                Some(answer)
            }
            1 if !entry.is_writable => abort(0x0601_0002),
            1 if command & 3 != 3 || 4 - ((command >> 2) & 3) != entry.bytes => abort(0x0607_0010),
            1 => {
                if let Some(reason) = self.refusal(index, sub) {
                    return abort(reason);
                }
                self.set(index, sub, u32::from_le_bytes([a, b, c, d]));
                Some(vec![0x60, low, high, sub, 0, 0, 0, 0])
            }
            _ => abort(0x0504_0001),
        }
    }

    /// What is mapped may only be changed while the frame is off and its count is 0.
    fn refusal(&self, index: u16, sub: u8) -> Option<u32> {
        let is_contents = (0x1600..0x1604).contains(&index) || (0x1a00..0x1a04).contains(&index);
        if !is_contents {
            return None;
        }
        let is_on = self.get(index - 0x200, 1) & 0x8000_0000 == 0;
        let is_counted = sub != 0 && self.get(index, 0) != 0;
        (is_on || is_counted).then_some(0x0800_0022)
    }
}
