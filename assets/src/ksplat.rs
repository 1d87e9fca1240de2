//! Reads the `.ksplat` files of Mark Kellogg's viewer: a header, sections with their own headers, and rows of splats.
//!
//! | bytes of a row, level 0 / 1 / 2 | value |
//! |---|---|
//! | 12 / 6 / 6 | position: `f32`, or 16 bits relative to the centre of the row's bucket |
//! | 12 / 6 / 6 | standard deviations, `f32` or `f16` |
//! | 16 / 8 / 8 | quaternion w, x, y, z, `f32` or `f16` |
//! | 4 | red, green and blue of band 0, and opacity, 0 to 255 for 0 to 1 |
//! | 4 / 2 / 1 per coefficient and channel | harmonics: `f32`, `f16`, or `u / 255` between the header's bounds |
//!
//! Harmonics are stored band by band; within a band all of red, then green, then blue. Positions of levels 1 and 2 are
//! `(u - range) * bucketBlockSize / 2 / range + centre`, where `range` is `compressionScaleRange`. The first
//! `fullBucketCount` buckets have `bucketSize` rows each; the lengths of the other buckets come before the centres.
//! Format: <https://github.com/mkkellogg/GaussianSplats3D>, `SplatBuffer.js`.

use crate::activation;
use crate::error::{SceneError, field};
use crate::input::{self, Done, Input, SceneHeader, Source};
use crate::scene::{FileNotes, Scene, Splat, sh_floats};
use crate::size_breakdown::{ElementSize, FieldSize, SizeBreakdown};
use crate::words::{bytes_at, float, word};
use half::f16;

/// Bytes of the file's header, and of each section's.
const HEADER: usize = 4096;
const SECTION: usize = 1024;

const ROWS: usize = 4096;

fn half_word(bytes: &[u8], at: usize) -> u16 {
    u16::from_le_bytes(bytes_at(bytes, at))
}

/// Returns true if the fields of a `.ksplat` header are plausible. The format has no magic number.
pub(crate) fn is_plausible(head: &[u8]) -> bool {
    head.len() >= HEADER
        && head[0] == 0
        && head[1] == 1
        && half_word(head, 20) <= 2
        && word(head, 4) > 0
        && word(head, 16) > 0
}

struct Header {
    level: usize,
    sections: u64,
    count: u32,
    /// Bounds of the harmonics of level 2. A stored 0 stands for the default, -1.5 and 1.5.
    range: [f32; 2],
}

struct Section {
    count: usize,
    first: usize,
    /// Offset of the first row.
    rows: u64,
    stride: usize,
    degree: u32,
    /// Half the side of a bucket, divided by the range of its integers.
    step: f64,
    range: f64,
    full: usize,
    capacity: usize,
    /// Index after the last row of each partial bucket, within the section.
    ends: Vec<usize>,
    centers: Vec<[f32; 3]>,
}

/// Bytes per value at each level: `VALUE` for positions, scales and rotations, `HARMONIC` for harmonics.
const VALUE: [usize; 3] = [4, 2, 2];
const HARMONIC: [usize; 3] = [4, 2, 1];

impl Header {
    fn read(source: &Source) -> Result<Self, SceneError> {
        let head = source.head(HEADER)?;
        if head.len() < HEADER {
            return Err(field(0, "header", format!("expected {HEADER} bytes, found {}", head.len())));
        }
        if head[0] != 0 || head[1] != 1 {
            return Err(field(0, "version", format!("expected 0.1, found {}.{}", head[0], head[1])));
        }
        let level = half_word(&head, 20);
        if level > 2 {
            return Err(field(20, "compressionLevel", format!("expected 0 to 2, found {level}")));
        }
        let (sections, count) = (u64::from(word(&head, 4)), word(&head, 16));
        let most = (source.length() - HEADER as u64) / SECTION as u64;
        if sections > most {
            return Err(field(
                4,
                "maxSectionCount",
                format!("expected at most {most}, which the file can hold, found {sections}"),
            ));
        }
        if count == 0 {
            return Err(field(16, "splatCount", "expected at least one splat, found 0"));
        }
        let bound = |at: usize, default: f32| match float(&head, at) {
            0.0 => default,
            bound => bound,
        };
        Ok(Self { level: level.into(), sections, count, range: [bound(36, -1.5), bound(40, 1.5)] })
    }

    fn plain(&self) -> usize {
        10 * VALUE[self.level] + 4
    }

    /// Reads the headers of all sections, and their buckets if `buckets` is true.
    fn sections(&self, source: &Source, buckets: bool) -> Result<Vec<Section>, SceneError> {
        let mut sections = Vec::new();
        let mut at = HEADER as u64 + self.sections * SECTION as u64;
        let mut first = 0;
        for index in 0..self.sections {
            let header_at = HEADER as u64 + index * SECTION as u64;
            let mut head = [0; 44];
            source.read(header_at, &mut head)?;
            let [count, most, capacity, bucket_count] = [0, 4, 8, 12].map(|at| u64::from(word(&head, at)));
            let [full, partial] = [32, 36].map(|at| u64::from(word(&head, at)));
            let degree = u32::from(half_word(&head, 40));
            if degree > 3 {
                return Err(field(
                    header_at + 40,
                    "sphericalHarmonicsDegree",
                    format!("expected 0 to 3, found {degree}"),
                ));
            }
            let stride = self.plain() + (sh_floats(degree) - 3) * HARMONIC[self.level];
            // At level 0 there are no buckets: `lengths` and `centers` are 0.
            let lengths = partial * 4;
            let centers = bucket_count * u64::from(half_word(&head, 20));
            let left = source.length() - at;
            let needed = most.saturating_mul(stride as u64).saturating_add(lengths + centers);
            if needed > left {
                let text = format!(
                    "expected a section of at most the {left} bytes that are left, found one of {needed}"
                );
                return Err(field(header_at + 4, "maxSplatCount", text));
            }
            if count > most {
                return Err(field(
                    header_at,
                    "splatCount",
                    format!("expected at most maxSplatCount, {most}, found {count}"),
                ));
            }
            let mut section = Section {
                count: count as usize,
                first,
                rows: at + lengths + centers,
                stride,
                degree,
                step: 1.0,
                range: 0.0,
                full: full as usize,
                capacity: capacity as usize,
                ends: Vec::new(),
                centers: Vec::new(),
            };
            if buckets && self.level > 0 && count > 0 {
                section.read_buckets(source, &head, (header_at, at))?;
            }
            first += count as usize;
            at += needed;
            sections.push(section);
        }
        if first as u64 != u64::from(self.count) {
            let text = format!("expected {first}, the sum over the sections, found {}", self.count);
            return Err(field(16, "splatCount", text));
        }
        Ok(sections)
    }

    /// Converts a row; also returns the length of the file's quaternion.
    fn splat(&self, section: &Section, index: usize, row: &[u8]) -> (Splat, f64) {
        let size = VALUE[self.level];
        let value = |index: usize| match size {
            4 => float(row, 4 * index),
            _ => f16::from_bits(half_word(row, 2 * index)).to_f32(),
        };
        let (rotation, norm) = activation::unit([6, 7, 8, 9].map(|index| f64::from(value(index))));
        let center = if self.level > 0 { section.centers[section.bucket(index)] } else { [0.0; 3] };
        let bytes = &row[10 * size..];
        let part = |at: usize| f64::from(bytes[at]) / 255.0;
        let mut splat = Splat {
            position: std::array::from_fn(|axis| match self.level {
                0 => value(axis),
                _ => {
                    let steps = f64::from(half_word(row, 2 * axis)) - section.range;
                    (steps * section.step + f64::from(center[axis])) as f32
                }
            }),
            scale: [3, 4, 5].map(value),
            rotation,
            opacity: part(3) as f32,
            sh: activation::flat([0, 1, 2].map(part)),
        };
        let harmonics = &row[self.plain()..];
        let harmonic = |index: usize| match self.level {
            0 => float(harmonics, 4 * index),
            1 => f16::from_bits(half_word(harmonics, 2 * index)).to_f32(),
            _ => {
                let [min, max] = self.range;
                min + (max - min) * f32::from(harmonics[index]) / 255.0
            }
        };
        let mut next = 0;
        for band in 1..=section.degree as usize {
            for channel in 0..3 {
                for k in band * band..(band + 1) * (band + 1) {
                    splat.sh[3 * k + channel] = harmonic(next);
                    next += 1;
                }
            }
        }
        (splat, norm)
    }
}

impl Section {
    /// Reads the buckets of a section with quantised positions, given the offsets of its header and of its data.
    fn read_buckets(
        &mut self,
        source: &Source,
        head: &[u8; 44],
        (header_at, at): (u64, u64),
    ) -> Result<(), SceneError> {
        let (buckets, partial) = (word(head, 12) as usize, word(head, 36) as usize);
        let bytes = half_word(head, 20);
        if bytes != 12 {
            return Err(field(
                header_at + 20,
                "bucketStorageSizeBytes",
                format!("expected 12, found {bytes}"),
            ));
        }
        if self.full.checked_add(partial) != Some(buckets) {
            let text = format!(
                "expected {buckets}, the number of buckets, less those that are not full, {partial}; found {}",
                self.full
            );
            return Err(field(header_at + 32, "fullBucketCount", text));
        }
        // The section was checked to lie within the file, so this allocates at most the file's length.
        let data = source.bytes(at, 4 * partial + 12 * buckets)?;
        let mut end = self.full.saturating_mul(self.capacity);
        for length in data[..4 * partial].chunks_exact(4) {
            end = end.saturating_add(word(length, 0) as usize);
            self.ends.push(end);
        }
        if end < self.count {
            return Err(field(
                at,
                "buckets",
                format!("expected buckets for {} splats, found room for {end}", self.count),
            ));
        }
        self.centers = data[4 * partial..]
            .chunks_exact(12)
            .map(|center| [0, 4, 8].map(|at| float(center, at)))
            .collect();
        let range = match word(head, 24) {
            0 => 32_767,
            range => range,
        };
        self.range = f64::from(range);
        self.step = f64::from(float(head, 16)) / 2.0 / self.range;
        Ok(())
    }

    fn bucket(&self, index: usize) -> usize {
        if index < self.full.saturating_mul(self.capacity) {
            return index / self.capacity;
        }
        self.full + self.ends.partition_point(|end| *end <= index)
    }
}

pub(crate) fn header(source: &Source) -> Result<SceneHeader, SceneError> {
    let header = Header::read(source)?;
    let sections = header.sections(source, false)?;
    Ok(SceneHeader { count: header.count.into(), stored_degree: degree(&sections) })
}

fn degree(sections: &[Section]) -> u32 {
    sections.iter().map(|section| section.degree).max().unwrap_or(0)
}

pub(crate) fn parse(input: &Input) -> Result<Scene, SceneError> {
    let source = input.source;
    let header = Header::read(source)?;
    let sections = header.sections(source, true)?;
    let count = u64::from(header.count);
    let most = sections.iter().map(|section| section.stride).max().unwrap_or(1);
    let mut columns = input.allocate(count, degree(&sections), false, (most, 0))?;
    let bytes: u64 = sections.iter().map(|section| (section.count * section.stride) as u64).sum();
    let done = Done::new(bytes, input.progress)?;
    let buffers = input::Buffers::default();
    let gathered = columns.fill(|out| {
        buffers.with(ROWS * most, |buffer| {
            let (mut next, end) = (out.first(), out.first() + out.len());
            while next < end {
                let at = sections.partition_point(|section| section.first + section.count <= next);
                let section = &sections[at];
                let local = next - section.first;
                let rows = (section.count - local).min(end - next).min(ROWS);
                let piece = &mut buffer[..rows * section.stride];
                source.read(section.rows + (local * section.stride) as u64, piece)?;
                for (row, index) in piece.chunks_exact(section.stride).zip(local..) {
                    let (splat, norm) = header.splat(section, index, row);
                    out.push(&splat, norm);
                }
                done.add(piece.len() as u64)?;
                next += rows;
            }
            Ok::<_, SceneError>(())
        })
    })?;
    let rows = ElementSize::new("splats", count, vec![FieldSize::whole("rows", "row", bytes)]);
    let header_bytes = sections.first().map_or(0, |section| section.rows);
    let format = format!("ksplat, level {}", header.level);
    let size_breakdown = SizeBreakdown::new(format, source.length(), header_bytes, vec![rows]);
    input::finish((columns, gathered), count, size_breakdown, FileNotes::default())
}

#[cfg(test)]
#[path = "../tests/files/ksplat.rs"]
pub(crate) mod ksplat_file;

#[cfg(test)]
mod tests {
    use super::ksplat_file::file;
    use super::*;
    use crate::activation::SH_C0;
    use crate::testing::parse as read;

    #[test]
    fn all_levels_have_the_values_that_the_format_defines() {
        for (level, degree) in [(0, 0), (0, 2), (1, 1), (2, 2), (1, 3)] {
            let bytes = file(level, degree);
            let scene = read(&bytes).unwrap();
            assert_eq!((scene.count(), scene.stored_degree()), (3, degree.into()));
            assert_eq!(scene.size_breakdown().sum(), bytes.len() as u64);
            let [first, _, third] = [0, 1, 2].map(|index| scene.splat(index));
            let (a, b) = if level == 0 {
                ([1.0, 2.0, 3.0], [1.0, 2.0, 3.0])
            } else {
                ([10.0, -4.0, 4.0], [-10.0, 1.0, 4.0])
            };
            assert_eq!((first.position, third.position), (a, b), "level {level}");
            assert_eq!((first.scale, first.rotation), ([0.5, 1.0, 2.0], [0.0, 1.0, 0.0, 0.0]));
            let near = |a: f32, b: f64| (f64::from(a) - b).abs() < 1e-5;
            assert!(
                near(first.opacity, 0.4) && near(first.sh[0], 0.5 / SH_C0) && near(first.sh[2], -0.3 / SH_C0)
            );
            if degree > 0 {
                // The first green coefficient of band 1 is the fourth value.
                let expected = if level == 2 { -2.0 + 4.0 * 4.0 / 255.0 } else { 4.0 / 32.0 };
                assert!(near(first.sh[4], expected), "level {level}: {:?}", first.sh);
            }
            if degree > 1 {
                // The last blue coefficient of band 2 is the last of 9 + 15 values.
                let expected = if level == 2 { -2.0 + 4.0 * 24.0 / 255.0 } else { 24.0 / 32.0 };
                assert!(near(first.sh[26], expected), "level {level}: {:?}", first.sh);
            }
        }
    }

    #[test]
    fn damage_names_the_byte_and_the_field() {
        let with = |at: usize, value: &[u8]| {
            let mut bytes = file(1, 1);
            bytes[at..at + value.len()].copy_from_slice(value);
            let source = Source::Bytes(&bytes);
            let input = Input::new(&source, Some(1 << 30), crate::QUIET);
            parse(&input).unwrap_err().to_string()
        };
        let cases: [(usize, &[u8], &str); 8] = [
            (1, &[9], "byte 0, `version`: expected 0.1, found 0.9"),
            (4, &[255; 4], "byte 4, `maxSectionCount`: expected at most 1"),
            (16, &[9], "byte 16, `splatCount`: expected 3, the sum over the sections, found 9"),
            (20, &[3], "byte 20, `compressionLevel`: expected 0 to 2, found 3"),
            (HEADER, &[9], "byte 4096, `splatCount`: expected at most maxSplatCount, 3, found 9"),
            (HEADER + 4, &[255; 4], "byte 4100, `maxSplatCount`: expected a section of at most"),
            (HEADER + 32, &[7], "byte 4128, `fullBucketCount`: expected 2"),
            (HEADER + SECTION, &[0], "byte 5120, `buckets`: expected buckets for 3 splats, found room for 2"),
        ];
        for (at, value, expected) in cases {
            let found = with(at, value);
            assert!(found.contains(expected), "{found}; expected {expected}");
        }
    }
}
