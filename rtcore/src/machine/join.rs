//! Links between lanes: an input finds its cell, here or over there. Refuses to judge order; types
//! are judged where they are known.

use std::collections::BTreeMap;

use taktil_hal::{Invalid, Nanos};

use super::Home;
use super::complaint::{mismatch, unknown};
use crate::lane::Lane;
use crate::port::{Binding, Ports};
use crate::record::Catalog;
use crate::status::ModeStatus;
use crate::trace::Remote;

/// The cell in lane `reader` through which the signal at `home` is seen; links the lanes when they
/// differ.
pub(super) fn join(
    lanes: &mut [Lane],
    reader: usize,
    home: &Home,
    connect: fn(&mut dyn crate::port::AnyCell, usize) -> Option<Box<dyn crate::port::AnyCell>>,
    stall: Nanos,
) -> Option<usize> {
    if reader == home.lane {
        return Some(home.cell);
    }
    let (from, to) = (&lanes[home.lane].spec, &lanes[reader].spec);
    let in_flight = (to.period + from.delivery + stall).0 / from.period.0 + 2;
    let capacity = usize::try_from(in_flight).ok()?;
    let cell = connect(lanes[home.lane].cells[home.cell].as_mut(), capacity)?;
    let remote = Remote::new(lanes[reader].cells.len(), &lanes[home.lane].spec);
    let lane = &mut lanes[reader];
    lane.cells.push(cell);
    lane.trace.remote.push(remote);
    Some(lane.cells.len() - 1)
}

/// Gives every lane the mode.
pub(super) fn bind_mode(
    lanes: &mut [Lane],
    signal: &str,
    homes: &BTreeMap<String, Home>,
    catalog: &Catalog,
    stall: Nanos,
) -> Result<(), Invalid> {
    for index in 0..lanes.len() {
        let mut ports = Ports::new(lanes[index].inputs.len(), 0);
        let input = ports.input::<ModeStatus>("mode");
        let declaration = &ports.inputs[0];
        let home =
            homes.get(signal).ok_or_else(|| unknown("mode", signal, declaration, catalog))?;
        let cell = (declaration.type_id == home.type_id)
            .then(|| join(lanes, index, home, declaration.connect, stall))
            .flatten()
            .ok_or_else(|| mismatch("mode", signal, declaration, home))?;
        lanes[index].inputs.push(Binding { cell, seen: 0, stale_after: Nanos::MAX });
        lanes[index].mode = Some(input);
    }
    Ok(())
}
