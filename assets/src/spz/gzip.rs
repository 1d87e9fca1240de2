//! Unpacks versions 1 to 3: one gzip stream of the header, the arrays and the extension records.

use super::header::{Header, Unpacked, append, check_memory, unpacked};
use super::layout::{HEADER, MAGIC};
use crate::error::{SceneError, field};
use crate::input::{Done, Input, Source, SourceReader};
use crate::size_breakdown::FieldSize;
use crate::words::word;
use flate2::bufread::GzDecoder;
use std::io::{BufReader, Read, Seek};

const MAX_EXTENSIONS: u64 = 64 << 10;

const PIECE: usize = 64 << 10;

type Unpacker<'a> = GzDecoder<BufReader<SourceReader<'a>>>;

fn unpacker<'a>(source: &'a Source<'a>) -> Unpacker<'a> {
    GzDecoder::new(BufReader::with_capacity(PIECE, SourceReader::new(source, 0)))
}

/// Returns true if the bytes begin a gzip stream that contains SPZ.
pub(crate) fn begins_as_spz(head: &[u8]) -> bool {
    let mut magic = [0; 4];
    GzDecoder::new(head).read_exact(&mut magic).is_ok() && magic == *MAGIC
}

pub(super) fn header(source: &Source) -> Result<Header, SceneError> {
    read_header(&mut unpacker(source), source.length())
}

fn read_header(unpacker: &mut Unpacker, length: u64) -> Result<Header, SceneError> {
    let mut bytes = [0; HEADER];
    unpacker.read_exact(&mut bytes).map_err(|error| unpacked(error, 0, "header", HEADER as u64))?;
    if bytes.starts_with(MAGIC) && word(&bytes, 4) == 4 {
        return Err(SceneError::NotScene {
            found: "SPZ of version 4 in a gzip file (unpack it first)".into(),
        });
    }
    Header::parse(&bytes, length, 1..=3)
}

pub(super) fn unpack(input: &Input) -> Result<Unpacked, SceneError> {
    let mut unpacker = unpacker(input.source);
    let header = read_header(&mut unpacker, input.source.length())?;
    check_memory(&header, input)?;
    let count = u64::from(header.count);
    let bytes = count * header.stride();
    let done = Done::new(2 * bytes, input.progress)?;
    let header_bytes = unpacker.get_mut().stream_position()?;
    let (mut data, mut fields) = (Vec::new(), Vec::new());
    for (name, kind, stride) in header.arrays() {
        let before = unpacker.get_mut().stream_position()?;
        let bytes = count * stride as u64;
        let at = (HEADER + data.len()) as u64;
        append(&mut unpacker, bytes, &mut data, &done, |error| unpacked(error, at, name, bytes))?;
        if stride > 0 {
            let bytes = unpacker.get_mut().stream_position()? - before;
            fields.push(FieldSize::whole(name, kind, bytes));
        }
    }
    let (mut records, at) = (Vec::new(), (HEADER + data.len()) as u64);
    let rest = (&mut unpacker).take(MAX_EXTENSIONS + 1).read_to_end(&mut records);
    rest.map_err(|error| unpacked(error, at, "extensions", 0))?;
    if records.len() as u64 > MAX_EXTENSIONS {
        let text = format!("expected at most {MAX_EXTENSIONS} bytes after the arrays, found more");
        return Err(field(at, "extensions", text));
    }
    Ok(Unpacked { header, data, fields, header_bytes, packing: "gzip", records: (records, at) })
}
