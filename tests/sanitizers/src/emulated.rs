//! The boards' emulators in a process of their own, and the section of a machine file that names
//! each of them. What they turn and press is enough for every half to have an answer.

use std::io::{self, Read, Write};
use std::net::UdpSocket;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use taktil_drivers_can_emulator as can;
use taktil_drivers_ethercat_emulator as ethercat;
use taktil_drivers_mesa_emulator as mesa;
use taktil_drivers_netft_emulator as netft;
use taktil_drivers_regmap_emulator as regmap;
use taktil_drivers_serial_emulator as serial;
use taktil_hal::fault::FaultPlan;
use taktil_hal::{Clock, LinesIn, Nanos};
use taktil_rtcore::linux::MonotonicClock;

/// Counts of a turn of the emulated card's encoders.
const TURN_COUNTS: i64 = 4_000;
/// Scans of the emulated array in a second.
const ARRAY_RATE_HZ: f64 = 100.0;
/// Drives on a bus and on a segment: one for each joint.
const DRIVES_COUNT: u8 = 6;
/// Records of the emulated box in a second: so few that its host asks for more between them.
const BOX_RATE_HZ: u32 = 5;
/// Counts by which the joints of the register board move in a step.
const STEP_COUNTS: i64 = 3;

/// A register board with every half but a watchdog's: the project's own layout.
const REGISTER_BOARD: &str = "taktil";

/// What a machine file says of the board of a driver that stands at `place`.
pub fn section(driver: &str, place: &str) -> String {
    let line = |number| format!("{{ at = \"field\", number = {number} }}");
    let lines = |names: [&str; 3], first: u32| {
        let each = names.iter().zip(first..).map(|(name, at)| format!("{name} = {}", line(at)));
        each.collect::<Vec<_>>().join(", ")
    };
    // Waits as long as a loaded machine may need: what they cost is not judged here.
    let keys = match driver {
        "mesa" => format!(
            "address = \"{place}\"\nperiod_us = 20000\nwait_share = 0.9\nlost_ms = 10000\n\
             watchdog_ms = 5000\nremote_watchdog_ms = 10000\nopen_wait_ms = 1000\n\
             lines_in = {{ {} }}\nlines_out = {{ {} }}",
            lines(["drive_power", "estop_a", "estop_b"], 3),
            lines(["enable", "brake_release", "watchdog_feed"], 3),
        ),
        "can" => format!(
            "serves = [\"encoders\", \"drive_out\", \"drive_in\", \"digital_in\", \
             \"digital_out\"]\ninterface = \"{place}\"\nnodes = [{}]\n\
             period_us = 20000\nwait_share = 0.9\n\
             lost_ms = 10000\nsilence_ms = 10000\nopen_wait_ms = 3000",
            (1..=DRIVES_COUNT).map(|id| format!("{{ id = {id} }}")).collect::<Vec<_>>().join(", "),
        ),
        "ethercat" => format!(
            "serves = [\"encoders\", \"drive_out\", \"drive_in\", \"board_clock\", \
             \"digital_out\"]\ninterface = \"{place}\"\nperiod_us = 20000\n\
             wait_share = 0.45\nlost_ms = 10000\n\
             watchdog_ms = 5000\nsync = {{}}\ndevices = [{{ kind = \"ek1100\" }}{}]\n\
             lines_out = {{ enable = {{ at = \"drives\" }} }}",
            format!(
                ", {{ kind = \"drive\", vendor = {}, product = {} }}",
                ethercat::DRIVE_VENDOR_ID,
                ethercat::DRIVE_PRODUCT_ID
            )
            .repeat(usize::from(DRIVES_COUNT)),
        ),
        "netft" => format!(
            "address = \"{place}\"\nrate_hz = {BOX_RATE_HZ}\nstale_ms = 5000\nask_again_ms = 100\n\
             open_wait_ms = 3000"
        ),
        "regmap" => format!("path = \"{place}\"\nwatchdog_ms = 5000\nstale_ms = 5000"),
        _ => format!("path = \"{place}\""),
    };
    format!("[device.board]\ndriver = \"{driver}\"\n{keys}\n")
}

/// Serves the board of a driver until the standard input ends: a UDP port of this machine that is
/// printed, a file or a link at `place`.
///
/// # Errors
/// No such board; the system's.
pub fn serve(driver: &str, place: &str) -> io::Result<()> {
    let ended = Arc::new(AtomicBool::new(false));
    let flag = ended.clone();
    std::thread::spawn(move || {
        let _ = io::stdin().read_to_end(&mut Vec::new());
        flag.store(true, Ordering::Relaxed);
    });
    let goes_on = || !ended.load(Ordering::Relaxed);
    let clock = MonotonicClock::starting_in(Nanos::ZERO);
    match driver {
        "mesa" => serve_card(&clock, goes_on),
        "regmap" => serve_registers(Path::new(place), &clock, goes_on),
        "serial" => serve_array(Path::new(place), &clock, goes_on),
        "can" => serve_bus(Path::new(place), &clock, goes_on),
        "ethercat" => serve_segment(place, &clock, goes_on),
        "netft" => serve_box(&clock, goes_on),
        _ => Err(io::Error::other(format!("no board of `{driver}` is emulated"))),
    }
}

fn say(text: impl std::fmt::Display) -> io::Result<()> {
    let mut out = io::stdout();
    writeln!(out, "{text}")?;
    out.flush()
}

fn serve_card(clock: &dyn Clock, mut goes_on: impl FnMut() -> bool) -> io::Result<()> {
    let mut turned = 0;
    let motors = move |_: Nanos, _: &mesa::Outputs| {
        turned += STEP_COUNTS;
        mesa::Inputs { counts: vec![turned; 6], field: 0x38, ..mesa::Inputs::default() }
    };
    let firmware = mesa::Firmware::with_7i77();
    let mut card = mesa::Emulator::new(firmware, TURN_COUNTS, Box::new(motors));
    let socket = UdpSocket::bind("127.0.0.1:0")?;
    say(socket.local_addr()?)?;
    mesa::serve(&mut card, &socket, clock, &mut goes_on)
}

fn serve_bus(path: &Path, clock: &dyn Clock, mut goes_on: impl FnMut() -> bool) -> io::Result<()> {
    let ids: Vec<u8> = (1..=DRIVES_COUNT).collect();
    let mut bus = can::Emulator::new(can::Kind::CanOpen(1_000), &ids);
    let _ = std::fs::remove_file(path);
    let mut link = can::PathLink::bind(path)?;
    say(path.display())?;
    can::serve(&mut bus, &mut link, clock, &mut goes_on)
}

fn serve_segment(
    interface: &str,
    clock: &dyn Clock,
    mut goes_on: impl FnMut() -> bool,
) -> io::Result<()> {
    let mut devices = vec![ethercat::Model::Coupler.into()];
    devices.extend((0..DRIVES_COUNT).map(|_| ethercat::Description::from(ethercat::Model::Drive)));
    let mut segment = ethercat::Segment::new(devices, ethercat::idle_motors());
    let socket = ethercat::RawSocket::open(interface)?;
    say(interface)?;
    ethercat::serve(&mut segment, &socket, clock, &mut |_, _| goes_on())
}

fn serve_box(clock: &dyn Clock, mut goes_on: impl FnMut() -> bool) -> io::Result<()> {
    let mut sensor = netft::Emulator::new(BOX_RATE_HZ, Box::new(|_| [1, 2, 3, 4, 5, 6]));
    let socket = UdpSocket::bind("127.0.0.1:0")?;
    say(socket.local_addr()?)?;
    netft::serve(&mut sensor, &socket, clock, &mut goes_on)
}

fn serve_registers(
    path: &Path,
    clock: &dyn Clock,
    mut goes_on: impl FnMut() -> bool,
) -> io::Result<()> {
    let boards = taktil_drivers_regmap::SHIPPED_BOARDS;
    let text = boards.iter().find(|(name, _)| *name == REGISTER_BOARD).map(|(_, text)| *text);
    let text = text.ok_or_else(|| io::Error::other("the board is not shipped"))?;
    let mut turned = 0;
    let plant = move |_: Nanos, outputs: &regmap::Outputs| {
        turned += STEP_COUNTS;
        regmap::Inputs {
            counts: vec![turned; 8],
            codes: outputs.codes.clone(),
            gauges: outputs.codes.clone(),
            frame: Some(vec![(turned % 1000) as u16; 256]),
            lines: LinesIn { drive_power: true, estop_a_closed: true, estop_b_closed: true },
            ..regmap::Inputs::default()
        }
    };
    let board = regmap::Emulator::new("board", text, path, 0, Box::new(plant));
    let mut board = board.map_err(io::Error::other)?;
    say(path.display())?;
    // The processor is shared: the board looks at its registers a thousand times a second.
    regmap::serve(&mut board, clock, &mut || {
        std::thread::sleep(std::time::Duration::from_millis(1));
        goes_on()
    })
}

fn serve_array(
    link: &Path,
    clock: &dyn Clock,
    mut goes_on: impl FnMut() -> bool,
) -> io::Result<()> {
    let board = Box::new(serial::Myrmex::new(ARRAY_RATE_HZ));
    let line = serial::Line::new(board, "board", FaultPlan::default(), 1);
    let mut line = line.map_err(io::Error::other)?;
    let mut image = |now: Nanos, values: &mut [u16]| values.fill((now.0 >> 24) as u16 & 0xfff);
    say(link.display())?;
    serial::serve(&mut line, link, clock, &mut image, &mut |_| !goes_on())
}
