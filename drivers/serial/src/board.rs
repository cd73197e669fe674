//! What the boards have in common: they cut a stream into messages, and they are started by a
//! dialogue of requests and answers, each with a deadline.

mod agni;
mod dialogue;
mod flexitac;
mod weiss;

pub(crate) use agni::Agni;
pub(crate) use flexitac::FlexiTac;
pub(crate) use weiss::Weiss;

use taktil_hal::Nanos;

use crate::payload::Payload;

/// The longest request (bytes).
pub const REQUEST_BYTES_MAX: usize = 16;

/// Bytes for the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Request {
    bytes: [u8; REQUEST_BYTES_MAX],
    length: usize,
}

impl Request {
    pub(crate) fn new() -> Request {
        Request { bytes: [0; REQUEST_BYTES_MAX], length: 0 }
    }

    /// Appends bytes; what does not fit is left out, which no request here reaches.
    pub(crate) fn with(mut self, bytes: &[u8]) -> Request {
        for byte in bytes {
            if let Some(place) = self.bytes.get_mut(self.length) {
                *place = *byte;
                self.length += 1;
            }
        }
        self
    }

    /// The bytes to send.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.bytes[..self.length]
    }
}

/// Where a board stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// The dialogue goes on.
    Starting,
    /// Scans arrive.
    Streaming,
    /// The dialogue has failed; it has to be begun again.
    Failed(StartError),
}

/// Why a dialogue failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StartError {
    /// No answer to a request, by its name.
    NoAnswer(&'static str),
    /// The board does not stop to send although it was told to.
    NotSilent,
    /// The board refuses a request, by its name, with a number of its own list.
    Refused(&'static str, u16),
    /// The board has another size.
    Size {
        /// Rows of the board.
        rows: u16,
        /// Columns of the board.
        cols: u16,
    },
    /// The board has another full scale.
    FullScale(u16),
    /// No logical sensor has the 512 bytes of a Myrmex v2, or the one configured has not.
    NoSensor,
    /// There is no matrix of that number.
    NoMatrix,
    /// The stream holds text: the diagnostic firmware of FlexiTac.
    Text,
    /// Headers of FlexiTac stand at another distance (bytes), which belongs to another size.
    HeaderDistance(u32),
    /// Bytes arrive, and no message is among them: another board or another speed.
    Foreign,
}

/// What stands at the begin of the bytes not read yet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Verdict {
    /// A message may begin here; more bytes are needed.
    Incomplete,
    /// This number of bytes, at least 1, begins no message.
    Skip(usize),
    /// A message of this number of bytes, at least 1.
    Message(usize),
}

/// Bytes not read yet, and what is known of them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct View<'a> {
    pub(crate) bytes: &'a [u8],
    /// The bytes before these were a message.
    pub(crate) locked: bool,
    /// When the first of these bytes was received.
    pub(crate) head_at: Nanos,
    pub(crate) now: Nanos,
}

/// The protocol of one board. It neither waits nor allocates.
pub(crate) trait Board: Send {
    /// The longest message that [`Board::examine`] waits for (bytes).
    fn message_bytes_max(&self) -> usize;

    /// Judges the begin of the bytes not read yet, which are not empty.
    fn examine(&mut self, view: View<'_>) -> Verdict;

    /// Takes a message of [`Board::examine`]; gives the image, if it carries one, and when the last
    /// byte was there, if that was before `now`.
    fn accept<'a>(&mut self, message: &'a [u8], now: Nanos)
    -> (Option<Payload<'a>>, Option<Nanos>);

    /// Begins the dialogue anew.
    fn restart(&mut self, now: Nanos);

    /// The next request that is due; `heard` is when a byte was received last.
    fn poll(&mut self, now: Nanos, heard: Nanos) -> Option<Request>;

    /// Where the dialogue stands.
    fn phase(&self) -> Phase;
}
