//! The flight recorder's files from one process to the next: a start that comes to no job leaves
//! no trace, what a killed process left is kept, and nobody writes what another one is writing.

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use taktil_record::flight::{FlightGrants, FlightRecorderWriter};
use taktil_rtcore::record::{Observer, Record};
use taktil_rtcore::{
    Builder, Cycle, FaultCode, Invalid, Io, LaneSpec, Machine, Nanos, Output, Task, flight,
    virtual_time,
};
use taktil_tests_script::report_skip;

taktil_rtcore::payload! {
    /// A number.
    pub struct Count {
        /// The tick.
        pub tick: u64,
    }
}

struct Counter(Output<Count>);

impl Task for Counter {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        io.write(&self.0, Count { tick: cycle.tick });
        Ok(())
    }
}

fn machine() -> Machine {
    let mut builder = Builder::default();
    let lane = builder.lane(LaneSpec::new("servo", Nanos::from_millis(1), 80)).unwrap();
    builder.task(lane, "counter", |ports| Ok(Box::new(Counter(ports.output("count"))))).unwrap();
    builder.build().unwrap()
}

/// Files in memory of one test, removed at its end.
struct Shm(PathBuf);

impl Shm {
    /// None where there is no memory to put files.
    fn new(name: &str) -> Option<Shm> {
        let path = Path::new("/dev/shm").join(format!("taktil-{name}-{}", std::process::id()));
        let shm = Shm(path);
        match shm.start() {
            Ok(_) => Some(shm),
            Err(refused) => {
                report_skip(refused);
                None
            }
        }
    }

    fn beside(&self, ending: &str) -> PathBuf {
        let mut name = self.0.clone().into_os_string();
        name.push(ending);
        name.into()
    }

    /// A process that starts recording. A child that another test has forked holds a copy of every
    /// lock until it runs its own program: a lock that passes is waited for.
    fn start(&self) -> Result<(Machine, FlightRecorderWriter), Invalid> {
        let mut tries = 0..100;
        loop {
            let mut machine = machine();
            match FlightRecorderWriter::start(&mut machine, &self.0, 1.0, &[]) {
                Err(bad) if bad.what.contains("is writing it") && tries.next().is_some() => {
                    std::thread::sleep(std::time::Duration::from_millis(5));
                }
                started => return Ok((machine, started?)),
            }
        }
    }

    /// A process that runs so many jobs and is killed: one without grants says nothing of its end.
    fn run_and_kill(&self, jobs: i64) -> Vec<u8> {
        let (mut machine, mut writer) = self.start().unwrap();
        run(&mut machine, &mut writer, jobs);
        std::fs::read(&self.0).unwrap()
    }

    /// The file without its name, as it is after its process was killed.
    fn leave_nameless(&self, started: (Machine, FlightRecorderWriter)) -> Vec<u8> {
        let nameless = std::fs::read(self.beside(".starting")).unwrap();
        drop(started);
        std::fs::write(self.beside(".starting"), &nameless).unwrap();
        nameless
    }
}

impl Drop for Shm {
    fn drop(&mut self) {
        for ending in ["", ".previous", ".starting"] {
            let _ = std::fs::remove_file(self.beside(ending));
        }
    }
}

/// Gives the file its name when the first record comes, as an application does.
struct Publisher<'a>(&'a mut FlightRecorderWriter);

impl Observer for Publisher<'_> {
    fn record(&mut self, _: &Record<'_>) {
        self.0.publish();
    }
}

fn run(machine: &mut Machine, writer: &mut FlightRecorderWriter, jobs: i64) {
    let until = Nanos::from_millis(jobs);
    virtual_time::run(machine, until, &AtomicBool::new(false), &mut Publisher(writer)).unwrap();
    assert_eq!(writer.failure(), None);
}

fn last_job(bytes: &[u8]) -> u64 {
    flight::read(bytes).unwrap().lanes[0].tick
}

#[test]
fn starts_that_come_to_no_job_leave_no_trace() {
    let Some(shm) = Shm::new("failed-starts") else { return };
    assert!(!shm.0.exists() && !shm.beside(".starting").exists());
    let first = shm.run_and_kill(10);
    let second = shm.run_and_kill(20);
    assert_eq!(std::fs::read(shm.beside(".previous")).unwrap(), first);
    for round in 0..5 {
        let started = shm.start().unwrap();
        assert!(shm.beside(".starting").exists());
        match round % 2 {
            0 => drop(started),
            // Killed before its first job.
            _ => drop(shm.leave_nameless(started)),
        }
        assert_eq!(std::fs::read(&shm.0).unwrap(), second, "round {round}");
        assert_eq!(std::fs::read(shm.beside(".previous")).unwrap(), first, "round {round}");
    }
}

#[test]
fn a_second_process_at_the_same_path_is_refused_and_changes_nothing() {
    let Some(shm) = Shm::new("second") else { return };
    let (mut first, mut writer) = shm.start().unwrap();
    let refused = shm.start().err().unwrap();
    assert!(refused.what.contains("another process is writing it"), "{refused}");
    run(&mut first, &mut writer, 10);
    let refused = shm.start().err().unwrap();
    assert!(refused.what.contains("another process is writing it"), "{refused}");
    run(&mut first, &mut writer, 20);
    assert_eq!(last_job(&std::fs::read(&shm.0).unwrap()), 19);
}

#[test]
fn a_process_killed_before_its_file_had_its_name_is_evidence_too() {
    let Some(shm) = Shm::new("nameless") else { return };
    let before = shm.run_and_kill(10);
    let (mut machine, writer) = shm.start().unwrap();
    let until = Nanos::from_millis(20);
    struct Nobody;
    impl Observer for Nobody {
        fn record(&mut self, _: &Record<'_>) {}
    }
    virtual_time::run(&mut machine, until, &AtomicBool::new(false), &mut Nobody).unwrap();
    let nameless = shm.leave_nameless((machine, writer));
    drop(shm.start().unwrap());
    assert_eq!(std::fs::read(&shm.0).unwrap(), nameless);
    assert_eq!(std::fs::read(shm.beside(".previous")).unwrap(), before);
}

#[test]
fn a_recording_that_ended_well_does_not_displace_one_of_a_crash() {
    let Some(shm) = Shm::new("evidence") else { return };
    let crash = shm.run_and_kill(10);
    for jobs in [20, 30, 40] {
        let (mut machine, mut writer) = shm.start().unwrap();
        writer.write_grants(FlightGrants::default());
        run(&mut machine, &mut writer, jobs);
        drop((machine, writer));
        assert_eq!(last_job(&std::fs::read(&shm.0).unwrap()), jobs.unsigned_abs() - 1);
        assert_eq!(std::fs::read(shm.beside(".previous")).unwrap(), crash);
    }
    shm.run_and_kill(50);
    assert_eq!(std::fs::read(shm.beside(".previous")).unwrap(), crash);
    shm.run_and_kill(60);
    assert_eq!(last_job(&std::fs::read(shm.beside(".previous")).unwrap()), 49, "a newer crash");
}

#[test]
fn what_is_no_recording_of_ours_is_refused_at_once_and_stays() {
    let Some(shm) = Shm::new("strangers") else { return };
    std::fs::write(&shm.0, "dear diary").unwrap();
    let refused = shm.start().err().unwrap();
    assert!(refused.what.contains("is no flight recording"), "{refused}");
    assert_eq!(std::fs::read(&shm.0).unwrap(), b"dear diary");
    std::fs::remove_file(&shm.0).unwrap();
    let pipe = std::process::Command::new("mkfifo").arg(&shm.0).status().unwrap();
    assert!(pipe.success());
    let refused = shm.start().err().unwrap();
    assert!(refused.what.contains("it is a pipe"), "{refused}");
    std::fs::remove_file(&shm.0).unwrap();
    std::os::unix::fs::symlink("/dev/null", &shm.0).unwrap();
    let refused = shm.start().err().unwrap();
    assert!(refused.what.contains("it is a link"), "{refused}");
    std::fs::remove_file(&shm.0).unwrap();
    std::fs::write(&shm.0, "").unwrap();
    if std::os::unix::fs::chown(&shm.0, Some(12_345), None).is_err() {
        report_skip("a file of another user: only root gives files away");
        return;
    }
    let refused = shm.start().err().unwrap();
    assert!(refused.what.contains("it belongs to user 12345"), "{refused}");
}
