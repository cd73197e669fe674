//! What is behind a segment: motors, discs and lines.

use taktil_hal::Nanos;

/// The shaft of a motor, in counts of its encoder.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Shaft {
    /// Position (counts).
    pub position_counts: f64,
    /// Speed (counts/s).
    pub speed_counts_s: f64,
}

/// What the devices put out, in their order on the segment.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Outputs {
    /// Volts at the channels of the analog outputs.
    pub volts: Vec<f64>,
    /// Lines of the digital outputs, eight bits a terminal.
    pub lines: Vec<u8>,
    /// Torque of the drives, as a part of the rated one.
    pub torques: Vec<f64>,
}

/// What the devices read, in their order on the segment; what is missing reads as zero.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Inputs {
    /// Discs of the encoder terminals (counts).
    pub counts: Vec<i64>,
    /// Volts at the channels of the analog inputs.
    pub volts: Vec<f64>,
    /// Lines of the digital inputs, eight bits a terminal.
    pub lines: Vec<u8>,
    /// Shafts of the drives.
    pub shafts: Vec<Shaft>,
    /// Whether the drives' supply is on.
    pub has_supply: bool,
}

/// A plant: told what is put out and up to when, it answers what is read then.
pub type Plant = Box<dyn FnMut(Nanos, &Outputs) -> Inputs + Send>;

/// Acceleration of a drive's shaft at the rated torque (counts/s^2).
const RATED_ACCELERATION_COUNTS_S2: f64 = 80_000.0;
/// Part of the speed that friction takes in a second (1/s).
const FRICTION_1_S: f64 = 2.0;
/// Speed of an encoder terminal's disc for a volt (counts/s).
const SPEED_PER_VOLT_COUNTS_S: f64 = 2_000.0;
/// Longest step of the integration.
const STEP_TIME_MAX: Nanos = Nanos::from_millis(1);
/// All lines of a terminal are on.
const ALL_LINES: u8 = 0xff;

/// Motors without load: the shaft of each drive follows its torque with inertia and friction, the
/// disc of each encoder terminal turns with the volts of the analog output of the same number, and
/// analog inputs and digital inputs read what the output of the same number puts out. Supply is on,
/// and digital inputs without an output of their number read true.
pub fn idle_motors() -> Plant {
    let mut last: Option<Nanos> = None;
    let (mut shafts, mut discs) = (Vec::<Shaft>::new(), Vec::<f64>::new());
    Box::new(move |now, outputs| {
        shafts.resize(outputs.torques.len(), Shaft::default());
        discs.resize(outputs.volts.len(), 0.0);
        let mut rest = now - last.replace(now).unwrap_or(now);
        while rest > Nanos::ZERO {
            let step = rest.min(STEP_TIME_MAX).as_secs_f64();
            rest -= rest.min(STEP_TIME_MAX);
            for (shaft, torque) in shafts.iter_mut().zip(&outputs.torques) {
                let friction = FRICTION_1_S * shaft.speed_counts_s;
                shaft.speed_counts_s += step * (RATED_ACCELERATION_COUNTS_S2 * torque - friction);
                shaft.position_counts += step * shaft.speed_counts_s;
            }
            for (disc, volts) in discs.iter_mut().zip(&outputs.volts) {
                *disc += step * SPEED_PER_VOLT_COUNTS_S * volts;
            }
        }
        let lines = outputs.lines.iter().copied().chain(std::iter::repeat(ALL_LINES));
        Inputs {
            counts: discs.iter().map(|disc| disc.floor() as i64).collect(),
            volts: outputs.volts.clone(),
            lines: lines.take(outputs.lines.len().max(1) + 7).collect(),
            shafts: shafts.clone(),
            has_supply: true,
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_motor_turns_with_its_torque_and_a_disc_with_its_volts() {
        let mut plant = idle_motors();
        let outputs = Outputs { volts: vec![5.0, 0.0], lines: vec![3], torques: vec![0.5] };
        plant(Nanos::ZERO, &outputs);
        let inputs = plant(Nanos::from_millis(100), &outputs);
        // Half a second's constant of friction: a tenth of it lets the speed stay below a t.
        assert!((3_500.0..4_000.0).contains(&inputs.shafts[0].speed_counts_s));
        // The steps of a millisecond round, each by less than 1e-9 counts.
        assert!((inputs.counts[0] - 1_000).abs() <= 1 && inputs.counts[1] == 0);
        assert_eq!((inputs.lines[0], inputs.lines[1]), (3, ALL_LINES));
    }
}
