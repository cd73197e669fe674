//! The server of pages against clients that are not pages: forged names, wrong tokens, messages
//! that are too large, connections that say half of something or never read. Behind it stands a
//! machine of a few lines that keeps what it was told.
#![expect(clippy::disallowed_types, reason = "a test collects what threads heard")]

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Duration;

use serde_json::{Value, json};
use taktil_machine_page::{PageConfig, PageServer};
use tungstenite::client::IntoClientRequest;
use tungstenite::{Message, WebSocket};

/// Longest wait for something that has to come (s): far more than it takes on a busy machine.
const WAIT_MAX: Duration = Duration::from_secs(20);

/// A line that the machine was told: which connection said it, and what.
#[derive(Debug)]
enum Told {
    Line(Value),
    HungUp,
}

/// A machine that answers `ok`, sends values when they are watched, and keeps what it was told.
fn machine(path: &Path) -> Receiver<Told> {
    let (told, heard) = channel();
    let listener = UnixListener::bind(path).unwrap();
    std::thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            let told = told.clone();
            std::thread::spawn(move || serve(stream, &told));
        }
    });
    heard
}

fn serve(stream: UnixStream, told: &Sender<Told>) {
    let mut answers = stream.try_clone().unwrap();
    let mut watcher = Some(stream.try_clone().unwrap());
    for line in BufReader::new(stream).lines() {
        let Ok(line) = line else { break };
        let said: Value = serde_json::from_str(&line).unwrap();
        let words = said["say"].as_str().unwrap_or_default().to_owned();
        let data = match words.as_str() {
            "signals" => {
                json!({ "sense.joints": [{ "name": "q_rad", "type": "float64", "count": 6 }] })
            }
            "status" => json!({ "state": "START" }),
            _ => Value::Null,
        };
        if words.starts_with("watch ")
            && let Some(mut events) = watcher.take()
        {
            std::thread::spawn(move || {
                for t_ns in 0.. {
                    let values = json!({ "sense.joints.q_rad": vec![0.5; 400] });
                    let event = json!({ "event": "watch", "t_ns": t_ns, "values": values });
                    if events.write_all(format!("{event}\n").as_bytes()).is_err() {
                        return;
                    }
                    std::thread::sleep(Duration::from_millis(5));
                }
            });
        }
        let answer = json!({ "id": said["id"], "outcome": "ok", "text": words, "data": data });
        let _ = told.send(Told::Line(said));
        if answers.write_all(format!("{answer}\n").as_bytes()).is_err() {
            break;
        }
    }
    let _ = told.send(Told::HungUp);
}

/// A server in front of such a machine.
struct Bench {
    server: PageServer,
    address: SocketAddr,
    heard: Receiver<Told>,
    folder: PathBuf,
}

impl Bench {
    fn new(name: &str) -> Bench {
        let folder = std::env::temp_dir().join(format!("taktil-{name}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir_all(&folder).unwrap();
        let heard = machine(&folder.join("op"));
        let mut config = PageConfig::for_socket(&folder.join("op"));
        config.port = Some(0);
        let server = PageServer::start(&config).unwrap();
        let address = server.url()["http://".len()..].trim_end_matches('/').parse().unwrap();
        Bench { server, address, heard, folder }
    }

    fn token(&self) -> String {
        std::fs::read_to_string(self.server.token_path()).unwrap().trim().to_owned()
    }

    fn stream(&self) -> TcpStream {
        let stream = TcpStream::connect(self.address).unwrap();
        stream.set_read_timeout(Some(WAIT_MAX)).unwrap();
        stream
    }

    /// The whole answer to some bytes.
    fn answer_to(&self, bytes: &[u8]) -> String {
        let mut stream = self.stream();
        stream.write_all(bytes).unwrap();
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        String::from_utf8_lossy(&answer).into_owned()
    }

    fn page(&self) -> TestPage {
        self.page_of(&format!("http://{}", self.address)).unwrap()
    }

    fn page_of(&self, origin: &str) -> Result<TestPage, u16> {
        let url = format!("ws://{}/machine", self.address);
        let mut request = url.into_client_request().unwrap();
        let headers = request.headers_mut();
        headers.insert("origin", origin.parse().unwrap());
        headers.insert("sec-websocket-protocol", "taktil.page.v1".parse().unwrap());
        match tungstenite::client(request, self.stream()) {
            Ok((socket, _)) => Ok(TestPage { socket, asked: 0 }),
            Err(tungstenite::HandshakeError::Failure(tungstenite::Error::Http(answer))) => {
                Err(answer.status().as_u16())
            }
            Err(error) => panic!("{error}"),
        }
    }

    /// Waits until the machine has heard words.
    fn wait_for(&self, words: &str) {
        loop {
            let told = self.heard.recv_timeout(WAIT_MAX).expect(words);
            if matches!(&told, Told::Line(said) if said["say"] == words) {
                return;
            }
        }
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

/// A page without a browser.
struct TestPage {
    socket: WebSocket<TcpStream>,
    asked: u64,
}

impl TestPage {
    fn send(&mut self, value: &Value) {
        self.socket.send(Message::text(value.to_string())).unwrap();
    }

    /// The next message; `None` when the server has hung up.
    fn next(&mut self) -> Option<Value> {
        loop {
            match self.socket.read() {
                Ok(Message::Text(text)) => return Some(serde_json::from_str(&text).unwrap()),
                Ok(_) => {}
                Err(_) => return None,
            }
        }
    }

    fn ask(&mut self, key: &str, value: Value) -> Option<Value> {
        self.asked += 1;
        let id = self.asked;
        self.send(&json!({ "id": id, key: value }));
        loop {
            let value = self.next()?;
            if value["id"] == json!(id) {
                return Some(value);
            }
        }
    }

    fn say(&mut self, words: &str) -> String {
        let answer = self.ask("say", json!(words)).unwrap();
        let text = answer["text"].as_str().unwrap_or_default();
        format!("{}: {text}", answer["outcome"].as_str().unwrap())
    }
}

#[test]
fn a_page_without_the_token_watches_and_stops_and_commands_nothing() {
    let bench = Bench::new("viewer");
    let mut page = bench.page();
    let seen = std::iter::from_fn(|| page.next()).find(|value| value["event"] == "update").unwrap();
    assert_eq!(seen["watch"]["values"]["sense.joints.q_rad"][0], json!(0.5));
    for words in ["enable", "jog joints 0 0 1 0 0 0", "set a 1", "control take", "fault reset"] {
        let answer = page.say(words);
        assert!(answer.starts_with("refused: this page may watch and stop"), "{words}: {answer}");
    }
    assert_eq!(page.say("status"), "ok: status");
    assert_eq!(page.say("stop"), "ok: stop");
    bench.wait_for("stop");
    // All that was refused would have been heard before it.
    let later: Vec<Told> = bench.heard.try_iter().collect();
    let commands = ["enable", "set a 1", "control take"];
    let is_command = |said: &Value| commands.iter().any(|word| said["say"] == *word);
    let is_command = |told: &Told| matches!(told, Told::Line(said) if is_command(said));
    assert!(!later.iter().any(is_command));
}

#[test]
fn the_token_opens_a_page_and_a_wrong_one_ends_it_at_the_third_time() {
    let bench = Bench::new("token");
    let mut page = bench.page();
    assert_eq!(page.ask("token", json!("x")).unwrap()["outcome"], "refused");
    assert!(page.say("enable").starts_with("refused"));
    assert_eq!(page.ask("token", json!(bench.token())).unwrap()["outcome"], "ok");
    assert_eq!(page.say("enable"), "ok: enable");
    bench.wait_for("enable");
    let mut other = bench.page();
    assert!(other.say("enable").starts_with("refused"), "one page's token opens no other");
    assert!(other.ask("token", json!("a")).is_some() && other.ask("token", json!("b")).is_some());
    assert!(other.ask("token", json!("c")).is_none(), "hung up");
}

#[test]
fn held_keys_are_repeated_and_let_go_of_with_the_connection() {
    let bench = Bench::new("hold");
    let mut page = bench.page();
    assert_eq!(page.ask("token", json!(bench.token())).unwrap()["outcome"], "ok");
    let keys = "jog joints 0.5 0 0 0 0 0";
    assert!(page.say(keys).starts_with("ok"));
    // Three repetitions of one word of the page, and then its silence is a release.
    for _ in 0..3 {
        bench.wait_for(keys);
    }
    bench.wait_for("release");
    assert!(page.say(keys).starts_with("refused: the page was silent"), "held again by nobody");
    assert_eq!(page.say("release"), "ok: release");
    assert!(page.say(keys).starts_with("ok"));
    bench.wait_for(keys);
    drop(page);
    let is_hung_up = |told: Told| matches!(told, Told::HungUp);
    while !is_hung_up(bench.heard.recv_timeout(WAIT_MAX).expect("the machine is hung up on")) {}
}

#[test]
fn foreign_pages_and_foreign_names_are_refused() {
    let bench = Bench::new("foreign");
    for origin in ["http://evil.test", "null", "http://127.0.0.1:1", "https://127.0.0.1"] {
        assert_eq!(bench.page_of(origin).err(), Some(403), "{origin}");
    }
    let get = |head: &str| bench.answer_to(head.replace('\n', "\r\n").as_bytes());
    let own = format!("GET / HTTP/1.1\nHost: {}\n\n", bench.address);
    let page = get(&own);
    assert!(page.starts_with("HTTP/1.1 200") && page.contains("<html"), "{page}");
    assert!(page.contains("frame-ancestors 'none'"));
    for (head, status) in [
        (own.replace(&bench.address.to_string(), "evil.test"), "403"),
        (own.replace("GET", "POST"), "405"),
        (own.replace("GET /", "GET /../../../../etc/passwd"), "404"),
        (own.replace("GET /", "GET /%2e%2e/%2e%2e/etc/passwd"), "404"),
        (own.replace("GET /", &format!("GET /{}", "x".repeat(9000))), "431"),
        ("\u{16}\u{3}\u{1}\n\n".to_owned(), "400"),
    ] {
        let answer = get(&head);
        assert!(answer.starts_with(&format!("HTTP/1.1 {status}")), "{head:.80}: {answer:.200}");
        assert!(!answer.contains("root:"));
    }
}

#[test]
fn messages_that_are_too_large_or_no_messages_end_a_page_and_no_other() {
    let bench = Bench::new("large");
    let mut other = bench.page();
    assert!(other.next().is_some());
    let mut large = bench.page();
    let _ = large.socket.send(Message::text("x".repeat(70_000)));
    while large.next().is_some() {}
    let mut wrong = bench.page();
    let _ = wrong.socket.get_mut().write_all(&[0x81, 0x05, b'h', b'e', b'l', b'l', b'o']);
    while wrong.next().is_some() {}
    let mut claims = bench.page();
    // A frame that claims 2^62 bytes.
    let _ = claims.socket.get_mut().write_all(&[0x81, 0xff, 0x40, 0, 0, 0, 0, 0, 0, 0, 1, 2, 3, 4]);
    while claims.next().is_some() {}
    let mut deep = bench.page();
    deep.send(&json!(null));
    let told = std::iter::from_fn(|| deep.next()).find(|value| value["outcome"] == "refused");
    assert!(told.is_some(), "what is no request is refused");
    assert_eq!(other.say("status"), "ok: status");
}

#[test]
fn slow_and_silent_connections_are_ended_and_keep_nobody_waiting() {
    let bench = Bench::new("slow");
    let mut lorises: Vec<TcpStream> = (0..32).map(|_| bench.stream()).collect();
    for stream in &mut lorises {
        stream.write_all(b"GET / HT").unwrap();
    }
    // All places for connections are taken: the next one is served when they have been ended.
    let page =
        bench.answer_to(format!("GET / HTTP/1.1\r\nHost: {}\r\n\r\n", bench.address).as_bytes());
    assert!(page.starts_with("HTTP/1.1 200"), "{page:.100}");
    for mut stream in lorises {
        let mut rest = Vec::new();
        let ended = stream.read_to_end(&mut rest);
        assert!(rest.is_empty() && ended.is_ok_and(|count| count == 0), "ended without an answer");
    }
}

#[test]
fn a_page_that_never_reads_gets_only_the_newest_and_others_get_everything() {
    let bench = Bench::new("latest");
    let mut slow = bench.page();
    let mut quick = bench.page();
    let (mut updates, mut dropped) = (0, 0);
    while updates < 60 {
        let value = quick.next().unwrap();
        if value["event"] == "update" {
            updates += 1;
            dropped = value["dropped"].as_u64().unwrap();
            quick.send(&json!({ "seen": value["number"] }));
        }
    }
    assert!(dropped < 60, "{dropped}");
    // The slow one has confirmed nothing: two updates wait for it, however long that took.
    let answer = slow.ask("say", json!("status"));
    assert_eq!(answer.unwrap()["outcome"], "ok");
    slow.send(&json!({ "seen": 2 }));
    let third = std::iter::from_fn(|| slow.next()).find(|value| value["number"] == 3).unwrap();
    let replaced = third["dropped"].as_u64().unwrap();
    assert!(replaced >= 40, "what it did not take was replaced and counted: {replaced}");
}

#[test]
fn the_seventeenth_page_is_sent_away_and_a_place_that_is_left_is_taken() {
    let bench = Bench::new("places");
    let mut pages: Vec<TestPage> = (0..16).map(|_| bench.page()).collect();
    for page in &mut pages {
        assert!(page.next().is_some());
    }
    assert_eq!(bench.page_of(&format!("http://{}", bench.address)).err(), Some(503));
    drop(pages.pop());
    let again = (0..200).find_map(|_| {
        std::thread::sleep(Duration::from_millis(20));
        bench.page_of(&format!("http://{}", bench.address)).ok()
    });
    assert!(again.is_some());
}

#[test]
fn an_address_that_others_can_reach_needs_a_token_file_that_exists() {
    let mut config = PageConfig::for_socket(Path::new("/nonexistent/op"));
    config.address = "0.0.0.0".parse().unwrap();
    config.port = Some(0);
    let refused = PageServer::start(&config).unwrap_err();
    assert!(refused.what.contains("not the loopback"), "{refused:?}");
    config.token_file = Some("/nonexistent/token".into());
    assert_eq!(PageServer::start(&config).unwrap_err().place, "--token-file");
}
