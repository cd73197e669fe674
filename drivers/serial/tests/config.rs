//! What a machine file may say, and what is refused.

use taktil_drivers_serial::{BoardKind, Config, Pressure, Session};
use taktil_hal::explain::Explain;

fn config(text: &str) -> Config {
    toml::from_str(text).unwrap()
}

#[test]
fn path_and_board_are_enough() {
    let config = config("path = \"/dev/ttyUSB0\"\nboard = \"flexitac\"");
    assert_eq!((config.board, config.line_baud()), (BoardKind::Flexitac, 2_000_000));
    assert_eq!((config.geometry().full_scale, config.pressure), (255, Pressure::Raises));
    config.check().unwrap();
    for text in ["bord = \"myrmex\"", "board = \"m1616\"", "pressure = \"up\"", "rows = -1"] {
        assert!(toml::from_str::<Config>(text).is_err(), "{text}");
    }
}

#[test]
fn what_is_out_of_range_is_refused_by_its_key() {
    for (key, value) in [
        ("rows", "0"),
        ("cols", "65"),
        ("baud", "5000000"),
        ("rate_hz", "9.9"),
        ("rate_hz", "nan"),
        ("scan_us", "1000001"),
        ("transfer_us", "1000001"),
        ("latency_us", "100001"),
        ("full_scale", "256"),
        ("sensor", "202"),
        ("start_timeout_ms", "99"),
        ("degraded_share", "-0.1"),
        ("lost_share", "1.1"),
        ("window_ms", "9"),
        ("lost_after_ms", "9"),
        ("retry_min_ms", "0"),
        ("retry_min_ms", "2000"),
        ("retry_max_ms", "60001"),
        ("queue_scans", "1"),
    ] {
        let config = config(&format!("path = \"x\"\nboard = \"flexitac\"\n{key} = {value}"));
        let refused = config.check().expect_err(key);
        assert_eq!(refused.place, key, "{refused}");
        assert_eq!(Session::new(&config).err(), Some(refused), "{key}");
    }
    assert_eq!(config("").check().unwrap_err().place, "path");
    assert_eq!(config("path = \"x\"\nrows = 12").check().unwrap_err().place, "rows");
}

#[test]
fn every_key_says_what_it_is() {
    for key in Config::keys() {
        assert!(key.about.len() > 15, "{key:?}");
    }
}
