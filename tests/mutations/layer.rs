//! Predicts which mistakes in barriers synchronization validation reports.
//!
//! The blind spots are those of Khronos validation 1.3.239. The oracle lists the violations of a mutant; each names two
//! accesses and what is missing between them. The layer should report a violation unless it is blind to one of the
//! accesses, or to the pair. The layer's silence about a mutant is never used as evidence.

use splatgraph_api::FRAMES_IN_FLIGHT;
use splatgraph_framework::ir::{
    Accesses, Binding, DescriptorKind, DrawCall, Groups, PassId, ResourceId, ShaderId, Shape, Stages, Work,
};
use splatgraph_framework::plan::Plan;
use splatgraph_vulkan::sync::Barriers;
use splatgraph_vulkan::sync::model::{Actor, Missing, Replay, Violation, ViolationKind, What, When, replay};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Blind {
    /// The layer does not track attachments of dynamic rendering, nor their layouts.
    Attachments,
    /// It does not report a shader write after a shader write.
    ShaderWrites,
    /// A binding that a shader both loads from and stores to counts only as a write.
    LoadsBesideStores,
    /// A binding that only atomics write counts only as a read.
    Atomics,
    /// It does not track reads and writes of the host.
    Host,
    /// Accesses of a frame that the host waited for count as complete, even if not made available or visible.
    Fences,
    /// A write made visible to one access counts as visible to everything that waits for that access.
    SeenByAnother,
    /// A fill counts as a copy, and the backend translates both `CLEAR` and `COPY` to both stages. Each implies the
    /// other.
    FillsAreCopies,
    /// A buffer and an image share memory. For the layer, images have separate addresses.
    BesideImages,
    /// It does not track whether memory has contents.
    Contents,
}

impl fmt::Display for Blind {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self {
            Blind::Attachments => "attachments",
            Blind::ShaderWrites => "write after write of shaders",
            Blind::LoadsBesideStores => "loads beside stores",
            Blind::Atomics => "atomics' writes",
            Blind::Host => "host",
            Blind::Fences => "fences",
            Blind::SeenByAnother => "seen by another reader",
            Blind::FillsAreCopies => "fills are copies",
            Blind::BesideImages => "buffers beside images",
            Blind::Contents => "contents",
        })
    }
}

/// An access as the layer sees it.
#[derive(Clone, Copy, PartialEq)]
struct View {
    /// Stage of the access; empty for a layout change.
    stage: Stages,
    access: Accesses,
    writes: bool,
}

impl View {
    fn shader_write(self) -> bool {
        self.writes && self.access == Accesses::STORAGE_WRITE
    }

    /// Returns true if the layer reports these two accesses when `missing` is missing between them.
    fn conflicts(self, other: View, missing: Missing) -> bool {
        let pair = self.writes || other.writes;
        let lacks = match missing {
            Missing::Order => true,
            Missing::Availability => self.writes,
            Missing::Visibility(stage, access) => {
                self.writes && (stage, access) == (other.stage, other.access)
            }
            Missing::Layout { .. } | Missing::Contents => false,
        };
        pair && lacks && !(self.shader_write() && other.shader_write())
    }
}

pub struct Layer<'a> {
    plan: &'a Plan,
    /// For each shader, the bindings that it stores to other than by atomics.
    stores: Vec<BTreeSet<u32>>,
}

impl Layer<'_> {
    pub fn new(plan: &Plan) -> Layer<'_> {
        Layer { plan, stores: plan.shaders.iter().map(|shader| stores(&shader.spirv)).collect() }
    }

    /// Predicts whether the layer reports the mutant `mutant` within `frames` frames. Returns the reason if it does
    /// not.
    pub fn ought_to_see(&self, mutant: &Barriers, frames: u32) -> Result<(), Blind> {
        let (plan, mutant) = with_fills_as_copies(self.plan, mutant);
        let violations = replay(&plan, &mutant, &Replay { frames, ..Replay::default() });
        let blind: Option<BTreeSet<Blind>> =
            violations.iter().map(|violation| self.sees(&mutant, violation).err()).collect();
        // The oracle objects to every mutant. If it does not object here, it is because fills are treated as copies.
        blind.map_or(Ok(()), |blind| Err(blind.first().copied().unwrap_or(Blind::FillsAreCopies)))
    }

    fn sees(&self, mutant: &Barriers, violation: &Violation) -> Result<(), Blind> {
        let Violation { kind, first, second, resource, through, missing, .. } = *violation;
        match (kind, second.what) {
            (ViolationKind::Unwritten, _) => return Err(Blind::Contents),
            (ViolationKind::Layout, What::Pass(pass)) if self.attaches(pass, resource) => {
                return Err(Blind::Attachments);
            }
            (ViolationKind::Layout, _) => return Ok(()),
            _ => {}
        }
        let Some(first) = first else { return Err(Blind::Contents) };
        if second.when.frame().saturating_sub(first.when.frame()) >= FRAMES_IN_FLIGHT as u32 {
            return Err(Blind::Fences);
        }
        let is_image = |id| matches!(self.plan.resource(id).shape, Shape::Image { .. });
        if is_image(through.unwrap_or(resource)) != is_image(resource) {
            return Err(Blind::BesideImages);
        }
        let sides = [(first, through.unwrap_or(resource)), (second, resource)];
        let [before, after] = sides.map(|(actor, resource)| self.views(actor.what, resource));
        if before.iter().any(|a| after.iter().any(|b| a.conflicts(*b, missing))) {
            let settled = kind == ViolationKind::ReadAfterWrite && missing != Missing::Order;
            let settled = settled && self.seen_between(mutant, first, second, resource, &after);
            return if settled { Err(Blind::SeenByAnother) } else { Ok(()) };
        }
        let any = |test: &dyn Fn(PassId, ResourceId) -> bool| {
            sides
                .iter()
                .any(|(actor, resource)| matches!(actor.what, What::Pass(pass) if test(pass, *resource)))
        };
        Err(if any(&|pass, resource| self.attaches(pass, resource)) {
            Blind::Attachments
        } else if first.what == What::Host
            || second.what == What::Host
            || any(&|pass, _| self.plan.pass(pass).work == Work::Host)
        {
            Blind::Host
        } else if before.iter().any(|v| v.shader_write()) && after.iter().any(|v| v.shader_write()) {
            Blind::ShaderWrites
        } else if missing == Missing::Visibility(Stages::COMPUTE, Accesses::STORAGE_READ) {
            Blind::LoadsBesideStores
        } else {
            Blind::Atomics
        })
    }

    /// Returns true if `second` waits for a pass between the two, in the same frame, that reads the resource.
    fn seen_between(
        &self,
        mutant: &Barriers,
        first: Actor,
        second: Actor,
        resource: ResourceId,
        after: &[View],
    ) -> bool {
        let step = |actor| match actor {
            Actor { when: When::Frame(frame), what: What::Pass(pass) } => {
                Some((frame, self.plan.frame.iter().position(|id| *id == pass)?))
            }
            _ => None,
        };
        let (Some((frame, first)), Some((same, second))) = (step(first), step(second)) else { return false };
        let waits = |reader: usize, at: Stages| {
            let passes = self.plan.frame[reader + 1..=second].iter();
            // A wait for indirect reads may name a later stage of the same command.
            let with_later = if at == Stages::INDIRECT { at | Stages::COMPUTE | Stages::VERTEX } else { at };
            let target = |stages: Stages| after.iter().all(|view| stages.contains(view.stage));
            passes
                .flat_map(|pass| mutant.at(Some(*pass)))
                .any(|b| b.masks.source_stages.intersects(with_later) && target(b.masks.target_stages))
        };
        frame == same
            && (first + 1..second).any(|reader| {
                let views = self.views(What::Pass(self.plan.frame[reader]), resource);
                views.iter().any(|view| !view.writes && waits(reader, view.stage))
            })
    }

    fn attaches(&self, pass: PassId, image: ResourceId) -> bool {
        match &self.plan.pass(pass).work {
            Work::Draw { targets, depth, .. } => {
                targets.iter().any(|target| target.image == image)
                    || depth.is_some_and(|depth| depth.image == image)
            }
            _ => false,
        }
    }

    /// Returns the accesses of an actor to a resource, as the layer sees them.
    fn views(&self, actor: What, resource: ResourceId) -> Vec<View> {
        let view = |stage, access: Accesses| View { stage, access, writes: access.writes() };
        let pass = match actor {
            What::Host => return Vec::new(),
            What::Transition { .. } => {
                return vec![View { stage: Stages::empty(), access: Accesses::empty(), writes: true }];
            }
            What::Pass(pass) => self.plan.pass(pass),
        };
        let mut views = Vec::new();
        let mut shader = |stage: Stages, shader: ShaderId| {
            for reflected in &self.plan.shader(shader).reflection.bindings {
                let bound = |b: &&Binding| is_bound(b, reflected.binding, resource);
                for binding in pass.bindings.iter().filter(bound) {
                    let stored = self.stores[shader.index()].contains(&reflected.binding);
                    let access = match binding.kind {
                        DescriptorKind::UniformBuffer => Accesses::UNIFORM_READ,
                        _ if stored => Accesses::STORAGE_WRITE,
                        _ => Accesses::STORAGE_READ,
                    };
                    views.push(view(stage, access));
                }
            }
        };
        match &pass.work {
            Work::Dispatch { shader: id, groups } => {
                shader(Stages::COMPUTE, *id);
                if matches!(groups, Groups::Indirect { buffer, .. } if *buffer == resource) {
                    views.push(view(Stages::INDIRECT, Accesses::INDIRECT_READ));
                }
            }
            Work::Draw { vertex, fragment, call, .. } => {
                shader(Stages::VERTEX, *vertex);
                shader(Stages::FRAGMENT, *fragment);
                if matches!(call, DrawCall::Indirect { buffer, .. } if *buffer == resource) {
                    views.push(view(Stages::INDIRECT, Accesses::INDIRECT_READ));
                }
            }
            Work::Host => {}
            _ => {
                for touch in pass.uses.iter().filter(|touch| touch.resource == resource) {
                    views.extend(
                        touch
                            .stages
                            .iter()
                            .flat_map(|stage| touch.accesses.iter().map(move |a| view(stage, a))),
                    );
                }
            }
        }
        views
    }
}

fn is_bound(binding: &Binding, number: u32, resource: ResourceId) -> bool {
    binding.binding == number && binding.resource == resource
}

/// Returns the plan and its barriers as the layer sees them. Fills run at the copy stage, and `CLEAR` means that stage.
fn with_fills_as_copies(plan: &Plan, barriers: &Barriers) -> (Plan, Barriers) {
    let (mut plan, mut barriers) = (plan.clone(), barriers.clone());
    let rename = |stages: &mut Stages| {
        if stages.contains(Stages::CLEAR) {
            stages.remove(Stages::CLEAR);
            stages.insert(Stages::COPY);
        }
    };
    plan.passes.iter_mut().flat_map(|pass| &mut pass.uses).for_each(|touch| rename(&mut touch.stages));
    for barrier in barriers.before.iter_mut().flatten().chain(&mut barriers.handover) {
        rename(&mut barrier.masks.source_stages);
        rename(&mut barrier.masks.target_stages);
    }
    (plan, barriers)
}

/// Returns the bindings that a SPIR-V module stores to. Bindings that only atomics write are left out. (SPIR-V 1.6,
/// section 3.)
fn stores(spirv: &[u32]) -> BTreeSet<u32> {
    const HEADER: usize = 5;
    const LOAD: u32 = 61;
    const STORE: u32 = 62;
    const ACCESS_CHAIN: u32 = 65;
    const IN_BOUNDS_ACCESS_CHAIN: u32 = 66;
    const DECORATE: u32 = 71;
    const COPY_OBJECT: u32 = 83;
    const IMAGE_WRITE: u32 = 99;
    const BINDING: u32 = 33;
    let (mut bindings, mut bases, mut stored) = (BTreeMap::new(), BTreeMap::new(), Vec::new());
    let mut rest = spirv.get(HEADER..).unwrap_or_default();
    while let [first, operands @ ..] = rest {
        let length = (first >> 16).max(1) as usize;
        match (first & 0xffff, operands) {
            (DECORATE, [id, BINDING, binding, ..]) => drop(bindings.insert(*id, *binding)),
            (LOAD | ACCESS_CHAIN | IN_BOUNDS_ACCESS_CHAIN | COPY_OBJECT, [_, result, base, ..]) => {
                bases.insert(*result, *base);
            }
            (STORE | IMAGE_WRITE, [target, ..]) => stored.push(*target),
            _ => {}
        }
        rest = rest.get(length..).unwrap_or_default();
    }
    let origin = |mut id: u32| {
        while let Some(base) = bases.get(&id) {
            id = *base;
        }
        bindings.get(&id).copied()
    };
    stored.into_iter().filter_map(origin).collect()
}
