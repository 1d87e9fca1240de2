//! Walks the passes, and resolves conditions, repeats, swaps and includes.

use indexmap::IndexMap;
use std::collections::BTreeMap;
use std::rc::Rc;

use super::declared::{self, Exposed};
use super::defines::{Constants, defines};
use super::document::Opened;
use super::include::Written;
use super::params;
use super::require::{self, Choices};
use super::resources::{Handle, History, PingPong};
use super::scope::{Names, Notes, Place, describe};
use super::{
    Lowered, LoweredBind, LoweredInclude, LoweredPass, LoweredPush, LoweredResource, LoweredSize,
    LoweredWork, RemovedPass, RemovedUse, ResourceHandle, ShaderName, SkippedUse,
};
use crate::ir::{
    Culled, DrawCall, EXPORT, FileId, Format, HOST, LIVE_BLOCK, Load, Param, ParamSet, Request, Run, Shape,
    Source, Span, Stat, Target, Value,
};
use crate::schema::{Call, Expression, Graph, Number, PassDecl, Reference, Size, folded, is_choice};
use crate::source::{Diagnostic, Outline, Path, SourceMap};

/// Maximum number of passes after repeats: far beyond any use, but few enough that a typing error cannot exhaust memory.
const MAX_PASSES: usize = 20_000;

/// Limits the work of the walk: declarations with their entries, and iterations of repeats.
const MAX_STEPS: usize = 25 * MAX_PASSES;

/// Maximum length of a pass's name in the file, in bytes.
const LONGEST_NAME: usize = 256;

/// Maximum number of errors before the walk ends.
const MAX_ERRORS: usize = 20;

/// The state of the walk.
pub(super) struct Lowering<'a> {
    pub request: &'a Request<'a>,
    pub files: &'a mut SourceMap,
    pub errors: Vec<Diagnostic>,
    pub resources: Vec<LoweredResource>,
    /// Name and place of every resource, to detect duplicates.
    pub resource_names: BTreeMap<String, Span>,
    pub ping_pongs: Vec<PingPong>,
    passes: Vec<LoweredPass>,
    /// Counts towards [`MAX_STEPS`].
    steps: usize,
    pub choices: Choices<'a>,
    pub known: declared::Known,
    /// Name and place of every pass, to detect duplicates.
    pass_names: BTreeMap<String, Option<Span>>,
    /// Name and place of every include, to detect duplicates.
    pub include_names: BTreeMap<String, Span>,
    pub culled: Vec<Culled>,
    pub histories: Vec<History>,
    pub unwritten: Vec<RemovedUse>,
    pub removed: Vec<RemovedPass>,
    pub skipped: Vec<SkippedUse>,
    /// As [`Lowered::shape`].
    pub shape: ParamSet,
    /// As [`Lowered::results`].
    pub results: ParamSet,
    /// Statistics of this graph and of its parts, with their places in the files.
    pub stats: Vec<(Stat<ResourceHandle>, Span)>,
    /// The files being included, outermost first.
    pub includes: Vec<FileId>,
    pub included: Vec<LoweredInclude>,
}

/// One graph file in the walk: the root, or an include.
pub(super) struct Level {
    pub file: FileId,
    pub graph: Rc<Graph>,
    pub outline: Rc<Outline>,
    pub names: Names,
    /// Its own parameters and the exposed ones of its parts.
    pub params: Vec<Param>,
    pub exposed: Exposed,
    /// `None` for an invalid declaration.
    pub handles: IndexMap<String, Option<Handle>>,
    /// Parameters that decide which resource of an include a name means.
    pub given: BTreeMap<String, ParamSet>,
    /// Includes without resources: removed by the condition at a place, or invalid.
    pub absent: BTreeMap<String, Option<Span>>,
    /// Prefix for the names of passes and resources.
    pub prefix: String,
    /// Suffix for the names of passes: the indices of repeats.
    pub suffix: String,
    /// Index into [`Lowering::included`]; `None` for the root.
    pub include: Option<usize>,
    /// Parameters that the includes and repeats around the present pass depend on.
    pub around: ParamSet,
    defines: Rc<Vec<(String, String)>>,
    unfit: Rc<Vec<(String, String)>>,
    /// As [`LoweredPass::constants`].
    pub constants: Rc<BTreeMap<String, ParamSet>>,
}

impl Level {
    /// Notes the parameters that decide which resource of an include a name means.
    pub fn note_given(&self, name: &str) {
        if let Some(params) = self.given.get(name) {
            self.names.note_decided(params);
        }
    }
}

/// The names at the start of a level.
pub(super) struct Scope {
    /// Facts and parameters.
    pub names: Names,
    pub params: Vec<Param>,
    pub exposed: Exposed,
}

/// The fields that all kinds of passes share.
pub(super) struct Head<'a> {
    pub name: &'a str,
    pub phase: &'a Option<String>,
    pub run: Run,
    pub place: &'a Place,
}

impl<'a> Lowering<'a> {
    pub fn new(request: &'a Request<'a>, files: &'a mut SourceMap) -> Self {
        Lowering {
            request,
            files,
            errors: Vec::new(),
            resources: Vec::new(),
            resource_names: BTreeMap::new(),
            ping_pongs: Vec::new(),
            passes: Vec::new(),
            steps: 0,
            choices: Choices::new(request),
            known: Default::default(),
            // The frame's last passes, which the solver adds.
            pass_names: [EXPORT, HOST].map(|name| (name.to_string(), None)).into(),
            include_names: BTreeMap::new(),
            culled: Vec::new(),
            histories: Vec::new(),
            unwritten: Vec::new(),
            removed: Vec::new(),
            skipped: Vec::new(),
            shape: ParamSet::new(),
            results: ParamSet::new(),
            stats: Vec::new(),
            includes: Vec::new(),
            included: Vec::new(),
        }
    }

    pub fn run(mut self) -> Result<Lowered, Vec<Diagnostic>> {
        let chosen = self.choices.root(self.files)?;
        let (root, fallbacks) = (&chosen.opened, &chosen.fallbacks);
        let parameters = declared::parameters(root, &mut self.choices, self.files, &mut self.known)?;
        let resolved = params::resolve(root, &parameters, self.request, self.files, &mut self.errors);
        if !self.errors.is_empty() {
            return Err(require::explained(self.errors, fallbacks));
        }
        let (names, params) = (resolved.names, resolved.params.clone());
        let scope = Scope { names, params, exposed: parameters.exposed.clone() };
        let mut level = self.level(root, scope, String::new());
        if let Some(port) = root.graph.ports.keys().next() {
            let span = root.outline.key(&Path::root().field("ports").key(port));
            self.errors.push(
                Diagnostic::new("this graph is made to be included", span, "nothing is bound to this port")
                    .with_help("name a graph that includes it"),
            );
            return Err(self.errors);
        }
        self.check_outputs(&level);
        if !self.errors.is_empty() {
            return Err(self.errors);
        }
        self.includes.push(root.file);
        self.declare(&mut level);
        let passes = Place::new(&root.outline, Path::root().field("passes"));
        self.walk(&mut level, &root.graph.passes, &passes);
        level.names.take_notes();
        let output = self.output(&level);
        let outputs = self.outputs(&level);
        self.stats(&level);
        self.results.extend(level.names.take_notes().all());
        let live_bytes = resolved.live_bytes.next_multiple_of(16).max(16);
        let live_span = root.outline.key(&Path::root().field("params"));
        let live_shape = Shape::Buffer { stride: live_bytes, count: 1 };
        let live = self.add(LIVE_BLOCK.into(), live_shape, Source::Live, live_span);
        self.end_histories();
        match output {
            Some((output, output_span)) if self.errors.is_empty() => Ok(Lowered {
                name: self.request.graph.into(),
                summary: folded(&root.summary),
                based_on: root.based_on.clone(),
                fallbacks: fallbacks.clone(),
                facts: self.request.facts.named(),
                live_glsl: params::live_glsl(&resolved.params),
                params: resolved.params,
                live_params: resolved.live,
                shape: self.shape,
                results: self.results,
                resources: self.resources,
                passes: self.passes,
                culled: self.culled,
                removed: self.removed,
                skipped: [resolved.skipped, self.skipped].concat(),
                unwritten: self.unwritten,
                includes: self.included,
                output,
                output_span,
                outputs,
                stats: self.stats.into_iter().map(|(stat, _)| stat).collect(),
                live,
            }),
            _ => Err(self.errors),
        }
    }

    /// Creates a level, and evaluates its `let`s.
    pub(super) fn level(&mut self, opened: &Opened, scope: Scope, prefix: String) -> Level {
        let Scope { mut names, params, exposed } = scope;
        for (name, number) in &opened.graph.lets {
            let place = Place::new(&opened.outline, Path::root().field("let").key(name));
            if names.values.contains_key(name) || names.live.contains(name) {
                let taken = "the name is already that of a parameter, a fact or a `let`";
                self.errors.push(Diagnostic::new(format!("`{name}` is declared twice"), place.key(), taken));
                continue;
            }
            let (value, read) = names.traced(|| names.evaluate(number, &place));
            match value {
                Ok(value) => {
                    let params: ParamSet = names.named_by(number).difference(&read).copied().collect();
                    if !params.is_empty() {
                        let (name, span, decided) = (name.clone(), place.key(), read.clone());
                        self.skipped.push(SkippedUse { params, name, span, decided });
                    }
                    names.define(name, value, read);
                }
                Err(diagnostic) => self.errors.push(diagnostic),
            }
        }
        let Constants { defines, unfit, params: constants } = defines(&names, &params);
        let mut seen = BTreeMap::new();
        for (name, value) in &defines {
            if seen.insert(name, value).is_some_and(|other| other != value) {
                let span = opened.outline.head(&Path::root());
                let message = format!("two constants of this graph are `{name}` to its shaders");
                self.errors.push(Diagnostic::new(message, span, "in this graph").with_help(
                    "names are in capitals there, and a choice adds one for each of its values: rename one of them",
                ));
            }
        }
        Level {
            file: opened.file,
            graph: opened.graph.clone(),
            outline: opened.outline.clone(),
            names,
            params,
            exposed,
            handles: IndexMap::new(),
            given: BTreeMap::new(),
            absent: BTreeMap::new(),
            prefix,
            suffix: String::new(),
            include: None,
            around: ParamSet::new(),
            defines: Rc::new(defines),
            unfit: Rc::new(unfit),
            constants: Rc::new(constants),
        }
    }

    /// Counts work. Returns false beyond the limit, the first time with an error at `place`.
    pub(super) fn count(&mut self, steps: usize, place: &Place) -> bool {
        let before = self.steps;
        self.steps = before.saturating_add(steps);
        if before <= MAX_STEPS && self.steps > MAX_STEPS {
            let message = format!("this graph has over {MAX_STEPS} steps, its repeats counted");
            self.errors.push(place.error(message, "while walking this one"));
        }
        self.steps <= MAX_STEPS
    }

    pub(super) fn walk(&mut self, level: &mut Level, passes: &[PassDecl], at: &Place) {
        for (i, pass) in passes.iter().enumerate() {
            let entries = match pass {
                PassDecl::Dispatch { bind, push, .. } => bind.len() + push.len(),
                PassDecl::Draw { bind, push, targets, .. } => bind.len() + push.len() + targets.len(),
                PassDecl::Include { with, set, .. } => with.len() + set.len(),
                PassDecl::Fill { .. } | PassDecl::Repeat { .. } | PassDecl::Swap(_) => 0,
            };
            if !self.count(1 + entries, &at.index(i))
                || self.passes.len() > MAX_PASSES
                || self.errors.len() >= MAX_ERRORS
            {
                return;
            }
            level.names.take_notes();
            if let Err(diagnostic) = self.pass(level, pass, &at.index(i)) {
                self.errors.push(diagnostic);
            }
        }
    }

    fn pass(&mut self, level: &mut Level, pass: &PassDecl, place: &Place) -> Result<(), Diagnostic> {
        match pass {
            PassDecl::Dispatch { name, phase, run, when, shader, size, bind, push } => {
                let head = Head { name, phase, run: *run, place };
                if !self.wanted(level, when, pass, place)? {
                    return Ok(());
                }
                let size_place = place.field("size");
                let size = match size {
                    Size::Threads(extent) => LoweredSize::Threads(level.names.extent(extent, &size_place)?),
                    Size::Groups(extent) => LoweredSize::Groups(level.names.extent(extent, &size_place)?),
                    Size::Indirect(buffer, offset) => {
                        match self.arguments(level, (buffer, offset), 12, &size_place)? {
                            Some((buffer, offset)) => LoweredSize::Indirect { buffer, offset },
                            None => return Ok(()),
                        }
                    }
                };
                let shader = self.shader(level, shader, &place.field("shader"))?;
                let work = LoweredWork::Dispatch { shader, size, size_span: size_place.span() };
                self.emit(level, &head, work, bind, push)
            }
            PassDecl::Draw { name, phase, when, vertex, fragment, topology, call, bind, push, targets } => {
                let head = Head { name, phase, run: Run::Frame, place };
                if !self.wanted(level, when, pass, place)? {
                    return Ok(());
                }
                let call_place = place.field("call");
                let call = match call {
                    Call::Direct { vertices, instances } => {
                        let count = |number, field| -> Result<u32, Diagnostic> {
                            let at = call_place.field(field);
                            let n = level.names.natural(number, &at)?;
                            u32::try_from(n)
                                .map_err(|_| at.error("this does not fit 32 bits", format!("is {n}")))
                        };
                        DrawCall::Direct {
                            vertices: count(vertices, "vertices")?,
                            instances: count(instances, "instances")?,
                        }
                    }
                    Call::Indirect(buffer, offset) => {
                        match self.arguments(level, (buffer, offset), 16, &call_place)? {
                            Some((buffer, offset)) => DrawCall::Indirect { buffer, offset },
                            None => return Ok(()),
                        }
                    }
                };
                let mut resolved = Vec::new();
                for (i, target) in targets.iter().enumerate() {
                    let at = place.field("targets").index(i);
                    if let Some(when) = &target.when
                        && !level.names.deciding(|| level.names.truth(when, &at.field("when")))?
                    {
                        continue;
                    }
                    let image_at = at.field("image");
                    let Some(image) = self.look_up_one(level, &target.image, &image_at)? else {
                        return Ok(());
                    };
                    self.clear(image, target.load, &at.field("load"))?;
                    resolved
                        .push((Target { image, load: target.load, blend: target.blend }, image_at.span()));
                }
                let work = LoweredWork::Draw {
                    vertex: self.shader(level, vertex, &place.field("vertex"))?,
                    fragment: self.shader(level, fragment, &place.field("fragment"))?,
                    topology: *topology,
                    call,
                    call_span: call_place.span(),
                    targets: resolved,
                };
                self.emit(level, &head, work, bind, push)
            }
            PassDecl::Fill { name, phase, when, buffer, value } => {
                let head = Head { name, phase, run: Run::Frame, place };
                if !self.wanted(level, when, pass, place)? {
                    return Ok(());
                }
                let value_place = place.field("value");
                let value = level.names.natural(value, &value_place)?;
                let value = u32::try_from(value)
                    .map_err(|_| value_place.error("this does not fit 32 bits", format!("is {value}")))?;
                let at = place.field("buffer");
                let Some(id) = self.look_up_one(level, buffer, &at)? else { return Ok(()) };
                let target = &self.resources[id.index()];
                let last = self.histories.iter().any(|history| history.previous_frame == id);
                if !matches!(target.shape, Shape::Buffer { .. }) || target.source != Source::Transient || last
                {
                    return Err(at.error(
                        format!("`{}` cannot be filled", buffer.text),
                        "only the graph's own buffers can",
                    ));
                }
                let none = (IndexMap::new(), IndexMap::new());
                self.emit(level, &head, LoweredWork::Fill { buffer: id, value }, &none.0, &none.1)
            }
            PassDecl::Repeat { var, count, body } => self.repeat(level, var, count, body, place),
            PassDecl::Swap(name) => self.swap(level, name, &place.index(0)),
            PassDecl::Include { graph, name, when, with, set, expose: _ } => {
                if !self.wanted(level, when, pass, place)? {
                    level.absent.insert(name.clone(), Some(place.field("when").span()));
                    return Ok(());
                }
                let errors = self.errors.len();
                let result = self.include(level, &Written { graph, name, with, set, place });
                if result.is_err() || self.errors.len() > errors {
                    level.absent.insert(name.clone(), None);
                }
                result
            }
        }
    }

    /// Evaluates the file name of a shader, which may be an expression.
    pub(super) fn shader(
        &self,
        level: &Level,
        text: &Expression,
        place: &Place,
    ) -> Result<ShaderName, Diagnostic> {
        let span = place.span();
        if !is_choice(&text.text) {
            return Ok(ShaderName { name: text.text.clone(), span });
        }
        match level.names.deciding(|| level.names.expression(text, place))? {
            Value::Text(name) => Ok(ShaderName { name, span }),
            other => {
                Err(place
                    .error("the name of a shader is needed here", format!("this is {}", describe(&other))))
            }
        }
    }

    /// Checks the colour that a target is cleared to.
    fn clear(&self, image: ResourceHandle, load: Load, at: &Place) -> Result<(), Diagnostic> {
        let Load::Clear(r, g, b, a) = load else { return Ok(()) };
        let integers =
            matches!(self.resources[image.index()].shape, Shape::Image { format: Format::R32Uint, .. });
        for v in [r, g, b, a] {
            if !v.is_finite() {
                return Err(
                    at.error("a target is cleared to finite numbers of 32 bits", format!("found {v}"))
                );
            }
            // The largest float below 2^32 fits a `uint`; 2^32 does not.
            if integers && !(v.fract() == 0.0 && (0.0..4_294_967_296.0).contains(&v)) {
                let found = format!("expected an integer from 0 to 4294967295, found {v}");
                return Err(at.error("a target of the format r32ui is cleared to integers", found));
            }
        }
        Ok(())
    }

    /// Resolves the arguments of an indirect command.
    fn arguments(
        &self,
        level: &Level,
        named: (&Reference, &Number),
        bytes: u64,
        at: &Place,
    ) -> Result<Option<(ResourceHandle, u64)>, Diagnostic> {
        let what = format!("{bytes} bytes of arguments do not stand");
        self.words(level, named, (bytes, &what), at)
    }

    /// Resolves a buffer and the byte offset of words in it, whose names are at `at`. `what` describes the words in
    /// errors.
    pub(super) fn words(
        &self,
        level: &Level,
        (buffer, offset): (&Reference, &Number),
        (bytes, what): (u64, &str),
        at: &Place,
    ) -> Result<Option<(ResourceHandle, u64)>, Diagnostic> {
        let Some(id) = self.look_up_one(level, buffer, &at.index(0))? else { return Ok(None) };
        let offset_place = at.index(1);
        let offset = level.names.natural(offset, &offset_place)?;
        let resource = &self.resources[id.index()];
        if !matches!(resource.shape, Shape::Buffer { .. }) {
            return Err(at
                .index(0)
                .error(format!("`{}` is an image", buffer.text), "the name of a buffer is needed here"));
        }
        let end = offset.checked_add(bytes);
        if offset % 4 != 0 || end.is_none_or(|end| end > resource.shape.bytes()) {
            return Err(offset_place.error(
                format!("{what} at offset {offset} of `{}`", buffer.text),
                format!("it has {} bytes, and offsets are multiples of 4", resource.shape.bytes()),
            ));
        }
        Ok(Some((id, offset)))
    }

    fn emit(
        &mut self,
        level: &Level,
        head: &Head,
        work: LoweredWork,
        bind: &IndexMap<String, Reference>,
        push: &IndexMap<String, Number>,
    ) -> Result<(), Diagnostic> {
        let name = format!("{}{}{}", level.prefix, head.name, level.suffix);
        let span = head.place.field("name").span();
        if head.name.len() > LONGEST_NAME {
            let found = format!("expected at most {LONGEST_NAME} bytes, found {}", head.name.len());
            return Err(Diagnostic::new("the name of this pass is too long", span, found));
        }
        if let Some(first) = self.pass_names.insert(name.clone(), Some(span)) {
            let diagnostic = Diagnostic::new(format!("two passes are called `{name}`"), span, "the second");
            return Err(match first {
                Some(first) => diagnostic.with_label(first, "the first"),
                None => diagnostic.with_help("the first is the end of every frame"),
            });
        }
        let mut binds = Vec::new();
        for (block, text) in bind {
            let at = head.place.field("bind").field(block);
            match self.look_up(level, text, &at) {
                Ok(None) => {}
                Ok(Some(resources)) => binds.push(LoweredBind {
                    block: block.clone(),
                    block_span: at.key(),
                    resources,
                    resource_span: at.span(),
                }),
                Err(diagnostic) => self.errors.push(diagnostic),
            }
        }
        let mut pushes = Vec::new();
        for (member, number) in push {
            let at = head.place.field("push").field(member);
            match level.names.evaluate(number, &at) {
                Ok(value) => pushes.push(LoweredPush {
                    name: member.clone(),
                    value,
                    name_span: at.key(),
                    value_span: at.span(),
                }),
                Err(diagnostic) => self.errors.push(diagnostic),
            }
        }
        let Notes { read, mut decided } = level.names.take_notes();
        decided.extend(&level.around);
        self.passes.push(LoweredPass {
            name,
            phase: head.phase.clone().unwrap_or_else(|| head.name.into()),
            run: head.run,
            file: level.file,
            span,
            include: level.include,
            work,
            bind: binds,
            push: pushes,
            defines: level.defines.clone(),
            unfit: level.unfit.clone(),
            decided,
            read,
            constants: level.constants.clone(),
        });
        if self.passes.len() > MAX_PASSES {
            return Err(Diagnostic::new(
                format!("this graph has over {MAX_PASSES} passes"),
                span,
                "while adding this one",
            ));
        }
        Ok(())
    }

    fn repeat(
        &mut self,
        level: &mut Level,
        var: &str,
        count: &Number,
        body: &[PassDecl],
        place: &Place,
    ) -> Result<(), Diagnostic> {
        let count_place = place.field("count");
        let count = level.names.deciding(|| level.names.natural(count, &count_place))?;
        let decided = level.names.take_notes().decided;
        self.shape.extend(&decided);
        if count > MAX_PASSES as u64 {
            return Err(
                count_place.error(format!("this repeats over {MAX_PASSES} times"), format!("is {count}"))
            );
        }
        if level.names.values.contains_key(var) || level.names.live.contains(var) {
            let at = place.field("var");
            return Err(
                at.error(format!("`{var}` is declared twice"), "the name is already that of something else")
            );
        }
        let errors = self.errors.len();
        let suffix = level.suffix.clone();
        let around = level.around.clone();
        level.around.extend(decided);
        for i in 0..count {
            if !self.count(1, place) {
                break;
            }
            level.names.values.insert(var.into(), Value::Int(i as i64));
            level.suffix = format!("{suffix}[{i}]");
            self.walk(level, body, &place.field("body"));
            // A second iteration would only repeat the errors.
            if self.errors.len() > errors {
                break;
            }
        }
        level.names.values.remove(var);
        level.suffix = suffix;
        level.around = around;
        Ok(())
    }
}
