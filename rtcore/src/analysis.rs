//! Analyses before the first job whether every lane meets its deadline: computes the longest
//! response of each lane, for fixed priorities with preemption, in integers only. A lane whose
//! tasks declare no budgets is not judged, and the result says so.
//!
//! A lane's response is the smallest `w = C + sum over lanes first of ceil((w + J) / T) C`, plus J
//! (M. Joseph and P. Pandya, "Finding response times in a real-time system", The Computer Journal
//! 29(5), 1986; release jitter J: N. Audsley, A. Burns, M. Richardson, K. Tindell and A. Wellings,
//! "Applying new scheduling theory to static priority pre-emptive scheduling", Software Engineering
//! Journal 8(5), 1993). It ignores phases and is safe. Where the hyperperiod is short the phases
//! are taken into account too, and that response decides.
//!
//! - Lanes of equal priority are taken to preempt each other: `SCHED_FIFO` queues them.
//! - Lanes scheduled by deadline come before all of these, and are judged among themselves.
//! - A lane with a CPU meets the lanes of that CPU and all lanes without one. A lane without a CPU
//!   meets every lane, as if there were one CPU. More CPUs cannot make it later than that.
//! - What a lane's guard spins before a release is taken from the lanes that come after it.
//! - Lanes share nothing that blocks, so there is no blocking term.
//! - A wait for a board is part of the budget, as if the job computed meanwhile: exact for the lane
//!   itself, safe for those after it (J.-J. Chen et al., "Many suspensions, many problems: a review
//!   of self-suspending tasks in real-time systems", Real-Time Systems 55(1), 2019, section 4.1),
//!   and right for a wait that polls instead of sleeping, which cannot be told from here.

use taktil_hal::{Invalid, Nanos};

use crate::schedule::{LaneSpec, PERIOD_MAX, Policy};

mod guards;
mod phases;

pub(crate) use guards::keep_schedulable_guards;

/// Most rounds of the fixed-point iteration; each round adds at least one job. A response that has
/// not converged by then counts as beyond its bound.
pub const ITERATIONS_MAX: usize = 10_000;
/// One million parts are a whole CPU.
pub const WHOLE_PPM: u64 = 1_000_000;

/// Time that the analysis allows for besides the declared budgets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Allowance {
    /// A job starts at most this long after its release when nobody else runs: wake-up latency.
    pub release_jitter: Nanos,
    /// The executor's own work in each job: switching, delivery, records.
    pub overhead: Nanos,
}

impl Default for Allowance {
    fn default() -> Allowance {
        Allowance { release_jitter: Nanos::from_micros(100), overhead: Nanos::from_micros(5) }
    }
}

impl Allowance {
    /// Checks that both spans are neither negative nor longer than the longest period. Places are
    /// `release_jitter_us`, `overhead_us`.
    ///
    /// # Errors
    /// The first of the two that is out of range.
    pub fn check(&self) -> Result<(), Invalid> {
        for (place, span) in
            [("release_jitter_us", self.release_jitter), ("overhead_us", self.overhead)]
        {
            if span < Nanos::ZERO || span > PERIOD_MAX {
                let what = format!("an allowance of {span} is out of range");
                let remedy = format!("give 0 to {PERIOD_MAX}; 0 trusts the kernel to be exact");
                return Err(Invalid::new(place, what, remedy));
            }
        }
        Ok(())
    }
}

/// A lane as the analysis sees it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Demand {
    /// Name, period, phase, deadline, priority and CPU.
    pub spec: LaneSpec,
    /// Processor time of one job, tasks only; `None` when a task declares none.
    pub budget: Option<Nanos>,
}

/// A recurring piece of work.
#[derive(Clone, Copy, Debug)]
struct Periodic {
    cost: Nanos,
    period: Nanos,
    phase: Nanos,
}

/// A longest response.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bound {
    /// Never longer than this.
    Within(Nanos),
    /// At least this long; the search ended there, beyond the lane's period.
    Beyond(Nanos),
}

impl Bound {
    /// The length, whatever it bounds.
    #[must_use]
    pub fn span(self) -> Nanos {
        match self {
            Bound::Within(span) | Bound::Beyond(span) => span,
        }
    }

    /// Whether `deadline` is certainly met.
    #[must_use]
    pub fn meets(self, deadline: Nanos) -> bool {
        matches!(self, Bound::Within(span) if span <= deadline)
    }
}

/// The result of the analysis for a lane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Ends by its deadline, always.
    Meets,
    /// May end after its deadline.
    Misses,
    /// Ends by its deadline if the lanes that declare nothing and come first took no time.
    Unknown,
    /// Declares no budgets.
    NotAnalysed,
}

impl Verdict {
    /// The verdict in one or two words.
    #[must_use]
    pub fn text(self) -> &'static str {
        match self {
            Verdict::Meets => "meets",
            Verdict::Misses => "misses",
            Verdict::Unknown => "unknown",
            Verdict::NotAnalysed => "not analysed",
        }
    }
}

/// One lane's result.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LaneResponse {
    /// Its name.
    pub name: String,
    /// Declared budget of a job plus the overhead.
    pub cost: Option<Nanos>,
    /// Its deadline.
    pub deadline: Nanos,
    /// Longest response from the release, whatever the phases.
    pub any_phase: Option<Bound>,
    /// Longest response with these phases; `None` when the hyperperiod is too long to walk.
    pub with_phases: Option<Bound>,
    /// Lanes that come first and declare their budgets.
    pub interfering: Vec<String>,
    /// Lanes that come first and declare none: left out of the responses.
    pub undeclared: Vec<String>,
    /// The verdict that follows from these numbers.
    pub verdict: Verdict,
}

impl LaneResponse {
    /// The response that decides: with phases where it is known.
    #[must_use]
    pub fn response(&self) -> Option<Bound> {
        self.with_phases.or(self.any_phase)
    }
}

/// The declared load of a CPU.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Load {
    /// The CPU; `None` for all lanes together when some have none.
    pub cpu: Option<usize>,
    /// Declared share, rounded up, of [`WHOLE_PPM`].
    pub ppm: u64,
    /// Lanes that may run there and declare nothing.
    pub undeclared: Vec<String>,
}

/// The whole result.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Analysis {
    /// The allowance that was made.
    pub allowance: Allowance,
    /// Lane by lane, in order.
    pub lanes: Vec<LaneResponse>,
    /// CPU by CPU, ascending; lanes without a CPU last.
    pub loads: Vec<Load>,
    refusal: Option<Invalid>,
}

impl Analysis {
    /// The complaint about the first lane that may miss its deadline. The place is `lane.NAME`.
    #[must_use]
    pub fn refusal(&self) -> Option<&Invalid> {
        self.refusal.as_ref()
    }
}

/// Analyses all lanes of a machine.
#[must_use]
pub fn analyse(lanes: &[Demand], allowance: Allowance) -> Analysis {
    let mut responses = Vec::new();
    let mut refusal = None;
    for index in 0..lanes.len() {
        let response_of_lane = lane_response(lanes, index, allowance);
        if response_of_lane.verdict == Verdict::Misses && refusal.is_none() {
            refusal = Some(miss_refusal(lanes, index, &response_of_lane, allowance));
        }
        responses.push(response_of_lane);
    }
    Analysis { allowance, lanes: responses, loads: loads(lanes, allowance), refusal }
}

/// Whether two lanes may run on the same CPU.
fn may_share_cpu(a: &LaneSpec, b: &LaneSpec) -> bool {
    a.cpu.is_none() || b.cpu.is_none() || a.cpu == b.cpu
}

/// Whether lane `other` may take the processor from lane `me`.
fn preempts(other: &LaneSpec, me: &LaneSpec) -> bool {
    match (other.policy, me.policy) {
        (Policy::Deadline, _) => true,
        (Policy::Fifo, Policy::Deadline) => false,
        (Policy::Fifo, Policy::Fifo) => other.priority >= me.priority,
    }
}

/// The other lanes that can delay lane `index`.
fn preempting_lanes(lanes: &[Demand], index: usize) -> impl Iterator<Item = &Demand> {
    let me = &lanes[index].spec;
    lanes.iter().enumerate().filter_map(move |(other, lane)| {
        let first = other != index && preempts(&lane.spec, me) && may_share_cpu(me, &lane.spec);
        first.then_some(lane)
    })
}

fn periodic(lane: &Demand, allowance: Allowance) -> Option<Periodic> {
    let cost = lane.budget? + allowance.overhead;
    Some(Periodic { cost, period: lane.spec.period, phase: lane.spec.phase })
}

/// The processor time that a lane takes from lanes of lower priority: its jobs, and the longest
/// spin before each of them.
fn interference(lane: &Demand, allowance: Allowance) -> Option<Periodic> {
    let own = periodic(lane, allowance)?;
    let spin = spin_max(lane);
    Some(Periodic { cost: own.cost + spin, phase: own.phase - spin, ..own })
}

/// The longest spin before a release of a lane.
fn spin_max(lane: &Demand) -> Nanos {
    lane.spec.guard.map_or(Nanos::ZERO, |guard| guard.spin_max)
}

fn lane_response(lanes: &[Demand], index: usize, allowance: Allowance) -> LaneResponse {
    let spec = &lanes[index].spec;
    let names = |declared: bool| {
        preempting_lanes(lanes, index)
            .filter(|lane| lane.budget.is_some() == declared)
            .map(|lane| lane.spec.name.clone())
            .collect::<Vec<_>>()
    };
    let mut response_of_lane = LaneResponse {
        name: spec.name.clone(),
        cost: None,
        deadline: spec.deadline,
        any_phase: None,
        with_phases: None,
        interfering: names(true),
        undeclared: names(false),
        verdict: Verdict::NotAnalysed,
    };
    let Some(own) = periodic(&lanes[index], allowance) else { return response_of_lane };
    let over: Vec<Periodic> =
        preempting_lanes(lanes, index).filter_map(|lane| interference(lane, allowance)).collect();
    response_of_lane.cost = Some(own.cost);
    if spec.policy == Policy::Deadline {
        response_of_lane.any_phase = Some(edf_bound(lanes, index, allowance));
    } else {
        response_of_lane.any_phase =
            Some(response_time_bound(&own, &over, allowance.release_jitter));
        response_of_lane.with_phases = phases::longest(&own, &over, allowance.release_jitter);
    }
    response_of_lane.verdict = match response_of_lane.response() {
        Some(bound) if !bound.meets(spec.deadline) => Verdict::Misses,
        _ if !response_of_lane.undeclared.is_empty() => Verdict::Unknown,
        _ => Verdict::Meets,
    };
    response_of_lane
}

/// The density of lane `index` and of the deadline lanes that may share its CPU, in parts per
/// million of a CPU: the sum of each lane's cost over what jitter leaves of its deadline, rounded
/// up.
fn density_ppm(lanes: &[Demand], index: usize, allowance: Allowance) -> u64 {
    let all = preempting_lanes(lanes, index).chain([&lanes[index]]);
    let parts = all.filter_map(|lane| {
        let work = interference(lane, allowance)?;
        let room = i128::from((lane.spec.deadline - allowance.release_jitter).0.max(1));
        u64::try_from((i128::from(work.cost.0) * i128::from(WHOLE_PPM) + room - 1) / room).ok()
    });
    parts.sum()
}

/// Earliest deadline first keeps every deadline when the densities add up to no more than one CPU
/// (J. Stankovic, M. Spuri, K. Ramamritham and G. Buttazzo, "Deadline Scheduling for Real-Time
/// Systems", 1998, 3.2), on several CPUs as on one (J. Goossens, S. Funk and S. Baruah, Real-Time
/// Systems 25, 2003). Sufficient, not necessary.
fn edf_bound(lanes: &[Demand], index: usize, allowance: Allowance) -> Bound {
    let deadline = lanes[index].spec.deadline;
    if density_ppm(lanes, index, allowance) <= WHOLE_PPM {
        Bound::Within(deadline)
    } else {
        Bound::Beyond(deadline)
    }
}

/// The fixed point of Joseph and Pandya with the release jitter of Audsley et al. It holds up to
/// one period: beyond that a lane delays itself, and the search ends.
fn response_time_bound(own: &Periodic, over: &[Periodic], jitter: Nanos) -> Bound {
    let mut window = own.cost;
    for _ in 0..ITERATIONS_MAX {
        let mut next = own.cost;
        for lane in over {
            next += lane.cost * releases_in(window + jitter, lane.period);
        }
        if next + jitter > own.period {
            return Bound::Beyond(next + jitter);
        }
        if next == window {
            return Bound::Within(window + jitter);
        }
        window = next;
    }
    Bound::Beyond(window + jitter)
}

/// The largest number of releases in a window that is open at its end: the quotient rounded up.
fn releases_in(window: Nanos, period: Nanos) -> i64 {
    (window.0 + period.0 - 1) / period.0.max(1)
}

fn loads(lanes: &[Demand], allowance: Allowance) -> Vec<Load> {
    let mut cpus: Vec<usize> = lanes.iter().filter_map(|lane| lane.spec.cpu).collect();
    cpus.sort_unstable();
    cpus.dedup();
    let mut places: Vec<Option<usize>> = cpus.into_iter().map(Some).collect();
    if lanes.iter().any(|lane| lane.spec.cpu.is_none()) {
        places.push(None);
    }
    let load = |cpu: Option<usize>| {
        let here =
            |lane: &&Demand| cpu.is_none() || lane.spec.cpu.is_none() || lane.spec.cpu == cpu;
        let share = |lane: &Demand| {
            let work = interference(lane, allowance)?;
            let whole = i128::from(work.period.0.max(1));
            let parts = i128::from(work.cost.0) * i128::from(WHOLE_PPM);
            u64::try_from((parts + whole - 1) / whole).ok()
        };
        Load {
            cpu,
            ppm: lanes.iter().filter(here).filter_map(share).sum(),
            undeclared: lanes
                .iter()
                .filter(here)
                .filter(|lane| lane.budget.is_none())
                .map(|lane| lane.spec.name.clone())
                .collect(),
        }
    };
    places.into_iter().map(load).collect()
}

/// The refusal of lane `index`, which may miss: the numbers, and what would make it fit.
fn miss_refusal(
    lanes: &[Demand],
    index: usize,
    response_of_lane: &LaneResponse,
    allowance: Allowance,
) -> Invalid {
    let spec = &lanes[index].spec;
    let response = match response_of_lane.response() {
        Some(Bound::Within(span)) => format!("{span}"),
        Some(Bound::Beyond(span)) => format!("{span} or more"),
        None => String::new(),
    };
    let first: Vec<String> = preempting_lanes(lanes, index)
        .filter_map(|lane| {
            let work = periodic(lane, allowance)?;
            let name = &lane.spec.name;
            let spin = spin_max(lane);
            let spin =
                if spin > Nanos::ZERO { format!(" and up to {spin} of guard") } else { "".into() };
            let rank = match lane.spec.policy {
                Policy::Fifo => format!("priority {}", lane.spec.priority),
                Policy::Deadline => "by deadline".to_owned(),
            };
            Some(format!("`{name}` ({}{spin} every {}, {rank})", work.cost, work.period))
        })
        .collect();
    let held_up = if first.is_empty() {
        String::new()
    } else {
        let place =
            spec.cpu.map_or("without a CPU of its own".into(), |cpu| format!("on CPU {cpu}"));
        format!("; first come, {place}: {}", first.join(", "))
    };
    if spec.policy == Policy::Deadline {
        let what = format!(
            "lane `{}` and the deadline lanes that it meets ask for {:.1} % of a CPU: {} of its \
             own within {}, less {} release jitter{held_up}",
            spec.name,
            density_ppm(lanes, index, allowance) as f64 / 1e4,
            response_of_lane.cost.unwrap_or(Nanos::ZERO),
            spec.deadline,
            allowance.release_jitter,
        );
        let remedy = remedy(lanes, index, response_of_lane, allowance);
        return Invalid::new(format!("lane.{}", spec.name), what, remedy);
    }
    let what = format!(
        "lane `{}` may end {response} after its release, and its deadline is {}: {} of its own \
         with overhead, {} release jitter{held_up}",
        spec.name,
        spec.deadline,
        response_of_lane.cost.unwrap_or(Nanos::ZERO),
        allowance.release_jitter,
    );
    Invalid::new(
        format!("lane.{}", spec.name),
        what,
        remedy(lanes, index, response_of_lane, allowance),
    )
}

fn remedy(
    lanes: &[Demand],
    index: usize,
    response_of_lane: &LaneResponse,
    allowance: Allowance,
) -> String {
    let spec = &lanes[index].spec;
    let mut ways = Vec::new();
    match fitting_budget(lanes, index, allowance) {
        Some(budget) => ways.push(format!("cut its budgets to {budget} in all")),
        None => ways.push("cut the budgets of the lanes that come first".into()),
    }
    let guards: Vec<String> = preempting_lanes(lanes, index)
        .filter(|lane| spin_max(lane) > Nanos::ZERO)
        .map(|lane| format!("`lane.{}.guard.cpu_share_max`", lane.spec.name))
        .collect();
    if !guards.is_empty() {
        ways.push(format!("lower {}", guards.join(" or ")));
    }
    if !response_of_lane.interfering.is_empty() {
        ways.push("give it a CPU that it shares with none of them (`cpu`)".into());
    }
    if let Some(Bound::Within(span)) = response_of_lane.response()
        && span <= spec.period
    {
        ways.push(format!("allow a deadline and a delivery of {span}"));
    }
    let tail = "or measure again: the table after a run suggests budgets";
    format!("{}, {tail}", ways.join(", "))
}

/// The largest budget, in whole microseconds, with which lane `index` would meet its deadline.
fn fitting_budget(lanes: &[Demand], index: usize, allowance: Allowance) -> Option<Nanos> {
    let mut trial = lanes.to_vec();
    let mut fits = |us: i64| {
        trial[index].budget = Some(Nanos::from_micros(us));
        lane_response(&trial, index, allowance).verdict != Verdict::Misses
    };
    let (mut low, mut high) = (0, lanes[index].budget?.0 / 1000 + 1);
    // Bisection: the response grows with the budget.
    while high - low > 1 {
        let middle = low + (high - low) / 2;
        if fits(middle) {
            low = middle;
        } else {
            high = middle;
        }
    }
    (low > 0).then(|| Nanos::from_micros(low))
}
