//! What the halves of a driver ask of the kernel within a job. Each driver has one list, which
//! people read and which the real-time sanitizer permits; a call that is not on it is a fault of
//! the driver.

/// A system call that the halves of a driver may make within a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SystemCall {
    /// Name of the C library's function, as the linker knows it: lower-case letters, digits and
    /// `_`, such as `recv` or `pread64`.
    pub name: &'static str,
    /// Which half makes it, and why it returns within the time that the half declares.
    pub about: &'static str,
}

impl SystemCall {
    /// Whether the name is one that a function of the C library can have.
    ///
    /// ```
    /// use taktil_hal::SystemCall;
    ///
    /// let named = |name| SystemCall { name, about: "reads a channel" };
    /// assert!(named("pread64").has_good_name());
    /// // A pattern would permit more than the driver says.
    /// assert!(!named("*").has_good_name());
    /// ```
    #[must_use]
    pub fn has_good_name(&self) -> bool {
        let good = |c: u8| c.is_ascii_lowercase() || c.is_ascii_digit() || c == b'_';
        !self.name.is_empty() && self.name.bytes().all(good)
    }
}
