//! Generates and finds the demo scene, which commands draw if no scene is given.
//!
//! The first use writes the scene as a `.ply`; later uses load that file. If it cannot be written, each use generates
//! the scene.

use crate::io::folders;
use crate::io::output::file::Cause;
use splatgraph_assets::{Camera, file, synth};
use std::env;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

/// Name of the demo scene's generator.
pub const NAME: &str = "demo";

/// Name of the demo scene's file. It contains a checksum of the file, because another build may generate another scene.
pub const FILE: &str = "demo-56f7d1c4.ply";

/// True on systems that generate [`FILE`] bit by bit. Other systems' mathematical functions may round differently.
const IS_EXACT: bool = cfg!(all(target_os = "linux", target_env = "gnu"));

/// Returns the demo scene's path: in `assets/splats/` of a checkout, otherwise in the user's cache folder.
///
/// `None` if there is no cache folder. The temporary folder is not used: its names are predictable, and another user
/// could plant a file.
pub fn path() -> Option<PathBuf> {
    let here = env::current_dir().unwrap_or_default();
    // Projects of users have folders with the other names of a checkout, such as pipelines/ and assets/.
    let in_checkout = |folder: &&Path| folder.join("app/src/io/demo.rs").is_file();
    match here.ancestors().find(in_checkout) {
        Some(root) => Some(root.join("assets/splats").join(FILE)),
        None => Some(folders::cache()?.join("splatgraph").join(FILE)),
    }
}

/// Returns true if the file at `path` has the checksum in its name. On systems whose mathematical functions round
/// differently, the generator's file has another checksum, and every file passes.
///
/// # Errors
/// The file cannot be read.
pub fn is_intact(path: &Path) -> io::Result<bool> {
    let (mut file, mut bytes, mut checksum) = (file::open(path)?, vec![0; 1 << 17], crc32fast::Hasher::new());
    loop {
        match file.read(&mut bytes)? {
            0 => return Ok(!IS_EXACT || FILE == format!("demo-{:08x}.ply", checksum.finalize())),
            count => checksum.update(&bytes[..count]),
        }
    }
}

/// Generates the demo scene, as the bytes of its file.
///
/// # Errors
/// There is not enough memory.
pub fn generate() -> Result<Vec<u8>, Cause> {
    let generator = synth::generators().iter().find(|g| g.name == NAME);
    let scene = synth::generate(NAME, generator.map_or(0, |g| g.default_count), 0)?;
    let mut bytes = Vec::new();
    scene.write_ply_to(&mut bytes)?;
    Ok(bytes)
}

/// Returns the initial camera of the demo scene; `None` if the generator has no cameras.
pub fn camera() -> Option<Camera> {
    synth::demo_cameras().into_iter().next()
}

#[cfg(test)]
mod tests {
    use super::*;
    use splatgraph_assets::Scene;

    #[test]
    fn its_file_is_a_complete_scene_with_the_checksum_in_its_name() {
        let bytes = generate().unwrap();
        let scene = Scene::parse(&bytes, splatgraph_assets::QUIET).unwrap();
        assert_eq!((scene.stored_degree(), scene.dropped().total()), (3, 0));
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), &bytes).unwrap();
        assert!(is_intact(file.path()).unwrap());
    }

    #[test]
    fn in_a_checkout_the_scene_lies_among_the_assets() {
        let path = path().unwrap();
        assert!(path.ends_with(Path::new("assets/splats").join(FILE)), "{}", path.display());
    }

    #[test]
    fn it_has_a_camera() {
        assert!(camera().is_some());
    }
}
