//! Compares decoded values with those of PlayCanvas's `splat-transform` (npm) and of the package `spz` (PyPI).
//!
//! `SPLAT_TRANSFORM` is the command that runs splat-transform, by default `splat-transform`.
//! `SPZ_PYTHON` is a Python that has the packages `spz` and `numpy`, by default `python3`. `SPLATGRAPH_DATA` is the
//! folder of captured scenes.

#[path = "../../tests/captures.rs"]
mod captures;

use captures::{captures, not_run};
use glam::{DMat3, DQuat, DVec3};
use splatgraph_assets::{QUIET, Scene, SceneFormat, Splat, SpzVersion, harmonics};
use std::fs::File;
use std::io::Write;
use std::path::Path;
use std::process::Command;

/// Creates the command in an environment variable, split at blanks, or `program` if the variable is not set.
fn command(variable: &str, program: &str) -> Command {
    let line = std::env::var(variable).unwrap_or_else(|_| program.to_owned());
    let mut words = line.split_ascii_whitespace();
    let mut command = Command::new(words.next().unwrap_or(program));
    command.args(words);
    command
}

fn output(mut command: Command) -> Result<String, String> {
    let done = command.output().map_err(|error| error.to_string())?;
    let text = String::from_utf8_lossy(&done.stdout).into_owned();
    let error = String::from_utf8_lossy(&done.stderr);
    // splat-transform prints its version to the standard error.
    let text = if text.is_empty() { error.clone().into_owned() } else { text };
    if done.status.success() { Ok(text) } else { Err(format!("{}: {error}", done.status)) }
}

/// The largest differences between two scenes, in the order of [`Differences::NAMES`].
#[derive(Debug, Default)]
struct Differences([f64; 6]);

impl Differences {
    const NAMES: [&str; 6] =
        ["positions", "scales, relative", "rotations", "opacities", "band 0", "other bands"];

    /// Compares splat by splat. If `turned` is true, the axes of `theirs` are half a turn about x from those of `ours`.
    fn of(ours: &Scene, theirs: &Scene, turned: bool) -> Self {
        let mut most = Self::default();
        // The logits of 0 and 1 are infinite in a PLY, and such splats are dropped.
        let finite = |index: &usize| {
            ours.count() == theirs.count() || ours.opacities()[*index] > 0.0 && ours.opacities()[*index] < 1.0
        };
        let kept: Vec<usize> = (0..ours.count() as usize).filter(finite).collect();
        assert_eq!(kept.len(), theirs.count() as usize);
        for (other, index) in kept.into_iter().enumerate() {
            let (a, mut b) = (ours.splat(index), theirs.splat(other));
            if turned {
                turn(&mut b);
            }
            // A quaternion and its negative are one rotation.
            let dot: f32 = a.rotation.iter().zip(b.rotation).map(|(a, b)| a * b).sum();
            let relative = [0, 1, 2].map(|axis| a.scale[axis] / b.scale[axis]);
            most.add(0, &a.position, &b.position);
            most.add(1, &relative, &[1.0; 3]);
            let same = most.0[2];
            most.add(2, &a.rotation.map(|value| value * dot.signum()), &b.rotation);
            // The same ellipsoid can have its axes in another order, so covariances are compared.
            if most.0[2] > ANOTHER {
                most.0[2] = same;
                most.add(2, &covariance(&a), &covariance(&b));
            }
            most.add(3, &[a.opacity], &[b.opacity]);
            most.add(4, &a.sh[..3], &b.sh[..3]);
            most.add(5, &a.sh[3..], &b.sh[3..]);
        }
        most
    }

    fn add(&mut self, kind: usize, ours: &[f32], theirs: &[f32]) {
        for (a, b) in ours.iter().zip(theirs) {
            self.0[kind] = self.0[kind].max((f64::from(*a) - f64::from(*b)).abs());
        }
    }

    fn check(&self, what: &str, limits: [f64; 6]) {
        let found: Vec<String> =
            Self::NAMES.iter().zip(self.0).map(|(name, value)| format!("{name} {value:.1e}")).collect();
        let _ = writeln!(std::io::stderr(), "{what}: {}", found.join(", "));
        for ((name, found), limit) in Self::NAMES.iter().zip(self.0).zip(limits) {
            assert!(found <= limit, "{what}, {name}: expected at most {limit:e}, found {found:e}");
        }
    }
}

/// Difference of quaternions above which they may describe the same ellipsoid with its axes in another order.
const ANOTHER: f64 = 0.1;

/// Computes the covariance, relative to the largest variance.
fn covariance(splat: &Splat) -> [f32; 9] {
    let [w, x, y, z] = splat.rotation.map(f64::from);
    let axes = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w));
    let variances = DVec3::from(splat.scale.map(f64::from)).powf(2.0);
    let relative = variances / variances.max_element().max(f64::MIN_POSITIVE);
    (axes * DMat3::from_diagonal(relative) * axes.transpose()).to_cols_array().map(|v| v as f32)
}

/// Turns a splat half a turn about x, which changes only signs.
fn turn(splat: &mut Splat) {
    let direction = [0.48, 0.6, 0.64];
    let [here, there] = [direction, [direction[0], -direction[1], -direction[2]]].map(harmonics::basis);
    for (k, coefficients) in splat.sh.chunks_exact_mut(3).enumerate() {
        let sign = (here[k] / there[k]).round() as f32;
        coefficients.iter_mut().for_each(|value| *value *= sign);
    }
    for axis in [1, 2] {
        splat.position[axis] = -splat.position[axis];
        splat.rotation[axis + 1] = -splat.rotation[axis + 1];
    }
}

/// Limits for values that both programs decode from the same bytes.
///
/// Positions and harmonics above band 0 must be equal. The others pass through a logarithm, a logit, a
/// normalisation or a colour of the PLY. Other programs change opacities of 0 and 1 by 1e-6 before the logit.
const EQUAL: [f64; 6] = [0.0, 1e-6, 1e-6, 1.1e-6, 1e-6, 0.0];

fn load(path: &Path) -> Scene {
    Scene::load(path, QUIET).unwrap_or_else(|error| panic!("{error}"))
}

fn write(scene: &Scene, format: SceneFormat, path: &Path) {
    scene.write(format, QUIET, &mut File::create(path).unwrap()).unwrap();
}

#[test]
fn splat_transform_decodes_the_values_that_are_read() {
    let test = "splat_transform_decodes_the_values_that_are_read";
    let Some(captures) = captures(test) else { return };
    let mut asked = command("SPLAT_TRANSFORM", "splat-transform");
    asked.arg("--version");
    let Ok(version) = output(asked) else {
        return not_run(test, "splat-transform; set SPLAT_TRANSFORM to the command that runs it");
    };
    let version = version.trim().trim_start_matches("splat-transform ");
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let convert = |from: &Path, to: &Path| {
        let mut command = command("SPLAT_TRANSFORM", "splat-transform");
        command.args(["-q", "-w", "-g", "cpu"]).args([from, to]);
        output(command).unwrap_or_else(|error| panic!("{} to {}: {error}", from.display(), to.display()));
    };
    let compare = |path: &Path, limits: [f64; 6], what: &str| {
        let theirs = at("theirs.ply");
        convert(path, &theirs);
        let what = format!("{what}, decoded by splat-transform {version}");
        // splat-transform copies the axes of SPZ (right, up and back) to the PLY without a conversion.
        let turned = path.extension().is_some_and(|end| end == "spz");
        Differences::of(&load(path), &load(&theirs), turned).check(&what, limits);
    };
    for scene in ["biker", "playbot-31k"] {
        let original = captures.join(scene).with_extension("ply");
        let ours = load(&original);
        for (format, limits) in [
            (SceneFormat::Ply, EQUAL),
            (SceneFormat::CompressedPly, EQUAL),
            (SceneFormat::Spz, EQUAL),
            (SceneFormat::Sog, EQUAL),
            // A byte of a quaternion is `(u - 128) / 128` here, and `u / 127.5 - 1` in splat-transform.
            (SceneFormat::Splat, [EQUAL[0], EQUAL[1], 0.01, EQUAL[3], EQUAL[4], EQUAL[5]]),
        ] {
            let path = at(&format!("ours.{}", format.extension()));
            write(&ours, format, &path);
            compare(&path, limits, &format!("{scene} as .{}", format.extension()));
        }
        let path = at("ours3.spz");
        ours.write_spz(SpzVersion::V3, &mut File::create(&path).unwrap()).unwrap();
        compare(&path, EQUAL, &format!("{scene} as .spz, version 3"));
        // For a scene with harmonics, splat-transform takes minutes to choose the palette.
        let ends = ["compressed.ply", "spz", "sog"];
        for end in &ends[..if ours.stored_degree() > 0 { 2 } else { 3 }] {
            let path = at(&format!("written.{end}"));
            convert(&original, &path);
            compare(&path, EQUAL, &format!("{scene} as .{end}, written by splat-transform"));
        }
        // splat-transform writes glTF but does not read it, so the splats are compared with those of the PLY.
        let path = at("written.glb");
        convert(&original, &path);
        let what = format!("{scene} as .glb, written by splat-transform {version}");
        Differences::of(&load(&path), &ours, false).check(&what, EQUAL);
    }
}

/// Decodes an SPZ file to rows of floats.
///
/// A row has position, scale (a logarithm), rotation x, y, z, w, opacity (a logit), band 0, and the other bands with
/// the channels of each coefficient together. Version 0.0.1 of the package cannot be imported by its name, so its
/// library is loaded.
const DECODE: &str = r#"
import glob, importlib.util, os, sys
import numpy as np
folder = importlib.util.find_spec("spz").submodule_search_locations[0]
library = [path for path in glob.glob(os.path.join(folder, "spz.*")) if path.endswith((".so", ".pyd"))][0]
spec = importlib.util.spec_from_file_location("spz", library)
spz = importlib.util.module_from_spec(spec)
spec.loader.exec_module(spz)
if len(sys.argv) > 1:
    cloud = spz.load(sys.argv[1], spz.CoordinateSystem.RDF)
    n = cloud.num_points
    parts = [cloud.positions, cloud.scales, cloud.rotations, cloud.alphas, cloud.colors, cloud.spherical_harmonics]
    np.concatenate([part.reshape(n, -1) for part in parts], 1).astype("<f4").tofile(sys.argv[2])
"#;

#[test]
fn the_package_spz_decodes_the_values_that_are_read() {
    let test = "the_package_spz_decodes_the_values_that_are_read";
    let Some(captures) = captures(test) else { return };
    let python = |args: &[&Path]| {
        let mut command = command("SPZ_PYTHON", "python3");
        command.args(["-c", DECODE]).args(args);
        output(command)
    };
    if python(&[]).is_err() {
        return not_run(test, "the packages spz and numpy; set SPZ_PYTHON to a Python that has them");
    }
    let folder = tempfile::tempdir().unwrap();
    let [path, rows] = ["scene.spz", "rows"].map(|name| folder.path().join(name));
    for scene in ["biker", "playbot-31k"] {
        let original = load(&captures.join(scene).with_extension("ply"));
        original.write_spz(SpzVersion::V3, &mut File::create(&path).unwrap()).unwrap();
        python(&[&path, &rows]).unwrap();
        let ours = load(&path);
        let bytes = std::fs::read(&rows).unwrap();
        let floats: Vec<f32> =
            bytes.chunks_exact(4).map(|word| f32::from_le_bytes(word.try_into().unwrap())).collect();
        let width = floats.len() / ours.count() as usize;
        let theirs = Scene::generate(ours.count(), ours.stored_degree(), |index| {
            let row = &floats[index * width..][..width];
            let mut splat = ours.splat(index);
            splat.position.copy_from_slice(&row[..3]);
            splat.scale = [3, 4, 5].map(|at| f64::from(row[at]).exp() as f32);
            splat.rotation = [9, 6, 7, 8].map(|at| row[at]);
            splat.opacity = (1.0 / (1.0 + (-f64::from(row[10])).exp())) as f32;
            splat.sh[..width - 11].copy_from_slice(&row[11..]);
            splat
        });
        let what = format!("{scene} as .spz, version 3, decoded by the package spz");
        Differences::of(&ours, &theirs, false).check(&what, EQUAL);
    }
}
