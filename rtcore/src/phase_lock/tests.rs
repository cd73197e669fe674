//! The loop against clocks that drift, jitter, jump and fall silent.

use taktil_hal::fault::SplitMix;
use taktil_hal::phase_in_cycle;

use super::*;

const JOB_PERIOD: Nanos = Nanos::from_millis(1);
const JITTER_NS: i64 = 20_000;
const LOCK_WINDOW: Nanos = Nanos::from_micros(25);
const STEP_MAX: Nanos = Nanos(2_000);
/// Jobs until the loop has settled from anywhere.
const SETTLING_JOBS: i64 = 20_000;
/// Instants before the start of a run are none of an unsigned clock.
const BOARD_ORIGIN_NS: i64 = 1_000_000_000;

/// A board whose clock is fast by `ppm`, and a host whose jobs jitter.
struct Board {
    ppm: i64,
    offset_ns: i64,
    random: SplitMix,
}

impl Board {
    fn new(ppm: i64, offset_ns: i64) -> Board {
        Board { ppm, offset_ns, random: SplitMix::new(7) }
    }

    fn phase(&mut self, job: i64, correction: Nanos) -> Nanos {
        let jitter = self.random.below(2 * JITTER_NS as usize + 1) as i64 - JITTER_NS;
        let host = job * JOB_PERIOD.0 + correction.0 + jitter + BOARD_ORIGIN_NS;
        let board = host + host / 1_000_000 * self.ppm + self.offset_ns;
        phase_in_cycle(board.cast_unsigned(), JOB_PERIOD)
    }
}

fn lock() -> PhaseLock {
    PhaseLock::new(JOB_PERIOD, STEP_MAX, LOCK_WINDOW)
}

#[test]
fn an_hour_against_a_clock_that_drifts_has_no_slip_and_repeats_from_its_phases() {
    for ppm in [-100, 0, 100] {
        let (mut lock, mut again) = (lock(), lock());
        let (mut board, mut step) = (Board::new(ppm, 300_000), PhaseStep::default());
        let mut most = 0;
        for job in 0..3_600_000 {
            let phase = board.phase(job, step.correction);
            step = lock.step(Some(phase));
            assert_eq!(again.step(Some(phase)), step, "the phases decide");
            if job > SETTLING_JOBS {
                most = most.max(phase.0.abs());
                assert!(step.is_locked && !step.is_clamped, "{ppm} ppm, job {job}: {step:?}");
            }
        }
        assert!(most <= LOCK_WINDOW.0 && step.slips == 0, "{ppm} ppm: {most} ns, {step:?}");
    }
}

#[test]
fn it_locks_from_every_place_of_the_cycle() {
    for offset_ns in (-500_000..500_000).step_by(62_500) {
        let (mut lock, mut board) = (lock(), Board::new(100, offset_ns));
        let mut step = PhaseStep::default();
        for job in 0..5_000 {
            step = lock.step(Some(board.phase(job, step.correction)));
        }
        assert!(step.is_locked && step.slips == 0, "{offset_ns} ns: {step:?}");
    }
}

#[test]
fn steps_are_clamped_and_phases_that_are_missing_let_the_drift_go_on() {
    let mut slow = PhaseLock::new(JOB_PERIOD, Nanos(500), LOCK_WINDOW);
    let mut last = Nanos::ZERO;
    for _ in 0..50 {
        let step = slow.step(Some(Nanos(400_000)));
        assert!((step.correction - last).0.abs() <= 500 && step.is_clamped);
        last = step.correction;
    }
    let (mut lock, mut board, mut step) = (lock(), Board::new(100, 0), PhaseStep::default());
    for job in 0..40_000 {
        step = lock.step(Some(board.phase(job, step.correction)));
    }
    // A hundred silent jobs cost little more than the jitter.
    (0..100).for_each(|_| step = lock.step(None));
    let phase = board.phase(40_100, step.correction);
    assert!(phase.0.abs() < 30_000 && step.is_locked, "{phase}");
}

#[test]
fn late_jobs_neither_unlock_the_loop_nor_move_it_far() {
    let (mut lock, mut board, mut step) = (lock(), Board::new(-100, 0), PhaseStep::default());
    let mut most = 0;
    for job in 0..100_000 {
        let late = if job > SETTLING_JOBS && job % 50 == 0 { 450_000 } else { 0 };
        let phase = board.phase(job, step.correction);
        step = lock.step(Some(Nanos(phase.0 + late)));
        if job > SETTLING_JOBS {
            most = most.max(phase.0.abs());
            assert!(step.is_locked, "job {job}");
        }
    }
    assert!(most <= LOCK_WINDOW.0 && step.slips == 0, "{most} ns, {step:?}");
}

#[test]
fn a_clock_that_is_too_fast_to_follow_slips_and_the_loop_says_so() {
    let (mut lock, mut board, mut step) = (lock(), Board::new(0, 0), PhaseStep::default());
    for job in 0..1_000 {
        step = lock.step(Some(board.phase(job, step.correction)));
    }
    assert!(step.is_locked && step.slips == 0);
    // Twice what the largest step can follow. Towards the end of the cycle jobs drift by 4 - 2 us,
    // from its begin by 4 + 2 us: 250 + 83 jobs a slip.
    board.ppm = 4_000;
    for job in 1_000..6_000 {
        step = lock.step(Some(board.phase(job, step.correction)));
    }
    assert!(!step.is_locked && step.is_clamped && (14..=16).contains(&step.slips), "{step:?}");
}

#[test]
fn extreme_numbers_do_no_harm() {
    for cycle in [0, -7, 1, 3, i64::MAX] {
        for bound in [i64::MIN, 0, i64::MAX] {
            let mut lock = PhaseLock::new(Nanos(cycle), Nanos(bound), Nanos(bound));
            for phase in [i64::MIN, i64::MAX, 0, -1, i64::MAX, i64::MIN] {
                let step = lock.step(Some(Nanos(phase)));
                assert!(step.correction.0.abs() <= 6 * CYCLE_MAX.0, "{cycle} {bound} {step:?}");
            }
        }
    }
}
