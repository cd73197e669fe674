//! Runs the suite on a real device node, which the variable `TAKTIL_COMEDI` names; the kernel's
//! `comedi_test` suffices. It writes to every D/A channel over its whole range: **never with a
//! robot behind it**. Without the variable the tests say that they were skipped.

use std::io::Write;
use std::process::Command;

use taktil_drivers_comedi::{AnalogChannel, Config, open, write_safe_values};
use taktil_hal::conformance::{CycleDriver, check_analog_in, check_analog_out};
use taktil_hal::{CHANNELS, DacCode, Nanos};

/// The variable that names the node.
const NODE_VARIABLE: &str = "TAKTIL_COMEDI";
/// The variable that makes this binary the process that is killed.
const VICTIM_VARIABLE: &str = "TAKTIL_COMEDI_VICTIM";
/// Channels that the node has, in and out.
const NODE_CHANNELS: u16 = 8;
/// Cycles of the loop from D/A to A/D.
const LOOP_CYCLES: i64 = 4_000;

/// Eight channels in and out of the node, or a word on the output.
fn config() -> Option<Config> {
    let Ok(path) = std::env::var(NODE_VARIABLE) else {
        let text = format!("skipped: needs /dev/comedi0; name it in {NODE_VARIABLE}\n");
        std::io::stderr().write_all(text.as_bytes()).unwrap();
        return None;
    };
    let mut config = Config::new(&path, 10);
    config.analog_out = (0..NODE_CHANNELS).map(AnalogChannel::new).collect();
    config.analog_in = (0..NODE_CHANNELS).map(AnalogChannel::new).collect();
    Some(config)
}

/// All in one test: a node is locked for one opener at a time.
#[test]
fn the_node_conforms_loops_back_and_is_safe_after_a_kill() {
    let Some(config) = config() else { return };
    if std::env::var(VICTIM_VARIABLE).is_ok() {
        be_killed(&config);
    }
    let mut halves = open(&config).unwrap_or_else(|error| panic!("{error}"));
    let text = open(&config).unwrap_err().to_string();
    assert!(text.contains("another process has locked"), "{text}");
    let cycle = &mut CycleDriver::stationary();
    let (mut out, mut input) =
        (halves.analog_out.take().unwrap(), halves.analog_in.take().unwrap());
    assert_eq!(check_analog_in(input.as_mut(), cycle), []);
    assert_eq!(check_analog_out(out.as_mut(), cycle), []);
    for step in 0..LOOP_CYCLES {
        let release = cycle.release();
        let codes =
            core::array::from_fn(|at| DacCode(((step * 7 + at as i64 * 1_000) % 32_000) as i32));
        out.commit(release, &codes).unwrap();
        // One that sampled at this release would answer what it had then.
        let reading = input.sample(release + Nanos(1)).unwrap();
        let wired = usize::from(NODE_CHANNELS);
        let (seen, due) = (reading.value.map(|code| code.0), codes.map(|code: DacCode| code.0));
        assert_eq!(seen[..wired], due[..wired], "step {step}");
    }
    drop((out, input, halves));
    let mut child = Command::new(std::env::current_exe().unwrap())
        .env(VICTIM_VARIABLE, "1")
        .stdout(std::process::Stdio::piped())
        .args(["--exact", "the_node_conforms_loops_back_and_is_safe_after_a_kill", "--nocapture"])
        .spawn()
        .unwrap();
    let mut lines = std::io::BufRead::lines(std::io::BufReader::new(child.stdout.take().unwrap()));
    assert!(lines.any(|line| line.unwrap().contains("outputs are driven")));
    child.kill().unwrap();
    child.wait().unwrap();
    // What the kernel's test device still puts out, read without driving anything.
    let inputs = Config { analog_out: Vec::new(), ..config.clone() };
    let codes = |config: &Config| {
        let mut halves = open(config).unwrap();
        let reading = halves.analog_in.as_mut().unwrap().sample(Nanos(1)).unwrap();
        reading.value[..usize::from(NODE_CHANNELS)].iter().map(|code| code.0).collect::<Vec<_>>()
    };
    assert_eq!(codes(&inputs), [12_345; NODE_CHANNELS as usize]);
    write_safe_values(&config.path, &config).unwrap();
    assert_eq!(codes(&inputs), [0; NODE_CHANNELS as usize]);
}

/// Drives the outputs and waits for SIGKILL.
fn be_killed(config: &Config) -> ! {
    let mut halves = open(config).unwrap();
    let codes = [DacCode(12_345); CHANNELS];
    halves.analog_out.as_mut().unwrap().commit(Nanos::ZERO, &codes).unwrap();
    let mut out = std::io::stdout();
    out.write_all(b"outputs are driven\n").unwrap();
    out.flush().unwrap();
    loop {
        std::thread::sleep(std::time::Duration::from_secs(1));
    }
}
