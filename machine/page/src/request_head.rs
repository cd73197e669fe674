//! The head of an HTTP request, and what it is answered with: one of the page's files, the
//! WebSocket, or a refusal. Only GET of names in a table is served, so that no path can lead
//! anywhere else, and nothing of a request is repeated in an answer.

use tungstenite::handshake::derive_accept_key;

use crate::assets::{ASSETS, Asset};
#[cfg(feature = "foxglove")]
use crate::foxglove::{LAYOUT, VIEWER_PATH, VIEWER_SUBPROTOCOLS};
use crate::hosts::AllowedHosts;

/// Headers that a request may have.
const HEADERS_MAX: usize = 64;
/// Characters of a WebSocket's key: sixteen bytes in base 64.
const KEY_CHARACTERS: usize = 24;
/// The path of the WebSocket.
pub(crate) const SOCKET_PATH: &str = "/machine";
/// The language that is spoken over it.
pub(crate) const SUBPROTOCOL: &str = "taktil.page.v1";

/// What a request is answered with.
#[derive(Clone, Debug, PartialEq)]
pub enum Route {
    /// A file of the page.
    File(&'static Asset),
    /// A WebSocket, with the answer to its key.
    Socket {
        /// Who speaks over it.
        peer: Peer,
        /// The language that is spoken over it.
        subprotocol: &'static str,
        /// The value of `Sec-WebSocket-Accept`.
        accept: String,
    },
}

/// Who is at the other end of a WebSocket.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Peer {
    /// The operator's page.
    Page,
    /// A common viewer, which watches.
    Viewer,
}

/// Why a request is not served.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Refusal {
    /// HTTP status.
    pub status: u16,
    /// A sentence for people.
    pub text: &'static str,
}

fn refuse<T>(status: u16, text: &'static str) -> Result<T, Refusal> {
    Err(Refusal { status, text })
}

/// The only value of a header; `None` where there is none.
fn single<'a>(headers: &[httparse::Header<'a>], name: &str) -> Result<Option<&'a str>, Refusal> {
    let mut found = headers.iter().filter(|header| header.name.eq_ignore_ascii_case(name));
    let Some(first) = found.next() else { return Ok(None) };
    if found.next().is_some() {
        return refuse(400, "a header stands twice");
    }
    match std::str::from_utf8(first.value) {
        Ok(value) => Ok(Some(value.trim())),
        Err(_) => refuse(400, "a header is no text"),
    }
}

fn has_word(list: Option<&str>, word: &str) -> bool {
    list.is_some_and(|list| list.split(',').any(|one| one.trim().eq_ignore_ascii_case(word)))
}

/// Reads a whole head, up to and with its empty line, and decides.
///
/// # Errors
/// The status and a sentence with which the request is refused.
pub fn route(head: &[u8], hosts: &AllowedHosts) -> Result<Route, Refusal> {
    let mut headers = [httparse::EMPTY_HEADER; HEADERS_MAX];
    let mut request = httparse::Request::new(&mut headers);
    match request.parse(head) {
        Ok(httparse::Status::Complete(_)) => {}
        Ok(httparse::Status::Partial) => return refuse(400, "the request has no end"),
        Err(_) => return refuse(400, "this is no HTTP request"),
    }
    let (method, path) = (request.method.unwrap_or(""), request.path.unwrap_or(""));
    let headers = &*request.headers;
    match single(headers, "host")? {
        Some(host) if hosts.allows_host(host) => {}
        _ => return refuse(403, "this server has another name; open the address that it printed"),
    }
    if method != "GET" {
        return refuse(405, "only GET is served");
    }
    let has_body = single(headers, "content-length")?.is_some_and(|length| length != "0")
        || single(headers, "transfer-encoding")?.is_some();
    if has_body {
        return refuse(400, "a request with a body is not served");
    }
    if path == SOCKET_PATH {
        return page_socket(headers, hosts);
    }
    #[cfg(feature = "foxglove")]
    if hosts.has_viewers() {
        match path {
            VIEWER_PATH => return viewer_socket(headers, hosts),
            path if path == LAYOUT.path => return Ok(Route::File(&LAYOUT)),
            _ => {}
        }
    }
    match ASSETS.iter().find(|asset| asset.path == path) {
        Some(asset) => Ok(Route::File(asset)),
        None => refuse(404, "there is no such page"),
    }
}

fn page_socket(headers: &[httparse::Header<'_>], hosts: &AllowedHosts) -> Result<Route, Refusal> {
    match single(headers, "origin")? {
        Some(origin) if hosts.allows_origin(origin) => {}
        _ => return refuse(403, "only this server's own page may speak to the machine"),
    }
    let offered = single(headers, "sec-websocket-protocol")?;
    let accept = accept_key(headers)?;
    match has_word(offered, SUBPROTOCOL) {
        true => Ok(Route::Socket { peer: Peer::Page, subprotocol: SUBPROTOCOL, accept }),
        false => refuse(400, "the subprotocol is unknown; it is taktil.page.v1"),
    }
}

/// The WebSocket for viewers.
#[cfg(feature = "foxglove")]
fn viewer_socket(headers: &[httparse::Header<'_>], hosts: &AllowedHosts) -> Result<Route, Refusal> {
    if !hosts.allows_viewer(single(headers, "origin")?) {
        return refuse(403, "this viewer's origin is not served; name it with --foxglove-origin");
    }
    let offered = single(headers, "sec-websocket-protocol")?;
    let accept = accept_key(headers)?;
    match VIEWER_SUBPROTOCOLS.into_iter().find(|known| has_word(offered, known)) {
        Some(subprotocol) => Ok(Route::Socket { peer: Peer::Viewer, subprotocol, accept }),
        None => refuse(400, "the subprotocol is unknown; it is foxglove.websocket.v1"),
    }
}

/// The answer to the key of a WebSocket.
fn accept_key(headers: &[httparse::Header<'_>]) -> Result<String, Refusal> {
    let is_upgrade = has_word(single(headers, "upgrade")?, "websocket")
        && has_word(single(headers, "connection")?, "upgrade");
    if !is_upgrade {
        return refuse(426, "a WebSocket stands here");
    }
    if single(headers, "sec-websocket-version")? != Some("13") {
        return refuse(426, "version 13 of the WebSocket protocol is spoken here");
    }
    match single(headers, "sec-websocket-key")? {
        Some(key) if key.len() == KEY_CHARACTERS && key.is_ascii() => {
            Ok(derive_accept_key(key.as_bytes()))
        }
        _ => refuse(400, "the WebSocket has no key"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hosts() -> AllowedHosts {
        AllowedHosts::new("127.0.0.1:8260".parse().unwrap())
    }

    fn answer(head: &str) -> Result<Route, u16> {
        route(head.replace('\n', "\r\n").as_bytes(), &hosts()).map_err(|bad| bad.status)
    }

    const SOCKET: &str = "GET /machine HTTP/1.1\nHost: 127.0.0.1:8260\nOrigin: \
        http://127.0.0.1:8260\nUpgrade: websocket\nConnection: keep-alive, Upgrade\n\
        Sec-WebSocket-Version: 13\nSec-WebSocket-Protocol: taktil.page.v1\n\
        Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\n\n";

    #[test]
    fn the_page_and_its_socket_are_found_under_their_names() {
        let Ok(Route::File(asset)) = answer("GET / HTTP/1.1\nHost: localhost:8260\n\n") else {
            panic!("no page")
        };
        assert!(asset.text.contains("<html"));
        // The key and its answer are the example of RFC 6455, section 1.3.
        let accept = "s3pPLMBiTxaQ9kYGzzhZRbK+xOo=".to_owned();
        let (peer, subprotocol) = (Peer::Page, SUBPROTOCOL);
        assert_eq!(answer(SOCKET), Ok(Route::Socket { peer, subprotocol, accept }));
    }

    #[test]
    fn foreign_names_and_pages_are_refused_before_anything_else() {
        for (from, to, status) in [
            ("Host: 127.0.0.1:8260", "Host: evil.test", 403),
            ("Host: 127.0.0.1:8260", "Host: evil.test:8260", 403),
            ("Host: 127.0.0.1:8260\n", "", 403),
            ("Host: 127.0.0.1:8260", "Host: 127.0.0.1:8260\nHost: evil.test", 400),
            ("Origin: http://127.0.0.1:8260", "Origin: http://evil.test", 403),
            ("Origin: http://127.0.0.1:8260", "Origin: null", 403),
            ("Origin: http://127.0.0.1:8260\n", "", 403),
            ("taktil.page.v1", "chat", 400),
            ("Sec-WebSocket-Protocol: taktil.page.v1\n", "", 400),
            ("Version: 13", "Version: 8", 426),
            ("Upgrade: websocket\n", "", 426),
            ("dGhlIHNhbXBsZSBub25jZQ==", "short", 400),
            ("GET", "POST", 405),
            ("\n\n", "\nContent-Length: 5\n\n", 400),
            ("\n\n", "\nTransfer-Encoding: chunked\n\n", 400),
        ] {
            assert!(SOCKET.contains(from), "{from}");
            assert_eq!(answer(&SOCKET.replacen(from, to, 1)), Err(status), "{from} -> {to}");
        }
    }

    #[test]
    fn no_path_leads_to_a_file_of_the_host() {
        for path in [
            "/../../etc/passwd",
            "/..%2f..%2fetc/passwd",
            "//etc/passwd",
            "/page.css/../../x",
            "/page.css?x",
            "/?token=1",
            "/assets/page.css",
            "*",
            "http://127.0.0.1:8260/",
        ] {
            let head = format!("GET {path} HTTP/1.1\nHost: 127.0.0.1:8260\n\n");
            assert_eq!(answer(&head), Err(404), "{path}");
        }
        assert_eq!(answer("hello\n\n"), Err(400));
        assert_eq!(answer("GET / HTTP/1.1\nHost: 127.0.0.1:8260\n"), Err(400));
    }
}
