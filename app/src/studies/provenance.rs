//! Describes the program, the device, the scene and the views on which the numbers of a study depend.

use crate::draw::stats::CPU_TIMES;
use crate::io::program;
use crate::io::report::text;
use crate::studies::study::Subject;
use serde::{Deserialize, Serialize};
use splatgraph_api::Device;
use splatgraph_assets::{Camera, grouped};

/// The program, the device, the scene and the views of a study.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// The program's version and commit.
    pub version: String,
    /// The device and its driver.
    pub device: String,
    /// True for a device on the CPU, whose times of passes are unreliable.
    pub is_cpu: bool,
    /// Name of the scene, for headings: the same scene may have another path.
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
        let views = match self.cameras.len() {
            1 if missing.is_empty() => "one view".to_owned(),
            all if missing.is_empty() => format!("{all} views"),
            all => format!("{} of {all} views (missing: {}{more})", all - missing.len(), named.join(", ")),
        };
        format!(
            "`{}`, {} splats, {views}, on {}. Measured by splatgraph {}.",
            self.scene,
            grouped(self.splats.into()),
            self.device,
            self.version
        )
    }

    /// Formats a CSV, and appends the columns `device` and `program`. The header and the lines lack their line breaks.
    pub fn csv(&self, header: &str, lines: impl IntoIterator<Item = String>) -> String {
        text::csv(header, lines, &[("device", &self.device), ("program", &self.version)])
    }

    /// Returns the warning about times of phases; `None` on a GPU.
    pub fn note(&self) -> Option<&'static str> {
        self.is_cpu.then_some(CPU_TIMES)
    }
}
