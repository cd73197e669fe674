//! The service under systemd: configuration errors with their place, `--check`, readiness and
//! watchdog, the end by SIGTERM and by SIGKILL, and the content of the board's registers
//! afterwards. The board's model only loops outputs back; it simulates no robot.

mod process;

use nix::sys::signal::Signal;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use taktil_drivers_regmap::registers::{
    DAC, DAC_STROBE, DIGITAL_OUT, OUT_BRAKE_RELEASE, OUT_ENABLE, OUT_WATCHDOG_FEED, WATCHDOG_MS,
};
use taktil_hal::{CHANNELS, DacCode};
use taktil_machine::operator::RemoteOperator;
use taktil_tests_script::Hanging;

use process::{
    CHILD_CONFIGURATION_VARIABLE, DRIVING_CODE, Folder, NO_FLIGHT, Rig, Service, ZERO_VOLTS, check,
    command,
};

#[test]
fn check_prints_what_would_run_and_leaves_the_board_safe() {
    let folder = Folder::new();
    let rig = Rig::new(&folder);
    let output = check(&folder.config("hard"));
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(text.starts_with("analog_in: device board\n"), "{text}");
    for word in
        ["lane servo: every 2500 us, priority 80: operator > sense", "lane touch: every 5 ms"]
    {
        assert!(text.contains(word), "not `{word}` in\n{text}");
    }
    for word in ["deadline 2500 us: meets", "contract fifo (hard): ", "contract governor (soft): "]
    {
        assert!(text.contains(word), "not `{word}` in\n{text}");
    }
    let (start, refused) = (text.contains("it would start\n"), text.contains("would be refused"));
    assert!(start != refused, "{text}");
    rig.assert_registers_are_safe();
}

/// Reads the registers continuously; counts how often they were unsafe after they had been safe.
fn unsafe_words(rig: &Rig, stop: &AtomicBool) -> u64 {
    let (mut armed, mut unsafe_seen) = (false, 0);
    loop {
        // The registers are read once more after the request to stop, however late this thread ran.
        let last = stop.load(Ordering::SeqCst);
        let lines = rig.registers.read(DIGITAL_OUT) & (OUT_ENABLE | OUT_BRAKE_RELEASE);
        let safe = lines == 0 && rig.words().iter().all(|word| *word == ZERO_VOLTS);
        unsafe_seen += u64::from(armed && !safe);
        armed |= safe;
        if last {
            break;
        }
    }
    assert!(armed, "it was never safe");
    unsafe_seen
}

#[test]
fn an_item_that_is_hard_and_missing_is_refused_before_any_output_is_armed() {
    let folder = Folder::new();
    let rig = Rig::new(&folder);
    let config = folder.config_with(
        "contract = { fifo = \"none\", rttime = \"hard\", memory = \"none\", \
         preempt_rt = \"none\" }",
        NO_FLIGHT,
    );
    // A limit that any process may set for itself, so that the item is missing on every host.
    let mut limited = Command::new("prlimit");
    limited.args(["--rttime=10000000:10000000", env!("CARGO_BIN_EXE_taktild"), "--allow-root"]);
    limited.arg("--config").arg(&config).env_remove("NOTIFY_SOCKET");
    let (stop, strobe) = (AtomicBool::new(false), rig.registers.read(DAC_STROBE));
    let (output, seen) = std::thread::scope(|scope| {
        let watcher = scope.spawn(|| unsafe_words(&rig, &stop));
        let output = limited.output();
        stop.store(true, Ordering::SeqCst);
        (output, watcher.join())
    });
    let Ok(output) = output else {
        taktil_tests_script::report_skip("there is no `prlimit` (util-linux) here");
        return;
    };
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{text}");
    for word in ["no output was armed", "rttime: a lane that computes for 10000000 us is killed"] {
        assert!(text.contains(word), "not `{word}` in\n{text}");
    }
    assert!(text.contains("wanted RLIMIT_RTTIME = unlimited; LimitRTTIME=infinity"), "{text}");
    assert!(!text.contains("fifo: "), "{text}");
    assert_eq!(seen.unwrap(), 0, "a word that drives was written");
    let writes = rig.registers.read(DAC_STROBE).wrapping_sub(strobe);
    assert!(writes < 16, "{writes} writes: jobs have run");
    rig.assert_registers_are_safe();
}

#[test]
fn boards_are_not_driven_without_preempt_rt_unless_the_configuration_says_so() {
    if std::fs::read_to_string("/proc/version").unwrap().contains("PREEMPT_RT") {
        taktil_tests_script::report_skip("this kernel has PREEMPT_RT");
        return;
    }
    let folder = Folder::new();
    let rig = Rig::new(&folder);
    let rest = "fifo = \"none\", memory = \"none\"";
    let silent = folder.config_with(&format!("contract = {{ {rest} }}"), NO_FLIGHT);
    let output = command(&silent).output().unwrap();
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{text}");
    for word in ["no output was armed", "preempt_rt: the kernel is built without PREEMPT_RT"] {
        assert!(text.contains(word), "not `{word}` in\n{text}");
    }
    assert!(text.contains("say preempt_rt = \"soft\" aloud"), "{text}");
    rig.assert_registers_are_safe();
    let checked = String::from_utf8_lossy(&check(&folder.config("hard")).stdout).into_owned();
    assert!(checked.contains("contract preempt_rt (hard): the kernel is built"), "{checked}");
    assert!(checked.contains("would be refused"), "{checked}");
    let aloud = format!("contract = {{ {rest}, preempt_rt = \"soft\" }}");
    let service = Service::start(&folder, &folder.config_with(&aloud, NO_FLIGHT));
    service.wait_for_message("READY=1");
}

#[test]
fn it_says_ready_feeds_the_watchdog_and_ends_safe_on_sigterm() {
    let folder = Folder::new();
    let mut rig = Rig::new(&folder);
    let service = Service::start(&folder, &folder.config("soft"));
    service.wait_for_message("READY=1");
    for _ in 0..5 {
        service.wait_for_message("WATCHDOG=1");
    }
    assert_ne!(rig.registers.read(WATCHDOG_MS), 0, "the board's own watchdog is not set");
    service.signal(Signal::SIGTERM);
    service.wait_for_message("STOPPING=1");
    let (code, lines) = service.end();
    assert_eq!(code, Some(0), "{lines:?}");
    assert!(lines.iter().any(|line| line.starts_with("lane servo: ")), "{lines:?}");
    assert!(lines.iter().all(|line| !line.contains("panicked")), "{lines:?}");
    rig.assert_registers_are_safe();
    let model = rig.stop().unwrap();
    assert_eq!(model.dac_codes(), [DacCode(0); CHANNELS]);
    assert!(!model.lines_out().enable && !model.lines_out().brake_release);
}

#[test]
fn it_drives_the_registers_while_it_lives_and_comes_up_with_the_drives_off() {
    let folder = Folder::new();
    let rig = Rig::new(&folder);
    let service = Service::start(&folder, &folder.config("soft"));
    service.wait_for_message("WATCHDOG=1");
    rig.assert_registers_are_safe();
    let strobe = || rig.registers.read(DAC_STROBE);
    let feed = || rig.registers.read(DIGITAL_OUT) & OUT_WATCHDOG_FEED;
    let (strobe_before, feed_before) = (strobe(), feed());
    let soon = |changed: &dyn Fn() -> bool| {
        (0..20_000).any(|_| {
            std::thread::sleep(Duration::from_micros(500));
            changed()
        })
    };
    assert!(soon(&|| strobe() != strobe_before), "the D/A words are not refreshed");
    assert!(soon(&|| feed() != feed_before), "the feed line does not change");
}

#[test]
fn the_board_becomes_safe_after_the_service_was_killed() {
    // Nothing can be written after SIGKILL: the board's own watchdog, which the service has set,
    // makes the outputs safe. The model does the same as the board.
    let folder = Folder::new();
    let mut rig = Rig::new(&folder);
    let service = Service::start(&folder, &folder.config("soft"));
    service.wait_for_message("WATCHDOG=1");
    service.signal(Signal::SIGKILL);
    let (code, _) = service.end();
    assert_eq!(code, None, "it was killed, it did not exit");
    let strobe = rig.registers.read(DAC_STROBE);
    // The registers hold the words of a driving board.
    for register in DAC.iter() {
        rig.registers.write(register, DRIVING_CODE);
    }
    let feed = rig.registers.read(DIGITAL_OUT) & OUT_WATCHDOG_FEED;
    rig.registers.write(DIGITAL_OUT, feed | OUT_ENABLE | OUT_BRAKE_RELEASE);
    let silence = rig.registers.read(WATCHDOG_MS);
    assert!((1..=100).contains(&silence), "{silence} ms");
    let model = rig.wait_until_silent();
    assert_eq!(rig.registers.read(DAC_STROBE), strobe, "somebody still writes");
    assert_eq!(model.dac_codes(), [DacCode(0); CHANNELS]);
    assert!(!model.lines_out().enable && !model.lines_out().brake_release);
}

#[test]
fn a_service_that_is_stopped_for_a_while_drives_nothing_when_it_goes_on() {
    // SIGSTOP holds all threads at once, as a virtual machine that is paused: nothing can be
    // written meanwhile, and the board's own watchdog makes the outputs safe.
    let folder = Folder::new();
    let rig = Rig::new(&folder);
    let service = Service::start(&folder, &folder.config("soft"));
    service.wait_for_message("WATCHDOG=1");
    service.signal(Signal::SIGSTOP);
    let silence = u64::from(rig.registers.read(WATCHDOG_MS));
    assert!((1..=100).contains(&silence), "{silence} ms");
    std::thread::sleep(Duration::from_millis(3 * silence + 200));
    let strobe = rig.registers.read(DAC_STROBE);
    let feed = rig.registers.read(DIGITAL_OUT) & OUT_WATCHDOG_FEED;
    std::thread::sleep(Duration::from_millis(100));
    assert_eq!(rig.registers.read(DAC_STROBE), strobe, "somebody still writes");
    assert_eq!(rig.registers.read(DIGITAL_OUT) & OUT_WATCHDOG_FEED, feed, "somebody still feeds");
    service.signal(Signal::SIGCONT);
    let goes_on = (0..20_000).any(|_| {
        std::thread::sleep(Duration::from_micros(500));
        rig.registers.read(DAC_STROBE) != strobe
    });
    assert!(goes_on, "it does not write again");
    for _ in 0..3 {
        service.wait_for_message("WATCHDOG=1");
        rig.assert_registers_are_safe();
    }
    service.signal(Signal::SIGTERM);
    let (code, lines) = service.end();
    assert_eq!(code, Some(0), "{lines:?}");
    assert!(lines.iter().any(|line| line.starts_with("lane servo: ")), "{lines:?}");
    rig.assert_registers_are_safe();
}

#[test]
fn root_is_refused_unless_it_insists() {
    let folder = Folder::new();
    let rig = Rig::new(&folder);
    let config = folder.config("soft");
    let root = taktil_rtcore::linux::is_root();
    let mut command = if root {
        Command::new(env!("CARGO_BIN_EXE_taktild"))
    } else {
        // To its own process, a user who is alone in a name space is root.
        let mut command = Command::new("unshare");
        command.args(["--user", "--map-root-user", env!("CARGO_BIN_EXE_taktild")]);
        command
    };
    let output = command.arg("--config").arg(&config).stdin(Stdio::null()).output();
    let text = output.as_ref().map(|output| String::from_utf8_lossy(&output.stderr).into_owned());
    let text = text.unwrap_or_else(|error| format!("unshare: {error}"));
    if !root && text.starts_with("unshare: ") {
        taktil_tests_script::report_skip("a user cannot be made root of a name space here");
        return;
    }
    assert_eq!(output.unwrap().status.code(), Some(2), "{text}");
    assert!(text.contains("does not run as root") && text.contains("--allow-root"), "{text}");
    rig.assert_registers_are_safe();
}

#[test]
fn a_second_service_is_refused_the_board() {
    let folder = Folder::new();
    let _rig = Rig::new(&folder);
    let config = folder.config("soft");
    let service = Service::start(&folder, &config);
    service.wait_for_message("READY=1");
    let output = check(&config);
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{text}");
    assert!(text.contains("another process drives this board"), "{text}");
}

#[test]
fn a_configuration_that_cannot_be_used_ends_with_2_and_its_place() {
    let folder = Folder::new();
    let _rig = Rig::new(&folder);
    let path = folder.config("soft");
    let good = std::fs::read_to_string(&path).unwrap();
    assert_eq!(check(&path).status.code(), Some(0));
    for (from, to, says, line) in [
        ("contract", "contrakt", "unknown field `contrakt`", 2),
        ("\"soft\"", "\"firm\"", "unknown variant `firm`", 2),
        ("[board]\npath", "[board]\njoints = 9\npath", "board.joints: 9", 5),
        ("[board]\npath", "[board]\nwatchdog_ms = 0\npath", "board.watchdog_ms: 0", 5),
        ("[board]\npath", "[board]\ndac_bits = 16\npath", "nothing says what a code is worth", 4),
        ("board.bin", "nothing.bin", "board.path", 5),
        ("puma260.toml", "puma999.toml", "machine: there is no file", 1),
        ("[board]", "[robot.sense]\nspeed = 1\n[board]", "unknown field `speed`", 5),
        (
            "[board]",
            "[robot.joint_servo]\nderivative_filter_hz = nan\n[board]",
            "robot.joint_servo.derivative_filter_hz: NaN",
            5,
        ),
    ] {
        assert_eq!(good.matches(from).count(), 1, "`{from}` is not unique");
        std::fs::write(&path, good.replacen(from, to, 1)).unwrap();
        let output = check(&path);
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{to}\n{text}");
        assert!(text.contains(says), "not `{says}` in\n{text}");
        assert!(text.contains(&format!("--> {}:{line}:", path.display())), "line {line}:\n{text}");
        assert!(!text.contains("panicked"), "{text}");
    }
    let output = check(&folder.join("nowhere.toml"));
    assert_eq!(output.status.code(), Some(2));
}

#[test]
fn the_service_whose_operator_hangs() {
    let Some(config) = std::env::var_os(CHILD_CONFIGURATION_VARIABLE) else {
        println!("nothing to do: this is the child of another test");
        return;
    };
    let service = taktil_machine_service::service::Service::with_operator(
        Path::new(&config),
        Box::new(|ports| {
            Ok(Box::new(Hanging { until_then: RemoteOperator::new(None, ports), tick: 200 }))
        }),
    );
    let ended = service.unwrap().run();
    panic!("it cannot end by itself: {ended:?}");
}

#[test]
fn a_task_that_does_not_return_is_named_and_ends_the_service_and_the_board_is_safe() {
    let folder = Folder::new();
    let mut rig = Rig::new(&folder);
    let service = Service::start_hanging(&folder, &folder.config("soft"));
    service.wait_for_message("WATCHDOG=1");
    service.wait_for_message("STATUS=task `operator` in lane servo does not return");
    // The lane that hangs holds the outputs. Nothing feeds the watchdog any more, so the board's
    // watchdog acts.
    let strobe = rig.registers.read(DAC_STROBE);
    for register in DAC.iter() {
        rig.registers.write(register, DRIVING_CODE);
    }
    let (code, lines) = service.end();
    assert_eq!(code, Some(taktil_machine_service::service::EXIT_HUNG), "{lines:?}");
    assert!(lines.iter().any(|line| line.contains("task `operator` in lane servo")), "{lines:?}");
    assert_eq!(rig.registers.read(DAC_STROBE), strobe, "somebody still writes");
    let model = rig.wait_until_silent();
    assert_eq!(model.dac_codes(), [DacCode(0); CHANNELS]);
    assert!(!model.lines_out().enable && !model.lines_out().brake_release);
}

#[test]
fn the_flight_recorder_outlives_a_killed_service() {
    let folder = Folder::new();
    let _rig = Rig::new(&folder);
    let memory = PathBuf::from(format!("/dev/shm/taktild-test-{}.flight", std::process::id()));
    let previous = memory.with_extension("flight.previous");
    let flight = format!("\n[flight]\npath = \"{}\"\nseconds = 2\n", memory.display());
    let config = folder.config_with("contract = \"soft\"", &flight);
    let mut ticks = Vec::new();
    for _ in 0..2 {
        let sockets = Folder::new();
        let service = Service::start(&sockets, &config);
        for _ in 0..5 {
            service.wait_for_message("WATCHDOG=1");
        }
        service.signal(Signal::SIGKILL);
        service.end();
        let found = taktil_rtcore::flight::read(&std::fs::read(&memory).unwrap()).unwrap();
        assert!(found.about.contains("machine_text") && found.granted.contains("zero_unix_ns"));
        assert_eq!(found.lanes.len(), 2);
        for lane in &found.lanes {
            let last = lane.records().next_back().expect("the lane ran").tick;
            assert_eq!(lane.damage, None);
            // The recorded job is the last one, or the one before it when the service was killed
            // within a job.
            assert!(lane.tick >= last, "{} and {last}", lane.tick);
        }
        ticks.push(found.lanes[0].tick);
    }
    assert!(ticks.iter().all(|tick| *tick > 100), "half a second at 400 Hz: {ticks:?}");
    assert!(taktil_rtcore::flight::read(&std::fs::read(&previous).unwrap()).is_ok());
    std::fs::write(&memory, "somebody's notes").unwrap();
    let output = command(&config).output().unwrap();
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{text}");
    assert!(text.contains("flight.path: ") && text.contains("is no flight recording"), "{text}");
    std::fs::remove_file(&memory).unwrap();
    std::fs::remove_file(&previous).unwrap();
    let disk = flight.replace("/dev/shm/", "/proc/");
    let config = folder.config_with("contract = \"soft\"", &disk);
    let output = command(&config).output().unwrap();
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(text.contains("writes back to a disk"), "{text}");
    assert!(text.contains("name a file in /run or /dev/shm"), "{text}");
}
