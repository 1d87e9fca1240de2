//! Uploads of the scene, in chunks through staging memory.
//!
//! The staging memory has two halves: while the device copies out of one, the host fills the other. However large the scene, no
//! more than twice [`CHUNK`] bytes are mapped, and progress is reported after every chunk.

use crate::attributes::{PlaneKey, Planes};
use crate::gpu::{Buffer, BufferDesc, Encoder, Gpu, Location};
use crate::shared::Shared;
use crate::watch::{Submission, Ticket};
use splatgraph_api::{BackendError, Progress, SceneData};
use splatgraph_framework::ir::Usage;

/// Bytes of one copy at most.
const CHUNK: u64 = 16 << 20;

/// Reads the planes `missing` from the scene and uploads them. When this returns, also with an error, the device uses none of
/// them any more: they are uploaded, or can be dropped. (Those of a copy that does not come to its end are kept.)
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
    Uploader::new(shared, missing, planes)?.run(scene, missing, progress)
}

/// Staging memory for one chunk.
struct Half<G: Gpu> {
    staging: Buffer<G>,
    encoder: G::Encoder,
    /// The copy on its way.
    busy: Option<Ticket<G>>,
}

struct Uploader<'a, G: Gpu> {
    shared: &'a Shared<G>,
    planes: &'a Planes<Buffer<G>>,
    /// Two.
    halves: Vec<Half<G>>,
    done: u64,
    total: u64,
}

impl<'a, G: Gpu> Uploader<'a, G> {
    fn new(
        shared: &'a Shared<G>,
        missing: &[PlaneKey],
        planes: &'a Planes<Buffer<G>>,
    ) -> Result<Self, BackendError> {
        let gpu = &shared.gpu;
        let total: u64 = missing.iter().map(|key| key.bytes).sum();
        let desc = BufferDesc { name: "staging", bytes: total.min(CHUNK), usage: Usage::COPY_SOURCE };
        let half = || -> Result<Half<G>, BackendError> {
            Ok(Half {
                staging: Buffer::new(gpu, &desc, Location::Upload)?,
                encoder: gpu.create_encoder("upload")?,
                busy: None,
            })
        };
        Ok(Uploader { shared, planes, halves: vec![half()?, half()?], done: 0, total })
    }

    fn run(
        &mut self,
        scene: &dyn SceneData,
        missing: &[PlaneKey],
        progress: &mut dyn FnMut(Progress),
    ) -> Result<(), BackendError> {
        progress(Progress::Upload { done_bytes: 0, of_bytes: self.total });
        let mut bytes = Vec::new();
        let mut next = 0;
        for key in missing {
            bytes.clear();
            bytes.resize(key.bytes as usize, 0);
            scene.write(&key.attribute, key.plane, &mut bytes).map_err(|reason| BackendError::Scene {
                attribute: key.attribute.clone(),
                plane: key.plane,
                reason,
            })?;
            let target = &self.planes[key];
            for (index, chunk) in bytes.chunks(CHUNK as usize).enumerate() {
                self.send(next, chunk, target, index as u64 * CHUNK)?;
                next = 1 - next;
                self.done += chunk.len() as u64;
                progress(Progress::Upload { done_bytes: self.done, of_bytes: self.total });
            }
        }
        self.wait(0)?;
        self.wait(1)
    }

    /// Copies `chunk` to byte `offset` of `target` through one of the halves.
    fn send(
        &mut self,
        half: usize,
        chunk: &[u8],
        target: &Buffer<G>,
        offset: u64,
    ) -> Result<(), BackendError> {
        self.wait(half)?;
        let Half { staging, encoder, busy } = &mut self.halves[half];
        let bytes = chunk.len() as u64;
        staging.mapped_mut()[..chunk.len()].copy_from_slice(chunk);
        encoder.begin()?;
        encoder.copy_buffer((staging, 0), (target, offset), bytes);
        encoder.after_copy(target, offset..offset + bytes);
        encoder.end()?;
        self.shared.gpu.submit(encoder, None)?;
        *busy = Some(self.shared.watch.enter(Submission { frame: None }));
        Ok(())
    }

    fn wait(&mut self, half: usize) -> Result<(), BackendError> {
        let Half { encoder, busy, .. } = &mut self.halves[half];
        if let Some(ticket) = busy {
            self.shared.watch.wait(&self.shared.gpu, encoder, ticket)?;
            *busy = None;
        }
        Ok(())
    }
}

impl<G: Gpu> Drop for Uploader<'_, G> {
    /// Waits for the copies that an error, or a panic of the scene's, leaves on their way.
    fn drop(&mut self) {
        let mut stuck = false;
        for half in 0..self.halves.len() {
            // A device that is lost has nothing left to do.
            stuck |= matches!(self.wait(half), Err(BackendError::Stuck { .. }));
        }
        if stuck {
            let planes: Vec<_> = self.planes.values().cloned().collect();
            self.shared.abandon((std::mem::take(&mut self.halves), planes));
        }
    }
}
