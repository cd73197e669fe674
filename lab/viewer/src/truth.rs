//! Reads numbers of messages as they pass, without columns of the whole log in memory: joints,
//! torques, tactile images, and pin and table of the simulated bench.

use taktil_machine_foxglove::BenchInstant;
use taktil_record::{Channel, FieldInfo};
use taktil_rtcore::payload::Primitive;

/// The numbers of one field of a message; empty for a field that the channel does not have.
pub(crate) fn numbers(channel: &Channel, field: &str, data: &[u8]) -> Vec<f64> {
    let found = channel.payload_fields().iter().find(|info| info.name == field);
    found.map_or_else(Vec::new, |info| (0..info.count).map(|at| number(info, at, data)).collect())
}

/// The first number of a field; `None` without it.
pub(crate) fn scalar(channel: &Channel, field: &str, data: &[u8]) -> Option<f64> {
    let info = channel.payload_fields().iter().find(|info| info.name == field)?;
    (info.count > 0).then(|| number(info, 0, data))
}

/// One element of a field; NaN behind the end of the message.
fn number(info: &FieldInfo, element: usize, data: &[u8]) -> f64 {
    let size = info.kind.size();
    let at = info.offset + element * size;
    let Some(bytes) = data.get(at..at + size) else { return f64::NAN };
    let mut word = [0; 8];
    word[..size].copy_from_slice(bytes);
    let bits = u64::from_le_bytes(word);
    match info.kind {
        Primitive::F64 => f64::from_bits(bits),
        Primitive::F32 => f64::from(f32::from_bits((bits & u64::from(u32::MAX)) as u32)),
        Primitive::I64 | Primitive::I32 | Primitive::I16 => {
            let unused = 64 - 8 * size;
            ((bits << unused).cast_signed() >> unused) as f64
        }
        _ => bits as f64,
    }
}

/// Pin and table of the simulated bench, by a message of the signal `world.truth`; `None` for an
/// arm without a bench.
pub(crate) fn bench(channel: &Channel, data: &[u8]) -> Option<BenchInstant> {
    BenchInstant::from_fields(|field| numbers(channel, field, data))
}
