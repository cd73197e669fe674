//! A lane over a segment whose clocks drift: locked to the reference clock its frames keep their
//! place, and every SYNC0 finds new outputs; without the lock they do not.

mod rig;

use rig::{CYCLE_PERIOD, Rig, six_drives};
use taktil_drivers_ethercat::{Config, ExchangeTimes, Halves, SyncConfig};
use taktil_drivers_ethercat_emulator::{Description, State};
use taktil_hal::conformance::{CycleDriver, check_board_clock};
use taktil_hal::fault::SplitMix;
use taktil_hal::{
    AnalogOut, BoardClock, CHANNELS, DacCode, DigitalOut, Encoders, ErrorKind, LinesOut, Nanos,
};
use taktil_rtcore::{PhaseLock, PhaseStep};

const LOCK_WINDOW: Nanos = Nanos::from_micros(25);
/// Jobs begin at most this late: 20 us on either side of their mean.
const LATENESS_MAX_NS: usize = 40_000;

/// Six drives that act by SYNC0.
fn synchronised() -> (Vec<Description>, Config) {
    let (devices, mut config) = six_drives();
    config.sync = Some(SyncConfig::default());
    (devices, config)
}

/// What a run of jobs showed.
#[derive(Debug, Default)]
struct Shown {
    /// The worst phase of the last half of the run.
    worst_ns: i64,
    step: PhaseStep,
    refused: usize,
}

/// A lane whose releases are where a host's clock has them.
struct HostLane {
    halves: Halves,
    origin: Nanos,
    job: i64,
    random: SplitMix,
    lock: PhaseLock,
    step: PhaseStep,
}

impl HostLane {
    fn open(rig: &Rig, config: &Config) -> HostLane {
        let halves = rig.open(config).unwrap();
        HostLane {
            halves,
            origin: rig.world().now,
            job: 0,
            random: SplitMix::new(5),
            lock: PhaseLock::new(CYCLE_PERIOD, Nanos(2_000), LOCK_WINDOW),
            step: PhaseStep::default(),
        }
    }

    /// One job; the phase that the segment's clock gives, which is followed if `follows`.
    fn run_job(&mut self, rig: &Rig, enable: bool, follows: bool) -> (Option<Nanos>, bool) {
        self.job += 1;
        let release = CYCLE_PERIOD * self.job;
        let late = Nanos(self.random.below(LATENESS_MAX_NS + 1) as i64);
        let moved = if follows { self.step.correction } else { Nanos::ZERO };
        let begin = self.origin + release + moved + late;
        let now = rig.world().now;
        rig.pass(Nanos((begin - now).0.max(0)));
        let _ = self.halves.encoders.as_mut().unwrap().sample(release);
        let clock = self.halves.board_clock.as_mut().unwrap();
        let phase = clock.sample(release).ok().map(|reading| reading.value);
        self.step = self.lock.step(phase);
        let codes = [DacCode(50); CHANNELS];
        let analog = self.halves.analog_out.as_mut().unwrap().commit(release, &codes);
        let lines = LinesOut { enable, brake_release: enable, watchdog_feed: self.job % 2 == 0 };
        let lines = self.halves.digital_out.as_mut().unwrap().commit(release, &lines);
        (phase, analog.is_ok() && lines.is_ok())
    }

    fn run(&mut self, rig: &Rig, jobs: i64, enable: bool, follows: bool) -> Shown {
        let mut shown = Shown::default();
        for job in 0..jobs {
            let (phase, accepted) = self.run_job(rig, enable, follows);
            shown.refused += usize::from(!accepted);
            if 2 * job > jobs {
                shown.worst_ns = shown.worst_ns.max(phase.map_or(i64::MAX, |one| one.0.abs()));
            }
        }
        Shown { step: self.step, ..shown }
    }
}

/// The clocks of a segment, the reference first, are fast by these millionths.
fn drift(rig: &Rig, reference: i64, others: i64) {
    let mut world = rig.world();
    for position in 0..7 {
        world.segment.set_clock_drift(position, if position == 0 { reference } else { others });
    }
}

fn misses(rig: &Rig) -> (u64, u64) {
    let figures = rig.world().segment.sync_figures();
    let pulses = figures.iter().map(|one| one.pulses).max().unwrap();
    (pulses, figures.iter().map(|one| one.misses).sum())
}

#[test]
fn frames_that_follow_the_reference_clock_keep_their_place_and_no_pulse_is_missed() {
    // What is collected a cycle later tells the phase a cycle later, which the loop bears.
    for (reference, others, exchange) in [
        (100, -100, ExchangeTimes::Twice),
        (-100, 100, ExchangeTimes::Twice),
        (100, -100, ExchangeTimes::Pipelined),
    ] {
        let (devices, mut config) = synchronised();
        config.exchange = exchange;
        let rig = Rig::with_motors(devices);
        drift(&rig, reference, others);
        let mut lane = HostLane::open(&rig, &config);
        let settling = lane.run(&rig, 4_000, false, true);
        assert!(settling.step.is_locked, "{settling:?}");
        let (_, before) = misses(&rig);
        // The first cycles lead the drives through their states.
        lane.run(&rig, 50, true, true);
        let shown = lane.run(&rig, 10_000, true, true);
        assert!(
            shown.worst_ns <= LOCK_WINDOW.0 && shown.refused == 0,
            "{reference} ppm: {shown:?}"
        );
        assert!(shown.step.is_locked && shown.step.slips == 0, "{shown:?}");
        let (pulses, after) = misses(&rig);
        assert!(pulses > 10_000 && after == before, "{pulses} pulses, {} missed", after - before);
        // 14 s of 100 ppm are 1.4 ms: more than a cycle that nobody lost.
        let moved = shown.step.correction.0;
        assert!((moved + reference * 14_050).abs() < 600_000, "{moved} ns");
        let states = rig.world().segment.states();
        assert!(states.iter().all(|state| *state == State::Operational), "{states:?}");
    }
}

#[test]
fn frames_that_do_not_follow_it_miss_pulses() {
    let (devices, mut config) = synchronised();
    config.exchange = ExchangeTimes::Once;
    let rig = Rig::with_motors(devices);
    drift(&rig, 100, 100);
    let mut lane = HostLane::open(&rig, &config);
    lane.run(&rig, 500, false, false);
    let before = misses(&rig).1;
    let shown = lane.run(&rig, 12_000, true, false);
    let missed = misses(&rig).1 - before;
    assert!(missed > 10 && shown.worst_ns > 400_000, "{missed} missed, {shown:?}");
}

#[test]
fn the_clock_conforms_and_says_nothing_when_the_segment_is_silent() {
    let (devices, config) = synchronised();
    let rig = Rig::with_motors(devices);
    drift(&rig, 50, 0);
    let mut lane = HostLane::open(&rig, &config);
    lane.run(&rig, 30, false, true);
    let first = CYCLE_PERIOD * (lane.job + 1);
    let clock = lane.halves.board_clock.as_mut().unwrap();
    let mut release = {
        let mut bench = CycleDriver::new(first, CYCLE_PERIOD, |_| rig.pass(CYCLE_PERIOD));
        assert_eq!(check_board_clock(clock, &mut bench), []);
        bench.release()
    };
    assert_eq!(clock.cycle(), CYCLE_PERIOD);
    let rig = rig.with_faults(&["kind=silence target=ethercat at=0 for=1000"]);
    let kinds: Vec<ErrorKind> = (0..400)
        .filter_map(|_| {
            release += CYCLE_PERIOD;
            rig.pass(CYCLE_PERIOD);
            clock.sample(release).err().map(|error| error.kind)
        })
        .collect();
    let ends = (kinds.first().copied(), kinds.last().copied());
    assert_eq!(ends, (Some(ErrorKind::Transient), Some(ErrorKind::Lost)));
    assert_eq!(kinds.len(), 400);
}

#[test]
fn a_segment_without_the_section_has_no_clock_and_a_shift_beyond_the_cycle_is_refused() {
    let (devices, mut config) = six_drives();
    let rig = Rig::new(devices);
    assert!(rig.open(&config).unwrap().board_clock.is_none());
    config.sync = Some(SyncConfig { shift_us: Some(1_000) });
    let text = rig.open(&config).unwrap_err().to_string();
    assert!(text.contains("sync.shift_us") && text.contains("999"), "{text}");
    config.sync = Some(SyncConfig { shift_us: Some(999) });
    let (devices, _) = six_drives();
    assert!(Rig::new(devices).open(&config).unwrap().board_clock.is_some());
    let parsed: Config = toml::from_str("[sync]\nshift_us = 250\n").unwrap();
    assert_eq!(parsed.sync, Some(SyncConfig { shift_us: Some(250) }));
    assert!(toml::from_str::<Config>("[sync]\nshift = 250\n").is_err());
}
