//! Implements argument tables, which hold the bindings of a plan's passes.
//!
//! Metal has no descriptor sets: each argument is set in the encoder before its command. The tables are therefore
//! host-side lists of the arguments to set.

use crate::apple::gpu::MetalGpu;
use crate::apple::pipelines::Pipelines;
use crate::lower::ArgumentSlot;
use metal::{Buffer, Texture};
use splatgraph_api::BackendError;
use splatgraph_framework::ir::{Binding, Msl, PassId, ShaderStage};
use splatgraph_framework::plan::Plan;
use splatgraph_runtime::{BindingTarget, binding_copies};
use std::sync::Arc;

/// The argument tables of all passes of a plan.
pub struct ArgumentTables {
    /// Tables by pass, then by copy; empty for passes without bindings.
    tables: Vec<Vec<Table>>,
    /// By pass, each (binding, element) with the argument slots that it fills.
    places: Vec<Vec<((u32, u32), ArgumentSlot)>>,
}

#[derive(Clone, Default)]
pub(crate) struct Table {
    pub arguments: Vec<(ArgumentSlot, Argument)>,
    /// For each stage that needs buffer sizes, the sizes in bytes, by buffer index.
    pub sizes: Vec<(ShaderStage, [u32; Msl::MAX_BUFFERS as usize])>,
}

#[derive(Clone)]
pub(crate) enum Argument {
    /// A buffer, and the byte offset at which the argument starts.
    Buffer(Buffer, u64),
    Texture(Texture),
}

impl ArgumentTables {
    pub(crate) fn of(&self, pass: PassId, slot: usize) -> Option<&Table> {
        let copies = &self.tables[pass.index()];
        copies.get(slot.checked_rem(copies.len())?)
    }
}

impl splatgraph_runtime::Bindings<MetalGpu> for ArgumentTables {
    fn new(_: &Arc<MetalGpu>, plan: &Plan, pipelines: &Pipelines) -> Result<ArgumentTables, BackendError> {
        let mut tables = vec![Vec::new(); plan.passes.len()];
        let mut places = vec![Vec::new(); plan.passes.len()];
        for id in plan.order() {
            let pass = plan.pass(id);
            if pass.bindings.is_empty() {
                continue;
            }
            let all = pass.bindings.iter().flat_map(|binding| {
                let at = (binding.binding, binding.element);
                pipelines.lowered.places(id, binding).map(move |place| (at, place))
            });
            places[id.index()] = all.collect();
            tables[id.index()] = vec![Table::default(); binding_copies(plan, pass)];
        }
        Ok(ArgumentTables { tables, places })
    }

    fn write(
        &mut self,
        _: &MetalGpu,
        pass: PassId,
        copy: usize,
        binding: &Binding,
        target: BindingTarget<MetalGpu>,
    ) {
        let table = &mut self.tables[pass.index()][copy];
        let at = (binding.binding, binding.element);
        for &(_, place) in self.places[pass.index()].iter().filter(|(binding, _)| *binding == at) {
            let argument = match &target {
                BindingTarget::Buffer(buffer, bytes) => {
                    table.set_size(place, bytes.end - bytes.start);
                    Argument::Buffer(buffer.raw.clone(), bytes.start)
                }
                BindingTarget::Image(image) => Argument::Texture(image.raw.clone()),
            };
            match table.arguments.iter_mut().find(|(known, _)| *known == place) {
                Some((_, known)) => *known = argument,
                None => table.arguments.push((place, argument)),
            }
        }
    }

    /// Removes the objects from a pass's tables, which would keep them alive.
    fn clear(&mut self, pass: PassId) {
        self.tables[pass.index()].fill(Table::default());
    }
}

impl Table {
    fn set_size(&mut self, place: ArgumentSlot, bytes: u64) {
        if !place.sized {
            return;
        }
        let known = self.sizes.iter().position(|(stage, _)| *stage == place.stage);
        let known = known.unwrap_or_else(|| {
            self.sizes.push((place.stage, [0; Msl::MAX_BUFFERS as usize]));
            self.sizes.len() - 1
        });
        // The limits keep bindings below 4 GiB.
        self.sizes[known].1[place.index as usize] = u32::try_from(bytes).unwrap_or(u32::MAX);
    }
}
