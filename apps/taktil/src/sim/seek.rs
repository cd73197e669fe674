//! `taktil sim seek`: the world of a recorded run at any instant, moved there by the log's own
//! words, and compared with what the log says of it on the way. Refuses logs without the devices'
//! tapes, and instants that the record does not reach.

use std::path::PathBuf;
use std::process::ExitCode;

use serde_json::{Value, json};
use taktil_hal::{DacCode, Devices, LinesOut};
use taktil_machine::tape::{AnalogWord, DigitalWord, name};
use taktil_machine_console::out;
use taktil_rtcore::{Nanos, Payload};
use taktil_sim::{Truth, World};

use crate::replay::origin::Origin;
use crate::run::assemble;
use taktil_machine_console::option::BadOption;
use taktil_record::{Channel, Log, Message};

/// Signal in which the simulator says what happened.
const TRUTH: &str = "world.truth";
/// Complaint about a log in which it never does.
const NO_STATES: &str = "it does not say what the world did";

/// Which instants.
#[derive(Clone, Debug, clap::Args)]
pub struct SeekArgs {
    /// Log file (MCAP) of a simulated run
    log: PathBuf,
    /// Instants of the simulated run, in seconds; the end of the record when absent
    #[arg(long, value_name = "S", allow_negative_numbers = true)]
    at: Vec<f64>,
    /// One JSON object an instant instead of sentences
    #[arg(long)]
    json: bool,
}

/// The world at an instant.
#[derive(Clone, Debug)]
pub struct Found {
    /// What happens there.
    pub truth: Truth,
    /// There is a pin, and what the truth says of it means something.
    pub pin: bool,
    /// Hash of the whole state.
    pub state: u64,
    /// Angles of the joints, however many (rad).
    pub q_rad: Vec<f64>,
    /// Speeds of the joints (rad/s).
    pub qd_rad_s: Vec<f64>,
}

impl Found {
    fn of(world: &World, pin: bool) -> Found {
        let (q, qd) = world.joints();
        let (truth, state) = (world.truth(), world.state_hash());
        Found { truth, pin, state, q_rad: q.to_vec(), qd_rad_s: qd.to_vec() }
    }
}

/// What a search found.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// One for each instant, in the order in which they were asked for.
    pub found: Vec<Found>,
    /// Recorded states that were met again, bit for bit.
    pub equal: u64,
    /// The first recorded state that was not, and its instant.
    pub parted: Option<Nanos>,
}

/// A word of the log.
#[derive(Clone, Copy, Debug)]
enum Word {
    Analog(AnalogWord),
    Digital(DigitalWord),
}

/// Seeks and prints.
///
/// # Errors
/// [`BadOption`] for logs and instants that cannot be used.
pub fn run(arguments: &SeekArgs) -> anyhow::Result<ExitCode> {
    let bad = |why: String| BadOption(format!("{}: {why}", arguments.log.display()));
    let log = Log::open(&arguments.log).map_err(|error| bad(format!("{error:#}")))?;
    let outcome = seek(&log, &arguments.at).map_err(bad)?;
    for found in &outcome.found {
        if arguments.json {
            out::line(object(found))?;
        } else {
            out::text(sentences(found))?;
        }
    }
    match outcome.parted {
        None => {
            let equal = outcome.equal;
            out::warn(format_args!("{equal} recorded states met again, bit for bit"));
        }
        Some(at) => out::warn(format_args!(
            "another way than in the log from {} s on: another build, or a damaged log",
            at.as_secs_f64()
        )),
    }
    Ok(ExitCode::from(u8::from(outcome.parted.is_some())))
}

/// The world of a log at several instants (s); at the end of the record when there are none.
///
/// # Errors
/// Why log or instants cannot be used, in one sentence.
pub fn seek(log: &Log, at_s: &[f64]) -> Result<Outcome, String> {
    let (scene, seed) = Origin::of(log)?.into_scene()?;
    let (words, states) = collect(log)?;
    let end = states.last().map(|(t, _)| *t).ok_or(NO_STATES)?;
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
    let (mut world, mut devices) = assemble::world(&scene, seed).map_err(|bad| bad.what)?;
    let mut outcome = Outcome { found: Vec::new(), equal: 0, parted: None };
    let mut kept: Vec<Option<Found>> = vec![None; asked.len()];
    let mut words = words.into_iter().peekable();
    let mut aside = |world: &mut World, until: Nanos| {
        for (slot, t) in kept.iter_mut().zip(&asked) {
            if slot.is_none() && *t <= until {
                // To the side, so that steps on the way stay as they were in the run.
                let (mut other, _halves) = world.snapshot().revive();
                other.advance(*t);
                *slot = Some(Found::of(&other, scene.world.pin.present));
            }
        }
    };
    for (t, state) in states {
        while let Some((release, word)) = words.next_if(|(release, _)| *release < t) {
            commit(&mut devices, release, word)?;
        }
        aside(&mut world, t);
        world.advance(t);
        if world.state_hash() == state {
            outcome.equal += 1;
        } else if outcome.parted.is_none() {
            outcome.parted = Some(t);
        }
    }
    outcome.found = kept.into_iter().flatten().collect();
    Ok(outcome)
}

/// The instant up to which a log says what the world did.
///
/// # Errors
/// A log that does not say it at all.
pub fn recorded_until(log: &Log) -> Result<Nanos, String> {
    let truth = log.find(TRUTH).ok_or_else(|| format!("it has no `{TRUTH}`"))?;
    let last = log.messages().filter(|message| message.channel == truth).last();
    last.map(|message| state(&message).map(|(t, _)| t)).transpose()?.ok_or_else(|| NO_STATES.into())
}

/// The words of a log in order, and what it says of the world's states.
type Record = (Vec<(Nanos, Word)>, Vec<(Nanos, u64)>);

fn collect(log: &Log) -> Result<Record, String> {
    let find = |name: &str| log.find(name).ok_or_else(|| format!("it has no `{name}`"));
    let (analog, digital) = (find(name::ANALOG_OUT)?, find(name::DIGITAL_OUT)?);
    let truth = find(TRUTH)?;
    let fields = log.channels().get(truth).map(Channel::payload_fields).unwrap_or_default();
    if !fields.iter().map(|field| &*field.name).take(2).eq(["t_ns", "state_hash"]) {
        return Err(format!("its `{TRUTH}` does not begin with an instant and a state"));
    }
    let (mut words, mut states) = (Vec::new(), Vec::new());
    for message in log.messages() {
        let release = Nanos(message.release_ns);
        if message.channel == analog {
            let word = read::<AnalogWord>(&message)?;
            words.push((release, Word::Analog(word)));
        } else if message.channel == digital {
            let word = read::<DigitalWord>(&message)?;
            words.push((release, Word::Digital(word)));
        } else if message.channel == truth {
            states.push(state(&message)?);
        }
    }
    Ok((words, states))
}

/// The payload of a message, which may have padding behind it.
fn read<T: Payload>(message: &Message<'_>) -> Result<T, String> {
    let at_s = Nanos(message.release_ns).as_secs_f64();
    let value = message.body.get(..T::SIZE).and_then(T::decode);
    value.ok_or_else(|| format!("a record at {at_s} s cannot be read"))
}

/// The instant and the hash with which the truth begins, whatever the arm.
fn state(message: &Message<'_>) -> Result<(Nanos, u64), String> {
    let words = message.body.split_first_chunk::<8>();
    let words = words.and_then(|(t, rest)| Some((t, rest.first_chunk::<8>()?)));
    let at_s = Nanos(message.release_ns).as_secs_f64();
    let (t, hash) = words.ok_or_else(|| format!("a record at {at_s} s cannot be read"))?;
    Ok((Nanos(i64::from_le_bytes(*t)), u64::from_le_bytes(*hash)))
}

/// Writes a word that was taken; one that was refused moved nothing.
fn commit(devices: &mut Devices, release: Nanos, word: Word) -> Result<(), String> {
    let refused = |_| format!("the devices refuse the word at {} s", release.as_secs_f64());
    match word {
        Word::Analog(word) if word.outcome == 0 => {
            devices.analog_out.commit(release, &word.codes.map(DacCode)).map_err(refused)
        }
        Word::Digital(word) if word.outcome == 0 => {
            let lines = LinesOut {
                enable: word.enable != 0,
                brake_release: word.brake_release != 0,
                watchdog_feed: word.watchdog_feed != 0,
            };
            devices.digital_out.commit(release, &lines).map_err(refused)
        }
        Word::Analog(_) | Word::Digital(_) => Ok(()),
    }
}

fn object(found: &Found) -> Value {
    let truth = &found.truth;
    let pin = |v: glam::DVec3| found.pin.then_some(v.to_array());
    json!({
        "t_s": truth.t.as_secs_f64(),
        "state_hash": format!("{:016x}", found.state),
        "q_rad": found.q_rad,
        "qd_rad_s": found.qd_rad_s,
        "tool_m": truth.tool.to_array(),
        "pin_m": pin(truth.pin),
        "pin_axis": pin(truth.pin_axis),
        "pin_velocity_m_s": pin(truth.pin_velocity),
        "pin_roll_rad": found.pin.then_some(truth.pin_roll_rad),
        "finger_normal_n": truth.finger_normal_n,
        "table_normal_n": truth.table_normal_n,
        "finger_tangential_n": [truth.finger_tangential_n.0, truth.finger_tangential_n.1],
        "tool_wrench_n_nm": truth.tool_wrench.as_slice(),
        "contact_x_tactels": truth.contact_x_tactels,
        "pin_yaw_rad": found.pin.then_some(truth.pin_yaw_rad),
        "tilt_rad": found.pin.then_some(truth.tilt_rad),
        "finger_slip_m_s": truth.finger_slip_m_s,
        "object": truth.object.map(|felt| json!({
            "normal_n": felt.normal_n,
            "place_m": [felt.place_m.0, felt.place_m.1],
            "off_m": felt.off_m,
            "yaw_rad": felt.yaw_rad,
            "along_m": felt.along_m,
            "tilt_rad": [felt.tilt_rad.0, felt.tilt_rad.1],
            "slip_m_s": felt.slip_m_s,
        })),
        "opposed": truth.opposed.map(|tip| json!({
            "face_m": tip.face.to_array(),
            "face_x": tip.face_x.to_array(),
            "face_z": tip.face_z.to_array(),
            "contact_x_tactels": tip.contact_x_tactels,
            "pin_yaw_rad": tip.pin_yaw_rad,
            "tilt_rad": tip.tilt_rad,
        })),
        "in_contact": truth.in_contact,
        "enabled": truth.enabled,
        "braked": truth.braked,
    })
}

fn sentences(found: &Found) -> String {
    let truth = &found.truth;
    let mm = |v: [f64; 3]| v.map(|x| format!("{:.3}", 1e3 * x)).join(", ");
    let mut text = format!(
        "{} s, state {:016x}\n  tool (mm)   {}\n{}  q (deg)     {}\n",
        truth.t.as_secs_f64(),
        found.state,
        mm(truth.tool.to_array()),
        if found.pin {
            format!("  pin (mm)    {}\n", mm(truth.pin.to_array()))
        } else {
            String::new()
        },
        found.q_rad.iter().map(|q| format!("{:.3}", q.to_degrees())).collect::<Vec<_>>().join(", "),
    );
    text += &match truth.contact_x_tactels {
        None if truth.in_contact => String::new(),
        None => "  contact     none\n".to_owned(),
        Some(x) => {
            let turned = (truth.pin_yaw_rad, truth.tilt_rad);
            on_pad("contact", truth.finger_normal_n, x, turned, truth.finger_slip_m_s)
        }
    };
    if let Some((tip, x)) = truth.opposed.and_then(|tip| Some((tip, tip.contact_x_tactels?))) {
        let turned = (tip.pin_yaw_rad, tip.tilt_rad);
        text += &on_pad("opposed", truth.table_normal_n, x, turned, truth.table_slip_m_s);
    }
    if let Some(felt) = truth.object.filter(|felt| felt.normal_n > 0.0) {
        text += &format!(
            "  object      {:.3} N at {:.3}, {:.3} mm, slip {:.3} mm/s\n",
            felt.normal_n,
            1e3 * felt.place_m.0,
            1e3 * felt.place_m.1,
            1e3 * felt.slip_m_s,
        );
    }
    text
}

/// The pin on one of the fingertips: force, column, yaw and tilt (rad), slip.
fn on_pad(tip: &str, normal_n: f64, x: f64, (yaw, tilt): (f64, f64), slip_m_s: f64) -> String {
    format!(
        "  {tip}     {normal_n:.3} N at column {x:.3}, yaw {:.3} deg, tilt {:.3} deg, \
         slip {:.3} mm/s\n",
        yaw.to_degrees(),
        tilt.to_degrees(),
        1e3 * slip_m_s,
    )
}
