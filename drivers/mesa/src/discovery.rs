//! The dialogue in which a card is opened: its tables are read, the remotes named, the modules set
//! up and the outputs put at their safe values. It may allocate and take its time.

use taktil_hal::Nanos;

use crate::config::Config;
use crate::cycle::Cycle;
use crate::error::Unfit;
use crate::hostmot2::{
    IDENTITY_ADDRESS, IDENTITY_WORDS, IDROM_WORDS, IdRom, MODULE_WORDS, MODULES_MAX, Module, Pin,
    Tables, idrom_address,
};
use crate::lbp16::{ELEMENTS_MAX, PACKET_BYTES_MAX, Packet, Place, Space};
use crate::modules::{encoder, pwm, sserial};
use crate::port::Port;
use crate::wiring::{SerialWiring, Wiring};

/// How often a question is repeated until the card counts as silent.
const ATTEMPTS_MAX: usize = 10;
/// Datagrams that one attempt takes: answers to earlier attempts.
const ANSWERS_MAX: usize = 16;
/// How often the command register is read until smart serial counts as stuck.
const COMMAND_READS_MAX: usize = 2_000;
/// Where the number of a question is kept.
const NUMBER_ADDRESS: u16 = 0x10;
/// Where the number of a packet of writes is kept.
const WRITE_NUMBER_ADDRESS: u16 = 0x14;

/// The dialogue with a card.
pub(crate) struct Dialogue<'a> {
    port: &'a mut dyn Port,
    wait: Nanos,
    number: u32,
}

impl Dialogue<'_> {
    /// Speaks through `port` and waits for each answer as long as the config says. Numbers of
    /// questions begin behind `number`.
    pub(crate) fn new<'a>(port: &'a mut dyn Port, config: &Config, number: u32) -> Dialogue<'a> {
        let wait = Nanos::from_millis(i64::from(config.open_wait_ms));
        Dialogue { port, wait, number }
    }

    /// The number of the newest question.
    pub(crate) fn number(&self) -> u32 {
        self.number
    }

    fn silent(&self) -> Unfit {
        let what = format!("no card answers within {} ms, asked {ATTEMPTS_MAX} times", {
            self.wait.0 / 1_000_000
        });
        let remedy = "check power, cable, the address that the card's jumpers choose, and that \
                      this host has an address in its network";
        Unfit::new("address", what, remedy)
    }

    /// Sends a packet and gives the answer, which carries the question's number at its end.
    fn ask(&mut self, build: &mut dyn FnMut(&mut Packet)) -> Result<Vec<u8>, Unfit> {
        let mut buffer = [0; PACKET_BYTES_MAX];
        for _ in 0..ATTEMPTS_MAX {
            self.number = self.number.wrapping_add(1);
            let mut packet = Packet::default();
            packet.write(Space::Timers, NUMBER_ADDRESS, &[self.number]);
            build(&mut packet);
            let mark = packet.read(Space::Timers, NUMBER_ADDRESS, 2);
            self.send(&packet)?;
            self.port.start_wait(self.wait);
            for _ in 0..ANSWERS_MAX {
                let Some(bytes) = self.port.receive(&mut buffer) else { break };
                let answer = &buffer[..bytes.min(PACKET_BYTES_MAX)];
                if answer.len() == packet.answer_bytes() && mark.read(answer) == self.number {
                    return Ok(answer.to_vec());
                }
            }
        }
        Err(self.silent())
    }

    fn send(&mut self, packet: &Packet) -> Result<(), Unfit> {
        self.port.send(packet.bytes()).map_err(|error| {
            let what = format!("nothing can be sent to the card ({error})");
            let remedy = "check that this host has an address in the card's network";
            Unfit::new("address", what, remedy)
        })
    }

    /// Registers from `address` on.
    fn registers(&mut self, address: u16, words: usize) -> Result<Vec<u32>, Unfit> {
        let mut all = Vec::new();
        while all.len() < words {
            let part = (words - all.len()).min(ELEMENTS_MAX);
            let from = address.wrapping_add(4 * all.len() as u16);
            let answer = self.ask(&mut |packet| {
                packet.read(Space::Registers, from, part);
            })?;
            let first = Place::default();
            all.extend((0..part).map(|word| first.word(word).read(&answer)));
        }
        Ok(all)
    }

    fn fixed<const N: usize>(&mut self, address: u16) -> Result<[u32; N], Unfit> {
        let words = self.registers(address, N)?;
        Ok(core::array::from_fn(|word| words[word]))
    }

    /// Reads everything that the card says of itself.
    pub(crate) fn tables(&mut self) -> Result<Tables, Unfit> {
        let identity = self.fixed::<IDENTITY_WORDS>(IDENTITY_ADDRESS)?;
        let address = idrom_address(&identity)?;
        let idrom = IdRom::parse(&self.fixed::<IDROM_WORDS>(address)?, address)?;
        let words = self.registers(idrom.modules_address, MODULES_MAX * MODULE_WORDS)?;
        let entries = words.chunks_exact(MODULE_WORDS);
        let modules = entries
            .map_while(|entry| Module::parse([entry[0], entry[1], entry[2]], &idrom))
            .collect();
        let pins = self.registers(idrom.pins_address, idrom.pins)?;
        let pins = pins.into_iter().map(Pin::parse).collect();
        Ok(Tables { idrom, modules, pins })
    }

    /// Makes the card safe and sets it up for `wiring`.
    pub(crate) fn set_up(
        &mut self,
        config: &Config,
        wiring: &Wiring,
        cycle: &Cycle,
        session: u32,
    ) -> Result<(), Unfit> {
        if let Some(packet) = cycle.packets().into_iter().find(|packet| !packet.fits_frame()) {
            let (sent, answered) = (packet.bytes().len(), packet.answer_bytes());
            let what = format!("a packet of {sent} bytes with {answered} to answer fits no frame");
            return Err(Unfit::new("encoders", what, "configure fewer channels"));
        }
        if let Some(serial) = &wiring.serial {
            self.command(serial, sserial::STOP_COMMAND)?;
        }
        self.confirm(&cycle.rearm)?;
        self.confirm(&Cycle::mark(session))?;
        self.set_up_encoders(config, wiring)?;
        self.set_up_pwm(config, wiring)?;
        if let Some(serial) = &wiring.serial {
            self.set_up_serial(serial)?;
            self.confirm(&cycle.start)?;
            self.finish(serial)?;
            self.require_started(serial)?;
        }
        Ok(())
    }

    /// Sends a packet of writes, with a number of its own behind them, and asks whether that number
    /// arrived. A lost packet is repeated.
    fn confirm(&mut self, packet: &Packet) -> Result<(), Unfit> {
        for _ in 0..ATTEMPTS_MAX {
            let number = self.number.wrapping_add(1);
            let mut numbered = packet.clone();
            numbered.write(Space::Timers, WRITE_NUMBER_ADDRESS, &[number]);
            self.send(&numbered)?;
            let mut place = Place::default();
            let answer = self.ask(&mut |packet| {
                place = packet.read(Space::Timers, WRITE_NUMBER_ADDRESS, 2);
            })?;
            if place.read(&answer) == number {
                return Ok(());
            }
        }
        Err(self.silent())
    }

    fn set_up_encoders(&mut self, config: &Config, wiring: &Wiring) -> Result<(), Unfit> {
        let Some(module) = &wiring.encoders else { return Ok(()) };
        let mut packet = Packet::default();
        let divisor = encoder::divisor_word(module.clock_hz);
        let address = module.address(encoder::DIVISOR_REGISTER, 0);
        packet.write(Space::Registers, address, &[divisor]);
        for channel in 0..config.encoders {
            let address = module.address(encoder::CONTROL_REGISTER, channel);
            let control =
                if config.index { encoder::FIRST_PULSE_CONTROL } else { encoder::PLAIN_CONTROL };
            packet.write(Space::Registers, address, &[control]);
        }
        self.confirm(&packet)
    }

    fn set_up_pwm(&mut self, config: &Config, wiring: &Wiring) -> Result<(), Unfit> {
        let Some((module, modulation)) = &wiring.pwm else { return Ok(()) };
        let mut packet = Packet::default();
        let rate = module.address(pwm::RATE_REGISTER, 0);
        packet.write(Space::Registers, rate, &[modulation.rate]);
        for unit in 0..config.analog_channels {
            let mode = module.address(pwm::MODE_REGISTER, unit);
            packet.write(Space::Registers, mode, &[modulation.mode_word()]);
        }
        self.confirm(&packet)
    }

    /// Gives smart serial a command and waits until it is done.
    fn command(&mut self, serial: &SerialWiring, command: u32) -> Result<(), Unfit> {
        let address = serial.address(sserial::COMMAND_REGISTER, 0);
        let mut packet = Packet::default();
        packet.write(Space::Registers, address, &[command]);
        self.confirm(&packet)?;
        self.finish(serial)
    }

    fn finish(&mut self, serial: &SerialWiring) -> Result<(), Unfit> {
        let address = serial.address(sserial::COMMAND_REGISTER, 0);
        for _ in 0..COMMAND_READS_MAX {
            if self.fixed::<1>(address)? == [0] {
                return Ok(());
            }
        }
        let what = "smart serial does not finish a command";
        Err(Unfit::new("analog", what, "switch the card off and on"))
    }

    /// Asks the remotes for their names, in setup mode, and stops them again.
    fn set_up_serial(&mut self, serial: &SerialWiring) -> Result<(), Unfit> {
        let mask = serial.field_mask() | serial.analog_mask();
        self.command(serial, sserial::SETUP_COMMAND | mask)?;
        let used = [
            (serial.field, sserial::FIELD_UNIT, "field terminals"),
            (serial.analog, sserial::ANALOG_UNIT, "analog outputs"),
        ];
        for (channel, unit, role) in used {
            if let Some(channel) = channel {
                self.require_remote(serial, channel, unit, role)?;
            }
        }
        self.command(serial, sserial::STOP_COMMAND)
    }

    fn require_remote(
        &mut self,
        serial: &SerialWiring,
        channel: usize,
        unit: u32,
        role: &str,
    ) -> Result<(), Unfit> {
        let user = |register| serial.address(sserial::USER_REGISTER + register, channel);
        let ([number], [name]) = (self.fixed::<1>(user(0))?, self.fixed::<1>(user(1))?);
        let place = "serial_channel";
        if name == 0 {
            let what = format!("no remote answers on smart-serial channel {channel}");
            let remedy = "check the 7I77's power (both field and logic supply) and its cable";
            return Err(Unfit::new(place, what, remedy));
        }
        if name != sserial::NAME_WORD || number >> 24 != unit {
            let letters = name.to_le_bytes();
            let letters = String::from_utf8_lossy(&letters);
            let what = format!(
                "smart-serial channel {channel} is {letters:?}, number {number:#010x}, not the \
                 {role} of a 7I77"
            );
            return Err(Unfit::new(place, what, "correct `serial_channel` or the cable"));
        }
        Ok(())
    }

    fn require_started(&mut self, serial: &SerialWiring) -> Result<(), Unfit> {
        for channel in [serial.field, serial.analog].into_iter().flatten() {
            let address = serial.address(sserial::STATUS_REGISTER, channel);
            let [state] = self.fixed::<1>(address)?;
            if state & sserial::RESTART_MASK != 0 {
                let what =
                    format!("smart-serial channel {channel} starts with state {state:#010x}");
                let remedy = "check the 7I77's power and its cable";
                return Err(Unfit::new("serial_channel", what, remedy));
            }
        }
        Ok(())
    }
}
