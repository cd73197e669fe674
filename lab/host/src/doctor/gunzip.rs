//! Unpacks the gzip file in which the kernel provides its configuration. A damaged file, and a
//! content longer than a bound, are errors with a text.

use std::io::Read;

use flate2::read::GzDecoder;

/// Longest content (bytes). Kernel configurations have at most 0.4 MiB today; the bound keeps a
/// malicious file from filling the memory.
const OUTPUT_BYTES_MAX: usize = 8 << 20;

/// The content of the first member of a gzip file (RFC 1952).
///
/// # Errors
/// A text for people when the file is damaged, cut or longer than `OUTPUT_BYTES_MAX`.
pub(super) fn gunzip(file: &[u8]) -> Result<Vec<u8>, String> {
    let mut content = Vec::new();
    // One byte more than allowed is enough to see that the content is too long.
    let read = GzDecoder::new(file).take(OUTPUT_BYTES_MAX as u64 + 1).read_to_end(&mut content);
    match read {
        Err(_) => Err("is no whole gzip file".to_owned()),
        Ok(length) if length > OUTPUT_BYTES_MAX => {
            Err(format!("holds more than {} MiB", OUTPUT_BYTES_MAX >> 20))
        }
        Ok(_) => Ok(content),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// These files were made with zlib: fixed codes, a stored block, and dynamic codes.
    #[rustfmt::skip]
    const FIXED_CODES: [u8; 76] = [
        31, 139, 8, 0, 0, 0, 0, 0, 2, 3, 115, 246, 247, 115, 243, 116, 143, 15, 8, 114, 117, 245,
        13, 8, 137, 15, 10, 177, 173, 228, 114, 134, 136, 121, 68, 217, 26, 26, 24, 24, 192, 184,
        126, 254, 64, 145, 120, 183, 80, 31, 31, 132, 18, 111, 199, 96, 71, 191, 248, 224, 16,
        71, 103, 111, 219, 92, 46, 0, 106, 62, 91, 90, 76, 0, 0, 0,
    ];
    #[rustfmt::skip]
    const STORED_BLOCK: [u8; 53] = [
        31, 139, 8, 0, 0, 0, 0, 0, 4, 3, 1, 30, 0, 225, 255, 67, 79, 78, 70, 73, 71, 95, 80, 82,
        69, 69, 77, 80, 84, 95, 82, 84, 61, 121, 10, 67, 79, 78, 70, 73, 71, 95, 72, 90, 61, 18,
        150, 28, 80, 30, 0, 0, 0,
    ];
    #[rustfmt::skip]
    const DYNAMIC_CODES: [u8; 248] = [
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
    fn all_three_kinds_of_blocks_are_unpacked() {
        let text =
            "CONFIG_PREEMPT_RT=y\nCONFIG_HZ=1000\nCONFIG_NO_HZ_FULL=y\nCONFIG_KASAN_STACK=m\n";
        assert_eq!(gunzip(&FIXED_CODES).unwrap(), text.as_bytes());
        assert_eq!(gunzip(&STORED_BLOCK).unwrap(), &text.as_bytes()[..30]);
        assert_eq!(gunzip(&DYNAMIC_CODES).unwrap(), dynamic_text().as_bytes());
    }

    #[test]
    fn cut_and_flipped_files_are_refused() {
        for good in [&FIXED_CODES[..], &STORED_BLOCK[..], &DYNAMIC_CODES[..]] {
            for cut in 0..good.len() {
                assert!(gunzip(&good[..cut]).is_err(), "cut at {cut}");
            }
            // Bytes 4 to 9 are a date and two remarks, which no checksum covers.
            for at in (0..3).chain(10..good.len()) {
                let mut bad = good.to_vec();
                bad[at] ^= 0x10;
                let out = gunzip(&bad);
                assert!(out.is_err() || out == gunzip(good), "byte {at}");
            }
        }
    }

    #[test]
    fn a_content_beyond_the_bound_is_refused() {
        // A literal zero, then 40,000 copies of 258 bytes from one byte back, in fixed codes.
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
        assert_eq!(gunzip(&file), Err("holds more than 8 MiB".to_owned()));
        // The damage behind the bound is not reached; a short file of the same kind is damaged.
        assert_eq!(gunzip(&file[..1000]), Err("is no whole gzip file".to_owned()));
    }
}
