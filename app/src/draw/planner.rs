//! Builds plans from graphs, and reports their errors with the source text.

use crate::draw::builtin;
use crate::draw::capacity::Capacities;
use splatgraph_framework::build_candidate;
use splatgraph_framework::ir::{Catalog, Facts, FileId, OUTPUTS, Origin, Request, Shader, Span, Value, Work};
use splatgraph_framework::lower::{self, Control, no_output};
use splatgraph_framework::plan::{Plan, Warning};
use splatgraph_framework::reload::Wanted;
use splatgraph_framework::shader::{Cancel, Glslang, SpirvStore, Worker};
use splatgraph_framework::source::{Diagnostic, Kind, Library, SourceMap, render_warnings};
pub use splatgraph_framework::source::{GraphErrors, PlainDiagnostic, Severity};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Arc, PoisonError, RwLock};

/// Settings of planners: shader compiler, store of compiled shaders, and folders that graphs may use.
#[derive(Clone, Debug, Default)]
pub struct Settings {
    /// Program that compiles shaders; `None` compiles in this process, which an invalid shader can crash.
    pub worker: Option<Worker>,
    /// Store that keeps compiled shaders between runs; `None` compiles all shaders in every run.
    pub store: Option<Arc<dyn SpirvStore>>,
    /// Additional folders from which graphs may use files.
    pub include_roots: Vec<PathBuf>,
}

static SETTINGS: RwLock<Settings> =
    RwLock::new(Settings { worker: None, store: None, include_roots: Vec::new() });

/// Sets the settings that [`Planner::default`] uses from now on.
///
/// The first compiler and the first store stay, because planners share compiled shaders. Folders accumulate over
/// several calls, and stay allowed until the process ends.
pub fn configure(settings: Settings) {
    let mut all = SETTINGS.write().unwrap_or_else(PoisonError::into_inner);
    all.worker = all.worker.take().or(settings.worker);
    all.store = all.store.take().or(settings.store);
    for root in settings.include_roots {
        if !all.include_roots.contains(&root) {
            all.include_roots.push(root);
        }
    }
}

/// Returns the settings of [`configure`].
pub fn settings() -> Settings {
    SETTINGS.read().unwrap_or_else(PoisonError::into_inner).clone()
}

/// Builder of plans, with a cache of compiled shaders.
pub struct Planner {
    /// True to let resources with disjoint lifetimes share memory; see [`Request::share_memory`].
    pub share_memory: bool,
    /// Minimum values of growing parameters; see [`Request::capacities`].
    pub capacities: Capacities,
    /// Outputs that plans must produce besides the picture, by name.
    pub outputs: Vec<String>,
    files: SourceMap,
    compiler: Glslang,
    settings: Settings,
    unsaved: BTreeMap<PathBuf, String>,
}

impl Default for Planner {
    /// Creates a planner with the settings of [`configure`].
    fn default() -> Planner {
        Planner::new(settings())
    }
}

impl Planner {
    /// Creates a planner with an empty cache.
    pub fn new(settings: Settings) -> Planner {
        let compiler = settings.worker.clone().map_or_else(Glslang::new, Glslang::in_worker);
        let compiler = match &settings.store {
            Some(store) => compiler.with_store(store.clone()),
            None => compiler,
        };
        let unsaved = BTreeMap::new();
        let files = files(&settings, &unsaved);
        Planner {
            share_memory: true,
            capacities: Capacities::default(),
            outputs: Vec::new(),
            files,
            compiler,
            settings,
            unsaved,
        }
    }

    /// Returns the number of shaders that were compiled, not taken from a cache.
    pub fn compiled(&self) -> usize {
        self.compiler.compiled_count()
    }

    /// Sets the cancellation token of later builds. A build fails soon after the token is set.
    pub fn set_cancel(&mut self, cancel: Cancel) {
        self.compiler.set_cancel(cancel);
    }

    /// Builds the plan of `graph`, a preset's name or a path. Later values in `set` override earlier ones.
    ///
    /// # Errors
    /// See [`Planner::plan_candidate`].
    pub fn plan(
        &mut self,
        graph: &str,
        set: &[(String, String)],
        facts: &Facts,
        catalog: &Catalog,
    ) -> Result<Plan, GraphErrors> {
        self.plan_candidate(graph, None, set, facts, catalog)
    }

    /// Builds a plan like [`Planner::plan`], for the graph at index `candidate` of [`lower::candidates`], if given.
    ///
    /// # Errors
    /// The graph or its shaders have errors, its requirements are not met, or an image or dispatch is too large for the
    /// device.
    pub fn plan_candidate(
        &mut self,
        graph: &str,
        candidate: Option<usize>,
        set: &[(String, String)],
        facts: &Facts,
        catalog: &Catalog,
    ) -> Result<Plan, GraphErrors> {
        let capacities = self.capacities.values();
        let mut facts = facts.clone();
        let asked = self.outputs.iter().map(|name| (format!("{OUTPUTS}{name}"), Value::Bool(true)));
        facts.host.extend(asked);
        let share_memory = self.share_memory;
        let request = Request { graph, set, capacities, facts: &facts, catalog, share_memory };
        let built = build_candidate(&request, candidate, &mut self.files, &mut self.compiler);
        let plan = built.map_err(|mut found| {
            self.outputs.iter().for_each(|name| name_graphs_with(name, &mut found));
            if !self.outputs.is_empty() {
                let panorama = Value::Text("equirectangular".to_owned());
                let controls = self.controls(graph, set, &facts, catalog).unwrap_or_default();
                // A panorama has its principal point in the middle, so it cannot be drawn as tiles.
                let has_tiles = controls.iter().all(|control| control.param.value != panorama);
                name_ways_to_draw_pixels(has_tiles, &mut found);
            }
            GraphErrors::new(&self.files, &found)
        })?;
        let too_large = splatgraph_runtime::too_large(&plan, &facts.device);
        let error = too_large
            .and_then(|(error, origin)| Some(Diagnostic::new(error.to_string(), self.token_at(origin)?, "")));
        error.map_or(Ok(plan), |error| Err(GraphErrors::new(&self.files, &[error])))
    }

    /// Requests every output that the graph of `plan` offers, while `build` runs. `None` if `plan` has them all.
    ///
    /// # Errors
    /// See `build`. A note says that every output is requested.
    pub fn with_every_output<T>(
        &mut self,
        plan: &Plan,
        build: impl FnOnce(&mut Planner) -> Result<T, GraphErrors>,
    ) -> Result<Option<T>, GraphErrors> {
        if plan.offered.len() == plan.outputs.len() {
            return Ok(None);
        }
        let requested = std::mem::replace(&mut self.outputs, plan.offered.clone());
        let built = build(self);
        self.outputs = requested;
        let note = format!("with every output requested: {}", plan.offered.join(", "));
        built.map(Some).map_err(|errors| errors.with_note(&note))
    }

    /// Returns the span of the token at an origin; `None` if the file is not open.
    fn token_at(&self, origin: &Origin) -> Option<Span> {
        let (file, ..) = self.files.opened().find(|(_, path, _)| *path == origin.file)?;
        let text = self.files.text(file);
        let line = text.split_inclusive('\n').take(origin.line as usize - 1).map(str::len).sum::<usize>();
        let columns = text[line..].char_indices().nth(origin.column as usize - 1);
        let start = line + columns.map_or(0, |(offset, _)| offset);
        let is_inside = |c: &char| !c.is_whitespace() && !"\",:(".contains(*c);
        let length = text[start..].chars().take_while(is_inside).map(char::len_utf8).sum::<usize>();
        Some(Span::new(file, start..start + length.max(1)))
    }

    /// Adds warnings about dispatches that devices with several subgroup sizes may refuse.
    ///
    /// Such a device must run a shader with the plan's size. A pipeline can request it only if the size of its
    /// workgroups in x is a multiple of it.
    pub fn warn_of_subgroups(&self, plan: &mut Plan) {
        let Some(&Value::Int(lanes)) = plan.facts.get("device.subgroup_size") else { return };
        let mut found: Vec<Warning> = Vec::new();
        for pass in &plan.passes {
            let Work::Dispatch { shader, .. } = pass.work else { continue };
            let Shader { name, reflection, .. } = &plan.shaders[shader.index()];
            let [x, y, z] = reflection.local_size;
            let is_certain = !reflection.has_subgroups() || i64::from(x) % lanes.max(1) == 0;
            // The iterations of a repeat have one origin.
            if is_certain || found.iter().any(|other| other.origin == pass.origin) {
                continue;
            }
            let message = format!("`{name}` uses subgroup operations in workgroups of {x} x {y} x {z}");
            let label = "devices with several subgroup sizes may refuse this";
            let diagnostic = self.token_at(&pass.origin).map(|span| Diagnostic::new(message, span, label));
            let help = "let `local_size_x` be a multiple of `DEVICE_SUBGROUP_SIZE`";
            found.extend(diagnostic.map(|diagnostic| Warning {
                diagnostic: diagnostic.with_help(help),
                origin: pass.origin.clone(),
            }));
        }
        plan.warnings.extend(found);
    }

    /// Renders warnings about a plan with the source text; empty if there are none.
    ///
    /// The plan must have been built after the last [`Planner::forget_files`].
    pub fn warnings(&self, warnings: &[Warning], colour: bool) -> String {
        let found: Vec<Diagnostic> = warnings.iter().map(|w| w.diagnostic.clone()).collect();
        render_warnings(&self.files, &found, colour)
    }

    /// Lists warnings about a plan as plain data; see [`Planner::warnings`].
    pub fn plain_warnings(&self, warnings: &[Warning]) -> Vec<PlainDiagnostic> {
        let plain = |found| PlainDiagnostic::new(&self.files, found, Severity::Warning);
        warnings.iter().map(|warning| plain(&warning.diagnostic)).collect()
    }

    /// Lists the parameters of `graph`, with the values of `set`; growing ones are at least [`Planner::capacities`].
    ///
    /// # Errors
    /// The graph cannot be read, a value in `set` is invalid, or a requirement is not met.
    pub fn controls(
        &mut self,
        graph: &str,
        set: &[(String, String)],
        facts: &Facts,
        catalog: &Catalog,
    ) -> Result<Vec<Control>, GraphErrors> {
        self.ask((graph, set), facts, catalog, lower::controls).map(|(_, controls)| controls)
    }

    /// Lists the names of the settings in `set` that `graph` rejects; see [`lower::rejected_settings`].
    pub fn rejected_settings(
        &mut self,
        graph: &str,
        set: &[(String, String)],
        facts: &Facts,
        catalog: &Catalog,
    ) -> Vec<String> {
        let ask = |request: &Request, files: &mut SourceMap| Ok(lower::rejected_settings(request, files));
        self.ask((graph, set), facts, catalog, ask).unwrap_or_default()
    }

    /// Returns the additional folders from which graphs may use files.
    pub fn include_roots(&self) -> &[PathBuf] {
        &self.settings.include_roots
    }

    /// Lists the folders on disk that are searched for a name in a file, in order of search.
    pub fn folders(&self, from: FileId, kind: Kind) -> Vec<String> {
        self.files.disk_folders(Some(from), kind)
    }

    /// Drops the cached files, so that the next plan reads them again. Unchanged shaders are not recompiled.
    pub fn forget_files(&mut self) {
        self.files = files(&self.settings, &self.unsaved);
    }

    /// Sets texts that replace the contents of files on disk, by path; see [`Library::unsaved`].
    pub fn read_unsaved(&mut self, texts: BTreeMap<PathBuf, String>) {
        self.unsaved = texts;
        self.forget_files();
    }

    /// Calls `ask` for a graph with the parameters in `set`, without building the graph.
    ///
    /// `ask` is a function of [`lower`], such as [`lower::standing`].
    ///
    /// # Errors
    /// See `ask`.
    pub fn ask<T>(
        &mut self,
        (graph, set): (&str, &[(String, String)]),
        facts: &Facts,
        catalog: &Catalog,
        ask: impl FnOnce(&Request, &mut SourceMap) -> Result<T, Vec<Diagnostic>>,
    ) -> Result<T, GraphErrors> {
        let (capacities, share_memory) = (self.capacities.values(), self.share_memory);
        let request = Request { graph, set, capacities, facts, catalog, share_memory };
        ask(&request, &mut self.files).map_err(|found| GraphErrors::new(&self.files, &found))
    }

    /// Returns the text of a graph; `None` if it cannot be read.
    pub fn graph_text(&mut self, graph: &str) -> Option<String> {
        let file = self.files.find(None, graph, Kind::Graph).ok()?;
        Some(self.files.text(file).to_owned())
    }

    /// Finds a shader that a graph names: its path, as in [`PlainDiagnostic::file`], and its text.
    ///
    /// `None` if it cannot be read.
    pub fn shader(&mut self, graph: &str, name: &str) -> Option<(String, String)> {
        let graph = self.files.find(None, graph, Kind::Graph).ok()?;
        let file = self.files.find(Some(graph), name, Kind::Shader).ok()?;
        Some(self.path_and_text(file))
    }

    /// Finds a file that `from` names, or a graph by its name or path.
    ///
    /// The id is valid until [`Planner::forget_files`]. `None` if the file cannot be read.
    pub fn file(&mut self, from: Option<FileId>, name: &str, kind: Kind) -> Option<FileId> {
        self.files.find(from, name, kind).ok()
    }

    /// Returns true if the graph is found among the built-in files, not on disk.
    pub fn is_built_in(&mut self, graph: &str) -> bool {
        let file = self.file(None, graph, Kind::Graph);
        file.is_some_and(|file| self.files.opened().any(|(id, _, is_on_disk)| id == file && !is_on_disk))
    }

    /// Describes names of graphs to compare that stand for one file, or for a file that hides a built-in graph.
    ///
    /// Names without a file are left out.
    pub fn compared(&mut self, names: &[&str]) -> Vec<String> {
        let (mut known, mut found): (Vec<(FileId, &str)>, Vec<String>) = Default::default();
        for name in names {
            let Some(file) = self.file(None, name, Kind::Graph) else { continue };
            let path = self.files.shown_path(file);
            if self.files.hides_built_in(file, name) {
                found.push(format!("`{name}` is {path}, which takes precedence over the built-in graph"));
            }
            match known.iter().find(|(other, _)| *other == file) {
                Some((_, other)) => found.push(format!("`{other}` and `{name}` are one graph: {path}")),
                None => known.push((file, name)),
            }
        }
        found
    }

    /// Returns the path of a file, as in [`PlainDiagnostic::file`], and its text.
    pub fn path_and_text(&self, file: FileId) -> (String, String) {
        (self.files.path(file).to_owned(), self.files.text(file).to_owned())
    }

    /// Lists the files on which the plans since the last [`Planner::forget_files`] depend.
    pub fn wanted(&self) -> Vec<Wanted> {
        self.files.wanted()
    }
}

/// Adds the built-in graphs with the output to the error about a missing output.
fn name_graphs_with(output: &str, errors: &mut [Diagnostic]) {
    let graphs = builtin::giving(output).join(", ");
    for error in errors.iter_mut().filter(|error| !graphs.is_empty() && error.message == no_output(output)) {
        error.help.push(format!("built-in graphs with this output, and their presets: {graphs}"));
    }
}

/// Adds the ways to draw large pictures to the error about the buffer from which outputs are written.
fn name_ways_to_draw_pixels(has_tiles: bool, errors: &mut [Diagnostic]) {
    for error in errors.iter_mut().filter(|error| error.message.starts_with("`pixels` has ")) {
        let tiles = if has_tiles { " tiles of it (docs/projections.md)," } else { "" };
        error.help.push(format!("draw a smaller picture,{tiles} or with `--backend reference`"));
    }
}

/// Lists the warnings about a plan that are not in `told`, by place and message, and adds them there.
pub fn new_warnings(plan: &Plan, told: &mut Vec<Warning>) -> Vec<Warning> {
    fn key(warning: &Warning) -> (&Origin, &str) {
        (&warning.origin, &warning.diagnostic.message)
    }
    let is_new = |warning: &&Warning| told.iter().all(|other| key(other) != key(warning));
    let new: Vec<Warning> = plan.warnings.iter().filter(is_new).cloned().collect();
    told.extend_from_slice(&new);
    new
}

/// Returns the message that a built-in graph replaces a file that the user named.
pub fn replaced(graph: &str) -> String {
    format!("there is no file {graph}: the built-in graph of this name is drawn")
}

/// Lists the settings that have no effect in a plan, each with the reason as a sentence.
pub fn without_effect(plan: &Plan, set: &[(String, String)]) -> Vec<(String, String)> {
    let mut found: Vec<(String, String)> = Vec::new();
    for (name, _) in set {
        if let (Some(_), Some(text)) = (plan.no_effect(name), plan.effect_text(name))
            && found.iter().all(|(other, _)| other != name)
        {
            found.push((name.clone(), text));
        }
    }
    found
}

fn files(settings: &Settings, unsaved: &BTreeMap<PathBuf, String>) -> SourceMap {
    let (include_roots, unsaved) = (settings.include_roots.clone(), unsaved.clone());
    SourceMap::new(Library { builtin: builtin::FILES, include_roots, unsaved, ..Library::default() })
}

#[cfg(test)]
pub(crate) mod testing {
    use super::*;
    use crate::draw::facts;

    /// Returns parameters as pairs of owned names and values.
    pub fn set(pairs: &[(&str, &str)]) -> Vec<(String, String)> {
        pairs.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned())).collect()
    }

    /// Builds the plan of a graph for the nominal scene, on the least capable supported device.
    pub fn plan(graph: &str, pairs: &[(&str, &str)], lanes: u32) -> Plan {
        let (facts, catalog) = (facts::nominal(lanes), facts::nominal_catalog());
        let plan = Planner::default().plan(graph, &set(pairs), &facts, &catalog);
        plan.unwrap_or_else(|errors| panic!("{graph}: {errors}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::facts;
    use splatgraph_framework::ir::{DescriptorKind, DeviceFacts};

    #[test]
    fn an_image_or_a_dispatch_that_is_too_large_for_the_device_is_an_error_at_its_declaration() {
        let folder = tempfile::tempdir().expect("a folder");
        let shader = "#version 460\nlayout(local_size_x = 64) in;\n\
            layout(rgba8, set = 0, binding = 0) uniform writeonly image2D picture;\n\
            void main() { imageStore(picture, ivec2(gl_GlobalInvocationID.xy), vec4(1)); }\n";
        std::fs::write(folder.path().join("paint.comp"), shader).expect("writable");
        let path = folder.path().join("graph.ron");
        let graph = path.display().to_string();
        let errors = |width: u32, groups: u32, most: u32| {
            let text = format!(
                "Graph(\n  version: 1, summary: \"Too large\",\n  resources: {{\n    \"out\": Image(format: \"rgba8\", size: ({width}, 8)),\n  }},\n  \
                 passes: [\n    Dispatch(name: \"paint\", shader: \"paint.comp\", size: Groups({groups}, {groups}, {groups}), \
                 bind: {{ \"picture\": \"out\" }}),\n  ],\n  output: \"out\",\n)"
            );
            std::fs::write(&path, text).expect("writable");
            let device = DeviceFacts { max_image_size: most, ..facts::portable_device(32) };
            let facts = facts::without_scene(&device, facts::DEFAULT_SIZE);
            Planner::default().plan(&graph, &[], &facts, &Catalog::default()).err()
        };
        assert_eq!(errors(16_384, 1, 16_384).map(|error| error.to_string()), None);
        let error = errors(16_384, 1, 8192).expect("the image is too large");
        assert_eq!((error.found[0].line, error.found[0].column, error.found[0].end_column), (4, 6, 9));
        assert!(error.found[0].message.ends_with("expected at most 8192, found 16384"), "{error}");
        let error = errors(64, 65_535, 8192).expect("the dispatch is too large");
        assert_eq!(error.found[0].line, 7, "{error}");
        assert!(error.found[0].message.starts_with("pass `paint` has more invocations"), "{error}");
    }

    #[test]
    fn outputs_of_a_picture_that_is_too_large_for_a_buffer_are_answered_with_other_ways_to_draw_it() {
        let mut planner = Planner { outputs: vec!["alpha".into()], ..Planner::default() };
        let facts = facts::facts(&facts::SceneFacts::NOMINAL, &facts::portable_device(32), (4100, 4100));
        let errors =
            planner.plan("splat", &[], &facts, &facts::nominal_catalog()).expect_err("it is too large");
        let text = errors.to_string();
        assert!(text.contains("`pixels` has 128.3 MiB, and the device binds at most 128.0 MiB"), "{text}");
        assert!(text.contains("= help: draw a smaller picture, tiles of it"), "{text}");
        let errors = planner
            .plan("equirectangular", &[], &facts, &facts::nominal_catalog())
            .expect_err("it is too large");
        let text = errors.to_string();
        assert!(text.contains("= help: draw a smaller picture, or with `--backend reference`"), "{text}");
    }

    #[test]
    fn the_built_in_graphs_bind_as_many_storage_buffers_as_the_portable_device_promises() {
        let catalog = facts::nominal_catalog();
        let mut planner = Planner { outputs: vec!["depth".into()], ..Planner::default() };
        let mut most = 0;
        for lanes in [4, facts::USUAL_SUBGROUP_SIZE] {
            let facts = facts::nominal(lanes);
            for graph in ["splat", "tiled"] {
                let set = [("sh_storage".to_owned(), "f32".to_owned())];
                let plan = planner.plan(graph, &set, &facts, &catalog).unwrap_or_else(|e| panic!("{e}"));
                for pass in &plan.passes {
                    let buffers = pass.bindings.iter().filter(|b| b.kind == DescriptorKind::StorageBuffer);
                    most = most.max(buffers.count());
                }
            }
        }
        assert_eq!(most, facts::MAX_STORAGE_BUFFERS);
    }
}
