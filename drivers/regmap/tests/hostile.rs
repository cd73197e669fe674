//! Descriptions that no board can have are refused with the key and a remedy; so are texts that are
//! no descriptions.

mod rig;

use rig::{BOARDS, place, text};
use taktil_drivers_regmap::{Board, Config, Description, OpenError};

/// A small board with everything in which a mistake can be made.
const GOOD: &str = r#"
name = "good"
bus_bits = 16
byte_order = "big"
stride_bytes = 2
length_bytes = 0x100

[presence]
offset = 0x00
value = 7

[[identity]]
offset = 0x02
mask = 0x00ff
value = 0x12

[[setup]]
offset = 0x04
value = 1

[watchdog]
offset = 0x06
unit_us = 1000
kick_offset = 0x08

[analog_out]
offset = 0x10
channels = 4
bits = 12
shift = 4
format = "offset-binary"
low_v = -10.0
high_v = 10.0
safe_code = 0
strobe_offset = 0x0a

[encoders]
offset = 0x20
channels = 4
bits = 24
latch_offset = 0x0c
hold = "latch"
busy_offset = 0x0c
busy_mask = 1
polls = 10

[index]
offset = 0x30
seen_offset = 0x40
feature_offset = 0x02
feature_mask = 1

[analog_in]
offset = 0x50
channels = 8
bits = 12
format = "twos-complement"
start_offset = 0x60
busy_offset = 0x60
busy_mask = 0x8000
begin_offset = 0x62
end_offset = 0x64

[digital_in]
offset = 0x66
drive_power_bit = 0
estop_a_bit = 1
estop_b_bit = 2
zero_mask = 0xf0
beat_shift = 8

[digital_out]
offset = 0x68
enable_bit = 0
brake_release_bit = 1
watchdog_feed_bit = 2

[tactile]
offset = 0x80
rows = 4
cols = 4
bits = 10
scan_us = 1000
begin_offset = 0x7e
end_offset = 0xa0
"#;

/// Replaces a line of one section of the good description.
fn with(section: &str, key: &str, line: &str) -> String {
    let (mut current, mut done) = (String::new(), false);
    let mut text: Vec<String> = Vec::new();
    for old in GOOD.lines() {
        if old.starts_with('[') {
            if current == section && !done {
                text.push(line.to_owned());
                done = true;
            }
            current = old.trim_matches(['[', ']']).to_owned();
        }
        let is_key = current == section && old.starts_with(&format!("{key} "));
        if is_key && !done {
            text.push(line.to_owned());
            done = true;
        } else {
            text.push(old.to_owned());
        }
    }
    if !done {
        text.push(line.to_owned());
    }
    text.join("\n")
}

/// The description is refused at this place, with a remedy.
fn refused(text: &str, place: &str, what: &str) {
    let Err(bad) = Description::from_toml(text) else { panic!("{place} was taken in {text}") };
    assert_eq!(bad.place, place, "{bad}");
    assert!(bad.what.contains(what), "{bad}");
    assert!(bad.remedy.len() > 5, "{bad}");
}

#[test]
fn the_good_description_is_taken() {
    assert_eq!(Description::from_toml(GOOD).map(|good| good.name), Ok("good".to_owned()));
    let same = with("analog_out", "bits", "bits = 12");
    assert_eq!(Description::from_toml(&same), Description::from_toml(GOOD));
}

/// Part of a complaint about a value beyond its bounds.
const OUTSIDE_BOUNDS: &str = "out of bounds";

/// Section, key, a value that it cannot have, and what is said about it.
const BAD_VALUES: &[(&str, &str, &str, &str)] = &[
    ("", "bus_bits", "0", "no width"),
    ("", "bus_bits", "12", "no width"),
    ("", "bus_bits", "4294967295", "no width"),
    ("", "stride_bytes", "0", OUTSIDE_BOUNDS),
    ("", "stride_bytes", "1", OUTSIDE_BOUNDS),
    ("", "stride_bytes", "3", "no multiple"),
    ("", "length_bytes", "0", OUTSIDE_BOUNDS),
    ("", "length_bytes", "9223372036854775807", OUTSIDE_BOUNDS),
    ("", "name", "\" \"", "empty"),
    ("presence", "value", "0x10000", "bits outside 0xffff"),
    ("watchdog", "unit_us", "0", OUTSIDE_BOUNDS),
    ("watchdog", "kick_value", "0x12345", "bits outside"),
    ("analog_out", "channels", "0", OUTSIDE_BOUNDS),
    ("analog_out", "channels", "65", OUTSIDE_BOUNDS),
    ("analog_out", "channels", "18446744073709551615", OUTSIDE_BOUNDS),
    ("analog_out", "bits", "0", OUTSIDE_BOUNDS),
    ("analog_out", "bits", "1", OUTSIDE_BOUNDS),
    ("analog_out", "bits", "32", OUTSIDE_BOUNDS),
    ("analog_out", "bits", "4294967295", OUTSIDE_BOUNDS),
    ("analog_out", "shift", "21", OUTSIDE_BOUNDS),
    ("analog_out", "shift", "4294967295", OUTSIDE_BOUNDS),
    ("analog_out", "low_v", "nan", OUTSIDE_BOUNDS),
    ("analog_out", "high_v", "inf", OUTSIDE_BOUNDS),
    ("analog_out", "high_v", "-1e300", OUTSIDE_BOUNDS),
    ("analog_out", "low_v", "10.0", "is not below"),
    ("analog_out", "safe_code", "2048", OUTSIDE_BOUNDS),
    ("analog_out", "safe_code", "-2049", OUTSIDE_BOUNDS),
    ("analog_out", "strobe_value", "0x10000", "bits outside"),
    ("encoders", "channels", "17", OUTSIDE_BOUNDS),
    ("encoders", "bits", "7", OUTSIDE_BOUNDS),
    ("encoders", "bits", "33", OUTSIDE_BOUNDS),
    ("encoders", "words", "1", OUTSIDE_BOUNDS),
    ("encoders", "words", "3", OUTSIDE_BOUNDS),
    ("encoders", "polls", "0", OUTSIDE_BOUNDS),
    ("encoders", "polls", "1001", OUTSIDE_BOUNDS),
    ("encoders", "busy_mask", "0", "has no bit"),
    ("encoders", "busy_value", "2", "bits outside 0x1"),
    ("encoders", "step_max_counts", "2147483648", OUTSIDE_BOUNDS),
    ("index", "feature_mask", "0", "has no bit"),
    ("analog_in", "channels", "0", OUTSIDE_BOUNDS),
    ("digital_in", "estop_a_bit", "16", OUTSIDE_BOUNDS),
    ("digital_in", "estop_b_bit", "1", "is `estop_a_bit` already"),
    ("digital_in", "zero_mask", "0x4", "bits outside"),
    ("digital_in", "zero_mask", "0x100f0", "bits outside"),
    ("digital_in", "beat_shift", "1", "covers another bit"),
    ("digital_in", "beat_shift", "9", OUTSIDE_BOUNDS),
    ("digital_in", "beat_bits", "0", OUTSIDE_BOUNDS),
    ("digital_out", "enable_bit", "4294967295", OUTSIDE_BOUNDS),
    ("digital_out", "watchdog_feed_bit", "0", "is `enable_bit` already"),
    ("digital_out", "inverted_mask", "0x10000", "bits outside"),
    ("tactile", "rows", "0", OUTSIDE_BOUNDS),
    ("tactile", "rows", "65", OUTSIDE_BOUNDS),
    ("tactile", "cols", "1025", OUTSIDE_BOUNDS),
    ("tactile", "bits", "17", OUTSIDE_BOUNDS),
    ("tactile", "scan_us", "0", OUTSIDE_BOUNDS),
];

#[test]
fn values_out_of_bounds_are_refused_by_their_key() {
    for (section, key, value, what) in BAD_VALUES.iter().copied() {
        let place = if section.is_empty() { key.to_owned() } else { format!("{section}.{key}") };
        let text = with(section, key, &format!("{key} = {value}"));
        refused(&text, &place, what);
    }
    refused(&with("identity", "value", "value = 0x112"), "identity[0].value", "bits outside 0xff");
    refused(&with("setup", "value", "value = 0x1ffff"), "setup[0].value", "bits outside");
}

#[test]
fn registers_outside_or_between_or_in_two_places_are_refused() {
    for (section, key, value, what) in [
        ("presence", "offset", "0x100", "outside 0x100"),
        ("presence", "offset", "0x1", "no multiple"),
        ("presence", "offset", "9223372036854775806", "outside"),
        ("analog_out", "offset", "0xfa", "outside 0x100"),
        ("analog_out", "offset", "0x11", "no multiple"),
        ("analog_out", "offset", "0x06", "shares"),
        ("analog_out", "channel_stride_bytes", "0", "shares"),
        ("analog_out", "channel_stride_bytes", "9223372036854775807", "no multiple"),
        ("encoders", "offset", "0x2e", "shares"),
        ("encoders", "channel_stride_bytes", "2", "shares"),
        ("encoders", "latch_offset", "0x60", "shares"),
        ("analog_out", "strobe_offset", "0x10", "shares"),
        ("index", "seen_offset", "0x30", "shares"),
        ("analog_in", "begin_offset", "0x64", "shares"),
        ("analog_in", "offset", "0x56", "shares"),
        ("digital_out", "offset", "0x06", "shares"),
        ("digital_out", "offset", "0x04", "shares"),
        ("tactile", "offset", "0x98", "shares"),
        ("tactile", "offset", "0xf0", "outside"),
    ] {
        let text = with(section, key, &format!("{key} = {value}"));
        let bad = Description::from_toml(&text).expect_err(key);
        assert!(bad.what.contains(what), "{section}.{key} = {value}: {bad}");
        assert!(bad.place.contains("offset") && bad.remedy.len() > 5, "{bad}");
    }
    // Two commands of one register are told apart by their values.
    let text = with("encoders", "latch_offset", "latch_offset = 0x60\nlatch_value = 2");
    assert!(Description::from_toml(&text).is_ok());
    // Read as one thing, written as another: command and status.
    let text = with("analog_in", "start_offset", "start_offset = 0x66");
    assert!(Description::from_toml(&text).is_ok());
}

#[test]
fn keys_that_need_others_are_refused_alone() {
    let drop = |section: &str, key: &str| with(section, key, "");
    refused(&drop("encoders", "latch_offset"), "encoders.hold", "without a latch");
    let text = drop("encoders", "latch_offset").replace("hold = \"latch\"", "");
    refused(&text, "encoders.busy_offset", "a latch that is not there");
    refused(&drop("encoders", "busy_offset"), "encoders.busy_offset", "is missing");
    refused(&drop("analog_in", "begin_offset"), "analog_in.begin_offset", "is missing");
    refused(&drop("analog_in", "end_offset"), "analog_in.end_offset", "is missing");
    let text = with("analog_in", "start_by", "start_by = \"encoders\"");
    assert!(Description::from_toml(&text).is_ok());
    let text = text.replace("start_offset = 0x60", "");
    refused(&text, "analog_in.start_offset", "cannot start");
    let text = drop("analog_out", "strobe_offset").replace("kick_offset = 0x08", "");
    refused(&text, "watchdog.kick_offset", "sign of life");
    let text = drop("analog_out", "strobe_offset").replace("safe_code", "strobe = \"count\"\n#");
    refused(&text, "analog_out.strobe", "without a strobe");
    let start = GOOD.find("[encoders]").unwrap();
    let end = GOOD.find("[index]").unwrap();
    refused(&GOOD.replace(&GOOD[start..end], ""), "index", "no encoders");
}

#[test]
fn texts_that_are_no_description_are_refused_at_their_line() {
    let line = |found: &str| GOOD.lines().position(|line| line.starts_with(found)).unwrap() + 1;
    for (old, new, what) in [
        ("bus_bits = 16", "bus_bits = 16\nbus_bits = 16", "duplicate"),
        ("bus_bits = 16", "bus_bits = \"16\"", "string"),
        ("bus_bits = 16", "bus_bit = 16", "unknown field `bus_bit`"),
        ("unit_us = 1000", "unit_us = -1", "-1"),
        ("unit_us = 1000", "unit_us = 1.5", "1.5"),
        ("kick_offset = 0x08", "kick_offset = nan", "NaN"),
        ("byte_order = \"big\"", "byte_order = \"middle\"", "unknown variant `middle`"),
        ("rows = 4", "rows = ", ""),
    ] {
        let bad = Description::from_toml(&GOOD.replacen(old, new, 1)).expect_err(new);
        let key = line(old.split(' ').next().unwrap());
        let near: Vec<String> = [key, key + 1].map(|at| format!("line {at}")).into();
        assert!(near.contains(&bad.place), "{new}: {bad}");
        assert!(bad.what.contains(what), "{new}: {bad}");
    }
    for text in ["", "[", "\u{0}", "name = \"x\"", "[analog_out]", &"[a]\n".repeat(1_000)] {
        assert!(Description::from_toml(text).is_err(), "{text:?}");
    }
}

#[test]
fn a_truncated_or_scrambled_description_is_never_taken_for_another_and_never_panics() {
    for board in BOARDS {
        let text = text(board);
        for end in (0..text.len()).step_by(7) {
            let _ = Description::from_toml(&text[..end]);
        }
        let lines: Vec<&str> = text.lines().collect();
        for at in 0..lines.len() {
            let mut doubled = lines.clone();
            doubled.insert(at, lines[at]);
            let again = Description::from_toml(&doubled.join("\n"));
            let harmless =
                lines[at].is_empty() || lines[at].starts_with('#') || lines[at].starts_with("[[");
            assert!(harmless || again.is_err(), "{board}: {} twice", lines[at]);
        }
    }
}

#[test]
fn a_device_section_names_the_place_inside_it() {
    let path = place("hostile");
    let section = |rest: &str| {
        let text = format!("path = \"{}\"\n{rest}", path.display());
        toml::from_str::<Config>(&text).unwrap()
    };
    let refused = |config: &Config, place: &str, what: &str| {
        let bad = Board::open_halves(config).expect_err(place);
        assert!(matches!(bad, OpenError::Invalid(_)), "{bad}");
        assert_eq!(bad.place(), place, "{bad}");
        assert!(bad.to_string().contains(what), "{bad}");
    };
    let inline = "[registers]\nname = \"x\"\nbus_bits = 16\nbyte_order = \"big\"\n\
                  length_bytes = 4\n[registers.analog_out]\noffset = 2\nchannels = 2\nbits = 12\n\
                  format = \"offset-binary\"";
    refused(&section(inline), "registers.analog_out.offset", "outside 0x4");
    let inline = inline.replace("channels = 2", "channels = 1");
    refused(&section(&inline), "relay_ms", "no watchdog");
    let with = |keys: &str| section(&format!("relay_ms = 10\n{keys}\n{inline}"));
    refused(&with("board = \"dvme-628\""), "registers", "beside `board`");
    refused(&with("dac_bits = 16"), "dac_bits", "described board");
    refused(&with("joints = 5"), "joints", "described board");
    refused(&with("analog_out_channels = [1]"), "analog_out_channels[0]", "no channel 1");
    refused(&with("analog_out_channels = [0, 0]"), "analog_out_channels[1]", "listed twice");
    refused(&with("encoder_channels = [0]"), "encoder_channels[0]", "no channel 0");
    refused(&with("gauge_channels = [0]"), "gauge_channels", "1 channels");
    refused(&with("pci_id = \"10b5\""), "pci_id", "no pair");
    refused(&with("pci_id = \"10b5:9050\"\nuio_name = \"x\""), "uio_name", "beside `pci_id`");
    refused(&section("relay_ms = 0\nboard = \"dvme-628\""), "relay_ms", "out of bounds");
    refused(&section("board = \"dvme\""), "board", "taktil, dvme-628");
    refused(&section("board = \"/nowhere/x.toml\""), "board", "cannot be read");
    refused(&section("board = \"/dev/zero.toml\""), "board", "cannot be read");
    refused(&section("encoder_channels = [0]"), "encoder_channels", "project's layout");
    let file = place("hostile.toml");
    std::fs::write(&file, "name = 1").unwrap();
    let named = section(&format!("board = \"{}\"", file.display()));
    refused(&named, "board", "hostile.toml: line 1");
    std::fs::write(&file, GOOD.replace("bits = 12", "bits = 99")).unwrap();
    refused(&named, "board", "analog_out.bits: 99 is out of bounds");
    let beside = section("board = \"rig-hostile.toml\"").beside(file.parent().unwrap());
    refused(&beside, "board", "analog_out.bits: 99");
    std::fs::write(&file, vec![b'#'; 2 << 20]).unwrap();
    refused(&named, "board", "larger than 1 MB");
}
