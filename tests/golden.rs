//! Scenes with images drawn by the published CUDA rasteriser.
//!
//! The scene `rules` is in the repository, with an eighth of each image's pixels (`assets/golden/README.md`). The whole
//! images and the captured scenes are found through `SPLATGRAPH_DATA`.

use crate::common;
use splatgraph::draw::blind;
use splatgraph::io::image::Image;
use splatgraph_assets::{Camera, Scene, synth};
use splatgraph_reference::Rules;
use splatgraph_reference::metrics::{self, Comparison};
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

pub struct Golden {
    pub name: &'static str,
    scenes: PathBuf,
    images: PathBuf,
    /// True if the images contain only the pixels of [`sampled`].
    sampled: bool,
    scene: OnceLock<Arc<Scene>>,
}

impl Golden {
    pub fn rules() -> Golden {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets/golden");
        Golden {
            name: "rules",
            scenes: folder.clone(),
            images: folder,
            sampled: true,
            scene: OnceLock::new(),
        }
    }

    pub fn whole(data: &Path, name: &'static str) -> Golden {
        let (scenes, images) = (data.join("scenes"), data.join("golden"));
        Golden { name, scenes, images, sampled: false, scene: OnceLock::new() }
    }

    /// Returns every scene with whole images. Without the data folder, returns `rules` and reports the others as not
    /// run.
    pub fn all(test: &str) -> Vec<Golden> {
        match common::data(&format!("{test}, for captures,")) {
            Some(data) => ["biker", "playbot-31k", "rules"].map(|name| Golden::whole(&data, name)).into(),
            None => vec![Golden::rules()],
        }
    }

    pub fn path(&self) -> PathBuf {
        self.scenes.join(format!("{}.ply", self.name))
    }

    pub fn scene(&self) -> Arc<Scene> {
        let load = || Scene::load(self.path(), splatgraph_assets::QUIET).expect("the scene loads");
        self.scene.get_or_init(|| Arc::new(load())).clone()
    }

    pub fn cameras(&self) -> Vec<Camera> {
        let path = self.scenes.join(format!("{}.cameras.json", self.name));
        Camera::load(path).expect("the cameras load")
    }

    pub fn compare(&self, found: &Image, image: &str) -> Comparison {
        let golden = self.image(image);
        let found = if self.sampled { &sampled(found) } else { found };
        metrics::compare(found.into(), (&golden).into()).expect("images of one size")
    }

    fn image(&self, image: &str) -> Image {
        let archive = self.images.join(format!("{}.npz", self.name));
        Image::load(Path::new(&format!("{}#{image}", archive.display()))).expect("the golden image loads")
    }
}

/// Keeps the pixels where (x + 3 y) mod 8 = 0, an eighth of each row.
fn sampled(whole: &Image) -> Image {
    assert_eq!(whole.width % 8, 0, "every row has as many pixels");
    let rows = whole.rgb.chunks_exact(whole.width).enumerate();
    let rgb = rows.flat_map(|(y, row)| {
        let kept = move |(x, _): &(usize, &[f32; 3])| (x + 3 * y) % 8 == 0;
        row.iter().enumerate().filter(kept).map(|(_, pixel)| *pixel)
    });
    Image { width: whole.width / 8, height: whole.height, rgb: rgb.collect() }
}

#[test]
fn the_golden_images_of_the_repository_are_those_of_the_data_folder_to_the_bit() {
    const TEST: &str = "the_golden_images_of_the_repository_are_those_of_the_data_folder_to_the_bit";
    let Some(data) = common::data(TEST) else { return };
    let (here, whole) = (Golden::rules(), Golden::whole(&data, "rules"));
    let read = |golden: &Golden| std::fs::read(golden.path()).expect("the scene is read");
    assert!(read(&here) == read(&whole), "the scenes differ");
    assert_eq!(here.cameras(), whole.cameras());
    for index in 0..here.cameras().len() {
        let name = format!("camera{index}");
        let bits = |image: Image| image.rgb.as_flattened().iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        assert!(bits(here.image(&name)) == bits(sampled(&whole.image(&name))), "{name} differs");
    }
}

#[test]
fn no_camera_of_a_capture_or_the_demo_is_said_to_lose_much_to_the_near_plane() {
    let captures = Golden::all("no_camera_of_a_capture_or_the_demo_is_said_to_lose_much_to_the_near_plane");
    let demo = synth::generate("demo", 50_000, 0).expect("the demo scene");
    let all = captures.iter().map(|golden| (golden.scene(), golden.cameras()));
    for (scene, cameras) in all.chain([(demo.into(), synth::demo_cameras())]) {
        let views: Vec<_> = cameras.iter().map(|camera| (camera, Rules::of_view(&scene, camera))).collect();
        assert_eq!(blind::cut(&scene, &views), None);
    }
}
