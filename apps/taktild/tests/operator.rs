//! The operator's socket of the service, in a process of its own: it accepts connections, answers
//! every line, explains errors, notices a client that is gone, and leaves no files. No motion is
//! tested, because the board's model has no drives.

mod process;

use std::io::Write;
use std::os::unix::fs::PermissionsExt;
use std::time::Duration;

use nix::sys::signal::Signal;
use process::{Caller, Folder, NO_FLIGHT, Rig, Service, listening};

#[test]
fn every_line_has_an_answer_and_a_refusal_says_why() {
    let folder = Folder::new();
    let rig = Rig::new(&folder);
    let (service, path) = listening(&folder);
    let mode = std::fs::metadata(&path).unwrap().permissions().mode();
    assert_eq!(mode & 0o777, 0o660, "for its user and group");
    let mut caller = Caller::new(&path);
    let state = caller.ask("state");
    assert!(state.starts_with("ok START (mode "), "{state}");
    for (line, says) in [
        ("fly", "refused: there is no word `fly`"),
        ("move by 0 0 5", "refused: moves are taken in TRAJECTORY/USER"),
        ("pause", "refused: moves are taken in TRAJECTORY/USER"),
        ("move by 0 0 nan", "refused: move by: `nan` is no number"),
        ("move joint 1 2 3", "refused: move joint: 3 numbers where 6 are needed"),
        ("jog joints 2 0 0 0 0 0", "refused: jog: a push of 2"),
        ("jog joints 0.5 0 0 0 0 0", "ok"),
        ("release", "ok"),
        ("calibrate", "refused: calibrate is not possible in START"),
        ("tactile_servo", "refused: tactile_servo is not possible in START"),
        ("wait", "refused: TRAJECTORY/USER was left: START"),
    ] {
        let answer = caller.ask(line);
        assert!(answer.starts_with(says), "{line}: {answer}");
    }
    // What is not possible now is refused with the reason and what helps.
    let refused = caller.ask("calibrate");
    assert!(refused.contains("): ") && refused.contains("say `"), "{refused}");
    // A line that arrives in parts, two lines that arrive at once, and one that is not text.
    caller.write.write_all(b"sta").unwrap();
    std::thread::sleep(Duration::from_millis(20));
    caller.write.write_all(b"te\nstate\n").unwrap();
    assert!(caller.answer().starts_with("ok START"));
    assert!(caller.answer().starts_with("ok START"));
    caller.write.write_all(&[0xFF, 0xFE, b'\n']).unwrap();
    assert!(caller.answer().starts_with("refused: "));
    // A client that disconnects in the middle of a line does not affect the others.
    let mut other = Caller::new(&path);
    other.write.write_all(b"jog joints 1 0").unwrap();
    drop(other);
    let mut third = Caller::new(&path);
    assert!(third.ask("state").starts_with("ok START"));
    assert!(caller.ask("state").starts_with("ok START"));
    rig.assert_registers_are_safe();
    service.signal(Signal::SIGTERM);
    let (code, lines) = service.end();
    assert_eq!(code, Some(0), "{lines:?}");
    assert!(lines.iter().all(|line| !line.contains("panicked")), "{lines:?}");
    assert!(!path.exists(), "the socket is gone with the service");
    rig.assert_registers_are_safe();
}

#[test]
fn the_socket_of_a_killed_service_is_taken_over_and_that_of_a_living_one_is_not() {
    let folder = Folder::new();
    let _rig = Rig::new(&folder);
    let (service, path) = listening(&folder);
    service.signal(Signal::SIGKILL);
    let (code, _) = service.end();
    assert_eq!((code, path.exists()), (None, true), "killed: the socket is left behind");
    std::fs::remove_file(folder.join("notify")).unwrap();
    let (again, path) = listening(&folder);
    assert!(Caller::new(&path).ask("state").starts_with("ok START"));
    // Another service, over a board of its own, cannot take over the socket.
    let beside = Folder::new();
    let _rig = Rig::new(&beside);
    let more = format!("{NO_FLIGHT}\n[operator]\nsocket = \"{}\"\n", path.display());
    let second = Service::start(&beside, &beside.config_with("contract = \"soft\"", &more));
    let (code, lines) = second.end();
    assert_ne!(code, Some(0));
    let said = lines.join("\n");
    assert!(said.contains("somebody listens at") && said.contains("socket"), "{said}");
    assert!(Caller::new(&path).ask("state").starts_with("ok START"), "the first one lives");
    again.signal(Signal::SIGTERM);
    assert_eq!(again.end().0, Some(0));
}
