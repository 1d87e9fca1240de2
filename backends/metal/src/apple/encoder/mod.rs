//! Records commands into a command buffer.
//!
//! [`Walk`](crate::walk::Walk) determines the encoder of each pass and its waits. An encoder is opened only when its
//! first command is recorded, because the targets of a draw and the timestamp samples are not known before.
//!
//! Calls that create objects have an autorelease pool, so that Metal's temporary objects are freed before the thread
//! ends.

use crate::apple::capture;
use crate::apple::descriptors::ArgumentTables;
use crate::apple::gpu::{MetalGpu, Submission};
use crate::apple::objc;
use crate::apple::pipelines::Pipelines;
use crate::apple::queue::{self, Timestamps};
use crate::error::no_object;
use crate::lower::{self, CLEAR_THREADS};
use crate::times;
use crate::walk::{Move, Walk};
use metal::*;
use splatgraph_api::BackendError;
use splatgraph_framework::ir::{DepthAccess, Format, Pass, PassId, ResourceId, Target};
use splatgraph_runtime::{Buffer, Draw, Image, ImageLayout, Show, lock};
use std::fmt::Arguments;
use std::ops::Range;
use std::sync::Arc;
use std::time::Duration;

mod open;
mod state;

pub use state::Encoder;
use state::{Bound, Open};

impl Encoder {
    fn follow(&mut self) {
        let moves = std::mem::take(&mut self.moves);
        for step in &moves {
            match *step {
                Move::AfterAll => self.after_all = true,
                // Later submissions cannot wait for an event within these commands, so they wait for the whole
                // submission.
                Move::HandOver => {
                    self.order_by_event();
                    self.publishes = true;
                }
                Move::Open(kind) => {
                    self.close();
                    self.next = Some(kind);
                    self.sample = None;
                }
                Move::Wait(fence) => self.waits.push(fence),
                Move::Barrier(barrier) => {
                    if let Open::Compute(encoder) = &self.open {
                        objc::memory_barrier(encoder, barrier.buffers, barrier.textures);
                    }
                }
                Move::Update(fence) => self.update(fence),
                Move::Close => self.close(),
            }
        }
        self.moves = moves;
        self.moves.clear();
    }

    /// Closes the encoder, and orders these commands against everything else.
    ///
    /// Later commands wait for earlier ones and for all earlier submissions, and later submissions wait for these
    /// commands. Commands outside the plan need this, because its fences do not cover them.
    fn order_everything(&mut self) {
        self.interrupt();
        self.after_all = true;
        self.publishes = true;
        self.order_by_event();
    }

    /// Orders all earlier commands of the command buffer before all later ones, by an event. No encoder may be open.
    fn order_by_event(&mut self) {
        let (event, value) = &mut self.order_event;
        *value += 1;
        if let Some(commands) = &self.commands {
            commands.encode_signal_event(event, *value);
            commands.encode_wait_for_event(event, *value);
        }
    }

    /// Closes the open encoder, whether it belongs to the plan or to copies outside of it.
    fn interrupt(&mut self) {
        if let Some(order) = self.order.clone() {
            self.walk.interrupt(&lock(&order.walked), &mut self.moves);
            self.follow();
        }
        self.close();
    }
}

impl splatgraph_runtime::Encoder<MetalGpu> for Encoder {
    fn new(gpu: &Arc<MetalGpu>, name: &str) -> Result<Encoder, BackendError> {
        Ok(Encoder {
            name: name.to_string(),
            commands: None,
            submitted: None,
            done: (gpu.device.new_shared_event(), 0),
            order_event: (gpu.device.new_event(), 0),
            others: (gpu.device.new_shared_event(), 0),
            after_all: false,
            publishes: false,
            walk: Walk::default(),
            order: None,
            moves: Vec::new(),
            open: Open::None,
            next: None,
            waits: Vec::new(),
            bound: Bound::default(),
            times: None,
            sample: None,
            label: String::new(),
            groups: 0,
            gpu: gpu.clone(),
        })
    }

    fn begin(&mut self) -> Result<(), BackendError> {
        objc::pool(|| {
            // Metal requires an encoder to end before it is dropped. An earlier recording may have failed.
            self.close();
            if let Some(reason) = capture::begin(&self.gpu.device) {
                self.gpu.common.messages.add(format!("no frame is captured: {reason}"));
            }
            let commands = self.gpu.commands(&self.name)?;
            // The submission decides which earlier submissions these commands wait for.
            self.others.1 += 1;
            commands.encode_wait_for_event(&self.others.0, self.others.1);
            self.commands = Some(commands);
            self.order = None;
            self.walk.begin();
            (self.after_all, self.publishes) = (false, false);
            (self.times, self.sample) = (None, None);
            Ok(())
        })
    }

    fn end(&mut self) -> Result<(), BackendError> {
        objc::pool(|| {
            self.interrupt();
            if self.commands.is_some() { Ok(()) } else { Err(no_object("commandBuffer")) }
        })
    }

    fn submit(&mut self, show: Option<Show<MetalGpu>>) -> Result<(), BackendError> {
        objc::pool(|| {
            let Some(commands) = self.commands.take() else {
                return Err(BackendError::Invalid(format!(
                    "the encoder `{}` has nothing recorded",
                    self.name
                )));
            };
            self.done.1 += 1;
            commands.encode_signal_event(&self.done.0, self.done.1);
            self.submitted = None;
            let mut recorded = vec![commands];
            if let Some(Show { swapchain: window, .. }) = show {
                let frame = (&**self.done.0, self.done.1);
                let shown = match (&self.order, self.walk.division()) {
                    (Some(order), Some(division)) => {
                        let walked = lock(&order.walked);
                        let updates =
                            order.export.map_or(&[][..], |export| self.walk.updates(&walked, export));
                        let fences = updates.iter().map(|update| order.fence(division, update.fence));
                        window.draw(&self.gpu, &fences.collect::<Vec<_>>(), frame)?
                    }
                    _ => window.draw(&self.gpu, &[], frame)?,
                };
                // The submission as a whole signals the value after the frame's.
                shown.encode_wait_for_event(&self.done.0, self.done.1);
                self.done.1 += 1;
                shown.encode_signal_event(&self.done.0, self.done.1);
                recorded.push(shown);
            }
            let submission = Submission {
                commands: recorded,
                start: self.others.clone(),
                done: self.done.clone(),
                publishes: self.publishes,
            };
            self.submitted = Some(queue::submit(&self.gpu, submission, self.after_all)?);
            if let Some(order) = self.order.take() {
                lock(&order.walked).submitted(&self.walk);
            }
            Ok(())
        })
    }

    fn wait(&mut self, limit: Duration) -> Result<bool, BackendError> {
        objc::pool(|| {
            let Some(submission) = &self.submitted else { return Ok(true) };
            if !queue::wait(&self.gpu, submission, limit)? {
                return Ok(false);
            }
            if let (Some(times), Some(frame)) = (self.times.take(), submission.commands.first()) {
                times.completed(objc::device_times(frame));
            }
            self.submitted = None;
            Ok(true)
        })
    }

    fn pass(&mut self, pipelines: &Pipelines, id: PassId, timed: bool) {
        objc::pool(|| {
            let order = self.order.get_or_insert_with(|| pipelines.order.clone()).clone();
            let timed = timed && self.gpu.timestamps.is_some();
            // An encoder that is still open here belongs to copies outside the plan.
            if !self.walk.is_open() {
                self.close();
            }
            self.walk.pass(&lock(&order.walked), id, timed, &mut self.moves);
            self.follow();
        })
    }

    fn push_label(&mut self, name: Arguments) {
        if !self.gpu.labels {
            return;
        }
        self.label = name.to_string();
        if let Some(encoder) = self.open.raw() {
            objc::pool(|| encoder.push_debug_group(&self.label));
            self.groups += 1;
        }
    }

    fn pop_label(&mut self) {
        if self.groups > 0 {
            self.groups -= 1;
            objc::pool(|| self.pop_group());
        }
    }

    /// Does nothing: the walk orders encoders by fences and barriers, and images have no layouts.
    fn synchronize<'a>(
        &mut self,
        _: &(),
        _: Option<PassId>,
        _: impl Fn(ResourceId) -> Option<&'a Image<MetalGpu>>,
    ) {
    }

    fn full_barrier<'a>(&mut self, _: impl Iterator<Item = ImageLayout<'a, MetalGpu>>) {
        objc::pool(|| {
            self.order_everything();
        })
    }

    fn after_copy(&mut self, _: &Buffer<MetalGpu>, _: Range<u64>) {
        self.publishes = true;
    }

    /// Does nothing: completion of the command buffer makes writes visible to the host.
    fn copies_to_host(&mut self) {}

    fn bind(
        &mut self,
        pipelines: &Pipelines,
        bindings: &ArgumentTables,
        id: PassId,
        pass: &Pass,
        slot: usize,
    ) {
        let Bound { pipeline, table, bytes, copied } = &mut self.bound;
        *pipeline = pipelines.of(id).cloned();
        table.arguments.clear();
        table.sizes.clear();
        bytes.clear();
        copied.clear();
        if let Some(of) = bindings.of(id, slot) {
            table.arguments.extend_from_slice(&of.arguments);
            table.sizes.extend_from_slice(&of.sizes);
        }
        for stage in &pipelines.lowered.arguments[id.index()] {
            if let (Some(index), false) = (stage.msl.push, pass.push.is_empty()) {
                let start = bytes.len();
                bytes.extend_from_slice(&pass.push);
                copied.push((stage.stage, index, start..bytes.len()));
            }
            let sizes = table.sizes.iter().find(|(of, _)| *of == stage.stage);
            if let (Some(index), Some((_, sizes))) = (stage.msl.sizes, sizes) {
                let start = bytes.len();
                bytes.extend(sizes.iter().flat_map(|size| size.to_le_bytes()));
                copied.push((stage.stage, index, start..bytes.len()));
            }
        }
    }

    fn dispatch(&mut self, [x, y, z]: [u32; 3]) {
        objc::pool(|| {
            let Some(encoder) = self.compute() else { return };
            let Some(threads) = self.bound.dispatch(&encoder) else { return };
            // Metal's validation refuses empty dispatches.
            if [x, y, z].contains(&0) {
                return self.gpu.builtin.fill(&encoder, &self.gpu.builtin.scratch, [0, 0]);
            }
            encoder.dispatch_thread_groups(MTLSize::new(x.into(), y.into(), z.into()), threads);
        })
    }

    fn dispatch_indirect(&mut self, arguments: &Buffer<MetalGpu>, offset: u64) {
        objc::pool(|| {
            let Some(encoder) = self.compute() else { return };
            let Some(threads) = self.bound.dispatch(&encoder) else { return };
            encoder.dispatch_thread_groups_indirect(&arguments.raw, offset, threads);
        })
    }

    fn draw<'a>(
        &mut self,
        targets: impl Iterator<Item = (&'a Target, &'a Image<MetalGpu>)>,
        depth: Option<(DepthAccess, &'a Image<MetalGpu>)>,
        draw: Draw<MetalGpu>,
    ) {
        objc::pool(|| {
            let Some(encoder) = self.render(targets, depth) else { return };
            let Some(primitives) = self.bound.draw(&encoder) else { return };
            match draw {
                // Metal's validation refuses empty draws as well. The encoder has cleared the targets.
                Draw::Direct { vertices: 0, .. } | Draw::Direct { instances: 0, .. } => {}
                Draw::Direct { vertices, instances } => {
                    encoder.draw_primitives_instanced(primitives, 0, vertices.into(), instances.into());
                }
                Draw::Indirect(buffer, offset) => {
                    encoder.draw_primitives_indirect(primitives, &buffer.raw, offset)
                }
            }
        })
    }

    fn fill(&mut self, buffer: &Buffer<MetalGpu>, value: u32) {
        objc::pool(|| {
            let Some(encoder) = self.compute() else { return };
            self.gpu.builtin.fill(&encoder, &buffer.raw, [(buffer.bytes / 4) as u32, value]);
        })
    }

    fn clear(&mut self, image: &Image<MetalGpu>) {
        objc::pool(|| {
            let Some(encoder) = self.compute() else { return };
            let builtin = &self.gpu.builtin;
            let kernel =
                if image.format == Format::R32Uint { &builtin.clear_words } else { &builtin.clear_floats };
            let ([x, y], [width, height]) = (lower::clear_groups(image.size), CLEAR_THREADS);
            encoder.set_compute_pipeline_state(kernel);
            encoder.set_texture(0, Some(&image.raw));
            encoder.dispatch_thread_groups(
                MTLSize::new(x.into(), y.into(), 1),
                MTLSize::new(width.into(), height.into(), 1),
            );
        })
    }

    fn copy_buffer(
        &mut self,
        source: (&Buffer<MetalGpu>, u64),
        target: (&Buffer<MetalGpu>, u64),
        bytes: u64,
    ) {
        objc::pool(|| {
            let Some(encoder) = self.blit() else { return };
            encoder.copy_from_buffer(&source.0.raw, source.1, &target.0.raw, target.1, bytes);
        })
    }

    fn copy_image(&mut self, image: &Image<MetalGpu>, target: &Buffer<MetalGpu>) {
        objc::pool(|| {
            let Some(encoder) = self.blit() else { return };
            let (width, height) = (u64::from(image.size.0), u64::from(image.size.1));
            let row = width * u64::from(image.format.bytes_per_pixel());
            encoder.copy_from_texture_to_buffer(
                &image.raw,
                0,
                0,
                MTLOrigin { x: 0, y: 0, z: 0 },
                MTLSize::new(width, height, 1),
                &target.raw,
                0,
                row,
                row * height,
                MTLBlitOption::empty(),
            );
        })
    }

    fn copy_to_image(&mut self, image: &Image<MetalGpu>, target: &Image<MetalGpu>) {
        objc::pool(|| {
            let Some(encoder) = self.blit() else { return };
            let origin = MTLOrigin { x: 0, y: 0, z: 0 };
            let size = MTLSize::new(image.size.0.into(), image.size.1.into(), 1);
            encoder.copy_from_texture(&image.raw, 0, 0, origin, size, &target.raw, 0, 0, origin);
        })
    }

    fn reset_timestamps(&mut self, timestamps: &Timestamps, _: u32) {
        timestamps.reset();
        self.times = Some(timestamps.clone());
    }

    /// Stores the first timestamp's index for the pass's encoder, which is opened later and samples both timestamps.
    /// Does nothing for the second timestamp, for the frame's own timestamps, and if the encoder is already open.
    fn timestamp(&mut self, _: &Timestamps, index: u32) {
        if let (Some(sample), Some(_)) = (times::sample(index), self.next)
            && sample.is_multiple_of(2)
        {
            self.sample = Some(sample);
        }
    }
}

impl Drop for Encoder {
    /// Ends the open encoder, because Metal requires that before its release.
    fn drop(&mut self) {
        objc::pool(|| self.close());
    }
}
