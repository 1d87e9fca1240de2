//! Derives scenes from others: selects, orders, transforms and joins splats.

use crate::activation::quantised;
use crate::bounds::{Bounds, largest};
use crate::camera::Camera;
use crate::harmonics::Turn;
use crate::memory::SceneMemoryError;
use crate::mesh::Mesh;
use crate::projection::Projection;
use crate::scene::{Dropped, FileNotes, Properties, Scene, Splat};
use crate::similarity::Similarity;
use glam::{DMat3, DQuat, DVec3};
use rayon::prelude::*;

/// Size of the box outside of which splats are outliers, relative to [`Scene::robust_bounds`].
const INNER: f64 = 5.0;

/// Spreads the lowest 21 bits of a number, with two zero bits between neighbours.
fn spread(value: u32) -> u64 {
    (0..21).fold(0u64, |code, bit| code | (u64::from(value) >> bit & 1) << (3 * bit))
}

/// Snaps a unit vector to an axis that it equals up to rounding, so that tags have whole numbers.
fn on_axis(direction: DVec3) -> DVec3 {
    const ROUNDING: f64 = 1e-12;
    let axis = DVec3::from(direction.to_array().map(|v| v.round() + 0.0));
    if axis.distance(direction) < ROUNDING { axis } else { direction }
}

impl Camera {
    /// Transforms the camera in world coordinates, so that it sees a transformed scene as it saw the scene before.
    ///
    /// Check the result with [`Camera::fault`]: a large transform may move it out of range.
    #[must_use]
    pub fn transformed(&self, by: &Similarity) -> Self {
        let mut moved = self.clone();
        moved.position = by.point(self.position.into()).into();
        // The matrices of glam have columns, and the camera's rotation rows.
        let axes = DMat3::from_cols_array_2d(&self.rotation).transpose();
        moved.rotation = (DMat3::from_quat(by.rotation) * axes).transpose().to_cols_array_2d();
        if self.projection == Projection::Orthographic {
            // The focal lengths are in pixels per unit.
            (moved.fx, moved.fy) = (self.fx / by.scale, self.fy / by.scale);
        }
        moved
    }
}

impl Scene {
    /// Copies the splats with these indices, in this order.
    ///
    /// # Errors
    /// The copy does not fit in memory.
    ///
    /// # Panics
    /// Panics if an index is not below [`Scene::count`].
    pub fn picked(&self, indices: &[u32]) -> Result<Self, SceneMemoryError> {
        self.picked_as(indices, |_, splat| splat)
    }

    /// Copies splats like [`Scene::picked`], with the sizes, comments and losses of the file that they are from.
    ///
    /// # Errors
    /// The copy does not fit in memory.
    ///
    /// # Panics
    /// Panics if an index is not below [`Scene::count`].
    pub fn selected(&self, indices: &[u32]) -> Result<Self, SceneMemoryError> {
        Ok(self.picked(indices)?.with_file_of(self))
    }

    /// Copies splats like [`Scene::picked`], and changes each with `change`.
    ///
    /// `change` gets each splat with its index in this scene. It must not change the position, and must keep the
    /// quaternion at unit length.
    ///
    /// # Errors
    /// The copy does not fit in memory.
    ///
    /// # Panics
    /// Panics if an index is not below [`Scene::count`].
    pub fn picked_as(
        &self,
        indices: &[u32],
        change: impl Fn(u32, Splat) -> Splat + Sync,
    ) -> Result<Self, SceneMemoryError> {
        let source = |at: usize| indices[at] as usize;
        self.derived(indices.len() as u32, self.stored_degree(), source, |at| {
            (change(indices[at], self.splat(source(at))), self.position(source(at)))
        })
    }

    /// Returns true for a splat far from most others.
    pub(crate) fn is_outlier(&self, index: u32) -> bool {
        !self.robust_bounds().grown(INNER).contains(self.positions()[index as usize])
    }

    /// Sorts the splats along a Morton curve, 21 bits per axis of their box, and returns their indices.
    ///
    /// Outliers come last, along a curve of their own: in one box with them, the other splats would differ in few bits
    /// of an axis, and neighbours along the curve would be far from each other.
    ///
    /// Each axis has its own scale. With one scale for all, the SOG files of long scenes are up to 2 % larger, and some
    /// compressed PLY files are more accurate, others less.
    pub fn morton_order(&self) -> Vec<u32> {
        let (all, mut inner) = (self.bounds(), Bounds::EMPTY);
        let is_inner = |index: &u32| !self.is_outlier(*index);
        (0..self.count()).filter(is_inner).for_each(|index| inner.add(self.positions()[index as usize]));
        let code = |index: u32| {
            let is_outlier = self.is_outlier(index);
            let position = self.positions()[index as usize];
            let bounds = if is_outlier { &all } else { &inner };
            (0..3).fold(u64::from(is_outlier) << 63, |code, axis| {
                let (min, max) = (f64::from(bounds.min[axis]), f64::from(bounds.max[axis]));
                let part = if max > min { (f64::from(position[axis]) - min) / (max - min) } else { 0.0 };
                code | spread(quantised(part, (1 << 21) - 1)) << axis
            })
        };
        let mut order: Vec<(u64, u32)> =
            (0..self.count()).into_par_iter().map(|index| (code(index), index)).collect();
        order.par_sort_unstable();
        order.into_iter().map(|(_, index)| index).collect()
    }

    /// Transforms the scene in world coordinates: splats with their harmonics, mesh, light and up direction.
    ///
    /// Splats whose transformed position or scale is beyond the range of f32 are dropped and counted, in addition to
    /// the scene's own [`Scene::dropped`]. The result has an offset or wide positions only if it needs them.
    ///
    /// # Errors
    /// The copy does not fit in memory.
    pub fn transformed(&self, by: &Similarity) -> Result<Self, SceneMemoryError> {
        let turn = Turn::new(by.rotation);
        let degree = self.stored_degree();
        let size = |index: usize| by.scale * f64::from(largest(self.scales()[index]));
        let world = |index| by.point(DVec3::from(self.world_position(index)));
        let is_offset = self.offset() != [0.0; 3];
        let (offset, wide) = if !is_offset && !self.is_wide() {
            let origin = Self::finer_origin(self.count(), DVec3::ZERO, world, size);
            (origin.unwrap_or_default(), origin.is_some())
        } else if Self::fits_floats(self.count(), world, size) {
            (DVec3::ZERO, false)
        } else {
            // The offset moves with the scene, so that positions relative to it keep their precision in f32.
            let offset = if is_offset { by.point(self.offset().into()) } else { DVec3::ZERO };
            let origin = Self::finer_origin(self.count(), offset, world, size);
            (origin.unwrap_or(offset), self.is_wide() || origin.is_some())
        };
        let names = self.property_names().to_vec();
        let properties = Properties { names, value: &|index, name| self.property(index, name) };
        let moved = Self::try_generate_with(self.count(), degree, wide, properties, |index| {
            let mut splat = self.splat(index);
            let [w, x, y, z] = splat.rotation.map(f64::from);
            let turned = (by.rotation * DQuat::from_xyzw(x, y, z, w)).normalize();
            splat.rotation = [turned.w, turned.x, turned.y, turned.z].map(|c| c as f32);
            splat.scale = splat.scale.map(|scale| (f64::from(scale) * by.scale) as f32);
            turn.apply(&mut splat.sh, degree);
            (splat, (world(index) - offset).into())
        })?;
        let up = self.notes().up.map(|up| on_axis(by.rotation * DVec3::from(up)).into());
        let mesh = self.mesh().map(|mesh| mesh.transformed(by, self.offset(), offset.into()).into());
        let notes = FileNotes { up, ..self.notes() };
        let dropped = self.dropped().plus(moved.dropped());
        let moved = moved.with_offset(offset.into()).with_notes(notes).with_mesh(mesh).with_dropped(dropped);
        Ok(moved.with_header_comments(self.header_comments().to_vec()))
    }

    /// Joins scenes, one after the other, and their meshes. The result's offset is the first scene's, unless that is
    /// too far from the splats.
    ///
    /// Harmonics and further properties that a scene lacks are 0. Tags that differ are dropped, and so are comments. The light is that of the
    /// first mesh with a light. Counts of dropped splats are summed.
    ///
    /// # Errors
    /// The copy does not fit in memory, or there are 2^32 splats or more.
    ///
    /// # Panics
    /// Panics if `scenes` is empty.
    pub fn joined(scenes: &[Self]) -> Result<Self, SceneMemoryError> {
        let degree = scenes.iter().map(Self::stored_degree).max().unwrap_or(0);
        let total: u64 = scenes.iter().map(|scene| u64::from(scene.count())).sum();
        let count = u32::try_from(total).map_err(|_| SceneMemoryError {
            count: total,
            degree,
            needed: Self::host_bytes(total, degree),
            available: None,
        })?;
        let mut first = 0;
        let mut firsts = Vec::with_capacity(scenes.len());
        for scene in scenes {
            firsts.push(first);
            first += scene.count() as usize;
        }
        let place = |index| {
            let at = firsts.partition_point(|first| *first <= index) - 1;
            (&scenes[at], index - firsts[at])
        };
        let world = |index| {
            let (scene, local) = place(index);
            DVec3::from(scene.world_position(local))
        };
        let size = |index| {
            let (scene, local) = place(index);
            largest(scene.scales()[local]).into()
        };
        let offset = DVec3::from(scenes[0].offset());
        let offset = Self::finer_origin(count, offset, world, size).unwrap_or(offset);
        let mut names: Vec<String> = Vec::new();
        for name in scenes.iter().flat_map(Self::property_names) {
            if !names.contains(name) {
                names.push(name.clone());
            }
        }
        let value = |index, name: usize| {
            let (scene, local) = place(index);
            let own = scene.property_names().iter().position(|own| *own == names[name]);
            own.map_or(0.0, |own| scene.property(local, own))
        };
        let properties = Properties { names: names.clone(), value: &value };
        let joined = Self::try_generate_with(count, degree, true, properties, |index| {
            let (scene, local) = place(index);
            (scene.splat(local), (world(index) - offset).into())
        })?;
        let offset = offset.into();
        let notes = scenes.iter().map(Self::notes).reduce(FileNotes::common).unwrap_or_default();
        let mut mesh = Mesh::default();
        for scene in scenes {
            let here = |own: &Mesh| own.transformed(&Similarity::IDENTITY, scene.offset(), offset);
            scene.mesh().map(here).iter().for_each(|own| mesh.append(own));
        }
        let mesh = (!mesh.triangles.is_empty()).then(|| mesh.into());
        let dropped = scenes.iter().map(Self::dropped).fold(*joined.dropped(), Dropped::plus);
        Ok(joined.with_offset(offset).with_notes(notes).with_mesh(mesh).with_dropped(dropped))
    }

    /// Joins the scenes of one file. A single scene is returned as it is, without a copy.
    pub(crate) fn of_one_file(mut scenes: Vec<Self>) -> Result<Self, SceneMemoryError> {
        match scenes.len() {
            1 => Ok(scenes.remove(0)),
            _ => Self::joined(&scenes),
        }
    }

    /// Adds a mesh, relative to its own origin before `by` transforms it in the world, to the scene's mesh.
    pub fn beside(self, mesh: &Mesh, by: &Similarity) -> Self {
        let mut all = self.mesh().cloned().unwrap_or_default();
        all.append(&mesh.transformed(by, mesh.origin, self.offset()));
        self.with_mesh(Some(all.into()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::harmonics::basis;
    use crate::scene::{Filter, SortKey};
    use crate::scene_format::SceneFormat;
    use crate::testing::{parse, splat, written};
    use std::f64::consts::TAU;

    fn color(sh: &[f32; 48], direction: DVec3) -> [f64; 3] {
        let values = basis(direction.into());
        std::array::from_fn(|c| values.iter().enumerate().map(|(k, y)| y * f64::from(sh[3 * k + c])).sum())
    }

    #[test]
    fn a_moved_splat_looks_from_the_moved_side_as_it_did_before() {
        let scene = Scene::generate(20, 3, |index| {
            let mut s = splat(index);
            s.sh = std::array::from_fn(|k| ((k * 7 + index) as f32).sin());
            s
        });
        let turn = DQuat::from_axis_angle(DVec3::new(0.6, -0.48, 0.64), 1.1);
        let by = Similarity { rotation: turn, scale: 2.5, translation: DVec3::new(1.0, -2.0, 3.0) };
        let moved = scene.transformed(&by).unwrap();
        for index in 0..20 {
            let (a, b) = (scene.splat(index), moved.splat(index));
            let expected = turn * DVec3::from(a.position.map(f64::from)) * 2.5 + by.translation;
            assert!(DVec3::from(b.position.map(f64::from)).distance(expected) < 1e-5);
            assert!((0..3).all(|axis| (b.scale[axis] - 2.5 * a.scale[axis]).abs() < 1e-6));
            let quaternion =
                |[w, x, y, z]: [f32; 4]| DQuat::from_xyzw(x.into(), y.into(), z.into(), w.into());
            let (axis, moved_axis) = (quaternion(a.rotation) * DVec3::X, quaternion(b.rotation) * DVec3::X);
            assert!((turn * axis).distance(moved_axis) < 1e-5);
            for direction in [DVec3::new(0.36, 0.48, 0.8), DVec3::NEG_Y, DVec3::new(-0.6, 0.64, -0.48)] {
                let (before, after) = (color(&a.sh, direction), color(&b.sh, turn * direction));
                assert!((0..3).all(|c| (before[c] - after[c]).abs() < 1e-5), "{before:?} and {after:?}");
            }
        }
    }

    #[test]
    fn a_moved_camera_sees_a_moved_scene_as_before_also_far_from_the_origin() {
        let eye = DVec3::new(4e5, 5.5e6, 120.0);
        let at = |x, y, z| eye + DVec3::new(x, y, z);
        let up = [0.0, 0.1, 1.0];
        let camera = Camera::looking_at_upright(eye.into(), at(3.0, -2.0, 1.0).into(), up, 70.0, (64, 48));
        let turn = DQuat::from_axis_angle(DVec3::new(0.6, -0.48, 0.64), 1.1);
        let by = Similarity { rotation: turn, scale: 2.5, translation: DVec3::new(1.0, -2.0, 3e5) };
        let moved = camera.transformed(&by);
        for point in [at(5.0, 0.0, 1.0), at(-1.0, 2.0, 0.5), at(0.0, -3.0, -7.0)] {
            let before = DVec3::from(camera.to_view(point.into()));
            let after = DVec3::from(moved.to_view(by.point(point).into()));
            assert!(after.distance(2.5 * before) < 1e-7, "{before} and {after}");
        }
        assert_eq!((moved.fx, moved.fy), (camera.fx, camera.fy));
        let flat = Camera { projection: Projection::Orthographic, ..camera };
        let flat_moved = flat.transformed(&by);
        assert_eq!((flat_moved.fx, flat_moved.fy), (flat.fx / 2.5, flat.fy / 2.5));
    }

    #[test]
    fn similarities_follow_one_another() {
        let a = Similarity { scale: 2.0, ..Similarity::IDENTITY };
        let b = Similarity { translation: DVec3::X, ..Similarity::IDENTITY };
        let c = Similarity { rotation: DQuat::from_rotation_z(TAU / 4.0), ..Similarity::IDENTITY };
        let all = a.then(b).then(c);
        assert!(all.point(DVec3::X).distance(DVec3::new(0.0, 3.0, 0.0)) < 1e-12);
    }

    #[test]
    fn a_quarter_turn_turns_one_axis_up_into_another() {
        let y_up = FileNotes { up: Some([0.0, -1.0, 0.0]), ..FileNotes::default() };
        let scene = Scene::generate(3, 0, splat).with_notes(y_up);
        let up = |axis: DVec3, degrees: f64| {
            let rotation = DQuat::from_axis_angle(axis, degrees.to_radians());
            let by = Similarity { rotation, ..Similarity::IDENTITY };
            scene.transformed(&by).unwrap().notes().up.unwrap()
        };
        assert_eq!(up(DVec3::Z, 90.0), [1.0, 0.0, 0.0]);
        assert_eq!(up(DVec3::X, 90.0), [0.0, 0.0, -1.0]);
        assert_eq!(up(DVec3::X, 450.0), [0.0, 0.0, -1.0]);
        assert!((up(DVec3::X, 60.0)[1] + 0.5).abs() < 1e-12);
    }

    #[test]
    fn a_narrow_scene_stays_narrow_unless_it_is_moved_far() {
        let small = |index| Splat { scale: [1e-6; 3], ..splat(index) };
        let scene = Scene::generate(300, 0, small);
        let is_wide = |scene: &Scene, by: Similarity| scene.transformed(&by).unwrap().is_wide();
        let rotation = DQuat::from_axis_angle(DVec3::new(0.6, -0.48, 0.64), 50f64.to_radians());
        assert!(!is_wide(&scene, Similarity { rotation, ..Similarity::IDENTITY }));
        assert!(!is_wide(&scene, Similarity { scale: 3.0, ..Similarity::IDENTITY }));
        assert!(!is_wide(&scene, Similarity { translation: DVec3::X, ..Similarity::IDENTITY }));
        let far = Similarity { translation: DVec3::X * 1000.0, ..Similarity::IDENTITY };
        assert!(is_wide(&scene, far));
        assert!(is_wide(&scene, Similarity { scale: 0.001, translation: DVec3::X, ..far }));
        let surveyed = scene.with_offset([2e6, 0.0, 0.0]);
        let moved = surveyed.transformed(&far).unwrap();
        assert!(!moved.is_wide() && moved.offset() == [2_001_000.0, 0.0, 0.0]);
    }

    #[test]
    fn a_scene_that_is_moved_far_or_joined_to_one_has_the_offset_that_its_file_of_doubles_gets() {
        let scene = Scene::generate(300, 0, splat);
        let by = Similarity { translation: DVec3::new(5e5, 5e6, 300.0), ..Similarity::IDENTITY };
        let moved = scene.transformed(&by).unwrap();
        assert_eq!(moved.offset(), [499_712.0, 5_000_192.0, 0.0]);
        let reread = parse(&written(&moved, SceneFormat::Ply)).unwrap();
        assert_eq!((reread.offset(), reread.positions()), (moved.offset(), moved.positions()));
        let few = Scene::generate(9, 0, splat);
        let joined = Scene::joined(&[few, moved]).unwrap();
        assert_eq!(joined.offset(), reread.offset());
        assert_eq!(joined.positions()[9..], *reread.positions());
        assert!(reread.position_rounding(SceneFormat::Gltf) < 3e-5);
        // Moved back, floats suffice again.
        let by = Similarity { translation: -by.translation, ..by };
        let home = reread.transformed(&by).unwrap();
        assert!(home.offset() == [0.0; 3] && !home.is_wide());
        let header = String::from_utf8_lossy(&written(&home, SceneFormat::Ply)[..200]).into_owned();
        assert!(header.contains("property float x"), "{header}");
        // Few splats far away keep their doubles.
        let joined = Scene::joined(&[home, reread.picked(&[0, 1, 2, 3]).unwrap()]).unwrap();
        let beside = Similarity { translation: DVec3::Y, ..Similarity::IDENTITY };
        let moved = joined.transformed(&beside).unwrap();
        let distance = |index| {
            let at = |scene: &Scene| DVec3::from(scene.world_position(index));
            (at(&moved) - at(&joined) - DVec3::Y).abs().max_element()
        };
        assert!((300..304).map(distance).all(|distance| distance < 1e-6));
        // Near the first scene, its offset stays.
        let beside = Scene::joined(&[reread.picked(&[0, 1]).unwrap(), reread]).unwrap();
        assert_eq!(beside.offset(), [499_712.0, 5_000_192.0, 0.0]);
    }

    #[test]
    fn moves_of_a_narrow_scene_do_not_add_up_to_a_coarse_one() {
        let small = |index| Splat { scale: [0.05; 3], ..splat(index) };
        let scene = Scene::generate(300, 0, small);
        let step = |scene: Scene, x: f64| {
            scene.transformed(&Similarity { translation: DVec3::X * x, ..Similarity::IDENTITY }).unwrap()
        };
        let moved = [30.0, 400.0, 6000.0, 70_000.0].into_iter().fold(step(scene, 0.0), step);
        for index in 0..300 {
            let error = moved.world_position(index)[0] - 76_430.0 - f64::from(splat(index).position[0]);
            assert!(error.abs() < 0.05 / 64.0, "{error}");
        }
    }

    #[test]
    fn tags_in_which_joined_scenes_differ_are_reset_and_named() {
        let with = |notes: FileNotes| Scene::generate(2, 0, splat).with_notes(notes);
        let up = Some([0.0, 0.0, 1.0]);
        let tagged = FileNotes { low_pass: Filter::Compensated, up, ..FileNotes::default() };
        let distance = FileNotes { key_of: SortKey::Distance, ..FileNotes::default() };
        let joined = |all: &[FileNotes]| {
            let scenes: Vec<Scene> = all.iter().map(|notes| with(*notes)).collect();
            Scene::joined(&scenes).unwrap().notes()
        };
        assert_eq!(joined(&[tagged, tagged]), tagged);
        let none = FileNotes::default();
        // Tags that the first two scenes have mixed stay mixed, whether later values equal the default or the first's.
        let mixed = joined(&[tagged, none, none, tagged]);
        assert_eq!((mixed.tags(), mixed.mixed_tags()), (vec![], Some("low_pass, up".to_owned())));
        assert_eq!(joined(&[mixed, distance]).mixed_tags(), Some("low_pass, key_of, up".to_owned()));
        let both = FileNotes { key_of: SortKey::Distance, ..tagged };
        assert_eq!(joined(&[both, tagged]).tags(), tagged.tags());
        assert!(with(both).without_tags().notes().tags().is_empty());
        assert_eq!((tagged.mixed_tags(), mixed.without_tags()), (None, none));
        let report = crate::report::Report::new(&with(mixed), &[]).to_string();
        assert!(report.contains("low_pass, up: the merged scenes differ"), "{report}");
    }

    #[test]
    fn joined_scenes_keep_their_places_in_the_world_and_their_harmonics() {
        let near = Scene::generate(3, 1, splat).with_offset([1000.0, 0.0, 0.0]);
        let far = Scene::generate(2, 3, splat).with_offset([2e6, 0.0, 0.0]);
        let joined = Scene::joined(&[near, far]).unwrap();
        assert_eq!((joined.count(), joined.stored_degree(), joined.is_wide()), (5, 3, true));
        let far = splat(1).position;
        assert!((joined.world_position(4)[0] - 2e6 - f64::from(far[0])).abs() < 1e-6);
        assert_eq!(joined.splat(1).sh[12..], [0.0; 36]);
        assert_eq!(joined.splat(4).sh, splat(1).sh);
    }

    #[test]
    fn copies_have_the_bits_of_their_splats() {
        let scene = Scene::generate(500, 3, |index| {
            let wave = |k: usize| ((index * 7 + k * 13) as f32 * 0.37).sin();
            Splat { rotation: std::array::from_fn(wave), ..splat(index) }
        });
        let all: Vec<u32> = (0..scene.count()).collect();
        for copy in [scene.picked(&all), scene.cut_to_degree(3)] {
            assert_eq!(copy.unwrap().identity(), scene.identity());
        }
    }

    #[test]
    fn picked_splats_come_in_the_order_of_their_indices_and_neighbours_along_the_curve_are_near() {
        let scene = Scene::generate(500, 0, splat);
        let picked = scene.picked(&[7, 3, 499]).unwrap();
        assert_eq!([0, 1, 2].map(|at| picked.splat(at)), [7, 3, 499].map(|at| scene.splat(at)));
        let order = scene.morton_order();
        let mut sorted = order.clone();
        sorted.sort_unstable();
        assert_eq!(sorted, (0..500).collect::<Vec<u32>>());
        let way = |scene: &Scene| -> f64 {
            let places = scene.positions().windows(2);
            places.map(|p| DVec3::from(p[0].map(f64::from)).distance(DVec3::from(p[1].map(f64::from)))).sum()
        };
        assert!(way(&scene.picked(&order).unwrap()) < 0.5 * way(&scene));
        let far = |index| Splat { position: [0.0, 5000.0, 0.0], ..splat(index) };
        let with_far =
            Scene::generate(501, 0, |index| if index == 0 { far(index) } else { splat(index - 1) });
        let expected: Vec<u32> = order.iter().map(|index| index + 1).chain([0]).collect();
        assert_eq!(with_far.morton_order(), expected, "a far splat comes last, and changes no other");
    }
}
