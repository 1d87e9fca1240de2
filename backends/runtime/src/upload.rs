//! Uploads the scene in chunks, through staging memory.
//!
//! The staging memory has two halves: the scene writes one while the device copies from the other. Whatever the scene's
//! size, at most two [`CHUNK`]s (or two entries, if longer) are mapped, nothing else is allocated, and progress is
//! reported after every chunk.

use crate::attributes::{PlaneKey, Planes};
use crate::gpu::{Buffer, BufferDesc, Encoder, Gpu, Location};
use crate::shared::Shared;
use crate::watch::Ticket;
use splatgraph_api::{BackendError, Progress, SceneData};
use splatgraph_framework::ir::Usage;
use std::ops::Range;
use tracing::info_span;

/// Maximum size of one copy, in bytes, unless a single entry is longer. A copy has whole entries.
const CHUNK: u64 = 16 << 20;

/// Uploads the `missing` planes of the scene.
///
/// When it returns, even with an error, the caller may drop the planes: if a copy may still run, they are kept alive.
pub(crate) fn upload<G: Gpu>(
    shared: &Shared<G>,
    scene: &dyn SceneData,
    missing: &[PlaneKey],
    planes: &Planes<Buffer<G>>,
    progress: &mut dyn FnMut(Progress),
) -> Result<(), BackendError> {
    if missing.is_empty() {
        return Ok(());
    }
    let _span = info_span!("upload the scene").entered();
    Uploader::new(shared, missing, planes)?.run(scene, progress)
}

struct Half<G: Gpu> {
    staging: Buffer<G>,
    encoder: G::Encoder,
    busy: Option<Ticket<G>>,
}

struct Uploader<'a, G: Gpu> {
    shared: &'a Shared<G>,
    missing: &'a [PlaneKey],
    planes: &'a Planes<Buffer<G>>,
    halves: Vec<Half<G>>,
    total: u64,
}

impl<'a, G: Gpu> Uploader<'a, G> {
    fn new(
        shared: &'a Shared<G>,
        missing: &'a [PlaneKey],
        planes: &'a Planes<Buffer<G>>,
    ) -> Result<Self, BackendError> {
        let gpu = &shared.gpu;
        let total: u64 = missing.iter().map(|key| key.bytes).sum();
        let longest = missing.iter().map(|key| key.bytes.min(key.stride.max(CHUNK))).max().unwrap_or(0);
        let desc = BufferDesc { name: "staging", bytes: longest, usage: Usage::COPY_SOURCE };
        let half = || -> Result<Half<G>, BackendError> {
            Ok(Half {
                staging: Buffer::new(gpu, &desc, Location::Staging)?,
                encoder: G::Encoder::new(gpu, "upload")?,
                busy: None,
            })
        };
        Ok(Uploader { shared, missing, planes, halves: vec![half()?, half()?], total })
    }

    fn run(&mut self, scene: &dyn SceneData, progress: &mut dyn FnMut(Progress)) -> Result<(), BackendError> {
        progress(Progress::Upload { done_bytes: 0, of_bytes: self.total });
        let (mut next, mut done) = (0, 0);
        for key in self.missing {
            let chunk = (CHUNK / key.stride.max(1)).max(1) * key.stride.max(1);
            let mut offset = 0;
            while offset < key.bytes {
                let bytes = chunk.min(key.bytes - offset);
                self.send(next, scene, key, offset..offset + bytes)?;
                next = 1 - next;
                offset += bytes;
                done += bytes;
                progress(Progress::Upload { done_bytes: done, of_bytes: self.total });
            }
        }
        self.wait(0)?;
        self.wait(1)
    }

    fn send(
        &mut self,
        half: usize,
        scene: &dyn SceneData,
        key: &PlaneKey,
        range: Range<u64>,
    ) -> Result<(), BackendError> {
        self.wait(half)?;
        let Half { staging, encoder, busy } = &mut self.halves[half];
        let (target, bytes) = (&self.planes[key], range.end - range.start);
        let memory = &mut staging.mapped_mut()[..bytes as usize];
        let written = info_span!("convert for the device", attribute = key.attribute, bytes)
            .in_scope(|| scene.write(&key.attribute, key.plane, range.start, memory));
        written.map_err(|reason| BackendError::Scene {
            attribute: key.attribute.clone(),
            plane: key.plane,
            reason,
        })?;
        encoder.begin()?;
        encoder.copy_buffer((staging, 0), (target, range.start), bytes);
        encoder.after_copy(target, range);
        encoder.end()?;
        *busy = Some(self.shared.watch.submit(None, || encoder.submit(None))?);
        Ok(())
    }

    fn wait(&mut self, half: usize) -> Result<(), BackendError> {
        let Half { encoder, busy, .. } = &mut self.halves[half];
        if let Some(ticket) = busy {
            let _span = info_span!("wait for a copy").entered();
            self.shared.watch.wait(&self.shared.gpu, encoder, ticket)?;
            *busy = None;
        }
        Ok(())
    }
}

impl<G: Gpu> Drop for Uploader<'_, G> {
    /// Waits for copies still in flight, after an error or a panic of the scene.
    fn drop(&mut self) {
        let mut in_use = false;
        for half in 0..self.halves.len() {
            // A lost device has no work left.
            in_use |= !matches!(self.wait(half), Ok(()) | Err(BackendError::DeviceLost(_)));
        }
        if in_use {
            let planes: Vec<_> = self.planes.values().cloned().collect();
            self.shared.abandon((std::mem::take(&mut self.halves), planes));
        }
    }
}
