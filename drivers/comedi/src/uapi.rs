//! Declares what the kernel's header `include/uapi/linux/comedi.h` declares: structures as they lie
//! in memory, request numbers computed from their sizes, and the constants that the driver uses. An
//! address stands as an integer here; pointers are made in [`device`](crate::device) only.

/// Bytes of the names of driver and board, the closing zero included.
pub(crate) const NAME_BYTES: usize = 20;

/// Who is attached: `struct comedi_devinfo`.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub(crate) struct DevInfo {
    pub(crate) version_code: u32,
    pub(crate) subdevices: u32,
    pub(crate) driver_name: [u8; NAME_BYTES],
    pub(crate) board_name: [u8; NAME_BYTES],
    pub(crate) read_subdevice: i32,
    pub(crate) write_subdevice: i32,
    pub(crate) unused: [i32; 30],
}

/// One subdevice: `struct comedi_subdinfo`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SubdInfo {
    pub(crate) kind: u32,
    pub(crate) channels: u32,
    pub(crate) flags: u32,
    pub(crate) timer_type: u32,
    pub(crate) channel_list_length: u32,
    pub(crate) maxdata: u32,
    pub(crate) channel_flags: u32,
    pub(crate) range_type: u32,
    pub(crate) settling_time_ns: u32,
    pub(crate) bits_support: u32,
    pub(crate) unused: [u32; 8],
}

/// Where the kernel puts what differs between channels: `struct comedi_chaninfo`.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub(crate) struct ChanInfo {
    pub(crate) subdevice: u32,
    pub(crate) maxdata_list: usize,
    pub(crate) flag_list: usize,
    pub(crate) range_list: usize,
    pub(crate) unused: [u32; 4],
}

/// Where the kernel puts the ranges of a range type: `struct comedi_rangeinfo`.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub(crate) struct RangeInfo {
    pub(crate) range_type: u32,
    pub(crate) ranges: usize,
}

/// One range in millionths of its unit: `struct comedi_krange`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct KernelRange {
    pub(crate) min_millionths: i32,
    pub(crate) max_millionths: i32,
    pub(crate) flags: u32,
}

/// One instruction: `struct comedi_insn`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Insn {
    pub(crate) kind: u32,
    pub(crate) words: u32,
    pub(crate) data: usize,
    pub(crate) subdevice: u32,
    pub(crate) channel: u32,
    pub(crate) unused: [u32; 3],
}

/// A list of instructions: `struct comedi_insnlist`.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub(crate) struct InsnList {
    pub(crate) instructions: u32,
    pub(crate) first: usize,
}

/// The letter of all requests.
const REQUEST_TYPE_BYTE: u32 = b'd' as u32;
/// The kernel writes: the direction of a request by the kernel's `_IOR`.
const DIRECTION_READ_BITS: u32 = 2 << 30;

/// `_IO('d', number)`.
const fn plain(number: u32) -> u32 {
    REQUEST_TYPE_BYTE << 8 | number
}

/// `_IOR('d', number, T)`.
const fn reading<T>(number: u32) -> u32 {
    DIRECTION_READ_BITS | (size_of::<T>() as u32) << 16 | plain(number)
}

/// `COMEDI_DEVINFO`.
pub(crate) const DEVINFO_REQUEST: u32 = reading::<DevInfo>(1);
/// `COMEDI_SUBDINFO`; its argument is an array, one entry a subdevice.
pub(crate) const SUBDINFO_REQUEST: u32 = reading::<SubdInfo>(2);
/// `COMEDI_CHANINFO`.
pub(crate) const CHANINFO_REQUEST: u32 = reading::<ChanInfo>(3);
/// `COMEDI_LOCK`; its argument is the number of a subdevice.
pub(crate) const LOCK_REQUEST: u32 = plain(5);
/// `COMEDI_RANGEINFO`.
pub(crate) const RANGEINFO_REQUEST: u32 = reading::<RangeInfo>(8);
/// `COMEDI_INSNLIST`.
pub(crate) const INSNLIST_REQUEST: u32 = reading::<InsnList>(11);

#[cfg(target_pointer_width = "64")]
const _: () = {
    assert!(size_of::<DevInfo>() == 176 && DEVINFO_REQUEST == 0x80b0_6401);
    assert!(size_of::<SubdInfo>() == 72 && SUBDINFO_REQUEST == 0x8048_6402);
    assert!(size_of::<ChanInfo>() == 48 && CHANINFO_REQUEST == 0x8030_6403);
    assert!(size_of::<RangeInfo>() == 16 && RANGEINFO_REQUEST == 0x8010_6408);
    assert!(size_of::<InsnList>() == 16 && INSNLIST_REQUEST == 0x8010_640b);
    assert!(size_of::<Insn>() == 40 && reading::<Insn>(12) == 0x8028_640c);
    assert!(size_of::<KernelRange>() == 12 && LOCK_REQUEST == 0x6405);
};

/// Flag of a subdevice: the largest sample differs between channels.
pub(crate) const MAXDATA_PER_CHANNEL_FLAG: u32 = 0x0010;
/// Flag of a subdevice: the ranges differ between channels.
pub(crate) const RANGES_PER_CHANNEL_FLAG: u32 = 0x0040;
/// Flags of a subdevice: the analog references that it can take, ground first, in the order of
/// their numbers.
pub(crate) const REFERENCE_FLAGS: [u32; 4] = [0x0010_0000, 0x0020_0000, 0x0040_0000, 0x0080_0000];

/// Kinds of subdevices: `enum comedi_subdevice_type`.
pub(crate) const SUBDEVICE_KINDS: [&str; 13] = [
    "unused",
    "analog input",
    "analog output",
    "digital input",
    "digital output",
    "digital input/output",
    "counter",
    "timer",
    "memory",
    "calibration",
    "processor",
    "serial",
    "PWM",
];
/// A/D converters.
pub(crate) const ANALOG_IN_KIND: u32 = 1;
/// D/A converters.
pub(crate) const ANALOG_OUT_KIND: u32 = 2;
/// Lines to the computer.
pub(crate) const DIGITAL_IN_KIND: u32 = 3;
/// Lines from the computer.
pub(crate) const DIGITAL_OUT_KIND: u32 = 4;
/// Lines whose direction is chosen.
pub(crate) const DIGITAL_IO_KIND: u32 = 5;
/// Counters.
pub(crate) const COUNTER_KIND: u32 = 6;

/// `INSN_READ`.
pub(crate) const READ_INSTRUCTION: u32 = 0x0400_0000;
/// `INSN_WRITE`.
pub(crate) const WRITE_INSTRUCTION: u32 = 0x0800_0001;
/// `INSN_BITS`: mask and levels of up to 32 lines, answered by their levels.
pub(crate) const BITS_INSTRUCTION: u32 = 0x0c00_0002;
/// `INSN_CONFIG`; the first word says what is configured.
pub(crate) const CONFIG_INSTRUCTION: u32 = 0x0c00_0003;

/// `INSN_CONFIG_DIO_INPUT`.
pub(crate) const LINE_INPUT_CONFIG: u32 = 0;
/// `INSN_CONFIG_DIO_OUTPUT`.
pub(crate) const LINE_OUTPUT_CONFIG: u32 = 1;
/// `INSN_CONFIG_DIO_QUERY`: answered by 0 for an input, 1 for an output.
pub(crate) const LINE_QUERY_CONFIG: u32 = 28;
/// `INSN_CONFIG_ARM`.
pub(crate) const ARM_CONFIG: u32 = 31;
/// `INSN_CONFIG_RESET`.
pub(crate) const RESET_CONFIG: u32 = 34;
/// `INSN_CONFIG_GPCT_QUADRATURE_ENCODER`.
pub(crate) const QUADRATURE_CONFIG: u32 = 1003;
/// `INSN_CONFIG_SET_GATE_SRC`.
pub(crate) const GATE_SOURCE_CONFIG: u32 = 2001;
/// `INSN_CONFIG_SET_OTHER_SRC`.
pub(crate) const OTHER_SOURCE_CONFIG: u32 = 2005;
/// `INSN_CONFIG_SET_COUNTER_MODE`.
pub(crate) const COUNTER_MODE_CONFIG: u32 = 4097;

/// `NI_GPCT_DISABLED_GATE_SELECT`.
pub(crate) const GATE_DISABLED_SELECT: u32 = 0x8000;
/// `NI_GPCT_ARM_IMMEDIATE`.
pub(crate) const ARM_AT_ONCE_SELECT: u32 = 0;
/// `NI_GPCT_COUNTING_MODE_QUADRATURE_X4_BITS | NI_GPCT_COUNTING_DIRECTION_HW_UP_DOWN_BITS`: every
/// edge of both tracks counts, their order gives the direction.
pub(crate) const QUADRATURE_MODE_BITS: u32 = 3 << 16 | 2 << 24;

/// The unit of a range is volts; in the low byte of the range's flags.
pub(crate) const VOLTS_UNIT: u32 = 0;
/// The byte of a range's flags that holds the unit.
pub(crate) const UNIT_MASK_BITS: u32 = 0xff;
/// A range whose numbers are multiples of an external reference (`RF_EXTERNAL`).
pub(crate) const EXTERNAL_REFERENCE_FLAG: u32 = 0x100;

/// Channel, range and analog reference in one word (`CR_PACK`).
pub(crate) const fn channel_word(channel: u16, range: u8, reference: u8) -> u32 {
    (reference as u32 & 3) << 24 | (range as u32) << 16 | channel as u32
}

#[cfg(test)]
mod tests;
