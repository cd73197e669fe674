//! An EtherCAT segment before the simulated robot: the torque of its drives drives the motors,
//! their power sections are the enable and the brakes, and their encoders follow the discs.

use taktil_drivers_ethercat_emulator::{Description, Inputs, Model, Outputs, Segment, Shaft};
use taktil_hal::fault::FaultPlan;
use taktil_hal::{CHANNELS, Counts, Invalid, LinesIn, LinesOut, Nanos};

use crate::board::Traffic;
use crate::simulated::{Commands, SimulatedRobot};

/// From one look of the drives at their motors to the next, when no frame comes.
const LOOK_TIME: Nanos = Nanos::from_millis(1);
/// How often torques that stay are told to the world again, which takes silence for a cable that is
/// off: well below its 50 ms.
const REFRESH_TIME: Nanos = Nanos::from_millis(20);
/// Speeds are taken from counts that are at least so far apart.
const SPEED_TIME: Nanos = Nanos::from_millis(2);
/// Highest torque of an emulated drive, at the full-scale current of its motor (0.1 % of the rated
/// torque).
const TORQUE_MAX_PERMILLE: u16 = 1_000;

/// The segment and what it put out last.
pub(crate) struct DriveSegment {
    segment: Segment,
    outputs: Outputs,
    enabled: bool,
    /// When the world was last told.
    driven: Nanos,
    looked: Nanos,
    /// Where the discs were when speeds were taken, and the speeds.
    reference: (Nanos, [Counts; CHANNELS]),
    speeds: [f64; CHANNELS],
    feed: bool,
    /// Frames for the host.
    pub(crate) outbox: Vec<Vec<u8>>,
}

impl DriveSegment {
    /// A coupler, a terminal with the lines, and a drive for each joint.
    ///
    /// # Errors
    /// A fault that no segment can have.
    pub(crate) fn new(
        robot: &SimulatedRobot,
        plan: FaultPlan,
        name: &str,
        seed: u64,
    ) -> Result<DriveSegment, Invalid> {
        let drive = || {
            let most = TORQUE_MAX_PERMILLE.to_le_bytes();
            Description::from(Model::Drive).with_object(0x6072, 0, &most)
        };
        let mut devices = vec![Model::Coupler.into(), Model::DigitalInput.into()];
        devices.extend((0..robot.joints()).map(|_| drive()));
        let segment = Segment::without_plant(devices).with_faults(plan, name, seed)?;
        Ok(DriveSegment {
            segment,
            outputs: Outputs::default(),
            enabled: false,
            driven: Nanos::ZERO,
            looked: Nanos::ZERO,
            reference: (Nanos::ZERO, [Counts::default(); CHANNELS]),
            speeds: [0.0; CHANNELS],
            feed: false,
            outbox: Vec::new(),
        })
    }

    /// What it is, for people.
    pub(crate) fn description(robot: &SimulatedRobot) -> String {
        format!(
            "EK1100, EL1008 and {} CiA 402 drives with encoders, rated torque for full-scale \
             current; lines of the EL1008: drive power 0, emergency stop 1 and 2",
            robot.joints()
        )
    }

    /// The next instant at which it does something by itself.
    pub(crate) fn next_event(&self) -> Nanos {
        self.next_due().min(self.looked + LOOK_TIME)
    }

    /// When the next frame for the host is due.
    pub(crate) fn next_due(&self) -> Nanos {
        self.segment.next_due().unwrap_or(Nanos::MAX)
    }

    /// Executes what happens at `now`: the robot is driven by what the drives put out.
    pub(crate) fn step(&mut self, now: Nanos, robot: &mut SimulatedRobot) {
        if now - self.looked >= LOOK_TIME {
            robot.advance(now);
            self.read(now, robot);
            self.looked = now;
        }
        self.segment.advance(now);
        let outputs = self.segment.outputs();
        let enabled = self.segment.enabled_drives().iter().all(|enabled| *enabled);
        let is_due = now - self.driven >= REFRESH_TIME;
        if is_due || outputs != self.outputs || enabled != self.enabled {
            self.feed = !self.feed;
            robot.drive(now, &self.commands(&outputs, enabled, robot.full_codes()));
            (self.outputs, self.enabled, self.driven) = (outputs, enabled, now);
        }
        self.segment.poll(now, &mut self.outbox);
    }

    fn commands(&self, outputs: &Outputs, enabled: bool, full_codes: f64) -> Commands {
        let mut codes = [0; CHANNELS];
        for (code, torque) in codes.iter_mut().zip(&outputs.torques) {
            *code = (torque * full_codes).round() as i32;
        }
        let lines = LinesOut { enable: enabled, brake_release: enabled, watchdog_feed: self.feed };
        Commands { codes, lines }
    }

    /// Reads the robot's discs and lines, which has been integrated up to `now`.
    pub(crate) fn read(&mut self, now: Nanos, robot: &mut SimulatedRobot) {
        let counts = robot.counts();
        let (since, before) = self.reference;
        if now - since >= SPEED_TIME {
            let seconds = (now - since).as_secs_f64();
            for (speed, (now, before)) in self.speeds.iter_mut().zip(counts.iter().zip(before)) {
                *speed = f64::from(now.0.wrapping_sub(before.0)) / seconds;
            }
            self.reference = (now, counts);
        }
        let shaft = |(Counts(count), speed_counts_s): (&Counts, &f64)| Shaft {
            position_counts: f64::from(*count),
            speed_counts_s: *speed_counts_s,
        };
        let lines = robot.lines_in();
        let inputs = Inputs {
            shafts: counts.iter().zip(&self.speeds).map(shaft).take(robot.joints()).collect(),
            lines: vec![levels(lines)],
            has_supply: lines.drive_power,
            ..Inputs::default()
        };
        self.segment.set_inputs(now, inputs);
    }

    /// Takes a frame at `now`; the inputs have been read.
    pub(crate) fn receive(&mut self, now: Nanos, frame: &[u8], robot: &mut SimulatedRobot) {
        self.segment.receive(now, frame);
        self.step(now, robot);
    }

    pub(crate) fn traffic(&self) -> Traffic {
        Traffic::Segment { link: self.segment.traffic(), bites: self.segment.bites() }
    }
}

/// The levels of the terminal for these lines.
fn levels(lines: LinesIn) -> u8 {
    u8::from(lines.drive_power)
        | u8::from(lines.estop_a_closed) << 1
        | u8::from(lines.estop_b_closed) << 2
}
