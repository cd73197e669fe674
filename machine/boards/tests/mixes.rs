//! One robot out of several boards: which half comes from where, what cannot be meant, and that
//! every half keeps its promises in the mixture.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use taktil_drivers_regmap::registers::BLOCK_BYTES;
use taktil_drivers_regmap::{Config, Loopback, RegisterFile};
use taktil_hal::conformance::{CycleDriver, check_devices};
use taktil_hal::{CHANNELS, Clock, DacCode, Invalid, Nanos};
use taktil_machine::config::MachineConfig;
use taktil_machine::robot::AnyRobot;
use taktil_machine_boards::{OpenDevices, open};
use taktil_rtcore::linux::MonotonicClock;

/// A register board in a file, with its model at work beside it.
struct Board {
    path: PathBuf,
    stop: Arc<AtomicBool>,
    model: Option<std::thread::JoinHandle<Loopback>>,
}

impl Board {
    fn new(test: &str, name: &str) -> Board {
        let folder =
            std::env::temp_dir().join(format!("taktil-mixes-{test}-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let path = folder.join(name);
        std::fs::write(&path, vec![0; BLOCK_BYTES]).unwrap();
        let config = Config { path: path.clone(), ..Config::default() };
        let registers = Arc::new(RegisterFile::open(&config).unwrap());
        let mut model = Loopback::new(registers, &config).unwrap();
        let stop = Arc::new(AtomicBool::new(false));
        let flag = stop.clone();
        let model = std::thread::spawn(move || {
            for ms in 0.. {
                let last = flag.load(Ordering::SeqCst);
                model.set_counts(std::array::from_fn(|i| ms as i32 * (i as i32 + 1)));
                model.publish_frame(&[(300 + ms % 100) as u16; 256]);
                model.tick(Nanos::from_millis(ms));
                if last {
                    break;
                }
                std::thread::sleep(Duration::from_micros(500));
            }
            model
        });
        Board { path, stop, model: Some(model) }
    }

    fn section(&self, name: &str, serves: &str) -> String {
        format!("[device.{name}]\ndriver = \"regmap\"\nserves = {serves}\npath = {:?}\n", self.path)
    }

    fn end(mut self) -> Loopback {
        self.stop.store(true, Ordering::SeqCst);
        self.model.take().unwrap().join().unwrap()
    }
}

impl Drop for Board {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::SeqCst);
        let _ = self.model.take().map(std::thread::JoinHandle::join);
    }
}

fn opened(text: &str) -> Result<OpenDevices, Invalid> {
    let machine: MachineConfig = toml::from_str(text).unwrap_or_else(|bad| panic!("{bad}\n{text}"));
    open(&machine, &AnyRobot::puma260())
}

const MOTORS: &str = r#"["encoders", "analog_out", "digital_in", "digital_out"]"#;

#[test]
fn motors_from_one_board_and_touch_from_two_others_without_a_wrist() {
    let [motors, tip, palm] = ["motors", "tip", "palm"].map(|name| Board::new("three", name));
    let text = motors.section("motors", MOTORS)
        + &tip.section("tip", r#"["tactile"]"#)
        + &palm.section("palm", r#"["tactile_palm"]"#);
    let mut all = opened(&text).unwrap();
    assert!(all.devices.force_torque.is_none() && all.devices.analog_in.is_none());
    assert_eq!(all.devices.tactile.keys().collect::<Vec<_>>(), ["tactile", "tactile_palm"]);
    assert_eq!(all.served["encoders"], "motors");
    assert_eq!(all.served["tactile_palm"], "palm");
    // In real time, as the models are: a release is an instant of the clock.
    let clock = MonotonicClock::starting_in(Nanos::ZERO);
    let mut bench = CycleDriver::new(Nanos::ZERO, Nanos::from_micros(2_500), move |release| {
        clock.sleep_until(release);
    })
    .with_cycles(60);
    assert_eq!(check_devices(&mut all.devices, &mut bench), []);
    drop(all);
    let model = motors.end();
    assert_eq!(model.dac_codes(), [DacCode(0); CHANNELS], "closed boards are safe");
}

#[test]
fn what_cannot_be_meant_is_refused_with_its_place_and_leaves_boards_safe() {
    let [motors, tip] = ["motors", "tip"].map(|name| Board::new("refused", name));
    let place = |text: &str| {
        let bad = opened(text).unwrap_err();
        assert!(!bad.remedy.is_empty(), "{bad}");
        bad.place
    };
    let both = |serves: &str| motors.section("motors", MOTORS) + &tip.section("tip", serves);
    assert_eq!(place(&both(r#"["tactile", "encoders"]"#)), "device.tip.serves[1]");
    assert_eq!(place(&both(r#"["tactile", "tactile_palm"]"#)), "device.tip.serves[1]");
    assert_eq!(place(&both(r#"["touch"]"#)), "device.tip.serves[0]");
    assert_eq!(place(&both(r#"["tactile", "tactile"]"#)), "device.tip.serves[1]");
    assert_eq!(place(&both("3")), "device.tip.serves");
    assert_eq!(place("[device.x]\npath = \"a\"\n"), "device.x");
    assert_eq!(place("[device.x]\ndriver = \"simulator\"\n"), "device.x.driver");
    assert_eq!(place("[device.x]\ndriver = \"mesha\"\n"), "device.x.driver");
    assert_eq!(place("[device.x]\ndriver = \"regmap\"\npath = \"/no/such\"\n"), "device.x.path");
    assert_eq!(place("[device.x]\ndriver = \"regmap\"\npaht = \"a\"\n"), "device.x.paht");
    let thread = "thread = { priority = 100 }\n";
    assert_eq!(place(&(motors.section("m", MOTORS) + thread)), "device.m.thread.priority");
    let joints = motors.section("m", MOTORS) + "[joints]\nmotor_channel = [0, 1, 2, 3, 4, 9]\n";
    assert_eq!(place(&joints), "joints.motor_channel[5]");
}

#[test]
fn the_shipped_configuration_names_drivers_and_keys_that_exist() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let text = std::fs::read_to_string(root.join("systemd/emulated-boards.toml")).unwrap();
    let file: toml::Table = text.parse().unwrap();
    let machine: MachineConfig = file["robot"].clone().try_into().unwrap();
    for (name, section) in &machine.device {
        let (keys, own) = section.split().unwrap();
        let driver = taktil_machine_boards::find(&keys.driver).expect(name);
        // The boards are not there: whatever is complained of is not a key.
        let bad = (driver.open)(&own, &taktil_machine_boards::Epoch::default()).unwrap_err();
        let bad = bad.into_invalid();
        assert!(
            !bad.what.contains("unknown field") && !bad.what.contains("missing field"),
            "{bad}"
        );
    }
}
