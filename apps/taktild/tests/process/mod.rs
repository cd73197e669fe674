//! A service in a process of its own over a register file with the board's model behind it. The
//! model only loops outputs back to inputs; it simulates no robot.
#![allow(dead_code, unreachable_pub, reason = "every test file uses a part of it")]

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use std::io::{BufRead, BufReader, Write};
use std::os::unix::net::{UnixDatagram, UnixStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::Duration;
use taktil_drivers_regmap::registers::{
    BLOCK_BYTES, DAC, DIGITAL_OUT, OUT_BRAKE_RELEASE, OUT_ENABLE,
};
use taktil_drivers_regmap::{Config, Loopback, RegisterFile};
use taktil_hal::Nanos;

/// Zero volts in offset binary of 12 bits.
pub(crate) const ZERO_VOLTS: u16 = 2048;
/// D/A words that drive the motors, as a board may hold them from before.
pub(crate) const DRIVING_CODE: u16 = 4095;

/// Tests that are not about the flight recorder switch it off.
pub(crate) const NO_FLIGHT: &str = "\n[flight]\nenabled = false\n";

/// A folder of one test, removed at its end.
pub(crate) struct Folder(PathBuf);

impl Folder {
    pub(crate) fn new() -> Folder {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let name = format!("taktild-{}-{number}", std::process::id());
        let path = std::env::temp_dir().join(name);
        std::fs::create_dir_all(&path).unwrap();
        Folder(path)
    }

    pub(crate) fn join(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }

    /// Writes a configuration of the service over `board.bin` in this folder.
    pub(crate) fn config(&self, contract: &str) -> PathBuf {
        self.config_with(&format!("contract = \"{contract}\""), NO_FLIGHT)
    }

    pub(crate) fn config_with(&self, contract: &str, flight: &str) -> PathBuf {
        let machine = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("../../sim/scenes/machine/puma260.toml")
            .canonicalize()
            .unwrap();
        let text = format!(
            "machine = \"{}\"\n{contract}\n\n[board]\npath = \"{}\"\n{flight}",
            machine.display(),
            self.join("board.bin").display()
        );
        let path = self.join("taktild.toml");
        std::fs::write(&path, text).unwrap();
        path
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// A register file with the board's model running behind it, in the state of a board that was left
/// driving.
pub(crate) struct Rig {
    pub(crate) registers: Arc<RegisterFile>,
    stop: Arc<AtomicBool>,
    model: Option<std::thread::JoinHandle<Loopback>>,
}

impl Rig {
    pub(crate) fn new(folder: &Folder) -> Rig {
        let config = Config { path: folder.join("board.bin"), ..Config::default() };
        std::fs::write(&config.path, vec![0; BLOCK_BYTES]).unwrap();
        let registers = Arc::new(RegisterFile::open(&config).unwrap());
        let mut model = Loopback::new(registers.clone(), &config).unwrap();
        for register in DAC.iter() {
            registers.write(register, DRIVING_CODE);
        }
        registers.write(DIGITAL_OUT, OUT_ENABLE | OUT_BRAKE_RELEASE);
        let stop = Arc::new(AtomicBool::new(false));
        let flag = stop.clone();
        let model = std::thread::spawn(move || {
            // The model reads once more after the request to stop, so that it sees every earlier
            // write.
            for ms in 0.. {
                let last = flag.load(Ordering::SeqCst);
                model.tick(Nanos::from_millis(ms));
                model.publish_frame(&[300; 256]);
                if last {
                    break;
                }
                std::thread::sleep(Duration::from_millis(1));
            }
            model
        });
        Rig { registers, stop, model: Some(model) }
    }

    pub(crate) fn words(&self) -> Vec<u16> {
        DAC.iter().map(|register| self.registers.read(register)).collect()
    }

    pub(crate) fn assert_registers_are_safe(&self) {
        assert!(self.words().iter().all(|word| *word == ZERO_VOLTS), "D/A words");
        let lines = self.registers.read(DIGITAL_OUT);
        assert_eq!(lines & (OUT_ENABLE | OUT_BRAKE_RELEASE), 0, "lines {lines:#06x}");
    }

    pub(crate) fn stop(&mut self) -> Option<Loopback> {
        self.stop.store(true, Ordering::SeqCst);
        self.model.take().and_then(|model| model.join().ok())
    }

    /// Returns the board after its watchdog has expired without a write.
    pub(crate) fn wait_until_silent(&mut self) -> Loopback {
        let mut model = self.stop().unwrap();
        model.tick(Nanos::from_secs(1_000_000));
        model
    }
}

impl Drop for Rig {
    fn drop(&mut self) {
        self.stop();
    }
}

pub(crate) fn command(config: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_taktild"));
    command
        .arg("--allow-root")
        .arg("--config")
        .arg(config)
        .stdin(Stdio::null())
        .env_remove("NOTIFY_SOCKET");
    command
}

pub(crate) fn check(config: &Path) -> Output {
    command(config).arg("--check").output().unwrap()
}

/// A service that is killed when its test ends, and its socket to systemd.
pub(crate) struct Service {
    pub(crate) child: Child,
    socket: UnixDatagram,
}

/// Environment variable with the path of the child's configuration.
pub(crate) const CHILD_CONFIGURATION_VARIABLE: &str = "TAKTILD_TEST_HANGS";

impl Service {
    pub(crate) fn start(folder: &Folder, config: &Path) -> Service {
        Service::spawn(folder, command(config))
    }

    /// This test's own program as a service whose operator task stops returning after half a
    /// second.
    pub(crate) fn start_hanging(folder: &Folder, config: &Path) -> Service {
        let mut command = Command::new(std::env::current_exe().unwrap());
        command.args(["--exact", "the_service_whose_operator_hangs", "--nocapture"]);
        Service::spawn(folder, {
            command.env(CHILD_CONFIGURATION_VARIABLE, config).stdout(Stdio::null());
            command
        })
    }

    pub(crate) fn spawn(folder: &Folder, mut command: Command) -> Service {
        let path = folder.join("notify");
        let socket = UnixDatagram::bind(&path).unwrap();
        socket.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
        let child = command.env("NOTIFY_SOCKET", &path).stderr(Stdio::piped()).spawn();
        Service { child: child.unwrap(), socket }
    }

    /// Waits for a message to systemd.
    pub(crate) fn wait_for_message(&self, word: &str) {
        let mut buffer = [0; 4096];
        for _ in 0..1_000 {
            let length = self.socket.recv(&mut buffer).unwrap_or_else(|e| panic!("{word}: {e}"));
            let text = String::from_utf8_lossy(&buffer[..length]).into_owned();
            if text.lines().any(|line| line == word) {
                return;
            }
        }
        panic!("`{word}` was never said");
    }

    pub(crate) fn signal(&self, signal: Signal) {
        let id = i32::try_from(self.child.id()).unwrap();
        kill(Pid::from_raw(id), signal).unwrap();
    }

    /// Returns its exit code and its standard error.
    pub(crate) fn end(mut self) -> (Option<i32>, Vec<String>) {
        let lines = BufReader::new(self.child.stderr.take().unwrap()).lines();
        let lines: Vec<String> = lines.map_while(Result::ok).collect();
        (self.child.wait().unwrap().code(), lines)
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A client of the socket.
pub(crate) struct Caller {
    pub(crate) write: UnixStream,
    read: BufReader<UnixStream>,
}

impl Caller {
    pub(crate) fn new(path: &Path) -> Caller {
        let write = UnixStream::connect(path).unwrap();
        write.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
        let read = BufReader::new(write.try_clone().unwrap());
        Caller { write, read }
    }

    /// Sends a line and returns the answer.
    pub(crate) fn ask(&mut self, line: &str) -> String {
        self.write.write_all(format!("{line}\n").as_bytes()).unwrap();
        self.answer()
    }

    pub(crate) fn answer(&mut self) -> String {
        let mut answer = String::new();
        self.read.read_line(&mut answer).unwrap();
        answer.trim_end().to_owned()
    }
}

/// A service with an operator's socket `op` in the folder, once it runs.
pub(crate) fn listening(folder: &Folder) -> (Service, PathBuf) {
    let path = folder.join("op");
    let more = format!("{NO_FLIGHT}\n[operator]\nsocket = \"{}\"\n", path.display());
    let service = Service::start(folder, &folder.config_with("contract = \"soft\"", &more));
    service.wait_for_message("READY=1");
    service.wait_for_message("WATCHDOG=1");
    (service, path)
}
