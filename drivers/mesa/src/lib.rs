//! HostMot2 cards with an Ethernet port (Mesa 7I92, 7I80, 7I96S and their kin): encoders, plain or
//! muxed, with index pulses; the analog outputs and field terminals of a 7I77 behind smart serial,
//! or pulse-width modulators; lines at terminals or pins; the FPGA's watchdog.
//!
//! The card describes itself: cookie, config name, IDROM, modules and pins are read when it is
//! opened, every address comes from the module table, and what does not fit the configuration is
//! refused by name.
//!
//! # A cycle
//!
//! One packet asks for everything, one puts everything out. The first input half that is sampled
//! sends the request and waits for its answer; the others get the same answer.
//! [`CardMonitor::request`] sends it earlier in the job, which then does something else meanwhile.
//! The output half that commits last sends both halves' values; which one that is it learns from
//! the cycle before. An answer belongs to a request by the number that it carries: late, doubled
//! and damaged ones are counted and discarded.
//!
//! System calls after opening: those of [`SYSTEM_CALLS`], on two descriptors. How long a job may
//! wait in a half [`Config::wait_bound`] tells, for whoever analyses the schedule: a `sample` waits
//! at most `wait_share` of the period, five times that in the very first cycle of a card whose
//! input lines stand at a 7I77's terminals; a `commit` or `safe` waits only where smart serial has
//! not finished the exchange before (two of them within one cycle), at most four times `wait_share`
//! of the period. A wait sleeps in `poll`; with `busy_poll` it asks again and again until its end,
//! and is processor time of the lane.
//!
//! [`CardMonitor`] tells requests, losses, late, doubled and overtaken answers, bites and more to
//! any thread, without entering the card: the halves publish the numbers when they leave it.
//!
//! The halves of a card belong on one lane. They may be on several: a half that finds another one
//! in the card answers with a transient error at once, and going safe is then done by the other.
//!
//! # When something bites
//!
//! A bite of the FPGA's watchdog only makes its pins inputs; a 7I77 has a watchdog of its own that
//! only stopping and starting clears. The driver sees both in the next answer, and then writes
//! zeros, directions, and only then clears the status; it stops and starts smart serial, exchanges
//! zeros, and only then puts values out again. Until then every commit answers with a transient
//! error. A card that restarted has lost its counts: it is gone until it is opened anew, as after
//! `lost_ms` of silence. A card that another program has opened is gone as well, and nothing is
//! written to it any more; a card that another program is driving is not opened.
//!
//! Longest silence: a 7I77 goes to 0 V `remote_watchdog_ms` after the last exchange, modulators
//! and pins after `watchdog_ms`. An exchange and a sign of life go out only as long as every half
//! that is not at its safe value commits, the lines with a change of the feed line. A pin that the
//! FPGA lets go is pulled up by most cards: an output there has to be low when it is true.
//!
//! # Speeds, and what is not offered
//!
//! Speeds from the stamps of the edges stand in [`MesaEncoders::speeds_counts_s`] and in
//! [`CardMonitor::speeds_counts_s`]; hal's encoders have no place for them, and tasks of the arm
//! differentiate counts. Step generators are not offered: an analog output carries what a motor's
//! torque is proportional to, and a step rate is no such thing.

mod card;
mod config;
mod cycle;
mod discovery;
mod halves;
pub mod hostmot2;
pub mod lbp16;
mod link;
mod modules;
mod port;
mod recovery;
mod wiring;

use std::sync::Arc;

pub use taktil_drivers_exchange::LEVEL_LIMIT;
use taktil_drivers_exchange::{Refusal, Shared};
pub use taktil_hal::OpenError;
use taktil_hal::{DacCode, Nanos, SystemCall};

pub use config::{
    Analog, Config, EncoderKind, Line, LinesInConfig, LinesOutConfig, OutputPlace,
    REMOTE_VOLTS_PER_CODE, RemotePlace, Terminal, WaitBound,
};

pub use halves::{CardMonitor, MesaAnalogOut, MesaDigitalIn, MesaDigitalOut, MesaEncoders};
pub use link::Diagnostics;
pub use port::{Port, UdpPort};

use card::Card;
use cycle::Cycle;
use discovery::Dialogue;
use halves::OutputTimes;
use link::CardNumbers;
use modules::sserial;
use wiring::Wiring;

/// What the halves ask of the kernel within a job.
pub const SYSTEM_CALLS: &[SystemCall] = &[
    SystemCall {
        name: "send",
        about: "the request of the first half that is sampled, the values of the half that commits \
                last, and steps of recovery; the socket does not block",
    },
    SystemCall {
        name: "recv",
        about: "takes one datagram; the socket does not block, and calls of a wait are counted",
    },
    SystemCall {
        name: "poll",
        about: "waits for an answer; the timer ends it, within the wait that the half declares",
    },
    SystemCall { name: "timerfd_settime", about: "sets the end of a wait before it begins" },
];

/// The halves that a card offers by its configuration.
#[derive(Debug)]
pub struct Halves {
    /// Encoder channels, where some are wired.
    pub encoders: Option<MesaEncoders>,
    /// Analog outputs or modulators, where they are used.
    pub analog_out: Option<MesaAnalogOut>,
    /// Lines from the cell, where they are configured.
    pub digital_in: Option<MesaDigitalIn>,
    /// Lines to the cell, where they are configured.
    pub digital_out: Option<MesaDigitalOut>,
    /// Early requests and counts.
    pub monitor: CardMonitor,
}

/// What a card says of itself.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CardIdentity {
    /// Name in the table of the FPGA's configuration, such as `MESA7I92`.
    pub board: String,
    /// Name by the card's own firmware; empty where it gives none.
    pub card: String,
    /// The modules of the configuration with their numbers of instances, for people.
    pub modules: Vec<String>,
    /// Pins of the card.
    pub pins: usize,
}

/// Opens a card and splits it into its halves.
#[derive(Debug)]
pub struct Board;

impl Board {
    /// Connects to the card that `config` names, reads its tables, sets it up and puts its outputs
    /// at their safe values.
    ///
    /// # Errors
    /// The config is refused; nothing answers; what answers is no such card, or its configuration
    /// lacks what is asked for. The outputs were not driven then.
    pub fn open(config: &Config) -> Result<Halves, OpenError> {
        config.check()?;
        let port = UdpPort::connect(&config.address, config.local_port, config.busy_poll);
        let port = port.map_err(|error| {
            let unfit = if error.kind() == std::io::ErrorKind::AddrInUse {
                let what = format!("port {} of this host is in use", config.local_port);
                let remedy = "end the program that has it, or give another one or 0";
                Refusal::new("local_port", what, remedy)
            } else {
                let what = format!("no socket can be connected to it ({error})");
                let remedy = "give this host an address in the card's network";
                Refusal::new("address", what, remedy)
            };
            unfit.at(&config.address)
        })?;
        Board::attach(Box::new(port), config)
    }

    /// Asks the card at an address what it is; each answer is waited for at most `wait`. Nothing is
    /// set up, and nothing is written but the number of the question.
    ///
    /// # Errors
    /// Nobody answers, or what answers is no such card.
    pub fn identify(address: &str, wait: Nanos) -> Result<CardIdentity, OpenError> {
        let port = UdpPort::connect(address, 0, false);
        let mut port = port.map_err(|error| {
            let what = format!("no socket can be connected to it ({error})");
            let remedy = "give this host an address in the card's network";
            Refusal::new("address", what, remedy).at(address)
        })?;
        let open_wait_ms = u32::try_from(wait.0 / 1_000_000).unwrap_or(u32::MAX).max(1);
        let config = Config { open_wait_ms, ..Config::default() };
        let first = SESSION_MARK ^ std::process::id();
        let mut dialogue = Dialogue::new(&mut port, &config, first);
        let tables = dialogue.tables().map_err(|unfit| unfit.at(address))?;
        let card = dialogue.card_name().map_err(|unfit| unfit.at(address))?;
        let module = |module: &hostmot2::Module| {
            let name = hostmot2::module_name(module.tag);
            format!("{name} x {} (version {})", module.instances, module.version)
        };
        let modules = tables.modules.iter().map(module).collect();
        Ok(CardIdentity { board: tables.idrom.board_name, card, modules, pins: tables.pins.len() })
    }

    /// Takes a link that exists already, such as to a model of the card in the same process;
    /// `config.address` appears in messages only.
    ///
    /// # Errors
    /// As [`Board::open`].
    pub fn attach(port: Box<dyn Port>, config: &Config) -> Result<Halves, OpenError> {
        config.check_card()?;
        Board::split(port, config).map_err(|unfit| unfit.at(&config.address))
    }

    fn split(mut port: Box<dyn Port>, config: &Config) -> Result<Halves, Refusal> {
        let first = SESSION_MARK ^ std::process::id();
        let mut dialogue = Dialogue::new(port.as_mut(), config, first);
        let tables = dialogue.tables()?;
        if tables.idrom.require_board(&config.board, "").is_err() {
            let name = dialogue.card_name()?;
            tables.idrom.require_board(&config.board, &name)?;
        }
        let wiring = Wiring::new(config, &tables)?;
        let cycle = Cycle::new(config, &wiring);
        let session = session_mark(first, dialogue.require_sole_master()?);
        dialogue.set_up(config, &wiring, &cycle, session)?;
        let number = dialogue.number();
        let card = Card::new(port, cycle, config, &wiring, session, number);
        Ok(Board::halves(Arc::new(Shared::new(card, CardNumbers::default())), config, &wiring))
    }

    fn halves(shared: Arc<Shared<Card>>, config: &Config, wiring: &Wiring) -> Halves {
        let ms = |ms: u32| Nanos::from_millis(i64::from(ms));
        let watchdog = ms(config.watchdog_ms);
        let remote = ms(config.remote_watchdog_ms);
        let modulation = wiring.pwm.as_ref().map(|pwm| pwm.modulation.code_max());
        let analog = match (config.analog, modulation) {
            (Analog::Remote, _) => Some((sserial::CODE_MIN, sserial::CODE_MAX, remote)),
            (Analog::Pwm, Some(most)) => Some((-most, most, watchdog)),
            _ => None,
        };
        let at_terminals = config.has_remote_lines();
        let silence = if at_terminals { watchdog.max(remote) } else { watchdog };
        // The first half of a cycle waits for both of its direction.
        let WaitBound { sample, commit, .. } = config.wait_bound();
        let lines_sample = if config.encoders > 0 { Nanos::ZERO } else { sample };
        let lines_commit = if analog.is_some() { Nanos::ZERO } else { commit };
        let lines_times = OutputTimes { longest_silence: silence, wait: lines_commit };
        Halves {
            encoders: (config.encoders > 0)
                .then(|| MesaEncoders::new(shared.clone(), config.encoders, config.index, sample)),
            analog_out: analog.map(|(low, high, silence)| {
                let (low, high) = (DacCode(low), DacCode(high));
                let times = OutputTimes { longest_silence: silence, wait: commit };
                MesaAnalogOut::new(shared.clone(), config.analog_channels, low, high, times)
            }),
            digital_in: (config.lines_in.is_some())
                .then(|| MesaDigitalIn::new(shared.clone(), remote, lines_sample)),
            digital_out: (config.lines_out.is_some())
                .then(|| MesaDigitalOut::new(shared.clone(), lines_times)),
            monitor: CardMonitor::new(shared, config.wait_bound()),
        }
    }
}

/// A mark that differs from that of whoever opened the card before, and from power-up's 0.
fn session_mark(first: u32, before: u32) -> u32 {
    let differs = |mark: &u32| *mark != before && *mark != 0;
    // Three marks in a row, because at most two are refused.
    (0..3).map(|step| first.wrapping_add(step)).find(differs).unwrap_or(first)
}

/// The mark of a session, before the process number is mixed in: not 0, as after power-up.
const SESSION_MARK: u32 = 0x544b_0000;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mark_is_neither_the_one_before_nor_that_of_power_up() {
        assert_eq!(session_mark(7, 0), 7);
        assert_eq!(session_mark(7, 7), 8);
        assert_eq!(session_mark(u32::MAX, u32::MAX), 1);
        assert_eq!(session_mark(0, 1), 2);
    }
}
