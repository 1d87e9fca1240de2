//! Computes the width that a depth key needs.
//!
//! A key never decreases with depth. Therefore, only splats with equal keys can be in the wrong order: a stable sort
//! leaves them in file order. Only pairs that overlap on the screen matter. The keys are computed with the same
//! operations as in shaders/depth_key.glsl.
//!
//! [`of_scene`] computes the width that orders every view of a scene exactly, which graphs read as the fact
//! `scene.key_bits`. [`needs`] finds the width for given cameras.

use crate::draw::camera::{ROUNDING, depth_range, farthest};
use crate::draw::orbit;
use rayon::prelude::*;
use serde::Serialize;
use splatgraph_assets::{Bounds, Camera, NEAR, Scene};
use splatgraph_reference::{KeyOf, Rules, Visible, visible};
use std::collections::HashMap;
use std::ops::Range;

/// Mapping of depths to keys: a value of the graphs' parameter `key_map`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Mapping {
    /// The bits of the depth as a float; with fewer than 32 bits, scaled from the range of the depths.
    FloatBits,
    /// Equal steps of depth.
    Linear,
    /// Equal steps of the logarithm of depth, approximately.
    Logarithmic,
    /// Equal numbers of the frame's splats per key, approximately.
    Equalised,
}

/// Range of widths of keys, in bits.
pub const WIDTHS: std::ops::RangeInclusive<u32> = 8..=32;

impl Mapping {
    /// All mappings.
    pub const ALL: [Mapping; 4] =
        [Mapping::FloatBits, Mapping::Linear, Mapping::Logarithmic, Mapping::Equalised];

    /// Returns the name as a value of `key_map`.
    pub fn name(self) -> &'static str {
        match self {
            Mapping::FloatBits => "float_bits",
            Mapping::Linear => "linear",
            Mapping::Logarithmic => "logarithmic",
            Mapping::Equalised => "equalised",
        }
    }
}

/// Function that maps depths to keys in one frame.
pub struct Keys {
    map: Mapping,
    range: (f32, f32),
    bits: u32,
    /// First key of each depth class, and the end of the last class. Empty unless the keys are equalised.
    starts: Vec<u32>,
}

/// Bits of a depth class, for equalised keys; see shaders/depth_classes.glsl.
const CLASS_BITS: u32 = 11;

impl Keys {
    /// Prepares keys of `bits` bits for depths from `near` to `far`, the range of the scene's box.
    ///
    /// Equalised keys use at most 31 bits. `depths` are those of the frame's visible splats; only
    /// [`Mapping::Equalised`] reads them.
    pub fn new(map: Mapping, (near, far): (f32, f32), bits: u32, depths: impl Iterator<Item = f32>) -> Keys {
        let mut keys = Keys { map, range: (near, far.max(near)), bits, starts: Vec::new() };
        if map == Mapping::Equalised {
            let mut counts = vec![0u32; 1 << CLASS_BITS];
            depths.for_each(|z| counts[(keys.place(z) >> (32 - CLASS_BITS)) as usize] += 1);
            let all = counts.iter().sum();
            let mut before = 0;
            keys.starts.push(0);
            for count in counts {
                before += count;
                keys.starts.push(key_after(before, all, bits.min(31)));
            }
        }
        keys
    }

    /// Computes the position of a depth's bits in the range, like `depth_place` in the shader. It is shifted left until
    /// the range's size has 32 significant bits.
    fn place(&self, z: f32) -> u32 {
        let (near, far) = self.range;
        let range = far.to_bits() - near.to_bits();
        let x = z.clamp(near, far).to_bits() - near.to_bits();
        if range == 0 { 0 } else { x << range.leading_zeros() }
    }

    /// Computes the key of a depth. A depth beyond the range has the key of the range's end, except for
    /// [`Mapping::FloatBits`] with 32 bits.
    pub fn of(&self, z: f32) -> u32 {
        let ((near, far), bits) = (self.range, self.bits);
        let z_held = z.clamp(near, far);
        match self.map {
            Mapping::Equalised => {
                let place = self.place(z);
                let class = (place >> (32 - CLASS_BITS)) as usize;
                let width = self.starts[class + 1] - self.starts[class];
                self.starts[class] + high(place << CLASS_BITS, width)
            }
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
                // Below 2^bits, so the cast does not saturate, here or in the shader.
                (share.min(0.999_999_94) * (bits as f32).exp2()) as u32
            }
        }
    }
}

fn high(a: u32, b: u32) -> u32 {
    ((u64::from(a) * u64::from(b)) >> 32) as u32
}

/// Computes the key of a splat with `count` of `all` splats in front of it, like `key_after` in shaders/equalise.comp.
fn key_after(count: u32, all: u32, bits: u32) -> u32 {
    if all == 0 {
        return 0;
    }
    let up = all.leading_zeros();
    high(count << up, factor(all << up, bits)).min((1 << bits) - 1)
}

/// Computes 2^bits divided by a range of at least 2^31, in units of 2^-32.
///
/// One rounded factor scales all keys, so rounding does not change their order.
fn factor(range: u32, bits: u32) -> u32 {
    let factor = (bits as f32).exp2() * (4_294_967_296.0 / (range as f32 + 1.0));
    factor.min(4_294_967_040.0) as u32
}

/// Approximates 127 + log2 of a positive float, with 24 fractional bits, like `fixed_log2` in the shader.
fn fixed_log2(z: f32) -> u32 {
    let bits = z.to_bits();
    let m = bits << 9;
    ((bits >> 23) << 24) + (m >> 8) + (high(high(m, !m), 1_477_468_750) >> 8)
}

/// Scales `x` from 0..range to `bits` bits. If the range already fits, returns `x`.
fn stretch(x: u32, range: u32, bits: u32) -> u32 {
    if bits >= 32 || range >> bits == 0 {
        return x;
    }
    let up = range.leading_zeros();
    high(x << up, factor(range << up, bits)).min((1 << bits) - 1)
}

/// Data of a view that determine the order of splats, and which splats overlap.
struct View {
    /// The visible splats, near to far.
    visible: Vec<Visible>,
    /// Number of tiles across and down.
    tiles: [u32; 2],
    /// Range of the depths, or distances, that the keys cover.
    range: (f32, f32),
}

impl View {
    /// Projects, by the scene's own rules, the splats that reach the published alpha floor.
    ///
    /// [`of_scene`] covers fainter splats, too, because a graph's parameter `alpha_floor` can be below that floor.
    fn new(scene: &Scene, camera: &Camera) -> View {
        let rules = Rules::of_view(scene, camera);
        let (mut visible, tiles) = visible(scene, camera, &rules);
        visible.retain(|splat| scene.can_show(splat.index as usize));
        let bounds = scene.bounds();
        let [near, mut far] = depth_range(camera, &bounds);
        if rules.key_of == KeyOf::Distance {
            far = farthest(camera, &bounds).max(near);
        }
        View { visible, tiles, range: (near as f32, far as f32) }
    }
}

/// Key width that a mapping needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Need {
    /// Mapping of depth to keys.
    pub map: Mapping,
    /// Width of the key in bits. `None` if 32 bits are not enough, or if too many keys are equal to count the pairs.
    pub bits: Option<u32>,
}

/// Finds, for each mapping, the smallest key width that leaves at most `errors` wrong pairs in each view, as all larger
/// widths do.
///
/// A wrong pair is two splats that overlap on the screen and are drawn in the wrong order. The cameras are in the
/// scene's coordinates.
pub fn needs(scene: &Scene, cameras: &[Camera], errors: u64) -> Vec<Need> {
    needs_of(&cameras.iter().map(|camera| View::new(scene, camera)).collect::<Vec<_>>(), errors)
}

fn needs_of(views: &[View], errors: u64) -> Vec<Need> {
    Mapping::ALL.into_par_iter().map(|map| Need { map, bits: need(views, map, errors) }).collect()
}

fn need(views: &[View], map: Mapping, errors: u64) -> Option<u32> {
    let enough = |bits: &u32| views.iter().all(|view| wrong_pairs(view, map, *bits, errors) <= errors);
    // The widest keys come first: they have few ties, so they are checked quickly.
    WIDTHS.rev().take_while(enough).last()
}

/// Makes `count` cameras in a circle around the middle of a scene. The circle starts at `first`; each name is that of
/// `first` and an index.
pub fn around(scene: &Scene, first: &Camera, count: u32) -> Vec<Camera> {
    let center = scene.robust_bounds().center();
    let turned = |at: u32| Camera {
        img_name: format!("{} {at}", first.img_name),
        ..orbit::turned(first, center, 360.0 / f64::from(count) * f64::from(at))
    };
    (0..count).map(turned).collect()
}

/// Computes the width, 8 to 32 bits, at which [`Mapping::FloatBits`] orders every view of a scene exactly.
///
/// Keys are exact if their range contains at most 2^width floats. In a view, depths range from some `near` to at most
/// `near` plus the diagonal of the scene's box. Floats become sparser with increasing value, so the range that starts
/// at the near plane contains the most floats. It is extended by the rounding of depths ([`depth_range`]) for cameras
/// no farther from the origin than about a thousand times the box's largest coordinates.
pub fn of_scene(bounds: &Bounds) -> u32 {
    let side = |i: usize| f64::from(bounds.max[i]) - f64::from(bounds.min[i]);
    let diagonal = (0..3).map(|i| side(i) * side(i)).sum::<f64>().sqrt();
    let coordinate = |i: usize| f64::from(bounds.min[i].abs().max(bounds.max[i].abs()));
    let rounding = 2000.0 * ROUNDING * (0..3).map(coordinate).sum::<f64>();
    let far = (NEAR + diagonal + rounding).min(f32::MAX.into()) as f32;
    let range = far.to_bits() - (NEAR as f32).to_bits();
    (u32::BITS - range.leading_zeros()).clamp(*WIDTHS.start(), *WIDTHS.end())
}

/// Maximum number of tiles and pairs to examine for one width in one view.
///
/// It bounds the otherwise quadratic time for thousands of splats with equal keys.
const MAX_WORK: u64 = 20_000_000;

/// Counts the pairs that overlap on the screen and are drawn in the wrong order. Stops above `limit`.
///
/// Pairs count as overlapping if they touch a common tile. If counting takes more than [`MAX_WORK`], the result exceeds
/// the limit, so that keys become too wide rather than too narrow.
fn wrong_pairs(view: &View, map: Mapping, bits: u32, limit: u64) -> u64 {
    let of = Keys::new(map, view.range, bits, view.visible.iter().map(|splat| splat.depth as f32));
    let keys: Vec<u32> = view.visible.par_iter().map(|splat| of.of(splat.depth as f32)).collect();
    let mut ties = Ties { view, limit, work: 0, count: 0, greatest: Vec::new() };
    let mut begin = 0;
    while begin < keys.len() && ties.count <= limit {
        let end = begin + keys[begin..].iter().take_while(|key| **key == keys[begin]).count();
        if end - begin > 1 {
            ties.count(begin..end);
        }
        begin = end;
    }
    ties.count
}

struct Ties<'a> {
    view: &'a View,
    limit: u64,
    work: u64,
    count: u64,
    /// For each tile, the end of the last run that touched it, and the greatest index in that run. Empty until needed.
    greatest: Vec<(usize, u32)>,
}

impl Ties<'_> {
    /// Counts the wrong pairs in a run of equal keys: pairs whose farther splat comes first in the file.
    fn count(&mut self, run: Range<usize>) {
        let splats = &self.view.visible[run.clone()];
        let area = |splat: &Visible| {
            let [x0, y0, x1, y1] = splat.tiles;
            u64::from(x1.saturating_sub(x0)) * u64::from(y1.saturating_sub(y0))
        };
        let tiles = splats.iter().map(area).fold(0, u64::saturating_add);
        let pairs = splats.len() as u64 * (splats.len() as u64 - 1) / 2;
        match self.limit {
            // Few splats may touch millions of tiles.
            _ if pairs <= tiles => self.compare_pairs(run),
            0 => self.find_one(run),
            _ => self.count_by_tile(run),
        }
    }

    /// Adds units of work. Returns true once there are too many units or wrong pairs.
    ///
    /// Too many units set the count above the limit.
    fn work(&mut self, units: u64) -> bool {
        self.work += units;
        if self.work > MAX_WORK {
            self.count = self.limit + 1;
        }
        self.count > self.limit
    }

    fn tiles(&self, at: usize) -> impl Iterator<Item = (u32, u32, usize)> + use<> {
        let ([x0, y0, x1, y1], across) = (self.view.visible[at].tiles, self.view.tiles[0] as usize);
        (y0..y1).flat_map(move |y| (x0..x1).map(move |x| (x, y, y as usize * across + x as usize)))
    }

    /// Counts the wrong pairs by comparing each splat with all nearer ones.
    fn compare_pairs(&mut self, run: Range<usize>) {
        let view = self.view;
        for at in run.clone() {
            if self.work((at - run.start) as u64) {
                return;
            }
            let splat = &view.visible[at];
            let [x0, y0, x1, y1] = splat.tiles;
            let overlaps = |[left, top, right, bottom]: [u32; 4]| {
                x0.max(left) < x1.min(right) && y0.max(top) < y1.min(bottom)
            };
            let nearer = &view.visible[run.start..at];
            let wrong = nearer.iter().filter(|other| other.index > splat.index && overlaps(other.tiles));
            self.count += wrong.count() as u64;
        }
    }

    /// Searches for one wrong pair.
    fn find_one(&mut self, run: Range<usize>) {
        if self.greatest.is_empty() {
            let [across, down] = self.view.tiles.map(|count| count as usize);
            // Zeroed memory is committed page by page, when a splat first touches a tile of the page.
            self.greatest = vec![(0, 0); across * down];
        }
        for at in run.clone() {
            let index = self.view.visible[at].index;
            for (_, _, tile) in self.tiles(at) {
                if self.work(1) {
                    return;
                }
                match &mut self.greatest[tile] {
                    (end, nearer) if *end == run.end => {
                        if *nearer > index {
                            self.count = 1;
                            return;
                        }
                        *nearer = index;
                    }
                    other => *other = (run.end, index),
                }
            }
        }
    }

    /// Counts the wrong pairs among the splats of each tile.
    fn count_by_tile(&mut self, run: Range<usize>) {
        let mut in_tile: HashMap<usize, Vec<usize>> = HashMap::new();
        for at in run {
            let splat = &self.view.visible[at];
            for (x, y, tile) in self.tiles(at) {
                let in_tile = in_tile.entry(tile).or_default();
                if self.work(1 + in_tile.len() as u64) {
                    return;
                }
                for &nearer in &*in_tile {
                    let other = &self.view.visible[nearer];
                    // Count a pair only in the first tile that both touch.
                    let first = (splat.tiles[0].max(other.tiles[0]), splat.tiles[1].max(other.tiles[1]));
                    self.count += u64::from(other.index > splat.index && first == (x, y));
                }
                in_tile.push(at);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use splatgraph_assets::{FileNotes, Projection, SortKey, synth};

    /// Makes splats whose file order is the reverse of their depths, so that every tie is a wrong pair.
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
        let views = [View { visible: visible.to_vec(), tiles: [4, 4], range: (near, far) }];
        needs_of(&views, errors).into_iter().find(|need| need.map == map).expect("all are there").bits
    }

    #[test]
    fn steps_within_one_unit_of_depth_need_as_many_bits_as_there_are_steps() {
        // 512 equal steps.
        let depths: Vec<f64> = (0..512).map(|i| 10.0 + f64::from(i) / 512.0).collect();
        let visible = reversed(&depths, |_| [0, 0, 1, 1]);
        assert_eq!(bits(&visible, Mapping::Linear, 0), Some(9));
        // From 10 to 11, floats have equal steps as well.
        assert_eq!(bits(&visible, Mapping::FloatBits, 0), Some(9));
    }

    #[test]
    fn an_outlier_takes_the_bits_of_linear_keys_and_not_those_of_the_others() {
        // 64 depths from 1 to 2 in steps of 1/64, and one at 2e7.
        let mut depths: Vec<f64> = (0..64).map(|i| 1.0 + f64::from(i) / 64.0).collect();
        depths.push(2e7);
        let visible = reversed(&depths, |_| [0, 0, 1, 1]);
        // One step is 1 / (64 * 2e7) = 2^-30.3 of the range.
        assert_eq!(bits(&visible, Mapping::Linear, 0), Some(31));
        // The range 1 to 2e7 has 24.25 octaves of 2^23 floats. A step is 2^17 floats, so there are 1552 steps.
        assert_eq!(bits(&visible, Mapping::FloatBits, 0), Some(11));
        let logarithmic = bits(&visible, Mapping::Logarithmic, 0).unwrap();
        assert!((11..=12).contains(&logarithmic), "{logarithmic}");
    }

    #[test]
    fn ten_thousand_splats_at_one_place_cost_no_more_than_their_number() {
        let same: Vec<Visible> =
            (0..10_000).map(|index| Visible { index, depth: 10.0, tiles: [0, 0, 4, 4] }).collect();
        assert_eq!(bits(&same, Mapping::FloatBits, 0), Some(8), "they keep the order of the file");
        let behind: Vec<Visible> =
            (0..10_000).map(|index| Visible { index: 9_999 - index, ..same[0] }).collect();
        assert_eq!(bits(&behind, Mapping::FloatBits, 0), None);
        assert_eq!(bits(&same, Mapping::FloatBits, 1), None);
    }

    #[test]
    fn few_splats_that_touch_millions_of_tiles_cost_no_more_than_their_pairs() {
        let same: Vec<Visible> =
            (0..300).map(|index| Visible { index, depth: 10.0, tiles: [0, 0, 2048, 2048] }).collect();
        let view = |visible| View { visible, tiles: [2048, 2048], range: (10.0, 10.0) };
        let behind = same.iter().map(|splat| Visible { index: 299 - splat.index, ..*splat }).collect();
        assert_eq!(wrong_pairs(&view(same), Mapping::FloatBits, 8, 0), 0);
        assert_eq!(wrong_pairs(&view(behind), Mapping::FloatBits, 8, u64::MAX), 300 * 299 / 2);
    }

    #[test]
    fn pairs_counted_by_tile_are_those_that_overlap() {
        // 60 splats of one key, in a file order without a pattern, each in one to four of 16 tiles.
        let visible: Vec<Visible> = (0..60)
            .map(|at| {
                let [x, y] = [at * 7 % 4, at * 5 % 3];
                Visible {
                    index: at * 37 % 61,
                    depth: 10.0,
                    tiles: [x, y, (x + 1 + at % 2).min(4), y + 1 + at % 2],
                }
            })
            .collect();
        let overlap = |[a, b, c, d]: [u32; 4], [e, f, g, h]: [u32; 4]| a < g && e < c && b < h && f < d;
        let nearer = |at: usize| visible[..at].iter().map(move |other| (other, at));
        let pairs = (0..visible.len()).flat_map(nearer);
        let wrong = pairs.filter(|(other, at)| {
            other.index > visible[*at].index && overlap(other.tiles, visible[*at].tiles)
        });
        let wrong = wrong.count() as u64;
        let view = View { visible, tiles: [4, 4], range: (10.0, 10.0) };
        assert_eq!(wrong_pairs(&view, Mapping::FloatBits, 8, u64::MAX), wrong);
        assert_eq!(wrong_pairs(&view, Mapping::FloatBits, 8, 0), 1);
    }

    #[test]
    fn pairs_that_do_not_overlap_or_keep_the_order_of_the_file_are_no_errors() {
        let depths: Vec<f64> = (0..512).map(|i| 10.0 + f64::from(i) / 512.0).collect();
        let apart = reversed(&depths, |at| {
            let (x, y) = ((at % 4) as u32, (at / 4 % 4) as u32);
            [x, y, x + 1, y + 1]
        });
        // The next splat in the same tile is 16 steps away. 5 bits would be enough, but 8 is the minimum width.
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
        // With 8 bits, pairs of neighbours share a key.
        let view = View { visible: visible.clone(), tiles: [4, 4], range: (10.0, 10.0 + 511.0 / 512.0) };
        let wrong = wrong_pairs(&view, Mapping::Linear, 8, u64::MAX);
        assert_eq!(wrong, 256);
        assert_eq!(
            (bits(&visible, Mapping::Linear, 256), bits(&visible, Mapping::Linear, 255)),
            (Some(8), Some(9))
        );
    }

    #[test]
    fn the_cameras_around_a_scene_keep_their_distance() {
        let scene = synth::generate("uniform", 200, 0).unwrap();
        let cameras = around(&scene, &Camera::framing(&scene, 64, 48), 4);
        let center = scene.robust_bounds().center();
        let depth: Vec<f64> = cameras.iter().map(|camera| camera.to_view(center)[2]).collect();
        assert_eq!(cameras.len(), 4);
        assert!(depth.iter().all(|z| (z - depth[0]).abs() < 1e-9 && *z > 0.0), "{depth:?}");
        assert_ne!(cameras[0].position, cameras[2].position);
    }

    #[test]
    fn equalised_keys_go_where_the_splats_are() {
        // 512 depths from 10 to 11, and an outlier at 2e7. Equalised keys need 10 bits; linear keys would need 34.
        let mut depths: Vec<f64> = (0..512).map(|i| 10.0 + f64::from(i) / 512.0).collect();
        depths.push(2e7);
        let visible = reversed(&depths, |_| [0, 0, 1, 1]);
        let wide = bits(&visible, Mapping::FloatBits, 0).unwrap();
        let narrow = bits(&visible, Mapping::Equalised, 0).unwrap();
        assert!((9..=11).contains(&narrow) && narrow + 2 < wide, "{narrow} of {wide}");
        assert_eq!(bits(&visible, Mapping::Linear, 0), None);
    }

    #[test]
    fn keys_of_distances_cover_the_greatest_distance() {
        let scene = synth::generate("uniform", 500, 0).expect("a small scene");
        let scene = scene.with_notes(FileNotes { key_of: SortKey::Distance, ..FileNotes::default() });
        let wide = Camera::looking_at([0.0; 3], [0.0, 0.0, 1.0], 120.0, (64, 48));
        let around = wide.with_projection(Projection::Equirectangular, [0.0; 3]);
        for camera in [wide, around] {
            let found = needs(&scene, &[camera], 0);
            assert!(found.iter().all(|need| need.bits.is_some_and(|bits| bits <= 26)), "{found:?}");
        }
    }

    #[test]
    fn the_width_of_a_scene_grows_with_the_octaves_from_the_near_plane_through_its_box() {
        let cube = |side: f32| of_scene(&Bounds { min: [-0.5 * side; 3], max: [0.5 * side; 3] });
        // From the near plane 0.2, a diagonal of 1.7 spans 3.2 octaves, 17 spans 6.4, and 17,000 spans 16.4.
        assert_eq!([1.0, 10.0, 1e4, 1e8].map(cube), [25, 26, 28, 28]);
        assert_eq!(of_scene(&Bounds { min: [0.5; 3], max: [0.5; 3] }), 17, "a point has the rounding alone");
        assert_eq!(of_scene(&Bounds { min: [-1e38; 3], max: [1e38; 3] }), 31);
    }

    proptest! {
        #[test]
        fn keys_of_a_scenes_width_keep_all_depths_apart_in_every_view(
            corner in prop::array::uniform3(-1e3f32..1e3),
            size in prop::array::uniform3(0f32..1e2),
            eye in prop::array::uniform3(-300f64..300.0),
            to in prop::array::uniform3(0f64..1.0),
            shares in prop::collection::vec(prop::array::uniform3(0f64..=1.0), 2..20),
        ) {
            let bounds = Bounds { min: corner, max: std::array::from_fn(|i| corner[i] + size[i]) };
            let at = |share: [f64; 3]| -> [f64; 3] {
                std::array::from_fn(|i| {
                    let (low, high) = (f64::from(bounds.min[i]), f64::from(bounds.max[i]));
                    low + share[i] * (high - low)
                })
            };
            // Cameras near, inside and far from the box.
            let position: [f64; 3] = std::array::from_fn(|i| f64::from(corner[i]) + eye[i] * eye[0].abs() / 300.0);
            let target = at(to);
            prop_assume!((0..3).any(|i| (target[i] - position[i]).abs() > 1e-3));
            let camera = Camera::looking_at(position, target, 60.0, (64, 48));
            let bits = of_scene(&bounds);
            let [near, far] = depth_range(&camera, &bounds).map(|z| z as f32);
            let keys = Keys::new(Mapping::FloatBits, (near, far), bits, [].into_iter());
            for share in shares {
                let z = camera.to_view(at(share))[2] as f32;
                prop_assume!(z > NEAR as f32);
                prop_assert!(near <= z && z <= far, "{z} is not in {near} to {far}");
                prop_assert!(keys.of(z) < keys.of(z.next_up()) || z == far, "{bits} bits, {z} in {near} to {far}");
            }
        }

        #[test]
        fn keys_never_decrease_with_depth(a in 0.2f32..1e6, b in 0.2f32..1e6, width in 8u32..=32, far in 1f32..1e6) {
            let (a, b) = (a.min(b), a.max(b));
            for map in Mapping::ALL {
                let keys = Keys::new(map, (0.2, far), width, [a, 0.3, 7.0, 7.1].into_iter());
                let (first, second) = (keys.of(a), keys.of(b));
                prop_assert!(first <= second, "{map:?}: {first} {second}");
                prop_assert!(width == 32 || second < 1 << width, "{map:?}: {second}");
            }
        }
    }
}
