//! Serves an emulated tactile array on a pseudo-terminal in real time, with a load that moves
//! around the centre: `serve --board myrmex --link pad --rate 200 --fault "kind=..."`.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use taktil_drivers_serial_emulator::{Board, FlexiTac, Line, Myrmex, WeissDsa, WeissWts, serve};
use taktil_hal::fault::{Fault, FaultPlan};
use taktil_hal::{Clock, Nanos};

struct Monotonic(Instant);

impl Monotonic {
    #[expect(clippy::disallowed_methods, reason = "an emulator serves in real time")]
    fn start() -> Monotonic {
        Monotonic(Instant::now())
    }
}

impl Clock for Monotonic {
    #[expect(clippy::disallowed_methods, reason = "an emulator serves in real time")]
    fn now(&self) -> Nanos {
        Nanos(self.0.elapsed().as_nanos() as i64)
    }

    fn sleep_until(&self, instant: Nanos) {
        let wait = instant - self.now();
        std::thread::sleep(Duration::from_nanos(wait.0.max(0) as u64));
    }
}

/// The command line.
struct Options {
    board: String,
    link: PathBuf,
    rate_hz: f64,
    rows: u16,
    cols: u16,
    seconds: f64,
    seed: u64,
    faults: Vec<Fault>,
}

fn options() -> Result<Options, Box<dyn std::error::Error>> {
    let mut given = Options {
        board: "myrmex".to_owned(),
        link: std::env::temp_dir().join("taktil-pad"),
        rate_hz: 100.0,
        rows: 16,
        cols: 16,
        seconds: 3600.0,
        seed: 1,
        faults: Vec::new(),
    };
    let mut words = std::env::args().skip(1);
    while let Some(key) = words.next() {
        let value = words.next().ok_or_else(|| format!("{key} needs a value"))?;
        match key.as_str() {
            "--board" => given.board = value,
            "--link" => given.link = value.into(),
            "--rate" => given.rate_hz = value.parse()?,
            "--rows" => given.rows = value.parse()?,
            "--cols" => given.cols = value.parse()?,
            "--seconds" => given.seconds = value.parse()?,
            "--seed" => given.seed = value.parse()?,
            "--fault" => given.faults.push(value.parse()?),
            _ => return Err(format!("{key} is no option").into()),
        }
    }
    Ok(given)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let given = options()?;
    let (rows, cols, rate_hz) = (given.rows, given.cols, given.rate_hz);
    let board: Box<dyn Board> = match given.board.as_str() {
        "myrmex" => Box::new(Myrmex::new(rate_hz)),
        "flexitac" => Box::new(FlexiTac::new(rows.into(), cols.into(), rate_hz)),
        "weiss-wts" => Box::new(WeissWts::new(rows, cols, rate_hz)),
        "weiss-dsa" => Box::new(WeissDsa::new(rows, cols, rate_hz)),
        other => return Err(format!("{other} is no board").into()),
    };
    let mut line = Line::new(board, &given.board, FaultPlan::new(given.faults), given.seed)?;
    println!("{}", given.link.display());
    let (clock, cols) = (Monotonic::start(), usize::from(cols));
    let mut image = |now: Nanos, values: &mut [u16]| {
        let step = (now.0 / 100_000_000) as usize % 4;
        for (tactel, value) in values.iter_mut().enumerate() {
            let (row, col) = (tactel / cols, tactel % cols);
            let distance = row.abs_diff(6 + step) + col.abs_diff(6 + step);
            *value = 20 + 180_u16.saturating_sub(40 * distance as u16);
        }
    };
    let end = Nanos((1e9 * given.seconds) as i64);
    serve(&mut line, &given.link, &clock, &mut image, &mut |now| now >= end)?;
    Ok(())
}
