//! The harness with a task that adds up what it reads: ages, array inputs, refusals, a panic.

use super::*;
use crate::array_payload;
use crate::mode::Mode;
use crate::payload;
use crate::payload::Payload;
use crate::port::{Input, Output};
use crate::state::StateHash;

payload! {
    /// A number.
    pub struct Number {
        /// The number.
        pub n: f64,
    }
}

array_payload! {
    /// Some numbers.
    pub struct Row {
        /// The numbers.
        pub numbers: Box<[f32]>,
    }
    usual [4]
}

/// Adds up what it reads while it is usable, and panics at 13.
struct Sum {
    number: Input<Number>,
    row: Input<Row>,
    sum: Output<Number>,
    small: Output<Number>,
    total: f64,
}

impl Task for Sum {
    fn step(&mut self, _: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        let number = io.read(&self.number).usable().map_or(0.0, |number| number.n);
        assert!(number != 13.0, "the number of bad luck");
        let row = io.view(&self.row).map_or(0.0, |row| row.value.numbers.iter().sum::<f32>());
        self.total += number + f64::from(row);
        io.write(&self.sum, Number { n: self.total });
        io.write(&self.small, Number { n: self.total });
        Ok(())
    }

    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.total);
    }

    fn stop(&mut self) {
        self.total = 0.0;
    }
}

const TEN_MS: Nanos = Nanos::from_millis(10);

fn two_numbers(_: &str, field: &str) -> Option<usize> {
    (field == "numbers").then_some(2)
}

fn sum() -> Harness {
    Harness::new(&two_numbers, |ports| {
        Ok(Box::new(Sum {
            number: ports.input_within("number", TEN_MS),
            row: ports.array_input("row"),
            sum: ports.output("sum"),
            small: ports.output_within("small", |number: &Number| number.n.abs() < 100.0),
            total: 0.0,
        }))
    })
    .unwrap()
}

fn number(n: f64) -> Vec<u8> {
    let mut body = vec![0; Number::SIZE];
    Number { n }.encode(&mut body);
    body
}

fn step(harness: &mut Harness, tick: u64) -> StepReport {
    let dt = Nanos::from_millis(1);
    let release = dt * i64::try_from(tick).unwrap();
    harness.step(&Cycle { tick, release, dt, mode: Mode::Hold })
}

fn written(harness: &mut Harness) -> Vec<(usize, f64)> {
    let mut all = Vec::new();
    harness.take_written(|output, body| all.push((output, Number::decode(body).unwrap().n)));
    all
}

#[test]
fn a_value_is_absent_then_new_then_held_then_stale() {
    let mut harness = sum();
    harness.start().unwrap();
    step(&mut harness, 0);
    assert_eq!(written(&mut harness), [(0, 0.0), (1, 0.0)], "absent");
    assert!(harness.give(0, &number(2.0), Nanos::ZERO));
    step(&mut harness, 1);
    step(&mut harness, 10);
    assert_eq!(written(&mut harness), [(0, 4.0), (1, 4.0)], "new, then held");
    step(&mut harness, 11);
    assert!(harness.replace(0, &number(70.0)), "another value of the same age");
    step(&mut harness, 12);
    assert_eq!(written(&mut harness), [(0, 4.0), (1, 4.0)], "stale");
    assert!(!harness.give(0, &[0; 7], Nanos::ZERO) && !harness.give(7, &number(1.0), Nanos::ZERO));
}

#[test]
fn arrays_have_the_lengths_that_were_asked_for() {
    let mut harness = sum();
    assert_eq!((harness.inputs()[1].size, harness.inputs()[1].fields[0].count), (8, 2));
    let body: Vec<u8> = [1.5_f32, 2.0].iter().flat_map(|x| x.to_le_bytes()).collect();
    assert!(harness.give(1, &body, Nanos::ZERO));
    step(&mut harness, 0);
    assert_eq!(written(&mut harness)[0], (0, 3.5));
    let refused = Harness::new(&|_, _| None, |ports| {
        let row = ports.array_input("row");
        let number = ports.input("number");
        let (sum, small) = (ports.output("sum"), ports.output("small"));
        Ok(Box::new(Sum { number, row, sum, small, total: 0.0 }))
    });
    assert_eq!(refused.unwrap_err().place, "row");
}

#[test]
fn refused_values_are_shown_with_their_port() {
    let mut harness = sum();
    let refused = |harness: &mut Harness| {
        let mut all = Vec::new();
        harness.take_refused(|output, body| all.push((output, Number::decode(body).unwrap().n)));
        all
    };
    harness.give(0, &number(100.0), Nanos::ZERO);
    assert_eq!(step(&mut harness, 0).refused, Some(FaultCode::OutOfRange));
    assert_eq!(refused(&mut harness), [(1, 100.0)]);
    assert_eq!(refused(&mut harness), [], "shown once");
    harness.give(0, &number(f64::INFINITY), Nanos::ZERO);
    assert_eq!(step(&mut harness, 1).refused, Some(FaultCode::NotFinite));
    assert_eq!(refused(&mut harness).len(), 2);
}

#[test]
fn a_panic_is_named_and_ends_the_task() {
    let mut harness = sum();
    harness.give(0, &number(13.0), Nanos::ZERO);
    let report = step(&mut harness, 0);
    assert!(report.is_panic() && report.state == 0);
    let place = harness.take_panic_place().unwrap();
    assert!(place.contains("harness/tests.rs:"), "{place}");
    harness.give(0, &number(1.0), Nanos::ZERO);
    assert!(step(&mut harness, 1).is_panic(), "it is out of the lane");
    assert_eq!(written(&mut harness), []);
}

#[test]
fn inputs_that_were_cleared_are_absent_again() {
    let mut harness = sum();
    harness.give(0, &number(5.0), Nanos::ZERO);
    let first = step(&mut harness, 0);
    harness.stop().unwrap();
    harness.clear_inputs(&two_numbers).unwrap();
    written(&mut harness);
    harness.start().unwrap();
    let empty = step(&mut harness, 0);
    assert_eq!(written(&mut harness)[0], (0, 0.0));
    assert_ne!(first.state, empty.state);
    harness.give(0, &number(5.0), Nanos::ZERO);
    assert_eq!(step(&mut harness, 1).state, first.state);
}
