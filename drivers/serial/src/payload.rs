//! The image inside a message, decoded in one pass when a scan is there to take it.

/// How tactels stand in a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Encoding {
    /// One byte each, row by row.
    Bytes,
    /// 16-bit words, low byte first, row by row.
    Words,
    /// 256 words of Myrmex v2 in the order of its converters, upper four bits cut off.
    MyrmexWords,
    /// Runs of DSA: low 12 bits value, high 4 bits count; `skip` texels of other matrices in front.
    Runs {
        /// Texels in front of the image.
        skip: usize,
        /// Texels of the whole message.
        total: usize,
    },
}

/// First word of a group of four columns, by row within a group of four and column within it.
const MYRMEX_WORDS: [[u8; 4]; 4] =
    [[208, 224, 32, 0], [192, 48, 16, 64], [176, 144, 112, 80], [160, 240, 128, 96]];

/// The word of each tactel.
const MYRMEX_ORDER: [u8; 256] = {
    let mut order = [0; 256];
    let mut tactel = 0;
    while tactel < 256 {
        let (row, col) = (tactel / 16, tactel % 16);
        order[tactel] = MYRMEX_WORDS[row % 4][col % 4] + (col / 4 + 4 * (row / 4)) as u8;
        tactel += 1;
    }
    order
};

/// The image of one message.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Payload<'a> {
    pub(crate) bytes: &'a [u8],
    pub(crate) encoding: Encoding,
}

impl Payload<'_> {
    /// Whether the bytes are an image of `tactels`, before anything is written.
    pub(crate) fn is_image(&self, tactels: usize) -> bool {
        match self.encoding {
            Encoding::Bytes => self.bytes.len() == tactels,
            Encoding::Words => self.bytes.len() == 2 * tactels,
            Encoding::MyrmexWords => self.bytes.len() == 512 && tactels == 256,
            Encoding::Runs { skip, total } => {
                let (units, rest) = self.bytes.as_chunks::<2>();
                let texels: usize = units.iter().map(|unit| usize::from(unit[1] >> 4)).sum();
                rest.is_empty() && texels == total && skip + tactels <= total
            }
        }
    }

    /// Writes the counts row by row; the payload must be an image of that length.
    pub(crate) fn decode(&self, values: &mut [u16]) {
        let words = self.bytes.as_chunks::<2>().0;
        match self.encoding {
            Encoding::Bytes => {
                for (value, byte) in values.iter_mut().zip(self.bytes) {
                    *value = u16::from(*byte);
                }
            }
            Encoding::Words => {
                for (value, word) in values.iter_mut().zip(words) {
                    *value = u16::from_le_bytes(*word);
                }
            }
            Encoding::MyrmexWords => {
                for (value, place) in values.iter_mut().zip(MYRMEX_ORDER) {
                    let word = words.get(usize::from(place)).copied().unwrap_or_default();
                    *value = u16::from_le_bytes(word) & 0x0fff;
                }
            }
            Encoding::Runs { skip, .. } => decode_runs(words, skip, values),
        }
    }
}

fn decode_runs(units: &[[u8; 2]], skip: usize, values: &mut [u16]) {
    let mut at = 0;
    for unit in units {
        let word = u16::from_le_bytes(*unit);
        let end = at + usize::from(word >> 12);
        let (from, to) = (at.max(skip) - skip, end.max(skip) - skip);
        let count = values.len();
        values[from.min(count)..to.min(count)].fill(word & 0x0fff);
        at = end;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_word_of_a_myrmex_is_one_tactel() {
        let mut seen = MYRMEX_ORDER;
        seen.sort_unstable();
        assert!(seen.iter().enumerate().all(|(place, word)| place == usize::from(*word)));
        assert_eq!(MYRMEX_ORDER[..5], [208, 224, 32, 0, 209]);
        assert_eq!(MYRMEX_ORDER[255], 96 + 3 + 12);
    }

    #[test]
    fn runs_fill_their_matrix_and_nothing_else() {
        let units: Vec<u8> =
            [0x3005_u16, 0x4007, 0x1009].iter().flat_map(|unit| unit.to_le_bytes()).collect();
        let payload = Payload { bytes: &units, encoding: Encoding::Runs { skip: 2, total: 8 } };
        let mut values = [0; 6];
        assert!(payload.is_image(6) && !payload.is_image(7));
        payload.decode(&mut values);
        assert_eq!(values, [5, 7, 7, 7, 7, 9]);
        let short = Payload { bytes: &units[..4], ..payload };
        assert!(!short.is_image(6));
    }
}
