//! The dialogue in which a card is opened: its tables are read, the modules set up and the outputs
//! put at their safe values. It may allocate and take its time.

mod remotes;

use taktil_hal::Nanos;

use crate::config::Config;
use crate::cycle::Cycle;
use crate::hostmot2::{
    IDENTITY_ADDRESS, IDENTITY_WORDS, IDROM_WORDS, IdRom, MODULE_WORDS, MODULES_MAX, Module, Pin,
    Tables, idrom_address, text,
};
use crate::lbp16::{ELEMENTS_MAX, PACKET_BYTES_MAX, Packet, Place, Space};
use crate::modules::{encoder, pwm};
use crate::port::Port;
use crate::wiring::Wiring;
use taktil_drivers_exchange::Refusal;

/// How often a question is repeated until the card counts as silent.
const ATTEMPTS_MAX: usize = 10;
/// Datagrams that one attempt takes: answers to earlier attempts.
const ANSWERS_MAX: usize = 16;
/// How often a question is asked that a card need not answer.
const OPTIONAL_ATTEMPTS_MAX: usize = 2;
/// Looks at the scratch words for the trace of another program.
const LOOKS_MAX: usize = 5;
/// From one of these looks to the next: some cycles of any program that drives a card.
const LOOK_PERIOD: Nanos = Nanos::from_millis(10);
/// Words of the card's name in its own firmware.
const NAME_WORDS: usize = 8;
/// Where the number of a question is kept.
const NUMBER_ADDRESS: u16 = 0x10;
/// Where the number of a packet of writes is kept.
const WRITE_NUMBER_ADDRESS: u16 = 0x14;

/// The dialogue with a card.
pub(crate) struct Dialogue<'a> {
    port: &'a mut dyn Port,
    wait: Nanos,
    number: u32,
    /// The address told that nobody listens there.
    refused: bool,
}

impl Dialogue<'_> {
    /// Speaks through `port` and waits for each answer as long as the config says. Numbers of
    /// questions begin behind `number`.
    pub(crate) fn new<'a>(port: &'a mut dyn Port, config: &Config, number: u32) -> Dialogue<'a> {
        let wait = Nanos::from_millis(i64::from(config.open_wait_ms));
        Dialogue { port, wait, number, refused: false }
    }

    /// The number of the newest question.
    pub(crate) fn number(&self) -> u32 {
        self.number
    }

    /// The complaint about questions that nobody answered.
    fn silent(&mut self) -> Refusal {
        if self.refused {
            let what = "the host of this address tells that nobody listens at this port";
            let remedy = "check address and port: a card listens at port 27181";
            return Refusal::new("address", what, remedy);
        }
        if let Some([parse, memory, write]) = self.packet_errors() {
            let what = format!(
                "a card answers, but not this driver's packets; it counts {parse} errors of \
                 commands, {memory} of addresses, {write} of writes"
            );
            let remedy = "load a firmware of the card that speaks LBP16 with 32-bit registers";
            return Refusal::new("address", what, remedy);
        }
        let what = format!("no card answers within {} ms, asked {ATTEMPTS_MAX} times", {
            self.wait.0 / 1_000_000
        });
        let remedy = "check power, cable, the address that the card's jumpers choose, and that \
                      this host has an address in its network";
        Refusal::new("address", what, remedy)
    }

    /// The card's own counts of refused packets, asked without any number; `None` if it does not
    /// answer.
    fn packet_errors(&mut self) -> Option<[u16; 3]> {
        let mut packet = Packet::default();
        let place = packet.read(Space::Counters, 0x02, 3);
        let mut buffer = [0; PACKET_BYTES_MAX];
        self.port.send(packet.bytes()).ok()?;
        self.port.start_wait(self.wait);
        for _ in 0..ANSWERS_MAX {
            let bytes = self.port.receive(&mut buffer)?.min(PACKET_BYTES_MAX);
            // No other question has an answer as short as this one.
            if bytes == packet.answer_bytes() {
                let (low, high) = (place.read(&buffer[..bytes]), &buffer[4..6]);
                let words = low.to_le_bytes();
                return Some([[words[0], words[1]], [words[2], words[3]], [high[0], high[1]]])
                    .map(|words| words.map(u16::from_le_bytes));
            }
        }
        None
    }

    /// Sends a packet and gives the answer, which carries the question's number at its end.
    fn ask(&mut self, build: &mut dyn FnMut(&mut Packet)) -> Result<Vec<u8>, Refusal> {
        match self.ask_up_to(ATTEMPTS_MAX, build)? {
            Some(answer) => Ok(answer),
            None => Err(self.silent()),
        }
    }

    fn ask_up_to(
        &mut self,
        attempts: usize,
        build: &mut dyn FnMut(&mut Packet),
    ) -> Result<Option<Vec<u8>>, Refusal> {
        let mut buffer = [0; PACKET_BYTES_MAX];
        for _ in 0..attempts {
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
                if packet.is_answered_by(answer) && mark.read(answer) == self.number {
                    return Ok(Some(answer[..packet.answer_bytes()].to_vec()));
                }
            }
            self.refused |= self.port.is_refused();
        }
        Ok(None)
    }

    fn send(&mut self, packet: &Packet) -> Result<(), Refusal> {
        self.port.send(packet.bytes()).map_err(|error| {
            let what = format!("nothing can be sent to the card ({error})");
            let remedy = "check that this host has an address in the card's network";
            Refusal::new("address", what, remedy)
        })
    }

    /// Registers from `address` on.
    fn registers(&mut self, address: u16, words: usize) -> Result<Vec<u32>, Refusal> {
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

    fn fixed<const N: usize>(&mut self, address: u16) -> Result<[u32; N], Refusal> {
        let words = self.registers(address, N)?;
        Ok(core::array::from_fn(|word| words[word]))
    }

    /// Reads everything that the card says of itself.
    pub(crate) fn tables(&mut self) -> Result<Tables, Refusal> {
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

    /// The name that the card's own firmware gives it, which tells boards apart whose names in the
    /// IDROM are the same; empty where it gives none.
    pub(crate) fn card_name(&mut self) -> Result<String, Refusal> {
        let answer = self.ask_up_to(OPTIONAL_ATTEMPTS_MAX, &mut |packet| {
            packet.read(Space::Names, 0, NAME_WORDS);
        })?;
        Ok(answer.map_or_else(String::new, |answer| text(&answer[..2 * NAME_WORDS])))
    }

    /// Refuses a card that another program drives: then the scratch words change by themselves.
    /// Gives the mark that stands in the card.
    pub(crate) fn require_sole_master(&mut self) -> Result<u32, Refusal> {
        let mut seen: Option<[u32; 2]> = None;
        for _ in 0..LOOKS_MAX {
            let mut place = Place::default();
            let answer = self.ask(&mut |packet| {
                place = packet.read(Space::Timers, WRITE_NUMBER_ADDRESS, 4);
            })?;
            let words = [place.read(&answer), place.word(1).read(&answer)];
            if seen.is_some_and(|seen| seen != words) {
                let what = "another program drives the card";
                let remedy = "end it, or give the address of another card";
                return Err(Refusal::new("address", what, remedy));
            }
            seen = Some(words);
            self.pause(LOOK_PERIOD);
        }
        Ok(seen.map_or(0, |[_, mark]| mark))
    }

    /// Lets time pass; what arrives meanwhile answers an earlier question and is of no use.
    fn pause(&mut self, time: Nanos) {
        self.port.start_wait(time);
        let mut nothing = [0; PACKET_BYTES_MAX];
        for _ in 0..ANSWERS_MAX {
            if self.port.receive(&mut nothing).is_none() {
                break;
            }
        }
    }

    /// Makes the card safe and sets it up for `wiring`.
    pub(crate) fn set_up(
        &mut self,
        config: &Config,
        wiring: &Wiring,
        cycle: &Cycle,
        session: u32,
    ) -> Result<(), Refusal> {
        if let Some(packet) = cycle.packets().into_iter().find(|packet| !packet.fits_frame()) {
            let (sent, answered) = (packet.bytes().len(), packet.answer_bytes());
            let what = format!("a packet of {sent} bytes with {answered} to answer fits no frame");
            return Err(Refusal::new("encoders", what, "configure fewer channels"));
        }
        if let Some(serial) = &wiring.serial {
            self.stop_serial(serial, &cycle.stop)?;
        }
        self.confirm(&cycle.rearm)?;
        self.confirm(&Cycle::mark(session))?;
        self.set_up_encoders(config, wiring)?;
        self.set_up_pwm(wiring)?;
        if let Some(serial) = &wiring.serial {
            self.identify_remotes(serial, &cycle.stop)?;
            self.confirm(&cycle.start)?;
            self.finish(serial)?;
            self.require_started(serial)?;
        }
        Ok(())
    }

    /// Sends a packet of writes, with a number of its own behind them, and asks whether that number
    /// arrived. A lost packet is repeated.
    fn confirm(&mut self, packet: &Packet) -> Result<(), Refusal> {
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

    fn set_up_encoders(&mut self, config: &Config, wiring: &Wiring) -> Result<(), Refusal> {
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

    fn set_up_pwm(&mut self, wiring: &Wiring) -> Result<(), Refusal> {
        let Some(pwm) = &wiring.pwm else { return Ok(()) };
        let mut packet = Packet::default();
        let rate = pwm.module.address(pwm::RATE_REGISTER, 0);
        packet.write(Space::Registers, rate, &[pwm.modulation.rate]);
        for unit in &pwm.units {
            let mode = pwm.module.address(pwm::MODE_REGISTER, *unit);
            packet.write(Space::Registers, mode, &[pwm.modulation.mode_word()]);
        }
        self.confirm(&packet)
    }
}
