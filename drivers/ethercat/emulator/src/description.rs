//! What the devices of a segment are: identity, sync managers, process data and objects of each
//! model. The numbers of the terminals are those of their maker's device descriptions.

/// Bytes of a mailbox in each direction.
pub(crate) const MAILBOX_BYTES: u16 = 128;
/// Where the mailbox that the host writes begins.
pub(crate) const MAILBOX_OUT_ADDRESS: u16 = 0x1000;
/// Where the mailbox that the host reads begins.
pub(crate) const MAILBOX_IN_ADDRESS: u16 = MAILBOX_OUT_ADDRESS + MAILBOX_BYTES;
/// Where process data to a device with a mailbox begin.
const OUTPUTS_ADDRESS: u16 = 0x1100;
/// Where process data from a device with a mailbox begin.
const INPUTS_ADDRESS: u16 = 0x1180;
/// Vendor of the terminals.
pub(crate) const BECKHOFF_VENDOR_ID: u32 = 2;
/// Vendor of the emulated drives: a number that is reserved for tests.
pub const DRIVE_VENDOR_ID: u32 = 0x0000_0ffe;
/// Product of the emulated drives.
pub const DRIVE_PRODUCT_ID: u32 = 0x0000_0402;
/// Analog outputs of an EL4134.
pub(crate) const ANALOG_CHANNELS: u16 = 4;
/// Lines of a digital terminal.
pub(crate) const DIGITAL_LINES: u16 = 8;
/// Rated torque of a drive (mNm), object 0x6076.
pub const RATED_TORQUE_MNM: u32 = 1_270;
/// Highest torque of a drive (0.1 % of the rated one), object 0x6072.
pub const TORQUE_MAX_PERMILLE: u16 = 3_000;

/// Models of devices.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Model {
    /// The coupler EK1100.
    Coupler,
    /// The terminal EL1008 with eight digital inputs.
    DigitalInput,
    /// The terminal EL2008 with eight digital outputs.
    DigitalOutput,
    /// The terminal EL4134 with four outputs of -10 to 10 V and 16 bits.
    AnalogOutput,
    /// The terminal EL3104 with four inputs of -10 to 10 V and 16 bits.
    AnalogInput,
    /// The terminal EL5101, an encoder of 16 bits.
    Encoder16,
    /// The terminal EL5151, an encoder of 32 bits.
    Encoder32,
    /// A drive by CiA 402.
    Drive,
}

impl Model {
    /// All models, in the order of their declaration.
    pub const ALL: [Model; 8] = [
        Model::Coupler,
        Model::DigitalInput,
        Model::DigitalOutput,
        Model::AnalogOutput,
        Model::AnalogInput,
        Model::Encoder16,
        Model::Encoder32,
        Model::Drive,
    ];

    /// Its name on a command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Model::Coupler => "ek1100",
            Model::DigitalInput => "el1008",
            Model::DigitalOutput => "el2008",
            Model::AnalogOutput => "el4134",
            Model::AnalogInput => "el3104",
            Model::Encoder16 => "el5101",
            Model::Encoder32 => "el5151",
            Model::Drive => "drive",
        }
    }

    /// The model of a name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Model> {
        Model::ALL.into_iter().find(|model| model.name() == name)
    }
}

/// What a sync manager is for, by the numbers of the device information.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Purpose {
    MailboxOut = 1,
    MailboxIn = 2,
    Outputs = 3,
    Inputs = 4,
}

/// A sync manager as the device information describes it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct SyncManager {
    pub(crate) address: u16,
    pub(crate) length: u16,
    pub(crate) control: u8,
    pub(crate) purpose: Purpose,
}

/// One object within process data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Entry {
    pub(crate) index: u16,
    pub(crate) subindex: u8,
    pub(crate) bits: u8,
}

impl Entry {
    const fn new(index: u16, subindex: u8, bits: u8) -> Entry {
        Entry { index, subindex, bits }
    }
}

/// A process data object.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Pdo {
    pub(crate) index: u16,
    pub(crate) entries: Vec<Entry>,
}

/// An object of the dictionary that is no process data.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Object {
    pub(crate) index: u16,
    pub(crate) subindex: u8,
    pub(crate) bytes: Vec<u8>,
}

/// A device of a segment before it is powered on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Description {
    /// The model.
    pub model: Model,
    /// Vendor in the device information.
    pub vendor: u32,
    /// Product in the device information.
    pub product: u32,
    /// Revision in the device information.
    pub revision: u32,
    /// Station alias; 0 for none.
    pub alias: u16,
    pub(crate) order: &'static str,
    pub(crate) has_mailbox: bool,
    pub(crate) sync_managers: Vec<SyncManager>,
    /// Process data to the device.
    pub(crate) outputs: Vec<Pdo>,
    /// Process data from the device.
    pub(crate) inputs: Vec<Pdo>,
    pub(crate) objects: Vec<Object>,
}

impl From<Model> for Description {
    fn from(model: Model) -> Description {
        let (product, revision, order) = match model {
            Model::Coupler => (0x044c_2c52, 0x0011_0000, "EK1100"),
            Model::DigitalInput => (0x03f0_3052, 0x0011_0000, "EL1008"),
            Model::DigitalOutput => (0x07d8_3052, 0x0011_0000, "EL2008"),
            Model::AnalogOutput => (0x1026_3052, 0x03fa_0000, "EL4134"),
            Model::AnalogInput => (0x0c20_3052, 0x0013_0000, "EL3104"),
            Model::Encoder16 => (0x13ed_3052, 0x03ff_0000, "EL5101"),
            Model::Encoder32 => (0x141f_3052, 0x0014_0000, "EL5151"),
            Model::Drive => (DRIVE_PRODUCT_ID, 0x0001_0000, "TK402"),
        };
        let is_drive = model == Model::Drive;
        let vendor = if is_drive { DRIVE_VENDOR_ID } else { BECKHOFF_VENDOR_ID };
        let plain = [Model::Coupler, Model::DigitalInput, Model::DigitalOutput];
        Description {
            model,
            vendor,
            product,
            revision,
            alias: 0,
            order,
            has_mailbox: !plain.contains(&model),
            sync_managers: sync_managers(model),
            outputs: outputs(model),
            inputs: inputs(model),
            objects: if is_drive { drive_objects() } else { Vec::new() },
        }
    }
}

impl Description {
    /// The same device with another product and revision, as if somebody had plugged in another
    /// one.
    #[must_use]
    pub fn with_identity(mut self, product: u32, revision: u32) -> Description {
        (self.product, self.revision) = (product, revision);
        self
    }

    /// The same device with one more object in its dictionary, or another value of one.
    #[must_use]
    pub fn with_object(mut self, index: u16, subindex: u8, bytes: &[u8]) -> Description {
        self.objects.push(Object { index, subindex, bytes: bytes.to_vec() });
        self
    }

    /// The same device with a station alias.
    #[must_use]
    pub fn with_alias(mut self, alias: u16) -> Description {
        self.alias = alias;
        self
    }
}

fn sync_managers(model: Model) -> Vec<SyncManager> {
    let manager =
        |address, length, control, purpose| SyncManager { address, length, control, purpose };
    match model {
        Model::Coupler => Vec::new(),
        Model::DigitalInput => vec![manager(0x1000, 1, 0x20, Purpose::Inputs)],
        Model::DigitalOutput => vec![manager(0x0f00, 1, 0x44, Purpose::Outputs)],
        _ => vec![
            manager(MAILBOX_OUT_ADDRESS, MAILBOX_BYTES, 0x26, Purpose::MailboxOut),
            manager(MAILBOX_IN_ADDRESS, MAILBOX_BYTES, 0x22, Purpose::MailboxIn),
            manager(OUTPUTS_ADDRESS, bytes(&outputs(model)), 0x64, Purpose::Outputs),
            manager(INPUTS_ADDRESS, bytes(&inputs(model)), 0x20, Purpose::Inputs),
        ],
    }
}

/// Bytes of process data.
fn bytes(pdos: &[Pdo]) -> u16 {
    let bits: u16 = pdos.iter().flat_map(|pdo| &pdo.entries).map(|one| u16::from(one.bits)).sum();
    bits.div_ceil(8)
}

/// Process data objects of one entry each, at `first + step n`.
fn pdos_each(count: u16, first: u16, step: u16, entry: impl Fn(u16) -> Entry) -> Vec<Pdo> {
    (0..count).map(|n| Pdo { index: first + step * n, entries: vec![entry(0x10 * n)] }).collect()
}

fn outputs(model: Model) -> Vec<Pdo> {
    let one = |entries: &[Entry]| vec![Pdo { index: 0x1600, entries: entries.to_vec() }];
    match model {
        Model::Coupler | Model::DigitalInput | Model::AnalogInput => Vec::new(),
        Model::DigitalOutput => {
            pdos_each(DIGITAL_LINES, 0x1600, 1, |place| Entry::new(0x7000 + place, 1, 1))
        }
        Model::AnalogOutput => {
            pdos_each(ANALOG_CHANNELS, 0x1600, 1, |place| Entry::new(0x7000 + place, 0x11, 16))
        }
        Model::Encoder16 => one(&[Entry::new(0x7000, 1, 8), Entry::new(0x7000, 2, 16)]),
        Model::Encoder32 => one(&[
            Entry::new(0x7000, 1, 1),
            Entry::new(0x7000, 2, 1),
            Entry::new(0x7000, 3, 1),
            Entry::new(0x7000, 4, 1),
            Entry::new(0, 0, 12),
            Entry::new(0x7000, 0x11, 32),
        ]),
        Model::Drive => one(&[
            Entry::new(0x6040, 0, 16),
            Entry::new(0x607a, 0, 32),
            Entry::new(0x60ff, 0, 32),
            Entry::new(0x6071, 0, 16),
            Entry::new(0x6060, 0, 8),
        ]),
    }
}

fn inputs(model: Model) -> Vec<Pdo> {
    let one = |entries: &[Entry]| vec![Pdo { index: 0x1a00, entries: entries.to_vec() }];
    match model {
        Model::Coupler | Model::DigitalOutput | Model::AnalogOutput => Vec::new(),
        Model::DigitalInput => {
            pdos_each(DIGITAL_LINES, 0x1a00, 1, |place| Entry::new(0x6000 + place, 1, 1))
        }
        Model::AnalogInput => (0..ANALOG_CHANNELS)
            .map(|n| {
                let place = 0x6000 + 0x10 * n;
                let entries = vec![Entry::new(place, 1, 16), Entry::new(place, 0x11, 16)];
                Pdo { index: 0x1a00 + 2 * n, entries }
            })
            .collect(),
        Model::Encoder16 => {
            one(&[Entry::new(0x6000, 1, 8), Entry::new(0x6000, 2, 16), Entry::new(0x6000, 3, 16)])
        }
        Model::Encoder32 => one(&[
            Entry::new(0x6000, 1, 16),
            Entry::new(0x6000, 0x11, 32),
            Entry::new(0x6000, 0x12, 32),
        ]),
        Model::Drive => one(&[
            Entry::new(0x6041, 0, 16),
            Entry::new(0x6064, 0, 32),
            Entry::new(0x606c, 0, 32),
            Entry::new(0x6077, 0, 16),
            Entry::new(0x603f, 0, 16),
            Entry::new(0x6061, 0, 8),
        ]),
    }
}

/// Settings and limits of a drive that are not process data.
fn drive_objects() -> Vec<Object> {
    let object = |index, subindex, bytes: &[u8]| Object { index, subindex, bytes: bytes.to_vec() };
    vec![
        object(0x605a, 0, &2_i16.to_le_bytes()),
        object(0x6072, 0, &TORQUE_MAX_PERMILLE.to_le_bytes()),
        object(0x6076, 0, &RATED_TORQUE_MNM.to_le_bytes()),
        object(0x608f, 0, &[2]),
        object(0x608f, 1, &4_000_u32.to_le_bytes()),
        object(0x608f, 2, &1_u32.to_le_bytes()),
        object(0x60c2, 0, &[2]),
        object(0x60c2, 1, &[1]),
        object(0x60c2, 2, &[0xfd]),
        object(0x6502, 0, &0x0000_0380_u32.to_le_bytes()),
    ]
}
