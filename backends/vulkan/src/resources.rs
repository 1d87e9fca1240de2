//! The buffers and images of one plan.
//!
//! Transients are single, and stand in the plan's blocks. A uniform block that the host writes exists once per frame in
//! flight, mapped for good, and so does the memory that the host reads statistics from; a buffer that comes with a frame is
//! made when it comes ([`crate::given`]). Planes of the scene are shared by all
//! plans of the device ([`crate::planes`]), and histories by plans that follow one another ([`crate::history`]).

use crate::blocks::{self, Bound, Unbound};
use crate::given::Given;
use crate::gpu::Gpu;
use crate::lower;
use crate::memory::{Buffer, Image, Memory, UnboundBuffer, UnboundImage, check_format};
use crate::picture::PictureBuffer;
use crate::planes::{PlaneKey, Planes};
use ash::vk;
use splatgraph_api::{BackendError, FRAMES_IN_FLIGHT};
use splatgraph_framework::{ir::*, plan::*};
use std::collections::HashMap;
use std::sync::Arc;

enum Held {
    Bound(Bound),
    Plane(Arc<Buffer>),
    PerFrame([Buffer; FRAMES_IN_FLIGHT]),
    Given([Given; FRAMES_IN_FLIGHT]),
}

pub(crate) struct Resources {
    held: Vec<Held>,
}

/// Resources, and what is still to be done about them.
pub(crate) struct Created {
    pub resources: Resources,
    /// Planes that are new and want their data.
    pub missing: Vec<PlaneKey>,
}

impl Resources {
    /// Creates what `plan` needs, but for the `planes` that are there. Those that are not are added to them.
    pub fn create(
        gpu: &Arc<Gpu>,
        plan: &Plan,
        identity: u64,
        planes: &mut Planes,
    ) -> Result<Created, BackendError> {
        let mut bound = transients(gpu, plan)?;
        let (mut held, mut missing) = (Vec::new(), Vec::new());
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
                    if !planes.contains_key(&key) {
                        missing.push(key.clone());
                        planes.insert(key.clone(), Arc::new(Buffer::on_device(gpu, name, bytes, usage)?));
                    }
                    Held::Plane(planes[&key].clone())
                }
                Source::Given { .. } => Held::Given(Default::default()),
                Source::Frame { .. } | Source::Live => {
                    let copy = || Buffer::to_device(gpu, name, bytes, usage);
                    Held::PerFrame([copy()?, copy()?])
                }
                Source::Readback => {
                    let copy = || Buffer::read_back(gpu, name, bytes, usage);
                    Held::PerFrame([copy()?, copy()?])
                }
            });
        }
        Ok(Created { resources: Resources { held }, missing })
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
    /// As [`Resources::part`].
    pub fn buffer(&self, id: ResourceId, slot: usize) -> &Buffer {
        self.part(id, slot).0
    }

    /// The same, and how many of its bytes belong to the resource, from the first on.
    ///
    /// # Panics
    /// On an image, and on a buffer that comes with the frame before it has come. [`crate::limits::check`] made sure that what
    /// is used as a buffer is one, and [`crate::given::take`] that a frame has all its buffers.
    pub fn part(&self, id: ResourceId, slot: usize) -> (&Buffer, u64) {
        let buffer = match &self.held[id.index()] {
            Held::Bound(Bound::Buffer(buffer)) | Held::Plane(buffer) => buffer,
            Held::PerFrame(copies) => &copies[slot],
            Held::Given(given) => match given[slot].held() {
                Some(held) => return held,
                None => unreachable!("a frame is not recorded before it has all its buffers"),
            },
            Held::Bound(Bound::Image(_)) => {
                unreachable!("images are not used as buffers in a plan that was checked")
            }
        };
        (buffer, buffer.bytes)
    }

    /// What is held for the frame in this slot, if it comes with the frame.
    pub fn given_mut(&mut self, id: ResourceId, slot: usize) -> Option<&mut Given> {
        match &mut self.held[id.index()] {
            Held::Given(given) => Some(&mut given[slot]),
            _ => None,
        }
    }

    /// The pictures that the frame in this slot was given, once it is recorded. They must be kept until it is done.
    pub fn take_pictures(&mut self, slot: usize) -> Vec<Arc<PictureBuffer>> {
        let given = self.held.iter_mut().filter_map(|held| match held {
            Held::Given(given) => given[slot].let_go(),
            _ => None,
        });
        given.collect()
    }

    /// A transient's buffer or image, to be shared with another plan.
    pub fn bound(&self, id: ResourceId) -> Option<&Bound> {
        match &self.held[id.index()] {
            Held::Bound(bound) => Some(bound),
            _ => None,
        }
    }

    /// Gives a transient another plan's buffer or image in place of its own.
    pub fn rebind(&mut self, id: ResourceId, bound: Bound) {
        self.held[id.index()] = Held::Bound(bound);
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
            Held::Given(given) => given.iter().filter_map(Given::memory).collect(),
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
                Held::Given(given) => {
                    let bytes = given.iter().filter_map(Given::memory).map(|memory| memory.bytes()).sum();
                    // None before the first frame, and none where only pictures are given.
                    if bytes > 0 {
                        entries.push((name.clone(), bytes));
                    }
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

/// The tenants of all blocks.
fn transients(gpu: &Arc<Gpu>, plan: &Plan) -> Result<HashMap<ResourceId, Bound>, BackendError> {
    let mut all = HashMap::new();
    for block in &plan.blocks {
        let mut tenants = Vec::new();
        for &id in &block.tenants {
            let resource = plan.resource(id);
            if let Shape::Image { format, .. } = resource.shape {
                check_format(gpu, &resource.name, format, resource.usage, is_blended(plan, id))?;
            }
            tenants.push((resource.name.as_str(), unbound(gpu, resource)?));
        }
        all.extend(block.tenants.iter().copied().zip(blocks::bind(gpu, tenants)?));
    }
    Ok(all)
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
