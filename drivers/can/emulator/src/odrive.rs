//! An ODrive axis from its own side: commands in the identifier, signs of life, and a watchdog that
//! inputs feed.

use taktil_hal::Nanos;

use crate::wire::BusFrame;

/// From one sign of life to the next.
const LIFE_PERIOD: Nanos = Nanos::from_millis(20);
/// The watchdog's time.
const WATCHDOG_TIME: Nanos = Nanos::from_millis(50);
/// Error of a watchdog that was not fed.
const WATCHDOG_ERROR: u32 = 0x0800;

/// An axis.
#[derive(Clone, Debug)]
pub(crate) struct Odrive {
    id: u8,
    state: u8,
    error: u32,
    has_cause: bool,
    is_torque_mode: bool,
    torque_nm: f64,
    turns: f64,
    speed: f64,
    fed: Option<Nanos>,
    next_life: Nanos,
    pub(crate) outbox: Vec<BusFrame>,
}

impl Odrive {
    pub(crate) fn new(id: u8) -> Odrive {
        Odrive {
            id,
            state: 1,
            error: 0,
            has_cause: false,
            is_torque_mode: false,
            torque_nm: 0.0,
            turns: 0.0,
            speed: 0.0,
            fed: None,
            next_life: Nanos::ZERO,
            outbox: Vec::new(),
        }
    }

    pub(crate) fn restart(&mut self) {
        *self = Odrive { turns: self.turns, ..Odrive::new(self.id) };
    }

    fn say(&mut self, command: u32, data: &[u8]) {
        self.outbox.push(BusFrame::classic(u32::from(self.id) << 5 | command, data));
    }

    pub(crate) fn is_enabled(&self) -> bool {
        self.state == 8
    }

    pub(crate) fn torque_nm(&self) -> f64 {
        if self.is_enabled() && self.is_torque_mode { self.torque_nm } else { 0.0 }
    }

    /// The torque that was asked for (mNm).
    pub(crate) fn target(&self) -> i16 {
        (1e3 * self.torque_nm()).round() as i16
    }

    pub(crate) fn set_motion(&mut self, turns: f64, speed: f64) {
        (self.turns, self.speed) = (turns, speed);
    }

    pub(crate) fn set_fault(&mut self, is_there: bool) {
        if is_there && !self.has_cause {
            (self.state, self.error) = (1, 0x0001);
        }
        self.has_cause = is_there;
    }

    pub(crate) fn next_event(&self) -> Option<Nanos> {
        let bite = self.fed.filter(|_| self.is_enabled()).map(|fed| fed + WATCHDOG_TIME);
        bite.into_iter().chain([self.next_life]).min()
    }

    pub(crate) fn advance(&mut self, now: Nanos) {
        if self.is_enabled() && self.fed.is_some_and(|fed| fed + WATCHDOG_TIME <= now) {
            (self.state, self.error) = (1, WATCHDOG_ERROR);
        }
        if self.next_life <= now {
            self.next_life = now + LIFE_PERIOD;
            self.life();
        }
    }

    fn life(&mut self) {
        let mut data = self.error.to_le_bytes().to_vec();
        data.extend([self.state, 0, 0, 0]);
        self.say(0x01, &data);
    }

    pub(crate) fn receive(&mut self, now: Nanos, frame: &BusFrame) {
        if frame.id() >> 5 != u32::from(self.id) {
            return;
        }
        let number = |at: usize| {
            let bytes = frame.data.get(at..at + 4)?;
            Some(u32::from_le_bytes(bytes.try_into().ok()?))
        };
        match (frame.id() & 0x1f, frame.is_remote()) {
            (0x09, true) => {
                let mut data = (self.turns as f32).to_le_bytes().to_vec();
                data.extend((self.speed as f32).to_le_bytes());
                self.say(0x09, &data);
            }
            (0x07, false) => {
                match number(0) {
                    Some(1) => self.state = 1,
                    Some(8) if self.error == 0 && self.state != 8 => {
                        (self.state, self.fed) = (8, Some(now));
                    }
                    _ => {}
                }
                self.life();
            }
            (0x0b, false) => self.is_torque_mode = number(0) == Some(1) && number(4) == Some(1),
            (0x0e, false) => {
                self.fed = Some(now);
                self.torque_nm = number(0).map_or(0.0, |bits| f64::from(f32::from_bits(bits)));
            }
            (0x18, false) if !self.has_cause => {
                self.error = 0;
                self.life();
            }
            _ => {}
        }
    }
}
