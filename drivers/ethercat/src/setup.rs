//! Opens a segment: finds the devices, compares them with the configuration, sets drives and
//! watchdogs up, and leads all of them to operation and back to SAFEOP, where they wait for a lane.

use ethercrab::error::Error;
use ethercrab::subdevice_group::{PreOp, SafeOp};
use ethercrab::{DefaultLock, MainDevice, SubDevice, SubDevicePdi, SubDeviceRef};
use taktil_drivers_cia402::{InterpolationPeriod, Object, QuickStopOption};
use taktil_drivers_exchange::Refusal;
use taktil_hal::Nanos;

use crate::config::{Config, DeviceConfig, DriveMode, ExchangeTimes, Kind};
use crate::field::{MappedObject, ProcessData};
use crate::identity::{DeviceIdentity, compare};
use crate::master::{FRAME_PAYLOAD_BYTES, Group, IMAGE_BYTES_MAX, Master, SetupError, discover};
use crate::port::Port;
use crate::wiring::Wiring;

/// Divider of a device's watchdogs for units of 100 us.
const WATCHDOG_DIVIDER: u16 = 2_498;
/// Register of that divider.
const WATCHDOG_DIVIDER_ADDRESS: u16 = 0x0400;
/// Register of the watchdog of outputs.
const OUTPUT_WATCHDOG_ADDRESS: u16 = 0x0420;
/// Units of the watchdog in a millisecond.
const WATCHDOG_UNITS_PER_MS: u16 = 10;
/// The time of the segment.
const SYSTEM_TIME_ADDRESS: u16 = 0x0910;
/// Register that starts SYNC0.
const SYNC_ACTIVATION_ADDRESS: u16 = 0x0981;
/// The first SYNC0, in the time of the segment.
const SYNC_START_ADDRESS: u16 = 0x0990;
/// Time from one SYNC0 to the next.
const SYNC_CYCLE_ADDRESS: u16 = 0x09a0;
/// Cyclic operation, and SYNC0.
const SYNC_ACTIVATION_WORD: u8 = 3;
/// From the set-up of a device's SYNC0 to its first pulse: longer than a frame is sent again.
const SYNC_LEAD_NS: u64 = 100_000_000;
/// Header and working counter of a datagram.
const DATAGRAM_OVERHEAD_BYTES: usize = 12;
/// Most process data objects of a direction, and entries of one.
const MAPPED_OBJECTS_MAX: u8 = 64;
/// Lines of a digital terminal.
const DIGITAL_LINES: usize = 8;

/// What a drive says of its motor and limits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DriveFacts {
    /// Position on the segment, counted from 0.
    pub device: usize,
    /// Rated torque (mNm), object 0x6076; 0 where the drive has none.
    pub rated_torque_mnm: u32,
    /// Highest torque (0.1 % of the rated one), object 0x6072; 0 where the drive has none.
    pub torque_max_permille: u16,
    /// Modes that it knows, object 0x6502; 0 where the drive has none.
    pub supported_modes: u32,
    /// What it does at a quick stop, object 0x605A.
    pub quick_stop_option: i16,
}

/// A segment that waits for its lane.
pub(crate) struct Ready {
    pub(crate) master: Master,
    pub(crate) group: Box<Group<SafeOp>>,
    pub(crate) wiring: Wiring,
    pub(crate) drives: Vec<DriveFacts>,
}

/// What failed at a device.
struct DeviceError {
    position: usize,
    doing: &'static str,
    error: Error,
}

/// What was learnt of the devices in PREOP.
#[derive(Default)]
struct Prepared {
    data: Vec<ProcessData>,
    drives: Vec<DriveFacts>,
    /// A drive that is to be synchronised and has no clock.
    without_clock: Option<usize>,
}

/// Finds the devices of a segment and leads them to PREOP.
fn scan(
    master: &mut Master,
    limit: Nanos,
) -> Result<(Box<Group<PreOp>>, Vec<DeviceIdentity>), Refusal> {
    let device = master.device();
    let group = master.set_up(limit, discover(device)).map_err(|error| match error {
        SetupError::Silence => nobody(),
        SetupError::Endless => unreadable("their set-up does not end"),
        SetupError::Unreadable(why) => unreadable(&why),
        SetupError::Refused(error) => {
            let what = format!("the devices cannot be set up ({error})");
            Refusal::new("interface", what, "look at cables and supply, and open it again")
        }
    })?;
    if group.is_empty() {
        return Err(nobody());
    }
    let identity = |one: SubDeviceRef<'_, &SubDevice>| {
        let numbers = one.identity();
        DeviceIdentity {
            name: one.name().to_owned(),
            vendor: numbers.vendor_id,
            product: numbers.product_id,
            revision: numbers.revision,
            alias: one.alias_address(),
        }
    };
    let all = (0..group.len()).filter_map(|index| group.subdevice(device, index).ok());
    let found = all.map(identity).collect();
    Ok((group, found))
}

fn nobody() -> Refusal {
    let remedy = "switch the devices on, plug the cable into this interface, and set it up";
    Refusal::new("interface", "no device answers", remedy)
}

fn unreadable(why: &str) -> Refusal {
    let what = format!("devices answer, and what they say of themselves cannot be used ({why})");
    let remedy = "look at cables and plugs, and compare the devices' information memories with \
                  their makers'";
    Refusal::new("interface", what, remedy)
}

/// Opens a segment.
pub(crate) fn open(port: Box<dyn Port>, config: &Config) -> Result<Ready, Refusal> {
    let step_wait = Nanos::from_millis(i64::from(config.open_wait_ms));
    let limit = step_wait * (4 + config.devices.len() as i64);
    let mut master = Master::new(port, step_wait)
        .ok_or_else(|| Refusal::new("interface", "no frames are left", "open it once"))?;
    let (group, found) = scan(&mut master, limit)?;
    compare(config, &found)?;
    let device = master.device();
    let prepared = master.set_up(limit, prepare(device, &group, config));
    let prepared = prepared.map_err(|error| describe(error, &found))?;
    if let Some(position) = prepared.without_clock {
        let what = format!("the drive at position {position} has no distributed clock");
        return Err(Refusal::new("sync", what, "leave `sync` out"));
    }
    for (facts, listed) in prepared.drives.iter().zip(drives(config)) {
        check_mode(facts, listed)?;
    }
    let mut wiring = Wiring::new(config, &prepared.data)?;
    let group = master.set_up(limit, rehearse(device, group));
    let group = group.map_err(|error| describe(error, &found))?;
    wiring.counter = group.iter(device).map(|one| counter(&one)).sum();
    check_frame(config, group.iter(device).map(|one| image_bytes(&one)))?;
    Ok(Ready { master, group, wiring, drives: prepared.drives })
}

/// What a device adds to the working counter of an exchange.
fn counter(one: &SubDeviceRef<'_, SubDevicePdi<'_, IMAGE_BYTES_MAX, DefaultLock>>) -> u16 {
    let image = one.io_raw();
    u16::from(!image.inputs().is_empty()) + 2 * u16::from(!image.outputs().is_empty())
}

/// Bytes of a device in the image.
fn image_bytes(one: &SubDeviceRef<'_, SubDevicePdi<'_, IMAGE_BYTES_MAX, DefaultLock>>) -> usize {
    let image = one.io_raw();
    image.inputs().len() + image.outputs().len()
}

/// Nobody sends a second frame of an exchange before the first one has been collected.
fn check_frame(config: &Config, images: impl Iterator<Item = usize>) -> Result<(), Refusal> {
    let time_bytes = config.sync.map_or(0, |_| DATAGRAM_OVERHEAD_BYTES + size_of::<u64>());
    let state_bytes = DATAGRAM_OVERHEAD_BYTES + size_of::<u16>();
    let of_devices = images.map(|bytes| bytes + state_bytes).sum::<usize>();
    let bytes = time_bytes + DATAGRAM_OVERHEAD_BYTES + of_devices;
    if config.exchange != ExchangeTimes::Pipelined || bytes <= FRAME_PAYLOAD_BYTES {
        return Ok(());
    }
    let count = config.devices.len();
    let what = format!(
        "process data and states of {count} devices are {bytes} bytes, a frame has \
         {FRAME_PAYLOAD_BYTES}"
    );
    Err(Refusal::new("exchange", what, "give `once` or `twice`, which wait for several frames"))
}

fn drives(config: &Config) -> impl Iterator<Item = &DeviceConfig> {
    config.devices.iter().filter(|device| device.kind == Kind::Drive)
}

fn check_mode(facts: &DriveFacts, listed: &DeviceConfig) -> Result<(), Refusal> {
    let mode = listed.mode.cyclic();
    if facts.supported_modes != 0 && !mode.is_supported(facts.supported_modes) {
        let what = format!(
            "the drive at position {} does not know the mode {} (object 0x6502 is {:#x})",
            facts.device,
            mode.name(),
            facts.supported_modes
        );
        return Err(Refusal::new("devices", what, "give another `mode`"));
    }
    if listed.mode == DriveMode::Torque
        && listed.code_max.is_none()
        && facts.torque_max_permille == 0
    {
        let what = format!("the drive at position {} states no highest torque", facts.device);
        return Err(Refusal::new("devices", what, "give `code_max`, in 0.1 % of the rated torque"));
    }
    Ok(())
}

fn describe(error: SetupError<DeviceError>, found: &[DeviceIdentity]) -> Refusal {
    let DeviceError { position, doing, error } = match error {
        SetupError::Refused(error) => error,
        SetupError::Endless => return unreadable("their set-up does not end"),
        SetupError::Unreadable(why) => return unreadable(&why),
        SetupError::Silence => {
            let what = "the devices fell silent while they were set up";
            let remedy = "look at cables and supply, or give a longer `open_wait_ms`";
            return Refusal::new("interface", what, remedy);
        }
    };
    let name = found.get(position).map_or("", |one| one.name.as_str());
    let what = format!("position {position} (`{name}`): {doing} failed ({error})");
    let remedy = "compare its settings with the section, and read its own error display";
    Refusal::new("devices", what, remedy)
}

/// Sets the devices up in PREOP and learns where their process data lie.
async fn prepare(
    device: &'static MainDevice<'static>,
    group: &Group<PreOp>,
    config: &Config,
) -> Result<Prepared, DeviceError> {
    let mut prepared = Prepared::default();
    for (position, listed) in config.devices.iter().enumerate() {
        let failed = |doing| move |error| DeviceError { position, doing, error };
        let one = group.subdevice(device, position).map_err(failed("looking it up"))?;
        if listed.kind == Kind::Drive {
            if listed.map {
                map_drive(&one, listed.mode).await.map_err(failed("mapping its process data"))?;
            }
            set_mode(&one, listed, config).await.map_err(failed("setting its mode"))?;
            prepared.drives.push(facts(position, &one).await);
            if let Some(shift) = config.sync_shift() {
                if !one.dc_support().any() {
                    prepared.without_clock.get_or_insert(position);
                    continue;
                }
                let done = set_sync(&one, config.period(), shift).await;
                done.map_err(failed("setting its clock"))?;
            }
        }
        let data = process_data(&one, listed.kind).await;
        let data = data.map_err(failed("reading its process data"))?;
        if listed.kind != Kind::Ek1100 {
            set_watchdog(&one, config.watchdog_ms).await.map_err(failed("setting its watchdog"))?;
        }
        prepared.data.push(data);
    }
    Ok(prepared)
}

async fn map_drive(one: &SubDeviceRef<'_, &SubDevice>, mode: DriveMode) -> Result<(), Error> {
    let outputs = [Object::CONTROL_WORD, mode.cyclic().target(), Object::OPERATION_MODE];
    let inputs = [
        Object::STATUS_WORD,
        Object::ACTUAL_POSITION,
        Object::ACTUAL_VELOCITY,
        Object::ACTUAL_TORQUE,
        Object::ERROR_CODE,
        Object::OPERATION_MODE_DISPLAY,
    ];
    map(one, 0x1c12, 0x1600, &outputs).await?;
    map(one, 0x1c13, 0x1a00, &inputs).await
}

/// Assigns one process data object with these entries.
async fn map(
    one: &SubDeviceRef<'_, &SubDevice>,
    assignment: u16,
    pdo: u16,
    objects: &[Object],
) -> Result<(), Error> {
    one.sdo_write(assignment, 0, 0_u8).await?;
    one.sdo_write(pdo, 0, 0_u8).await?;
    for (number, object) in (1_u8..).zip(objects) {
        one.sdo_write(pdo, number, object.mapping()).await?;
    }
    one.sdo_write(pdo, 0, objects.len() as u8).await?;
    one.sdo_write(assignment, 1, pdo).await?;
    one.sdo_write(assignment, 0, 1_u8).await
}

async fn set_mode(
    one: &SubDeviceRef<'_, &SubDevice>,
    listed: &DeviceConfig,
    config: &Config,
) -> Result<(), Error> {
    let Object { index, sub, .. } = Object::OPERATION_MODE;
    one.sdo_write(index, sub, listed.mode.cyclic().code()).await?;
    let period = Nanos::from_micros(i64::from(config.period_us));
    if let Some(period) = InterpolationPeriod::from_nanos(period)
        && listed.mode != DriveMode::Torque
    {
        let (value, exponent) = (Object::INTERPOLATION_VALUE, Object::INTERPOLATION_EXPONENT);
        one.sdo_write(value.index, value.sub, period.value).await?;
        one.sdo_write(exponent.index, exponent.sub, period.exponent).await?;
    }
    Ok(())
}

/// What a drive says of itself; an object that it does not have is 0.
async fn facts(position: usize, one: &SubDeviceRef<'_, &SubDevice>) -> DriveFacts {
    let Object { index: rated, .. } = Object::RATED_TORQUE;
    let Object { index: most, .. } = Object::TORQUE_MAX;
    let Object { index: modes, .. } = Object::SUPPORTED_MODES;
    let Object { index: stop, .. } = Object::QUICK_STOP_OPTION;
    DriveFacts {
        device: position,
        rated_torque_mnm: one.sdo_read(rated, 0).await.unwrap_or(0),
        torque_max_permille: one.sdo_read(most, 0).await.unwrap_or(0),
        supported_modes: one.sdo_read(modes, 0).await.unwrap_or(0),
        quick_stop_option: one.sdo_read(stop, 0).await.unwrap_or(0),
    }
}

impl DriveFacts {
    pub(crate) fn quick_stop(&self) -> QuickStopOption {
        QuickStopOption::from_code(self.quick_stop_option)
    }
}

/// Starts SYNC0 of a device: at `shift` after the places of the frames, which are the whole cycles
/// of the segment's time.
async fn set_sync(
    one: &SubDeviceRef<'_, &SubDevice>,
    cycle: Nanos,
    shift: Nanos,
) -> Result<(), Error> {
    one.register_write(SYNC_ACTIVATION_ADDRESS, 0_u8).await?;
    let now_ns: u64 = one.register_read(SYSTEM_TIME_ADDRESS).await?;
    let cycle_ns = cycle.0.unsigned_abs();
    let places = now_ns.saturating_add(SYNC_LEAD_NS) / cycle_ns + 1;
    let start_ns = places * cycle_ns + shift.0.unsigned_abs();
    one.register_write(SYNC_START_ADDRESS, start_ns).await?;
    let cycle_ns = u32::try_from(cycle_ns).unwrap_or(u32::MAX);
    one.register_write(SYNC_CYCLE_ADDRESS, cycle_ns).await?;
    one.register_write(SYNC_ACTIVATION_ADDRESS, SYNC_ACTIVATION_WORD).await?;
    Ok(())
}

async fn set_watchdog(one: &SubDeviceRef<'_, &SubDevice>, watchdog_ms: u32) -> Result<(), Error> {
    let units = watchdog_ms.saturating_mul(u32::from(WATCHDOG_UNITS_PER_MS));
    let units = u16::try_from(units).unwrap_or(u16::MAX);
    one.register_write(WATCHDOG_DIVIDER_ADDRESS, WATCHDOG_DIVIDER).await?;
    one.register_write(OUTPUT_WATCHDOG_ADDRESS, units).await?;
    Ok(())
}

/// Where the objects of a device lie in its process data.
async fn process_data(
    one: &SubDeviceRef<'_, &SubDevice>,
    kind: Kind,
) -> Result<ProcessData, Error> {
    let lines = |first: u16| {
        let line = |bit: usize| {
            let index = first + 0x10 * bit as u16;
            MappedObject { index, subindex: 1, bit, bits: 1 }
        };
        (0..DIGITAL_LINES).map(line).collect::<Vec<MappedObject>>()
    };
    match kind {
        Kind::Ek1100 | Kind::Other => Ok(ProcessData::default()),
        Kind::El1008 => Ok(ProcessData { inputs: lines(0x6000), outputs: Vec::new() }),
        Kind::El2008 => Ok(ProcessData { outputs: lines(0x7000), inputs: Vec::new() }),
        _ => Ok(ProcessData {
            outputs: mapped_objects(one, 0x1c12).await?,
            inputs: mapped_objects(one, 0x1c13).await?,
        }),
    }
}

/// The objects that an assignment maps.
async fn mapped_objects(
    one: &SubDeviceRef<'_, &SubDevice>,
    assignment: u16,
) -> Result<Vec<MappedObject>, Error> {
    let mut all = Vec::new();
    let mut bit = 0;
    let pdos: u8 = one.sdo_read(assignment, 0).await?;
    for number in 1..=pdos.min(MAPPED_OBJECTS_MAX) {
        let pdo: u16 = one.sdo_read(assignment, number).await?;
        let entries: u8 = one.sdo_read(pdo, 0).await?;
        for number in 1..=entries.min(MAPPED_OBJECTS_MAX) {
            let entry: u32 = one.sdo_read(pdo, number).await?;
            let (index, subindex, bits) = ((entry >> 16) as u16, (entry >> 8) as u8, entry as u8);
            all.push(MappedObject { index, subindex, bit, bits });
            bit += usize::from(bits);
        }
    }
    Ok(all)
}

/// Leads the devices to OP and back to SAFEOP: what they refuse is known before a lane begins.
async fn rehearse(
    device: &'static MainDevice<'static>,
    group: Box<Group<PreOp>>,
) -> Result<Box<Group<SafeOp>>, DeviceError> {
    let failed = |doing| move |error| DeviceError { position: 0, doing, error };
    let group = (*group).into_safe_op(device).await.map_err(failed("the way to SAFEOP"))?;
    group.tx_rx(device).await.map_err(failed("the first exchange"))?;
    let group = group.request_into_op(device).await.map_err(failed("the way to OP"))?;
    loop {
        let answer = group.tx_rx(device).await.map_err(failed("an exchange"))?;
        if answer.all_op() {
            break;
        }
        for (position, one) in group.iter(device).enumerate() {
            // A device that refuses says why.
            let status = one.status().await;
            status.map_err(|error| DeviceError { position, doing: "the way to OP", error })?;
        }
    }
    let group = group.into_safe_op(device).await.map_err(failed("the way back to SAFEOP"))?;
    Ok(Box::new(group))
}
