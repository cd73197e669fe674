//! Joins an emulator with a UDP socket until it is told to end.

use std::io;
use std::net::{SocketAddr, UdpSocket};
use std::time::Duration;

use taktil_hal::Clock;

use crate::emulator::Emulator;

/// Longest time between two looks at what is due and whether to go on.
const WAIT_TIME: Duration = Duration::from_millis(5);
/// Room for a datagram.
const DATAGRAM_BYTES_MAX: usize = 2_048;

/// Answers on `socket` as long as `goes_on` says so. Answers go to whoever asked last.
///
/// # Errors
/// The socket's, time-outs apart.
pub fn serve(
    emulator: &mut Emulator,
    socket: &UdpSocket,
    clock: &dyn Clock,
    goes_on: &mut dyn FnMut() -> bool,
) -> io::Result<()> {
    let mut buffer = [0; DATAGRAM_BYTES_MAX];
    let mut peer: Option<SocketAddr> = None;
    let mut answers = Vec::new();
    while goes_on() {
        let now = clock.now();
        let wait = emulator.next_due().map_or(WAIT_TIME, |due| {
            Duration::from_nanos((due - now).0.max(1_000).cast_unsigned()).min(WAIT_TIME)
        });
        socket.set_read_timeout(Some(wait))?;
        match socket.recv_from(&mut buffer) {
            Ok((bytes, from)) => {
                peer = Some(from);
                emulator.receive(clock.now(), &buffer[..bytes]);
            }
            Err(error)
                if matches!(
                    error.kind(),
                    io::ErrorKind::WouldBlock
                        | io::ErrorKind::TimedOut
                        | io::ErrorKind::Interrupted
                        | io::ErrorKind::ConnectionRefused
                ) => {}
            Err(error) => return Err(error),
        }
        emulator.poll(clock.now(), &mut answers);
        for answer in answers.drain(..) {
            if let Some(peer) = peer {
                // Whoever asked may be gone.
                let _ = socket.send_to(&answer, peer);
            }
        }
    }
    Ok(())
}
