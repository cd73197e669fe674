//! The server's turns in its one thread: accept, read heads, hear pages, ask the machine, send what
//! is new. No turn waits for anybody, and the number of everything is bounded.

use std::collections::BTreeSet;
use std::net::TcpListener;
use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::path::PathBuf;

use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::socket::setsockopt;
use nix::sys::socket::sockopt::SndBuf;
use taktil_rtcore::{Nanos, linux};

use crate::connection::Connection;
use crate::feed::Feed;
#[cfg(feature = "foxglove")]
use crate::foxglove::{ViewSource, ViewerClient};
use crate::hosts::AllowedHosts;
use crate::page::{Page, Services};
use crate::request_head::Peer;
use crate::token::ControlToken;

/// Pages that are served at the same time, viewers among them.
const PAGES_MAX: usize = 16;
/// Connections that are no page yet; beyond these nobody is accepted.
const CONNECTIONS_MAX: usize = 32;
/// Pages with a connection of their own to the machine, which serves 16 clients in all.
const LINES_MAX: usize = 8;
/// Connections that are accepted in one turn.
const ACCEPTED_PER_TURN_MAX: usize = 8;
/// Bytes that the kernel keeps for a connection whose other side does not read.
const SEND_BUFFER_BYTES: usize = 1 << 16;
/// Longest wait for somebody to say something (ms), with pages and without.
const WAIT_WITH_PAGES_MS: i64 = 20;
const WAIT_ALONE_MS: i64 = 200;
/// Nanoseconds in a millisecond.
const NANOS_PER_MS: i64 = 1_000_000;

/// The server, in its thread.
pub(crate) struct Server {
    listener: TcpListener,
    hosts: AllowedHosts,
    token: ControlToken,
    path: PathBuf,
    feed: Feed,
    connections: Vec<Connection>,
    pages: Vec<Page>,
    #[cfg(feature = "foxglove")]
    viewers: Vec<ViewerClient>,
    #[cfg(feature = "foxglove")]
    source: ViewSource,
    next_number: u64,
    /// Closed when the first page has come.
    arrived: Option<UnixStream>,
}

impl Server {
    pub(crate) fn new(
        listener: TcpListener,
        hosts: AllowedHosts,
        token: ControlToken,
        path: PathBuf,
        arrived: UnixStream,
    ) -> Server {
        Server {
            listener,
            hosts,
            token,
            feed: Feed::new(path.clone()),
            path,
            connections: Vec::new(),
            pages: Vec::new(),
            #[cfg(feature = "foxglove")]
            viewers: Vec::new(),
            #[cfg(feature = "foxglove")]
            source: ViewSource::new(linux::wall_clock()),
            next_number: 0,
            arrived: Some(arrived),
        }
    }

    /// Serves until the other end of `ended` is closed.
    pub(crate) fn serve(&mut self, ended: &UnixStream) {
        loop {
            if self.wait(ended) {
                return;
            }
            self.turn(linux::monotonic());
        }
    }

    /// Waits until somebody says something, or until keys are to be repeated; true at the end.
    fn wait(&self, ended: &UnixStream) -> bool {
        let mut polled = vec![polled_end(ended, false)];
        if self.connections.len() < CONNECTIONS_MAX {
            polled.push(polled_end(&self.listener, false));
        }
        let connections = self.connections.iter();
        polled.extend(connections.map(|one| polled_end(one.stream(), one.wants_output())));
        let pages = self.pages.iter();
        polled.extend(pages.map(|page| polled_end(page.stream(), page.wants_output())));
        #[cfg(feature = "foxglove")]
        polled.extend(self.viewers.iter().map(|one| polled_end(one.stream(), one.wants_output())));
        let lines = self.pages.iter().filter_map(Page::line).chain(self.feed.socket());
        polled.extend(lines.map(|line| polled_end(line, line.wants_output())));
        let is_alone = self.watchers() == 0 && self.connections.is_empty();
        let longest = if is_alone { WAIT_ALONE_MS } else { WAIT_WITH_PAGES_MS };
        let now = linux::monotonic();
        let due = self.pages.iter().filter_map(Page::due).min();
        let due_ms = due.map_or(longest, |due| ((due - now).0 / NANOS_PER_MS).clamp(1, longest));
        // An interrupted wait is a short one.
        let _ = poll(&mut polled, PollTimeout::from(u16::try_from(due_ms).unwrap_or(1)));
        polled[0].revents().is_some_and(|events| !events.is_empty())
    }

    fn turn(&mut self, now: Nanos) {
        self.accept(now);
        self.advance_connections(now);
        self.hear_pages(now);
        #[cfg(feature = "foxglove")]
        for viewer in &mut self.viewers {
            viewer.hear(&self.source, now);
        }
        self.feed.set_wanted(self.wanted());
        for stop in self.feed.turn(now) {
            if let Some(page) = self.pages.iter_mut().find(|page| page.number == stop.page) {
                page.push_answer(stop.text);
            }
        }
        for page in &mut self.pages {
            page.send(&self.feed, now);
        }
        self.pages.retain(|page| !page.is_over());
        #[cfg(feature = "foxglove")]
        self.serve_viewers(now);
    }

    /// Pages and viewers that are connected.
    fn watchers(&self) -> usize {
        #[cfg(feature = "foxglove")]
        return self.pages.len() + self.viewers.len();
        #[cfg(not(feature = "foxglove"))]
        return self.pages.len();
    }

    /// What pages and viewers want beyond the usual.
    fn wanted(&self) -> BTreeSet<String> {
        let wanted = self.pages.iter().flat_map(|page| page.wanted.iter().cloned());
        #[cfg(feature = "foxglove")]
        let wanted = wanted.chain(self.viewers.iter().flat_map(|one| one.wanted(&self.source)));
        wanted.collect()
    }

    #[cfg(feature = "foxglove")]
    fn serve_viewers(&mut self, now: Nanos) {
        if self.viewers.is_empty() {
            return;
        }
        self.source.update(&self.feed, linux::wall_clock());
        for viewer in &mut self.viewers {
            viewer.send(&self.feed, &mut self.source, now);
        }
        self.viewers.retain(|viewer| !viewer.is_over());
    }

    fn accept(&mut self, now: Nanos) {
        for _ in 0..ACCEPTED_PER_TURN_MAX {
            if self.connections.len() >= CONNECTIONS_MAX {
                return;
            }
            let Ok((stream, _)) = self.listener.accept() else { return };
            if stream.set_nonblocking(true).is_ok() && stream.set_nodelay(true).is_ok() {
                // Without it more old values wait in the kernel, which a page has to confirm.
                let _ = setsockopt(&stream, SndBuf, &SEND_BUFFER_BYTES);
                self.connections.push(Connection::new(stream, now));
            }
        }
    }

    fn advance_connections(&mut self, now: Nanos) {
        for mut connection in std::mem::take(&mut self.connections) {
            let has_room = self.watchers() < PAGES_MAX;
            connection.turn(&self.hosts, has_room, now);
            match connection.peer() {
                Some(Peer::Page) => {
                    let (stream, early) = connection.into_parts();
                    self.next_number += 1;
                    self.pages.push(Page::new(self.next_number, stream, early, now));
                    drop(self.arrived.take());
                }
                #[cfg(feature = "foxglove")]
                Some(Peer::Viewer) => {
                    let (stream, early) = connection.into_parts();
                    self.viewers.push(ViewerClient::new(stream, early, now));
                }
                #[cfg(not(feature = "foxglove"))]
                Some(Peer::Viewer) => {}
                None if connection.is_over() => {}
                None => self.connections.push(connection),
            }
        }
    }

    fn hear_pages(&mut self, now: Nanos) {
        let mut lines = self.pages.iter().filter(|page| page.has_line()).count();
        for page in &mut self.pages {
            let had_line = page.has_line();
            let mut services = Services {
                feed: &mut self.feed,
                token: &self.token,
                path: &self.path,
                has_free_line: lines < LINES_MAX,
            };
            page.hear(&mut services, now);
            let may_have_set = page.serve(now);
            if may_have_set {
                self.feed.refresh_parameters();
            }
            lines += usize::from(page.has_line() && !had_line);
        }
    }
}

/// What is waited for at one end.
fn polled_end(end: &impl AsFd, wants_output: bool) -> PollFd<'_> {
    let mut flags = PollFlags::POLLIN;
    flags.set(PollFlags::POLLOUT, wants_output);
    PollFd::new(end.as_fd(), flags)
}
