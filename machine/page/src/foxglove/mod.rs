//! Serves common viewers (Foxglove, Lichtblick) over their own WebSocket protocol,
//! `foxglove.websocket.v1`, beside the page and from the same values. Viewers watch: whatever they
//! say beyond subscriptions is refused, so that no viewer commands the machine.
//!
//! Robot, tactile images and bodies come in the well-known messages of the package `foxglove`,
//! every signal as an object in JSON. A viewer that is slow gets the newest values when it has
//! taken those before; nothing is queued for it.

mod channels;
mod client;
mod request;
mod source;

pub(crate) use client::ViewerClient;
pub(crate) use source::ViewSource;

use crate::assets::Asset;

/// The path of the WebSocket for viewers.
pub(crate) const VIEWER_PATH: &str = "/foxglove";
/// The names of the protocol that viewers offer; the first one that is offered is spoken. Both name
/// the messages that are used here, in the same encoding.
pub(crate) const VIEWER_SUBPROTOCOLS: [&str; 2] = ["foxglove.websocket.v1", "foxglove.sdk.v1"];
/// An arrangement of panels that viewers can import.
pub(crate) static LAYOUT: Asset = Asset {
    path: "/foxglove-layout.json",
    kind: "application/json; charset=utf-8",
    text: include_str!("../../assets/foxglove-layout.json"),
};
