//! Pictures: what one executor drew, for others on the same device to read.
//!
//! An executor whose frame is to be shown copies its output, when the frame is otherwise done, into a buffer on the device, which
//! is its picture. It has one: the next frame that is shown writes to the same buffer, and only another size or format makes a
//! new one. A plan of another executor is given the picture as a buffer of its frame ([`crate::given`]).
//!
//! Frames of several executors come one after another on one queue, but no plan knows of the others. So the order of the copy
//! and of those that read it is the backend's own: the copy waits for whatever came before it on the queue, frames that read the
//! picture among it, and whatever comes after it waits for the copy. A reader thus finds the last picture whose frame was
//! submitted before its own, and always a whole one.

use crate::barriers::Scope;
use crate::error::mib;
use crate::gpu::Gpu;
use crate::memory::{Buffer, Image};
use crate::record::Recorder;
use ash::vk;
use splatgraph_api::{BackendError, Picture};
use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError, Weak};

/// A picture and its pixels. Every frame that writes or reads it holds it, until that frame is done.
pub(crate) struct PictureBuffer {
    pub picture: Picture,
    pub buffer: Buffer,
}

impl PictureBuffer {
    /// The picture that `image` is copied to: the one that there is, or another if that does not fit.
    pub fn of(
        gpu: &Arc<Gpu>,
        image: &Image,
        there: Option<&Arc<PictureBuffer>>,
    ) -> Result<Arc<PictureBuffer>, BackendError> {
        let (format, vk::Extent2D { width, height }) = (image.format, image.extent);
        let fits = |p: &Picture| (p.format, p.width, p.height) == (format, width, height);
        if let Some(there) = there.filter(|there| fits(&there.picture)) {
            return Ok(there.clone());
        }
        let picture = Picture { id: gpu.pictures.number(), format, width, height };
        let bytes = image.bytes();
        check_size(&picture, bytes, gpu.limits.max_storage_bytes)?;
        let usage = vk::BufferUsageFlags::STORAGE_BUFFER
            | vk::BufferUsageFlags::INDIRECT_BUFFER
            | vk::BufferUsageFlags::TRANSFER_SRC
            | vk::BufferUsageFlags::TRANSFER_DST;
        let buffer = Buffer::on_device(gpu, "picture", bytes, usage)?;
        Ok(Arc::new(PictureBuffer { picture, buffer }))
    }
}

/// Whoever is given the picture binds the whole of it.
fn check_size(picture: &Picture, bytes: u64, most: u64) -> Result<(), BackendError> {
    if bytes <= most {
        return Ok(());
    }
    Err(BackendError::Limit(format!(
        "a picture of {} x {} pixels is {}, and a storage binding of this device may have {} at most",
        picture.width,
        picture.height,
        mib(bytes),
        mib(most)
    )))
}

/// The pictures that frames can be given: of each executor of a device, the last.
#[derive(Default)]
pub(crate) struct Pictures {
    /// How many there ever were: the next one's id.
    numbers: AtomicU64,
    last: Mutex<HashMap<u64, Weak<PictureBuffer>>>,
}

impl Pictures {
    fn number(&self) -> u64 {
        self.numbers.fetch_add(1, Ordering::Relaxed)
    }

    /// An executor's frame with this picture was submitted; before, it had another, or none.
    pub fn enter(&self, picture: &Arc<PictureBuffer>, before: Option<&Arc<PictureBuffer>>) {
        let mut all = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(before) = before {
            all.remove(&before.picture.id);
        }
        all.insert(picture.picture.id, Arc::downgrade(picture));
    }

    /// The executor is gone, and nobody will be given its picture any more.
    pub fn remove(&self, picture: &PictureBuffer) {
        let mut all = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        all.remove(&picture.picture.id);
    }

    /// The pixels of a picture that frames can be given.
    pub fn find(&self, picture: &Picture) -> Option<Arc<PictureBuffer>> {
        let all = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        let there = all.get(&picture.id).and_then(Weak::upgrade);
        there.filter(|there| there.picture == *picture)
    }
}

/// What copies write.
const COPIES: Scope =
    Scope { stages: vk::PipelineStageFlags2::COPY, accesses: vk::AccessFlags2::TRANSFER_WRITE };

/// Whatever came before on the queue. What it read needs no access here, and only copies write to a picture.
const BEFORE: Scope =
    Scope { stages: vk::PipelineStageFlags2::ALL_COMMANDS, accesses: vk::AccessFlags2::TRANSFER_WRITE };

/// Whatever reads later on the queue.
const READERS: Scope =
    Scope { stages: vk::PipelineStageFlags2::ALL_COMMANDS, accesses: vk::AccessFlags2::MEMORY_READ };

impl Recorder<'_> {
    /// Copies the output, which the export left in the layout of a transfer's source, to the frame's picture, if it has one.
    pub(crate) fn copy_to_picture(&self) {
        let Some(target) = self.picture else { return };
        self.gpu.begin_label(self.commands, "picture");
        self.picture_barrier(target, BEFORE, COPIES);
        self.copy_image(self.loaded.plan.output, &target.buffer);
        self.picture_barrier(target, COPIES, READERS);
        self.gpu.end_label(self.commands);
    }

    fn picture_barrier(&self, picture: &PictureBuffer, source: Scope, target: Scope) {
        let barrier = [vk::BufferMemoryBarrier2::default()
            .src_stage_mask(source.stages)
            .src_access_mask(source.accesses)
            .dst_stage_mask(target.stages)
            .dst_access_mask(target.accesses)
            .src_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
            .dst_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
            .buffer(*picture.buffer.raw)
            .size(vk::WHOLE_SIZE)];
        self.pipeline_barrier(&vk::DependencyInfo::default().buffer_memory_barriers(&barrier));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use splatgraph_framework::ir::Format;

    #[test]
    fn a_picture_that_could_not_be_bound_is_a_limit() {
        let picture = Picture { id: 0, format: Format::Rgba8Unorm, width: 1024, height: 512 };
        assert!(check_size(&picture, 2 << 20, 2 << 20).is_ok());
        let error = check_size(&picture, 2 << 20, 1 << 20).expect_err("it is too large");
        assert!(matches!(error, BackendError::Limit(_)), "{error:?}");
        let text = "a picture of 1024 x 512 pixels is 2.0 MiB, and a storage binding of this device may have 1.0 MiB at most";
        assert_eq!(error.to_string(), text);
    }
}
