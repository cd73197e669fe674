//! Where the base of an arm stands in the frame in which tools and tables are placed. A place that
//! is not finite or far away is an error.

use glam::DVec3;
use taktil_mechanics::chain::Chain;
use taktil_rtcore::Invalid;

use super::ArmConfig;

/// Farthest place of an arm's base (mm).
const BASE_DISTANCE_MAX_MM: f64 = 1e5;
/// Largest turn of an arm's base (deg).
const BASE_YAW_MAX_DEG: f64 = 360.0;

/// Where the base stands (m) and its turn about the vertical (rad); `None` where the section says
/// nothing.
pub(super) fn base_place(config: &ArmConfig) -> Result<Option<(DVec3, f64)>, Invalid> {
    let (base_mm, yaw_deg) =
        (config.base_mm.unwrap_or_default(), config.base_yaw_deg.unwrap_or_default());
    for (i, mm) in base_mm.iter().enumerate() {
        if !(0.0..=BASE_DISTANCE_MAX_MM).contains(&mm.abs()) {
            let remedy = format!("give at most {BASE_DISTANCE_MAX_MM} mm either way");
            return Err(Invalid::new(format!("base_mm[{i}]"), format!("is {mm}"), remedy));
        }
    }
    if !(0.0..=BASE_YAW_MAX_DEG).contains(&yaw_deg.abs()) {
        let remedy = format!("give at most {BASE_YAW_MAX_DEG} degrees either way");
        return Err(Invalid::new("base_yaw_deg", format!("is {yaw_deg}"), remedy));
    }
    if config.base_mm.is_none() && config.base_yaw_deg.is_none() {
        return Ok(None);
    }
    Ok(Some((DVec3::from_array(base_mm) * 1e-3, yaw_deg.to_radians())))
}

/// The chain where its base stands.
pub(super) fn placed<const N: usize>(
    config: &ArmConfig,
    arm: &Chain<N>,
) -> Result<Chain<N>, Invalid> {
    let place = base_place(config)?;
    Ok(place.map_or(*arm, |(base_m, yaw_rad)| arm.standing_at(base_m, yaw_rad)))
}
