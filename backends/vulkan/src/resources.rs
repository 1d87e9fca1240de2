//! The buffers and images of one plan.
//!
//! Transients are single, and stand in the plan's blocks. A uniform block that the host writes exists once per frame in
//! flight, mapped for good, and so does the memory that the host reads statistics from. Planes of the scene are shared:
//! what an earlier plan uploaded from the same data is used again. So are histories ([`crate::history`]).

use crate::blocks::{self, Bound, Unbound};
use crate::gpu::Gpu;
use crate::history::{self, History};
use crate::lower;
use crate::memory::{Buffer, Image, Memory, UnboundBuffer, UnboundImage, check_format};
use ash::vk;
use splatgraph_api::{BackendError, FRAMES_IN_FLIGHT};
use splatgraph_framework::plan::*;
use std::collections::HashMap;
use std::sync::Arc;

/// What tells one plane of scene data from another.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) struct PlaneKey {
    /// [`splatgraph_api::SceneData::identity`].
    pub identity: u64,
    pub attribute: String,
    pub plane: u32,
    pub bytes: u64,
}

/// Planes that are on the device.
pub(crate) type Planes = HashMap<PlaneKey, Arc<Buffer>>;

/// What the plan before leaves to the next.
#[derive(Default)]
pub(crate) struct Estate {
    pub planes: Planes,
    pub histories: Vec<History>,
}

enum Held {
    Bound(Bound),
    Plane(Arc<Buffer>),
    PerFrame([Buffer; FRAMES_IN_FLIGHT]),
}

pub(crate) struct Resources {
    held: Vec<Held>,
    /// The planes among them.
    pub planes: Planes,
}

/// Resources, and what is still to be done about them.
pub(crate) struct Created {
    pub resources: Resources,
    /// Planes that are new and want their data.
    pub missing: Vec<PlaneKey>,
    /// Resources that go on from a former plan's history, with the layouts that images were left in.
    pub carried: Vec<(ResourceId, vk::ImageLayout)>,
}

impl Resources {
    /// Creates what `plan` needs.
    pub fn create(
        gpu: &Arc<Gpu>,
        plan: &Plan,
        identity: u64,
        estate: &Estate,
    ) -> Result<Created, BackendError> {
        let (mut planes, mut missing) = (Planes::new(), Vec::new());
        let (mut bound, carried) = transients(gpu, plan, identity, &estate.histories)?;
        let mut held = Vec::new();
        for (index, resource) in plan.resources.iter().enumerate() {
            let name = resource.name.as_str();
            let (bytes, usage) = (resource.bytes(), lower::buffer_usage(resource));
            held.push(match &resource.source {
                Source::Transient => match bound.remove(&ResourceId(index as u32)) {
                    Some(bound) => Held::Bound(bound),
                    None => unreachable!("every transient stands in a block of a plan that was checked"),
                },
                Source::Scene { attribute, plane } => {
                    let key = PlaneKey { identity, attribute: attribute.clone(), plane: *plane, bytes };
                    let found = planes.get(&key).or_else(|| estate.planes.get(&key)).cloned();
                    let buffer = match found {
                        Some(buffer) => buffer,
                        None => {
                            missing.push(key.clone());
                            Arc::new(Buffer::on_device(gpu, name, bytes, usage)?)
                        }
                    };
                    planes.insert(key, buffer.clone());
                    Held::Plane(buffer)
                }
                Source::Frame { .. } | Source::Given { .. } | Source::Live => {
                    let copy = || Buffer::to_device(gpu, name, bytes, usage);
                    Held::PerFrame([copy()?, copy()?])
                }
                Source::Readback => {
                    let copy = || Buffer::read_back(gpu, name, bytes, usage);
                    Held::PerFrame([copy()?, copy()?])
                }
            });
        }
        Ok(Created { resources: Resources { held, planes }, missing, carried })
    }

    /// The image behind a resource, if it is one.
    pub fn image(&self, id: ResourceId) -> Option<&Image> {
        match &self.held[id.index()] {
            Held::Bound(Bound::Image(image)) => Some(image),
            _ => None,
        }
    }

    /// The buffer behind a resource, for the frame in this slot.
    ///
    /// # Panics
    /// On an image. [`crate::limits::check`] made sure that what is used as a buffer is one.
    pub fn buffer(&self, id: ResourceId, slot: usize) -> &Buffer {
        match &self.held[id.index()] {
            Held::Bound(Bound::Buffer(buffer)) | Held::Plane(buffer) => buffer,
            Held::PerFrame(copies) => &copies[slot],
            Held::Bound(Bound::Image(_)) => {
                unreachable!("images are not used as buffers in a plan that was checked")
            }
        }
    }

    /// A transient's buffer or image, to be shared with another plan.
    pub fn bound(&self, id: ResourceId) -> Option<&Bound> {
        match &self.held[id.index()] {
            Held::Bound(bound) => Some(bound),
            _ => None,
        }
    }

    /// The host's view of what exists once per frame in flight; none for resources of other kinds.
    pub fn mapped_mut(&mut self, id: ResourceId, slot: usize) -> Option<&mut [u8]> {
        match &mut self.held[id.index()] {
            Held::PerFrame(copies) => Some(copies[slot].mapped_mut()),
            _ => None,
        }
    }

    /// Every piece of memory, some more than once.
    pub fn pieces(&self) -> impl Iterator<Item = &Arc<Memory>> {
        self.held.iter().flat_map(|held| match held {
            Held::Bound(bound) => vec![bound.memory()],
            Held::Plane(buffer) => vec![&buffer.memory],
            Held::PerFrame(copies) => copies.iter().map(|copy| &copy.memory).collect(),
        })
    }

    /// Names and allocated bytes: what the plan owns, then the planes of the scene. Resources that share memory are one
    /// entry.
    pub fn memory(&self, plan: &Plan) -> Vec<(String, u64)> {
        let mut entries: Vec<(String, u64)> = Vec::new();
        // Each piece of memory with its entry.
        let mut seen = HashMap::new();
        let is_plane = |index: &usize| matches!(self.held[*index], Held::Plane(_));
        let (planes, own): (Vec<_>, Vec<_>) = (0..self.held.len()).partition(is_plane);
        for index in own.into_iter().chain(planes) {
            let name = &plan.resources[index].name;
            let memory = match &self.held[index] {
                Held::Bound(bound) => bound.memory(),
                Held::Plane(buffer) => &buffer.memory,
                Held::PerFrame(copies) => {
                    entries.push((name.clone(), copies.iter().map(|copy| copy.memory.bytes()).sum()));
                    continue;
                }
            };
            match seen.get(&Arc::as_ptr(memory)) {
                Some(&entry) => {
                    let (names, _): &mut (String, u64) = &mut entries[entry];
                    *names = format!("{names} + {name}");
                }
                None => {
                    seen.insert(Arc::as_ptr(memory), entries.len());
                    entries.push((name.clone(), memory.bytes()));
                }
            }
        }
        entries
    }
}

type Transients = (HashMap<ResourceId, Bound>, Vec<(ResourceId, vk::ImageLayout)>);

/// The tenants of all blocks, and those of them that were taken over.
fn transients(
    gpu: &Arc<Gpu>,
    plan: &Plan,
    identity: u64,
    histories: &[History],
) -> Result<Transients, BackendError> {
    let (mut all, mut carried) = (HashMap::new(), Vec::new());
    for block in &plan.blocks {
        let mut tenants = Vec::new();
        for &id in &block.tenants {
            let resource = plan.resource(id);
            if let Shape::Image { format, .. } = resource.shape {
                check_format(gpu, &resource.name, format, resource.usage, is_blended(plan, id))?;
            }
            match history::find(plan, id, identity, histories) {
                Some(history) => {
                    carried.push((id, history.layout));
                    all.insert(id, history.bound.clone());
                }
                None => tenants.push((id, unbound(gpu, resource)?)),
            }
        }
        let (ids, tenants): (Vec<_>, Vec<_>) = tenants.into_iter().unzip();
        let names = ids.iter().map(|&id| plan.resource(id).name.as_str());
        let bound = blocks::bind(gpu, names.zip(tenants).collect())?;
        all.extend(ids.into_iter().zip(bound));
    }
    Ok((all, carried))
}

fn unbound(gpu: &Arc<Gpu>, resource: &Resource) -> Result<Unbound, BackendError> {
    let name = resource.name.as_str();
    Ok(match resource.shape {
        Shape::Image { format, width, height } => {
            let (extent, usage) = (vk::Extent2D { width, height }, lower::image_usage(resource.usage));
            Unbound::Image(UnboundImage::new(gpu, name, format, extent, usage)?)
        }
        Shape::Buffer { .. } => {
            let (bytes, usage) = (resource.bytes(), lower::buffer_usage(resource));
            Unbound::Buffer(UnboundBuffer::new(gpu, name, bytes, usage)?)
        }
    })
}

/// Some draw blends into the image.
fn is_blended(plan: &Plan, image: ResourceId) -> bool {
    plan.passes.iter().any(|pass| match &pass.work {
        Work::Draw { targets, .. } => targets.iter().any(|t| t.image == image && t.blend != Blend::Replace),
        _ => false,
    })
}
