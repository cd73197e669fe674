//! Parses the commands of an operator, one command per line. The command line, the socket, scripts
//! and keys use the same commands. Unknown words, and moves that no arm could make, are errors that
//! name the place in the line and the remedy.
//!
//! ```text
//! enable | calibrate | idle | manual_uncalibrated | manual_joint | manual_cartesian | trajectory
//!        | trajectory_user | tactile_servo | stop | reset
//! jog joints|base|tool|outer A1 .. A6      six pushes, -1 to 1: held for as long as it is repeated
//! release
//! move joint Q1 .. QN [in S] [now]         deg
//! move to X Y Z [YAW PITCH ROLL] [straight] [in S] [now]        mm, deg
//! move by DX DY DZ [straight] [in S] [now]                      mm, along the tool's own axes
//! pause | resume | clear
//! wait                                     until the moves are done
//! state
//! ```

use taktil_rtcore::Invalid;
use taktil_signal::{JogFrame, MoveKind, OperatorMove, Verb};
use taktil_tasks_trajectory::{Config, Move, ToolGoal, typed};

use crate::robot::AnyRobot;
use crate::with_robot;

/// The properties of a machine that the parser needs: the speed of its moves, and its arm.
#[derive(Clone, Debug)]
pub struct CommandContext {
    /// Speeds and accelerations of typed moves.
    pub trajectory: Config,
    /// The arm.
    pub robot: AnyRobot,
}

impl Default for CommandContext {
    /// The default speed of the PUMA 260.
    fn default() -> CommandContext {
        CommandContext { trajectory: Config::default(), robot: AnyRobot::puma260() }
    }
}

/// One command of an operator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum OperatorCommand {
    /// A request to the state machine.
    Request(Verb),
    /// Held keys: deflection of each axis, and the frame of the axes.
    Jog([f64; 6], JogFrame),
    /// A typed move, a pause or a resumption; its sequence number is not set yet.
    Move(OperatorMove),
    /// Asks for an answer when all moves are done.
    Wait,
    /// Asks for the state of the machine.
    State,
}

/// Largest number of words in a line.
const WORDS_MAX: usize = 16;

/// Parses a line; returns `None` for an empty line and for a comment.
///
/// # Errors
/// The place in the line, what is wrong there, and the remedy.
pub fn parse(line: &str, context: &CommandContext) -> Result<Option<OperatorCommand>, Invalid> {
    let line = line.split('#').next().unwrap_or_default();
    let words: Vec<&str> = line.split_whitespace().take(WORDS_MAX + 1).collect();
    if words.len() > WORDS_MAX {
        return Err(Invalid::new("", "too many words", "say one thing a line"));
    }
    let Some((first, rest)) = words.split_first() else { return Ok(None) };
    let alone = |order: OperatorCommand| match rest.first() {
        None => Ok(Some(order)),
        Some(more) => {
            let what = format!("`{more}` follows `{first}`");
            Err(Invalid::new(*first, what, format!("say `{first}` alone")))
        }
    };
    match *first {
        "jog" => parse_jog(rest).map(Some),
        "release" => alone(OperatorCommand::Jog([0.0; 6], JogFrame::Joints)),
        "move" => parse_move(rest, context).map(Some),
        "pause" => alone(OperatorCommand::Move(typed::command(MoveKind::Pause))),
        "resume" => alone(OperatorCommand::Move(typed::command(MoveKind::Resume))),
        "clear" => alone(OperatorCommand::Move(typed::command(MoveKind::Clear))),
        "wait" => alone(OperatorCommand::Wait),
        "state" => alone(OperatorCommand::State),
        name => match Verb::from_name(name).filter(|verb| *verb != Verb::None) {
            Some(verb) => alone(OperatorCommand::Request(verb)),
            None => {
                let verbs: Vec<&str> = Verb::ALL[1..].iter().map(|verb| verb.name()).collect();
                let what = format!("there is no word `{name}`");
                let remedy = format!(
                    "words are: {}, jog, release, move, pause, resume, clear, wait, state",
                    verbs.join(", ")
                );
                Err(Invalid::new("", what, remedy))
            }
        },
    }
}

fn parse_jog(words: &[&str]) -> Result<OperatorCommand, Invalid> {
    let usage = "say `jog joints 0 0 0.5 0 0 0`, or base, tool or outer; six pushes of -1 to 1";
    let Some((name, pushes)) = words.split_first() else {
        return Err(Invalid::new("jog", "what is pushed is missing", usage));
    };
    let frame = JogFrame::ALL.into_iter().find(|frame| frame.name() == *name).ok_or_else(|| {
        Invalid::new(
            "jog",
            format!("there is no frame `{name}`"),
            "frames are: joints, base, tool, outer",
        )
    })?;
    let axes = parse_numbers::<6>("jog", pushes, usage)?;
    match axes.iter().find(|axis| !(-1.0..=1.0).contains(*axis)) {
        None => Ok(OperatorCommand::Jog(axes, frame)),
        Some(axis) => Err(Invalid::new("jog", format!("a push of {axis}"), "give -1 to 1")),
    }
}

/// Parses the words after `move`.
fn parse_move(
    words: &[&str],
    CommandContext { trajectory, robot }: &CommandContext,
) -> Result<OperatorCommand, Invalid> {
    let usage = "say `move joint` with an angle for each joint (deg), `move to` with x y z (mm) \
                 and, if wanted, yaw pitch roll (deg), or `move by` with three mm along the \
                 tool's axes";
    let Some((kind, rest)) = words.split_first() else {
        return Err(Invalid::new("move", "where to?", usage));
    };
    let count = rest.iter().take_while(|word| word.parse::<f64>().is_ok()).count();
    let (values, options) = rest.split_at(count);
    let (t_s, straight, now) = parse_move_options(options)?;
    let mut step = Move { joints_deg: None, tool: None, by_mm: None, straight, t_s };
    match *kind {
        "joint" | "joints" => step.joints_deg = Some(parse_angles(values, robot, usage)?),
        "by" => step.by_mm = Some(parse_numbers("move by", values, usage)?),
        "to" => {
            let padded: Vec<&str> = match values.len() {
                3 => values.iter().copied().chain(["0"; 3]).collect(),
                6 => values.to_vec(),
                count => {
                    let what = format!("{count} numbers where 3 or 6 are needed");
                    return Err(Invalid::new("move to", what, usage));
                }
            };
            let [x, y, z, yaw_deg, pitch_deg, roll_deg] = parse_numbers("move to", &padded, usage)?;
            let p_mm = [x, y, z];
            step.tool = Some(ToolGoal { p_mm, rotation: None, yaw_deg, pitch_deg, roll_deg });
        }
        other => return Err(Invalid::new("move", format!("`{other}`?"), usage)),
    }
    let word = with_robot!(robot, robot => {
        trajectory.step(&step, robot).map(|step| typed::encode(&step, now))
    });
    word.map(OperatorCommand::Move).map_err(|bad| bad.within("move"))
}

/// Parses one angle for each joint.
fn parse_angles(words: &[&str], robot: &AnyRobot, usage: &str) -> Result<Vec<f64>, Invalid> {
    match robot.joints() {
        7 => parse_numbers::<7>("move joint", words, usage).map(Vec::from),
        _ => parse_numbers::<6>("move joint", words, usage).map(Vec::from),
    }
}

fn parse_move_options(mut words: &[&str]) -> Result<(Option<f64>, bool, bool), Invalid> {
    let (mut t_s, mut straight, mut now) = (None, false, false);
    loop {
        match words {
            [] => return Ok((t_s, straight, now)),
            ["straight", rest @ ..] => (straight, words) = (true, rest),
            ["now", rest @ ..] => (now, words) = (true, rest),
            ["in", seconds, rest @ ..] => {
                let [seconds] = parse_numbers("move", &[seconds], "say `in 1.5`: seconds")?;
                (t_s, words) = (Some(seconds), rest);
            }
            [other, ..] => {
                let what = format!("`{other}` is no number and no option");
                let remedy = "options are: straight, in SECONDS, now";
                return Err(Invalid::new("move", what, remedy));
            }
        }
    }
}

fn parse_numbers<const N: usize>(
    place: &str,
    words: &[&str],
    usage: &str,
) -> Result<[f64; N], Invalid> {
    if words.len() != N {
        let what = format!("{} numbers where {N} are needed", words.len());
        return Err(Invalid::new(place, what, usage));
    }
    let mut values = [0.0; N];
    for (value, word) in values.iter_mut().zip(words) {
        *value = word.parse().ok().filter(|x: &f64| x.is_finite()).ok_or_else(|| {
            Invalid::new(place, format!("`{word}` is no number of use here"), usage)
        })?;
    }
    Ok(values)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(line: &str) -> Result<Option<OperatorCommand>, Invalid> {
        parse(line, &CommandContext::default())
    }

    #[test]
    fn a_place_takes_three_numbers_or_six_and_says_so() {
        for line in ["move to 300 0", "move to 300 0 100 5", "move to 1 2 3 4 5 6 7", "move to"] {
            let error = parsed(line).unwrap_err().to_string();
            assert!(error.contains("where 3 or 6 are needed"), "{line}: {error}");
        }
        let bad = parsed("move to 330 0 180").unwrap_err().to_string();
        assert!(bad.contains("cannot be reached"), "three are understood: {bad}");
    }

    #[test]
    fn verbs_keys_and_moves_are_understood() {
        assert_eq!(parsed("enable").unwrap(), Some(OperatorCommand::Request(Verb::Enable)));
        assert_eq!(parsed("  # nothing").unwrap(), None);
        let pushes = [0.0, -1.0, 0.0, 0.0, 0.5, 0.0];
        let jog = parsed("jog tool 0 -1 0 0 .5 0 # gently").unwrap();
        assert_eq!(jog, Some(OperatorCommand::Jog(pushes, JogFrame::Tool)));
        let Some(OperatorCommand::Move(word)) = parsed("move by 0 0 5 straight in 2 now").unwrap()
        else {
            panic!("no move")
        };
        assert_eq!((word.kind, word.straight, word.now), (MoveKind::By as u32, 1, 1));
        assert_eq!((word.t_s, word.values[2]), (2.0, 0.005));
        let Some(OperatorCommand::Move(word)) = parsed("move joint 0 40 -153 -180 67 180").unwrap()
        else {
            panic!("no move")
        };
        assert_eq!((word.kind, word.t_s), (MoveKind::Joints as u32, 0.0));
        assert!((word.values[1] - 40f64.to_radians()).abs() < 1e-15);
        for line in ["move to 342 -127 -149", "move to 342 -127 -149 10 0 0 straight"] {
            let Some(OperatorCommand::Move(word)) = parsed(line).unwrap() else { panic!("{line}") };
            assert_eq!(word.kind, MoveKind::Tool as u32);
            assert!((word.values[9] - 0.342).abs() < 1e-15);
        }
    }

    #[test]
    fn unknown_commands_are_rejected_with_a_remedy() {
        for (line, place, says) in [
            ("fly", "", "no word `fly`"),
            ("none", "", "no word `none`"),
            ("enable now", "enable", "`now` follows"),
            ("jog", "jog", "missing"),
            ("jog world 0 0 0 0 0 0", "jog", "no frame `world`"),
            ("jog base 0 0 0", "jog", "3 numbers"),
            ("jog base 2 0 0 0 0 0", "jog", "push of 2"),
            ("jog base nan 0 0 0 0 0", "jog", "no number"),
            ("move", "move", "where to?"),
            ("move there", "move", "`there`?"),
            ("move joint 1 2 3", "move joint", "3 numbers"),
            ("move joint 1 2 3 4 5 six", "move", "`six` is no number"),
            ("move joint nan 0 0 0 0 0", "move joint", "no number"),
            ("move joint 400 0 0 0 0 0", "move.joints_deg[0]", "outside the limits"),
            ("move joint 0 40 -153 -180 67 180 straight", "move.straight", "joint angles"),
            ("move to 900 0 0", "move.tool", "cannot be reached"),
            ("move by 0 0 5 in", "move", "`in`"),
            ("move by 0 0 5 in 0", "move.t_s", "0"),
            ("move by 0 0 5 in 0.1", "move.t_s", "no room"),
            ("move by 0 0 5 in inf", "move", "no number"),
            ("move by 0 0 99999", "move.by_mm[2]", "99999"),
            ("a a a a a a a a a a a a a a a a a a", "", "too many"),
        ] {
            let bad = parsed(line).unwrap_err();
            assert_eq!(bad.place, place, "{line}: {bad:?}");
            assert!(bad.what.contains(says), "{line}: {bad:?}");
            assert!(!bad.remedy.is_empty());
        }
    }
}
