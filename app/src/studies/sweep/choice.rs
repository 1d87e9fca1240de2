//! Chooses the splats of a scene that are drawn when there are too many.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use splatgraph_assets::{Camera, Scene};
use splatgraph_framework::ir::{Domain, Value};
use splatgraph_framework::lower::Control;
use splatgraph_reference::{Rules, project};

/// A criterion by which the drawn splats are chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Choice {
    /// The first splats of the file, a naive truncation.
    FileOrder,
    /// The splats with the largest product of opacity and area in the world; the same for every camera.
    WorldSize,
    /// The splats with the largest product of opacity and area on the screen, in the exact renderer's projection.
    ScreenSize,
    /// The nearest visible splats, cut after the sort: the graph's parameter `budget`.
    Nearest,
}

/// Name of the graph parameter for the share of visible splats to draw.
pub const BUDGET: &str = "budget";

impl Choice {
    /// Every criterion, in the order of tables and plots.
    pub const ALL: [Choice; 4] = [Choice::FileOrder, Choice::WorldSize, Choice::ScreenSize, Choice::Nearest];

    /// Returns the name in tables and plots.
    pub fn name(self) -> &'static str {
        match self {
            Choice::FileOrder => "file order",
            Choice::WorldSize => "opacity x world size",
            Choice::ScreenSize => "opacity x screen size",
            Choice::Nearest => "nearest, after the sort",
        }
    }

    /// Returns the name in files and in file names.
    pub fn stem(self) -> &'static str {
        match self {
            Choice::FileOrder => "file_order",
            Choice::WorldSize => "world_size",
            Choice::ScreenSize => "screen_size",
            Choice::Nearest => "nearest",
        }
    }
}

/// Lists the parameters that [`Choice::Nearest`] sets besides [`BUDGET`]; `None` if the graph has no budget.
///
/// A graph with the parameter `sorted` must sort splats, not pairs of a splat and a bin, to know the nearest splats.
pub fn for_nearest(controls: &[Control]) -> Option<Vec<(String, String)>> {
    let param = |name: &str| controls.iter().map(|control| &control.param).find(|param| param.name == name);
    param(BUDGET)?;
    let by_splats = |names: &[String]| names.iter().any(|name| name == BY_SPLATS);
    let sorted = param(SORTED).filter(|param| {
        matches!(&param.domain, Domain::Choice(names) if by_splats(names))
            && param.value != Value::Text(BY_SPLATS.into())
    });
    Some(sorted.map(|_| (SORTED.to_owned(), BY_SPLATS.to_owned())).into_iter().collect())
}

const SORTED: &str = "sorted";
const BY_SPLATS: &str = "splats";

/// Lists the splats by decreasing significance, equal ones by index; `None` for [`Choice::Nearest`], which the graph
/// itself applies.
pub fn ranking(scene: &Scene, camera: &Camera, choice: Choice) -> Option<Vec<u32>> {
    if choice == Choice::Nearest {
        return None;
    }
    let rules = Rules::of_view(scene, camera);
    let weight = |index: usize| match choice {
        Choice::FileOrder | Choice::Nearest => 0.0,
        Choice::WorldSize => f64::from(scene.opacities()[index]) * world_area(scene, index),
        // The area is divided by pi, like that in the world.
        Choice::ScreenSize => project(scene, index as u32, camera, &rules)
            .map_or(0.0, |splat| splat.opacity * splat.determinant.sqrt()),
    };
    let mut all: Vec<(f64, u32)> =
        (0..scene.count() as usize).into_par_iter().map(|index| (weight(index), index as u32)).collect();
    all.par_sort_by(|a, b| b.0.total_cmp(&a.0));
    Some(all.into_iter().map(|(_, index)| index).collect())
}

/// Returns the product of a splat's two longest semi-axes: its largest projected area, divided by pi.
pub fn world_area(scene: &Scene, index: usize) -> f64 {
    let [a, b, c] = scene.scales()[index].map(f64::from);
    (a * b).max(b * c).max(a * c)
}

#[cfg(test)]
mod tests {
    use super::*;
    use splatgraph_assets::{Projection, Splat};

    /// Returns splats on the axis of a camera, with their indices as coefficients; and the camera.
    fn scene() -> (Scene, Camera) {
        let at = [(2.0, 0.1, 0.9), (10.0, 0.2, 0.9), (-5.0, 9.0, 0.9), (3.0, 0.01, 0.9), (2.0, 0.1, 0.5)];
        let splat = |i: usize| {
            let (z, deviation, opacity) = at[i];
            Splat {
                position: [0.0, 0.0, z],
                scale: [deviation; 3],
                rotation: [1.0, 0.0, 0.0, 0.0],
                opacity,
                sh: [i as f32; 48],
            }
        };
        let camera = Camera::looking_at([0.0; 3], [0.0, 0.0, 1.0], 60.0, (64, 48));
        (Scene::generate(5, 1, splat), camera)
    }

    #[test]
    fn each_choice_ranks_by_its_own_measure() {
        let (scene, camera) = scene();
        let order = |choice| ranking(&scene, &camera, choice);
        assert_eq!(order(Choice::FileOrder), Some(vec![0, 1, 2, 3, 4]));
        // The large splat behind the camera is first by world size, and last by screen size.
        assert_eq!(order(Choice::WorldSize), Some(vec![2, 1, 0, 4, 3]));
        assert_eq!(order(Choice::ScreenSize), Some(vec![0, 4, 1, 3, 2]));
        assert_eq!(order(Choice::Nearest), None);
        // An orthographic view shows near and far splats at one size, and a panorama those behind the camera.
        let in_lens =
            |projection| ranking(&scene, &camera.with_projection(projection, [2.0; 3]), Choice::ScreenSize);
        assert_eq!(in_lens(Projection::Orthographic), Some(vec![1, 0, 4, 3, 2]));
        assert_eq!(in_lens(Projection::Equirectangular), Some(vec![2, 0, 4, 1, 3]));
    }

    #[test]
    fn the_nearest_splats_are_known_where_splats_are_sorted() {
        let presets = crate::draw::builtin::presets();
        let needs = |name: &str| {
            for_nearest(&presets.iter().find(|preset| preset.name == name).expect("built in").params)
        };
        for tiles in ["tiled", "tiled_exact"] {
            assert_eq!(needs(tiles), Some(vec![("sorted".to_owned(), "splats".to_owned())]), "{tiles}");
        }
        assert_eq!(needs("splat"), Some(Vec::new()));
        assert_eq!(for_nearest(&[]), None);
    }

    #[test]
    fn splats_beside_the_picture_are_the_last_to_be_chosen() {
        let (scene, mut camera) = scene();
        camera.position[0] = 100.0;
        assert_eq!(ranking(&scene, &camera, Choice::ScreenSize), Some(vec![0, 1, 2, 3, 4]));
    }
}
