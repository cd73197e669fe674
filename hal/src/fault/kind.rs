//! The kinds of faults and what their strength means. Which of them a device, a lane or a task can
//! have is said by whoever executes them.

use super::SplitMix;

/// Calls a macro with the tokens in braces that follow its name, and then with each kind of a plan:
/// its documentation, its name and the word that stands for it in a plan. Whoever needs an
/// enumeration that contains these kinds makes it by this macro, because they are listed here only.
///
/// ```
/// macro_rules! words {
///     ({ $first:literal } $($(#[doc = $about:literal])* $Kind:ident = $word:literal,)*) => {
///         [$first, $($word),*]
///     };
/// }
/// let words = taktil_hal::planned_fault_kinds!(words { "none" });
/// assert_eq!(words[..2], ["none", "loss"]);
/// ```
#[macro_export]
macro_rules! planned_fault_kinds {
    ($callback:ident { $($given:tt)* }) => {
        $callback! {
            { $($given)* }
            /// A message is lost, with the probability `value`.
            Loss = "loss",
            /// A message arrives twice, with the probability `value`.
            Duplication = "duplication",
            /// A message is overtaken by the next one, with the probability `value`.
            Reordering = "reordering",
            /// Every message comes later, by `value` seconds.
            Delay = "delay",
            /// One bit of a message is inverted, with the probability `value`.
            Corruption = "corruption",
            /// A message ends early, with the probability `value`.
            Truncation = "truncation",
            /// The board neither hears nor says anything; its power stays on. A lane has no job, an
            /// operator says nothing.
            Silence = "silence",
            /// The cable is pulled; at the end of the fault it is plugged in again.
            Unplugged = "unplugged",
            /// The board restarts at the begin of the fault and has forgotten its settings.
            Restart = "restart",
            /// Inputs keep their last value, outputs the word that they had.
            Frozen = "frozen",
            /// A reading is displaced by `value` counts for as long as the fault lasts.
            Jump = "jump",
            /// The sign of a channel is turned.
            Inversion = "inversion",
            /// The part `value` of a movement is not counted.
            LostCounts = "lost_counts",
            /// A channel reads or puts out zero; a line is false.
            Dead = "dead",
            /// A channel reads or puts out its largest value; a line is true.
            Hot = "hot",
            /// Readings end at the part `value` of their range.
            Clipped = "clipped",
            /// A call fails for this time, with the probability `value`.
            Failing = "failing",
            /// A reading is put together from an old and a new one, with the probability `value`.
            Torn = "torn",
            /// A line changes every `value` seconds.
            Bounce = "bounce",
            /// The jobs of a lane begin `value` seconds after their release.
            Lateness = "lateness",
            /// The jobs of a lane take `value` seconds longer.
            Overrun = "overrun",
            /// No lane but the world's runs for `value` seconds from the begin of the fault.
            ClockGap = "clock_gap",
            /// A task panics.
            Panic = "panic",
            /// A task writes numbers that are not finite.
            NotFinite = "not_finite",
            /// An operator makes `value` requests at each opportunity.
            Flood = "flood",
        }
    };
}

/// Declares the enumeration of the kinds.
macro_rules! declare_kinds {
    ({} $($(#[doc = $about:literal])* $Kind:ident = $word:literal,)*) => {
        /// What goes wrong. A message is a datagram, a frame of a byte stream, or a reading or word
        /// that passes a device half.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
        pub enum FaultKind {
            $($(#[doc = $about])* $Kind,)*
        }

        impl FaultKind {
            /// All kinds, in the order of their declaration.
            pub const ALL: [FaultKind; [$($word),*].len()] = [$(FaultKind::$Kind),*];

            /// The word in a plan.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self {
                    $(FaultKind::$Kind => $word,)*
                }
            }
        }
    };
}

planned_fault_kinds!(declare_kinds {});

impl FaultKind {
    /// The kinds that can befall the messages of a link, and the board at its end.
    pub const LINK: [FaultKind; 10] = [
        FaultKind::Loss,
        FaultKind::Duplication,
        FaultKind::Reordering,
        FaultKind::Delay,
        FaultKind::Corruption,
        FaultKind::Truncation,
        FaultKind::Silence,
        FaultKind::Unplugged,
        FaultKind::Restart,
        FaultKind::Frozen,
    ];

    /// The kind of this word.
    #[must_use]
    pub fn from_name(name: &str) -> Option<FaultKind> {
        FaultKind::ALL.into_iter().find(|kind| kind.name() == name)
    }

    /// All words, separated by commas, for messages.
    #[must_use]
    pub fn words(kinds: &[FaultKind]) -> String {
        let names: Vec<&str> = kinds.iter().map(|kind| kind.name()).collect();
        names.join(", ")
    }

    /// The smallest and the largest `value`: a probability or a part of something, seconds, counts
    /// of an encoder, a number of requests; `None` where `value` has no meaning.
    #[must_use]
    pub const fn value_range(self) -> Option<(f64, f64)> {
        match self {
            FaultKind::Loss
            | FaultKind::Duplication
            | FaultKind::Reordering
            | FaultKind::Corruption
            | FaultKind::Truncation
            | FaultKind::LostCounts
            | FaultKind::Clipped
            | FaultKind::Failing
            | FaultKind::Torn => Some((0.0, 1.0)),
            FaultKind::Delay
            | FaultKind::Lateness
            | FaultKind::Overrun
            | FaultKind::ClockGap
            | FaultKind::Bounce => Some((0.0, 10.0)),
            FaultKind::Jump => Some((-1e6, 1e6)),
            FaultKind::Flood => Some((1.0, 1000.0)),
            FaultKind::Silence
            | FaultKind::Unplugged
            | FaultKind::Restart
            | FaultKind::Frozen
            | FaultKind::Inversion
            | FaultKind::Dead
            | FaultKind::Hot
            | FaultKind::Panic
            | FaultKind::NotFinite => None,
        }
    }

    /// A strength, small ones more often than large ones; 1 where the kind has none.
    pub fn draw_value(self, random: &mut SplitMix) -> f64 {
        match self {
            FaultKind::Delay => 0.01 * random.unit(),
            FaultKind::Lateness | FaultKind::Overrun => 0.02 * random.unit() * random.unit(),
            FaultKind::ClockGap => 0.5 * random.unit() * random.unit(),
            FaultKind::Bounce => 0.001 + 0.02 * random.unit(),
            FaultKind::Jump => {
                let sign = if random.below(2) == 0 { -1.0 } else { 1.0 };
                (sign * power_of_ten(4.0 * random.unit())).round()
            }
            FaultKind::Flood => (1.0 + 50.0 * random.unit() * random.unit()).round(),
            _ => match self.value_range() {
                Some((_, most)) => most * random.unit() * random.unit(),
                None => 1.0,
            },
        }
    }
}

/// Ten to the power of `exponent`, 0 to 4, by whole powers and a straight line between them: the
/// same bits on every machine, without a library of elementary functions.
fn power_of_ten(exponent: f64) -> f64 {
    let below = exponent.floor().clamp(0.0, 4.0);
    let mut power = 1.0;
    for _ in 0..below as u32 {
        power *= 10.0;
    }
    power * (1.0 + 9.0 * (exponent - below))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kind_has_a_word_of_its_own_and_values_within_its_range() {
        let mut random = SplitMix::new(5);
        for (index, kind) in FaultKind::ALL.into_iter().enumerate() {
            assert_eq!(kind as usize, index, "the order is that of the declaration");
            assert_eq!(FaultKind::from_name(kind.name()), Some(kind));
            for _ in 0..200 {
                let value = kind.draw_value(&mut random);
                let (low, high) = kind.value_range().unwrap_or((1.0, 1.0));
                assert!((low..=high).contains(&value), "{kind:?}: {value}");
            }
        }
        assert_eq!(FaultKind::from_name("los"), None);
    }

    #[test]
    fn powers_between_whole_ones_lie_between_them() {
        assert_eq!([0.0, 1.0, 2.0, 4.0].map(power_of_ten), [1.0, 10.0, 100.0, 1e4]);
        assert_eq!(power_of_ten(1.5), 55.0);
    }
}
