//! Sets a drive of CANopen up before any job: what it is, its mode, what it does in silence, and
//! which objects travel in which frames.

use taktil_drivers_cia402::{InterpolationPeriod, Object, QuickStopOption};
use taktil_hal::{Nanos, OpenError};

use crate::canopen::{CONTROL_BASE, MOTION_BASE, Management, STATUS_BASE, TARGET_BASE, management};
use crate::config::{Config, DriveMode, NodeConfig};
use crate::frame::Frame;
use crate::port::Port;
use crate::sdo::{Answer, abort_text, answer, download, upload};

/// How often a request is made before a drive counts as silent.
const REQUESTS_MAX: u32 = 3;
/// Frames of others that may come before an answer.
const FRAMES_MAX: usize = 10_000;
/// The profile number of drives in object 1000.
const DRIVE_PROFILE: u32 = 402;
/// Bit of a PDO's identifier: switched off.
const PDO_OFF_BIT: u32 = 1 << 31;
/// Bit of a TPDO's identifier: it cannot be asked for by a remote frame.
const NO_REMOTE_BIT: u32 = 1 << 30;
/// Transmission type of a frame that is sent at every SYNC.
const EVERY_SYNC: u32 = 1;
/// Transmission type of a frame that acts when it arrives.
const AT_ONCE: u32 = 255;
/// What a drive does when the host falls silent (6007): disable voltage.
const SILENCE_OPTION: u32 = 2;
/// The digital outputs of a drive.
const DIGITAL_OUTPUTS: Object = Object::new(0x60fe, 1, 32);

/// Why a drive did not do what was asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Refusal {
    Silent,
    Aborted(u32),
}

/// The dialogue with one drive.
pub(crate) struct Setup<'a> {
    port: &'a mut dyn Port,
    config: &'a Config,
    node: NodeConfig,
    wait: Nanos,
}

/// A frame that a drive is to send or to take.
struct Exchange {
    /// Object of its parameters; that of its contents lies 0x200 behind.
    index: u16,
    identifier: u32,
    kind: u32,
}

impl<'a> Setup<'a> {
    pub(crate) fn new(port: &'a mut dyn Port, config: &'a Config, node: NodeConfig) -> Setup<'a> {
        let wait = Nanos::from_millis(i64::from(config.open_wait_ms)).0 / i64::from(REQUESTS_MAX);
        Setup { port, config, node, wait: Nanos(wait.max(1)) }
    }

    fn request(&mut self, frame: &Frame, index: u16, sub: u8) -> Result<u32, Refusal> {
        for _ in 0..REQUESTS_MAX {
            // Whether it arrived is seen by what comes.
            let _ = self.port.send(frame);
            self.port.start_wait(self.wait);
            for _ in 0..FRAMES_MAX {
                let Some(frame) = self.port.receive() else { break };
                match answer(&frame, self.node.id, index, sub) {
                    Some(Answer::Value(value)) => return Ok(value),
                    Some(Answer::Written) => return Ok(0),
                    Some(Answer::Abort(reason)) => return Err(Refusal::Aborted(reason)),
                    None => {}
                }
            }
        }
        Err(Refusal::Silent)
    }

    fn read(&mut self, object: Object) -> Result<u32, Refusal> {
        let frame = upload(self.node.id, object.index, object.sub);
        self.request(&frame, object.index, object.sub)
    }

    fn write(&mut self, object: Object, value: u32) -> Result<(), Refusal> {
        let frame = download(self.node.id, object.index, object.sub, object.bits, value);
        self.request(&frame, object.index, object.sub).map(drop)
    }

    /// Writes an object that a drive may lack.
    fn write_optional(&mut self, object: Object, value: u32) -> Result<(), Refusal> {
        match self.write(object, value) {
            Err(Refusal::Aborted(_)) => Ok(()),
            other => other,
        }
    }

    fn error(&self, what: &str, remedy: &str) -> OpenError {
        let what = format!("drive {} {what}", self.node.id);
        OpenError::device(&self.config.interface, "nodes", what, remedy)
    }

    fn refused(&self, object: Object, refusal: Refusal) -> OpenError {
        let Object { index, sub, .. } = object;
        match refusal {
            Refusal::Silent => self.error(
                &format!("does not answer within {} ms", self.config.open_wait_ms),
                "switch it on, and look at its number, the bit rate and the bus's two resistors",
            ),
            Refusal::Aborted(reason) => self.error(
                &format!(
                    "refuses object {index:04X}:{sub:02X} ({}, {reason:08X})",
                    abort_text(reason)
                ),
                "take a drive with the objects of CiA 402's cyclic mode",
            ),
        }
    }

    fn require(&mut self, object: Object, value: u32) -> Result<(), OpenError> {
        self.write(object, value).map_err(|refusal| self.refused(object, refusal))
    }

    /// Sets the drive up and lets it take part in the exchange; its torque stays off.
    /// Gives what it does at a quick stop.
    pub(crate) fn run(&mut self) -> Result<QuickStopOption, OpenError> {
        let _ = self.port.send(&management(Management::PreOperational, self.node.id));
        self.identify()?;
        let silence = u32::from(self.config.host_id) << 16 | self.config.watchdog_ms();
        let producer = self.config.watchdog_ms();
        self.require(Object::new(0x1016, 1, 32), silence)?;
        self.require(Object::new(0x1017, 0, 16), producer)?;
        self.require(Object::ABORT_CONNECTION_OPTION, SILENCE_OPTION)?;
        self.require(Object::OPERATION_MODE, self.config.mode.cyclic().code() as u32)?;
        let period = Nanos::from_micros(i64::from(self.config.period_us));
        let timing = self.period(period);
        timing.map_err(|refusal| self.refused(Object::INTERPOLATION_VALUE, refusal))?;
        self.exchanges()?;
        let option = self.quick_stop();
        let _ = self.port.send(&management(Management::Start, self.node.id));
        Ok(option)
    }

    /// What the drive does at a quick stop, where it closes a loop; one that does not tell leaves
    /// operation.
    fn quick_stop(&mut self) -> QuickStopOption {
        if self.config.mode == DriveMode::Torque {
            return QuickStopOption::default();
        }
        match self.read(Object::QUICK_STOP_OPTION) {
            Ok(code) => QuickStopOption::from_code(code as u16 as i16),
            Err(_) => QuickStopOption::default(),
        }
    }

    fn identify(&mut self) -> Result<(), OpenError> {
        let kind = Object::new(0x1000, 0, 32);
        let profile = self.read(kind).map_err(|refusal| self.refused(kind, refusal))? & 0xffff;
        if profile != DRIVE_PROFILE {
            let what = format!("is no drive: its profile is {profile}, not {DRIVE_PROFILE}");
            return Err(self.error(&what, "name the numbers of drives only"));
        }
        if let Ok(modes) = self.read(Object::SUPPORTED_MODES)
            && !self.config.mode.cyclic().is_supported(modes)
        {
            let what = format!("does not know the mode {}", self.config.mode.cyclic().name());
            return Err(self.error(&what, "give another `mode`, or take a drive that does"));
        }
        let due = self.node.rated_torque_mnm;
        if due != 0 {
            let object = Object::RATED_TORQUE;
            let has = self.read(object).map_err(|refusal| self.refused(object, refusal))?;
            if has != due {
                let what = format!("has a rated torque of {has} mNm, not {due}");
                let remedy = "set `rated_torque_mnm` and the arm's torques to it, or the drive";
                return Err(self.error(&what, remedy));
            }
        }
        Ok(())
    }

    fn period(&mut self, period: Nanos) -> Result<(), Refusal> {
        self.write_optional(Object::new(0x1006, 0, 32), self.config.period_us)?;
        if let Some(InterpolationPeriod { value, exponent }) =
            InterpolationPeriod::from_nanos(period)
        {
            self.write_optional(Object::INTERPOLATION_VALUE, u32::from(value))?;
            let exponent = u32::from(exponent.cast_unsigned());
            self.write_optional(Object::INTERPOLATION_EXPONENT, exponent)?;
        }
        Ok(())
    }

    fn exchanges(&mut self) -> Result<(), OpenError> {
        let id = u32::from(self.node.id);
        let own = |base: u16| u32::from(base) + id;
        let is_first = self.config.nodes.first().is_some_and(|first| first.id == self.node.id);
        let control = [Object::CONTROL_WORD, DIGITAL_OUTPUTS];
        let count = 1 + usize::from(is_first && self.config.brake_bit.is_some());
        if count > 1 {
            // The drive's mask of the outputs that it obeys.
            self.require(Object::new(0x60fe, 2, 32), 1 << self.config.brake_bit.unwrap_or(0))?;
        }
        let exchange = |index, identifier, kind| Exchange { index, identifier, kind };
        self.map(&exchange(0x1400, own(CONTROL_BASE), AT_ONCE), &control[..count])?;
        self.map(&exchange(0x1401, own(TARGET_BASE), AT_ONCE), &[self.target()])?;
        let status = [Object::STATUS_WORD, Object::ACTUAL_POSITION, Object::ACTUAL_TORQUE];
        let identifier = own(STATUS_BASE) | NO_REMOTE_BIT;
        self.map(&exchange(0x1800, identifier, EVERY_SYNC), &status)?;
        let motion = [Object::ACTUAL_VELOCITY, Object::ERROR_CODE];
        let closes_loop = self.config.mode != DriveMode::Torque;
        if closes_loop {
            let identifier = own(MOTION_BASE) | NO_REMOTE_BIT;
            self.map(&exchange(0x1801, identifier, EVERY_SYNC), &motion)?;
        }
        // What the drive would send or take besides is switched off, as far as it has that.
        let unused =
            [(0x1402, 0x400), (0x1403, 0x500), (0x1801, 0x280), (0x1802, 0x380), (0x1803, 0x480)];
        for (index, base) in unused {
            if closes_loop && index == 0x1801 {
                continue;
            }
            let object = Object::new(index, 1, 32);
            self.write_optional(object, own(base) | NO_REMOTE_BIT | PDO_OFF_BIT)
                .map_err(|refusal| self.refused(object, refusal))?;
        }
        Ok(())
    }

    /// The object that the drive follows.
    const fn target(&self) -> Object {
        self.config.mode.cyclic().target()
    }

    fn map(&mut self, exchange: &Exchange, objects: &[Object]) -> Result<(), OpenError> {
        let Exchange { index, identifier, kind } = *exchange;
        let contents = index + 0x200;
        self.require(Object::new(index, 1, 32), identifier | PDO_OFF_BIT)?;
        self.require(Object::new(contents, 0, 8), 0)?;
        for (place, object) in (1..).zip(objects) {
            self.require(Object::new(contents, place, 32), object.mapping())?;
        }
        self.require(Object::new(contents, 0, 8), objects.len() as u32)?;
        self.require(Object::new(index, 2, 8), kind)?;
        self.require(Object::new(index, 1, 32), identifier)
    }
}
