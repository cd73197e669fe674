//! Shows that a cycle of all halves makes no call of the heap, whatever the board answers.

mod rig;

use rig::{BOARDS, CYCLE_PERIOD, Rig, config, text};
use taktil_drivers_regmap::Config;
use taktil_hal::{CHANNELS, DacCode, LinesOut, TactileFrame};
use taktil_rtcore::guard::{self, CountingAllocator};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

#[test]
fn no_cycle_uses_the_heap() {
    let mut answers = [0, 0];
    for board in BOARDS {
        let mut config = config(&format!("allocations-{board}"), board);
        if board.starts_with("vme") {
            config = Config { gauge_channels: (0..6).collect(), ..config };
        }
        let rig = Rig::new(&config, text(board));
        let mut halves = rig.open(&config).unwrap();
        rig.plan(&[
            "kind=corruption target=board.encoders value=0.1",
            "kind=silence target=board.analog_in at=0.3 for=0.1",
            "kind=silence target=board at=0.5 for=0.1",
            "kind=unplugged target=board at=1",
        ]);
        let mut frame = TactileFrame::new(16, 16);
        for cycle in 0..600 {
            let at = CYCLE_PERIOD * cycle;
            rig.inputs.lock().unwrap().counts = vec![cycle * 100; 8];
            rig.inputs.lock().unwrap().frame = Some(vec![cycle as u16; 256]);
            rig.job(at);
            let codes = [DacCode(cycle as i32 * 8 - 2_400); CHANNELS];
            let lines = LinesOut { watchdog_feed: cycle % 2 == 0, ..LinesOut::SAFE };
            let (failed, calls) = guard::count_heap_calls(|| {
                [
                    halves.encoders.as_mut().map(|half| half.sample(at).is_err()),
                    halves.analog_in.as_mut().map(|half| half.sample(at).is_err()),
                    halves.force_torque.as_mut().map(|half| half.sample(at).is_err()),
                    halves.digital_in.as_mut().map(|half| half.sample(at).is_err()),
                    halves.tactile.as_mut().map(|half| half.sample(at, &mut frame).is_err()),
                    halves.analog_out.as_mut().map(|half| half.commit(at, &codes).is_err()),
                    halves.digital_out.as_mut().map(|half| half.commit(at, &lines).is_err()),
                    halves.analog_out.as_mut().map(|half| half.safe().is_err()),
                    halves.digital_out.as_mut().map(|half| half.safe().is_err()),
                ]
            });
            assert_eq!(calls, 0, "{board}, cycle {cycle}");
            for failed in failed.into_iter().flatten() {
                answers[usize::from(failed)] += 1;
            }
        }
    }
    assert!(guard::installed());
    assert!(answers.iter().all(|count| *count > 500), "both kinds of answers came: {answers:?}");
}
