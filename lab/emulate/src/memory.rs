//! A board of registers before the simulated robot: codes in its registers drive the motors, its
//! lines the drives, and its counters, converters and tactels show what the robot's sensors read.
//!
//! The board may run in a thread of its own, because a driver looks at a busy bit for some
//! microseconds only. It exchanges values with the robot over links in either case.

use std::path::Path;

use serde::Deserialize;
use taktil_drivers_regmap_emulator::{Emulator, Inputs, Plant};
use taktil_hal::fault::FaultPlan;
use taktil_hal::link::{Receiver, Sender, link};
use taktil_hal::{CHANNELS, LinesOut, MAX_TACTELS, Nanos};
use taktil_machine_console::option::BadOption;

use crate::array::rescaled;
use crate::board::Traffic;
use crate::simulated::{Commands, SensorReadings, SimulatedRobot};

/// From one exchange with the robot to the next.
const EXCHANGE_PERIOD: Nanos = Nanos::from_micros(250);
/// How often commands that stay are told to the world again, which takes silence for a cable that
/// is off: well below its 50 ms.
const REFRESH_TIME: Nanos = Nanos::from_millis(20);
/// Values on their way between the board and the robot.
const LINK_CAPACITY: usize = 256;
/// Scans on their way.
const SCAN_LINK_CAPACITY: usize = 4;
/// Width of the simulator's own converters (bits).
const SIMULATED_BITS: u32 = 12;

/// One row of channels of a description.
#[derive(Clone, Copy, Debug, Deserialize)]
struct BankText {
    channels: usize,
    #[serde(default)]
    bits: u32,
    /// Where the driver looks whether something is under way.
    busy_offset: Option<usize>,
}

/// The tactile array of a description.
#[derive(Clone, Copy, Debug, Deserialize)]
struct TactileText {
    rows: usize,
    cols: usize,
    bits: u32,
}

/// What a description says of the sizes of a board.
#[derive(Clone, Debug, Deserialize)]
struct BoardText {
    name: String,
    encoders: BankText,
    analog_out: BankText,
    analog_in: Option<BankText>,
    force_torque: Option<BankText>,
    tactile: Option<TactileText>,
    digital_out: Option<toml::Table>,
    watchdog: Option<toml::Table>,
}

/// What the board puts out.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Driven {
    codes: [i32; CHANNELS],
    lines: LinesOut,
}

type Scan = [u16; MAX_TACTELS];

/// The links of the board to the robot.
struct RobotLinks {
    readings: Sender<SensorReadings>,
    scans: Sender<Scan>,
    driven: Receiver<Driven>,
}

/// The other ends of these links.
struct BoardLinks {
    readings: Receiver<SensorReadings>,
    scans: Receiver<Scan>,
    driven: Sender<Driven>,
}

/// The board and what it put out last.
pub(crate) struct MemoryBoard {
    sizes: BoardText,
    text: &'static str,
    name: String,
    plan: FaultPlan,
    seed: u64,
    emulator: Option<Emulator>,
    links: Option<RobotLinks>,
    driven: Driven,
    /// When the world was last told.
    told: Nanos,
    /// When the robot was last looked at.
    exchanged: Option<Nanos>,
    /// Number of the newest scan that was shown.
    scan: Option<u32>,
    /// The relay's line, where the board drives none.
    feed: bool,
    changes: u64,
    shown_scans: u64,
}

impl MemoryBoard {
    /// The board of a description, which needs a file before it can be opened.
    pub(crate) fn new(
        robot: &SimulatedRobot,
        text: &'static str,
        plan: FaultPlan,
        name: &str,
        seed: u64,
    ) -> anyhow::Result<MemoryBoard> {
        let sizes: BoardText = toml::from_str(text)?;
        let channels = sizes.encoders.channels.min(sizes.analog_out.channels);
        if robot.joints() > channels {
            let text = format!(
                "{name}: the board has {channels} channels, the scene's arm {} joints; take a \
                 scene whose arm has fewer",
                robot.joints()
            );
            return Err(BadOption(text).into());
        }
        if let (Some(tactile), Some(shape)) = (sizes.tactile, robot.arrays().first())
            && tactile.rows * tactile.cols != shape.rows * shape.cols
        {
            let text = format!(
                "{name}: the board has {} x {} tactels, the scene's array {} x {}; take another \
                 board",
                tactile.rows, tactile.cols, shape.rows, shape.cols
            );
            return Err(BadOption(text).into());
        }
        Ok(MemoryBoard {
            sizes,
            text,
            name: name.to_owned(),
            plan,
            seed,
            emulator: None,
            links: None,
            driven: Driven::default(),
            told: Nanos::ZERO,
            exchanged: None,
            scan: None,
            feed: false,
            changes: 0,
            shown_scans: 0,
        })
    }

    /// What it is and serves, for people.
    pub(crate) fn description(&self, robot: &SimulatedRobot) -> String {
        let index = if robot.index_pulse_places().is_empty() { "without" } else { "with" };
        let bits = self.sizes.analog_out.bits;
        let mut text = format!(
            "{}: {} motors and encoders {index} index pulses, {bits} bits for full-scale current",
            self.sizes.name,
            robot.joints()
        );
        text += match (self.sizes.analog_in, self.sizes.force_torque) {
            (Some(_), Some(_)) => "; A/D: motor currents; gauges in registers of their own",
            (Some(_), None) => "; A/D: gauges at channels 0 to 5, then motor currents",
            (None, _) => "",
        };
        if self.sizes.tactile.is_some() && !robot.arrays().is_empty() {
            text += "; the finger's array";
        }
        text + match (&self.sizes.digital_out, &self.sizes.watchdog) {
            (Some(_), _) => "; lines",
            (None, _) => "; no lines: the drives are on and the brakes lifted",
        }
    }

    /// Puts the board behind a file, which is made.
    pub(crate) fn attach(&mut self, path: &Path) -> anyhow::Result<()> {
        let (readings_tx, readings_rx) = link(LINK_CAPACITY);
        let (scans_tx, scans_rx) = link(SCAN_LINK_CAPACITY);
        let (driven_tx, driven_rx) = link(LINK_CAPACITY);
        let ends = BoardLinks { readings: readings_rx, scans: scans_rx, driven: driven_tx };
        let plant = plant(ends, &self.sizes);
        let complain = |place: &str, what: String, remedy: String| {
            BadOption(format!("{place} {}: {what}; {remedy}", path.display()))
        };
        let emulator = Emulator::new(&self.name, self.text, path, 0, plant);
        let mut emulator = emulator.map_err(|bad| complain("--link", bad.what, bad.remedy))?;
        emulator.set_faults(self.plan.clone(), self.seed).map_err(|bad| {
            BadOption(format!("--fault {}: {}; {}", bad.place, bad.what, bad.remedy))
        })?;
        // As short as the driver's looks at the busy bit: some tens of microseconds.
        emulator.set_conversion_time(Nanos::ZERO);
        self.links = Some(RobotLinks { readings: readings_tx, scans: scans_tx, driven: driven_rx });
        self.emulator = Some(emulator);
        Ok(())
    }

    /// Whether a driver waits for bits of the board.
    pub(crate) fn has_busy_bits(&self) -> bool {
        let inputs = [self.sizes.analog_in, self.sizes.force_torque];
        let inputs = inputs.into_iter().flatten().any(|bank| bank.busy_offset.is_some());
        inputs || self.sizes.encoders.busy_offset.is_some()
    }

    /// Gives the board away, to a thread that lets it run.
    pub(crate) fn detach(&mut self) -> Option<Emulator> {
        self.emulator.take()
    }

    /// The next instant at which it does something by itself.
    pub(crate) fn next_event(&self) -> Nanos {
        self.exchanged.map_or(Nanos::ZERO, |exchanged| exchanged + EXCHANGE_PERIOD)
    }

    /// Executes what happens at `now`: the sensors of the robot are read, and it is driven by what
    /// the board puts out.
    pub(crate) fn step(&mut self, now: Nanos, robot: &mut SimulatedRobot) {
        if self.exchanged.is_some_and(|exchanged| now < exchanged + EXCHANGE_PERIOD) {
            return;
        }
        self.exchanged = Some(now);
        robot.advance(now);
        let Some(links) = &mut self.links else { return };
        // A link that is full belongs to a board that does not run; the next readings replace
        // these.
        let _ = links.readings.send(robot.readings(now), now, now);
        if let Some(scan) = robot.newest_scan()
            && self.scan != Some(scan.sequence)
            && let Some(tactile) = self.sizes.tactile
        {
            self.scan = Some(scan.sequence);
            let mut values = [0; MAX_TACTELS];
            for (value, count) in values.iter_mut().zip(scan.values) {
                *value = rescaled(*count, scan.bits, tactile.bits);
            }
            self.shown_scans += u64::from(links.scans.send(values, now, now).is_ok());
        }
        if let Some(emulator) = &mut self.emulator
            && emulator.step(now).is_err()
        {
            // A file that cannot be written any more is a board that is gone.
            self.emulator = None;
        }
        self.drive(now, robot);
    }

    fn drive(&mut self, now: Nanos, robot: &mut SimulatedRobot) {
        let Some(links) = &mut self.links else { return };
        let newest = links.driven.newest(Nanos::MAX).map_or(self.driven, |newest| newest.value);
        let refresh = now - self.told >= REFRESH_TIME;
        if newest == self.driven && !refresh {
            return;
        }
        self.changes += u64::from(newest != self.driven);
        if newest != self.driven {
            robot.start(now);
        }
        (self.driven, self.told) = (newest, now);
        let (full, bits) = (robot.full_codes(), self.sizes.analog_out.bits);
        let codes = newest.codes.map(|code| simulated_code(code, bits, full));
        let lines = if self.sizes.digital_out.is_some() {
            newest.lines
        } else {
            self.feed = !self.feed;
            LinesOut { enable: true, brake_release: true, watchdog_feed: self.feed }
        };
        robot.drive(now, &Commands { codes, lines });
    }

    pub(crate) fn traffic(&self) -> Traffic {
        Traffic::Memory { changes: self.changes, scans: self.shown_scans }
    }
}

/// The robot as the board sees it: what came over the links last, and where its outputs go.
fn plant(mut ends: BoardLinks, sizes: &BoardText) -> Plant {
    let (mut newest, mut sent) = (SensorReadings::default(), None);
    let input_bits = sizes.analog_in.map_or(SIMULATED_BITS, |bank| bank.bits);
    let gauge_bits = sizes.force_torque.map(|bank| bank.bits);
    let tactels = sizes.tactile.map_or(0, |tactile| tactile.rows * tactile.cols);
    Box::new(move |_, outputs| {
        newest = ends.readings.newest(Nanos::MAX).map_or(newest, |newest| newest.value);
        let mut driven = Driven { lines: outputs.lines, ..Driven::default() };
        for (code, put) in driven.codes.iter_mut().zip(&outputs.codes) {
            *code = *put;
        }
        if sent != Some(driven) && ends.driven.send(driven, Nanos::ZERO, Nanos::ZERO).is_ok() {
            sent = Some(driven);
        }
        let gauges = newest.gauges.iter().copied();
        let currents = newest.currents.iter().copied();
        let codes: Vec<i32> = match gauge_bits {
            Some(_) => currents.collect(),
            None => gauges.clone().chain(currents).collect(),
        };
        Inputs {
            counts: newest.counts.iter().map(|count| i64::from(count.0)).collect(),
            index: newest.index.iter().map(|at| at.map(|count| i64::from(count.0))).collect(),
            codes: codes.into_iter().map(|code| widened(code, input_bits)).collect(),
            gauges: gauges.map(|code| widened(code, gauge_bits.unwrap_or(input_bits))).collect(),
            lines: newest.lines,
            frame: ends.scans.newest(Nanos::MAX).map(|scan| scan.value[..tactels].to_vec()),
        }
    })
}

/// The code of a converter of `bits` for one of the simulated converters; an end of their range is
/// an end of its range, so that a clipped input is one for the driver too.
fn widened(code: i32, bits: u32) -> i32 {
    let half = 1 << (SIMULATED_BITS - 1);
    if code >= half - 1 {
        return i32::MAX >> (32 - bits.clamp(2, 31));
    }
    let factor = 1 << bits.saturating_sub(SIMULATED_BITS);
    (code.max(-half) * factor) >> SIMULATED_BITS.saturating_sub(bits)
}

/// The code of the simulated converters for a code of `bits`: the lowest one is full-scale current.
fn simulated_code(code: i32, bits: u32, full_codes: f64) -> i32 {
    let half = f64::from(1_u32 << bits.clamp(1, 31).saturating_sub(1));
    #[expect(clippy::cast_possible_truncation, reason = "saturation is intended")]
    let code = (f64::from(code) / half * full_codes).round() as i32;
    code
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_code_of_any_width_is_the_same_share_of_full_scale() {
        assert_eq!(simulated_code(-2_048, 12, 2_048.0), -2_048);
        assert_eq!(simulated_code(16_384, 16, 2_048.0), 1_024);
        assert_eq!(simulated_code(7, 12, 2_048.0), 7);
    }

    #[test]
    fn a_clipped_input_is_clipped_in_any_width() {
        for bits in [10, 12, 16] {
            let (low, high) = (-(1 << (bits - 1)), (1 << (bits - 1)) - 1);
            assert_eq!([-2_048, 2_047].map(|code| widened(code, bits)), [low, high], "{bits}");
            assert!((low + 1..high).contains(&widened(1_024, bits)));
        }
        assert_eq!([widened(100, 16), widened(100, 12), widened(-7, 12)], [1_600, 100, -7]);
    }
}
