//! Shared outputs: the output of one executor's plan, for plans of others on the same device to read.
//!
//! An executor whose frame is to be shared copies its output, when the frame is otherwise done, into a buffer on the device. It has
//! one such buffer: the next shared frame writes to it again, and only another size or format makes a new one. A plan of another
//! executor reads it as a host buffer ([`crate::host_buffers`]).
//!
//! Frames of several executors follow one another on one queue, but no plan knows of the others. So the runtime orders the copy
//! itself: the copy waits for everything before it on the queue, readers among it, and everything after it waits for the copy. A
//! reader finds the output of the last frame that was submitted before its own, and always a whole one.

use crate::check::within_bytes;
use crate::gpu::{Buffer, BufferDesc, Gpu, Image, Location};
use splatgraph_api::{BackendError, Picture};
use splatgraph_framework::ir::Usage;
use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError, Weak};

/// A shared output with its pixels. Every frame that writes or reads it holds it until that frame is done.
pub(crate) struct SharedOutput<G: Gpu> {
    pub picture: Picture,
    pub buffer: Buffer<G>,
}

/// The shared outputs that frames can read: the last of each executor of a device.
pub(crate) struct SharedOutputs<G: Gpu> {
    /// The next id.
    next: AtomicU64,
    last: Mutex<HashMap<u64, Weak<SharedOutput<G>>>>,
}

impl<G: Gpu> Default for SharedOutputs<G> {
    fn default() -> Self {
        SharedOutputs { next: AtomicU64::default(), last: Mutex::default() }
    }
}

impl<G: Gpu> SharedOutputs<G> {
    /// Returns the buffer that `image` is copied to: the `current` one, or a new one where that does not fit.
    pub fn target(
        &self,
        gpu: &Arc<G>,
        image: &Image<G>,
        current: Option<&Arc<SharedOutput<G>>>,
    ) -> Result<Arc<SharedOutput<G>>, BackendError> {
        let (format, (width, height)) = (image.format, image.size);
        let fits = |p: &Picture| (p.format, p.width, p.height) == (format, width, height);
        if let Some(current) = current.filter(|current| fits(&current.picture)) {
            return Ok(current.clone());
        }
        let bytes = image.bytes();
        // A reader may bind less than the whole of it.
        let what = || format!("the size of a shared output of {width} x {height} pixels");
        within_bytes(what, bytes, gpu.limits().max_buffer_bytes)?;
        let picture = Picture { id: self.next.fetch_add(1, Ordering::Relaxed), format, width, height };
        let usage = Usage::STORAGE | Usage::INDIRECT | Usage::COPY_SOURCE | Usage::COPY_TARGET;
        let buffer = Buffer::new(gpu, &BufferDesc { name: "picture", bytes, usage }, Location::Device)?;
        Ok(Arc::new(SharedOutput { picture, buffer }))
    }

    /// Enters the output of a submitted frame in place of the executor's former one.
    pub fn enter(&self, output: &Arc<SharedOutput<G>>, former: Option<&Arc<SharedOutput<G>>>) {
        let mut all = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(former) = former {
            all.remove(&former.picture.id);
        }
        all.insert(output.picture.id, Arc::downgrade(output));
    }

    /// Removes the output of an executor that is dropped.
    pub fn remove(&self, output: &SharedOutput<G>) {
        let mut all = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        all.remove(&output.picture.id);
    }

    /// Finds a shared output that frames can read.
    pub fn find(&self, picture: &Picture) -> Option<Arc<SharedOutput<G>>> {
        let all = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        let held = all.get(&picture.id).and_then(Weak::upgrade);
        held.filter(|held| held.picture == *picture)
    }
}
