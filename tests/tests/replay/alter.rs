//! Writes logs again with something changed, checksums included.

use std::collections::BTreeMap;
use std::path::Path;

use taktil_lab_scene::scene::Scene;
use taktil_record::{Log, METADATA_RUN, McapLog};
use taktil_rtcore::Nanos;
use taktil_rtcore::record::{Catalog, Observer, Record};
use taktil_tests::bench::{SceneDraft, machine};

/// Metadata of a log.
pub(crate) type Altered = BTreeMap<String, String>;

/// The signals of the rolling experiment.
pub(crate) fn catalog() -> Catalog {
    let scene: Scene = SceneDraft::roll_pin().scene();
    machine(&scene, 1).catalog().clone()
}

/// Writes `from` again to `to`; `change` sees every message as signal, tick and body, and says
/// whether it stays.
pub(crate) fn rewrite(
    from: &Path,
    to: &Path,
    about: Option<Altered>,
    change: impl FnMut(&str, u64, &mut [u8]) -> bool,
) {
    rewrite_as(&catalog(), from, to, about, change);
}

/// The same for a log of other signals.
pub(crate) fn rewrite_as(
    catalog: &Catalog,
    from: &Path,
    to: &Path,
    about: Option<Altered>,
    mut change: impl FnMut(&str, u64, &mut [u8]) -> bool,
) {
    let log = Log::open(from).unwrap();
    let about = about.unwrap_or_else(|| log.metadata()[METADATA_RUN].clone());
    let mut out = McapLog::create(to, catalog, &about).unwrap();
    for message in log.messages() {
        let name = &log.channels()[message.channel].signal;
        let signal = catalog.find(name).unwrap();
        let mut body = message.body[..catalog.signals[signal].size].to_vec();
        if change(name, message.tick, &mut body) {
            let release = Nanos(message.release_ns);
            out.record(&Record { signal, tick: message.tick, release, body: &body });
        }
    }
    out.finish().unwrap();
}
