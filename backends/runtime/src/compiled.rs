//! Creates a compiled plan: all objects of a plan that do not belong to a single frame.
//!
//! It is created on any thread ([`CompiledPlan::new`]) while frames of another plan are drawn. It becomes the current
//! plan when it [follows](CompiledPlan::follow) the previous one. Only then are the previous plan's histories known.

use crate::aliasing::{self, Transient};
use crate::attributes::{self, PlaneKey};
use crate::bindings::Bindings;
use crate::check;
use crate::gpu::{Buffer, Gpu, Location, Memory};
use crate::history::{self, History, Start};
use crate::once::UsedOnce;
use crate::resources::{Resources, member};
use crate::results::{self, Recipe, Recipes};
use crate::shared::Shared;
use crate::timing::queries;
use crate::upload::upload;
use splatgraph_api::{BackendError, FRAMES_IN_FLIGHT, OUTPUT_READBACK, Progress, SceneData};
use splatgraph_framework::shader::Cancel;
use splatgraph_framework::{ir::*, plan::*};
use std::collections::BTreeSet;
use std::sync::Arc;
use tracing::info_span;

/// A plan with all its objects. Fields are dropped in declaration order, once no frame of the plan is in flight.
pub(crate) struct CompiledPlan<G: Gpu> {
    pub bindings: Bindings<G>,
    pub synchronization: G::Synchronization,
    pub pipelines: G::Pipelines,
    /// The timestamps of each slot's frame (see [`queries`]); `None` if the queue has no timer.
    pub timestamps: [Option<Arc<G::Timestamps>>; FRAMES_IN_FLIGHT],
    pub resources: Resources<G>,
    pub plan: Arc<Plan>,
    /// Number of the plan within its executor, set by [`CompiledPlan::follow`]; frames refer to it.
    pub number: u64,
    identity: u64,
    /// For each resource, its layout after the frames submitted so far; meaningful only for images.
    pub layouts: Vec<Layout>,
    /// Resources that continue a previous plan's history, until the first frame is submitted.
    pub carried: Vec<ResourceId>,
    /// State of a previous plan, with its layout, that is copied to the plan's resources after the prologue. Kept until
    /// the prologue's frame has completed.
    pub restored: Vec<(ResourceId, Layout, Transient<G>)>,
    /// Copies of the state, made before the plan's last frame that saved it. Empty before the first such frame.
    pub saved: Vec<(ResourceId, Transient<G>)>,
    recipes: Recipes,
    /// Prologue passes that do not run: their results are reused from another plan, or used only by other skipped
    /// passes.
    skipped: Vec<PassId>,
    /// Buffers that only the prologue uses; empty once they are freed.
    used_once: BTreeSet<ResourceId>,
    /// Readback buffers for the output. Each serves one frame at a time.
    readbacks: Vec<Arc<Buffer<G>>>,
    /// True until the first frame, which runs the prologue, is submitted.
    pub prologue_due: bool,
}

impl<G: Gpu> CompiledPlan<G> {
    pub fn new(
        shared: &Shared<G>,
        plan: Plan,
        scene: &dyn SceneData,
        (cancel, share_results, synchronization): (&Cancel, bool, Option<G::Synchronization>),
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Self, BackendError> {
        let gpu = &shared.gpu;
        info_span!("check the plan").in_scope(|| check::check(&plan, &gpu.common().limits))?;
        let identity = scene.identity();
        let synchronization = info_span!("lower the dependencies")
            .in_scope(|| synchronization.map_or_else(|| G::synchronization(&plan), Ok))?;
        let plan = Arc::new(plan);
        let pipelines = info_span!("wait for the pipelines")
            .in_scope(|| shared.compilers.create(gpu, &plan, cancel, progress))?;
        let allocating = info_span!("allocate and bind").entered();
        let recipes = results::recipes(&plan, identity);
        let mut taken = if share_results { shared.results.find(&plan, &recipes) } else { Default::default() };
        let skipped = results::skipped(&plan, &mut taken);
        let mut once = UsedOnce::new(&plan, &skipped);
        let keys = attributes::keys(&plan, identity, &once.unused);
        // This may wait for another upload, so it comes after the pipelines.
        let (mut planes, turn) = shared.attributes.find(&keys);
        let absent: Vec<_> = keys.iter().filter(|(_, key)| !planes.contains_key(key)).collect();
        let available = gpu.available().unwrap_or(gpu.common().limits.heap_bytes);
        once.find_room(&plan, available, &absent, taken.values().map(|buffer| buffer.bytes).sum())?;
        let (resources, missing) = Resources::create(gpu, &plan, identity, &mut planes, (&taken, &once))?;
        let bindings = Bindings::new(gpu, &plan, &pipelines, &resources, &skipped)?;
        let count = queries(plan.prologue.len() + plan.frame.len());
        let timestamps = || Ok(gpu.create_timestamps(count)?.map(Arc::new));
        let timestamps = [timestamps()?, timestamps()?];
        drop(allocating);
        // The upload is last because it is slowest: a plan that cannot run is refused before it.
        upload(shared, scene, &missing, &planes, progress)?;
        // Planes in host memory stay out of the cache: another plan might read them in every frame, which is slow.
        let hosted = |key: &PlaneKey| {
            once.location == Location::Host
                && absent.iter().any(|(id, other)| other == key && once.freed.contains(id))
        };
        shared.attributes.add(missing.iter().filter(|key| !hosted(key)).map(|key| (key, &planes[key])));
        drop(turn);
        Ok(CompiledPlan {
            bindings,
            synchronization,
            pipelines,
            timestamps,
            resources,
            number: 0,
            identity,
            layouts: vec![Layout::Undefined; plan.resources.len()],
            carried: Vec::new(),
            restored: Vec::new(),
            saved: Vec::new(),
            recipes,
            skipped,
            used_once: once.freed,
            readbacks: Vec::new(),
            prologue_due: true,
            plan,
        })
    }

    /// Sets the plan's number, and continues with the previous plan's state ([`Start`]), as far as it can. Call it when
    /// the plan becomes the current one, before its first frame.
    pub fn follow(&mut self, gpu: &G, number: u64, former: (Start, &[History<G>])) {
        self.number = number;
        for id in self.ids() {
            let Some(history) = history::find(&self.plan, id, self.identity, former) else { continue };
            if former.0 != Start::Current {
                self.restored.push((id, history.layout, history.transient.clone()));
                continue;
            }
            self.carried.push(id);
            self.layouts[id.index()] = history.layout;
            self.resources.rebind(id, history.transient.clone());
        }
        for slot in 0..FRAMES_IN_FLIGHT {
            self.bindings.rewrite(gpu, &self.plan, &self.resources, slot, &self.carried);
        }
    }

    /// Frees the prologue's bindings, the buffers that only it uses and restored state. The prologue's frame must have
    /// completed.
    pub fn end_prologue(&mut self) {
        self.restored.clear();
        self.bindings.end_prologue(&self.plan);
        for id in std::mem::take(&mut self.used_once) {
            self.resources.free(id);
        }
    }

    fn ids(&self) -> impl Iterator<Item = ResourceId> + use<G> {
        (0..self.plan.resources.len() as u32).map(ResourceId)
    }

    pub fn histories(&self) -> Vec<History<G>> {
        // Before the first frame, only state of the previous plan has contents.
        let full = self.ids().filter(|id| !self.prologue_due || self.carried.contains(id));
        let full = full.filter(|id| history::is_state(&self.plan, *id));
        let current = full
            .filter_map(|id| Some(self.history(id, self.layouts[id.index()], self.resources.transient(id)?)));
        let restored = self.restored.iter().filter(|_| self.prologue_due);
        current.chain(restored.map(|(id, layout, former)| self.history(*id, *layout, former))).collect()
    }

    /// Lists the state as it was before the last frame that saved it.
    pub fn saved_histories(&self) -> Vec<History<G>> {
        self.saved.iter().map(|(id, copy)| self.history(*id, Layout::TransferTarget, copy)).collect()
    }

    fn history(&self, id: ResourceId, layout: Layout, transient: &Transient<G>) -> History<G> {
        let (resource, transient) = (self.plan.resource(id).clone(), transient.clone());
        History { resource, identity: self.identity, layout, transient }
    }

    /// Returns the resources into which a frame saves the state. They become [`CompiledPlan::saved`] once the frame is
    /// submitted: until then, new ones have no contents.
    pub fn copies_of_state(&self, gpu: &Arc<G>) -> Result<Vec<(ResourceId, Transient<G>)>, BackendError> {
        if !self.saved.is_empty() {
            return Ok(self.saved.clone());
        }
        let mut copies = Vec::new();
        for id in self.ids().filter(|id| history::is_state(&self.plan, *id)) {
            let copy = aliasing::create_block(gpu, &[member(&self.plan, id)])?;
            copies.extend(copy.into_iter().map(|copy| (id, copy)));
        }
        Ok(copies)
    }

    pub fn prologue(&self) -> &[PassId] {
        if self.prologue_due { &self.plan.prologue } else { &[] }
    }

    /// Returns true if a pass would zero a history that continues.
    pub fn would_clear(&self, pass: PassId) -> bool {
        let continues = |resource: &ResourceId| self.carried.contains(resource);
        matches!(&self.plan.pass(pass).work, Work::ClearHistory { resource } if continues(resource))
    }

    /// Returns true if a pass does not run. Such a pass would zero a history that continues, or compute results that
    /// are reused or unused.
    pub fn is_skipped(&self, pass: PassId) -> bool {
        self.would_clear(pass) || self.skipped.contains(&pass)
    }

    /// Returns true if the next frame is the plan's first, and uses histories or results of other plans in place.
    pub fn continues_previous(&self) -> bool {
        !self.carried.is_empty() || self.prologue_due && !self.skipped.is_empty()
    }

    /// Lists the prologue's results that other plans can reuse. Call it only after the prologue's frame is submitted.
    pub fn results(&self) -> impl Iterator<Item = (&Arc<Recipe>, &Arc<Buffer<G>>)> {
        self.recipes.iter().filter_map(|(id, recipe)| match self.resources.transient(*id)? {
            Transient::Buffer(buffer) => Some((recipe, buffer)),
            Transient::Image(_) => None,
        })
    }

    pub fn passes(&self) -> impl Iterator<Item = PassId> {
        let prologue = self.prologue().iter().filter(|pass| !self.is_skipped(**pass));
        prologue.chain(&self.plan.frame).copied()
    }

    pub fn readback(&self, slot: usize) -> Option<&Buffer<G>> {
        let index = self.plan.resources.iter().position(|resource| resource.source == Source::Readback)?;
        Some(self.resources.buffer(ResourceId(index as u32), slot))
    }

    /// Returns an output readback buffer that no frame writes and no caller holds; allocates one if necessary.
    pub fn free_readback(&mut self, gpu: &Arc<G>) -> Result<Arc<Buffer<G>>, BackendError> {
        if let Some(free) = self.readbacks.iter().find(|buffer| Arc::strong_count(buffer) == 1) {
            return Ok(free.clone());
        }
        let bytes = self.resources.image(self.plan.output).map_or(0, |image| image.bytes());
        let buffer = Arc::new(Buffer::to_host(gpu, OUTPUT_READBACK, bytes)?);
        self.readbacks.push(buffer.clone());
        Ok(buffer)
    }

    /// Iterates over the plan's memory allocations. Shared ones appear more than once.
    pub fn pieces(&self) -> impl Iterator<Item = &Arc<G::Memory>> {
        let saved = self.saved.iter().map(|(_, copy)| copy.memory());
        let kept = saved.chain(self.restored.iter().map(|(_, _, former)| former.memory()));
        self.resources.pieces().chain(self.readbacks.iter().map(|buffer| &buffer.memory)).chain(kept)
    }

    pub fn memory(&self) -> Vec<(String, u64)> {
        let mut memory = self.resources.memory(&self.plan);
        let readback: u64 = self.readbacks.iter().map(|buffer| buffer.memory.bytes()).sum();
        if readback > 0 {
            memory.push((OUTPUT_READBACK.to_string(), readback));
        }
        let saved: u64 = self.saved.iter().map(|(_, copy)| copy.memory().bytes()).sum();
        if saved > 0 {
            memory.push(("saved histories".to_string(), saved));
        }
        memory
    }
}
