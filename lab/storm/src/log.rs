//! Writes the log of a failing case: the run is made once more, with a recording beside its
//! checkers, and is the same run, because a seed is one.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use taktil_lab_scene::score::Score;
use taktil_lab_scene::summary::FinishedRun;
use taktil_lab_scene::{RECORDED_FILE_PREFIX, targets};
use taktil_machine_console::option::BadOption;
use taktil_record::McapLog;
use taktil_record::summary::SUMMARY_KEY;
use taktil_rtcore::Machine;
use taktil_rtcore::linux::monotonic;
use taktil_rtcore::record::{Observer, Record};

use crate::case::Case;
use crate::check::Violation;
use crate::run::{Outcome, machine, run_machine};

/// Key of the run's metadata under which its faults stand, one a line.
pub const FAULTS_KEY: &str = "faults";
/// Key of the closing metadata under which the rules that were broken stand, one a line.
pub const VIOLATIONS_KEY: &str = "violations";

/// A folder that logs of failing cases go to.
#[derive(Clone, Debug)]
pub struct LogFolder(PathBuf);

impl LogFolder {
    /// The folder that the option `--log` names.
    ///
    /// # Errors
    /// A folder that is not there, or in which no file can be made.
    pub fn new(folder: &Path) -> Result<LogFolder, BadOption> {
        let shown = folder.display();
        if !folder.is_dir() {
            let what = if folder.exists() { "is no folder" } else { "there is no such folder" };
            let remedy = format!("name one that is there, such as after `mkdir -p {shown}`");
            return Err(BadOption(format!("--log {shown}: {what}; {remedy}")));
        }
        let scratch = folder.join(format!(".taktil-storm-{}", std::process::id()));
        std::fs::File::create(&scratch).map_err(|error| {
            let remedy = "name a folder in which files can be made";
            BadOption(format!("--log {shown}: {error}; {remedy}"))
        })?;
        // A scratch file that cannot be removed harms nobody.
        let _ = std::fs::remove_file(&scratch);
        Ok(LogFolder(folder.to_owned()))
    }

    /// The file of a case.
    #[must_use]
    pub fn file(&self, case: &Case) -> PathBuf {
        self.0.join(format!("{}-{}.mcap", case.campaign.name(), case.seed))
    }

    /// Runs a case and writes its log, which takes the place of an older one; `repeat` is the
    /// command that repeats the run.
    ///
    /// # Errors
    /// A machine that cannot be built; a log that cannot be written, with its path.
    pub fn write(&self, case: &Case, repeat: String) -> anyhow::Result<PathBuf> {
        let path = self.file(case);
        let began = monotonic();
        let mut machine = machine(case)?;
        let mut recording = Recording::start(&machine, case, &path)?;
        let outcome = run_machine(case, &mut machine, &mut recording);
        let Recording { log, mut score } = recording;
        score.finish();
        let targets = targets(&case.scene);
        let summary = FinishedRun {
            scene: case.scene.source.path.display().to_string(),
            title: &case.scene.title,
            seed: case.seed,
            account: None,
            sim_s: outcome.length.as_secs_f64(),
            wall_s: (monotonic() - began).as_secs_f64(),
            digest: outcome.digest.clone(),
            figures: &score.figures,
            force_set_point_n: targets.m0 / targets.counts_per_n,
            lanes: machine.figures().collect(),
            panics: machine.panics().collect(),
            log: Some(path.display().to_string()),
            interrupted: false,
            repeat,
        }
        .summary();
        let result = BTreeMap::from([
            (SUMMARY_KEY.to_owned(), summary.to_json().to_string()),
            (VIOLATIONS_KEY.to_owned(), violations(&outcome)),
        ]);
        log.finish_with(&result)?;
        Ok(path)
    }
}

/// The rules that a run broke, one a line.
fn violations(outcome: &Outcome) -> String {
    let line =
        |one: &Violation| format!("{} at {:.4} s: {}", one.rule, one.at.as_secs_f64(), one.what);
    outcome.violations.iter().map(line).collect::<Vec<_>>().join("\n")
}

/// What a log says of its run, in the words of a run of a scene.
fn metadata(case: &Case) -> BTreeMap<String, String> {
    let scene = &case.scene;
    let faults: Vec<String> = case.plan.faults().iter().map(ToString::to_string).collect();
    let about = BTreeMap::from([
        ("scene".to_owned(), scene.source.path.display().to_string()),
        ("scene_text".to_owned(), scene.source.text.clone()),
        ("machine_text".to_owned(), scene.machine_text().to_owned()),
        ("seed".to_owned(), case.seed.to_string()),
        ("mode".to_owned(), "storm".to_owned()),
        ("campaign".to_owned(), case.campaign.name().to_owned()),
        (FAULTS_KEY.to_owned(), faults.join("\n")),
        ("taktil".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
    ]);
    let recorded =
        scene.recorded().map(|(name, text)| (format!("{RECORDED_FILE_PREFIX}{name}"), text.into()));
    about.into_iter().chain(recorded).collect()
}

/// The log of a run and the figures of its closing table.
struct Recording {
    log: McapLog,
    score: Score,
}

impl Recording {
    fn start(machine: &Machine, case: &Case, path: &Path) -> anyhow::Result<Recording> {
        let catalog = machine.catalog();
        let score = Score::new(catalog, targets(&case.scene), case.scene.robot.clone());
        Ok(Recording { log: McapLog::create(path, catalog, &metadata(case))?, score })
    }
}

impl Observer for Recording {
    fn record(&mut self, record: &Record<'_>) {
        self.log.record(record);
        self.score.record(record);
    }
}
