//! Determines the uses for which buffers and images are created, and lists those that a pass makes of them.

use splatgraph_framework::ir::{Pass, ResourceId, Shape, Source, Usage, Work};
use splatgraph_framework::plan::Resource;

/// Returns the uses with which a resource's buffer or image is created. They always include copies from it, so that any
/// resource can be inspected.
pub(crate) fn usage(resource: &Resource) -> Usage {
    const BUFFER: Usage = Usage::COLOR_TARGET.union(Usage::DEPTH_TARGET).complement();
    if matches!(resource.shape, Shape::Image { .. }) {
        return resource.usage | Usage::COPY_SOURCE;
    }
    let base = match resource.source {
        // Plans with different uses share planes and histories, so these allow every use; so do host buffers.
        Source::Scene { .. } | Source::HostBuffer { .. } => return BUFFER,
        Source::Transient if resource.history.is_some() => return BUFFER,
        Source::Transient => Usage::COPY_SOURCE,
        Source::Frame { .. } | Source::Live => Usage::UNIFORM | Usage::COPY_SOURCE,
        Source::Readback => Usage::COPY_TARGET | Usage::COPY_SOURCE,
    };
    base | resource.usage & BUFFER
}

/// Lists a pass's resources, each with true if it is written. A resource can appear more than once: one that is bound
/// and written appears with both values.
pub(crate) fn touched(pass: &Pass) -> impl Iterator<Item = (ResourceId, bool)> + '_ {
    let uses = pass.uses.iter().map(|used| (used.resource, used.accesses.writes()));
    let bound = pass.bindings.iter().map(|binding| (binding.resource, false));
    // In plans of the framework, `uses` has these accesses, too; plans of tests may lack them.
    let own = match pass.work {
        Work::Fill { buffer, .. } => Some((buffer, true)),
        Work::ClearHistory { resource } => Some((resource, true)),
        Work::Dispatch { .. } | Work::Draw { .. } | Work::Export | Work::Host => None,
    };
    uses.chain(bound).chain(own)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{ARGS, SPLATS, plan};

    #[test]
    fn every_resource_can_be_copied_from_and_shared_ones_have_one_usage() {
        for resource in &plan().resources {
            assert!(usage(resource).contains(Usage::COPY_SOURCE));
        }
        let mut history = plan().resources[ARGS.index()].clone();
        history.history = Some("args".to_string());
        for mut shared in [plan().resources[SPLATS.index()].clone(), history] {
            let before = usage(&shared);
            shared.usage = Usage::UNIFORM;
            assert_eq!(usage(&shared), before);
        }
    }
}
