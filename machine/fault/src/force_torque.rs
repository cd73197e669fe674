//! A wrist's force/torque sensor with faults: gauges that stand still, are clipped or dead, and a
//! sensor that does not answer.

use core::ops::RangeInclusive;

use taktil_hal::fault::FaultKind;
use taktil_hal::{AdcCode, Error, FORCE_TORQUE_CHANNELS, ForceTorque, GaugeCodes, Nanos, Reading};

use crate::analog::{input_code, input_failure};
use crate::target_faults::{Answer, TargetFaults};

/// The kinds that can befall a force/torque sensor.
pub const FORCE_TORQUE_KINDS: [FaultKind; 9] = [
    FaultKind::Clipped,
    FaultKind::Frozen,
    FaultKind::Jump,
    FaultKind::Dead,
    FaultKind::Hot,
    FaultKind::Inversion,
    FaultKind::Failing,
    FaultKind::Silence,
    FaultKind::Unplugged,
];

const DEVICE: &str = "fault.force_torque";
/// Ends of the range of a gauge's converter of 12 bits, at which faults clip: the trait does not
/// say what a sensor's range is.
const GAUGE_RANGE: RangeInclusive<AdcCode> = AdcCode(-2048)..=AdcCode(2047);

/// A force/torque sensor behind faults.
pub(crate) struct FaultyForceTorque {
    half: Box<dyn ForceTorque>,
    faults: TargetFaults,
    answered: Option<(Nanos, Answer<GaugeCodes>)>,
    shown: [AdcCode; FORCE_TORQUE_CHANNELS],
}

impl FaultyForceTorque {
    pub(crate) fn new(half: Box<dyn ForceTorque>, faults: TargetFaults) -> FaultyForceTorque {
        let shown = [AdcCode(0); FORCE_TORQUE_CHANNELS];
        FaultyForceTorque { half, faults, answered: None, shown }
    }

    fn answer(&mut self, release: Nanos) -> Result<Reading<GaugeCodes>, Error> {
        let reading = self.half.sample(release);
        input_failure(&mut self.faults, release, DEVICE)?;
        let mut reading = reading?;
        let gauges = &mut reading.value;
        for channel in 0..FORCE_TORQUE_CHANNELS {
            let shown = self.shown[channel];
            let code = gauges.codes[channel];
            let faulty = input_code(&self.faults, channel, code, shown, &GAUGE_RANGE, release);
            let clipped = self.faults.has(FaultKind::Clipped, channel, release) && faulty != code;
            gauges.over_range[channel] |= clipped || faulty != code && faulty == *GAUGE_RANGE.end();
            gauges.codes[channel] = faulty;
            self.shown[channel] = faulty;
        }
        Ok(reading)
    }
}

impl ForceTorque for FaultyForceTorque {
    fn longest_wait(&self) -> Nanos {
        self.half.longest_wait()
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<GaugeCodes>, Error> {
        if let Some((_, answer)) = self.answered.filter(|(at, _)| *at == release) {
            return answer;
        }
        let answer = self.answer(release);
        self.answered = Some((release, answer));
        answer
    }
}
