//! The plan of a check: how many runs of a task, of which length, with which kind of inputs. A run
//! begins with a fresh task.

/// Which values the inputs of a run have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum InputKind {
    /// Such as the tasks of this repository write: joints in the middle half of their ranges, the
    /// numbers of states that there are.
    Plausible,
    /// Any finite numbers between them, which a port lets through: zero, the largest, any bits.
    Extreme,
    /// NaN and infinite numbers too, which ports refuse.
    NotFinite,
}

impl InputKind {
    /// What it is called.
    pub(crate) fn name(self) -> &'static str {
        match self {
            InputKind::Plausible => "plausible values",
            InputKind::Extreme => "extreme values",
            InputKind::NotFinite => "values that are not finite",
        }
    }
}

/// One run of a fresh task.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Run {
    /// Its number in the plan.
    pub(crate) number: usize,
    pub(crate) kind: InputKind,
    /// Seed of its inputs.
    pub(crate) seed: u64,
    /// Steps.
    pub(crate) steps: usize,
    /// Steps of all runs before.
    pub(crate) first: usize,
}

/// Share of the steps that the one long run has, in percent. A task that is slow once in 100 000
/// steps is slow several times in it.
const LONG_RUN_PERCENT: usize = 60;
/// Steps of a short run at most. Each begins with inputs that are absent.
const SHORT_RUN_STEPS_MAX: usize = 1000;
/// Short runs take turns with these.
const SHORT_RUN_KINDS: [InputKind; 4] =
    [InputKind::Extreme, InputKind::NotFinite, InputKind::Plausible, InputKind::Extreme];

/// The seed of a run, which depends on its number and not on the length of the plan.
pub(crate) fn run_seed(seed: u64, number: usize) -> u64 {
    (seed ^ 0x6368_6563_6b00_0000)
        .wrapping_add(0x9e37_79b9_7f4a_7c15_u64.wrapping_mul(number as u64))
}

/// The runs of a check of `steps` steps in all: one long one with plausible inputs, then short ones
/// of all kinds.
pub(crate) fn runs(seed: u64, steps: usize) -> Vec<Run> {
    let long = steps * LONG_RUN_PERCENT / 100;
    let short = ((steps - long) / SHORT_RUN_KINDS.len()).clamp(1, SHORT_RUN_STEPS_MAX);
    let mut runs = Vec::new();
    let mut first = 0;
    while first < steps {
        let number = runs.len();
        let kind = match number.checked_sub(1) {
            None => InputKind::Plausible,
            Some(turn) => SHORT_RUN_KINDS[turn % SHORT_RUN_KINDS.len()],
        };
        let length = if number == 0 { long.max(1) } else { short.min(steps - first) };
        runs.push(Run { number, kind, seed: run_seed(seed, number), steps: length, first });
        first += length;
    }
    runs
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_follow_each_other_and_sum_up_to_what_was_asked_for() {
        for steps in [1, 7, 1000, 999_983] {
            let runs = runs(4, steps);
            assert_eq!(runs.iter().map(|run| run.steps).sum::<usize>(), steps);
            for pair in runs.windows(2) {
                assert_eq!(pair[0].first + pair[0].steps, pair[1].first);
                assert_ne!(pair[0].seed, pair[1].seed);
            }
        }
        let million = runs(4, 1_000_000);
        assert_eq!((million[0].steps, million.len()), (600_000, 401));
        assert_eq!(
            million[3].seed,
            runs(4, 5000)[3].seed,
            "a run is found again in a shorter plan"
        );
    }
}
