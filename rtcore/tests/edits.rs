//! Tests edits of parameters: the same jobs take them in virtual time and live, all lanes take them
//! at one instant, and the lanes' own records show it. The tests do not depend on wall time.

use std::sync::atomic::AtomicBool;

use taktil_rtcore::guard::{self, CountingAllocator};
use taktil_rtcore::live::{self, Contract, Pace, RunObserver, RunOptions};
use taktil_rtcore::parameter::Edit;
use taktil_rtcore::record::{Observer, Record};
use taktil_rtcore::replay::RecordedRun;
use taktil_rtcore::trace::LaneState8;
use taktil_rtcore::{
    Builder, Cycle, Editor, FaultCode, Io, LaneSpec, Machine, Nanos, Output, Param, Payload, Task,
    Transaction, payload, replay, virtual_time,
};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

payload! {
    /// What a task found its parameters to be.
    pub struct Found {
        /// values
        pub value: [f64; 2],
    }
}

struct Teller {
    gain: Option<[Param; 2]>,
    out: Output<Found>,
}

impl Task for Teller {
    fn step(&mut self, _cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        let value = self.gain.map_or([0.0; 2], |gain| io.parameters(&gain));
        io.write(&self.out, Found { value });
        Ok(())
    }
}

fn ms(ms: i64) -> Nanos {
    Nanos::from_millis(ms)
}

/// Lanes of 2 ms and of 5 ms with a phase, each with two gains, and one without any.
fn machine() -> Machine {
    let mut b = Builder::new();
    let slow = LaneSpec { phase: ms(1), ..LaneSpec::new("slow", ms(5), 50) };
    for spec in [LaneSpec::new("fast", ms(2), 60), slow, LaneSpec::new("plain", ms(4), 40)] {
        let name = spec.name.clone();
        let lane = b.lane(spec).unwrap();
        b.task(lane, &format!("{name}_task"), |ports| {
            let gain = (name != "plain").then(|| ports.parameters("gain", [1.0; 2], 0.0..=10.0));
            Ok(Box::new(Teller { gain, out: ports.output("found") }))
        })
        .unwrap();
    }
    b.build().unwrap()
}

/// Every record by signal, job and bytes, and an edit to send on the way.
#[derive(Default)]
struct Keep {
    rows: Vec<(usize, u64, i64, Vec<u8>)>,
    editor: Option<Editor>,
    sent: Option<Nanos>,
}

impl Observer for Keep {
    fn record(&mut self, record: &Record<'_>) {
        self.rows.push((record.signal, record.tick, record.release.0, record.body.to_vec()));
    }
}

impl RunObserver for Keep {
    fn on_time(&mut self, now: Nanos) {
        let Some(mut editor) = self.editor.take_if(|_| now > ms(20)) else { return };
        let set = vec![("fast_task.gain".into(), 4.0), ("slow_task.gain".into(), 4.0)];
        let at = editor.earliest(now) + ms(10);
        editor.send(now, &Transaction { at, set }).unwrap();
        self.sent = Some(at);
    }
}

impl Keep {
    fn of<T: Payload>(&self, machine: &Machine, signal: &str) -> Vec<(i64, T)> {
        let id = machine.catalog().find(signal).unwrap();
        let rows = self.rows.iter().filter(|row| row.0 == id);
        rows.map(|row| (row.2, T::decode(&row.3).unwrap())).collect()
    }

    /// Every job before `at` has `old`, every other `new`; both lanes say when they took it.
    fn assert_edited(&self, machine: &Machine, at: Nanos, old: [f64; 2], new: [f64; 2]) {
        for lane in ["fast", "slow"] {
            let found = self.of::<Found>(machine, &format!("{lane}_task.found"));
            assert!(found.iter().any(|(release, _)| *release >= at.0));
            for (release, found) in &found {
                let expected = if *release < at.0 { old } else { new };
                assert_eq!(found.value, expected, "{lane} at {release}");
            }
            let edits = self.of::<Edit>(machine, &format!("{lane}.edit"));
            let first = found.iter().find(|(release, _)| *release >= at.0).unwrap().0;
            assert_eq!(edits.len(), 1);
            let (release, edit) = edits[0];
            assert_eq!((release, edit.at_ns, edit.count), (first, at.0, 2));
            assert_eq!((&edit.old[..2], &edit.new[..2]), (&old[..], &new[..]));
        }
    }
}

fn planned() -> Machine {
    let mut machine = machine();
    let set = vec![
        ("fast_task.gain[0]".into(), 2.0),
        ("fast_task.gain[1]".into(), 3.0),
        ("slow_task.gain[0]".into(), 2.0),
        ("slow_task.gain[1]".into(), 3.0),
    ];
    machine.plan_edits(&[Transaction { at: Nanos::from_micros(20_500), set }]).unwrap();
    machine
}

fn run_virtual(machine: &mut Machine) -> Keep {
    let mut keep = Keep::default();
    virtual_time::run(machine, ms(60), &AtomicBool::new(false), &mut keep).unwrap();
    keep
}

#[test]
fn all_lanes_take_an_edit_at_one_instant_without_the_heap() {
    let mut machine = planned();
    let keep = run_virtual(&mut machine);
    keep.assert_edited(&machine, Nanos::from_micros(20_500), [1.0; 2], [2.0, 3.0]);
    assert!(guard::installed());
    assert!(machine.figures().all(|(_, figures)| figures.allocations == 0));
    assert_eq!(machine.catalog().find("plain.edit"), None, "nothing to edit there");
    assert_eq!(machine.parameters().len(), 4);
}

#[test]
fn planned_edits_are_the_same_live_and_in_virtual_time() {
    let mut expected = run_virtual(&mut planned()).rows;
    let mut machine = planned();
    let mut keep = Keep::default();
    let terms = RunOptions { until: ms(60), contract: Contract::Soft, pace: Pace::Slip };
    live::run(&mut machine, terms, &AtomicBool::new(false), &mut keep).unwrap();
    expected.sort_by_key(|row| row.0);
    keep.rows.sort_by_key(|row| row.0);
    assert_eq!(keep.rows, expected);
}

#[test]
fn an_edit_sent_while_the_machine_runs_reaches_all_lanes_at_its_instant() {
    let mut machine = machine();
    let editor = machine.editor();
    assert!(editor.is_some() && machine.editor().is_none(), "there is one");
    let mut keep = Keep { editor, ..Keep::default() };
    let terms = RunOptions { until: ms(400), contract: Contract::Soft, pace: Pace::Slip };
    live::run(&mut machine, terms, &AtomicBool::new(false), &mut keep).unwrap();
    let at = keep.sent.expect("it was sent");
    keep.assert_edited(&machine, at, [1.0; 2], [4.0; 2]);
    assert!(machine.figures().all(|(_, figures)| figures.records_dropped == 0));
    // The record holds what a replay needs, and nobody sends anything then.
    let mut script = RecordedRun::new(machine.catalog(), &[]);
    for (signal, tick, release, body) in &keep.rows {
        let (signal, tick, release) = (*signal, *tick, Nanos(*release));
        script.record(&Record { signal, tick, release, body });
    }
    let (mut again, mut repeated) = (self::machine(), Keep::default());
    let stop = AtomicBool::new(false);
    replay::run(&mut again, &script, &[], Nanos::MAX, &stop, &mut repeated).unwrap();
    keep.rows.sort_by_key(|row| row.0);
    repeated.rows.sort_by_key(|row| row.0);
    assert_eq!(repeated.rows, keep.rows);
}

#[test]
fn a_parameter_whose_first_value_is_out_of_range_refuses_the_machine() {
    for bad in [f64::NAN, -0.1, 10.1] {
        let mut b = Builder::new();
        let lane = b.lane(LaneSpec::new("lane", ms(1), 50)).unwrap();
        let refused = b.task(lane, "teller", |ports| {
            let gain = Some(ports.parameters("gain", [1.0, bad], 0.0..=10.0));
            Ok(Box::new(Teller { gain, out: ports.output("found") }))
        });
        assert_eq!(refused.unwrap_err().place, "teller.gain[1]", "{bad}");
    }
}

/// States of the tasks of a lane, job by job.
fn states(machine: &Machine, keep: &Keep, lane: &str) -> Vec<(i64, u64)> {
    let states = keep.of::<LaneState8>(machine, &format!("{lane}.state"));
    states.into_iter().map(|(release, state)| (release, state.task[0])).collect()
}

#[test]
fn parameters_are_part_of_their_task_s_state_from_the_job_that_takes_an_edit() {
    let run = |mut machine: Machine| {
        let mut keep = Keep::default();
        virtual_time::run(&mut machine, ms(40), &AtomicBool::new(false), &mut keep).unwrap();
        (machine, keep)
    };
    let ((edited, with), (plain, without)) = (run(planned()), run(machine()));
    for lane in ["fast", "slow", "plain"] {
        let pairs = states(&edited, &with, lane).into_iter().zip(states(&plain, &without, lane));
        for ((release, a), (_, b)) in pairs {
            let taken = lane != "plain" && release >= 20_500_000;
            assert_eq!(a != b, taken, "{lane} at {release}");
        }
    }
}
