//! Finds the names and types that shaders declare for the words of a buffer.

use super::contents::ReadAs;
use crate::io::image::ElementField;
use splatgraph_framework::ir::{
    Member, MemberKind, Pass, PassId, ReflectedBinding, ReflectedKind, ResourceId,
};
use splatgraph_framework::plan::Plan;

/// A word of a buffer's elements, or a channel of an image.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Channel {
    /// Name in the shader, such as `root.x`. Empty for padding, channels of images, arrays of scalars, and unknown
    /// words.
    pub name: String,
    /// Declared type; `Uint` for images, whose format determines it.
    pub read: ReadAs,
}

/// Returns the channels of a buffer whose elements have `words` words.
///
/// The inspected pass decides, or, if it does not bind the buffer, the first pass that does. Words have names if the
/// shader's block is an array of elements of this size, or if it is a single element. Otherwise, they have the type of
/// the block's scalars if these are all floats or signed integers.
pub(super) fn of_buffer(plan: &Plan, after: PassId, buffer: ResourceId, words: usize) -> Vec<Channel> {
    let mut passes = [after].into_iter().chain(plan.order()).map(|id| plan.pass(id));
    let block = passes.find_map(|pass| block_of(plan, pass, buffer));
    let read = block.map_or(ReadAs::Uint, |block| read_as(block.scalar));
    let mut channels = vec![Channel { name: String::new(), read }; words];
    let bytes = 4 * words as u64;
    let is_element = |block: &&ReflectedBinding| match block.kind {
        ReflectedKind::StorageBuffer { stride: Some(stride), fixed_bytes: 0 } => u64::from(stride) == bytes,
        ReflectedKind::StorageBuffer { stride: None, fixed_bytes } => u64::from(fixed_bytes) <= bytes,
        _ => false,
    };
    for Member { name, offset, kind, .. } in block.filter(is_element).iter().flat_map(|block| &block.words) {
        if let Some(channel) = channels.get_mut(*offset as usize / 4) {
            *channel = Channel { name: name.clone(), read: read_as(*kind) };
        }
    }
    channels
}

fn read_as(scalar: MemberKind) -> ReadAs {
    match scalar {
        MemberKind::Float => ReadAs::Float,
        MemberKind::Int => ReadAs::Int,
        MemberKind::Uint | MemberKind::Other => ReadAs::Uint,
    }
}

/// Returns the block to which a pass binds the buffer; `None` without one.
fn block_of<'a>(plan: &'a Plan, pass: &Pass, buffer: ResourceId) -> Option<&'a ReflectedBinding> {
    let bound = pass.bindings.iter().find(|binding| binding.resource == buffer)?;
    let shaders = pass.work.shaders().into_iter().map(|id| plan.shader(*id));
    let mut blocks = shaders.flat_map(|shader| &shader.reflection.bindings);
    blocks.find(|block| block.binding == bound.binding)
}

/// Returns the type of all channels; `None` if they differ.
pub(super) fn only_type(channels: &[Channel]) -> Option<ReadAs> {
    let first = channels.first()?.read;
    channels.iter().all(|channel| channel.read == first).then_some(first)
}

/// Joins the components of vectors to fields of a structured array.
pub(super) fn fields(channels: &[Channel]) -> Vec<ElementField> {
    let mut fields: Vec<ElementField> = Vec::new();
    let mut firsts = Vec::new();
    for channel in channels {
        let split = channel.name.rsplit_once('.').filter(|(_, part)| ["x", "y", "z", "w"].contains(part));
        let name = split.map_or(channel.name.as_str(), |(vector, _)| vector);
        let kind = match channel.read {
            _ if name.is_empty() => "|V",
            ReadAs::Uint => "<u",
            ReadAs::Int => "<i",
            ReadAs::Float => "<f",
        };
        match fields.last_mut().filter(|last| last.kind == kind && last.name == name) {
            Some(last) => last.words += 1,
            None => {
                fields.push(ElementField { name: name.into(), kind, words: 1 });
                firsts.push(channel.name.as_str());
            }
        }
    }
    // A struct can have members `x` and `y` of different types.
    for (field, first) in fields.iter_mut().zip(firsts).filter(|(field, _)| field.words == 1) {
        field.name = first.into();
    }
    fields
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
            only_type(&of_buffer(&plan, plan.order().next().expect("a pass"), buffer, 1))
        };
        assert_eq!(read("order.keys#0"), Some(ReadAs::Uint));
        assert_eq!(read("scene.covariances"), Some(ReadAs::Float));
    }
}
