//! The operator's page: a server for browsers that is an ordinary client of the operator's socket.
//! It hands out one page that needs no other host, and joins each browser's WebSocket to the
//! machine. It runs in one thread that never waits for anybody, in a process of its own
//! (`taktil-dashboard`) or beside a simulated run (`taktil run --page`), and imports neither the
//! machine nor its tasks.
//!
//! What everybody may see is asked of the machine once, however many pages look: the newest values
//! replace older ones that a slow page has not taken. Commands go over a connection of each page's
//! own, so that the machine's control lease tells pages apart. A stop is heard from every page.
//!
//! Who may do what, the messages and all limits are described in `docs/guides/page.md`.

mod assets;
mod connection;
mod feed;
#[cfg(feature = "foxglove")]
mod foxglove;
mod hold;
mod hosts;
mod message;
mod page;
pub mod process;
mod request_head;
mod server;
mod token;

pub use assets::Asset;
pub use hosts::AllowedHosts;
pub use message::{PageMessage, read_message};
pub use request_head::{Peer, Refusal, Route, route};
pub use token::{ControlToken, TokenSource};

use std::io::{Error, Read};
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::thread::JoinHandle;
use std::time::Duration;

use server::Server;
use taktil_rtcore::Invalid;

/// Port that is tried first where none is named.
pub const PREFERRED_PORT: u16 = 8260;

/// Where a page is served, for which machine, and who may command.
#[derive(Clone, Debug)]
pub struct PageConfig {
    /// The operator's socket of the machine.
    pub socket: PathBuf,
    /// Address to listen at. Anything but the loopback needs a token file that exists.
    pub address: IpAddr,
    /// Port; where none is named the preferred one, or any that is free.
    pub port: Option<u16>,
    /// File with the control token; where none is named it is made at start.
    pub token_file: Option<PathBuf>,
    /// Whether common viewers are served too, and from which origins beside programs.
    #[cfg(feature = "foxglove")]
    pub viewer_origins: Option<Vec<String>>,
}

impl PageConfig {
    /// A page for the machine behind `socket`, on the loopback.
    #[must_use]
    pub fn for_socket(socket: &Path) -> PageConfig {
        let address = IpAddr::V4(Ipv4Addr::LOCALHOST);
        PageConfig {
            socket: socket.to_owned(),
            address,
            port: None,
            token_file: None,
            #[cfg(feature = "foxglove")]
            viewer_origins: None,
        }
    }
}

/// A server of pages in its thread. Dropping it ends the server and removes the token that it made.
#[derive(Debug)]
pub struct PageServer {
    address: SocketAddr,
    token_path: PathBuf,
    /// The other end closes when the server has seen its first page.
    arrival: UnixStream,
    ending: Option<UnixStream>,
    thread: Option<JoinHandle<()>>,
}

impl PageServer {
    /// Listens and serves from now on.
    ///
    /// # Errors
    /// An address that is not the loopback without a token file, an address that cannot be had, a
    /// token file that others may read; the place is the option at fault.
    pub fn start(config: &PageConfig) -> Result<PageServer, Invalid> {
        let needs_file = !config.address.is_loopback();
        if needs_file && config.token_file.is_none() {
            let what =
                format!("{} is not the loopback, and no token file is named", config.address);
            let remedy = "make a file with a long secret that only this user may read, and name it \
                          with --token-file; or stay on 127.0.0.1 and use `ssh -L`";
            return Err(Invalid::new("--listen", what, remedy));
        }
        let listener = listen(config)?;
        let address = listener.local_addr().map_err(|error| no_address(config, &error))?;
        let source = match &config.token_file {
            Some(path) => TokenSource::Existing(path.clone()),
            None => TokenSource::Made(token::default_path(address.port())),
        };
        let token = ControlToken::from_source(source)?;
        let token_path = token.path().to_owned();
        let no_thread = |error: Error| {
            Invalid::new("", format!("no thread for the page: {error}"), "raise the limits")
        };
        let (ending, ended) = UnixStream::pair().map_err(no_thread)?;
        let (arrival, arrived) = UnixStream::pair().map_err(no_thread)?;
        let hosts = AllowedHosts::new(address);
        #[cfg(feature = "foxglove")]
        let hosts = match &config.viewer_origins {
            Some(origins) => hosts.with_viewers(origins.clone()),
            None => hosts,
        };
        let socket = config.socket.clone();
        let thread = std::thread::Builder::new().name("page".into()).spawn(move || {
            Server::new(listener, hosts, token, socket, arrived).serve(&ended);
        });
        let thread = thread.map_err(no_thread)?;
        let (ending, thread) = (Some(ending), Some(thread));
        Ok(PageServer { address, token_path, arrival, ending, thread })
    }

    /// Where the page is.
    #[must_use]
    pub fn url(&self) -> String {
        format!("http://{}/", self.address)
    }

    /// Where viewers connect, if they are served.
    #[cfg(feature = "foxglove")]
    #[must_use]
    pub fn viewer_url(&self) -> String {
        format!("ws://{}{}", self.address, foxglove::VIEWER_PATH)
    }

    /// The file with the control token.
    #[must_use]
    pub fn token_path(&self) -> &Path {
        &self.token_path
    }

    /// Waits until a page has connected, at most for a time; true when one has.
    #[must_use]
    pub fn wait_for_page(&mut self, timeout: Duration) -> bool {
        // Without a time-out that the kernel accepts the read would wait for ever.
        if self.arrival.set_read_timeout(Some(timeout.max(Duration::from_millis(1)))).is_err() {
            return false;
        }
        self.arrival.read(&mut [0]).is_ok_and(|count| count == 0)
    }
}

impl Drop for PageServer {
    fn drop(&mut self) {
        drop(self.ending.take());
        if let Some(thread) = self.thread.take() {
            // It sees the end between two turns, none of which waits.
            let _ = thread.join();
        }
    }
}

fn listen(config: &PageConfig) -> Result<TcpListener, Invalid> {
    let at = |port: u16| TcpListener::bind(SocketAddr::new(config.address, port));
    let listener = match config.port {
        Some(port) => at(port),
        None => at(PREFERRED_PORT).or_else(|_| at(0)),
    };
    let listener = listener.and_then(|listener| {
        listener.set_nonblocking(true)?;
        Ok(listener)
    });
    listener.map_err(|error| no_address(config, &error))
}

fn no_address(config: &PageConfig, error: &Error) -> Invalid {
    let port = config.port.map(|port| format!(" port {port}")).unwrap_or_default();
    let what = format!("cannot listen at {}{port}: {error}", config.address);
    Invalid::new("--page", what, "name another port, or none")
}
