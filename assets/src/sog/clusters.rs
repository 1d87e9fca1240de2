//! Finds codebooks and palettes, which approximate many values by a few, with Lloyd's algorithm (k-means).
//!
//! The results are deterministic: sums run in the order of the splats, regardless of the number of threads.

use super::meta::CODES;
use rayon::prelude::*;

/// Number of iterations of the algorithm. Further ones change less than the quantisation to bytes.
const STEPS: usize = 12;

/// Number of points whose sums one task computes.
const CHUNK: usize = 4096;

/// A codebook of 256 ascending numbers.
pub(super) struct Codebook {
    pub codes: Vec<f32>,
    /// Upper ends of the ranges of values that each code but the last represents.
    ends: Vec<f32>,
}

impl Codebook {
    /// Chooses codes for at least one finite value.
    pub(super) fn of(mut values: Vec<f32>) -> Self {
        values.par_sort_unstable_by(f32::total_cmp);
        let mut sums = Vec::with_capacity(values.len() + 1);
        let mut sum = 0.0;
        sums.push(sum);
        for value in &values {
            sum += f64::from(*value);
            sums.push(sum);
        }
        let (first, last) = (values[0], values[values.len() - 1]);
        // Halfway between equal shares of the values and equal steps of the range, so that rare values have codes, too.
        let start = |code: usize| {
            let share = (code as f64 + 0.5) / CODES as f64;
            let by_rank = values[((share * values.len() as f64) as usize).min(values.len() - 1)];
            let by_step = first + (last - first) * share as f32;
            0.5 * (by_rank + by_step)
        };
        let mut codes: Vec<f32> = (0..CODES).map(start).collect();
        for _ in 0..4 * STEPS {
            let ends = middles(&codes);
            let mut begin = 0;
            for (code, value) in codes.iter_mut().enumerate() {
                let end = match ends.get(code) {
                    Some(end) => begin + values[begin..].partition_point(|value| value < end),
                    None => values.len(),
                };
                if end > begin {
                    *value = ((sums[end] - sums[begin]) / (end - begin) as f64) as f32;
                }
                begin = end;
            }
            codes.sort_unstable_by(f32::total_cmp);
        }
        let ends = middles(&codes);
        Self { codes, ends }
    }

    /// Returns the code nearest to a value.
    pub(super) fn nearest(&self, value: f32) -> u8 {
        self.ends.partition_point(|end| *end <= value) as u8
    }
}

fn middles(codes: &[f32]) -> Vec<f32> {
    codes.windows(2).map(|pair| 0.5 * (pair[0] + pair[1])).collect()
}

/// A palette of points of equal dimension, and for each input point a near entry.
pub(super) struct Palette {
    /// Entries, one after the other.
    pub entries: Vec<f32>,
    pub labels: Vec<u32>,
}

/// Chooses at most `count` entries for points of `width` numbers each: first groups, then entries within each group.
///
/// Comparing every point with every entry would take the product of their numbers; two levels take about the square
/// root of the comparisons per point.
pub(super) fn palette(points: &[f32], width: usize, count: usize) -> Palette {
    let all: Vec<u32> = (0..(points.len() / width) as u32).collect();
    if all.len() <= count {
        return Palette { entries: points.to_vec(), labels: all };
    }
    let groups = (count as f64).sqrt().ceil() as usize;
    let (_, group_of) = means(points, width, &all, groups);
    let mut members: Vec<Vec<u32>> = vec![Vec::new(); groups];
    for (point, group) in group_of.iter().enumerate() {
        members[*group as usize].push(point as u32);
    }
    // In proportion to the points, rounded down, so that the sum is at most `count`; but at least 1.
    let spare = count.saturating_sub(groups);
    let shares: Vec<usize> =
        members.iter().map(|of| (1 + of.len() * spare / all.len()).min(of.len())).collect();
    let found: Vec<(Vec<f32>, Vec<u32>)> =
        members.par_iter().zip(&shares).map(|(of, share)| means(points, width, of, *share)).collect();
    let mut palette = Palette { entries: Vec::new(), labels: vec![0; all.len()] };
    for (of, (entries, labels)) in members.iter().zip(found) {
        let first = (palette.entries.len() / width) as u32;
        for (point, label) in of.iter().zip(labels) {
            palette.labels[*point as usize] = first + label;
        }
        palette.entries.extend(entries);
    }
    palette
}

/// Finds `count` means of the points `of`, and the nearest mean of each point.
fn means(points: &[f32], width: usize, of: &[u32], count: usize) -> (Vec<f32>, Vec<u32>) {
    let point = |index: u32| &points[index as usize * width..][..width];
    // Every so many points of an order in which neighbours are near.
    let count = count.min(of.len());
    let mut centres: Vec<f32> = (0..count).flat_map(|k| point(of[k * of.len() / count])).copied().collect();
    let nearest = |centres: &[f32], index: u32| {
        let mut best = (f32::INFINITY, 0);
        for (label, centre) in centres.chunks_exact(width).enumerate() {
            let distance: f32 = point(index).iter().zip(centre).map(|(a, b)| (a - b) * (a - b)).sum();
            if distance < best.0 {
                best = (distance, label as u32);
            }
        }
        best.1
    };
    let assign = |centres: &[f32]| -> Vec<u32> {
        of.par_iter().with_min_len(64).map(|index| nearest(centres, *index)).collect()
    };
    let mut labels = assign(&centres);
    for _ in 0..STEPS {
        let partial = |(of, labels): (&[u32], &[u32])| {
            let (mut sums, mut counts) = (vec![0f64; count * width], vec![0u32; count]);
            for (index, label) in of.iter().zip(labels) {
                counts[*label as usize] += 1;
                let sums = &mut sums[*label as usize * width..][..width];
                sums.iter_mut().zip(point(*index)).for_each(|(sum, value)| *sum += f64::from(*value));
            }
            (sums, counts)
        };
        let (mut sums, mut counts) = (vec![0f64; count * width], vec![0u32; count]);
        for (of, labels) in of.chunks(CHUNK).zip(labels.chunks(CHUNK)) {
            let (part, part_counts) = partial((of, labels));
            sums.iter_mut().zip(part).for_each(|(sum, value)| *sum += value);
            counts.iter_mut().zip(part_counts).for_each(|(sum, value)| *sum += value);
        }
        for (label, centre) in centres.chunks_exact_mut(width).enumerate() {
            if counts[label] > 0 {
                let sums = &sums[label * width..][..width];
                centre
                    .iter_mut()
                    .zip(sums)
                    .for_each(|(value, sum)| *value = (sum / f64::from(counts[label])) as f32);
            }
        }
        let next = assign(&centres);
        if next == labels {
            break;
        }
        labels = next;
    }
    (centres, labels)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_values_have_a_code_each_and_many_one_nearby() {
        let codebook = Codebook::of(vec![3.0, -1.0, 3.0, 0.5]);
        assert_eq!(codebook.codes.len(), CODES);
        for value in [3.0, -1.0, 0.5] {
            assert_eq!(codebook.codes[usize::from(codebook.nearest(value))], value);
        }
        let many: Vec<f32> = (0..100_000).map(|i| (i as f32 * 0.37).sin() * 4.0).collect();
        let codebook = Codebook::of(many.clone());
        let worst = many.iter().map(|v| (codebook.codes[usize::from(codebook.nearest(*v))] - v).abs());
        assert!(worst.fold(0.0, f32::max) < 8.0 / 256.0);
    }

    #[test]
    fn points_in_clusters_get_their_clusters() {
        let centre = |i: usize| [(i % 7) as f32, (i % 5) as f32 * 2.0];
        let points: Vec<f32> =
            (0..3000).flat_map(|i| centre(i).map(|c| c + 0.01 * (i as f32 * 1.7).sin())).collect();
        let palette = palette(&points, 2, 256);
        assert!(palette.entries.len() / 2 <= 256);
        for (point, label) in points.chunks_exact(2).zip(&palette.labels) {
            let entry = &palette.entries[*label as usize * 2..][..2];
            assert!((point[0] - entry[0]).abs() < 0.05 && (point[1] - entry[1]).abs() < 0.05);
        }
    }
}
