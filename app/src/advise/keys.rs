//! Finds how wide a depth key must be.
//!
//! A key never decreases with depth, so that only equal keys can be in the wrong order: they keep the order of the file.
//! Only pairs that overlap on the screen matter; others may change places without a trace. The keys are those of
//! shaders/depth_key.glsl, computed here with the same operations, and a test holds the two together.

use rayon::prelude::*;
use serde::Serialize;
use splatgraph_reference::Visible;

/// A mapping of depth to keys, by the names of the graphs' parameter `key_map`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Mapping {
    /// The bits of the float.
    FloatBits,
    /// Equal steps of depth.
    Linear,
    /// Equal ratios of depth, nearly.
    Logarithmic,
}

/// Widths of keys in bits, from the narrowest to the widest.
pub const WIDTHS: std::ops::RangeInclusive<u32> = 8..=32;

impl Mapping {
    /// Lists all, the cheapest to compute first.
    pub const ALL: [Mapping; 3] = [Mapping::FloatBits, Mapping::Linear, Mapping::Logarithmic];

    /// The parameter's value.
    pub fn name(self) -> &'static str {
        match self {
            Mapping::FloatBits => "float_bits",
            Mapping::Linear => "linear",
            Mapping::Logarithmic => "logarithmic",
        }
    }

    /// Computes the key of a depth; `range` is the depth range of the scene's box, neither below the near plane.
    pub fn key(self, z: f32, (near, far): (f32, f32), bits: u32) -> u32 {
        let far = far.max(near);
        let z_held = z.clamp(near, far);
        match self {
            Mapping::FloatBits if bits == 32 => z.to_bits(),
            Mapping::FloatBits => {
                stretch(z_held.to_bits() - near.to_bits(), far.to_bits() - near.to_bits(), bits)
            }
            Mapping::Logarithmic => {
                let first = fixed_log2(near);
                stretch(fixed_log2(z_held) - first, fixed_log2(far) - first, bits)
            }
            Mapping::Linear => {
                let share = (z_held - near) * (1.0 / (far - near).max(1e-30));
                // The cast saturates as the shader's product never does: it stays below 2^bits.
                (share.min(0.999_999_94) * (bits as f32).exp2()) as u32
            }
        }
    }
}

/// Computes log2 of a positive float in fixed point, with 24 fractional bits, as `fixed_log2` of the shader.
fn fixed_log2(z: f32) -> u32 {
    let bits = z.to_bits();
    let m = bits << 9;
    let high = |a: u32, b: u32| ((u64::from(a) * u64::from(b)) >> 32) as u32;
    ((bits >> 23) << 24) + (m >> 8) + (high(high(m, !m), 1_477_468_750) >> 8)
}

/// Scales 0 .. range to `bits` bits; returns x unchanged if the range fits.
fn stretch(x: u32, range: u32, bits: u32) -> u32 {
    if bits >= 32 || range >> bits == 0 {
        return x;
    }
    let up = range.leading_zeros();
    let factor = (bits as f32).exp2() * (4_294_967_296.0 / ((range << up) as f32 + 1.0));
    let key = (u64::from(x << up) * u64::from(factor.min(4_294_967_040.0) as u32)) >> 32;
    (key as u32).min((1 << bits) - 1)
}

/// A view as far as its order goes.
pub struct View<'a> {
    /// The visible splats, near to far.
    pub visible: &'a [Visible],
    /// Tiles across and down.
    pub tiles: [u32; 2],
    /// The depth range that keys are made for.
    pub range: (f32, f32),
}

/// The width that a mapping needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Need {
    /// The mapping.
    pub map: Mapping,
    /// Bits of the key; `None` if even 32 are not enough.
    pub bits: Option<u32>,
}

/// Finds the least width for each mapping that leaves at most `errors` overlapping pairs in the wrong order, in any view.
pub fn needs(views: &[View], errors: u64) -> Vec<Need> {
    let of = |map: Mapping| {
        let enough = |bits: &u32| views.iter().all(|view| wrong_pairs(view, map, *bits, errors) <= errors);
        // From wide to narrow: wide keys have few ties, and the first width with too many ends the search.
        Need { map, bits: WIDTHS.rev().take_while(enough).last() }
    };
    Mapping::ALL.into_par_iter().map(of).collect()
}

/// Counts the pairs that overlap on the screen and are drawn in the wrong order; stops beyond `limit`.
///
/// Pairs overlap if they touch a common tile, which may be a few more than share a pixel.
fn wrong_pairs(view: &View, map: Mapping, bits: u32, limit: u64) -> u64 {
    let keys: Vec<u32> =
        view.visible.par_iter().map(|splat| map.key(splat.depth as f32, view.range, bits)).collect();
    let mut in_tile: Vec<Vec<usize>> = vec![Vec::new(); (view.tiles[0] * view.tiles[1]) as usize];
    let mut touched = Vec::new();
    let mut count = 0;
    let mut begin = 0;
    while begin < keys.len() {
        let end = begin + keys[begin..].iter().take_while(|key| **key == keys[begin]).count();
        if end - begin > 1 {
            for at in begin..end {
                let splat = &view.visible[at];
                let [x0, y0, x1, y1] = splat.tiles;
                for (x, y) in (y0..y1).flat_map(|y| (x0..x1).map(move |x| (x, y))) {
                    let tile = (y * view.tiles[0] + x) as usize;
                    for &nearer in &in_tile[tile] {
                        let other = &view.visible[nearer];
                        // A pair is counted in the first tile that both touch.
                        let first = (x0.max(other.tiles[0]), y0.max(other.tiles[1]));
                        count += u64::from(other.index > splat.index && first == (x, y));
                    }
                    if count > limit {
                        return count;
                    }
                    in_tile[tile].push(at);
                    touched.push(tile);
                }
            }
            touched.drain(..).for_each(|tile| in_tile[tile].clear());
        }
        begin = end;
    }
    count
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Splats at depths, each nearer one later in the file, so that every tie is an error where they overlap.
    fn reversed(depths: &[f64], tiles: impl Fn(usize) -> [u32; 4]) -> Vec<Visible> {
        let last = depths.len() - 1;
        let splat = |(at, depth): (usize, &f64)| Visible {
            index: (last - at) as u32,
            depth: *depth,
            tiles: tiles(at),
        };
        depths.iter().enumerate().map(splat).collect()
    }

    fn bits(visible: &[Visible], map: Mapping, errors: u64) -> Option<u32> {
        let (near, far) = (visible[0].depth as f32, visible[visible.len() - 1].depth as f32);
        let views = [View { visible, tiles: [4, 4], range: (near, far) }];
        needs(&views, errors).into_iter().find(|need| need.map == map).expect("all are there").bits
    }

    #[test]
    fn steps_within_one_unit_of_depth_need_as_many_bits_as_there_are_steps() {
        // 512 depths in equal steps: linear keys need 9 bits.
        let depths: Vec<f64> = (0..512).map(|i| 10.0 + f64::from(i) / 512.0).collect();
        let visible = reversed(&depths, |_| [0, 0, 1, 1]);
        assert_eq!(bits(&visible, Mapping::Linear, 0), Some(9));
        // At 10 to 11, floats are in equal steps, too.
        assert_eq!(bits(&visible, Mapping::FloatBits, 0), Some(9));
    }

    #[test]
    fn an_outlier_takes_the_bits_of_linear_keys_and_not_those_of_the_others() {
        // 64 depths from 1 to 2 in steps of 1/64, and one at 2e7.
        let mut depths: Vec<f64> = (0..64).map(|i| 1.0 + f64::from(i) / 64.0).collect();
        depths.push(2e7);
        let visible = reversed(&depths, |_| [0, 0, 1, 1]);
        // A step is 1 / (64 * 2e7) = 2^-30.3 of the range.
        assert_eq!(bits(&visible, Mapping::Linear, 0), Some(31));
        // From 1 to 2e7 are 24.25 octaves of 2^23 floats, and a step is 2^17 of them: 1552 steps.
        assert_eq!(bits(&visible, Mapping::FloatBits, 0), Some(11));
        let logarithmic = bits(&visible, Mapping::Logarithmic, 0).unwrap();
        assert!((11..=12).contains(&logarithmic), "{logarithmic}");
    }

    #[test]
    fn pairs_that_do_not_overlap_or_keep_the_order_of_the_file_are_no_errors() {
        let depths: Vec<f64> = (0..512).map(|i| 10.0 + f64::from(i) / 512.0).collect();
        let apart = reversed(&depths, |at| {
            let (x, y) = ((at % 4) as u32, (at / 4 % 4) as u32);
            [x, y, x + 1, y + 1]
        });
        // The next one in the same tile is 16 steps away: 5 bits would do, and 8 are the least.
        assert_eq!(bits(&apart, Mapping::Linear, 0), Some(8));
        let mut in_order = reversed(&depths, |_| [0, 0, 1, 1]);
        in_order.iter_mut().enumerate().for_each(|(at, splat)| splat.index = at as u32);
        assert_eq!(bits(&in_order, Mapping::Linear, 0), Some(8));
    }

    #[test]
    fn a_number_of_errors_can_be_allowed() {
        let depths: Vec<f64> = (0..512).map(|i| 10.0 + f64::from(i) / 512.0).collect();
        // A pair of two large splats shares four tiles and counts once.
        let visible = reversed(&depths, |_| [0, 0, 2, 2]);
        // With 8 bits, about every two neighbours have one key.
        let view = View { visible: &visible, tiles: [4, 4], range: (10.0, 10.0 + 511.0 / 512.0) };
        let wrong = wrong_pairs(&view, Mapping::Linear, 8, u64::MAX);
        assert_eq!(wrong, 256);
        assert_eq!(
            (bits(&visible, Mapping::Linear, 256), bits(&visible, Mapping::Linear, 255)),
            (Some(8), Some(9))
        );
    }

    proptest! {
        #[test]
        fn keys_never_decrease_with_depth(a in 0.2f32..1e6, b in 0.2f32..1e6, width in 8u32..=32, far in 1f32..1e6) {
            let (a, b) = (a.min(b), a.max(b));
            for map in Mapping::ALL {
                let (first, second) = (map.key(a, (0.2, far), width), map.key(b, (0.2, far), width));
                prop_assert!(first <= second, "{map:?}: {first} {second}");
                prop_assert!(width == 32 || second < 1 << width, "{map:?}: {second}");
            }
        }
    }
}
