//! Every cause of a miss, provoked on purpose on real `SCHED_FIFO` threads, is told apart by the
//! executor. Other misses of the machine are counted but do not fail the test. The test needs the
//! right to `SCHED_FIFO` and is skipped without it.
//!
//! ```sh
//! cargo test --release -p taktil-tests --test causes -- --nocapture
//! TAKTIL_WRITE=docs/measurements/miss-causes.md cargo test --release -p taktil-tests --test causes
//! ```

use std::fs::OpenOptions;
use std::hint::black_box;
use std::io::{PipeReader, PipeWriter, Read, Write, pipe};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use nix::sys::signal::{Signal, kill, raise};
use nix::sys::wait::{WaitPidFlag, WaitStatus, waitpid};
use nix::unistd::Pid;
use taktil_rtcore::live::{self, Contract, Pace, RunObserver, RunOptions};
use taktil_rtcore::record::{Observer, Record};
use taktil_rtcore::{Builder, Cycle, FaultCode, Io, LaneSpec, Misses, Nanos, Task, linux};

/// The period of the lane: long enough that a host's stall seldom fills it.
const LANE_PERIOD: Nanos = Nanos::from_millis(20);
/// The deadline of its jobs.
const LANE_DEADLINE: Nanos = Nanos::from_millis(4);
/// What a provocation costs: more than the deadline, less than the period.
const PROVOCATION_TIME: Nanos = Nanos::from_millis(8);
/// One job in this many is provoked.
const PROVOCATION_INTERVAL_JOBS: u64 = 3;
/// Provoked jobs of a run.
const PROVOKED_JOBS: u64 = 10;
/// Priority of the lane.
const LANE_PRIORITY: u8 = 50;
/// Priority of the thread that takes the lane's processor.
const PREEMPTING_PRIORITY: u8 = 60;
/// The processor of both.
const LANE_CPU: usize = 0;
/// Pages that one job touches. At half a microsecond each they take longer than the deadline; so
/// much memory at once always comes fresh from the kernel.
const TOUCHED_PAGES: usize = 9_000;
/// Bytes of a page.
const PAGE_BYTES: usize = 4096;

/// What real-time threads of the throttled control group may use in each period, and what the task
/// takes: more than two periods' worth, less than its deadline.
const GROUP_RUNTIME: Nanos = Nanos::from_micros(1_500);
const GROUP_PERIOD: Nanos = Nanos::from_millis(10);
const GROUP_JOB_TIME: Nanos = Nanos::from_micros(3_500);

/// How a job is troubled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Provocation {
    Overrun,
    Sleep,
    BlockingRead,
    UnlockedPages,
    SpinnerInTheJob,
    SpinnerAtTheRelease,
    StopInTheJob,
    StopAtTheRelease,
    RtGroup,
}

use Provocation::{
    BlockingRead, Overrun, RtGroup, Sleep, SpinnerAtTheRelease, SpinnerInTheJob, StopAtTheRelease,
    StopInTheJob, UnlockedPages,
};

/// Name, what is done, the cause that has to be found.
const ALL: [(Provocation, &str, &str, &str); 9] = [
    (Overrun, "overrun", "the task computes for 8 ms", "overrun"),
    (Sleep, "sleep", "the task sleeps for 8 ms", "blocked"),
    (BlockingRead, "read", "the task reads a pipe that is written 8 ms later", "blocked"),
    (UnlockedPages, "pages", "memory is unlocked, the task touches 9000 new pages", "page_fault"),
    (SpinnerInTheJob, "spinner", "a thread of higher priority spins during the job", "preempted"),
    (SpinnerAtTheRelease, "late", "the same thread spins over the release", "late_wake"),
    (StopInTheJob, "stop", "SIGSTOP in the job, SIGCONT 8 ms later", "blocked"),
    (StopAtTheRelease, "stop-late", "SIGSTOP before a release, SIGCONT 8 ms later", "late_wake"),
    (
        RtGroup,
        "group",
        "the task computes for 3.5 ms, its control group has 1.5 of 10 ms",
        "throttled",
    ),
];

/// Troubles one job in [`PROVOCATION_INTERVAL_JOBS`].
struct Provoked {
    provocation: Provocation,
    ask: PipeWriter,
    answer: PipeReader,
    pages: Vec<u8>,
}

fn spin(how_long: Nanos) {
    let end = linux::thread_cpu_time() + how_long;
    while linux::thread_cpu_time() < end {
        std::hint::spin_loop();
    }
}

impl Task for Provoked {
    fn step(&mut self, cycle: &Cycle, _io: &mut Io<'_>) -> Result<(), FaultCode> {
        if self.provocation == UnlockedPages && cycle.tick == 0 {
            // Pages of 4 KiB, as a small robot's computer has them.
            nix::sys::prctl::set_thp_disable(true).expect("a process may choose its pages");
            linux::unlock_memory();
        }
        if cycle.tick % PROVOCATION_INTERVAL_JOBS != PROVOCATION_INTERVAL_JOBS - 1 {
            self.pages = Vec::new();
            return Ok(());
        }
        match self.provocation {
            Overrun => spin(PROVOCATION_TIME),
            Sleep => std::thread::sleep(Duration::from_nanos(PROVOCATION_TIME.0.unsigned_abs())),
            BlockingRead => {
                self.ask.write_all(&[1]).expect("the helper lives");
                self.answer.read_exact(&mut [0]).expect("the helper answers");
            }
            UnlockedPages => {
                self.pages = vec![0; TOUCHED_PAGES * PAGE_BYTES];
                for page in self.pages.chunks_mut(PAGE_BYTES) {
                    page[0] = 1;
                }
                black_box(&self.pages);
            }
            SpinnerInTheJob | SpinnerAtTheRelease | StopAtTheRelease => {
                self.ask.write_all(&[1]).expect("the helper lives");
            }
            RtGroup => spin(GROUP_JOB_TIME),
            StopInTheJob => raise(Signal::SIGSTOP).expect("a process may stop itself"),
        }
        Ok(())
    }
}

/// Waits for the task's word and does what the provocation needs from outside the lane.
fn helper(provocation: Provocation, mut asked: PipeReader, mut answer: PipeWriter) {
    if matches!(provocation, SpinnerInTheJob | SpinnerAtTheRelease | StopAtTheRelease) {
        linux::pin_to(LANE_CPU).unwrap();
        linux::set_fifo(PREEMPTING_PRIORITY).unwrap();
    }
    let to_the_release =
        Duration::from_nanos((LANE_PERIOD - Nanos::from_millis(1)).0.unsigned_abs());
    while asked.read_exact(&mut [0]).is_ok() {
        match provocation {
            BlockingRead => {
                std::thread::sleep(Duration::from_nanos(PROVOCATION_TIME.0.unsigned_abs()));
                answer.write_all(&[1]).unwrap();
            }
            SpinnerInTheJob => spin(PROVOCATION_TIME),
            SpinnerAtTheRelease => {
                std::thread::sleep(to_the_release);
                spin(PROVOCATION_TIME);
            }
            StopAtTheRelease => {
                std::thread::sleep(to_the_release);
                raise(Signal::SIGSTOP).unwrap();
            }
            _ => {}
        }
    }
}

/// NullObserver watches.
struct NullObserver;

impl Observer for NullObserver {
    fn record(&mut self, _record: &Record<'_>) {}
}

impl RunObserver for NullObserver {}

fn provoke(provocation: Provocation) -> Misses {
    let (asked, ask) = pipe().unwrap();
    let (answered, answer) = pipe().unwrap();
    let helper = std::thread::spawn(move || helper(provocation, asked, answer));
    let mut builder = Builder::new();
    let mut spec = LaneSpec::new("lane", LANE_PERIOD, LANE_PRIORITY);
    (spec.deadline, spec.cpu) = (LANE_DEADLINE, Some(LANE_CPU));
    let lane = builder.lane(spec).unwrap();
    let task = Provoked { provocation, ask, answer: answered, pages: Vec::new() };
    builder.task(lane, "troubled", |_| Ok(Box::new(task))).unwrap();
    let mut machine = builder.build().unwrap();
    let jobs = i64::try_from(PROVOCATION_INTERVAL_JOBS * PROVOKED_JOBS + 1).unwrap();
    let terms =
        RunOptions { until: LANE_PERIOD * jobs, contract: Contract::Soft, pace: Pace::Fixed };
    live::run(&mut machine, terms, &AtomicBool::new(false), &mut NullObserver).unwrap();
    let misses = machine.figures().next().unwrap().1.misses;
    drop(machine);
    helper.join().unwrap();
    misses
}

const CHILD: &str = "TAKTIL_PROVOKE";
/// The control group that the child has to join.
const GROUP: &str = "TAKTIL_PROVOKE_GROUP";

/// A control group whose real-time threads are throttled, for as long as it lives.
struct ThrottledGroup(PathBuf);

impl ThrottledGroup {
    /// Makes one.
    ///
    /// # Errors
    /// The file that is not there or cannot be written, and why: such groups are of kernels with
    /// `CONFIG_RT_GROUP_SCHED` and the first version's `cpu` controller.
    fn new() -> Result<ThrottledGroup, String> {
        let name = format!("taktil-causes-{}", std::process::id());
        let group = ThrottledGroup(Path::new("/sys/fs/cgroup/cpu").join(name));
        let told = |path: &Path, why: std::io::Error| format!("{}: {why}", path.display());
        std::fs::create_dir(&group.0).map_err(|why| told(&group.0, why))?;
        let budget = [("cpu.rt_period_us", GROUP_PERIOD), ("cpu.rt_runtime_us", GROUP_RUNTIME)];
        for (file, span) in budget {
            let path = group.0.join(file);
            let mut file = OpenOptions::new().write(true).open(&path);
            let written = file.as_mut().map(|file| write!(file, "{}", span.0 / 1000));
            match written {
                Ok(Ok(())) => {}
                Ok(Err(why)) => return Err(told(&path, why)),
                Err(_) => return Err(format!("there is no {}", path.display())),
            }
        }
        Ok(group)
    }
}

impl Drop for ThrottledGroup {
    fn drop(&mut self) {
        // Whoever was in it has ended.
        let _ = std::fs::remove_dir(&self.0);
    }
}

/// The child of the test below: provokes one cause and prints what was counted. Alone it does
/// nothing.
#[test]
fn child_that_is_troubled() {
    let Ok(name) = std::env::var(CHILD) else { return };
    let (provocation, ..) = ALL.iter().find(|row| row.1 == name).expect("a known provocation");
    if let Some(group) = std::env::var_os(GROUP) {
        let me = std::process::id().to_string();
        std::fs::write(Path::new(&group).join("cgroup.procs"), me).expect("the group is there");
    }
    for (cause, count) in provoke(*provocation).rows() {
        println!("found {cause} {count}");
    }
}

/// Runs one provocation in a process of its own, which may be stopped and is then continued.
#[expect(clippy::zombie_processes, reason = "waited for by its number, which also tells of a stop")]
fn ask_child(name: &str, group: Option<&ThrottledGroup>) -> Vec<(String, u64)> {
    let mut child = Command::new(std::env::current_exe().unwrap())
        .args(["child_that_is_troubled", "--exact", "--nocapture"])
        .env(CHILD, name)
        .envs(group.map(|group| (GROUP, &group.0)))
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let pid = Pid::from_raw(i32::try_from(child.id()).unwrap());
    while let Ok(WaitStatus::Stopped(..)) = waitpid(pid, Some(WaitPidFlag::WUNTRACED)) {
        std::thread::sleep(Duration::from_nanos(PROVOCATION_TIME.0.unsigned_abs()));
        kill(pid, Signal::SIGCONT).unwrap();
    }
    let mut text = String::new();
    child.stdout.take().unwrap().read_to_string(&mut text).unwrap();
    let rows = text.lines().filter_map(|line| line.split_once("found "));
    let parsed = rows.filter_map(|(_, row)| row.split_once(' '));
    parsed.map(|(cause, count)| (cause.to_owned(), count.parse().unwrap())).collect()
}

fn is_fifo_allowed() -> bool {
    std::thread::spawn(|| linux::set_fifo(PREEMPTING_PRIORITY).is_ok()).join().unwrap()
}

#[test]
fn each_provoked_cause_is_identified() {
    if std::env::var_os(CHILD).is_some() {
        return;
    }
    if !is_fifo_allowed() {
        taktil_tests_script::report_skip(
            "causes of misses: no right to SCHED_FIFO here; run it as root",
        );
        return;
    }
    let mut table =
        String::from("| provoked | expected | found in 10 troubled jobs |\n|---|---|---|\n");
    let mut wrong = Vec::new();
    for (provocation, name, what, expected) in ALL {
        let group = match (provocation == RtGroup).then(ThrottledGroup::new).transpose() {
            Ok(group) => group,
            Err(why) => {
                taktil_tests_script::report_skip(format_args!(
                    "misses by throttling cannot be provoked: {why}"
                ));
                table += &format!("| {what} | {expected} | not possible there: {why} |\n");
                continue;
            }
        };
        // A shared machine may take the processor away for longer than any provocation: once more.
        let mut found = ask_child(name, group.as_ref());
        let told = |found: &[(String, u64)]| {
            let most = found.iter().max_by_key(|(_, count)| *count).cloned();
            most.is_some_and(|(cause, count)| cause == expected && count * 10 >= PROVOKED_JOBS * 8)
        };
        if !told(&found) {
            println!("once more: {name}: {found:?}");
            found = ask_child(name, group.as_ref());
        }
        if !told(&found) {
            wrong.push(format!("{name}: expected {expected}, found {found:?}"));
        }
        let counts = found.iter().filter(|(_, count)| *count > 0);
        let counts: Vec<_> = counts.map(|(cause, count)| format!("{cause} {count}")).collect();
        table += &format!("| {what} | {expected} | {} |\n", counts.join(", "));
    }
    println!("{table}");
    if let Some(path) = std::env::var_os("TAKTIL_WRITE") {
        let page = include_str!("../fixtures/miss-causes.md").replace("{table}\n", &table);
        std::fs::write(taktil_tests::root().join(path), page).unwrap();
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}
