//! The part of the dialogue that concerns smart serial: its processors are stopped and started, and
//! every remote tells its name.

use taktil_hal::Nanos;

use super::Dialogue;
use crate::lbp16::{Packet, Space};
use crate::modules::sserial;
use crate::wiring::SerialWiring;
use taktil_drivers_exchange::Refusal;

/// How often the command register is read until smart serial counts as stuck: remotes that are
/// started are waited for by the processor, some 100 ms each.
const COMMAND_READS_MAX: usize = 2_000;
/// Readings without a pause between them: most commands are done after one or two.
const QUICK_READS_COUNT: usize = 20;
/// The pause between later ones.
const READ_PAUSE: Nanos = Nanos::from_millis(1);
/// How often the state of a channel that was started is read until it counts as faulty.
const STATE_READS_MAX: usize = 50;

impl Dialogue<'_> {
    /// Stops all ports. A processor that does not take the command, as after a program that was
    /// ended in the middle of one, is reset first.
    pub(super) fn stop_serial(
        &mut self,
        serial: &SerialWiring,
        stop: &Packet,
    ) -> Result<(), Refusal> {
        self.confirm(stop)?;
        if self.is_finished(serial)? {
            return Ok(());
        }
        for command in [sserial::RESET_COMMAND, sserial::CLEAR_COMMAND] {
            let mut packet = Packet::default();
            for (port, _) in serial.ports() {
                packet.write(Space::Registers, serial.command_address(port), &[command]);
            }
            self.confirm(&packet)?;
        }
        self.finish(serial)?;
        self.confirm(stop)?;
        self.finish(serial)
    }

    /// Whether all ports have done their commands.
    fn is_finished(&mut self, serial: &SerialWiring) -> Result<bool, Refusal> {
        for (port, _) in serial.ports() {
            let mut reads = 0;
            while self.fixed::<1>(serial.command_address(port))? != [0] {
                reads += 1;
                if reads == COMMAND_READS_MAX {
                    return Ok(false);
                }
                if reads >= QUICK_READS_COUNT {
                    self.pause(READ_PAUSE);
                }
            }
        }
        Ok(true)
    }

    /// Waits until all ports have done their commands.
    pub(super) fn finish(&mut self, serial: &SerialWiring) -> Result<(), Refusal> {
        if self.is_finished(serial)? {
            return Ok(());
        }
        let what = "smart serial does not finish a command";
        Err(Refusal::new("analog", what, "switch the card off and on"))
    }

    /// Asks the remotes for their names, in setup mode, and stops them again.
    pub(super) fn identify_remotes(
        &mut self,
        serial: &SerialWiring,
        stop: &Packet,
    ) -> Result<(), Refusal> {
        let mut packet = Packet::default();
        for (port, mask) in serial.ports() {
            let command = sserial::SETUP_COMMAND | mask;
            packet.write(Space::Registers, serial.command_address(port), &[command]);
        }
        self.confirm(&packet)?;
        self.finish(serial)?;
        for remote in &serial.remotes {
            let used = [
                (remote.field, sserial::FIELD_UNIT, "field terminals"),
                (remote.analog, sserial::ANALOG_UNIT, "analog outputs"),
            ];
            for (channel, unit, role) in used {
                if let Some(channel) = channel {
                    self.require_remote(serial, remote.port, channel, unit, role)?;
                }
            }
        }
        self.confirm(stop)?;
        self.finish(serial)
    }

    fn require_remote(
        &mut self,
        serial: &SerialWiring,
        port: usize,
        channel: usize,
        unit: u32,
        role: &str,
    ) -> Result<(), Refusal> {
        let user = |register| serial.address(sserial::USER_REGISTER + register, port, channel);
        let ([number], [name]) = (self.fixed::<1>(user(0))?, self.fixed::<1>(user(1))?);
        let at = place_name(port, channel);
        if name == 0 {
            let what = format!("no remote answers on smart-serial channel {at}");
            let remedy = "check the 7I77's power (both field and logic supply) and its cable";
            return Err(Refusal::new("remotes", what, remedy));
        }
        if name != sserial::NAME_WORD || number >> 24 != unit {
            let letters = name.to_le_bytes();
            let letters = String::from_utf8_lossy(&letters);
            let what = format!(
                "smart-serial channel {at} is {letters:?}, number {number:#010x}, not the {role} \
                 of a 7I77"
            );
            return Err(Refusal::new("remotes", what, "correct `remotes` or the cable"));
        }
        Ok(())
    }

    /// Refuses channels that were started and are not running.
    pub(super) fn require_started(&mut self, serial: &SerialWiring) -> Result<(), Refusal> {
        for remote in &serial.remotes {
            for channel in remote.used() {
                let address = serial.address(sserial::STATUS_REGISTER, remote.port, channel);
                let [mut state] = self.fixed::<1>(address)?;
                for _ in 0..STATE_READS_MAX {
                    if state & sserial::RESTART_MASK == 0 {
                        break;
                    }
                    self.pause(READ_PAUSE);
                    [state] = self.fixed::<1>(address)?;
                }
                if state & sserial::RESTART_MASK != 0 {
                    let at = place_name(remote.port, channel);
                    let what = format!("smart-serial channel {at} starts with state {state:#010x}");
                    let remedy = "check the 7I77's power and its cable";
                    return Err(Refusal::new("remotes", what, remedy));
                }
            }
        }
        Ok(())
    }
}

/// The channel as people count it.
fn place_name(port: usize, channel: usize) -> String {
    if port == 0 { channel.to_string() } else { format!("{channel} of port {port}") }
}
