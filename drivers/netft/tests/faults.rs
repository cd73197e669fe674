//! The half on a bad link: what is lost, doubled, overtaken, cut or silent is counted, and never
//! taken for a new reading.

mod rig;

use rig::{CYCLE_PERIOD, Rig, config};
use taktil_drivers_netft::{BACKLOG_RECORDS_MAX, Config};
use taktil_hal::{ErrorKind, ForceTorque, Nanos};

/// The time that a reading shows (us), as the sensor of the rig puts it.
fn shown(reading: &taktil_hal::Reading<taktil_hal::GaugeCodes>) -> i64 {
    i64::from(reading.value.codes[2].0)
}

#[test]
fn the_newest_record_is_handed_out_and_is_never_older_than_its_stamp() {
    for rate_hz in [300, 400, 1000, 7000] {
        let rig = Rig::new(rate_hz, &[]);
        let mut half = rig.open(&config(rate_hz));
        let mut good = 0;
        for answer in rig.run(&mut half, 0, 200) {
            let Ok(reading) = answer else { continue };
            // A record is as old as its stamp says, within the microsecond that the sensor shows.
            assert!(shown(&reading) >= reading.acquired.0 / 1_000 - 1, "{rate_hz}: {reading:?}");
            good += 1;
        }
        assert!(good >= 198, "{rate_hz} Hz: {good}");
        assert_eq!(half.counts().missing, 0);
    }
}

#[test]
fn lost_doubled_overtaken_and_cut_records_are_counted() {
    let faults = [
        "kind=loss value=0.05",
        "kind=duplication value=0.1",
        "kind=reordering value=0.1",
        "kind=truncation value=0.05",
    ];
    let rig = Rig::new(7000, &faults);
    let mut half = rig.open(&config(7000));
    let answers = rig.run(&mut half, 0, 400);
    let mut last = 0;
    for reading in answers[1..].iter().map(|answer| answer.unwrap()) {
        assert!(shown(&reading) > last, "time runs backwards: {reading:?}");
        last = shown(&reading);
    }
    let seen = half.counts();
    assert!(seen.missing > 300 && seen.old > 500 && seen.strange > 200, "{seen:?}");
    assert_eq!((seen.restarts, seen.streams), (0, 0), "{seen:?}");
}

#[test]
fn a_status_that_is_not_zero_is_no_reading() {
    let rig = Rig::new(400, &["kind=failing value=1 at=0.1 for=0.1"]);
    let mut half = rig.open(&config(400));
    let answers = rig.run(&mut half, 0, 120);
    let kinds: Vec<_> = answers.iter().map(|answer| answer.map_err(|error| error.kind)).collect();
    assert_eq!(kinds[41], Err(ErrorKind::Transient));
    assert_eq!(kinds[60], Err(ErrorKind::Stale), "20 ms without a valid record");
    assert!(kinds[100].is_ok() && half.counts().invalid == 40, "{:?}", half.counts());
}

#[test]
fn the_end_of_the_range_is_marked() {
    let rig = Rig::new(400, &[]);
    let limits = Config { force_range_counts: 8_000, torque_range_counts: 1, ..config(400) };
    let mut half = rig.open(&limits);
    let answers = rig.run(&mut half, 0, 6);
    let gauges = |cycle: usize| answers[cycle].unwrap().value.over_range;
    assert_eq!(gauges(3), [false, false, false, true, true, false]);
    assert_eq!(gauges(5), [false, false, true, true, true, false], "Fz has come to 8000");
    assert_eq!(rig.open(&config(400)).counts().records, 0);
}

#[test]
fn a_cable_that_is_pulled_makes_it_stale_and_it_goes_on_when_it_is_back() {
    let rig = Rig::new(1000, &["kind=unplugged at=0.5 for=0.5"]);
    let mut half = rig.open(&config(1000));
    let answers = rig.run(&mut half, 0, 600);
    assert!(answers[199].is_ok());
    assert!(answers[205].is_ok(), "held for as long as it is not stale");
    assert_eq!(answers[300].unwrap_err().kind, ErrorKind::Stale);
    assert!(answers[402..].iter().all(Result::is_ok));
    // The box went on: the numbers show what was missed, or that the stream began anew.
    let seen = half.counts();
    assert!(seen.requests >= 4 && seen.requests <= 5, "{seen:?}");
    assert!(seen.missing > 400 && seen.restarts == 0, "{seen:?}");
    assert!(rig.sent().iter().all(|packet| packet[3] == 2), "nothing but starts");
}

#[test]
fn a_box_that_has_restarted_is_started_again_and_lost_where_its_bias_counts() {
    for bias in [false, true] {
        let rig = Rig::new(1000, &["kind=restart at=1"]);
        let mut half = rig.open(&Config { bias, ..config(1000) });
        let answers = rig.run(&mut half, 0, 600);
        assert_eq!(answers[430].unwrap_err().kind, ErrorKind::Stale);
        let seen = half.counts();
        assert_eq!((seen.restarts, seen.requests), (1, 1), "{seen:?}");
        let end = answers[599].map_err(|error| error.kind);
        assert_eq!(end.is_ok(), !bias, "{end:?}");
        assert!(!bias || end == Err(ErrorKind::Lost));
    }
}

#[test]
fn records_that_have_piled_up_are_not_handed_out() {
    let rig = Rig::new(7000, &[]);
    let mut half = rig.open(&config(7000));
    rig.advance(Nanos::from_millis(150));
    let first = half.sample(Nanos::from_millis(150)).unwrap_err();
    assert_eq!((first.kind, half.counts().backlogs), (ErrorKind::Transient, 1));
    assert!(half.counts().records > BACKLOG_RECORDS_MAX as u64);
    let next = Nanos::from_millis(150) + CYCLE_PERIOD;
    rig.advance(next);
    assert!(half.sample(next).is_ok());
}

#[test]
fn a_box_that_never_speaks_is_stale_and_asked_again() {
    let rig = Rig::new(1000, &["kind=silence"]);
    let mut half = rig.open(&config(1000));
    let answers = rig.run(&mut half, 0, 100);
    assert_eq!(answers[0].unwrap_err().kind, ErrorKind::Transient);
    assert!(answers[20..].iter().all(|answer| answer.unwrap_err().kind == ErrorKind::Stale));
    assert_eq!(rig.sent().len(), 2, "every 100 ms");
}
