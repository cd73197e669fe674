//! A drive of CANopen from its own side: network management, service and process data, signs of
//! life, emergencies, and the states of CiA 402 in cyclic synchronous torque mode.

use taktil_hal::Nanos;

use crate::objects::Objects;
use crate::wire::BusFrame;

/// States of network management as a sign of life tells them.
const OPERATIONAL_STATE: u8 = 5;
const PRE_OPERATIONAL_STATE: u8 = 0x7f;
const STOPPED_STATE: u8 = 4;

/// Cyclic synchronous position.
const POSITION_MODE: u32 = 8;
/// Cyclic synchronous velocity.
const VELOCITY_MODE: u32 = 9;
/// Cyclic synchronous torque.
const TORQUE_MODE: u32 = 10;
/// Torque for each count of position error (thousandths): 50 rad/s with the motor behind it.
const POSITION_GAIN_PERMILLE: f64 = 0.38;
/// Torque for each count a second of speed error (thousandths).
const SPEED_GAIN_PERMILLE: f64 = 0.0153;
/// Torque that friction takes for each count a second (thousandths).
const FRICTION_PERMILLE: f64 = 5.0 / 6_553.6;
/// The most that the power stage gives (thousandths).
const TORQUE_MAX_PERMILLE: f64 = 2_000.0;
/// Speed below which a stop is over (counts/s).
const STANDSTILL_COUNTS_S: f64 = 300.0;

/// States of the power stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Power {
    Disabled,
    Ready,
    SwitchedOn,
    Enabled,
    QuickStop,
    Fault,
}

/// A drive.
#[derive(Clone, Debug)]
pub(crate) struct CanOpen {
    node: u8,
    rated_torque_mnm: u32,
    counts_per_turn: f64,
    objects: Objects,
    management: u8,
    power: Power,
    has_voltage: bool,
    has_cause: bool,
    last_control: u16,
    /// The newest sign of life of the host that it watches.
    host_heard: Option<Nanos>,
    /// How fast the shaft turns (counts/s).
    speed_counts_s: f64,
    /// How many it has heard.
    pub(crate) host_signs: u64,
    next_life: Option<Nanos>,
    /// Frames to send.
    pub(crate) outbox: Vec<BusFrame>,
}

impl CanOpen {
    pub(crate) fn new(node: u8, rated_torque_mnm: u32, counts_per_turn: f64) -> CanOpen {
        let mut drive = CanOpen {
            node,
            rated_torque_mnm,
            counts_per_turn,
            objects: Objects::new(node, rated_torque_mnm),
            management: PRE_OPERATIONAL_STATE,
            power: Power::Disabled,
            has_voltage: true,
            has_cause: false,
            last_control: 0,
            host_heard: None,
            speed_counts_s: 0.0,
            host_signs: 0,
            next_life: None,
            outbox: Vec::new(),
        };
        drive.say(0x700, &[0]);
        drive
    }

    /// Power was switched off and on.
    pub(crate) fn restart(&mut self) {
        *self = CanOpen::new(self.node, self.rated_torque_mnm, self.counts_per_turn);
    }

    fn say(&mut self, base: u32, data: &[u8]) {
        self.outbox.push(BusFrame::classic(base + u32::from(self.node), data));
    }

    pub(crate) fn is_enabled(&self) -> bool {
        self.power == Power::Enabled
    }

    /// Whether the newest controlword wants operation, or a step towards it.
    pub(crate) fn is_wanted(&self) -> bool {
        self.last_control & 0x86 == 0x06
    }

    /// The torque that was asked for, in thousandths.
    pub(crate) fn target(&self) -> i16 {
        self.objects.get(0x6071, 0) as u16 as i16
    }

    pub(crate) fn digital_outputs(&self) -> u32 {
        self.objects.get(0x60fe, 1)
    }

    /// The torque that the motor feels (Nm).
    pub(crate) fn torque_nm(&self) -> f64 {
        self.torque_permille() * f64::from(self.objects.get(0x6076, 0)) * 1e-6
    }

    /// The torque on the shaft by the loop that the mode closes, in thousandths.
    fn torque_permille(&self) -> f64 {
        let speed = self.speed_counts_s;
        let wanted = match (self.power, self.objects.get(0x6060, 0)) {
            (Power::QuickStop, _) => -SPEED_GAIN_PERMILLE * speed,
            (Power::Enabled, POSITION_MODE) => {
                let here = self.objects.get(0x6064, 0) as i32;
                let error = f64::from((self.objects.get(0x607a, 0) as i32).wrapping_sub(here));
                POSITION_GAIN_PERMILLE * error - SPEED_GAIN_PERMILLE * speed
            }
            (Power::Enabled, VELOCITY_MODE) => {
                let target = f64::from(self.objects.get(0x60ff, 0) as i32);
                // The feed-forward of the motor's friction.
                SPEED_GAIN_PERMILLE * (target - speed) + FRICTION_PERMILLE * target
            }
            (Power::Enabled, _) => f64::from(self.target()),
            _ => 0.0,
        };
        wanted.clamp(-TORQUE_MAX_PERMILLE, TORQUE_MAX_PERMILLE)
    }

    /// What the motor shows: where it is (turns), and how fast it turns (turn/s).
    pub(crate) fn set_motion(&mut self, turns: f64, turns_s: f64) {
        let counts = (turns * self.counts_per_turn).round() as i64;
        self.objects.set(0x6064, 0, counts as u32);
        self.speed_counts_s = turns_s * self.counts_per_turn;
        self.objects.set(0x606c, 0, self.speed_counts_s.round() as i64 as u32);
        if self.power == Power::QuickStop && self.speed_counts_s.abs() < STANDSTILL_COUNTS_S {
            self.power = Power::Disabled;
        }
    }

    pub(crate) fn set_counts(&mut self, counts: i32) {
        self.objects.set(0x6064, 0, counts as u32);
    }

    pub(crate) fn set_voltage(&mut self, is_on: bool) {
        self.has_voltage = is_on;
        if !is_on && !matches!(self.power, Power::Fault) {
            self.power = Power::Disabled;
        }
    }

    /// A fault begins or its cause has gone.
    pub(crate) fn set_fault(&mut self, is_there: bool) {
        if is_there && !self.has_cause {
            self.fail(0x2310);
        }
        self.has_cause = is_there;
    }

    fn fail(&mut self, code: u16) {
        if self.power != Power::Fault {
            self.power = Power::Fault;
            self.objects.set(0x603f, 0, u32::from(code));
            let [low, high] = code.to_le_bytes();
            self.say(0x080, &[low, high, 0x11, 0, 0, 0, 0, 0]);
        }
    }

    /// The next instant at which it does something by itself.
    pub(crate) fn next_event(&self) -> Option<Nanos> {
        [self.next_life, self.silent_at()].into_iter().flatten().min()
    }

    /// When it misses the host.
    fn silent_at(&self) -> Option<Nanos> {
        let wait = i64::from(self.objects.get(0x1016, 1) & 0xffff);
        let is_watching = wait > 0 && self.management == OPERATIONAL_STATE;
        self.host_heard.filter(|_| is_watching).map(|heard| heard + Nanos::from_millis(wait))
    }

    pub(crate) fn advance(&mut self, now: Nanos) {
        if self.silent_at().is_some_and(|at| at <= now) {
            self.host_heard = None;
            let code = 0x8130_u16;
            let [low, high] = code.to_le_bytes();
            match self.objects.get(0x6007, 0) {
                1 => self.fail(code),
                2 if self.power != Power::Fault => {
                    self.power = Power::Disabled;
                    self.say(0x080, &[low, high, 0x11, 0, 0, 0, 0, 0]);
                }
                _ => {}
            }
        }
        let period = i64::from(self.objects.get(0x1017, 0));
        if period > 0 && self.next_life.is_none_or(|at| at <= now) {
            self.say(0x700, &[self.management]);
            self.next_life = Some(now + Nanos::from_millis(period));
        }
    }

    fn status(&self) -> u16 {
        let state = match self.power {
            Power::Disabled => 0x0240,
            Power::Ready => 0x0221,
            Power::SwitchedOn => 0x0223,
            Power::Enabled => 0x1227,
            Power::QuickStop => 0x0207,
            Power::Fault => 0x0208,
        };
        state | if self.has_voltage { 0x0010 } else { 0 }
    }

    pub(crate) fn receive(&mut self, now: Nanos, frame: &BusFrame) {
        let node = u32::from(self.node);
        match frame.id() {
            0x000 => self.manage(&frame.data),
            0x080 if frame.data.is_empty() => self.synchronise(),
            id if id == 0x600 + node => {
                let answer = self.objects.serve(&frame.data);
                if let Some(answer) = answer.filter(|_| self.management != STOPPED_STATE) {
                    self.say(0x580, &answer);
                }
            }
            id if id == 0x700 + (self.objects.get(0x1016, 1) >> 16 & 0x7f) => {
                self.host_heard = Some(now);
                self.host_signs += 1;
            }
            id => self.take_process_data(id, &frame.data),
        }
    }

    fn manage(&mut self, data: &[u8]) {
        let [command, node] = *data else { return };
        if node != 0 && node != self.node {
            return;
        }
        match command {
            0x01 => self.management = OPERATIONAL_STATE,
            0x02 => self.management = STOPPED_STATE,
            0x80 => self.management = PRE_OPERATIONAL_STATE,
            0x81 | 0x82 => self.restart(),
            _ => {}
        }
        if self.management != OPERATIONAL_STATE && self.power == Power::Enabled {
            self.power = Power::Disabled;
        }
    }

    fn synchronise(&mut self) {
        self.objects.set(0x6041, 0, u32::from(self.status()));
        self.objects.set(0x6061, 0, self.objects.get(0x6060, 0));
        let torque = self.torque_permille().round() as i16;
        self.objects.set(0x6077, 0, u32::from(torque as u16));
        for number in 0..4 {
            let identifier = self.objects.get(0x1800 + number, 1);
            let kind = self.objects.get(0x1800 + number, 2);
            let is_due = identifier & 0x8000_0000 == 0 && (1..=240).contains(&kind);
            if self.management != OPERATIONAL_STATE || !is_due {
                continue;
            }
            let mut data = Vec::new();
            for (index, sub, bytes) in self.objects.mapping(0x1a00 + number) {
                let value = self.objects.get(index, sub).to_le_bytes();
                data.extend_from_slice(&value[..usize::from(bytes).min(4)]);
            }
            self.outbox.push(BusFrame::classic(identifier & 0x7ff, &data));
        }
    }

    fn take_process_data(&mut self, id: u32, data: &[u8]) {
        for number in 0..4 {
            let identifier = self.objects.get(0x1400 + number, 1);
            let is_on = identifier & 0x8000_0000 == 0 && self.management == OPERATIONAL_STATE;
            if !is_on || identifier & 0x7ff != id {
                continue;
            }
            let mapping = self.objects.mapping(0x1600 + number);
            let length: usize = mapping.iter().map(|(_, _, bytes)| usize::from(*bytes)).sum();
            if data.len() < length {
                self.fail(0x8210);
                continue;
            }
            let mut at = 0;
            for (index, sub, bytes) in mapping {
                let mut value = [0; 4];
                let bytes = usize::from(bytes).min(4);
                value[..bytes].copy_from_slice(&data[at..at + bytes]);
                at += bytes;
                self.objects.set(index, sub, u32::from_le_bytes(value));
                if index == 0x6040 {
                    self.obey(self.objects.get(0x6040, 0) as u16);
                }
            }
        }
    }

    /// The transitions of the standard's diagram.
    fn obey(&mut self, word: u16) {
        let rises = word & 0x80 != 0 && self.last_control & 0x80 == 0;
        self.last_control = word;
        let is_cyclic = (POSITION_MODE..=TORQUE_MODE).contains(&self.objects.get(0x6060, 0));
        let fed = |on: Power| if self.has_voltage { on } else { Power::Disabled };
        self.power = match (self.power, word & 0x8f) {
            (Power::Fault, _) if rises && !self.has_cause => {
                self.objects.set(0x603f, 0, 0);
                Power::Disabled
            }
            (Power::Fault, _) => Power::Fault,
            (_, command) if command & 0x82 == 0 => Power::Disabled,
            (Power::Enabled | Power::QuickStop, command) if command & 0x86 == 0x02 => {
                Power::QuickStop
            }
            (_, command) if command & 0x86 == 0x02 => Power::Disabled,
            (Power::Disabled, command) if command & 0x87 == 0x06 => fed(Power::Ready),
            (Power::SwitchedOn | Power::Enabled, command) if command & 0x87 == 0x06 => Power::Ready,
            (Power::Ready, 0x07 | 0x0f) => fed(Power::SwitchedOn),
            (Power::SwitchedOn, 0x0f) if is_cyclic => Power::Enabled,
            (Power::Enabled, 0x07) => Power::SwitchedOn,
            (state, _) => state,
        };
    }
}
