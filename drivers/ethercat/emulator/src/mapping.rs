//! What guards and maps the memory of a controller: sync managers and FMMUs as the host has set
//! them.

/// A mailbox is full.
pub(crate) const MAILBOX_FULL_BIT: u8 = 8;

/// A sync manager as the host has set it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Manager {
    pub(crate) address: u16,
    pub(crate) length: u16,
    pub(crate) control: u8,
    pub(crate) status: u8,
    pub(crate) is_enabled: bool,
}

impl Manager {
    pub(crate) fn is_mailbox(&self) -> bool {
        self.control & 3 == 2
    }

    pub(crate) fn is_written_by_host(&self) -> bool {
        self.control & 0x0c != 0
    }

    pub(crate) fn end(&self) -> usize {
        usize::from(self.address) + usize::from(self.length)
    }

    pub(crate) fn has_watchdog(&self) -> bool {
        self.control & 0x40 != 0
    }
}

/// A mapping of the logical image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Fmmu {
    pub(crate) logical: u32,
    pub(crate) bytes: u16,
    pub(crate) first_bit: u8,
    pub(crate) last_bit: u8,
    pub(crate) physical: u16,
    pub(crate) physical_bit: u8,
    pub(crate) reads: bool,
    pub(crate) writes: bool,
}
