//! Objects of the drive's dictionary that drivers map or write: index, sub-index and width.

/// An entry of the object dictionary.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Object {
    /// Index.
    pub index: u16,
    /// Sub-index.
    pub sub: u8,
    /// Width (bits).
    pub bits: u8,
}

impl Object {
    /// Error code, u16.
    pub const ERROR_CODE: Object = Object::new(0x603f, 0, 16);
    /// Controlword, u16.
    pub const CONTROL_WORD: Object = Object::new(0x6040, 0, 16);
    /// Statusword, u16.
    pub const STATUS_WORD: Object = Object::new(0x6041, 0, 16);
    /// Quick stop option code, i16.
    pub const QUICK_STOP_OPTION: Object = Object::new(0x605a, 0, 16);
    /// Mode of operation, i8.
    pub const OPERATION_MODE: Object = Object::new(0x6060, 0, 8);
    /// Mode of operation as displayed, i8.
    pub const OPERATION_MODE_DISPLAY: Object = Object::new(0x6061, 0, 8);
    /// Actual position, i32.
    pub const ACTUAL_POSITION: Object = Object::new(0x6064, 0, 32);
    /// Actual velocity, i32.
    pub const ACTUAL_VELOCITY: Object = Object::new(0x606c, 0, 32);
    /// Target torque, i16, in thousandths of the rated torque.
    pub const TARGET_TORQUE: Object = Object::new(0x6071, 0, 16);
    /// Greatest torque, u16, in thousandths of the rated torque.
    pub const TORQUE_MAX: Object = Object::new(0x6072, 0, 16);
    /// Rated torque of the motor, u32 (mNm).
    pub const RATED_TORQUE: Object = Object::new(0x6076, 0, 32);
    /// Actual torque, i16, in thousandths of the rated torque.
    pub const ACTUAL_TORQUE: Object = Object::new(0x6077, 0, 16);
    /// Target position, i32.
    pub const TARGET_POSITION: Object = Object::new(0x607a, 0, 32);
    /// Torque offset, i16, in thousandths of the rated torque.
    pub const TORQUE_OFFSET: Object = Object::new(0x60b2, 0, 16);
    /// Interpolation period, value, u8.
    pub const INTERPOLATION_VALUE: Object = Object::new(0x60c2, 1, 8);
    /// Interpolation period, power of ten, i8.
    pub const INTERPOLATION_EXPONENT: Object = Object::new(0x60c2, 2, 8);
    /// Target velocity, i32.
    pub const TARGET_VELOCITY: Object = Object::new(0x60ff, 0, 32);
    /// Supported modes, u32.
    pub const SUPPORTED_MODES: Object = Object::new(0x6502, 0, 32);
    /// What the drive does when its bus is interrupted, i16.
    pub const ABORT_CONNECTION_OPTION: Object = Object::new(0x6007, 0, 16);

    /// An entry.
    #[must_use]
    pub const fn new(index: u16, sub: u8, bits: u8) -> Object {
        Object { index, sub, bits }
    }

    /// The entry as a PDO mapping writes it: index, sub-index, bits.
    #[must_use]
    pub const fn mapping(self) -> u32 {
        (self.index as u32) << 16 | (self.sub as u32) << 8 | self.bits as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mapping_is_index_sub_index_and_bits() {
        assert_eq!(Object::CONTROL_WORD.mapping(), 0x6040_0010);
        assert_eq!(Object::ACTUAL_POSITION.mapping(), 0x6064_0020);
        assert_eq!(Object::INTERPOLATION_EXPONENT.mapping(), 0x60c2_0208);
    }
}
