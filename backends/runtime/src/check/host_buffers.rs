//! Checks how passes use host buffers.
//!
//! The plan's size of a host buffer is its minimum, so checks against it (words of indirect arguments, bindings) hold
//! for every frame. The maximum is checked with each frame: see [`crate::host_buffers`].

use super::{Checker, invalid};
use crate::usage::touched;
use splatgraph_api::BackendError;
use splatgraph_framework::ir::*;

impl Checker<'_> {
    pub(super) fn host_buffers(&self, pass: &Pass) -> Result<(), BackendError> {
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
        for (id, _) in touched(pass).filter(|(_, writes)| *writes) {
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
