//! Records a frame: the plan's passes, in order, into an encoder.
//!
//! Between the passes come only the commands lowered from the plan's dependencies. The runtime adds barriers only
//! around its own work: at the start of a plan that continues another's histories or reuses its results, around copies
//! of state, inspected resources and shared outputs, and before the host reads copies.

use crate::aliasing::Transient;
use crate::compiled::CompiledPlan;
use crate::gpu::{Buffer, Draw, Encoder, Gpu, ImageLayout};
use crate::outputs::SharedOutput;
use crate::timing::queries;
use splatgraph_api::{BackendError, FrameId, FrameInputs, Inspect};
use splatgraph_framework::ir::*;

/// Effects of a recorded frame, to be applied once it is submitted.
pub(crate) struct Recorded {
    pub passes: Vec<PassId>,
    /// For each resource, its layout after the frame; meaningful only for images.
    pub layouts: Vec<Layout>,
}

/// A side of a copy of state, with an image's layouts before and after the copy.
type Copied<'a, G> = (&'a Transient<G>, (Layout, Layout));

/// Returns a resource of the plan as a side of a copy, which keeps its layout; `None` if it is not the plan's own.
fn own<'a, G: Gpu>(
    compiled: &'a CompiledPlan<G>,
    id: ResourceId,
    layouts: &[Layout],
) -> Option<Copied<'a, G>> {
    let layout = layouts[id.index()];
    Some((compiled.resources.transient(id)?, (layout, layout)))
}

pub(crate) struct Recorder<'a, G: Gpu> {
    pub encoder: &'a mut G::Encoder,
    pub compiled: &'a CompiledPlan<G>,
    pub inputs: &'a FrameInputs,
    pub frame: FrameId,
    pub slot: usize,
    /// The resources that the state is copied to, if the frame saves it.
    pub saved: &'a [(ResourceId, Transient<G>)],
    pub inspected: &'a [Buffer<G>],
    pub readback: Option<&'a Buffer<G>>,
    /// The shared output that receives a copy of the output; `None` if the frame is not shared.
    pub shared: Option<&'a SharedOutput<G>>,
}

impl<G: Gpu> Recorder<'_, G> {
    pub fn record(mut self) -> Result<Recorded, BackendError> {
        let compiled = self.compiled;
        let mut recorded = Recorded { passes: Vec::new(), layouts: compiled.layouts.clone() };
        self.encoder.begin()?;
        self.encoder.push_label(format_args!("frame {}", self.frame.0));
        if let Some(timestamps) = &compiled.timestamps[self.slot] {
            self.encoder.reset_timestamps(timestamps, queries(compiled.passes().count()));
        }
        self.timestamp(0);
        self.take_over(&mut recorded.layouts);
        for pass in compiled.prologue() {
            self.pass(*pass, &mut recorded);
        }
        if compiled.prologue_due {
            self.synchronize(None, &mut recorded.layouts);
            self.restore_state(&recorded.layouts);
        }
        self.save_histories(&recorded.layouts);
        for pass in &compiled.plan.frame {
            self.pass(*pass, &mut recorded);
        }
        self.share_output();
        // Waiting for the submission does not by itself make the copies visible to the host.
        if self.readback.is_some() || !self.inputs.inspect.is_empty() {
            self.encoder.copies_to_host();
        }
        self.timestamp(1);
        self.encoder.pop_label();
        self.encoder.end()?;
        Ok(recorded)
    }

    /// Makes later commands wait for frames of other plans whose histories or results this plan reuses. Images of
    /// continued histories move to the layout in which [`Work::ClearHistory`] leaves them.
    fn take_over(&mut self, layouts: &mut [Layout]) {
        let carried = &self.compiled.carried;
        if !self.compiled.continues_previous() {
            return;
        }
        let resources = &self.compiled.resources;
        let new = Layout::TransferTarget;
        self.encoder.full_barrier(carried.iter().filter_map(|&id| {
            Some(ImageLayout { image: resources.image(id)?, old: layouts[id.index()], new })
        }));
        for id in carried {
            layouts[id.index()] = new;
        }
    }

    /// Copies [`CompiledPlan::restored`] to the plan's resources.
    fn restore_state(&mut self, layouts: &[Layout]) {
        let compiled = self.compiled;
        let copies = compiled.restored.iter().filter_map(|(id, layout, former)| {
            Some([(former, (*layout, Layout::TransferSource)), own(compiled, *id, layouts)?])
        });
        self.copy_state("restore state", &copies.collect::<Vec<_>>());
    }

    /// Copies the state to [`Recorder::saved`]. The copies of images end in [`Layout::TransferTarget`].
    fn save_histories(&mut self, layouts: &[Layout]) {
        let compiled = self.compiled;
        let copies = self.saved.iter().filter_map(|(id, copy)| {
            Some([own(compiled, *id, layouts)?, (copy, (Layout::Undefined, Layout::TransferTarget))])
        });
        self.copy_state("save state", &copies.collect::<Vec<_>>());
    }

    /// Copies resources: each from the first of a pair to the second.
    fn copy_state(&mut self, label: &str, copies: &[[Copied<G>; 2]]) {
        if copies.is_empty() {
            return;
        }
        let between = [Layout::TransferSource, Layout::TransferTarget];
        let images = || {
            copies.iter().flat_map(|pair| pair.iter().zip(between)).filter_map(
                |((copied, layouts), between)| match copied {
                    Transient::Image(image) => Some((&**image, *layouts, between)),
                    Transient::Buffer(_) => None,
                },
            )
        };
        self.encoder.push_label(format_args!("{label}"));
        self.encoder.full_barrier(images().map(|(image, (old, _), new)| ImageLayout { image, old, new }));
        for pair in copies {
            match pair {
                [(Transient::Buffer(source), _), (Transient::Buffer(target), _)] => {
                    self.encoder.copy_buffer((source, 0), (target, 0), target.bytes);
                }
                [(Transient::Image(source), _), (Transient::Image(target), _)] => {
                    self.encoder.copy_to_image(source, target);
                }
                _ => unreachable!("state is copied between resources of one shape"),
            }
        }
        let back = images().filter(|(_, (_, new), old)| old != new);
        self.encoder.full_barrier(back.map(|(image, (_, new), old)| ImageLayout { image, old, new }));
        self.encoder.pop_label();
    }

    fn pass(&mut self, id: PassId, recorded: &mut Recorded) {
        let pass = self.compiled.plan.pass(id);
        let is_timed = !self.inputs.untimed_passes && self.compiled.timestamps[self.slot].is_some();
        self.encoder.pass(&self.compiled.pipelines, id, is_timed);
        self.encoder.push_label(format_args!("{}", pass.name));
        self.synchronize(Some(id), &mut recorded.layouts);
        if pass.work != Work::Host && !self.compiled.is_skipped(id) {
            let query = queries(recorded.passes.len());
            if is_timed {
                self.timestamp(query);
            }
            self.work(id, pass);
            if is_timed {
                self.timestamp(query + 1);
            }
            recorded.passes.push(id);
        }
        self.encoder.pop_label();
        for (inspect, buffer) in self.inputs.inspect.iter().zip(self.inspected) {
            if inspect.after == id {
                self.encoder.push_label(format_args!("inspect after {}", pass.name));
                self.inspect(*inspect, buffer, &recorded.layouts);
                self.encoder.pop_label();
            }
        }
    }

    /// Records the barriers before a pass or (`None`) the first frame, with their layout changes. A continued history
    /// is not zeroed: the layout change that would discard its contents is dropped, but its execution dependency stays,
    /// because other passes may rely on it.
    fn synchronize(&mut self, at: Option<PassId>, layouts: &mut [Layout]) {
        let compiled = self.compiled;
        let is_start = at.is_some_and(|pass| compiled.would_clear(pass));
        let changes = || compiled.plan.layout_changes_at(at).filter(|_| !is_start);
        self.encoder.synchronize(&compiled.synchronization, at, |image| {
            changes().find(|change| change.image == image).and_then(|_| compiled.resources.image(image))
        });
        for change in changes() {
            layouts[change.image.index()] = change.new;
        }
    }

    fn work(&mut self, id: PassId, pass: &Pass) {
        let (compiled, slot) = (self.compiled, self.slot);
        let (resources, encoder) = (&compiled.resources, &mut *self.encoder);
        match &pass.work {
            Work::Dispatch { groups, .. } => {
                encoder.bind(&compiled.pipelines, &compiled.bindings.raw, id, pass, slot);
                match *groups {
                    Groups::Direct(groups) => encoder.dispatch(groups),
                    Groups::Indirect { buffer, offset } => {
                        encoder.dispatch_indirect(resources.buffer(buffer, slot), offset);
                    }
                }
            }
            Work::Draw { call, targets, depth, .. } => {
                encoder.bind(&compiled.pipelines, &compiled.bindings.raw, id, pass, slot);
                let targets = targets.iter().filter_map(|t| Some((t, resources.image(t.image)?)));
                let depth = depth.and_then(|d| Some((d.access, resources.image(d.image)?)));
                encoder.draw(
                    targets,
                    depth,
                    match *call {
                        DrawCall::Direct { vertices, instances } => Draw::Direct { vertices, instances },
                        DrawCall::Indirect { buffer, offset } => {
                            Draw::Indirect(resources.buffer(buffer, slot), offset)
                        }
                    },
                );
            }
            Work::Fill { buffer, value } => encoder.fill(resources.buffer(*buffer, slot), *value),
            Work::ClearHistory { resource } => match resources.image(*resource) {
                Some(image) => encoder.clear(image),
                None => encoder.fill(resources.buffer(*resource, slot), 0),
            },
            Work::Export => self.export(),
            Work::Host => {}
        }
    }

    fn export(&mut self) {
        let (compiled, slot) = (self.compiled, self.slot);
        if let Some(target) = compiled.readback(slot) {
            // Adjacent words are copied at once: on a GPU, each copy takes microseconds.
            let mut at = 0;
            for run in compiled.plan.stats.chunk_by(|a, b| a.buffer == b.buffer && a.offset + 4 == b.offset) {
                let (source, bytes) = (compiled.resources.buffer(run[0].buffer, slot), 4 * run.len() as u64);
                self.encoder.copy_buffer((source, run[0].offset), (target, at), bytes);
                at += bytes;
            }
        }
        if let Some(target) = self.readback {
            self.copy_output(target);
        }
    }

    /// Copies the output, which is in [`Layout::TransferSource`] after the export.
    fn copy_output(&mut self, target: &Buffer<G>) {
        if let Some(output) = self.compiled.resources.image(self.compiled.plan.output) {
            self.encoder.copy_image(output, target);
        }
    }

    fn share_output(&mut self) {
        let Some(SharedOutput { buffer, .. }) = self.shared else { return };
        self.encoder.push_label(format_args!("picture"));
        self.encoder.full_barrier(std::iter::empty());
        self.copy_output(buffer);
        self.encoder.after_copy(buffer, 0..buffer.bytes);
        self.encoder.pop_label();
    }

    /// Copies a resource to a readback buffer. Full barriers before and after order the copy against the plan's passes.
    fn inspect(&mut self, inspect: Inspect, target: &Buffer<G>, layouts: &[Layout]) {
        let resources = &self.compiled.resources;
        let (layout, copied) = (layouts[inspect.resource.index()], Layout::TransferSource);
        let image = resources.image(inspect.resource);
        let change = |old, new| image.into_iter().map(move |image| ImageLayout { image, old, new });
        self.encoder.full_barrier(change(layout, copied));
        match image {
            Some(image) => self.encoder.copy_image(image, target),
            None => {
                let (source, range) = resources.part(inspect.resource, self.slot);
                self.encoder.copy_buffer((source, range.start), (target, 0), range.end - range.start);
            }
        }
        self.encoder.full_barrier(change(copied, layout));
    }

    fn timestamp(&mut self, index: u32) {
        if let Some(timestamps) = &self.compiled.timestamps[self.slot] {
            self.encoder.timestamp(timestamps, index);
        }
    }
}
