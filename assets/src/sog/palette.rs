//! Chooses the palette of the harmonics: few entries that approximate many points.
//!
//! The groups of points with the largest errors are split repeatedly, until every entry has a group or all points of
//! each group are equal. Entries thus go where points are dense or far apart, and equal points share an entry.
//!
//! Everything is deterministic: sums run in the order of the points, whatever the number of threads.

use rayon::prelude::*;
use std::io::Result;

/// The most iterations that move the border between the two halves of a group.
const BORDER_STEPS: usize = 4;

const CHUNK: usize = 4096;

/// Entries of equal dimension, and for each point the index of its entry.
pub(super) struct Palette {
    /// The coordinates, entry after entry.
    pub entries: Vec<f32>,
    pub labels: Vec<u32>,
}

/// Points among other values: `width` coordinates from index `first` on, in every row of `stride` values.
pub(super) struct Points<'a> {
    pub values: &'a [f32],
    pub stride: usize,
    pub first: usize,
    pub width: usize,
}

struct Group<'a> {
    of: &'a mut [u32],
    mean: Vec<f32>,
    /// Axis of the largest variance.
    widest: usize,
    /// Sum of the squared distances from the mean; 0 only if all points are equal.
    error: f64,
}

impl Points<'_> {
    fn point(&self, number: u32) -> &[f32] {
        &self.values[number as usize * self.stride + self.first..][..self.width]
    }

    /// Sums `value(axis, coordinate)` over points; returns one sum per axis.
    fn sum(&self, of: &[u32], value: impl Fn(usize, f64) -> f64 + Sync) -> Vec<f64> {
        let part = |of: &[u32]| {
            let mut sums = vec![0.0; self.width];
            for number in of {
                for (axis, (sum, coordinate)) in sums.iter_mut().zip(self.point(*number)).enumerate() {
                    *sum += value(axis, f64::from(*coordinate));
                }
            }
            sums
        };
        let parts: Vec<Vec<f64>> = of.par_chunks(CHUNK).map(part).collect();
        parts.into_iter().fold(vec![0.0; self.width], |mut sums, part| {
            sums.iter_mut().zip(part).for_each(|(sum, value)| *sum += value);
            sums
        })
    }

    fn mean(&self, of: &[u32]) -> Vec<f64> {
        self.sum(of, |_, coordinate| coordinate).into_iter().map(|sum| sum / of.len() as f64).collect()
    }

    fn group<'a>(&self, of: &'a mut [u32]) -> Group<'a> {
        let any = self.point(of[0]);
        if of.iter().all(|number| self.point(*number) == any) {
            return Group { of, mean: any.to_vec(), widest: 0, error: 0.0 };
        }
        let mean = self.mean(of);
        let variances = self.sum(of, |axis, coordinate| (coordinate - mean[axis]).powi(2));
        let wider = |best: usize, axis: usize| if variances[axis] > variances[best] { axis } else { best };
        let widest = (1..self.width).fold(0, wider);
        let mean = mean.into_iter().map(|value| value as f32).collect();
        Group { of, mean, widest, error: variances.iter().sum::<f64>().max(f64::MIN_POSITIVE) }
    }

    /// Splits a group at the plane halfway between the means of its halves. Its points must not all be equal.
    fn halves<'a>(&self, group: Group<'a>) -> [Group<'a>; 2] {
        let Group { of, mean, widest, .. } = group;
        let mut middle = partition(of, |number| self.point(number)[widest] > mean[widest]);
        for _ in 0..BORDER_STEPS {
            let [a, b] = [&of[..middle], &of[middle..]].map(|half| self.mean(half));
            let normal: Vec<f32> = a.iter().zip(&b).map(|(a, b)| (b - a) as f32).collect();
            let border = a.iter().zip(&b).map(|(a, b)| 0.5 * (a + b) * (b - a)).sum::<f64>() as f32;
            let along = |number| self.point(number).iter().zip(&normal).map(|(a, b)| a * b).sum::<f32>();
            let next = partition(of, |number| along(number) > border);
            if next == middle {
                break;
            }
            middle = next;
        }
        let (low, high) = of.split_at_mut(middle);
        [low, high].map(|half| self.group(half))
    }
}

/// Moves the indices that are `beyond` a border behind the others, and returns the number of the others.
///
/// If one side would be empty, splits the list in the middle.
fn partition(of: &mut [u32], beyond: impl Fn(u32) -> bool + Sync) -> usize {
    let numbers = of.par_iter().with_min_len(CHUNK);
    let (behind, before): (Vec<u32>, Vec<u32>) = numbers.partition(|number| beyond(**number));
    let middle = if before.is_empty() || behind.is_empty() { of.len() / 2 } else { before.len() };
    for (to, number) in of.iter_mut().zip(before.into_iter().chain(behind)) {
        *to = number;
    }
    middle
}

/// Chooses at most `count` entries for all points, of which there must be at least one. `numbers` lists them; sums run
/// in its order.
///
/// `tell` gets the number of entries found so far. An error from `tell` ends the search.
pub(super) fn palette(
    points: &Points,
    mut numbers: Vec<u32>,
    count: usize,
    tell: impl Fn(usize) -> Result<()>,
) -> Result<Palette> {
    let all = numbers.len();
    let mut done = Vec::new();
    let mut groups = vec![points.group(&mut numbers)];
    loop {
        // Splits at most a third at a time: the halves of the worst groups can be worse than the other groups.
        let most = (groups.len() / 3).max(1).min(count - done.len() - groups.len());
        groups.sort_by(|a, b| b.error.total_cmp(&a.error));
        let equal = groups.partition_point(|group| group.error > 0.0);
        done.extend(groups.drain(equal..));
        let others = groups.split_off(most.min(groups.len()));
        if groups.is_empty() {
            done.extend(others);
            break;
        }
        groups = groups.into_par_iter().flat_map_iter(|group| points.halves(group)).collect();
        groups.extend(others);
        tell(done.len() + groups.len())?;
    }
    let mut palette =
        Palette { entries: Vec::with_capacity(done.len() * points.width), labels: vec![0; all] };
    for (entry, group) in done.iter().enumerate() {
        palette.entries.extend(&group.mean);
        for number in &*group.of {
            palette.labels[*number as usize] = entry as u32;
        }
    }
    Ok(palette)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::Cell;

    fn chosen(values: &[f32], count: usize, tell: impl Fn(usize) -> Result<()>) -> Palette {
        let points = Points { values, stride: 2, first: 0, width: 2 };
        palette(&points, (0..values.len() as u32 / 2).collect(), count, tell).unwrap()
    }

    fn kept(points: &[f32], palette: &Palette) -> usize {
        let pairs = points.chunks_exact(2).zip(&palette.labels);
        pairs.filter(|(point, label)| *point == &palette.entries[**label as usize * 2..][..2]).count()
    }

    #[test]
    fn equal_points_share_an_entry_and_leave_the_others_to_the_rest() {
        // Nine in ten points are equal, and there are entries for all others.
        let point =
            |i: usize| if i.is_multiple_of(10) { [i as f32, (i as f32 * 0.7).sin()] } else { [0.0, 0.0] };
        let points: Vec<f32> = (0..2000).flat_map(point).collect();
        let palette = chosen(&points, 200, |_| Ok(()));
        assert_eq!((palette.entries.len() / 2, kept(&points, &palette)), (200, 2000));
    }

    #[test]
    fn points_in_clusters_get_their_clusters() {
        let centre = |i: usize| [(i % 7) as f32, (i % 5) as f32 * 2.0];
        let points: Vec<f32> =
            (0..3000).flat_map(|i| centre(i).map(|c| c + 0.01 * (i as f32 * 1.7).sin())).collect();
        for count in [1, 2, 256] {
            let told = Cell::new(1);
            let tell = |chosen| {
                told.set(chosen);
                Ok(())
            };
            let palette = chosen(&points, count, tell);
            assert_eq!((palette.entries.len() / 2, told.get()), (count, count));
            for (point, label) in points.chunks_exact(2).zip(&palette.labels) {
                let entry = &palette.entries[*label as usize * 2..][..2];
                let near = (point[0] - entry[0]).abs() < 0.05 && (point[1] - entry[1]).abs() < 0.05;
                assert!(near || count < 256, "{point:?} and {entry:?}");
            }
        }
    }
}
