//! Sorts splats by depth, and counts the pairs that two orders rank differently.

use crate::gaussian::Splats;
use crate::rules::{Depth, KeyOf, Rules, Ties};
use glam::{DMat3, DVec3};
use rayon::prelude::*;
use splatgraph_assets::Camera;

/// The world-to-view transform in f64. The elements for the depth are also stored as f32, as the rasteriser receives
/// them.
pub(crate) struct View {
    pub rotation: DMat3,
    eye: DVec3,
    /// Elements 2, 6, 10 and 14 of the rasteriser's matrix: the view direction, and the translation along it.
    depth_row: [f32; 4],
    /// True if f32 is too coarse for the scene's positions.
    wide: bool,
    /// True if the camera sees splats behind it. The near plane is then a sphere, if splats are sorted by distance.
    sees_behind: bool,
}

impl View {
    pub(crate) fn new(camera: &Camera, wide: bool) -> View {
        let rows = camera.axes();
        let eye = DVec3::from(camera.position);
        let translation = -DVec3::from(rows[2]).dot(eye);
        let [x, y, z] = rows[2].map(|v| v as f32);
        let sees_behind = camera.projection.sees_behind();
        let rotation = DMat3::from_cols_array_2d(&rows).transpose();
        View { rotation, eye, depth_row: [x, y, z, translation as f32], wide, sees_behind }
    }

    /// Transforms a point to view space: right, down, forward.
    pub(crate) fn point(&self, p: [f64; 3]) -> [f64; 3] {
        (self.rotation * (DVec3::from(p) - self.eye)).into()
    }

    /// Computes the view depth of a point, used for culling and sorting.
    ///
    /// In f32 it is `fma(m10, z, fma(m6, y, m2 * x)) + m14`, the order in which the rasteriser's compiler contracts
    /// `transformPoint4x3` (cuda_rasterizer/auxiliary.h), so that the same splats tie. The rasteriser does not handle
    /// scenes for which f32 is too coarse ([`Splats::is_wide`]): their depths are computed in f64, then rounded.
    pub(crate) fn depth(&self, p: [f64; 3], rule: Depth) -> f64 {
        match rule {
            Depth::F64 => self.point(p)[2],
            Depth::F32 if self.wide => f64::from(self.point(p)[2] as f32),
            Depth::F32 => {
                let [x, y, z] = p.map(|v| v as f32);
                let [m2, m6, m10, m14] = self.depth_row;
                f64::from(m10.mul_add(z, m6.mul_add(y, m2 * x)) + m14)
            }
        }
    }

    /// Computes a splat's sort key, view depth or distance, by the rules. `None` if it is not beyond the near plane.
    pub(crate) fn key(&self, p: [f64; 3], rules: &Rules) -> Option<f64> {
        let distance = || DVec3::from(p).distance(self.eye);
        let depth = self.depth(p, rules.depth);
        let key = match (rules.key_of, rules.depth) {
            (KeyOf::Depth, _) => depth,
            (KeyOf::Distance, Depth::F32) => f64::from(distance() as f32),
            (KeyOf::Distance, Depth::F64) => distance(),
        };
        let near = if self.sees_behind && rules.key_of == KeyOf::Distance { key } else { depth };
        (near > rules.near).then_some(key)
    }
}

/// Sorts by `key` (depth and index), near to far. Equal depths follow the rule for ties.
pub(crate) fn sort<T: Send>(items: &mut [T], rules: &Rules, key: impl Fn(&T) -> (f64, u32) + Sync) {
    items.par_sort_unstable_by(|a, b| {
        let ((a_depth, a_index), (b_depth, b_index)) = (key(a), key(b));
        let ties = match rules.ties {
            Ties::Ascending => a_index.cmp(&b_index),
            Ties::Descending => b_index.cmp(&a_index),
        };
        a_depth.total_cmp(&b_depth).then(ties)
    });
}

/// Returns the indices of the splats beyond the near plane, near to far.
pub fn depth_order(splats: &(impl Splats + ?Sized), camera: &Camera, rules: &Rules) -> Vec<u32> {
    let view = View::new(camera, splats.is_wide());
    let mut keys: Vec<(f64, u32)> = (0..splats.count())
        .into_par_iter()
        .filter_map(|index| view.key(splats.get(index).position, rules).map(|key| (key, index as u32)))
        .collect();
    sort(&mut keys, rules, |key| *key);
    keys.into_iter().map(|(_, index)| index).collect()
}

/// Sorts pairs of a key and a value by key, stably; returns the keys and the values. Radix sorts must give the same
/// result.
pub fn sort_pairs(mut pairs: Vec<(u32, u32)>) -> (Vec<u32>, Vec<u32>) {
    pairs.sort_by_key(|(key, _)| *key);
    pairs.into_iter().unzip()
}

/// Counts the pairs of splats that `given` and `truth` order differently. For n splats, the count is 0 for equal
/// orders, and n (n - 1) / 2 for reversed ones. `None` unless both hold the same indices, each once.
pub fn inversions(truth: &[u32], given: &[u32]) -> Option<u64> {
    let bound = truth.iter().max().map_or(0, |max| *max as usize + 1);
    let mut ranks = vec![u32::MAX; bound];
    for (rank, index) in truth.iter().enumerate() {
        ranks[*index as usize] = rank as u32;
    }
    let mut sequence: Vec<u32> = Vec::with_capacity(given.len());
    for index in given {
        let rank = ranks.get_mut(*index as usize)?;
        // Remove it, so that a second occurrence is detected.
        sequence.push(std::mem::replace(rank, u32::MAX));
    }
    if given.len() != truth.len() || sequence.contains(&u32::MAX) {
        return None;
    }
    let mut scratch = sequence.clone();
    Some(merge_sort(&mut sequence, &mut scratch))
}

/// Sorts `values`, and returns the number of pairs that were in the wrong order.
fn merge_sort(values: &mut [u32], scratch: &mut [u32]) -> u64 {
    if values.len() < 2 {
        return 0;
    }
    let middle = values.len() / 2;
    let mut count = {
        let ((left, right), (a, b)) = (values.split_at_mut(middle), scratch.split_at_mut(middle));
        merge_sort(left, a) + merge_sort(right, b)
    };
    let (mut left, mut right) = (0, middle);
    for slot in scratch.iter_mut() {
        if right == values.len() || (left < middle && values[left] <= values[right]) {
            *slot = values[left];
            left += 1;
        } else {
            *slot = values[right];
            count += (middle - left) as u64;
            right += 1;
        }
    }
    values.copy_from_slice(scratch);
    count
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn equal_orders_have_no_inversions_and_reversed_ones_have_all_pairs() {
        let forward: Vec<u32> = (0..100).map(|i| 3 * i).collect();
        let reversed: Vec<u32> = forward.iter().rev().copied().collect();
        assert_eq!(inversions(&forward, &forward), Some(0));
        assert_eq!(inversions(&forward, &reversed), Some(4950));
        assert_eq!(inversions(&[], &[]), Some(0));
    }

    #[test]
    fn orders_of_different_splats_cannot_be_compared() {
        assert_eq!(inversions(&[0, 1], &[0]), None);
        assert_eq!(inversions(&[0, 1], &[0, 2]), None);
        assert_eq!(inversions(&[0, 1], &[1, 1]), None);
    }

    proptest! {
        #[test]
        fn inversions_are_the_pairs_counted_one_by_one(order in Just((0..40u32).collect::<Vec<_>>()).prop_shuffle()) {
            let truth: Vec<u32> = (0..40).collect();
            let pairs = (0..40).flat_map(|i| (i + 1..40).map(move |j| (i, j)));
            let expected = pairs.filter(|(i, j)| order[*i] > order[*j]).count() as u64;
            prop_assert_eq!(inversions(&truth, &order), Some(expected));
        }
    }
}
