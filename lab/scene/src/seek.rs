//! The world of a recorded run at any instant. The world is simulated again with the log's own
//! output words and compared with the recorded states on the way. A log without the tapes of the
//! devices, and an instant after the end of the record, are errors.

use taktil_hal::{Devices, LinesOut};
use taktil_machine::tape::{AnalogWord, DigitalWord, DriveWord, name};
use taktil_rtcore::{Nanos, Payload};
use taktil_sim::{Truth, World};

use crate::assembly::Assembly;
use crate::origin::Origin;
use taktil_record::{Channel, Log, Message};

/// Signal with the simulator's truth.
const TRUTH_SIGNAL: &str = "world.truth";
/// Error message for a log without that signal's records.
const NO_TRUTH_MESSAGE: &str = "it does not say what the world did";

/// The world at an instant.
#[derive(Clone, Debug)]
pub struct WorldState {
    /// The truth at this instant.
    pub truth: Truth,
    /// True when there is a pin, so that its part of the truth is valid.
    pub pin: bool,
    /// Hash of the complete state.
    pub state: u64,
    /// Angles of the joints, however many (rad).
    pub q_rad: Vec<f64>,
    /// Speeds of the joints (rad/s).
    pub qd_rad_s: Vec<f64>,
}

impl WorldState {
    fn of(world: &World, pin: bool) -> WorldState {
        let (q, qd) = world.joints();
        let (truth, state) = (world.truth(), world.state_hash());
        WorldState { truth, pin, state, q_rad: q.to_vec(), qd_rad_s: qd.to_vec() }
    }
}

/// The result of a search.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// One world for each instant, in the requested order.
    pub found: Vec<WorldState>,
    /// Number of recorded states that were reproduced, bit for bit.
    pub equal: u64,
    /// Instant of the first recorded state that was not reproduced.
    pub first_difference: Option<Nanos>,
}

/// An output word of the log.
#[derive(Clone, Copy, Debug)]
enum OutputWord {
    Analog(AnalogWord),
    Digital(DigitalWord),
    Drives(DriveWord),
}

/// The world of a log at several instants (s); at the end of the record when there are none.
///
/// # Errors
/// The reason why the log or the instants cannot be used, as one sentence.
pub fn seek(log: &Log, at_s: &[f64]) -> Result<Outcome, String> {
    seek_telling(log, at_s, &mut |_, _| ())
}

/// The same; `told` is called after each recorded state with the number of those that were reached
/// and of all.
///
/// # Errors
/// As [`seek`].
pub fn seek_telling(
    log: &Log,
    at_s: &[f64],
    told: &mut dyn FnMut(usize, usize),
) -> Result<Outcome, String> {
    let (scene, seed) = Origin::of(log)?.into_scene()?;
    let (words, states) = collect(log)?;
    let end = states.last().map(|(t, _)| *t).ok_or(NO_TRUTH_MESSAGE)?;
    let instant = |s: &f64| {
        let t = Nanos((1e9 * s).round() as i64);
        let inside = s.is_finite() && t >= Nanos::ZERO && t <= end;
        inside.then_some(t).ok_or_else(|| {
            format!("--at {s}: the record reaches from 0 to {} s", end.as_secs_f64())
        })
    };
    let asked: Vec<Nanos> = match at_s {
        [] => vec![end],
        some => some.iter().map(instant).collect::<Result<_, _>>()?,
    };
    let (mut world, mut devices) =
        Assembly::new(&scene).with_seed(seed).build_world().map_err(|bad| bad.what)?;
    let mut outcome = Outcome { found: Vec::new(), equal: 0, first_difference: None };
    let mut kept: Vec<Option<WorldState>> = vec![None; asked.len()];
    let mut words = words.into_iter().peekable();
    let mut visit_until = |world: &mut World, until: Nanos| {
        for (slot, t) in kept.iter_mut().zip(&asked) {
            if slot.is_none() && *t <= until {
                // A copy is advanced, so that the steps of the world itself stay as they were in
                // the run.
                let (mut other, _halves) = world.snapshot().restore();
                other.advance(*t);
                *slot = Some(WorldState::of(&other, scene.world.pin.present));
            }
        }
    };
    let total = states.len();
    for (reached, (t, state)) in states.into_iter().enumerate() {
        while let Some((release, word)) = words.next_if(|(release, _)| *release < t) {
            commit(&mut devices, release, word)?;
        }
        visit_until(&mut world, t);
        world.advance(t);
        if world.state_hash() == state {
            outcome.equal += 1;
        } else if outcome.first_difference.is_none() {
            outcome.first_difference = Some(t);
        }
        told(reached + 1, total);
    }
    outcome.found = kept.into_iter().flatten().collect();
    Ok(outcome)
}

/// The instant up to which a log contains the world's truth.
///
/// # Errors
/// A log without the truth.
pub fn recorded_until(log: &Log) -> Result<Nanos, String> {
    let truth = log.find(TRUTH_SIGNAL).ok_or_else(|| format!("it has no `{TRUTH_SIGNAL}`"))?;
    let last = log.messages().filter(|message| message.channel == truth).last();
    last.map(|message| state(&message).map(|(t, _)| t))
        .transpose()?
        .ok_or_else(|| NO_TRUTH_MESSAGE.into())
}

/// The output words of a log in order, and the recorded states of the world.
type Record = (Vec<(Nanos, OutputWord)>, Vec<(Nanos, u64)>);

fn collect(log: &Log) -> Result<Record, String> {
    let find = |name: &str| log.find(name).ok_or_else(|| format!("it has no `{name}`"));
    let drives = log.find(name::DRIVE_OUT);
    // Drives that close a loop stand in place of converters.
    let analog = match drives {
        Some(_) => log.find(name::ANALOG_OUT),
        None => Some(find(name::ANALOG_OUT)?),
    };
    let digital = find(name::DIGITAL_OUT)?;
    let truth = find(TRUTH_SIGNAL)?;
    let fields = log.channels().get(truth).map(Channel::payload_fields).unwrap_or_default();
    if !fields.iter().map(|field| &*field.name).take(2).eq(["t_ns", "state_hash"]) {
        return Err(format!("its `{TRUTH_SIGNAL}` does not begin with an instant and a state"));
    }
    let (mut words, mut states) = (Vec::new(), Vec::new());
    for message in log.messages() {
        let release = Nanos(message.release_ns);
        if Some(message.channel) == drives {
            let word = read::<DriveWord>(&message)?;
            words.push((release, OutputWord::Drives(word)));
        } else if Some(message.channel) == analog {
            let word = read::<AnalogWord>(&message)?;
            words.push((release, OutputWord::Analog(word)));
        } else if message.channel == digital {
            let word = read::<DigitalWord>(&message)?;
            words.push((release, OutputWord::Digital(word)));
        } else if message.channel == truth {
            states.push(state(&message)?);
        }
    }
    Ok((words, states))
}

/// The payload of a message, which may have padding after it.
fn read<T: Payload>(message: &Message<'_>) -> Result<T, String> {
    let at_s = Nanos(message.release_ns).as_secs_f64();
    let value = message.body.get(..T::SIZE).and_then(T::decode);
    value.ok_or_else(|| format!("a record at {at_s} s cannot be read"))
}

/// The instant and the hash at the beginning of the truth, for any arm.
fn state(message: &Message<'_>) -> Result<(Nanos, u64), String> {
    let words = message.body.split_first_chunk::<8>();
    let words = words.and_then(|(t, rest)| Some((t, rest.first_chunk::<8>()?)));
    let at_s = Nanos(message.release_ns).as_secs_f64();
    let (t, hash) = words.ok_or_else(|| format!("a record at {at_s} s cannot be read"))?;
    Ok((Nanos(i64::from_le_bytes(*t)), u64::from_le_bytes(*hash)))
}

/// Writes a word that was accepted in the run; a word that was refused had no effect.
fn commit(devices: &mut Devices, release: Nanos, word: OutputWord) -> Result<(), String> {
    let written = match word {
        OutputWord::Analog(word) if word.outcome == 0 => {
            devices.require_analog_out().and_then(|half| half.commit(release, &word.codes()))
        }
        OutputWord::Digital(word) if word.outcome == 0 => {
            let lines = LinesOut {
                enable: word.enable != 0,
                brake_release: word.brake_release != 0,
                watchdog_feed: word.watchdog_feed != 0,
            };
            devices.require_digital_out().and_then(|half| half.commit(release, &lines))
        }
        OutputWord::Drives(word) if word.outcome == 0 => {
            devices.require_drive_out().and_then(|half| half.commit(release, &word.command()))
        }
        OutputWord::Analog(_) | OutputWord::Digital(_) | OutputWord::Drives(_) => Ok(()),
    };
    written.map_err(|_| {
        let at_s = release.as_secs_f64();
        format!("the devices refuse the word at {at_s} s; name the log of another run")
    })
}
