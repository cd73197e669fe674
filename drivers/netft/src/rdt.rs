//! The bytes of RDT: requests of 8 bytes to the box, records of 36 bytes from it, all big-endian.
//!
//! ```
//! use taktil_drivers_netft::rdt::{Command, Record, request};
//!
//! assert_eq!(request(Command::Start, 0), [0x12, 0x34, 0, 2, 0, 0, 0, 0]);
//! assert_eq!(Record::parse(&[0; 35]), None);
//! ```

use taktil_hal::FORCE_TORQUE_CHANNELS;

/// Port of the box on which it takes requests.
pub const RDT_PORT: u16 = 49_152;
/// Length of a request (bytes).
pub const REQUEST_BYTES: usize = 8;
/// Length of a record (bytes).
pub const RECORD_BYTES: usize = 36;
/// The first two bytes of a request.
const REQUEST_MARK: u16 = 0x1234;

/// What can be asked of a box.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command {
    /// No more records.
    Stop,
    /// A record in each datagram, as soon as it is measured.
    Start,
    /// What the sensor measures now is its zero from now on.
    Bias,
}

impl Command {
    const fn code(self) -> u16 {
        match self {
            Command::Stop => 0x0000,
            Command::Start => 0x0002,
            Command::Bias => 0x0042,
        }
    }
}

/// The bytes of a request; `count` records, without end for 0.
#[must_use]
pub const fn request(command: Command, count: u32) -> [u8; REQUEST_BYTES] {
    let ([a, b], [c, d]) = (REQUEST_MARK.to_be_bytes(), command.code().to_be_bytes());
    let [e, f, g, h] = count.to_be_bytes();
    [a, b, c, d, e, f, g, h]
}

/// One record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Record {
    /// Number of the record in its stream, from 1.
    pub rdt_sequence: u32,
    /// Number of the sample since the box was switched on.
    pub ft_sequence: u32,
    /// 0 when box and sensor are well.
    pub status: u32,
    /// Fx, Fy, Fz, Tx, Ty and Tz in the box's counts.
    pub counts: [i32; FORCE_TORQUE_CHANNELS],
}

impl Record {
    /// Reads a datagram; `None` when it has another length than a record.
    #[must_use]
    pub fn parse(datagram: &[u8]) -> Option<Record> {
        let bytes: &[u8; RECORD_BYTES] = datagram.try_into().ok()?;
        let word = |place: usize| {
            let at = 4 * place;
            u32::from_be_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
        };
        Some(Record {
            rdt_sequence: word(0),
            ft_sequence: word(1),
            status: word(2),
            counts: core::array::from_fn(|axis| word(3 + axis).cast_signed()),
        })
    }
}
