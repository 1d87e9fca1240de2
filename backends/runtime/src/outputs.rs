//! Shares one executor's output with plans of other executors on the device.
//!
//! To share a frame, an executor copies the frame's output, at the end of the frame, to the executor's only buffer for
//! shared outputs. Plans of other executors read this buffer as a host buffer ([`crate::host_buffers`]).
//!
//! Frames of all executors run on one queue, but no plan knows of the others, so the runtime orders the copy: it waits
//! for all earlier work on the queue, readers included, and all later work waits for it. A reader always sees the
//! complete output of the last shared frame submitted before its own frame.

use crate::check::within_bytes;
use crate::gpu::{Buffer, BufferDesc, Gpu, Image, Location};
use crate::lock::lock;
use splatgraph_api::{BackendError, Picture};
use splatgraph_framework::ir::Usage;
use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, Weak};

/// A shared output with its pixels. It is kept alive by every frame that reads or writes it, until the frame completes.
pub(crate) struct SharedOutput<G: Gpu> {
    pub picture: Picture,
    pub buffer: Buffer<G>,
}

/// The shared outputs of a device: the latest of each executor.
pub(crate) struct SharedOutputs<G: Gpu> {
    next: AtomicU64,
    last: Mutex<HashMap<u64, Weak<SharedOutput<G>>>>,
}

impl<G: Gpu> Default for SharedOutputs<G> {
    fn default() -> Self {
        SharedOutputs { next: AtomicU64::default(), last: Mutex::default() }
    }
}

impl<G: Gpu> SharedOutputs<G> {
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
        // The limit of a storage binding does not apply: a reader can bind a range of rows.
        let what = || format!("the size of a shared output of {width} x {height} pixels");
        within_bytes(what, bytes, gpu.common().limits.max_buffer_bytes)?;
        let picture = Picture { id: self.next.fetch_add(1, Ordering::Relaxed), format, width, height };
        let usage = Usage::STORAGE | Usage::INDIRECT | Usage::COPY_SOURCE | Usage::COPY_TARGET;
        let buffer = Buffer::new(gpu, &BufferDesc { name: "picture", bytes, usage }, Location::Device)?;
        Ok(Arc::new(SharedOutput { picture, buffer }))
    }

    /// Makes the output of a submitted frame available to other executors, in place of the executor's `former` one.
    pub fn enter(&self, output: &Arc<SharedOutput<G>>, former: Option<&Arc<SharedOutput<G>>>) {
        let mut all = lock(&self.last);
        if let Some(former) = former {
            all.remove(&former.picture.id);
        }
        all.insert(output.picture.id, Arc::downgrade(output));
    }

    pub fn remove(&self, output: &SharedOutput<G>) {
        let mut all = lock(&self.last);
        all.remove(&output.picture.id);
    }

    /// Finds a shared output by its picture. `None` if it was replaced, its executor was dropped, or `picture` has
    /// another format or size.
    pub fn find(&self, picture: &Picture) -> Option<Arc<SharedOutput<G>>> {
        let all = lock(&self.last);
        let held = all.get(&picture.id).and_then(Weak::upgrade);
        held.filter(|held| held.picture == *picture)
    }
}
