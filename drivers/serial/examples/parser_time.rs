//! Measures what the parsers of the four boards cost a byte: a line's session is started against an
//! emulated board, then takes messages of that board again and again. Prints nanoseconds a byte,
//! and the share of a core at ten times the rate of the line.
//!
//! ```sh
//! cargo run --release -p taktil-drivers-serial --example parser_time
//! ```
//!
//! `parser_time --instructions BOARD MESSAGES` takes so many messages of one board (`myrmex`,
//! `flexitac`, `weiss-wts`, `weiss-dsa`, or `weiss-dsa-runs` for compressed ones) and prints how
//! many bytes these were, for a tool that counts.
#![expect(clippy::disallowed_methods, reason = "an instrument measures time")]

use std::error::Error;
use std::io::Write;
use std::time::Instant;

use taktil_drivers_serial::{BoardKind, Config, Outlet, Scan, Session};
use taktil_drivers_serial_emulator::{Board, FlexiTac, Line, Myrmex, WeissDsa, WeissWts};
use taktil_hal::Nanos;
use taktil_hal::fault::{FaultPlan, SplitMix};

/// Names of the boards, with the bytes a second that their lines carry (Myrmex and WTS on USB: 200
/// scans a second, the others at 2 Mbaud and at 115200 baud).
const BOARD_RATES: [(&str, f64); 5] = [
    ("myrmex", 104_000.0),
    ("flexitac", 200_000.0),
    ("weiss-wts", 105_200.0),
    ("weiss-dsa", 11_520.0),
    ("weiss-dsa-runs", 11_520.0),
];
/// Messages of one slice.
const SLICE_MESSAGES: usize = 200;
/// Slices of each board.
const SLICES_COUNT: usize = 51;
/// Bytes that arrive at once, as one packet of a USB port has them.
const PIECE_BYTES: usize = 64;
/// From one exchange of bytes with the emulated board to the next.
const EXCHANGE_PERIOD: Nanos = Nanos::from_micros(100);
/// When every board streams.
const STREAMING_TIME: Nanos = Nanos::from_millis(1_000);
/// Until when its messages are collected.
const COLLECTED_TIME: Nanos = Nanos::from_millis(2_000);

/// Gives the same scan out again and again.
struct Slot(Option<Box<Scan>>);

impl Outlet for Slot {
    fn take(&mut self) -> Option<Box<Scan>> {
        self.0.take()
    }

    fn put(&mut self, scan: Box<Scan>) {
        self.0 = Some(scan);
    }
}

/// A session that streams, with messages for it.
struct Stream {
    session: Session,
    slot: Slot,
    messages: Vec<u8>,
    messages_count: usize,
    now: Nanos,
}

fn board(name: &str) -> Option<(Config, Box<dyn Board>)> {
    let (board, emulated): (_, Box<dyn Board>) = match name {
        "myrmex" => (BoardKind::Myrmex, Box::new(Myrmex::new(100.0))),
        "flexitac" => (BoardKind::Flexitac, Box::new(FlexiTac::new(16, 16, 100.0))),
        "weiss-wts" => (BoardKind::WeissWts, Box::new(WeissWts::new(16, 16, 100.0))),
        "weiss-dsa" | "weiss-dsa-runs" => {
            (BoardKind::WeissDsa, Box::new(WeissDsa::new(16, 16, 100.0)))
        }
        _ => return None,
    };
    Some((Config { board, compress: name == "weiss-dsa-runs", ..Config::default() }, emulated))
}

impl Stream {
    fn new(name: &str) -> Result<Stream, Box<dyn Error>> {
        let (config, emulated) = board(name).ok_or("no such board")?;
        let mut session = Session::new(&config)?;
        let mut slot = Slot(Some(Box::new(Scan::new(session.geometry()))));
        let mut line = Line::new(emulated, "pad", FaultPlan::default(), 5)?;
        let (mut random, mut messages, mut bytes) = (SplitMix::new(1), Vec::new(), Vec::new());
        // Noise on top of a constant: compression finds short runs, and no AA 55 stands still.
        let mut image = |_: Nanos, values: &mut [u16]| {
            values.iter_mut().for_each(|value| *value = (random.next_u64() % 3) as u16 + 90);
        };
        let (mut now, mut before) = (Nanos::ZERO, 0);
        session.restart(now);
        while now < COLLECTED_TIME {
            now += EXCHANGE_PERIOD;
            bytes.clear();
            line.poll(now, &mut image, &mut bytes);
            session.push(now, &bytes, &mut slot);
            if now >= STREAMING_TIME {
                messages.extend(&bytes);
            } else {
                before = session.health().scans;
            }
            if let Some(request) = session.poll(now) {
                line.receive(now, request.bytes());
            }
        }
        let messages_count = (session.health().scans - before) as usize;
        Ok(Stream { session, slot, messages, messages_count, now })
    }

    /// Takes some messages, whole rounds of those collected; gives their bytes.
    fn take(&mut self, count: usize) -> usize {
        let rounds = count.div_ceil(self.messages_count.max(1));
        for _ in 0..rounds {
            for piece in self.messages.chunks(PIECE_BYTES) {
                self.now += Nanos::from_micros(500);
                self.session.push(self.now, piece, &mut self.slot);
                let _ = self.session.poll(self.now);
            }
        }
        rounds * self.messages.len()
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let mut out = std::io::stdout();
    if let [option, name, count] = arguments.as_slice()
        && option == "--instructions"
    {
        let mut stream = Stream::new(name)?;
        let bytes = stream.take(count.parse()?);
        writeln!(out, "{bytes}")?;
        return Ok(());
    }
    for (name, bytes_s) in BOARD_RATES {
        let mut stream = Stream::new(name)?;
        let mut times = Vec::new();
        for _ in 0..SLICES_COUNT {
            let begin = Instant::now();
            let bytes = stream.take(SLICE_MESSAGES);
            times.push(begin.elapsed().as_nanos() as f64 / bytes as f64);
        }
        times.sort_by(f64::total_cmp);
        let (median, damaged) = (times[SLICES_COUNT / 2], stream.session.health().garbled);
        let share = 100.0 * 10.0 * bytes_s * median * 1e-9;
        writeln!(
            out,
            "{name}: {median:.2} ns a byte, {share:.2} % of a core at ten times the line's rate, \
             {damaged} damaged"
        )?;
    }
    Ok(())
}
