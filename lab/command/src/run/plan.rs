//! `taktil run --plan`: prints when each lane is released, and whether it meets its deadline,
//! without a run. A schedule that is not feasible is an error when the scene is loaded.

use std::fmt::Write;

use serde_json::{Value, json};
use taktil_rtcore::analysis::{Bound, LaneResponse, Load};
use taktil_rtcore::hyperperiod::{self, Table};
use taktil_rtcore::{Invalid, LaneSpec, Machine, Nanos, Policy};

fn specs(machine: &Machine) -> Vec<&LaneSpec> {
    machine.figures().map(|(spec, _)| spec).collect()
}

fn us(span: Option<Nanos>) -> String {
    let exact = |Nanos(ns)| match ns % 1000 {
        0 => (ns / 1000).to_string(),
        rest => format!("{}.{:03}", ns / 1000, rest.abs()),
    };
    span.map_or_else(|| "-".into(), exact)
}

fn bound(bound: Option<Bound>) -> String {
    match bound {
        Some(Bound::Beyond(span)) => format!(">{}", us(Some(span))),
        other => us(other.map(Bound::span)),
    }
}

fn cpu(cpu: Option<usize>) -> String {
    cpu.map_or_else(|| "any".into(), |cpu| cpu.to_string())
}

#[expect(clippy::cast_precision_loss, reason = "parts of a million")]
fn percent(load: &Load) -> f64 {
    load.ppm as f64 / 1e4
}

/// The plan as text.
#[must_use]
pub fn text(machine: &Machine) -> String {
    let (analysis, specs) = (machine.analysis(), specs(machine));
    let mut out = format!(
        "schedule, all in us: release jitter {}, overhead {} a job\n",
        us(Some(analysis.allowance.release_jitter)),
        us(Some(analysis.allowance.overhead)),
    );
    let _ = writeln!(
        out,
        "  {:<10} {:>4} {:>5} {:>8} {:>8} {:>8} {:>9} {:>10} {:>9} {:>6}  verdict",
        "lane",
        "cpu",
        "prio",
        "period",
        "phase",
        "cost",
        "response",
        "any phase",
        "deadline",
        "guard",
    );
    for (spec, lane) in specs.iter().zip(&analysis.lanes) {
        let _ = writeln!(
            out,
            "  {:<10} {:>4} {:>5} {:>8} {:>8} {:>8} {:>9} {:>10} {:>9} {:>6}  {}",
            lane.name,
            cpu(spec.cpu),
            rank(spec),
            us(Some(spec.period)),
            us(Some(spec.phase)),
            us(lane.cost),
            bound(lane.response()),
            bound(lane.any_phase),
            us(Some(lane.deadline)),
            us(spec.guard.map(|guard| guard.spin_max)),
            verdict(lane),
        );
    }
    for load in &analysis.loads {
        let more = if load.undeclared.is_empty() { "" } else { ", and what is not declared" };
        let _ = writeln!(out, "  cpu {:<4} {:.1} % declared{more}", cpu(load.cpu), percent(load));
    }
    if specs.iter().any(|spec| spec.cpu.is_none()) {
        out +=
            "  lanes without a cpu are analysed as if all lanes shared one: the safe assumption\n";
    }
    match hyperperiod::table(&specs) {
        Ok(table) => releases(&mut out, &table, &specs),
        Err(Invalid { what, .. }) => {
            let _ = writeln!(out, "no table of releases: {what}");
        }
    }
    out
}

/// The priority, or a text for a lane without one.
fn rank(spec: &LaneSpec) -> String {
    match spec.policy {
        Policy::Fifo => spec.priority.to_string(),
        Policy::Deadline => "edf".to_owned(),
    }
}

fn verdict(lane: &LaneResponse) -> String {
    match lane.undeclared.as_slice() {
        [] => lane.verdict.text().to_owned(),
        missing if lane.cost.is_some() => {
            format!("{}: no budgets in {}", lane.verdict.text(), missing.join(", "))
        }
        _ => lane.verdict.text().to_owned(),
    }
}

fn releases(out: &mut String, table: &Table, specs: &[&LaneSpec]) {
    let _ = writeln!(out, "releases, repeating every {} us", us(Some(table.length)));
    for instant in table.releases.chunk_by(|a, b| a.at == b.at) {
        let names: Vec<String> =
            instant.iter().map(|r| format!("{} {}", specs[r.lane].name, r.job)).collect();
        let _ = writeln!(out, "  {:>10}  {}", us(Some(instant[0].at)), names.join(", "));
    }
}

/// The plan as one JSON object and a line end.
#[must_use]
pub fn json(machine: &Machine) -> String {
    let (analysis, specs) = (machine.analysis(), specs(machine));
    let lane = |(spec, lane): (&&LaneSpec, &LaneResponse)| {
        json!({
            "name": lane.name,
            "cpu": spec.cpu,
            "priority": (spec.policy == Policy::Fifo).then_some(spec.priority),
            "period_ns": spec.period.0,
            "phase_ns": spec.phase.0,
            "cost_ns": lane.cost.map(|cost| cost.0),
            "response_ns": lane.response().map(|bound| bound.span().0),
            "any_phase_ns": lane.any_phase.map(|bound| bound.span().0),
            "deadline_ns": lane.deadline.0,
            "guard_ns": spec.guard.map(|guard| guard.spin_max.0),
            "interfering": lane.interfering,
            "undeclared": lane.undeclared,
            "verdict": lane.verdict.text(),
        })
    };
    let load = |load: &Load| json!({ "cpu": load.cpu, "percent": percent(load) });
    let table = hyperperiod::table(&specs);
    let released: Option<Vec<Value>> = table.as_ref().ok().map(|table| {
        let row = |r: &hyperperiod::Release| {
            json!({ "at_ns": r.at.0, "lane": specs[r.lane].name, "job": r.job })
        };
        table.releases.iter().map(row).collect()
    });
    let plan = json!({
        "release_jitter_ns": analysis.allowance.release_jitter.0,
        "overhead_ns": analysis.allowance.overhead.0,
        "lanes": specs.iter().zip(&analysis.lanes).map(lane).collect::<Vec<_>>(),
        "loads": analysis.loads.iter().map(load).collect::<Vec<_>>(),
        "hyperperiod_ns": table.as_ref().ok().map(|table| table.length.0),
        "releases": released,
    });
    format!("{plan}\n")
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use taktil_lab_scene::assembly::Assembly;
    use taktil_lab_scene::scene::Scene;

    use super::*;

    #[test]
    fn the_rolling_machine_is_shown_to_meet_every_deadline() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../sim/scenes/roll-pin.toml");
        let mut scene = Scene::load(&path).unwrap();
        let machine = Assembly::new(&scene).with_seed(1).build().unwrap();
        let plan = text(&machine);
        assert_eq!(plan.matches("  meets\n").count(), 3, "{plan}");
        assert!(plan.contains("servo 0, touch 0\n"), "{plan}");
        let object: Value = serde_json::from_str(&json(&machine)).unwrap();
        assert_eq!(object["hyperperiod_ns"], 5_000_000);
        assert_eq!(object["releases"].as_array().unwrap().len(), 5);
        assert_eq!(object["lanes"][0]["verdict"], "meets");

        scene.world_budget = None;
        let partly = text(&Assembly::new(&scene).with_seed(1).build().unwrap());
        assert_eq!(partly.matches("not analysed").count(), 1, "{partly}");
        assert!(partly.contains("and what is not declared"), "{partly}");

        scene.world_budget = Some(Nanos::from_micros(1200));
        let refused = Assembly::new(&scene).with_seed(1).build().err().expect("must be refused");
        assert!(refused.what.contains("its deadline is 1250 us"), "{refused}");
        assert_eq!(refused.mark.map(|mark| mark.line), Some(7), "world_budget_us");
        scene.world_budget = None;
        scene.world_cpu = Some(100_000);
        let nowhere = Assembly::new(&scene).with_seed(1).build().err().expect("must be refused");
        assert!(nowhere.what.contains("CPU 100000 does not exist"), "{nowhere}");
    }
}
