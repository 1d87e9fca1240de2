//! Files damaged under a running viewer.
//!
//! Every case damages one file of the pictures or the window (cut, emptied, bits flipped, bytes inserted, lines lost or
//! doubled, invalid UTF-8), draws until the viewer has settled, and mends the file. The viewer must survive and report
//! what is wrong and where. Meanwhile and afterwards, the picture must be bit-identical.
//!
//! A damaged shader that still builds is not run on a device: it may write anywhere, and lavapipe would take this
//! process down with it. So each damaged file is first built without a device, in another copy of the folder. That
//! build also gives the expected result: an error with the same text, or an equal plan (the damage is in a comment).
//! Cases that give another plan are counted and left out.

use super::whole::TestShell;
use crate::common;
use crate::fuzz::damaged;
use crate::numbers::Random;
use crate::place::{Place, shipped};
use splatgraph::draw::facts::{self, SceneFacts};
use splatgraph::draw::planner::{Planner, Settings};
use splatgraph::view::events::{Cause, Event, RendererId};
use splatgraph::view::paint;
use splatgraph::view::renderer::Renderer;
use splatgraph_framework::ir::{Catalog, Facts, Origin, Value};
use splatgraph_framework::plan::Plan;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Instant;

const SIZE: (u32, u32) = (64, 36);

/// The parameter that A's graph is set to: name and value.
const NARROW: (&str, i64) = ("key_bits", 8);

/// Number of viewers that share the cases.
const VIEWERS: u64 = 4;

const SHORT: usize = 80;
const LONG: usize = 2_000;

/// Interval, in cases, at which the viewer's watcher must notice the damage, with its delay for broken files. In the
/// others, the renderer is told directly. The repair is always left to the watcher.
const WATCHED: usize = 25;

#[test]
fn a_file_that_is_damaged_under_a_running_viewer_costs_neither_it_nor_its_picture() {
    let begun = Instant::now();
    let cases = if common::long() { LONG } else { SHORT };
    // Several viewers in parallel: each spends most of its time waiting.
    let viewers: Vec<_> = (0..VIEWERS)
        .map(|seed| {
            std::thread::spawn(move || {
                let mut fuzz = Fuzz::begin(seed);
                (0..cases / VIEWERS as usize).for_each(|number| fuzz.case(number));
                fuzz.viewer.close();
                fuzz.counted
            })
        })
        .collect();
    let mut counted: BTreeMap<(&str, &str), usize> = BTreeMap::new();
    for viewer in viewers {
        for (key, count) in viewer.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)) {
            *counted.entry(key).or_default() += count;
        }
    }
    println!("{cases} cases in {:.1} s: {counted:#?}", begun.elapsed().as_secs_f64());
    // If most damage were harmless, the test would prove little.
    let failed: usize =
        counted.iter().filter(|((_, what), _)| *what == "failed").map(|(_, count)| count).sum();
    assert!(failed > cases / 2, "{failed} of {cases} failed");
}

#[derive(Clone, Debug, PartialEq)]
enum Outcome {
    /// There is no plan; the error's text.
    Failed(String),
    /// The plan is unchanged.
    Same,
    /// The plan differs, or the graph no longer declares a parameter that is set.
    Other,
}

struct Fuzz {
    viewer: TestShell,
    dice: Random,
    /// Builds damaged files without a device, to predict the outcome.
    beside: Beside,
    /// The files that each renderer's graph is built from, by their names in the folder.
    files: Vec<(RendererId, Vec<String>)>,
    /// The intact pictures of A and of the window.
    shown: [Vec<[f32; 3]>; 2],
    counted: BTreeMap<(&'static str, &'static str), usize>,
}

impl Fuzz {
    fn begin(seed: u64) -> Fuzz {
        let mut viewer = TestShell::new(("demo", 400), "pipelines/splat.ron", SIZE);
        viewer.shell.panels.hidden = true;
        viewer.settle();
        // One sort pass instead of four: a frame is cheaper, and still uses all files.
        let (name, bits) = NARROW;
        viewer.shell.viewer.a.renderer.set_param(name, Some(Value::Int(bits)));
        viewer.settle();
        let shown = [viewer.picture(RendererId::A).rgb, viewer.window().rgb];
        let mut beside = Beside::new(&viewer);
        let files = [RendererId::A, RendererId::Window].map(|who| (who, beside.files(who))).into();
        Fuzz { viewer, dice: Random(seed), beside, files, shown, counted: BTreeMap::new() }
    }

    fn case(&mut self, number: usize) {
        let watched = number.is_multiple_of(WATCHED);
        // Only the watcher notices changes of the window's graph; no call announces them.
        let (who, files) = self.files[usize::from(watched && number.is_multiple_of(2 * WATCHED))].clone();
        let (name, damage, bytes, expected) = loop {
            let name = self.dice.of(&files);
            let shipped = shipped(name).as_bytes();
            let (damage, bytes) = damaged(shipped, &mut self.dice);
            if bytes == shipped {
                continue;
            }
            match self.beside.outcome(who, name, &bytes, shipped) {
                Outcome::Other => self.count(damage, "left out: it gives another plan"),
                outcome => break (name.clone(), damage, bytes, outcome),
            }
        };
        let case = format!("case {number}: {name} {damage}");
        self.count(damage, if expected == Outcome::Same { "harmless" } else { "failed" });
        self.viewer.events.clear();
        self.viewer.place.write(&name, bytes);
        if let (false, Some(viewport)) = (watched, self.viewer.shell.viewer.viewport(who)) {
            viewport.renderer.want(Cause::Graph, Instant::now());
        }
        match &expected {
            Outcome::Failed(text) => {
                let text = text.replace(&self.beside.place.named(""), &self.viewer.place.named(""));
                assert!(has_place(&text), "{case}: it has no place\n{text}");
                self.viewer.until(&format!("{case}\n{text}"), |viewer| {
                    let failure = renderer(viewer, who).failure().map(|failure| failure.text(false));
                    failure.is_some_and(|failure| failure == text)
                });
                let swapped = self.viewer.events.iter().any(|event| matches!(event, Event::Swapped { .. }));
                assert!(!swapped, "{case}: {:#?}", self.viewer.events);
                assert!(self.viewer.picture(RendererId::A).rgb == self.shown[0], "{case}: another picture");
            }
            _ => self.until_swapped(who, &case),
        }
        self.viewer.events.clear();
        self.viewer.place.write(&name, shipped(&name));
        self.until_swapped(who, &format!("the mending of {case}"));
        assert!(renderer(&self.viewer, who).failure().is_none(), "{case}");
        assert!(self.viewer.picture(RendererId::A).rgb == self.shown[0], "{case}: another picture after it");
        if who == RendererId::Window {
            assert!(self.viewer.window().rgb == self.shown[1], "{case}: another window after it");
        }
        assert_eq!(self.viewer.undrawn_windows, 0, "{case}");
    }

    fn count(&mut self, damage: &'static str, what: &'static str) {
        *self.counted.entry((damage, what)).or_default() += 1;
    }

    /// Draws until the collected events have a new plan of `who`, and it is not building another.
    fn until_swapped(&mut self, who: RendererId, what: &str) {
        self.viewer.until(what, |viewer| {
            let swapped = |event: &Event| matches!(event, Event::Swapped { renderer: of, .. } if *of == who);
            viewer.events.iter().any(swapped) && !renderer(viewer, who).busy()
        });
    }
}

fn renderer(viewer: &TestShell, who: RendererId) -> &Renderer {
    match who {
        RendererId::Window => viewer.shell.window(),
        _ => &viewer.shell.viewer.a.renderer,
    }
}

/// Returns true if an error names its place: `--> file:line:column`.
fn has_place(text: &str) -> bool {
    text.lines().any(|line| {
        let place =
            line.trim_start().strip_prefix("--> ").map(|place| place.rsplitn(3, ':').collect::<Vec<_>>());
        place.is_some_and(|place| match place.as_slice() {
            [column, line, file] => {
                column.parse::<u32>().is_ok() && line.parse::<u32>().is_ok() && !file.is_empty()
            }
            _ => false,
        })
    })
}

/// Another copy of the files, for building plans without a device.
struct Beside {
    place: Place,
    /// The graphs of A and of the window.
    graphs: [Building; 2],
}

/// The inputs of a graph's build.
struct Building {
    planner: Planner,
    graph: String,
    set: Vec<(String, String)>,
    facts: Facts,
    catalog: Catalog,
    /// The plan of the intact files; `None` until it is built.
    plan: Option<Plan>,
}

impl Beside {
    fn new(viewer: &TestShell) -> Beside {
        let place = Place::shipped();
        let device = &viewer.shell.window().info().facts;
        let scene = viewer.shell.viewer.scene();
        let mut window = Catalog::default();
        paint::offer(&mut window);
        let graphs = [
            (RendererId::A, "pipelines/splat.ron", vec![NARROW], facts::catalog(scene)),
            (RendererId::Window, "pipelines/view/window.ron", vec![], window),
        ];
        let graphs = graphs.map(|(who, graph, set, catalog)| {
            let size = renderer(viewer, who).size();
            let facts = match who {
                RendererId::Window => facts::without_scene(device, size),
                _ => facts::facts(&SceneFacts::of(scene), device, size),
            };
            let mut building = Building {
                planner: Planner::new(Settings { worker: Some(common::worker()), ..Settings::default() }),
                graph: place.named(graph),
                set: set.into_iter().map(|(name, bits)| (name.to_owned(), bits.to_string())).collect(),
                facts,
                catalog,
                plan: None,
            };
            building.plan = Some(building.build().unwrap_or_else(|error| panic!("{error}")));
            building
        });
        Beside { place, graphs }
    }

    fn building(&mut self, who: RendererId) -> &mut Building {
        &mut self.graphs[usize::from(who == RendererId::Window)]
    }

    /// Returns the files of the folder that the graph is built from.
    fn files(&mut self, who: RendererId) -> Vec<String> {
        let folder = self.place.at("").canonicalize().expect("the folder is there");
        let wanted = self.building(who).planner.wanted();
        // Leaves out files that were looked for and do not exist.
        let there = wanted.iter().filter_map(|wanted| wanted.path.canonicalize().ok());
        let files = there.filter(|path| path.is_file());
        let name = |path: PathBuf| Some(path.strip_prefix(&folder).ok()?.to_string_lossy().into_owned());
        let mut files: Vec<String> = files.filter_map(name).collect();
        files.sort();
        files.dedup();
        assert!(files.len() > 5, "{files:?}");
        files
    }

    /// Builds the graph while the file `name` has these bytes, then restores the file.
    fn outcome(&mut self, who: RendererId, name: &str, bytes: &[u8], shipped: &[u8]) -> Outcome {
        self.place.write(name, bytes);
        let building = self.building(who);
        let outcome = match building.build() {
            // The viewer would drop the setting, and draw another picture even after the repair.
            _ if !building.declares_what_is_set() => Outcome::Other,
            Err(text) => Outcome::Failed(text),
            Ok(plan) if building.plan.as_ref() == Some(&plan) => Outcome::Same,
            Ok(_) => Outcome::Other,
        };
        self.place.write(name, shipped);
        outcome
    }
}

impl Building {
    /// Returns true if the graph still declares the parameters that are set, or does not load at all.
    fn declares_what_is_set(&mut self) -> bool {
        let Building { planner, graph, set, facts, catalog, .. } = self;
        planner.controls(graph, &[], facts, catalog).map_or(true, |declared| {
            set.iter().all(|(name, _)| declared.iter().any(|control| control.param.name == *name))
        })
    }

    /// Builds the plan and clears what does not affect the drawing: summary, culled passes and places in files.
    fn build(&mut self) -> Result<Plan, String> {
        self.planner.forget_files();
        let Building { planner, graph, set, facts, catalog, .. } = self;
        let plan = planner.plan(graph, set, facts, catalog);
        let mut plan = plan.map_err(|errors| errors.text(false).trim_end().to_owned())?;
        let nowhere = || Origin { file: String::new(), line: 0, column: 0 };
        plan.summary.clear();
        plan.culled.clear();
        let params = plan.params.iter_mut().map(|param| &mut param.origin);
        let resources = plan.resources.iter_mut().map(|resource| &mut resource.origin);
        let passes = plan.passes.iter_mut().map(|pass| &mut pass.origin);
        for origin in params.chain(resources).chain(passes) {
            *origin = nowhere();
        }
        Ok(plan)
    }
}
