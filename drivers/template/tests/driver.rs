//! The driver over files that look like those of the kernel: the promises of its half, its errors,
//! and how it is found by its name.

use std::fs;
use std::path::{Path, PathBuf};

use own_driver::{Config, DRIVER, IioAnalogIn};
use taktil_hal::conformance::{CycleDriver, check_analog_in};
use taktil_hal::{AnalogIn, ErrorKind, Nanos};
use taktil_machine::config::MachineConfig;
use taktil_machine::robot::AnyRobot;
use taktil_rtcore::guard::{self, CountingAllocator};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// A device with two channels.
fn device(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("own-driver-{name}-{}", std::process::id()));
    fs::create_dir_all(&folder).unwrap();
    for (channel, code) in [(0, 17), (3, 4095)] {
        write(&folder, channel, &format!("{code}\n"));
    }
    folder
}

fn write(folder: &Path, channel: u32, text: &str) {
    fs::write(folder.join(format!("in_voltage{channel}_raw")), text).unwrap();
}

fn config(folder: &Path) -> Config {
    Config { path: folder.to_owned(), channels: vec![0, 3], bits: 12 }
}

#[test]
fn it_keeps_every_promise_of_an_input_half_and_calls_no_heap() {
    let folder = device("promises");
    let mut half = IioAnalogIn::open(&config(&folder)).unwrap();
    let mut bench = CycleDriver::new(Nanos::ZERO, Nanos::from_millis(5), |release| {
        write(&folder, 0, &format!("{}\n", release.0 / 5_000_000 % 4096));
    });
    assert_eq!(check_analog_in(&mut half, &mut bench), []);
    let (reading, calls) = guard::count_heap_calls(|| half.sample(Nanos::from_secs(9)).unwrap());
    assert_eq!((reading.value[1].0, calls), (4095, 0));
}

#[test]
fn what_is_no_code_is_refused_channel_by_channel() {
    let folder = device("codes");
    let mut half = IioAnalogIn::open(&config(&folder)).unwrap();
    let answers = [
        ("4096\n", ErrorKind::OutOfRange),
        ("-1\n", ErrorKind::OutOfRange),
        ("", ErrorKind::Transient),
        ("nan\n", ErrorKind::Transient),
    ];
    for (at, (text, kind)) in answers.into_iter().enumerate() {
        write(&folder, 3, text);
        let bad = half.sample(Nanos(at as i64)).unwrap_err();
        assert_eq!((bad.kind, bad.channel), (kind, 1), "{text:?}");
    }
    write(&folder, 3, "5\n");
    assert_eq!(half.sample(Nanos(9)).unwrap().value[1].0, 5);
}

#[test]
fn a_machine_file_finds_it_by_its_name_and_learns_what_is_wrong() {
    static DRIVERS: [taktil_machine_boards::Driver; 1] = [DRIVER];
    taktil_machine_boards::register(&DRIVERS).unwrap();
    let folder = device("machine");
    let text = format!(
        "[device.pressures]\ndriver = \"iio\"\nserves = [\"analog_in\"]\npath = {:?}\n\
         channels = [0, 3]\nbits = 12\n",
        folder.display().to_string()
    );
    let open = |text: &str| {
        let machine: MachineConfig = toml::from_str(text).unwrap();
        taktil_machine_boards::open(&machine, &AnyRobot::puma260())
    };
    let opened = open(&text).unwrap();
    assert_eq!(opened.devices.analog_in.unwrap().channels(), 2);
    assert_eq!(opened.served["analog_in"], "pressures");
    for (from, to, place) in [
        ("channels = [0, 3]", "channels = [0, 4]", "device.pressures.channels[1]"),
        ("channels = [0, 3]", "channels = []", "device.pressures.channels"),
        ("bits = 12", "bits = 32", "device.pressures.bits"),
        ("bits = 12", "bits = 12\nbit = 3", "device.pressures.bit"),
        ("\"analog_in\"", "\"encoders\"", "device.pressures.serves[0]"),
        ("\"iio\"", "\"ioi\"", "device.pressures.driver"),
    ] {
        let bad = open(&text.replace(from, to)).unwrap_err();
        assert_eq!(bad.place, place, "{to}: {bad}");
        assert!(!bad.remedy.is_empty());
    }
}
