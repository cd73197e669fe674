//! The controlword (6040) and the commands of the standard's diagram.

/// The word of object 6040. The constants are the diagram's commands, with every bit that a command
/// leaves open at 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Controlword(pub u16);

impl Controlword {
    /// Torque off at once, from every state (transitions 7, 9, 10, 12).
    pub const DISABLE_VOLTAGE: Controlword = Controlword(0x0000);
    /// Stop as object 605A says (transition 11; 7 and 10 from below operation).
    pub const QUICK_STOP: Controlword = Controlword(0x0002);
    /// To ready to switch on (transitions 2, 6, 8).
    pub const SHUT_DOWN: Controlword = Controlword(0x0006);
    /// To switched on (transition 3), or operation off (transition 5).
    pub const SWITCH_ON: Controlword = Controlword(0x0007);
    /// Operation on (transitions 4 and 16).
    pub const ENABLE_OPERATION: Controlword = Controlword(0x000f);
    /// The rising edge of its bit 7 resets a fault (transition 15); torque stays off.
    pub const FAULT_RESET: Controlword = Controlword(0x0080);

    /// Whether bit 7, whose rising edge resets a fault, is set.
    #[must_use]
    pub const fn has_fault_reset(self) -> bool {
        self.0 & Controlword::FAULT_RESET.0 != 0
    }
}
