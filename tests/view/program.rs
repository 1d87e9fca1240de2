//! The real program with a window, observed by the events that it writes.

use super::screen::{PATIENCE, Pixels, Screen, Window, comes};
use crate::place::{Line, Place};
use serde_json::Value;
use splatgraph_assets::{Camera, synth};
use std::fs::{self, File};
use std::process::{Child, Command, ExitStatus};
use std::time::{Duration, Instant};

pub type Rect = [i32; 4];

/// `splatgraph view` on its own screen, with its own graphs, shaders and scene, until it is dropped.
pub struct Program {
    process: Child,
    pub window: Window,
    /// Events that were read so far.
    events: Vec<Value>,
    /// Bytes of the event file that were read so far.
    read: usize,
    pub place: Place,
    // The last field, so that the X server is stopped after the process.
    screen: Option<Screen>,
}

impl Program {
    /// Starts the program, and waits until it shows the requested picture. It draws continuously, so that
    /// [`Self::frames`] can wait for frames.
    pub fn start(splats: u32, line: &str) -> Program {
        let mut program = Program::launch(splats, &format!("--continuous {line}"), |_| {});
        assert!(program.window.appears(), "no window came {}", program.account());
        program.window.focus();
        program.settle();
        program
    }

    /// Starts the program in a folder that `arrange` prepares.
    pub fn launch(splats: u32, line: &str, arrange: impl FnOnce(&Place)) -> Program {
        Program::launch_with(splats, line, |_| {}, arrange)
    }

    /// Starts the program like `launch`; `change` first changes the command.
    pub fn launch_with(
        splats: u32,
        line: &str,
        change: impl FnOnce(&mut Command),
        arrange: impl FnOnce(&Place),
    ) -> Program {
        let screen = Screen::start(1280, 900);
        let place = Place::shipped();
        place.scene("scene.ply", "demo", splats, 0);
        Camera::save(&synth::demo_cameras(), place.at("scene.cameras.json")).expect("cameras are written");
        arrange(&place);
        let errors = File::create(place.at("errors.txt")).expect("a file");
        let window = Window::on(&screen);
        let mut command = place.program("view scene.ply --events events.jsonl --device llvmpipe --validate");
        command
            .args(line.words())
            .env("DISPLAY", screen.display())
            .env("XDG_STATE_HOME", place.at("state"))
            .env("WINIT_X11_SCALE_FACTOR", "1")
            .stderr(errors);
        change(&mut command);
        let process = command.spawn().expect("the program starts");
        Program { process, window, events: Vec::new(), read: 0, place, screen: Some(screen) }
    }

    /// Stops the X server that the program is connected to.
    pub fn lose_display(&mut self) {
        self.screen = None;
    }

    /// Reads new events; returns the total number of events.
    pub fn now(&mut self) -> usize {
        let all = fs::read(self.place.at("events.jsonl")).unwrap_or_default();
        let new = &all[self.read..];
        // The last line may be incomplete.
        let whole = new.iter().rposition(|byte| *byte == b'\n').map_or(0, |end| end + 1);
        for line in new[..whole].split(|byte| *byte == b'\n').filter(|line| !line.is_empty()) {
            let event = serde_json::from_slice(line);
            self.events
                .push(event.unwrap_or_else(|error| {
                    panic!("{error} in the event {}", String::from_utf8_lossy(line))
                }));
        }
        self.read += whole;
        self.events.len()
    }

    fn account(&self) -> String {
        let errors = fs::read_to_string(self.place.at("errors.txt")).unwrap_or_default();
        let kind = |event: &Value| event["event"].as_str().unwrap_or_default().to_owned();
        let frames = self.events.iter().filter(|event| kind(event) == "frame").count();
        let told = self.events.iter().filter(|event| !kind(event).starts_with("control"));
        let told: Vec<String> = told.filter(|event| kind(event) != "frame").map(Value::to_string).collect();
        let controls = self.events.iter().rev().filter(|event| kind(event).starts_with("control")).take(12);
        let controls: Vec<String> = controls.map(Value::to_string).collect();
        format!(
            "after {frames} frames\nevents:\n{}\nlast controls, newest first:\n{}\nstderr:\n{errors}",
            told.join("\n"),
            controls.join("\n")
        )
    }

    /// Waits for an event that satisfies `is_it`, after the first `since` events; returns it. Fails if the program ends
    /// first, or after [`PATIENCE`].
    pub fn until(&mut self, since: usize, what: &str, is_it: impl Fn(&Value) -> bool) -> Value {
        let begun = Instant::now();
        let mut next = since;
        loop {
            let end = self.now();
            if let Some(event) = self.events[next..end].iter().find(|event| is_it(event)) {
                return event.clone();
            }
            next = end;
            let ended = self.process.try_wait().expect("the program can be asked").is_some();
            if ended || begun.elapsed() > PATIENCE {
                let why = if ended { "the program ended" } else { "in vain" };
                panic!("{why}, waiting for {what} {}", self.account());
            }
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    /// Waits for `count` further frames. Input before this call affects the second of them at the latest. Needs
    /// `--continuous`.
    pub fn frames(&mut self, count: usize) {
        let since = self.now();
        let first = self.until(since, "a frame", |event| event["event"] == "frame");
        let last = first["number"].as_u64().unwrap_or(0) + count as u64 - 1;
        self.until(since, "frames", |event| event["number"].as_u64().is_some_and(|number| number >= last));
    }

    pub fn rests(&mut self) {
        let rests = comes(|| {
            let before = self.now();
            std::thread::sleep(Duration::from_millis(500));
            self.now() == before
        });
        assert!(rests, "the program never rests {}", self.account());
    }

    /// Returns the CPU time that the window's thread has used so far.
    pub fn main_thread_time(&self) -> Duration {
        let text = fs::read_to_string(format!("/proc/{}/schedstat", self.process.id()));
        let text = text.expect("there is a /proc");
        let time = text.split(' ').next().and_then(|time| time.parse().ok());
        Duration::from_nanos(time.expect("nanoseconds"))
    }

    /// Waits for a frame after the first `since` events.
    pub fn frame_after(&mut self, since: usize) {
        self.until(since, "a frame", |event| event["event"] == "frame");
    }

    /// Waits until nothing is being built and the result is on the screen.
    pub fn settle(&mut self) {
        self.act();
        let since = self.now();
        self.until(since, "the end of building", |event| event["busy"] == false);
        self.act();
    }

    /// Waits for a plan of viewport `who` whose causes include `cause`, after the first `since` events; returns the
    /// event.
    pub fn swapped(&mut self, since: usize, who: &str, cause: &str) -> Value {
        let event = self.until(since, &format!("a plan of {who} because of {cause}"), |event| {
            let causes = event["causes"].as_array().into_iter().flatten();
            event["renderer"] == who && causes.into_iter().any(|told| told == cause)
        });
        assert!(event["latency_ms"].as_f64().is_some_and(|ms| ms > 0.0), "{event}");
        event
    }

    /// Returns a control's left, top, right and bottom in the window's pixels; `None` if it is not shown.
    pub fn find(&mut self, name: &str) -> Option<Rect> {
        self.now();
        let last = self.events.iter().rev().find(|event| event["name"] == name)?;
        let side = |side: &str| last[side].as_f64().map(|v| v as i32);
        Some([side("left")?, side("top")?, side("right")?, side("bottom")?])
    }

    pub fn control(&mut self, name: &str) -> Rect {
        let mut found = None;
        comes(|| {
            found = self.find(name);
            found.is_some()
        });
        let found = found.unwrap_or_else(|| panic!("{name} is not shown {}", self.account()));
        let (width, height) = self.window.size();
        let [left, top, right, bottom] = found;
        let inside = left >= 0 && top >= 0 && right <= width as i32 && bottom <= height as i32;
        assert!(inside, "{name} stands at {found:?}, outside the window");
        found
    }

    pub fn act(&mut self) {
        // The first frame may have begun before the input arrived.
        self.frames(2);
    }

    pub fn point(&mut self, place: [i32; 2]) {
        self.window.point(place);
        self.act();
    }

    /// Clicks a control once its place is stable: an opening menu reaches its position in its second frame.
    pub fn click(&mut self, name: &str) {
        let mut place = self.control(name);
        loop {
            self.act();
            let now = self.control(name);
            if std::mem::replace(&mut place, now) == now {
                break;
            }
        }
        self.window.point(middle(place));
        self.window.press(1);
        self.window.release(1);
        self.act();
    }

    /// Presses a button at the first place, goes to the others, and releases it at the last.
    pub fn drag(&mut self, button: u8, places: &[[i32; 2]]) {
        let (first, others) = places.split_first().expect("there is a first place");
        self.window.point(*first);
        self.window.press(button);
        self.act();
        for place in others {
            self.point(*place);
        }
        self.window.release(button);
        self.act();
    }

    /// Turns the wheel by a notch, away from the user or towards them.
    pub fn wheel(&mut self, away: bool) {
        let button = if away { 4 } else { 5 };
        self.window.press(button);
        self.window.release(button);
        self.act();
    }

    pub fn keys(&mut self, keysyms: &[u32]) {
        for keysym in keysyms {
            self.window.key(*keysym);
        }
        self.act();
    }

    pub fn view(&mut self) -> Pixels {
        let view = self.control("view");
        self.window.pixels(view)
    }

    /// Waits until the view satisfies `is_it`; returns its picture.
    pub fn view_until(&mut self, what: &str, is_it: impl Fn(&Pixels) -> bool) -> Pixels {
        let mut shown = self.view();
        // Finds the view again each time, because it may move.
        let come = is_it(&shown)
            || comes(|| {
                shown = self.view();
                is_it(&shown)
            });
        if !come {
            self.now();
            panic!("the view never shows {what} {}", self.account());
        }
        shown
    }

    pub fn view_is(&mut self, what: &str, expected: &Pixels) {
        self.view_until(what, |shown| shown == expected);
    }

    /// Waits until over 1% of the view's pixels differ from `former`; returns the picture once it is stable.
    pub fn view_is_not(&mut self, what: &str, former: &Pixels) -> Pixels {
        self.view_until(what, |shown| shown.differs(former) > 0.01);
        self.still()
    }

    /// Returns the picture of the view, once it no longer changes.
    pub fn still(&mut self) -> Pixels {
        let begun = Instant::now();
        let mut before = self.view();
        loop {
            self.act();
            let shown = self.view();
            if shown == before {
                return shown;
            }
            before = shown;
            assert!(begun.elapsed() < PATIENCE, "the view never stands still {}", self.account());
        }
    }

    /// Closes the window; fails if the program fails or reports validation messages.
    pub fn close(self) {
        self.window.ask_to_close();
        let (status, errors) = self.end();
        assert!(status.success() && errors.trim() == "validation: no messages", "{status}\n{errors}");
    }

    /// Waits for the program's end; returns its status and standard error.
    pub fn end(self) -> (ExitStatus, String) {
        self.end_before(|| {})
    }

    /// Waits for the program's end like `end`, and calls `look` before the program's folder is removed.
    pub fn end_before(mut self, look: impl FnOnce()) -> (ExitStatus, String) {
        let mut ended = None;
        comes(|| {
            ended = self.process.try_wait().expect("the program can be asked");
            ended.is_some()
        });
        self.now();
        let status = ended.unwrap_or_else(|| panic!("the program goes on {}", self.account()));
        look();
        (status, self.place.text("errors.txt"))
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

pub fn middle([left, top, right, bottom]: Rect) -> [i32; 2] {
    [(left + right) / 2, (top + bottom) / 2]
}
