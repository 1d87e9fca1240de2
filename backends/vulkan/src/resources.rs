//! The buffers and images of one plan.
//!
//! Transients are single. A uniform block that the host writes exists once per frame in flight, mapped for good.
//! Planes of the scene are shared: what an earlier plan uploaded from the same data is used again.

use crate::gpu::Gpu;
use crate::lower;
use crate::memory::{Buffer, Image};
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

enum Held {
    Buffer(Buffer),
    Plane(Arc<Buffer>),
    PerFrame([Buffer; FRAMES_IN_FLIGHT]),
    Image(Image),
}

pub(crate) struct Resources {
    held: Vec<Held>,
    /// The planes among them.
    pub planes: Planes,
}

impl Resources {
    /// Creates what `plan` needs. The second part of the answer is the planes that are new and want their data.
    pub fn new(
        gpu: &Arc<Gpu>,
        plan: &Plan,
        identity: u64,
        kept: &Planes,
    ) -> Result<(Resources, Vec<PlaneKey>), BackendError> {
        let mut resources = Resources { held: Vec::new(), planes: Planes::new() };
        let mut missing = Vec::new();
        for (index, resource) in plan.resources.iter().enumerate() {
            let name = resource.name.as_str();
            let usage = lower::buffer_usage(resource);
            let held = match (&resource.shape, &resource.source) {
                (&Shape::Image { format, width, height }, _) => {
                    let extent = vk::Extent2D { width, height };
                    let blended = is_blended(plan, ResourceId(index as u32));
                    Held::Image(Image::new(gpu, name, format, extent, resource.usage, blended)?)
                }
                (Shape::Buffer { .. }, Source::Scene { attribute, plane }) => {
                    let (attribute, plane, bytes) = (attribute.clone(), *plane, resource.bytes());
                    let key = PlaneKey { identity, attribute, plane, bytes };
                    let found = resources.planes.get(&key).or_else(|| kept.get(&key)).cloned();
                    let buffer = match found {
                        Some(buffer) => buffer,
                        None => {
                            missing.push(key.clone());
                            Arc::new(Buffer::on_device(gpu, name, bytes, usage)?)
                        }
                    };
                    resources.planes.insert(key, buffer.clone());
                    Held::Plane(buffer)
                }
                (Shape::Buffer { .. }, Source::Frame { .. } | Source::Live) => {
                    let copy = || Buffer::to_device(gpu, name, resource.bytes(), usage);
                    Held::PerFrame([copy()?, copy()?])
                }
                (Shape::Buffer { .. }, Source::Transient) => {
                    Held::Buffer(Buffer::on_device(gpu, name, resource.bytes(), usage)?)
                }
            };
            resources.held.push(held);
        }
        Ok((resources, missing))
    }

    /// The image behind a resource, if it is one.
    pub fn image(&self, id: ResourceId) -> Option<&Image> {
        match &self.held[id.index()] {
            Held::Image(image) => Some(image),
            _ => None,
        }
    }

    /// The buffer behind a resource, for the frame in this slot.
    ///
    /// # Panics
    /// On an image. [`crate::limits::check`] made sure that what is used as a buffer is one.
    pub fn buffer(&self, id: ResourceId, slot: usize) -> &Buffer {
        match &self.held[id.index()] {
            Held::Buffer(buffer) => buffer,
            Held::Plane(buffer) => buffer,
            Held::PerFrame(copies) => &copies[slot],
            Held::Image(_) => unreachable!("images are not used as buffers in a plan that was checked"),
        }
    }

    /// The host's view of a uniform block, for the frame in this slot; none for resources of other kinds.
    pub fn uniform_mut(&mut self, id: ResourceId, slot: usize) -> Option<&mut [u8]> {
        match &mut self.held[id.index()] {
            Held::PerFrame(copies) => Some(copies[slot].mapped_mut()),
            _ => None,
        }
    }

    /// Names and allocated bytes: what the plan owns, then the planes of the scene.
    pub fn memory(&self, plan: &Plan) -> Vec<(String, u64)> {
        let (mut own, mut planes) = (Vec::new(), Vec::new());
        for (held, resource) in self.held.iter().zip(&plan.resources) {
            let name = resource.name.clone();
            match held {
                Held::Buffer(buffer) => own.push((name, buffer.allocated_bytes())),
                Held::Image(image) => own.push((name, image.allocated_bytes())),
                Held::PerFrame(copies) => own.push((name, copies.iter().map(Buffer::allocated_bytes).sum())),
                Held::Plane(buffer) => planes.push((name, buffer.allocated_bytes())),
            }
        }
        own.append(&mut planes);
        own
    }
}

/// Some draw blends into the image.
fn is_blended(plan: &Plan, image: ResourceId) -> bool {
    plan.passes.iter().any(|pass| match &pass.work {
        Work::Draw { targets, .. } => targets.iter().any(|t| t.image == image && t.blend != Blend::Replace),
        _ => false,
    })
}
