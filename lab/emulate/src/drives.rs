//! Drives on a CAN bus before the simulated robot: the torque that each is asked for is the current
//! of its motor, and its position follows the disc.

use taktil_drivers_can_emulator::{Emulator, Kind, Outputs};
use taktil_hal::fault::FaultPlan;
use taktil_hal::{CHANNELS, Counts, LinesIn, LinesOut, Nanos};

use crate::board::Traffic;
use crate::simulated::{Commands, SimulatedRobot};

/// Rated torque of every drive (mNm): a number to ask for, since the arm's gears are its own.
const RATED_TORQUE_MNM: u32 = 1_000;
/// The torque that is full-scale current, in thousandths of the rated one.
const FULL_SCALE_TORQUE: f64 = 1_000.0;
/// How often a torque that stays is told to the world again, which takes silence for a cable that
/// is off: well below its 50 ms.
const REFRESH_TIME: Nanos = Nanos::from_millis(20);

/// The bus and what its drives put out last.
pub(crate) struct DriveBus {
    emulator: Emulator,
    drives: usize,
    commands: Commands,
    /// When the world was last told.
    driven: Nanos,
    /// The relay's line, which no drive has: it lives as long as the drives do.
    feed: bool,
    /// Frames for the host.
    pub(crate) outbox: Vec<Vec<u8>>,
}

impl DriveBus {
    pub(crate) fn new(robot: &SimulatedRobot, plan: FaultPlan, name: &str, seed: u64) -> DriveBus {
        let drives = robot.joints();
        let ids: Vec<u8> = (1..=drives as u8).collect();
        let emulator = Emulator::new(Kind::CanOpen(RATED_TORQUE_MNM), &ids)
            .without_motors()
            .with_faults(plan, name, seed);
        DriveBus {
            emulator,
            drives,
            commands: Commands { codes: [0; CHANNELS], lines: LinesOut::SAFE },
            driven: Nanos::ZERO,
            feed: false,
            outbox: Vec::new(),
        }
    }

    /// What it is and serves, for people.
    pub(crate) fn description(&self) -> String {
        format!(
            "{} drives of CANopen, numbers 1 to {}, rated torque {RATED_TORQUE_MNM} mNm, which is \
             full-scale current; brakes are lifted when all are enabled",
            self.drives, self.drives
        )
    }

    /// The next instant at which it does something by itself.
    pub(crate) fn next_event(&self) -> Nanos {
        self.next_due().min(self.driven + REFRESH_TIME)
    }

    /// When the next frame for the host may be due.
    pub(crate) fn next_due(&self) -> Nanos {
        self.emulator.next_due().unwrap_or(Nanos::MAX)
    }

    /// Executes what happens at `now`: the robot is driven by what the drives put out.
    pub(crate) fn step(&mut self, now: Nanos, robot: &mut SimulatedRobot) {
        self.emulator.advance(now);
        let commands = self.wanted_commands(robot.full_codes());
        let refresh = now - self.driven >= REFRESH_TIME;
        if refresh || commands != self.commands {
            if refresh {
                // Whoever says the same for a long time does not fill the links.
                robot.advance(now);
            }
            self.feed = !self.feed;
            let lines = LinesOut { watchdog_feed: self.feed, ..commands.lines };
            robot.drive(now, &Commands { lines, ..commands });
            (self.commands, self.driven) = (commands, now);
        }
        self.emulator.poll(now, &mut self.outbox);
    }

    fn wanted_commands(&self, full_codes: f64) -> Commands {
        let outputs: Vec<Outputs> =
            (0..self.drives).map(|place| self.emulator.outputs(place)).collect();
        let is_enabled = outputs.iter().all(|drive| drive.is_enabled);
        let mut codes = [0; CHANNELS];
        for (code, drive) in codes.iter_mut().zip(&outputs) {
            let share = f64::from(drive.target) / FULL_SCALE_TORQUE;
            *code = if drive.is_enabled { (share * full_codes).round() as i32 } else { 0 };
        }
        let lines =
            LinesOut { enable: is_enabled, brake_release: is_enabled, watchdog_feed: false };
        Commands { codes, lines }
    }

    /// Reads the robot's discs and lines, as far as it has been integrated.
    pub(crate) fn read(&mut self, robot: &mut SimulatedRobot) {
        for (place, Counts(count)) in robot.counts().into_iter().take(self.drives).enumerate() {
            self.emulator.set_position(place, count, 1.0);
        }
        let LinesIn { drive_power, estop_a_closed, estop_b_closed } = robot.lines_in();
        self.emulator.set_voltage(drive_power && estop_a_closed && estop_b_closed);
    }

    /// Takes a frame at `now`; the discs have been read.
    pub(crate) fn receive(&mut self, now: Nanos, frame: &[u8], robot: &mut SimulatedRobot) {
        self.emulator.receive(now, frame);
        self.step(now, robot);
    }

    pub(crate) fn traffic(&self) -> Traffic {
        Traffic::Bus(self.emulator.traffic())
    }
}
