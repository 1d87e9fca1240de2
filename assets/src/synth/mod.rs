//! Generates deterministic scenes: one for demonstration, and extreme ones for tests.
//!
//! [`generators`] lists them by name, with suitable cameras; [`generate`] generates one. [`enlarge()`] enlarges a
//! captured scene.

mod demo;
mod enlarge;
mod extremes;
mod random;
mod ring;

pub use demo::demo_cameras;
pub use enlarge::enlarge;
pub use ring::mesh;

use crate::camera::Camera;
use crate::error::nearest;
use crate::memory::SceneMemoryError;
use crate::scene::Scene;
use extremes::Made;

/// A generator of scenes.
#[derive(Clone, Copy, Debug)]
pub struct Generator {
    /// The name for [`generate`].
    pub name: &'static str,
    /// A one-line description of the scene.
    pub summary: &'static str,
    /// Default number of splats.
    pub default_count: u32,
    /// Returns suitable cameras in the scene's coordinates, 960 x 540; the best is first.
    pub cameras: fn() -> Vec<Camera>,
    make: fn(u32, u64) -> Made,
}

/// Name of the generated mesh, and a one-line description of it.
pub const MESH: (&str, &str) =
    ("ring", "a mesh for the demo scene (.glb): a bronze ring, upright and half sunk into the pond");

/// An error while generating a scene.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SynthError {
    /// No generator has the name.
    #[error("expected the name of a generated scene ({}), found `{name}`{}", names(), near(.name))]
    UnknownGenerator {
        /// The requested name.
        name: String,
    },
    /// The scene does not fit in memory.
    #[error(transparent)]
    Memory(#[from] SceneMemoryError),
}

fn names() -> String {
    generators().iter().map(|g| g.name).collect::<Vec<_>>().join(", ")
}

fn near(name: &str) -> String {
    let near = nearest(name, generators().iter().map(|g| g.name));
    near.map(|n| format!("; did you mean `{n}`?")).unwrap_or_default()
}

fn origin() -> Vec<Camera> {
    vec![extremes::camera()]
}

const fn extreme(name: &'static str, summary: &'static str, make: fn(u32, u64) -> Made) -> Generator {
    Generator { name, summary, default_count: 5_000, cameras: origin, make }
}

const fn layered(name: &'static str, summary: &'static str, make: fn(u32, u64) -> Made) -> Generator {
    Generator { name, summary, default_count: 4096, cameras: origin, make }
}

const GENERATORS: [Generator; 26] = [
    Generator {
        name: "demo",
        summary: "a lotus pond at dusk, with an iridescent knot above it: gloss, needles, mist and reflections",
        default_count: 200_000,
        cameras: demo_cameras,
        make: demo::demo,
    },
    Generator {
        name: "uniform",
        summary: "a ball evenly filled with splats of all shapes, all bands of the harmonics in use",
        default_count: 100_000,
        cameras: || vec![extremes::outside()],
        make: extremes::uniform,
    },
    extreme("needles", "needles and plates with axes in ratios of up to a million to 1", extremes::needles),
    extreme(
        "huge",
        "a cloud inside one splat that is a hundred times as large and holds the camera",
        extremes::huge,
    ),
    extreme("far", "a cloud with outliers up to a million units away", extremes::far),
    extreme("ties", "eight planes of splats that all have exactly the same depth", extremes::ties),
    extreme("faint", "splats whose opacity is within a thousandth of the floor of 1/255", extremes::faint),
    extreme("empty-view", "a cloud entirely behind the camera", extremes::empty_view),
    extreme("giants", "scales from e^-30 to e^20, each axis independent", extremes::giants),
    Generator {
        default_count: 10_000,
        ..extreme("coincident", "splats that all have the same centre", extremes::coincident)
    },
    extreme(
        "near-plane",
        "splats at the near plane, a float before and behind it, and around the camera",
        extremes::near_plane,
    ),
    extreme("logits", "opacities of 0, 4e-18 (the logit -40), 0.5 and 1", extremes::logits),
    extreme(
        "quaternions",
        "quaternions of lengths from denormal to the end of f32; a file holds them normalised",
        extremes::quaternions,
    ),
    extreme(
        "harmonics",
        "spherical harmonics of degree 3 with coefficients of up to 10,000",
        |count, seed| extremes::harmonics(count, seed, 1e4),
    ),
    layered("layers-opaque", "layers across the view that are nearly opaque", |count, seed| {
        extremes::layers(count, seed, 0.98)
    }),
    layered(
        "layers-faint",
        "layers across the view with an opacity just above the floor of 1/255",
        |count, seed| extremes::layers(count, seed, 0.0045),
    ),
    layered("layers-dark", "black layers across the view, as faint", extremes::layers_dark),
    layered(
        "floor",
        "layers whose opacities are the eight floats around the floor of 1/255; a file's logits hold two",
        extremes::floor,
    ),
    extreme("bright", "spherical harmonics of degree 3 with coefficients of up to 100,000", |count, seed| {
        extremes::harmonics(count, seed, 1e5)
    }),
    Generator {
        default_count: 18,
        cameras: || vec![extremes::crossing_camera()],
        ..extreme(
            "crossing",
            "plates that change places only where a camera looks across them",
            extremes::crossing,
        )
    },
    Generator {
        cameras: || vec![extremes::remote_camera()],
        ..extreme(
            "remote",
            "a cloud with details of a hundredth, ten thousand units from the origin",
            extremes::remote,
        )
    },
    extreme("surveyed", "the same cloud ten million units from the origin, in doubles", extremes::surveyed),
    Generator {
        cameras: || vec![extremes::two_clouds_camera()],
        ..extreme("two-clouds", "two clouds ten million units apart, in doubles", extremes::two_clouds)
    },
    Generator {
        cameras: || vec![extremes::telephoto_camera(1e6, 1.0)],
        ..extreme("telephoto", "a ball of one unit, seen from a million units away", extremes::uniform)
    },
    Generator {
        cameras: || vec![extremes::telephoto_camera(1.0, 1e-6)],
        ..extreme(
            "millionth",
            "a ball of a millionth of a unit, seen from one unit away",
            extremes::millionth,
        )
    },
    Generator {
        default_count: 20_000,
        cameras: || vec![extremes::askew_camera()],
        ..extreme("askew", "splats of one depth, on a plane askew to the axes", extremes::askew)
    },
];

/// Lists all generators.
pub fn generators() -> &'static [Generator] {
    &GENERATORS
}

/// Generates the scene `name` with `count` splats. Equal arguments give equal scenes.
///
/// # Errors
/// No generator has that name (the message offers the most similar one), or the scene does not fit in memory.
pub fn generate(name: &str, count: u32, seed: u64) -> Result<Scene, SynthError> {
    let generator = generators().iter().find(|g| g.name == name);
    let generator = generator.ok_or_else(|| SynthError::UnknownGenerator { name: name.into() })?;
    Ok((generator.make)(count, seed)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Report;

    fn make(name: &str, count: u32) -> Scene {
        generate(name, count, 0).unwrap()
    }

    #[test]
    fn every_scene_has_the_number_of_splats_asked_for_and_none_dropped() {
        for generator in generators() {
            for count in [0, 1, 37, 3000] {
                let scene = make(generator.name, count);
                assert_eq!((scene.count(), scene.dropped().total()), (count, 0), "{}", generator.name);
            }
            assert!(!(generator.cameras)().is_empty());
            assert!(!Report::new(&make(generator.name, 0), &[]).to_string().contains("NaN"));
        }
    }

    #[test]
    fn the_same_seed_gives_the_same_scene_and_another_seed_another() {
        for generator in generators() {
            let identity = |seed| generate(generator.name, 2000, seed).unwrap().identity();
            assert_eq!(identity(5), identity(5), "{}", generator.name);
            assert_ne!(identity(5), identity(6), "{}", generator.name);
        }
    }

    #[test]
    fn a_name_that_is_not_there_is_answered_with_the_nearest() {
        let error = generate("needels", 1, 0).unwrap_err().to_string();
        assert!(error.contains("did you mean `needles`?") && error.contains("empty-view"), "{error}");
    }

    #[test]
    fn the_extremes_are_as_extreme_as_they_say() {
        let ratios = |s: &[f32; 3]| s[0] / s[2];
        assert!(make("needles", 3000).scales().iter().map(ratios).fold(0.0, f32::max) > 9e5);
        let report = |name: &str| {
            let generator = generators().iter().find(|g| g.name == name).unwrap();
            Report::new(&make(name, 3000), &(generator.cameras)())
        };
        assert_eq!(report("huge").size.oversized, 1);
        assert!(report("far").place.outliers > 20);
        assert!(report("far").depth[0].range.unwrap().linear_bits_lost > 10.0);
        assert!((1000..2000).contains(&report("faint").opacity.below_floor));
        assert_eq!(report("empty-view").depth[0].in_front, 0);
        let ties = make("ties", 3000);
        let camera = extremes::camera();
        let forward = camera.axes()[2];
        assert_eq!(forward, [0.0, 0.0, 1.0]);
        assert!(ties.positions().chunks_exact(8).all(|planes| planes[3][2] == 3.5));
        assert_eq!(make("uniform", 3000).effective_degree(), 3);
        let giants = make("giants", 3000);
        let logs = giants.scales().as_flattened().iter().map(|s| f64::from(*s).ln());
        let (least, most) =
            logs.fold((0.0, 0.0), |(least, most): (f64, f64), log| (least.min(log), most.max(log)));
        assert!(least < -29.5 && most > 19.5, "{least} {most}");
        let norms = make("quaternions", 3000).quaternion_norms();
        assert!(norms.min < f64::from(f32::MIN_POSITIVE) && norms.max > 1e37, "{norms:?}");
        let near = make("near-plane", 3000);
        let depths = |z: f32| near.positions().iter().filter(|p| p[2] == z).count();
        assert!([0.2f32, 0.2f32.next_up(), 0.2f32.next_down()].into_iter().all(|z| depths(z) == 500));
        let two = make("two-clouds", 3000);
        assert!(two.is_wide() && two.position(0)[0] > 5e6 && two.position(1)[0] < -4e6);
        assert!(!make("surveyed", 3000).is_wide(), "its rounding is invisible");
        assert!(make("millionth", 3000).bounds().max.iter().all(|v| (5e-7..1.1e-6).contains(v)));
        assert!(make("remote", 30).positions().iter().all(|p| p[0] > 9990.0 && p[1] < -9990.0));
    }
}
