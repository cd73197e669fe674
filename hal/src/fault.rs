//! The plan of the faults that befall a run: what happens, to what, from when, for how long, and
//! how strongly. An emulator executes it on the bytes or packets that pass through it, a decorator
//! on the readings and words of a device half, an executor on the jobs of a lane. A plan is written
//! by hand, one fault a text, or drawn from a seed. A target may name one channel, the first is 1.
//!
//! ```
//! use taktil_hal::Nanos;
//! use taktil_hal::fault::{Fault, FaultKind, FaultPlan};
//!
//! let cable = "kind=silence target=mesa at=2.5 for=0.2".parse::<Fault>()?;
//! let noise = "kind=loss target=mesa at=0 value=0.01".parse::<Fault>()?;
//! let plan = FaultPlan::new(vec![cable, noise]);
//! assert_eq!(plan.strength(FaultKind::Silence, "mesa", Nanos::from_micros(2_600_000)), Some(1.0));
//! assert_eq!(plan.strength(FaultKind::Silence, "mesa", Nanos::from_micros(2_700_000)), None);
//! assert_eq!(plan.strength(FaultKind::Loss, "myrmex", Nanos::ZERO), None);
//!
//! let joint = "kind=jump target=encoders.3 at=1 for=0.1 value=-500".parse::<Fault>()?;
//! assert_eq!((joint.target.as_str(), joint.channel), ("encoders", Some(3)));
//! # Ok::<(), taktil_hal::Invalid>(())
//! ```

use core::fmt;
use core::str::FromStr;

use crate::invalid::Invalid;
use crate::time::Nanos;

mod counts;
mod kind;

pub use counts::FaultCounts;
pub use kind::FaultKind;

/// Largest number of faults that [`FaultPlan::draw`] makes.
pub const DRAWN_FAULTS_MAX: usize = 8;
/// Latest begin and longest duration of a fault (s).
pub const FAULT_TIME_MAX_S: f64 = 1e6;

/// One fault of a plan.
#[derive(Clone, Debug, PartialEq)]
pub struct Fault {
    /// What goes wrong.
    pub kind: FaultKind,
    /// Name of the device that it befalls; empty for every device.
    pub target: String,
    /// The channel that it befalls, the first is 1; all of them when absent.
    pub channel: Option<u16>,
    /// When it begins, since the start of the run.
    pub at: Nanos,
    /// How long it lasts; [`Nanos::MAX`] for good.
    pub duration: Nanos,
    /// How strong it is, as [`FaultKind`] says; 1 where the kind has no strength.
    pub value: f64,
}

impl Fault {
    /// Checks what a text or a section of a file gave. A number after the last full stop of
    /// `target` is a channel.
    ///
    /// # Errors
    /// A time that is negative, too large or no number; a `value` outside the range of the kind,
    /// given without meaning, or missing; the channel 0. The place is the key.
    pub fn new(
        kind: FaultKind,
        target: &str,
        at_s: f64,
        for_s: Option<f64>,
        value: Option<f64>,
    ) -> Result<Fault, Invalid> {
        let instant = |place: &str, seconds: f64| {
            if (0.0..=FAULT_TIME_MAX_S).contains(&seconds) {
                Ok(Nanos((1e9 * seconds).round() as i64))
            } else {
                Err(Invalid::new(place, format!("{seconds} s"), "give 0 to 1000000 s"))
            }
        };
        let (target, channel) = split_target(target)?;
        let value = match (kind.value_range(), value) {
            (None, None) => 1.0,
            (None, Some(_)) => {
                let what = format!("`{}` has no strength", kind.name());
                return Err(Invalid::new("value", what, "leave it out"));
            }
            (Some((low, high)), Some(value)) if (low..=high).contains(&value) => value,
            (Some((low, high)), given) => {
                let what = match given {
                    Some(value) => format!("{value} for `{}`", kind.name()),
                    None => format!("is missing for `{}`", kind.name()),
                };
                return Err(Invalid::new("value", what, format!("give {low} to {high}")));
            }
        };
        let duration = for_s.map_or(Ok(Nanos::MAX), |seconds| instant("for", seconds))?;
        let at = instant("at", at_s)?;
        Ok(Fault { kind, target: target.to_owned(), channel, at, duration, value })
    }

    /// When it ends: the first instant at which it does not befall anything any more.
    #[must_use]
    pub fn end(&self) -> Nanos {
        Nanos(self.at.0.saturating_add(self.duration.0))
    }

    /// Whether it is under way at `now`, whatever it befalls.
    #[must_use]
    pub fn is_under_way(&self, now: Nanos) -> bool {
        self.at <= now && now < self.end()
    }

    /// Whether it befalls this channel of its target, counted from 0.
    #[must_use]
    pub fn has_channel(&self, channel: usize) -> bool {
        self.channel.is_none_or(|one| usize::from(one) == channel + 1)
    }

    /// Whether it befalls `target` at `now`: from its begin, included, to its end, excluded.
    #[must_use]
    pub fn is_active(&self, target: &str, now: Nanos) -> bool {
        (self.target.is_empty() || self.target == target) && self.is_under_way(now)
    }
}

/// The device and the channel of a target.
fn split_target(target: &str) -> Result<(&str, Option<u16>), Invalid> {
    let numbered = target.rsplit_once('.').and_then(|(device, number)| {
        let digits = number.bytes().all(|byte| byte.is_ascii_digit()) && !number.is_empty();
        digits.then_some((device, number))
    });
    let Some((device, number)) = numbered else { return Ok((target, None)) };
    match number.parse::<u16>() {
        Ok(channel) if channel > 0 => Ok((device, Some(channel))),
        _ => {
            let what = format!("`{number}` is no channel");
            Err(Invalid::new("target", what, "the first channel is 1"))
        }
    }
}

impl FromStr for Fault {
    type Err = Invalid;

    /// Reads `kind=WORD target=NAME at=SECONDS for=SECONDS value=NUMBER`, in any order, separated
    /// by blanks or commas. `kind` is needed; `at` is 0, `for` is for good, `target` is every
    /// device where they are left out.
    fn from_str(text: &str) -> Result<Fault, Invalid> {
        let (mut kind, mut target, mut at_s) = (None, "", 0.0);
        let (mut for_s, mut value) = (None, None);
        let mut given = Vec::new();
        for part in text.split([' ', ',']).filter(|part| !part.is_empty()) {
            let Some((key, word)) = part.split_once('=') else {
                return Err(Invalid::new(part, "is no key=value", "write for example kind=loss"));
            };
            if given.contains(&key) {
                return Err(Invalid::new(key, "is given twice", "give it once"));
            }
            given.push(key);
            let number = || {
                word.parse::<f64>().map_err(|_| {
                    Invalid::new(key, format!("`{word}` is no number"), "give a number")
                })
            };
            match key {
                "kind" => kind = FaultKind::from_name(word),
                "target" => target = word,
                "at" => at_s = number()?,
                "for" => for_s = Some(number()?),
                "value" => value = Some(number()?),
                _ => {
                    let remedy = "the keys are kind, target, at, for and value";
                    return Err(Invalid::new(key, "is no key of a fault", remedy));
                }
            }
        }
        let Some(kind) = kind else {
            let words = FaultKind::words(&FaultKind::ALL);
            return Err(Invalid::new("kind", "names no fault", format!("it is one of: {words}")));
        };
        Fault::new(kind, target, at_s, for_s, value)
    }
}

impl fmt::Display for Fault {
    /// Writes what [`Fault::from_str`] reads.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "kind={}", self.kind.name())?;
        if !self.target.is_empty() {
            write!(f, " target={}", self.target)?;
            if let Some(channel) = self.channel {
                write!(f, ".{channel}")?;
            }
        }
        write!(f, " at={}", self.at.0 as f64 * 1e-9)?;
        if self.duration != Nanos::MAX {
            write!(f, " for={}", self.duration.0 as f64 * 1e-9)?;
        }
        match self.kind.value_range() {
            Some(_) => write!(f, " value={}", self.value),
            None => Ok(()),
        }
    }
}

/// A device that a drawn plan may befall.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FaultTarget<'a> {
    /// Its name in the plan.
    pub name: &'a str,
    /// The kinds of faults that whoever executes the plan can make of it.
    pub kinds: &'a [FaultKind],
}

/// All faults of a run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FaultPlan {
    faults: Vec<Fault>,
}

impl FaultPlan {
    /// A plan of these faults; they may overlap.
    #[must_use]
    pub fn new(faults: Vec<Fault>) -> FaultPlan {
        FaultPlan { faults }
    }

    /// The faults in the order in which they were given.
    #[must_use]
    pub fn faults(&self) -> &[Fault] {
        &self.faults
    }

    /// Checks that an emulator that executes only `kinds`, on whole boards, can execute what
    /// befalls `target`.
    ///
    /// # Errors
    /// The first fault that it cannot, at the place `kind`; one of a single channel, at `target`.
    pub fn check_kinds(&self, target: &str, kinds: &[FaultKind]) -> Result<(), Invalid> {
        let befalls = |fault: &&Fault| fault.target.is_empty() || fault.target == target;
        for fault in self.faults.iter().filter(befalls) {
            if !kinds.contains(&fault.kind) {
                let what = format!("`{}` cannot happen to `{target}`", fault.kind.name());
                let known = FaultKind::words(kinds);
                return Err(Invalid::new("kind", what, format!("it is one of: {known}")));
            }
            if let Some(channel) = fault.channel {
                let what = format!("faults befall `{target}` as a whole");
                return Err(Invalid::new("target", what, format!("leave `.{channel}` out")));
            }
        }
        Ok(())
    }

    /// One to [`DRAWN_FAULTS_MAX`] faults within `length`, each of a kind that its target can have;
    /// the same for the same seed. Each ends before `length`, so that what comes after it can be
    /// judged. Without a target that can have a fault the plan is empty.
    #[must_use]
    pub fn draw(seed: u64, targets: &[FaultTarget<'_>], length: Nanos) -> FaultPlan {
        let targets: Vec<_> = targets.iter().filter(|target| !target.kinds.is_empty()).collect();
        if targets.is_empty() {
            return FaultPlan::default();
        }
        let mut random = SplitMix::new(seed);
        let count = 1 + random.below(DRAWN_FAULTS_MAX);
        let faults = (0..count).map(|_| {
            let target = targets[random.below(targets.len())];
            let kind = target.kinds[random.below(target.kinds.len())];
            let at = Nanos((random.unit() * 0.9 * length.0 as f64) as i64);
            let rest = 0.95 * length.0 as f64 - at.0 as f64;
            let duration = Nanos((random.unit() * rest).max(1.0) as i64);
            let value = kind.draw_value(&mut random);
            let (name, channel) = split_target(target.name).unwrap_or((target.name, None));
            Fault { kind, target: name.to_owned(), channel, at, duration, value }
        });
        FaultPlan { faults: faults.collect() }
    }

    /// How strongly a kind of fault befalls `target` at `now`: the strongest of those active.
    #[must_use]
    pub fn strength(&self, kind: FaultKind, target: &str, now: Nanos) -> Option<f64> {
        let active = |fault: &&Fault| fault.kind == kind && fault.is_active(target, now);
        self.faults.iter().filter(active).map(|fault| fault.value).reduce(f64::max)
    }
}

/// The generator splitmix64 (Steele, Lea and Flood, 2014): equal seeds, equal numbers. It decides
/// which messages a fault hits; it is no source of noise for the simulator.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SplitMix {
    state: u64,
}

impl SplitMix {
    /// The generator of a seed.
    #[must_use]
    pub const fn new(seed: u64) -> SplitMix {
        SplitMix { state: seed }
    }

    /// The next 64 bits.
    pub fn next_u64(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut word = self.state;
        word = (word ^ (word >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        word = (word ^ (word >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        word ^ (word >> 31)
    }

    /// The next whole number below `end`, which is at least 1.
    pub fn below(&mut self, end: usize) -> usize {
        (self.next_u64() % end.max(1) as u64) as usize
    }

    /// The next number in 0 to 1, 1 excluded.
    pub fn unit(&mut self) -> f64 {
        (self.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// The next number from `low` to `high`, `high` excluded.
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn any_fault(name: &str) -> FaultTarget<'_> {
        FaultTarget { name, kinds: &FaultKind::ALL }
    }

    #[test]
    fn a_fault_written_and_read_is_the_same() {
        let targets = ["mesa", "myrmex"].map(any_fault);
        let plan = FaultPlan::draw(7, &targets, Nanos::from_secs(10));
        for fault in plan.faults() {
            let again: Fault = fault.to_string().parse().unwrap();
            assert_eq!((again.kind, &again.target), (fault.kind, &fault.target));
            assert!((again.at.0 - fault.at.0).abs() <= 1, "{fault}");
            assert!((again.value - fault.value).abs() < 1e-15);
        }
    }

    #[test]
    fn a_target_may_name_a_channel_and_is_written_with_it() {
        let fault: Fault = "kind=dead target=encoders.3 at=1 for=2".parse().unwrap();
        assert_eq!((fault.target.as_str(), fault.channel), ("encoders", Some(3)));
        assert!(fault.has_channel(2) && !fault.has_channel(3) && !fault.has_channel(0));
        assert_eq!(fault.to_string(), "kind=dead target=encoders.3 at=1 for=2");
        assert_eq!((fault.at, fault.end()), (Nanos::from_secs(1), Nanos::from_secs(3)));
        let lane: Fault = "kind=silence target=lane.servo".parse().unwrap();
        assert_eq!((lane.target.as_str(), lane.channel), ("lane.servo", None));
        assert!(lane.has_channel(31) && lane.end() == Nanos::MAX);
    }

    #[test]
    fn equal_seeds_draw_equal_plans_that_end_in_time() {
        let length = Nanos::from_secs(5);
        let targets = [any_fault("a")];
        for seed in 0..200 {
            let plan = FaultPlan::draw(seed, &targets, length);
            assert_eq!(plan, FaultPlan::draw(seed, &targets, length));
            assert!(!plan.faults().is_empty());
            assert!(plan.faults().iter().all(|f| f.at.0 + f.duration.0 < length.0));
        }
        assert_ne!(FaultPlan::draw(1, &targets, length), FaultPlan::draw(2, &targets, length));
    }

    #[test]
    fn a_drawn_plan_holds_only_what_its_targets_can_have() {
        let kinds = [FaultKind::Loss, FaultKind::Frozen];
        let targets = [FaultTarget { name: "a", kinds: &kinds }, any_fault("b")];
        for seed in 0..100 {
            let plan = FaultPlan::draw(seed, &targets, Nanos::from_secs(1));
            assert_eq!(plan.check_kinds("a", &kinds), Ok(()));
            assert_eq!(plan.check_kinds("b", &FaultKind::ALL), Ok(()));
        }
        let none = FaultTarget { name: "c", kinds: &[] };
        assert_eq!(FaultPlan::draw(1, &[none], Nanos::from_secs(1)), FaultPlan::default());
        let delay = FaultPlan::new(vec!["kind=delay value=0.1".parse().unwrap()]);
        let refused = delay.check_kinds("a", &kinds).unwrap_err();
        assert_eq!(
            (refused.place.as_str(), refused.remedy.as_str()),
            ("kind", "it is one of: loss, frozen")
        );
    }

    #[test]
    fn what_is_wrong_is_named_by_its_key() {
        for (text, place) in [
            ("", "kind"),
            ("kind=los", "kind"),
            ("kind=loss", "value"),
            ("kind=loss value=1.5", "value"),
            ("kind=loss value=nan", "value"),
            ("kind=silence value=1", "value"),
            ("kind=silence at=-1", "at"),
            ("kind=silence for=1e9", "for"),
            ("kind=silence for=soon", "for"),
            ("kind=silence kind=silence", "kind"),
            ("kind=silence where=here", "where"),
            ("kind=frozen target=encoders.0", "target"),
            ("kind=frozen target=encoders.99999", "target"),
            ("kind=jump target=encoders.1 value=2e6", "value"),
            ("silence", "silence"),
        ] {
            let bad = text.parse::<Fault>().unwrap_err();
            assert_eq!(bad.place, place, "{text}: {bad:?}");
        }
    }
}
