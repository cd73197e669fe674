//! The live executor's words between threads (`rtcore/src/live/flags.rs`, the file itself) in every
//! order that the memory model allows. Each model holds for the right file and has to fail for
//! variants of it with one word changed. The rings are not modelled here, because they belong to
//! `rtrb`.
#![cfg(test)]
#![allow(dead_code)]

/// A copy of the file, made by the build script.
macro_rules! variant {
    ($name:ident) => {
        mod $name {
            mod sync {
                pub(super) use loom::sync::atomic::{
                    AtomicI64, AtomicU8, AtomicU64, AtomicUsize, Ordering,
                };
            }
            pub(crate) mod flags {
                include!(concat!(env!("OUT_DIR"), "/", stringify!($name), ".rs"));
            }
        }
    };
}

variant!(right);
variant!(done_relaxed_store);
variant!(done_relaxed_load);
variant!(start_relaxed_store);
variant!(start_relaxed_load);
variant!(arrivals_relaxed_add);
variant!(arrivals_load_and_store);
variant!(slip_load_and_store);
variant!(storms_load_and_store);

/// Values in a ring's slots are seen by whoever saw that the jobs are done. The slots are plain
/// memory here: loom fails at an access that nothing orders.
macro_rules! done_model {
    ($variant:ident) => {
        loom::model(|| {
            use crate::$variant::flags::JobsDone;
            let shared = loom::sync::Arc::new((
                JobsDone::new(),
                [loom::cell::Cell::new(0u64), loom::cell::Cell::new(0u64)],
            ));
            let lane = {
                let shared = shared.clone();
                loom::thread::spawn(move || {
                    for job in 0..2 {
                        shared.1[job].set(7 + job as u64);
                        shared.0.publish(job as u64 + 1);
                    }
                })
            };
            let (glanced, seen) = (shared.0.load_relaxed(), shared.0.load());
            assert!(glanced <= seen, "the count never runs backwards");
            for job in 0..seen as usize {
                assert_eq!(shared.1[job].get(), 7 + job as u64);
            }
            lane.join().unwrap();
        })
    };
}

/// A lane that sees `Go` sees the epoch; one that sees `Abandon` runs nothing.
macro_rules! start_model {
    ($variant:ident) => {
        loom::model(|| {
            use crate::$variant::flags::{StartGate, StartSignal};
            let shared = loom::sync::Arc::new((StartGate::new(), loom::cell::Cell::new(0u64)));
            let lanes: Vec<_> = (0..2)
                .map(|_| {
                    let shared = shared.clone();
                    loom::thread::spawn(move || match shared.0.signal() {
                        StartSignal::Go => assert_eq!(shared.1.get(), 20),
                        StartSignal::Wait | StartSignal::Abandon => {}
                    })
                })
                .collect();
            shared.1.set(20);
            shared.0.set(StartSignal::Go);
            shared.0.set(StartSignal::Abandon);
            for lane in lanes {
                lane.join().unwrap();
            }
        })
    };
}

/// Whoever counts all threads sees what each left behind, and none is lost.
macro_rules! arrival_model {
    ($variant:ident) => {
        loom::model(|| {
            use crate::$variant::flags::ArrivalCount;
            let shared = loom::sync::Arc::new((
                ArrivalCount::new(),
                [loom::cell::Cell::new(0u64), loom::cell::Cell::new(0u64)],
            ));
            let lanes: Vec<_> = (0..2)
                .map(|n| {
                    let shared = shared.clone();
                    loom::thread::spawn(move || {
                        shared.1[n].set(5);
                        shared.0.arrive();
                    })
                })
                .collect();
            if shared.0.count() == 2 {
                for answer in &shared.1 {
                    assert_eq!(answer.get(), 5);
                }
            }
            for lane in lanes {
                lane.join().unwrap();
            }
            assert_eq!(shared.0.count(), 2, "nobody is lost");
        })
    };
}

/// The larger figure of two lanes that report a stall stands, and nobody sees it shrink.
macro_rules! slip_model {
    ($variant:ident) => {
        loom::model(|| {
            use crate::$variant::flags::Slip;
            let shared = loom::sync::Arc::new(Slip::new());
            let lanes: Vec<_> = [3, 8]
                .map(|ns| {
                    let shared = shared.clone();
                    loom::thread::spawn(move || shared.raise_to(ns))
                })
                .into_iter()
                .collect();
            let (first, then) = (shared.ns(), shared.ns());
            assert!(first <= then, "logical time never runs backwards");
            for lane in lanes {
                lane.join().unwrap();
            }
            assert_eq!(shared.ns(), 8);
        })
    };
}

/// No storm in one of two lanes is lost, and nobody sees the count shrink.
macro_rules! storms_model {
    ($variant:ident) => {
        loom::model(|| {
            use crate::$variant::flags::StormCount;
            let shared = loom::sync::Arc::new(StormCount::new());
            let lanes: Vec<_> = [1, 2]
                .map(|storms| {
                    let shared = shared.clone();
                    loom::thread::spawn(move || shared.add(storms))
                })
                .into_iter()
                .collect();
            let (first, then) = (shared.count(), shared.count());
            assert!(first <= then, "what has been heard stays so");
            for lane in lanes {
                lane.join().unwrap();
            }
            assert_eq!(shared.count(), 3);
        })
    };
}

mod tests {
    /// A model that has to fail, in silence.
    fn assert_rejected(model: impl FnOnce() + std::panic::UnwindSafe) {
        let hook = std::panic::take_hook();
        std::panic::set_hook(Box::new(|_| {}));
        let outcome = std::panic::catch_unwind(model);
        std::panic::set_hook(hook);
        assert!(outcome.is_err(), "a wrong variant passed");
    }

    #[test]
    fn the_words_hold_in_every_order_and_wrong_ones_do_not() {
        done_model!(right);
        start_model!(right);
        arrival_model!(right);
        slip_model!(right);
        storms_model!(right);
        assert_rejected(|| done_model!(done_relaxed_store));
        assert_rejected(|| done_model!(done_relaxed_load));
        assert_rejected(|| start_model!(start_relaxed_store));
        assert_rejected(|| start_model!(start_relaxed_load));
        assert_rejected(|| arrival_model!(arrivals_relaxed_add));
        assert_rejected(|| arrival_model!(arrivals_load_and_store));
        assert_rejected(|| slip_model!(slip_load_and_store));
        assert_rejected(|| storms_model!(storms_load_and_store));
    }
}
