//! Measures the speed of the simulated bench relative to real time on one core, with default
//! settings: the best of five runs of 20 simulated seconds for each scene, by the processor time
//! that Linux charged to this process, so that other work on the machine does not count: `cargo run
//! --profile dist -p taktil-sim --example bench_speed`.

use glam::{DMat3, DVec3};
use taktil_hal::{Devices, LinesOut, Nanos, TactileFrame};
use taktil_sim::{Carriage, FloatingGuide, Timing, World, WorldConfig, build, build_with_carriage};

const DURATION_S: i64 = 20;
const RUN_COUNT: u32 = 5;

fn main() {
    let mut resting = WorldConfig::default();
    resting.pin.present = false;
    let mut pressing = WorldConfig::default();
    // The finger starts on the pin and leans on it with the arm's weight.
    pressing.table.height_mm = Some(-180.1);
    let arm = |config: &WorldConfig| build(config, &Timing::default(), 1).expect("a sound scene");
    report("arm, no pin", || arm(&resting));
    report("arm over the pin", || arm(&WorldConfig::default()));
    report("arm pressing on the pin", || arm(&pressing));
    report("finger on rails rolling the pin", rolling);
}

fn report(name: &str, build: impl Fn() -> (World, Devices)) {
    let speed = (0..RUN_COUNT).map(|_| run(build())).fold(0.0, f64::max);
    println!("{name:32} {speed:6.0} x real time");
}

/// One run with the traffic of a controller: simulated seconds per second.
fn run((mut world, mut devices): (World, Devices)) -> f64 {
    let timing = Timing::default();
    let mut frame = TactileFrame::new(16, 16);
    let (mut t, mut feed) = (Nanos::ZERO, false);
    let start = processor_time();
    while t < Nanos::from_secs(DURATION_S) {
        feed = !feed;
        let lines = LinesOut { enable: true, brake_release: true, watchdog_feed: feed };
        devices
            .digital_out
            .as_mut()
            .expect("it is there")
            .commit(t, &lines)
            .expect("the link has room");
        devices.encoders.as_mut().expect("it is there").sample(t).expect("a reading is there");
        devices
            .tactile
            .get_mut("tactile")
            .expect("an array")
            .sample(t, &mut frame)
            .expect("no fault");
        world.advance(t + timing.actuation_delay);
        t += timing.control_period;
    }
    Nanos::from_secs(DURATION_S).0 as f64 / (processor_time() - start)
}

/// Nanoseconds that this process has spent on a processor.
fn processor_time() -> f64 {
    let text = std::fs::read_to_string("/proc/self/schedstat").expect("Linux tells it there");
    text.split(' ').next().and_then(|ns| ns.parse().ok()).expect("the first field is a number")
}

fn rolling() -> (World, Devices) {
    let place = |x: f64| DVec3::new(x, -0.127, -0.1489);
    let knots = (0..=DURATION_S)
        .map(|i| (i as f64, place(if i % 2 == 0 { 0.325 } else { 0.335 })))
        .collect();
    let axes = DMat3::from_cols(-DVec3::X, DVec3::Y, -DVec3::Z);
    let float = Some(FloatingGuide { mass_kg: 1.0, load_n: 15.0, damping_n_s_m: 100.0 });
    let carriage = Carriage { axes, knots, float };
    build_with_carriage(&WorldConfig::default(), &Timing::default(), 1, carriage)
        .expect("a sound scene")
}
