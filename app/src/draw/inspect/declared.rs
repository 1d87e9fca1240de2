//! Finds the type that shaders declare for the elements of a buffer, from their SPIR-V.

use super::contents::ReadAs;
use splatgraph_framework::ir::{Pass, PassId, ResourceId, Shader, Work};
use splatgraph_framework::plan::Plan;
use std::collections::HashMap;

/// Deepest nesting of types that is followed; SPIR-V of a compiler nests far less.
const DEPTH: usize = 16;

const TYPE_INT: u32 = 21;
const TYPE_FLOAT: u32 = 22;
const TYPE_VECTOR: u32 = 23;
const TYPE_MATRIX: u32 = 24;
const TYPE_ARRAY: u32 = 28;
const TYPE_RUNTIME_ARRAY: u32 = 29;
const TYPE_STRUCT: u32 = 30;
const TYPE_POINTER: u32 = 32;
const VARIABLE: u32 = 59;
const DECORATE: u32 = 71;
const BINDING: u32 = 33;

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
    let binding = pass.bindings.iter().find(|binding| binding.resource == buffer)?;
    let shaders: Vec<&Shader> = match pass.work {
        Work::Dispatch { shader, .. } => vec![plan.shader(shader)],
        Work::Draw { vertex, fragment, .. } => vec![plan.shader(vertex), plan.shader(fragment)],
        _ => Vec::new(),
    };
    shaders.into_iter().find_map(|shader| {
        let types = Types::of(&shader.spirv);
        let block = types.blocks.get(&binding.binding)?;
        types.is_float(*block, DEPTH)
    })
}

#[derive(Default)]
struct Types {
    /// Types by id: opcode, and operands after the id.
    types: HashMap<u32, (u32, Vec<u32>)>,
    /// Type of the variable at each binding.
    blocks: HashMap<u32, u32>,
}

impl Types {
    fn of(spirv: &[u32]) -> Types {
        let (mut found, mut bindings, mut variables) = (Types::default(), HashMap::new(), HashMap::new());
        let mut rest = spirv.get(5..).unwrap_or_default();
        while let [first, ..] = *rest {
            let length = (first >> 16).max(1) as usize;
            let Some(operands) = rest.get(1..length) else { break };
            match (first & 0xffff, operands) {
                (DECORATE, &[id, BINDING, number]) => _ = bindings.insert(id, number),
                (VARIABLE, &[of, id, ..]) => _ = variables.insert(id, of),
                (opcode @ TYPE_INT..=TYPE_POINTER, [id, operands @ ..]) => {
                    found.types.insert(*id, (opcode, operands.to_vec()));
                }
                _ => {}
            }
            rest = &rest[length..];
        }
        let block = |(id, number)| Some((number, *variables.get(&id)?));
        found.blocks = bindings.into_iter().filter_map(block).collect();
        found
    }

    /// Returns true if a type consists of 32-bit floats; `None` for an unknown type.
    fn is_float(&self, id: u32, depth: usize) -> Option<bool> {
        let (opcode, operands) = self.types.get(&id)?;
        let of = |id: &u32| self.is_float(*id, depth.checked_sub(1)?);
        match (*opcode, operands.as_slice()) {
            (TYPE_FLOAT, [bits, ..]) => Some(*bits == 32),
            (TYPE_INT, _) => Some(false),
            (TYPE_VECTOR | TYPE_MATRIX | TYPE_ARRAY | TYPE_RUNTIME_ARRAY, [element, ..]) => of(element),
            (TYPE_POINTER, [_, pointee]) => of(pointee),
            (TYPE_STRUCT, members) => members.iter().map(of).try_fold(true, |all, one| Some(all && one?)),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::facts::{self, SceneFacts};
    use crate::draw::planner::Planner;

    #[test]
    fn buffers_of_vectors_are_read_as_floats_and_buffers_of_keys_as_integers() {
        let device = facts::portable_device(facts::USUAL_SUBGROUP_SIZE);
        let facts = facts::facts(&SceneFacts::NOMINAL, &device, facts::DEFAULT_SIZE);
        let plan = Planner::default().plan("splat", &[], &facts, &facts::nominal_catalog());
        let plan = plan.unwrap_or_else(|error| panic!("{error}"));
        let read = |name: &str| {
            let buffer = plan.find_resource(name).unwrap_or_else(|| panic!("no {name}"));
            of_buffer(&plan, plan.order().next().expect("a pass"), buffer)
        };
        assert_eq!(read("order.keys#0"), ReadAs::Uint);
        assert_eq!(read("scene.covariances"), ReadAs::Float);
    }
}
