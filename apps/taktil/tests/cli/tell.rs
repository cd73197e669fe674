//! An operator of a running machine: commands through the socket, typed moves, errors in words, and
//! the rights on the socket. The machines run live.

use std::io::{BufRead as _, Write};
use std::process::{Child, Command, Stdio};

use crate::process::{Folder, ProcessOutput, Running, TAKTIL, scenes, taktil};

/// A live run with an operator's socket `op` in the folder, once it accepts connections.
pub(crate) fn listening(folder: &Folder, scene: &str) -> Running {
    let mut command = Command::new(TAKTIL);
    command.arg("run").arg(scenes().join(scene)).args(["--for", "600", "--operator", "op"]);
    let child = command.current_dir(folder.path()).stdout(Stdio::null()).stderr(Stdio::null());
    let running = Running(child.spawn().unwrap());
    for _ in 0..1500 {
        if taktil(folder.path(), &["tell", "--at", "op", "state"]).out.contains("IDLE/CALIBRATED") {
            return running;
        }
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    panic!("the machine does not get to IDLE/CALIBRATED");
}

pub(crate) fn tell(folder: &Folder, words: &[&str]) -> ProcessOutput {
    let arguments: Vec<&str> = ["tell", "--at", "op"].iter().chain(words).copied().collect();
    taktil(folder.path(), &arguments)
}

fn type_in(folder: &Folder, options: &[&str], words: &str) -> ProcessOutput {
    let mut arguments = vec!["move", "--at", "op"];
    arguments.extend(options);
    arguments.extend(words.split(' '));
    taktil(folder.path(), &arguments)
}

/// Sends a script through standard input.
fn script(folder: &Folder, lines: &str) -> ProcessOutput {
    let mut command = Command::new(TAKTIL);
    command.args(["tell", "--at", "op"]).current_dir(folder.path());
    command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child: Child = command.spawn().unwrap();
    child.stdin.take().unwrap().write_all(lines.as_bytes()).unwrap();
    ProcessOutput::of(&child.wait_with_output().unwrap())
}

#[test]
fn moves_are_typed_to_a_running_machine_and_refusals_say_why() {
    let folder = Folder::new();
    let _running = listening(&folder, "hold.toml");
    // This command is not allowed in this state.
    let early = type_in(&folder, &[], "by 0 0 -5").expect_code(1);
    assert!(early.err.contains("refused: moves are taken in TRAJECTORY/USER"), "{}", early.err);
    assert!(early.err.contains("IDLE/CALIBRATED (mode HOLD)"), "{}", early.err);
    let wrong = tell(&folder, &["calibrate"]).expect_code(1);
    assert!(wrong.err.contains("refused: calibrate is not possible in IDLE/CALIBRATED"));
    // These moves are typed, joined and waited for.
    let granted = tell(&folder, &["trajectory_user"]).expect_code(0);
    assert!(granted.out.starts_with("ok TRAJECTORY/USER (mode MOVING)"), "{}", granted.out);
    let found = type_in(&folder, &[], "by 0 0 -20 straight").expect_code(0);
    assert!(found.out.contains("of its torque"), "{}", found.out);
    let done = type_in(&folder, &["--wait"], "by 10 0 0 straight in 1").expect_code(0);
    assert!(done.out.contains("; at rest"), "{}", done.out);
    // The first is refused by the check of the whole move, the second by the reach, the third by
    // the grammar.
    let far = type_in(&folder, &[], "by 0 0 -400 straight").expect_code(1);
    assert!(far.err.contains("refused: out of reach"), "{}", far.err);
    let limit = type_in(&folder, &[], "joint 400 0 0 0 0 0").expect_code(1);
    assert!(limit.err.contains("outside the limits of joint 1"), "{}", limit.err);
    let fast = type_in(&folder, &[], "by 130 0 0 straight in 0.2").expect_code(1);
    assert!(fast.err.contains("refused: joint ") && fast.err.contains(" s on"), "{}", fast.err);
    let words = tell(&folder, &["fly"]).expect_code(1);
    assert!(words.err.contains("no word `fly`") && words.err.contains("trajectory_user"));
    // A script stops at the first refused line.
    let lines =
        "# up and back\nmove by 0 0 -10 straight\npause\nresume\nwait\nmove by 0 0 9999\nidle\n";
    let stopped = script(&folder, lines).expect_code(1);
    assert_eq!(stopped.out.lines().count(), 4, "{}", stopped.out);
    assert!(stopped.err.contains("9999"), "{}", stopped.err);
    let still = tell(&folder, &["state"]).expect_code(0);
    assert!(still.out.contains("TRAJECTORY/USER"), "idle was not said: {}", still.out);
    script(&folder, "clear\nidle\nmanual_joint\njog joints 0 0 0 0 1 0\nrelease\nidle\n")
        .expect_code(0);
}

#[test]
fn a_socket_in_use_a_file_and_virtual_time_are_rejected() {
    let folder = Folder::new();
    let alone = tell(&folder, &["state"]).expect_code(2);
    assert!(alone.err.contains("nobody listens at `op`"), "{}", alone.err);
    let _running = listening(&folder, "hold.toml");
    let hold = scenes().join("hold.toml");
    let hold = hold.to_str().unwrap();
    let second = taktil(folder.path(), &["run", hold, "--operator", "op"]).expect_code(2);
    assert!(second.err.contains("somebody listens at `op` already"), "{}", second.err);
    folder.write("file", "precious");
    let over = taktil(folder.path(), &["run", hold, "--operator", "file"]).expect_code(2);
    assert!(over.err.contains("is there and no socket"), "{}", over.err);
    let fast = taktil(folder.path(), &["run", hold, "--fast", "--operator", "x"]).expect_code(2);
    assert!(fast.err.contains("virtual time does not wait"), "{}", fast.err);
    let far = "d".repeat(200);
    let long = taktil(folder.path(), &["run", hold, "--operator", &far]).expect_code(2);
    assert!(long.err.contains("cannot listen"), "{}", long.err);
}

#[test]
fn the_socket_goes_with_its_run_and_one_of_a_killed_run_is_no_obstacle() {
    let folder = Folder::new();
    let mut running = listening(&folder, "hold.toml");
    running.0.kill().unwrap();
    running.wait();
    assert!(folder.join("op").exists(), "nobody could remove it");
    let again = listening(&folder, "hold.toml");
    let id = nix::unistd::Pid::from_raw(i32::try_from(again.0.id()).unwrap());
    nix::sys::signal::kill(id, nix::sys::signal::Signal::SIGINT).unwrap();
    let mut again = again;
    assert_eq!(again.wait().code(), Some(0));
    assert!(!folder.join("op").exists());
}

/// Sends characters to `taktil keys --stdin`.
fn type_keys(folder: &Folder, characters: &str) -> ProcessOutput {
    let mut command = Command::new(TAKTIL);
    command.args(["keys", "--at", "op", "--stdin"]).current_dir(folder.path());
    command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child: Child = command.spawn().unwrap();
    child.stdin.take().unwrap().write_all(characters.as_bytes()).unwrap();
    ProcessOutput::of(&child.wait_with_output().unwrap())
}

/// The desired joint angles of the machine, deg.
pub(crate) fn joints(folder: &Folder) -> Vec<f64> {
    let said = tell(folder, &["state"]).expect_code(0).out;
    let words = said.split("joints ").nth(1).unwrap().split(" deg").next().unwrap();
    words.split(' ').map(|word| word.parse().unwrap()).collect()
}

#[test]
fn keys_from_a_pipe_move_the_arm_as_long_as_they_are_held_and_no_longer() {
    let folder = Folder::new();
    let _running = listening(&folder, "hold.toml");
    let before = joints(&folder);
    // The keys select MANUAL/JOINT and full speed and push the fifth axis back; the end of the
    // input releases them.
    let said = type_keys(&folder, "j3g").expect_code(0);
    assert!(said.out.contains("manual_joint: ok MANUAL/JOINT"), "{}", said.out);
    std::thread::sleep(std::time::Duration::from_millis(300));
    let moved = joints(&folder);
    assert!(moved[4] < before[4] - 0.5, "{before:?} {moved:?}");
    assert!((0..6).filter(|i| *i != 4).all(|i| (moved[i] - before[i]).abs() < 0.3), "{moved:?}");
    std::thread::sleep(std::time::Duration::from_millis(300));
    assert_eq!(joints(&folder), moved, "it stands");
    type_keys(&folder, "i").expect_code(0);
    let wrong = type_keys(&folder, "o").expect_code(0);
    assert!(wrong.out.contains("resume: refused"), "{}", wrong.out);
}

#[test]
fn key_maps_and_devices_that_cannot_be_used_are_refused() {
    let folder = Folder::new();
    let list = taktil(folder.path(), &["keys", "--list"]).expect_code(0);
    let map = folder.write("map.toml", list.out.replace("\"axis +1\"", "\"axis +9\""));
    let bad = taktil(folder.path(), &["keys", "--map", map.to_str().unwrap()]).expect_code(2);
    assert!(
        bad.err.contains("there is no axis `+9`") && bad.err.contains("map.toml:"),
        "{}",
        bad.err
    );
    let alone = taktil(folder.path(), &["keys", "--at", "op"]).expect_code(2);
    assert!(alone.err.contains("nobody listens"), "{}", alone.err);
    let _running = listening(&folder, "hold.toml");
    let device = ["keys", "--at", "op", "--device", "/dev/null"];
    let none = taktil(folder.path(), &device).expect_code(2);
    assert!(none.err.contains("--device /dev/null"), "{}", none.err);
}

/// The bytes of a keyboard's event device.
fn event(code: evdev::KeyCode, down: bool) -> Vec<u8> {
    let key = taktil_lab_command::keys::events::bytes(1, code.0, i32::from(down));
    [key, taktil_lab_command::keys::events::bytes(0, 0, 0)].concat()
}

#[test]
fn events_through_a_pipe_move_the_arm_until_the_pipe_ends() {
    use evdev::KeyCode;
    let folder = Folder::new();
    let _running = listening(&folder, "hold.toml");
    let pipe = folder.join("events");
    nix::unistd::mkfifo(&pipe, nix::sys::stat::Mode::S_IRWXU).unwrap();
    let mut command = Command::new(TAKTIL);
    command.args(["keys", "--at", "op", "--device"]).arg(&pipe).current_dir(folder.path());
    let child = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let mut reading = Running(child);
    let mut wire = std::fs::OpenOptions::new().write(true).open(&pipe).unwrap();
    let before = joints(&folder);
    for key in [KeyCode::KEY_J, KeyCode::KEY_3, KeyCode::KEY_G] {
        wire.write_all(&event(key, true)).unwrap();
        std::thread::sleep(std::time::Duration::from_millis(300));
    }
    // The writer hangs with the key down and the pipe open: the arm stops.
    assert!(stands(&folder), "nobody repeats the key");
    let hung = joints(&folder);
    assert!(hung[4] < before[4] - 0.5, "{before:?} {hung:?}");
    // The key repeats: it counts as held, and the arm moves as long as it repeats.
    let repeat = taktil_lab_command::keys::events::bytes(1, KeyCode::KEY_G.0, 2);
    let gone = (0..1000).any(|_| {
        wire.write_all(&repeat).unwrap();
        std::thread::sleep(std::time::Duration::from_millis(33));
        joints(&folder)[4] < hung[4] - 0.5
    });
    assert!(gone, "{hung:?} {:?}", joints(&folder));
    // The device is disconnected with the key down.
    drop(wire);
    assert_eq!(reading.wait().code(), Some(1), "no device is left");
    assert!(stands(&folder), "no device is left");
}

/// Whether the arm comes to rest: two consecutive readings are equal.
pub(crate) fn stands(folder: &Folder) -> bool {
    let mut before = joints(folder);
    (0..100).any(|_| {
        std::thread::sleep(std::time::Duration::from_millis(200));
        let now = joints(folder);
        let same = now == before;
        before = now;
        same
    })
}

#[test]
fn a_client_that_hangs_with_keys_held_releases_them() {
    use evdev::KeyCode;
    use nix::sys::signal::{Signal, kill};
    let folder = Folder::new();
    let _running = listening(&folder, "hold.toml");
    tell(&folder, &["manual_joint"]).expect_code(0);
    let pipe = folder.join("events");
    nix::unistd::mkfifo(&pipe, nix::sys::stat::Mode::S_IRWXU).unwrap();
    let mut command = Command::new(TAKTIL);
    command.args(["keys", "--at", "op", "--device"]).arg(&pipe).current_dir(folder.path());
    let child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let reading = Running(child);
    let mut wire = std::fs::OpenOptions::new().write(true).open(&pipe).unwrap();
    let before = joints(&folder);
    wire.write_all(&event(KeyCode::KEY_G, true)).unwrap();
    let repeat = taktil_lab_command::keys::events::bytes(1, KeyCode::KEY_G.0, 2);
    let moving = (0..1000).any(|_| {
        wire.write_all(&repeat).unwrap();
        std::thread::sleep(std::time::Duration::from_millis(30));
        joints(&folder)[4] < before[4] - 0.3
    });
    assert!(moving, "the key moves the arm");
    // The program that reads the keys is stopped with a key held; its socket and the pipe stay
    // open. Where this test is slow, the program may have let go of the key before.
    let id = nix::unistd::Pid::from_raw(i32::try_from(reading.0.id()).unwrap());
    let pause = || std::thread::sleep(std::time::Duration::from_millis(50));
    let silent = (0..20).any(|_| {
        kill(id, Signal::SIGCONT).unwrap();
        wire.write_all(&event(KeyCode::KEY_G, false)).unwrap();
        pause();
        wire.write_all(&event(KeyCode::KEY_G, true)).unwrap();
        pause();
        kill(id, Signal::SIGSTOP).unwrap();
        (0..10).any(|_| {
            pause();
            let said = tell(&folder, &["state"]).expect_code(0).out;
            said.contains("stopped: the hand fell silent")
        })
    });
    assert!(silent, "{}", tell(&folder, &["state"]).out);
    assert!(stands(&folder), "nobody says that the key is held");
    // A client that sends faster than it is served, and then hangs, does not move the arm either.
    let mut flood = std::os::unix::net::UnixStream::connect(folder.join("op")).unwrap();
    let stood = joints(&folder);
    flood.write_all(&b"jog joints 0 0 0 0 1 0\n".repeat(2000)).unwrap();
    assert!(stands(&folder));
    assert_eq!(joints(&folder), stood, "nothing moves by what had to wait");
}

#[test]
fn the_reason_for_a_blocked_jog_is_reported() {
    let folder = Folder::new();
    let _running = listening(&folder, "hold.toml");
    let push = ["jog", "joints", "0", "0", "0", "0", "1", "0"];
    let once = tell(&folder, &push).expect_code(2).err;
    assert!(once.contains("held only as long as they are said again; give a time"), "{once}");
    for wrong in ["0", "-1", "nan", "61"] {
        let held = [&["--for", wrong], &push[..]].concat();
        let said = tell(&folder, &held).expect_code(2).err;
        assert!(said.contains("give seconds above 0, at most 60"), "{said}");
    }
    let said = tell(&folder, &["--for", "1", "state"]).expect_code(2).err;
    assert!(said.contains("only `jog` is held"), "{said}");
    let idle = tell(&folder, &[&["--for", "0.05"], &push[..]].concat()).expect_code(0).out;
    assert!(idle.contains("keys move the arm in MANUAL; it is in IDLE/CALIBRATED"), "{idle}");
    tell(&folder, &["manual_joint"]).expect_code(0);
    // A hand that lets go after each word is not blocked for long: this one stays.
    let mut wire = std::os::unix::net::UnixStream::connect(folder.join("op")).unwrap();
    let mut answers = std::io::BufReader::new(wire.try_clone().unwrap()).lines();
    let told = (0..500).any(|_| {
        std::thread::sleep(std::time::Duration::from_millis(10));
        wire.write_all(b"jog tool 0 0 0 0 1 0\n").unwrap();
        let answer = answers.next().unwrap().unwrap();
        answer.contains("joints are pushed in MANUAL/JOINT")
    });
    assert!(told, "the tool's keys where joints are pushed");
    drop((wire, answers));
    assert!(tell(&folder, &["release"]).expect_code(0).out.trim() == "ok");
    let freed =
        (0..500).any(|_| !tell(&folder, &["state"]).expect_code(0).out.contains("stopped:"));
    assert!(freed);
    // The arm moves as long as the keys are held, and no longer.
    let before = joints(&folder);
    tell(&folder, &[&["--for", "1"], &push[..]].concat()).expect_code(0);
    assert!(stands(&folder));
    let moved = joints(&folder);
    assert!(moved[4] > before[4] + 0.3, "{before:?} {moved:?}");
}

/// A virtual keyboard of the kernel.
#[test]
fn an_unplugged_keyboard_releases_its_keys() {
    use evdev::uinput::VirtualDevice;
    use evdev::{AttributeSet, EventType, InputEvent, KeyCode};
    if !std::path::Path::new("/dev/uinput").exists() {
        taktil_tests_script::report_skip("this host has no /dev/uinput to make a keyboard with");
        return;
    }
    let folder = Folder::new();
    let _running = listening(&folder, "hold.toml");
    let mut keys = AttributeSet::<KeyCode>::new();
    for key in [KeyCode::KEY_J, KeyCode::KEY_3, KeyCode::KEY_G] {
        keys.insert(key);
    }
    let builder = VirtualDevice::builder().unwrap().name("taktil test").with_keys(&keys).unwrap();
    let mut keyboard = builder.build().unwrap();
    let path = keyboard.enumerate_dev_nodes_blocking().unwrap().find_map(Result::ok).unwrap();
    let mut command = Command::new(TAKTIL);
    command.args(["keys", "--at", "op", "--device"]).arg(path).current_dir(folder.path());
    let child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let mut reading = Running(child);
    std::thread::sleep(std::time::Duration::from_millis(500));
    let before = joints(&folder);
    for key in [KeyCode::KEY_J, KeyCode::KEY_3, KeyCode::KEY_G] {
        keyboard.emit(&[InputEvent::new(EventType::KEY.0, key.0, 1)]).unwrap();
        std::thread::sleep(std::time::Duration::from_millis(300));
    }
    drop(keyboard);
    assert_eq!(reading.wait().code(), Some(1), "no device is left");
    std::thread::sleep(std::time::Duration::from_millis(300));
    let moved = joints(&folder);
    assert!(moved[4] < before[4] - 0.5, "{before:?} {moved:?}");
    std::thread::sleep(std::time::Duration::from_millis(300));
    assert_eq!(joints(&folder), moved, "it stands");
}

/// A virtual gamepad of the kernel: its stick moves the arm while the dead-man's switch is held.
#[test]
fn an_unplugged_gamepad_releases_its_keys() {
    use evdev::uinput::VirtualDevice;
    use evdev::{AbsInfo, AbsoluteAxisCode, AttributeSet, InputEvent, KeyCode, UinputAbsSetup};
    if !std::path::Path::new("/dev/uinput").exists() {
        taktil_tests_script::report_skip("this host has no /dev/uinput to make a gamepad with");
        return;
    }
    let folder = Folder::new();
    let _running = listening(&folder, "hold.toml");
    let mut keys = AttributeSet::<KeyCode>::new();
    for key in [KeyCode::BTN_TL, KeyCode::BTN_WEST] {
        keys.insert(key);
    }
    let stick = AbsoluteAxisCode::ABS_RY;
    let way = UinputAbsSetup::new(stick, AbsInfo::new(0, -128, 127, 0, 0, 1));
    let builder = VirtualDevice::builder().unwrap().name("taktil test pad");
    let builder = builder.with_keys(&keys).unwrap().with_absolute_axis(&way).unwrap();
    let mut pad = builder.build().unwrap();
    let path = pad.enumerate_dev_nodes_blocking().unwrap().find_map(Result::ok).unwrap();
    let mut command = Command::new(TAKTIL);
    command.args(["keys", "--at", "op", "--device"]).arg(path).current_dir(folder.path());
    let child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let mut reading = Running(child);
    let pause = || std::thread::sleep(std::time::Duration::from_millis(500));
    pause();
    let before = joints(&folder);
    let press = |key: KeyCode| InputEvent::new(1, key.0, 1);
    let push = |value: i32| InputEvent::new(3, stick.0, value);
    pad.emit(&[press(KeyCode::BTN_WEST), push(-128)]).unwrap();
    pause();
    assert_eq!(joints(&folder), before, "nothing moves without the switch");
    pad.emit(&[press(KeyCode::BTN_TL)]).unwrap();
    pause();
    drop(pad);
    assert_eq!(reading.wait().code(), Some(1), "no device is left");
    pause();
    let moved = joints(&folder);
    assert!((moved[2] - before[2]).abs() > 0.5, "{before:?} {moved:?}");
    pause();
    assert_eq!(joints(&folder), moved, "it stands");
}
