//! HostMot2 cards behind UDP: addresses that are named, or the two that a card has as delivered
//! where this host has an address in their network. A card is asked what it is, and nothing is
//! written to it but the number of the question.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::Path;

use serde_json::Value;
use taktil_drivers_mesa::Board;
use taktil_hal::Nanos;
use taktil_machine_console::option::BadOption;

use super::{Found, Group};

/// The port at which a card listens.
const CARD_PORT: u16 = 27_181;
/// The addresses of a card as delivered, by its jumpers.
const DELIVERED_ADDRESSES: [Ipv4Addr; 2] =
    [Ipv4Addr::new(10, 10, 10, 10), Ipv4Addr::new(192, 168, 1, 121)];

/// Whom to ask, and how long.
pub(super) struct Question {
    /// Addresses of the user; the delivered ones when there are none.
    pub(super) named: Vec<SocketAddr>,
    /// Wait for each answer.
    pub(super) wait: Nanos,
    /// The tree is a recorded one: nobody is asked.
    pub(super) is_recorded: bool,
}

/// The addresses that these texts name.
pub(super) fn addresses(texts: &[String]) -> Result<Vec<SocketAddr>, BadOption> {
    let address = |text: &String| {
        let whole = text.parse::<SocketAddr>();
        let found = whole.or_else(|_| text.parse::<IpAddr>().map(|ip| (ip, CARD_PORT).into()));
        let remedy = "give one such as 10.10.10.10 or 127.0.0.1:27181";
        let found = found.map_err(|_| BadOption(format!("--udp {text}: no address; {remedy}")))?;
        let is_many = found.ip().is_multicast() || found.ip() == Ipv4Addr::BROADCAST;
        if is_many || found.ip().is_unspecified() {
            let text = format!("--udp {text}: is no address of one card; {remedy}");
            return Err(BadOption(text));
        }
        Ok(found)
    };
    texts.iter().map(address).collect()
}

/// The cards that answer.
pub(super) fn cards(root: &Path, question: &Question) -> Group {
    let mut group = Group {
        key: "udp_cards",
        title: "HostMot2 cards over UDP (driver \"mesa\")",
        ..Group::default()
    };
    if question.is_recorded {
        group.not_seen.push("cards are not asked on behalf of a recorded tree".to_owned());
        return group;
    }
    let mut asked = question.named.clone();
    if asked.is_empty() {
        let networks = own_networks(&root.join("proc/net/route"));
        for address in DELIVERED_ADDRESSES {
            if networks.iter().any(|network| network.holds(address)) {
                asked.push((address, CARD_PORT).into());
            } else {
                group.not_seen.push(format!(
                    "{address} was not asked: this host has no address in its network; add --udp \
                     {address} to ask nevertheless"
                ));
            }
        }
    }
    for address in asked {
        match Board::identify(&address.to_string(), question.wait) {
            Ok(identity) => {
                let mut found = Found::new(address.to_string());
                found.add("board", identity.board);
                found.add_some("card", (!identity.card.is_empty()).then_some(identity.card));
                let modules: Vec<Value> = identity.modules.into_iter().map(Value::from).collect();
                found.add("modules", modules);
                found.add("pins", identity.pins);
                group.found.push(found);
            }
            Err(bad) => group.not_seen.push(format!("{address}: {}", bad.into_invalid().what)),
        }
    }
    group
}

/// A network that this host is in.
struct Network {
    destination: u32,
    mask: u32,
}

impl Network {
    fn holds(&self, address: Ipv4Addr) -> bool {
        u32::from(address) & self.mask == self.destination & self.mask
    }
}

/// The networks that need no gateway, by the kernel's table of routes.
fn own_networks(table: &Path) -> Vec<Network> {
    let text = std::fs::read_to_string(table).unwrap_or_default();
    let network = |line: &str| {
        let words: Vec<&str> = line.split_whitespace().collect();
        // The kernel prints the bytes of an address as one number of this host.
        let number = |at: usize| {
            let number = u32::from_str_radix(words.get(at)?, 16).ok()?;
            Some(u32::from(Ipv4Addr::from(number.to_ne_bytes())))
        };
        let (destination, gateway, mask) = (number(1)?, number(2)?, number(7)?);
        (gateway == 0 && mask != 0).then_some(Network { destination, mask })
    };
    text.lines().skip(1).filter_map(network).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_have_the_port_of_cards_and_name_one_card() {
        let one = |text: &str| addresses(&[text.to_owned()]);
        assert_eq!(one("10.10.10.10").unwrap()[0].to_string(), "10.10.10.10:27181");
        assert_eq!(one("127.0.0.1:5").unwrap()[0].to_string(), "127.0.0.1:5");
        for bad in ["255.255.255.255", "224.0.0.1", "0.0.0.0", "card", "1.2.3.4:x"] {
            assert!(one(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn a_network_of_this_host_is_one_without_a_gateway() {
        let path = std::env::temp_dir().join(format!("taktil-route-{}", std::process::id()));
        let of = |ip: [u8; 4]| format!("{:08X}", u32::from_ne_bytes(ip));
        let (any, net, mask) = (of([0; 4]), of([10, 10, 10, 0]), of([255, 255, 255, 0]));
        let gateway = of([10, 10, 10, 1]);
        let text = format!(
            "Iface Destination Gateway Flags RefCnt Use Metric Mask\neth0 {any} {gateway} 3 0 0 0 \
             {any}\neth0 {net} {any} 1 0 0 0 {mask}\n"
        );
        std::fs::write(&path, text).unwrap();
        let networks = own_networks(&path);
        std::fs::remove_file(&path).unwrap();
        assert_eq!(networks.len(), 1);
        assert!(networks[0].holds(DELIVERED_ADDRESSES[0]));
        assert!(!networks[0].holds(DELIVERED_ADDRESSES[1]));
    }
}
