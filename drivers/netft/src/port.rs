//! The link to a box: a trait for datagrams that never waits, and its implementation by a UDP
//! socket that is connected.

use std::io::{self, ErrorKind};
use std::net::UdpSocket;
use std::time::Duration;

use taktil_hal::OpenError;

use crate::config::Config;
use crate::rdt::{Command, RECORD_BYTES, Record, request};

/// How often the opening asks for records before it gives up.
const START_TRIES_MAX: u32 = 3;
/// Datagrams of one try that may be no record.
const START_DATAGRAMS_MAX: usize = 16;
/// Room for a datagram: one byte more than a record, so that a longer one is seen.
pub(crate) const BUFFER_BYTES: usize = RECORD_BYTES + 1;

/// What a look at the link found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Arrival {
    /// A datagram of so many bytes, cut where the buffer ends.
    Datagram(usize),
    /// The news that nobody listens at the other end.
    Refusal,
    /// Nothing more for now.
    Nothing,
}

/// A link that carries datagrams to a box and back. A box in another process and a model of it in
/// this one are both behind it.
pub trait Port: Send {
    /// Hands a datagram over; it may be lost.
    ///
    /// # Errors
    /// The system's, without allocating.
    fn send(&mut self, packet: &[u8]) -> io::Result<()>;

    /// Takes the next datagram that has arrived; returns at once.
    fn receive(&mut self, buffer: &mut [u8]) -> Arrival;
}

/// A UDP socket that is connected to a box.
#[derive(Debug)]
pub struct UdpPort {
    socket: UdpSocket,
}

impl UdpPort {
    /// Connects to a box; nothing is sent.
    ///
    /// # Errors
    /// The system's: no such network, no permission, no file descriptor left.
    pub fn connect(address: &str) -> io::Result<UdpPort> {
        let any = if address.starts_with('[') { "[::]:0" } else { "0.0.0.0:0" };
        let socket = UdpSocket::bind(any)?;
        socket.connect(address)?;
        Ok(UdpPort { socket })
    }

    /// Asks for the bias and the stream, and waits for the first record; before any job.
    pub(crate) fn start(&mut self, config: &Config) -> Result<(), OpenError> {
        let error = |what: String, remedy: &str| {
            OpenError::device(&config.address, "address", what, remedy)
        };
        let broken = |bad: io::Error| error(format!("it cannot be asked ({bad})"), ROUTE_REMEDY);
        let wait = Duration::from_millis(u64::from(config.open_wait_ms.max(1)));
        self.socket.set_read_timeout(Some(wait / START_TRIES_MAX)).map_err(broken)?;
        let mut strange = 0;
        for _ in 0..START_TRIES_MAX {
            if config.bias {
                let _ = self.socket.send(&request(Command::Bias, 0));
            }
            // A box that refuses is asked again: it may have come up meanwhile.
            let _ = self.socket.send(&request(Command::Start, 0));
            match self.first_record() {
                Ok(None) => {}
                Ok(Some(0)) => {
                    self.socket.set_nonblocking(true).map_err(broken)?;
                    return Ok(());
                }
                Ok(Some(status)) => {
                    let what = format!("the box is not well: its status is {status:08x}");
                    return Err(error(what, "look at its page for the cause and cure that first"));
                }
                Err(datagrams) => strange += datagrams,
            }
        }
        Err(match strange {
            0 => error(
                format!("no record came within {} ms", config.open_wait_ms),
                "switch the box on, plug its cable in, and give its address and port",
            ),
            _ => error(
                format!("{strange} datagrams came, and none is a record"),
                "give the address and port of a Net F/T box",
            ),
        })
    }

    /// The status of the first record of a try, `None` when nothing comes, or the number of
    /// datagrams that are none.
    fn first_record(&self) -> Result<Option<u32>, usize> {
        let mut buffer = [0; BUFFER_BYTES];
        let mut strange = 0;
        for _ in 0..START_DATAGRAMS_MAX {
            match self.socket.recv(&mut buffer) {
                Ok(bytes) => match Record::parse(&buffer[..bytes]) {
                    Some(record) => return Ok(Some(record.status)),
                    None => strange += 1,
                },
                Err(bad) if bad.kind() == ErrorKind::ConnectionRefused => {}
                Err(_) => break,
            }
        }
        if strange == 0 { Ok(None) } else { Err(strange) }
    }
}

/// What to do about a socket that does not work.
const ROUTE_REMEDY: &str = "give this host an address in the sensor's network";

impl Port for UdpPort {
    fn send(&mut self, packet: &[u8]) -> io::Result<()> {
        match self.socket.send(packet) {
            // The error of an earlier datagram, reported late: this one was not sent.
            Err(error) if error.kind() == ErrorKind::ConnectionRefused => {
                self.socket.send(packet).map(drop)
            }
            other => other.map(drop),
        }
    }

    fn receive(&mut self, buffer: &mut [u8]) -> Arrival {
        match self.socket.recv(buffer) {
            Ok(bytes) => Arrival::Datagram(bytes),
            Err(error) if error.kind() == ErrorKind::ConnectionRefused => Arrival::Refusal,
            Err(_) => Arrival::Nothing,
        }
    }
}

impl Drop for UdpPort {
    fn drop(&mut self) {
        // A box that nobody hears need not send. It may be gone itself.
        let _ = self.socket.send(&request(Command::Stop, 0));
    }
}
