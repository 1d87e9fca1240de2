//! Finds the JSON and the buffers of a glTF file.

use super::document::{Buffer, BufferView, Document, item};
use crate::error::{SceneError, field, wrong};
use crate::input::{OpenFile, Source};
use crate::json;
use crate::uri::{self, Resource};
use crate::words;
use std::path::Path;

pub(crate) const MAGIC: &[u8; 4] = b"glTF";

/// Maximum size of the JSON, in bytes: parsing takes several times as much memory.
const MAX_JSON: u64 = 16 << 20;

/// Returns true if a file begins as glTF: with its magic number, or with a JSON object. The object must mention
/// `"asset"` or `"buffers"`, and not be a tileset of 3D Tiles.
pub(crate) fn begins_as_gltf(head: &[u8]) -> bool {
    let text = String::from_utf8_lossy(head);
    let is_json = text.trim_start().starts_with('{')
        && ["\"asset\"", "\"buffers\""].iter().any(|key| text.contains(key))
        && !text.contains("\"geometricError\"");
    head.starts_with(MAGIC) || is_json
}

enum Bytes<'a> {
    /// Bytes in the document's own file, from an offset on.
    Within(&'a Source<'a>, u64),
    /// Bytes encoded in the document's text.
    Memory(Vec<u8>),
    /// Bytes in a file beside the document.
    File(OpenFile),
}

pub(super) struct Container<'a> {
    pub document: Document,
    /// Bytes of the file and of the files that its buffers are in.
    pub file_bytes: u64,
    /// Bytes of the file outside its binary chunk and its data URIs.
    pub header_bytes: u64,
    /// Bytes that the data URIs take beyond the bytes that they encode.
    pub encoding_bytes: u64,
    buffers: Vec<(Bytes<'a>, u64)>,
}

fn word(bytes: &[u8], at: usize) -> u64 {
    words::word(bytes, at).into()
}

/// Offset and length of a chunk in the file, in bytes.
type Chunk = (u64, u64);

/// Returns the JSON chunk, and the binary chunk if there is one. A text file is all JSON.
fn chunks(source: &Source) -> Result<(Chunk, Option<Chunk>), SceneError> {
    let length = source.length();
    let head = source.head(20)?;
    if !head.starts_with(MAGIC) {
        return Ok(((0, length), None));
    }
    if head.len() < 20 {
        return Err(field(0, "header", format!("expected 20 bytes, found {}", head.len())));
    }
    if word(&head, 4) != 2 {
        return Err(field(4, "version", format!("expected 2, found {}", word(&head, 4))));
    }
    let total = word(&head, 8);
    if total > length {
        let text = format!("the file is truncated: expected {total} bytes, found {length}");
        return Err(field(8, "length", text));
    }
    let (json, kind) = (word(&head, 12), word(&head, 16));
    if kind != 0x4E4F_534A {
        return Err(field(16, "chunkType", format!("expected JSON, found {kind:#x}")));
    }
    if 20 + json > length {
        return Err(field(12, "chunkLength", format!("expected at most {}, found {json}", length - 20)));
    }
    let at = 20 + json;
    if at + 8 > length {
        return Ok(((20, json), None));
    }
    let mut next = [0; 8];
    source.read(at, &mut next)?;
    let (bytes, kind) = (word(&next, 0), word(&next, 4));
    if kind != 0x004E_4942 {
        return Ok(((20, json), None));
    }
    if at + 8 + bytes > length {
        let left = length - at - 8;
        return Err(field(at, "chunkLength", format!("expected at most {left}, found {bytes}")));
    }
    Ok(((20, json), Some((at + 8, bytes))))
}

pub(super) fn document(source: &Source) -> Result<Document, SceneError> {
    Document::parse(&json(source)?)
}

pub(super) fn json(source: &Source) -> Result<Vec<u8>, SceneError> {
    let (chunk, _) = chunks(source)?;
    json::read(source, chunk, MAX_JSON, json::GLTF_OBJECT)
}

impl<'a> Container<'a> {
    /// Parses the document of a file and opens its buffers. `path` locates the buffers beside the file.
    pub(super) fn open(source: &'a Source<'a>, path: Option<&Path>) -> Result<Self, SceneError> {
        let document = document(source)?;
        let (_, binary) = chunks(source)?;
        let mut buffers = Vec::new();
        let within = binary.map_or(0, |(_, bytes)| bytes);
        let (mut file_bytes, mut header_bytes) = (source.length(), source.length() - within);
        let mut encoding_bytes = 0;
        for (index, buffer) in document.buffers.iter().enumerate() {
            let name = format!("buffers[{index}]");
            let (bytes, length) = match (&buffer.uri, binary) {
                (None, Some((at, length))) if index == 0 => (Bytes::Within(source, at), length),
                (None, _) => {
                    return Err(wrong(name, "expected a uri, or the first buffer of a .glb, found neither"));
                }
                (Some(uri), _) => outside(uri, path).map_err(|message| wrong(name.as_str(), message))?,
            };
            let Buffer { byte_length, uri } = buffer;
            match (&bytes, uri) {
                (Bytes::Memory(_), Some(uri)) => {
                    header_bytes -= uri.len() as u64;
                    encoding_bytes += uri.len() as u64 - length;
                }
                // Several buffers can be in one file.
                (Bytes::File(_), _) if !document.buffers[..index].iter().any(|other| other.uri == *uri) => {
                    file_bytes += length;
                }
                _ => {}
            }
            if *byte_length > length {
                return Err(wrong(
                    name,
                    format!("expected at most {length} bytes, found byteLength {byte_length}"),
                ));
            }
            buffers.push((bytes, *byte_length));
        }
        Ok(Self { document, file_bytes, header_bytes, encoding_bytes, buffers })
    }

    /// Fails if a file beside the document changed since it was opened.
    pub(super) fn check_unchanged(&self) -> Result<(), SceneError> {
        self.buffers.iter().enumerate().try_for_each(|(index, (bytes, _))| match bytes {
            Bytes::File(file) => {
                file.check_unchanged().map_err(|problem| wrong(format!("buffers[{index}]"), problem))
            }
            Bytes::Within(..) | Bytes::Memory(_) => Ok(()),
        })
    }

    /// Returns a buffer view and its bytes. Fails if the view exceeds its buffer.
    pub(super) fn view(&self, index: usize) -> Result<(Source<'_>, &BufferView), SceneError> {
        let view = item(&self.document.buffer_views, index, "bufferView")?;
        let (bytes, length) = item(&self.buffers, view.buffer, "bufferViews.buffer")?;
        let end = view.byte_offset.checked_add(view.byte_length);
        if end.is_none_or(|end| end > *length) {
            let text = format!(
                "expected bytes within the buffer's {length}, found {} at {}",
                view.byte_length, view.byte_offset
            );
            return Err(wrong(format!("bufferViews[{index}]"), text));
        }
        let (source, start) = match bytes {
            Bytes::Within(source, at) => (**source, *at),
            Bytes::Memory(bytes) => (Source::Bytes(bytes), 0),
            Bytes::File(file) => (Source::File(file), 0),
        };
        Ok((source.part(start + view.byte_offset, view.byte_length), view))
    }
}

/// Opens the buffer that a `uri` refers to, and returns its length, too. `path` is that of the document.
fn outside<'a>(uri: &str, path: Option<&Path>) -> Result<(Bytes<'a>, u64), String> {
    match uri::resolve(uri, path.and_then(Path::parent))? {
        Resource::Data(bytes) => {
            let length = bytes.len() as u64;
            Ok((Bytes::Memory(bytes), length))
        }
        Resource::File(path) => {
            let unreadable = |error| format!("expected a readable file, found {}: {error}", uri::shown(uri));
            let file = OpenFile::open(&path).map_err(unreadable)?;
            let length = Source::File(&file).length();
            Ok((Bytes::File(file), length))
        }
    }
}
