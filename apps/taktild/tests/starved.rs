//! The service on a host that has nothing left: no address space, no memory, no room on the disk, a
//! disk that does not answer. The arm behind emulated boards is held all the same, or its drives
//! are off.
//!
//! A frozen file system needs root and a loop device, a group of processes with little memory needs
//! root:
//!
//! ```sh
//! sudo -E cargo test -p taktild --test starved
//! ```

mod emulated;
mod process;

use std::io::Read;
use std::os::fd::AsRawFd;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Stdio};
use std::time::Duration;

use emulated::{Boards, Sight, hold, registers_config, served_by};
use nix::sys::signal::Signal;
use process::{Caller, Folder, Service, command};
use taktil_rtcore::Nanos;
use taktil_rtcore::linux::monotonic;
use taktil_tests_script::report_skip;

/// The test of this program that becomes the boards.
const CHILD: &str = "the_boards_of_the_other_tests";
/// Longest time in which a start that cannot succeed has to end.
const START_TIME_MAX: Nanos = Nanos::from_secs(10);
/// Address spaces that are tried (KiB): from one in which nothing starts to one that is enough.
const ADDRESS_SPACES_KIB: [u64; 9] =
    [4_000, 8_000, 16_000, 32_000, 64_000, 96_000, 128_000, 256_000, 4_000_000];
/// Size of the disk that is too small for a recording (bytes).
const SMALL_DISK_BYTES: u64 = 1 << 20;
/// How often it is tried whether the arm is held: a busy host may take the drives, too, but not
/// every time.
const HELD_TRIES_MAX: u32 = 4;
/// For how long the arm has to be held with a disk that is full or does not answer.
const HELD_TIME: Nanos = Nanos::from_secs(2);
/// Memory that a group of processes has beside what the service holds (bytes).
const SPARE_MEMORY_BYTES: u64 = 16 << 20;

#[test]
fn the_boards_of_the_other_tests() {
    emulated::serve_if_asked();
}

/// The service is told to end, and leaves the arm without torque.
fn ended(boards: &mut Boards, service: Service) -> Vec<String> {
    service.signal(Signal::SIGTERM);
    let (code, lines) = service.end();
    assert!(code.is_some(), "{lines:?}");
    assert!(lines.iter().all(|line| !line.contains("panicked")), "{lines:?}");
    assert!(boards.look_until(Sight::is_safe).is_safe());
    lines
}

/// The service's command line in a shell that prepares something first.
fn after(prologue: &str, config: &Path) -> Command {
    let service = command(config);
    let mut shell = Command::new("sh");
    shell.arg("-c").arg(format!("{prologue} && exec \"$0\" \"$@\"")).arg(service.get_program());
    shell.args(service.get_args()).stdin(Stdio::null()).env_remove("NOTIFY_SOCKET");
    shell
}

#[test]
fn a_start_without_address_space_succeeds_or_ends_and_drives_nothing() {
    let folder = Folder::new();
    let mut boards = Boards::registers(&folder, CHILD, &[]);
    let config = registers_config(&folder, "");
    let mut starts = 0;
    for kib in ADDRESS_SPACES_KIB {
        let mut child = after(&format!("ulimit -v {kib}"), &config)
            .stderr(Stdio::null())
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        let begin = monotonic();
        let mut runs = false;
        while child.try_wait().unwrap().is_none() {
            runs = folder.join("op").exists();
            let passed = monotonic() - begin;
            assert!(runs || passed < START_TIME_MAX, "{kib} KiB: neither runs nor ends");
            if runs {
                let _ = child.kill();
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        starts += u32::from(runs);
        let _ = std::fs::remove_file(folder.join("op"));
        let sight = boards.look_until(Sight::is_safe);
        assert!(sight.is_safe(), "{kib} KiB: {sight:?}");
    }
    let all = u32::try_from(ADDRESS_SPACES_KIB.len()).unwrap();
    assert!((1..all).contains(&starts), "{starts} of {all} address spaces were enough");
}

#[test]
fn a_service_whose_address_space_ends_while_it_runs_holds_the_arm_or_lets_it_go() {
    let folder = Folder::new();
    let mut boards = Boards::registers(&folder, CHILD, &[]);
    let config = registers_config(&folder, "");
    let service = served_by(&folder, command(&config));
    let mut caller = Caller::new(&folder.join("op"));
    hold(&mut boards, &mut caller);
    let id = service.child.id().to_string();
    let limited = Command::new("prlimit").args(["--pid", &id, "--as=1000000:1000000"]).status();
    if !limited.is_ok_and(|status| status.success()) {
        report_skip("there is no `prlimit` (util-linux) here");
        return;
    }
    // Threads for further clients cannot be had any more; the lanes do not ask for memory.
    for _ in 0..20 {
        let _ = std::os::unix::net::UnixStream::connect(folder.join("op"));
        std::thread::sleep(Duration::from_millis(20));
    }
    // Whoever had a connection before is still answered.
    assert!(caller.ask("state").starts_with("ok"));
    hold(&mut boards, &mut caller);
    ended(&mut boards, service);
}

/// A shell's words that run a command in mounts of its own; `None`, and why, where that is not
/// allowed.
fn own_mounts() -> Option<Vec<&'static str>> {
    let words = match taktil_rtcore::linux::is_root() {
        true => vec!["--mount"],
        false => vec!["--mount", "--user", "--map-root-user"],
    };
    let tried = Command::new("unshare").args(&words).arg("true").stderr(Stdio::null()).status();
    if tried.is_ok_and(|status| status.success()) {
        return Some(words);
    }
    report_skip("mounts of its own are not allowed to a process here (`unshare --mount`)");
    None
}

/// The service in mounts of its own, with something mounted on the folder's `disk`.
fn mounted(folder: &Folder, words: &[&str], mount: &str, config: &Path) -> Command {
    std::fs::create_dir_all(folder.join("disk")).unwrap();
    let inner = after(&format!("{mount} '{}'", folder.join("disk").display()), config);
    let mut outer = Command::new("unshare");
    outer.args(words).arg(inner.get_program()).args(inner.get_args());
    outer.stdin(Stdio::null()).env_remove("NOTIFY_SOCKET");
    outer
}

fn with_log(folder: &Folder) -> PathBuf {
    let path = folder.join("disk/run.mcap");
    registers_config(folder, &format!("[log]\npath = \"{}\"\nfree_mb = 0\n", path.display()))
}

/// Whether the drives stay on until `is_over` is true for the first time.
fn is_held_until(boards: &mut Boards, mut is_over: impl FnMut() -> bool) -> bool {
    loop {
        if !boards.look().is_enabled {
            return false;
        }
        if is_over() {
            return true;
        }
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn is_held_for(boards: &mut Boards, time: Nanos) -> bool {
    let end = monotonic() + time;
    is_held_until(boards, || monotonic() >= end)
}

#[test]
fn a_small_disk_that_is_full_ends_the_recording_and_not_the_motion() {
    let Some(words) = own_mounts() else { return };
    let held = (0..HELD_TRIES_MAX).any(|_| is_held_while_a_disk_fills(&words));
    assert!(held, "the drives went off each time that the disk became full");
}

/// The longest recording of a folder, and its length (bytes): a recording that has no room left is
/// put aside under a name with its date.
fn recorded(folder: &Path) -> Option<(u64, PathBuf)> {
    let files = std::fs::read_dir(folder).ok()?.filter_map(|entry| Some(entry.ok()?.path()));
    let logs = files.filter(|path| path.extension().is_some_and(|ending| ending == "mcap"));
    logs.filter_map(|path| Some((path.metadata().ok()?.len(), path))).max()
}

/// Whether the drives stayed on while the disk became full, and for a while afterwards.
fn is_held_while_a_disk_fills(words: &[&str]) -> bool {
    let folder = Folder::new();
    let mut boards = Boards::registers(&folder, CHILD, &[]);
    let mount = format!("mount -t tmpfs -o size={SMALL_DISK_BYTES} none");
    let config = with_log(&folder);
    let service = served_by(&folder, mounted(&folder, words, &mount, &config));
    let mut caller = Caller::new(&folder.join("op"));
    hold(&mut boards, &mut caller);
    let root = PathBuf::from(format!("/proc/{}/root", service.child.id()));
    let disk = root.join(folder.join("disk").strip_prefix("/").unwrap());
    let bytes = || recorded(&disk).map_or(0, |(bytes, _)| bytes);
    let (mut before, mut looks) = (0, 0);
    let mut is_full = || {
        looks += 1;
        assert!(looks < 2_500, "{} bytes", bytes());
        // Looked at is every tenth time, 0.2 s apart.
        let full = looks % 10 == 0 && before == bytes() && before > SMALL_DISK_BYTES / 2;
        before = if looks % 10 == 0 { bytes() } else { before };
        full
    };
    let mut held = is_held_until(&mut boards, &mut is_full);
    while !held && !is_full() {
        std::thread::sleep(Duration::from_millis(20));
    }
    held = held && is_held_for(&mut boards, HELD_TIME);
    // Whatever a busy host has done: a full disk keeps nobody from bringing the arm up again.
    hold(&mut boards, &mut caller);
    assert!(caller.ask("stop").starts_with("ok"), "{}", caller.ask("state"));
    // The file outlives the mounts of the service as long as somebody has it open.
    let file = recorded(&disk).and_then(|(_, path)| std::fs::File::open(path).ok());
    let file = file.expect("there is a recording");
    let lines = ended(&mut boards, service);
    let read = taktil_record::Log::open(format!("/proc/self/fd/{}", file.as_raw_fd()).as_ref());
    let read = read.unwrap_or_else(|error| panic!("the log of a full disk: {error:#}"));
    assert!(read.messages().count() > 100, "what was written before is read");
    let told = |line: &String| line.contains("recording") || line.contains("log");
    assert!(lines.iter().any(told), "{lines:?}");
    held
}

/// A disk in a file, frozen in the mounts of another process, and thawed at the end.
struct Frozen {
    process: String,
    folder: String,
}

impl Frozen {
    fn act(&self, what: &str) -> bool {
        let mut command = Command::new("nsenter");
        command.args(["--target", &self.process, "--mount", "fsfreeze", what, &self.folder]);
        command.status().is_ok_and(|status| status.success())
    }
}

impl Drop for Frozen {
    fn drop(&mut self) {
        self.act("--unfreeze");
    }
}

#[test]
fn a_frozen_file_system_costs_records_and_neither_the_arm_nor_a_stop() {
    let folder = Folder::new();
    let image = folder.join("disk.img");
    std::fs::File::create(&image).unwrap().set_len(32 << 20).unwrap();
    let made = Command::new("mkfs.ext4").arg("-q").arg(&image).stderr(Stdio::null()).status();
    let root = taktil_rtcore::linux::is_root();
    if !root || !made.is_ok_and(|status| status.success()) {
        report_skip("a frozen file system needs root, a loop device and mkfs.ext4");
        return;
    }
    let mount = format!("mount -o loop '{}'", image.display());
    let words = ["--mount"];
    let tried = mounted(&folder, &words, &mount, Path::new("-"));
    let tried = Command::new("unshare")
        .args(["--mount", "sh", "-c"])
        .arg(format!("{mount} '{}'", folder.join("disk").display()))
        .stderr(Stdio::null())
        .status()
        .map(|status| (status, tried));
    if !tried.is_ok_and(|(status, _)| status.success()) {
        report_skip("this host mounts no file (loop device)");
        return;
    }
    let mut boards = Boards::registers(&folder, CHILD, &[]);
    let config = with_log(&folder);
    let service = served_by(&folder, mounted(&folder, &words, &mount, &config));
    let mut caller = Caller::new(&folder.join("op"));
    hold(&mut boards, &mut caller);
    let disk = folder.join("disk").display().to_string();
    let process = service.child.id().to_string();
    let freeze = || {
        let frozen = Frozen { process: process.clone(), folder: disk.clone() };
        assert!(frozen.act("--freeze"), "the disk is not frozen");
        frozen
    };
    let held = (0..HELD_TRIES_MAX).any(|_| {
        hold(&mut boards, &mut caller);
        let _frozen = freeze();
        is_held_for(&mut boards, HELD_TIME)
    });
    assert!(held, "the drives went off each time that the disk was frozen");
    let frozen = freeze();
    hold(&mut boards, &mut caller);
    assert!(caller.ask("stop").starts_with("ok"), "{}", caller.ask("state"));
    service.signal(Signal::SIGTERM);
    assert!(boards.look_until(Sight::is_safe).is_safe(), "the end waits for no disk");
    drop(frozen);
    let (code, lines) = service.end();
    assert!(code.is_some() && lines.iter().all(|line| !line.contains("panicked")), "{lines:?}");
}

/// A group of processes of its own (cgroups(7)), with a limit for their memory; removed at the end.
struct MemoryGroup {
    folder: PathBuf,
    limit: &'static str,
    usage: &'static str,
}

impl MemoryGroup {
    /// A group below this process's own; `None` where that is not allowed, or no memory is counted.
    fn new(name: &str) -> Option<MemoryGroup> {
        let groups = std::fs::read_to_string("/proc/self/cgroup").ok()?;
        let own = |start: &str| {
            groups.lines().find_map(|line| {
                let (_, rest) = line.split_once(':')?;
                rest.strip_prefix(start)
            })
        };
        let first = own("memory:").map(|path| MemoryGroup {
            folder: PathBuf::from(format!("/sys/fs/cgroup/memory{path}")).join(name),
            limit: "memory.limit_in_bytes",
            usage: "memory.usage_in_bytes",
        });
        let second = own(":").map(|path| MemoryGroup {
            folder: PathBuf::from(format!("/sys/fs/cgroup{path}")).join(name),
            limit: "memory.max",
            usage: "memory.current",
        });
        [first, second].into_iter().flatten().find(|group| {
            std::fs::create_dir(&group.folder).is_ok() && group.folder.join(group.limit).exists()
        })
    }

    /// The words of a shell by which it becomes one of the group.
    fn joined(&self) -> String {
        format!("echo $$ >'{}'", self.folder.join("cgroup.procs").display())
    }

    fn usage_bytes(&self) -> u64 {
        let text = std::fs::read_to_string(self.folder.join(self.usage)).unwrap();
        text.trim().parse().unwrap()
    }

    fn set_limit_bytes(&self, bytes: u64) {
        std::fs::write(self.folder.join(self.limit), bytes.to_string()).unwrap();
    }
}

impl Drop for MemoryGroup {
    fn drop(&mut self) {
        // The last process may not be gone yet.
        for _ in 0..100 {
            if std::fs::remove_dir(&self.folder).is_ok() {
                break;
            }
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

/// A process of the group that asks for more and more memory, until it is ended by the kernel.
fn greedy(group: &MemoryGroup) -> ExitStatus {
    // The kernel prefers it to the service, as it does beside the service's unit.
    let last = "echo 1000 >/proc/self/oom_score_adj && exec tail /dev/zero";
    let line = format!("{} && {last}", group.joined());
    let mut child = Command::new("sh").arg("-c").arg(line).stderr(Stdio::piped()).spawn().unwrap();
    let mut said = String::new();
    let _ = child.stderr.take().unwrap().read_to_string(&mut said);
    child.wait().unwrap()
}

#[test]
fn a_neighbour_that_takes_all_memory_of_their_group_takes_nothing_from_the_arm() {
    let folder = Folder::new();
    let group = MemoryGroup::new(&format!("taktild-{}", std::process::id()));
    let (true, Some(group)) = (taktil_rtcore::linux::is_root(), group) else {
        report_skip(
            "a group of processes with little memory needs root and memory that is counted",
        );
        return;
    };
    let mut boards = Boards::registers(&folder, CHILD, &[]);
    let config = registers_config(&folder, "");
    let service = served_by(&folder, after(&group.joined(), &config));
    let mut caller = Caller::new(&folder.join("op"));
    hold(&mut boards, &mut caller);
    group.set_limit_bytes(group.usage_bytes() + SPARE_MEMORY_BYTES);
    let held = (0..HELD_TRIES_MAX).any(|_| {
        hold(&mut boards, &mut caller);
        let ended = greedy(&group);
        assert!(!ended.success(), "the memory of the group has no end: {ended}");
        is_held_for(&mut boards, HELD_TIME)
    });
    assert!(held, "the drives went off each time that there was no memory");
    assert!(caller.ask("stop").starts_with("ok"), "{}", caller.ask("state"));
    ended(&mut boards, service);
}
