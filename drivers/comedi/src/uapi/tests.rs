//! Compares the driver's structures and numbers with the kernel's header, as a C compiler reads it
//! on this machine. Says on its output when there is no compiler or no header here.

use std::io::Write;
use std::mem::offset_of;
use std::process::Command;

use super::*;

/// Requests and structures: expressions of the header, and what the driver takes them to be.
fn layout() -> Vec<(&'static str, u64)> {
    vec![
        ("COMEDI_DEVINFO", DEVINFO_REQUEST as u64),
        ("COMEDI_SUBDINFO", SUBDINFO_REQUEST as u64),
        ("COMEDI_CHANINFO", CHANINFO_REQUEST as u64),
        ("COMEDI_LOCK", LOCK_REQUEST as u64),
        ("COMEDI_RANGEINFO", RANGEINFO_REQUEST as u64),
        ("COMEDI_INSNLIST", INSNLIST_REQUEST as u64),
        ("COMEDI_INSN", reading::<Insn>(12) as u64),
        ("COMEDI_MAJOR", crate::device::COMEDI_MAJOR_NUMBER),
        ("COMEDI_NAMELEN", NAME_BYTES as u64),
        ("sizeof(struct comedi_krange)", size_of::<KernelRange>() as u64),
        ("offsetof(struct comedi_devinfo, n_subdevs)", offset_of!(DevInfo, subdevices) as u64),
        ("offsetof(struct comedi_devinfo, driver_name)", offset_of!(DevInfo, driver_name) as u64),
        ("offsetof(struct comedi_devinfo, board_name)", offset_of!(DevInfo, board_name) as u64),
        (
            "offsetof(struct comedi_devinfo, read_subdevice)",
            offset_of!(DevInfo, read_subdevice) as u64,
        ),
        ("offsetof(struct comedi_subdinfo, type)", offset_of!(SubdInfo, kind) as u64),
        ("offsetof(struct comedi_subdinfo, n_chan)", offset_of!(SubdInfo, channels) as u64),
        ("offsetof(struct comedi_subdinfo, subd_flags)", offset_of!(SubdInfo, flags) as u64),
        ("offsetof(struct comedi_subdinfo, maxdata)", offset_of!(SubdInfo, maxdata) as u64),
        ("offsetof(struct comedi_subdinfo, range_type)", offset_of!(SubdInfo, range_type) as u64),
        (
            "offsetof(struct comedi_chaninfo, maxdata_list)",
            offset_of!(ChanInfo, maxdata_list) as u64,
        ),
        ("offsetof(struct comedi_chaninfo, flaglist)", offset_of!(ChanInfo, flag_list) as u64),
        ("offsetof(struct comedi_chaninfo, rangelist)", offset_of!(ChanInfo, range_list) as u64),
        ("offsetof(struct comedi_rangeinfo, range_ptr)", offset_of!(RangeInfo, ranges) as u64),
        ("offsetof(struct comedi_krange, max)", offset_of!(KernelRange, max_millionths) as u64),
        ("offsetof(struct comedi_krange, flags)", offset_of!(KernelRange, flags) as u64),
        ("offsetof(struct comedi_insn, insn)", offset_of!(Insn, kind) as u64),
        ("offsetof(struct comedi_insn, n)", offset_of!(Insn, words) as u64),
        ("offsetof(struct comedi_insn, data)", offset_of!(Insn, data) as u64),
        ("offsetof(struct comedi_insn, subdev)", offset_of!(Insn, subdevice) as u64),
        ("offsetof(struct comedi_insn, chanspec)", offset_of!(Insn, channel) as u64),
        ("offsetof(struct comedi_insnlist, insns)", offset_of!(InsnList, first) as u64),
    ]
}

/// Constants of the header, and what the driver takes them to be.
fn constants() -> Vec<(&'static str, u64)> {
    vec![
        ("SDF_MAXDATA", MAXDATA_PER_CHANNEL_FLAG as u64),
        ("SDF_RANGETYPE", RANGES_PER_CHANNEL_FLAG as u64),
        ("SDF_GROUND", REFERENCE_FLAGS[0] as u64),
        ("SDF_COMMON", REFERENCE_FLAGS[1] as u64),
        ("SDF_DIFF", REFERENCE_FLAGS[2] as u64),
        ("SDF_OTHER", REFERENCE_FLAGS[3] as u64),
        ("COMEDI_SUBD_AI", ANALOG_IN_KIND as u64),
        ("COMEDI_SUBD_AO", ANALOG_OUT_KIND as u64),
        ("COMEDI_SUBD_DI", DIGITAL_IN_KIND as u64),
        ("COMEDI_SUBD_DO", DIGITAL_OUT_KIND as u64),
        ("COMEDI_SUBD_DIO", DIGITAL_IO_KIND as u64),
        ("COMEDI_SUBD_COUNTER", COUNTER_KIND as u64),
        ("COMEDI_SUBD_PWM + 1", SUBDEVICE_KINDS.len() as u64),
        ("INSN_READ", READ_INSTRUCTION as u64),
        ("INSN_WRITE", WRITE_INSTRUCTION as u64),
        ("INSN_BITS", BITS_INSTRUCTION as u64),
        ("INSN_CONFIG", CONFIG_INSTRUCTION as u64),
        ("INSN_CONFIG_DIO_INPUT", LINE_INPUT_CONFIG as u64),
        ("INSN_CONFIG_DIO_OUTPUT", LINE_OUTPUT_CONFIG as u64),
        ("INSN_CONFIG_DIO_QUERY", LINE_QUERY_CONFIG as u64),
        ("INSN_CONFIG_ARM", ARM_CONFIG as u64),
        ("INSN_CONFIG_RESET", RESET_CONFIG as u64),
        ("INSN_CONFIG_GPCT_QUADRATURE_ENCODER", QUADRATURE_CONFIG as u64),
        ("INSN_CONFIG_SET_GATE_SRC", GATE_SOURCE_CONFIG as u64),
        ("INSN_CONFIG_SET_OTHER_SRC", OTHER_SOURCE_CONFIG as u64),
        ("INSN_CONFIG_SET_COUNTER_MODE", COUNTER_MODE_CONFIG as u64),
        ("NI_GPCT_DISABLED_GATE_SELECT", GATE_DISABLED_SELECT as u64),
        ("NI_GPCT_ARM_IMMEDIATE", ARM_AT_ONCE_SELECT as u64),
        (
            "NI_GPCT_COUNTING_MODE_QUADRATURE_X4_BITS + NI_GPCT_COUNTING_DIRECTION_HW_UP_DOWN_BITS",
            QUADRATURE_MODE_BITS as u64,
        ),
        ("CR_PACK(5, 3, AREF_DIFF)", channel_word(5, 3, 2) as u64),
        ("RF_EXTERNAL", EXTERNAL_REFERENCE_FLAG as u64),
    ]
}

#[test]
fn the_numbers_are_those_of_the_kernels_header() {
    let folder = std::env::temp_dir().join(format!("comedi-header-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let (source, program) = (folder.join("facts.c"), folder.join("facts"));
    let facts = [layout(), constants()].concat();
    let lines: String = facts
        .iter()
        .map(|(expression, _)| {
            format!("printf(\"%llu\\n\", (unsigned long long)({expression}));\n")
        })
        .collect();
    let includes = ["stddef.h", "stdio.h", "sys/ioctl.h", "linux/comedi.h"]
        .map(|header| format!("#include <{header}>\n"))
        .concat();
    std::fs::write(&source, format!("{includes}int main(void) {{\n{lines}return 0; }}\n")).unwrap();
    let compiled = Command::new("cc").arg("-o").arg(&program).arg(&source).output();
    match compiled {
        Ok(compiled) if compiled.status.success() => {
            let output = Command::new(&program).output().unwrap();
            let numbers = String::from_utf8(output.stdout).unwrap();
            assert_eq!(numbers.lines().count(), facts.len());
            for ((expression, due), number) in facts.iter().zip(numbers.lines()) {
                assert_eq!(number.parse(), Ok(*due), "{expression}");
            }
        }
        other => {
            let reason = other.map_or_else(|error| error.to_string(), |_| "no header".to_owned());
            let text = format!("skipped: needs cc and linux/comedi.h ({reason})\n");
            std::io::stderr().write_all(text.as_bytes()).unwrap();
        }
    }
    std::fs::remove_dir_all(&folder).unwrap();
}
