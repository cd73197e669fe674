//! A frame on the bus, and the bytes by which Linux passes it.

/// A frame.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct BusFrame {
    /// The word of the identifier with its three flags, as Linux has it.
    pub word: u32,
    /// Whether it is a frame of CAN FD.
    pub is_fd: bool,
    /// Its data.
    pub data: Vec<u8>,
}

impl BusFrame {
    /// A classic frame with an identifier of 11 bits.
    #[must_use]
    pub fn classic(id: u32, data: &[u8]) -> BusFrame {
        BusFrame { word: id, is_fd: false, data: data.to_vec() }
    }

    /// The identifier without flags.
    #[must_use]
    pub fn id(&self) -> u32 {
        self.word & 0x1fff_ffff
    }

    /// Whether it asks for data.
    #[must_use]
    pub fn is_remote(&self) -> bool {
        self.word & 0x4000_0000 != 0
    }

    /// Its bytes: a `struct can_frame` of 16 or a `struct canfd_frame` of 72.
    #[must_use]
    pub fn bytes(&self) -> Vec<u8> {
        let mut bytes = vec![0; if self.is_fd { 72 } else { 16 }];
        bytes[..4].copy_from_slice(&self.word.to_ne_bytes());
        bytes[4] = self.data.len() as u8;
        bytes[5] = if self.is_fd { 5 } else { 0 };
        bytes[8..8 + self.data.len()].copy_from_slice(&self.data);
        bytes
    }

    /// The frame of such bytes; `None` for others.
    #[must_use]
    pub fn from_bytes(bytes: &[u8]) -> Option<BusFrame> {
        let word = u32::from_ne_bytes(bytes.get(..4)?.try_into().ok()?);
        let data = bytes.get(8..8 + usize::from(bytes[4]))?.to_vec();
        match (bytes.len(), data.len()) {
            (16, 0..=8) => Some(BusFrame { word, is_fd: false, data }),
            (72, 0..=64) => Some(BusFrame { word, is_fd: true, data }),
            _ => None,
        }
    }
}

/// The report of a controller that is in trouble: the class of the error, and the state of the
/// controller in the second byte.
#[must_use]
pub fn error_report(class: u32, state: u8) -> BusFrame {
    BusFrame { word: 0x2000_0000 | class, is_fd: false, data: vec![0, state, 0, 0, 0, 0, 0, 0] }
}
