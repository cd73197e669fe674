//! Lists every register of a description and refuses those that stand outside the window, between
//! two registers, or where another one already does.
//!
//! A register may be one thing when it is read and another when it is written, such as command and
//! status. Registers of state (presence, identity, busy bits, lines from the cell) may be one, and
//! so may commands that are told apart by their values.

use std::collections::BTreeMap;

use taktil_hal::Invalid;

use super::{Description, StrobeKind};

/// What is done with a register.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Access {
    /// A value is read, for which it is there alone.
    Value,
    /// State is read that may be that of several things.
    State,
    /// It is written in cycles: this value each time, or others.
    Command(Option<u32>),
    /// It puts something out, so that nothing else may be written there.
    Output,
    /// It is written once, before anything else.
    Setup,
}

/// One register as it is listed.
struct Listed {
    offset: usize,
    access: Access,
    /// The key that puts it there.
    place: String,
}

/// Registers while they are listed.
struct List<'a> {
    description: &'a Description,
    all: Vec<Listed>,
}

impl List<'_> {
    fn one(&mut self, access: Access, place: impl Into<String>, offset: usize) {
        self.all.push(Listed { offset, access, place: place.into() });
    }

    fn optional(&mut self, access: Access, place: &str, offset: Option<usize>) {
        if let Some(offset) = offset {
            self.one(access, place, offset);
        }
    }

    /// The registers of a row of channels; what would lie beyond all addresses is listed at the
    /// last one, and refused there.
    fn bank(
        &mut self,
        access: Access,
        place: &str,
        first: usize,
        channels: usize,
        words: usize,
        channel_stride: Option<usize>,
    ) {
        let stride = self.description.stride();
        let channel_stride = self.description.channel_stride(channel_stride, words);
        for channel in 0..channels {
            for word in 0..words {
                let offset = first
                    .saturating_add(channel.saturating_mul(channel_stride))
                    .saturating_add(word.saturating_mul(stride));
                self.one(access, place, offset);
            }
        }
    }
}

impl Description {
    /// Checks where all registers stand.
    pub(super) fn check_registers(&self) -> Result<(), Invalid> {
        let mut list = List { description: self, all: Vec::new() };
        self.list_board(&mut list);
        self.list_inputs(&mut list);
        self.list_outputs(&mut list);
        let bytes = self.bus_bytes();
        let mut taken: BTreeMap<usize, Vec<(Access, String)>> = BTreeMap::new();
        for Listed { offset, access, place } in list.all {
            if !offset.is_multiple_of(bytes) {
                let what = format!("{offset:#x} is no multiple of the bus's {bytes} bytes");
                return Err(Invalid::new(place, what, "give the offset of a whole register"));
            }
            if offset.checked_add(bytes).is_none_or(|end| end > self.length_bytes) {
                let what = format!("a register at {offset:#x} is outside {:#x}", self.length_bytes);
                let remedy = "correct the offset or stride, or `length_bytes`";
                return Err(Invalid::new(place, what, remedy));
            }
            let here = taken.entry(offset).or_default();
            if let Some((_, other)) = here.iter().find(|(other, _)| collides(*other, access)) {
                let what = format!("shares the register at {offset:#x} with `{other}`");
                let remedy = "give each its own registers: compare offsets, widths and strides";
                return Err(Invalid::new(place, what, remedy));
            }
            here.push((access, place));
        }
        Ok(())
    }

    fn list_board(&self, list: &mut List<'_>) {
        for (at, expected) in self.identity.iter().enumerate() {
            list.one(Access::State, format!("identity[{at}].offset"), expected.offset);
        }
        for (at, written) in self.setup.iter().enumerate() {
            list.one(Access::Setup, format!("setup[{at}].offset"), written.offset);
        }
        let presence = self.presence.as_ref().map(|expected| expected.offset);
        list.optional(Access::State, "presence.offset", presence);
        if let Some(part) = &self.watchdog {
            list.one(Access::Command(None), "watchdog.offset", part.offset);
            list.one(Access::State, "watchdog.offset", part.offset);
            let kick = Access::Command(Some(part.kick_value));
            list.optional(kick, "watchdog.kick_offset", part.kick_offset);
        }
    }

    fn list_inputs(&self, list: &mut List<'_>) {
        if let Some(part) = &self.encoders {
            let words = self.count_words(part);
            let (place, stride) = ("encoders.offset", part.channel_stride_bytes);
            list.bank(Access::Value, place, part.offset, part.channels, words, stride);
            let latch = command(part.latch, part.latch_value);
            list.optional(latch, "encoders.latch_offset", part.latch_offset);
            list.optional(Access::State, "encoders.busy_offset", part.busy_offset);
            list.optional(Access::Value, "encoders.begin_offset", part.begin_offset);
            list.optional(Access::Value, "encoders.end_offset", part.end_offset);
            if let Some(index) = &self.index {
                let stride = index.channel_stride_bytes;
                let (place, first) = ("index.offset", index.offset);
                list.bank(Access::Value, place, first, part.channels, words, stride);
            }
        }
        if let Some(index) = &self.index {
            list.one(Access::Value, "index.seen_offset", index.seen_offset);
            list.optional(Access::State, "index.feature_offset", index.feature_offset);
            list.optional(Access::Value, "index.begin_offset", index.begin_offset);
            list.optional(Access::Value, "index.end_offset", index.end_offset);
        }
        for (name, part) in [("analog_in", &self.analog_in), ("force_torque", &self.force_torque)] {
            let Some(part) = part else { continue };
            let place = |key: &str| format!("{name}.{key}");
            let words = self.words(part.bits, part.shift);
            let stride = part.channel_stride_bytes;
            list.bank(Access::Value, &place("offset"), part.offset, part.channels, words, stride);
            let start = Access::Command(Some(part.start_value));
            list.optional(start, &place("start_offset"), part.start_offset);
            list.optional(Access::State, &place("busy_offset"), part.busy_offset);
            list.optional(Access::Value, &place("begin_offset"), part.begin_offset);
            list.optional(Access::Value, &place("end_offset"), part.end_offset);
        }
        if let Some(part) = &self.tactile {
            let (words, tactels) = (self.words(part.bits, 0), part.rows * part.cols);
            list.bank(Access::Value, "tactile.offset", part.offset, tactels, words, None);
            list.one(Access::Value, "tactile.begin_offset", part.begin_offset);
            list.one(Access::Value, "tactile.end_offset", part.end_offset);
        }
        let lines = self.digital_in.as_ref().map(|part| part.offset);
        list.optional(Access::State, "digital_in.offset", lines);
    }

    fn list_outputs(&self, list: &mut List<'_>) {
        if let Some(part) = &self.analog_out {
            let words = self.words(part.bits, part.shift);
            let (place, stride) = ("analog_out.offset", part.channel_stride_bytes);
            list.bank(Access::Output, place, part.offset, part.channels, words, stride);
            if part.read_back {
                list.bank(Access::Value, place, part.offset, part.channels, words, stride);
            }
            let strobe = command(part.strobe, part.strobe_value);
            list.optional(strobe, "analog_out.strobe_offset", part.strobe_offset);
        }
        let lines = self.digital_out.as_ref().map(|part| part.offset);
        list.optional(Access::Output, "digital_out.offset", lines);
    }
}

/// What a strobe writes.
fn command(kind: StrobeKind, value: u32) -> Access {
    Access::Command(match kind {
        StrobeKind::Value => Some(value),
        StrobeKind::Count => None,
    })
}

/// Whether two things that are done with one register disturb each other.
fn collides(one: Access, other: Access) -> bool {
    match (one.min(other), one.max(other)) {
        (Access::Command(Some(one)), Access::Command(Some(other))) => one == other,
        pair => matches!(
            pair,
            (Access::Value, Access::Value | Access::State)
                | (Access::Command(_), Access::Command(_) | Access::Output)
                | (Access::Output, Access::Output | Access::Setup)
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn command_and_status_may_be_one_register_and_two_equal_commands_may_not() {
        let [any, one, two] = [None, Some(1), Some(2)].map(Access::Command);
        let all = [Access::Value, Access::State, any, one, two, Access::Output, Access::Setup];
        for left in all {
            for right in all {
                assert_eq!(collides(left, right), collides(right, left));
            }
        }
        assert!(!collides(one, Access::State));
        assert!(!collides(one, two));
        assert!(collides(one, one) && collides(any, one) && collides(any, any));
        assert!(!collides(Access::State, Access::State));
        assert!(!collides(any, Access::Setup));
        assert!(collides(Access::Output, Access::Setup));
        assert!(collides(Access::Output, one));
        assert!(collides(Access::Value, Access::Value));
    }
}
