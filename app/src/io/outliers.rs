//! Finds the few splats, far from all others, that make the steps of positions in packed formats coarse.

use splatgraph_assets::{Bounds, Scene, SceneFormat, WorldBounds};

/// Sizes of the boxes to try, relative to the box of most splats ([`Scene::robust_bounds`]). The largest one that helps
/// keeps the most splats.
const FACTORS: [f64; 4] = [10.0, 5.0, 3.0, 2.0];

/// Largest share of the splats that are called outliers: one in this number.
const SHARE: usize = 20;

/// Splats far from the others.
#[derive(Debug, PartialEq)]
pub struct Outliers {
    pub count: u64,
    /// The option of `convert` that drops them.
    pub crop: String,
}

/// Finds the splats without which at most 1/100 of the others are smaller than the steps of their positions. `None` if
/// no box helps, or only one that drops more than a few splats.
pub fn find(scene: &Scene, format: SceneFormat) -> Option<Outliers> {
    FACTORS.iter().find_map(|factor| outside(scene, format, &scene.robust_bounds().grown(*factor)))
}

/// Finds the splats outside of a box; `None` if leaving them out does not help.
fn outside(scene: &Scene, format: SceneFormat, bounds: &Bounds) -> Option<Outliers> {
    let corners = rounded(&bounds.in_world(scene.offset()))?;
    let [min, max] =
        corners.each_ref().map(|corner| corner.each_ref().map(|text| text.parse().unwrap_or(f64::NAN)));
    let is_inside = |index: &u32| {
        let position = scene.world_position(*index as usize);
        (0..3).all(|axis| (min[axis]..=max[axis]).contains(&position[axis]))
    };
    let kept: Vec<u32> = (0..scene.count()).filter(is_inside).collect();
    let dropped = scene.count() as usize - kept.len();
    if dropped == 0 || SHARE * dropped > scene.count() as usize {
        return None;
    }
    let helps = scene.picked(&kept).ok()?.large_steps(format).is_none();
    let [from, to] = corners.map(|corner| corner.join(","));
    helps.then(|| Outliers { count: dropped as u64, crop: format!("--crop box:{from},{to}") })
}

/// Formats the corners of a box, enlarged to few digits; `None` for a box without an extent.
fn rounded(bounds: &WorldBounds) -> Option<[[String; 3]; 2]> {
    let extent = (0..3).map(|axis| bounds.max[axis] - bounds.min[axis]).fold(0.0, f64::max);
    if !extent.is_normal() {
        return None;
    }
    let decimals = (1 - extent.log10().floor() as i32).clamp(0, 12);
    let steps = 10f64.powi(decimals);
    // `+ 0.0` avoids "-0".
    let text = |value: f64| format!("{:.*}", decimals as usize, value / steps + 0.0);
    Some([bounds.min.map(|v| text((v * steps).floor())), bounds.max.map(|v| text((v * steps).ceil()))])
}

#[cfg(test)]
mod tests {
    use super::*;
    use splatgraph_assets::Splat;

    #[test]
    fn a_few_splats_far_from_the_others_are_counted_with_the_crop_that_drops_them() {
        let scene = |far: usize, offset: f64| {
            let splat = |index: usize| {
                let at = |k: usize| (index * k % 1000) as f32 * 1e-3;
                let away = if index < far { 1e4 * (1 + index) as f32 } else { 0.0 };
                let position = [at(7) + away, at(13) - away, at(29)];
                Splat {
                    position,
                    scale: [0.01; 3],
                    rotation: [1.0, 0.0, 0.0, 0.0],
                    opacity: 0.5,
                    sh: [0.0; 48],
                }
            };
            Scene::generate(3000, 0, splat).with_offset([offset, 0.0, 0.0])
        };
        let found = |far, offset| {
            find(&scene(far, offset), SceneFormat::Sog).map(|Outliers { count, crop }| (count, crop))
        };
        assert_eq!(found(3, 0.0), Some((3, "--crop box:-4.5,-4.5,-4.4,5.5,5.4,5.4".into())));
        assert_eq!(found(1, 5e5), Some((1, "--crop box:499995.5,-4.4,-4.4,500005.5,5.4,5.4".into())));
        assert_eq!(found(0, 0.0), None);
        assert_eq!(found(200, 0.0), None, "too many to be outliers");
    }
}
