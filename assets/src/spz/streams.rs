//! Unpacks version 4: a plain header, extension records, a table of contents, and a Zstandard stream per array.
//!
//! After the 16 bytes of the older header (with the number of streams in its last byte) come the offset of the table of
//! contents and 12 reserved bytes. An entry of the table is the stream's packed and unpacked length, 8 bytes each.
//! Empty arrays have no stream. The last stream ends with the file.

use super::header::{Header, Unpacked, append, check_memory, unpacked};
use super::layout::{ENTRY, HEADER, LONG_HEADER};
use crate::error::{SceneError, field};
use crate::input::{Done, Input, Source, SourceReader};
use crate::size_breakdown::FieldSize;
use crate::words::{bytes_at, word};
use ruzstd::decoding::StreamingDecoder;
use std::io::Read;

/// Reads the header of a file of version 4; also returns the offset of the table of contents.
pub(super) fn header(source: &Source) -> Result<(Header, u64), SceneError> {
    let bytes = source.head(LONG_HEADER)?;
    let length = source.length();
    let Some(bytes) = bytes.first_chunk::<LONG_HEADER>() else {
        return Err(field(0, "header", format!("expected {LONG_HEADER} bytes, found {length}")));
    };
    let first = bytes.first_chunk::<HEADER>().expect("the header is longer");
    if let version @ 1..=3 = word(first, 4) {
        let found = format!("SPZ of version {version}, unpacked (pack it first: `gzip FILE`)");
        return Err(SceneError::NotScene { found });
    }
    let header = Header::parse(first, length, 4..=4)?;
    let expected = header.arrays().iter().filter(|(_, _, stride)| *stride > 0).count();
    if usize::from(bytes[15]) != expected {
        let (degree, found) = (header.degree, bytes[15]);
        return Err(field(
            15,
            "numStreams",
            format!("expected {expected} for shDegree {degree}, found {found}"),
        ));
    }
    let table = u64::from(word(bytes, 16));
    let end = table + (expected * ENTRY) as u64;
    if table < LONG_HEADER as u64 || end > length {
        let most = length.saturating_sub((expected * ENTRY) as u64);
        let text =
            format!("expected {LONG_HEADER} to {most}, which leaves room for the table, found {table}");
        return Err(field(16, "tocByteOffset", text));
    }
    Ok((header, table))
}

pub(super) fn unpack(input: &Input) -> Result<Unpacked, SceneError> {
    let source = input.source;
    let (header, table_at) = header(source)?;
    check_memory(&header, input)?;
    let count = u64::from(header.count);
    let done = Done::new(2 * count * header.stride(), input.progress)?;
    // `header` checked that the records lie within the file, so this allocates at most the file's length.
    let records = source.bytes(LONG_HEADER as u64, (table_at - LONG_HEADER as u64) as usize)?;

    let streams = header.arrays().iter().filter(|(_, _, stride)| *stride > 0).count();
    let header_bytes = table_at + (streams * ENTRY) as u64;
    let (mut data, mut fields) = (Vec::new(), Vec::new());
    let (mut entry_at, mut at) = (table_at, header_bytes);
    for (name, kind, stride) in header.arrays() {
        if stride == 0 {
            continue;
        }
        let mut entry = [0; ENTRY];
        source.read(entry_at, &mut entry)?;
        let [packed, found] = [0, 8].map(|at| u64::from_le_bytes(bytes_at(&entry, at)));
        let bytes = count * stride as u64;
        if found != bytes {
            let text = format!("expected {bytes} unpacked bytes for {count} splats, found {found}");
            return Err(field(entry_at + 8, name, text));
        }
        let left = source.length() - at;
        if packed > left {
            let text = format!("the file is truncated: expected {packed} packed bytes, found {left}");
            return Err(field(entry_at, name, text));
        }
        let failed = |error| unpacked(error, at, name, bytes);
        let packed_bytes = SourceReader::new(source, at).take(packed);
        let mut stream =
            StreamingDecoder::new(packed_bytes).map_err(|error| failed(std::io::Error::other(error)))?;
        append(&mut stream, bytes, &mut data, &done, failed)?;
        if stream.read(&mut [0]).map_err(failed)? > 0 {
            return Err(field(at, name, format!("expected {bytes} unpacked bytes, found more")));
        }
        let decoder = &stream.decoder;
        // The decoder reads the checksum, but does not compare it.
        if decoder.get_checksum_from_data().is_some_and(|sum| decoder.get_calculated_checksum() != Some(sum))
        {
            let text = "expected an intact compressed stream, found damage: its checksum differs";
            return Err(field(at, name, text));
        }
        fields.push(FieldSize::whole(name, kind, packed));
        entry_at += ENTRY as u64;
        at += packed;
    }
    if at != source.length() {
        let text = format!(
            "expected the end of the file after the last stream, found {} bytes",
            source.length() - at
        );
        return Err(field(at, "streams", text));
    }
    let records = (records, LONG_HEADER as u64);
    Ok(Unpacked { header, data, fields, header_bytes, packing: "zstd", records })
}
