//! A run of a hand's scene through the whole stack in virtual time, as the tests of hands see it.

use std::path::Path;

use taktil_lab_scene::assembly::Assembly;
use taktil_lab_scene::run_virtual;
use taktil_lab_scene::scene::Scene;
use taktil_lab_world::HandTruth;
use taktil_record::digest::Digest;
use taktil_rtcore::record::{Observer, Record};
use taktil_rtcore::{FaultSet, Nanos, Payload};
use taktil_signal::{ControlState, GraspState};

/// A shipped scene of a hand.
pub(crate) fn scene(name: &str) -> Scene {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../sim/scenes/hand").join(name);
    Scene::load(&path).unwrap()
}

/// All truths and reports of a run of `N` joints, and the faults that were latched in it.
pub(crate) struct GraspRun<const N: usize> {
    ids: [Option<usize>; 3],
    pub(crate) truths: Vec<HandTruth<N>>,
    pub(crate) states: Vec<GraspState>,
    pub(crate) faults: FaultSet,
}

impl<const N: usize> Observer for GraspRun<N> {
    fn record(&mut self, record: &Record<'_>) {
        let id = Some(record.signal);
        if id == self.ids[0] {
            self.truths.push(HandTruth::decode(record.body).unwrap());
        } else if id == self.ids[1] {
            self.states.push(GraspState::decode(record.body).unwrap());
        } else if id == self.ids[2] {
            self.faults.0 |= ControlState::decode(record.body).unwrap().faults;
        }
    }
}

impl<const N: usize> GraspRun<N> {
    /// Runs a scene for some time (s).
    pub(crate) fn new(scene: &Scene, until_s: f64) -> GraspRun<N> {
        let mut machine = Assembly::new(scene).build().unwrap();
        let catalog = machine.catalog().clone();
        let names = ["world.truth", "grasp.state", "supervisor.control"];
        let ids = names.map(|name| catalog.find(name));
        assert!(ids.iter().all(Option::is_some));
        let faults = FaultSet::default();
        let mut run = GraspRun { ids, truths: Vec::new(), states: Vec::new(), faults };
        run_virtual(&mut machine, Nanos((1e9 * until_s) as i64), &mut run).unwrap();
        run
    }
}

/// The digest of the first three seconds of a scene.
pub(crate) fn digest_hex(name: &str, seed: u64) -> String {
    let scene = scene(name);
    let mut machine = Assembly::new(&scene).with_seed(seed).build().unwrap();
    let mut digest = Digest::new(machine.catalog());
    run_virtual(&mut machine, Nanos::from_secs(3), &mut digest).unwrap();
    digest.hex()
}
