//! What the configuration refuses, and the reason that it gives.

use super::*;

const JOB_PERIOD: Nanos = Nanos::from_millis(1);

#[test]
fn what_does_not_fit_is_refused_with_its_key() {
    let place = |config: Config, period, cycle| {
        config.lock(period, cycle).map(|_| String::new()).unwrap_or_else(|bad| bad.place)
    };
    let good = Config::default();
    assert!(
        good.lock(JOB_PERIOD, JOB_PERIOD).is_ok() && good.lock(JOB_PERIOD * 4, JOB_PERIOD).is_ok()
    );
    for (config, key) in [
        (Config { slew_max_ppm: 199, ..good }, "slew_max_ppm"),
        (Config { slew_max_ppm: i64::MAX, ..good }, "slew_max_ppm"),
        (Config { window_us: 0, ..good }, "window_us"),
        (Config { window_us: i64::MIN, ..good }, "window_us"),
        (Config { window_us: 251, ..good }, "window_us"),
    ] {
        assert_eq!(place(config, JOB_PERIOD, JOB_PERIOD), key, "{config:?}");
    }
    for cycle in [Nanos::ZERO, Nanos(-1_000_000), JOB_PERIOD * 2, Nanos(300_000)] {
        assert!(good.lock(JOB_PERIOD, cycle).is_err(), "{cycle}");
    }
}
