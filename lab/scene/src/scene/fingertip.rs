//! The simulated fingertip of an arm that carries one by its machine file: what the scene does not
//! say of array and rubber is as the laws of the machine take it to be. An arm without one has
//! nothing to touch.

use taktil_machine::config::MachineConfig;
use taktil_machine::robot::ArmConfig;
use taktil_machine::source::Source;
use taktil_rtcore::Invalid;
use taktil_sim::scene::WorldConfig;

/// Puts array and rubber of the machine's laws in the place of what the scene leaves out; nothing
/// where the machine file does not say that the arm carries a fingertip.
pub(super) fn set_defaults(world: &mut WorldConfig, machine: &MachineConfig, scene: &Source) {
    if machine.arm.as_ref().is_none_or(|arm| arm.fingertip.is_none()) {
        return;
    }
    let servo = machine.tactile_servo.clone().unwrap_or_default();
    let keys = ["rows", "cols", "pitch_x_mm", "pitch_y_mm"];
    if keys.iter().all(|key| !scene.contains(&format!("world.tactile.{key}"))) {
        let tactile = &mut world.tactile;
        (tactile.rows, tactile.cols) = (servo.array.rows, servo.array.cols);
        (tactile.pitch_x_mm, tactile.pitch_y_mm) = (servo.array.pitch_x_mm, servo.array.pitch_y_mm);
    }
    if !scene.contains("world.finger.rubber") {
        let (rubber, model) = (&mut world.finger.rubber, &servo.model);
        rubber.thickness_mm = model.pad_thickness_mm;
        rubber.youngs_mpa = model.pad_mpa;
        rubber.poisson = model.pad_poisson;
    }
}

/// Whether the arm can feel what stands in the world.
///
/// # Errors
/// A pin or an object beside an arm without a fingertip, which would pass through them.
pub(super) fn check(world: &WorldConfig, machine: &MachineConfig) -> Result<(), Invalid> {
    let feels = |arm: &ArmConfig| arm.fingertip.is_some() || !arm.tips.is_empty();
    if machine.arm.as_ref().is_none_or(feels) {
        return Ok(());
    }
    let key = match (world.pin.present, world.object.is_empty()) {
        (true, _) => "world.pin.present",
        (false, false) => "world.object",
        (false, true) => return Ok(()),
    };
    let what = "puts something on the table, and this arm carries no fingertip to feel it with";
    let remedy = "leave it out, or say in [arm.fingertip] where on the arm the fingertip is";
    Err(Invalid::new(key, what, remedy))
}
