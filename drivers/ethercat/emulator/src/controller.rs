//! The controller of one device: 64 KiB of memory with registers, sync managers that guard
//! mailboxes and process data, FMMUs that map them into the logical image, and the clock.

use taktil_hal::Nanos;

use crate::clock::{DeviceClock, Pulses};
use crate::mapping::{Fmmu, MAILBOX_FULL_BIT, Manager};

/// Bytes of the memory.
const MEMORY_BYTES: usize = 0x1_0000;
/// Sync managers of a controller.
pub(crate) const SYNC_MANAGERS_COUNT: usize = 8;
/// FMMUs of a controller.
const FMMUS_COUNT: usize = 8;
/// Registers end and process memory begins: the outputs of plain digital terminals are here.
const PROCESS_MEMORY_ADDRESS: u16 = 0x0f00;
/// The state that the host asks for.
pub(crate) const AL_CONTROL_ADDRESS: u16 = 0x0120;
/// The state of the device.
pub(crate) const AL_STATUS_ADDRESS: u16 = 0x0130;
/// Why it refused one.
pub(crate) const AL_CODE_ADDRESS: u16 = 0x0134;
/// Divider of the watchdogs.
const WATCHDOG_DIVIDER_ADDRESS: u16 = 0x0400;
/// Time of the watchdog of outputs, in units of the divider.
const OUTPUT_WATCHDOG_ADDRESS: u16 = 0x0420;
/// Counts the bites of that watchdog.
const WATCHDOG_COUNT_ADDRESS: u16 = 0x0442;
/// Control of the information memory.
const SII_CONTROL_ADDRESS: u16 = 0x0502;
/// Data of the information memory.
const SII_DATA_ADDRESS: u16 = 0x0508;
/// FMMUs, 16 bytes each.
const FMMU_ADDRESS: u16 = 0x0600;
/// Sync managers, 8 bytes each.
const SYNC_MANAGER_ADDRESS: u16 = 0x0800;
/// Times at which a frame arrived at each port.
const RECEIVE_TIMES_ADDRESS: u16 = 0x0900;
/// The time of the segment.
const SYSTEM_TIME_ADDRESS: u16 = 0x0910;
/// The time at which a frame was processed.
const LOCAL_TIME_ADDRESS: u16 = 0x0918;
/// What is added to the local time.
const TIME_OFFSET_ADDRESS: u16 = 0x0920;
/// What a frame needs from the reference clock to the device.
const TIME_DELAY_ADDRESS: u16 = 0x0928;
/// By how much the device's time differed from the reference's.
const TIME_DIFFERENCE_ADDRESS: u16 = 0x092c;
/// Starts SYNC0.
const SYNC_ACTIVATION_ADDRESS: u16 = 0x0981;
/// The first SYNC0.
const SYNC_START_ADDRESS: u16 = 0x0990;
/// Time from one SYNC0 to the next.
const SYNC_CYCLE_ADDRESS: u16 = 0x09a0;
/// Time of a frame from one device to the next.
const HOP_TIME: Nanos = Nanos(300);

/// What an access made happen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Event {
    /// Nothing beyond the memory.
    None,
    /// The host wrote a whole mailbox.
    MailboxWritten,
    /// The host read a whole mailbox, which is free again.
    MailboxRead,
    /// The host wrote all outputs.
    OutputsWritten,
    /// The host asks for a state.
    StateRequested,
}

/// A device's controller.
#[derive(Debug)]
pub(crate) struct Controller {
    memory: Box<[u8]>,
    information: Vec<u8>,
    fmmus: Vec<Fmmu>,
    position: usize,
    devices: usize,
    clock: DeviceClock,
}

impl Controller {
    /// The controller at `position` of `devices` after power-up.
    pub(crate) fn new(information: Vec<u8>, position: usize, devices: usize) -> Controller {
        let memory = vec![0; MEMORY_BYTES].into_boxed_slice();
        let (fmmus, clock) = (Vec::new(), DeviceClock::new(position));
        let mut all = Controller { memory, information, fmmus, position, devices, clock };
        all.reset();
        all
    }

    /// Sets everything as after power-up.
    pub(crate) fn reset(&mut self) {
        self.memory.fill(0);
        self.fmmus.clear();
        self.clock.restart();
        let ports = if self.position == 0 { 0x0b } else { 0x0a };
        // An ET1100 with clocks of 64 bits.
        self.memory[..10].copy_from_slice(&[0x11, 0, 2, 0, 8, 8, 8, ports, 0xfc, 1]);
        let is_last = self.position + 1 == self.devices;
        // The way in is open, the way out is where another device follows; others are closed.
        let links = 0x0011 | 0x0200 | 0x5000 | if is_last { 0x0400 } else { 0x0820 };
        self.set_word(0x0110, links);
        self.set_word(AL_STATUS_ADDRESS, 1);
        self.set_word(WATCHDOG_DIVIDER_ADDRESS, 2_498);
        self.set_word(0x0410, 1_000);
        self.set_word(OUTPUT_WATCHDOG_ADDRESS, 1_000);
        self.set_word(SII_CONTROL_ADDRESS, 0x0040);
        self.set_word(0x0012, u16::from_le_bytes([self.information[8], self.information[9]]));
    }

    /// Tells the controller how many devices answer behind one another.
    pub(crate) fn set_devices(&mut self, devices: usize) {
        self.devices = devices;
        let is_last = self.position + 1 == devices;
        self.set_word(0x0110, 0x0011 | 0x0200 | 0x5000 | if is_last { 0x0400 } else { 0x0820 });
    }

    pub(crate) fn word(&self, address: u16) -> u16 {
        let at = usize::from(address);
        u16::from_le_bytes([self.memory[at], self.memory[at + 1]])
    }

    pub(crate) fn set_word(&mut self, address: u16, word: u16) {
        let at = usize::from(address);
        self.memory[at..at + 2].copy_from_slice(&word.to_le_bytes());
    }

    fn double(&self, address: u16) -> u64 {
        let at = usize::from(address);
        let mut bytes = [0; 8];
        bytes.copy_from_slice(&self.memory[at..at + 8]);
        u64::from_le_bytes(bytes)
    }

    fn set_double(&mut self, address: u16, value: u64) {
        let at = usize::from(address);
        self.memory[at..at + 8].copy_from_slice(&value.to_le_bytes());
    }

    /// The address that the host has given it.
    pub(crate) fn station(&self) -> u16 {
        self.word(0x0010)
    }

    /// A part of the memory, as the device's own processor sees it.
    pub(crate) fn bytes(&self, address: u16, count: u16) -> &[u8] {
        let end = (usize::from(address) + usize::from(count)).min(MEMORY_BYTES);
        &self.memory[usize::from(address)..end]
    }

    pub(crate) fn bytes_mut(&mut self, address: u16, count: u16) -> &mut [u8] {
        let end = (usize::from(address) + usize::from(count)).min(MEMORY_BYTES);
        &mut self.memory[usize::from(address)..end]
    }

    pub(crate) fn manager(&self, number: usize) -> Manager {
        let at = usize::from(SYNC_MANAGER_ADDRESS) + 8 * number;
        let word = |offset: usize| {
            u16::from_le_bytes([self.memory[at + offset], self.memory[at + offset + 1]])
        };
        Manager {
            address: word(0),
            length: word(2),
            control: self.memory[at + 4],
            status: self.memory[at + 5],
            is_enabled: self.memory[at + 6] & 1 == 1,
        }
    }

    fn status_mut(&mut self, number: usize) -> &mut u8 {
        &mut self.memory[usize::from(SYNC_MANAGER_ADDRESS) + 8 * number + 5]
    }

    pub(crate) fn is_mailbox_full(&self, number: usize) -> bool {
        self.manager(number).status & MAILBOX_FULL_BIT != 0
    }

    /// Puts a message into the mailbox of a sync manager, for the host to read.
    pub(crate) fn fill_mailbox(&mut self, number: usize, message: &[u8]) {
        let Manager { address, length, .. } = self.manager(number);
        let room = self.bytes_mut(address, length);
        room.fill(0);
        let count = message.len().min(room.len());
        room[..count].copy_from_slice(&message[..count]);
        *self.status_mut(number) |= MAILBOX_FULL_BIT;
    }

    /// The longest time without outputs that the watchdog bears; `None` when it is off.
    pub(crate) fn output_watchdog(&self) -> Option<Nanos> {
        let count = i64::from(self.word(OUTPUT_WATCHDOG_ADDRESS));
        let unit = (i64::from(self.word(WATCHDOG_DIVIDER_ADDRESS)) + 2) * 40;
        (count > 0).then_some(Nanos(count * unit))
    }

    pub(crate) fn count_bite(&mut self) {
        let count = &mut self.memory[usize::from(WATCHDOG_COUNT_ADDRESS)];
        *count = count.saturating_add(1);
    }

    /// Bites of the watchdog of outputs since power-up.
    pub(crate) fn bites(&self) -> u64 {
        u64::from(self.memory[usize::from(WATCHDOG_COUNT_ADDRESS)])
    }

    /// The sync manager that an access touches. `Err` when it must not: the mailbox is full or
    /// empty, or the direction is wrong.
    fn guard(&self, address: u16, count: usize, is_write: bool) -> Result<Option<usize>, ()> {
        for number in 0..SYNC_MANAGERS_COUNT {
            let one = self.manager(number);
            let first = usize::from(address);
            let apart = first + count <= usize::from(one.address) || first >= one.end();
            if !one.is_enabled || apart {
                continue;
            }
            let is_full = one.status & MAILBOX_FULL_BIT != 0;
            let is_blocked = one.is_mailbox() && is_full == is_write;
            let is_allowed = one.is_written_by_host() == is_write && !is_blocked;
            return if is_allowed { Ok(Some(number)) } else { Err(()) };
        }
        Ok(None)
    }

    /// Reads for the host; `None` when the read is refused and must not count.
    pub(crate) fn read(&mut self, address: u16, data: &mut [u8], now: Nanos) -> Option<Event> {
        let end = usize::from(address) + data.len();
        if end > MEMORY_BYTES {
            return None;
        }
        let mut event = Event::None;
        if address >= PROCESS_MEMORY_ADDRESS {
            let manager = self.guard(address, data.len(), false).ok()?;
            if let Some(number) = manager {
                let one = self.manager(number);
                if one.is_mailbox() && end >= one.end() {
                    *self.status_mut(number) &= !MAILBOX_FULL_BIT;
                    event = Event::MailboxRead;
                }
            }
        } else if touches(address, data.len(), SYSTEM_TIME_ADDRESS, 8) {
            let time = self.system_time(now);
            self.set_double(SYSTEM_TIME_ADDRESS, time);
        }
        data.copy_from_slice(&self.memory[usize::from(address)..end]);
        Some(event)
    }

    /// Writes for the host; `None` when the write is refused and must not count.
    pub(crate) fn write(&mut self, address: u16, data: &[u8], now: Nanos) -> Option<Event> {
        let end = usize::from(address) + data.len();
        if end > MEMORY_BYTES {
            return None;
        }
        if address >= PROCESS_MEMORY_ADDRESS {
            let manager = self.guard(address, data.len(), true).ok()?;
            self.memory[usize::from(address)..end].copy_from_slice(data);
            let Some(number) = manager else { return Some(Event::None) };
            let one = self.manager(number);
            if end < one.end() {
                return Some(Event::None);
            }
            if one.is_mailbox() {
                return Some(Event::MailboxWritten);
            }
            return Some(Event::OutputsWritten);
        }
        self.write_registers(address, data, now)
    }

    fn write_registers(&mut self, address: u16, data: &[u8], now: Nanos) -> Option<Event> {
        let end = usize::from(address) + data.len();
        let is_read_only = end <= 0x10
            || (0x0110..0x0112).contains(&address)
            || (AL_STATUS_ADDRESS..0x0136).contains(&address);
        if is_read_only {
            return None;
        }
        if touches(address, data.len(), RECEIVE_TIMES_ADDRESS, 1) {
            self.latch_receive_times(now);
            return Some(Event::None);
        }
        if (SYSTEM_TIME_ADDRESS..LOCAL_TIME_ADDRESS).contains(&address) {
            if let Ok(bytes) = <[u8; 8]>::try_from(data) {
                let own = self.system_time(now);
                let delay = self.double(TIME_DELAY_ADDRESS) & u64::from(u32::MAX);
                let reference = u64::from_le_bytes(bytes).wrapping_add(delay);
                let shown = self.clock.follow(own, reference);
                let at = usize::from(TIME_DIFFERENCE_ADDRESS);
                self.memory[at..at + 4].copy_from_slice(&shown.to_le_bytes());
            }
            return Some(Event::None);
        }
        self.memory[usize::from(address)..end].copy_from_slice(data);
        if (FMMU_ADDRESS..SYNC_MANAGER_ADDRESS).contains(&address) {
            self.map();
        }
        if touches(address, data.len(), TIME_OFFSET_ADDRESS, 8) {
            self.clock.forget_correction();
        }
        if touches(address, data.len(), SYNC_ACTIVATION_ADDRESS, 1) {
            let activation = self.memory[usize::from(SYNC_ACTIVATION_ADDRESS)];
            let start = self.double(SYNC_START_ADDRESS);
            let cycle = self.double(SYNC_CYCLE_ADDRESS) as u32;
            let system = self.system_time(now);
            self.clock.set_sync(activation, start, cycle, system);
        }
        if touches(address, data.len(), SII_CONTROL_ADDRESS, 2) {
            self.serve_information();
        }
        let is_request = touches(address, data.len(), AL_CONTROL_ADDRESS, 1);
        Some(if is_request { Event::StateRequested } else { Event::None })
    }

    fn local(&self, now: Nanos) -> u64 {
        self.clock.local(now)
    }

    /// The time of the segment as this device has it.
    pub(crate) fn system_time(&self, now: Nanos) -> u64 {
        self.clock.system_time(now, self.double(TIME_OFFSET_ADDRESS))
    }

    /// Lets the clock be fast by so many millionths from `now` on.
    pub(crate) fn set_drift(&mut self, ppm: i64, now: Nanos) {
        self.clock.set_drift(ppm, now);
    }

    /// Whether SYNC0 is asked for, and whether it comes at all.
    pub(crate) fn has_sync(&self) -> Option<bool> {
        self.clock.has_sync()
    }

    /// The pulses of SYNC0 up to `now`.
    pub(crate) fn pulses(&mut self, now: Nanos) -> Pulses {
        let system = self.system_time(now);
        self.clock.pulses(system)
    }

    fn latch_receive_times(&mut self, now: Nanos) {
        let hop = HOP_TIME.0.cast_unsigned();
        let last = self.devices.saturating_sub(1);
        let local = self.local(now);
        let there = local + hop * self.position as u64;
        let back = local + hop * (2 * last).saturating_sub(self.position) as u64;
        let back = if self.position < last { back as u32 } else { 0 };
        let at = usize::from(RECEIVE_TIMES_ADDRESS);
        self.memory[at..at + 4].copy_from_slice(&(there as u32).to_le_bytes());
        self.memory[at + 4..at + 8].copy_from_slice(&back.to_le_bytes());
        self.set_double(LOCAL_TIME_ADDRESS, there);
    }

    /// Overwrites a word of the information memory, as damage or a wrong tool would.
    pub(crate) fn damage_information(&mut self, word: u16, value: u16) {
        let at = 2 * usize::from(word) % self.information.len();
        self.information[at..at + 2].copy_from_slice(&value.to_le_bytes());
    }

    fn serve_information(&mut self) {
        let command = self.word(SII_CONTROL_ADDRESS);
        let address = usize::from(self.word(SII_CONTROL_ADDRESS + 2));
        let data = usize::from(SII_DATA_ADDRESS);
        if command & 0x0100 != 0 {
            for offset in 0..8 {
                let at = (2 * address + offset) % self.information.len();
                self.memory[data + offset] = self.information[at];
            }
        } else if command & 0x0201 == 0x0201 {
            let at = 2 * address % self.information.len();
            self.information[at..at + 2].copy_from_slice(&self.memory[data..data + 2]);
        }
        self.set_word(SII_CONTROL_ADDRESS, 0x0040);
    }

    fn map(&mut self) {
        self.fmmus.clear();
        for number in 0..FMMUS_COUNT {
            let at = usize::from(FMMU_ADDRESS) + 16 * number;
            let Some(raw) = self.memory.get(at..at + 16) else { return };
            let bytes = u16::from_le_bytes([raw[4], raw[5]]);
            if raw[12] & 1 == 1 && bytes > 0 {
                self.fmmus.push(Fmmu {
                    logical: u32::from_le_bytes([raw[0], raw[1], raw[2], raw[3]]),
                    bytes,
                    first_bit: raw[6] & 7,
                    last_bit: raw[7] & 7,
                    physical: u16::from_le_bytes([raw[8], raw[9]]),
                    physical_bit: raw[10] & 7,
                    reads: raw[11] & 1 != 0,
                    writes: raw[11] & 2 != 0,
                });
            }
        }
    }

    /// Exchanges the logical image from `logical` on. `reads` and `writes` are what the command
    /// does; `outgoing` are the bytes as they came in. Answers whether anything was read and
    /// written, and whether all outputs arrived.
    pub(crate) fn exchange(
        &mut self,
        logical: u32,
        command: LogicalCommand,
        outgoing: &[u8],
        data: &mut [u8],
        now: Nanos,
    ) -> Exchange {
        let mut done = Exchange::default();
        for number in 0..self.fmmus.len() {
            let fmmu = self.fmmus[number];
            let is_bitwise = fmmu.first_bit != 0 || fmmu.last_bit != 7 || fmmu.physical_bit != 0;
            if is_bitwise {
                self.exchange_bits(&fmmu, logical, command, outgoing, data, &mut done);
                continue;
            }
            let (begin, end) = (u64::from(logical), u64::from(logical) + outgoing.len() as u64);
            let low = begin.max(u64::from(fmmu.logical));
            let high = end.min(u64::from(fmmu.logical) + u64::from(fmmu.bytes));
            if low >= high {
                continue;
            }
            let physical = fmmu.physical.wrapping_add((low - u64::from(fmmu.logical)) as u16);
            let range = (low - begin) as usize..(high - begin) as usize;
            if fmmu.reads && command.reads {
                done.has_read |= self.read(physical, &mut data[range.clone()], now).is_some();
            }
            if fmmu.writes && command.writes {
                let event = self.write(physical, &outgoing[range], now);
                done.has_written |= event.is_some();
                done.has_outputs |= event == Some(Event::OutputsWritten);
            }
        }
        done
    }

    fn exchange_bits(
        &mut self,
        fmmu: &Fmmu,
        logical: u32,
        command: LogicalCommand,
        outgoing: &[u8],
        data: &mut [u8],
        done: &mut Exchange,
    ) {
        let bits = 8 * (u64::from(fmmu.bytes) - 1) + u64::from(fmmu.last_bit) + 1;
        for bit in 0..bits.saturating_sub(u64::from(fmmu.first_bit)) {
            let wanted = 8 * u64::from(fmmu.logical) + u64::from(fmmu.first_bit) + bit;
            let Some(inside) = wanted.checked_sub(8 * u64::from(logical)) else { continue };
            let (byte, shift) = ((inside / 8) as usize, inside % 8);
            if byte >= outgoing.len() {
                continue;
            }
            let own = 8 * u64::from(fmmu.physical) + u64::from(fmmu.physical_bit) + bit;
            let Some(cell) = self.memory.get_mut((own / 8) as usize) else { continue };
            let mask = 1_u8 << (own % 8);
            if fmmu.reads && command.reads {
                let value = u8::from(*cell & mask != 0);
                data[byte] = data[byte] & !(1 << shift) | value << shift;
                done.has_read = true;
            }
            if fmmu.writes && command.writes {
                let is_set = outgoing[byte] >> shift & 1 == 1;
                *cell = if is_set { *cell | mask } else { *cell & !mask };
                (done.has_written, done.has_outputs) = (true, true);
            }
        }
    }
}

/// What a logical command does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct LogicalCommand {
    pub(crate) reads: bool,
    pub(crate) writes: bool,
}

/// What a logical command did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Exchange {
    pub(crate) has_read: bool,
    pub(crate) has_written: bool,
    pub(crate) has_outputs: bool,
}

/// Whether an access touches some registers.
fn touches(address: u16, count: usize, register: u16, bytes: usize) -> bool {
    let (first, own) = (usize::from(address), usize::from(register));
    first < own + bytes && own < first + count
}
