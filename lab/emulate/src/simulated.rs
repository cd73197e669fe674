//! The simulated robot behind the boards: its world and the halves through which it is driven. It
//! is integrated only as far as somebody looks, and only to instants at which something happens, so
//! that who looks in between does not change its bits.
//!
//! Boards have a time of their own: the world's time begins when it is started, and until then the
//! robot stands still.

use taktil_hal::{
    AnalogIn, AnalogOut, Arrival, CHANNELS, Counts, DacCode, Devices, DigitalOut, Encoders,
    FORCE_TORQUE_CHANNELS, ForceTorque, IndexPulses, LinesIn, LinesOut, Nanos, TACTILE,
    TactileArray, TactileFrame,
};
use taktil_lab_scene::assembly::Assembly;
use taktil_lab_scene::scene::Scene;
use taktil_machine::source::Located;
use taktil_sim::{IndexPulsePlaces, Timing, World};

use crate::wired::{WiredEncoders, index_pulse_places};

/// A tactile array of the simulator with the newest scan that was complete.
struct SimulatedArray {
    half: Box<dyn TactileArray>,
    frame: TactileFrame,
}

impl SimulatedArray {
    fn new(half: Box<dyn TactileArray>) -> SimulatedArray {
        let frame = TactileFrame::of(half.as_ref());
        SimulatedArray { half, frame }
    }

    /// Takes the newest scan that is complete at `now`; a scan that is lost leaves the old one.
    fn update(&mut self, now: Nanos) {
        let _: Result<Arrival, _> = self.half.sample(now, &mut self.frame);
    }
}

/// Size and width of a tactile array.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct ArrayShape {
    pub(crate) rows: usize,
    pub(crate) cols: usize,
    /// Width of a count (bits).
    pub(crate) bits: u32,
}

/// The state of the amplifiers' inputs and the lines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Commands {
    pub(crate) codes: [i32; CHANNELS],
    pub(crate) lines: LinesOut,
}

/// What the robot's sensors read.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SensorReadings {
    pub(crate) counts: [Counts; CHANNELS],
    pub(crate) index: IndexPulses,
    pub(crate) currents: [i32; CHANNELS],
    pub(crate) gauges: [i32; FORCE_TORQUE_CHANNELS],
    pub(crate) lines: LinesIn,
}

/// The newest scan of an array, row by row.
pub(crate) struct NewestScan<'a> {
    pub(crate) sequence: u32,
    /// Width of a count (bits).
    pub(crate) bits: u32,
    pub(crate) values: &'a [u16],
}

/// The world with its devices. Instants are those of the boards.
pub(crate) struct SimulatedRobot {
    world: World,
    /// When the world's time is 0; absent while it waits to be started.
    zero: Option<Nanos>,
    /// The newest commands of boards before a world that waits.
    waiting: Option<Commands>,
    timing: Timing,
    joints: usize,
    /// Encoders that are not in the order and direction of the joints.
    wired: Option<WiredEncoders>,
    pulse_places: Vec<IndexPulsePlaces>,
    encoders: Option<Box<dyn Encoders>>,
    analog_out: Option<Box<dyn AnalogOut>>,
    analog_in: Option<Box<dyn AnalogIn>>,
    force_torque: Option<Box<dyn ForceTorque>>,
    /// What the sensors read last.
    readings: SensorReadings,
    digital_out: Option<Box<dyn DigitalOut>>,
    arrays: Vec<SimulatedArray>,
}

impl SimulatedRobot {
    /// The robot of a scene, at its start.
    ///
    /// # Errors
    /// An error in the scene, located.
    pub(crate) fn new(scene: &Scene, seed: u64) -> Result<SimulatedRobot, Located> {
        let (world, devices) =
            Assembly::new(scene).with_seed(seed).without_drives().build_world()?;
        let Devices {
            encoders, analog_out, analog_in, force_torque, digital_out, mut tactile, ..
        } = devices;
        let joints = encoders.as_ref().map_or(0, |half| half.joints());
        let timing = *world.timing();
        let wired = WiredEncoders::new(scene);
        let wired = wired.map_err(|bad| scene.locate(bad.within("world_joints")))?;
        let mut pulse_places = world.index_pulse_places().unwrap_or_default();
        if wired.is_some() && !pulse_places.is_empty() {
            pulse_places = index_pulse_places(scene, &pulse_places, joints);
        }
        if !scene.world.tactile.present {
            tactile.remove(TACTILE);
        }
        // The finger's array comes first, because its name is the beginning of the others'.
        let arrays = tactile.into_values().map(SimulatedArray::new).collect();
        Ok(SimulatedRobot {
            world,
            zero: Some(Nanos::ZERO),
            waiting: None,
            timing,
            joints,
            wired,
            pulse_places,
            encoders,
            analog_out,
            analog_in,
            force_torque,
            readings: SensorReadings::default(),
            digital_out,
            arrays,
        })
    }

    pub(crate) fn world(&self) -> &World {
        &self.world
    }

    /// Lets the world wait until it is started.
    pub(crate) fn hold(&mut self) {
        self.zero = None;
    }

    /// The world's time is 0 at `now`, unless it has begun.
    pub(crate) fn start(&mut self, now: Nanos) {
        if self.zero.is_none() {
            self.zero = Some(now);
            if let Some(commands) = self.waiting.take() {
                self.drive(now, &commands);
            }
        }
    }

    /// The world's time at an instant of the boards.
    fn world_time(&self, at: Nanos) -> Nanos {
        self.zero.map_or(Nanos::ZERO, |zero| (at - zero).max(Nanos::ZERO))
    }

    pub(crate) fn joints(&self) -> usize {
        self.joints
    }

    /// Where the index pulses of each encoder come; empty where the scene describes none.
    pub(crate) fn index_pulse_places(&self) -> &[IndexPulsePlaces] {
        &self.pulse_places
    }

    /// Shapes of the arrays: that of the finger, then the one opposed to it.
    pub(crate) fn arrays(&self) -> Vec<ArrayShape> {
        let shape = |array: &SimulatedArray| ArrayShape {
            rows: array.half.rows(),
            cols: array.half.cols(),
            bits: u16::BITS - array.half.full_scale().leading_zeros(),
        };
        self.arrays.iter().map(shape).collect()
    }

    /// Scans a second.
    pub(crate) fn scan_rate_hz(&self) -> f64 {
        1.0 / self.timing.scan_period.as_secs_f64()
    }

    /// Integrates up to `to` and takes the scans that are complete by then.
    pub(crate) fn advance(&mut self, to: Nanos) {
        let to = self.world_time(to);
        self.world.advance(to);
        for array in &mut self.arrays {
            array.update(to);
        }
    }

    fn code_range(&self) -> (DacCode, DacCode) {
        self.analog_out.as_ref().map_or_else(Default::default, |half| half.code_range())
    }

    /// The code of full-scale current.
    pub(crate) fn full_codes(&self) -> f64 {
        -f64::from(self.code_range().0.0)
    }

    /// The amplifiers' inputs and the lines are these from `at` on, which is no instant before one
    /// that was given.
    pub(crate) fn drive(&mut self, at: Nanos, commands: &Commands) {
        if self.zero.is_none() {
            self.waiting = Some(*commands);
            return;
        }
        let (low, high) = self.code_range();
        let codes = commands.codes.map(|code| DacCode(code.clamp(low.0, high.0)));
        // A command acts one actuation delay after its release.
        let release = self.world_time(at) - self.timing.actuation_delay;
        // A link that is full belongs to a world that was not advanced; the next command repeats
        // what is lost.
        let _ = self.analog_out.as_mut().map(|half| half.commit(release, &codes));
        let _ = self.digital_out.as_mut().map(|half| half.commit(release, &commands.lines));
    }

    /// What the encoders show, as far as the world has been integrated.
    pub(crate) fn counts(&mut self) -> [Counts; CHANNELS] {
        let counts = self.world.encoder_counts();
        self.wired.as_mut().map_or(counts, |wired| wired.counts(counts))
    }

    pub(crate) fn lines_in(&self) -> LinesIn {
        self.world.lines_in()
    }

    /// What the sensors read at `at`, up to which the world has been integrated; converters that
    /// have nothing new keep their value.
    pub(crate) fn readings(&mut self, at: Nanos) -> SensorReadings {
        let at = self.world_time(at);
        let mut readings = self.readings;
        readings.counts = self.counts();
        readings.lines = self.world.lines_in();
        if let Some(encoders) = &mut self.encoders {
            let _ = encoders.sample(at);
            readings.index = encoders.index_pulses();
        }
        if let Some(Ok(codes)) = self.analog_in.as_mut().map(|half| half.sample(at)) {
            readings.currents = codes.value.map(|code| code.0);
        }
        if let Some(Ok(codes)) = self.force_torque.as_mut().map(|half| half.sample(at)) {
            readings.gauges = codes.value.codes.map(|code| code.0);
        }
        self.readings = readings;
        readings
    }

    /// The newest scan of the finger's array that was taken when the world was integrated; `None`
    /// before the first one.
    pub(crate) fn newest_scan(&self) -> Option<NewestScan<'_>> {
        let array = self.arrays.first()?;
        let frame = &array.frame;
        let bits = u16::BITS - array.half.full_scale().leading_zeros();
        let any = frame.valid.iter().any(|valid| *valid);
        any.then_some(NewestScan { sequence: frame.sequence, bits, values: &frame.values })
    }

    /// The newest scan of an array that is complete at `at`, row by row. The world is integrated to
    /// the instant of that scan only.
    pub(crate) fn scan(&mut self, array: usize, at: Nanos) -> &[u16] {
        let (period, at) = (self.timing.scan_period.0.max(1), self.world_time(at));
        self.world.advance(Nanos(at.0.div_euclid(period) * period));
        let Some(array) = self.arrays.get_mut(array) else { return &[] };
        array.update(at);
        &array.frame.values
    }
}
