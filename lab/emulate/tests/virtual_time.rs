//! The production drivers over the emulated boards in virtual time: what the boards receive moves
//! the robot, what the robot feels comes back, and equal bytes give equal bits.

mod common;

use common::{Bench, CYCLE_PERIOD, Seen, pressed_scene};
use taktil_hal::fault::FaultPlan;
use taktil_hal::{CHANNELS, DacCode, LinesOut, Nanos};
use taktil_lab_emulate::{BoardKind, EmulatedRobot, Traffic};
use taktil_lab_scene::assembly::Assembly;

/// A code of the card that moves joint 1 against its friction: 3.4 V.
const PUSH_CODE: i32 = 1_400;

fn run(faults: &[&str], seed: u64) -> (Vec<Seen>, Bench) {
    let mut bench = Bench::new(&pressed_scene(""), BoardKind::Myrmex, faults, seed);
    let mut seen = Vec::new();
    for cycle in 0..400 {
        let push = if cycle < 200 { 0 } else { PUSH_CODE };
        seen.push(bench.cycle([push, 0, 0, 0, 0, 0], cycle >= 200));
    }
    (seen, bench)
}

#[test]
fn volts_turn_the_motor_in_their_direction_and_counts_come_back() {
    for sign in [1, -1] {
        let mut bench = Bench::new(&pressed_scene(""), BoardKind::Myrmex, &[], 1);
        for _ in 0..40 {
            let seen = bench.cycle([0; 6], false);
            assert_eq!(seen.counts, Some([0; 6]), "the brakes hold");
        }
        let mut last = 0;
        for _ in 0..80 {
            let seen = bench.cycle([sign * PUSH_CODE, 0, 0, 0, 0, 0], true);
            last = seen.counts.unwrap()[0];
        }
        assert!(sign * last > 50, "{last} counts for {sign}");
    }
}

#[test]
fn index_pulses_come_where_the_scene_has_them() {
    let scene = pressed_scene("[world.arm]\nindex_counts = [-20, 0, 0, 0, 0, 0]\n");
    let mut bench = Bench::new(&scene, BoardKind::Myrmex, &[], 1);
    let (mut counts, mut before) = (0, 0);
    for _ in 0..400 {
        counts = bench.cycle([PUSH_CODE, 0, 0, 0, 0, 0], true).counts.unwrap()[0];
        let expected = (counts >= 20).then_some(20);
        assert_eq!(bench.index_pulse(), expected, "from {before} to {counts}");
        before = counts;
        if counts > 100 {
            break;
        }
    }
    assert!(counts > 100, "{counts} counts");
}

#[test]
fn a_pressed_pin_shows_as_counts_on_every_tactile_board() {
    for (board, rest) in
        [(BoardKind::Myrmex, 300), (BoardKind::Flexitac, 18), (BoardKind::WeissWts, 300)]
    {
        let mut bench = Bench::new(&pressed_scene(""), board, &[], 1);
        for _ in 0..400 {
            let _ = bench.cycle([0; 6], false);
        }
        let scan = bench.scans().last().expect("scans arrive");
        let most = scan.values.iter().copied().max().unwrap();
        let corner = scan.values[0];
        assert!(most > 2 * rest, "{board}: {most}");
        assert!(corner < 2 * rest, "{board}: {corner}");
        assert!(bench.scans().len() > 20, "{board}: {} scans", bench.scans().len());
    }
}

#[test]
fn lines_and_the_relay_s_watchdog_are_those_of_the_cell() {
    let scene =
        pressed_scene("[[world.fault]]\nkind = \"emergency_stop\"\nat_s = 0.5\nfor_s = 0.2\n");
    let mut bench = Bench::new(&scene, BoardKind::Myrmex, &[], 1);
    let mut open = 0;
    for _ in 0..400 {
        let lines = bench.cycle([0; 6], true).lines.unwrap_or_default();
        open += i32::from(!lines.estop_a_closed && !lines.estop_b_closed && !lines.drive_power);
    }
    let pressed = bench.robot.lock().unwrap().now() > Nanos::from_millis(700);
    assert!(pressed && (70..=90).contains(&open), "{open} cycles");
    assert!(bench.robot.lock().unwrap().world().digital_out().enable);
    // Nobody says anything any more: the remote goes to 0 V and the lines go off by themselves.
    let mut robot = bench.robot.lock().unwrap();
    let later = robot.now() + Nanos::from_millis(120);
    robot.advance(later);
    robot.integrate();
    assert!(!robot.world().digital_out().enable && robot.world().truth().braked);
}

#[test]
fn equal_bytes_at_equal_instants_give_equal_bits() {
    let faults = ["kind=loss value=0.02 at=0.3", "kind=corruption target=myrmex value=0.05 at=0.3"];
    let ((seen, bench), (again, other)) = (run(&faults, 1), run(&faults, 1));
    assert_eq!(seen, again);
    assert_eq!(bench.scans(), other.scans());
    assert!(!bench.scans().is_empty());
    let robot = bench.robot.lock().unwrap();
    let befallen = |board: usize| robot.traffic(board).unwrap().faults().iter().count();
    assert!(befallen(0) > 0 && befallen(1) > 0);
    drop(robot);
    let (differently, third) = run(&faults, 2);
    assert_ne!(seen.last(), differently.last());
    assert_ne!(bench.scans(), third.scans());
}

#[test]
fn who_looks_in_between_does_not_change_a_bit() {
    let scene = pressed_scene("");
    let boards = [BoardKind::Flexitac];
    let cable = "kind=unplugged at=0.0213 for=0.03".parse().unwrap();
    let plan = FaultPlan::new(vec![cable]);
    let robot = || EmulatedRobot::new(&scene, &boards, &plan, 1).unwrap();
    let (mut once, mut often) = (robot(), robot());
    let end = Nanos::from_millis(100);
    once.advance(end);
    (1..=700).for_each(|tick| often.advance(Nanos(142_857) * tick));
    often.advance(end);
    once.integrate();
    often.integrate();
    let bytes = |robot: &mut EmulatedRobot| {
        let mut all = Vec::<u8>::new();
        robot.deliver(0, &mut |some| all.extend(some));
        all
    };
    assert_eq!(bytes(&mut once), bytes(&mut often));
    assert_eq!(once.world().state_hash(), often.world().state_hash());
    assert_eq!(once.traffic(0), often.traffic(0));
    let Some(Traffic::Line(line)) = once.traffic(0) else { panic!("it is a line") };
    assert_eq!((line.scans, line.messages), (19, 13), "4 before the cable was off, 9 after it");
}

#[test]
fn the_boards_add_nothing_but_their_delay() {
    let mut scene = pressed_scene("");
    let mut bench = Bench::new(&scene, BoardKind::Myrmex, &[], 1);
    // Smart serial takes 60 us to the analog outputs; the link takes no time here.
    scene.actuation_delay = taktil_drivers_mesa_emulator::EXCHANGE_TIME;
    let (mut world, mut devices) = Assembly::new(&scene).with_seed(1).build_world().unwrap();
    for cycle in 0..200 {
        let release = CYCLE_PERIOD * cycle;
        let (on, code) = (cycle >= 40, if cycle < 80 { 0 } else { 1_000 - 3 * cycle as i32 });
        world.advance(release);
        let seen = bench.cycle([2 * code, 0, -2 * code, 0, 0, 2 * code], on);
        assert_eq!(seen.state_hash, world.state_hash(), "cycle {cycle}");
        let counts = devices.encoders.as_mut().unwrap().sample(release).unwrap().value;
        assert_eq!(seen.counts.unwrap()[..], counts.map(|count| count.0)[..6], "cycle {cycle}");
        let mut codes = [DacCode(0); CHANNELS];
        (codes[0], codes[2], codes[5]) = (DacCode(code), DacCode(-code), DacCode(code));
        let lines = LinesOut { enable: on, brake_release: on, watchdog_feed: cycle % 2 == 0 };
        devices.analog_out.as_mut().unwrap().commit(release, &codes).unwrap();
        devices.digital_out.as_mut().unwrap().commit(release, &lines).unwrap();
    }
    assert!(bench.cycle([0; 6], true).counts.unwrap()[0] > 20, "the robot moved");
}
