//! Measures every setting of a graph in every view, and stores the rows in a file.

use super::ledger::{self, Book, Ledger, Origin};
use super::measure::{MAX_PENDING, Pending, Sessions};
use super::pictures::Album;
use crate::draw::interleaved::{Effort, Frames};
use crate::draw::projection;
use crate::draw::session::Session;
use crate::io::image::Image;
use crate::io::program;
use crate::io::report::text::hex;
use crate::studies::measurement::plans::{Planned, Plans, SamePlan, to_measure};
use crate::studies::measurement::settings;
use crate::studies::measurement::time::FRAMES_DIVISOR;
use crate::studies::measurement::view::{View, start};
use crate::studies::provenance::Provenance;
use crate::studies::study::{Listener, Setting, Steps, StudyError, Subject};
use indexmap::IndexSet;
use splatgraph_api::{Compiled, Device};
use splatgraph_assets::{Camera, Projection, Scene};
use splatgraph_framework::ir::Param;
use splatgraph_framework::lower::Control;
use splatgraph_reference::PictureMemoryError;
use std::collections::{BTreeSet, HashSet};
use std::ffi::OsStr;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::panic::resume_unwind;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, Receiver, Sender, SyncSender};
use std::thread::{self, Scope};

/// The parameters of a ledger.
pub struct Wanted {
    /// The graph whose parameters are changed.
    pub pipeline: String,
    /// Names and values of the parameters that are the same in every setting.
    pub set: Vec<(String, String)>,
    /// Other graphs to measure with their defaults, besides the built-in ones.
    pub graphs: Vec<String>,
    /// Prefixes of the names of the settings to measure; empty for all. The exact settings, `graphs`, and settings with
    /// rows of an earlier run are always measured.
    pub only: Vec<String>,
    /// Numbers of frames and rounds.
    pub frames: Frames,
    /// True pictures, one per camera, with the name of their source; `None` for the exact renderer's.
    pub truths: Option<(String, Vec<Image>)>,
    /// The command line, for the ledger.
    pub command: String,
    /// Options with which the device was opened, such as validation; part of [`Origin::opened`].
    pub opened: String,
    /// The file of the ledger, from which an interrupted study resumes, with the pictures' folder next to it.
    ///
    /// `None` stores neither.
    pub file: Option<PathBuf>,
}

/// Maximum number of views with their true pictures in memory at once.
const VIEWS_AT_ONCE: usize = 8;

/// Measures the wanted settings, and returns the ledger with their rows and those of earlier runs.
///
/// # Errors
/// See [`Study::new`], [`Study::book`] and [`Study::measure`].
pub fn study(subject: &Subject, wanted: &Wanted, listener: &mut dyn Listener) -> Result<Ledger, StudyError> {
    let mut study = Study::new(subject, wanted, listener)?;
    let mut book = study.book(wanted.file.clone(), listener)?;
    // Rows of an interrupted run stay, so its command is stored with the first of them.
    book.ledger.add_command(&wanted.command);
    let album = wanted.file.as_deref().map_or_else(Album::default, Album::beside);
    study.measure(subject, wanted, 0..subject.cameras.len(), (&mut book, &album), listener)?;
    Ok(book.ledger)
}

/// The settings to measure, and the sessions that draw them.
pub struct Study {
    /// Session that draws the graph with every parameter at its exact value.
    exact: Session,
    /// Session that draws the setting that is being measured.
    session: Session,
    /// The settings, each with the hash of its plans, `None` if one cannot be built. The exact settings are first.
    settings: Vec<(Setting, Option<u64>)>,
    same_plan: SamePlan,
    /// The plans of each setting.
    built: Plans,
    origin: Origin,
    /// Compiled pipelines of the settings, kept so that they are not compiled again; empty on CPUs.
    _pipelines: Vec<Compiled>,
}

impl Study {
    /// Chooses the settings, and builds the plans of each.
    ///
    /// # Errors
    /// [`Wanted::file`] is not a ledger, the subject has no camera or none that sees a splat, an exact picture does
    /// not fit in memory, a graph has errors, one of [`Wanted::graphs`] has another projection, no setting's name
    /// begins with a prefix of [`Wanted::only`], the executable cannot be read, the device fails, or the listener
    /// cancels.
    pub fn new(subject: &Subject, wanted: &Wanted, listener: &mut dyn Listener) -> Result<Study, StudyError> {
        // Rows of an earlier run are shown, too: their settings' plans are needed to drop rows that are out of date.
        let earlier = wanted.file.as_deref().map_or_else(|| Ok(BTreeSet::new()), ledger::replaceable)?;
        let camera = subject.first()?;
        if wanted.truths.is_none() {
            subject.check_views(listener)?;
        }
        let mut session = subject.session(&wanted.pipeline, &wanted.set)?;
        let controls = session.controls((camera.width, camera.height))?;
        check_graphs(
            &mut session,
            wanted,
            projection::of_controls(&controls),
            (camera.width, camera.height),
        )?;
        let settings = chosen(wanted, &earlier, &controls)?;
        let mut exact = subject.session(&settings[0].pipeline, &settings[0].set)?;
        exact.prepare((camera.width, camera.height), &mut |_| {})?;
        let is_wanted = |setting: &Setting| {
            let name = &setting.name;
            let is_graph = name.starts_with(settings::GRAPH);
            *name == settings::EXACT || is_graph || only(wanted, name) || earlier.contains(name)
        };
        let Planned { settings, same_plan, built, pipelines } =
            to_measure(settings, &mut exact, &subject.cameras, &is_wanted, listener)?;
        let origin = origin(subject, wanted, &controls, settings[0].1)?;
        Ok(Study { exact, session, settings, same_plan, built, origin, _pipelines: pipelines })
    }

    /// Returns the inputs on which the rows depend.
    pub fn origin(&self) -> &Origin {
        &self.origin
    }

    /// Returns the settings that are not measured because their plans equal another's.
    pub fn same_plan(&self) -> &SamePlan {
        &self.same_plan
    }

    /// Opens a ledger, with the rows of an earlier run that has the same origin. Without a `file`, nothing is saved.
    ///
    /// # Errors
    /// See [`Book::open`].
    pub fn book(&self, file: Option<PathBuf>, listener: &mut dyn Listener) -> Result<Book, StudyError> {
        let plans: Vec<_> =
            self.settings.iter().map(|(setting, plan)| (setting.name.as_str(), *plan)).collect();
        let name = file.as_deref().map(|file| file.display().to_string()).unwrap_or_default();
        let (mut book, lost) = Book::open(file, self.origin.clone(), &plans)?;
        book.ledger.add_same_plan(self.same_plan.clone());
        lost.iter().for_each(|line| listener.say(line));
        if !book.ledger.rows.is_empty() {
            listener.say(&format!("{name}: {} rows of an earlier run are kept", book.ledger.rows.len()));
        }
        Ok(book)
    }

    /// Adds the missing rows and pictures of some views, which are given as indices of the subject's cameras.
    ///
    /// # Errors
    /// The device fails, a file cannot be written, an exact picture does not fit in memory, or the listener cancels.
    pub fn measure(
        &mut self,
        subject: &Subject,
        wanted: &Wanted,
        views: std::ops::Range<usize>,
        (book, album): (&mut Book, &Album),
        listener: &mut dyn Listener,
    ) -> Result<(), StudyError> {
        let Study { exact, session, settings, built, .. } = self;
        let mut steps = Steps::new(listener, "measuring", settings.len() * views.len());
        let last = views.end;
        let mut together = Vec::new();
        for index in views {
            let camera = &subject.cameras[index];
            let lacks = |(setting, _): &&(Setting, Option<u64>)| !book.has(&setting.name, &camera.img_name);
            let lacking = settings.iter().filter(lacks).count();
            steps.skip(settings.len() - lacking);
            if lacking > 0 {
                exact.prepare((camera.width, camera.height), &mut |_| {})?;
                let effort = wanted.frames.choose(exact, camera, FRAMES_DIVISOR)?;
                let picture = wanted.truths.as_ref().and_then(|(_, pictures)| pictures.get(index));
                together.push((view(&subject.scene, camera, picture)?, effort));
            }
            if together.len() < VIEWS_AT_ONCE && index + 1 < last {
                continue;
            }
            let ms = together.iter().map(|(view, _)| book.exact_ms(&view.camera.img_name)).collect();
            let have: HashSet<_> =
                book.ledger.rows.iter().map(|row| (row.setting.clone(), row.camera.clone())).collect();
            let is_cpu = exact.device().info().is_cpu();
            thread::scope(|scope| {
                let (rows, measured) = mpsc::sync_channel(MAX_PENDING);
                let (sender, kept) = mpsc::channel();
                let keeper = start(scope, || keep(measured, sender, book, album))?;
                // On a CPU, each row waits until the file is written, which would compete with frames for cores.
                let ends = (rows, is_cpu.then_some(kept));
                let done = measure_views(
                    scope,
                    (exact, session),
                    (settings, built, subject.cameras.len()),
                    &together,
                    (ms, &have),
                    ends,
                    &mut steps,
                );
                // Joined after an error, too, so that no finished row is lost.
                keeper.join().unwrap_or_else(|panic| resume_unwind(panic)).and(done)
            })?;
            together.clear();
        }
        Ok(())
    }
}

/// A row whose comparison may still run, with its view.
type Measured<'scope> = (&'scope View, Pending<'scope>);

/// Adds rows to the ledger, and their pictures to the album, while frames are drawn.
///
/// Ends when the sender is dropped, or a file cannot be written. Sends to `kept` whenever the ledger's file is written.
fn keep(
    measured: Receiver<Measured>,
    kept: Sender<()>,
    book: &mut Book,
    album: &Album,
) -> Result<(), StudyError> {
    while let Ok(mut next) = measured.recv() {
        // Every write contains all rows, so pending rows share one.
        for left in (0..MAX_PENDING).rev() {
            let (view, pending) = next;
            let (row, picture) = pending.finish();
            let stored = match picture {
                Some(picture) => album.keep(&book.ledger, &row, &picture, view.picture()),
                None => Ok(()),
            };
            book.insert(row);
            let another = (left > 0 && stored.is_ok()).then(|| measured.try_recv().ok()).flatten();
            match another {
                Some(another) => next = another,
                None => {
                    book.save()?;
                    stored?;
                    let _ = kept.send(());
                    break;
                }
            }
        }
    }
    Ok(())
}

/// Measures every setting in the views whose rows are missing, and sends the rows to [`keep`].
///
/// `ms` are the exact settings' milliseconds per view, if known. `have` are the settings and cameras of existing rows.
/// Times are averaged over `all` views. With `kept`, waits after each row until it is written.
fn measure_views<'scope>(
    scope: &'scope Scope<'scope, '_>,
    (exact, session): (&mut Session, &mut Session),
    (settings, built, all): (&[(Setting, Option<u64>)], &Plans, usize),
    views: &'scope [(View, Effort)],
    (mut ms, have): (Vec<Option<f64>>, &HashSet<(String, String)>),
    (rows, kept): (SyncSender<Measured<'scope>>, Option<Receiver<()>>),
    steps: &mut Steps,
) -> Result<(), StudyError> {
    // All views of a setting are measured together, so that its plan and its shaders are built only once.
    for (setting, plan) in settings {
        let built = built.get(&setting.name);
        let mut sessions = Sessions::new(exact, session, setting, (*plan, built), all);
        for ((view, effort), ms) in views.iter().zip(&mut ms) {
            let name = &view.camera.img_name;
            if have.contains(&(setting.name.clone(), name.clone())) {
                continue;
            }
            steps.next(&format!("{name}, {}", setting.name))?;
            let row = sessions.measure(scope, view, *effort, *ms)?;
            *ms = ms.or(row.exact_ms());
            let is_sent = rows.send((view, row)).is_ok();
            if !is_sent || kept.as_ref().is_some_and(|kept| kept.recv().is_err()) {
                // `keep` ended with an error, which its thread returns.
                return Ok(());
            }
        }
    }
    Ok(())
}

fn only(wanted: &Wanted, setting: &str) -> bool {
    wanted.only.is_empty() || wanted.only.iter().any(|name| setting.starts_with(name.as_str()))
}

/// Checks that [`Wanted::graphs`] can be read, and have the projection of the exact pictures.
fn check_graphs(
    session: &mut Session,
    wanted: &Wanted,
    projection: Projection,
    size: (u32, u32),
) -> Result<(), StudyError> {
    for graph in &wanted.graphs {
        session.set_graph(graph, &wanted.set);
        let found = projection::of_controls(&session.controls(size)?);
        if found != projection {
            return Err(StudyError::Input(format!(
                "{graph}: expected a graph for {projection} cameras, as {} is, found one for {found} cameras",
                wanted.pipeline
            )));
        }
    }
    session.set_graph(&wanted.pipeline, &wanted.set);
    Ok(())
}

/// Lists all settings of the graph, the exact ones first, and checks the prefixes of [`Wanted::only`]. If `only` or an
/// `earlier` row names a parameter without an exact value, its current value counts as exact.
fn chosen(
    wanted: &Wanted,
    earlier: &BTreeSet<String>,
    controls: &[Control],
) -> Result<Vec<Setting>, StudyError> {
    let mut controls = controls.to_vec();
    let is_named =
        |name: &str| wanted.only.iter().chain(earlier).any(|other| other.split(' ').next() == Some(name));
    for Param { name, exact, value, .. } in controls.iter_mut().map(|control| &mut control.param) {
        // The exact value of a new method is seldom known, so a parameter that is asked for is compared with its value.
        if exact.is_none() && is_named(name.as_str()) {
            *exact = Some(value.clone());
        }
    }
    let mut all = settings::measured(&wanted.pipeline, &wanted.set, &controls);
    // The names of earlier rows have the graphs that they drew, so a run without these graphs keeps the rows.
    let drawn = earlier.iter().filter_map(|name| name.strip_prefix(settings::GRAPH));
    let graphs: IndexSet<&str> = wanted.graphs.iter().map(String::as_str).chain(drawn).collect();
    all.extend(graphs.into_iter().map(|graph| settings::of_graph(graph, &wanted.set)));
    for name in &wanted.only {
        settings::add(&mut all, &wanted.set, name);
        if !all.iter().any(|setting| setting.name.starts_with(name.as_str())) {
            let known = all.into_iter().map(|setting| setting.name).collect();
            return Err(StudyError::UnknownSetting { name: name.clone(), known });
        }
    }
    Ok(all)
}

/// Collects the inputs on which the rows depend. `exact` is the hash of the exact settings' plans.
fn origin(
    subject: &Subject,
    wanted: &Wanted,
    controls: &[Control],
    exact: Option<u64>,
) -> Result<Origin, StudyError> {
    let info = subject.device.info();
    let is_set = |control: &&Control| wanted.set.iter().any(|(name, _)| *name == control.param.name);
    let pair = |control: &Control| (control.param.name.clone(), control.param.value.to_string());
    let (truth, truth_content) = match &wanted.truths {
        Some((name, pictures)) => (name.clone(), content(pictures)),
        None => ("reference".to_owned(), String::new()),
    };
    Ok(Origin {
        provenance: Provenance::of(subject),
        program: program::hash()
            .map_err(|error| StudyError::Input(format!("the ledger's origin: {error}")))?,
        content: hex(subject.scene.identity()),
        tags: subject.scene.notes().rules().map(|(name, value)| (name.to_owned(), value.to_owned())).into(),
        // Without its folder, because the plans identify the graph.
        pipeline: name_of(&wanted.pipeline),
        // Parsed values in the graph's order, because users may write another order, and 0.010 for 0.01.
        set: controls.iter().filter(is_set).map(pair).collect(),
        exact: exact.map_or_else(String::new, hex),
        truth,
        truth_content,
        opened: format!("{:?}, bounds {:?}, {}", info.facts, info.robustness, wanted.opened),
        rounds: wanted.frames.rounds,
        frames: wanted.frames.frames,
    })
}

fn name_of(pipeline: &str) -> String {
    Path::new(pipeline).file_name().map_or(pipeline.into(), OsStr::to_string_lossy).into_owned()
}

fn content(pictures: &[Image]) -> String {
    let mut hash = DefaultHasher::new();
    for picture in pictures {
        (picture.width, picture.height).hash(&mut hash);
        picture.rgb.as_flattened().iter().for_each(|value| value.to_bits().hash(&mut hash));
    }
    hex(hash.finish())
}

/// Makes a view with the exact renderer's picture and order, or with a given picture instead of the renderer's.
///
/// # Errors
/// The renderer's picture does not fit in memory.
fn view(scene: &Scene, camera: &Camera, picture: Option<&Image>) -> Result<View, PictureMemoryError> {
    let view = View::exact(scene, camera)?.with_order(scene);
    Ok(match picture {
        Some(picture) => view.with_picture(picture.clone()),
        None => view,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::backend::Backend;
    use crate::draw::builtin;
    use splatgraph_assets::synth;
    use splatgraph_null::{Config, open};
    use std::fs;
    use std::ops::ControlFlow;
    use std::sync::Arc;

    /// A listener that cancels the measurements once this many steps are done.
    struct CancelBefore(u64);

    impl Listener for CancelBefore {
        fn progress(&mut self, task: &str, done: u64, _: u64, _: &str) -> ControlFlow<()> {
            if task == "measuring" && done == self.0 {
                ControlFlow::Break(())
            } else {
                ControlFlow::Continue(())
            }
        }

        fn say(&mut self, _: &str) {}
    }

    /// A request for the settings of `splat` whose names begin with `only`.
    fn wanted(only: &str) -> Wanted {
        Wanted {
            pipeline: "splat".into(),
            set: Vec::new(),
            graphs: Vec::new(),
            only: vec![only.into()],
            frames: Frames { rounds: 1, frames: Some(1) },
            truths: None,
            opened: String::new(),
            command: String::new(),
            file: None,
        }
    }

    #[test]
    fn a_cancelled_ledger_keeps_every_measured_row() {
        let device = Backend::Null(open(&Config::default()).0.expect("no fault is set"));
        let scene = synth::generate("demo", 50, 0).expect("a small scene");
        let camera = Camera::framing(&scene, 32, 24);
        let cameras = ["a", "b"].map(|name| Camera { img_name: name.into(), ..camera.clone() }).to_vec();
        let subject = Subject { device, name: "demo".into(), scene: Arc::new(scene), cameras };
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("ledger.json");
        let wanted = Wanted { file: Some(file.clone()), ..wanted("key_bits") };
        // Both views of the exact settings, and one of the next setting.
        let cancelled = study(&subject, &wanted, &mut CancelBefore(3));
        assert!(matches!(cancelled, Err(StudyError::Cancelled)), "{:?}", cancelled.err());
        let text = fs::read_to_string(&file).expect("the ledger");
        let ledger: serde_json::Value = serde_json::from_str(&text).expect("JSON");
        assert_eq!(ledger["rows"].as_array().map(Vec::len), Some(3), "{text}");
    }

    #[test]
    fn a_parameter_without_an_exact_value_is_measured_if_only_or_an_earlier_row_names_it() {
        let presets = builtin::presets();
        let splat = presets.iter().find(|preset| preset.name == "splat").expect("it is built in");
        let mut controls = splat.params.clone();
        controls.iter_mut().for_each(|control| control.param.exact = None);
        let is_measured = |only: &str, earlier: Option<&str>| {
            let earlier: BTreeSet<String> = earlier.map(str::to_owned).into_iter().collect();
            let all = chosen(&wanted(only), &earlier, &controls).expect("a known setting");
            all.iter().any(|setting| setting.name.starts_with("key_bits = "))
        };
        assert!(is_measured("key_bits", None));
        assert!(is_measured("defaults", Some("key_bits = 8")), "otherwise, its rows are dropped");
        assert!(!is_measured("defaults", None));
    }

    #[test]
    fn the_graph_of_an_earlier_row_is_measured_without_being_given_again() {
        let presets = builtin::presets();
        let splat = presets.iter().find(|preset| preset.name == "splat").expect("it is built in");
        let set = vec![("cutoff".into(), "2".into())];
        let wanted = Wanted { set, graphs: vec!["a.ron".into()], ..wanted("graph") };
        let earlier = ["graph a.ron", "graph my/b.ron", "defaults"].map(str::to_owned).into();
        let all = chosen(&wanted, &earlier, &splat.params).expect("known settings");
        let graphs: Vec<_> = all.into_iter().filter(|setting| setting.name.starts_with("graph ")).collect();
        let of = |graph: &str| Setting {
            name: format!("graph {graph}"),
            pipeline: graph.into(),
            set: wanted.set.clone(),
        };
        assert_eq!(graphs, [of("a.ron"), of("my/b.ron")]);
    }

    #[test]
    fn more_rows_than_are_written_at_once_are_all_kept() {
        let scene = synth::generate("demo", 50, 0).expect("a small scene");
        let view = View::exact(&scene, &Camera::framing(&scene, 32, 24)).expect("a small picture");
        let (mut book, _) = Book::open(None, ledger::testing::origin(), &[]).expect("no file");
        let count = 2 * MAX_PENDING + 1;
        let (sender, rows) = mpsc::sync_channel(count);
        for at in 0..count {
            sender.send((&view, Pending::failed(&format!("setting {at}"), "a"))).expect("room");
        }
        drop(sender);
        keep(rows, mpsc::channel().0, &mut book, &Album::default()).expect("nothing is written");
        assert_eq!(book.ledger.rows.len(), count);
    }
}
