//! The encoders of a robot that is wired otherwise than its machine file says: what the discs show
//! at an instant, and where their index pulses come, by channels, directions and counts of the
//! scene's `[world_joints]`.

use taktil_hal::link::{Receiver, Sender, link};
use taktil_hal::{CHANNELS, Counts, Devices, Encoders, Error, Nanos, Reading};
use taktil_lab_scene::scene::Scene;
use taktil_machine::joints::JointsConfig;
use taktil_machine::with_robot;
use taktil_rtcore::Invalid;
use taktil_sim::IndexPulsePlaces;

/// Counts on their way to the half: the newest ones are all that matters.
const LINK_CAPACITY: usize = 2;

/// The counts of the world's own encoders as a half, so that the wiring can stand before it.
struct WorldEncoders {
    counts: Receiver<[Counts; CHANNELS]>,
    newest: [Counts; CHANNELS],
    joints: usize,
}

impl Encoders for WorldEncoders {
    fn joints(&self) -> usize {
        self.joints
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<[Counts; CHANNELS]>, Error> {
        self.newest = self.counts.newest(Nanos::MAX).map_or(self.newest, |newest| newest.value);
        Ok(Reading { value: self.newest, acquired: release })
    }
}

/// The encoders by channel.
pub(crate) struct WiredEncoders {
    world: Sender<[Counts; CHANNELS]>,
    half: Box<dyn Encoders>,
}

impl WiredEncoders {
    /// The encoders of the robot of a scene; `None` where they are in the order and direction of
    /// its joints.
    ///
    /// # Errors
    /// What [`JointsConfig::as_wired`] refuses.
    pub(crate) fn new(scene: &Scene) -> Result<Option<WiredEncoders>, Invalid> {
        // What a code is worth does not concern encoders.
        let wired = JointsConfig {
            full_scale_codes: None,
            full_scale_v: None,
            codes_per_nm: None,
            volts_per_nm: None,
            ..scene.wired.clone()
        };
        if wired == JointsConfig::default() {
            return Ok(None);
        }
        let (world, counts) = link(LINK_CAPACITY);
        let joints = scene.plain_robot.joints();
        let half = WorldEncoders { counts, newest: [Counts(0); CHANNELS], joints };
        let devices = Devices { encoders: Some(Box::new(half)), ..Devices::default() };
        let encoders = wired.as_wired(&scene.plain_robot, devices, &[])?.encoders;
        Ok(encoders.map(|half| WiredEncoders { world, half }))
    }

    /// What the channels show where the world's encoders have these counts.
    pub(crate) fn counts(&mut self, world: [Counts; CHANNELS]) -> [Counts; CHANNELS] {
        // The half has taken what was sent before.
        let _ = self.world.send(world, Nanos::ZERO, Nanos::ZERO);
        self.half.sample(Nanos::ZERO).map_or(world, |reading| reading.value)
    }
}

/// Where the index pulses of each channel come, for those of the world's encoders; a channel
/// without an encoder has none.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked scales")]
pub(crate) fn index_pulse_places(
    scene: &Scene,
    world: &[IndexPulsePlaces],
    channels: usize,
) -> Vec<IndexPulsePlaces> {
    let wired = &scene.wired;
    let sizes = |robot: &taktil_machine::robot::AnyRobot| {
        with_robot!(robot, robot => {
            let gear = |i: usize| robot.gears.gear_matrix()[(i, i)];
            let counts = robot.gears.counts_per_revolution();
            (0..robot.home_rad.len()).map(|i| (gear(i), counts[i])).collect::<Vec<_>>()
        })
    };
    let Ok(scaled) = wired.applied_to(scene.plain_robot.clone()) else { return Vec::new() };
    let (own, other) = (sizes(&scene.plain_robot), sizes(&scaled));
    let mut places = vec![IndexPulsePlaces { first: Counts(0), turn_counts: 0 }; channels];
    for (joint, place) in world.iter().enumerate() {
        let of = |list: &Option<Vec<f64>>, usual: f64| {
            list.as_ref().and_then(|list| list.get(joint)).copied().unwrap_or(usual)
        };
        let channel = of(&wired.encoder_channel, joint as f64) as usize;
        let (Some((gear, counts)), Some((new_gear, new_counts)), Some(slot)) =
            (own.get(joint), other.get(joint), places.get_mut(channel))
        else {
            continue;
        };
        *slot = if new_gear == gear {
            let scale = of(&wired.encoder_sign, 1.0) * new_counts / counts;
            let scaled = |count: i32| (f64::from(count) * scale).round() as i32;
            let turn_counts = scaled(place.turn_counts).abs();
            IndexPulsePlaces { first: Counts(scaled(place.first.0)), turn_counts }
        } else {
            // A disc on another gear has pulses of its own: half a turn from where it stood.
            let turn_counts = new_counts.round() as i32;
            IndexPulsePlaces { first: Counts(turn_counts / 2), turn_counts }
        };
    }
    places
}
