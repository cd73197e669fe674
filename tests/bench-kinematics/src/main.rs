//! The PUMA 260's inverse, forward kinematics, tool Jacobian and inverse dynamics beside
//! rs-opw-kinematics, Pinocchio and KDL: alternating slices of one run, the spread of the slices,
//! and how far the answers are apart. `tests/bench-kinematics/run` builds the peers. Ends with 1
//! when a bar is missed and a peer was there to measure it. Times are not reported for answers that
//! differ.

mod opw;
mod peer;

use std::hint::black_box;
use std::process::ExitCode;
use std::time::Instant;

use anyhow::{Context, Result, bail, ensure};
use glam::DVec3;
use peer::Peer;
use rs_opw_kinematics::kinematic_traits::Kinematics;
use taktil_mechanics::chain::{Chain, DhRow, JointSpec};
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::puma260::dynamics::Dynamics;
use taktil_mechanics::{Joints, Pose};

/// Joint vectors of a slice.
const SLICE_SAMPLES: usize = 512;
/// Times that a slice goes through them.
const SLICE_ROUNDS: u32 = 8;

/// A motion.
pub struct Sample {
    /// Joints (rad).
    pub q: Joints,
    /// Speeds (rad/s).
    pub qd: Joints,
    /// Accelerations (rad/s^2).
    pub qdd: Joints,
}

fn samples() -> Vec<Sample> {
    let arm = Puma260::reference();
    let mut state: u64 = 1;
    let mut unit = || {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / 9_007_199_254_740_992.0
    };
    let mut six =
        |low: &Joints, high: &Joints| Joints::from_fn(|i, _| low[i] + (high[i] - low[i]) * unit());
    let (slow, fast) = (Joints::repeat(-2.0), Joints::repeat(2.0));
    (0..SLICE_SAMPLES)
        .map(|_| Sample {
            q: six(&arm.q_min_rad, &arm.q_max_rad),
            qd: six(&slow, &fast),
            qdd: six(&(slow * 5.0), &(fast * 5.0)),
        })
        .collect()
}

/// The arm's Denavit-Hartenberg rows: a, d (m), alpha (rad).
pub fn rows(arm: &Puma260) -> [(f64, f64, f64); 6] {
    let half = core::f64::consts::FRAC_PI_2;
    [
        (0.0, 0.0, half),
        (arm.a2_m, 0.0, 0.0),
        (0.0, arm.d3_m, -half),
        (0.0, arm.d4_m, half),
        (0.0, 0.0, -half),
        (0.0, 0.0, 0.0),
    ]
}

/// The arm as any arm: by its rows.
fn chain() -> Result<Chain<6>> {
    let (arm, dynamics) = (Puma260::reference(), Dynamics::reference());
    let mut bodies = dynamics.bodies().iter();
    let rows = rows(&arm).map(|(a_m, d_m, alpha_rad)| {
        let body = *bodies.next().unwrap_or(&dynamics.bodies()[5]);
        let spec = JointSpec { body, ..JointSpec::default() };
        DhRow { a_m, d_m, alpha_rad, theta_rad: 0.0, spec }
    });
    let tool = DVec3::new(0.0, 0.0, arm.tool_z_m);
    Ok(Chain::from_dh(&rows, &Pose::new(Pose::IDENTITY.rotation, tool))?)
}

fn clock<T>(inputs: &[T], mut call: impl FnMut(&T)) -> f64 {
    let start = Instant::now();
    for _ in 0..SLICE_ROUNDS {
        for input in inputs {
            call(black_box(input));
        }
    }
    start.elapsed().as_secs_f64() * 1e9 / (f64::from(SLICE_ROUNDS) * inputs.len() as f64)
}

/// Slices of one thing.
struct Line {
    what: &'static str,
    who: String,
    ns: Vec<f64>,
    error: String,
}

impl Line {
    fn quartile(&self, part: f64) -> f64 {
        let mut sorted = self.ns.clone();
        sorted.sort_by(f64::total_cmp);
        sorted[((sorted.len() - 1) as f64 * part).round() as usize]
    }
}

/// Times everything in turn, `slices` times.
struct Bench {
    samples: Vec<Sample>,
    poses: Vec<(Pose, Joints)>,
    peers: Vec<Peer>,
    lines: Vec<Line>,
}

const OURS: &str = "Taktil";
const CHAIN: &str = "Taktil, general chain";
const OPW: &str = "rs-opw-kinematics 3.0.0";

impl Bench {
    fn slice(&mut self) -> Result<()> {
        let (arm, dynamics, opw) = (Puma260::reference(), Dynamics::reference(), opw::arm());
        let theirs: Vec<_> =
            self.poses.iter().map(|(pose, q)| (opw::pose(pose), (*q).into())).collect();
        let ours = [
            (
                "inverse",
                clock(&self.poses, |(pose, q)| {
                    black_box(arm.inverse_kinematics(pose, Some(q)));
                }),
            ),
            (
                "fk",
                clock(&self.samples, |s| {
                    black_box(arm.tool_pose(&s.q));
                }),
            ),
            (
                "jacobian",
                clock(&self.samples, |s| {
                    black_box(arm.jacobian_tool(&s.q));
                }),
            ),
            (
                "rnea",
                clock(&self.samples, |s| {
                    black_box(dynamics.inverse_dynamics(&s.q, &s.qd, &s.qdd));
                }),
            ),
        ];
        for (what, ns) in ours {
            self.note(what, OURS, ns);
            if what == "inverse" {
                let plain = clock(&theirs, |(pose, _)| {
                    black_box(opw.inverse(pose));
                });
                self.note("inverse", OPW, plain);
                let continuing = clock(&theirs, |(pose, q)| {
                    black_box(opw.inverse_continuing(pose, q));
                });
                self.note("inverse", &format!("{OPW}, continuing"), continuing);
            } else {
                for index in 0..self.peers.len() {
                    let ns = self.peers[index].time(what, SLICE_ROUNDS)?;
                    let name = self.peers[index].name.clone();
                    self.note(what, &name, ns);
                }
            }
        }
        self.general()
    }

    /// The same by the code for any arm.
    fn general(&mut self) -> Result<()> {
        let (arm, chain) = (Puma260::reference(), chain()?);
        let wrist = chain.spherical_wrist().context("the arm is not recognised")?;
        let tools: Vec<_> = self.poses.iter().map(|(_, q)| (arm.tool_pose(q), *q)).collect();
        let ns = clock(&tools, |(pose, q)| {
            black_box(wrist.inverse_kinematics(pose, Some(q)));
        });
        self.note("inverse", CHAIN, ns);
        let ns = clock(&self.samples, |s| {
            black_box(chain.tool_pose(&s.q));
        });
        self.note("fk", CHAIN, ns);
        let ns = clock(&self.samples, |s| {
            black_box(chain.jacobian_tool(&s.q));
        });
        self.note("jacobian", CHAIN, ns);
        let ns = clock(&self.samples, |s| {
            black_box(chain.inverse_dynamics(&s.q, &s.qd, &s.qdd));
        });
        self.note("rnea", CHAIN, ns);
        Ok(())
    }

    fn note(&mut self, what: &'static str, who: &str, ns: f64) {
        match self.lines.iter_mut().find(|line| line.what == what && line.who == who) {
            Some(line) => line.ns.push(ns),
            None => {
                let (who, error) = (who.to_owned(), String::new());
                self.lines.push(Line { what, who, ns: vec![ns], error });
            }
        }
    }

    fn say(&mut self, what: &str, who: &str, error: String) {
        let line = self.lines.iter_mut().find(|line| line.what == what && line.who == who);
        if let Some(line) = line {
            line.error = error;
        }
    }

    /// How far the peers' answers are from ours.
    fn compare(&mut self) -> Result<()> {
        let (arm, dynamics) = (Puma260::reference(), Dynamics::reference());
        for index in 0..self.peers.len() {
            let answers = self.peers[index].answers(self.samples.len())?;
            let name = self.peers[index].name.clone();
            let mut most = [0.0_f64; 3];
            for (sample, answer) in self.samples.iter().zip(&answers) {
                ensure!(answer.len() == 54, "{name} gives {} numbers", answer.len());
                let tool = arm.tool_pose(&sample.q);
                let jacobian = arm.jacobian_tool(&sample.q).transpose();
                let tau = dynamics.inverse_dynamics(&sample.q, &sample.qd, &sample.qdd);
                let place = tool.translation.to_array();
                let pose = tool.rotation_rows().into_iter().chain(place);
                let ours = pose.chain(jacobian.iter().copied()).chain(tau.iter().copied());
                for (n, (a, b)) in ours.zip(answer).enumerate() {
                    let part = usize::from(n >= 12) + usize::from(n >= 48);
                    most[part] = most[part].max((a - b).abs());
                }
            }
            for (what, off) in ["fk", "jacobian", "rnea"].into_iter().zip(most) {
                ensure!(off < 1e-11, "{name}: {what} is {off:e} away from ours");
                self.say(what, &name, format!("{off:.1e} from ours"));
            }
        }
        Ok(())
    }

    /// What the solvers leave of the pose, and how often the joints of the pose are not found.
    fn residuals(&mut self) -> Result<()> {
        let (arm, opw) = (Puma260::reference(), opw::arm());
        let q: Vec<Joints> = self.samples.iter().map(|s| s.q).collect();
        opw::check(&opw, &q)?;
        let (mut ours, mut plain, mut continuing) = (0.0_f64, 0.0_f64, 0.0_f64);
        let (mut few, mut few_opw) = (0, 0);
        for (pose, q) in &self.poses {
            let entries = |got: &Pose| {
                let off = (got.rotation - pose.rotation).to_cols_array();
                let place = (got.translation - pose.translation).length();
                off.iter().fold(place, |most, x| most.max(x.abs()))
            };
            let branches = arm.inverse_kinematics(pose, Some(q));
            few += usize::from(branches.len() != 8);
            ours = branches.iter().fold(ours, |m, b| m.max(entries(&arm.wrist_pose(&b.q))));
            let target = opw::pose(pose);
            let back = |q: &[f64; 6]| entries(&arm.wrist_pose(&Joints::from(*q)));
            let got = opw.inverse(&target);
            few_opw += usize::from(got.len() != 8);
            plain = got.iter().fold(plain, |m, q| m.max(back(q)));
            let got = opw.inverse_continuing(&target, &(*q).into());
            continuing = got.iter().fold(continuing, |m, q| m.max(back(q)));
        }
        self.say("inverse", OURS, format!("residual {ours:.1e}, {few} poses without 8"));
        self.say("inverse", OPW, format!("residual {plain:.1e}, {few_opw} poses without 8"));
        self.say("inverse", &format!("{OPW}, continuing"), format!("residual {continuing:.1e}"));
        Ok(())
    }

    /// The table; whether every bar that could be measured holds.
    fn print(&self) -> bool {
        let bars = [("inverse", OPW, 0.40), ("fk", "Pinocchio", 0.5)];
        let bars =
            bars.into_iter().chain([("jacobian", "Pinocchio", 0.5), ("rnea", "Pinocchio", 0.5)]);
        println!("| call | by | ns, best | median | quartiles | ours over it | errors |");
        println!("|---|---|---|---|---|---|---|");
        for line in &self.lines {
            let own = self.lines.iter().find(|l| l.what == line.what && l.who == OURS);
            let ratio = own.map_or(f64::NAN, |own| own.quartile(0.5) / line.quartile(0.5));
            println!(
                "| {} | {} | {:.0} | {:.0} | {:.0} to {:.0} | {ratio:.2} | {} |",
                name(line.what),
                line.who,
                line.quartile(0.0),
                line.quartile(0.5),
                line.quartile(0.25),
                line.quartile(0.75),
                line.error
            );
        }
        let mut held = true;
        for (what, who, bar) in bars {
            let find = |who: &str| self.lines.iter().find(|l| l.what == what && l.who == who);
            let (Some(own), Some(peer)) = (find(OURS), find(who)) else { continue };
            // Medians of slices that shared their minutes, and the best, which load cannot flatter.
            let ratio = own.quartile(0.5) / peer.quartile(0.5);
            let best = own.quartile(0.0) / peer.quartile(0.0);
            let good = ratio <= bar && best <= bar;
            let verdict = if good { "held" } else { "MISSED" };
            let what = name(what);
            println!("{what}: {ratio:.3} of {who}, best {best:.3}, bar {bar:.2}: {verdict}");
            held &= good;
        }
        held
    }
}

fn name(what: &str) -> &str {
    match what {
        "inverse" => "inverse, all branches",
        "fk" => "forward, tool pose",
        "jacobian" => "tool Jacobian",
        _ => "inverse dynamics",
    }
}

fn main() -> Result<ExitCode> {
    let samples = samples();
    let (mut peers, mut slices) = (Vec::new(), 41_u32);
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        let value = args.next().with_context(|| format!("{arg} needs a value"))?;
        match arg.as_str() {
            "--peer" => peers.push(Peer::start(&value, &samples)?),
            "--slices" => slices = value.parse().context("--slices needs a number")?,
            _ => bail!("{arg}: give --peer NAME=PROGRAM or --slices N"),
        }
    }
    let arm = Puma260::reference();
    let poses = samples.iter().map(|s| (arm.wrist_pose(&s.q), s.q)).collect();
    let mut bench = Bench { samples, poses, peers, lines: Vec::new() };
    for _ in 0..slices.max(1) {
        bench.slice()?;
    }
    bench.residuals()?;
    bench.compare()?;
    println!(
        "{SLICE_SAMPLES} random joint vectors, {slices} alternating slices of {SLICE_ROUNDS} \
         passes:"
    );
    Ok(if bench.print() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
