//! Under which names a browser may ask for the page. A name of somebody else that leads here is
//! how a foreign page would reach a server on the loopback (DNS rebinding).

use std::net::SocketAddr;

/// The origin of a program that shows pages of its own files, as viewers for the desktop do.
const FILE_ORIGIN: &str = "file://";

/// The values of `Host` that are served, and with `http://` before them those of `Origin`.
#[derive(Clone, Debug)]
pub struct AllowedHosts {
    hosts: Vec<String>,
    /// Origins of viewers beside pages; `None` where viewers are not served.
    viewer_origins: Option<Vec<String>>,
}

impl AllowedHosts {
    /// The names of a server at this address: the address itself, and `localhost` on the loopback.
    #[must_use]
    pub fn new(address: SocketAddr) -> AllowedHosts {
        let mut hosts = vec![address.to_string()];
        if address.ip().is_loopback() {
            hosts.push(format!("localhost:{}", address.port()));
        }
        AllowedHosts { hosts, viewer_origins: None }
    }

    /// Serves viewers too, from these origins beside those that no browser's page can have.
    #[must_use]
    pub fn with_viewers(self, origins: Vec<String>) -> AllowedHosts {
        AllowedHosts { viewer_origins: Some(origins), ..self }
    }

    /// Whether viewers are served.
    #[must_use]
    pub fn has_viewers(&self) -> bool {
        self.viewer_origins.is_some()
    }

    /// Whether a viewer of this `Origin` may watch: a program, which sends none, a page from this
    /// computer's own files, a page of this server, or one that was named.
    #[must_use]
    pub fn allows_viewer(&self, origin: Option<&str>) -> bool {
        let Some(named) = &self.viewer_origins else { return false };
        origin.is_none_or(|origin| {
            origin == FILE_ORIGIN
                || self.allows_origin(origin)
                || named.iter().any(|one| one.eq_ignore_ascii_case(origin))
        })
    }

    /// Whether a `Host` names this server.
    #[must_use]
    pub fn allows_host(&self, host: &str) -> bool {
        self.hosts.iter().any(|allowed| allowed.eq_ignore_ascii_case(host))
    }

    /// Whether an `Origin` is a page of this server.
    #[must_use]
    pub fn allows_origin(&self, origin: &str) -> bool {
        origin.strip_prefix("http://").is_some_and(|host| self.allows_host(host))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn viewers_are_programs_own_files_or_named_and_only_where_they_are_served() {
        let hosts = AllowedHosts::new("127.0.0.1:8260".parse().unwrap());
        assert!(!hosts.has_viewers() && !hosts.allows_viewer(None));
        let named = format!("https://{}", "viewer.test");
        let hosts = hosts.with_viewers(vec![named.clone()]);
        assert!(hosts.has_viewers());
        for origin in [None, Some("file://"), Some(&*named)] {
            assert!(hosts.allows_viewer(origin), "{origin:?}");
        }
        let other = format!("https://{}", "other.test");
        for origin in ["null", "", &other, "file:///x"] {
            assert!(!hosts.allows_viewer(Some(origin)), "{origin}");
        }
    }

    #[test]
    fn only_the_address_itself_and_localhost_name_the_server() {
        let hosts = AllowedHosts::new("127.0.0.1:8260".parse().unwrap());
        assert!(hosts.allows_host("127.0.0.1:8260") && hosts.allows_host("LOCALHOST:8260"));
        assert!(hosts.allows_origin(&format!("http://{}", "localhost:8260")));
        for foreign in ["", "127.0.0.1", "localhost", "evil.test:8260", "127.0.0.1:8261", "null"] {
            assert!(!hosts.allows_host(foreign), "{foreign}");
            assert!(!hosts.allows_origin(&format!("http://{foreign}")), "{foreign}");
        }
        for foreign in ["https://127.0.0.1:8260", "http://127.0.0.1:8260/", "127.0.0.1:8260"] {
            assert!(!hosts.allows_origin(foreign), "{foreign}");
        }
        let named = AllowedHosts::new("192.0.2.7:80".parse().unwrap());
        assert!(named.allows_host("192.0.2.7:80") && !named.allows_host("localhost:80"));
    }
}
