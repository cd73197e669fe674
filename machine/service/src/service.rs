//! The service: the machine over real boards, under systemd. It says READY only after the kernel's
//! grants were read back, feeds the watchdog only while the lanes beat, and comes up with the
//! drives off. Refuses to move anything by itself: the machine checks itself and waits in READY for
//! somebody to ask, through the operator's socket if the configuration has one.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use anyhow::Context as _;
use sd_notify::NotifyState;
use serde::Deserialize;
use taktil_drivers_regmap::{Board, Config as BoardConfig, OpenError};
use taktil_rtcore::contract::Item;
use taktil_rtcore::live::{self, Attestation, Contract, Hang, Pace, RunObserver, RunOptions};
use taktil_rtcore::record::{Catalog, LaneInfo, Observer, Record};
use taktil_rtcore::{Invalid, Machine, Nanos};

use taktil_machine::config::MachineConfig;
use taktil_machine::contract::ContractConfig;
use taktil_machine::operator::socket::{SERVICE_SOCKET, Socket};
use taktil_machine::operator::speech::Meaning;
use taktil_machine::operator::{self, Mouth, Remote};
use taktil_machine::robot::{self, AnyRobot, Broken};
use taktil_machine::source::{Located, Meant, Source};
use taktil_machine::tape::player::{About, Lack, Tapes};
use taktil_machine::wiring;
use taktil_machine_console::out;
use taktil_machine_console::signals::{self, Second};
use taktil_record::McapLog;
use taktil_record::flight::{FlightConfig, Keeper};

/// Longest run of the service: ten years, so that every release fits its integer.
const FOREVER: Nanos = Nanos::from_secs(10 * 365 * 86_400);
/// Time between two words to systemd.
const PING: Nanos = Nanos::from_millis(100);

/// The service's configuration file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ServiceFile {
    /// Machine file, relative to this one.
    machine: String,
    /// Which missing real-time rights refuse the start.
    #[serde(default = "hard")]
    contract: ContractConfig,
    /// The flight recorder.
    #[serde(default)]
    flight: FlightConfig,
    /// The register-file board.
    board: BoardConfig,
    /// Where the run is recorded, relative to this file; nowhere when absent.
    log: Option<LogConfig>,
    /// Where an operator is listened to; nowhere when absent.
    operator: Option<OperatorConfig>,
    /// Sections that replace those of the machine file.
    #[serde(default)]
    robot: MachineConfig,
}

/// The recording of the service's run.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct LogConfig {
    /// MCAP file; an existing one is kept as `<path>.previous`, in place of the one before it.
    path: PathBuf,
}

/// The operator's socket.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct OperatorConfig {
    /// Unix-domain socket, for the service's user and group.
    #[serde(default = "socket_path")]
    socket: PathBuf,
}

fn socket_path() -> PathBuf {
    SERVICE_SOCKET.into()
}

/// Exit code of a service one of whose tasks does not return.
pub const EXIT_HUNG: i32 = 3;

/// Where an operator will be listened to, what words mean, and the way into the lane.
type Ear = (PathBuf, Meaning, Mouth);

/// A service ready to run.
pub struct Service {
    machine: Machine,
    contract: Contract,
    board: PathBuf,
    flight: FlightConfig,
    source: Source,
    machine_text: String,
    log: Option<PathBuf>,
    socket: Option<Ear>,
    /// What a replay needs: the texts of both files, and what the devices say of themselves.
    origin: BTreeMap<String, String>,
}

impl Service {
    /// Reads the configuration, opens the board, assembles the machine. Opening writes the safe
    /// values.
    ///
    /// # Errors
    /// Anything wrong, located in the file where it stands.
    pub fn load(path: &Path) -> Result<Service, Located> {
        let (mouth, hand) = operator::pair();
        let remote: wiring::MakeOperator<'_> =
            Box::new(move |ports| Ok(Box::new(Remote::new(Some(hand), ports))));
        Service::build(path, remote, Some(mouth))
    }

    /// As [`Service::load`], with somebody who asks: a task that writes `operator.request`,
    /// `operator.jog` and `operator.moves`. Nobody else is listened to.
    ///
    /// # Errors
    /// As [`Service::load`].
    pub fn with_operator(
        path: &Path,
        operator: wiring::MakeOperator<'_>,
    ) -> Result<Service, Located> {
        Service::build(path, operator, None)
    }

    fn build(
        path: &Path,
        operator: wiring::MakeOperator<'_>,
        mouth: Option<Mouth>,
    ) -> Result<Service, Located> {
        let source = Source::read(path, Meant::Service)?;
        let file: ServiceFile = source.parse()?;
        let machine_path = path.parent().unwrap_or(Path::new("")).join(&file.machine);
        let described = Source::read(&machine_path, Meant::Machine)
            .map_err(|bad| source.locate(Invalid::new("machine", bad.what, bad.remedy)))?;
        // The arm's file lies beside the file that names it.
        let namer = if file.robot.arm.is_some() { path } else { &machine_path };
        let beside = namer.parent().unwrap_or(Path::new("")).to_owned();
        let config = machine_config(&described, file.robot)?;
        let (robot, urdf) = robot::load(config.arm.as_ref(), &beside)
            .map_err(|bad| broken(bad, &source, &described))?;
        let devices = Board::open(&file.board).map_err(|bad| source.locate(board_error(bad)))?;
        let origin = [
            ("mode", "board".to_owned()),
            ("taktil", env!("CARGO_PKG_VERSION").to_owned()),
            ("service", path.display().to_string()),
            ("service_text", source.text.clone()),
            ("machine_text", described.text.clone()),
            ("devices", About::of(&devices).text()),
        ]
        .into_iter()
        .chain(urdf.map(|urdf| ("urdf_text", urdf.text)));
        let origin = origin.map(|(key, value)| (key.to_owned(), value)).collect();
        let pace = config.trajectory.clone().unwrap_or_default();
        let built =
            wiring::assemble(config, &robot, devices, operator).and_then(|builder| builder.build());
        Ok(Service {
            machine: built.map_err(|bad| locate(bad, &source, &described))?,
            contract: file.contract.contract(),
            board: file.board.path,
            log: file.log.map(|log| path.parent().unwrap_or(Path::new("")).join(log.path)),
            origin,
            socket: file
                .operator
                .zip(mouth)
                .map(|(ear, mouth)| (ear.socket, Meaning { pace, robot }, mouth)),
            flight: file.flight,
            source,
            machine_text: described.text,
        })
    }

    /// Records the run to this file, whatever the configuration says.
    pub fn record_to(&mut self, path: PathBuf) {
        self.log = Some(path);
    }

    /// What was assembled, whether its schedule can hold, and what the kernel would grant it now,
    /// which is asked for and given back.
    #[must_use]
    pub fn describe(&self) -> String {
        let mut text = format!("board {}\n", self.board.display());
        let lanes = self.machine.figures().zip(self.machine.task_names());
        for (((spec, _), seats), found) in lanes.zip(&self.machine.analysis().lanes) {
            let response = found.response().map_or_else(
                || "response unknown".to_owned(),
                |bound| format!("response {}", bound.span()),
            );
            text += &format!(
                "lane {}: every {}, priority {}: {}\n  {}, deadline {}: {}\n",
                spec.name,
                spec.period,
                spec.priority,
                seats.join(" > "),
                response,
                found.deadline,
                found.verdict.text(),
            );
        }
        text + &self.rights()
    }

    /// The contract, item by item, against what the kernel would grant now.
    fn rights(&self) -> String {
        let attestation = live::trial_attestation(&self.machine, self.contract);
        let demands = self.contract.demands();
        let mut text = String::new();
        for item in Item::ALL {
            let short: Vec<_> =
                attestation.shortfalls.iter().filter(|short| short.item == item).collect();
            let (name, weight) = (item.name(), demands.of(item).name());
            if short.is_empty() {
                text += &format!("contract {name} ({weight}): holds\n");
            }
            for short in short {
                text += &format!("contract {name} ({weight}): {}", short.found);
                text += &format!("; wanted {}; {}\n", short.wanted(), short.remedy());
            }
        }
        text + match attestation.refused().count() {
            0 => "it would start\n",
            _ => "it would be refused: an item that is hard does not hold\n",
        }
    }

    /// Starts the flight recorder, unless the configuration has none.
    fn record_flight(&mut self) -> Result<Option<Keeper>, Located> {
        if !self.flight.enabled {
            return Ok(None);
        }
        let texts = [("config_text", &*self.source.text), ("machine_text", &*self.machine_text)];
        let path = self.flight.place();
        Keeper::start(&mut self.machine, &path, self.flight.seconds, &texts)
            .map(Some)
            .map_err(|bad| self.source.locate(bad.within("flight")))
    }

    /// Runs until SIGTERM or SIGINT.
    ///
    /// # Errors
    /// What the kernel did not grant under a hard contract, or a task that refused to start.
    pub fn run(&mut self) -> anyhow::Result<()> {
        let stop = signals::watch(Second::Waits)?;
        self.run_until(&stop)
    }

    /// As [`Service::run`], until `stop` is set.
    ///
    /// # Errors
    /// As [`Service::run`].
    pub fn run_until(&mut self, stop: &AtomicBool) -> anyhow::Result<()> {
        let keeper = self.record_flight()?;
        let catalog = self.machine.catalog();
        let log = match &self.log {
            None => None,
            Some(path) => {
                set_aside(path)?;
                Some(McapLog::create(path, catalog, &self.origin)?)
            }
        };
        let mut heart = Heart::new(catalog, log);
        heart.keeper = keeper;
        if let Some((path, meaning, mouth)) = self.socket.take() {
            let socket = Socket::listen(&path, mouth, meaning);
            let mut socket = socket.map_err(|bad| {
                self.source.locate(Invalid { place: "operator.socket".into(), ..bad })
            })?;
            socket.attach(self.machine.catalog());
            heart.socket = Some(socket);
        }
        let terms = RunOptions { until: FOREVER, contract: self.contract, pace: Pace::Fixed };
        let outcome = live::run(&mut self.machine, terms, stop, &mut heart);
        tell(&[NotifyState::Stopping]);
        // The machine has ended whatever becomes of its record.
        let recorded = heart.log.take().map_or(Ok(()), McapLog::finish);
        outcome?;
        for (spec, figures) in self.machine.figures() {
            let (jobs, missed) = (figures.jobs, figures.misses.total());
            out::warn(format_args!(
                "lane {}: {jobs} jobs, {missed} missed, {} skipped",
                spec.name, figures.skipped
            ));
        }
        recorded
    }
}

/// Keeps the log of the run before beside the new one, as `<path>.previous`: what happened before a
/// restart is what somebody will ask for.
fn set_aside(path: &Path) -> anyhow::Result<()> {
    if !path.is_file() {
        return Ok(());
    }
    let mut previous = path.as_os_str().to_owned();
    previous.push(".previous");
    let previous = PathBuf::from(previous);
    std::fs::rename(path, &previous).with_context(|| {
        let (path, previous) = (path.display(), previous.display());
        format!("cannot keep the log {path} as {previous}; move it away, or name another log")
    })
}

/// The machine that repeats a run of the service from what stands in its log: the texts of both
/// files and, where the machine names one, of the arm's; `tapes`, and what the devices said of
/// themselves. It bears lanes that stood still for `stall`; the task `operator` is to be fed.
///
/// # Errors
/// Anything wrong with the texts, located.
pub fn rebuild(
    (source, machine, urdf): (&Source, &Source, Option<&Source>),
    tapes: Tapes,
    about: &About,
    stall: Nanos,
) -> Result<(Machine, Lack), Located> {
    let file: ServiceFile = source.parse()?;
    let config = machine_config(machine, file.robot)?;
    let robot = match (&config.arm, urdf) {
        (None, _) => AnyRobot::puma260(),
        (Some(arm), Some(urdf)) => {
            robot::build(arm, urdf).map_err(|bad| broken(bad, source, machine))?
        }
        (Some(_), None) => {
            let bad = Invalid::new("arm.urdf", "its text is not there", "name a newer log");
            return Err(locate(bad, source, machine));
        }
    };
    let (devices, lack) = tapes.devices(about);
    let operator: wiring::MakeOperator<'_> =
        Box::new(|ports| Ok(Box::new(Remote::new(None, ports))));
    let built = wiring::assemble(config, &robot, devices, operator).and_then(|mut builder| {
        builder.for_replay(stall);
        builder.build()
    });
    Ok((built.map_err(|bad| locate(bad, source, machine))?, lack))
}

fn machine_config(machine: &Source, robot: MachineConfig) -> Result<MachineConfig, Located> {
    let mut config = machine.parse::<MachineConfig>()?.overridden_by(robot);
    // Without an operator the script's feedback has no reader.
    config.wiring.remove("operator.control");
    config.wiring.remove("operator.typed");
    Ok(config)
}

/// Puts a complaint at its place in the service's file or in the machine's.
fn locate(bad: Invalid, source: &Source, machine: &Source) -> Located {
    let here = bad.clone().within("robot");
    if source.holds(&here.place) { source.locate(here) } else { machine.locate(bad) }
}

fn broken(bad: Broken, source: &Source, machine: &Source) -> Located {
    match bad {
        Broken::Section(bad) => locate(bad, source, machine),
        Broken::File(located) => *located,
    }
}

fn hard() -> ContractConfig {
    ContractConfig::HARD
}

fn board_error(bad: OpenError) -> Invalid {
    match bad {
        OpenError::Invalid(invalid) => invalid.within("board"),
        OpenError::Device { what, remedy, .. } => Invalid::new("board.path", what, remedy),
    }
}

/// Watches the lanes' health and passes their beat on to systemd.
struct Heart {
    beats: Vec<Beat>,
    next: Nanos,
    keeper: Option<Keeper>,
    log: Option<McapLog>,
    socket: Option<Socket>,
}

impl Heart {
    fn new(catalog: &Catalog, log: Option<McapLog>) -> Heart {
        let beat = |lane: &LaneInfo| {
            let health = catalog.find(&format!("{}.health", lane.name))?;
            Some(Beat::new(health, lane.period))
        };
        let beats = catalog.lanes.iter().filter_map(beat).collect();
        Heart { beats, next: Nanos::ZERO, keeper: None, log, socket: None }
    }
}

/// What is heard of one lane.
struct Beat {
    /// Its health's place in the catalog.
    health: usize,
    /// It is silent when nothing was heard of it for so long.
    limit: Nanos,
    heard: bool,
    last: Nanos,
}

impl Beat {
    /// A lane may be as slow as it likes: it is held to its own period.
    fn new(health: usize, period: Nanos) -> Beat {
        Beat { health, limit: PING.max(period * 2), heard: false, last: Nanos::ZERO }
    }

    /// Whether the lane is alive at `now`.
    fn lives(&mut self, now: Nanos) -> bool {
        if core::mem::take(&mut self.heard) {
            self.last = now;
        }
        now - self.last <= self.limit
    }
}

impl Observer for Heart {
    fn record(&mut self, record: &Record<'_>) {
        if let Some(beat) = self.beats.iter_mut().find(|beat| beat.health == record.signal) {
            beat.heard = true;
        }
        if let Some(log) = &mut self.log {
            log.record(record);
        }
        if let Some(socket) = &mut self.socket {
            socket.record(record);
        }
    }
}

impl RunObserver for Heart {
    fn on_attestation(&mut self, attestation: &Attestation) {
        if let Some(keeper) = &mut self.keeper {
            keeper.attested(attestation);
        }
        if !attestation.is_granted() {
            out::warn(format_args!("degraded: {}", attestation.missing.join("; ")));
        }
        let status =
            if attestation.is_granted() { "lanes granted" } else { "degraded: not real time" };
        tell(&[NotifyState::Ready, NotifyState::Status(status)]);
    }

    fn on_time(&mut self, now: Nanos) {
        if let Some(keeper) = &mut self.keeper {
            keeper.passed(now);
        }
        if let Some(socket) = &mut self.socket {
            socket.poll(now);
        }
        // One silent lane is enough to let the watchdog bite.
        let alive = self.beats.iter_mut().fold(true, |all, beat| all & beat.lives(now));
        if now < self.next {
            return;
        }
        self.next = now + PING;
        if let Some(log) = &mut self.log {
            log.flush();
        }
        if alive {
            tell(&[NotifyState::Watchdog]);
        }
    }

    fn on_hang(&mut self, hang: &Hang) {
        out::warn(format_args!(
            "error: {hang}; the other lanes have ended safe, the board's watchdog does the rest"
        ));
        tell(&[NotifyState::Stopping, NotifyState::Status(&hang.to_string())]);
        if let Some(Err(error)) = self.log.take().map(McapLog::finish) {
            out::warn(format_args!("error: {error:#}"));
        }
        // Its thread cannot be joined, and what it holds cannot be dropped.
        std::process::exit(EXIT_HUNG);
    }
}

/// Says it to systemd; without systemd nobody listens, and that is no error.
fn tell(states: &[NotifyState<'_>]) {
    if let Err(error) = sd_notify::notify(states) {
        out::warn(format_args!("systemd could not be told: {error}"));
    }
}
