//! Changes a scene before it is written: joins, moves, crops, selects and orders splats.

use crate::cli::loading;
use crate::cli::look_at::direction;
use crate::cli::outcome::Usage;
use crate::draw::splat_set::SplatSet;
use crate::io::condition::{self, Condition};
use crate::io::load::FileOptions;
use crate::io::losses::{self, Original};
use crate::io::output::{one_line, say};
use anyhow::{Result, bail};
use glam::{DMat4, DQuat, DVec3, DVec4};
use splatgraph_assets::{Camera, Filter, Scene, Similarity};
use std::path::PathBuf;

/// The changes, applied in the order of these options.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Changes, in this order")]
pub struct EditArgs {
    /// Append the splats of another scene; may be repeated
    #[arg(long, value_name = "SCENE")]
    pub merge: Vec<PathBuf>,
    /// Set a tag, which files of some trainers lack: `low_pass=compensated` (trained with anti-aliasing), `mip` or
    /// `dilated`, or `up=`, an axis such as z or -y, or a vector; may be repeated
    #[arg(long, value_name = "NAME=VALUE", value_parser = tag)]
    tag: Vec<Tag>,
    /// Keep the splats of a selection that the viewer wrote (.json), by their indices in IN and the scenes of --merge
    #[arg(long, value_name = "FILE.json")]
    keep: Option<PathBuf>,
    /// Remove the splats of a selection that the viewer wrote (.json)
    #[arg(long, value_name = "FILE.json")]
    remove: Option<PathBuf>,
    /// Transform the scene: `scale:S`, `rotate:X,Y,Z,DEGREES` (about an axis through the origin), `move:X,Y,Z`, or
    /// `matrix:` and the 12 numbers of three rows, whose last is the translation; may be repeated. The cameras of --price and --write-cameras move with it. Splats at a depth of at most 0.2 units are
    /// not drawn, so enlarge small scenes
    #[arg(long, value_name = "KIND:NUMBERS", value_parser = transform)]
    transform: Vec<Similarity>,
    /// Keep the splats whose centres are inside: `box:X,Y,Z,X,Y,Z` (two corners) or `sphere:X,Y,Z,RADIUS`
    #[arg(long, value_name = "KIND:NUMBERS", value_parser = crop)]
    crop: Option<Crop>,
    /// Keep the splats for which this expression is true, for instance 'opacity > 0.05 && scale_max < 0.5'
    ///
    /// The names are x, y, z (centre, in the world), opacity (0 to 1), scale_min, scale_max (standard deviations), red,
    /// green, blue (band 0, 0 to 1 and beyond), index (as of --keep: in IN and the scenes of --merge, before other
    /// changes). Operators and functions are those of expressions in graphs, but `/` divides whole numbers as floats:
    /// 1/2 is 0.5.
    #[arg(long = "where", value_name = "EXPRESSION", allow_hyphen_values = true)]
    condition: Option<Condition>,
    /// Order of the splats: `file`, or `morton`, which stores neighbours in space near each other
    #[arg(long, value_name = "ORDER", default_value = "file", value_parser = ["file", "morton"])]
    order: String,
}

/// A tag that a file can store.
#[derive(Clone, Copy, Debug)]
enum Tag {
    LowPass(Filter),
    Up([f64; 3]),
}

#[derive(Clone, Copy, Debug)]
enum Crop {
    Box([DVec3; 2]),
    Sphere(DVec3, f64),
}

/// Parses `KIND:NUMBERS`. Each entry of `kinds` is a name, the number of values, and an example.
fn numbers<'a>(text: &'a str, kinds: &[(&str, usize, &str)]) -> Result<(&'a str, Vec<f64>), String> {
    let parse = || {
        let (kind, rest) = text.split_once(':')?;
        let values: Option<Vec<f64>> =
            rest.split(',').map(|v| v.trim().parse().ok().filter(|v: &f64| v.is_finite())).collect();
        let values = values?;
        kinds.iter().any(|(name, count, _)| *name == kind && *count == values.len()).then_some((kind, values))
    };
    let examples: Vec<&str> = kinds.iter().map(|(_, _, example)| *example).collect();
    parse().ok_or_else(|| format!("expected for instance {}", examples.join(" or ")))
}

fn tag(text: &str) -> Result<Tag, String> {
    match text.split_once('=') {
        Some(("low_pass", name)) => {
            let expected = "expected low_pass=dilated, low_pass=compensated or low_pass=mip";
            Filter::named(name).map(Tag::LowPass).ok_or_else(|| expected.into())
        }
        Some(("up", up)) => Ok(Tag::Up(DVec3::from(direction(up)?).normalize().into())),
        _ => Err("expected low_pass=compensated or up=z, for instance".into()),
    }
}

fn transform(text: &str) -> Result<Similarity, String> {
    let kinds = [
        ("scale", 1, "scale:0.5"),
        ("rotate", 4, "rotate:1,0,0,90"),
        ("move", 3, "move:0,-1.5,0"),
        ("matrix", 12, "matrix:2,0,0,5,0,2,0,0,0,0,2,0"),
    ];
    if let Some(factors) = text.strip_prefix("scale:").filter(|factors| factors.contains(',')) {
        let found = factors.split(',').count();
        return Err(format!(
            "expected one factor for all axes, found {found}: scenes cannot be stretched or mirrored"
        ));
    }
    let (kind, values) = numbers(text, &kinds)?;
    match (kind, values.as_slice()) {
        // Many tools take the angle first.
        ("rotate", &[angle, x, y, z])
            if angle.abs() > 1.0 && DVec3::AXES.contains(&DVec3::new(x, y, z).abs()) =>
        {
            Err(format!("expected the axis, then the angle: rotate:{x},{y},{z},{angle}"))
        }
        ("rotate", &[x, y, z, degrees]) => {
            let axis = DVec3::new(x, y, z).try_normalize().ok_or("expected an axis other than 0,0,0")?;
            Ok(Similarity {
                rotation: DQuat::from_axis_angle(axis, degrees.to_radians()),
                ..Similarity::IDENTITY
            })
        }
        ("move", &[x, y, z]) => Ok(Similarity { translation: DVec3::new(x, y, z), ..Similarity::IDENTITY }),
        ("matrix", rows) => {
            let [x, y, z] = [0, 4, 8].map(|row| DVec4::from_slice(&rows[row..]));
            Similarity::of_matrix(DMat4::from_cols(x, y, z, DVec4::W).transpose())
        }
        (_, &[scale]) if (1e-9..=1e9).contains(&scale) => Ok(Similarity { scale, ..Similarity::IDENTITY }),
        _ => Err("expected a factor of 1e-9 to 1e9".into()),
    }
}

fn crop(text: &str) -> Result<Crop, String> {
    let kinds = [("box", 6, "box:-1,-1,-1,1,1,1"), ("sphere", 4, "sphere:0,0,0,2")];
    match *numbers(text, &kinds)?.1.as_slice() {
        [x, y, z, radius] if radius > 0.0 => Ok(Crop::Sphere(DVec3::new(x, y, z), radius)),
        [a, b, c, d, e, f] => {
            let (one, other) = (DVec3::new(a, b, c), DVec3::new(d, e, f));
            Ok(Crop::Box([one.min(other), one.max(other)]))
        }
        _ => Err("expected a radius above 0".into()),
    }
}

impl Crop {
    fn has(&self, point: DVec3) -> bool {
        match self {
            Crop::Box([min, max]) => point.cmpge(*min).all() && point.cmple(*max).all(),
            Crop::Sphere(center, radius) => point.distance(*center) <= *radius,
        }
    }
}

impl EditArgs {
    pub fn lists(&self) -> impl Iterator<Item = &PathBuf> {
        self.keep.iter().chain(&self.remove)
    }

    /// Returns true if an option selects splats.
    fn removes(&self) -> bool {
        self.lists().next().is_some() || self.crop.is_some() || self.condition.is_some()
    }

    /// Appends the scenes of `--merge`, and sets the tags of `--tag`. Also returns the properties of `scene` and of
    /// each appended scene, in order.
    ///
    /// # Errors
    /// A scene cannot be loaded, or does not fit in memory.
    pub fn merged(&self, scene: Scene, load: &FileOptions) -> Result<(Scene, Vec<Original>)> {
        let mut all = vec![scene];
        for path in &self.merge {
            all.push(loading::load_scene(path, &load.clone().into())?);
        }
        let originals = all.iter().map(Original::of).collect();
        let merged = if all.len() == 1 { all.remove(0) } else { Scene::joined(&all)? };
        let mut notes = merged.notes();
        for tag in &self.tag {
            match *tag {
                Tag::LowPass(filter) => (notes.low_pass, notes.mixed.low_pass) = (filter, false),
                Tag::Up(up) => (notes.up, notes.mixed.up) = (Some(up), false),
            }
        }
        Ok((merged.with_notes(notes), originals))
    }

    /// Applies `--transform` to cameras in world coordinates.
    ///
    /// # Errors
    /// A camera is moved out of the range of cameras.
    pub fn moved(&self, cameras: Vec<Camera>) -> Result<Vec<Camera>, Usage> {
        let similarity = self.similarity();
        let moved = |camera: &Camera| match camera.transformed(&similarity) {
            moved if moved.fault().is_none() => Ok(moved),
            moved => Err(Usage(format!(
                "--transform gives no valid camera {}: {}",
                one_line(&camera.img_name),
                moved.fault().unwrap_or_default()
            ))),
        };
        if self.transform.is_empty() { Ok(cameras) } else { cameras.iter().map(moved).collect() }
    }

    pub fn transforms(&self) -> bool {
        !self.transform.is_empty()
    }

    /// Copies the merged scene with all its splats, and applies `--transform`. `None` if no option selects splats or
    /// orders them, which changes the picture where depths are equal.
    ///
    /// # Errors
    /// The copy does not fit in memory.
    pub fn uncut(&self, merged: &Scene) -> Result<Option<Scene>> {
        if !self.removes() && self.order != "morton" {
            return Ok(None);
        }
        Ok(Some(match self.transform.is_empty() {
            true => merged.picked(&(0..merged.count()).collect::<Vec<_>>())?,
            false => merged.transformed(&self.similarity())?,
        }))
    }

    fn similarity(&self) -> Similarity {
        self.transform.iter().fold(Similarity::IDENTITY, |all, next| all.then(*next))
    }

    /// Returns true if `--transform`, which moves the origin to `offset`, leaves a splat within the range of f32.
    fn keeps(&self, scene: &Scene, index: usize, offset: [f64; 3]) -> bool {
        let by = self.similarity();
        let position = by.point(scene.world_position(index).into()) - DVec3::from(offset);
        let scale = scene.scales()[index].map(|scale| (f64::from(scale) * by.scale) as f32);
        position.as_vec3().is_finite() && scale.iter().all(|scale| scale.is_finite())
    }

    /// Applies the changes after `--merge`, in order. Also returns what `--transform` dropped, if anything.
    ///
    /// # Errors
    /// A selection cannot be loaded, the scene does not fit in memory, the condition cannot be evaluated, or no splat
    /// is left.
    pub fn changed(&self, mut scene: Scene) -> Result<(Scene, Option<String>)> {
        let mut loss = None;
        // Indices in the merged scene, before --keep, --remove and --transform left out splats.
        let mut first_indices: Vec<u32> = (0..scene.count()).collect();
        if self.lists().next().is_some() {
            let count = scene.count();
            let read = |path: &PathBuf| SplatSet::read(path, &scene).map_err(Usage);
            let kept = self.keep.as_ref().map_or_else(|| Ok(SplatSet::first(count)), read)?;
            let removed = self.remove.as_ref().map_or_else(|| Ok(SplatSet::default()), read)?;
            let left = kept.without(&removed);
            if left.is_empty() {
                bail!("expected --keep and --remove to leave a splat, found none left of {count}");
            }
            first_indices = left.indices();
            scene = scene.picked(&first_indices)?;
        }
        if !self.transform.is_empty() {
            let moved = scene.transformed(&self.similarity())?;
            let lost = moved.dropped().since(scene.dropped());
            if moved.count() == 0 {
                bail!("expected --transform to leave a splat, found none left of {}: {lost}", scene.count());
            }
            if lost.total() > 0 {
                loss = Some(format!("--transform: {} dropped ({lost})", losses::splats(lost.total())));
                let mut at = 0..;
                first_indices.retain(|_| at.next().is_some_and(|at| self.keeps(&scene, at, moved.offset())));
            }
            let up = moved.notes().up.filter(|up| Some(*up) != scene.notes().up);
            if let Some([x, y, z]) = up.filter(|_| self.tag.iter().any(|tag| matches!(tag, Tag::Up(_)))) {
                say(format!("the tag up becomes {x},{y},{z}: --transform turns what --tag set"));
            }
            scene = moved;
        }
        if self.crop.is_some() || self.condition.is_some() {
            let kept = condition::keep(&scene, "--crop and --where", |index| {
                let at = index as usize;
                let is_inside = self.crop.is_none_or(|crop| crop.has(scene.world_position(at).into()));
                let condition = self.condition.as_ref().filter(|_| is_inside);
                condition.map_or(Ok(is_inside), |condition| condition.holds(&scene, at, first_indices[at]))
            })?;
            if let Some(kept) = kept {
                scene = scene.picked(&kept)?;
            }
        }
        if self.order == "morton" {
            scene = scene.picked(&scene.morton_order())?;
        }
        Ok((scene, loss))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::parsed;
    use splatgraph_assets::synth;

    fn edit(words: &[&str]) -> Result<Scene, String> {
        let edit: EditArgs = parsed([&["convert"], words].concat()).map_err(|error| error.to_string())?;
        let scene = synth::generate("uniform", 400, 0).expect("a small scene");
        let merged = edit.merged(scene, &FileOptions::default());
        merged
            .and_then(|(merged, _)| edit.changed(merged))
            .map(|(scene, _)| scene)
            .map_err(|error| error.to_string())
    }

    #[test]
    fn splats_that_a_transform_moves_beyond_the_range_of_floats_are_a_loss() {
        let words = ["1e9", "1e9", "1e9", "1e9", "500"].map(|factor| format!("--transform=scale:{factor}"));
        let edit: EditArgs = parsed([&["convert".to_owned()][..], &words].concat()).unwrap();
        let scene = || synth::generate("uniform", 400, 0).expect("a small scene");
        let (left, loss) = edit.changed(scene()).unwrap();
        let loss = loss.expect("a loss");
        assert!(loss.starts_with(&format!("--transform: {} splats dropped", 400 - left.count())), "{loss}");
        let keeps = |index: &usize| edit.keeps(&scene(), *index, left.offset());
        assert_eq!((0..400).filter(keeps).count(), left.count() as usize);
    }

    #[test]
    fn the_scene_before_an_order_is_kept_to_compare_with() {
        let scene = synth::generate("uniform", 400, 0).expect("a small scene");
        let edit = |words: &[&str]| parsed::<EditArgs>([&["convert"], words].concat()).unwrap();
        assert!(edit(&[]).uncut(&scene).unwrap().is_none());
        let uncut = edit(&["--order", "morton"]).uncut(&scene).unwrap().expect("a copy");
        assert!(uncut.positions() == scene.positions());
    }

    #[test]
    fn splats_are_kept_by_place_and_by_condition() {
        let whole = edit(&[]).unwrap();
        let expected = |keep: &dyn Fn(usize) -> bool| (0..400).filter(|index| keep(*index)).count() as u32;
        let opaque = edit(&["--where", "opacity > 0.5 && x < 0"]).unwrap();
        assert_eq!(
            opaque.count(),
            expected(&|i| whole.opacities()[i] > 0.5 && whole.positions()[i][0] < 0.0)
        );
        assert!(opaque.count() > 0 && opaque.count() < 400);
        let [x, y, z] = whole.positions()[7];
        let sphere = edit(&["--crop", &format!("sphere:{x},{y},{z},0.0001")]).unwrap();
        assert_eq!((sphere.count(), sphere.splat(0)), (1, whole.splat(7)));
        let half = edit(&["--crop", "box:100,-100,100,-100,100,0"]).unwrap();
        assert_eq!(half.count(), expected(&|i| whole.positions()[i][2] >= 0.0));
        assert_eq!(edit(&["--where", "index % 2 == 0", "--order", "morton"]).unwrap().count(), 200);
        // Whole numbers divide as floats.
        let half = edit(&["--where", "opacity > 1/2 && x < -3/4 + 6/8 && index / 2 < 399 / 2"]).unwrap();
        assert_eq!(
            half.positions(),
            edit(&["--where", "opacity > 0.5 && x < 0 && index < 399"]).unwrap().positions()
        );
        let left = edit(&["--where", "-x > 0"]).unwrap();
        assert_eq!(left.count(), expected(&|i| whole.positions()[i][0] < 0.0));
    }

    #[test]
    fn splats_are_kept_and_removed_by_lists() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let whole = edit(&[]).unwrap();
        let write = |name: &str, indices: &[u32]| {
            let set: SplatSet = indices.iter().copied().collect();
            std::fs::write(at(name), set.to_json(&whole).unwrap()).unwrap();
            at(name).to_string_lossy().into_owned()
        };
        let (some, one) = (write("some.json", &[7, 3, 390]), write("one.json", &[3]));
        let kept = edit(&["--keep", &some]).unwrap();
        assert_eq!(kept.positions(), [3, 7, 390].map(|index| whole.positions()[index]));
        assert_eq!(edit(&["--remove", &some]).unwrap().count(), 397);
        assert_eq!(edit(&["--keep", &some, "--remove", &one]).unwrap().count(), 2);
        // `index` counts the splats of the file, whatever other options leave out.
        for changes in [vec!["--remove", &one], vec!["--crop", "sphere:0,0,0,9000"]] {
            let left = edit(&[&changes[..], &["--where", "index == 7 || index == 390"]].concat()).unwrap();
            assert_eq!(left.positions(), [7, 390].map(|index| whole.positions()[index]));
        }
        let none = edit(&["--keep", &one, "--remove", &some]).unwrap_err();
        assert!(
            none.contains("expected --keep and --remove to leave a splat, found none left of 400"),
            "{none}"
        );
        let other = synth::generate("uniform", 400, 1).unwrap();
        let set: SplatSet = [7].into_iter().collect();
        std::fs::write(at("other.json"), set.to_json(&other).unwrap()).unwrap();
        let other = edit(&["--remove", &at("other.json").to_string_lossy()]).unwrap_err();
        assert!(other.contains("other.json: expected a selection of the scene "), "{other}");
        std::fs::write(at("some.json"), "{\"splats\":3,\"indices\":[]}").unwrap();
        let other = edit(&["--keep", &some]).unwrap_err();
        assert!(other.contains("some.json: expected a selection of 400 splats, found one of 3"), "{other}");
    }

    #[test]
    fn transforms_are_made_in_their_order() {
        let whole = edit(&[]).unwrap();
        let moved =
            edit(&["--transform", "scale:2", "--transform", "rotate:0,0,1,90", "--transform", "move:1,0,0"])
                .unwrap();
        let ([x, y, z], [a, b, c]) = (whole.positions()[3], moved.positions()[3]);
        assert!(
            (a - (1.0 - 2.0 * y)).abs() < 1e-5 && (b - 2.0 * x).abs() < 1e-5 && (c - 2.0 * z).abs() < 1e-5
        );
        let at_once = edit(&["--transform", "matrix:0,-2,0,1,2,0,0,0,0,0,2,0"]).unwrap();
        assert!([a, b, c].iter().zip(at_once.positions()[3]).all(|(a, b)| (a - b).abs() < 1e-5));
    }

    #[test]
    fn a_transform_that_leaves_no_splat_within_the_range_of_floats_is_refused() {
        let far = ["--transform", "scale:1e9"].repeat(5);
        let said = edit(&far).unwrap_err();
        assert!(
            said.contains("expected --transform to leave a splat, found none left of 400: ")
                && said.contains(" not finite in f32"),
            "{said}"
        );
    }

    #[test]
    fn mistakes_are_told_with_their_place() {
        let said = |words: &[&str]| edit(words).unwrap_err();
        assert!(said(&["--where", "opacity >"]).contains("column "), "{}", said(&["--where", "opacity >"]));
        let unknown = said(&["--where", "true && opacty > 0.5"]);
        assert!(
            unknown.contains("column 9 of `true && opacty > 0.5`") && unknown.contains("opacity"),
            "{unknown}"
        );
        let zero = said(&["--where", "x > 1 / 0"]);
        assert!(zero.contains("column 9 of `x > 1 / 0`: division by zero"), "{zero}");
        assert!(said(&["--where", "1.5"]).contains("expected a condition, found `1.5`"));
        assert!(
            said(&["--where", "opacity > 2"])
                .contains("expected --crop and --where to keep a splat, found none kept of 400 splats")
        );
        assert!(
            said(&["--crop", "sphere:1,2,3"])
                .contains("expected for instance box:-1,-1,-1,1,1,1 or sphere:0,0,0,2")
        );
        assert!(said(&["--crop", "sphere:1,2,3,0"]).contains("expected a radius above 0"));
        assert!(said(&["--transform", "rotate:0,0,0,90"]).contains("expected an axis other than 0,0,0"));
        let first = said(&["--transform", "rotate:180,1,0,0"]);
        assert!(first.contains("expected the axis, then the angle: rotate:1,0,0,180"), "{first}");
        assert!(
            edit(&["--transform", "rotate:1,0,0,0"]).is_ok(),
            "no turn, for instance in a loop over angles"
        );
        assert!(said(&["--transform", "scale:1,1,-1"]).contains("expected one factor for all axes, found 3"));
        let skewed =
            "expected a rotation, a uniform scale and a translation, found a matrix that skews, mirrors";
        for rows in ["1,1,0,0,0,1,0,0,0,0,1,0", "-1,0,0,0,0,1,0,0,0,0,1,0"] {
            assert!(said(&["--transform", &format!("matrix:{rows}")]).contains(skewed));
        }
        assert!(said(&["--transform", "scale:-1"]).contains("expected a factor of 1e-9 to 1e9"));
    }
}
