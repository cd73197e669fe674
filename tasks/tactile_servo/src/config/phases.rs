//! `[tactile_servo.phases]`, or a file of its own: a touch task as a sequence of phases, each with
//! the features that characterise it (the thesis, section 5.2). What cannot work is refused when it
//! is read: a phase whose features do not tell its motions apart, a condition that is never met, a
//! phase that does not exist or is never entered, and a circle of phases without a way out.

mod condition;
mod graph;

use serde::Deserialize;
use taktil_rtcore::Invalid;

use super::Config;
use super::task_frame::{MOTIONS_MAX, Motion, ServoedFeature, TaskFrame};
pub use condition::{Condition, Quantity};

/// Largest number of phases.
pub const PHASES_MAX: usize = 16;
/// Largest number of conditions of a phase.
pub const CONDITIONS_MAX: usize = 4;
/// Longest name of a phase (bytes).
const NAME_BYTES_MAX: usize = 32;
/// The name that stands for the end of the task in `then` and `else`.
pub const END_NAME: &str = "end";

taktil_rtcore::explained! {
    /// What a phase does.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub enum PhaseKind {
        /// Moves at `velocity_per_s` until a condition is met: a guarded move.
        Approach,
        /// Servoes features while there is contact.
        Regulate,
        /// Moves at `velocity_per_s`, and servoes the features that it has.
        Move,
        /// Stands still.
        Hold,
    }
}

taktil_rtcore::explained! {
    /// `[[tactile_servo.phases.phase]]`: one phase of a task.
    #[derive(Clone, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct PhaseConfig {
        /// Its name, of at most 32 bytes; not `end`.
        pub name: String,
        /// What it does: `approach`, `regulate`, `move` or `hold`.
        pub does: PhaseKind,
        /// Motion along x, y, z and about them, in the sensor's own frame (mm/s, mrad/s), of
        /// `approach` and `move`. Default none. A `move` with features is fed while the finger
        /// presses with `roll_min_counts` at least.
        #[serde(default)]
        pub velocity_per_s: [f64; MOTIONS_MAX],
        /// The motions by which features are servoed, as many as there are features.
        #[serde(default)]
        pub state: Vec<Motion>,
        /// The features of `regulate`, and of a `move` that has any.
        #[serde(default)]
        pub feature: Vec<ServoedFeature>,
        /// Time from rest to the limit of speed of what features move or feed, save along z (s).
        /// Default 0.2.
        pub slew_s: Option<f64>,
        /// In a phase without features: motions in which drift is not taken back by the encoders.
        /// Default none.
        #[serde(default)]
        pub unheld: Vec<Motion>,
        /// The phase is done when all of these conditions hold, at most 4. Default: it goes on for
        /// ever.
        #[serde(default)]
        pub until: Vec<Condition>,
        /// They have to hold for this time without a break (s). Default 0.
        #[serde(default)]
        pub for_s: f64,
        /// The phase that follows, or `end`. Default the next one of the file.
        pub then: Option<String>,
        /// The phase that follows when this one fails, or `end`. A phase that can fail needs it.
        pub r#else: Option<String>,
        /// It fails after this time (s). Default never.
        pub within_s: Option<f64>,
        /// It fails when the finger was moved this far in it (mm), or was held up for three times
        /// as long as that takes. Default never.
        pub within_mm: Option<f64>,
        /// It fails when contact is lost. Default true with features, false without.
        pub keeps_contact: Option<bool>,
        /// It fails when it is entered more often. Default never.
        pub visits_max: Option<u32>,
    }
}

taktil_rtcore::explained! {
    /// `[tactile_servo.phases]`: a task as a sequence of phases, for the law `phases`.
    #[derive(Clone, Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct TouchTask {
        /// One line for people. Default empty.
        #[serde(default)]
        pub title: String,
        /// The phase with which it begins. Default the first one of the file.
        pub first: Option<String>,
        /// The phases, 1 to 16.
        pub phase: Vec<PhaseConfig>,
    }
}

/// Where a phase leads to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// To the phase of this index.
    Phase(usize),
    /// To the end of the task.
    End,
}

fn out_of_range(place: &str, value: f64, low: f64, high: f64) -> Result<(), Invalid> {
    if low <= value && value <= high {
        return Ok(());
    }
    Err(Invalid::new(place, format!("is {value}"), format!("give {low} to {high}")))
}

impl PhaseConfig {
    /// The features, with the motion that is fed beside them; none without features.
    #[must_use]
    pub fn task_frame(&self) -> Option<TaskFrame> {
        (!self.feature.is_empty()).then(|| TaskFrame {
            state: self.state.clone(),
            feed_per_s: self.velocity_per_s,
            slew_s: self.slew_s.unwrap_or(TaskFrame::default().slew_s),
            feature: self.feature.clone(),
        })
    }

    /// Whether a loss of contact is a failure.
    #[must_use]
    pub fn needs_contact(&self) -> bool {
        self.keeps_contact.unwrap_or(!self.feature.is_empty())
    }

    /// Whether the phase can fail.
    fn can_fail(&self) -> bool {
        self.needs_contact()
            || self.within_s.is_some()
            || self.within_mm.is_some()
            || self.visits_max.is_some()
    }

    fn is_moving(&self) -> bool {
        self.velocity_per_s.iter().any(|speed| *speed != 0.0)
    }

    /// Refuses keys that do not belong to what the phase does, and keys that it lacks.
    fn check_kind(&self) -> Result<(), Invalid> {
        let (moves, senses) = (self.is_moving(), !self.feature.is_empty());
        let wrong = |key: &str, what: &str, remedy: &str| Err(Invalid::new(key, what, remedy));
        match self.does {
            PhaseKind::Approach | PhaseKind::Move if !moves => {
                wrong("velocity_per_s", "is zero: nothing would move", "give a speed, or hold")
            }
            PhaseKind::Regulate if !senses => {
                wrong("feature", "is empty: nothing would be regulated", "name a feature")
            }
            PhaseKind::Regulate if moves => {
                wrong("velocity_per_s", "is not for regulate", "leave it out, or move")
            }
            PhaseKind::Hold if moves => {
                wrong("velocity_per_s", "is not for hold", "leave it out, or move")
            }
            PhaseKind::Approach | PhaseKind::Hold if senses => {
                wrong("feature", "is not for this phase", "leave it out, or regulate")
            }
            PhaseKind::Approach if self.until.is_empty() => wrong(
                "until",
                "is empty: an approach would never end by itself",
                "name the condition that ends it",
            ),
            PhaseKind::Approach if self.within_s.is_none() && self.within_mm.is_none() => wrong(
                "does",
                "approaches without a bound",
                "give within_mm or within_s, and where to go then with else",
            ),
            _ if !senses && !self.state.is_empty() => {
                wrong("state", "has motions, but no feature is servoed", "leave it out")
            }
            _ if !senses && self.slew_s.is_some() => {
                wrong("slew_s", "is for phases with features", "leave it out")
            }
            _ if senses && !self.unheld.is_empty() => {
                wrong("unheld", "is for phases without features", "leave it out")
            }
            _ => Ok(()),
        }
    }

    fn check_numbers(&self) -> Result<(), Invalid> {
        for (i, speed) in self.velocity_per_s.iter().enumerate() {
            out_of_range(&format!("velocity_per_s[{i}]"), *speed, -500.0, 500.0)?;
        }
        let rows = [
            ("for_s", Some(self.for_s), 0.0, 3_600.0),
            ("within_s", self.within_s, 1e-3, 86_400.0),
            ("within_mm", self.within_mm, 1e-3, 500.0),
            ("visits_max", self.visits_max.map(f64::from), 1.0, 1e6),
        ];
        for (key, value, low, high) in rows {
            value.map_or(Ok(()), |value| out_of_range(key, value, low, high))?;
        }
        let translates = self.velocity_per_s[..3].iter().any(|speed| *speed != 0.0);
        if self.within_mm.is_some() && !translates && self.feature.is_empty() {
            let remedy = "give within_s, or a speed along x, y or z";
            return Err(Invalid::new("within_mm", "bounds a way that is never gone", remedy));
        }
        Ok(())
    }

    fn check(&self, servo: &Config) -> Result<(), Invalid> {
        self.check_kind()?;
        self.check_numbers()?;
        if let Some(frame) = self.task_frame() {
            // A feed is a velocity here.
            frame.check(&servo.array).map_err(|bad| Invalid {
                place: bad.place.replace("feed_per_s", "velocity_per_s"),
                ..bad
            })?;
        }
        if self.until.len() > CONDITIONS_MAX {
            let what = format!("has {} conditions", self.until.len());
            return Err(Invalid::new("until", what, format!("give at most {CONDITIONS_MAX}")));
        }
        condition::check(self, servo)?;
        match (&self.r#else, self.can_fail()) {
            (None, true) => Err(Invalid::new(
                "else",
                "is absent, but the phase can fail: by its bounds, or by lost contact",
                "name the phase that follows then, or `end`",
            )),
            (Some(_), false) => Err(Invalid::new(
                "else",
                "is never taken: the phase has no bound and does not need contact",
                "leave it out, or give within_s, within_mm, visits_max or keeps_contact",
            )),
            _ => Ok(()),
        }
    }
}

impl TouchTask {
    /// Checks the task for a servo with these parameters.
    ///
    /// # Errors
    /// The faults that this module names.
    pub fn check(&self, servo: &Config) -> Result<(), Invalid> {
        if self.phase.is_empty() || self.phase.len() > PHASES_MAX {
            let what = format!("has {} phases", self.phase.len());
            return Err(Invalid::new("phase", what, format!("give 1 to {PHASES_MAX}")));
        }
        for (i, phase) in self.phase.iter().enumerate() {
            let within = |bad: Invalid| bad.within(&format!("phase[{i}]"));
            self.check_name(i).map_err(within)?;
            phase.check(servo).map_err(within)?;
        }
        graph::check(self)
    }

    fn check_name(&self, index: usize) -> Result<(), Invalid> {
        let name = &self.phase[index].name;
        if name.is_empty() || name.len() > NAME_BYTES_MAX {
            let what = format!("has {} bytes", name.len());
            return Err(Invalid::new("name", what, format!("give 1 to {NAME_BYTES_MAX}")));
        }
        if name == END_NAME {
            let remedy = "call it otherwise";
            return Err(Invalid::new("name", "is `end`, which stands for no phase", remedy));
        }
        if self.phase[..index].iter().any(|other| other.name == *name) {
            return Err(Invalid::new("name", format!("is `{name}` once more"), "rename one"));
        }
        Ok(())
    }

    /// The phase of a name; the place of an error is `place`.
    fn next_of(&self, name: &str, place: &str) -> Result<Next, Invalid> {
        if name == END_NAME {
            return Ok(Next::End);
        }
        let found = self.phase.iter().position(|phase| phase.name == name);
        found.map(Next::Phase).ok_or_else(|| {
            let names: Vec<&str> = self.phase.iter().map(|phase| phase.name.as_str()).collect();
            let what = format!("names the phase `{name}`, which there is not");
            Invalid::new(place, what, format!("phases are: {}, {END_NAME}", names.join(", ")))
        })
    }

    /// The index of the phase with which the task begins.
    ///
    /// # Errors
    /// A name that no phase has.
    pub fn first_index(&self) -> Result<usize, Invalid> {
        match self.first.as_deref().map(|name| self.next_of(name, "first")).transpose()? {
            None => Ok(0),
            Some(Next::Phase(index)) => Ok(index),
            Some(Next::End) => {
                let what = "is `end`: the task would do nothing";
                Err(Invalid::new("first", what, "name a phase"))
            }
        }
    }

    /// Where the phase of an index leads to when it is done, and when it fails.
    ///
    /// # Errors
    /// A name that no phase has, and a last phase that ends and does not say what follows.
    pub fn successors(&self, index: usize) -> Result<(Option<Next>, Option<Next>), Invalid> {
        let phase = &self.phase[index];
        let at = |key: &str| format!("phase[{index}].{key}");
        let failed = phase.r#else.as_deref().map(|name| self.next_of(name, &at("else")));
        let done = match (&phase.then, phase.until.is_empty()) {
            (Some(_), true) => {
                let what = "is never taken: the phase has no condition that ends it";
                return Err(Invalid::new(at("then"), what, "give until, or leave it out"));
            }
            (None, true) => None,
            (Some(name), false) => Some(self.next_of(name, &at("then"))?),
            (None, false) if index + 1 < self.phase.len() => Some(Next::Phase(index + 1)),
            (None, false) => {
                let what = "is absent, and no phase follows in the file";
                return Err(Invalid::new(at("then"), what, "name a phase, or `end`"));
            }
        };
        Ok((done, failed.transpose()?))
    }

    /// The largest load that a phase is to hold (counts), where `m0_counts` stands for what a phase
    /// does not say.
    pub(crate) fn load_counts(&self, m0_counts: f64) -> f64 {
        let features = self.phase.iter().flat_map(|phase| &phase.feature);
        let loads = features.filter(|feature| feature.name == super::task_frame::Feature::M0);
        loads.map(|feature| feature.desired.unwrap_or(m0_counts)).fold(0.0, f64::max)
    }

    /// Whether a condition goes by the wrist's force.
    pub(crate) fn uses_wrench(&self) -> bool {
        let mut conditions = self.phase.iter().flat_map(|phase| &phase.until);
        conditions.any(|condition| condition.quantity == Quantity::WristForce)
    }
}

#[cfg(test)]
mod tests;
