//! The page beside a simulated run: `--page` serves it, and a run that ends by itself begins when
//! the first browser has come.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use serde_json::{Value, json};
use taktil_lab_scene::scene::Scene;
use taktil_machine_console::option::BadOption;
use taktil_machine_console::out;
use taktil_machine_page::{PageConfig, PageServer};
use taktil_sim::scene::{ObjectConfig, ObjectKind};

/// How long one wait for a browser lasts before the request to end is looked at.
const WAIT_STEP: Duration = Duration::from_millis(100);
/// Port that stands for any.
pub(super) const PORT_ANY: u16 = 0;

/// The socket of a run with a page and without an operator's socket of its own.
pub(super) fn run_socket() -> PathBuf {
    let folder = std::env::var_os("XDG_RUNTIME_DIR").map(PathBuf::from);
    let folder = folder.filter(|folder| folder.is_dir()).unwrap_or_else(std::env::temp_dir);
    folder.join(format!("taktil-run-{}.sock", std::process::id()))
}

/// Serves the page of the machine behind `socket` on the loopback, where a port is given.
///
/// # Errors
/// A port that cannot be had, a token file that cannot be made.
pub(super) fn start(
    port: Option<u16>,
    socket: Option<&Path>,
) -> anyhow::Result<Option<PageServer>> {
    let Some((port, socket)) = port.zip(socket) else { return Ok(None) };
    let mut config = PageConfig::for_socket(socket);
    config.port = (port != PORT_ANY).then_some(port);
    let server = PageServer::start(&config)
        .map_err(|bad| BadOption(format!("{}: {}; {}", bad.place, bad.what, bad.remedy)))?;
    out::warn(format_args!("the page is at {}", server.url()));
    out::warn(format_args!(
        "to command from it, give it the token in {}",
        server.token_path().display()
    ));
    Ok(Some(server))
}

/// Waits for the first browser, where there is a page; a signal ends the wait.
pub(super) fn wait_for_browser(server: Option<&mut PageServer>, stop: &AtomicBool) {
    let Some(server) = server else { return };
    out::warn("the run begins when the page is opened");
    // A signal sets the flag; nothing else depends on it.
    while !stop.load(Ordering::SeqCst) && !server.wait_for_page(WAIT_STEP) {}
}

/// What is simulated around the arm, for the page to draw: sizes and places (m, rad).
pub(super) fn surroundings(scene: &Scene) -> Value {
    let world = &scene.world;
    if !scene.has_contact() {
        return Value::Null;
    }
    let table = &world.table;
    let pivot_mm = (table.pivot_x_mm + table.slide_mm, table.pivot_y_mm);
    let start_rad: Vec<f64> = scene.start_deg.iter().map(|angle| angle.to_radians()).collect();
    let finger_mm = scene.robot.tool_pose(&start_rad).map(|pose| 1e3 * pose.translation);
    let finger_mm = finger_mm.unwrap_or_default();
    let object = |object: &ObjectConfig| {
        json!({
            "kind": match object.kind {
                ObjectKind::Sphere => "sphere",
                ObjectKind::Edge => "edge",
                ObjectKind::Bar => "bar",
            },
            "x_m": 1e-3 * (finger_mm.x + object.x_mm - pivot_mm.0),
            "y_m": 1e-3 * (finger_mm.y + object.y_mm - pivot_mm.1),
            "top_m": 1e-3 * object.top_mm,
            "yaw_rad": object.yaw_deg.to_radians(),
            "radius_m": 1e-3 * object.radius(),
            "length_m": 1e-3 * object.length(),
            "width_m": 1e-3 * object.width_mm.unwrap_or(4.0),
        })
    };
    let pin = world.pin.present.then(|| {
        json!({ "radius_m": 1e-3 * world.pin.radius_mm, "length_m": 1e-3 * world.pin.length_mm })
    });
    json!({
        "table": {
            "x_m": 1e-3 * pivot_mm.0,
            "y_m": 1e-3 * pivot_mm.1,
            "z_m": 1e-3 * world.table_height_mm(),
        },
        "pin": pin,
        "objects": world.object.iter().map(object).collect::<Value>(),
    })
}
