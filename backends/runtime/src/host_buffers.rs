//! Manages host buffers, whose contents come with each frame
//! ([`Source::HostBuffer`](splatgraph_framework::ir::Source::HostBuffer)).
//!
//! A plan has each host buffer once per frame in flight. Host bytes are copied to a mapped buffer, unless it already
//! holds them; the buffer grows to powers of two. A shared output is read in place. When a frame is submitted, the
//! slot's bindings are rewritten if the buffer or its length differs from the slot's previous frame.

use crate::check::{invalid, within_bytes};
use crate::gpu::{Buffer, BufferDesc, Gpu, Location};
use crate::outputs::SharedOutput;
use crate::shared::Shared;
use crate::usage::usage;
use splatgraph_api::{BackendError, BufferContents, Picture, ROWS_ALIGNMENT};
use splatgraph_framework::ir::{Shape, Usage};
use splatgraph_framework::plan::Resource;
use std::ops::Range;
use std::sync::Arc;

pub(crate) struct HostBuffer<G: Gpu> {
    /// Mapped buffer for host bytes; `None` before the first host bytes.
    own: Option<Buffer<G>>,
    /// The bytes that `own` contains. Holding the `Arc` keeps them from changing.
    bytes: Option<Arc<Vec<u8>>>,
    /// The shared output that the next recorded frame reads; `None` if it reads bytes, and once the output is taken.
    output: Option<Arc<SharedOutput<G>>>,
    /// The contents that the frame about to be recorded reads.
    holds: Contents,
    /// The contents that the slot's bindings point to.
    written: Contents,
}

#[derive(Clone, Debug, Default, PartialEq)]
enum Contents {
    #[default]
    Nothing,
    Bytes(u64),
    /// A byte range of the shared output with this id. Ids are never reused, so an equal id is the same buffer.
    Output(u64, Range<u64>),
}

impl<G: Gpu> Default for HostBuffer<G> {
    fn default() -> Self {
        HostBuffer {
            own: None,
            bytes: None,
            output: None,
            holds: Contents::Nothing,
            written: Contents::Nothing,
        }
    }
}

impl<G: Gpu> HostBuffer<G> {
    /// Sets the contents for a frame. The slot must have nothing in flight.
    ///
    /// # Errors
    /// [`BackendError::Invalid`] if the contents are too short or not whole elements, the shared output does not exist,
    /// or its rows cannot be bound; [`BackendError::Limit`] if the contents exceed a storage binding's limit;
    /// [`BackendError::OutOfMemory`].
    pub fn take(
        &mut self,
        shared: &Shared<G>,
        resource: &Resource,
        contents: &BufferContents,
    ) -> Result<(), BackendError> {
        let most = shared.gpu.common().limits.facts.max_storage_bytes;
        match contents {
            BufferContents::Bytes(bytes) => {
                check_length(resource, bytes.len() as u64, most)?;
                self.copy(&shared.gpu, resource, bytes)?;
                self.output = None;
                self.holds = Contents::Bytes(bytes.len() as u64);
            }
            BufferContents::Picture(picture) | BufferContents::Rows { picture, .. } => {
                let Some(found) = shared.outputs.find(picture) else {
                    return invalid(format!(
                        "host buffer `{}` was given the picture {}, which does not exist: its executor has shared another \
                         since or was dropped, or it belongs to another device",
                        resource.name, picture.id
                    ));
                };
                let range = match *contents {
                    BufferContents::Rows { first, count, .. } => rows(resource, picture, first, count)?,
                    _ => 0..found.buffer.bytes,
                };
                check_length(resource, range.end - range.start, most)?;
                self.holds = Contents::Output(picture.id, range);
                self.output = Some(found);
            }
        }
        Ok(())
    }

    fn copy(&mut self, gpu: &Arc<G>, resource: &Resource, bytes: &Arc<Vec<u8>>) -> Result<(), BackendError> {
        let length = bytes.len() as u64;
        if self.own.as_ref().is_none_or(|own| own.bytes < length) {
            let capacity = capacity(length, gpu.common().limits.max_buffer_bytes);
            let desc = BufferDesc { name: &resource.name, bytes: capacity, usage: usage(resource) };
            let buffer = Buffer::new(gpu, &desc, Location::Upload)?;
            // The bindings refer to the old buffer, which is dropped.
            (self.bytes, self.written) = (None, Contents::Nothing);
            self.own = Some(buffer);
        }
        if self.bytes.as_ref().is_some_and(|held| Arc::ptr_eq(held, bytes)) {
            return Ok(());
        }
        let target = self.own.as_mut().and_then(|own| own.mapped_mut().get_mut(..bytes.len()));
        let Some(target) = target else {
            let answer = format!("the memory of `{}` is not mapped", resource.name);
            return Err(BackendError::Api { call: "allocate", answer });
        };
        target.copy_from_slice(bytes);
        self.bytes = Some(bytes.clone());
        Ok(())
    }

    /// Returns the buffer and the byte range that the frame reads. `None` before the first contents, and once
    /// [`HostBuffer::take_output`] has taken the shared output.
    pub fn binding(&self) -> Option<(&Buffer<G>, Range<u64>)> {
        match &self.holds {
            Contents::Nothing => None,
            Contents::Bytes(bytes) => Some((self.own.as_ref()?, 0..*bytes)),
            Contents::Output(_, range) => self.output.as_ref().map(|held| (&held.buffer, range.clone())),
        }
    }

    pub fn is_changed(&self) -> bool {
        self.holds != self.written
    }

    pub fn set_written(&mut self) {
        self.written = self.holds.clone();
    }

    /// Takes the shared output, if any, out of the slot. The caller keeps it until the frame has completed.
    pub fn take_output(&mut self) -> Option<Arc<SharedOutput<G>>> {
        self.output.take()
    }

    pub fn memory(&self) -> Option<&Arc<G::Memory>> {
        self.own.as_ref().map(|own| &own.memory)
    }
}

fn check_length(resource: &Resource, bytes: u64, most: u64) -> Result<(), BackendError> {
    let Shape::Buffer { stride, .. } = resource.shape else { return Ok(()) };
    let (name, least) = (&resource.name, resource.bytes());
    if bytes < least || !bytes.is_multiple_of(stride) {
        return invalid(format!(
            "host buffer `{name}`: expected {least} bytes or more in elements of {stride}, found {bytes} bytes"
        ));
    }
    within_bytes(|| format!("the size of the contents of host buffer `{name}`"), bytes, most)
}

fn rows(resource: &Resource, picture: &Picture, first: u32, count: u32) -> Result<Range<u64>, BackendError> {
    let row = u64::from(picture.width) * u64::from(picture.format.bytes_per_pixel());
    let (from, to) = (u64::from(first) * row, (u64::from(first) + u64::from(count)) * row);
    let name = &resource.name;
    if count == 0 || to > u64::from(picture.height) * row {
        return invalid(format!(
            "host buffer `{name}` was given {count} rows from row {first} on, of a picture of {} rows",
            picture.height
        ));
    }
    if !from.is_multiple_of(ROWS_ALIGNMENT) || resource.usage.contains(Usage::INDIRECT) && from > 0 {
        return invalid(format!(
            "host buffer `{name}` was given rows of a picture starting at byte {from}: expected a multiple of {ROWS_ALIGNMENT}, and \
             0 for arguments of indirect calls"
        ));
    }
    Ok(from..to)
}

/// Returns the size to allocate for `bytes` bytes: the next power of two, capped at `most`, the device's limit.
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
    fn rows_of_a_picture_are_within_it_and_begin_at_a_place_that_can_be_bound() {
        let mut resource = plan().resources[SPLATS.index()].clone();
        resource.usage = Usage::STORAGE;
        let format = splatgraph_framework::ir::Format::Rgba32Float;
        let picture = Picture { id: 1, format, width: 4, height: 40 };
        assert_eq!(rows(&resource, &picture, 4, 36), Ok(256..2560));
        assert_eq!(rows(&resource, &picture, 0, 1), Ok(0..64));
        let said = |first, count| rows(&resource, &picture, first, count).err().map(|e| e.to_string());
        assert!(
            said(4, 37).is_some_and(|text| text.contains("37 rows from row 4 on, of a picture of 40 rows"))
        );
        assert!(said(u32::MAX, u32::MAX).is_some() && said(0, 0).is_some());
        assert!(said(3, 1).is_some_and(|text| text.contains("at byte 192")));
        resource.usage |= Usage::INDIRECT;
        assert!(rows(&resource, &picture, 4, 1).is_err() && rows(&resource, &picture, 0, 1).is_ok());
    }

    #[test]
    fn a_length_is_whole_elements_no_fewer_than_the_plan_counts_on_and_no_more_than_can_be_bound() {
        let mut resource = plan().resources[SPLATS.index()].clone();
        resource.shape = Shape::Buffer { stride: 8, count: 3 };
        let said =
            |bytes| check_length(&resource, bytes, 80).err().map(|e| e.to_string()).unwrap_or_default();
        assert_eq!((said(24), said(32), said(80)), Default::default());
        let short = "host buffer `splats`: expected 24 bytes or more in elements of 8, found 16 bytes";
        assert_eq!(said(16), short);
        assert!(said(28).contains("in elements of 8, found 28 bytes"), "{}", said(28));
        assert!(said(88).contains("expected at most 80 bytes, found 88 bytes"), "{}", said(88));
        let long = check_length(&resource, 88, 80);
        assert!(matches!(long, Err(BackendError::Limit(_))), "{long:?}");
    }
}
