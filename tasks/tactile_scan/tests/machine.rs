//! Tests the task in a machine in virtual time with a scripted array.

use taktil_hal::{Arrival, Error, ErrorKind, TactileArray, TactileFrame};
use taktil_rtcore::status::LaneHealth;
use taktil_rtcore::{FaultCode, FaultSet, LaneSpec, Nanos};
use taktil_signal::TactileImage;
use taktil_tasks_tactile_scan::{Config, TactileScan};
use taktil_tests_script::Bench;

const LANE_PERIOD: Nanos = Nanos::from_millis(5);

/// What the array answers in one job: a frame with this level on every tactel, nothing, an error,
/// or a frame of another size.
#[derive(Clone, Copy)]
enum Answer {
    Level(u16),
    Held,
    Fails(ErrorKind),
}

struct Array {
    answer: fn(i64) -> Answer,
    sequence: u32,
}

impl TactileArray for Array {
    fn rows(&self) -> usize {
        16
    }

    fn cols(&self) -> usize {
        16
    }

    fn full_scale(&self) -> u16 {
        4095
    }

    fn sample(&mut self, release: Nanos, frame: &mut TactileFrame) -> Result<Arrival, Error> {
        let level = match (self.answer)(release.0 / LANE_PERIOD.0) {
            Answer::Held => return Ok(Arrival::Held),
            Answer::Fails(kind) => {
                return Err(Error { kind, device: "script", channel: Error::ALL_CHANNELS });
            }
            Answer::Level(level) => level,
        };
        self.sequence += 1;
        (frame.sequence, frame.acquired) = (self.sequence, release);
        frame.values.fill(level);
        frame.valid.fill(true);
        frame.row_acquired.fill(release);
        Ok(Arrival::New)
    }
}

/// The images with their ticks, and the faults of each job.
struct Keep {
    images: Vec<(u64, TactileImage)>,
    faults: Vec<FaultSet>,
}

fn run(config: Config, answer: fn(i64) -> Answer, jobs: i64) -> Keep {
    let mut bench = Bench::new();
    let lane = bench.lane(LaneSpec::new("touch", LANE_PERIOD, 75));
    let array = Box::new(Array { answer, sequence: 0 });
    bench.task(lane, "tactile_scan", |ports| TactileScan::new(config, array, ports));
    let run = bench.run(LANE_PERIOD * jobs);
    let health: Vec<LaneHealth> = run.of("touch.health");
    let faults = health.iter().map(|health| FaultSet(health.faults)).collect();
    Keep { images: run.values_with_ticks("tactile_scan.image"), faults }
}

fn only(fault: FaultCode) -> FaultSet {
    let mut set = FaultSet::NONE;
    set.insert(fault);
    set
}

#[test]
fn the_baseline_takes_its_frames_and_then_images_flow() {
    let keep = run(Config::default(), |job| Answer::Level(if job < 40 { 300 } else { 500 }), 42);
    assert_eq!(keep.images.len(), 42);
    for (tick, image) in &keep.images {
        assert_eq!(image.baseline_ready, u32::from(*tick >= 39), "tick {tick}");
        let counts = if *tick < 40 { 0.0 } else { 200.0 };
        assert_eq!(*image.counts, [counts; 256], "tick {tick}");
        assert_eq!(*image.valid, [u8::from(*tick >= 39); 256]);
        assert_eq!(image.acquired_ns, LANE_PERIOD.0 * i64::try_from(*tick).unwrap());
        assert_eq!(u64::from(image.sequence), tick + 1);
    }
    assert!(keep.faults.iter().all(|faults| faults.is_empty()));
}

#[test]
fn held_frames_are_not_written_again_and_become_stale() {
    let config = Config { baseline_frames: 1, ..Config::default() };
    let keep =
        run(config, |job| if job < 3 || job == 10 { Answer::Level(300) } else { Answer::Held }, 12);
    let ticks: Vec<u64> = keep.images.iter().map(|(tick, _)| *tick).collect();
    assert_eq!(ticks, [0, 1, 2, 10]);
    for (job, faults) in keep.faults.iter().enumerate() {
        // The last frame is of job 2; 20 ms later is job 6, which is still within the limit.
        let stale = (7..10).contains(&job);
        assert_eq!(*faults, if stale { only(FaultCode::TactileStale) } else { FaultSet::NONE });
    }
}

#[test]
fn an_array_that_never_delivers_a_frame_is_stale_too() {
    let keep = run(Config::default(), |_| Answer::Held, 8);
    assert!(keep.images.is_empty());
    assert!(keep.faults[4].is_empty());
    assert_eq!(keep.faults[5], only(FaultCode::TactileStale));
}

#[test]
fn errors_become_faults_by_their_kind() {
    let keep = run(
        Config { baseline_frames: 1, ..Config::default() },
        |job| match job {
            2 => Answer::Fails(ErrorKind::Transient),
            4 => Answer::Fails(ErrorKind::OutOfRange),
            6 => Answer::Fails(ErrorKind::Stale),
            8 => Answer::Fails(ErrorKind::Lost),
            11.. => Answer::Fails(ErrorKind::Transient),
            _ => Answer::Level(300),
        },
        17,
    );
    let expected = [
        (2, FaultCode::TactileGarbled),
        (4, FaultCode::TactileGarbled),
        (6, FaultCode::TactileStale),
        (8, FaultCode::TactileLost),
        (14, FaultCode::TactileGarbled),
        (15, FaultCode::TactileStale),
    ];
    for (job, fault) in expected {
        assert_eq!(keep.faults[job], only(fault), "job {job}");
    }
    for job in [0, 1, 3, 5, 7, 9, 10] {
        assert!(keep.faults[job].is_empty(), "job {job}");
    }
    let ticks: Vec<u64> = keep.images.iter().map(|(tick, _)| *tick).collect();
    assert_eq!(ticks, [0, 1, 3, 5, 7, 9, 10]);
}

#[test]
fn a_finger_that_is_blind_after_the_baseline_is_lost() {
    let config = Config { baseline_frames: 2, ..Config::default() };
    let keep = run(config, |_| Answer::Level(0), 4);
    assert!(keep.faults[0].is_empty());
    assert_eq!(keep.faults[1], only(FaultCode::TactileLost));
    assert_eq!(keep.faults[3], only(FaultCode::TactileLost));
    let dark = Config { baseline_frames: 2, rest_min_counts: 0.0, ..Config::default() };
    assert!(run(dark, |_| Answer::Level(0), 4).faults[3].is_empty());
}
