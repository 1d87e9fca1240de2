//! Records commands as calls in the journal.

use crate::fault::Point;
use crate::gpu::{Bindings, NullGpu, Synchronization, Ticks, Timestamps};
use crate::journal::{Call, Hung, Object, Owned, Used};
use splatgraph_api::BackendError;
use splatgraph_framework::ir::*;
use splatgraph_runtime::{Buffer, Draw, Image, ImageLayout, Show, lock};
use std::collections::HashSet;
use std::fmt::Arguments;
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

/// An encoder that adds each call to the journal and executes nothing.
pub struct Encoder {
    gpu: Arc<NullGpu>,
    owned: Owned,
    /// The objects and bindings that the recorded commands use.
    used: HashSet<Used>,
    /// The timestamps that the recorded commands write, each as a set and an index.
    timestamps: Vec<(Ticks, u32)>,
}

impl Encoder {
    fn call(&self, call: Call) {
        self.owned.journal.call(call);
    }

    fn buffer(&mut self, buffer: &Buffer<NullGpu>) -> String {
        self.used.insert(Used::Object(buffer.raw.number));
        buffer.raw.name.clone()
    }

    fn image(&mut self, image: &Image<NullGpu>) -> String {
        self.used.insert(Used::Object(image.raw.number));
        image.raw.name.clone()
    }
}

impl splatgraph_runtime::Encoder<NullGpu> for Encoder {
    fn new(gpu: &Arc<NullGpu>, name: &str) -> Result<Encoder, BackendError> {
        let owned = gpu.create(Object::Encoder, name)?;
        Ok(Encoder { gpu: gpu.clone(), owned, used: HashSet::new(), timestamps: Vec::new() })
    }

    fn begin(&mut self) -> Result<(), BackendError> {
        self.owned.journal.check_idle(&self.owned, "begun");
        self.used.clear();
        self.timestamps.clear();
        self.call(Call::Begin { encoder: self.owned.name.clone() });
        Ok(())
    }

    fn end(&mut self) -> Result<(), BackendError> {
        self.call(Call::End);
        Ok(())
    }

    fn submit(&mut self, show: Option<Show<NullGpu>>) -> Result<(), BackendError> {
        self.gpu.check_lost("submit")?;
        let show = show.map(|show| show.image);
        self.gpu.journal.call(Call::Submit { encoder: self.owned.name.clone(), show });
        if self.gpu.journal.fails(Point::Submit) {
            self.gpu.journal.lose();
            return self.gpu.check_lost("submit");
        }
        let lost = self.gpu.journal.fails(Point::Execute);
        let hung = self.gpu.journal.hangs();
        let written = match (lost || hung.is_some(), hung) {
            (_, Some(Hung::Behind)) => 0,
            (true, _) => self.timestamps.len() / 2,
            (false, _) => self.timestamps.len(),
        };
        for (ticks, index) in &self.timestamps[..written] {
            let tick = self.gpu.tick.fetch_add(1, Ordering::Relaxed);
            lock(ticks)[*index as usize] = Some(tick);
        }
        if lost {
            self.gpu.journal.lose();
        } else {
            self.gpu.journal.submit(&self.owned, std::mem::take(&mut self.used), hung.is_some());
        }
        if self.gpu.journal.fails(Point::LateSubmit) {
            std::thread::sleep(Duration::from_millis(50));
        }
        Ok(())
    }

    fn wait(&mut self, limit: Duration) -> Result<bool, BackendError> {
        self.gpu.journal.call(Call::Wait { encoder: self.owned.name.clone(), blocks: !limit.is_zero() });
        self.gpu.check_lost("wait")?;
        if self.gpu.journal.fails(Point::Wait) {
            let reason = "a fault prevents the wait".to_string();
            return Err(BackendError::OutOfMemory { name: "a wait".to_string(), bytes: 0, reason });
        }
        if self.gpu.journal.is_hung(Some(&self.owned)) {
            std::thread::sleep(limit);
            return Ok(false);
        }
        self.gpu.journal.complete(Some(&self.owned));
        Ok(true)
    }

    fn push_label(&mut self, name: Arguments) {
        self.call(Call::PushLabel(name.to_string()));
    }

    fn pop_label(&mut self) {
        self.call(Call::PopLabel);
    }

    fn synchronize<'a>(
        &mut self,
        synchronization: &Synchronization,
        at: Option<PassId>,
        image: impl Fn(ResourceId) -> Option<&'a Image<NullGpu>>,
    ) {
        let (dependencies, changes) = synchronization.at(at);
        let changed =
            changes.iter().filter_map(|change| Some((image(change.image)?, change.old, change.new)));
        let images: Vec<_> = changed.map(|(image, old, new)| (self.image(image), old, new)).collect();
        if *dependencies > 0 || !changes.is_empty() {
            self.call(Call::Synchronize { dependencies: *dependencies, images });
        }
    }

    fn full_barrier<'a>(&mut self, changes: impl Iterator<Item = ImageLayout<'a, NullGpu>>) {
        let images = changes.map(|change| (self.image(change.image), change.old, change.new)).collect();
        self.call(Call::FullBarrier { images });
    }

    fn after_copy(&mut self, target: &Buffer<NullGpu>, range: Range<u64>) {
        let target = self.buffer(target);
        self.call(Call::AfterCopy { target, range });
    }

    fn copies_to_host(&mut self) {
        self.call(Call::CopiesToHost);
    }

    fn bind(&mut self, pipelines: &Owned, bindings: &Bindings, id: PassId, pass: &Pass, slot: usize) {
        self.used.insert(Used::Object(pipelines.number));
        self.used.insert(Used::Object(bindings.owned.number));
        if let Some(copies) = bindings.passes.get(&id) {
            let copy = slot % copies.len();
            self.used.insert(Used::Bindings(bindings.owned.number, id.0, copy));
            self.used.extend(copies[copy].values().map(|&number| Used::Object(number)));
            // The runtime has written every binding by now.
            if copies[copy].len() < pass.bindings.len() {
                let message = format!("pass `{}` runs before all its bindings are written", pass.name);
                self.owned.journal.messages().add(message);
            }
        }
        self.call(Call::BindPass { pass: pass.name.clone(), slot });
    }

    fn dispatch(&mut self, groups: [u32; 3]) {
        self.call(Call::Dispatch(groups));
    }

    fn dispatch_indirect(&mut self, arguments: &Buffer<NullGpu>, offset: u64) {
        let arguments = self.buffer(arguments);
        self.call(Call::DispatchIndirect { arguments, offset });
    }

    fn draw<'a>(
        &mut self,
        targets: impl Iterator<Item = (&'a Target, &'a Image<NullGpu>)>,
        depth: Option<(DepthAccess, &'a Image<NullGpu>)>,
        draw: Draw<NullGpu>,
    ) {
        let mut targets: Vec<String> = targets.map(|(_, image)| self.image(image)).collect();
        targets.extend(depth.map(|(_, image)| self.image(image)));
        let call = match draw {
            Draw::Direct { vertices, instances } => Call::Draw { targets, vertices, instances },
            Draw::Indirect(buffer, offset) => {
                Call::DrawIndirect { targets, arguments: self.buffer(buffer), offset }
            }
        };
        self.call(call);
    }

    fn fill(&mut self, buffer: &Buffer<NullGpu>, value: u32) {
        let buffer = self.buffer(buffer);
        self.call(Call::Fill { buffer, value });
    }

    fn clear(&mut self, image: &Image<NullGpu>) {
        let image = self.image(image);
        self.call(Call::Clear { image });
    }

    fn copy_buffer(&mut self, source: (&Buffer<NullGpu>, u64), target: (&Buffer<NullGpu>, u64), bytes: u64) {
        for (buffer, offset) in [source, target] {
            if offset + bytes > buffer.bytes {
                let message = format!("a copy goes beyond the end of `{}`", buffer.raw.name);
                self.owned.journal.messages().add(message);
            }
        }
        let (source, target) = ((self.buffer(source.0), source.1), (self.buffer(target.0), target.1));
        self.call(Call::CopyBuffer { source, target, bytes });
    }

    fn copy_image(&mut self, image: &Image<NullGpu>, target: &Buffer<NullGpu>) {
        if image.bytes() > target.bytes {
            let message = format!("a copy goes beyond the end of `{}`", target.raw.name);
            self.owned.journal.messages().add(message);
        }
        let (image, target) = (self.image(image), self.buffer(target));
        self.call(Call::CopyImage { image, target });
    }

    fn copy_to_image(&mut self, image: &Image<NullGpu>, target: &Image<NullGpu>) {
        if (image.format, image.size) != (target.format, target.size) {
            let message = format!("`{}` is copied to an image of another shape", image.raw.name);
            self.owned.journal.messages().add(message);
        }
        let (image, target) = (self.image(image), self.image(target));
        self.call(Call::CopyToImage { image, target });
    }

    fn reset_timestamps(&mut self, timestamps: &Timestamps, count: u32) {
        let mut ticks = lock(&timestamps.ticks);
        ticks[..count as usize].fill(None);
        self.call(Call::ResetTimestamps { count });
    }

    fn timestamp(&mut self, timestamps: &Timestamps, index: u32) {
        self.timestamps.push((timestamps.ticks.clone(), index));
        self.call(Call::Timestamp { index });
    }
}
