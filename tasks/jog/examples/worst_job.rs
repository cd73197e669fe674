//! Measures the cost of the longest job of jogging: `cargo run --profile dist -p taktil-tasks-jog
//! --example worst_job`. Random keys move arms from random starts; the jobs that asked the arm most
//! often for joints are kept and repeated. With a number as argument each of the PUMA 260's jobs is
//! repeated that many times and nothing is printed, so that instructions can be counted as the
//! difference of two runs under `valgrind --tool=callgrind`. With 200 and 2200 repetitions that
//! gives 237 000 instructions for a job of 20 to 24 trials. This is not lane code: it reads the
//! clock.

use std::hint::black_box;
use std::time::Instant;

use taktil_mechanics::arm::Arm;
use taktil_mechanics::chain::JointSpec;
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::spatial::JointVector;
use taktil_signal::JogFrame;
use taktil_tasks_jog::Config;
use taktil_tasks_jog::law::{JogDemand, Law};
use taktil_tests_script::dice::Dice;

#[path = "../../../mechanics/tests/dh_rows/mod.rs"]
mod dh_rows;

const DT_S: f64 = 0.0025;
/// Number of random starts; the next constant is the number of jobs from each.
const STARTS_TRIED: u64 = 60;
const JOBS_RUN: u32 = 2_000;
/// How many of the longest jobs are kept.
const JOBS_KEPT: usize = 16;
const ROUNDS_TIMED: usize = 201;

/// A job that can be repeated.
struct Job<const N: usize, A: Arm<N>> {
    law: Law<N, A>,
    demand: JogDemand,
    trials: u32,
}

/// Random keys that move the tool and change now and then.
fn keys(dice: &mut Dice) -> JogDemand {
    let axes = core::array::from_fn(|_| [1.0, -1.0, 0.0, 0.0, 0.4][dice.roll(5) as usize]);
    JogDemand { axes, frame: if dice.roll(2) == 0 { JogFrame::Base } else { JogFrame::Tool } }
}

/// The longest jobs, and a histogram of all jobs over the number of trials.
fn longest<const N: usize, A: Arm<N>>(arm: &A) -> (Vec<Job<N, A>>, Vec<u32>) {
    let rates = Config::default().rates(arm, true);
    let (mut dice, mut kept, mut counts) = (Dice::new(7), Vec::new(), vec![0; 64]);
    for _ in 0..STARTS_TRIED {
        let at = JointVector::from_fn(|i, _| dice.between(arm.q_min()[i], arm.q_max()[i]));
        let mut law = Law::new(arm, &rates, &at, true);
        let (mut demand, mut left) = (JogDemand::ZERO, 0);
        for _ in 0..JOBS_RUN {
            if left == 0 {
                (demand, left) = (keys(&mut dice), 20 + dice.roll(300));
            }
            left -= 1;
            let before = law;
            let trials = law.step(&demand, DT_S).trials;
            counts[trials as usize] += 1;
            kept.push(Job { law: before, demand, trials });
        }
        kept.sort_by_key(|job| core::cmp::Reverse(job.trials));
        kept.truncate(JOBS_KEPT);
    }
    (kept, counts)
}

/// Does every job once.
fn all<const N: usize, A: Arm<N>>(jobs: &[Job<N, A>]) {
    for job in jobs {
        let mut law = job.law;
        black_box(law.step(black_box(&job.demand), DT_S));
    }
}

#[expect(clippy::disallowed_methods, reason = "a stopwatch for people, not lane code")]
fn show<const N: usize, A: Arm<N>>(name: &str, arm: &A) {
    let (jobs, counts) = longest(arm);
    let mut times: Vec<f64> = (0..ROUNDS_TIMED)
        .map(|_| {
            let start = Instant::now();
            all(&jobs);
            start.elapsed().as_secs_f64() * 1e6 / jobs.len() as f64
        })
        .collect();
    times.sort_by(f64::total_cmp);
    let (least, most) = (jobs.last().map_or(0, |job| job.trials), jobs[0].trials);
    let over = |trials: usize| f64::from(counts[trials..].iter().sum::<u32>());
    let all: f64 = over(0);
    println!(
        "{name:<14} {:8.1} {:8.1}   {least} to {most} trials; above 2: {:.2} %, above 8: {:.3} %",
        times[0],
        times[ROUNDS_TIMED / 2],
        100.0 * over(3) / all,
        100.0 * over(9) / all,
    );
}

fn main() {
    let puma = Puma260::reference();
    if let Some(times) = std::env::args().nth(1).and_then(|text| text.parse::<u32>().ok()) {
        let (jobs, _) = longest(&puma);
        (0..times).for_each(|_| all(&jobs));
        return;
    }
    println!("{:<14} {:>8} {:>8}", "the longest, us", "best", "median");
    show("PUMA 260", &puma);
    let spec = JointSpec {
        q_min: -3.0,
        q_max: 3.0,
        speed_max: 3.0,
        acceleration_max: 15.0,
        ..JointSpec::default()
    };
    show("six joints", &dh_rows::chain(&dh_rows::UR5E_ROWS, &spec));
    show("seven joints", &dh_rows::chain(&dh_rows::SEVEN_JOINT_ROWS, &spec));
}
