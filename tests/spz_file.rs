//! Builds SPZ files of version 4 for tests.

/// Joins header, extension records, table of contents, and a Zstandard stream for each array that is not empty.
pub fn file(count: u32, (degree, flags): (u8, u8), records: &[u8], arrays: &[Vec<u8>]) -> Vec<u8> {
    let arrays = arrays.iter().filter(|array| !array.is_empty());
    let streams = arrays.clone().map(|array| zstd::bulk::compress(array, 0).expect("memory takes it"));
    let streams: Vec<Vec<u8>> = streams.collect();
    let mut bytes = b"NGSP\x04\0\0\0".to_vec();
    bytes.extend(count.to_le_bytes());
    bytes.extend([degree, 12, flags, streams.len() as u8]);
    bytes.extend((32 + records.len() as u32).to_le_bytes());
    bytes.extend([0; 12]);
    bytes.extend(records);
    for (stream, array) in streams.iter().zip(arrays) {
        bytes.extend([stream.len() as u64, array.len() as u64].map(u64::to_le_bytes).as_flattened());
    }
    bytes.extend(streams.concat());
    bytes
}
