//! Keys that are held on a page. A browser says so about twenty times a second; the machine wants
//! to hear it more often than that and lets go by itself when it does not. The server repeats what
//! a page holds, and lets go when the page has been silent for too long.

use taktil_rtcore::Nanos;

/// How often the machine is told (Nanos): half of the shortest time after which it lets go.
const REPEAT_INTERVAL: Nanos = Nanos::from_millis(20);
/// How long a page may be silent before its keys count as released: three heartbeats.
const HEARTBEAT_MAX: Nanos = Nanos::from_millis(150);

/// What is to be said to the machine now.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum HoldAction {
    /// Nothing.
    Nothing,
    /// The held keys again.
    Repeat(String),
    /// No keys are held.
    Release,
}

/// The keys that a page holds.
#[derive(Debug, Default)]
pub(crate) struct Hold {
    words: Option<String>,
    heard: Nanos,
    next: Nanos,
    /// The machine has not answered the last repetition.
    is_asked: bool,
    /// Numbers under which the page waits for the machine's answer.
    waiting: Vec<u64>,
    /// The page was silent with keys held: it has to let go before it holds keys again, as nobody
    /// can tell whether a hand still does.
    has_lapsed: bool,
}

impl Hold {
    /// The page holds keys: the words say which, and it waits for an answer under a number. False
    /// when it has to let go first.
    pub(crate) fn press(&mut self, words: String, id: u64, now: Nanos) -> bool {
        if self.has_lapsed {
            return false;
        }
        if self.words.is_none() {
            self.next = now;
        } else if self.words.as_ref() != Some(&words) {
            // Other keys are told at once.
            self.next = self.next.min(now);
        }
        self.words = Some(words);
        self.heard = now;
        self.waiting.push(id);
        true
    }

    /// The page has let go, or may hold nothing.
    pub(crate) fn release(&mut self) {
        self.words = None;
        self.has_lapsed = false;
    }

    /// What the machine is to be told.
    pub(crate) fn action(&mut self, now: Nanos) -> HoldAction {
        let Some(words) = &self.words else { return HoldAction::Nothing };
        if now - self.heard > HEARTBEAT_MAX {
            self.words = None;
            self.has_lapsed = true;
            return HoldAction::Release;
        }
        if self.is_asked || now < self.next {
            return HoldAction::Nothing;
        }
        self.is_asked = true;
        self.next = (self.next + REPEAT_INTERVAL).max(now);
        HoldAction::Repeat(words.clone())
    }

    /// When something is to be said next, if nothing comes.
    pub(crate) fn due(&self) -> Option<Nanos> {
        self.words.as_ref().map(|_| self.next)
    }

    /// The machine has answered a repetition; returns the numbers under which the page waits. A
    /// refusal ends the hold.
    pub(crate) fn answered(&mut self, is_ok: bool) -> Vec<u64> {
        self.is_asked = false;
        if !is_ok {
            self.words = None;
        }
        std::mem::take(&mut self.waiting)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn held_keys_are_repeated_until_the_page_is_silent_lets_go_or_is_refused() {
        let at = Nanos::from_millis;
        let keys = || "jog joints 1 0 0 0 0 0".to_owned();
        let mut hold = Hold::default();
        assert_eq!(hold.action(at(0)), HoldAction::Nothing);
        hold.press(keys(), 1, at(0));
        assert_eq!(hold.action(at(0)), HoldAction::Repeat(keys()));
        assert_eq!(hold.action(at(25)), HoldAction::Nothing, "one question at a time");
        assert_eq!(hold.answered(true), [1]);
        assert_eq!(hold.action(at(25)), HoldAction::Repeat(keys()));
        hold.answered(true);
        hold.press(keys(), 2, at(50));
        assert_eq!(hold.action(at(60)), HoldAction::Repeat(keys()));
        assert_eq!(hold.answered(true), [2]);
        assert_eq!(hold.action(at(201)), HoldAction::Release, "silent for more than 150 ms");
        assert_eq!(hold.action(at(202)), HoldAction::Nothing);
        assert!(!hold.press(keys(), 9, at(250)), "a page that hung has to let go first");
        hold.release();
        assert!(hold.press(keys(), 3, at(300)));
        hold.release();
        assert_eq!(hold.action(at(301)), HoldAction::Nothing);
        hold.press(keys(), 4, at(400));
        assert_eq!(hold.action(at(400)), HoldAction::Repeat(keys()));
        assert_eq!(hold.answered(false), [3, 4], "whoever waits is answered once");
        assert_eq!(hold.action(at(430)), HoldAction::Nothing, "what was refused is not repeated");
        hold.press(keys(), 5, at(500));
        assert_eq!(hold.action(at(510)), HoldAction::Repeat(keys()));
        hold.press("jog base 0 0 1 0 0 0".into(), 6, at(512));
        hold.answered(true);
        assert!(
            matches!(hold.action(at(512)), HoldAction::Repeat(words) if words.contains("base"))
        );
    }
}
