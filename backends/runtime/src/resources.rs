//! Creates the buffers and images of one plan.
//!
//! A transient exists once, in the memory of its block. A uniform block that the host writes exists once per frame in
//! flight and stays mapped; so does the readback memory for statistics. A host buffer is created by the first frame
//! that supplies host bytes for it ([`crate::host_buffers`]). Planes of the scene are shared by all plans of the device
//! ([`crate::attributes`]), and histories by successive plans ([`crate::history`]).

use crate::aliasing::{self, Member, Transient};
use crate::attributes::{self, PlaneKey, Planes};
use crate::gpu::{BindingTarget, Buffer, BufferDesc, Gpu, Image, ImageDesc, Location};
use crate::host_buffers::HostBuffer;
use crate::once::UsedOnce;
use crate::outputs::SharedOutput;
use crate::usage::usage;
use splatgraph_api::{BackendError, FRAMES_IN_FLIGHT};
use splatgraph_framework::{ir::*, plan::*};
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::ops::Range;
use std::sync::Arc;

enum Held<G: Gpu> {
    Transient(Transient<G>),
    Plane(Arc<Buffer<G>>),
    PerFrame([Buffer<G>; FRAMES_IN_FLIGHT]),
    HostBuffer([HostBuffer<G>; FRAMES_IN_FLIGHT]),
    /// A buffer that was freed after the prologue, or never created; see [`crate::once`].
    Freed,
}

impl<G: Gpu> Held<G> {
    fn pieces(&self) -> Vec<&Arc<G::Memory>> {
        match self {
            Held::Transient(transient) => vec![transient.memory()],
            Held::Plane(buffer) => vec![&buffer.memory],
            Held::PerFrame(copies) => copies.iter().map(|copy| &copy.memory).collect(),
            Held::HostBuffer(copies) => copies.iter().filter_map(HostBuffer::memory).collect(),
            Held::Freed => Vec::new(),
        }
    }
}

pub(crate) struct Resources<G: Gpu> {
    held: Vec<Held<G>>,
}

impl<G: Gpu> Resources<G> {
    /// Creates the resources of `plan` that no other plan provides and that an executed pass uses.
    ///
    /// `taken` are results of other plans, and `once` are buffers that need not be created. `planes` are the planes on
    /// the device; `identity` is the scene's part of their keys. Missing planes are created and added to `planes`;
    /// their keys are returned, and the caller uploads their data.
    pub fn create(
        gpu: &Arc<G>,
        plan: &Plan,
        identity: u64,
        planes: &mut Planes<Buffer<G>>,
        (taken, once): (&BTreeMap<ResourceId, Arc<Buffer<G>>>, &UsedOnce),
    ) -> Result<(Resources<G>, Vec<PlaneKey>), BackendError> {
        let mut transients = transients(gpu, plan, taken, &once.unused)?;
        let (mut held, mut missing) = (Vec::new(), Vec::new());
        for (index, resource) in plan.resources.iter().enumerate() {
            let bytes = resource.bytes();
            let desc = BufferDesc { name: &resource.name, bytes, usage: usage(resource) };
            let per_frame = |location| -> Result<Held<G>, BackendError> {
                let copy = || Buffer::new(gpu, &desc, location);
                Ok(Held::PerFrame([copy()?, copy()?]))
            };
            let id = ResourceId(index as u32);
            held.push(match &resource.source {
                _ if once.unused.contains(&id) => Held::Freed,
                Source::Transient => match transients.remove(&id) {
                    Some(transient) => Held::Transient(transient),
                    None => unreachable!("every transient of a checked plan is in a block"),
                },
                Source::Scene { .. } => {
                    let Some(key) = attributes::key(resource, identity) else {
                        unreachable!("every plane of a checked plan is a buffer")
                    };
                    if !planes.contains_key(&key) {
                        missing.push(key.clone());
                        let location =
                            if once.freed.contains(&id) { once.location } else { Location::Device };
                        planes.insert(key.clone(), Arc::new(Buffer::new(gpu, &desc, location)?));
                    }
                    Held::Plane(planes[&key].clone())
                }
                Source::HostBuffer { .. } => Held::HostBuffer(Default::default()),
                Source::Frame { .. } | Source::Live => per_frame(Location::Upload)?,
                Source::Readback => per_frame(Location::Readback)?,
            });
        }
        Ok((Resources { held }, missing))
    }

    pub fn image(&self, id: ResourceId) -> Option<&Image<G>> {
        match &self.held[id.index()] {
            Held::Transient(Transient::Image(image)) => Some(image),
            _ => None,
        }
    }

    /// Returns the buffer of a resource for the frame in this slot; panics as [`Resources::part`] does.
    pub fn buffer(&self, id: ResourceId, slot: usize) -> &Buffer<G> {
        self.part(id, slot).0
    }

    /// Returns the buffer of a resource for the frame in this slot, and the resource's byte range in it.
    ///
    /// # Panics
    /// Panics for an image, a freed buffer, or a host buffer without contents. [`crate::check::check`] guarantees that
    /// resources used as buffers are buffers, and [`crate::inputs::take_host_buffers`] that a frame has all its host
    /// buffers.
    pub fn part(&self, id: ResourceId, slot: usize) -> (&Buffer<G>, Range<u64>) {
        let buffer = match &self.held[id.index()] {
            Held::Transient(Transient::Buffer(buffer)) | Held::Plane(buffer) => buffer,
            Held::PerFrame(copies) => &copies[slot],
            Held::HostBuffer(copies) => match copies[slot].binding() {
                Some(held) => return held,
                None => unreachable!("a frame is not recorded before it has all its host buffers"),
            },
            Held::Transient(Transient::Image(_)) => {
                unreachable!("images are not used as buffers in a checked plan")
            }
            Held::Freed => unreachable!("no pass that runs uses it"),
        };
        (buffer, 0..buffer.bytes)
    }

    /// Returns the binding target of a resource for the frame in this slot. Panics as [`Resources::part`] does, except
    /// for an image.
    pub fn binding_target(&self, id: ResourceId, slot: usize) -> BindingTarget<'_, G> {
        match self.image(id) {
            Some(image) => BindingTarget::Image(image),
            None => {
                let (buffer, range) = self.part(id, slot);
                BindingTarget::Buffer(buffer, range)
            }
        }
    }

    pub fn host_buffer_mut(&mut self, id: ResourceId, slot: usize) -> Option<&mut HostBuffer<G>> {
        match &mut self.held[id.index()] {
            Held::HostBuffer(copies) => Some(&mut copies[slot]),
            _ => None,
        }
    }

    /// Takes the shared outputs that the recorded frame in this slot reads. The caller keeps them until it completes.
    pub fn take_outputs(&mut self, slot: usize) -> impl Iterator<Item = Arc<SharedOutput<G>>> {
        self.held.iter_mut().filter_map(move |held| match held {
            Held::HostBuffer(copies) => copies[slot].take_output(),
            _ => None,
        })
    }

    pub fn transient(&self, id: ResourceId) -> Option<&Transient<G>> {
        match &self.held[id.index()] {
            Held::Transient(transient) => Some(transient),
            _ => None,
        }
    }

    /// Drops this plan's reference to a buffer that its passes no longer use. Another plan may still hold it.
    pub fn free(&mut self, id: ResourceId) {
        self.held[id.index()] = Held::Freed;
    }

    pub fn is_freed(&self, id: ResourceId) -> bool {
        matches!(self.held[id.index()], Held::Freed)
    }

    pub fn rebind(&mut self, id: ResourceId, transient: Transient<G>) {
        self.held[id.index()] = Held::Transient(transient);
    }

    /// Returns the mapped bytes of a resource with a copy per frame; `None` for other resources and for host buffers.
    pub fn mapped_mut(&mut self, id: ResourceId, slot: usize) -> Option<&mut [u8]> {
        match &mut self.held[id.index()] {
            Held::PerFrame(copies) => Some(copies[slot].mapped_mut()),
            _ => None,
        }
    }

    pub fn pieces(&self) -> impl Iterator<Item = &Arc<G::Memory>> {
        self.held.iter().flat_map(Held::pieces)
    }

    /// Lists names and allocated bytes: the plan's own resources, then the scene's planes. Resources that share memory
    /// form one entry.
    pub fn memory(&self, plan: &Plan) -> Vec<(String, u64)> {
        use crate::gpu::Memory;
        let mut entries: Vec<(String, u64)> = Vec::new();
        let mut seen = HashMap::new();
        let is_plane = |index: &usize| matches!(self.held[*index], Held::Plane(_));
        let (planes, own): (Vec<_>, Vec<_>) = (0..self.held.len()).partition(is_plane);
        for index in own.into_iter().chain(planes) {
            let name = &plan.resources[index].name;
            let pieces = self.held[index].pieces();
            let Some(first) = pieces.first().map(|piece| Arc::as_ptr(piece)) else { continue };
            match seen.get(&first) {
                Some(&entry) => {
                    let (names, _): &mut (String, u64) = &mut entries[entry];
                    *names = format!("{names} + {name}");
                }
                None => {
                    seen.insert(first, entries.len());
                    entries.push((name.clone(), pieces.iter().map(|piece| piece.bytes()).sum()));
                }
            }
        }
        entries
    }
}

/// Returns the transients: the reused ones (`taken`), and new members of all other blocks except those of `unused`
/// resources. Blocks of reused and unused resources have no other members.
fn transients<G: Gpu>(
    gpu: &Arc<G>,
    plan: &Plan,
    taken: &BTreeMap<ResourceId, Arc<Buffer<G>>>,
    unused: &BTreeSet<ResourceId>,
) -> Result<HashMap<ResourceId, Transient<G>>, BackendError> {
    let mut all: HashMap<_, _> =
        taken.iter().map(|(id, buffer)| (*id, Transient::Buffer(buffer.clone()))).collect();
    let is_left = |id: &ResourceId| taken.contains_key(id) || unused.contains(id);
    for block in plan.blocks.iter().filter(|block| !block.aliases.iter().any(is_left)) {
        let mut members = Vec::new();
        for &id in &block.aliases {
            let resource = plan.resource(id);
            if let Shape::Image { format, .. } = resource.shape {
                check_format(gpu, plan, id, format)?;
            }
            members.push(member(plan, id));
        }
        all.extend(block.aliases.iter().copied().zip(aliasing::create_block(gpu, &members)?));
    }
    Ok(all)
}

/// Describes a transient resource to create, or the copy of one.
pub(crate) fn member(plan: &Plan, id: ResourceId) -> Member<'_> {
    let resource = plan.resource(id);
    let restored = if plan.is_state(id) { Usage::COPY_TARGET } else { Usage::empty() };
    let (name, usage) = (resource.name.as_str(), usage(resource) | restored);
    match resource.shape {
        Shape::Image { format, width, height } => {
            Member::Image(ImageDesc { name, format, size: (width, height), usage })
        }
        Shape::Buffer { .. } => Member::Buffer(BufferDesc { name, bytes: resource.bytes(), usage }),
    }
}

fn check_format<G: Gpu>(
    gpu: &Arc<G>,
    plan: &Plan,
    id: ResourceId,
    format: Format,
) -> Result<(), BackendError> {
    let (resource, support) = (plan.resource(id), gpu.format_support(format));
    for (used, supported, action) in [
        (resource.usage.contains(Usage::STORAGE), support.storage, "store to it"),
        (
            resource.usage.intersects(Usage::COLOR_TARGET | Usage::DEPTH_TARGET),
            support.target,
            "draw into it",
        ),
        (is_blended(plan, id), support.blend, "blend into it"),
    ] {
        if used && !supported {
            return Err(BackendError::Unsupported(format!(
                "image `{}` has the format {format:?}, and this device cannot {action}",
                resource.name
            )));
        }
    }
    Ok(())
}

fn is_blended(plan: &Plan, image: ResourceId) -> bool {
    plan.passes.iter().any(|pass| match &pass.work {
        Work::Draw { targets, .. } => targets.iter().any(|t| t.image == image && t.blend != Blend::Replace),
        _ => false,
    })
}
