//! Measures the cost of one tick of a trajectory (interpolation, inverse kinematics and limits
//! together) for the PUMA 260 and for chains of six and seven joints: `cargo run --profile dist -p
//! taktil-mechanics --example tick_speed`. With a number of ticks as argument it runs that many on
//! the PUMA 260's path and prints nothing, so that instructions can be counted as the difference of
//! two runs. This is not lane code: it reads the clock.

use std::hint::black_box;
use std::time::Instant;

use glam::DVec3;
use taktil_mechanics::Pose;
use taktil_mechanics::arm::Arm;
use taktil_mechanics::chain::JointSpec;
use taktil_mechanics::paul::JointPath;
use taktil_mechanics::paul::cartesian::{Blend, CartesianPath};
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::spatial::JointVector;
use taktil_mechanics::tracking::{PathRef, PathTracker};

#[path = "../tests/dh_rows/mod.rs"]
mod dh_rows;

const DT_S: f64 = 0.0025;
const ROUND_COUNT: usize = 201;

/// A square of the tool about where joints `q` put it, and back.
fn square<const N: usize, A: Arm<N>>(arm: &A, q: &JointVector<N>) -> CartesianPath {
    let here = arm.tool_pose(q);
    let side = 0.04;
    let corner =
        |x: f64, y: f64| Pose::new(here.rotation, here.apply(DVec3::new(side * x, side * y, 0.0)));
    let poses = [here, corner(1.0, 0.0), corner(1.0, 1.0), corner(0.0, 1.0), here];
    CartesianPath::new(&poses, &[1.0; 4], 0.1, Blend::Smooth).expect("a path")
}

/// Follows the square once; the number of ticks.
fn follow<const N: usize, A: Arm<N>>(arm: &A, path: &CartesianPath, q: &JointVector<N>) -> u32 {
    let mut lead = PathTracker::new(arm, q);
    let mut tick = 0_u32;
    let mut t_s = 0.0;
    while t_s < path.duration_s() {
        tick += 1;
        t_s = DT_S * f64::from(tick);
        let led = lead.step(arm, PathRef::Cartesian(path), t_s, DT_S).expect("it follows");
        black_box((led.setpoint, arm.within_limits(&led.setpoint.q)));
    }
    tick
}

/// Best, median and largest of many rounds, in ns a tick.
#[expect(clippy::disallowed_methods, reason = "a stopwatch for people, not lane code")]
fn measure(name: &str, mut round: impl FnMut() -> u32) {
    let mut times: Vec<f64> = (0..ROUND_COUNT)
        .map(|_| {
            let start = Instant::now();
            let ticks = round();
            start.elapsed().as_secs_f64() * 1e9 / f64::from(ticks)
        })
        .collect();
    times.sort_by(f64::total_cmp);
    let (best, median, most) = (times[0], times[ROUND_COUNT / 2], times[ROUND_COUNT - 1]);
    println!("{name:<36} {best:8.0} {median:8.0} {most:8.0}");
}

fn main() {
    let puma = Puma260::reference();
    let over =
        JointVector::<6>::from([0.0, 40.2, -153.4, -180.0, 66.8, 180.0].map(f64::to_radians));
    let path = square(&puma, &over);
    if let Some(ticks) = std::env::args().nth(1).and_then(|text| text.parse::<u32>().ok()) {
        let mut done = 0;
        while done < ticks {
            done += follow(&puma, &path, &over);
        }
        return;
    }
    println!("{:<36} {:>8} {:>8} {:>8}", "a tick, ns", "best", "median", "most");
    measure("PUMA 260, line of the tool", || follow(&puma, &path, &over));
    let there = over + JointVector::<6>::repeat(0.3);
    let joints = JointPath::new(&[over, there, over], &[1.0, 1.0], 0.1).expect("a path");
    measure("PUMA 260, joint move", || {
        (1..=880_u32)
            .map(|tick| {
                let at = joints.at(DT_S * f64::from(tick));
                black_box((at, puma.within_limits(&at.q)));
            })
            .fold(0, |ticks, ()| ticks + 1)
    });
    // Limits that do not matter.
    let spec = JointSpec { speed_max: 10.0, ..JointSpec::default() };
    let six = dh_rows::chain(&dh_rows::UR5E_ROWS, &spec);
    let six_joint_start = JointVector::<6>::new(0.2, -1.3, 1.6, -1.9, -1.5, 0.4);
    let path = square(&six, &six_joint_start);
    measure("six joints by damped steps, line", || follow(&six, &path, &six_joint_start));
    let seven = dh_rows::chain(&dh_rows::SEVEN_JOINT_ROWS, &spec);
    let seven_joint_start = JointVector::<7>::from([0.1, -0.4, 0.2, -2.0, 0.1, 1.7, 0.5]);
    let path = square(&seven, &seven_joint_start);
    measure("seven joints by damped steps, line", || follow(&seven, &path, &seven_joint_start));
}
