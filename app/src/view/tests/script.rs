//! Simulates a user's visit to the viewer on the null device, which executes nothing.

use crate::draw::backend::Backend;
use crate::view::events::Event;
use crate::view::paint::{self, Mode};
use crate::view::panels::Panels;
use crate::view::recovery::{Open, Recovery};
use crate::view::shell::{Frame, FrameRequest, Shell};
use crate::view::viewer::Viewer;
use egui::{Key, Modifiers, Pos2, RawInput, Rect, Vec2};
use splatgraph_api::Device;
use splatgraph_assets::{Camera, Scene, synth};
use splatgraph_framework::ir::Value;
use splatgraph_null::{Call, Config, Fault, Journal, open};
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;
use std::rc::Rc;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tempfile::TempDir;

const PATIENCE: Duration = Duration::from_secs(60);

const SIZE: (u32, u32) = (320, 180);

/// Text of `graph.ron`.
pub const GRAPH: &str = r#"Graph(
  version: 1,
  summary: "Three passes over a scene",
  params: {
    "digits": Const(Int(default: 4, range: (1, 8))),
    "entries": Const(Int(default: "2 * scene.count", range: (1, 8388608), grows: "entries_needed")),
    "shade": Live(Float(default: 0.5, range: (0.0, 1.0))),
  },
  let: { "n": "scene.count" },
  imports: { "position": Import(from: "scene.position") },
  resources: {
    "table": Buffer(stride: 4, count: "64 << digits"),
    "keys": Buffer(stride: 4, count: "max(n, entries)"),
    "color": Image(format: "rgba8", size: ("viewport.width", "viewport.height")),
  },
  passes: [
    Dispatch(name: "once", run: Once, shader: "once.comp", size: Threads("64 << digits"), bind: { "Table": "table" }),
    Dispatch(
      name: "key", shader: "key.comp", size: Threads("n"), bind: { "Position": "position", "Table": "table", "Keys": "keys" },
    ),
    Dispatch(name: "shade", shader: "shade.comp", size: Threads(64), bind: { "Keys": "keys", "color": "color" }),
  ],
  stats: { "entries_needed": ("keys", 0) },
  output: "color",
)
"#;

const HEAD: &str =
    "#version 460\n#extension GL_GOOGLE_include_directive : require\nlayout(local_size_x = 64) in;\n";

const SHADERS: [(&str, &str); 3] = [
    (
        "once.comp",
        "layout(set = 0, binding = 0, std430) writeonly buffer Table { uint table[]; };\n\
         void main() { table[gl_GlobalInvocationID.x] = gl_GlobalInvocationID.x; }\n",
    ),
    (
        "key.comp",
        "struct Point { float x, y, z; };\n\
         layout(set = 0, binding = 0, std430) readonly buffer Position { Point position[]; };\n\
         layout(set = 0, binding = 1, std430) readonly buffer Table { uint table[]; };\n\
         layout(set = 0, binding = 2, std430) writeonly buffer Keys { uint keys[]; };\n\
         void main() {\n    uint i = gl_GlobalInvocationID.x;\n    if (i >= SCENE_COUNT) return;\n    \
         keys[i] = table[uint(position[i].x) % 64u];\n}\n",
    ),
    (
        "shade.comp",
        "#include \"live.glsl\"\n\
         layout(set = 0, binding = 0, std430) readonly buffer Keys { uint keys[]; };\n\
         layout(set = 0, binding = 1, rgba8) writeonly uniform image2D color;\n\
         void main() { imageStore(color, ivec2(gl_GlobalInvocationID.x, 0), vec4(shade * float(keys[0]))); }\n",
    ),
];

/// Devices opened during the visit, each with the journal of its calls. The context, if any, is for reading the
/// device's messages at the end.
type Devices = Vec<(Option<Backend>, Journal)>;

/// Final state of a visit, for comparison with other visits.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// Commands of the last frames of A and of the window, without numbers that depend on time.
    pub last: Vec<String>,
    /// Names and sizes, in bytes, of A's device memory.
    pub memory: Vec<(String, u64)>,
    /// Everything else that the visit changed, as text.
    pub state: Vec<String>,
}

pub struct Script {
    pub shell: Shell,
    recovery: Recovery,
    devices: Rc<RefCell<Devices>>,
    size: (u32, u32),
    pub events: Vec<Event>,
    calls: u64,
    pub input: Vec<egui::Event>,
    hangs: bool,
    folder: TempDir,
}

/// Makes a folder with a graph, its shaders, two scenes and cameras.
pub fn arranged() -> TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let write = |name: &str, text: &str| fs::write(at(name), text).expect("a file is written");
    write("graph.ron", GRAPH);
    for (name, text) in SHADERS {
        write(name, &format!("{HEAD}{text}"));
    }
    for (name, splats) in [("first.ply", 100), ("second.ply", 200)] {
        let scene = synth::generate("uniform", splats, 0).expect("the scene is generated");
        scene.write_ply(at(name)).expect("the scene is written");
    }
    let scene = synth::generate("uniform", 100, 0).expect("the scene is generated");
    Camera::save(&[Camera::framing(&scene, 64, 36)], at("cameras.json")).expect("cameras are written");
    folder
}

impl Script {
    /// Opens the viewer on one null device. The faults apply to the first device opened.
    pub fn open(config: &Config) -> Script {
        Script::open_in(arranged(), config, false)
    }

    /// Opens the viewer in an arranged folder. If `apart`, the scene and the window have separate devices, as on a CPU.
    pub fn open_in(folder: TempDir, config: &Config, apart: bool) -> Script {
        let devices = Rc::new(RefCell::new(Devices::default()));
        let config = config.clone();
        let mut faults = config.faults.clone();
        let opened = devices.clone();
        let mut open_both: Open = Box::new(move |size| {
            let config = Config {
                window: Some(size),
                faults: std::mem::take(&mut faults),
                patience: Duration::from_millis(20),
                ..config.clone()
            };
            let open = |config: &Config| {
                let (device, journal) = open(config);
                opened.borrow_mut().push((None, journal));
                let device = Backend::Null(device?);
                let probe = device.new_context()?;
                if let Some(last) = opened.borrow_mut().last_mut() {
                    last.0 = Some(probe);
                }
                Ok(device)
            };
            let scene = if apart { Some(open(&config)?) } else { None };
            let canvas = open(&config)?;
            let scene = scene.map_or_else(|| canvas.new_context(), Ok)?;
            Ok((canvas, scene))
        });
        let first = open_both(SIZE);
        // The program would report the error and exit; the user starts it again.
        let (canvas, device) = first.or_else(|_| open_both(SIZE)).expect("the second device opens");
        let path = folder.path().join("first.ply");
        let scene = Scene::load(&path, splatgraph_assets::QUIET).expect("the scene is loaded");
        let graph = folder.path().join("graph.ron");
        let wake: crate::view::renderer::Wake = Arc::new(|| {});
        let viewer = Viewer::new(device, (scene, path), &graph.to_string_lossy(), &[], wake.clone());
        let mut viewer = viewer.expect("the viewer opens");
        viewer.navigation.flight_seconds = 0.0;
        // Draw continuously, even after a failure.
        viewer.continuous = true;
        viewer.a.renderer.patience = Duration::from_millis(5);
        let mut shell = Shell::new(viewer, canvas, paint::GRAPH, wake).expect("the shell opens");
        shell.window_mut().patience = Duration::from_millis(5);
        // Text would fill textures, which is slow here.
        shell.panels.hidden = true;
        // The overlay shows frame times, and would cause another frame after each.
        shell.panels.hud = false;
        Script {
            shell,
            recovery: Recovery::new(open_both),
            devices,
            size: SIZE,
            events: Vec::new(),
            calls: 0,
            input: Vec::new(),
            hangs: false,
            folder,
        }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn write(&self, name: &str, text: impl AsRef<[u8]>) {
        fs::write(self.path(name), text).expect("a file is written");
    }

    pub fn resize(&mut self, size: (u32, u32)) {
        self.size = size;
        self.resize_swapchain(size);
    }

    /// Changes the size of the device's surface, without a resize event.
    pub fn resize_swapchain(&mut self, size: (u32, u32)) {
        if let Some(canvas) = self.shell.window_mut().device_mut() {
            canvas.resize_window(size.0, size.1);
        }
    }

    pub fn viewer(&mut self) -> &mut Viewer {
        &mut self.shell.viewer
    }

    /// Returns the position of a control; `None` if it is not shown.
    pub fn find(&self, name: &str) -> Option<Rect> {
        self.shell.panels.controls.find(name)
    }

    pub fn panels(&mut self) -> &mut Panels {
        &mut self.shell.panels
    }

    /// Draws a frame, and reads it back if `read`; returns `None` while the device is lost.
    pub fn frame(&mut self, read: bool) -> Option<Frame> {
        self.draw(FrameRequest { read, ..FrameRequest::default() })
    }

    pub fn has_event(&self, is_it: impl Fn(&Event) -> bool) -> bool {
        self.events.iter().any(is_it)
    }

    /// Advances the simulated time without drawing a frame.
    pub fn sleep(&mut self, seconds: u64) {
        self.calls += 60 * seconds;
    }

    pub fn redraw(&mut self) -> Option<Frame> {
        self.draw(FrameRequest { redraw: true, ..FrameRequest::default() })
    }

    /// Presses and releases a key in one frame, and draws the result.
    pub fn press(&mut self, key: Key, modifiers: Modifiers) {
        self.input = [true, false].map(|pressed| super::key(key, pressed, modifiers)).into();
        self.frame(false);
        self.frame(false);
    }

    fn draw(&mut self, request: FrameRequest) -> Option<Frame> {
        let (width, height) = self.size;
        let input = RawInput {
            screen_rect: Some(Rect::from_min_size(Pos2::ZERO, Vec2::new(width as f32, height as f32))),
            time: Some(self.calls as f64 / 60.0),
            events: std::mem::take(&mut self.input),
            focused: true,
            ..RawInput::default()
        };
        self.calls += 1;
        let request = FrameRequest { size: self.size, present: true, ..request };
        let frame = self.recovery.frame(&mut self.shell, input, request).expect("another device opens");
        self.events.extend(self.shell.take_events());
        frame
    }

    /// Counts the pipelines that were requested from all devices.
    pub fn pipelines(&self) -> u64 {
        let devices = self.devices.borrow();
        devices.iter().map(|(_, journal)| journal.reached(splatgraph_null::Point::Compile)).sum()
    }

    /// Counts the frames of A, B and the window submitted since the last call.
    pub fn submissions(&self) -> usize {
        let is_frame = |call: &&Call| matches!(call, Call::Submit { encoder, .. } if encoder == "frame");
        self.take_calls().iter().filter(is_frame).count()
    }

    /// Takes the calls of all devices since the last time.
    pub fn take_calls(&self) -> Vec<Call> {
        self.devices.borrow().iter().flat_map(|(_, journal)| journal.take()).collect()
    }

    /// Makes the first device hang in later submissions, or resume. With two devices, the first is the scene's.
    pub fn set_hanging(&mut self, hangs: bool) {
        self.hangs = hangs;
        let devices = self.devices.borrow();
        let journal = &devices.first().expect("a device").1;
        if hangs { journal.hang() } else { journal.resume() }
    }

    /// Draws frames until none is due.
    pub fn rest(&mut self) {
        self.until("rest", |script| {
            let next = script.frame(false).expect("the device is not lost").next;
            next.is_none() && !script.shell.collect() && script.shell.in_flight().is_none()
        });
    }

    pub fn draws(&mut self) -> bool {
        (0..100).any(|_| self.frame(false).is_some_and(|frame| frame.drawn))
    }

    /// Resumes a hanging device once the viewer has reported the hang, unless [`Script::set_hanging`] keeps it hanging.
    fn resume(&mut self) {
        if self.hangs {
            return;
        }
        let stuck = |text: String| text.contains("it may never end");
        let said = self.shell.problem().is_some_and(stuck)
            || self.viewer().a.inspection.as_ref().is_some_and(|i| matches!(&i.found, Some(Err(_))));
        if self.shell.stalled().is_some() || said {
            self.devices.borrow().iter().for_each(|(_, journal)| journal.resume());
        }
    }

    /// Draws frames until `is_so` returns true; panics after [`PATIENCE`], naming `what`.
    pub fn until(&mut self, what: &str, mut is_so: impl FnMut(&mut Script) -> bool) {
        let begun = Instant::now();
        loop {
            self.frame(false);
            if is_so(self) {
                return;
            }
            self.resume();
            assert!(
                begun.elapsed() < PATIENCE,
                "waiting for {what}; {:?}; so far: {:#?}",
                self.shell.problem(),
                self.events
            );
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    /// Draws frames until everything requested is built and shown.
    pub fn settle(&mut self) {
        // The first frame starts the builds.
        self.frame(false);
        self.until("the end of all building", |script| {
            let Script { shell, size, recovery, .. } = script;
            let viewer = &shell.viewer;
            recovery.loss().is_none()
                && !viewer.busy()
                && viewer.shown().all(|shown| shown.renderer.plan().is_some())
                && shell.problem().is_none()
                && shell.window().size() == *size
                && !shell.window().busy()
        });
    }

    /// Draws frames until nothing is being built, even if pictures stay incomplete.
    pub fn settle_in_part(&mut self) {
        self.frame(false);
        self.until("the end of all building", |script| {
            !script.viewer().busy() && !script.shell.window().busy()
        });
    }

    /// Repeats an action until `is_done`; an action may fail because of the injected fault.
    fn insist(&mut self, what: &str, act: impl Fn(&mut Script), is_done: impl Fn(&Script, &[Event]) -> bool) {
        let begun = Instant::now();
        loop {
            let seen = self.events.len();
            act(self);
            let mut done = false;
            self.until(what, |script| {
                let new = &script.events[seen..];
                done = is_done(script, new);
                let refusal =
                    |event: &Event| matches!(event, Event::Problem { .. } | Event::DeviceLost { .. });
                done || new.iter().any(refusal)
            });
            self.settle();
            if done {
                return;
            }
            assert!(begun.elapsed() < PATIENCE, "{what} is refused: {:#?}", self.events);
        }
    }

    pub fn visit(&mut self) {
        self.settle();
        self.viewer().a.renderer.set_param("digits", Some(Value::Int(5)));
        self.viewer().a.renderer.set_param("shade", Some(Value::Float(0.25)));
        self.settle();
        let text = fs::read_to_string(self.path("shade.comp")).expect("it can be read");
        let former = self.viewer().a.renderer.plan().cloned();
        self.write("shade.comp", format!("{text}// edited\n"));
        self.until("the edited shader", |script| {
            let (plan, former) = (script.viewer().a.renderer.plan(), former.as_ref());
            plan.zip(former).is_some_and(|(plan, former)| !Arc::ptr_eq(plan, former))
        });
        self.settle();
        self.write("graph.ron", GRAPH.replace("\"Table\": \"table\" }", "\"Table\": \"tabel\" }"));
        let mistake = |event: &Event| matches!(event, Event::Failed { text, .. } if text.contains("tabel"));
        self.until("the mistake", |script| script.events.iter().any(mistake));
        self.write("graph.ron", GRAPH);
        self.settle();
        for size in [(400, 200), (0, 0), (250, 250), SIZE] {
            self.resize(size);
            if size.0 == 0 {
                for _ in 0..3 {
                    self.frame(false);
                }
            } else {
                self.settle();
            }
        }
        // A pass of the frame, and one of the prologue.
        for (resource, pass) in [("keys", "key"), ("table", "once")] {
            self.viewer().a.look_at(resource, pass);
            let mut asked = Instant::now();
            self.until("the contents", |script| {
                let inspection = script.viewer().a.inspection.as_mut().expect("there is an inspection");
                let failed = matches!(inspection.found, Some(Err(_)));
                let again = failed && asked.elapsed() > Duration::from_millis(20);
                if again {
                    asked = Instant::now();
                    inspection.ask();
                }
                matches!(inspection.found, Some(Ok(_)))
            });
        }
        self.viewer().a.inspection = None;
        self.settle();
        self.insist(
            "B",
            |script| script.viewer().choose_compare(Mode::Split),
            |script, _| script.shell.viewer.b.as_ref().is_some_and(|b| b.renderer.plan().is_some()),
        );
        if let Some(b) = &mut self.viewer().b {
            b.renderer.patience = Duration::from_millis(5);
        }
        self.settle();
        self.insist(
            "the comparison",
            |script| script.viewer().measure(),
            |_, new| new.iter().any(|event| matches!(event, Event::Compared { .. })),
        );
        self.viewer().exchange();
        self.viewer().choose_compare(Mode::Difference);
        self.settle();
        self.viewer().choose_compare(Mode::A);
        self.settle();
        let (scene, cameras) = (self.path("second.ply"), self.path("cameras.json"));
        self.viewer().open(&scene);
        self.settle();
        self.viewer().open(&cameras);
        self.settle();
        self.shell.panels.vsync = false;
        let mut read = false;
        self.until("a picture of the window", |script| {
            read |= script.frame(true).is_some_and(|frame| frame.picture.is_some());
            read
        });
        self.settle();
    }

    /// Draws a last frame, closes everything, and checks that no device object is leaked. Returns the final state, the
    /// events, and how often each call of the first device was reached.
    pub fn close(mut self, faults: &[Fault]) -> (Outcome, Vec<Event>, BTreeMap<splatgraph_null::Point, u64>) {
        self.viewer().continuous = true;
        // A frame that was never waited for may be hanging unnoticed.
        self.devices.borrow().iter().for_each(|(_, journal)| journal.resume());
        self.shell.finish(PATIENCE).expect("the frames end");
        let journal = self.devices.borrow().last().expect("a device").1.clone();
        journal.take();
        let mut drawn = false;
        for _ in 0..100 {
            journal.take();
            drawn = self.frame(false).is_some_and(|frame| frame.drawn);
            if drawn {
                break;
            }
            self.devices.borrow().iter().for_each(|(_, journal)| journal.resume());
            std::thread::sleep(Duration::from_millis(5));
        }
        assert!(drawn, "no last frame: {:?}", self.shell.problem());
        let last = journal.take().iter().filter_map(command).collect();
        journal.resume();
        self.shell.finish(PATIENCE).expect("the frames end");
        let viewer = &self.shell.viewer;
        assert!(viewer.pictures()[0].is_some(), "A shows nothing");
        let device = viewer.a.renderer.device().expect("a device");
        let state = vec![
            format!("{:?}", viewer.a.renderer.set()),
            format!("{:?}", viewer.a.renderer.size()),
            format!("{:?} {:?} {:?}", viewer.compare, viewer.camera, viewer.cameras().len()),
            format!("{} {:?}", viewer.scene().count(), viewer.scene_path().file_name()),
            format!("{:?}", viewer.navigation.camera(64, 36)),
            format!("{:?} {:?}", viewer.b.is_some(), viewer.a.inspection.is_some()),
        ];
        let outcome = Outcome { last, memory: device.memory(), state };
        let idle = self.shell.is_idle(Instant::now() + PATIENCE);
        assert!(idle, "a build does not end");
        let Script { shell, recovery, devices, events, .. } = self;
        drop(recovery);
        drop(shell.into_devices());
        let mut reached = BTreeMap::new();
        for (index, (probe, journal)) in devices.take().into_iter().enumerate() {
            let messages = probe.map(Backend::close).unwrap_or_default();
            assert_eq!(messages, Vec::<String>::new(), "device {index} under {faults:?}");
            // An abandoned compiler thread that was resumed must notice that its result is no longer awaited.
            let begun = Instant::now();
            while !journal.alive().is_empty() && begun.elapsed() < PATIENCE {
                std::thread::sleep(Duration::from_millis(1));
            }
            assert_eq!(journal.alive(), BTreeMap::new(), "left on device {index} under {faults:?}");
            if index == 0 {
                let all = splatgraph_null::Point::ALL;
                reached = all.map(|point| (point, journal.reached(point))).into();
            }
        }
        (outcome, events, reached)
    }
}

/// Formats a command of a frame; `None` for calls whose order or number depends on time.
fn command(call: &Call) -> Option<String> {
    match call {
        Call::BindPass { pass, .. } => Some(format!("pass {pass}")),
        Call::Dispatch(_)
        | Call::DispatchIndirect { .. }
        | Call::Draw { .. }
        | Call::DrawIndirect { .. }
        | Call::CopyImage { .. }
        | Call::Synchronize { .. } => Some(format!("{call:?}")),
        Call::Present { .. } => Some("present".to_owned()),
        _ => None,
    }
}

pub fn loses(events: &[Event]) -> bool {
    events.iter().any(|event| matches!(event, Event::DeviceLost { .. }))
}

/// Panics if an event reports a panic on another thread.
pub fn check_no_panic(events: &[Event]) {
    let internal = |event: &&Event| format!("{event:?}").contains("internal error");
    assert_eq!(events.iter().find(internal), None);
}
