//! Draws of a body that slides over the pad: which body, how hard it is pressed, where, when and
//! which way it goes. A draw depends on its speed and number only.

use taktil_hal::fault::SplitMix;
use taktil_lab_scene::scene::Scene;
use taktil_rtcore::Nanos;
use taktil_sim::scene::{Axis, Motion, ObjectConfig, ObjectKind};

/// The slip begins at an instant of this second (s): pressing has settled by then.
const ONSET_S: (f64, f64) = (3.5, 3.6);
/// The body slides this far at most, and this long (mm, s).
const WAY_MAX_MM: f64 = 5.0;
const SLIDING_MAX_S: f64 = 0.6;
/// The run goes on for this time after it (s).
const REST_S: f64 = 0.1;

/// What was drawn.
#[derive(Clone, Debug)]
pub(crate) struct SlidingDraw {
    pub(crate) speed_mm_s: f64,
    pub(crate) number: u64,
    pub(crate) seed: u64,
    /// When the table begins to move.
    pub(crate) from: Nanos,
    /// What it was, on a line.
    pub(crate) about: String,
}

/// The scene of a draw.
pub(crate) fn sliding_draw(base: &Scene, speed_mm_s: f64, number: u64) -> (Scene, SlidingDraw) {
    let mut draw = SplitMix::new(number.wrapping_mul(0x1234_5678_9ABC_DEF1) ^ speed_mm_s.to_bits());
    let mut scene = base.clone();
    let kind =
        [ObjectKind::Sphere, ObjectKind::Edge, ObjectKind::Bar][(draw.unit() * 3.0) as usize];
    let mut object = ObjectConfig::of(kind);
    let size_mm = match kind {
        ObjectKind::Sphere => draw.uniform(10.0, 25.0),
        ObjectKind::Edge => draw.uniform(2.0, 5.0),
        ObjectKind::Bar => draw.uniform(3.0, 6.0),
    };
    match kind {
        ObjectKind::Sphere => object.radius_mm = Some(size_mm),
        ObjectKind::Edge => (object.radius_mm, object.length_mm) = (Some(size_mm), Some(160.0)),
        ObjectKind::Bar => object.width_mm = Some(size_mm),
    }
    // An edge that turns would lift its ends off a pad that does not.
    let yaw_deg = draw.uniform(-20.0, 20.0);
    object.yaw_deg = yaw_deg;
    // Slippery: else the arm gives way and goes along, and the body slides at another speed.
    let friction = draw.uniform(0.005, 0.02);
    object.friction = Some(friction);
    (object.x_mm, object.y_mm) = (draw.uniform(-2.0, 2.0), draw.uniform(-2.0, 2.0));
    let load_counts = draw.uniform(12_000.0, 18_000.0).round();
    let from_s = draw.uniform(ONSET_S.0, ONSET_S.1);
    let way = if draw.unit() < 0.5 { 1.0 } else { -1.0 };
    let to_s = from_s + (WAY_MAX_MM / speed_mm_s).min(SLIDING_MAX_S);
    let seed = 1 + (draw.unit() * 1e6) as u64;
    scene.world.object = vec![object];
    scene.world.table.motion = vec![Motion::ramp(Axis::Slide, way * speed_mm_s, from_s, to_s)];
    scene.machine.tactile_servo.get_or_insert_default().m0_counts = load_counts;
    scene.duration = Nanos(((to_s + REST_S) * 1e9) as i64);
    let about = format!(
        "{kind:?} of {size_mm:.1} mm, yaw {yaw_deg:.0} deg, friction {friction:.3}, \
         {load_counts:.0} counts, {}",
        if way > 0.0 { "forwards" } else { "backwards" }
    );
    let from = Nanos((from_s * 1e9) as i64);
    (scene, SlidingDraw { speed_mm_s, number, seed, from, about })
}
