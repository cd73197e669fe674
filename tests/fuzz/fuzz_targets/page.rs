//! Whatever a browser or anybody else says to the server of the page: the head of a request, which
//! is served only under this server's name, or a message over the WebSocket, which is understood or
//! refused with a reason; never a panic. The first byte says which it is.
#![no_main]

use libfuzzer_sys::fuzz_target;
use taktil_machine_page::{AllowedHosts, PageMessage, Route, read_message, route};
use tungstenite::protocol::{Role, WebSocketConfig};
use tungstenite::{Message, WebSocket};

/// Bytes that come and an end that takes whatever is said.
struct Wire<'a>(&'a [u8]);

impl std::io::Read for Wire<'_> {
    fn read(&mut self, into: &mut [u8]) -> std::io::Result<usize> {
        self.0.read(into)
    }
}

impl std::io::Write for Wire<'_> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

fn head(bytes: &[u8]) {
    let hosts = AllowedHosts::new("127.0.0.1:8260".parse().unwrap());
    let text = String::from_utf8_lossy(bytes).to_ascii_lowercase();
    match route(bytes, &hosts) {
        Ok(answer) => {
            assert!(text.contains("127.0.0.1:8260") || text.contains("localhost:8260"));
            if matches!(answer, Route::Socket { .. }) {
                assert!(text.contains("http://") && text.contains("taktil.page.v1"));
            }
        }
        Err(bad) => assert!((400..600).contains(&bad.status) && !bad.text.is_empty()),
    }
}

fn message(text: &str) {
    match read_message(text) {
        Ok(PageMessage::Say { words, .. }) => {
            assert!(words.len() <= 1024 && !words.contains(['\n', '\r']));
        }
        Ok(PageMessage::Trace { paths, .. }) => {
            assert!(paths.len() <= 12 && paths.iter().all(|path| !path.contains(' ')));
        }
        Ok(_) => {}
        Err(why) => assert!(!why.is_empty()),
    }
}

fn frames(bytes: &[u8]) {
    let limit = Some(1 << 16);
    let config = WebSocketConfig::default().max_message_size(limit).max_frame_size(limit);
    let mut socket = WebSocket::from_raw_socket(Wire(bytes), Role::Server, Some(config));
    while let Ok(read) = socket.read() {
        if let Message::Text(text) = read {
            assert!(text.len() <= 1 << 16);
            message(&text);
        }
    }
}

fuzz_target!(|bytes: &[u8]| {
    let Some((kind, rest)) = bytes.split_first() else { return };
    match kind % 3 {
        0 => head(rest),
        1 => message(&String::from_utf8_lossy(rest)),
        _ => frames(rest),
    }
});
