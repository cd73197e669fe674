//! Many cases on several threads, in batches, so that progress can be told and equal seeds give
//! equal lines however many threads there are.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::thread;

use taktil_hal::Nanos;
use taktil_hal::fault::FaultPlan;

use crate::case::{Campaign, Case, Scenes};
use crate::coverage::Coverage;
use crate::run::{Outcome, run};

/// What is to be run.
#[derive(Clone, Debug)]
pub struct StormPlan {
    /// Where cases come from.
    pub scenes: Scenes,
    /// The campaign.
    pub campaign: Campaign,
    /// Faults instead of drawn ones.
    pub plan: Option<FaultPlan>,
    /// The time in which faults may begin; drawn when absent.
    pub length: Option<Nanos>,
    /// Threads.
    pub jobs: usize,
}

/// A seed whose run could not be made, or broke a rule.
#[derive(Clone, Debug)]
pub struct Failure {
    /// The case.
    pub case: Case,
    /// The rules that it broke, each with its instant and how.
    pub outcome: Result<Outcome, String>,
}

/// What a batch of seeds came to.
#[derive(Debug, Default)]
pub struct Batch {
    /// Seed and digest of each run, in order of seeds.
    pub digests: Vec<(u64, String)>,
    /// Those that failed.
    pub failures: Vec<Failure>,
    /// What they went through.
    pub coverage: Coverage,
    /// Simulated time.
    pub simulated: Nanos,
}

impl StormPlan {
    /// The case of a seed.
    #[must_use]
    pub fn case(&self, seed: u64) -> Case {
        Case::draw(&self.scenes, seed, self.campaign, self.plan.as_ref(), self.length)
    }

    /// Runs the cases of these seeds.
    #[must_use]
    pub fn run_batch(&self, seeds: &[u64]) -> Batch {
        let jobs = self.jobs.clamp(1, seeds.len().max(1));
        let work = |first: usize| {
            let mut batch = Batch::default();
            for seed in seeds.iter().skip(first).step_by(jobs) {
                self.run_seed(*seed, &mut batch);
            }
            batch
        };
        let mut all = Batch::default();
        thread::scope(|scope| {
            let threads: Vec<_> = (0..jobs).map(|first| scope.spawn(move || work(first))).collect();
            for thread in threads {
                if let Ok(batch) = thread.join() {
                    all.append(batch);
                }
            }
        });
        all.digests.sort();
        all.failures.sort_by_key(|failure| failure.case.seed);
        all
    }

    fn run_seed(&self, seed: u64, batch: &mut Batch) {
        let case = self.case(seed);
        let ran = catch_unwind(AssertUnwindSafe(|| run(&case)));
        let outcome = match ran {
            Ok(Ok(outcome)) => outcome,
            Ok(Err(located)) => {
                batch.failures.push(Failure { case, outcome: Err(located.to_string()) });
                return;
            }
            Err(_) => {
                let outcome = Err("the run panicked".to_owned());
                batch.failures.push(Failure { case, outcome });
                return;
            }
        };
        batch.simulated += outcome.length;
        batch.coverage.add(&case, &outcome);
        batch.digests.push((seed, outcome.digest.clone()));
        if !outcome.violations.is_empty() {
            batch.failures.push(Failure { case, outcome: Ok(outcome) });
        }
    }
}

impl Batch {
    /// Adds another batch behind this one.
    pub fn append(&mut self, other: Batch) {
        self.digests.extend(other.digests);
        self.failures.extend(other.failures);
        self.coverage.merge(other.coverage);
        self.simulated += other.simulated;
    }

    /// One number over the digests of all runs, in order of seeds.
    #[must_use]
    pub fn digest(&self) -> String {
        let mut hash = taktil_rtcore::StateHash::new();
        for (seed, digest) in &self.digests {
            hash.add(seed);
            for byte in digest.bytes() {
                hash.add(&u64::from(byte));
            }
        }
        format!("{:016x}", hash.value())
    }
}
