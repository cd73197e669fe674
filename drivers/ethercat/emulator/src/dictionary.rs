//! A device's object dictionary and its service over the mailbox (CoE): uploads and downloads,
//! expedited, at once or in segments, and aborts with the code that the standard gives.

use std::collections::{BTreeMap, VecDeque};

use crate::application::Application;
use crate::description::{Description, Entry, MAILBOX_BYTES, Model, Pdo};

/// Bytes of a mailbox's header.
const MAILBOX_HEADER_BYTES: usize = 6;
/// Bytes of CoE's header and an SDO's.
const SDO_HEADER_BYTES: usize = 10;
/// Payload of the first answer of an upload.
const FIRST_ROOM_BYTES: usize = MAILBOX_BYTES as usize - MAILBOX_HEADER_BYTES - SDO_HEADER_BYTES;
/// Payload of a segment.
const SEGMENT_ROOM_BYTES: usize = MAILBOX_BYTES as usize - MAILBOX_HEADER_BYTES - 3;
/// CoE in the type of a mailbox message.
const COE_TYPE: u8 = 3;
/// Messages that wait for the host at most.
const ANSWERS_MAX: usize = 8;
/// Assignment of process data to the device.
const OUTPUT_ASSIGNMENT: u16 = 0x1c12;
/// Assignment of process data from the device.
const INPUT_ASSIGNMENT: u16 = 0x1c13;

/// Abort codes.
mod abort {
    pub(super) const TOGGLE_CODE: u32 = 0x0503_0000;
    pub(super) const COMMAND_CODE: u32 = 0x0504_0001;
    pub(super) const ACCESS_CODE: u32 = 0x0601_0000;
    pub(super) const READ_ONLY_CODE: u32 = 0x0601_0002;
    pub(super) const NO_OBJECT_CODE: u32 = 0x0602_0000;
    pub(super) const LENGTH_CODE: u32 = 0x0607_0010;
    pub(super) const NO_SUBINDEX_CODE: u32 = 0x0609_0011;
    pub(super) const STATE_CODE: u32 = 0x0800_0022;
}

/// A download in segments that is under way.
#[derive(Clone, Debug)]
struct Download {
    index: u16,
    subindex: u8,
    size: usize,
    bytes: Vec<u8>,
}

/// The dictionary of a device.
#[derive(Clone, Debug, Default)]
pub(crate) struct Dictionary {
    objects: BTreeMap<(u16, u8), Vec<u8>>,
    answers: VecDeque<Vec<u8>>,
    counter: u8,
    upload: Option<Vec<u8>>,
    toggle: bool,
    download: Option<Download>,
}

impl Dictionary {
    pub(crate) fn new(device: &Description) -> Dictionary {
        let mut all = Dictionary::default();
        let mut put = |index, subindex, bytes: &[u8]| {
            all.objects.insert((index, subindex), bytes.to_vec());
        };
        let is_drive = device.model == Model::Drive;
        let device_type: u32 = if is_drive { 0x0002_0192 } else { 0x1389 };
        put(0x1000, 0, &device_type.to_le_bytes());
        put(0x1008, 0, device.order.as_bytes());
        put(0x1018, 0, &[4]);
        put(0x1018, 1, &device.vendor.to_le_bytes());
        put(0x1018, 2, &device.product.to_le_bytes());
        put(0x1018, 3, &device.revision.to_le_bytes());
        put(0x1018, 4, &[0; 4]);
        put(0x1c00, 0, &[4]);
        for number in 1..=4 {
            put(0x1c00, number, &[number]);
        }
        for object in &device.objects {
            put(object.index, object.subindex, &object.bytes);
        }
        all.assign(OUTPUT_ASSIGNMENT, &device.outputs);
        all.assign(INPUT_ASSIGNMENT, &device.inputs);
        all
    }

    fn assign(&mut self, assignment: u16, pdos: &[Pdo]) {
        self.objects.insert((assignment, 0), vec![pdos.len() as u8]);
        for (number, pdo) in (1..).zip(pdos) {
            self.objects.insert((assignment, number), pdo.index.to_le_bytes().to_vec());
            self.objects.insert((pdo.index, 0), vec![pdo.entries.len() as u8]);
            for (number, entry) in (1..).zip(&pdo.entries) {
                let Entry { index, subindex, bits } = *entry;
                let mapping = u32::from(index) << 16 | u32::from(subindex) << 8 | u32::from(bits);
                self.objects.insert((pdo.index, number), mapping.to_le_bytes().to_vec());
                let bytes = vec![0; usize::from(bits).div_ceil(8)];
                self.objects.entry((index, subindex)).or_insert(bytes);
            }
        }
    }

    /// The entries of the process data in a direction, in their order; `None` when an assignment
    /// names what does not exist.
    pub(crate) fn mapping(&self, is_output: bool) -> Option<Vec<Entry>> {
        let assignment = if is_output { OUTPUT_ASSIGNMENT } else { INPUT_ASSIGNMENT };
        let mut entries = Vec::new();
        for number in 1..=self.byte(assignment, 0)? {
            let pdo = self.objects.get(&(assignment, number))?;
            let pdo = u16::from_le_bytes([*pdo.first()?, *pdo.get(1)?]);
            for number in 1..=self.byte(pdo, 0)? {
                let raw = self.objects.get(&(pdo, number))?;
                let [bits, subindex, low, high] = raw.as_slice().try_into().ok()?;
                entries.push(Entry { index: u16::from_le_bytes([low, high]), subindex, bits });
            }
        }
        Some(entries)
    }

    fn byte(&self, index: u16, subindex: u8) -> Option<u8> {
        self.objects.get(&(index, subindex)).and_then(|bytes| bytes.first()).copied()
    }

    /// The next message for the host.
    pub(crate) fn answer(&mut self) -> Option<Vec<u8>> {
        self.answers.pop_front()
    }

    /// Puts an emergency message between the answers.
    pub(crate) fn push_emergency(&mut self, code: u16) {
        let mut body = code.to_le_bytes().to_vec();
        body.extend([0x20, 0, 0, 0, 0, 0]);
        self.push(1, &body);
    }

    fn push(&mut self, service: u16, body: &[u8]) {
        if self.answers.len() >= ANSWERS_MAX {
            return;
        }
        self.counter = self.counter % 7 + 1;
        let mut message = (body.len() as u16 + 2).to_le_bytes().to_vec();
        message.extend([0, 0, 0, COE_TYPE | self.counter << 4]);
        message.extend((service << 12).to_le_bytes());
        message.extend(body);
        self.answers.push_back(message);
    }

    fn respond(&mut self, command: u8, index: u16, subindex: u8, rest: &[u8]) {
        let [low, high] = index.to_le_bytes();
        let mut body = vec![command, low, high, subindex];
        body.extend(rest);
        self.push(3, &body);
    }

    fn abort(&mut self, index: u16, subindex: u8, code: u32) {
        let [low, high] = index.to_le_bytes();
        let mut body = vec![0x80, low, high, subindex];
        body.extend(code.to_le_bytes());
        self.push(2, &body);
    }

    /// Takes a message of the host. `is_pre_operational` says whether process data may be changed.
    pub(crate) fn receive(
        &mut self,
        message: &[u8],
        application: &mut Application,
        is_pre_operational: bool,
    ) {
        let Some((header, rest)) = message.split_at_checked(MAILBOX_HEADER_BYTES) else { return };
        let length = usize::from(u16::from_le_bytes([header[0], header[1]]));
        let Some(content) = rest.get(..length) else { return };
        if header[5] & 0x0f != COE_TYPE || content.len() < SDO_HEADER_BYTES {
            return;
        }
        if u16::from_le_bytes([content[0], content[1]]) >> 12 != 2 {
            return;
        }
        let sdo = &content[2..];
        let (index, subindex) = (u16::from_le_bytes([sdo[1], sdo[2]]), sdo[3]);
        match sdo[0] >> 5 {
            0 => self.take_segment(sdo, is_pre_operational),
            1 => self.start_download(sdo, application, is_pre_operational),
            2 => self.start_upload(sdo[0], index, subindex, application),
            3 => self.send_segment(sdo[0]),
            _ => self.abort(index, subindex, abort::COMMAND_CODE),
        }
    }

    fn start_upload(&mut self, command: u8, index: u16, subindex: u8, application: &Application) {
        if command & 0x10 != 0 {
            return self.abort(index, subindex, abort::ACCESS_CODE);
        }
        let Some(mut bytes) = self.objects.get(&(index, subindex)).cloned() else {
            let code = self.missing(index);
            return self.abort(index, subindex, code);
        };
        if let Some(value) = application.read(index, subindex) {
            let count = bytes.len().min(8);
            bytes[..count].copy_from_slice(&value.to_le_bytes()[..count]);
        }
        if (1..=4).contains(&bytes.len()) {
            let command = 0x43 | (4 - bytes.len() as u8) << 2;
            bytes.resize(4, 0);
            return self.respond(command, index, subindex, &bytes);
        }
        let mut rest = (bytes.len() as u32).to_le_bytes().to_vec();
        let first = bytes.len().min(FIRST_ROOM_BYTES);
        rest.extend(&bytes[..first]);
        self.upload = Some(bytes.split_off(first));
        self.toggle = false;
        self.respond(0x41, index, subindex, &rest);
    }

    fn missing(&self, index: u16) -> u32 {
        let is_known = self.objects.range((index, 0)..=(index, u8::MAX)).next().is_some();
        if is_known { abort::NO_SUBINDEX_CODE } else { abort::NO_OBJECT_CODE }
    }

    fn send_segment(&mut self, command: u8) {
        let is_due = (command & 0x10 != 0) == self.toggle;
        let Some(mut bytes) = self.upload.take().filter(|_| is_due) else {
            return self.abort(0, 0, abort::TOGGLE_CODE);
        };
        let rest = bytes.split_off(bytes.len().min(SEGMENT_ROOM_BYTES));
        let is_last = rest.is_empty();
        let unused = 7_usize.saturating_sub(bytes.len());
        let mut body = vec![u8::from(self.toggle) << 4 | (unused as u8) << 1 | u8::from(is_last)];
        body.extend(&bytes);
        body.resize(body.len() + unused, 0);
        self.push(3, &body);
        self.toggle = !self.toggle;
        self.upload = (!is_last).then_some(rest);
    }

    fn start_download(&mut self, sdo: &[u8], application: &mut Application, may_map: bool) {
        let (index, subindex) = (u16::from_le_bytes([sdo[1], sdo[2]]), sdo[3]);
        if sdo[0] & 0x10 != 0 {
            return self.abort(index, subindex, abort::ACCESS_CODE);
        }
        if sdo[0] & 2 != 0 {
            let unused = if sdo[0] & 1 == 1 { usize::from(sdo[0] >> 2 & 3) } else { 0 };
            let Some(bytes) = sdo.get(4..8 - unused) else { return };
            return self.store(index, subindex, bytes, application, may_map);
        }
        let Some(size) = sdo.get(4..8) else { return };
        let size = u32::from_le_bytes([size[0], size[1], size[2], size[3]]) as usize;
        let bytes = sdo[8..].iter().copied().take(size).collect::<Vec<u8>>();
        if bytes.len() == size {
            return self.store(index, subindex, &bytes, application, may_map);
        }
        self.download = Some(Download { index, subindex, size, bytes });
        self.toggle = false;
        self.respond(0x60, index, subindex, &[0; 4]);
    }

    fn take_segment(&mut self, sdo: &[u8], may_map: bool) {
        let is_due = (sdo[0] & 0x10 != 0) == self.toggle;
        let Some(mut download) = self.download.take().filter(|_| is_due) else {
            return self.abort(0, 0, abort::TOGGLE_CODE);
        };
        let unused = if sdo.len() <= 8 { usize::from(sdo[0] >> 1 & 7) } else { 0 };
        download.bytes.extend(&sdo[1..sdo.len().saturating_sub(unused).max(1)]);
        self.toggle = !self.toggle;
        if sdo[0] & 1 == 0 {
            self.download = Some(download);
            return self.push(3, &[0x20 | sdo[0] & 0x10, 0, 0, 0, 0, 0, 0, 0]);
        }
        let Download { index, subindex, size, mut bytes } = download;
        bytes.truncate(size);
        match self.refusal(index, subindex, &bytes, may_map) {
            Some(code) => self.abort(index, subindex, code),
            None => {
                self.objects.insert((index, subindex), bytes);
                self.push(3, &[0x20 | sdo[0] & 0x10, 0, 0, 0, 0, 0, 0, 0]);
            }
        }
    }

    fn store(
        &mut self,
        index: u16,
        subindex: u8,
        bytes: &[u8],
        application: &mut Application,
        may_map: bool,
    ) {
        if let Some(code) = self.refusal(index, subindex, bytes, may_map) {
            return self.abort(index, subindex, code);
        }
        self.objects.insert((index, subindex), bytes.to_vec());
        let mut value = [0; 8];
        let count = bytes.len().min(8);
        value[..count].copy_from_slice(&bytes[..count]);
        application.write(index, subindex, i64::from_le_bytes(value));
        self.respond(0x60, index, subindex, &[0; 4]);
    }

    fn refusal(&self, index: u16, subindex: u8, bytes: &[u8], may_map: bool) -> Option<u32> {
        let is_mapping = (0x1600..0x1c20).contains(&index);
        if is_mapping {
            return (!may_map).then_some(abort::STATE_CODE);
        }
        if matches!(index, 0x1000..=0x1018 | 0x603f | 0x6041 | 0x6061 | 0x6064 | 0x606c | 0x6077) {
            return Some(abort::READ_ONLY_CODE);
        }
        match self.objects.get(&(index, subindex)) {
            None => Some(self.missing(index)),
            Some(old) if old.len() != bytes.len() => Some(abort::LENGTH_CODE),
            Some(_) => None,
        }
    }
}
