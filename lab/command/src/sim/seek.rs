//! `taktil sim seek`: prints the simulated world at an instant of a recorded run, as sentences or
//! JSON.

use std::path::PathBuf;
use std::process::ExitCode;

use serde_json::{Value, json};
use taktil_lab_progress::Progress;
use taktil_lab_scene::seek::{WorldState, seek_telling};
use taktil_machine_console::option::BadOption;
use taktil_machine_console::out;
use taktil_record::Log;

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

/// Seeks the instants and prints the world.
///
/// # Errors
/// [`BadOption`] for logs and instants that cannot be used.
pub(super) fn run(arguments: &SeekArgs) -> anyhow::Result<ExitCode> {
    let bad = |why: String| BadOption(format!("{}: {why}", arguments.log.display()));
    let log = Log::open(&arguments.log).map_err(|error| bad(format!("{error:#}")))?;
    let mut progress = None;
    let outcome = seek_telling(&log, &arguments.at, &mut |_reached, total| {
        progress.get_or_insert_with(|| Progress::new("states", total)).advance();
    })
    .map_err(bad)?;
    drop(progress);
    for found in &outcome.found {
        if arguments.json {
            out::line(object(found))?;
        } else {
            out::text(sentences(found))?;
        }
    }
    match outcome.first_difference {
        None => {
            let equal = outcome.equal;
            out::warn(format_args!("{equal} recorded states met again, bit for bit"));
        }
        Some(at) => out::warn(format_args!(
            "another way than in the log from {} s on: another build, or a damaged log",
            at.as_secs_f64()
        )),
    }
    Ok(ExitCode::from(u8::from(outcome.first_difference.is_some())))
}

fn object(found: &WorldState) -> Value {
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
            "centre_of_load_m": [felt.place_m.0, felt.place_m.1],
            "offset_m": felt.off_m,
            "yaw_rad": felt.yaw_rad,
            "arc_length_m": felt.along_m,
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

fn sentences(found: &WorldState) -> String {
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
        Some(x) => on_pad(
            "contact",
            PadContact {
                normal_n: truth.finger_normal_n,
                column_tactels: x,
                yaw_rad: truth.pin_yaw_rad,
                tilt_rad: truth.tilt_rad,
                slip_m_s: truth.finger_slip_m_s,
            },
        ),
    };
    if let Some((tip, x)) = truth.opposed.and_then(|tip| Some((tip, tip.contact_x_tactels?))) {
        let contact = PadContact {
            normal_n: truth.table_normal_n,
            column_tactels: x,
            yaw_rad: tip.pin_yaw_rad,
            tilt_rad: tip.tilt_rad,
            slip_m_s: truth.table_slip_m_s,
        };
        text += &on_pad("opposed", contact);
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

/// The pin on one of the fingertips.
struct PadContact {
    normal_n: f64,
    column_tactels: f64,
    yaw_rad: f64,
    tilt_rad: f64,
    slip_m_s: f64,
}

/// The line of a fingertip.
fn on_pad(tip: &str, contact: PadContact) -> String {
    let PadContact { normal_n, column_tactels, yaw_rad, tilt_rad, slip_m_s } = contact;
    format!(
        "  {tip}     {normal_n:.3} N at column {column_tactels:.3}, yaw {:.3} deg, tilt {:.3} deg, \
         slip {:.3} mm/s\n",
        yaw_rad.to_degrees(),
        tilt_rad.to_degrees(),
        1e3 * slip_m_s,
    )
}
