//! Shows that a cycle of all halves makes no call of the heap, whatever the board answers.

mod rig;

use rig::{CYCLE_PERIOD, SharedDouble, advance, robot_config};
use taktil_drivers_comedi_double::Double;
use taktil_hal::{CHANNELS, DacCode, LinesOut};
use taktil_rtcore::guard::{self, CountingAllocator};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

#[test]
fn no_cycle_uses_the_heap() {
    let double = SharedDouble::new(Double::robot_board(24));
    let mut halves = double.open(&robot_config()).unwrap();
    double.plan(&[
        "kind=loss value=0.1",
        "kind=truncation value=0.1",
        "kind=silence at=1 for=0.1",
        "kind=frozen at=1.5 for=0.1",
        "kind=unplugged at=2",
    ]);
    let mut answers = [0, 0];
    for cycle in 0..1_000 {
        let at = CYCLE_PERIOD * cycle;
        advance(&double, at);
        let codes = [DacCode(cycle as i32 - 500); CHANNELS];
        let lines = LinesOut { watchdog_feed: cycle % 2 == 0, ..LinesOut::SAFE };
        let (failed, calls) = guard::count_heap_calls(|| {
            [
                halves.encoders.as_mut().unwrap().sample(at).is_err(),
                halves.analog_in.as_mut().unwrap().sample(at).is_err(),
                halves.force_torque.as_mut().unwrap().sample(at).is_err(),
                halves.digital_in.as_mut().unwrap().sample(at).is_err(),
                halves.analog_out.as_mut().unwrap().commit(at, &codes).is_err(),
                halves.digital_out.as_mut().unwrap().commit(at, &lines).is_err(),
                halves.analog_out.as_mut().unwrap().safe().is_err(),
                halves.digital_out.as_mut().unwrap().safe().is_err(),
            ]
        });
        assert_eq!(calls, 0, "cycle {cycle}");
        let failures = failed.iter().filter(|failed| **failed).count();
        answers[0] += failed.len() - failures;
        answers[1] += failures;
    }
    assert!(guard::installed());
    assert!(answers.iter().all(|count| *count > 500), "both kinds of answers came: {answers:?}");
}
