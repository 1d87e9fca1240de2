//! Draws the window's frames, saves pictures, and ends a scripted run.

use super::event_log::{EventLog, Seen};
use super::pictures::{self, fresh_name};
use super::{dialog, display, editor};
use crate::draw::backend::Backend;
use crate::io::output::{one_line, say};
use crate::view::events::Event;
use crate::view::kept;
use crate::view::panels::Command;
use crate::view::recovery::Recovery;
use crate::view::shell::{FrameRequest, Shell};
use anyhow::{Context as _, Result, bail};
use egui::RawInput;
use splatgraph_api::{BackendError, Pixels};
use std::mem::ManuallyDrop;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use winit::raw_window_handle::{HasDisplayHandle, RawDisplayHandle};
use winit::window::{Fullscreen, Window};

/// Interval between checks whether a hidden window is visible again.
const IDLE: Duration = Duration::from_millis(100);

/// Interval between attempts to draw while the device is being reopened.
const REOPENING: Duration = Duration::from_millis(50);

/// Minimum and maximum interval between polls of a frame in flight.
const LOOKS: (Duration, Duration) = (Duration::from_millis(1), Duration::from_millis(50));

/// Divisor of the age of the newest frame in flight; the quotient is the polling interval, within [`LOOKS`].
const LOOK: u32 = 16;

/// Maximum wait for each renderer's frames, and in total for builds, when the window closes.
const CLOSING: Duration = Duration::from_secs(3);

/// Time after which the program ends if the window's own graph could never be drawn. The cause is a transient failure,
/// such as a lack of memory.
const BLIND: Duration = Duration::from_secs(3);

/// Running time of a pass after which the window's title names it.
const SLOW: Duration = Duration::from_secs(1);

/// Time from a change of the window layout until it is saved.
const KEEP: Duration = Duration::from_secs(1);

/// Number of frames after which a view without pixels is assumed to stay empty.
const MANY: u64 = 30;

pub struct Running {
    pub shell: Shell,
    pub recovery: Recovery,
    pub input: egui_winit::State,
    pub window: display::Handle,
    pub covered: bool,
    /// True for a minimised window, and the time of the last check. Polled: not every window system sends an event.
    pub minimised: (bool, Instant),
    pub asked: bool,
    /// True if the window may have lost its content: at the start, after a resize, or if the window system asks for a
    /// redraw.
    pub redraw: bool,
    /// Time of the next frame; `None` to draw it only on request.
    pub next: Option<Instant>,
    /// Time of the next poll of frames in flight; `None` if there are none.
    pub look: Option<Instant>,
    /// The next frame is not drawn before this time; see [`Running::interval`].
    pub earliest: Instant,
    pub frames: u64,
    pub closing: Closing,
    pub log: Option<EventLog>,
    pub title: String,
    /// Time since which the window's own graph could not be built; `None` if it can.
    pub blind: Option<Instant>,
    /// Pass or frame that is reported as slow; `None` if none is.
    pub slow: Option<String>,
    /// File for the window layout; `None` to save none.
    pub kept: Option<PathBuf>,
    /// Time to save the window layout, which the last frames may have changed; `None` if it is saved.
    pub keep: Option<Instant>,
    pub open: dialog::Dialog,
    pub editor: editor::Editor,
    /// Request to save the window's picture with the next frame: the path, or `Some(None)` for a numbered name.
    pub save: Option<Option<PathBuf>>,
    /// True to save A's picture once it is read back.
    pub save_a: bool,
    /// True once every shown graph has a plan, or the error of one was written to standard error.
    pub has_begun: bool,
}

pub struct Closing {
    pub screenshot: Option<PathBuf>,
    pub frames: Option<u64>,
}

impl Running {
    fn shows_nothing(&mut self) -> bool {
        if self.minimised.1.elapsed() >= IDLE {
            self.minimised = (self.window.with(Window::is_minimized) == Some(true), Instant::now());
        }
        let (width, height) = self.window.size();
        // A screenshot does not need a visible window.
        let hidden = (self.covered || self.minimised.0) && self.closing.screenshot.is_none();
        hidden || width == 0 || height == 0
    }

    /// Draws a frame if one is due, and polls frames in flight; returns true if the window must close. Does neither
    /// while the window is hidden or has no pixels. Fails if no device can be opened, the window's own graph could
    /// never be drawn, or what the command line requested cannot be shown or saved.
    pub fn turn(&mut self) -> Result<bool> {
        let now = Instant::now();
        let is_due = |time: Option<Instant>| time.is_some_and(|time| time <= now);
        if is_due(self.keep) {
            // A failure is reported when the window closes.
            _ = self.keep_layout();
        }
        let looks = is_due(self.look);
        if !(self.asked || is_due(self.next) || looks) || now < self.earliest {
            return Ok(false);
        }
        if self.shows_nothing() {
            // The first frame after the window is visible again covers the request.
            self.asked = false;
            (self.next, self.look) = (Some(now + IDLE), None);
            return Ok(false);
        }
        let collected = looks && self.shell.collect();
        let closes = match self.asked || is_due(self.next) || collected {
            true => {
                self.earliest = now + self.interval();
                self.draw()?
            }
            false => self.show_state().map(|()| false)?,
        };
        let pause = |since: Instant| (since.elapsed() / LOOK).clamp(LOOKS.0, LOOKS.1);
        self.look = self.shell.in_flight().map(|since| Instant::now() + pause(since));
        Ok(closes)
    }

    pub fn wakes(&self) -> Option<Instant> {
        let asked = self.asked.then(Instant::now);
        [asked, self.next, self.look, self.keep]
            .into_iter()
            .flatten()
            .min()
            .map(|time| time.max(self.earliest))
    }

    /// Returns the minimum interval between frames: one refresh of the display with vsync on Wayland, otherwise zero.
    /// Also zero if the refresh rate is unknown. On Wayland, presentation must not wait for the display, because a
    /// hidden window would wait forever.
    fn interval(&self) -> Duration {
        if !self.shell.panels.vsync {
            return Duration::ZERO;
        }
        self.window.with(|window| {
            let display = window.display_handle().ok().map(|display| display.as_raw());
            let is_wayland = matches!(display, Some(RawDisplayHandle::Wayland(_)));
            let display = window.current_monitor().filter(|_| is_wayland);
            let rate = display.and_then(|display| display.refresh_rate_millihertz());
            rate.map_or(Duration::ZERO, |rate| Duration::from_secs_f64(1e3 / f64::from(rate.max(1000))))
        })
    }

    fn draw(&mut self) -> Result<bool> {
        self.asked = false;
        match self.open.take() {
            Some(Ok((path, None))) => self.shell.viewer.open_in(self.shell.panels.selected, &path),
            Some(Ok((path, Some(role)))) => self.shell.viewer.open_cameras_as(role, &path),
            Some(Err(text)) => self.shell.report(Event::Problem { text }),
            None => {}
        }
        while let Some(text) = self.editor.take_failure() {
            self.shell.report(Event::Problem { text });
        }
        let input: RawInput = self.window.with(|window| self.input.take_egui_input(window));
        let close = self.must_close()?;
        if close && let Some(path) = &self.closing.screenshot {
            self.save = Some(Some(path.clone()));
        }
        let request = FrameRequest {
            size: self.window.size(),
            present: true,
            read: self.save.is_some(),
            redraw: self.redraw,
        };
        let frame = self.recovery.frame(&mut self.shell, input, request)?;
        self.show_state()?;
        self.tell_failed_start();
        let Some(frame) = frame else {
            self.next = Some(Instant::now() + REOPENING);
            self.write_events(request.size, false);
            return Ok(false);
        };
        self.window.with(|window| self.input.handle_platform_output(window, frame.platform));
        if let Some(pixels) = frame.picture
            && let Some(path) = self.save.take()
        {
            let saved = self.save_picture(&pixels, path.as_deref(), "splatgraph-window");
            if let Some(path) = path {
                saved.with_context(|| format!("{} cannot be written", path.display()))?;
            }
        }
        if self.save_a
            && let Some(picture) = self.shell.viewer.a.take_picture()
        {
            self.save_a = false;
            match picture {
                // An error is reported as an event.
                Ok(pixels) => _ = self.save_picture(&pixels, None, "splatgraph"),
                Err(error) => {
                    self.shell.report(Event::FileFailed { path: fresh_name("splatgraph", "png"), error })
                }
            }
        }
        for command in frame.commands {
            self.apply(command);
            self.asked = true;
        }
        self.next = frame.next;
        self.redraw &= !frame.drawn;
        self.frames += u64::from(frame.drawn);
        if frame.drawn && self.kept.is_some() {
            self.keep.get_or_insert_with(|| Instant::now() + KEEP);
        }
        self.write_events(request.size, frame.drawn);
        Ok(close && self.save.is_none())
    }

    /// Returns true if this frame is the last. A screenshot or a number of frames was then requested, the frame shows
    /// the requested state, and enough frames were drawn. Fails if the requested state cannot be shown.
    fn must_close(&self) -> Result<bool> {
        if self.closing.screenshot.is_none() && self.closing.frames.is_none() {
            return Ok(false);
        }
        let viewer = &self.shell.viewer;
        if viewer.is_empty() && self.frames >= MANY {
            bail!(
                "cannot show what was requested\nerror: the window has no room for a picture beside its panels"
            );
        }
        let problem = self.shell.problem();
        if self.frames < self.closing.frames.unwrap_or(3) || !self.shell.is_settled() {
            return Ok(false);
        }
        match problem {
            None => Ok(true),
            Some(problem) => bail!("cannot show what was requested\n{problem}"),
        }
    }

    /// Updates the window's title, which names the pass or the error that delays the next picture. Reports a slow pass
    /// as an event. Fails if the window's own graph could never be drawn.
    fn show_state(&mut self) -> Result<()> {
        if let Some(failure) = self.shell.is_blind() {
            let since = *self.blind.get_or_insert_with(Instant::now);
            if self.frames == 0 && (!failure.may_pass() || since.elapsed() > BLIND) {
                bail!("the window's own graph cannot be drawn\n{}", failure.text(false));
            }
        } else {
            self.blind = None;
        }
        let slow = self.shell.stalled().filter(|running| running.time >= SLOW).cloned();
        let state = match (&slow, self.recovery.loss()) {
            (_, Some(loss)) => Some(format!("{loss}; reopening the device")),
            (Some(slow), _) => Some(format!("{} has been running for {} s", slow.place, slow.time.as_secs())),
            (None, None) => self.shell.window().problem(false),
        };
        let slow = slow.map(|slow| slow.place);
        if slow != self.slow {
            if let Some(place) = slow.clone() {
                self.shell.report(Event::Slow { place });
            }
            self.slow = slow;
        }
        let name = title(self.shell.viewer.scene_path());
        let title = match state {
            Some(state) => format!("{} - {name}", one_line(state.lines().next().unwrap_or_default())),
            None => name,
        };
        if title != self.title {
            self.window.with(|window| window.set_title(&title));
            self.title = title;
        }
        Ok(())
    }

    /// Writes the error of a graph that fails at the start to standard error, where a command's errors are expected. A
    /// scripted run ends with the error instead.
    fn tell_failed_start(&mut self) {
        if self.has_begun || self.closing.screenshot.is_some() || self.closing.frames.is_some() {
            return;
        }
        let mut waiting = self.shell.viewer.shown().filter(|v| v.renderer.plan().is_none()).peekable();
        self.has_begun = waiting.peek().is_none();
        if let Some(problem) = waiting.find_map(|v| v.renderer.problem(false)) {
            self.has_begun = true;
            say(problem);
        }
    }

    /// Writes the events since the last frame, the controls and a drawn frame to the event log, if any.
    fn write_events(&mut self, size: (u32, u32), drawn: bool) {
        let events = self.shell.take_events();
        let Some(log) = &mut self.log else { return };
        let frame = Seen::Frame { number: self.frames, busy: self.shell.viewer.busy() };
        let scale = self.shell.context().pixels_per_point();
        log.write(&events, &self.shell.panels.controls, size, scale, drawn.then_some(frame));
    }

    fn apply(&mut self, command: Command) {
        match command {
            Command::Screenshot => _ = self.save.get_or_insert_default(),
            Command::SavePicture => {
                self.shell.viewer.a.want_picture();
                self.save_a = true;
            }
            Command::Fullscreen => {
                self.window.with(|window| {
                    let full = window.fullscreen().is_none();
                    window.set_fullscreen(full.then_some(Fullscreen::Borderless(None)));
                });
            }
            Command::Open(cameras) => {
                let near = self.shell.viewer.scene_path();
                if let Err(text) = self.window.with(|window| self.open.ask(window, near, cameras)) {
                    self.shell.report(Event::Problem { text });
                }
            }
            Command::Edit(origin) => {
                if let Err(text) = self.editor.open(&origin) {
                    self.shell.report(Event::Problem { text });
                }
            }
            Command::Capture => {
                let document = || fresh_name("splatgraph", "gputrace");
                if let Err(error) = crate::view::profile::capture_next_frame(document) {
                    self.shell.report(Event::FileFailed { path: "Capture".into(), error });
                }
            }
        }
    }

    fn save_picture(&mut self, pixels: &Pixels, path: Option<&Path>, stem: &str) -> Result<()> {
        let saved = pictures::save(pixels, path, stem);
        self.shell.report(match &saved {
            Ok(path) => Event::Screenshot { path: path.clone() },
            Err(error) => {
                let path = path.map_or_else(|| fresh_name(stem, "png"), Path::to_owned);
                Event::FileFailed { path, error: format!("{error:#}") }
            }
        });
        saved.map(drop)
    }

    /// Returns true if nothing is unsaved, or the user was told what is. Otherwise, tells the user.
    pub fn may_close(&mut self) -> bool {
        let Some(unsaved) = self.shell.viewer.unsaved() else { return true };
        let text = format!("Not saved: {unsaved}. Close the window again to discard.");
        let told = self.shell.panels.notice() == Some(&text);
        if !told {
            self.shell.panels.show_notice(text);
        }
        told
    }

    /// Waits for a file that is being written: the process may end without waiting for its threads. Writes a failure to
    /// standard error.
    pub fn finish_export(&mut self) {
        if let Some(event @ Event::FileFailed { .. }) = self.shell.viewer.finish_export() {
            say(event.to_string());
        }
    }

    /// Saves the window layout, if it has changed. A signal may end the program without closing the window.
    fn keep_layout(&mut self) -> Result<(), String> {
        self.keep = None;
        let Some(path) = &self.kept else { return Ok(()) };
        kept::keep(path, &self.shell.panels, self.shell.context())
    }

    /// Saves the window layout, closes the devices, and returns the validation messages. Waits for a file that is being
    /// written. If other work does not end within [`CLOSING`], the devices stay open, and no messages are returned.
    pub fn close(mut self) -> Vec<String> {
        if let Err(error) = self.keep_layout() {
            say(format!("the window layout is not saved: {error}"));
        }
        let end = Instant::now() + CLOSING;
        let finished = self.shell.finish(CLOSING);
        let still = match finished {
            Err(BackendError::Stuck { place, .. }) if !place.is_empty() => Some(place),
            Err(BackendError::Stuck { .. }) => Some("a frame".to_owned()),
            // After a device error, no frames are left to wait for.
            Ok(()) | Err(_) => (!self.shell.is_idle(end)).then(|| "a build".to_owned()),
        };
        self.finish_export();
        if let Some(still) = still {
            let _ = ManuallyDrop::new(self);
            say(format!("closed while {still} was still running"));
            return Vec::new();
        }
        let messages = self.shell.into_devices().into_iter().flat_map(Backend::close).collect();
        display::set_open(false);
        messages
    }
}

/// Returns the title of a window that shows this scene.
pub fn title(scene: &Path) -> String {
    format!("{} - splatgraph", one_line(&scene.file_name().unwrap_or_default().to_string_lossy()))
}
