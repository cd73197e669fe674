//! Starts and stops: a task that was stopped and is started again has to do what a fresh one does,
//! and no start may lose memory.

use taktil_rtcore::guard::{self, HeapBalance};

use crate::drive::{Findings, StepOutputs};
use crate::plan::{InputKind, Run, run_seed};
use crate::progress::Progress;
use crate::report::Check;
use crate::stimulus::Stimulus;
use crate::task_under_test::TaskUnderTest;
use crate::watchdog::Watchdog;

/// Restarts that are compared.
pub(crate) const RESTARTS_COMPARED: usize = 100;
/// Steps before the stop, and after the start behind it, at most.
const RESTART_STEPS_MAX: usize = 300;
/// Steps between a start and a stop, when memory is looked at.
const LEAK_STEPS: usize = 20;
/// Starts before memory is looked at: what is made once in a process is made then.
const WARM_UP_STARTS: usize = 10;
/// Parts of the starts. Memory that grows in at least two of them is lost; what grows in one only
/// was made once.
const START_PARTS: usize = 4;

/// What the checks of this module need.
pub(crate) struct Lifecycle<'a> {
    pub(crate) subject: &'a TaskUnderTest,
    pub(crate) seed: u64,
    pub(crate) watchdog: &'a Watchdog,
    pub(crate) progress: &'a mut Progress,
    pub(crate) findings: &'a mut Findings,
}

impl Lifecycle<'_> {
    /// Compares tasks that were stopped and started again with fresh ones.
    ///
    /// # Errors
    /// A task that cannot be built.
    pub(crate) fn restart(&mut self) -> anyhow::Result<()> {
        self.progress.begin("restarting", RESTARTS_COMPARED);
        for round in 0..RESTARTS_COMPARED {
            let kinds = [InputKind::Plausible, InputKind::Extreme];
            let run = |number: usize| Run {
                number: round,
                kind: kinds[round % kinds.len()],
                seed: run_seed(self.seed ^ 0x7265_7374, number),
                steps: 1 + (round * 7) % RESTART_STEPS_MAX,
                first: 0,
            };
            let (before, after) = (run(2 * round), run(2 * round + 1));
            self.restart_once(&before, &Run { steps: RESTART_STEPS_MAX, ..after })?;
            self.progress.advance();
        }
        Ok(())
    }

    fn restart_once(&mut self, before: &Run, after: &Run) -> anyhow::Result<()> {
        let (mut used, mut fresh) = (self.subject.build()?, self.subject.build()?);
        let mut written = (StepOutputs::default(), StepOutputs::default());
        let mut stimulus = Stimulus::new(self.subject, &used, before);
        if used.start().is_err() {
            return Ok(());
        }
        for step in 0..before.steps {
            stimulus.advance();
            self.watchdog.begin(None, step);
            stimulus.apply(&mut used, false);
            if used.step(&stimulus.cycle()).is_panic() {
                let _ = used.take_panic_place();
                return Ok(());
            }
        }
        let stopped = used.stop();
        written.0.take(&mut used);
        used.take_refused(|_, _| {});
        self.subject.clear_inputs(&mut used)?;
        let (again, first) = (used.start(), fresh.start());
        if stopped.is_err() || first.is_err() {
            return Ok(());
        }
        if let Err(fault) = again {
            let what = format!("`start` after a stop refuses: {}", fault.text());
            self.findings.add(Check::Restart, what, None);
            return Ok(());
        }
        let mut stimulus = Stimulus::new(self.subject, &fresh, after);
        for step in 0..after.steps {
            stimulus.advance();
            self.watchdog.begin(None, step);
            stimulus.apply(&mut used, false);
            stimulus.apply(&mut fresh, false);
            let reports = (used.step(&stimulus.cycle()), fresh.step(&stimulus.cycle()));
            written.0.take(&mut used);
            written.1.take(&mut fresh);
            if written.0.hash(&reports.0) != written.1.hash(&reports.1) {
                let difference = written.1.difference(&written.0, fresh.outputs());
                let what = format!(
                    "stopped after {} steps and started again, against a fresh one at step {step}: \
                     {difference}",
                    before.steps
                );
                self.findings.add(Check::Restart, what, None);
                break;
            }
            if reports.0.is_panic() {
                let _ = used.take_panic_place();
                break;
            }
        }
        let _ = (used.stop(), fresh.stop());
        Ok(())
    }

    /// Looks whether starts lose memory.
    ///
    /// # Errors
    /// A task that cannot be built.
    pub(crate) fn leak(&mut self, starts: usize) -> anyhow::Result<()> {
        self.progress.begin("starting and stopping", starts);
        let warm_up = WARM_UP_STARTS.min(starts / 2);
        let mut parts = [HeapBalance::default(); START_PARTS];
        let counted = starts - warm_up;
        for start in 0..starts {
            let seed = run_seed(self.seed ^ 0x6c65_616b, start);
            let (ended, balance) = guard::heap_balance(|| self.start_and_stop(seed));
            self.progress.advance();
            let (true, Some(number)) = (ended?, start.checked_sub(warm_up)) else { continue };
            let part = &mut parts[number * START_PARTS / counted];
            part.blocks += balance.blocks;
            part.bytes += balance.bytes;
        }
        let grown = parts.iter().filter(|part| part.blocks > 0 || part.bytes > 0).count();
        if grown >= 2 {
            let blocks: i64 = parts.iter().map(|part| part.blocks).sum();
            let bytes: i64 = parts.iter().map(|part| part.bytes).sum();
            let what = format!("{counted} starts and stops left {bytes} bytes in {blocks} blocks");
            self.findings.add(Check::Leak, what, None);
        }
        Ok(())
    }

    /// Builds, starts, runs for a little, stops and drops the task; false when it panicked, after
    /// which memory is lost by design.
    fn start_and_stop(&self, seed: u64) -> anyhow::Result<bool> {
        let run = Run { number: 0, kind: InputKind::Plausible, seed, steps: LEAK_STEPS, first: 0 };
        let mut harness = self.subject.build()?;
        let mut stimulus = Stimulus::new(self.subject, &harness, &run);
        let mut sound = harness.start().is_ok();
        for step in 0..run.steps {
            stimulus.advance();
            self.watchdog.begin(None, step);
            stimulus.apply(&mut harness, false);
            if harness.step(&stimulus.cycle()).is_panic() {
                let _ = harness.take_panic_place();
                sound = false;
                break;
            }
        }
        Ok(harness.stop().is_ok() && sound)
    }
}
