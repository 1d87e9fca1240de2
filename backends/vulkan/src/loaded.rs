//! A plan that is ready to run: everything that is created for it, and nothing of any one frame.
//!
//! It is made beside the frames, on any thread ([`Loaded::new`]), and becomes the current one when it [follows](Loaded::follow)
//! the plan before it. Only then is it known what that one leaves behind.

use crate::error::api;
use crate::gpu::{Gpu, Owned};
use crate::history::{self, History};
use crate::limits;
use crate::lower::{self, Lowered, LoweredStep};
use crate::memory::{Buffer, Memory};
use crate::pipelines::{DescriptorSets, Pipelines};
use crate::planes;
use crate::resources::{Created, Resources};
use crate::upload::upload;
use ash::vk;
use splatgraph_api::{BackendError, FRAMES_IN_FLIGHT, Progress, SceneData};
use splatgraph_framework::ir::{ResourceId, Source, Work};
use splatgraph_framework::plan::Plan;
use std::sync::Arc;

/// Dropped in the order of its fields, when no frame of it is in flight.
pub(crate) struct Loaded {
    pub sets: DescriptorSets,
    pub pipelines: Pipelines,
    pub slots: [LoadedSlot; FRAMES_IN_FLIGHT],
    pub resources: Resources,
    pub lowered: Lowered,
    pub plan: Plan,
    /// Tells plans apart that are loaded one after another; see [`Loaded::follow`].
    pub number: u64,
    /// The scene's.
    identity: u64,
    /// The layouts that the frames submitted so far leave the images in.
    pub layouts: Vec<vk::ImageLayout>,
    /// Resources that go on from the history of a former plan, until the first frame was submitted.
    pub carried: Vec<ResourceId>,
    /// The next frame is the first: it runs the prologue.
    pub prologue_due: bool,
}

/// What the plan has once per frame in flight.
pub(crate) struct LoadedSlot {
    /// See [`queries`]; none where the queue has no timestamps.
    pub timestamps: Option<Owned<vk::QueryPool>>,
    /// The output's pixels; made when first asked for.
    pub output: Option<Buffer>,
}

/// Timestamps of a frame that runs `passes` passes: its start and its end, then before and after each pass.
pub(crate) fn queries(passes: usize) -> u32 {
    2 + 2 * passes as u32
}

impl Loaded {
    /// Makes a plan ready.
    pub fn new(
        gpu: &Arc<Gpu>,
        plan: Plan,
        scene: &dyn SceneData,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Loaded, BackendError> {
        limits::check(&plan, &gpu.limits)?;
        let identity = scene.identity();
        let lowered = lower::lower(&plan, &gpu.limits.subgroup);
        let pipelines = Pipelines::new(gpu, &plan, &lowered, progress)?;
        // Where planes are missing this may wait, so it comes after the pipelines.
        let (mut planes, turn) = gpu.planes.find(&planes::keys(&plan, identity));
        let Created { resources, missing } = Resources::create(gpu, &plan, identity, &mut planes)?;
        let sets = DescriptorSets::new(gpu, &plan, &lowered, &pipelines, &resources)?;
        let slots = [LoadedSlot::new(gpu, &plan)?, LoadedSlot::new(gpu, &plan)?];
        // Last, since it takes the longest: a plan that cannot run is refused before.
        upload(gpu, scene, &missing, &planes, progress)?;
        gpu.planes.add(missing.iter().map(|key| (key, &planes[key])));
        drop(turn);
        let layouts = vec![vk::ImageLayout::UNDEFINED; plan.resources.len()];
        Ok(Loaded {
            sets,
            pipelines,
            slots,
            resources,
            lowered,
            plan,
            number: 0,
            identity,
            layouts,
            carried: Vec::new(),
            prologue_due: true,
        })
    }

    /// Becomes the plan of this number, which goes on from the `histories` that the plan before has now, after the last frame
    /// of it that there will be. No frame of this one was submitted yet.
    pub fn follow(&mut self, gpu: &Gpu, number: u64, histories: &[History]) {
        self.number = number;
        for id in self.ids() {
            let Some(history) = history::find(&self.plan, id, self.identity, histories) else { continue };
            self.carried.push(id);
            self.layouts[id.index()] = history.layout;
            self.resources.rebind(id, history.bound.clone());
        }
        for slot in 0..FRAMES_IN_FLIGHT {
            self.sets.rewrite(gpu, &self.plan, &self.resources, slot, &self.carried);
        }
    }

    fn ids(&self) -> impl Iterator<Item = ResourceId> + use<> {
        (0..self.plan.resources.len() as u32).map(ResourceId)
    }

    /// What a plan that comes after this one may take over.
    pub fn histories(&self) -> Vec<History> {
        // Before the first frame only what this plan took over itself has contents.
        let full = self.ids().filter(|id| !self.prologue_due || self.carried.contains(id));
        let history = |id: ResourceId| {
            Some(History {
                name: history::name(&self.plan, id)?.to_string(),
                shape: self.plan.resource(id).shape,
                identity: self.identity,
                layout: self.layouts[id.index()],
                bound: self.resources.bound(id)?.clone(),
            })
        };
        full.filter_map(history).collect()
    }

    /// The steps of the prologue, if the next frame runs it.
    pub fn prologue(&self) -> &[LoweredStep] {
        if self.prologue_due { &self.lowered.prologue } else { &[] }
    }

    /// The step would zero a history that goes on: its pass does not run.
    pub fn is_left_out(&self, step: &LoweredStep) -> bool {
        matches!(self.plan.pass(step.pass).work, Work::Start { resource } if self.carried.contains(&resource))
    }

    /// The steps whose passes the next frame runs.
    pub fn steps(&self) -> impl Iterator<Item = &LoweredStep> {
        self.prologue().iter().filter(|step| !self.is_left_out(step)).chain(&self.lowered.frame)
    }

    /// Where the statistics of the frame in this slot are copied to; none where the plan has none.
    pub fn readback(&self, slot: usize) -> Option<&Buffer> {
        let index = self.plan.resources.iter().position(|resource| resource.source == Source::Readback)?;
        Some(self.resources.buffer(ResourceId(index as u32), slot))
    }

    /// Every piece of memory, some more than once: plans may share some.
    pub fn pieces(&self) -> impl Iterator<Item = &Arc<Memory>> {
        let outputs = self.slots.iter().flat_map(|slot| &slot.output);
        self.resources.pieces().chain(outputs.map(|buffer| &buffer.memory))
    }

    /// Names and bytes of what is allocated; see [`splatgraph_api::Device::memory`].
    pub fn memory(&self) -> Vec<(String, u64)> {
        let mut memory = self.resources.memory(&self.plan);
        let outputs = self.slots.iter().flat_map(|slot| &slot.output);
        let readback: u64 = outputs.map(|buffer| buffer.memory.bytes()).sum();
        if readback > 0 {
            memory.push(("output readback".to_string(), readback));
        }
        memory
    }
}

impl LoadedSlot {
    fn new(gpu: &Arc<Gpu>, plan: &Plan) -> Result<LoadedSlot, BackendError> {
        let timestamps = if gpu.limits.timestamp_bits == 0 {
            None
        } else {
            let count = queries(plan.prologue.len() + plan.frame.len());
            let info =
                vk::QueryPoolCreateInfo::default().query_type(vk::QueryType::TIMESTAMP).query_count(count);
            // SAFETY: a plain creation on a live device.
            let pool = unsafe { gpu.device.create_query_pool(&info, None) };
            Some(Owned::new(gpu, pool.map_err(api("vkCreateQueryPool"))?))
        };
        Ok(LoadedSlot { timestamps, output: None })
    }
}
