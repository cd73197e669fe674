//! What a viewer says: which channels it wants under which numbers. Everything else that the
//! protocol knows would need a capability that this server does not offer.

use serde_json::Value;

/// Subscriptions that one viewer may have.
pub(super) const SUBSCRIPTIONS_MAX: usize = 64;

/// A wish of a viewer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum ViewerRequest {
    /// It wants channels; pairs of its own number and that of the channel.
    Subscribe(Vec<Subscription>),
    /// It wants these numbers no longer.
    Unsubscribe(Vec<u32>),
}

/// A channel that a viewer wants under a number of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Subscription {
    /// The viewer's number, which stands in front of each message.
    pub(super) id: u32,
    /// The number of the channel.
    pub(super) channel: u32,
}

fn number(value: &Value) -> Option<u32> {
    value.as_u64().and_then(|number| u32::try_from(number).ok())
}

/// Reads a message.
///
/// # Errors
/// What is wrong with it, as a sentence for people.
pub(super) fn read(text: &str) -> Result<ViewerRequest, &'static str> {
    let Ok(message) = serde_json::from_str::<Value>(text) else {
        return Err("a message is a JSON object");
    };
    let list = |key: &str| message[key].as_array().filter(|all| all.len() <= SUBSCRIPTIONS_MAX);
    match message["op"].as_str() {
        Some("subscribe") => {
            let pair = |one: &Value| {
                Some(Subscription { id: number(&one["id"])?, channel: number(&one["channelId"])? })
            };
            let pairs = list("subscriptions").and_then(|all| all.iter().map(pair).collect());
            pairs.map(ViewerRequest::Subscribe).ok_or("`subscriptions` is a list of at most 64")
        }
        Some("unsubscribe") => {
            let all = list("subscriptionIds").and_then(|all| all.iter().map(number).collect());
            all.map(ViewerRequest::Unsubscribe).ok_or("`subscriptionIds` is a list of at most 64")
        }
        Some(_) => Err("viewers watch here; only subscribe and unsubscribe are served"),
        None => Err("a message has `op`"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn subscriptions_are_read_and_anything_else_is_refused_with_a_reason() {
        let wanted = "{\"op\":\"subscribe\",\"subscriptions\":[{\"id\":0,\"channelId\":3}]}";
        let pair = Subscription { id: 0, channel: 3 };
        assert_eq!(read(wanted), Ok(ViewerRequest::Subscribe(vec![pair])));
        let given_up = "{\"op\":\"unsubscribe\",\"subscriptionIds\":[0,7]}";
        assert_eq!(read(given_up), Ok(ViewerRequest::Unsubscribe(vec![0, 7])));
        let many = vec!["1"; SUBSCRIPTIONS_MAX + 1].join(",");
        for bad in [
            "",
            "[]",
            "7",
            "{}",
            "{\"op\":7}",
            "{\"op\":\"subscribe\"}",
            "{\"op\":\"subscribe\",\"subscriptions\":[{\"id\":0}]}",
            "{\"op\":\"subscribe\",\"subscriptions\":[{\"id\":-1,\"channelId\":3}]}",
            "{\"op\":\"subscribe\",\"subscriptions\":[{\"id\":4294967296,\"channelId\":3}]}",
            "{\"op\":\"unsubscribe\",\"subscriptionIds\":[1.5]}",
            "{\"op\":\"setParameters\",\"parameters\":[]}",
            "{\"op\":\"advertise\",\"channels\":[]}",
            &format!("{{\"op\":\"unsubscribe\",\"subscriptionIds\":[{many}]}}"),
        ] {
            assert!(read(bad).is_err_and(|why| !why.is_empty()), "{bad}");
        }
    }
}
