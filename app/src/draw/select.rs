//! Finds the splats in a region of the picture.
//!
//! [`Reach::Through`] selects the splats with their centres in the region, at any depth. [`Reach::Front`] selects the
//! splats that contribute most to at least one pixel of the region, wherever their centres are. The rules are those of
//! [`super::pick`], in f64. A splat that the rules cull, or whose opacity is below 1/255, is in no region.

use super::splat_set::{Masked, SplatSet};
use rayon::prelude::*;
use splatgraph_assets::Camera;
use splatgraph_reference::{Rules, largest, project};

/// Number of splats between checks for cancellation.
const CHUNK: u32 = 8192;

/// A region of a picture. Positions are in pixels from its top left corner, right and down.
#[derive(Clone, Debug, PartialEq)]
pub enum Region {
    /// Rectangle between two opposite corners.
    Box([[f64; 2]; 2]),
    /// Points within a distance of a line.
    Brush {
        /// Points of the line; a single point makes a disc.
        line: Vec<[f64; 2]>,
        /// Radius, in pixels.
        radius: f64,
    },
}

/// Depth to which a region selects splats.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Reach {
    /// Selects all splats with their centres in the region.
    #[default]
    Through,
    /// Selects the splats that contribute most to a pixel of the region.
    Front,
}

impl Region {
    /// Returns true if the point is in the region.
    pub fn contains(&self, point: [f64; 2]) -> bool {
        match self {
            Region::Box([a, b]) => {
                (0..2).all(|axis| (a[axis].min(b[axis])..=a[axis].max(b[axis])).contains(&point[axis]))
            }
            Region::Brush { line, radius } => {
                let near = |from, to| distance(point, from, to) <= *radius;
                match line.as_slice() {
                    [only] => near(*only, *only),
                    line => line.windows(2).any(|ends| near(ends[0], ends[1])),
                }
            }
        }
    }

    /// Returns the pixel box of the region in a picture: left, top, right, bottom; right and bottom are exclusive.
    fn bounds(&self, (width, height): (u32, u32)) -> [u32; 4] {
        let (points, margin): (&[[f64; 2]], f64) = match self {
            Region::Box(corners) => (corners, 0.0),
            Region::Brush { line, radius } => (line, *radius),
        };
        let of = |axis: usize, length: u32| {
            let along = points.iter().map(|point| point[axis]);
            let (least, most) =
                along.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
            let pixel = |v: f64| v.clamp(0.0, length.into()) as u32;
            (pixel((least - margin).floor()), pixel((most + margin).ceil()))
        };
        let ((left, right), (top, bottom)) = (of(0, width), of(1, height));
        [left, top, right, bottom]
    }
}

fn distance(point: [f64; 2], from: [f64; 2], to: [f64; 2]) -> f64 {
    let [x, y] = [point[0] - from[0], point[1] - from[1]];
    let [u, v] = [to[0] - from[0], to[1] - from[1]];
    let square = u * u + v * v;
    let along = if square > 0.0 { ((x * u + y * v) / square).clamp(0.0, 1.0) } else { 0.0 };
    (x - along * u).hypot(y - along * v)
}

/// Finds the splats in a region of the picture, without those in [`Masked::hidden`].
///
/// `camera` is in the scene's coordinates, with the size of the picture. `cancelled` is called from several threads;
/// once it returns true, the result is `None`.
pub fn select(
    masked: &Masked,
    camera: &Camera,
    region: &Region,
    reach: Reach,
    cancelled: &(dyn Fn() -> bool + Sync),
) -> Option<SplatSet> {
    let rules = &Rules::of_view(masked.scene, camera);
    match reach {
        Reach::Through => centres(masked, camera, region, rules, cancelled),
        Reach::Front => {
            let area = region.bounds((camera.width, camera.height));
            let found = largest(masked, camera, area, rules, cancelled)?;
            let [left, top, right, bottom] = area;
            let middles = (top..bottom).flat_map(|y| (left..right).map(move |x| [x, y].map(f64::from)));
            let inside = middles.map(|[x, y]| region.contains([x + 0.5, y + 0.5]));
            let seen = found.into_iter().zip(inside).filter(|(index, inside)| *inside && *index != u32::MAX);
            Some(seen.map(|(index, _)| index).collect())
        }
    }
}

fn centres(
    masked: &Masked,
    camera: &Camera,
    region: &Region,
    rules: &Rules,
    cancelled: &(dyn Fn() -> bool + Sync),
) -> Option<SplatSet> {
    let [left, top, right, bottom] = region.bounds((camera.width, camera.height)).map(f64::from);
    let is_in = |index: &u32| {
        project(masked, *index, camera, rules).is_some_and(|splat| {
            let [x, y] = splat.center.map(|v| v + 0.5);
            splat.opacity >= rules.alpha_floor
                && (left..=right).contains(&x)
                && (top..=bottom).contains(&y)
                && region.contains([x, y])
        })
    };
    let count = masked.scene.count();
    let chunk = |chunk: u32| -> Option<Vec<u32>> {
        let first = chunk * CHUNK;
        (!cancelled()).then(|| (first..count.min(first.saturating_add(CHUNK))).filter(is_in).collect())
    };
    let chunks: Option<Vec<Vec<u32>>> = (0..count.div_ceil(CHUNK)).into_par_iter().map(chunk).collect();
    Some(chunks?.into_iter().flatten().collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use splatgraph_assets::{Scene, synth};
    use splatgraph_reference::render;

    fn scene() -> (Scene, Camera) {
        let scene = synth::generate("uniform", 3000, 1).unwrap();
        let camera = Camera::framing(&scene, 160, 120);
        (scene, camera)
    }

    fn selected(hidden: &SplatSet, region: &Region, reach: Reach) -> SplatSet {
        let (scene, camera) = scene();
        select(&Masked { scene: &scene, hidden }, &camera, region, reach, &|| false).unwrap()
    }

    const BOX: Region = Region::Box([[100.0, 90.0], [40.0, 30.0]]);

    #[test]
    fn a_box_selects_the_visible_centres_inside_of_it_at_any_depth() {
        let (scene, camera) = scene();
        let found = selected(&SplatSet::default(), &BOX, Reach::Through);
        let rules = Rules::of(&scene);
        for index in 0..scene.count() {
            let splat = project(&scene, index, &camera, &rules);
            let inside = splat.is_some_and(|splat| {
                let [x, y] = splat.center.map(|v| v + 0.5);
                (40.0..=100.0).contains(&x)
                    && (30.0..=90.0).contains(&y)
                    && splat.opacity >= rules.alpha_floor
            });
            assert_eq!(found.contains(index), inside, "splat {index}");
        }
        assert!(found.len() > 100 && found.len() < scene.count() - 100, "{}", found.len());
    }

    #[test]
    fn the_front_of_a_region_is_what_contributes_most_to_its_pixels() {
        let (scene, camera) = scene();
        let brush = Region::Brush { line: vec![[50.0, 40.0], [90.0, 70.0]], radius: 12.0 };
        for region in [BOX, brush] {
            let picture = render(&scene, &camera, [0.0; 3], &Rules::of(&scene), &|_, _| {});
            let at = |x: u32, y: u32| picture.index[(y * 160 + x) as usize];
            let pixels = (0..120).flat_map(|y| (0..160).map(move |x| (x, y)));
            let inside = pixels.filter(|(x, y)| region.contains([f64::from(*x) + 0.5, f64::from(*y) + 0.5]));
            let expected: SplatSet =
                inside.map(|(x, y)| at(x, y)).filter(|index| *index != u32::MAX).collect();
            let found = selected(&SplatSet::default(), &region, Reach::Front);
            assert_eq!(found, expected);
            assert!(found.len() > 20, "{}", found.len());
        }
    }

    #[test]
    fn hidden_splats_are_not_selected_and_show_what_is_behind_them() {
        for reach in [Reach::Through, Reach::Front] {
            let first = selected(&SplatSet::default(), &BOX, reach);
            let next = selected(&first, &BOX, reach);
            assert!(next.without(&first) == next, "{reach:?}");
            assert_eq!(next.is_empty(), reach == Reach::Through, "{reach:?}");
        }
    }

    #[test]
    fn a_brush_covers_what_is_within_its_radius_of_its_line() {
        let brush = Region::Brush { line: vec![[10.0, 10.0], [30.0, 10.0], [30.0, 40.0]], radius: 5.0 };
        for (point, inside) in [
            ([20.0, 15.0], true),
            ([20.0, 15.1], false),
            ([5.0, 10.0], true),
            ([5.0, 6.0], false),
            ([35.0, 25.0], true),
            ([33.0, 44.0], true),
            ([34.0, 44.0], false),
        ] {
            assert_eq!(brush.contains(point), inside, "{point:?}");
        }
        assert_eq!(brush.bounds((34, 100)), [5, 5, 34, 45]);
        assert_eq!(Region::Box([[-7.0, 3.2], [2.5, 9.0]]).bounds((100, 8)), [0, 3, 3, 8]);
        let dab = Region::Brush { line: vec![[3.0, 3.0]], radius: 2.0 };
        assert!(dab.contains([4.4, 4.4]) && !dab.contains([4.5, 4.5]));
    }

    #[test]
    fn a_region_outside_of_the_picture_has_no_splat() {
        let outside = Region::Box([[-50.0, -50.0], [-1.0, -1.0]]);
        for reach in [Reach::Through, Reach::Front] {
            assert!(selected(&SplatSet::default(), &outside, reach).is_empty());
        }
        let (scene, camera) = scene();
        let masked = Masked::whole(&scene);
        assert_eq!(select(&masked, &camera, &BOX, Reach::Through, &|| true), None);
        assert_eq!(select(&masked, &camera, &BOX, Reach::Front, &|| true), None);
    }
}
