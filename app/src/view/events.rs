//! Defines the viewer's events, for the log in the window and for `--events` (one JSON object per line).

use super::renderer::{RendererEvent, Swap};
use serde::Serialize;
use std::fmt;
use std::path::PathBuf;

/// Renderer that an event concerns.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum RendererId {
    /// The renderer of the scene: it fills the view, or the part left of the split line.
    A,
    /// The renderer of the comparison.
    B,
    /// The renderer of the window's own graph, which draws the pictures and the user interface.
    Window,
}

impl fmt::Display for RendererId {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self {
            RendererId::A => "A",
            RendererId::B => "B",
            RendererId::Window => "window",
        })
    }
}

/// An event in the viewer, for the log in the window and for `--events`.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Event {
    /// A new plan replaced the previous one; see [`Swap`].
    Swapped {
        /// Renderer whose plan was replaced.
        renderer: RendererId,
        /// Reason for the new plan and the times of its build.
        #[serde(flatten)]
        swap: Swap,
    },
    /// A plan could not be built, or a frame drawn; the previous plan and picture stay.
    Failed {
        /// Renderer that failed.
        renderer: RendererId,
        /// Error messages, without colours.
        text: String,
    },
    /// A plan was built, or a frame drawn, for the first time after a failure.
    Mended {
        /// Renderer that works again.
        renderer: RendererId,
    },
    /// Settings were dropped: the new graph lacks their parameters, sets them itself, or excludes their values.
    Dropped {
        /// Renderer with the new graph.
        renderer: RendererId,
        /// Names of the parameters.
        parameters: Vec<String>,
        /// The reasons.
        text: String,
    },
    /// Dropped settings apply again, because the new graph accepts them.
    Restored {
        /// Renderer with the new graph.
        renderer: RendererId,
        /// Names of the parameters.
        parameters: Vec<String>,
        /// The values.
        text: String,
    },
    /// A scene was loaded.
    Scene {
        /// Path of the scene.
        path: PathBuf,
        /// Number of splats in the scene.
        splats: u32,
        /// Loading time, in milliseconds.
        load_ms: f64,
    },
    /// A scene could not be loaded; the previous one stays.
    SceneFailed {
        /// Path of the scene.
        path: PathBuf,
        /// Cause of the failure.
        error: String,
    },
    /// Cameras were loaded.
    Cameras {
        /// Path of the cameras.
        path: PathBuf,
        /// Number of cameras.
        count: usize,
    },
    /// A file could not be read or written, or has an unknown type.
    FileFailed {
        /// Path of the file.
        path: PathBuf,
        /// Cause of the failure.
        error: String,
    },
    /// A file with cameras was written.
    Saved {
        /// Path of the written file.
        path: PathBuf,
    },
    /// A picture was written.
    Screenshot {
        /// Path of the written file.
        path: PathBuf,
    },
    /// Splats were selected or hidden.
    Marked {
        /// Number of selected splats after the change.
        selected: u32,
        /// Number of hidden splats after the change.
        hidden: u32,
    },
    /// Splats were written to a file.
    Exported {
        /// Path of the written file.
        path: PathBuf,
        /// Number of splats in the file.
        splats: u32,
        /// Size of the file, in bytes.
        bytes: u64,
        /// Properties of the scene that the file lacks.
        lost: Vec<String>,
    },
    /// The device or its window surface was lost, with everything on the device. The scene stays in host memory.
    DeviceLost {
        /// Error of the device.
        error: String,
    },
    /// A device was opened as a replacement for the lost one.
    DeviceOpened {
        /// Name of the device.
        name: String,
        /// Number of attempts to open it, including the successful one.
        attempts: u32,
    },
    /// A request could not be fulfilled; the viewer continues unchanged.
    Problem {
        /// Error message, with its context.
        text: String,
    },
    /// The device has been running one pass (on a CPU, one frame) for more than a second, which delays pictures.
    Slow {
        /// Name of the pass or frame.
        place: String,
    },
    /// A and B were exchanged: what earlier events report of A is now B's, and the reverse.
    Exchanged,
    /// A and B were compared.
    Compared {
        /// PSNR in decibels; infinite for identical pictures, which is `null` in JSON.
        psnr: f64,
        /// SSIM; `None` for pictures smaller than its window.
        ssim: Option<f64>,
        /// Largest difference in a colour channel, from 0 to 1.
        worst: f64,
        /// True if the pictures are identical as shown, clamped to 0..1.
        identical: bool,
    },
}

impl Event {
    /// Converts a renderer's event to a viewer's event.
    pub fn of(renderer: RendererId, event: RendererEvent) -> Event {
        match event {
            RendererEvent::Swapped(swap) => Event::Swapped { renderer, swap },
            RendererEvent::Failed(text) => Event::Failed { renderer, text },
            RendererEvent::Mended => Event::Mended { renderer },
            RendererEvent::Dropped { parameters, text } => Event::Dropped { renderer, parameters, text },
            RendererEvent::Restored { parameters, text } => Event::Restored { renderer, parameters, text },
        }
    }
}

impl fmt::Display for Event {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Event::Swapped { renderer, swap } => {
                let Swap { graph, causes, passes, plan_ms, prepare_ms, latency_ms } = swap;
                write!(
                    f,
                    "{renderer}: {graph} after {causes}: {latency_ms:.0} ms to its first frame ({passes} passes; plan \
                     {plan_ms:.0} ms, device {prepare_ms:.0} ms)"
                )
            }
            Event::Failed { renderer, text } => {
                write!(f, "{renderer}: {}", text.lines().next().unwrap_or_default())
            }
            Event::Mended { renderer } => write!(f, "{renderer}: mended"),
            Event::Dropped { renderer, text, .. } | Event::Restored { renderer, text, .. } => {
                write!(f, "{renderer}: {text}")
            }
            Event::Scene { path, splats, load_ms } => {
                let splats = splatgraph_assets::grouped((*splats).into());
                write!(f, "{}: {splats} splats in {load_ms:.0} ms", path.display())
            }
            Event::SceneFailed { path, error } | Event::FileFailed { path, error } => {
                // Most error messages already contain the file's name.
                let name = path.display().to_string();
                if error.contains(&name) { f.write_str(error) } else { write!(f, "{name}: {error}") }
            }
            Event::Cameras { path, count } => write!(f, "{}: {count} cameras", path.display()),
            Event::DeviceLost { error } => write!(f, "{error}"),
            Event::Problem { text } => f.write_str(text),
            Event::Exchanged => f.write_str("A and B exchanged"),
            Event::Slow { place } => write!(f, "{place} has been running for more than a second"),
            Event::DeviceOpened { name, attempts: 1 } => write!(f, "{name} was reopened"),
            Event::DeviceOpened { name, attempts } => {
                write!(f, "{name} was reopened at attempt {attempts}")
            }
            Event::Screenshot { path } | Event::Saved { path } => {
                // Files that are named automatically are in the working directory.
                let path = std::path::absolute(path).unwrap_or_else(|_| path.clone());
                write!(f, "{} written", path.display())
            }
            Event::Marked { selected, hidden } => {
                let count = |count: u32| splatgraph_assets::grouped(count.into());
                write!(f, "{} splats selected, {} hidden", count(*selected), count(*hidden))
            }
            Event::Exported { path, splats, bytes, lost } => {
                let count = splatgraph_assets::grouped;
                write!(f, "{}: {} splats, {} bytes", path.display(), count((*splats).into()), count(*bytes))?;
                if lost.is_empty() { Ok(()) } else { write!(f, "; lost: {}", lost.join("; ")) }
            }
            Event::Compared { psnr, ssim, worst, identical } => {
                write!(f, "A against B: {psnr:.2} dB PSNR, worst pixel {worst:.4}")?;
                ssim.map_or(Ok(()), |ssim| write!(f, ", SSIM {ssim:.4}"))?;
                f.write_str(if *identical { ": identical" } else { "" })
            }
        }
    }
}
