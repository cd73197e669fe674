//! Whatever comes over the line of a tactile array: no panic, bounded work, and once whole messages
//! come again all but the first two of them are delivered. The first byte chooses the board, the
//! second one in which pieces the bytes arrive.
#![no_main]

use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use taktil_drivers_serial::{BoardKind, Config, Outlet, Phase, Scan, Session};
use taktil_hal::Nanos;

/// The boards, each with the bytes that a session with one of them held.
const BOARD_SESSIONS: [(BoardKind, &[u8]); 4] = [
    (BoardKind::Myrmex, include_bytes!("../../../drivers/serial/recordings/emulator-myrmex.bin")),
    (
        BoardKind::Flexitac,
        include_bytes!("../../../drivers/serial/recordings/emulator-flexitac.bin"),
    ),
    (
        BoardKind::WeissWts,
        include_bytes!("../../../drivers/serial/recordings/emulator-weiss-wts.bin"),
    ),
    (
        BoardKind::WeissDsa,
        include_bytes!("../../../drivers/serial/recordings/emulator-weiss-dsa.bin"),
    ),
];
/// Most pieces in which the bytes that a fuzzer makes arrive, but for the last one.
const PIECES_MAX: usize = 1024;
/// Messages before the bytes that a fuzzer makes.
const MESSAGES_BEFORE: usize = 2;
/// Messages behind them.
const MESSAGES_BEHIND: usize = 5;
/// Messages behind them that may be lost.
const MESSAGES_LOST_MAX: usize = 2;

/// Gives one scan out again and again, and counts.
struct Slot {
    scan: Option<Box<Scan>>,
    count: usize,
}

impl Outlet for Slot {
    fn take(&mut self) -> Option<Box<Scan>> {
        self.scan.take()
    }

    fn put(&mut self, scan: Box<Scan>) {
        self.scan = Some(scan);
        self.count += 1;
    }
}

struct Stream {
    session: Session,
    slot: Slot,
    now: Nanos,
}

impl Stream {
    fn new(board: BoardKind) -> Stream {
        let config = Config { board, ..Config::default() };
        let mut session = Session::new(&config).expect("a good configuration");
        session.restart(Nanos::ZERO);
        let slot = Slot { scan: Some(Box::new(Scan::new(session.geometry()))), count: 0 };
        // Past the silence that Myrmex needs after its stop.
        session.poll(Nanos::ZERO);
        session.poll(Nanos::from_millis(150));
        Stream { session, slot, now: Nanos::from_millis(160) }
    }

    fn push(&mut self, bytes: &[u8], piece_bytes: usize) {
        for piece in bytes.chunks(piece_bytes) {
            self.session.push(self.now, piece, &mut self.slot);
            self.session.poll(self.now);
            self.now += Nanos::from_micros(10) * piece.len() as i64;
        }
    }
}

/// The dialogue with some messages, and whole messages behind these.
static PARTS: LazyLock<[(&[u8], &[u8]); 4]> = LazyLock::new(|| {
    BOARD_SESSIONS.map(|(board, bytes)| {
        let mut stream = Stream::new(board);
        let mut ends = Vec::new();
        for (at, byte) in bytes.iter().enumerate() {
            let before = stream.slot.count;
            stream.push(&[*byte], 1);
            if stream.slot.count > before {
                ends.push(at + 1);
            }
        }
        let (begin, end) = (ends[MESSAGES_BEFORE], ends[MESSAGES_BEFORE + MESSAGES_BEHIND]);
        (&bytes[..begin], &bytes[begin..end])
    })
});

fuzz_target!(|bytes: &[u8]| {
    let [kind, piece, bytes @ ..] = bytes else { return };
    // A long input comes in larger pieces: what single bytes show, a few messages show.
    let piece_bytes = (1 + 3 * usize::from(*piece)).max(bytes.len() / PIECES_MAX);
    let board = usize::from(kind & 3);
    let mut stream = Stream::new(BOARD_SESSIONS[board].0);
    let (before, behind) = PARTS[board];
    if kind & 4 == 0 {
        stream.push(before, 64);
    }
    let skipped = stream.session.health().skipped_bytes;
    stream.push(bytes, piece_bytes);
    let health = stream.session.health();
    assert!(health.skipped_bytes - skipped <= (bytes.len() + before.len()) as u64);
    let streams = stream.session.phase() == Phase::Streaming;
    let count = stream.slot.count;
    stream.push(behind, 64);
    if streams && kind & 4 == 0 {
        let delivered = stream.slot.count - count;
        assert!(delivered + MESSAGES_LOST_MAX >= MESSAGES_BEHIND, "{delivered} delivered");
    }
});
