//! A connection from its first byte: a request's head, an answer, then the end or a WebSocket. Each
//! stage has a time after which the connection is over, whatever the other side does or does not.

use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, TcpStream};

use taktil_rtcore::Nanos;

use crate::assets::Asset;
use crate::hosts::AllowedHosts;
use crate::request_head::{Peer, Refusal, Route, route};

/// Longest head of a request (bytes).
const HEAD_BYTES_MAX: usize = 8192;
/// How long the head of a request may take.
const HEAD_TIME_MAX: Nanos = Nanos::from_secs(5);
/// How long an answer may take to be read.
const ANSWER_TIME_MAX: Nanos = Nanos::from_secs(10);
/// How long the other side may take to close after its answer.
const CLOSE_TIME_MAX: Nanos = Nanos::from_secs(1);

/// What a connection is doing.
#[derive(Debug, PartialEq, Eq)]
enum Stage {
    /// The head of its request comes in.
    Head,
    /// Its answer goes out; a WebSocket follows one that upgrades.
    Answer { upgrade: Option<Peer> },
    /// Its answer is out, and the other side has to close.
    Closing,
    /// It is a WebSocket from now on.
    Upgraded(Peer),
    /// It is over.
    Over,
}

/// A connection that is no page yet.
#[derive(Debug)]
pub(crate) struct Connection {
    stream: TcpStream,
    input: Vec<u8>,
    output: Vec<u8>,
    written: usize,
    stage: Stage,
    until: Nanos,
}

impl Connection {
    /// A connection that has just been accepted, whose stream does not block.
    pub(crate) fn new(stream: TcpStream, now: Nanos) -> Connection {
        let (input, output) = (Vec::new(), Vec::new());
        let (stage, until) = (Stage::Head, now + HEAD_TIME_MAX);
        Connection { stream, input, output, written: 0, stage, until }
    }

    pub(crate) fn stream(&self) -> &TcpStream {
        &self.stream
    }

    pub(crate) fn wants_output(&self) -> bool {
        matches!(self.stage, Stage::Answer { .. })
    }

    pub(crate) fn is_over(&self) -> bool {
        self.stage == Stage::Over
    }

    /// Who speaks over it, once it is a WebSocket.
    pub(crate) fn peer(&self) -> Option<Peer> {
        match self.stage {
            Stage::Upgraded(peer) => Some(peer),
            _ => None,
        }
    }

    /// The stream and what has come behind the head.
    pub(crate) fn into_parts(self) -> (TcpStream, Vec<u8>) {
        (self.stream, self.input)
    }

    /// Does what can be done now. `has_room` says whether one more page is served.
    pub(crate) fn turn(&mut self, hosts: &AllowedHosts, has_room: bool, now: Nanos) {
        if now > self.until && self.peer().is_none() {
            self.stage = Stage::Over;
        }
        if self.stage == Stage::Head {
            self.read_head(hosts, has_room, now);
        }
        if let Stage::Answer { upgrade } = self.stage {
            self.write_answer(upgrade, now);
        }
        if self.stage == Stage::Closing {
            let mut bytes = [0; 1024];
            match self.stream.read(&mut bytes) {
                Ok(0) => self.stage = Stage::Over,
                Err(error) if !is_later(error.kind()) => self.stage = Stage::Over,
                // What is said behind an answer is not listened to.
                _ => {}
            }
        }
    }

    fn read_head(&mut self, hosts: &AllowedHosts, has_room: bool, now: Nanos) {
        let mut bytes = [0; 2048];
        match self.stream.read(&mut bytes) {
            Ok(0) => return self.stage = Stage::Over,
            Ok(count) => self.input.extend_from_slice(&bytes[..count]),
            Err(error) if is_later(error.kind()) => return,
            Err(_) => return self.stage = Stage::Over,
        }
        let end = self.input.windows(4).position(|four| four == b"\r\n\r\n").map(|at| at + 4);
        let decided = match end {
            Some(end) if end <= HEAD_BYTES_MAX => {
                let decided = route(&self.input[..end], hosts);
                self.input.drain(..end);
                decided
            }
            None if self.input.len() <= HEAD_BYTES_MAX => return,
            _ => Err(Refusal { status: 431, text: "the request is too long" }),
        };
        let full = Refusal { status: 503, text: "too many pages are open; close one" };
        let (output, upgrade) = match decided {
            Ok(Route::File(asset)) => (file(asset), None),
            Ok(Route::Socket { .. }) if !has_room => (refusal(&full), None),
            Ok(Route::Socket { peer, subprotocol, accept }) => {
                (switch_protocol(subprotocol, &accept), Some(peer))
            }
            Err(bad) => (refusal(&bad), None),
        };
        (self.output, self.stage) = (output, Stage::Answer { upgrade });
        self.until = now + ANSWER_TIME_MAX;
    }

    fn write_answer(&mut self, upgrade: Option<Peer>, now: Nanos) {
        while self.written < self.output.len() {
            match self.stream.write(&self.output[self.written..]) {
                Ok(0) => return self.stage = Stage::Over,
                Ok(count) => self.written += count,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) if error.kind() == ErrorKind::WouldBlock => return,
                Err(_) => return self.stage = Stage::Over,
            }
        }
        if let Some(peer) = upgrade {
            return self.stage = Stage::Upgraded(peer);
        }
        // Closing with bytes unread would take the answer away from the other side.
        self.stage = match self.stream.shutdown(Shutdown::Write) {
            Ok(()) => Stage::Closing,
            Err(_) => Stage::Over,
        };
        self.until = now + CLOSE_TIME_MAX;
    }
}

fn is_later(kind: ErrorKind) -> bool {
    [ErrorKind::WouldBlock, ErrorKind::Interrupted].contains(&kind)
}

/// What every answer says: the page may load nothing from elsewhere, nobody may put it into a
/// frame, and nothing is kept.
const COMMON_HEADERS: &str = "Connection: close\r\nCache-Control: no-store\r\n\
    X-Content-Type-Options: nosniff\r\nReferrer-Policy: no-referrer\r\n\
    Cross-Origin-Opener-Policy: same-origin\r\nCross-Origin-Resource-Policy: same-origin\r\n\
    Content-Security-Policy: default-src 'none'; script-src 'self'; style-src 'self'; \
    connect-src 'self'; img-src data:; base-uri 'none'; form-action 'none'; \
    frame-ancestors 'none'\r\n";

fn file(asset: &Asset) -> Vec<u8> {
    let (kind, length) = (asset.kind, asset.text.len());
    let head = format!("Content-Type: {kind}\r\nContent-Length: {length}\r\n");
    format!("HTTP/1.1 200 OK\r\n{head}{COMMON_HEADERS}\r\n{}", asset.text).into_bytes()
}

fn refusal(bad: &Refusal) -> Vec<u8> {
    let reason = match bad.status {
        403 => "Forbidden",
        404 => "Not Found",
        405 => "Method Not Allowed",
        426 => "Upgrade Required",
        431 => "Request Header Fields Too Large",
        503 => "Service Unavailable",
        _ => "Bad Request",
    };
    let body = format!("{}\n", bad.text);
    let kind = "text/plain; charset=utf-8";
    let head = format!("Content-Type: {kind}\r\nContent-Length: {}\r\n", body.len());
    format!("HTTP/1.1 {} {reason}\r\n{head}{COMMON_HEADERS}\r\n{body}", bad.status).into_bytes()
}

fn switch_protocol(subprotocol: &str, accept: &str) -> Vec<u8> {
    let head = "Upgrade: websocket\r\nConnection: Upgrade\r\n";
    let language = format!("Sec-WebSocket-Protocol: {subprotocol}\r\n");
    format!(
        "HTTP/1.1 101 Switching Protocols\r\n{head}{language}Sec-WebSocket-Accept: {accept}\r\n\r\n"
    )
    .into_bytes()
}
