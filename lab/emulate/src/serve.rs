//! Serves an emulated robot on sockets and pseudo-terminals, in the time of a clock and in one
//! thread: it waits for the boards' hosts and for the next step of the world, whichever comes
//! first.

use std::io::ErrorKind;
use std::net::{SocketAddr, UdpSocket};
use std::os::fd::AsFd;
use std::os::unix::net::{SocketAddr as UnixAddress, UnixDatagram};
use std::path::{Path, PathBuf};
use std::thread::JoinHandle;

use anyhow::Context;
use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, ppoll};
use nix::sys::time::{TimeSpec, TimeValLike};
use taktil_drivers_can_emulator::InterfaceSocket;
use taktil_drivers_ethercat_emulator::RawSocket;
use taktil_drivers_regmap_emulator::serve;
use taktil_drivers_serial_emulator::Terminal;
use taktil_hal::link::{Sender, link};
use taktil_hal::{Clock, Nanos};
use taktil_machine_console::option::BadOption;
use taktil_rtcore::linux::{self, MonotonicClock};

use crate::pace::{Lateness, Pace, STEP_TIME};
use crate::robot::EmulatedRobot;

/// From one look of a board of registers at its file to the next, where the driver never waits for
/// a bit of it. A board that publishes numbers more often is seldom read between two of them.
const LOOK_PERIOD: Nanos = Nanos::from_micros(200);
/// Priority of the thread of a board of registers: above every lane, because a driver that meets
/// the board between two numbers of a block reads again, and a board that a lane has interrupted
/// there never ends its block.
const REGISTERS_PRIORITY: u8 = 95;
/// Where a board on UDP is unless somebody says otherwise: a port that is free.
const ANY_ADDRESS: &str = "127.0.0.1:0";
/// Room for a datagram, and for what a host says on a serial line at once.
const BUFFER_BYTES: usize = 2_048;
/// Datagrams, or reads of a line, that are taken from a board before the others are served.
const READS_A_TURN_MAX: usize = 64;

/// Where the boards are to be found.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Places {
    /// Addresses and ports of the boards on UDP, in their order, such as `127.0.0.1:27181`; with
    /// port 0, and for a board without one, the system takes a port that is free.
    pub addresses: Vec<String>,
    /// The network interface of a segment, such as one end of a veth pair.
    pub interface: Option<String>,
    /// Names of symbolic links to the pseudo-terminals, of files of registers, and of the socket
    /// or the interface of a CAN bus, in the order of the boards; a board without one has the
    /// pseudo-terminal's own name, a file in `/dev/shm`, or a socket there.
    pub links: Vec<PathBuf>,
}

/// Where one board is.
enum Endpoint {
    Socket {
        socket: UdpSocket,
        /// Who asked last.
        peer: Option<SocketAddr>,
    },
    Line {
        /// Absent while the cable is pulled.
        terminal: Option<Terminal>,
        link: Option<PathBuf>,
    },
    /// Frames on a network interface.
    Segment { socket: RawSocket, name: String },
    /// Registers in a file that goes when the server does.
    File(OwnPath),
    /// A CAN bus behind a socket of Unix that goes when the server does.
    Bus {
        socket: UnixDatagram,
        /// Who spoke last.
        peer: Option<UnixAddress>,
        path: OwnPath,
    },
    /// A CAN bus that is an interface of the kernel's.
    Interface { socket: InterfaceSocket, name: String },
}

/// The file or socket of a board.
struct OwnPath(PathBuf);

impl Drop for OwnPath {
    fn drop(&mut self) {
        // Somebody may have taken it away.
        let _ = std::fs::remove_file(&self.0);
    }
}

/// A board of registers that runs in a thread of its own.
struct BoardThread {
    stop: Sender<()>,
    handle: JoinHandle<std::io::Result<()>>,
}

/// A clock that shows the boards' time.
struct BoardClock {
    clock: MonotonicClock,
    zero: Nanos,
}

impl Clock for BoardClock {
    fn now(&self) -> Nanos {
        self.clock.now() - self.zero
    }

    fn sleep_until(&self, instant: Nanos) {
        self.clock.sleep_until(instant + self.zero);
    }
}

/// An emulated robot on sockets and pseudo-terminals.
pub struct Server {
    robot: EmulatedRobot,
    endpoints: Vec<Endpoint>,
    starts_on_request: bool,
    priority: Option<u8>,
}

impl Server {
    /// Opens a socket for each board on UDP and for a CAN bus, a raw socket for a segment, a
    /// pseudo-terminal for each serial
    /// board and a file for a board of registers.
    ///
    /// # Errors
    /// [`BadOption`] for an address that is no address or taken, a link that cannot be made, or
    /// more addresses or links than such boards.
    pub fn open(mut robot: EmulatedRobot, places: &Places) -> anyhow::Result<Server> {
        let mut links = places.links.iter().cloned();
        let mut addresses = places.addresses.iter();
        let mut endpoints = Vec::new();
        for board in 0..robot.board_count() {
            endpoints.push(if robot.is_card(board) {
                let address = addresses.next().map_or(ANY_ADDRESS, String::as_str);
                Endpoint::Socket { socket: bound(address)?, peer: None }
            } else if robot.is_bus(board) {
                let link = links.next();
                bus(link.unwrap_or_else(|| shared_file(robot.name(board))))?
            } else if robot.is_segment(board) {
                raw_socket(places.interface.as_deref())?
            } else if robot.is_memory(board) {
                let path = links.next().unwrap_or_else(|| shared_file(robot.name(board)));
                if path.exists() {
                    let text = format!("--link {}: there is such a file", path.display());
                    return Err(BadOption(format!("{text}; name one that is not there")).into());
                }
                robot.attach_file(board, &path)?;
                Endpoint::File(OwnPath(path))
            } else {
                let link = links.next();
                Endpoint::Line { terminal: Some(terminal(link.as_deref())?), link }
            });
        }
        if let Some(address) = addresses.next() {
            let text = format!("--address {address}: no board is left for it");
            return Err(BadOption(format!("{text}; give one for each at most")).into());
        }
        if let Some(link) = links.next() {
            let text = format!("--link {}: no board is left for it", link.display());
            return Err(BadOption(format!("{text}; give one for each at most")).into());
        }
        Ok(Server { robot, endpoints, starts_on_request: false, priority: None })
    }

    /// The same server, whose world stands still until a host has sent something.
    #[must_use]
    pub fn starting_on_request(mut self) -> Server {
        self.robot = self.robot.with_waiting_world();
        self.starts_on_request = true;
        self
    }

    /// The same server at a priority of `SCHED_FIFO`, 1 to 99. The thread of a board of registers
    /// then has 95, above that of any lane; that of a board with busy bits never sleeps and stays
    /// at ordinary priority.
    #[must_use]
    pub fn with_priority(mut self, priority: Option<u8>) -> Server {
        self.priority = priority;
        self
    }

    /// The robot and its boards.
    #[must_use]
    pub fn robot(&self) -> &EmulatedRobot {
        &self.robot
    }

    /// Where a host finds a board: address and port, or a path.
    ///
    /// # Errors
    /// The system does not tell the address.
    pub fn place(&self, board: usize) -> anyhow::Result<String> {
        Ok(match self.endpoints.get(board) {
            Some(Endpoint::Socket { socket, .. }) => socket.local_addr()?.to_string(),
            Some(Endpoint::Line { terminal: Some(terminal), .. }) => {
                terminal.path().display().to_string()
            }
            Some(Endpoint::File(path) | Endpoint::Bus { path, .. }) => path.0.display().to_string(),
            Some(Endpoint::Segment { name, .. }) => name.clone(),
            Some(Endpoint::Interface { name, .. }) => name.clone(),
            _ => String::new(),
        })
    }

    /// Serves until `is_over` says so of the robot, which it looks at between two steps. `moved` is
    /// told each board that came back under a name of its own after its cable was pulled, and that
    /// name.
    ///
    /// # Errors
    /// A socket or a terminal is broken; [`BadOption`] for a priority that is not granted.
    pub fn run(
        &mut self,
        clock: &dyn Clock,
        is_over: &mut dyn FnMut(&EmulatedRobot) -> bool,
        moved: &mut dyn FnMut(&str, &Path),
    ) -> anyhow::Result<Lateness> {
        // A thread inherits the priority of whoever starts it.
        let threads = self.start_boards()?;
        let granted = self.priority.map_or(Ok(()), linux::set_fifo);
        let granted =
            granted.map_err(|what| BadOption(format!("--priority: {what}; see `taktil doctor`")));
        let lateness = match granted {
            Ok(()) => self.run_in_time(clock, is_over, moved),
            Err(refused) => Err(refused.into()),
        };
        for BoardThread { mut stop, handle } in threads {
            // The link has room for this one message.
            let _ = stop.send((), Nanos::ZERO, Nanos::ZERO);
            match handle.join() {
                Ok(outcome) => outcome.context("the file of a board is broken")?,
                Err(_) => anyhow::bail!("the thread of a board has panicked"),
            }
        }
        lateness
    }

    /// Lets each board of registers run in a thread, by the boards' time.
    fn start_boards(&mut self) -> anyhow::Result<Vec<BoardThread>> {
        let clock = MonotonicClock::since_boot();
        let zero = clock.now() - self.robot.now();
        let mut threads = Vec::new();
        for board in 0..self.robot.board_count() {
            let Some(mut emulator) = self.robot.detach_memory(board) else { continue };
            let (stop, mut stopped) = link(1);
            let own = BoardClock { clock, zero };
            let is_busy = self.robot.has_busy_bits(board);
            let priority = self.priority.filter(|_| !is_busy).map(|_| REGISTERS_PRIORITY);
            let work = move || {
                // Whoever asked for it is told by the thread of the world.
                let _ = priority.map(linux::set_fifo);
                let pause = BoardClock { clock, zero };
                let mut goes_on = || {
                    if is_busy {
                        std::thread::yield_now();
                    } else {
                        pause.sleep_until(pause.now() + LOOK_PERIOD);
                    }
                    stopped.next(Nanos::MAX).is_none()
                };
                serve(&mut emulator, &own, &mut goes_on)
            };
            let name = self.robot.name(board).to_owned();
            let handle = std::thread::Builder::new().name(name).spawn(work)?;
            threads.push(BoardThread { stop, handle });
        }
        Ok(threads)
    }

    fn run_in_time(
        &mut self,
        clock: &dyn Clock,
        is_over: &mut dyn FnMut(&EmulatedRobot) -> bool,
        moved: &mut dyn FnMut(&str, &Path),
    ) -> anyhow::Result<Lateness> {
        let mut pace = Pace::new(clock.now() - self.robot.now());
        let mut planned = next_step(self.robot.now());
        while !is_over(&self.robot) {
            self.robot.advance(pace.target(clock.now(), self.robot.now()));
            self.robot.integrate();
            self.receive()?;
            self.deliver()?;
            self.plug(moved)?;
            let reached = self.robot.now();
            while planned <= reached {
                pace.record(clock.now(), planned);
                planned += STEP_TIME;
            }
            let due = self.robot.next_event().min(planned);
            self.wait(pace.until(clock.now(), due))?;
        }
        Ok(pace.lateness)
    }

    /// Hands the boards what their hosts have sent.
    fn receive(&mut self) -> anyhow::Result<()> {
        let mut buffer = [0; BUFFER_BYTES];
        for (board, endpoint) in self.endpoints.iter_mut().enumerate() {
            for _ in 0..READS_A_TURN_MAX {
                let count = match endpoint {
                    Endpoint::Socket { socket, peer } => match socket.recv_from(&mut buffer) {
                        Ok((count, from)) => {
                            *peer = Some(from);
                            count
                        }
                        Err(error) if is_passing(error.kind()) => break,
                        Err(error) => return Err(error).context("the card's socket is broken"),
                    },
                    Endpoint::Segment { socket, .. } => {
                        match socket.receive(&mut buffer).context("the interface is broken")? {
                            None => break,
                            Some(count) => count,
                        }
                    }
                    Endpoint::Line { terminal: Some(terminal), .. } => {
                        match terminal.read(&mut buffer).context("a terminal is broken")? {
                            0 => break,
                            count => count,
                        }
                    }
                    Endpoint::Bus { socket, peer, .. } => match socket.recv_from(&mut buffer) {
                        Ok((count, from)) => {
                            *peer = Some(from);
                            count
                        }
                        Err(error) if is_passing(error.kind()) => break,
                        Err(error) => return Err(error).context("the bus's socket is broken"),
                    },
                    Endpoint::Interface { socket, .. } => match socket.receive(&mut buffer) {
                        Some(count) => count,
                        None => break,
                    },
                    Endpoint::Line { terminal: None, .. } | Endpoint::File(_) => break,
                };
                if self.starts_on_request {
                    self.robot.start_world();
                }
                self.robot.receive(board, &buffer[..count]);
            }
        }
        Ok(())
    }

    /// Sends what the boards have said.
    fn deliver(&mut self) -> anyhow::Result<()> {
        for (board, endpoint) in self.endpoints.iter_mut().enumerate() {
            let mut outcome = Ok(());
            self.robot.deliver(board, &mut |bytes| match endpoint {
                Endpoint::Socket { socket, peer: Some(peer) } => {
                    // Whoever asked may be gone.
                    let _ = socket.send_to(bytes, *peer);
                }
                Endpoint::Line { terminal: Some(terminal), .. } => outcome = terminal.write(bytes),
                Endpoint::Segment { socket, .. } => socket.send(bytes),
                Endpoint::Bus { socket, peer: Some(peer), .. } => {
                    // Whoever spoke may be gone.
                    let _ = socket.send_to_addr(bytes, peer);
                }
                Endpoint::Interface { socket, .. } => socket.send(bytes),
                _ => {}
            });
            outcome.context("a terminal is broken")?;
        }
        Ok(())
    }

    /// Pulls cables and plugs them in as the plan says.
    fn plug(&mut self, moved: &mut dyn FnMut(&str, &Path)) -> anyhow::Result<()> {
        for (board, endpoint) in self.endpoints.iter_mut().enumerate() {
            let Endpoint::Line { terminal: open, link } = endpoint else { continue };
            match (self.robot.is_plugged(board), &open) {
                (false, Some(_)) => *open = None,
                (true, None) => {
                    let again = terminal(link.as_deref())?;
                    moved(self.robot.name(board), again.path());
                    *open = Some(again);
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// Waits until a host has sent something, at most for `longest`.
    fn wait(&self, longest: Nanos) -> anyhow::Result<()> {
        if longest <= Nanos::ZERO {
            return Ok(());
        }
        let descriptors = self.endpoints.iter().filter_map(|endpoint| match endpoint {
            Endpoint::Socket { socket, .. } => Some(socket.as_fd()),
            Endpoint::Line { terminal, .. } => terminal.as_ref().map(AsFd::as_fd),
            Endpoint::Segment { socket, .. } => Some(socket.as_fd()),
            Endpoint::Bus { socket, .. } => Some(socket.as_fd()),
            Endpoint::Interface { socket, .. } => Some(socket.as_fd()),
            Endpoint::File(_) => None,
        });
        let mut watched: Vec<PollFd<'_>> =
            descriptors.map(|descriptor| PollFd::new(descriptor, PollFlags::POLLIN)).collect();
        match ppoll(&mut watched, Some(TimeSpec::nanoseconds(longest.0)), None) {
            Ok(_) | Err(Errno::EINTR) => Ok(()),
            Err(error) => Err(error).context("the boards cannot be waited for"),
        }
    }
}

/// The first multiple of a step after `now`.
fn next_step(now: Nanos) -> Nanos {
    STEP_TIME * (now.0.div_euclid(STEP_TIME.0) + 1)
}

/// Whether an error of a socket leaves it usable.
fn is_passing(kind: ErrorKind) -> bool {
    matches!(kind, ErrorKind::WouldBlock | ErrorKind::Interrupted | ErrorKind::ConnectionRefused)
}

/// Where a board of registers is unless somebody says otherwise.
fn shared_file(name: &str) -> PathBuf {
    PathBuf::from(format!("/dev/shm/taktil-{name}-{}", std::process::id()))
}

/// A bus at a path, or on an interface of the kernel's where the name is no path.
fn bus(place: PathBuf) -> anyhow::Result<Endpoint> {
    let name = place.display().to_string();
    let refused = |error: std::io::Error| {
        let remedy = "name a path where nothing is, or an interface that is up, such as vcan0";
        BadOption(format!("--link {}: {error}; {remedy}", place.display()))
    };
    if !name.contains('/') {
        let socket = InterfaceSocket::open(&name).map_err(refused)?;
        return Ok(Endpoint::Interface { socket, name });
    }
    let socket = UnixDatagram::bind(&place).map_err(refused)?;
    socket.set_nonblocking(true)?;
    Ok(Endpoint::Bus { socket, peer: None, path: OwnPath(place) })
}

fn bound(address: &str) -> anyhow::Result<UdpSocket> {
    let Ok(parsed) = address.parse::<SocketAddr>() else {
        let text = format!("--address {address}: no address with a port; write 127.0.0.1:27181");
        return Err(BadOption(text).into());
    };
    let socket = UdpSocket::bind(parsed).map_err(|error| {
        let remedy = match error.kind() {
            ErrorKind::AddrInUse => "end whoever has it, or take port 0 for one that is free",
            ErrorKind::PermissionDenied => "take a port above 1023",
            _ => "give an address of this machine, such as 127.0.0.1:27181",
        };
        BadOption(format!("--address {address}: {error}; {remedy}"))
    })?;
    socket.set_nonblocking(true)?;
    Ok(socket)
}

fn raw_socket(interface: Option<&str>) -> anyhow::Result<Endpoint> {
    let Some(name) = interface.map(str::to_owned) else {
        let text = "--interface: a segment needs one; name one end of a veth pair";
        return Err(BadOption(text.to_owned()).into());
    };
    let socket = RawSocket::open(&name).map_err(|error| {
        let remedy = match error.kind() {
            ErrorKind::PermissionDenied => "give the program the capability CAP_NET_RAW",
            _ => "name an interface as `ip link` lists it",
        };
        BadOption(format!("--interface {name}: {error}; {remedy}"))
    })?;
    Ok(Endpoint::Segment { socket, name })
}

fn terminal(link: Option<&Path>) -> anyhow::Result<Terminal> {
    let Some(link) = link else {
        return Terminal::open().context("no pseudo-terminal can be opened");
    };
    Terminal::new(link).map_err(|error| {
        let shown = link.display();
        let remedy = "name a path in a folder that exists, where no file stands";
        BadOption(format!("--link {shown}: {error}; {remedy}")).into()
    })
}
