//! Defines splats as the reference reads them: one at a time, in f64.

use splatgraph_assets::{Mesh, Scene};

/// One anisotropic 3D Gaussian with its activations applied.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gaussian {
    /// Centre, in world units.
    pub position: [f64; 3],
    /// Standard deviation along each of its axes, in world units.
    pub scale: [f64; 3],
    /// Unit quaternion w, x, y, z that rotates the splat's axes into the world; it is not normalised again.
    pub rotation: [f64; 4],
    /// Opacity at the centre, 0 to 1.
    pub opacity: f64,
    /// Spherical harmonics: coefficient `k` for red, green and blue; zero above the scene's degree.
    pub sh: [[f64; 3]; 16],
}

/// A list of splats that several threads can read.
pub trait Splats: Sync {
    /// Returns the number of splats.
    fn count(&self) -> usize;

    /// Returns splat `index`, which must be below [`Splats::count`].
    fn get(&self, index: usize) -> Gaussian;

    /// Returns true if f32 is too coarse for the positions, so that depths must be computed from f64 positions.
    fn is_wide(&self) -> bool {
        false
    }

    /// Returns the mesh to render with the splats; `None` without one.
    fn mesh(&self) -> Option<&Mesh> {
        None
    }
}

impl Splats for [Gaussian] {
    fn count(&self) -> usize {
        self.len()
    }

    fn get(&self, index: usize) -> Gaussian {
        self[index]
    }
}

impl Splats for Scene {
    fn count(&self) -> usize {
        Scene::count(self) as usize
    }

    fn get(&self, index: usize) -> Gaussian {
        let splat = self.splat(index);
        Gaussian {
            position: self.position(index),
            scale: splat.scale.map(f64::from),
            rotation: splat.rotation.map(f64::from),
            opacity: f64::from(splat.opacity),
            sh: std::array::from_fn(|k| std::array::from_fn(|channel| f64::from(splat.sh[3 * k + channel]))),
        }
    }

    fn is_wide(&self) -> bool {
        Scene::is_wide(self)
    }

    fn mesh(&self) -> Option<&Mesh> {
        Scene::mesh(self)
    }
}
