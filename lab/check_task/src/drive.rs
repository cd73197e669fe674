//! Drives the task through the runs of a plan and collects what its steps did wrong. A run is
//! driven at least three times: a task and its twin side by side, which differ in the values that
//! they must not use, and one more task later, which has to do the same bit for bit. The time of a
//! step is the shortest of these, so that a stall of the host is not taken for the task's; a step
//! over its budget is repeated more often before it counts.

use std::collections::BTreeMap;

use taktil_rtcore::harness::{Harness, OutputPort, StepReport};
use taktil_rtcore::{FaultCode, Nanos, StateHash};

use crate::number::{Number, places};
use crate::plan::{InputKind, Run};
use crate::progress::Progress;
use crate::range::Ranges;
use crate::report::{Check, FailedStep, Failure};
use crate::stimulus::Stimulus;
use crate::task_under_test::TaskUnderTest;
use crate::watchdog::Watchdog;

/// How often runs with steps over the budget are driven once more.
const BUDGET_REPEATS_MAX: usize = 3;
/// Hash of a step that was not reached.
const NOT_REACHED: u32 = 0;

/// What was found, the first of each kind.
#[derive(Debug, Default)]
pub(crate) struct Findings {
    pub(crate) failures: BTreeMap<Check, Failure>,
    /// Steps at which an input had a value that must not be used.
    pub(crate) unusable_steps: u64,
}

impl Findings {
    /// Adds one; of a kind that was found before only the number counts.
    pub(crate) fn add(&mut self, check: Check, what: String, at: Option<FailedStep>) {
        let found = self.failures.entry(check).or_insert(Failure { what, at, count: 0 });
        found.count += 1;
    }

    /// Whether the next one of this kind would be the first.
    fn is_first(&self, check: Check) -> bool {
        !self.failures.contains_key(&check)
    }
}

/// The outputs that a step wrote.
#[derive(Debug, Default)]
pub(crate) struct StepOutputs {
    bytes: Vec<u8>,
    /// Number of each output and the end of its value.
    parts: Vec<(usize, usize)>,
}

impl StepOutputs {
    /// Takes what the last step wrote.
    pub(crate) fn take(&mut self, harness: &mut Harness) {
        self.bytes.clear();
        self.parts.clear();
        harness.take_written(|output, body| {
            self.bytes.extend_from_slice(body);
            self.parts.push((output, self.bytes.len()));
        });
    }

    fn values(&self) -> impl Iterator<Item = (usize, &[u8])> {
        let mut begin = 0;
        self.parts.iter().map(move |&(output, end)| {
            (output, &self.bytes[core::mem::replace(&mut begin, end)..end])
        })
    }

    /// A hash of all that a step showed: outputs, faults and state.
    pub(crate) fn hash(&self, report: &StepReport) -> u32 {
        let mut hash = StateHash::new();
        hash.add(&report.fault).add(&report.refused).word(report.state);
        for &(output, end) in &self.parts {
            hash.word(output as u64).word(end as u64);
        }
        for chunk in self.bytes.chunks(8) {
            let mut word = [0; 8];
            word[..chunk.len()].copy_from_slice(chunk);
            hash.word(u64::from_le_bytes(word));
        }
        let value = hash.value();
        ((value ^ (value >> 32)) as u32).max(NOT_REACHED + 1)
    }

    /// The first difference to what another step wrote, as text.
    pub(crate) fn difference(&self, other: &StepOutputs, outputs: &[OutputPort]) -> String {
        for ((output, value), (other_output, other_value)) in self.values().zip(other.values()) {
            if output != other_output {
                break;
            }
            let OutputPort { name, fields, .. } = &outputs[output];
            for (field, place) in fields.iter().zip(places(fields)) {
                for element in 0..place.count {
                    let pair = (place.get(value, element), place.get(other_value, element));
                    if !is_same(pair.0, pair.1) {
                        let index =
                            if field.array { format!("[{element}]") } else { String::new() };
                        let (first, second) = pair;
                        return format!("{name}.{}{index} is {first}, then {second}", field.name);
                    }
                }
            }
        }
        match self.parts == other.parts {
            true => "the folded state or a fault differs".to_owned(),
            false => "other outputs are written".to_owned(),
        }
    }
}

fn is_same(one: Number, other: Number) -> bool {
    match (one, other) {
        (Number::Real(one), Number::Real(other)) => one.to_bits() == other.to_bits(),
        (one, other) => one == other,
    }
}

/// A task at work on a run.
struct TaskInstance {
    harness: Harness,
    written: StepOutputs,
}

impl TaskInstance {
    fn step(&mut self, stimulus: &Stimulus, twin: bool) -> (StepReport, u32) {
        stimulus.apply(&mut self.harness, twin);
        let report = self.harness.step(&stimulus.cycle());
        self.written.take(&mut self.harness);
        let hash = self.written.hash(&report);
        (report, hash)
    }
}

/// What drives, and what it found.
pub(crate) struct TestDriver<'a> {
    subject: &'a TaskUnderTest,
    ranges: Ranges,
    watchdog: &'a Watchdog,
    pub(crate) progress: &'a mut Progress,
    pub(crate) findings: Findings,
    /// Hash of each step of the plan, and its shortest time (ns).
    hashes: Vec<u32>,
    took_ns: Vec<u32>,
}

/// The place of a step for the report.
fn failed_step(run: &Run, step: usize, stimulus: &Stimulus) -> Option<FailedStep> {
    Some(FailedStep { run: run.number, kind: run.kind.name(), step, inputs: stimulus.lines() })
}

impl<'a> TestDriver<'a> {
    /// A driver for plans of so many steps.
    ///
    /// # Errors
    /// A task that cannot be built.
    pub(crate) fn new(
        subject: &'a TaskUnderTest,
        steps: usize,
        watchdog: &'a Watchdog,
        progress: &'a mut Progress,
    ) -> anyhow::Result<TestDriver<'a>> {
        let ranges = Ranges::new(subject.build()?.outputs(), &subject.robot);
        let (hashes, took_ns) = (vec![NOT_REACHED; steps], vec![u32::MAX; steps]);
        let findings = Findings::default();
        Ok(TestDriver { subject, ranges, watchdog, progress, findings, hashes, took_ns })
    }

    /// Number of elements of outputs whose range is known.
    pub(crate) fn range_count(&self) -> usize {
        self.ranges.count()
    }

    /// Drives all runs as often as needed.
    ///
    /// # Errors
    /// A task that cannot be built, or refuses to start.
    pub(crate) fn drive(&mut self, runs: &[Run]) -> anyhow::Result<()> {
        self.progress.begin("driving", self.took_ns.len());
        for run in runs {
            self.observe(run)?;
        }
        self.progress.begin("repeating", self.took_ns.len());
        for run in runs {
            self.repeat(run, run.steps)?;
        }
        for _ in 0..BUDGET_REPEATS_MAX {
            let slow: Vec<(&Run, usize)> =
                runs.iter().filter_map(|run| Some((run, self.last_slow_step(run)?))).collect();
            if slow.is_empty() {
                break;
            }
            let steps = slow.iter().map(|(_, last)| last + 1).sum();
            self.progress.begin("repeating slow steps", steps);
            for (run, last) in slow {
                self.repeat(run, last + 1)?;
            }
        }
        self.judge_budget(runs)
    }

    /// A fresh task that was started; none when starting it panicked.
    fn start(&mut self) -> anyhow::Result<Option<TaskInstance>> {
        let mut harness = self.subject.build()?;
        match harness.start() {
            Ok(()) => Ok(Some(TaskInstance { harness, written: StepOutputs::default() })),
            Err(FaultCode::TaskPanicked) => {
                self.findings.add(Check::Panics, "`start` panicked".to_owned(), None);
                Ok(None)
            }
            Err(fault) => {
                let name = self.subject.name();
                anyhow::bail!("`{name}` refuses to start: {}", fault.text())
            }
        }
    }

    fn stop(&mut self, mut worker: TaskInstance) {
        if worker.harness.stop().is_err() {
            self.findings.add(Check::Panics, "`stop` panicked".to_owned(), None);
        }
    }

    /// Drives a task and its twin through a run.
    fn observe(&mut self, run: &Run) -> anyhow::Result<()> {
        let (Some(mut one), Some(mut twin)) = (self.start()?, self.start()?) else {
            return Ok(());
        };
        let mut stimulus = Stimulus::new(self.subject, &one.harness, run);
        let mut parted = false;
        for step in 0..run.steps {
            stimulus.advance();
            self.watchdog.begin(Some(run.number), step);
            let (report, hash) = one.step(&stimulus, false);
            let (other, other_hash) = twin.step(&stimulus, true);
            self.hashes[run.first + step] = hash;
            self.note_time(run.first + step, &report);
            self.note_time(run.first + step, &other);
            self.judge(run, step, &stimulus, &mut one, &report);
            twin.harness.take_refused(|_, _| {});
            self.findings.unusable_steps += u64::from(stimulus.has_unusable());
            if hash != other_hash && !core::mem::replace(&mut parted, true) {
                let at = failed_step(run, step, &stimulus);
                let difference = one.written.difference(&twin.written, one.harness.outputs());
                let inputs = stimulus.unusable().join(", ");
                let what =
                    format!("with another value of what is not usable ({inputs}): {difference}");
                self.findings.add(Check::StaleInputs, what, at);
            }
            self.progress.advance();
            if report.is_panic() {
                let _ = twin.harness.take_panic_place();
                break;
            }
        }
        self.stop(one);
        self.stop(twin);
        Ok(())
    }

    /// Drives a task through the first steps of a run, which have to be as they were.
    fn repeat(&mut self, run: &Run, steps: usize) -> anyhow::Result<()> {
        let Some(mut one) = self.start()? else { return Ok(()) };
        let mut stimulus = Stimulus::new(self.subject, &one.harness, run);
        for step in 0..steps {
            stimulus.advance();
            self.watchdog.begin(Some(run.number), step);
            let (report, hash) = one.step(&stimulus, false);
            self.note_time(run.first + step, &report);
            one.harness.take_refused(|_, _| {});
            self.progress.advance();
            let before = self.hashes[run.first + step];
            if hash != before {
                let at = failed_step(run, step, &stimulus);
                let what = "the same inputs led to other outputs or another state".to_owned();
                self.findings.add(Check::Repeats, what, at);
                break;
            }
            if report.is_panic() {
                let _ = one.harness.take_panic_place();
                break;
            }
        }
        self.stop(one);
        Ok(())
    }

    fn note_time(&mut self, step: usize, report: &StepReport) {
        if !report.is_panic() {
            let took = u32::try_from(report.took.0).unwrap_or(u32::MAX - 1);
            self.took_ns[step] = self.took_ns[step].min(took);
        }
    }

    /// Looks at what one step did.
    fn judge(
        &mut self,
        run: &Run,
        step: usize,
        stimulus: &Stimulus,
        worker: &mut TaskInstance,
        report: &StepReport,
    ) {
        let at = |findings: &Findings, check| {
            findings.is_first(check).then(|| failed_step(run, step, stimulus)).flatten()
        };
        let TaskInstance { harness, written } = worker;
        if report.is_panic() {
            let place = harness.take_panic_place().unwrap_or_else(|| "an unknown place".to_owned());
            let at = at(&self.findings, Check::Panics);
            self.findings.add(Check::Panics, format!("panicked at {place}"), at);
        } else if report.heap_calls > 0 {
            let at = at(&self.findings, Check::HeapCalls);
            let calls = report.heap_calls;
            self.findings.add(Check::HeapCalls, format!("{calls} heap calls in one step"), at);
        }
        if let Some(refused) = report.refused {
            let (check, judged) = match refused {
                FaultCode::NotFinite => (Check::NotFinite, run.kind != InputKind::NotFinite),
                _ => (Check::Ranges, run.kind == InputKind::Plausible),
            };
            let mut first = None;
            harness.take_refused(|output, body| {
                if judged && first.is_none() {
                    first = Some((output, body.to_vec()));
                }
            });
            if judged {
                let what = first.map_or_else(
                    || refused.text().to_owned(),
                    |(output, body)| refused_text(&harness.outputs()[output], &body),
                );
                let at = at(&self.findings, check);
                self.findings.add(check, what, at);
            }
        }
        if run.kind == InputKind::Plausible {
            let mut values = written.values();
            let found = values.find_map(|(output, body)| self.ranges.violation(output, body));
            if let Some(what) = found {
                let at = at(&self.findings, Check::Ranges);
                self.findings.add(Check::Ranges, what, at);
            }
        }
    }

    fn is_slow(&self, step: usize) -> bool {
        let budget = self.subject.budget().map_or(i64::MAX, |budget| budget.0);
        let took = self.took_ns[step];
        took != u32::MAX && i64::from(took) > budget
    }

    fn last_slow_step(&self, run: &Run) -> Option<usize> {
        (0..run.steps).rev().find(|step| self.is_slow(run.first + step))
    }

    /// Adds the steps that were over the budget whenever they were repeated.
    fn judge_budget(&mut self, runs: &[Run]) -> anyhow::Result<()> {
        for run in runs {
            for step in 0..run.steps {
                if !self.is_slow(run.first + step) {
                    continue;
                }
                let took = Nanos(i64::from(self.took_ns[run.first + step]));
                let budget = self.subject.budget().unwrap_or(Nanos::MAX);
                let at = match self.findings.is_first(Check::Budget) {
                    true => self.step_again(run, step)?,
                    false => None,
                };
                let what = format!("{took} of {budget}, at the least of all repeats");
                self.findings.add(Check::Budget, what, at);
            }
        }
        Ok(())
    }

    /// Where a step stands, with its inputs, which are drawn once more.
    fn step_again(&self, run: &Run, step: usize) -> anyhow::Result<Option<FailedStep>> {
        let harness = self.subject.build()?;
        let mut stimulus = Stimulus::new(self.subject, &harness, run);
        (0..=step).for_each(|_| stimulus.advance());
        Ok(failed_step(run, step, &stimulus))
    }

    /// The step time that 99.9 % of the steps do not exceed, and the longest one.
    pub(crate) fn step_times(&self) -> (Nanos, Nanos) {
        let mut took: Vec<u32> =
            self.took_ns.iter().copied().filter(|took| *took != u32::MAX).collect();
        took.sort_unstable();
        let at = |place: usize| took.get(place).map_or(Nanos::ZERO, |took| Nanos(i64::from(*took)));
        let last = took.len().saturating_sub(1);
        (at(last * 999 / 1000), at(last))
    }
}

/// The element for which a port refused a value, as text.
fn refused_text(output: &OutputPort, body: &[u8]) -> String {
    for (field, place) in output.fields.iter().zip(places(&output.fields)) {
        for element in 0..place.count {
            if let Number::Real(real) = place.get(body, element)
                && !real.is_finite()
            {
                let index = if field.array { format!("[{element}]") } else { String::new() };
                return format!("{}.{}{index} is {real}", output.name, field.name);
            }
        }
    }
    let values = crate::number::text(&output.fields, body, 8);
    format!("{} is out of the range that its output declares: {values}", output.name)
}
