//! A stop reaches the lanes of the real service whatever else does not answer: systemd, the
//! journal, the disk, and other clients. The board's model has no drives, so that nothing moves:
//! shown is that the request is taken and answered.

mod process;

use std::io::Write;
use std::os::unix::net::UnixStream;
use std::path::Path;

use nix::sys::signal::Signal;
use process::{Caller, Folder, NO_FLIGHT, Rig, Service};

/// A service with a socket `op` and a log, once its lanes run.
fn start(folder: &Folder) -> Service {
    let socket = folder.join("op");
    let log = folder.join("run.mcap");
    let more = format!(
        "{NO_FLIGHT}\n[operator]\nsocket = \"{}\"\n[log]\npath = \"{}\"\n",
        socket.display(),
        log.display()
    );
    let service = Service::start(folder, &folder.config_with("contract = \"soft\"", &more));
    service.wait_for_message("READY=1");
    service.wait_for_message("WATCHDOG=1");
    service
}

/// Says `stop` on a new connection until it is answered.
fn stop_is_heard(path: &Path, tries: usize) {
    for _ in 0..tries {
        let mut caller = Caller::new(path);
        let answer = caller.ask("{\"id\": 1, \"say\": \"stop\"}");
        assert!(answer.contains("\"id\":1") && answer.contains("\"outcome\":\"ok\""), "{answer}");
        assert!(answer.contains("nothing to stop: START"), "{answer}");
    }
}

#[test]
fn a_stop_is_heard_while_systemd_and_the_journal_do_not_read() {
    let folder = Folder::new();
    let _rig = Rig::new(&folder);
    let service = start(&folder);
    let path = folder.join("op");
    // Nobody reads the notifications from here on, nor standard error, which is a pipe: a service
    // that waits for them stands still when their buffers are full.
    let mut caller = Caller::new(&path);
    for _ in 0..4000 {
        caller.write.write_all(b"state\n").unwrap();
    }
    std::thread::sleep(std::time::Duration::from_secs(3));
    stop_is_heard(&path, 20);
    service.signal(Signal::SIGTERM);
    assert_eq!(service.end().0, Some(0));
}

#[test]
fn a_stop_is_heard_beside_idle_and_flooding_clients_and_from_whoever_has_no_control() {
    let folder = Folder::new();
    let _rig = Rig::new(&folder);
    let service = start(&folder);
    let path = folder.join("op");
    let mut holder = Caller::new(&path);
    assert_eq!(holder.ask("control take"), "ok you have control");
    let mut floods: Vec<UnixStream> = (0..8)
        .map(|_| {
            let stream = UnixStream::connect(&path).unwrap();
            stream.set_nonblocking(true).unwrap();
            stream
        })
        .collect();
    let idle: Vec<UnixStream> = (0..64).map(|_| UnixStream::connect(&path).unwrap()).collect();
    let flood = "jog joints 1 0 0 0 0 0\n".repeat(500);
    for _ in 0..20 {
        for stream in &mut floods {
            // Those that are disconnected for it come back.
            if let Err(error) = stream.write(flood.as_bytes())
                && error.kind() != std::io::ErrorKind::WouldBlock
            {
                *stream = UnixStream::connect(&path).unwrap();
                stream.set_nonblocking(true).unwrap();
            }
        }
        assert!(holder.ask("state").starts_with("ok START"), "whoever has control is served");
        stop_is_heard(&path, 1);
    }
    drop(idle);
    let answer = Caller::new(&path).ask("idle");
    let has_no_control = answer.starts_with("refused: process") || answer.contains("too many");
    assert!(has_no_control, "{answer}");
    service.signal(Signal::SIGTERM);
    let (code, lines) = service.end();
    assert_eq!(code, Some(0), "{lines:?}");
}
