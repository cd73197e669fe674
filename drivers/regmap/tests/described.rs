//! Every half of every shipped description passes hal's conformance suite on the emulator, seen
//! from the driver and from the board's terminals.

mod rig;

use rig::{BOARDS, Rig, config, text};
use taktil_drivers_regmap::Config;
use taktil_hal::conformance::{
    check_analog_in, check_analog_out_drop, check_analog_out_observed, check_digital_in,
    check_digital_out_drop, check_digital_out_observed, check_encoders, check_force_torque,
    check_tactile,
};
use taktil_hal::{CHANNELS, DacCode};

/// The codes at the board's terminals, in the order in which the channels are wired.
fn codes(rig: &Rig, wired: &[usize]) -> [DacCode; CHANNELS] {
    let (mut codes, all) = ([DacCode(0); CHANNELS], rig.look().codes);
    for (at, code) in codes.iter_mut().enumerate() {
        let channel = wired.get(at).or(wired.is_empty().then_some(&at));
        *code = DacCode(channel.and_then(|channel| all.get(*channel)).copied().unwrap_or(0));
    }
    codes
}

/// Checks all halves that a board has; their number.
fn check(config: &Config, text: &str) -> usize {
    let rig = Rig::new(config, text);
    let mut halves = rig.open(config).unwrap();
    let cycle = &mut rig.bench();
    let mut count = 0;
    if let Some(half) = halves.encoders.as_deref_mut() {
        assert_eq!(check_encoders(half, cycle), []);
        count += 1;
    }
    if let Some(half) = halves.analog_in.as_deref_mut() {
        assert_eq!(check_analog_in(half, cycle), []);
        count += 1;
    }
    if let Some(half) = halves.force_torque.as_deref_mut() {
        assert_eq!(check_force_torque(half, cycle), []);
        count += 1;
    }
    if let Some(half) = halves.tactile.as_deref_mut() {
        assert_eq!(check_tactile(half, cycle), []);
        count += 1;
    }
    if let Some(half) = halves.digital_in.as_deref_mut() {
        assert_eq!(check_digital_in(half, cycle), []);
        count += 1;
    }
    if let Some(mut half) = halves.analog_out.take() {
        let mut seen = || codes(&rig, &config.analog_out_channels);
        assert_eq!(check_analog_out_observed(half.as_mut(), cycle, &mut seen), []);
        assert_eq!(check_analog_out_drop(half, cycle, &mut seen), []);
        count += 1;
    }
    if let Some(mut half) = halves.digital_out.take() {
        let mut lines = || rig.look().lines;
        assert_eq!(check_digital_out_observed(half.as_mut(), cycle, &mut lines), []);
        assert_eq!(check_digital_out_drop(half, cycle, &mut lines), []);
        count += 1;
    }
    count
}

#[test]
fn every_shipped_board_conforms() {
    let counts =
        BOARDS.map(|board| check(&config(&format!("conforms-{board}"), board), text(board)));
    assert_eq!(counts, [7, 1, 1, 1, 3]);
}

#[test]
fn looks_at_busy_bits_are_declared_as_a_wait() {
    let config = Config { gauge_channels: (0..6).collect(), ..config("waits", "vme-arm") };
    let rig = Rig::new(&config, text("vme-arm"));
    let halves = rig.open(&config).unwrap();
    let ms = taktil_hal::Nanos::from_millis;
    assert_eq!(halves.encoders.map(|half| half.longest_wait()), Some(ms(1)));
    // Every latch of the encoders starts the conversion anew, which may happen three times.
    assert_eq!(halves.force_torque.map(|half| half.longest_wait()), Some(ms(4)));
    let own = self::config("waits-own", "taktil");
    let rig = Rig::new(&own, text("taktil"));
    let halves = rig.open(&own).unwrap();
    assert_eq!(halves.encoders.map(|half| half.longest_wait()), Some(ms(0)));
    assert_eq!(halves.analog_in.map(|half| half.longest_wait()), Some(ms(0)));
}

#[test]
fn gauges_of_chosen_converters_conform_beside_the_others() {
    for board in ["vme-8605", "vme-arm"] {
        let config = Config {
            gauge_channels: vec![7, 6, 5, 4, 3, 2],
            analog_in_channels: vec![0, 1],
            ..config(&format!("gauges-{board}"), board)
        };
        assert_eq!(check(&config, text(board)), if board == "vme-arm" { 4 } else { 2 });
    }
}

#[test]
fn chosen_channels_conform_and_stand_in_the_order_of_the_list() {
    let mut config = config("chosen", "vme-arm");
    config.encoder_channels = vec![5, 0, 2];
    config.analog_out_channels = vec![7];
    config.analog_in_channels = vec![3, 1];
    assert_eq!(check(&config, text("vme-arm")), 3);
    let rig = Rig::new(&config, text("vme-arm"));
    let mut halves = rig.open(&config).unwrap();
    {
        let mut inputs = rig.inputs.lock().unwrap();
        inputs.counts = (0..8).map(|joint| 1000 * joint).collect();
        inputs.codes = (0..8).map(|channel| -100 * channel).collect();
    }
    let release = taktil_hal::Nanos::from_millis(1_000);
    rig.job(release);
    let counts = halves.encoders.as_mut().unwrap().sample(release).unwrap().value;
    assert_eq!(counts[..4].iter().map(|count| count.0).collect::<Vec<_>>(), [5000, 0, 2000, 0]);
    let read = halves.analog_in.as_mut().unwrap().sample(release).unwrap().value;
    assert_eq!(read[..3].iter().map(|code| code.0).collect::<Vec<_>>(), [-300, -100, 0]);
    let mut codes = [DacCode(i32::MAX); CHANNELS];
    codes[0] = DacCode(-1);
    halves.analog_out.as_mut().unwrap().commit(release, &codes).unwrap();
    assert_eq!(rig.look().codes, [0, 0, 0, 0, 0, 0, 0, -1]);
}
