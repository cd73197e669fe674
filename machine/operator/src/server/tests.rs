//! The server turn by turn, with clients over real sockets, and in place of the lane a stand-in
//! that takes messages as a lane does and decides about requests by a fixed rule.

use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::sync::atomic::AtomicU32;

use serde_json::json;

use super::*;
use crate::OperatorConfig;
use taktil_machine::operator::{OperatorInput, OperatorReceiver, channel};
use taktil_rtcore::record::Signal;
use taktil_rtcore::record_ring::{RecordSender, queue};
use taktil_rtcore::{Mode, Payload};
use taktil_signal::{ControlState, State, Verb};

/// The server, and the other ends of all that it holds.
struct Bench {
    server: Server,
    reader: RecordReader,
    records: RecordSender,
    receiver: OperatorReceiver,
    input: OperatorInput,
    control: ControlState,
    /// What the lane has been asked for, in order.
    taken: Vec<Verb>,
    path: PathBuf,
    now: Nanos,
    jobs: u64,
    /// The lane takes nothing.
    is_deaf: bool,
}

fn catalog() -> Catalog {
    let control = Signal {
        name: "supervisor.control".into(),
        lane: 0,
        type_name: ControlState::NAME.into(),
        fields: ControlState::FIELDS.into(),
        size: ControlState::SIZE,
    };
    Catalog { signals: vec![control], lanes: Vec::new() }
}

impl Bench {
    fn new() -> Bench {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let name = format!("taktil-operator-{}-{number}", std::process::id());
        let path = std::env::temp_dir().join(name);
        let config = OperatorConfig::at(path.clone());
        let policy = AccessPolicy::new(&config).unwrap();
        let listener = Listener::bind(&path, false).unwrap();
        let (sender, receiver) = channel();
        let catalog = catalog();
        let (records, reader) = queue(1 << 16, &catalog);
        let setup = ServerSetup {
            sender,
            context: CommandContext::default(),
            about: json!({ "simulated": true }),
            recording: None,
        };
        let shared = Arc::new(SharedState::default());
        let server = Server::new(listener, policy, setup, catalog, None, shared);
        let mut control = ControlState::ZERO;
        (control.state, control.mode) = (State::ManualJoint as u32, u32::from(Mode::Moving as u8));
        Bench {
            server,
            reader,
            records,
            receiver,
            input: OperatorInput::default(),
            control,
            taken: Vec::new(),
            path,
            now: linux::monotonic(),
            jobs: 0,
            is_deaf: false,
        }
    }

    fn connect(&mut self) -> UnixStream {
        let stream = UnixStream::connect(&self.path).unwrap();
        stream.set_nonblocking(true).unwrap();
        self.turn();
        stream
    }

    /// A turn of the server, 5 ms later, and two jobs of the lane.
    fn turn(&mut self) {
        self.now += Nanos::from_millis(5);
        self.server.turn(&mut self.reader, self.now);
        for _ in 0..2 {
            self.job();
        }
    }

    fn turns(&mut self, count: usize) {
        for _ in 0..count {
            self.turn();
        }
    }

    /// A job: the lane refuses `calibrate` and grants the rest, as the supervisor does.
    fn job(&mut self) {
        self.jobs += 1;
        if !self.is_deaf {
            self.receiver.receive_into(&mut self.input);
        }
        let request = self.input.request;
        if request.sequence != self.control.request {
            let verb = Verb::from_code(request.verb).unwrap();
            self.control.request = request.sequence;
            self.control.refused += u32::from(verb == Verb::Calibrate);
            self.taken.push(verb);
        }
        let mut body = vec![0; ControlState::SIZE];
        self.control.encode(&mut body);
        let release = Nanos::from_millis(self.jobs as i64);
        let record = Record { signal: 0, tick: self.jobs, release, body: &body };
        assert!(self.records.send(&record));
    }
}

fn say(stream: &mut UnixStream, text: &str) {
    stream.write_all(text.as_bytes()).unwrap();
}

fn heard(stream: &mut UnixStream) -> Vec<String> {
    let mut text = Vec::new();
    let _ = stream.read_to_end(&mut text);
    String::from_utf8(text).unwrap().lines().map(str::to_owned).collect()
}

const JOG_LINE: &str = "jog joints 0 0 0 0 1 0\n";

#[test]
fn keys_that_had_to_wait_do_not_move_the_arm() {
    let mut bench = Bench::new();
    let mut caller = bench.connect();
    // A client sends hundreds of lines and then hangs: it takes many turns to serve them.
    say(&mut caller, &JOG_LINE.repeat(200));
    bench.turns(100);
    assert_eq!(bench.input.jog.sequence, 0);
    let answers = heard(&mut caller);
    assert_eq!(answers.len(), 200);
    assert!(answers.iter().all(|answer| answer.starts_with("refused: these keys")), "{answers:?}");
    // Lines that come one at a time move the arm.
    for n in 1..=5 {
        say(&mut caller, JOG_LINE);
        bench.turn();
        assert_eq!(bench.input.jog.sequence, n);
    }
    assert!(heard(&mut caller).iter().all(|answer| answer.starts_with("ok")));
    // When two lines come at once, only the newer one counts; a release always counts.
    say(&mut caller, &JOG_LINE.repeat(2));
    bench.turns(3);
    assert_eq!(bench.input.jog.sequence, 6);
    say(&mut caller, &[JOG_LINE, "release\n", JOG_LINE, "release\n"].concat());
    bench.turns(3);
    assert_eq!((bench.input.jog.sequence, bench.input.jog.axes), (8, [0.0; 6]));
}

#[test]
fn a_client_that_hung_up_holds_no_keys() {
    let mut bench = Bench::new();
    let mut caller = bench.connect();
    say(&mut caller, JOG_LINE);
    drop(caller);
    bench.turns(3);
    assert_eq!(bench.input.jog.axes, [0.0; 6]);
    assert!(bench.server.clients.is_empty());
    let mut caller = bench.connect();
    say(&mut caller, JOG_LINE);
    bench.turn();
    assert_ne!(bench.input.jog.axes, [0.0; 6]);
    drop(caller);
    bench.turns(2);
    assert_eq!(bench.input.jog.axes, [0.0; 6], "let go in its place");
}

#[test]
fn each_answer_is_that_of_its_own_request() {
    let mut bench = Bench::new();
    let mut callers: Vec<UnixStream> = (0..8).map(|_| bench.connect()).collect();
    let mut granted = 0;
    for round in 0..200u64 {
        for (n, caller) in callers.iter_mut().enumerate() {
            let verb = if n % 2 == 0 { "calibrate" } else { "idle" };
            say(caller, &format!("{{\"id\": {round}, \"say\": \"{verb}\"}}\n"));
        }
        // Two clients by turns have been silent for long enough to hand control on.
        bench.now += Nanos::from_secs(3);
        bench.turns(6);
        for (n, caller) in callers.iter_mut().enumerate() {
            let answers = heard(caller);
            assert_eq!(answers.len(), 1, "{round} {n} {answers:?}");
            let answer: Value = serde_json::from_str(&answers[0]).unwrap();
            assert_eq!(answer["id"], json!(round));
            let text = answer["text"].as_str().unwrap();
            match (answer["outcome"].as_str().unwrap(), n % 2) {
                ("ok", 1) => granted += 1,
                ("refused", 0) if text.starts_with("calibrate is not possible") => granted += 1,
                ("refused", _) => assert!(text.contains("has control"), "{text}"),
                other => panic!("{other:?} {text}"),
            }
        }
    }
    assert!(granted >= 200, "one a round at least: {granted}");
    assert_eq!(bench.taken.len(), granted);
}

#[test]
fn a_stop_overtakes_everything_and_voids_what_was_said_before_it() {
    let mut bench = Bench::new();
    let mut commander = bench.connect();
    let mut other = bench.connect();
    bench.is_deaf = true;
    say(&mut commander, "{\"id\":1,\"say\":\"idle\"}\n");
    bench.turns(2);
    say(&mut other, &format!("{}stop\n", "state\n".repeat(300)));
    bench.turn();
    bench.is_deaf = false;
    bench.turn();
    assert_eq!(bench.taken, [Verb::Stop], "before three hundred lines, and in place of `idle`");
    bench.turns(2);
    let answer: Value = serde_json::from_str(&heard(&mut commander)[0]).unwrap();
    assert_eq!((&answer["id"], &answer["text"]), (&json!(1), &json!("a stop came first")));
    bench.now += Nanos::from_secs(10);
    bench.turns(2000);
    let answers = heard(&mut other);
    assert_eq!(answers.len(), 301);
    assert!(answers[300].starts_with("ok MANUAL/JOINT"), "{}", answers[300]);
    assert_eq!(bench.taken, [Verb::Stop], "once");
    say(&mut commander, "{\"id\":2,\"say\":\"idle\"}\n");
    bench.turns(3);
    assert_eq!(bench.taken, [Verb::Stop, Verb::Idle], "it goes on afterwards");
}

#[test]
fn a_place_for_stop_is_left_when_all_others_are_taken() {
    let mut bench = Bench::new();
    let mut idle: Vec<UnixStream> = (0..16).map(|_| bench.connect()).collect();
    for stream in &mut idle {
        say(stream, "watch 1 supervisor.control\n");
    }
    bench.turn();
    let mut beyond: Vec<UnixStream> = (0..200).map(|_| bench.connect()).collect();
    let mut last = bench.connect();
    say(&mut last, "state\n{\"id\":9,\"say\":\"stop\"}\n");
    bench.turns(3);
    assert_eq!(bench.taken, [Verb::Stop]);
    let answers = heard(&mut last);
    assert!(answers[0].starts_with("error: too many operators"), "{answers:?}");
    assert!(answers[1].contains("\"id\":9") && answers[1].contains("\"ok\""), "{answers:?}");
    let is_dismissed = |s: &mut UnixStream| heard(s).iter().any(|line| line.contains("needed"));
    let dismissed = beyond.iter_mut().map(is_dismissed).filter(|dismissed| *dismissed).count();
    assert!(dismissed >= 200 - STOP_ONLY_MAX, "{dismissed}");
    assert!(bench.server.clients.len() <= SERVED_MAX + STOP_ONLY_MAX);
}

#[test]
fn an_idle_client_gives_way_and_a_busy_one_does_not() {
    let mut bench = Bench::new();
    let mut all: Vec<UnixStream> = (0..16).map(|_| bench.connect()).collect();
    say(&mut all[0], "control take\n");
    bench.turn();
    let mut early = bench.connect();
    say(&mut early, "state\n");
    bench.turn();
    assert!(heard(&mut early)[0].contains("too many operators"));
    drop(early);
    bench.turn();
    bench.now += Nanos::from_secs(6);
    let mut late = bench.connect();
    say(&mut late, "state\n");
    bench.turn();
    assert!(heard(&mut late)[0].starts_with("ok MANUAL"), "it has a place");
    assert!(heard(&mut all[1])[0].contains("somebody else needed the place"));
    assert!(heard(&mut all[0])[0].contains("you have control"), "and was not dismissed");
}

#[test]
fn questions_need_no_control_and_commands_do() {
    let mut bench = Bench::new();
    let mut first = bench.connect();
    let mut second = bench.connect();
    say(&mut first, "control take\n");
    bench.turn();
    assert_eq!(heard(&mut first), ["ok you have control"]);
    for (line, begins) in [
        ("state", "ok MANUAL/JOINT"),
        ("status", "ok {"),
        ("version", "ok {\"protocol\":1"),
        ("help", "ok {"),
        ("signals", "ok {\"supervisor.control\":"),
        ("parameters", "ok []"),
        ("fault list", "ok []"),
        ("control", "ok {\"holder\":{\"pid\":"),
        ("release", "ok"),
        ("watch off", "ok"),
        ("idle", "refused: process"),
        ("jog joints 1 0 0 0 0 0", "refused: process"),
        ("set a.b 1", "refused: process"),
        ("fault reset", "refused: process"),
        ("record start", "refused: no recording is configured"),
        ("watch 10 nothing", "refused: watch.nothing: there is no such signal"),
    ] {
        say(&mut second, &format!("{line}\n"));
        bench.turn();
        let answers = heard(&mut second);
        assert!(answers[0].starts_with(begins), "{line}: {answers:?}");
    }
    drop(first);
    bench.turns(2);
    say(&mut second, "idle\n");
    bench.turns(2);
    assert!(heard(&mut second)[0].starts_with("ok"), "control is free");
    say(&mut second, "set a.b 1\n");
    bench.turn();
    assert!(heard(&mut second)[0].contains("no parameters"));
}

#[test]
fn watched_signals_and_captures_arrive_as_events() {
    let mut bench = Bench::new();
    let mut caller = bench.connect();
    say(&mut caller, "{\"id\":1,\"say\":\"watch 50 supervisor.control.state\"}\n");
    bench.turns(40);
    let lines = heard(&mut caller);
    assert_eq!(lines[0], "{\"id\":1,\"outcome\":\"ok\"}");
    let events: Vec<Value> =
        lines[1..].iter().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert!((8..=12).contains(&events.len()), "50 Hz for 0.2 s: {}", events.len());
    let last = &events[events.len() - 1];
    assert_eq!(last["values"]["supervisor.control.state"], json!(State::ManualJoint as u32));
    let scope = "scope supervisor.control.state trigger supervisor.control.state above 0 \
                 before 0 after 0.02";
    say(
        &mut caller,
        &format!("{{\"id\":2,\"say\":\"watch off\"}}\n{{\"id\":3,\"say\":\"{scope}\"}}\n"),
    );
    bench.turns(60);
    let lines = heard(&mut caller);
    let event: Value = serde_json::from_str(lines.last().unwrap()).unwrap();
    assert_eq!(event["event"], json!("scope"), "{lines:?}");
    assert_eq!(event["channels"][0]["values"].as_array().unwrap().len(), 21);
}

#[test]
fn a_machine_that_does_not_answer_is_reported_and_another_client_can_go_on() {
    let mut bench = Bench::new();
    let mut caller = bench.connect();
    bench.is_deaf = true;
    say(&mut caller, "idle\n");
    bench.turns(2);
    bench.now += Nanos::from_secs(3);
    bench.turns(2);
    assert_eq!(heard(&mut caller), ["error: the machine does not answer"]);
    bench.is_deaf = false;
    bench.turns(2);
    say(&mut caller, "idle\n");
    bench.turns(3);
    assert!(heard(&mut caller)[0].starts_with("ok"));
}
