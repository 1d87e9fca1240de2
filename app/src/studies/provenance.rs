//! Describes the program, the device, the scene and the views on which the numbers of a study depend.

use crate::draw::stats::CPU_TIMES;
use crate::io::program;
use crate::io::report::text;
use crate::studies::study::Subject;
use serde::{Deserialize, Serialize};
use splatgraph_api::Device;
use splatgraph_assets::{Camera, grouped};
use std::ffi::OsStr;
use std::path::Path;

/// The program, the device, the scene and the views of a study.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// The program's version and commit.
    pub version: String,
    /// The device and its driver.
    pub device: String,
    /// True for a device on the CPU, whose times of passes are unreliable.
    pub is_cpu: bool,
    /// Path of the scene, or `demo`, for headings: the same scene may have another path.
    pub scene: String,
    /// Number of splats in the scene.
    pub splats: u32,
    /// Cameras, with the size of their pictures.
    pub cameras: Vec<Camera>,
}

/// Maximum number of missing views that a page names.
const MAX_NAMED: usize = 10;

impl Provenance {
    /// Collects the program, the device, the scene and the views of a subject.
    pub fn of(subject: &Subject) -> Provenance {
        Provenance {
            version: program::VERSION.into(),
            device: subject.device_name(),
            is_cpu: subject.device.info().is_cpu(),
            scene: subject.name.clone(),
            splats: subject.scene.count(),
            cameras: subject.cameras.clone(),
        }
    }

    /// Lists the names of the cameras that `is_measured` rejects.
    pub fn missing(&self, is_measured: impl Fn(&str) -> bool) -> Vec<String> {
        let names = self.cameras.iter().map(|camera| &camera.img_name);
        names.filter(|name| !is_measured(name)).cloned().collect()
    }

    /// Formats the head of a page. `missing` are the views without measurements.
    pub fn text(&self, missing: &[String]) -> String {
        let named: Vec<String> = missing.iter().take(MAX_NAMED).map(|name| format!("`{name}`")).collect();
        let more = if missing.len() > MAX_NAMED { ", ..." } else { "" };
        let mut views = self.views(missing.len());
        if !missing.is_empty() {
            views += &format!(" (missing: {}{more})", named.join(", "));
        }
        format!(
            "`{}`, {} splats, {views}, on {}. Measured by splatgraph {}.",
            self.scene,
            grouped(self.splats.into()),
            self.device,
            self.version
        )
    }

    fn views(&self, missing: usize) -> String {
        match (self.cameras.len(), missing) {
            (1, 0) => "one view".to_owned(),
            (all, 0) => format!("{all} views"),
            (all, missing) => format!("{} of {all} views", all.saturating_sub(missing)),
        }
    }

    /// Formats the scene's name, the graph and its parameters for titles, and the number of views if some are missing.
    pub fn title(&self, pipeline: &str, set: &[(String, String)], missing: usize) -> String {
        let name =
            Path::new(&self.scene).file_stem().map_or(self.scene.as_str().into(), OsStr::to_string_lossy);
        let views = if missing > 0 { self.views(missing) } else { String::new() };
        let mut parts = vec![name.into_owned(), pipeline.to_owned(), text::parameters(set), views];
        parts.retain(|part| !part.is_empty());
        parts.join(", ")
    }

    /// Formats a CSV, and appends the scene, the pictures' size, empty if the cameras' sizes differ, `more` columns, the
    /// device and the program. The header and the lines lack their line breaks.
    pub fn csv(
        &self,
        header: &str,
        lines: impl IntoIterator<Item = String>,
        more: &[(&str, String)],
    ) -> String {
        let size = |of: fn(&Camera) -> u32| {
            let first = of(self.cameras.first()?);
            self.cameras.iter().all(|camera| of(camera) == first).then_some(first)
        };
        let [width, height] = [size(|camera| camera.width), size(|camera| camera.height)].map(text::optional);
        let scene = [("scene", text::quoted(&self.scene)), ("width", width), ("height", height)];
        let program = [("device", text::quoted(&self.device)), ("program", text::quoted(&self.version))];
        text::csv(header, lines, &[&scene, more, &program].concat())
    }

    /// Returns the warning about times of phases; `None` on a GPU.
    pub fn note(&self) -> Option<&'static str> {
        self.is_cpu.then_some(CPU_TIMES)
    }
}
