//! What is counted on a bus, each number with its name for people.

/// What was counted on a bus.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BusCounts {
    /// Exchanges.
    pub cycles: u64,
    /// Answers of drives that came in time.
    pub answers: u64,
    /// Answers that did not.
    pub missing: u64,
    /// Answers that came before anybody had asked: late ones.
    pub late: u64,
    /// Frames that the interface did not take because its queue was full (ENOBUFS).
    pub full: u64,
    /// Frames that the interface did not take because it is down.
    pub down: u64,
    /// Error frames of the controller.
    pub errors: u64,
    /// Error frames by which the controller says that it is off the bus.
    pub bus_offs: u64,
    /// Error frames by which it says that it is error passive.
    pub passive: u64,
    /// Error frames because nobody acknowledged.
    pub unacknowledged: u64,
    /// Error frames by which it says that it was restarted.
    pub restarts: u64,
    /// Emergency messages of drives.
    pub emergencies: u64,
    /// Drives that restarted.
    pub drive_restarts: u64,
    /// Drives that left the exchange.
    pub departures: u64,
    /// Drives that fell silent.
    pub silences: u64,
}

impl BusCounts {
    /// How many numbers there are.
    pub(crate) const NUMBERS_COUNT: usize = 15;

    /// Their names, in the order of the fields.
    pub(crate) const NAMES: [&'static str; BusCounts::NUMBERS_COUNT] = [
        "cycles",
        "answers",
        "missing answers",
        "late answers",
        "frames not sent, queue full",
        "frames not sent, interface down",
        "error frames",
        "bus-off",
        "error passive",
        "not acknowledged",
        "restarts of the controller",
        "emergency messages",
        "drives restarted",
        "drives that left",
        "drives gone silent",
    ];

    pub(crate) fn numbers(&self) -> [u64; BusCounts::NUMBERS_COUNT] {
        [
            self.cycles,
            self.answers,
            self.missing,
            self.late,
            self.full,
            self.down,
            self.errors,
            self.bus_offs,
            self.passive,
            self.unacknowledged,
            self.restarts,
            self.emergencies,
            self.drive_restarts,
            self.departures,
            self.silences,
        ]
    }
}
