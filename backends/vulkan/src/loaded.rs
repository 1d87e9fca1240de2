//! A plan that is ready to run: everything that is created for it, and nothing of any one frame.

use crate::error::api;
use crate::gpu::{Gpu, Owned};
use crate::limits;
use crate::lower::{self, Lowered, LoweredStep};
use crate::memory::Buffer;
use crate::pipelines::{DescriptorSets, Pipelines};
use crate::resources::{Planes, Resources};
use crate::upload::upload;
use ash::vk;
use splatgraph_api::{BackendError, FRAMES_IN_FLIGHT, Progress, SceneData};
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
    /// The layouts that the frames submitted so far leave the images in.
    pub layouts: Vec<vk::ImageLayout>,
    /// The next frame runs the prologue.
    pub prologue_due: bool,
}

/// What the plan has once per frame in flight.
pub(crate) struct LoadedSlot {
    /// See [`queries`]; none where the queue has no timestamps.
    pub timestamps: Option<Owned<vk::QueryPool>>,
    /// The words of the statistics, copied here by every frame; none where the plan has none.
    pub stats: Option<Buffer>,
    /// The output's pixels; made when first asked for.
    pub output: Option<Buffer>,
}

/// Timestamps of a frame that runs `passes` passes: its start and its end, then before and after each pass.
pub(crate) fn queries(passes: usize) -> u32 {
    2 + 2 * passes as u32
}

impl Loaded {
    pub fn new(
        gpu: &Arc<Gpu>,
        plan: Plan,
        scene: &dyn SceneData,
        kept: &Planes,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Loaded, BackendError> {
        limits::check(&plan, &gpu.limits)?;
        let lowered = lower::lower(&plan, &gpu.limits.subgroup);
        let pipelines = Pipelines::new(gpu, &plan, &lowered, progress)?;
        let (resources, missing) = Resources::new(gpu, &plan, scene.identity(), kept)?;
        let sets = DescriptorSets::new(gpu, &plan, &lowered, &pipelines, &resources)?;
        let slots = [LoadedSlot::new(gpu, &plan)?, LoadedSlot::new(gpu, &plan)?];
        // Last, since it takes the longest: a plan that cannot run is refused before.
        upload(gpu, scene, &missing, &resources.planes, progress)?;
        let layouts = lower::untouched(&plan);
        Ok(Loaded { sets, pipelines, slots, resources, lowered, plan, layouts, prologue_due: true })
    }

    /// The steps of the next frame.
    pub fn steps(&self) -> impl Iterator<Item = &LoweredStep> {
        let prologue = if self.prologue_due { self.lowered.prologue.as_slice() } else { &[] };
        prologue.iter().chain(&self.lowered.frame)
    }

    /// Names and bytes of what is allocated; see [`splatgraph_api::Device::memory`].
    pub fn memory(&self) -> Vec<(String, u64)> {
        let mut memory = self.resources.memory(&self.plan);
        let buffers = self.slots.iter().flat_map(|slot| [&slot.stats, &slot.output]).flatten();
        let readback: u64 = buffers.map(Buffer::allocated_bytes).sum();
        if readback > 0 {
            memory.push(("readback".to_string(), readback));
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
        let bytes = 4 * plan.stats.len() as u64;
        let stats = if bytes == 0 { None } else { Some(Buffer::to_host(gpu, "statistics readback", bytes)?) };
        Ok(LoadedSlot { timestamps, stats, output: None })
    }
}
