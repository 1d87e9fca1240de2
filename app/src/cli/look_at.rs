//! Makes cameras from an eye and a target, and circles of cameras.

use super::cameras;
use super::outcome::{self, Usage};
use crate::draw::camera::{common_view, mean_up};
use crate::draw::facts;
use crate::draw::orbit::{self, Orbit};
use crate::draw::projection;
use crate::io::output::say;
use anyhow::Result;
use glam::DVec3;
use splatgraph_assets::{Camera, NEAR, Projection, Scene};
use std::sync::OnceLock;

/// Options of cameras without a file.
#[derive(Debug, clap::Args)]
pub struct LookAtArgs {
    /// Position of the camera, in world coordinates (y points down in most captures) [default: one that frames the
    /// scene]
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = point)]
    eye: Option<[f64; 3]>,
    /// Point to look at [default: the middle of the scene; for a panorama, that direction along the horizon]
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = point)]
    target: Option<[f64; 3]>,
    /// World direction that points up in the picture: an axis such as z or -y, a vector, or `cameras`, the mean of
    /// those of --cameras, which are then not drawn; x points right in a view along it [default: the scene's, or -y]
    #[arg(long, value_name = "AXIS|X,Y,Z|cameras", allow_hyphen_values = true, value_parser = up)]
    up: Option<Up>,
    /// Horizontal field of view, in degrees: up to 179, or 360 for a fisheye [default: 60 across the longer side,
    /// or less for a scene smaller than a unit]
    #[arg(long, value_name = "DEGREES", value_parser = angle)]
    fov: Option<f64>,
    /// Height of an orthographic view, in world units [default: that of the perspective view, at the middle of the
    /// scene]
    #[arg(long, value_name = "UNITS", value_parser = height, conflicts_with = "fov")]
    ortho_height: Option<f64>,
    /// Draw N pictures along a circle through --eye with the axis --up, starting at --eye
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    orbit: Option<u32>,
}

/// The value of `--up`.
#[derive(Clone, Debug)]
pub enum Up {
    Direction([f64; 3]),
    /// The mean up direction of cameras, once [`Up::read`] has seen them.
    Cameras(OnceLock<[f64; 3]>),
}

impl Up {
    /// Takes the mean up direction of cameras, if this is `--up cameras`. Reports if it may lie along the ground.
    ///
    /// # Errors
    /// There are no cameras, or their directions cancel out.
    pub fn read(&self, cameras: &[Camera]) -> Result<(), Usage> {
        let Up::Cameras(direction) = self else { return Ok(()) };
        if let Some(forward) = common_view(cameras) {
            let (along, up) = (named(forward), named(-forward));
            say(format!("--up cameras: all cameras look along {along}; if that is down, use `--up {up}`"));
        }
        let expected = "--up cameras: expected cameras with an up direction in common, found";
        let mean = mean_up(cameras).ok_or_else(|| {
            let found = if cameras.is_empty() { "no camera" } else { "directions that cancel out" };
            Usage(format!("{expected} {found}"))
        })?;
        direction.get_or_init(|| mean.into());
        Ok(())
    }

    /// Returns the direction, of any length; `None` for `--up cameras` before [`Up::read`].
    pub fn direction(&self) -> Option<[f64; 3]> {
        match self {
            Up::Direction(direction) => Some(*direction),
            Up::Cameras(direction) => direction.get().copied(),
        }
    }
}

pub fn up(text: &str) -> Result<Up, String> {
    match text {
        "cameras" => Ok(Up::Cameras(OnceLock::new())),
        _ => direction(text).map(Up::Direction),
    }
}

pub fn point(text: &str) -> Result<[f64; 3], String> {
    let values: Option<Vec<f64>> =
        text.split(',').map(|v| v.trim().parse().ok().filter(|v: &f64| v.is_finite())).collect();
    let values = values.and_then(|values| <[f64; 3]>::try_from(values).ok());
    values.ok_or_else(|| "expected three numbers, for instance 1,-0.5,2".into())
}

/// Parses a direction: three numbers, not all 0, or an axis such as `z` or `-y`. The result is not normalized.
pub fn direction(text: &str) -> Result<[f64; 3], String> {
    let axis = match text.strip_prefix(['+', '-']).unwrap_or(text) {
        "x" => Some([1.0, 0.0, 0.0]),
        "y" => Some([0.0, 1.0, 0.0]),
        "z" => Some([0.0, 0.0, 1.0]),
        _ => None,
    };
    let sign = if text.starts_with('-') { -1.0 } else { 1.0 };
    let has_length = |v: &[f64; 3]| DVec3::from(*v).try_normalize().is_some();
    // `+ 0.0` avoids "-0", also in the tags of files.
    let found = axis.map(|axis| axis.map(|v| sign * v + 0.0)).or_else(|| point(text).ok().filter(has_length));
    found.ok_or_else(|| "expected an axis such as z or -y, or three numbers that are not all 0".into())
}

/// Names a direction as [`direction`] reads it: the axis within ten degrees, or else three numbers.
pub fn named(direction: DVec3) -> String {
    let axes = [(DVec3::X, "x"), (DVec3::Y, "y"), (DVec3::Z, "z")];
    let near = axes.into_iter().find(|(axis, _)| direction.dot(*axis).abs() > 0.985);
    let signed = |(axis, name)| format!("{}{name}", if direction.dot(axis) < 0.0 { "-" } else { "" });
    near.map_or_else(|| numbers(direction), signed)
}

/// Formats a direction with four decimals.
pub fn numbers(direction: DVec3) -> String {
    // `+ 0.0` avoids "-0".
    direction.to_array().map(|v| ((v * 1e4).round() / 1e4 + 0.0).to_string()).join(",")
}

/// Parses a field of view, in degrees. [`LookAtArgs::circle`] checks the limit of each projection.
fn angle(text: &str) -> Result<f64, String> {
    let angle = text.parse().ok().filter(|angle: &f64| (0.1..=360.0).contains(angle));
    angle.ok_or_else(|| "expected 0.1 to 179 degrees, or to 360 for a fisheye".into())
}

fn height(text: &str) -> Result<f64, String> {
    let height = text.parse().ok().filter(|height: &f64| *height > 0.0 && height.is_finite());
    height.ok_or_else(|| "expected a positive number of world units, for instance 2.5".into())
}

impl LookAtArgs {
    /// Checks the options against `--cameras`, and reads the direction of `--up cameras`.
    ///
    /// # Errors
    /// An option replaces the cameras that are given, `--up cameras` lacks `--cameras`, or its cameras cannot be read
    /// or have no up direction in common.
    pub fn check(&self, cameras: Option<&str>) -> Result<()> {
        let given = [
            ("--orbit", self.orbit.is_some()),
            ("--eye", self.eye.is_some()),
            ("--target", self.target.is_some()),
            ("--up", self.up.is_some()),
            ("--fov", self.fov.is_some()),
        ];
        match (&self.up, cameras) {
            (Some(Up::Cameras(_)), None) => {
                Err(Usage("expected --cameras with --up cameras, found none".into()).into())
            }
            (Some(up @ Up::Cameras(_)), Some(spec)) => Ok(up.read(&cameras::parse(spec, true)?)?),
            (_, None) => Ok(()),
            (_, Some(_)) => Ok(outcome::refuse(&given, |option| {
                format!(
                    "{option} cannot be used with --cameras, which have views of their own; with `--up cameras`, they give only \
                     the up direction"
                )
            })?),
        }
    }

    /// Returns the names of the cameras; `None` if the options give neither a camera nor a circle.
    pub fn names(&self) -> Option<Vec<String>> {
        match self.orbit {
            Some(count) => Some((0..count).map(|index| format!("orbit-{index:04}")).collect()),
            None => self.has_camera().then(|| vec!["eye".into()]),
        }
    }

    /// Returns true if `--eye`, `--target`, `--up` or `--fov` is given.
    pub fn has_camera(&self) -> bool {
        self.eye.is_some() || self.target.is_some() || self.up.is_some() || self.fov.is_some()
    }

    pub fn count(&self) -> Option<u32> {
        self.orbit
    }

    /// Makes the cameras, in the scene's coordinates; `None` if [`LookAtArgs::names`] returns `None`.
    ///
    /// # Errors
    /// See [`LookAtArgs::circle`].
    pub fn cameras(
        &self,
        scene: &Scene,
        size: Option<(u32, u32)>,
        projection: Projection,
    ) -> Result<Option<Vec<Camera>>, Usage> {
        let Some(names) = self.names() else { return Ok(None) };
        let circle = self.circle(scene, size, projection, names.len() > 1)?;
        let cameras = on_circle(&circle, names.len()).into_iter().zip(names);
        Ok(Some(cameras.map(|(camera, img_name)| Camera { img_name, ..camera }).collect()))
    }

    /// Sets the view height of an orthographic camera to `--ortho-height`, if given.
    ///
    /// # Errors
    /// The option is given for another projection, or the height is too small or too large for a camera.
    pub fn scaled(&self, camera: Camera) -> Result<Camera, Usage> {
        let Some(height) = self.ortho_height else { return Ok(camera) };
        if camera.projection != Projection::Orthographic {
            let found = camera.projection;
            return Err(Usage(format!(
                "expected --ortho-height for an orthographic camera, found a {found} one: add --pipeline orthographic"
            )));
        }
        let factor = f64::from(camera.height) / height / camera.fy;
        let scaled = Camera { fx: camera.fx * factor, fy: camera.fy * factor, ..camera };
        match scaled.fault() {
            Some(fault) => Err(Usage(format!("--ortho-height gives no valid camera: {fault}"))),
            None => Ok(scaled),
        }
    }

    /// Computes the circle through the eye around the axis `--up`, in the scene's coordinates.
    ///
    /// Without `--eye`, the first camera has the position of [`Camera::framing_upright`] with the field of view of
    /// `--fov` (for a fisheye, at most the default one), or of [`Camera::framing_around`] if the camera `turns`.
    /// Without `--eye`, `--fov` and `--target`, it also enlarges a small scene as that camera does.
    ///
    /// # Errors
    /// The eye and the target coincide, or are too far away to draw. `--fov` is invalid for the projection.
    pub fn circle(
        &self,
        scene: &Scene,
        size: Option<(u32, u32)>,
        projection: Projection,
        turns: bool,
    ) -> Result<Orbit, Usage> {
        let size = size.unwrap_or_else(|| projection::default_size(projection, facts::DEFAULT_SIZE));
        let local = |place: [f64; 3]| DVec3::from(place) - DVec3::from(scene.offset());
        let target = self.target.map_or_else(|| DVec3::from(scene.robust_bounds().center()), local);
        let up = self.up.as_ref().and_then(Up::direction).unwrap_or(scene.up());
        let framed = if turns { Camera::framing_around } else { Camera::framing_upright };
        let fov = self.fov.map(|fov| match projection {
            // With the same wide field of view, a fisheye shows the middle larger than a pinhole does, and could cut
            // the scene off above and below. The distance for the default field of view suits both.
            Projection::Fisheye => fov.min(default_fov(size)),
            _ => fov.min(MAX_FLAT_FOV),
        });
        let framing = self.eye.is_none().then(|| framed(scene, up, fov, size));
        if let (Some(fov), Some(framing), None) = (fov, &framing, self.target) {
            tell_small(scene, framing, fov);
        }
        let eye = framing.as_ref().map_or(DVec3::ZERO, |camera| camera.position.into());
        let eye = self.eye.map_or(eye, local);
        if eye.distance(target) < 1e-9 * eye.length().max(1.0) {
            return Err(Usage(format!(
                "expected different points for --eye and --target, found the same: {}",
                eye + DVec3::from(scene.offset())
            )));
        }
        let zoom = framing
            .filter(|_| self.fov.is_none() && self.target.is_none())
            .map_or(1.0, |camera| enlargement(&camera));
        let mut start = self.start([eye, target, up.into()], size, zoom, scene, projection)?;
        if projection == Projection::Equirectangular {
            start = self.panorama(start, up);
        }
        let axis = DVec3::from(up).normalize_or(DVec3::NEG_Y);
        if turns && (eye - target).cross(axis).length() < 1e-9 * eye.distance(target) {
            say(
                "the circle has no radius: --eye is on the axis --up through --target, so the camera only turns on the spot",
            );
        }
        if let Some(fault) = start.fault() {
            return Err(Usage(format!("--eye, --target and --fov give no valid camera: {fault}")));
        }
        Ok(Orbit { start, around: target.into(), axis: up })
    }

    /// Makes a panorama level, because a viewer's floor would otherwise lean. With `--target`, only reports the pitch.
    fn panorama(&self, camera: Camera, up: [f64; 3]) -> Camera {
        if self.target.is_none() {
            return orbit::levelled(&camera, up);
        }
        let pitch = orbit::pitch(&camera, up);
        if pitch.abs() >= 0.05 {
            let (degrees, side) = (pitch.abs(), if pitch < 0.0 { "below" } else { "above" });
            say(format!(
                "the panorama is tilted: --target is {degrees:.1} degrees {side} the horizon; without --target, it is level"
            ));
        }
        camera
    }

    fn start(
        &self,
        [eye, target, up]: [DVec3; 3],
        size: (u32, u32),
        zoom: f64,
        scene: &Scene,
        projection: Projection,
    ) -> Result<Camera, Usage> {
        let at = |fov| Camera::looking_at_upright(eye.into(), target.into(), up.into(), fov, size);
        match (projection, self.fov) {
            (Projection::Fisheye, Some(fov)) => {
                let focal = f64::from(size.0) / fov.to_radians();
                Ok(Camera { projection, fx: focal, fy: focal, ..at(60.0) })
            }
            (Projection::Equirectangular, Some(fov)) => Err(Usage(format!(
                "expected no --fov for an equirectangular view, which covers 360 degrees, found {fov}"
            ))),
            (_, Some(fov)) if fov > MAX_FLAT_FOV => {
                let text = format!("--fov: expected 0.1 to 179 degrees for a {projection} view, found {fov}");
                Err(Usage(format!("{text}; --pipeline fisheye allows up to 360")))
            }
            (_, fov) => {
                let camera = at(fov.unwrap_or_else(|| default_fov(size)));
                let camera = Camera { fx: zoom * camera.fx, fy: zoom * camera.fy, ..camera };
                Ok(camera.projected(projection, scene))
            }
        }
    }
}

/// Largest field of view of a projection onto a plane, in degrees.
const MAX_FLAT_FOV: f64 = 179.0;

/// Computes the horizontal field of view that is 60 degrees across the longer side, as in [`Camera::framing`].
fn default_fov((width, height): (u32, u32)) -> f64 {
    const LONGER: f64 = 60.0;
    if width >= height {
        return LONGER;
    }
    let half = (0.5 * LONGER).to_radians().tan() * f64::from(width) / f64::from(height);
    2.0 * half.atan().to_degrees()
}

/// Computes the share of the picture's width or height that the box of most splats spans, from the picture's middle.
fn span(scene: &Scene, camera: &Camera) -> f64 {
    let corners = scene.robust_bounds().corners().map(|corner| {
        let [x, y, z] = camera.to_view(corner);
        let z = if camera.projection == Projection::Orthographic { 1.0 } else { z };
        let share = |v: f64, focal: f64, side: u32| (2.0 * v / z * focal / f64::from(side)).abs();
        share(x, camera.fx, camera.width).max(share(y, camera.fy, camera.height))
    });
    corners.into_iter().fold(0.0, f64::max)
}

/// Reports a scene that is small in its framing picture, because the camera must be beyond the near plane.
fn tell_small(scene: &Scene, framing: &Camera, fov: f64) {
    let share = span(scene, framing);
    if share < 0.5 && framing.depth_range(&scene.robust_bounds()).0 < 1.5 * NEAR {
        let percent = 100.0 * share;
        say(format!(
            "with --fov {fov}, the scene spans {percent:.0} % of the picture, because splats nearer than {NEAR} units are not \
             drawn: leave out --fov, or enlarge the scene: `convert --transform scale:20`"
        ));
    }
}

/// Returns the factor by which a camera of [`Camera::framing`] enlarges a small scene; 1 if it does not.
pub fn enlargement(framing: &Camera) -> f64 {
    let size = (framing.width, framing.height);
    let usual = 0.5 * f64::from(size.0) / (0.5 * default_fov(size).to_radians()).tan();
    let zoom = framing.fx / usual;
    // Rounding errors must not change the pictures of other scenes.
    if zoom > 1.0 + 1e-9 { zoom } else { 1.0 }
}

/// Makes `count` cameras at equal steps along a circle, the first at its start.
pub fn on_circle(circle: &Orbit, count: usize) -> Vec<Camera> {
    (0..count).map(|index| Camera { id: index as i64, ..circle.at(index as f64 / count as f64) }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;
    use splatgraph_assets::{FileNotes, Similarity, synth};

    #[derive(Debug, Parser)]
    struct Line {
        #[arg(long)]
        cameras: Option<String>,
        #[command(flatten)]
        look: LookAtArgs,
    }

    fn parse(words: &str) -> Result<LookAtArgs, String> {
        let words = ["render"].into_iter().chain(words.split_ascii_whitespace());
        Line::try_parse_from(words).map(|line| line.look).map_err(|error| error.to_string())
    }

    #[test]
    fn an_orbit_keeps_the_target_in_the_middle_and_its_height_and_distance() {
        let scene = synth::generate("uniform", 50, 0).unwrap();
        let look = parse("--eye 3,-1,0 --target 0,1,0 --orbit 4 --fov 90").unwrap();
        let cameras = look.cameras(&scene, Some((200, 100)), Projection::Pinhole).unwrap().unwrap();
        let places: Vec<[i64; 3]> =
            cameras.iter().map(|c| c.position.map(|v| (v * 1e6).round() as i64)).collect();
        assert_eq!(places[0], [3_000_000, -1_000_000, 0]);
        assert_eq!(places[2], [-3_000_000, -1_000_000, 0]);
        assert_eq!(places[1][0], 0);
        for camera in &cameras {
            let [x, y, z] = camera.to_view([0.0, 1.0, 0.0]);
            assert!(x.abs() < 1e-9 && y.abs() < 1e-9 && (z - 13f64.sqrt()).abs() < 1e-9);
            assert!((camera.fx - 100.0).abs() < 1e-9 && camera.axes()[1][1] > 0.0);
        }
        assert_eq!(look.names().unwrap()[3], cameras[3].img_name);
    }

    #[test]
    fn a_scene_far_from_the_origin_is_looked_at_in_the_worlds_coordinates() {
        let scene = synth::generate("uniform", 50, 0).unwrap().with_offset([1e6, 0.0, 0.0]);
        let look = parse("--eye 1000000,0,-5 --target 1000000,0,0").unwrap();
        let cameras = look.cameras(&scene, None, Projection::Pinhole).unwrap().unwrap();
        assert_eq!((cameras[0].position, cameras[0].axes()[2]), ([0.0, 0.0, -5.0], [0.0, 0.0, 1.0]));
    }

    #[test]
    fn an_orbit_without_an_eye_begins_with_the_framing_view_in_a_picture_of_any_shape() {
        let scene = synth::generate("uniform", 50, 0).unwrap();
        for size in [(300, 600), (300, 300), (600, 300)] {
            let look = parse("--orbit 1").unwrap();
            let start = look.cameras(&scene, Some(size), Projection::Pinhole).unwrap().unwrap().remove(0);
            let framing = Camera::framing(&scene, size.0, size.1);
            assert!(
                (start.fx / framing.fx - 1.0).abs() < 1e-9 && start.position == framing.position,
                "{size:?}"
            );
        }
        let small = scene.transformed(&Similarity { scale: 1e-3, ..Similarity::IDENTITY }).unwrap();
        for size in [(300, 600), (600, 300)] {
            let made =
                |words: &str| parse(words).unwrap().circle(&small, Some(size), Projection::Pinhole, false);
            let (start, framing) =
                (made("--orbit 1").unwrap().start, Camera::framing(&small, size.0, size.1));
            assert!((start.fx / framing.fx - 1.0).abs() < 1e-9 && enlargement(&framing) > 100.0, "{size:?}");
            for own in ["--eye 0,0,-1", "--fov 60"] {
                let start = made(own).unwrap().start;
                assert!(start.fx < 2.0 * f64::from(size.1), "{own}: no enlargement");
            }
            // As near as the near plane allows.
            let near = made("--fov 60").unwrap().start.depth_range(&small.robust_bounds()).0;
            assert!((NEAR..1.2 * NEAR).contains(&near), "{near}");
        }
        assert_eq!(enlargement(&Camera::framing(&scene, 960, 540)), 1.0);
        // With a long or a wide lens, the scene fills the picture, too, seen from another distance.
        for (fov, size) in [(5.0, (300, 200)), (25.0, (90, 320)), (50.0, (320, 90)), (120.0, (300, 300))] {
            for projection in [Projection::Pinhole, Projection::Orthographic] {
                let look = parse(&format!("--fov {fov}")).unwrap();
                let camera = look.cameras(&scene, Some(size), projection).unwrap().unwrap().remove(0);
                let filled = span(&scene, &camera);
                let least = if projection == Projection::Pinhole { 0.91 } else { 0.3 };
                assert!((least..0.93).contains(&filled), "{fov}, {size:?}, {projection}: {filled}");
            }
        }
        let wide = parse("--fov 340").unwrap().cameras(&scene, None, Projection::Fisheye).unwrap().unwrap();
        assert_eq!(wide[0].position, Camera::framing(&scene, 960, 540).position);
        // The circle around a long scene is larger, so that each of its pictures shows the whole scene.
        let long = synth::generate("uniform", 500, 0).unwrap();
        let long = Scene::joined(&[0.0, 4.0, 8.0].map(|x| {
            let translation = DVec3::new(x, 0.0, 0.0);
            long.transformed(&Similarity { translation, ..Similarity::IDENTITY }).unwrap()
        }));
        let long = long.unwrap();
        for camera in parse("--orbit 8").unwrap().cameras(&long, None, Projection::Pinhole).unwrap().unwrap()
        {
            for corner in long.robust_bounds().corners() {
                let [x, y, z] = camera.to_view(corner);
                let (x, y) = (camera.fx * x / z, camera.fy * y / z);
                assert!(z > 0.0 && x.abs() < 480.0 && y.abs() < 270.0, "{}: {x}, {y}", camera.img_name);
            }
        }
        for up in [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]] {
            let look = parse(&format!("--orbit 4 --up {},{},{}", up[0], up[1], up[2])).unwrap();
            let cameras = look.cameras(&scene, None, Projection::Pinhole).unwrap().unwrap();
            let center = DVec3::from(scene.robust_bounds().center());
            for camera in cameras {
                let above = (DVec3::from(camera.position) - center).dot(up.into());
                assert!(above > 0.5, "{up:?}: seen from above, found {above}");
            }
        }
    }

    #[test]
    fn up_can_be_that_of_cameras_which_are_not_drawn() {
        let scene = synth::generate("uniform", 50, 0).unwrap();
        let up = [0.6, 0.0, 0.8];
        let around = [[3.0, 0.0, 0.0], [0.0, 3.0, 0.0], [-3.0, 0.0, 0.0], [0.0, -3.0, 0.0]];
        let given = around.map(|eye| Camera::looking_at_upright(eye, [0.0; 3], up, 60.0, (64, 48)));
        let look = parse("--orbit 3 --up cameras").unwrap();
        let level = mean_up(&given).unwrap();
        look.check(Some(&serde_json::to_string(&given).unwrap())).unwrap();
        let drawn = look.cameras(&scene, None, Projection::Pinhole).unwrap().unwrap();
        let right = |camera: &Camera| DVec3::from(camera.axes()[0]);
        assert!(drawn.len() == 3 && drawn.iter().all(|camera| right(camera).dot(level).abs() < 1e-6));
        assert!(
            right(&drawn[0]).dot(DVec3::from(FileNotes::UP)).abs() > 1e-3,
            "the scene's own up is another"
        );
    }

    #[test]
    fn the_options_of_each_projection_are_checked_against_it() {
        let scene = synth::generate("uniform", 50, 0).unwrap();
        let made = |words: &str, projection| {
            let look = parse(words).unwrap();
            let camera = look.cameras(&scene, Some((300, 150)), projection).map(|all| all.unwrap().remove(0));
            camera.and_then(|camera| look.scaled(camera)).map_err(|error| error.to_string())
        };
        let fisheye = made("--eye 0,0,-4 --fov 200", Projection::Fisheye).unwrap();
        assert!((fisheye.fx * 200f64.to_radians() - 300.0).abs() < 1e-9 && fisheye.fx == fisheye.fy);
        let parallel = made("--eye 0,0,-4 --ortho-height 3", Projection::Orthographic).unwrap();
        assert!((parallel.fx - 50.0).abs() < 1e-9 && (parallel.fy - 50.0).abs() < 1e-9, "pixels per unit");
        let said = made("--eye 0,0,-4 --ortho-height 3", Projection::Pinhole).unwrap_err();
        assert!(
            said.contains("expected --ortho-height for an orthographic camera, found a pinhole one"),
            "{said}"
        );
        let panorama = |words: &str| {
            let camera = made(words, Projection::Equirectangular).unwrap();
            (camera.axes()[1][1], camera.axes()[2])
        };
        // From high above, from almost straight above the middle, and without an eye.
        for level in ["--eye 0.5,-40,-4", "--eye 0.1,-30,0", "--up 0,-1,0"] {
            let (down, forward) = panorama(level);
            assert!((down - 1.0).abs() < 1e-9 && forward[1].abs() < 1e-9, "{level}: {forward:?}");
        }
        assert!(panorama("--eye 0,-3,-4 --target 0,0,0").1[1] > 0.5, "a target is looked at");
        let said = made("--eye 0,0,-4 --fov 90", Projection::Equirectangular).unwrap_err();
        assert!(said.contains("expected no --fov for an equirectangular view"), "{said}");
    }

    #[test]
    fn mistakes_are_told() {
        let scene = synth::generate("uniform", 50, 0).unwrap().with_offset([1000.0, 0.0, 0.0]);
        let said = |words: &str| {
            parse(words).unwrap().cameras(&scene, None, Projection::Pinhole).unwrap_err().to_string()
        };
        assert!(
            said("--eye 1,2,3 --target 1,2,3")
                .contains("expected different points for --eye and --target, found the same: [1, 2, 3]")
        );
        assert_eq!(
            ["-y", "+z", "x"].map(|axis| direction(axis).unwrap()),
            [[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]
        );
        assert_eq!(format!("{:?}", direction("-y")), "Ok([0.0, -1.0, 0.0])");
        for none in ["0,0,0", "1e-320,0,0", "1,2", "w"] {
            let said = parse(&format!("--up {none}")).unwrap_err();
            assert!(said.contains("or three numbers that are not all 0"), "{said}");
        }
        assert!(said("--eye 1e30,0,0").contains("expected a position within 1e18"));
        assert!(parse("--eye 1,2").unwrap_err().contains("expected three numbers"));
        assert!(parse("--eye 1,2,nan").unwrap_err().contains("expected three numbers"));
        assert!(said("--fov 180").contains("expected 0.1 to 179 degrees for a pinhole view, found 180"));
        assert!(
            parse("--fov 361").unwrap_err().contains("expected 0.1 to 179 degrees, or to 360 for a fisheye")
        );
        assert!(parse("--ortho-height 2 --fov 30").unwrap_err().contains("cannot be used with"));
        assert!(parse("--ortho-height 0").unwrap_err().contains("expected a positive number of world units"));
        let check =
            |words: &str, cameras| parse(words).unwrap().check(cameras).map_err(|error| error.to_string());
        let said = check("--eye 1,2,3", Some("a.json")).unwrap_err();
        assert!(said.starts_with("--eye cannot be used with --cameras"), "{said}");
        assert_eq!(
            check("--up cameras", None).unwrap_err(),
            "expected --cameras with --up cameras, found none"
        );
        assert_eq!(check("--up z --orbit 2", None), Ok(()));
        assert!(parse("").unwrap().names().is_none());
    }
}
