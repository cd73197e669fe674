//! The server for live viewers against clients that are not viewers: forged names, half messages,
//! floods, messages that are too large, and connections that never read. Behind it stands a machine
//! of a few lines.
#![cfg(feature = "foxglove")]

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::PathBuf;
use std::time::Duration;

use serde_json::{Value, json};
use taktil_machine_page::{PageConfig, PageServer};
use tungstenite::client::IntoClientRequest;
use tungstenite::{Message, WebSocket};

/// Longest wait for something that has to come: far more than it takes on a busy machine.
const WAIT_MAX: Duration = Duration::from_secs(20);
/// Values that the machine sends in a second.
const EVENT_INTERVAL: Duration = Duration::from_millis(5);

/// A machine with an arm of two joints that answers what is asked and sends values.
fn machine(listener: UnixListener) {
    std::thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            std::thread::spawn(move || serve(stream));
        }
    });
}

fn serve(stream: UnixStream) {
    let mut answers = stream.try_clone().unwrap();
    let mut watcher = Some(stream.try_clone().unwrap());
    let origin = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.25];
    for line in BufReader::new(stream).lines() {
        let Ok(line) = line else { return };
        let said: Value = serde_json::from_str(&line).unwrap();
        let words = said["say"].as_str().unwrap_or_default().to_owned();
        let data = match words.as_str() {
            "model" => {
                let joint = json!({ "origin": origin, "low_rad": -1, "high_rad": 1 });
                json!({ "arm": "two joints", "joints": [joint, joint], "tool": origin })
            }
            "signals" => json!({
                "sense.joints": [{ "name": "q_rad", "type": "float64", "count": 2 }],
                "a.big": [{ "name": "numbers", "type": "float64", "count": 4000 }],
            }),
            _ => Value::Null,
        };
        if words.starts_with("watch ")
            && let Some(mut events) = watcher.take()
        {
            std::thread::spawn(move || {
                for t_ns in 0.. {
                    let big = json!({ "numbers": vec![0.123_456_789; 4000] });
                    let values = json!({ "sense.joints.q_rad": [0.5, t_ns], "a.big": big });
                    let event = json!({ "event": "watch", "t_ns": t_ns, "values": values });
                    if events.write_all(format!("{event}\n").as_bytes()).is_err() {
                        return;
                    }
                    std::thread::sleep(EVENT_INTERVAL);
                }
            });
        }
        let answer = json!({ "id": said["id"], "outcome": "ok", "text": words, "data": data });
        if answers.write_all(format!("{answer}\n").as_bytes()).is_err() {
            return;
        }
    }
}

/// A server in front of such a machine.
struct Bench {
    _server: PageServer,
    address: SocketAddr,
    folder: PathBuf,
}

impl Bench {
    fn new(name: &str, viewer_origins: Option<Vec<String>>) -> Bench {
        let folder = std::env::temp_dir().join(format!("taktil-{name}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir_all(&folder).unwrap();
        machine(UnixListener::bind(folder.join("op")).unwrap());
        let mut config = PageConfig::for_socket(&folder.join("op"));
        (config.port, config.viewer_origins) = (Some(0), viewer_origins);
        let server = PageServer::start(&config).unwrap();
        let address = server.url()["http://".len()..].trim_end_matches('/').parse().unwrap();
        Bench { _server: server, address, folder }
    }

    fn stream(&self) -> TcpStream {
        let stream = TcpStream::connect(self.address).unwrap();
        stream.set_read_timeout(Some(WAIT_MAX)).unwrap();
        stream
    }

    /// A viewer of an origin and with a subprotocol; the status with which it is refused otherwise.
    fn viewer(&self, origin: Option<&str>, subprotocol: &str) -> Result<TestViewer, u16> {
        let mut request = format!("ws://{}/foxglove", self.address).into_client_request().unwrap();
        let headers = request.headers_mut();
        headers.insert("Sec-WebSocket-Protocol", subprotocol.parse().unwrap());
        if let Some(origin) = origin {
            headers.insert("Origin", origin.parse().unwrap());
        }
        match tungstenite::client(request, self.stream()) {
            Ok((socket, _)) => Ok(TestViewer(socket)),
            Err(tungstenite::HandshakeError::Failure(tungstenite::Error::Http(answer))) => {
                Err(answer.status().as_u16())
            }
            Err(other) => panic!("{other}"),
        }
    }

    fn plain_viewer(&self) -> TestViewer {
        self.viewer(None, "foxglove.websocket.v1").unwrap()
    }

    /// The first line of the answer to a request for a file.
    fn status_of(&self, path: &str) -> String {
        let mut stream = self.stream();
        write!(stream, "GET {path} HTTP/1.1\r\nHost: {}\r\n\r\n", self.address).unwrap();
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        String::from_utf8_lossy(&answer).lines().next().unwrap_or_default().to_owned()
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

struct TestViewer(WebSocket<TcpStream>);

impl TestViewer {
    fn say(&mut self, message: Value) {
        self.0.send(Message::text(message.to_string())).unwrap();
    }

    /// The next text with this operation; pings are answered meanwhile.
    fn text(&mut self, op: &str) -> Value {
        loop {
            if let Message::Text(text) = self.0.read().unwrap() {
                let value: Value = serde_json::from_str(&text).unwrap();
                if value["op"] == op {
                    return value;
                }
            }
        }
    }

    /// The number of the channel with this topic.
    fn channel(&mut self, topic: &str) -> u64 {
        let all = self.text("advertise");
        let found = all["channels"].as_array().unwrap().iter().find(|one| one["topic"] == topic);
        found.unwrap_or_else(|| panic!("{topic} in {all}"))["id"].as_u64().unwrap()
    }

    fn subscribe(&mut self, id: u32, channel: u64) {
        let wanted = json!([{ "id": id, "channelId": channel }]);
        self.say(json!({ "op": "subscribe", "subscriptions": wanted }));
    }

    /// The next values: the number of the subscription, the stamp (ns) and the message.
    fn values(&mut self) -> (u32, u64, Vec<u8>) {
        loop {
            if let Message::Binary(bytes) = self.0.read().unwrap() {
                assert_eq!(bytes[0], 1, "values");
                let id = u32::from_le_bytes(bytes[1..5].try_into().unwrap());
                let at = u64::from_le_bytes(bytes[5..13].try_into().unwrap());
                return (id, at, bytes[13..].to_vec());
            }
        }
    }

    /// Whether the server ends the connection.
    fn is_ended(&mut self) -> bool {
        loop {
            match self.0.read() {
                Ok(Message::Close(_)) => return true,
                Ok(_) => {}
                Err(tungstenite::Error::Io(error)) => {
                    return error.kind() != std::io::ErrorKind::WouldBlock;
                }
                Err(_) => return true,
            }
        }
    }
}

#[test]
fn viewers_are_served_where_they_are_asked_for_and_to_whom() {
    let closed = Bench::new("viewers-closed", None);
    assert_eq!(closed.viewer(None, "foxglove.websocket.v1").err(), Some(404));
    assert!(closed.status_of("/foxglove-layout.json").contains("404"));
    let named = format!("https://{}", "viewer.test");
    let open = Bench::new("viewers-open", Some(vec![named.clone()]));
    assert!(open.status_of("/foxglove-layout.json").contains("200"));
    for origin in [None, Some("file://"), Some(&*named)] {
        assert!(open.viewer(origin, "foxglove.websocket.v1").is_ok(), "{origin:?}");
    }
    let own = format!("http://{}", open.address);
    assert!(open.viewer(Some(&own), "foxglove.sdk.v1").is_ok());
    let other = format!("https://{}", "evil.test");
    for origin in [&*other, "null"] {
        assert_eq!(open.viewer(Some(origin), "foxglove.websocket.v1").err(), Some(403));
    }
    assert_eq!(open.viewer(None, "taktil.page.v1").err(), Some(400));
}

#[test]
fn values_come_for_what_is_subscribed_to_and_for_nothing_else() {
    let bench = Bench::new("viewers-values", Some(Vec::new()));
    let mut viewer = bench.plain_viewer();
    let info = viewer.text("serverInfo");
    assert_eq!(info["capabilities"], json!([]));
    let joints = viewer.channel("/viewer/joints");
    viewer.subscribe(7, joints);
    let (id, first, body) = viewer.values();
    assert!(id == 7 && !body.is_empty());
    // The machine's logical time is nanoseconds apart, and so are the stamps.
    let (_, second, _) = viewer.values();
    assert!(second > first && second - first < 1_000_000, "{first} {second}");
    viewer.subscribe(7, joints);
    assert!(viewer.text("status")["message"].as_str().unwrap().contains("already"));
    viewer.subscribe(8, 4_000_000_000);
    assert!(viewer.text("status")["message"].as_str().unwrap().contains("no channel"));
    viewer.say(json!({ "op": "unsubscribe", "subscriptionIds": [7] }));
    viewer.say(json!({ "op": "setParameters", "parameters": [] }));
    assert!(viewer.text("status")["message"].as_str().unwrap().contains("watch"));
}

#[test]
fn a_viewer_that_does_not_read_gets_the_newest_values_and_costs_others_nothing() {
    let bench = Bench::new("viewers-slow", Some(Vec::new()));
    let mut slow = bench.plain_viewer();
    let big = slow.channel("/a/big");
    slow.subscribe(1, big);
    let (_, before, _) = slow.values();
    let mut other = bench.plain_viewer();
    let joints = other.channel("/viewer/joints");
    other.subscribe(1, joints);
    // 200 rounds of some 50 KiB are far more than any buffer between the two holds.
    let mut newest = 0;
    for _ in 0..200 {
        newest = other.values().1;
    }
    let mut seen = vec![before];
    while *seen.last().unwrap() < newest {
        seen.push(slow.values().1);
    }
    // At most two rounds were on their way; what comes after them is new.
    assert!(seen.len() <= 5, "{} old values were kept", seen.len());
}

#[test]
fn floods_large_messages_and_garbage_end_the_connection_and_not_the_server() {
    let bench = Bench::new("viewers-hostile", Some(Vec::new()));
    let mut large = bench.plain_viewer();
    let _ = large.0.send(Message::text("x".repeat(1 << 17)));
    assert!(large.is_ended());
    let mut flood = bench.plain_viewer();
    for _ in 0..2000 {
        if flood.0.send(Message::text("{\"op\":\"nothing\"}")).is_err() {
            break;
        }
    }
    assert!(flood.is_ended());
    let mut raw = bench.plain_viewer();
    raw.0.get_mut().write_all(&[0xff; 64]).unwrap();
    assert!(raw.is_ended());
    // Seventeen are too many, and one that hung up makes room.
    let mut all: Vec<TestViewer> = (0..16).map(|_| bench.plain_viewer()).collect();
    assert_eq!(bench.viewer(None, "foxglove.websocket.v1").err(), Some(503));
    all.clear();
    let again = (0..200).any(|_| {
        std::thread::sleep(Duration::from_millis(20));
        bench.viewer(None, "foxglove.websocket.v1").is_ok()
    });
    assert!(again, "room is made");
}
