//! What a pass may do with a buffer that comes with a frame.
//!
//! Its size in the plan is the least that it holds, so that what is held against the plan's sizes here (words of indirect
//! arguments, bindings) holds for every frame. How long it may be at most is checked with each frame ([`crate::given`]).

use super::{Checker, invalid};
use splatgraph_api::BackendError;
use splatgraph_framework::ir::*;

impl Checker<'_> {
    /// A buffer that comes with a frame is storage, and only read: it is the host's, or another executor's.
    pub(super) fn given(&self, pass: &Pass) -> Result<(), BackendError> {
        let given = |id: ResourceId| {
            let resource = self.plan.resources.get(id.index())?;
            matches!(resource.source, Source::HostBuffer { .. }).then_some(&resource.name)
        };
        for binding in &pass.bindings {
            if let (DescriptorKind::UniformBuffer, Some(name)) = (binding.kind, given(binding.resource)) {
                return invalid(format!(
                    "pass `{}` binds `{name}`, a storage buffer that comes with the frame, as a uniform block",
                    pass.name
                ));
            }
        }
        let filled = match pass.work {
            Work::Fill { buffer, .. } => Some(buffer),
            Work::Start { resource } => Some(resource),
            _ => None,
        };
        let touched = pass.uses.iter().filter(|touch| touch.accesses.writes());
        for id in touched.map(|touch| touch.resource).chain(filled) {
            if let Some(name) = given(id) {
                return invalid(format!(
                    "pass `{}` writes to `{name}`, which comes with the frame and is only read",
                    pass.name
                ));
            }
        }
        Ok(())
    }
}
