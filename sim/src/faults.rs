//! The scene's faults over time: which of them hold at an instant, and when that changes next.
//! Refuses chance of its own: what is drawn comes from the seed.

use taktil_hal::Nanos;

use crate::hash::Hash;
use crate::prng::{Prng, Stream};
use crate::scene::{Fault, FaultKind};

/// One fault in exact time.
#[derive(Clone, Copy, Debug)]
struct Span {
    kind: FaultKind,
    from: Nanos,
    to: Nanos,
    joint: usize,
    share: f64,
    opposed: bool,
}

/// All faults of a scene.
#[derive(Clone, Debug)]
pub(crate) struct Faults {
    spans: Vec<Span>,
    lost: Prng,
}

impl Faults {
    pub(crate) fn new(faults: &[Fault], seed: u64) -> Faults {
        let instant = |s: f64| Nanos((1e9 * s).round() as i64);
        let span = |fault: &Fault| Span {
            kind: fault.kind,
            from: instant(fault.at_s),
            to: fault.for_s.map_or(Nanos::MAX, |for_s| instant(fault.at_s + for_s)),
            joint: fault.joint.map_or(usize::MAX, |joint| joint as usize - 1),
            share: fault.share.unwrap_or(1.0),
            opposed: fault.opposed.unwrap_or(false),
        };
        Faults {
            spans: faults.iter().map(span).collect(),
            lost: Prng::new(seed, Stream::LostFrames),
        }
    }

    fn holding(&self, kind: FaultKind, now: Nanos) -> impl Iterator<Item = &Span> {
        let holds = move |span: &&Span| span.kind == kind && span.from <= now && now < span.to;
        self.spans.iter().filter(holds)
    }

    /// Whether a fault of this kind holds.
    pub(crate) fn hold(&self, kind: FaultKind, now: Nanos) -> bool {
        self.holding(kind, now).next().is_some()
    }

    /// Whether the encoder of a joint counts no more.
    pub(crate) fn dead_encoder(&self, joint: usize, now: Nanos) -> bool {
        self.holding(FaultKind::DeadEncoder, now).any(|span| span.joint == joint)
    }

    /// Whether the frame of the finger's array, or of the one opposed to it, that is complete now
    /// is lost; draws once for each fault that holds.
    pub(crate) fn lose_frame(&mut self, now: Nanos, opposed: bool) -> bool {
        let mut lost = false;
        for span in &self.spans {
            let here = span.kind == FaultKind::DropFrames && span.opposed == opposed;
            if here && span.from <= now && now < span.to {
                lost |= span.share >= 1.0 || self.lost.uniform() <= span.share;
            }
        }
        lost
    }

    /// The next instant after `now` at which a fault begins or ends.
    pub(crate) fn next(&self, now: Nanos) -> Option<Nanos> {
        let instants = self.spans.iter().flat_map(|span| [span.from, span.to]);
        instants.filter(|instant| *instant > now && *instant < Nanos::MAX).min()
    }

    pub(crate) fn digest(&self, hash: &mut Hash) {
        if !self.spans.is_empty() {
            self.lost.digest(hash);
        }
    }
}
