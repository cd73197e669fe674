//! One CiA 402 drive in a lane: what it reports, the controlword and target that it gets, and what
//! keeps it from following.

use taktil_drivers_cia402::{
    Command, Controlword, CyclicTarget, EnableLine, Goal, Object, PositionTarget,
    PowerStateMachine, QuickStopOption, Statusword,
};
use taktil_hal::{Counts, DriveActual, DriveRequest, DriveState, Nanos};

use crate::config::DriveMode;
use crate::field::{Field, ProcessData, find};

/// How long a stop by the drive's own quick stop may take before its torque goes off.
pub(crate) const STOP_TIME: Nanos = Nanos::from_millis(500);

/// Where the objects of a drive lie.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DrivePlaces {
    control: Field,
    target: Field,
    mode: Option<Field>,
    status: Field,
    pub(crate) position: Field,
    velocity: Option<Field>,
    torque: Option<Field>,
    error: Option<Field>,
}

impl DrivePlaces {
    /// The places of the objects that a mode needs.
    ///
    /// # Errors
    /// The first object that is not mapped.
    pub(crate) fn new(
        device: usize,
        mode: DriveMode,
        data: &ProcessData,
    ) -> Result<DrivePlaces, Object> {
        let place = |mapped, object: Object| find(device, mapped, &[(object.index, object.sub)]);
        let output = |object| place(&data.outputs, object);
        let input = |object| place(&data.inputs, object);
        Ok(DrivePlaces {
            control: output(Object::CONTROL_WORD).ok_or(Object::CONTROL_WORD)?,
            target: output(mode.cyclic().target()).ok_or(mode.cyclic().target())?,
            mode: output(Object::OPERATION_MODE),
            status: input(Object::STATUS_WORD).ok_or(Object::STATUS_WORD)?,
            position: input(Object::ACTUAL_POSITION).ok_or(Object::ACTUAL_POSITION)?,
            velocity: input(Object::ACTUAL_VELOCITY),
            torque: input(Object::ACTUAL_TORQUE),
            error: input(Object::ERROR_CODE),
        })
    }
}

/// What is asked of a drive in a cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Demand {
    /// The drive is to follow its target.
    pub(crate) enable: bool,
    /// The target, in codes of the mode; `None` for the safe one: no torque, no speed, or the
    /// target as it stands.
    pub(crate) code: Option<i32>,
    /// A position is that of the drive's own counter, not the way from where it was enabled.
    pub(crate) is_absolute: bool,
}

/// What is wanted of a drive's power section.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Wish {
    /// The one line of a cell, which stands for both acts.
    Line(bool),
    /// Separate acts, as a half for drives has them.
    Acts { request: DriveRequest, reset: bool },
}

impl Wish {
    pub(crate) fn is_to_follow(self) -> bool {
        matches!(self, Wish::Line(true) | Wish::Acts { request: DriveRequest::Follow, .. })
    }
}

/// By what whoever owns the line learns of a drive's fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Told {
    /// Commits fail for a drive that does not follow.
    pub(crate) has_channel: bool,
    /// The line was taken away when a commit had failed: what happens until it rises is known to
    /// have failed.
    pub(crate) gave_up: bool,
}

/// A drive.
#[derive(Clone, Debug)]
pub(crate) struct DriveUnit {
    places: DrivePlaces,
    mode: DriveMode,
    machine: PowerStateMachine,
    line: EnableLine,
    target: PositionTarget,
    control: Controlword,
    status: Statusword,
    position: i32,
    velocity: i32,
    torque: i32,
    /// Where the drive was when it began to follow.
    anchor: i32,
    /// The newest target of mode position.
    held: i32,
    pub(crate) error: u16,
    was_fault: bool,
    /// Since when it is wanted, and whether it has followed since.
    wanted: Option<Nanos>,
    has_followed: bool,
    /// Since when it is not wanted any more.
    unwanted: Nanos,
    /// How long it may take to follow, and whether commits have failed because of its fault.
    enable_time: Nanos,
    is_told: bool,
}

impl DriveUnit {
    pub(crate) fn new(
        places: DrivePlaces,
        mode: DriveMode,
        step_max_counts: u32,
        quick_stop: QuickStopOption,
        enable_time: Nanos,
    ) -> DriveUnit {
        DriveUnit {
            places,
            mode,
            machine: PowerStateMachine::with_quick_stop(quick_stop),
            line: EnableLine::default(),
            target: PositionTarget::new(step_max_counts),
            control: Controlword::DISABLE_VOLTAGE,
            status: Statusword(0),
            position: 0,
            velocity: 0,
            torque: 0,
            anchor: 0,
            held: 0,
            error: 0,
            was_fault: false,
            wanted: None,
            has_followed: false,
            unwanted: Nanos(i64::MIN / 2),
            enable_time,
            is_told: false,
        }
    }

    /// Takes what the drive reports; whether a fault has begun.
    pub(crate) fn report(&mut self, inputs: &[u8]) -> bool {
        self.status = Statusword(self.places.status.raw(inputs) as u16);
        self.position = self.places.position.signed(inputs);
        self.velocity = self.places.velocity.map_or(0, |place| place.signed(inputs));
        self.torque = self.places.torque.map_or(0, |place| place.signed(inputs));
        let is_fault = self.status.is_fault();
        if is_fault {
            // The code may come a cycle after the state.
            self.error = self.places.error.map_or(0, |place| place.raw(inputs) as u16);
        }
        let has_begun = is_fault && !self.was_fault;
        self.was_fault = is_fault;
        has_begun
    }

    /// What the drive reports.
    pub(crate) fn actual(&self) -> DriveActual {
        let state = self.status.drive_state();
        let is_fault = state == DriveState::Fault;
        DriveActual {
            position: Counts(self.position),
            velocity_counts_s: self.velocity,
            torque_code: self.torque,
            state,
            fault_code: if is_fault { self.error } else { 0 },
        }
    }

    /// Steps the power state machine for the job released at `release`.
    pub(crate) fn step(&mut self, release: Nanos, wish: Wish, told: Told) {
        let enable = wish.is_to_follow();
        let is_told = told.gave_up || (told.has_channel && self.is_failing(release));
        self.is_told &= self.machine.needs_reset();
        self.is_told |= self.status.is_fault() && is_told;
        match (enable, self.wanted) {
            (true, None) => (self.wanted, self.has_followed) = (Some(release), false),
            (false, Some(_)) => (self.wanted, self.unwanted) = (None, release),
            _ => {}
        }
        self.has_followed |= enable && self.status.is_following();
        let command = match wish {
            Wish::Line(enable) => self.command_of_line(release, enable),
            Wish::Acts { request, reset } => Command { goal: request.into(), fault_reset: reset },
        };
        self.control = self.machine.step(self.status, command);
    }

    /// Both acts and the stop from the one line of a cell.
    fn command_of_line(&mut self, release: Nanos, enable: bool) -> Command {
        let mut command = self.line.command(enable, &self.machine, self.is_told);
        let is_stopping = command.goal == Goal::Disabled && release - self.unwanted < STOP_TIME;
        if is_stopping && !enable {
            command.goal = Goal::QuickStop;
        }
        command
    }

    /// Whether the drive is wanted and does not follow: it has stopped to do so, or has not begun
    /// to in time.
    pub(crate) fn is_failing(&self, release: Nanos) -> bool {
        let Some(since) = self.wanted else { return false };
        let is_due = self.has_followed || release - since > self.enable_time;
        is_due && !self.status.is_following()
    }

    /// Whether its voltage is on.
    pub(crate) fn has_voltage(&self) -> bool {
        self.status.has_voltage()
    }

    /// Writes controlword, mode and target. A drive that is not wanted any more has none.
    pub(crate) fn write(&mut self, demand: Demand, outputs: &mut [u8]) {
        let code = demand.code.filter(|_| demand.enable);
        let target = match self.mode {
            // The range of codes is within that of the object.
            DriveMode::Torque => {
                i32::from(CyclicTarget::torque(self.status, code.unwrap_or(0) as i16))
            }
            DriveMode::Velocity => CyclicTarget::velocity(self.status, code.unwrap_or(0)),
            DriveMode::Position => self.position_target(demand, code),
        };
        self.places.control.set(outputs, u32::from(self.control.0));
        self.places.target.set(outputs, target.cast_unsigned());
        if let Some(mode) = self.places.mode {
            mode.set(outputs, u32::from(self.mode.cyclic().code().cast_unsigned()));
        }
    }

    /// Nobody who is not wanted is led anywhere but to where the drive is.
    fn position_target(&mut self, demand: Demand, code: Option<i32>) -> i32 {
        let status = if demand.enable { self.status } else { Statusword(0) };
        if !status.is_following() {
            (self.anchor, self.held) = (self.position, self.position);
        }
        let origin = if demand.is_absolute { 0 } else { self.anchor };
        let desired = code.map_or(self.held, |code| origin.wrapping_add(code));
        self.held = self.target.step(status, self.position, desired);
        self.held
    }

    /// Writes torque off, for a segment that does not operate.
    pub(crate) fn write_off(&mut self, outputs: &mut [u8]) {
        self.control = Controlword::DISABLE_VOLTAGE;
        self.write(Demand::default(), outputs);
    }

    /// Position on the segment.
    pub(crate) fn device(&self) -> usize {
        self.places.status.device
    }
}
