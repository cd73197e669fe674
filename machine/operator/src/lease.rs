//! The control lease: one client at a time commands. It is taken by commanding, or by `control
//! take`, kept by every line of its holder, and lost by `control release`, by hanging up, and to
//! another client after a silence.

use taktil_rtcore::Nanos;

/// How long a holder may be silent, with nothing under way, before another client may take over.
const SILENCE_MAX: Nanos = Nanos::from_secs(2);

/// Who commands.
#[derive(Clone, Copy, Debug)]
struct Holder {
    client: u64,
    pid: i32,
    uid: u32,
    heard: Nanos,
}

/// The one control lease of a machine.
#[derive(Debug, Default)]
pub(crate) struct ControlLease(Option<Holder>);

impl ControlLease {
    /// Gives the lease to a client, unless another one holds it and was heard within the last two
    /// seconds.
    ///
    /// # Errors
    /// Who holds it, as text.
    pub(crate) fn take(
        &mut self,
        client: u64,
        (pid, uid): (i32, u32),
        now: Nanos,
    ) -> Result<(), String> {
        if let Some(holder) = self.0.filter(|holder| holder.client != client) {
            let silent = now - holder.heard;
            if silent < SILENCE_MAX {
                let left = (SILENCE_MAX - silent).as_secs_f64();
                return Err(format!(
                    "process {} of user {} has control; it is free when that one says `control \
                     release`, hangs up, or is silent for {left:.1} s more; `stop` is heard from \
                     everyone",
                    holder.pid, holder.uid
                ));
            }
        }
        self.0 = Some(Holder { client, pid, uid, heard: now });
        Ok(())
    }

    /// A sign of life of a client; counts only for the holder.
    pub(crate) fn keep(&mut self, client: u64, now: Nanos) {
        if let Some(holder) = self.0.as_mut().filter(|holder| holder.client == client) {
            holder.heard = now;
        }
    }

    /// The client gives the lease back or has gone; true when it held it.
    pub(crate) fn release(&mut self, client: u64) -> bool {
        let held = self.is_held_by(client);
        if held {
            self.0 = None;
        }
        held
    }

    /// Whether this client holds it.
    pub(crate) fn is_held_by(&self, client: u64) -> bool {
        self.0.is_some_and(|holder| holder.client == client)
    }

    /// Process and user of the holder.
    pub(crate) fn holding_process(&self) -> Option<(i32, u32)> {
        self.0.map(|holder| (holder.pid, holder.uid))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_client_commands_until_it_is_silent_gone_or_gives_it_back() {
        let begin = Nanos::from_secs(5);
        let at = |ms: i64| begin + Nanos::from_millis(ms);
        let mut lease = ControlLease::default();
        assert!(lease.take(1, (10, 1000), at(0)).is_ok());
        assert!(lease.take(1, (10, 1000), at(10)).is_ok(), "again");
        let held = lease.take(2, (20, 1001), at(1500)).unwrap_err();
        assert!(held.contains("process 10 of user 1000"), "{held}");
        lease.keep(1, at(1900));
        lease.keep(2, at(1900));
        assert!(lease.take(2, (20, 1001), at(3800)).is_err());
        assert!(lease.take(2, (20, 1001), at(3900)).is_ok(), "two seconds of silence");
        assert!(!lease.release(1), "it has lost it");
        assert!(lease.is_held_by(2) && lease.release(2));
        assert!(lease.take(1, (10, 1000), at(3901)).is_ok());
        assert_eq!(lease.holding_process(), Some((10, 1000)));
    }
}
