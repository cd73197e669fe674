//! Unpacks a gzip file (RFC 1951, RFC 1952): the kernel gives away its configuration in no other
//! form. Refuses damaged streams, wrong sums and anything that grows beyond a bound.

/// No kernel configuration is longer (bytes).
const OUTPUT_MAX: usize = 8 << 20;
/// Longest code of a symbol in bits.
const CODE_BITS: usize = 15;

const LENGTH_BASE: [u16; 29] = [
    3, 4, 5, 6, 7, 8, 9, 10, 11, 13, 15, 17, 19, 23, 27, 31, 35, 43, 51, 59, 67, 83, 99, 115, 131,
    163, 195, 227, 258,
];
const LENGTH_EXTRA: [u8; 29] =
    [0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3, 4, 4, 4, 4, 5, 5, 5, 5, 0];
const DISTANCE_BASE: [u16; 30] = [
    1, 2, 3, 4, 5, 7, 9, 13, 17, 25, 33, 49, 65, 97, 129, 193, 257, 385, 513, 769, 1025, 1537,
    2049, 3073, 4097, 6145, 8193, 12289, 16385, 24577,
];
const DISTANCE_EXTRA: [u8; 30] = [
    0, 0, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5, 6, 6, 7, 7, 8, 8, 9, 9, 10, 10, 11, 11, 12, 12, 13,
    13,
];
/// Order in which the lengths of the code of codes are written.
const ORDER: [usize; 19] = [16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15];

/// Unpacks the first member of a gzip file; `None` when it is damaged, cut or too long.
#[must_use]
pub(super) fn gunzip(file: &[u8]) -> Option<Vec<u8>> {
    let header = file.get(..10)?;
    if header[..3] != [0x1f, 0x8b, 8] {
        return None;
    }
    let flags = header[3];
    let mut at = 10;
    if flags & 4 != 0 {
        let length = file.get(at..at + 2)?;
        at += 2 + usize::from(u16::from_le_bytes([length[0], length[1]]));
    }
    // A name and a remark, each up to a zero.
    for bit in [8, 16] {
        if flags & bit != 0 {
            at += file.get(at..)?.iter().position(|byte| *byte == 0)? + 1;
        }
    }
    if flags & 2 != 0 {
        at += 2;
    }
    let mut bits = Bits { bytes: file.get(at..)?, at: 0, held: 0, count: 0 };
    let out = inflate(&mut bits)?;
    let tail = bits.bytes.get(bits.at..bits.at + 8)?;
    let word = |n: usize| u32::from_le_bytes([tail[n], tail[n + 1], tail[n + 2], tail[n + 3]]);
    (word(0) == crc32fast::hash(&out) && word(4) as usize == out.len()).then_some(out)
}

struct Bits<'a> {
    bytes: &'a [u8],
    at: usize,
    held: u32,
    count: u32,
}

impl Bits<'_> {
    fn take(&mut self, n: u8) -> Option<usize> {
        while self.count < u32::from(n) {
            self.held |= u32::from(*self.bytes.get(self.at)?) << self.count;
            self.at += 1;
            self.count += 8;
        }
        let value = self.held & ((1 << n) - 1);
        self.held >>= n;
        self.count -= u32::from(n);
        Some(value as usize)
    }

    /// Forgets the rest of the byte that was begun.
    fn align(&mut self) {
        self.held = 0;
        self.count = 0;
    }
}

/// A canonical Huffman code: how many codes of each length, and the symbols in order.
struct Code {
    counts: [u16; CODE_BITS + 1],
    symbols: Vec<u16>,
}

impl Code {
    fn new(lengths: &[u8]) -> Option<Code> {
        let mut counts = [0u16; CODE_BITS + 1];
        for length in lengths {
            *counts.get_mut(usize::from(*length))? += 1;
        }
        let mut left = 1i32;
        for count in &counts[1..] {
            left = 2 * left - i32::from(*count);
            if left < 0 {
                return None;
            }
        }
        let mut symbols = Vec::with_capacity(lengths.len());
        for wanted in 1..=CODE_BITS {
            for (symbol, length) in lengths.iter().enumerate() {
                if usize::from(*length) == wanted {
                    symbols.push(u16::try_from(symbol).ok()?);
                }
            }
        }
        Some(Code { counts, symbols })
    }

    fn symbol(&self, bits: &mut Bits<'_>) -> Option<usize> {
        let (mut code, mut first, mut index) = (0usize, 0usize, 0usize);
        for count in &self.counts[1..] {
            let count = usize::from(*count);
            code |= bits.take(1)?;
            if code < first + count {
                return self.symbols.get(index + code - first).map(|symbol| usize::from(*symbol));
            }
            index += count;
            first = (first + count) << 1;
            code <<= 1;
        }
        None
    }
}

fn inflate(bits: &mut Bits<'_>) -> Option<Vec<u8>> {
    let mut out = Vec::new();
    loop {
        let last = bits.take(1)? == 1;
        match bits.take(2)? {
            0 => stored(bits, &mut out)?,
            1 => {
                let lengths: Vec<u8> = [(8, 144), (9, 112), (7, 24), (8, 8)]
                    .into_iter()
                    .flat_map(|(length, count)| std::iter::repeat_n(length, count))
                    .collect();
                block(bits, &Code::new(&lengths)?, &Code::new(&[5; 30])?, &mut out)?;
            }
            2 => {
                let (literals, distances) = codes(bits)?;
                block(bits, &literals, &distances, &mut out)?;
            }
            _ => return None,
        }
        if last {
            return Some(out);
        }
    }
}

fn stored(bits: &mut Bits<'_>, out: &mut Vec<u8>) -> Option<()> {
    bits.align();
    let head = bits.bytes.get(bits.at..bits.at + 4)?;
    let length = u16::from_le_bytes([head[0], head[1]]);
    if length != !u16::from_le_bytes([head[2], head[3]]) {
        return None;
    }
    let start = bits.at + 4;
    bits.at = start + usize::from(length);
    out.extend_from_slice(bits.bytes.get(start..bits.at)?);
    (out.len() <= OUTPUT_MAX).then_some(())
}

fn codes(bits: &mut Bits<'_>) -> Option<(Code, Code)> {
    let literals = bits.take(5)? + 257;
    let distances = bits.take(5)? + 1;
    let written = bits.take(4)? + 4;
    let mut lengths = [0u8; 19];
    for place in &ORDER[..written] {
        lengths[*place] = u8::try_from(bits.take(3)?).ok()?;
    }
    let code = Code::new(&lengths)?;
    let mut lengths: Vec<u8> = Vec::with_capacity(literals + distances);
    while lengths.len() < literals + distances {
        let (value, count) = match code.symbol(bits)? {
            16 => (*lengths.last()?, 3 + bits.take(2)?),
            17 => (0, 3 + bits.take(3)?),
            18 => (0, 11 + bits.take(7)?),
            length => (u8::try_from(length).ok()?, 1),
        };
        lengths.extend(std::iter::repeat_n(value, count));
    }
    if lengths.len() != literals + distances {
        return None;
    }
    let (first, second) = lengths.split_at(literals);
    Some((Code::new(first)?, Code::new(second)?))
}

fn block(bits: &mut Bits<'_>, literals: &Code, far: &Code, out: &mut Vec<u8>) -> Option<()> {
    loop {
        match literals.symbol(bits)? {
            symbol @ 0..=255 => out.push(u8::try_from(symbol).ok()?),
            256 => return Some(()),
            symbol => {
                let at = symbol - 257;
                let length = usize::from(*LENGTH_BASE.get(at)?) + bits.take(LENGTH_EXTRA[at])?;
                let at = far.symbol(bits)?;
                let back = usize::from(*DISTANCE_BASE.get(at)?) + bits.take(DISTANCE_EXTRA[at])?;
                let start = out.len().checked_sub(back)?;
                // Source and target may overlap: byte by byte.
                for from in start..start + length {
                    out.push(*out.get(from)?);
                }
            }
        }
        if out.len() > OUTPUT_MAX {
            return None;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Made with zlib: fixed codes, stored, and dynamic codes.
    #[rustfmt::skip]
    const FIXED: [u8; 76] = [
        31, 139, 8, 0, 0, 0, 0, 0, 2, 3, 115, 246, 247, 115, 243, 116, 143, 15, 8, 114, 117, 245,
        13, 8, 137, 15, 10, 177, 173, 228, 114, 134, 136, 121, 68, 217, 26, 26, 24, 24, 192, 184,
        126, 254, 64, 145, 120, 183, 80, 31, 31, 132, 18, 111, 199, 96, 71, 191, 248, 224, 16,
        71, 103, 111, 219, 92, 46, 0, 106, 62, 91, 90, 76, 0, 0, 0,
    ];
    #[rustfmt::skip]
    const STORED: [u8; 53] = [
        31, 139, 8, 0, 0, 0, 0, 0, 4, 3, 1, 30, 0, 225, 255, 67, 79, 78, 70, 73, 71, 95, 80, 82,
        69, 69, 77, 80, 84, 95, 82, 84, 61, 121, 10, 67, 79, 78, 70, 73, 71, 95, 72, 90, 61, 18,
        150, 28, 80, 30, 0, 0, 0,
    ];
    #[rustfmt::skip]
    const DYNAMIC: [u8; 248] = [
        31, 139, 8, 0, 0, 0, 0, 0, 2, 3, 141, 148, 49, 14, 194, 48, 12, 69, 247, 158, 34, 18, 23,
        168, 157, 196, 73, 6, 134, 82, 9, 196, 2, 71, 96, 98, 96, 129, 161, 93, 184, 61, 3, 44,
        223, 250, 162, 25, 91, 61, 229, 217, 142, 243, 231, 235, 229, 120, 62, 221, 166, 113,
        255, 30, 118, 97, 254, 126, 29, 198, 240, 88, 194, 243, 181, 134, 229, 190, 14, 191, 159,
        147, 0, 82, 24, 146, 0, 145, 196, 152, 6, 140, 10, 85, 25, 66, 149, 65, 154, 1, 162, 178,
        136, 7, 9, 181, 37, 44, 73, 168, 205, 176, 55, 205, 12, 170, 56, 35, 106, 139, 128, 240,
        206, 220, 28, 169, 43, 21, 44, 72, 25, 84, 20, 161, 70, 117, 192, 80, 89, 116, 141, 81,
        153, 225, 65, 66, 101, 13, 111, 77, 141, 234, 112, 72, 188, 53, 92, 89, 42, 19, 87, 17,
        149, 101, 39, 139, 180, 108, 92, 164, 72, 95, 72, 194, 123, 163, 182, 230, 38, 73, 109,
        201, 149, 68, 109, 205, 109, 36, 125, 145, 25, 167, 68, 109, 21, 43, 162, 50, 195, 107,
        19, 42, 83, 183, 146, 244, 73, 214, 186, 29, 53, 57, 109, 103, 141, 106, 71, 216, 212,
        158, 180, 49, 233, 72, 155, 216, 145, 54, 34, 29, 105, 83, 173, 39, 109, 236, 79, 218,
        124, 0, 213, 107, 107, 228, 180, 5, 0, 0,
    ];

    fn dynamic_text() -> String {
        (0..40u32)
            .map(|i| format!("CONFIG_A{}=y\n# CONFIG_B{} is not set\n", i * i % 97, i * 7 % 31))
            .collect()
    }

    #[test]
    fn all_three_kinds_of_blocks_unpack() {
        let text =
            "CONFIG_PREEMPT_RT=y\nCONFIG_HZ=1000\nCONFIG_NO_HZ_FULL=y\nCONFIG_KASAN_STACK=m\n";
        assert_eq!(gunzip(&FIXED).unwrap(), text.as_bytes());
        assert_eq!(gunzip(&STORED).unwrap(), &text.as_bytes()[..30]);
        assert_eq!(gunzip(&DYNAMIC).unwrap(), dynamic_text().as_bytes());
    }

    #[test]
    fn cut_and_flipped_files_are_refused() {
        for good in [&FIXED[..], &STORED[..], &DYNAMIC[..]] {
            for cut in 0..good.len() {
                assert_eq!(gunzip(&good[..cut]), None, "cut at {cut}");
            }
            // Bytes 4 to 9 are a date and two remarks; everything else matters.
            for at in (0..3).chain(10..good.len()) {
                let mut bad = good.to_vec();
                bad[at] ^= 0x10;
                let out = gunzip(&bad);
                assert!(out.is_none() || out == gunzip(good), "byte {at}");
            }
        }
    }

    #[test]
    fn a_bomb_is_refused() {
        // Fixed codes: a zero, then copies of length 258 from one byte back, for ever.
        let mut file = vec![0x1f, 0x8b, 8, 0, 0, 0, 0, 0, 0, 0];
        let mut bits = vec![1, 1, 0];
        bits.extend([0, 0, 1, 1, 0, 0, 0, 0]);
        for _ in 0..40_000 {
            bits.extend([1, 1, 0, 0, 0, 1, 0, 1]);
            bits.extend([0, 0, 0, 0, 0]);
        }
        for byte in bits.chunks(8) {
            file.push(byte.iter().enumerate().fold(0, |sum, (n, bit)| sum | (bit << n)));
        }
        assert_eq!(gunzip(&file), None);
    }
}
