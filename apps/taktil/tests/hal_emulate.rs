//! `taktil hal emulate` in a process of its own, driven by the production drivers over UDP and a
//! pseudo-terminal; its errors and its end.

mod emulator;

use std::io::Read;
use std::path::Path;
use std::process::Command;

use emulator::{Emulator, folder, pressed_scene};
use taktil_drivers_mesa::{Board, Config, Halves, Line, LinesInConfig, LinesOutConfig, Terminal};
use taktil_hal::{
    AnalogOut, Arrival, CHANNELS, Clock, DacCode, DigitalIn, DigitalOut, Encoders, LinesOut, Nanos,
    TactileArray, TactileFrame,
};
use taktil_rtcore::linux::MonotonicClock;

/// The cycle of the drivers in these tests, on a machine with other work.
const CYCLE_PERIOD: Nanos = Nanos::from_millis(5);
/// A code of the card that moves joint 1 against its friction: 3.4 V.
const PUSH_CODE: i32 = 1_400;

/// The wiring that the help states, with waits for a machine with other work.
fn card(address: String) -> Config {
    let field = |number: u32| Line::at(Terminal::Field, number);
    Config {
        address,
        board: "7I92".to_owned(),
        lines_in: Some(LinesInConfig {
            drive_power: field(0),
            estop_a: field(1),
            estop_b: field(2),
        }),
        lines_out: Some(LinesOutConfig {
            enable: field(0),
            brake_release: field(1),
            watchdog_feed: Some(field(2)),
        }),
        period_us: 100_000,
        lost_ms: 10_000,
        watchdog_ms: 5_000,
        open_wait_ms: 2_000,
        ..Config::default()
    }
}

/// Cycles with a code for joint 1; answers its newest count and how many readings were fresh.
fn drive(halves: &mut Halves, clock: &dyn Clock, count: i64, code: Option<i32>) -> (i32, i64) {
    let (start, mut last, mut fresh) = (clock.now(), 0, 0);
    for cycle in 1..=count {
        let release = start + CYCLE_PERIOD * cycle;
        clock.sleep_until(release);
        if let Ok(reading) = halves.encoders.as_mut().unwrap().sample(release) {
            (last, fresh) = (reading.value[0].0, fresh + 1);
        }
        let mut codes = [DacCode(0); CHANNELS];
        codes[0] = DacCode(code.unwrap_or(0));
        let on = code.is_some();
        let lines = LinesOut { enable: on, brake_release: on, watchdog_feed: cycle % 2 == 0 };
        let _ = halves.analog_out.as_mut().unwrap().commit(release, &codes);
        let _ = halves.digital_out.as_mut().unwrap().commit(release, &lines);
    }
    (last, fresh)
}

#[test]
fn drivers_in_this_process_move_and_feel_the_robot_of_another() {
    let folder = folder("drive");
    let (scene, link) = (pressed_scene(&folder), folder.join("pad"));
    let (scene, link) = (scene.to_str().unwrap(), link.to_str().unwrap());
    let emulator = Emulator::start(&[
        "mesa", "myrmex", "--scene", scene, "--link", link, "--for", "120", "--wait",
    ]);
    assert_eq!(emulator.place("myrmex"), link);
    let mut halves = Board::open(&card(emulator.place("mesa"))).unwrap();
    let pad = taktil_drivers_serial::Config { path: link.to_owned(), ..Default::default() };
    let clock = MonotonicClock::starting_in(Nanos::ZERO);
    let (mut array, worker) = taktil_drivers_serial::open(&pad, Box::new(clock)).unwrap();
    let reader = std::thread::spawn(move || worker.run());

    let (count, fresh) = drive(&mut halves, &clock, 60, None);
    assert!(count == 0 && fresh > 30, "{count} counts behind the brakes, {fresh} readings");
    let now = clock.now();
    let lines = halves.digital_in.as_mut().unwrap().sample(now).unwrap().value;
    assert!(lines.drive_power && lines.estop_a_closed && lines.estop_b_closed, "{lines:?}");
    let mut frame = TactileFrame::new(16, 16);
    assert_eq!(array.sample(now, &mut frame), Ok(Arrival::New));
    let most = frame.values.iter().max().unwrap();
    assert!(*most > 500 && frame.values[0] < 600, "the pin presses {most}");
    let first = frame.sequence;

    let (count, _) = drive(&mut halves, &clock, 100, Some(PUSH_CODE));
    assert!(count > 50, "{count} counts after a push");
    assert_eq!(array.sample(clock.now(), &mut frame), Ok(Arrival::New));
    assert!(frame.sequence > first + 10, "{} after {first}", frame.sequence);

    drop(array);
    reader.join().unwrap();
    let (said, code) = emulator.end();
    assert_eq!(code, Some(0), "{said}");
    let has = |start: &str| said.lines().any(|line| line.starts_with(start));
    assert!(has("served ") && has("mesa: ") && has("myrmex: "), "{said}");
    assert!(!said.contains(" 0 requests") && !said.contains(" 0 scans"), "{said}");
    assert!(!Path::new(link).exists(), "the link goes with the terminal");
}

#[test]
fn a_plan_in_a_file_pulls_the_cable_and_it_is_told() {
    let folder = folder("cable");
    let (scene, link, plan) =
        (pressed_scene(&folder), folder.join("pad"), folder.join("plan.toml"));
    std::fs::write(&plan, "[[fault]]\nkind = \"unplugged\"\nat = 0.5\nfor = 0.5\n").unwrap();
    let arguments: Vec<&str> = ["flexitac", "--scene"]
        .into_iter()
        .chain([scene.to_str().unwrap(), "--link", link.to_str().unwrap()])
        .chain(["--fault", plan.to_str().unwrap(), "--for", "2"])
        .collect();
    let mut emulator = Emulator::start(&arguments);
    assert!(emulator.lines.iter().any(|line| line == "fault kind=unplugged at=0.5 for=0.5"));
    let mut rest = String::new();
    emulator.output.read_to_string(&mut rest).unwrap();
    assert_eq!(emulator.process.wait().unwrap().code(), Some(0), "{rest}");
    let back = format!("flexitac at {}", link.display());
    assert!(rest.lines().any(|line| line == back), "{rest}");
    assert!(rest.contains("unplugged 1"), "about 100 scans at a cable that is off: {rest}");
}

#[test]
fn what_cannot_be_served_is_refused_in_a_line_with_a_remedy() {
    let taken = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
    let taken = taken.local_addr().unwrap().to_string();
    let scene = |name: &str| format!("{}/../../sim/scenes/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    let (rolling, seven) = (scene("roll-pin"), scene("seven-lines"));
    let cases: [(&[&str], [&str; 2]); 9] = [
        (&["robot"], ["no board is called so", "weiss-dsa"]),
        (&["mesa", "--scene", "none.toml"], ["there is no file `none.toml`", "name a scene"]),
        (&["mesa", "--address", &taken, "--scene", &rolling], ["in use", "port 0"]),
        (&["mesa", "--address", "here", "--scene", &rolling], ["no address", "127.0.0.1:27181"]),
        (&["mesa", "mesa", "--scene", &rolling], ["one set of motors", "once"]),
        (&["myrmex", "flexitac", "--scene", &rolling], ["has one tactile array", "opposed"]),
        (&["mesa", "--scene", &seven], ["drives 6 motors", "fewer joints"]),
        (&["myrmex", "--link", "/", "--scene", &rolling], ["--link /", "where no file stands"]),
        (
            &["mesa", "--fault", "kind=loss target=pad value=0", "--scene", &rolling],
            ["`pad`", "mesa"],
        ),
    ];
    for (arguments, says) in cases {
        let output = Command::new(env!("CARGO_BIN_EXE_taktil"))
            .args(["hal", "emulate", "--for", "1"])
            .args(arguments)
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
        assert!(says.iter().all(|part| said.contains(part)), "{arguments:?}: {said}");
        assert!(!said.contains("panicked"), "{said}");
    }
}
