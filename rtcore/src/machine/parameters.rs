//! The parameters of a machine: collected from its tasks, edited by plan before a run or by hand
//! while it runs. Transactions are checked in [`crate::parameter`].

use taktil_hal::{Invalid, Nanos};

use super::Machine;
use super::draft::{LaneDraft, NO_TASK};
use crate::parameter::{
    Edit, Editor, LaneParameters, Parameter, ParameterRegistry, Transaction, plan,
};
use crate::port::{Output, Ports};

/// Gives every lane whose tasks have parameters the signal `lane.ports.edit`; returns its handle.
pub(super) fn declare_edit(draft: &mut LaneDraft) -> Option<Output<Edit>> {
    if draft.parameters.is_empty() {
        return None;
    }
    let mut own = Ports::new(0, draft.outputs.len());
    let output = own.output::<Edit>("edit");
    // As the lane's health it belongs to no task.
    draft.outputs.extend(own.outputs.into_iter().map(|output| (NO_TASK, output)));
    Some(output)
}

/// Every parameter of the machine, by lane and number.
pub(super) fn registry(drafts: &[LaneDraft]) -> ParameterRegistry {
    let mut parameters = Vec::new();
    for (lane, draft) in drafts.iter().enumerate() {
        for (number, (task, declared)) in (0u32..).zip(&draft.parameters) {
            parameters.push(Parameter {
                name: format!("{task}.{}", declared.name),
                lane,
                number,
                initial: declared.initial,
                low: declared.low,
                high: declared.high,
            });
        }
    }
    let apart = drafts.iter().map(|draft| draft.spec.period).max().unwrap_or(Nanos::ZERO);
    ParameterRegistry::new(parameters, apart)
}

impl Machine {
    /// Everything that may be edited while the machine runs.
    #[must_use]
    pub fn parameters(&self) -> &[Parameter] {
        &self.registry.parameters
    }

    /// Plans edits, in order of time, before the machine runs: a run in virtual time and a live one
    /// take them in the same jobs.
    ///
    /// # Errors
    /// The first transaction that is refused; then none is planned. The place is `edit[i].at` or
    /// `edit[i].set.NAME`.
    pub fn plan_edits(&mut self, transactions: &[Transaction]) -> Result<(), Invalid> {
        let mut parameters: Vec<&mut LaneParameters> =
            self.lanes.iter_mut().map(|lane| &mut lane.parameters).collect();
        plan(&mut self.registry, transactions, &mut parameters)
    }

    /// The end from which edits are sent while the machine runs; there is one.
    pub fn editor(&mut self) -> Option<Editor> {
        let rings = core::mem::take(&mut self.edit_rings);
        (rings.len() == self.lanes.len()).then(|| Editor::new(self.registry.clone(), rings))
    }
}
