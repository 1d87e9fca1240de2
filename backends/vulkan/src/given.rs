//! Buffers that come with a frame ([`Source::Given`]).
//!
//! A plan holds each once per frame in flight, as a [`Given`]. Words of the host are copied to a mapped buffer that grows when
//! it must (to a power of two, so that a length that creeps up does not make a buffer per frame), and are not copied where they
//! are there already. A picture is not copied: the frame reads it where it is.
//!
//! So a frame's descriptors may have to point elsewhere, or to another length, than those of the last frame in the same slot.
//! They are rewritten when the frame is submitted; nothing of that slot is in flight then.

use crate::error::mib;
use crate::gpu::Gpu;
use crate::limits::invalid;
use crate::loaded::Loaded;
use crate::lower;
use crate::memory::{Buffer, Memory};
use crate::picture::PictureBuffer;
use splatgraph_api::{self as api, BackendError, FrameInputs};
use splatgraph_framework::ir::{ResourceId, Shape, Source};
use splatgraph_framework::plan::Resource;
use std::sync::Arc;

/// What a resource holds for the frame in one slot.
#[derive(Default)]
pub(crate) struct Given {
    /// For words of the host; made when the first come.
    own: Option<Buffer>,
    /// What is in `own`. The words cannot change as long as this holds them.
    words: Option<Arc<Vec<u8>>>,
    /// Held instead of words, while the frame is recorded.
    picture: Option<Arc<PictureBuffer>>,
    /// What the frame that is about to be recorded reads.
    holds: Contents,
    /// What the slot's descriptors point to.
    written: Contents,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum Contents {
    #[default]
    Nothing,
    /// So many bytes of the buffer for words.
    Words(u64),
    /// The picture with this id. (No two ever have the same, so that it is the same buffer.)
    Picture(u64),
}

impl Given {
    /// Takes what a frame gives. The slot must have nothing in flight.
    fn take(&mut self, gpu: &Arc<Gpu>, resource: &Resource, given: &api::Given) -> Result<(), BackendError> {
        match given {
            api::Given::Bytes(words) => {
                check_length(resource, words.len() as u64, gpu.limits.max_storage_bytes)?;
                self.copy(gpu, resource, words)?;
                self.picture = None;
                self.holds = Contents::Words(words.len() as u64);
            }
            api::Given::Picture(picture) => {
                let Some(found) = gpu.pictures.find(picture) else {
                    return invalid(format!(
                        "the frame was given the picture {} for `{}`, which is not there (any more): the one that drew \
                         it has another by now or is gone, or it is of another device",
                        picture.id, resource.name
                    ));
                };
                check_length(resource, found.buffer.bytes, gpu.limits.max_storage_bytes)?;
                self.holds = Contents::Picture(picture.id);
                self.picture = Some(found);
            }
        }
        Ok(())
    }

    /// Brings words to the buffer for them.
    fn copy(
        &mut self,
        gpu: &Arc<Gpu>,
        resource: &Resource,
        words: &Arc<Vec<u8>>,
    ) -> Result<(), BackendError> {
        let bytes = words.len() as u64;
        if self.own.as_ref().is_none_or(|own| own.bytes < bytes) {
            let capacity = capacity(bytes, gpu.limits.max_buffer_bytes);
            let buffer = Buffer::to_device(gpu, &resource.name, capacity, lower::buffer_usage(resource))?;
            // Where the descriptors point to is gone with the buffer before.
            (self.words, self.written) = (None, Contents::Nothing);
            self.own = Some(buffer);
        }
        if self.words.as_ref().is_some_and(|there| Arc::ptr_eq(there, words)) {
            return Ok(());
        }
        let target = self.own.as_mut().and_then(|own| own.mapped_mut().get_mut(..words.len()));
        let Some(target) = target else {
            let answer = format!("the memory of `{}` is not mapped", resource.name);
            return Err(BackendError::Api { call: "allocate", answer });
        };
        target.copy_from_slice(words);
        self.words = Some(words.clone());
        Ok(())
    }

    /// What the frame reads, and how many bytes of it; none before it was given.
    pub fn held(&self) -> Option<(&Buffer, u64)> {
        match self.holds {
            Contents::Nothing => None,
            Contents::Words(bytes) => Some((self.own.as_ref()?, bytes)),
            Contents::Picture(_) => self.picture.as_ref().map(|held| (&held.buffer, held.buffer.bytes)),
        }
    }

    /// Gives the picture away, to be kept until the frame is done.
    pub fn let_go(&mut self) -> Option<Arc<PictureBuffer>> {
        self.picture.take()
    }

    /// The memory of its own.
    pub fn memory(&self) -> Option<&Arc<Memory>> {
        self.own.as_ref().map(|own| &own.memory)
    }
}

/// Takes all that the plan wants to be given for a frame in `slot`, and points the slot's descriptors to it.
///
/// # Errors
/// [`BackendError::Invalid`] for a buffer that is missing, too short or not whole elements, and for a picture that is gone;
/// [`BackendError::Limit`] for one that is longer than a storage binding may be.
pub(crate) fn take(
    gpu: &Arc<Gpu>,
    loaded: &mut Loaded,
    slot: usize,
    inputs: &FrameInputs,
) -> Result<(), BackendError> {
    let Loaded { plan, resources, sets, .. } = loaded;
    let mut changed = Vec::new();
    for (index, resource) in plan.resources.iter().enumerate() {
        let (id, Source::Given { buffer }) = (ResourceId(index as u32), &resource.source) else { continue };
        let Some(given) = inputs.buffers.get(buffer) else {
            return invalid(format!("the frame was given no buffer `{buffer}`"));
        };
        let Some(held) = resources.given_mut(id, slot) else { continue };
        held.take(gpu, resource, given)?;
        if held.holds != held.written {
            changed.push(id);
        }
    }
    sets.rewrite(gpu, plan, resources, slot, &changed);
    for id in changed {
        if let Some(held) = resources.given_mut(id, slot) {
            held.written = held.holds;
        }
    }
    Ok(())
}

/// Whole elements, at least as many as the plan counts on, and no more than a binding may have.
fn check_length(resource: &Resource, bytes: u64, most: u64) -> Result<(), BackendError> {
    let Shape::Buffer { stride, .. } = resource.shape else { return Ok(()) };
    let (name, least) = (&resource.name, resource.bytes());
    if bytes < least || !bytes.is_multiple_of(stride) {
        return invalid(format!(
            "the frame was given {bytes} bytes for `{name}`, which wants {least} or more, in elements of {stride}"
        ));
    }
    if bytes > most {
        return Err(BackendError::Limit(format!(
            "the frame was given {} for `{name}`, and a storage binding of this device may have {} at most",
            mib(bytes),
            mib(most)
        )));
    }
    Ok(())
}

/// The size of a buffer for `bytes` bytes, on a device whose buffers may have `most`.
fn capacity(bytes: u64, most: u64) -> u64 {
    bytes.checked_next_power_of_two().map_or(bytes, |capacity| capacity.min(most.max(bytes)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{SPLATS, plan};

    #[test]
    fn buffers_are_powers_of_two_as_far_as_the_device_allows() {
        assert_eq!(capacity(1, 1 << 30), 1);
        assert_eq!(capacity(4096, 1 << 30), 4096);
        assert_eq!(capacity(4097, 1 << 30), 8192);
        assert_eq!(capacity(4097, 5000), 5000);
        assert_eq!(capacity(u64::MAX - 1, u64::MAX), u64::MAX - 1);
    }

    #[test]
    fn a_length_is_whole_elements_no_fewer_than_the_plan_counts_on_and_no_more_than_can_be_bound() {
        let mut resource = plan().resources[SPLATS.index()].clone();
        resource.shape = Shape::Buffer { stride: 8, count: 3 };
        let said =
            |bytes| check_length(&resource, bytes, 80).err().map(|e| e.to_string()).unwrap_or_default();
        assert_eq!((said(24), said(32), said(80)), Default::default());
        assert!(said(16).contains("given 16 bytes for `splats`, which wants 24 or more"), "{}", said(16));
        assert!(said(28).contains("in elements of 8"), "{}", said(28));
        assert!(said(88).contains("given 88 bytes for `splats`, and a storage binding"), "{}", said(88));
        let long = check_length(&resource, 88, 80);
        assert!(matches!(long, Err(BackendError::Limit(_))), "{long:?}");
    }
}
