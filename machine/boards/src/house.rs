//! The drivers of this repository, by name.

use serde::de::DeserializeOwned;
use taktil_drivers_can as can;
use taktil_drivers_comedi as comedi;
#[cfg(feature = "ethercat")]
use taktil_drivers_ethercat as ethercat;
use taktil_drivers_mesa as mesa;
use taktil_drivers_netft as netft;
use taktil_drivers_regmap as regmap;
use taktil_drivers_serial as serial;
use taktil_hal::{Devices, OpenError, TACTILE, TactileArray};
use taktil_machine::own::Section;
use taktil_rtcore::explain::Explain;
use taktil_rtcore::linux::MonotonicClock;

use crate::driver::{Counts, Driver, Opened};
use crate::epoch::{Epoch, EpochArray};
use crate::thread::DriverThread;

pub(crate) static HOUSE_DRIVERS: &[Driver] = &[
    Driver::new("can", open_can, can::Config::keys)
        .with_make_safe(make_can_safe)
        .with_system_calls(can::SYSTEM_CALLS),
    Driver::new("comedi", open_comedi, comedi::Config::keys)
        .with_make_safe(make_comedi_safe)
        .with_system_calls(comedi::SYSTEM_CALLS),
    #[cfg(feature = "ethercat")]
    Driver::new("ethercat", open_ethercat, ethercat::Config::keys)
        .with_make_safe(make_ethercat_safe)
        .with_system_calls(ethercat::SYSTEM_CALLS),
    Driver::new("mesa", open_mesa, mesa::Config::keys)
        .with_make_safe(make_mesa_safe)
        .with_system_calls(mesa::SYSTEM_CALLS),
    Driver::new("netft", open_netft, netft::Config::keys).with_system_calls(netft::SYSTEM_CALLS),
    Driver::new("regmap", open_regmap, regmap::Config::keys)
        .with_make_safe(make_regmap_safe)
        .with_system_calls(regmap::SYSTEM_CALLS),
    Driver::new("serial", open_serial, serial::Config::keys)
        .with_system_calls(serial::SYSTEM_CALLS),
];

fn read<T: DeserializeOwned>(section: &Section) -> Result<T, OpenError> {
    section.read().map_err(OpenError::from)
}

fn make_can_safe(section: &Section) -> Result<(), OpenError> {
    // Opening a bus switches the torque of its drives off, and so does closing it.
    can::open(&read(section)?).map(drop)
}

fn make_comedi_safe(section: &Section) -> Result<(), OpenError> {
    let config: comedi::Config = read(section)?;
    comedi::write_safe_values(&config.path, &config)
}

#[cfg(feature = "ethercat")]
fn make_ethercat_safe(section: &Section) -> Result<(), OpenError> {
    // Opening a segment leads its devices to INIT first, and so does closing it.
    ethercat::Segment::open(&read(section)?).map(drop)
}

fn make_mesa_safe(section: &Section) -> Result<(), OpenError> {
    // Opening a card puts its outputs at their safe values, and so does closing it.
    mesa::Board::open(&read(section)?).map(drop)
}

fn make_regmap_safe(section: &Section) -> Result<(), OpenError> {
    regmap::write_safe_values(&read::<regmap::Config>(section)?.beside(section.folder()))
}

fn open_can(section: &Section, _: &Epoch) -> Result<Opened, OpenError> {
    let halves = can::open(&read(section)?)?;
    let devices = Devices {
        encoders: Some(Box::new(halves.encoders)),
        analog_out: halves.analog_out.map(|half| Box::new(half) as _),
        drive_out: Some(Box::new(halves.drive_out)),
        drive_in: Some(Box::new(halves.drive_in)),
        digital_in: Some(Box::new(halves.digital_in)),
        digital_out: halves.digital_out.map(|half| Box::new(half) as _),
        ..Devices::default()
    };
    let monitor = halves.monitor;
    let counts = Counts(Box::new(move || monitor.counts()));
    Ok(Opened { devices, counts: Some(counts), ..Opened::default() })
}

fn open_comedi(section: &Section, _: &Epoch) -> Result<Opened, OpenError> {
    let halves = comedi::open(&read(section)?)?;
    let devices = Devices {
        encoders: halves.encoders,
        analog_out: halves.analog_out,
        analog_in: halves.analog_in,
        force_torque: halves.force_torque,
        digital_in: halves.digital_in,
        digital_out: halves.digital_out,
        ..Devices::default()
    };
    let analog_out_volts_per_code = halves.analog_out_volts_per_code;
    Ok(Opened { devices, analog_out_volts_per_code, ..Opened::default() })
}

#[cfg(feature = "ethercat")]
fn open_ethercat(section: &Section, _: &Epoch) -> Result<Opened, OpenError> {
    let halves = ethercat::Segment::open(&read(section)?)?;
    let devices = Devices {
        encoders: halves.encoders.map(|half| Box::new(half) as _),
        analog_out: halves.analog_out.map(|half| Box::new(half) as _),
        drive_out: halves.drive_out.map(|half| Box::new(half) as _),
        drive_in: halves.drive_in.map(|half| Box::new(half) as _),
        board_clock: halves.board_clock.map(|half| Box::new(half) as _),
        analog_in: halves.analog_in.map(|half| Box::new(half) as _),
        digital_in: halves.digital_in.map(|half| Box::new(half) as _),
        digital_out: halves.digital_out.map(|half| Box::new(half) as _),
        ..Devices::default()
    };
    let monitor = halves.monitor;
    let counts = Counts(Box::new(move || monitor.diagnostics().named().to_vec()));
    let analog_out_volts_per_code = halves.analog_out_volts_per_code;
    Ok(Opened { devices, analog_out_volts_per_code, counts: Some(counts), ..Opened::default() })
}

fn open_mesa(section: &Section, _: &Epoch) -> Result<Opened, OpenError> {
    let config: mesa::Config = read(section)?;
    let halves = mesa::Board::open(&config)?;
    let devices = Devices {
        encoders: halves.encoders.map(|half| Box::new(half) as _),
        analog_out: halves.analog_out.map(|half| Box::new(half) as _),
        digital_in: halves.digital_in.map(|half| Box::new(half) as _),
        digital_out: halves.digital_out.map(|half| Box::new(half) as _),
        ..Devices::default()
    };
    let analog_out_volts_per_code = match config.analog {
        mesa::Analog::Remote => vec![mesa::REMOTE_VOLTS_PER_CODE; config.analog_channels],
        mesa::Analog::Pwm | mesa::Analog::None => Vec::new(),
    };
    let monitor = halves.monitor;
    let counts = Counts(Box::new(move || monitor.diagnostics().named().to_vec()));
    Ok(Opened { devices, analog_out_volts_per_code, counts: Some(counts), ..Opened::default() })
}

fn open_netft(section: &Section, _: &Epoch) -> Result<Opened, OpenError> {
    let half = netft::open(&read(section)?)?;
    let monitor = half.monitor();
    let counts = Counts(Box::new(move || monitor.counts().to_vec()));
    let devices = Devices { force_torque: Some(Box::new(half)), ..Devices::default() };
    Ok(Opened { devices, counts: Some(counts), ..Opened::default() })
}

fn open_regmap(section: &Section, _: &Epoch) -> Result<Opened, OpenError> {
    let config = read::<regmap::Config>(section)?.beside(section.folder());
    let halves = regmap::Board::open_halves(&config)?;
    let tactile = halves.tactile.map(|array| (TACTILE.to_owned(), array));
    let devices = Devices {
        encoders: halves.encoders,
        analog_out: halves.analog_out,
        analog_in: halves.analog_in,
        tactile: tactile.into_iter().collect(),
        force_torque: halves.force_torque,
        digital_in: halves.digital_in,
        digital_out: halves.digital_out,
        ..Devices::default()
    };
    let analog_out_volts_per_code = halves.analog_out_volts_per_code;
    Ok(Opened { devices, analog_out_volts_per_code, ..Opened::default() })
}

fn open_serial(section: &Section, epoch: &Epoch) -> Result<Opened, OpenError> {
    let clock = MonotonicClock::since_boot();
    let (array, worker) = serial::open(&read(section)?, Box::new(clock))?;
    let monitor = worker.monitor();
    let counts = Counts(Box::new(move || monitor.counts().to_vec()));
    let array = EpochArray { half: Box::new(array), epoch: epoch.clone() };
    let array: Box<dyn TactileArray> = Box::new(array);
    let devices = Devices { tactile: [(TACTILE.to_owned(), array)].into(), ..Devices::default() };
    let thread = DriverThread { name: "serial", run: Box::new(move || worker.run()) };
    Ok(Opened { devices, threads: vec![thread], counts: Some(counts), ..Opened::default() })
}
