//! Reads what drives that close a loop report, and raises their faults as those of the machine. The
//! drive's own code stands in the report.

use taktil_hal::{DriveActual, DriveIn, DriveState, Reading};
use taktil_rtcore::{Cycle, FaultCode, Fold, Invalid, Io, Output, Ports, StateHash};
use taktil_signal::Drives;

use crate::law::{FailureAction, ReadFailurePolicy};

/// The reports of the drives with the port that publishes them.
pub(crate) struct DriveReports<const N: usize> {
    half: Box<dyn DriveIn>,
    failures: ReadFailurePolicy,
    received: bool,
    /// Bit j is set while the drive of joint j has a fault.
    faulty: u32,
    drives: Output<Drives<N>>,
}

impl<const N: usize> Fold for DriveReports<N> {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.failures).add(&self.received).add(&self.faulty);
    }
}

impl<const N: usize> DriveReports<N> {
    /// Declares the port `drives`.
    ///
    /// # Errors
    /// Fewer drives than joints.
    pub(crate) fn new(
        half: Box<dyn DriveIn>,
        failures_max: u32,
        ports: &mut Ports,
    ) -> Result<DriveReports<N>, Invalid> {
        if half.channels() < N {
            let what = format!("the input half of the drives has {} channels", half.channels());
            return Err(Invalid::new("", what, format!("wire {N} drives")));
        }
        let drives = ports.output("drives");
        let failures = ReadFailurePolicy::new(failures_max);
        Ok(DriveReports { half, failures, received: false, faulty: 0, drives })
    }

    /// Publishes what the drives report.
    ///
    /// # Errors
    /// [`FaultCode::DriveFault`] when a fault of a drive begins, and in every job in which torque
    /// is allowed while one lasts: without torque a fault that was seen can be reset.
    /// [`FaultCode::DriveLost`] for drives that do not answer.
    pub(crate) fn read(
        &mut self,
        cycle: &Cycle,
        io: &mut Io<'_>,
        has_torque: bool,
    ) -> Result<(), FaultCode> {
        match self.half.sample(cycle.release) {
            Ok(reading) => {
                self.failures.record_success();
                self.received = true;
                let (report, faulty) = report(&reading);
                io.write(&self.drives, report);
                let begins = faulty & !self.faulty != 0;
                self.faulty = faulty;
                let raises = begins || (has_torque && faulty != 0);
                if raises { Err(FaultCode::DriveFault) } else { Ok(()) }
            }
            Err(error) => match self.failures.action_on_failure(error.kind, self.received) {
                FailureAction::Hold => Ok(()),
                FailureAction::Gone => Err(FaultCode::DriveLost),
            },
        }
    }
}

/// The report of the first `N` drives, and which of them have a fault.
fn report<const N: usize>(
    reading: &Reading<[DriveActual; taktil_hal::CHANNELS]>,
) -> (Drives<N>, u32) {
    let mut out = Drives::<N>::default();
    let mut faulty = 0;
    for (i, actual) in reading.value.iter().enumerate().take(N) {
        out.position_counts[i] = actual.position.0;
        out.velocity_counts_s[i] = actual.velocity_counts_s;
        out.torque_codes[i] = actual.torque_code;
        out.state[i] = actual.state as u16;
        out.fault_code[i] = actual.fault_code;
        faulty |= u32::from(actual.state == DriveState::Fault) << i;
    }
    (out, faulty)
}

#[cfg(test)]
mod tests {
    use super::*;
    use taktil_hal::{CHANNELS, Counts, Nanos};

    #[test]
    fn the_numbers_of_the_states_are_those_of_the_payload() {
        assert_eq!(DriveState::Following as u16, Drives::<6>::FOLLOWING_STATE);
        assert_eq!(DriveState::Fault as u16, Drives::<6>::FAULT_STATE);
        for (number, state) in DriveState::ALL.into_iter().enumerate() {
            assert_eq!(state as usize, number);
        }
    }

    #[test]
    fn a_report_names_the_drives_that_have_a_fault() {
        let mut value =
            [DriveActual { state: DriveState::Following, ..Default::default() }; CHANNELS];
        let (report, faulty) = report::<3>(&Reading { value, acquired: Nanos(1) });
        assert!(report.all_follow() && !report.has_fault() && faulty == 0);
        value[2] = DriveActual {
            position: Counts(-7),
            velocity_counts_s: 5,
            torque_code: -3,
            state: DriveState::Fault,
            fault_code: 0x8611,
        };
        value[3].state = DriveState::Fault;
        let (report, faulty) = super::report::<3>(&Reading { value, acquired: Nanos(1) });
        assert_eq!((report.position_counts, report.fault_code), ([0, 0, -7], [0, 0, 0x8611]));
        assert_eq!((faulty, report.has_fault(), report.all_follow()), (0b100, true, false));
    }
}
