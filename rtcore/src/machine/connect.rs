//! Connects inputs to their cells, in the same lane or through a link between two lanes.

use std::collections::BTreeMap;

use taktil_hal::{Invalid, Nanos};

use super::diagnostics::{mismatch, unknown};
use super::draft::SignalOrigin;
use crate::lane::Lane;
use crate::port::{Binding, Ports};
use crate::record::Catalog;
use crate::status::{ModeStatus, PaceStatus};
use crate::trace::RemoteInput;

/// The cell in lane `reader` through which the signal at `origin` is seen; links the lanes when
/// they differ.
pub(super) fn connect(
    lanes: &mut [Lane],
    reader: usize,
    origin: &SignalOrigin,
    connect: fn(&mut dyn crate::port::AnyCell, usize) -> Option<Box<dyn crate::port::AnyCell>>,
    stall: Nanos,
) -> Option<usize> {
    if reader == origin.lane {
        return Some(origin.cell);
    }
    let (from, to) = (&lanes[origin.lane].plan.spec, &lanes[reader].plan.spec);
    let in_flight = (to.period + from.delivery + stall).0 / from.period.0 + 2;
    let capacity = usize::try_from(in_flight).ok()?;
    let cell = connect(lanes[origin.lane].ports.cells[origin.cell].as_mut(), capacity)?;
    let remote = RemoteInput::new(lanes[reader].ports.cells.len(), &lanes[origin.lane].plan.spec);
    let lane = &mut lanes[reader];
    lane.ports.cells.push(cell);
    lane.ports.trace.remote.push(remote);
    Some(lane.ports.cells.len() - 1)
}

/// Gives every lane the mode.
pub(super) fn bind_mode(
    lanes: &mut [Lane],
    signal: &str,
    origins: &BTreeMap<String, SignalOrigin>,
    catalog: &Catalog,
    stall: Nanos,
) -> Result<(), Invalid> {
    for index in 0..lanes.len() {
        let mut ports = Ports::new(lanes[index].ports.inputs.len(), 0);
        let input = ports.input::<ModeStatus>("mode");
        let declaration = &ports.inputs[0];
        let origin =
            origins.get(signal).ok_or_else(|| unknown("mode", signal, declaration, catalog))?;
        let cell = (declaration.type_id == origin.type_id)
            .then(|| connect(lanes, index, origin, declaration.connect, stall))
            .flatten()
            .ok_or_else(|| mismatch("mode", signal, declaration, origin))?;
        lanes[index].ports.inputs.push(Binding { cell, seen: 0, stale_after: Nanos::MAX });
        lanes[index].ports.mode = Some(input);
    }
    Ok(())
}

/// Lets the lane that writes the pace read it after each of its jobs.
pub(super) fn bind_pace(
    lanes: &mut [Lane],
    signal: &str,
    origins: &BTreeMap<String, SignalOrigin>,
    catalog: &Catalog,
    stall: Nanos,
) -> Result<(), Invalid> {
    let place = "pace";
    let index = origins.get(signal).map_or(0, |origin| origin.lane);
    let mut ports = Ports::new(lanes[index].ports.inputs.len(), 0);
    let input = ports.input::<PaceStatus>(place);
    let declaration = &ports.inputs[0];
    let origin = origins.get(signal).ok_or_else(|| unknown(place, signal, declaration, catalog))?;
    let cell = (declaration.type_id == origin.type_id)
        .then(|| connect(lanes, index, origin, declaration.connect, stall))
        .flatten()
        .ok_or_else(|| mismatch(place, signal, declaration, origin))?;
    lanes[index].ports.inputs.push(Binding { cell, seen: 0, stale_after: Nanos::MAX });
    lanes[index].ports.pace = Some(input);
    Ok(())
}
