//! Opens the window: winit's events go into a [`Shell`], and its frames onto the display.
//!
//! The window draws continuously, at the display's rate or, without vsync, the device's, so that the shown times are those of a
//! busy device. While it is minimised or covered, it does not draw.

use super::events::Event;
use super::panels::{Command, Controls};
use super::shell::{FrameRequest, Shell};
use super::viewer::Viewer;
use crate::backend::{Backend, Options};
use crate::output::{Log, one_line};
use crate::session::image_of;
use anyhow::{Context as _, Result, anyhow, bail};
use egui::RawInput;
use serde::Serialize;
use splatgraph_api::{Pixels, Windowed};
use splatgraph_assets::{Camera, Scene};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};
use winit::application::ApplicationHandler;
use winit::dpi::PhysicalSize;
use winit::event::{StartCause, WindowEvent};
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop, EventLoopProxy};
use winit::window::{Fullscreen, Window, WindowId};

/// Interval of checks for a hidden window to reappear.
const IDLE: Duration = Duration::from_millis(100);

/// Interval of frames before the first plan, whose build needs the processor.
const BUILDING: Duration = Duration::from_millis(10);

/// A function that sets the initial state of the shell.
pub type Setup = Box<dyn FnOnce(&mut Shell<Backend>) -> Result<()>>;

/// The options of the window.
pub struct WindowOptions {
    /// The scene and its file.
    pub scene: (Scene, PathBuf),
    /// Name or path of the graph.
    pub pipeline: String,
    /// Parameters to change.
    pub set: Vec<(String, String)>,
    /// Selectable cameras.
    pub cameras: Vec<Camera>,
    /// Size of the window's content, in pixels.
    pub size: (u32, u32),
    /// The device, and its validation.
    pub device: Options,
    /// True to wait for the display's refresh.
    pub vsync: bool,
    /// Sets the initial state of the shell.
    pub setup: Setup,
    /// Destination of events, one JSON object per line.
    pub events: Option<Log>,
    /// File for the window's picture, saved once everything is built; the window then closes.
    pub screenshot: Option<PathBuf>,
    /// Least number of frames before that; without a screenshot, the number of frames after which the window closes.
    pub frames: Option<u64>,
}

/// Opens the window and runs until it is closed. Returns the validation messages.
///
/// # Errors
/// There is no display, no device that can present on it, or the device fails.
pub fn run(options: WindowOptions) -> Result<Vec<String>> {
    super::profile::start();
    let events = EventLoop::new().map_err(|error| {
        // The text before it is a place in winit's source.
        let error = error.to_string();
        let why = error.rsplit(": ").next().unwrap_or_default().trim_end_matches('.');
        anyhow!("there is no display to open a window on ({why}); `splatgraph render` draws without one")
    })?;
    let mut app =
        App { proxy: events.create_proxy(), options: Some(options), running: None, outcome: Ok(Vec::new()) };
    events.run_app(&mut app)?;
    app.outcome
}

struct App {
    proxy: EventLoopProxy<()>,
    options: Option<WindowOptions>,
    running: Option<Running>,
    outcome: Result<Vec<String>>,
}

struct Running {
    shell: Shell<Backend>,
    input: egui_winit::State,
    window: Arc<Window>,
    covered: bool,
    /// True for a minimised window, and the time of that check; not every window system reports changes.
    minimised: (bool, Instant),
    /// True if the last frame was drawn.
    drawn: bool,
    frames: u64,
    closing: Closing,
    log: Option<EventLog>,
    /// File for the next frame's picture.
    save: Option<PathBuf>,
    /// File for the next picture of A.
    save_a: Option<PathBuf>,
}

/// The conditions for closing the window.
struct Closing {
    screenshot: Option<PathBuf>,
    frames: Option<u64>,
}

impl App {
    fn open(&mut self, target: &ActiveEventLoop, options: WindowOptions) -> Result<()> {
        let attributes = Window::default_attributes()
            .with_title(title(&options.scene.1))
            .with_inner_size(PhysicalSize::new(options.size.0, options.size.1));
        let window = Arc::new(target.create_window(attributes).context("the window cannot be opened")?);
        let size = window.inner_size();
        let mut canvas = Backend::open_in_window(&options.device, window.clone(), (size.width, size.height))?;
        canvas.set_vsync(options.vsync);
        let proxy = self.proxy.clone();
        // An event loop that has ended need not wake up.
        let wake: super::renderer::Wake = Arc::new(move || {
            let _ = proxy.send_event(());
        });
        let device = splatgraph_api::Device::new_context(&canvas)?;
        let mut viewer = Viewer::new(device, options.scene, &options.pipeline, &options.set, wake.clone())?;
        viewer.set_cameras(options.cameras);
        let mut shell = Shell::new(viewer, canvas, wake)?;
        shell.panels.vsync = options.vsync;
        (options.setup)(&mut shell)?;
        let input = egui_winit::State::new(
            shell.context().clone(),
            egui::ViewportId::ROOT,
            &window,
            Some(window.scale_factor() as f32),
            window.theme(),
            None,
        );
        window.request_redraw();
        self.running = Some(Running {
            shell,
            input,
            window,
            covered: false,
            minimised: (false, Instant::now()),
            drawn: false,
            frames: 0,
            closing: Closing { screenshot: options.screenshot, frames: options.frames },
            log: options.events.map(EventLog::new),
            save: None,
            save_a: None,
        });
        Ok(())
    }

    /// Ends the program, with an error or without.
    fn end(&mut self, target: &ActiveEventLoop, result: Result<()>) {
        let closed = self.running.take().map(Running::close).transpose();
        self.outcome = result.and(closed.map(Option::unwrap_or_default));
        target.exit();
    }
}

impl ApplicationHandler<()> for App {
    fn resumed(&mut self, target: &ActiveEventLoop) {
        if let Some(options) = self.options.take()
            && let Err(error) = self.open(target, options)
        {
            self.end(target, Err(error));
        }
    }

    fn user_event(&mut self, _: &ActiveEventLoop, (): ()) {
        if let Some(running) = &self.running {
            running.window.request_redraw();
        }
    }

    fn window_event(&mut self, target: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        let Some(running) = &mut self.running else { return };
        // The panels read the result from egui.
        let _ = running.input.on_window_event(&running.window, &event);
        match event {
            WindowEvent::CloseRequested => self.end(target, Ok(())),
            WindowEvent::Resized(size) => {
                running.shell.canvas_mut().resize_window(size.width, size.height);
                running.window.request_redraw();
            }
            WindowEvent::Occluded(covered) => running.covered = covered,
            WindowEvent::RedrawRequested => match running.draw() {
                Ok(false) => {}
                Ok(true) => self.end(target, Ok(())),
                Err(error) => self.end(target, Err(error)),
            },
            _ => {}
        }
    }

    fn about_to_wait(&mut self, target: &ActiveEventLoop) {
        let Some(running) = &mut self.running else { return };
        let sleep = |time| ControlFlow::WaitUntil(Instant::now() + time);
        target.set_control_flow(if running.shows_nothing() {
            sleep(IDLE)
        } else if !running.drawn {
            sleep(BUILDING)
        } else {
            running.window.request_redraw();
            ControlFlow::Poll
        });
    }

    fn new_events(&mut self, _: &ActiveEventLoop, cause: StartCause) {
        if let (StartCause::ResumeTimeReached { .. }, Some(running)) = (cause, &self.running) {
            running.window.request_redraw();
        }
    }

    fn exiting(&mut self, _: &ActiveEventLoop) {
        if let Some(running) = self.running.take()
            && let (Ok(messages), Ok(outcome)) = (running.close(), &mut self.outcome)
        {
            outcome.extend(messages);
        }
    }
}

impl Running {
    fn shows_nothing(&mut self) -> bool {
        if self.minimised.1.elapsed() >= IDLE {
            self.minimised = (self.window.is_minimized() == Some(true), Instant::now());
        }
        let size = self.window.inner_size();
        self.covered || self.minimised.0 || size.width == 0 || size.height == 0
    }

    /// Draws a frame; returns true if the window must close.
    fn draw(&mut self) -> Result<bool> {
        if self.shows_nothing() {
            return Ok(false);
        }
        let size = self.window.inner_size();
        let input: RawInput = self.input.take_egui_input(&self.window);
        // Everything is built, so the frame shows the requested state.
        let settled = self.frames >= self.closing.frames.unwrap_or(3) && !self.shell.viewer.busy();
        let mut close = settled && (self.closing.screenshot.is_some() || self.closing.frames.is_some());
        if settled && let Some(path) = &self.closing.screenshot {
            self.save = Some(path.clone());
        }
        let request = FrameRequest {
            size: (size.width, size.height),
            pixels_per_point: egui_winit::pixels_per_point(self.shell.context(), &self.window),
            present: true,
            read: self.save.is_some(),
        };
        let frame = self.shell.frame(input, request)?;
        if let Some(failure) = self.shell.is_blind() {
            bail!("the window's own graph cannot be drawn\n{}", failure.text(false));
        }
        self.input.handle_platform_output(&self.window, frame.platform);
        if let Some(pixels) = frame.picture
            && let Some(path) = self.save.take()
        {
            let saved = self.save_picture(&pixels, &path);
            if close && saved.is_err() {
                return saved.with_context(|| format!("{} cannot be written", path.display())).map(|()| true);
            }
        }
        if let Some(path) = self.save_a.clone()
            && let Some(pixels) = self.shell.viewer.a.take_picture()
        {
            self.save_a = None;
            // The window shows the error.
            let _ = self.save_picture(&pixels, &path);
        }
        close &= self.save.is_none();
        for command in frame.commands {
            self.apply(command);
        }
        self.drawn = frame.drawn;
        self.frames += u64::from(frame.drawn);
        let events = self.shell.take_events();
        if let Some(log) = &mut self.log {
            log.write(events, &self.shell.panels.controls, &request)?;
            if frame.drawn {
                log.write_line(&Event::Frame { number: self.frames, busy: self.shell.viewer.busy() })?;
            }
            log.out.flush();
        }
        Ok(close)
    }

    fn apply(&mut self, command: Command) {
        match command {
            Command::Screenshot => self.save = Some(fresh_name("splatgraph-window")),
            Command::SavePicture => {
                self.shell.viewer.a.want_picture();
                self.save_a = Some(fresh_name("splatgraph"));
            }
            Command::Vsync(vsync) => self.shell.canvas_mut().set_vsync(vsync),
            Command::Fullscreen => {
                let full = self.window.fullscreen().is_none();
                self.window.set_fullscreen(full.then_some(Fullscreen::Borderless(None)));
            }
            Command::Capture => {
                if let Err(error) = super::profile::capture_next_frame() {
                    self.shell.report(Event::FileFailed { path: "RenderDoc".into(), error });
                }
            }
        }
    }

    /// Saves a picture and reports the result.
    fn save_picture(&mut self, pixels: &Pixels, path: &Path) -> Result<()> {
        let saved = match image_of(pixels) {
            Some(image) => image.save(path).map_err(Into::into),
            None => Err(anyhow!("the graph's output has no colours")),
        };
        let path = path.to_owned();
        self.shell.report(match &saved {
            Ok(()) => Event::Screenshot { path },
            Err(error) => Event::FileFailed { path, error: format!("{error:#}") },
        });
        saved
    }

    fn close(mut self) -> Result<Vec<String>> {
        self.shell.finish()?;
        Ok(self.shell.into_device().close())
    }
}

fn title(scene: &Path) -> String {
    format!("{} - splatgraph", one_line(&scene.file_name().unwrap_or_default().to_string_lossy()))
}

/// Finds the first of `NAME-1.png`, `NAME-2.png`, ... that does not exist.
fn fresh_name(stem: &str) -> PathBuf {
    let name = |number: u32| PathBuf::from(format!("{stem}-{number}.png"));
    (1..).map(name).find(|path| !path.exists()).unwrap_or_else(|| name(0))
}

/// A log of events as JSON lines, with changes of the window's size and of the controls' places.
struct EventLog {
    out: Log,
    begun: Instant,
    window: Option<Event>,
    controls: BTreeMap<String, [f32; 4]>,
}

#[derive(Serialize)]
struct Line<'a> {
    /// Seconds since the window was opened.
    time: f64,
    #[serde(flatten)]
    event: &'a Event,
}

impl EventLog {
    fn new(out: Log) -> EventLog {
        EventLog { out, begun: Instant::now(), window: None, controls: BTreeMap::new() }
    }

    fn write(&mut self, mut all: Vec<Event>, controls: &Controls, request: &FrameRequest) -> Result<()> {
        let FrameRequest { size: (width, height), pixels_per_point, .. } = *request;
        let window = Event::Window { width, height, pixels_per_point };
        if self.window.as_ref() != Some(&window) {
            self.window = Some(window.clone());
            all.push(window);
        }
        self.controls.retain(|name, _| {
            let there = controls.find(name).is_some();
            if !there {
                all.push(Event::ControlGone { name: name.clone() });
            }
            there
        });
        for (name, rect) in controls.iter() {
            let place =
                [rect.min.x, rect.min.y, rect.max.x, rect.max.y].map(|v| (v * pixels_per_point).round());
            if self.controls.get(name) != Some(&place) {
                self.controls.insert(name.to_owned(), place);
                let [left, top, right, bottom] = place;
                all.push(Event::Control { name: name.to_owned(), left, top, right, bottom });
            }
        }
        all.iter().try_for_each(|event| self.write_line(event))
    }

    fn write_line(&mut self, event: &Event) -> Result<()> {
        let time = self.begun.elapsed().as_secs_f64();
        self.out.line(&serde_json::to_string(&Line { time, event })?);
        Ok(())
    }
}
