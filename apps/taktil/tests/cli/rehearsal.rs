//! A rehearsal on the simulated robot as a process of this kernel: stopped, killed, without address
//! space, on a disk that is too small.

use std::process::{Command, Stdio};
use std::time::Duration;

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use taktil_record::Log;
use taktil_rtcore::Nanos;
use taktil_rtcore::linux::monotonic;

use crate::process::{Folder, ProcessOutput, Running, TAKTIL, scenes};
use crate::tell::{joints, listening, stands, tell};

/// How far a joint may go on after the process was held (deg): what it does within the tenth of a
/// second in which keys count as held, at its largest speed.
const COASTING_DEG: f64 = 20.0;
/// Longest time that a process without memory may take to say so.
const START_TIME_MAX: Nanos = Nanos::from_secs(30);
/// Address spaces that are tried (KiB).
const ADDRESS_SPACES_KIB: [u64; 7] = [4_000, 8_000, 16_000, 32_000, 64_000, 128_000, 4_000_000];

fn signal(running: &Running, signal: Signal) {
    kill(Pid::from_raw(i32::try_from(running.0.id()).unwrap()), signal).unwrap();
}

/// Somebody who keeps joint 5 moving, once it moves.
fn jogging(folder: &Folder) -> Running {
    for _ in 0..20 {
        tell(folder, &["reset"]);
        tell(folder, &["enable"]);
        tell(folder, &["manual_joint"]);
        let before = joints(folder)[4];
        let mut command = Command::new(TAKTIL);
        command.args(["tell", "--at", "op", "--for", "30", "jog", "joints"]);
        command.args(["0", "0", "0", "0", "0.3", "0"]).current_dir(folder.path());
        command.stdout(Stdio::null()).stderr(Stdio::null());
        let hand = Running(command.spawn().unwrap());
        for _ in 0..100 {
            std::thread::sleep(Duration::from_millis(20));
            if (joints(folder)[4] - before).abs() > 0.3 {
                return hand;
            }
        }
    }
    panic!("the arm does not move: {}", tell(folder, &["state"]).out);
}

#[test]
fn a_rehearsal_that_is_stopped_in_motion_answers_and_stands_when_it_goes_on() {
    let folder = Folder::new();
    let running = listening(&folder, "hold.toml");
    let hand = jogging(&folder);
    signal(&running, Signal::SIGSTOP);
    drop(hand);
    std::thread::sleep(Duration::from_millis(1_500));
    signal(&running, Signal::SIGCONT);
    let before = joints(&folder)[4];
    assert!((0..20).any(|_| stands(&folder)), "{}", tell(&folder, &["state"]).out);
    let after = joints(&folder)[4];
    assert!((after - before).abs() < COASTING_DEG, "{before} {after}");
    let hand = jogging(&folder);
    drop(hand);
    let mut running = running;
    signal(&running, Signal::SIGINT);
    assert_eq!(running.wait().code(), Some(0));
}

#[test]
fn the_log_of_a_rehearsal_that_is_killed_is_read_and_the_next_one_starts() {
    let folder = Folder::new();
    let scene = scenes().join("hold.toml").display().to_string();
    let words = ["run", &scene, "--for", "60", "--operator", "op", "--log", "run.mcap"];
    let mut command = Command::new(TAKTIL);
    command.args(words).current_dir(folder.path()).stdout(Stdio::null()).stderr(Stdio::null());
    let mut running = Running(command.spawn().unwrap());
    let grown = (0..1_500).any(|_| {
        std::thread::sleep(Duration::from_millis(20));
        std::fs::metadata(folder.join("run.mcap")).is_ok_and(|about| about.len() > 400_000)
    });
    assert!(grown, "nothing is recorded");
    signal(&running, Signal::SIGKILL);
    assert_eq!(running.wait().code(), None);
    let log = Log::open(&folder.join("run.mcap")).unwrap();
    assert!(log.damage().is_some() && log.messages().count() > 1_000);
    let words = ["run", &scene, "--for", "0.2", "--operator", "op"];
    crate::process::taktil(folder.path(), &words).expect_code(0);
}

#[test]
fn a_rehearsal_without_address_space_ends_in_time() {
    let folder = Folder::new();
    let scene = scenes().join("roll-pin.toml").display().to_string();
    let mut complete = 0;
    for kib in ADDRESS_SPACES_KIB {
        let shell = format!("ulimit -v {kib} && exec \"$0\" run \"$1\" --fast --for 0.2");
        let mut command = Command::new("sh");
        command.args(["-c", &shell, TAKTIL, &scene]).current_dir(folder.path());
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        let mut running = Running(command.spawn().unwrap());
        let begin = monotonic();
        complete += u32::from(running.wait().success());
        let took = monotonic() - begin;
        assert!(took < START_TIME_MAX, "{kib} KiB took {took}");
    }
    assert!((1..ADDRESS_SPACES_KIB.len() as u32).contains(&complete), "{complete} were enough");
}

#[test]
fn a_small_disk_that_is_full_costs_the_end_of_the_log_and_not_the_run() {
    let folder = Folder::new();
    std::fs::create_dir(folder.join("disk")).unwrap();
    let mut words = vec!["--mount"];
    if !nix::unistd::Uid::effective().is_root() {
        words.extend(["--user", "--map-root-user"]);
    }
    let mount = "mount -t tmpfs -o size=1m none disk";
    let mut trial = Command::new("unshare");
    trial.args(&words).args(["sh", "-c", mount]).current_dir(folder.path());
    if !trial.stderr(Stdio::null()).status().is_ok_and(|status| status.success()) {
        let why = "mounts of its own are not allowed to a process here (`unshare --mount`)";
        taktil_tests_script::report_skip(why);
        return;
    }
    let scene = scenes().join("roll-pin.toml").display().to_string();
    let shell = format!(
        "{mount} && \"$0\" run \"$1\" --fast --for 4 --log disk/run.mcap; code=$?; \
         cp disk/run.mcap kept.mcap; exit $code"
    );
    let mut command = Command::new("unshare");
    command.args(&words).args(["sh", "-c", &shell, TAKTIL, &scene]);
    let output = command.current_dir(folder.path()).stdin(Stdio::null()).output().unwrap();
    let said = ProcessOutput::of(&output).expect_code(1);
    assert!(said.err.contains("disk/run.mcap is incomplete: "), "{}", said.err);
    assert!(said.out.contains("digest"), "{}", said.out);
    let log = Log::open(&folder.join("kept.mcap")).unwrap();
    assert!(log.damage().is_some() && log.messages().count() > 100);
}
