//! Why an array could not be opened: the place in the configuration, the cause and the remedy.

use std::io;

use taktil_hal::OpenError;

use crate::board::StartError;
use crate::config::{BoardKind, Config};

/// The port was refused by the system.
pub(crate) fn port(config: &Config, error: &serialport::Error) -> OpenError {
    let text = error.description.as_str();
    let busy = [io::Error::from_raw_os_error(libc::EBUSY), again()]
        .iter()
        .any(|known| known.to_string().starts_with(text) || text.contains("exclusive lock"));
    let (what, remedy) = match error.kind() {
        serialport::ErrorKind::Io(io::ErrorKind::PermissionDenied) => (
            "may not be read and written by this user".to_owned(),
            "add the user to the group dialout, or install the udev rules of this driver",
        ),
        _ if !std::path::Path::new(&config.path).exists() => (
            "does not exist".to_owned(),
            "plug the board in, or correct `path`; names are listed in /dev/serial/by-id",
        ),
        _ if busy => (
            "is in use by another process".to_owned(),
            "end that process, or give it another board",
        ),
        _ => (format!("cannot be opened as a serial port ({text})"), "name a serial port"),
    };
    OpenError::device(&config.path, "path", what, remedy)
}

/// The board did not start.
pub(crate) fn start(config: &Config, error: StartError) -> OpenError {
    let (rows, cols) = (config.rows, config.cols);
    let (place, what, remedy) = match error {
        StartError::NoAnswer(request) => (
            "board",
            format!("{} gives no answer to `{request}`", name(config.board)),
            "check power, cable, `board` and `baud`".to_owned(),
        ),
        StartError::NotSilent => (
            "board",
            "does not stop to send although it was told to".to_owned(),
            "another board or program is on the line: check `board` and `path`".to_owned(),
        ),
        StartError::Refused(request, status) => (
            "board",
            format!("{} refuses `{request}` with status {status}", name(config.board)),
            "look the status up in the board's list, and check `rate_hz`".to_owned(),
        ),
        StartError::Size { rows: found_rows, cols: found_cols } => (
            "rows",
            format!("has {found_rows} x {found_cols} tactels, {rows} x {cols} are configured"),
            format!("set rows = {found_rows} and cols = {found_cols}"),
        ),
        StartError::FullScale(found) => (
            "full_scale",
            format!("has the full scale {found}"),
            format!("set full_scale = {found}"),
        ),
        StartError::NoSensor => (
            "sensor",
            "has no logical sensor with 512 bytes of data there".to_owned(),
            "check `sensor`, and that this is a Myrmex v2".to_owned(),
        ),
        StartError::NoMatrix => (
            "sensor",
            format!("has no matrix {}", config.sensor),
            "give a smaller `sensor`; matrices count from 0".to_owned(),
        ),
        StartError::Text => (
            "board",
            "sends text: this is the diagnostic firmware".to_owned(),
            "load the binary firmware of FlexiTac".to_owned(),
        ),
        StartError::HeaderDistance(bytes) => (
            "rows",
            format!(
                "sends headers every {bytes} bytes, which is {} tactels, not {rows} x {cols}",
                bytes.saturating_sub(2)
            ),
            "set `rows` and `cols` to the size of the board".to_owned(),
        ),
        StartError::Foreign => (
            "board",
            format!("sends what is not {}", name(config.board)),
            "check `board` and `baud`".to_owned(),
        ),
    };
    OpenError::device(&config.path, place, what, remedy)
}

fn again() -> io::Error {
    io::Error::from_raw_os_error(libc::EAGAIN)
}

fn name(board: BoardKind) -> &'static str {
    match board {
        BoardKind::Myrmex => "Myrmex v2",
        BoardKind::Flexitac => "FlexiTac",
        BoardKind::WeissWts => "Weiss WTS",
        BoardKind::WeissDsa => "Weiss DSA",
    }
}
