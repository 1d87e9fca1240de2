//! Parses the JSON texts of a file and of its chunks.

use crate::error::{SceneError, field};
use crate::input::Source;
use crate::json;
use crate::words::word;
use serde::Deserialize;
use serde::de::DeserializeOwned;

/// First bytes of a file, and of a chunk.
pub(crate) const MAGIC: &[u8; 4] = b"RAD0";
pub(crate) const CHUNK_MAGIC: &[u8; 4] = b"RADC";

/// Maximum length of a JSON text, in bytes.
const MAX_JSON: u64 = 16 << 20;

/// The only version of files and of chunks.
const VERSION: u32 = 1;

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Document {
    version: u32,
    #[serde(rename = "type")]
    kind: String,
    pub count: u64,
    /// Number of entries of the palette of harmonics; `None` if it is unknown or there is no palette.
    pub sh_code_count: Option<u64>,
    pub chunks: Vec<Place>,
}

/// The bytes of a chunk. `offset` counts from the end of the file's header or, with a `filename`, from the beginning of
/// that file beside it.
#[derive(Clone, Debug, Deserialize)]
pub(super) struct Place {
    pub offset: u64,
    pub bytes: u64,
    pub filename: Option<String>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct ChunkDocument {
    pub version: u32,
    /// Index of the chunk's first splat among all splats of the file.
    pub base: u64,
    pub count: u64,
    pub properties: Vec<Property>,
}

#[derive(Clone, Debug, Deserialize)]
pub(super) struct Property {
    /// Offset in the payload.
    pub offset: u64,
    pub bytes: u64,
    #[serde(rename = "property")]
    pub name: Name,
    pub encoding: Encoding,
    pub compression: Option<Compression>,
    pub min: Option<f32>,
    pub max: Option<f32>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Name {
    Center,
    Alpha,
    Rgb,
    Scales,
    Orientation,
    Sh1,
    Sh2,
    Sh3,
    Sh1Code,
    Sh2Code,
    Sh3Code,
    ShLabel,
    ChildCount,
    ChildStart,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Encoding {
    F32,
    F16,
    #[serde(rename = "f32_lebytes")]
    F32LeBytes,
    #[serde(rename = "f16_lebytes")]
    F16LeBytes,
    R8,
    R8Delta,
    S8,
    S8Delta,
    #[serde(rename = "ln_0r8")]
    Ln0R8,
    LnF16,
    Oct88r8,
    U16,
    U32,
}

/// The packing of an array: named after gzip, but a raw deflate stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Compression {
    Gz,
}

/// The names of the properties, and their numbers of components, in the order of [`Name`].
const NAMES: [(&str, usize); 14] = [
    ("center", 3),
    ("alpha", 1),
    ("rgb", 3),
    ("scales", 3),
    ("orientation", 3),
    ("sh1", 9),
    ("sh2", 15),
    ("sh3", 21),
    ("sh1_code", 9),
    ("sh2_code", 15),
    ("sh3_code", 21),
    ("sh_label", 1),
    ("child_count", 1),
    ("child_start", 1),
];

/// Bands 1 to 3: the arrays of their harmonics, and of their palettes.
pub(super) const BANDS: [(Name, Name); 3] =
    [(Name::Sh1, Name::Sh1Code), (Name::Sh2, Name::Sh2Code), (Name::Sh3, Name::Sh3Code)];

impl Name {
    pub(super) const COUNT: usize = NAMES.len();

    pub(super) fn text(self) -> &'static str {
        NAMES[self as usize].0
    }

    pub(super) fn width(self) -> usize {
        NAMES[self as usize].1
    }

    /// Returns true for the palette of harmonics, whose rows are entries.
    pub(super) fn is_code(self) -> bool {
        matches!(self, Self::Sh1Code | Self::Sh2Code | Self::Sh3Code)
    }

    /// Returns the encodings that the property can have, in words; `None` if it can have `encoding`.
    pub(super) fn refusal(self, encoding: Encoding) -> Option<&'static str> {
        let (fits, expected) = match self {
            Self::ChildCount => (encoding == Encoding::U16, "u16"),
            Self::ChildStart => (encoding == Encoding::U32, "u32"),
            Self::ShLabel => (encoding.is_index(), "u16 or u32"),
            Self::Orientation => (!encoding.is_index(), "oct88r8 or an encoding of numbers"),
            _ => (!encoding.is_index() && encoding != Encoding::Oct88r8, "an encoding of numbers"),
        };
        (!fits).then_some(expected)
    }
}

impl Encoding {
    fn is_index(self) -> bool {
        matches!(self, Self::U16 | Self::U32)
    }

    pub(super) fn bytes(self) -> usize {
        match self {
            Self::F32 | Self::F32LeBytes | Self::U32 => 4,
            Self::F16 | Self::F16LeBytes | Self::LnF16 | Self::U16 => 2,
            _ => 1,
        }
    }

    /// Returns two flags: whether the values depend on the property's `min`, and whether they depend on its `max`.
    pub(super) fn bounds(self) -> (bool, bool) {
        match self {
            Self::R8 | Self::R8Delta | Self::Ln0R8 => (true, true),
            Self::S8 | Self::S8Delta => (false, true),
            _ => (false, false),
        }
    }
}

/// Reads a magic number and a JSON text at offset `at`, of at most `most` bytes together.
///
/// Returns the document, and the offset after the text and its padding.
fn text<T: DeserializeOwned>(
    source: &Source,
    at: u64,
    most: u64,
    magic: &[u8; 4],
) -> Result<(T, u64), SceneError> {
    let mut head = [0; 8];
    if most < 8 {
        return Err(field(at, "magic", format!("expected 8 bytes, found {most}")));
    }
    source.read(at, &mut head)?;
    if head[..4] != magic[..] {
        let [expected, found] = [&magic[..], &head[..4]].map(|bytes| bytes.escape_ascii().to_string());
        return Err(field(at, "magic", format!("expected {expected}, found {found}")));
    }
    let length = u64::from(word(&head, 4));
    let json = json::read(source, (at + 8, length), MAX_JSON.min(most - 8), json::STREAMED_OBJECT)?;
    let document = serde_json::from_slice(&json).map_err(|error| field(at + 8, "JSON", error))?;
    Ok((document, at + 8 + length.next_multiple_of(8)))
}

impl Document {
    /// Reads the description of a file. Also returns the offset of its chunks; a `.radc` file is a file of one chunk.
    pub(super) fn read(source: &Source) -> Result<(Self, u64), SceneError> {
        let length = source.length();
        if source.head(4)? == CHUNK_MAGIC {
            let (chunk, _) = ChunkDocument::read(source, 0, length)?;
            let place = Place { offset: 0, bytes: length, filename: None };
            let (kind, count) = ("gsplat".into(), chunk.count);
            return Ok((Self { version: VERSION, kind, count, sh_code_count: None, chunks: vec![place] }, 0));
        }
        let (document, end): (Self, u64) = text(source, 0, length, MAGIC)?;
        if document.version != VERSION {
            return Err(field(8, "version", format!("expected {VERSION}, found {}", document.version)));
        }
        if document.kind != "gsplat" {
            return Err(field(8, "type", format!("expected gsplat, found {}", document.kind)));
        }
        Ok((document, end))
    }
}

impl ChunkDocument {
    /// Reads the description of a chunk of `bytes` bytes at offset `at`. Also returns the offset of its payload's
    /// length.
    pub(super) fn read(source: &Source, at: u64, bytes: u64) -> Result<(Self, u64), SceneError> {
        let (chunk, end): (Self, u64) = text(source, at, bytes, CHUNK_MAGIC)?;
        if chunk.version != VERSION {
            return Err(field(at + 8, "version", format!("expected {VERSION}, found {}", chunk.version)));
        }
        Ok((chunk, end))
    }
}
