//! Rules for udev that let the group `dialout` use the boards, give them names that stay, and ask
//! FTDI adapters for their shortest latency.

/// The text of a rules file, for `/etc/udev/rules.d/70-taktil-serial.rules`. A board is named by
/// the serial number of its adapter, because paths such as `/dev/ttyACM0` change between plugs.
pub const UDEV_RULES: &str = "\
# Tactile arrays on serial lines: access for the group dialout, and a name that stays.
SUBSYSTEM==\"tty\", KERNEL==\"ttyACM[0-9]*|ttyUSB[0-9]*\", GROUP=\"dialout\", MODE=\"0660\", \\
  SYMLINK+=\"taktil/tactile-$env{ID_SERIAL_SHORT}\"
# FTDI adapters hold bytes for 16 ms unless told otherwise.
ACTION==\"add\", SUBSYSTEM==\"usb-serial\", DRIVER==\"ftdi_sio\", ATTR{latency_timer}=\"1\"
# No daemon may probe the ports as modems.
SUBSYSTEM==\"tty\", KERNEL==\"ttyACM[0-9]*|ttyUSB[0-9]*\", ENV{ID_MM_DEVICE_IGNORE}=\"1\"
";
