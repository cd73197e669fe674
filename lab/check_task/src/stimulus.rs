//! Made-up inputs of a task, drawn from a seed: which value arrives at which job, how old it is,
//! and when none arrives. A twin of the task gets the same, except for the values that it must not
//! use: those that are stale, and the numbers of those whose field `valid` is 0.

use taktil_hal::fault::SplitMix;
use taktil_rtcore::harness::{Harness, InputPort, ParameterPort};
use taktil_rtcore::payload::Primitive;
use taktil_rtcore::{Cycle, Nanos};

use crate::number::{Number, Place, places, text};
use crate::plan::{InputKind, Run};
use crate::quantity::{Quantity, quantity};
use crate::scenario::Scenario;
use crate::task_under_test::TaskUnderTest;

/// Longest time for which an input is supplied in one way, in jobs.
const ARRIVAL_JOBS_MAX: usize = 600;
/// Longest time for which an input is absent at the begin of a run, in jobs.
const ABSENT_JOBS_MAX: usize = 60;
/// Longest time for which values stay that do not follow the scenario, in jobs.
const STAY_JOBS_MAX: usize = 500;
/// One job in so many edits a parameter.
const JOBS_BETWEEN_EDITS: usize = 2000;
/// Age of a late value of an input that is never stale, at most.
const AGE_MAX: Nanos = Nanos::from_secs(1);
/// Elements that are shown of an array of a failing step.
const SHOWN_ELEMENTS_MAX: usize = 8;

/// How values of an input arrive.
#[derive(Clone, Copy, Debug)]
enum Arrival {
    /// One at each job.
    Every,
    /// One at each so many jobs.
    EveryNth(u64),
    /// None.
    Silent,
    /// One at each job, each as old as it may be or older.
    Late,
}

/// One input and what it gets.
struct PortStimulus {
    port: InputPort,
    fields: Vec<(Place, Quantity)>,
    /// Where the field `valid` stands.
    valid: Option<Place>,
    arrival: Arrival,
    arrival_until: u64,
    stays_until: u64,
    /// The plausible value, and what is given.
    plausible: Vec<u8>,
    body: Vec<u8>,
    /// What the twin gets instead, and whether it does.
    other: Vec<u8>,
    differs: bool,
    stamp: Nanos,
    /// Whether a value was given in this run, and at this job.
    present: bool,
    given: bool,
    stale: bool,
}

/// The inputs of a run.
pub(crate) struct Stimulus {
    random: SplitMix,
    kind: InputKind,
    scenario: Scenario,
    ports: Vec<PortStimulus>,
    parameters: Vec<ParameterPort>,
    edit: Option<(usize, f64)>,
    moves_joints: bool,
}

impl Stimulus {
    /// The inputs of `run` for a task with these ports, before the first job.
    pub(crate) fn new(subject: &TaskUnderTest, harness: &Harness, run: &Run) -> Stimulus {
        let mut random = SplitMix::new(run.seed);
        let scenario = Scenario::new(&subject.lane, &subject.robot, &mut random);
        let joints = subject.robot.joints();
        let inputs = harness.inputs().iter();
        let ports: Vec<PortStimulus> =
            inputs.map(|port| PortStimulus::new(port, joints, &mut random)).collect();
        let of_joints = |(_, quantity): &(Place, Quantity)| {
            matches!(quantity, Quantity::JointAngles | Quantity::JointSpeeds)
        };
        Stimulus {
            random,
            kind: run.kind,
            scenario,
            moves_joints: ports.iter().any(|port| port.fields.iter().any(of_joints)),
            ports,
            parameters: harness.parameters().to_vec(),
            edit: None,
        }
    }

    /// Draws the next job.
    pub(crate) fn advance(&mut self) {
        self.scenario.advance(&mut self.random);
        if self.moves_joints {
            self.scenario.move_joints();
        }
        for port in &mut self.ports {
            port.advance(&self.scenario, self.kind, &mut self.random);
        }
        self.edit = None;
        if !self.parameters.is_empty() && self.random.below(JOBS_BETWEEN_EDITS) == 0 {
            let number = self.random.below(self.parameters.len());
            let ParameterPort { initial, range, .. } = &self.parameters[number];
            let value = match (self.kind, self.random.below(3)) {
                (InputKind::Plausible, _) => initial * (0.8 + 0.4 * self.random.unit()),
                (_, 0) => *range.start(),
                (_, 1) => *range.end(),
                _ => range.start() + (range.end() - range.start()) * self.random.unit(),
            };
            self.edit = Some((number, value.clamp(*range.start(), *range.end())));
        }
    }

    /// Gives the drawn values to a task, or to its twin.
    pub(crate) fn apply(&self, harness: &mut Harness, twin: bool) {
        for (input, port) in self.ports.iter().enumerate() {
            let differs = twin && port.differs;
            if port.given {
                let body = if differs { &port.other } else { &port.body };
                harness.give(input, body, port.stamp);
            } else if differs {
                harness.replace(input, &port.other);
            }
        }
        if let Some((number, value)) = self.edit {
            harness.set_parameter(number, value);
        }
    }

    /// What the step is told of time.
    pub(crate) fn cycle(&self) -> Cycle {
        self.scenario.cycle()
    }

    /// Whether an input has a value that must not be used now.
    pub(crate) fn has_unusable(&self) -> bool {
        self.ports.iter().any(|port| port.present && port.has_unusable_value())
    }

    /// Names of the inputs whose values must not be used now.
    pub(crate) fn unusable(&self) -> Vec<&'static str> {
        let unusable = self.ports.iter().filter(|port| port.present && port.has_unusable_value());
        unusable.map(|port| port.port.name).collect()
    }

    /// The inputs at this job in one line each.
    pub(crate) fn lines(&self) -> Vec<String> {
        let cycle = self.cycle();
        let now = format!(
            "tick {}, release {}, mode {:?}, state {:?}",
            cycle.tick, cycle.release, cycle.mode, self.scenario.state
        );
        let line = |port: &PortStimulus| {
            let age = cycle.release - port.stamp;
            let name = port.port.name;
            let what = match (port.present, port.stale) {
                (false, _) => return format!("{name}: absent"),
                (true, true) => "stale",
                (true, false) if port.has_unusable_value() => "not valid",
                (true, false) => "usable",
            };
            let values = text(&port.port.fields, &port.body, SHOWN_ELEMENTS_MAX);
            format!("{name}: {what}, {age} old: {values}")
        };
        core::iter::once(now).chain(self.ports.iter().map(line)).collect()
    }
}

impl PortStimulus {
    fn new(port: &InputPort, joints: usize, random: &mut SplitMix) -> PortStimulus {
        let places = places(&port.fields);
        let field =
            |(field, place): (&_, &Place)| (*place, quantity(&port.fields, field, *place, joints));
        let fields = port.fields.iter().zip(&places).map(field).collect();
        let mut flags = port.fields.iter().zip(&places);
        let valid = flags.find(|(field, place)| {
            field.name == "valid" && !field.array && place.kind == Primitive::U32
        });
        // Half of the inputs are absent at first.
        let absent = random.below(2) * (1 + random.below(ABSENT_JOBS_MAX));
        PortStimulus {
            fields,
            valid: valid.map(|(_, place)| *place),
            arrival: if absent > 0 { Arrival::Silent } else { Arrival::Every },
            arrival_until: absent as u64,
            stays_until: 0,
            plausible: vec![0; port.size],
            body: vec![0; port.size],
            other: vec![0; port.size],
            differs: false,
            stamp: Nanos::ZERO,
            present: false,
            given: false,
            stale: false,
            port: port.clone(),
        }
    }

    /// Whether the present value, or its numbers, must not be used.
    fn has_unusable_value(&self) -> bool {
        self.stale || self.valid.is_some_and(|at| at.get(&self.body, 0) == Number::Whole(0))
    }

    fn advance(&mut self, at: &Scenario, kind: InputKind, random: &mut SplitMix) {
        if at.tick >= self.arrival_until {
            self.arrival = match random.below(10) {
                0..=5 => Arrival::Every,
                6 => Arrival::EveryNth(2 + random.below(20) as u64),
                7 => Arrival::Silent,
                _ => Arrival::Late,
            };
            self.arrival_until = at.tick + 1 + random.below(ARRIVAL_JOBS_MAX) as u64;
        }
        self.given = match self.arrival {
            Arrival::Every | Arrival::Late => true,
            Arrival::EveryNth(jobs) => at.tick.is_multiple_of(jobs),
            Arrival::Silent => false,
        };
        if self.given {
            self.draw_value(at, kind, random);
            self.draw_stamp(at, random);
            self.present = true;
        }
        let was_stale = core::mem::replace(
            &mut self.stale,
            self.present && at.release - self.stamp > self.port.stale_after,
        );
        let changed = self.given || self.stale != was_stale;
        self.differs = changed && self.present && self.has_unusable_value();
        if self.differs {
            self.draw_other(random);
        }
    }

    fn draw_value(&mut self, at: &Scenario, kind: InputKind, random: &mut SplitMix) {
        let anew = at.tick >= self.stays_until;
        if anew {
            self.stays_until = at.tick + 1 + random.below(STAY_JOBS_MAX) as u64;
        }
        for (place, quantity) in &self.fields {
            if anew || quantity.follows() {
                for element in 0..place.count {
                    let number = quantity.draw(element, at, random);
                    place.put(&mut self.plausible, element, number);
                }
            }
        }
        self.body.copy_from_slice(&self.plausible);
        if kind != InputKind::Plausible && random.below(3) > 0 {
            self.spoil(kind == InputKind::NotFinite, random);
        }
    }

    /// Puts extreme numbers into some elements, one time in eight into all of them.
    fn spoil(&mut self, not_finite: bool, random: &mut SplitMix) {
        let all = random.below(8) == 0;
        let chosen = random.below(self.fields.len());
        for (number, (place, _)) in self.fields.iter().enumerate() {
            let one = random.below(place.count);
            for element in 0..place.count {
                if all || (number == chosen && element == one) || random.below(16) == 0 {
                    let extreme = place.draw_extreme(random, not_finite);
                    place.put(&mut self.body, element, extreme);
                }
            }
        }
    }

    /// The stamps of an input never go back.
    fn draw_stamp(&mut self, at: &Scenario, random: &mut SplitMix) {
        let newest = match self.port.delayed {
            true => at.release - at.cycle().dt,
            false => at.release,
        };
        let stamp = match self.arrival {
            Arrival::Late => {
                let limit = self.port.stale_after.min(AGE_MAX);
                let beyond = Nanos(random.below(20_000_000) as i64 - 5_000_000);
                newest.min(at.release - limit - beyond)
            }
            _ => newest,
        };
        self.stamp = if self.present { self.stamp.max(stamp) } else { stamp };
    }

    /// Draws the twin's value: every number of a stale one is another, and of one that is not valid
    /// every real number.
    fn draw_other(&mut self, random: &mut SplitMix) {
        self.other.copy_from_slice(&self.body);
        for (place, _) in &self.fields {
            if self.stale || place.is_real() {
                for element in 0..place.count {
                    let number = place.draw_extreme(random, false);
                    place.put(&mut self.other, element, number);
                }
            }
        }
    }
}
