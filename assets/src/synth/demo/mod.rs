//! Generates the demo scene: a lotus on a pond at dusk, and an iridescent knot above it.
//!
//! The knot and the petals are thin, elongated splats that follow a surface, with gloss that moves with the view (bands
//! 1 to 3 of the harmonics). Reeds are needles. Mist, water and glow are large and nearly transparent, so a pixel has
//! many layers. The reflection in the water consists of splats mirrored below the surface, with mirrored harmonics.
//!
//! Water is at y = 0 and up is -y; the sun sets behind, at +z and to the left.

mod knot;
mod lotus;
mod materials;
mod particles;
mod pond;
mod surface;

use super::random::Random;
use crate::camera::Camera;
use crate::memory::{self, SceneMemoryError};
use crate::scene::{Scene, Splat};

struct Part {
    /// Share of the splats, in thousandths.
    share: u32,
    make: fn(&mut Random, usize) -> Vec<Splat>,
    /// True if the water mirrors the part.
    mirrored: bool,
}

/// Parts of the scene. The reflection gets the rest of the splats.
const PARTS: [Part; 12] = [
    Part { share: 235, make: knot::knot, mirrored: true },
    Part { share: 165, make: lotus::petals, mirrored: true },
    Part { share: 25, make: lotus::heart, mirrored: true },
    Part { share: 85, make: pond::lily_pads, mirrored: false },
    Part { share: 90, make: pond::water, mirrored: false },
    Part { share: 100, make: pond::reeds, mirrored: true },
    Part { share: 14, make: particles::drifting_petals, mirrored: true },
    Part { share: 14, make: particles::dust, mirrored: true },
    Part { share: 3, make: particles::fireflies, mirrored: true },
    Part { share: 1, make: particles::mist, mirrored: false },
    Part { share: 28, make: particles::hills, mirrored: true },
    Part { share: 22, make: particles::sky, mirrored: true },
];

/// Generates the scene. Splats are smaller in a scene of more splats, so that every count covers the surfaces.
pub(super) fn demo(count: u32, seed: u64) -> Result<Scene, SceneMemoryError> {
    // Three lists: all splats, the mirrored ones, and those of the part being generated.
    let needed = u64::from(count) * (3 * size_of::<Splat>() as u64) + Scene::host_bytes(count.into(), 3);
    SceneMemoryError::check_against(count.into(), 3, needed, memory::available())?;
    let count = count as usize;
    let mut splats = Vec::with_capacity(count);
    let mut mirrored = Vec::new();
    for (number, part) in PARTS.iter().enumerate() {
        let share = count * part.share as usize / 1000;
        let made = (part.make)(&mut Random::new(seed, number as u64), share);
        assert_eq!(made.len(), share);
        if part.mirrored {
            mirrored.extend_from_slice(&made);
        }
        splats.extend(made);
    }
    let left = count - splats.len();
    splats.extend(pond::reflection(&mut Random::new(seed, 99), &mirrored, left));
    // Without a splat in any mirrored part there is no reflection: the knot gets the remaining splats.
    let missing = count - splats.len();
    splats.extend(knot::knot(&mut Random::new(seed, 0), missing));
    Scene::try_generate(count as u32, 3, |index| splats[index])
}

/// Returns four views of the demo scene, 960 x 540: the whole, the knot, the lotus, and from behind.
pub fn demo_cameras() -> Vec<Camera> {
    let view = |id, name: &str, eye, target, fov| Camera {
        id,
        img_name: name.into(),
        ..Camera::looking_at(eye, target, fov, (960, 540))
    };
    vec![
        view(0, "pond", [1.6, -1.30, -5.6], [0.0, -0.66, 0.0], 57.0),
        view(1, "knot", [-1.25, -1.80, -1.60], [0.0, -1.50, 0.0], 56.0),
        view(2, "lotus", [0.75, -1.02, -1.62], [0.0, -0.24, 0.0], 58.0),
        view(3, "lee", [1.55, -0.62, 2.75], [0.0, -0.93, 0.0], 70.0),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_leave_something_for_the_reflection() {
        assert!((700..1000).contains(&PARTS.iter().map(|p| p.share).sum::<u32>()));
    }

    #[test]
    fn each_view_has_in_the_picture_what_it_is_named_after() {
        let scene = demo(20_000, 0).unwrap();
        assert_eq!(scene.effective_degree(), 3);
        // The knot's splats come first, then the petals'.
        let (knot, petals) = (0..4700, 4700..8000);
        for (camera, things) in demo_cameras().iter().zip([
            vec![knot.clone(), petals.clone()],
            vec![knot.clone()],
            vec![petals.clone()],
            vec![knot.clone(), petals.clone()],
        ]) {
            let inside = |p: &&[f32; 3]| {
                let [x, y, z] = camera.to_view(p.map(f64::from));
                z > 0.2 && (camera.fx * x / z).abs() < 480.0 && (camera.fy * y / z).abs() < 270.0
            };
            for thing in things {
                let splats = &scene.positions()[thing];
                let seen = splats.iter().filter(inside).count();
                assert!(seen * 10 > splats.len() * 9, "{}: {seen} of {}", camera.img_name, splats.len());
            }
        }
    }
}
