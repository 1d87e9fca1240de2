//! Opens the window, passes winit's events to a [`Shell`], and presents the shell's frames.
//!
//! The window sleeps until an event or the time of the next frame ([`Frame::next`]), polls frames in flight at
//! intervals, and does not draw while it is minimised or covered. While nothing can be drawn, its title gives the
//! reason.
//!
//! [`Frame::next`]: super::shell::Frame::next

mod dialog;
mod display;
mod editor;
mod event_log;
mod pictures;
mod running;

use super::events::Event;
use super::kept;
use super::recovery::{Open, Recovery};
use super::shell::Shell;
use super::viewer::Viewer;
use crate::draw::backend::{Api, Backend, Options};
use crate::io::output::Log;
use anyhow::Result;
pub use display::is_left_open;
use display::own;
use event_log::EventLog;
use running::{Closing, Running, title};
use splatgraph_api::Device;
use splatgraph_assets::Scene;
use std::mem::ManuallyDrop;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;
use winit::application::ApplicationHandler;
use winit::dpi::PhysicalSize;
use winit::event::WindowEvent;
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoopProxy};
use winit::window::{Window, WindowId};

/// A function that sets the initial state of the shell, given the window's size in pixels.
pub type Setup<'a> = Box<dyn FnOnce(&mut Shell, (u32, u32)) -> Result<()> + 'a>;

/// Options of the window.
pub struct WindowOptions<'a> {
    /// The scene to open and the path of its file.
    pub scene: (Scene, PathBuf),
    /// Built-in name or path of the graph.
    pub pipeline: String,
    /// Names and values of parameters to change.
    pub set: Vec<(String, String)>,
    /// Size of the window's content, in pixels; reduced to fit on the display unless `exact_size`.
    pub size: (u32, u32),
    /// True to keep this size even if it does not fit on the display.
    pub exact_size: bool,
    /// Graphics API of the device.
    pub backend: Api,
    /// Selection of the device, and use of validation.
    pub device: Options,
    /// File that stores the arrangement between starts; `None` to use the default arrangement and save nothing.
    pub kept: Option<PathBuf>,
    /// Function that sets the initial state of the shell.
    pub setup: Setup<'a>,
    /// Destination of events, one JSON object per line; `None` to write none.
    pub events: Option<Log>,
    /// File for a picture of the window, saved once everything is built; the window then closes. `None` to save none.
    pub screenshot: Option<PathBuf>,
    /// Minimum number of frames before the screenshot is saved or the window closes; both also wait until everything is
    /// built. `None` means 3 with a screenshot; without one, the window stays open.
    pub frames: Option<u64>,
}

/// Opens the window and runs until it is closed. Returns the validation messages.
///
/// # Errors
/// No display is available, or it is gone; no device can present on it, or none can replace a lost one; the
/// initial state cannot be set, or cannot be shown in the requested screenshot or frames; or the program has a bug.
pub fn run(options: WindowOptions) -> Result<Vec<String>> {
    super::profile::start();
    let events = display::event_loop()?;
    let mut app =
        App { proxy: events.create_proxy(), options: Some(options), running: None, outcome: Ok(Vec::new()) };
    match display::guarded(|| events.run_app(&mut app)) {
        Ok(ended) => {
            ended?;
            app.outcome
        }
        Err(panic) => {
            if let Some(running) = &mut app.running {
                running.finish_export();
            }
            // The display is gone, or the panic left inconsistent state, so nothing can be closed normally.
            let _ = ManuallyDrop::new(app.running.take());
            Err(panic.into())
        }
    }
}

struct App<'a> {
    proxy: EventLoopProxy<()>,
    options: Option<WindowOptions<'a>>,
    running: Option<Running>,
    outcome: Result<Vec<String>>,
}

impl App<'_> {
    fn open(&mut self, target: &ActiveEventLoop, options: WindowOptions) -> Result<()> {
        let size = match options.exact_size {
            true => options.size,
            false => display::at_most(target, options.size),
        };
        let title = title(&options.scene.1);
        let attributes = Window::default_attributes()
            .with_title(&title)
            .with_inner_size(PhysicalSize::new(size.0, size.1));
        let window = display::Handle::open(target, attributes)?;
        let size = window.size();
        let (api, device, surface) = (options.backend, options.device, window.surface());
        let mut open: Open = Box::new(move |size| {
            let canvas = Backend::open_in_window(api, &device, surface.clone(), size)?;
            let scene = canvas.open_beside(&device)?;
            Ok((canvas, scene))
        });
        let (canvas, device) = open(size)?;
        display::set_open(true);
        let proxy = self.proxy.clone();
        // Sending fails only after the event loop has ended, when there is nothing to wake.
        let wake: super::renderer::Wake = Arc::new(move || {
            let _ = proxy.send_event(());
        });
        let viewer = Viewer::new(device, options.scene, &options.pipeline, &options.set, wake.clone())?;
        let mut shell = Shell::new(viewer, canvas, super::paint::GRAPH, wake.clone())?;
        let ctx = shell.context().clone();
        if let Some(path) = &options.kept
            && let Err(text) = kept::restore(path, &mut shell.panels, &ctx)
        {
            shell.report(Event::Problem { text });
        }
        (options.setup)(&mut shell, size)?;
        let input = window.with(|window| {
            let (id, scale) = (egui::ViewportId::ROOT, window.scale_factor() as f32);
            egui_winit::State::new(ctx, id, window, Some(scale), window.theme(), None)
        });
        self.running = Some(Running {
            shell,
            recovery: Recovery::new(open),
            input,
            window,
            covered: false,
            minimised: (false, Instant::now()),
            asked: true,
            redraw: true,
            next: None,
            look: None,
            earliest: Instant::now(),
            frames: 0,
            closing: Closing { screenshot: options.screenshot, frames: options.frames },
            log: options.events.map(EventLog::new),
            title,
            blind: None,
            slow: None,
            open: dialog::Dialog::new(wake.clone()),
            editor: editor::Editor::new(wake),
            kept: options.kept,
            keep: None,
            save: None,
            save_a: false,
            has_begun: false,
        });
        Ok(())
    }

    fn end(&mut self, target: &ActiveEventLoop, result: Result<()>) {
        let messages = self.running.take().map(|running| running.close()).unwrap_or_default();
        self.outcome = result.map(|()| messages);
        target.exit();
    }
}

impl ApplicationHandler<()> for App<'_> {
    fn resumed(&mut self, target: &ActiveEventLoop) {
        own(|| {
            if let Some(options) = self.options.take()
                && let Err(error) = self.open(target, options)
            {
                self.end(target, Err(error));
            }
        });
    }

    fn user_event(&mut self, _: &ActiveEventLoop, (): ()) {
        own(|| {
            if let Some(running) = &mut self.running {
                running.asked = true;
            }
        });
    }

    fn window_event(&mut self, target: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        own(|| self.take(target, event));
    }

    fn about_to_wait(&mut self, target: &ActiveEventLoop) {
        own(|| self.turn(target));
    }

    fn exiting(&mut self, _: &ActiveEventLoop) {
        own(|| {
            if let Some(running) = self.running.take() {
                let messages = running.close();
                if let Ok(outcome) = &mut self.outcome {
                    outcome.extend(messages);
                }
            }
        });
    }
}

impl App<'_> {
    fn take(&mut self, target: &ActiveEventLoop, event: WindowEvent) {
        let Some(running) = &mut self.running else { return };
        // egui must get every event, because the panels depend on it.
        running.asked |= running.window.with(|window| running.input.on_window_event(window, &event).repaint);
        match event {
            WindowEvent::CloseRequested if running.may_close() => self.end(target, Ok(())),
            WindowEvent::CloseRequested => running.asked = true,
            WindowEvent::Resized(size) => {
                if let Some(canvas) = running.shell.window_mut().device_mut() {
                    canvas.resize_window(size.width, size.height);
                }
                (running.asked, running.redraw) = (true, true);
            }
            WindowEvent::Occluded(covered) => {
                running.covered = covered;
                running.asked = true;
            }
            WindowEvent::RedrawRequested => {
                (running.asked, running.redraw) = (true, true);
                // Some systems send only this event while the user resizes the window.
                self.turn(target);
            }
            _ => {}
        }
    }

    fn turn(&mut self, target: &ActiveEventLoop) {
        let Some(running) = &mut self.running else { return };
        match running.turn() {
            Ok(true) => self.end(target, Ok(())),
            Ok(false) => target.set_control_flow(match running.wakes() {
                Some(time) => ControlFlow::WaitUntil(time),
                None => ControlFlow::Wait,
            }),
            Err(error) => self.end(target, Err(error)),
        }
    }
}
