//! Calls the kernel on an open device node: the only place with pointers. Each call hands over
//! memory that lives until the call has returned and is as large as the kernel takes it to be.
#![allow(unsafe_code)]

use std::fs::{File, OpenOptions};
use std::io;
use std::os::fd::AsRawFd;
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::Path;

use nix::errno::Errno;
use taktil_hal::OpenError;

use crate::board::{Board, ChannelInfo, DeviceInfo, InstructionList, Range, SubdeviceInfo};
use crate::error;
use crate::uapi::{self, ChanInfo, DevInfo, InsnList, KernelRange, RangeInfo, SubdInfo};

/// The major number of Comedi's device nodes.
pub(crate) const COMEDI_MAJOR_NUMBER: u64 = 98;
/// Subdevices that a board has at most; drivers of the kernel have up to some dozen.
const SUBDEVICES_MAX: usize = 256;
/// Channels that a subdevice has at most: the channel word has 16 bits for the number.
const SUBDEVICE_CHANNELS_MAX: usize = 1 << 16;

/// A device node such as `/dev/comedi0`, open for reading and writing. Closing it frees what it
/// has locked and leaves the outputs as they are.
#[derive(Debug)]
pub struct DeviceFile {
    file: File,
}

impl DeviceFile {
    /// Opens a node.
    ///
    /// # Errors
    /// The path does not exist, is forbidden, or is no node of Comedi; with the remedy.
    pub fn open(path: &str) -> Result<DeviceFile, OpenError> {
        let file = OpenOptions::new()
            .read(true)
            .write(true)
            .custom_flags(libc::O_CLOEXEC | libc::O_NONBLOCK)
            .open(Path::new(path))
            .map_err(|error| refused(path, &error))?;
        let metadata = file.metadata().map_err(|error| refused(path, &error))?;
        let device = std::os::unix::fs::MetadataExt::rdev(&metadata);
        let is_node = metadata.file_type().is_char_device();
        if !is_node || u64::from(libc::major(device)) != COMEDI_MAJOR_NUMBER {
            let what = "is no device node of Comedi";
            return Err(error::device(path, what, "name one such as /dev/comedi0"));
        }
        Ok(DeviceFile { file })
    }

    /// A node that is open already, such as one that another process has handed over. What it is
    /// shows at the first request: the kernel refuses those that a file does not know.
    #[must_use]
    pub fn from_file(file: File) -> DeviceFile {
        DeviceFile { file }
    }

    /// One request whose argument is memory of the caller.
    ///
    /// # Safety
    /// `argument` points to what the kernel's header declares as the argument of `request`; every
    /// address inside it belongs to exposed memory as large as the kernel takes it to be.
    unsafe fn request<T>(&self, request: u32, argument: *mut T) -> Result<i32, Errno> {
        // SAFETY: the descriptor is open as long as `self`; the argument is the caller's promise.
        let answer = unsafe { libc::ioctl(self.file.as_raw_fd(), request as _, argument) };
        Errno::result(answer)
    }

    fn subdevice_table(&self) -> Result<Vec<SubdInfo>, Errno> {
        let count = self.raw_device_info()?.subdevices as usize;
        if count > SUBDEVICES_MAX {
            return Err(Errno::E2BIG);
        }
        let mut table = vec![SubdInfo::default(); SUBDEVICES_MAX];
        // SAFETY: the kernel fills as many entries as the board has subdevices; there is room for
        // SUBDEVICES_MAX, even if another board has been attached since it was asked.
        unsafe { self.request(uapi::SUBDINFO_REQUEST, table.as_mut_ptr())? };
        table.truncate(count);
        Ok(table)
    }

    fn raw_device_info(&self) -> Result<DevInfo, Errno> {
        let mut info = DevInfo {
            version_code: 0,
            subdevices: 0,
            driver_name: [0; uapi::NAME_BYTES],
            board_name: [0; uapi::NAME_BYTES],
            read_subdevice: 0,
            write_subdevice: 0,
            unused: [0; 30],
        };
        // SAFETY: the kernel writes one structure of this layout, whose size is in the request.
        unsafe { self.request(uapi::DEVINFO_REQUEST, &raw mut info)? };
        Ok(info)
    }

    /// The largest samples and the range types of the channels, for the lists that are asked.
    fn channel_lists(
        &self,
        subdevice: u32,
        maxdata: Option<&mut [u32]>,
        ranges: Option<&mut [u32]>,
    ) -> Result<(), Errno> {
        let address =
            |list: Option<&mut [u32]>| list.map_or(0, |list| list.as_mut_ptr().expose_provenance());
        let mut argument = ChanInfo {
            subdevice,
            maxdata_list: address(maxdata),
            flag_list: 0,
            range_list: address(ranges),
            unused: [0; 4],
        };
        // SAFETY: both lists are null or have an entry for each channel that a subdevice can have,
        // which `channels` sees to, and live longer than this call.
        unsafe { self.request(uapi::CHANINFO_REQUEST, &raw mut argument)? };
        Ok(())
    }
}

/// The text before the closing zero.
fn name(bytes: &[u8]) -> String {
    let text = bytes.split(|byte| *byte == 0).next().unwrap_or_default();
    String::from_utf8_lossy(text).into_owned()
}

impl Board for DeviceFile {
    fn device_info(&self) -> Result<DeviceInfo, Errno> {
        let info = self.raw_device_info()?;
        Ok(DeviceInfo { driver: name(&info.driver_name), board: name(&info.board_name) })
    }

    fn subdevices(&self) -> Result<Vec<SubdeviceInfo>, Errno> {
        let info = |entry: &SubdInfo| SubdeviceInfo {
            kind: entry.kind,
            channels: entry.channels,
            flags: entry.flags,
        };
        Ok(self.subdevice_table()?.iter().map(info).collect())
    }

    fn channels(&self, subdevice: u32) -> Result<Vec<ChannelInfo>, Errno> {
        let table = self.subdevice_table()?;
        let entry = table.get(subdevice as usize).ok_or(Errno::EINVAL)?;
        let channels = entry.channels as usize;
        if channels > SUBDEVICE_CHANNELS_MAX {
            return Err(Errno::E2BIG);
        }
        let mut maxdata = vec![entry.maxdata; SUBDEVICE_CHANNELS_MAX];
        let mut ranges = vec![entry.range_type; SUBDEVICE_CHANNELS_MAX];
        let own_maxdata = entry.flags & uapi::MAXDATA_PER_CHANNEL_FLAG != 0;
        let own_ranges = entry.flags & uapi::RANGES_PER_CHANNEL_FLAG != 0;
        if channels > 0 && (own_maxdata || own_ranges) {
            self.channel_lists(
                subdevice,
                own_maxdata.then_some(maxdata.as_mut_slice()),
                own_ranges.then_some(ranges.as_mut_slice()),
            )?;
        }
        let info = |(maxdata, range_type)| ChannelInfo { maxdata, range_type };
        Ok(maxdata.into_iter().zip(ranges).take(channels).map(info).collect())
    }

    fn ranges(&self, range_type: u32) -> Result<Vec<Range>, Errno> {
        let count = range_type as usize & 0xffff;
        let mut ranges = vec![KernelRange::default(); count + 1];
        let mut argument =
            RangeInfo { range_type, ranges: ranges.as_mut_ptr().expose_provenance() };
        // SAFETY: the kernel writes as many ranges as the low 16 bits of the range type say, or
        // refuses; there is room for more, and it lives longer than this call.
        unsafe { self.request(uapi::RANGEINFO_REQUEST, &raw mut argument)? };
        ranges.truncate(count);
        let range = |range: &KernelRange| Range {
            min_millionths: range.min_millionths,
            max_millionths: range.max_millionths,
            flags: range.flags,
        };
        Ok(ranges.iter().map(range).collect())
    }

    fn lock(&self, subdevice: u32) -> Result<(), Errno> {
        let number = libc::c_ulong::from(subdevice);
        // SAFETY: the argument of this request is a number; no memory is involved.
        let answer = unsafe { libc::ioctl(self.file.as_raw_fd(), uapi::LOCK_REQUEST as _, number) };
        Errno::result(answer).map(drop)
    }

    fn execute(&self, list: &mut InstructionList) -> Result<usize, Errno> {
        let (instructions, raw) = list.parts();
        for (raw, instruction) in raw.iter_mut().zip(instructions.iter_mut()) {
            raw.kind = instruction.kind;
            raw.subdevice = instruction.subdevice;
            raw.channel = instruction.channel;
            let words = instruction.words_mut();
            raw.words = words.len() as u32;
            raw.data = words.as_mut_ptr().expose_provenance();
        }
        let mut argument = InsnList {
            instructions: raw.len() as u32,
            first: raw.as_mut_ptr().expose_provenance(),
        };
        // SAFETY: `first` addresses as many instructions as are announced, each of which addresses
        // as many words as it announces; `list` is borrowed alone until the call has returned.
        let executed = unsafe { self.request(uapi::INSNLIST_REQUEST, &raw mut argument)? };
        Ok(usize::try_from(executed).unwrap_or(0))
    }
}

/// The error of a path that the system refused, with what to do about it.
fn refused(path: &str, error: &io::Error) -> OpenError {
    match error.raw_os_error().map(Errno::from_raw) {
        Some(Errno::ENOENT) => error::device(
            path,
            "does not exist",
            "load the kernel driver of the board (for example `modprobe ni_pcimio`, or \
             `modprobe comedi_test`), or correct the path",
        ),
        Some(errno) => error::from_errno(path, "opening", errno),
        None => error::device(path, format!("cannot be opened ({error})"), "check the path"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_node_of_comedi_is_refused_by_name() {
        let text = DeviceFile::open("/dev/null").unwrap_err().to_string();
        assert!(text.starts_with("/dev/null: is no device node of Comedi; name one"), "{text}");
        let text = DeviceFile::open("/dev/comedi-none").unwrap_err().to_string();
        assert!(text.contains("does not exist") && text.contains("modprobe"), "{text}");
    }

    #[test]
    fn a_node_that_is_none_answers_the_systems_error() {
        let device = DeviceFile::from_file(File::open("/dev/null").unwrap());
        assert_eq!(device.device_info(), Err(Errno::ENOTTY));
        assert_eq!(device.lock(0), Err(Errno::ENOTTY));
        let mut list = InstructionList::new(vec![]);
        assert_eq!(device.execute(&mut list), Err(Errno::ENOTTY));
    }

    #[test]
    fn a_name_ends_at_its_zero() {
        assert_eq!(name(b"comedi_test\0\0x"), "comedi_test");
        assert_eq!(name(b"ni_pcimio"), "ni_pcimio");
    }
}
