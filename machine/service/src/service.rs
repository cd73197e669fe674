//! The service: the machine over real boards, under systemd. It reports READY only after the
//! kernel's grants were read back, and it feeds the watchdog only while all lanes run. It starts
//! with the drives off and moves nothing by itself: the machine checks itself and waits in READY
//! for a request, which comes through the operator's socket if the configuration has one.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use serde_json::json;
use taktil_rtcore::contract::{Item, Weight};
use taktil_rtcore::live::{self, Contract, Pace, RunOptions};
use taktil_rtcore::{Invalid, Machine, Nanos};

use crate::boards::{
    ServiceFile, ServiceSources, locate, locate_arm_error, machine_config, with_joints,
};
pub use crate::monitor::EXIT_HUNG;
use crate::monitor::{FAREWELL_TIMEOUT, HealthMonitor};
use crate::recording::{RecordingDesk, ServiceRecording};
use crate::systemd::{SystemdMessage, start_notifier};
use crate::viewer::{ViewerChannels, drawing};
use taktil_machine::config::MachineConfig;
use taktil_machine::operator::command::CommandContext;
use taktil_machine::operator::{self, OperatorSender, RemoteOperator};
use taktil_machine::robot::{self, AnyRobot};
use taktil_machine::source::{FileKind, Located, Source};
use taktil_machine::tape::player::{DeviceDescription, MissingEntry, Tapes};
use taktil_machine::touch_task;
use taktil_machine::wiring;
use taktil_machine_boards::{Counts, Epoch, RunningThread};
use taktil_machine_console::out;
use taktil_machine_console::signals::{self, SecondSignal};
use taktil_machine_fault::FaultPlan;
use taktil_machine_foxglove::ArmDrawing;
use taktil_machine_operator::{OperatorConfig, OperatorServer, RecordingControl, ServerSetup};
use taktil_record::flight::{FlightConfig, FlightRecorderWriter};
use taktil_record::recorder::{Ending, LogConfig, Recorder};

/// Longest run of the service: ten years, so that the times of all releases fit their integers.
const RUN_DURATION_MAX: Nanos = Nanos::from_secs(10 * 365 * 86_400);
/// Seed of the chance by which faults of a plan happen that have a probability.
const FAULT_SEED: u64 = 1;

/// A service that is ready to run.
pub struct Service {
    machine: Machine,
    contract: Contract,
    /// Which device serves which half.
    served: BTreeMap<String, String>,
    /// What the kernel did not grant to threads of drivers.
    threads: Vec<RunningThread>,
    /// What each driver counts on its board.
    counts: BTreeMap<String, Counts>,
    epoch: Epoch,
    flight: FlightConfig,
    /// Faults that are put into the boards, where that is asked for and allowed.
    faults: Option<FaultPlan>,
    source: Source,
    machine_text: String,
    log: Option<LogConfig>,
    /// The arm as viewers draw it.
    arm: ArmDrawing,
    /// Folder of the configuration, to which the log's path is relative.
    folder: PathBuf,
    /// Where an operator is listened to, and with what.
    operator: Option<(OperatorConfig, ServerSetup)>,
    /// Metadata for a replay: the texts of both files, and the description of the devices.
    log_metadata: BTreeMap<String, String>,
}

impl Service {
    /// Reads the configuration, opens the board and builds the machine. Opening the board writes
    /// the safe values.
    ///
    /// # Errors
    /// Anything wrong, located in the file where it stands.
    pub fn load(path: &Path) -> Result<Service, Located> {
        let (sender, receiver) = operator::channel();
        let remote: wiring::OperatorBuilder<'_> =
            Box::new(move |ports| Ok(Box::new(RemoteOperator::new(Some(receiver), ports))));
        Service::build(path, remote, Some(sender))
    }

    /// Like [`Service::load`], with the given operator's task, which writes `operator.request`,
    /// `operator.jog` and `operator.moves`. No operator's socket is opened.
    ///
    /// # Errors
    /// As [`Service::load`].
    pub fn with_operator(
        path: &Path,
        operator: wiring::OperatorBuilder<'_>,
    ) -> Result<Service, Located> {
        Service::build(path, operator, None)
    }

    fn build(
        path: &Path,
        operator: wiring::OperatorBuilder<'_>,
        sender: Option<OperatorSender>,
    ) -> Result<Service, Located> {
        let mut sources = ServiceSources::read(path)?;
        let task = read_task(&mut sources.config, &sources.source, &sources.machine)?;
        let opened = sources.open()?;
        let ServiceSources { source, machine: described, file, config, robot, urdf } = sources;
        opened
            .require_code_scale(&config, &robot)
            .map_err(|bad| locate(bad, &source, &described))?;
        let faults = file.service.plan(path.parent().unwrap_or(Path::new("")));
        let faults = faults.map_err(|bad| locate(bad, &source, &described))?;
        let log_metadata = [
            ("mode", "board".to_owned()),
            ("taktil", env!("CARGO_PKG_VERSION").to_owned()),
            ("service", path.display().to_string()),
            ("service_text", source.text.clone()),
            ("machine_text", described.text.clone()),
            ("devices", DeviceDescription::from_devices(&opened.devices).text()),
        ]
        .into_iter()
        .chain(urdf.map(|urdf| ("urdf_text", urdf.text)))
        .chain(task.map(|task| ("task_text", task.text)));
        let log_metadata = log_metadata.map(|(key, value)| (key.to_owned(), value)).collect();
        let arm = drawing(&robot);
        let trajectory = config.trajectory.clone().unwrap_or_default();
        let about = json!({
            "simulated": false,
            "service": path,
            "devices": opened.served,
            "fault_injection": faults.is_some(),
        });
        let plan = faults.clone().unwrap_or_default();
        // Chance of its own in each service would make a trial that nobody can repeat.
        let built = taktil_machine_fault::decorate(opened.devices, &plan, FAULT_SEED)
            .and_then(|devices| wiring::assemble(config, &robot, devices, operator))
            .and_then(|builder| builder.build())
            .and_then(|mut machine| machine.inject(&plan, "").map(|()| machine));
        Ok(Service {
            machine: built.map_err(|bad| locate(bad, &source, &described))?,
            contract: file.contract.contract(),
            served: opened.served,
            threads: opened.threads,
            counts: opened.counts,
            epoch: opened.epoch,
            log: file.log,
            arm,
            folder: path.parent().unwrap_or(Path::new("")).to_owned(),
            log_metadata,
            operator: file.operator.zip(sender).map(|(config, sender)| {
                let context = CommandContext { trajectory, robot };
                (config, ServerSetup { sender, context, about, recording: None })
            }),
            flight: file.flight,
            faults,
            source,
            machine_text: described.text,
        })
    }

    /// Records the run to this file instead of the configuration's.
    pub fn record_to(&mut self, path: PathBuf) {
        // Relative to the folder of whoever says so, not to that of the configuration.
        let path = std::path::absolute(&path).unwrap_or(path);
        self.log = Some(match self.log.take() {
            Some(log) => LogConfig { path, ..log },
            None => LogConfig::at(path),
        });
    }

    /// Describes the machine, whether its schedule is feasible, and what the kernel would grant
    /// now; the grants are requested and given back.
    #[must_use]
    pub fn describe(&self) -> String {
        let mut text = self.fault_text().unwrap_or_default();
        for (half, device) in &self.served {
            text += &format!("{half}: device {device}\n");
        }
        for thread in &self.threads {
            if let Some(missing) = &thread.missing {
                text += &format!("thread of device {}: {}\n", thread.device, missing.text);
            }
        }
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
        text + &self.contract_text()
    }

    /// The faults that are put into the boards, one a line.
    fn fault_text(&self) -> Option<String> {
        let faults = self.faults.as_ref()?.faults().iter();
        let lines: Vec<String> = faults.map(|fault| format!("fault by plan: {fault}\n")).collect();
        Some(lines.concat())
    }

    /// The contract, item by item, compared with what the kernel would grant now.
    fn contract_text(&self) -> String {
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
    fn start_flight_recorder(&mut self) -> Result<Option<FlightRecorderWriter>, Located> {
        if !self.flight.enabled {
            return Ok(None);
        }
        let texts = [("config_text", &*self.source.text), ("machine_text", &*self.machine_text)];
        let path = self.flight.place();
        FlightRecorderWriter::start(&mut self.machine, &path, self.flight.seconds, &texts)
            .map(Some)
            .map_err(|bad| self.source.locate(bad.within("flight")))
    }

    /// Threads of drivers are held to the contract as lanes are: what the kernel did not grant them
    /// is told, and refuses the start where that item, priority or CPU, is hard.
    fn require_driver_threads(&self) -> anyhow::Result<()> {
        for thread in &self.threads {
            let Some(missing) = &thread.missing else { continue };
            let text = format!("the thread of device {}: {}", thread.device, missing.text);
            let weight = self.contract.demands().of(missing.item);
            anyhow::ensure!(weight != Weight::Hard, "not granted to {text}; see `taktil doctor`");
            if weight == Weight::Soft {
                out::warn(format_args!("degraded: {text}"));
            }
        }
        Ok(())
    }

    /// Runs until SIGTERM or SIGINT.
    ///
    /// # Errors
    /// An item of a hard contract that the kernel did not grant, or a task that does not start.
    pub fn run(&mut self) -> anyhow::Result<()> {
        let stop = signals::watch(SecondSignal::Ignored)?;
        self.run_until(&stop)
    }

    /// Takes the place of the log for this process, and says how the recording before it ended.
    fn start_recording(&mut self) -> Result<Option<ServiceRecording>, Located> {
        let Some(log) = &self.log else { return Ok(None) };
        let catalog = self.machine.catalog();
        let metadata = self.log_metadata.clone();
        let recorder = log.options(&self.folder).and_then(|options| {
            if log.viewer {
                let companion = Box::new(ViewerChannels::new(self.arm.clone(), catalog));
                return Recorder::start_with_companion(options, catalog, metadata, companion);
            }
            Recorder::start(options, catalog, metadata)
        });
        let recorder = recorder.map_err(|bad| self.source.locate(bad.within("log")))?;
        if let Some(previous) = recorder.previous().filter(|p| p.ending != Ending::Finished) {
            out::warn(previous);
        }
        Ok(Some(ServiceRecording::new(recorder)))
    }

    /// Listens to an operator, where the configuration names a socket.
    fn listen(
        &mut self,
        recording: Option<Arc<RecordingDesk>>,
    ) -> Result<Option<OperatorServer>, Located> {
        let Some((config, mut setup)) = self.operator.take() else {
            out::warn(
                "no [operator] section: nobody can enable the drives; name a socket there, for \
                 `taktil tell`",
            );
            return Ok(None);
        };
        setup.recording = recording.map(|desk| desk as Arc<dyn RecordingControl>);
        OperatorServer::start(&config, setup, &mut self.machine)
            .map(Some)
            .map_err(|bad| self.source.locate(bad.within("operator")))
    }

    /// Like [`Service::run`], until `stop` is set.
    ///
    /// # Errors
    /// As [`Service::run`].
    pub fn run_until(&mut self, stop: &AtomicBool) -> anyhow::Result<()> {
        self.require_driver_threads()?;
        if let Some(faults) = self.fault_text() {
            out::warn(format_args!("FAULT INJECTION is on: nothing here is to be trusted"));
            out::warn(faults.trim_end());
        }
        let recording = self.start_recording()?;
        let desk = recording.as_ref().map(ServiceRecording::desk);
        let server = self.listen(desk)?;
        let flight_recorder = self.start_flight_recorder()?;
        let catalog = self.machine.catalog();
        let is_ending = || stop.load(Ordering::Relaxed);
        let mut monitor =
            HealthMonitor::new(catalog, &is_ending, self.epoch.clone(), start_notifier()?);
        monitor.flight_recorder = flight_recorder;
        monitor.recording = recording;
        monitor.server = server;
        monitor.latched.counts = std::mem::take(&mut self.counts);
        let terms =
            RunOptions { until: RUN_DURATION_MAX, contract: self.contract, pace: Pace::Fixed };
        let outcome = live::run(&mut self.machine, terms, stop, &mut monitor);
        monitor.notifier.send(SystemdMessage::Stopping("the lanes have ended".into()));
        monitor.server = None;
        monitor.notifier.flush(FAREWELL_TIMEOUT);
        // The end of the machine does not depend on its log.
        let recorded = monitor.finish_recording();
        outcome?;
        for (spec, figures) in self.machine.figures() {
            let (jobs, missed) = (figures.jobs, figures.misses.total());
            out::warn(format_args!(
                "lane {}: {jobs} jobs, {missed} missed, {} skipped",
                spec.name, figures.skipped
            ));
        }
        for (device, counts) in &monitor.latched.counts {
            out::warn(format_args!("device {device}: {}", counts.text()));
        }
        recorded
    }
}

/// The configuration of a run as text from its log.
#[derive(Clone, Debug)]
pub struct LoggedSources {
    /// The service's file.
    pub service: Source,
    /// The machine file.
    pub machine: Source,
    /// The arm's URDF file, where the machine names one.
    pub urdf: Option<Source>,
    /// The file of the touch task, where the machine names one.
    pub task: Option<Source>,
}

/// Reads the touch task that the machine names, by its path from the file in which the section
/// stands.
fn read_task(
    config: &mut MachineConfig,
    source: &Source,
    machine: &Source,
) -> Result<Option<Source>, Located> {
    let namer = if source.contains("robot.tactile_servo") { source } else { machine };
    let read = |name: &str| Source::read(Path::new(name), FileKind::Task).map_err(|bad| bad.what);
    let within = |bad| locate(bad, source, machine);
    let task = touch_task::fill(config, namer.folder(), &read, &within)?;
    Ok(task.map(|(_, task)| task))
}

/// The machine's configuration and the robot that the texts of a log describe.
///
/// # Errors
/// Anything wrong with the texts, located.
fn logged_robot(sources: &LoggedSources) -> Result<(MachineConfig, AnyRobot), Located> {
    let LoggedSources { service: source, machine, urdf, task } = sources;
    let file: ServiceFile = source.parse()?;
    let mut config = machine_config(source, machine, file.robot)?;
    let read = |_: &str| task.clone().ok_or_else(|| "its text is not there".to_owned());
    touch_task::fill(&mut config, Path::new(""), &read, &|bad| locate(bad, source, machine))?;
    let robot = match (&config.arm, urdf) {
        (None, _) => AnyRobot::puma260(),
        (Some(arm), Some(urdf)) => {
            robot::build(arm, urdf).map_err(|bad| locate_arm_error(bad, source, machine))?
        }
        (Some(_), None) => {
            let bad = Invalid::new("arm.urdf", "its text is not there", "name a newer log");
            return Err(locate(bad, source, machine));
        }
    };
    let robot = with_joints(&config, robot).map_err(|bad| locate(bad, source, machine))?;
    Ok((config, robot))
}

/// The robot that the texts of a log describe, its joints as the machine file connects them.
///
/// # Errors
/// Anything wrong with the texts, located.
pub fn robot_of(sources: &LoggedSources) -> Result<AnyRobot, Located> {
    logged_robot(sources).map(|(_, robot)| robot)
}

/// Builds the machine that repeats a run of the service from the sources, the tapes and the device
/// description in its log. The machine tolerates lanes that stood still for `stall`. The caller
/// feeds the outputs of the task `operator`.
///
/// # Errors
/// Anything wrong with the texts, located.
pub fn rebuild(
    sources: &LoggedSources,
    tapes: Tapes,
    about: &DeviceDescription,
    stall: Nanos,
) -> Result<(Machine, MissingEntry), Located> {
    let (config, robot) = logged_robot(sources)?;
    let (devices, lack) = tapes.devices(about);
    let operator: wiring::OperatorBuilder<'_> =
        Box::new(|ports| Ok(Box::new(RemoteOperator::new(None, ports))));
    let built = wiring::assemble(config, &robot, devices, operator).and_then(|mut builder| {
        builder.for_replay(stall);
        builder.build()
    });
    let located = |bad| locate(bad, &sources.service, &sources.machine);
    Ok((built.map_err(located)?, lack))
}
