//! The digest of a run: one number that two runs share when every port carried the same bits at the
//! same ticks. It does not depend on how lanes interleave: each signal is hashed by itself, then
//! the hashes are hashed in the catalog's order.

use taktil_rtcore::record::{Catalog, Observer, Record};

/// Odd constants with well-mixed bits (the fractional part of the golden ratio, and of pi, times
/// 2^64).
const MIX_A: u64 = 0x9E37_79B9_7F4A_7C15;
const MIX_B: u64 = 0x243F_6A88_85A3_08D3 | 1;

/// Computes the digest from the records of a run.
#[derive(Clone, Debug)]
pub struct Digest {
    signals: Vec<u64>,
    names: Vec<String>,
}

fn mix(hash: u64, word: u64) -> u64 {
    let product = u128::from(hash ^ word.wrapping_mul(MIX_A)) * u128::from(MIX_B);
    (product as u64) ^ ((product >> 64) as u64).rotate_left(29) ^ word
}

/// Mixes two words with one multiplication; the previous hash is preserved for any values of the
/// words.
fn mix_both(hash: u64, [a, b]: [u64; 2]) -> u64 {
    let product = u128::from(hash ^ a) * u128::from(b ^ MIX_A);
    let folded = (product as u64) ^ ((product >> 64) as u64);
    hash.rotate_left(23).wrapping_mul(MIX_B) ^ folded ^ a.rotate_left(41)
}

fn bytes(mut hash: u64, body: &[u8]) -> u64 {
    let (pairs, rest) = body.as_chunks::<16>();
    for pair in pairs {
        let both = u128::from_le_bytes(*pair);
        hash = mix_both(hash, [both as u64, (both >> 64) as u64]);
    }
    let mut last = [0; 16];
    last[..rest.len()].copy_from_slice(rest);
    let both = u128::from_le_bytes(last);
    hash = mix_both(hash, [both as u64, (both >> 64) as u64]);
    mix(hash, body.len() as u64)
}

impl Digest {
    /// An empty digest for the signals of a machine.
    #[must_use]
    pub fn new(catalog: &Catalog) -> Digest {
        let names: Vec<String> = catalog.signals.iter().map(|signal| signal.name.clone()).collect();
        Digest { signals: vec![MIX_A; names.len()], names }
    }

    /// The digest of the records so far, as 16 hexadecimal digits.
    #[must_use]
    pub fn hex(&self) -> String {
        self.hex_by_names(|name| name)
    }

    /// As [`Digest::hex`], with each signal under the name that `name_of` gives it: finds the
    /// digest of a run from before a signal was renamed.
    #[must_use]
    pub fn hex_by_names(&self, name_of: impl Fn(&str) -> &str) -> String {
        let mut hash = MIX_B;
        for (name, signal) in self.names.iter().zip(&self.signals) {
            hash = mix(bytes(hash, name_of(name).as_bytes()), *signal);
        }
        format!("{hash:016x}")
    }
}

impl Observer for Digest {
    fn record(&mut self, record: &Record<'_>) {
        if let Some(hash) = self.signals.get_mut(record.signal) {
            let stamped = mix(mix(*hash, record.tick), record.release.0.cast_unsigned());
            *hash = bytes(stamped, record.body);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use taktil_rtcore::Nanos;
    use taktil_rtcore::record::Signal;

    fn catalog() -> Catalog {
        let signal = |name: &str| Signal {
            name: name.to_owned(),
            lane: 0,
            type_name: "T".into(),
            fields: (&[]).into(),
            size: 11,
        };
        Catalog { signals: vec![signal("a"), signal("b")], lanes: Vec::new() }
    }

    fn digest(records: &[(usize, u64, &[u8])]) -> String {
        let mut digest = Digest::new(&catalog());
        for (signal, tick, body) in records {
            digest.record(&Record { signal: *signal, tick: *tick, release: Nanos(5), body });
        }
        digest.hex()
    }

    #[test]
    fn interleaving_does_not_matter_and_every_bit_does() {
        let (x, y) = (*b"hello world", *b"hello worle");
        let base = digest(&[(0, 1, &x), (1, 1, &x), (0, 2, &x)]);
        assert_eq!(base, digest(&[(1, 1, &x), (0, 1, &x), (0, 2, &x)]));
        for other in [
            digest(&[(0, 1, &y), (1, 1, &x), (0, 2, &x)]),
            digest(&[(0, 1, &x), (1, 1, &x), (0, 3, &x)]),
            digest(&[(0, 1, &x), (1, 1, &x)]),
            digest(&[(1, 1, &x), (0, 1, &x), (1, 2, &x)]),
            digest(&[(0, 1, &x[..10]), (1, 1, &x), (0, 2, &x)]),
        ] {
            assert_ne!(base, other);
        }
    }
}
