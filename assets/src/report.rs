//! Reports the flaws of a scene that affect rendering.
//!
//! Flaws are, for example, floaters far from most splats, which waste the bits of a depth key, and splats as large as
//! the scene. The report counts them, and the splats that were dropped on load; it does not change the scene.

use crate::bounds::{self, WorldBounds, decimals, median, quantile};
use crate::camera::Camera;
use crate::formats::LargeSteps;
use crate::scene::{
    ALPHA_FLOOR, CoarsePositions, ColorRange, Dropped, FileNotes, QuaternionNorms, Scene, SortKey,
};
use crate::scene_format::SceneFormat;
use crate::size_breakdown::{grouped, rounded};
use crate::words::CHUNK;
use glam::DVec3;
use rayon::prelude::*;
use serde::Serialize;
use std::fmt;

/// View depth of the reference rasteriser's near plane, in world units.
pub const NEAR: f64 = 0.2;

/// Largest finite half float.
const MAX_HALF: f64 = 65_504.0;

/// The statistics of a scene.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// Tags of the file, and counts of what loading left out or clamped.
    pub file: FileNotes,
    /// Number of splats, without dropped ones.
    pub splats: u32,
    /// Counts of the dropped splats, by reason.
    pub dropped: Dropped,
    /// Degree of the stored spherical harmonics.
    pub stored_sh_degree: u32,
    /// Highest band with a coefficient other than 0 in any splat; 0 if there is none.
    pub effective_sh_degree: u32,
    /// Highest band with a coefficient other than 0 in any splat whose opacity is at least the alpha floor, 1/255.
    pub shown_sh_degree: u32,
    /// Lengths of the quaternions before normalisation.
    pub quaternions: QuaternionNorms,
    /// Range of the spherical harmonics and of the colours.
    pub color: ColorRange,
    /// Opacities near their limits.
    pub opacity: OpacityReport,
    /// Splats that are large relative to the scene.
    pub size: SizeReport,
    /// Bounds and precision of the splats' positions, and the number of outliers.
    pub place: PlaceReport,
    /// Depth range of the splats, per camera.
    pub depth: Vec<DepthReport>,
}

/// Opacities near their limits.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct OpacityReport {
    /// Number of splats with an opacity below 1/255; the reference rasteriser never draws them.
    pub below_floor: u64,
    /// Number of splats with an opacity above 0.99, the maximum of alpha.
    pub above_cap: u64,
}

/// Splats that are large relative to the scene.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SizeReport {
    /// Number of splats with a standard deviation above half the robust extent.
    pub oversized: u64,
    /// Largest standard deviation, in world units.
    pub largest: f32,
    /// Median of each splat's largest standard deviation, in world units.
    pub median: f32,
    /// Longest side of the robust box, in world units.
    pub robust_extent: f64,
}

/// Bounds and precision of the splats' positions, in the world's coordinates.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PlaceReport {
    /// The scene's origin, which is subtracted from positions and cameras before they are rounded to f32.
    pub offset: [f64; 3],
    /// Box around every centre.
    pub bounds: WorldBounds,
    /// Box from the 1st to the 99th percentile of each coordinate.
    pub robust_bounds: WorldBounds,
    /// Centre of the robust box.
    pub center: [f64; 3],
    /// Number of centres outside the robust box scaled by ten.
    pub outliers: u64,
    /// Rounding of the centres that is large relative to the splats; `None` if there is none.
    pub coarse: Option<CoarsePositions>,
    /// Files of a list of scenes with coarse positions.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub coarse_parts: Vec<(String, CoarsePositions)>,
    /// Steps of positions that are larger than more than 1/100 of the splats. `None` unless the scene is one whole SOG.
    pub steps: Option<LargeSteps>,
}

/// View depths of the splats beyond a camera's near plane ([`NEAR`]), whether inside the image or not. Distances from
/// the camera, if splats are sorted by them.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DepthReport {
    /// Name of the camera; its `id` if it has none.
    pub camera: String,
    /// Number of splats beyond the near plane.
    pub in_front: u64,
    /// Range of the depths of these splats; `None` if there are none.
    pub range: Option<DepthRange>,
}

/// A range of depths, in world units.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct DepthRange {
    /// Smallest depth.
    pub near: f64,
    /// Largest depth.
    pub far: f64,
    /// 1st percentile of the depths.
    pub robust_near: f64,
    /// 99th percentile of the depths.
    pub robust_far: f64,
    /// Bits that outliers cost a key linear in depth: log2 of the whole range over the robust range.
    pub linear_bits_lost: f64,
    /// Bits that outliers cost a key linear in the logarithm of depth.
    pub logarithmic_bits_lost: f64,
}

impl Report {
    /// Examines a scene. `cameras` are in the scene's coordinates ([`Camera::relative_to`]); without any, depths are
    /// for the camera of [`Camera::framing`].
    pub fn new(scene: &Scene, cameras: &[Camera]) -> Self {
        let (robust_bounds, offset) = (scene.robust_bounds(), scene.offset());
        let robust_extent = robust_bounds.extent();
        let mut largest: Vec<f32> =
            scene.scales().par_iter().with_min_len(CHUNK).copied().map(bounds::largest).collect();
        let count_above = |limit: f64| largest.par_iter().filter(|s| f64::from(**s) > limit).count() as u64;
        let outer = robust_bounds.grown(10.0);
        let outliers = scene.positions().par_iter().filter(|p| !outer.contains(**p)).count() as u64;
        let opacities =
            |keep: fn(f32) -> bool| scene.opacities().par_iter().filter(|o| keep(**o)).count() as u64;
        let is_sog = scene.size_breakdown().is_whole_sog;
        let framing;
        let cameras = if cameras.is_empty() {
            framing = [Camera { img_name: "framing".into(), ..Camera::framing(scene, 960, 540) }];
            &framing
        } else {
            cameras
        };
        Self {
            file: scene.notes(),
            splats: scene.count(),
            dropped: *scene.dropped(),
            stored_sh_degree: scene.stored_degree(),
            effective_sh_degree: scene.effective_degree(),
            shown_sh_degree: scene.shown_degree(),
            quaternions: scene.quaternion_norms(),
            color: scene.color_range(),
            opacity: OpacityReport {
                below_floor: opacities(|o| o < ALPHA_FLOOR),
                above_cap: opacities(|o| o > 0.99),
            },
            size: SizeReport {
                oversized: count_above(0.5 * robust_extent),
                largest: largest.iter().copied().fold(0.0, f32::max),
                median: median(&mut largest),
                robust_extent,
            },
            place: PlaceReport {
                offset,
                bounds: scene.bounds().in_world(offset),
                robust_bounds: robust_bounds.in_world(offset),
                center: std::array::from_fn(|axis| robust_bounds.center()[axis] + offset[axis]),
                outliers,
                coarse: scene.coarse_positions(),
                coarse_parts: scene.coarse_parts().to_vec(),
                // The file's bounds are those of its splats.
                steps: is_sog.then(|| scene.large_steps(SceneFormat::Sog)).flatten(),
            },
            depth: cameras.iter().map(|camera| DepthReport::new(scene, camera)).collect(),
        }
    }
}

impl DepthReport {
    fn new(scene: &Scene, camera: &Camera) -> Self {
        let projection = camera.projection;
        let key_of = projection.sort_key(scene.notes().key_of);
        let depth = |p: &[f32; 3]| {
            let view = DVec3::from(camera.to_view(p.map(f64::from)));
            let key = if key_of == SortKey::Distance { view.length() } else { view.z };
            // The near plane of a camera that sees behind itself is a sphere.
            let from_near = if projection.sees_behind() { key } else { view.z };
            (from_near > NEAR).then_some(key as f32)
        };
        let mut depths: Vec<f32> =
            scene.positions().par_iter().with_min_len(CHUNK).filter_map(depth).collect();
        let range = (!depths.is_empty()).then(|| {
            let [near, robust_near, robust_far, far] =
                [0.0, 0.01, 0.99, 1.0].map(|q| f64::from(quantile(&mut depths, q)));
            let lost = |all: f64, bulk: f64| if bulk > 0.0 { (all / bulk).log2() } else { 0.0 };
            DepthRange {
                near,
                far,
                robust_near,
                robust_far,
                linear_bits_lost: lost(far - near, robust_far - robust_near),
                logarithmic_bits_lost: lost((far / near).ln(), (robust_far / robust_near).ln()),
            }
        });
        let name = if camera.img_name.is_empty() { camera.id.to_string() } else { camera.img_name.clone() };
        Self { camera: name, in_front: depths.len() as u64, range }
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let percent = |n: u64| 100.0 * n as f64 / f64::from(self.splats.max(1));
        let line = |f: &mut fmt::Formatter<'_>, what: &str, text: String| writeln!(f, "  {what:<22}{text}");
        writeln!(f, "{} splats", grouped(self.splats.into()))?;
        line(f, "dropped", self.dropped.to_string())?;
        let (stored, effective, shown) =
            (self.stored_sh_degree, self.effective_sh_degree, self.shown_sh_degree);
        let above = match () {
            () if shown < effective => ", the bands above are zero in every splat that can be visible",
            () if effective < stored => ", the bands above are all zero",
            () => "",
        };
        let cut = self.file.cut_degree.map(|degree| format!("degree {degree} in the file, cut to 3; "));
        let cut = cut.unwrap_or_default();
        line(f, "harmonics", format!("{cut}degree {stored} stored, {shown} in use{above}"))?;
        for text in self.file.left_out() {
            line(f, "left out", text)?;
        }
        for (name, value) in self.file.tags() {
            line(f, "tag", format!("{name} {value}"))?;
        }
        if let Some(tags) = self.file.mixed_tags() {
            line(f, "tags left out", format!("{tags}: the merged scenes differ"))?;
        }
        let c = &self.color;
        let beyond = if c.brightest > MAX_HALF { ", beyond half floats" } else { "" };
        line(
            f,
            "colours",
            format!("coefficients up to {:.3}, brightness up to {:.3}{beyond}", c.largest_sh, c.brightest),
        )?;
        let q = &self.quaternions;
        line(
            f,
            "quaternions",
            format!(
                "length {} to {}, {} far from unit",
                rounded(q.min),
                rounded(q.max),
                grouped(q.far_from_unit)
            ),
        )?;
        let o = &self.opacity;
        line(
            f,
            "opacity",
            format!(
                "{} below 1/255 ({:.2} %), {} above 0.99 ({:.2} %)",
                grouped(o.below_floor),
                percent(o.below_floor),
                grouped(o.above_cap),
                percent(o.above_cap)
            ),
        )?;
        let s = &self.size;
        line(
            f,
            "size",
            format!(
                "median {:.*}, largest {:.*}; {} above half the robust extent of {:.*}",
                decimals(s.median.into(), 3).max(4),
                s.median,
                decimals(s.largest.into(), 3),
                s.largest,
                grouped(s.oversized),
                decimals(s.robust_extent, 3),
                s.robust_extent
            ),
        )?;
        let p = &self.place;
        if p.offset != [0.0; 3] {
            let [x, y, z] = p.offset;
            line(f, "origin", format!("({x}, {y}, {z}), subtracted from positions and cameras"))?;
        }
        line(f, "box", p.bounds.to_string())?;
        line(f, "box, 1 to 99 %", p.robust_bounds.to_string())?;
        let ([x, y, z], d) = (p.center, p.bounds.decimals());
        line(f, "centre", format!("({x:.d$}, {y:.d$}, {z:.d$})"))?;
        line(f, "outliers", format!("{} beyond ten times that box", grouped(p.outliers)))?;
        for (file, coarse) in &p.coarse_parts {
            line(f, "positions", format!("{file}: {coarse}"))?;
        }
        if let Some(coarse) = p.coarse.filter(|_| p.coarse_parts.is_empty()) {
            line(f, "positions", coarse.to_string())?;
        }
        if let Some(steps) = &p.steps {
            line(f, "positions", steps.to_string())?;
        }
        for depth in &self.depth {
            let text = match &depth.range {
                None => format!("no splat beyond the near plane, at {} units", NEAR as f32),
                Some(r) => format!(
                    "{:.3} to {:.3} (1 to 99 %: {:.3} to {:.3}); lost to outliers: {:.1} bits of a linear key, {:.1} of a \
                     logarithmic one",
                    r.near, r.far, r.robust_near, r.robust_far, r.linear_bits_lost, r.logarithmic_bits_lost
                ),
            };
            line(f, "depth", format!("{}: {text}", depth.camera))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::projection::Projection;
    use crate::scene::Splat;
    use crate::testing::splat;

    fn camera() -> Camera {
        Camera::looking_at([0.0; 3], [0.0, 0.0, 1.0], 60.0, (64, 64))
    }

    #[test]
    fn flaws_are_counted() {
        let scene = Scene::generate(1000, 3, |i| {
            let mut s = splat(i);
            s.opacity = 0.5;
            match i {
                0 => s.position = [1e6, 0.0, 3.0],
                1..=3 => s.scale[1] = 50.0,
                4..=6 => s.opacity = 0.001,
                7..=10 => s.opacity = 0.995,
                11 => s.rotation = [2.0, 0.0, 0.0, 0.0],
                12 => s.position[1] = f32::NAN,
                13 => s.position = [0.0, 0.0, 4096.0],
                _ => {}
            }
            s
        });
        let report = Report::new(&scene, &[camera()]);
        assert_eq!((report.splats, report.dropped.position, report.dropped.total()), (999, 1, 1));
        assert_eq!((report.quaternions.far_from_unit, report.quaternions.max), (1, 2.0));
        assert_eq!((report.opacity.below_floor, report.opacity.above_cap), (3, 4));
        assert_eq!((report.size.oversized, report.size.largest), (3, 50.0));
        assert_eq!((report.place.outliers, report.place.bounds.max[0]), (2, 1e6));
        assert!(report.size.robust_extent < 2.1);
        let range = report.depth[0].range.unwrap();
        assert_eq!((report.depth[0].in_front, range.far), (999, 4096.0));
        assert!((10.0..12.0).contains(&range.linear_bits_lost), "{range:?}");
        assert!((2.0..4.0).contains(&range.logarithmic_bits_lost), "{range:?}");
    }

    #[test]
    fn a_report_is_text_and_json() {
        let scene = Scene::generate(100, 2, splat);
        let report = Report::new(&scene, &[]);
        let text = report.to_string();
        for word in ["100 splats", "none", "degree 2 stored, 2 in use", "depth                 framing: "] {
            assert!(text.contains(word), "{word} in\n{text}");
        }
        assert!(!text.contains("beyond half floats"));
        let json = serde_json::to_value(&report).unwrap();
        assert_eq!(json["dropped"]["zero_rotation"], 0);
        assert!(json["depth"][0]["range"]["near"].is_f64());
    }

    #[test]
    fn places_are_the_worlds() {
        let near = Scene::generate(100, 0, splat);
        let (local, offset) = (near.bounds(), [499_712.0, 4_999_168.0, 0.0]);
        let report = Report::new(&near.with_offset(offset), &[]);
        assert_eq!(report.place.bounds.max[1], 4_999_168.0 + f64::from(local.max[1]));
        let text = report.to_string();
        for line in ["box                   (499711.0", "centre                (49971"] {
            assert!(text.contains(line), "{line} in\n{text}");
        }
    }

    #[test]
    fn colours_that_half_floats_do_not_hold_are_told() {
        let scene = Scene::generate(10, 1, |i| {
            let mut s = splat(i);
            s.sh = [0.0; 48];
            s.sh[7] = if i == 3 { -2e5 } else { 0.0 };
            s
        });
        let report = Report::new(&scene, &[]);
        assert_eq!(report.color.largest_sh, 2e5);
        // The square root of 3 / (4 pi), times the absolute value of the coefficient, plus 0.5.
        assert!((report.color.brightest - 97_721.0).abs() < 0.1, "{:?}", report.color);
        let text = report.to_string();
        let told = text
            .lines()
            .find(|line| line.contains("coefficients up to 200000.000, brightness up to 97721.0"));
        assert!(told.is_some_and(|line| line.ends_with(", beyond half floats")), "{report}");
    }

    #[test]
    fn a_scene_behind_the_camera_has_no_depth_range() {
        let scene = Scene::generate(10, 0, |i| {
            let mut s = splat(i);
            s.position[2] = -1.0;
            s
        });
        let report = Report::new(&scene, &[camera()]);
        assert_eq!((report.depth[0].in_front, report.depth[0].range), (0, None));
        assert!(report.to_string().contains("no splat beyond the near plane, at 0.2 units"));
    }

    #[test]
    fn depths_are_what_splats_are_sorted_by() {
        // Splats at 5 units from the camera: before, beside and behind it.
        let at = [[0.0, 3.0, 4.0], [5.0, 0.0, 0.0], [0.0, -3.0, -4.0]];
        let found = |key_of: SortKey, projection: Projection| {
            let scene = Scene::generate(3, 0, |i| Splat { position: at[i], ..splat(i) });
            let scene = scene.with_notes(FileNotes { key_of, ..FileNotes::default() });
            let depth = Report::new(&scene, &[Camera { projection, ..camera() }]).depth.remove(0);
            (depth.in_front, depth.range.map(|range| (range.near, range.far)))
        };
        assert_eq!(found(SortKey::Depth, Projection::Pinhole), (1, Some((4.0, 4.0))));
        assert_eq!(found(SortKey::Distance, Projection::Pinhole), (1, Some((5.0, 5.0))));
        assert_eq!(found(SortKey::Distance, Projection::Orthographic), (1, Some((4.0, 4.0))));
        assert_eq!(found(SortKey::Depth, Projection::Equirectangular), (3, Some((5.0, 5.0))));
    }
}
