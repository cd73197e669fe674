//! Takes the faults of a plan out of `[[world.fault]]`: those that befall what is outside the
//! bench.

use taktil_hal::fault::FaultPlan;
use taktil_rtcore::Invalid;
use taktil_sim::scene::WorldConfig;

/// The faults of a bench that befall what is outside it.
pub(super) fn planned(world: &WorldConfig) -> Result<FaultPlan, Invalid> {
    let planned = |(index, fault): (usize, &taktil_sim::scene::Fault)| {
        let place = || format!("world.fault[{index}]");
        fault.planned().map_err(|bad| bad.within(&place())).transpose()
    };
    let faults: Result<Vec<_>, Invalid> =
        world.fault.iter().enumerate().filter_map(planned).collect();
    faults.map(FaultPlan::new)
}
