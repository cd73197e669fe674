//! Times the arm's formulas on this machine: `cargo run --profile dist -p taktil-mechanics
//! --example arm_speed`. It prints nanoseconds per call, best of several rounds. This is not lane
//! code: it reads the clock.

use std::hint::black_box;
use std::time::Instant;
use taktil_mechanics::dls::damped_least_squares;
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::puma260::dynamics::{Dynamics, State, rk4_step};
use taktil_mechanics::tactile::{Image, features, moments};
use taktil_mechanics::{Joints, Pose};

const SAMPLE_COUNT: usize = 1024;
const ROUND_COUNT: usize = 40;

#[expect(clippy::disallowed_methods, reason = "a stopwatch for people, not lane code")]
fn measure<T>(name: &str, inputs: &[T], mut call: impl FnMut(&T)) {
    let mut best = f64::INFINITY;
    for _ in 0..ROUND_COUNT {
        let start = Instant::now();
        for input in inputs {
            call(black_box(input));
        }
        #[expect(clippy::cast_precision_loss, reason = "a small count")]
        let each = start.elapsed().as_secs_f64() * 1e9 / inputs.len() as f64;
        best = best.min(each);
    }
    println!("{name:<34} {best:8.1} ns");
}

fn main() {
    let (arm, dynamics) = (Puma260::reference(), Dynamics::reference());
    let mut state: u64 = 1;
    let mut unit = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        f64::from((state >> 33) as u32) / f64::from(1_u32 << 31)
    };
    let mut six =
        |low: &Joints, high: &Joints| Joints::from_fn(|i, _| low[i] + (high[i] - low[i]) * unit());
    let ones = Joints::repeat(1.0);
    let q: Vec<Joints> = (0..SAMPLE_COUNT).map(|_| six(&arm.q_min_rad, &arm.q_max_rad)).collect();
    let motions: Vec<(Joints, Joints, Joints)> =
        q.iter().map(|q| (*q, six(&-ones, &ones), six(&-ones, &ones))).collect();
    let poses: Vec<(Pose, Joints)> = q.iter().map(|q| (arm.wrist_pose(q), *q)).collect();
    let image: Vec<f32> = (0..256_u16).map(|n| f32::from(n * 37 % 4096)).collect();

    measure("wrist pose", &q, |q| {
        black_box(arm.wrist_pose(q));
    });
    measure("tool pose", &q, |q| {
        black_box(arm.tool_pose(q));
    });
    measure("Jacobian, base", &q, |q| {
        black_box(arm.jacobian_base(q));
    });
    measure("Jacobian, tool", &q, |q| {
        black_box(arm.jacobian_tool(q));
    });
    measure("inverse, eight branches", &poses, |(pose, q)| {
        black_box(arm.inverse_kinematics(pose, Some(q)));
    });
    measure("inverse and nearest", &poses, |(pose, q)| {
        black_box(arm.nearest_branch(&arm.inverse_kinematics(pose, Some(q)), q));
    });
    measure("damped least squares", &motions, |(q, qd, _)| {
        black_box(damped_least_squares(&arm.jacobian_base(q), qd, 0.01));
    });
    measure("inverse dynamics", &motions, |(q, qd, qdd)| {
        black_box(dynamics.inverse_dynamics(q, qd, qdd));
    });
    measure("gravity", &q, |q| {
        black_box(dynamics.gravity_torque(q));
    });
    measure("mass matrix", &q, |q| {
        black_box(dynamics.mass_matrix(q));
    });
    measure("forward dynamics", &motions, |(q, qd, tau)| {
        black_box(dynamics.forward_dynamics(q, qd, tau));
    });
    measure("Runge-Kutta step", &motions, |(q, qd, tau)| {
        let state = State { q: *q, qd: *qd };
        black_box(rk4_step(&dynamics, &state, 0.0, 0.0025, &mut |_, _, _| *tau));
    });
    measure("features, 16 x 16", &[image], |image| {
        let image = Image::new(16, 16, image, None).expect("256 values");
        black_box(features(&moments(&image, 10.0)));
    });
}
