//! Who is at the other end of a connection, and what that user may do. The kernel says who it is.
#![allow(unsafe_code)]

use std::os::fd::AsRawFd;
use std::os::unix::net::UnixStream;

use nix::sys::socket::getsockopt;
use nix::sys::socket::sockopt::PeerCredentials;
use nix::unistd::{Gid, Group, Uid};
use taktil_rtcore::Invalid;

use crate::OperatorConfig;

/// Largest number of supplementary groups that are asked for.
const GROUPS_MAX: usize = 1024;

/// What a client may do. Each role includes those before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Role {
    /// Nothing at all.
    None,
    /// See everything, and stop the machine.
    View,
    /// Command the machine, when nobody else does.
    Control,
}

impl Role {
    /// The name in answers.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Role::None => "none",
            Role::View => "view",
            Role::Control => "control",
        }
    }
}

/// The process at the other end of a connection.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Peer {
    pub(crate) pid: i32,
    pub(crate) uid: u32,
    groups: Vec<u32>,
}

impl Peer {
    /// The credentials that the process had when it connected.
    pub(crate) fn of(stream: &UnixStream) -> Option<Peer> {
        let about = getsockopt(stream, PeerCredentials).ok()?;
        let mut groups = supplementary_groups(stream);
        groups.push(about.gid());
        Some(Peer { pid: about.pid(), uid: about.uid(), groups })
    }
}

/// The supplementary groups of the process at the other end; none when there are too many.
fn supplementary_groups(stream: &UnixStream) -> Vec<u32> {
    let mut groups = [0u32; GROUPS_MAX];
    let mut bytes = size_of_val(&groups) as libc::socklen_t;
    // SAFETY: the kernel writes at most `bytes` bytes into the array, which is as long as that, and
    // any bits are a value of its elements.
    let code = unsafe {
        libc::getsockopt(
            stream.as_raw_fd(),
            libc::SOL_SOCKET,
            libc::SO_PEERGROUPS,
            groups.as_mut_ptr().cast(),
            &mut bytes,
        )
    };
    let count = if code == 0 { bytes as usize / size_of::<u32>() } else { 0 };
    groups[..count.min(GROUPS_MAX)].to_vec()
}

/// Which users have which role.
#[derive(Clone, Debug)]
pub(crate) struct AccessPolicy {
    own: Uid,
    control: Option<Gid>,
    view: Option<Gid>,
}

impl AccessPolicy {
    /// The policy of a configuration; groups are looked up once.
    ///
    /// # Errors
    /// A group that the system does not have; the place is its key.
    pub(crate) fn new(config: &OperatorConfig) -> Result<AccessPolicy, Invalid> {
        let look_up = |place: &str, name: &Option<String>| match name {
            None => Ok(None),
            Some(name) => match Group::from_name(name) {
                Ok(Some(group)) => Ok(Some(group.gid)),
                Ok(None) => {
                    let remedy = format!("make it with `groupadd --system {name}`");
                    Err(Invalid::new(place, format!("there is no group `{name}`"), remedy))
                }
                Err(error) => {
                    let what = format!("group `{name}` cannot be looked up: {error}");
                    Err(Invalid::new(place, what, "name another group"))
                }
            },
        };
        Ok(AccessPolicy {
            own: nix::unistd::geteuid(),
            control: look_up("control_group", &config.control_group)?,
            view: look_up("view_group", &config.view_group)?,
        })
    }

    /// Whether groups decide, and not the mode of the socket's file.
    pub(crate) fn has_groups(&self) -> bool {
        self.control.is_some() || self.view.is_some()
    }

    /// The role of a process: root and the user of this process may command.
    pub(crate) fn role(&self, peer: &Peer) -> Role {
        let is_member = |gid: &Option<Gid>| gid.is_some_and(|g| peer.groups.contains(&g.as_raw()));
        if !self.has_groups() || peer.uid == 0 || peer.uid == self.own.as_raw() {
            return Role::Control;
        }
        if is_member(&self.control) {
            Role::Control
        } else if is_member(&self.view) {
            Role::View
        } else {
            Role::None
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_decide_where_they_are_named() {
        let policy = |control, view| AccessPolicy {
            own: Uid::from_raw(990),
            control: Option::map(control, Gid::from_raw),
            view: Option::map(view, Gid::from_raw),
        };
        let peer = |uid, groups: &[u32]| Peer { pid: 1, uid, groups: groups.to_vec() };
        let both = policy(Some(50), Some(60));
        for (uid, groups, role) in [
            (1000, &[1000, 50][..], Role::Control),
            (1000, &[1000, 60], Role::View),
            (1000, &[1000, 60, 50], Role::Control),
            (1000, &[1000], Role::None),
            (1000, &[], Role::None),
            (990, &[990], Role::Control),
            (0, &[0], Role::Control),
        ] {
            assert_eq!(both.role(&peer(uid, groups)), role, "{uid} {groups:?}");
        }
        assert_eq!(policy(None, Some(60)).role(&peer(1000, &[50])), Role::None);
        assert_eq!(policy(None, None).role(&peer(1000, &[1000])), Role::Control);
    }

    #[test]
    fn the_kernel_tells_who_is_connected() {
        let (here, _there) = UnixStream::pair().unwrap();
        let peer = Peer::of(&here).unwrap();
        assert_eq!(peer.pid.cast_unsigned(), std::process::id());
        assert_eq!(peer.uid, nix::unistd::getuid().as_raw());
        assert!(peer.groups.contains(&nix::unistd::getegid().as_raw()));
    }

    #[test]
    fn a_group_that_does_not_exist_is_refused_by_its_key() {
        let mut config = OperatorConfig::at("op".into());
        config.view_group = Some("no-such-group-here".into());
        let bad = AccessPolicy::new(&config).unwrap_err();
        assert_eq!(bad.place, "view_group");
        assert!(bad.what.contains("no-such-group-here"), "{bad:?}");
    }
}
