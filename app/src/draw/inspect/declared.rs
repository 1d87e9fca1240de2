//! Finds the type that shaders declare for the elements of a buffer.

use super::contents::ReadAs;
use splatgraph_framework::ir::{Pass, PassId, ResourceId};
use splatgraph_framework::plan::Plan;

/// Returns the type of a buffer's words: floats if a shader declares only floats in its block, otherwise integers.
///
/// The inspected pass decides, or, if it does not bind the buffer, the first pass that does.
pub(super) fn of_buffer(plan: &Plan, after: PassId, buffer: ResourceId) -> ReadAs {
    let mut passes = [after].into_iter().chain(plan.order()).map(|id| plan.pass(id));
    let floats = passes.find_map(|pass| has_floats(plan, pass, buffer));
    if floats == Some(true) { ReadAs::Float } else { ReadAs::Uint }
}

/// Returns true if the block to which a pass binds the buffer has only floats; `None` without such a block.
fn has_floats(plan: &Plan, pass: &Pass, buffer: ResourceId) -> Option<bool> {
    let bound = pass.bindings.iter().find(|binding| binding.resource == buffer)?;
    let shaders = pass.work.shaders().into_iter().map(|id| plan.shader(*id));
    let mut blocks = shaders.flat_map(|shader| &shader.reflection.bindings);
    Some(blocks.find(|block| block.binding == bound.binding)?.floats)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::facts;
    use crate::draw::planner::testing;

    #[test]
    fn buffers_of_vectors_are_read_as_floats_and_buffers_of_keys_as_integers() {
        let plan = testing::plan("splat", &[], facts::USUAL_SUBGROUP_SIZE);
        let read = |name: &str| {
            let buffer = plan.find_resource(name).unwrap_or_else(|| panic!("no {name}"));
            of_buffer(&plan, plan.order().next().expect("a pass"), buffer)
        };
        assert_eq!(read("order.keys#0"), ReadAs::Uint);
        assert_eq!(read("scene.covariances"), ReadAs::Float);
    }
}
