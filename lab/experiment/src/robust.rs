//! `taktil experiment robust`: the rolling scene with random values of everything that a user may
//! change without telling the controller. The worst draws are listed with the commands that repeat
//! them.

use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use taktil_machine_console::out;
use taktil_sim::scene::{Defect, DefectKind, Electronics, Fault, FaultKind, ScanStamp};

use super::evaluation::Evaluation;
use super::run_table::{RunRow, RunTable};
use super::{evaluated_run, laws_by_name, run_parallel, with_law};
use taktil_hal::fault::SplitMix;
use taktil_lab_plot::axis::format_number;
use taktil_lab_scene::scene::Scene;
use taktil_lab_scene::score::Spread;
use taktil_machine_console::option::BadOption;

/// Largest number of draws in one call.
const DRAWS_MAX: u64 = 10_000;
/// Rows and columns of the array.
const ARRAY_ROWS: u16 = 16;

/// Options of `taktil experiment robust`.
#[derive(Args, Debug)]
pub struct RobustOptions {
    /// The law
    #[arg(long, default_value = "model")]
    law: String,
    /// Draws 1 to N, each from its own seed
    #[arg(long, default_value_t = 20, value_name = "N")]
    draws: u64,
    /// Only this draw, told in full
    #[arg(long, value_name = "K")]
    draw: Option<u64>,
    /// Scene that is changed
    #[arg(long, default_value = "sim/scenes/roll-pin.toml", value_name = "FILE")]
    scene: PathBuf,
    /// Every run as a table with commas; what was drawn stands in place of the scene
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Threads; one a processor when absent
    #[arg(long, value_name = "N")]
    threads: Option<NonZeroUsize>,
}

/// Disables a row of the array, with or without the machine's knowledge, and returns a description.
fn kill_row(scene: &mut Scene, row: u16, known: bool) -> String {
    scene.world.tactile.defect.push(Defect {
        kind: DefectKind::Dead,
        row: Some(u32::from(row)),
        column: None,
        counts: 0,
        period_s: 0.1,
        from_s: 0.0,
    });
    if known {
        let scan = scene.machine.tactile_scan.get_or_insert_default();
        scan.dead_tactels = (1..=ARRAY_ROWS).map(|col| [row + 1, col]).collect();
    }
    format!(", row {} dead{}", row + 1, if known { " and known to be" } else { "" })
}

/// The scene of a draw, and a description of it.
fn random_scene(base: &Scene, number: u64) -> (Scene, String) {
    let mut draw = SplitMix::new(number.wrapping_mul(0x1234_5678_9ABC_DEF1));
    let mut scene = base.clone();
    let world = &mut scene.world;
    let radius = draw.uniform(15.0, 35.0);
    let (pad, bed) = (draw.uniform(0.5, 1.5), draw.uniform(0.5, 1.5));
    let (finger, table) = (draw.uniform(0.3, 1.2), draw.uniform(0.3, 1.2));
    let mass = draw.uniform(0.8, 1.2);
    let yaw = draw.uniform(-4.0, 4.0);
    let tilt = draw.uniform(-3.0, 3.0);
    let row = (draw.unit() * f64::from(ARRAY_ROWS)) as u16;
    let dead = draw.unit();
    let [spread, lossy, late] = [0.5, 0.25, 0.25].map(|share| draw.unit() < share);
    let links: [f64; 6] = core::array::from_fn(|_| draw.uniform(0.8, 1.2));
    let payload = draw.uniform(0.8, 1.2);
    let hidden = draw.unit() < 0.5;
    world.pin.radius_mm = radius;
    world.finger.rubber.youngs_mpa *= pad;
    world.table.rubber.youngs_mpa *= bed;
    world.finger.friction = finger;
    world.table.friction = table;
    world.pin.mass_kg *= mass;
    world.arm.link_mass_scale = links;
    world.arm.tool_mass_scale = payload;
    world.pin.yaw_deg = yaw;
    world.table.tilt_x_deg = tilt;
    let links = links.map(|scale| format!("{scale:.2}")).join(" ");
    let mut about = format!(
        "radius {radius:.1} mm, pad x {pad:.2}, bed x {bed:.2}, friction {finger:.2} and \
         {table:.2}, mass x {mass:.2}, links x {links}, payload x {payload:.2}, yaw {yaw:.1} deg, \
         tilt {tilt:.1} deg"
    );
    if spread {
        // Only the gains vary: a power law would shift every force by a tenth, independent of the
        // control law.
        world.tactile.electronics = Electronics::Response;
        (world.tactile.exponent, world.tactile.threshold_n) = (1.0, 0.0);
        about += ", gains spread by 6 %";
    }
    if lossy {
        let lost = Fault { fraction: Some(0.1), ..Fault::at(FaultKind::DropFrames, 1.0) };
        world.fault.push(lost);
        about += ", a tenth of the frames lost";
    }
    if dead < 0.25 {
        // The machine knows half of the dead rows.
        about += &kill_row(&mut scene, row, dead < 0.125);
    }
    if late {
        scene.world.tactile.delay_scans = 1;
        about += ", images a frame late";
        if hidden {
            scene.world.tactile.stamp = ScanStamp::Delivered;
            about += " and not saying so";
        }
    }
    (scene, about)
}

fn is_within_bounds(verdict: &Evaluation) -> bool {
    verdict.figures.faults.is_empty()
        && verdict.figures.contact_lost == 0
        && verdict.settling_s.is_some()
}

/// Runs the draws and prints the result.
///
/// # Errors
/// Invalid input as [`BadOption`], or a located error of the scene.
pub fn run(options: &RobustOptions) -> anyhow::Result<ExitCode> {
    let law = laws_by_name(std::slice::from_ref(&options.law))?[0];
    if options.draws == 0 || options.draws > DRAWS_MAX {
        let text = format!("--draws {}: give 1 to {DRAWS_MAX}", options.draws);
        return Err(BadOption(text).into());
    }
    let base = with_law(&Scene::load(&options.scene)?, law);
    let numbers = options.draw.map_or(1..=options.draws, |draw| draw..=draw);
    let plan: Vec<(u64, Scene, String)> = numbers
        .map(|number| {
            let (scene, about) = random_scene(&base, number);
            (number, scene, about)
        })
        .collect();
    let table = options.csv.as_deref().map(RunTable::create).transpose()?;
    let verdicts = run_parallel(options.threads, &plan, |(number, scene, about)| {
        let verdict = evaluated_run(scene, *number, false)?;
        if let Some(table) = &table {
            table.append(&RunRow::new(about, law.text(), *number, &verdict))?;
        }
        Ok(verdict)
    })?;
    let done = || plan.iter().zip(&verdicts).filter_map(|(draw, v)| Some((draw, v.as_ref()?)));
    let mut lost = 0;
    for ((number, _, about), verdict) in done() {
        lost += u32::from(!is_within_bounds(verdict));
        if options.draw.is_some() || !is_within_bounds(verdict) {
            out::line(format_args!(
                "draw {number}: {about}\n  {}\n  taktil experiment robust --law {} --scene {} \
                 --draw {number}",
                evaluation_summary(verdict),
                law.text(),
                options.scene.display()
            ))?;
        }
    }
    out::line(format_args!(
        "| draws | number | force error rms, N: median | 95 % | most | tilt rms, deg: 95 % | yaw \
         rms, deg: 95 % |\n|{}",
        "---|".repeat(7)
    ))?;
    for group in ["", "frames lost", "frame late", "not saying so", "dead", "gains spread"] {
        let of: Vec<&Evaluation> = done()
            .filter_map(|((_, _, about), verdict)| about.contains(group).then_some(verdict))
            .collect();
        out::line(group_row(if group.is_empty() { "all" } else { group }, &of))?;
    }
    let (number, law) = (done().count(), law.text());
    out::line(format_args!("\n{number} draws with `{law}`: {lost} did not hold"))?;
    let left = plan.len() - number;
    if left > 0 {
        out::warn(format_args!("interrupted: {left} draws were not tried"));
    }
    Ok(if lost == 0 && left == 0 { ExitCode::SUCCESS } else { ExitCode::from(1) })
}

/// A run as text.
fn evaluation_summary(verdict: &Evaluation) -> String {
    let rms = |spread: &Spread| spread.rms().map_or("-".into(), format_number);
    format!(
        "{} faults, {} contact losses, settled after {} s; rms force {} N, tilt {} deg, yaw {} \
         deg",
        verdict.figures.faults.0.count_ones(),
        verdict.figures.contact_lost,
        verdict.settling_s.map_or("never".into(), format_number),
        rms(&verdict.force_n),
        rms(&verdict.tilt_deg),
        rms(&verdict.yaw_deg),
    )
}

/// A row of the table: the result of a group of draws.
fn group_row(name: &str, of: &[&Evaluation]) -> String {
    let at = |share: f64, spread: fn(&Evaluation) -> &Spread| {
        let mut all: Vec<f64> = of.iter().filter_map(|v| spread(v).rms()).collect();
        all.sort_by(f64::total_cmp);
        let place = (share * all.len().saturating_sub(1) as f64).round() as usize;
        all.get(place).map_or("-".into(), |value| format_number(*value))
    };
    let force: fn(&Evaluation) -> &Spread = |v| &v.force_n;
    format!(
        "| {name} | {} | {} | {} | {} | {} | {} |",
        of.len(),
        at(0.5, force),
        at(0.95, force),
        at(1.0, force),
        at(0.95, |v| &v.tilt_deg),
        at(0.95, |v| &v.yaw_deg),
    )
}
