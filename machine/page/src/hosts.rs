//! Under which names a browser may ask for the page. A name of somebody else that leads here is
//! how a foreign page would reach a server on the loopback (DNS rebinding).

use std::net::SocketAddr;

/// The values of `Host` that are served, and with `http://` before them those of `Origin`.
#[derive(Clone, Debug)]
pub struct AllowedHosts(Vec<String>);

impl AllowedHosts {
    /// The names of a server at this address: the address itself, and `localhost` on the loopback.
    #[must_use]
    pub fn new(address: SocketAddr) -> AllowedHosts {
        let mut hosts = vec![address.to_string()];
        if address.ip().is_loopback() {
            hosts.push(format!("localhost:{}", address.port()));
        }
        AllowedHosts(hosts)
    }

    /// Whether a `Host` names this server.
    #[must_use]
    pub fn allows_host(&self, host: &str) -> bool {
        self.0.iter().any(|allowed| allowed.eq_ignore_ascii_case(host))
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
