//! Storms where one machine is outgrown: scripts for HyperQueue, Slurm and GNU parallel that run a
//! storm part by part. A part is addressed by its number, leaves one file by an atomic rename, and
//! does nothing when that file is there, so that it may be run again, anywhere, as often as wanted.

use std::path::{Path, PathBuf};

use anyhow::Context;
use serde_json::{Value, json};
use taktil_machine_console::option::BadOption;

use crate::campaign::{Batch, Failure};

/// What runs the parts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Engine {
    /// HyperQueue: one task a part.
    Hq,
    /// Slurm: one element of an array a part.
    Slurm,
    /// GNU parallel on one machine.
    Parallel,
}

/// A text as one word of a shell.
fn quoted(text: &str) -> String {
    format!("'{}'", text.replace('\'', "'\\''"))
}

/// The script that submits `parts` parts of `command`, a part's number as its last argument.
#[must_use]
pub fn script(engine: Engine, program: &str, options: &[String], parts: u64) -> String {
    let words: Vec<String> =
        std::iter::once(program).chain(options.iter().map(String::as_str)).map(quoted).collect();
    let command = words.join(" ");
    let last = parts.saturating_sub(1);
    let body = match engine {
        Engine::Hq => format!(
            "# A part whose worker is lost is run again by another one; finished ones stay.\n\
             exec hq submit --array 0-{last} --crash-limit 5 --name storm --log storm.log -- \\\n\
             \x20   bash -c {}\n",
            quoted(&format!("{command} --index \"$HQ_TASK_ID\""))
        ),
        Engine::Slurm => format!(
            "#SBATCH --job-name=storm\n#SBATCH --array=0-{last}\n#SBATCH --cpus-per-task=1\n\
             #SBATCH --requeue\n#SBATCH --output=storm-%a.out\nset -eu\n\
             exec {command} --index \"$SLURM_ARRAY_TASK_ID\"\n"
        ),
        Engine::Parallel => {
            format!("set -eu\nseq 0 {last} | parallel --halt never {} --index\n", quoted(&command))
        }
    };
    format!("#!/usr/bin/env bash\n{body}")
}

/// The file of a part.
#[must_use]
pub fn part_file(folder: &Path, index: u64) -> PathBuf {
    folder.join(format!("part-{index:06}.json"))
}

/// A failure as JSON.
#[must_use]
pub fn failure_json(failure: &Failure) -> Value {
    let violations = match &failure.outcome {
        Ok(outcome) => outcome
            .violations
            .iter()
            .map(|one| json!({ "rule": one.rule, "at_ns": one.at.0, "what": one.what }))
            .collect(),
        Err(why) => vec![json!({ "rule": "the case runs", "at_ns": 0, "what": why })],
    };
    let plan: Vec<String> = failure.case.plan.faults().iter().map(ToString::to_string).collect();
    json!({ "seed": failure.case.seed, "plan": plan, "violations": violations })
}

/// A batch as one JSON object.
#[must_use]
pub fn batch_json(batch: &Batch) -> Value {
    let runs: Vec<Value> = batch
        .digests
        .iter()
        .map(|(seed, digest)| json!({ "seed": seed, "digest": digest }))
        .collect();
    let failures: Vec<Value> = batch.failures.iter().map(failure_json).collect();
    json!({
        "digest": batch.digest(),
        "simulated_s": batch.simulated.as_secs_f64(),
        "runs": runs,
        "failures": failures,
    })
}

/// Writes the file of a part: under another name first, then renamed.
///
/// # Errors
/// A folder that cannot be written.
pub fn write_part(folder: &Path, index: u64, batch: &Batch) -> anyhow::Result<()> {
    let file = part_file(folder, index);
    let scratch = folder.join(format!(".part-{index:06}.{}", std::process::id()));
    let text = format!("{}\n", batch_json(batch));
    std::fs::write(&scratch, text).with_context(|| format!("{}", scratch.display()))?;
    std::fs::rename(&scratch, &file).with_context(|| format!("{}", file.display()))
}

/// What the parts in a folder came to.
#[derive(Debug, Default)]
pub struct Collection {
    /// Numbers of parts that are not there.
    pub missing: Vec<u64>,
    /// Runs, with those that failed.
    pub runs: u64,
    /// Failures as they stand in the files.
    pub failures: Vec<Value>,
    /// Simulated time (s).
    pub simulated_s: f64,
    /// One number over all digests in order of seeds.
    pub digest: String,
}

/// Reads `parts` parts.
///
/// # Errors
/// A file that is no part of a storm.
pub fn collect(folder: &Path, parts: u64) -> anyhow::Result<Collection> {
    let mut all = Collection::default();
    let mut batch = Batch::default();
    for index in 0..parts {
        let file = part_file(folder, index);
        let Ok(text) = std::fs::read_to_string(&file) else {
            all.missing.push(index);
            continue;
        };
        let bad = || BadOption(format!("{}: no part of a storm", file.display()));
        let part: Value = serde_json::from_str(&text).map_err(|_| bad())?;
        all.simulated_s += part["simulated_s"].as_f64().ok_or_else(bad)?;
        all.failures.extend(part["failures"].as_array().ok_or_else(bad)?.iter().cloned());
        for run in part["runs"].as_array().ok_or_else(bad)? {
            let seed = run["seed"].as_u64().ok_or_else(bad)?;
            let digest = run["digest"].as_str().ok_or_else(bad)?;
            batch.digests.push((seed, digest.to_owned()));
        }
    }
    batch.digests.sort();
    all.runs = batch.digests.len() as u64;
    all.digest = batch.digest();
    Ok(all)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_script_addresses_every_part_and_quotes_what_it_runs() {
        let options = ["storm", "--seeds", "0..100", "--out", "a b'c"].map(str::to_owned);
        let hq = script(Engine::Hq, "/usr/bin/taktil", &options, 10);
        assert!(hq.contains("--array 0-9") && hq.contains("$HQ_TASK_ID"), "{hq}");
        let slurm = script(Engine::Slurm, "/usr/bin/taktil", &options, 10);
        assert!(slurm.contains("#SBATCH --array=0-9\n"), "{slurm}");
        assert!(slurm.contains(r"'a b'\''c' --index"), "{slurm}");
        assert!(script(Engine::Parallel, "taktil", &options, 1).contains("seq 0 0 | parallel"));
    }

    #[test]
    fn parts_are_collected_and_missing_ones_named() {
        let folder = std::env::temp_dir().join(format!("taktil-storm-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let part =
            |seed: u64| Batch { digests: vec![(seed, format!("{seed:016x}"))], ..Batch::default() };
        write_part(&folder, 0, &part(0)).unwrap();
        write_part(&folder, 2, &part(2)).unwrap();
        let some = collect(&folder, 3).unwrap();
        assert_eq!((some.missing, some.runs), (vec![1], 2));
        write_part(&folder, 1, &part(1)).unwrap();
        let all = collect(&folder, 3).unwrap();
        assert_eq!((all.missing.len(), all.runs), (0, 3));
        let mut whole = Batch::default();
        (0..3).for_each(|seed| whole.append(part(seed)));
        assert_eq!(all.digest, whole.digest());
        std::fs::write(part_file(&folder, 1), "{}").unwrap();
        assert!(collect(&folder, 3).is_err());
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
