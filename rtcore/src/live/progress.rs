//! Which lane has finished which job. At the pace of a simulated world a lane does not begin a job
//! before every value that is due at its release has been sent: a stall on one processor then costs
//! time and no value, and a live run carries the same bits as one in virtual time. On boards, where
//! the world does not wait, only the monitors use it.

use taktil_hal::Nanos;

use super::flags::JobsDone;
use super::monitor::ProgressMonitor;
use crate::schedule::LaneSpec;

/// The progress of one lane.
struct LaneProgress {
    spec: LaneSpec,
    /// Jobs that the lane will run in all.
    jobs: u64,
    /// Jobs finished so far.
    done: JobsDone,
}

/// The progress of all lanes.
pub(super) struct JobProgress {
    rows: Vec<LaneProgress>,
}

impl JobProgress {
    /// Nothing is finished yet; jobs released before `until` will be run.
    pub(super) fn new<'a>(specs: impl Iterator<Item = &'a LaneSpec>, until: Nanos) -> JobProgress {
        let row = |spec: &LaneSpec| LaneProgress {
            spec: spec.clone(),
            jobs: spec.jobs_before(until),
            done: JobsDone::new(),
        };
        JobProgress { rows: specs.map(row).collect() }
    }

    /// Lane `lane` has sent everything of its first `jobs` jobs.
    pub(super) fn set_finished(&self, lane: usize, jobs: u64) {
        self.rows[lane].done.publish(jobs);
    }

    /// Whether every other lane has finished the jobs whose values are due at `release`.
    pub(super) fn has_due_values(&self, lane: usize, release: Nanos) -> bool {
        self.rows.iter().enumerate().all(|(other, row)| {
            let due = jobs_due(&row.spec, release).min(row.jobs);
            other == lane || row.done.load() >= due
        })
    }

    /// How many jobs a lane has done; `None` when it has run all its jobs.
    pub(super) fn jobs_done(&self, lane: usize) -> Option<u64> {
        let row = self.rows.get(lane)?;
        Some(row.done.load_relaxed()).filter(|done| *done < row.jobs)
    }

    /// The monitor with which lane `lane` watches all others, once in each of its jobs.
    pub(super) fn peer_monitor(&self, lane: usize) -> ProgressMonitor {
        let limit =
            |(other, row): (usize, &LaneProgress)| (other != lane).then_some(row.spec.silent_after);
        ProgressMonitor::new(self.rows[lane].spec.period, self.rows.iter().enumerate().map(limit))
    }

    /// Whether every lane has run all its jobs.
    pub(super) fn is_complete(&self) -> bool {
        self.rows.iter().all(|row| row.done.load() >= row.jobs)
    }
}

/// How many jobs of a lane have their deadline, by which their values are out, at or before `now`.
fn jobs_due(spec: &LaneSpec, now: Nanos) -> u64 {
    let latest = now - spec.deadline;
    if latest < spec.phase { 0 } else { spec.newest_released(latest) + 1 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spec(name: &str, phase_us: i64, deadline_us: i64) -> LaneSpec {
        let mut spec = LaneSpec::new(name, Nanos::from_micros(2500), 50);
        spec.phase = Nanos::from_micros(phase_us);
        spec.delivery = Nanos::from_micros(deadline_us);
        spec.deadline = spec.delivery;
        spec
    }

    #[test]
    fn a_job_waits_for_exactly_the_jobs_whose_values_are_due() {
        let (servo, world) = (spec("servo", 0, 1250), spec("world", 1250, 1250));
        let progress = JobProgress::new([&servo, &world].into_iter(), Nanos::from_micros(5000));
        assert!(progress.has_due_values(0, Nanos::ZERO), "nothing is due at the start");
        assert!(!progress.has_due_values(1, world.release(0)), "the first D/A word is");
        progress.set_finished(0, 1);
        assert!(progress.has_due_values(1, world.release(0)));
        assert!(!progress.has_due_values(0, servo.release(1)));
        progress.set_finished(1, 1);
        assert!(progress.has_due_values(0, servo.release(1)));
        progress.set_finished(0, 2);
        assert!(progress.has_due_values(1, world.release(1)));
        assert!(progress.has_due_values(1, world.release(9)), "no more jobs come than the run has");
    }

    #[test]
    fn no_wait_is_circular() {
        // In order of release there is always a lane that may go on.
        let specs = [spec("a", 0, 2500), spec("b", 1250, 700), spec("c", 0, 100)];
        let until = Nanos::from_millis(50);
        let progress = JobProgress::new(specs.iter(), until);
        let mut next = [0u64; 3];
        while (0..3).any(|lane| next[lane] < specs[lane].jobs_before(until)) {
            let able: Vec<usize> = (0..3)
                .filter(|&lane| next[lane] < specs[lane].jobs_before(until))
                .filter(|&lane| progress.has_due_values(lane, specs[lane].release(next[lane])))
                .collect();
            let lane = *able.last().expect("somebody can go on");
            assert!(!progress.is_complete());
            next[lane] += 1;
            progress.set_finished(lane, next[lane]);
        }
        assert!(progress.is_complete());
    }
}
