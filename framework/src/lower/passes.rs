//! Walks the passes, and resolves conditions, repeats, swaps and includes.

use indexmap::IndexMap;
use std::collections::HashSet;
use std::ops::Range;

use super::conditions::False;
use super::include::Written;
use super::lowered::{LoweredBind, LoweredPass, LoweredPush, LoweredSize, ShaderName, Unswapped};
use super::lowering::{Level, Lowering, MAX_PASSES, PingPong};
use super::scope::{Notes, describe};
use crate::ir::{
    Blend, DepthTarget, DrawCall, Format, Load, Pass, ResourceId, Run, Shape, Source, Span, Target, Value,
    Work,
};
use crate::schema::{Call, Expression, Number, PassDecl, Reference, Size, is_choice};
use crate::source::{Diagnostic, Place};

/// Maximum length of a pass's name in the file, in bytes.
const MAX_NAME: usize = 256;

const MAX_ERRORS: usize = 20;

struct Head<'a> {
    pub name: &'a str,
    pub phase: &'a Option<String>,
    pub run: Run,
    pub place: &'a Place,
}

impl Lowering<'_> {
    pub(super) fn walk(&mut self, level: &mut Level, passes: &[PassDecl], at: &Place) {
        for (i, pass) in passes.iter().enumerate() {
            let entries = match pass {
                PassDecl::Dispatch { bind, push, .. } => bind.len() + push.len(),
                PassDecl::Draw { bind, push, targets, depth, .. } => {
                    bind.len() + push.len() + targets.len() + usize::from(depth.is_some())
                }
                PassDecl::Include { with, set, .. } => with.len() + set.len(),
                PassDecl::Fill { .. } | PassDecl::Repeat { .. } | PassDecl::Swap(_) => 0,
            };
            if !self.count(1 + entries, &at.index(i))
                || self.lowered.passes.len() > MAX_PASSES
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
        if !self.wanted(level, pass, place)? {
            return Ok(());
        }
        match pass {
            PassDecl::Dispatch { name, phase, run, when: _, shader, size, bind, push } => {
                let head = Head { name, phase, run: *run, place };
                let size_place = place.field("size");
                if let Size::Threads(extent) | Size::Groups(extent) = size {
                    let numbers = extent.0.iter().enumerate();
                    numbers.for_each(|(axis, number)| {
                        self.note_idle(level, name, number, &size_place.index(axis));
                    });
                }
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
                let places = (size_place.span(), Vec::new());
                self.emit(level, &head, (Work::Dispatch { shader, groups: size }, places), bind, push)
            }
            PassDecl::Draw {
                name,
                phase,
                when: _,
                vertex,
                fragment,
                topology,
                call,
                bind,
                push,
                targets,
                depth,
            } => {
                let head = Head { name, phase, run: Run::Frame, place };
                let call_place = place.field("call");
                let call = match call {
                    Call::Direct { vertices, instances } => {
                        let mut count = |number, field| -> Result<u32, Diagnostic> {
                            let at = call_place.field(field);
                            self.note_idle(level, name, number, &at);
                            let n = level.names.natural(number, &at)?;
                            u32::try_from(n)
                                .map_err(|_| at.error("this does not fit in 32 bits", format!("is {n}")))
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
                let (mut resolved, mut target_spans) = (Vec::new(), Vec::new());
                for (i, target) in targets.iter().enumerate() {
                    let at = place.field("targets").index(i);
                    let image_at = at.field("image");
                    if !self.attaches(level, &target.when, &at)? {
                        level.names.traced(|| self.look_up_removed(level, &target.image, &image_at)).0?;
                        continue;
                    }
                    let Some(image) = self.look_up_one(level, &target.image, &image_at)? else {
                        return Ok(());
                    };
                    self.clear(image, target.load, &at.field("load"))?;
                    self.blend(image, target.blend, &at.field("blend"))?;
                    resolved.push(Target { image, load: target.load, blend: target.blend });
                    target_spans.push(image_at.span());
                }
                let mut tested = None;
                if let Some(depth) = depth {
                    let at = place.field("depth");
                    let image_at = at.field("image");
                    if !self.attaches(level, &depth.when, &at)? {
                        level.names.traced(|| self.look_up_removed(level, &depth.image, &image_at)).0?;
                    } else {
                        let Some(image) = self.look_up_one(level, &depth.image, &image_at)? else {
                            return Ok(());
                        };
                        tested = Some(DepthTarget { image, access: depth.access });
                        target_spans.push(image_at.span());
                    }
                }
                let work = Work::Draw {
                    vertex: self.shader(level, vertex, &place.field("vertex"))?,
                    fragment: self.shader(level, fragment, &place.field("fragment"))?,
                    topology: *topology,
                    call,
                    targets: resolved,
                    depth: tested,
                };
                self.emit(level, &head, (work, (call_place.span(), target_spans)), bind, push)
            }
            PassDecl::Fill { name, phase, when: _, buffer, value } => {
                let head = Head { name, phase, run: Run::Frame, place };
                let value_place = place.field("value");
                let value = level.names.natural(value, &value_place)?;
                let value = u32::try_from(value)
                    .map_err(|_| value_place.error("this does not fit in 32 bits", format!("is {value}")))?;
                let at = place.field("buffer");
                let Some(id) = self.look_up_one(level, buffer, &at)? else { return Ok(()) };
                let target = self.lowered.plan.resource(id);
                let last = self.histories.iter().any(|history| history.previous_frame == id);
                if !matches!(target.shape, Shape::Buffer { .. }) || target.source != Source::Transient || last
                {
                    return Err(at.error(
                        format!("`{}` cannot be filled", buffer.text),
                        "only the graph's own buffers can",
                    ));
                }
                let none = (IndexMap::new(), IndexMap::new());
                let work = (Work::Fill { buffer: id, value }, (at.span(), Vec::new()));
                self.emit(level, &head, work, &none.0, &none.1)
            }
            PassDecl::Repeat { var, count, body } => self.repeat(level, var, count, body, place),
            PassDecl::Swap(name) => self.swap(level, name, &place.index(0)),
            PassDecl::Include { graph, name, when: _, with, set, expose } => {
                let errors = self.errors.len();
                let result = self.include(level, &Written { graph, name, with, set, expose, place });
                if result.is_err() || self.errors.len() > errors {
                    level.absent.insert(name.clone(), None);
                }
                result
            }
        }
    }

    /// Warns if a size of a pass is 0 in every plan.
    fn note_idle(&mut self, level: &Level, pass: &str, size: &Number, at: &Place) {
        if level.names.is_constant(size) && level.names.evaluate(size, at) == Ok(Value::Int(0)) {
            let warning = at.error(format!("no shader of `{pass}` ever runs"), "is 0");
            self.lowered.sizes.push(warning.with_help("to leave a pass out, give it `when: false`"));
        }
    }

    fn attaches(&self, level: &Level, when: &Option<Number>, at: &Place) -> Result<bool, Diagnostic> {
        let truth = |when| level.names.deciding(|| level.names.truth(when, &at.field("when")));
        when.as_ref().map_or(Ok(true), truth)
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

    fn is_integer(&self, image: ResourceId) -> bool {
        matches!(self.lowered.plan.resource(image).shape, Shape::Image { format: Format::R32Uint, .. })
    }

    /// Checks that a target's blend mode exists for the image's format: no device blends integers.
    fn blend(&self, image: ResourceId, blend: Blend, at: &Place) -> Result<(), Diagnostic> {
        if blend == Blend::Replace || !self.is_integer(image) {
            return Ok(());
        }
        let found = format!("expected `Replace`, found `{blend:?}`");
        Err(at.error("a target of the format r32ui cannot be blended", found))
    }

    /// Checks that a target's clear colour can be stored in the image's format.
    fn clear(&self, image: ResourceId, load: Load, at: &Place) -> Result<(), Diagnostic> {
        let Load::Clear(r, g, b, a) = load else { return Ok(()) };
        let integers = self.is_integer(image);
        for v in [r, g, b, a] {
            if !v.is_finite() {
                return Err(
                    at.error("a target must be cleared to finite 32-bit numbers", format!("found {v}"))
                );
            }
            // The largest float below 2^32 fits a `uint`; 2^32 does not.
            if integers && !(v.fract() == 0.0 && (0.0..4_294_967_296.0).contains(&v)) {
                let found = format!("expected an integer from 0 to 4294967295, found {v}");
                return Err(at.error("a target of the format r32ui must be cleared to integers", found));
            }
        }
        Ok(())
    }

    /// Returns the buffer and byte offset of an indirect command's arguments, like [`Self::words`].
    fn arguments(
        &self,
        level: &Level,
        named: (&Reference, &Number),
        bytes: u64,
        at: &Place,
    ) -> Result<Option<(ResourceId, u64)>, Diagnostic> {
        let what = format!("{bytes} bytes of arguments do not fit");
        self.words(level, named, (bytes, &what), at)
    }

    /// Returns a buffer and the byte offset of words in it, after checking that they fit. `at` is the place of the two
    /// entries, and `what` describes the words in errors. Returns `Ok(None)` as [`Self::look_up`] does.
    pub(super) fn words(
        &self,
        level: &Level,
        (buffer, offset): (&Reference, &Number),
        (bytes, what): (u64, &str),
        at: &Place,
    ) -> Result<Option<(ResourceId, u64)>, Diagnostic> {
        let Some(id) = self.look_up_one(level, buffer, &at.index(0))? else { return Ok(None) };
        let offset_place = at.index(1);
        let offset = level.names.natural(offset, &offset_place)?;
        let resource = self.lowered.plan.resource(id);
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
        (work, (size_span, target_spans)): (Work<ShaderName, LoweredSize>, (Span, Vec<Span>)),
        bind: &IndexMap<String, Reference>,
        push: &IndexMap<String, Number>,
    ) -> Result<(), Diagnostic> {
        let name = format!("{}{}{}", level.prefix, head.name, level.suffix);
        let span = head.place.field("name").span();
        if head.name.len() > MAX_NAME {
            let found = format!("expected at most {MAX_NAME} bytes, found {}", head.name.len());
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
        let pass = Pass {
            name,
            phase: head.phase.clone().unwrap_or_else(|| head.name.into()),
            run: head.run,
            work,
            bindings: Vec::new(),
            push: Vec::new(),
            uses: Vec::new(),
            origin: self.files.origin(span),
        };
        self.lowered.passes.push(LoweredPass {
            pass,
            file: level.file,
            span,
            include: level.include,
            size_span,
            target_spans,
            bind: binds,
            push: pushes,
            defines: level.defines.clone(),
            unfit: level.unfit.clone(),
            live_glsl: level.live_glsl.clone(),
            decided,
            read,
            constants: level.constants.clone(),
        });
        if self.lowered.passes.len() > MAX_PASSES {
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
        let (written, count_place) = (count, place.field("count"));
        let count = level.names.deciding(|| level.names.natural(written, &count_place))?;
        let decided = level.names.take_notes().decided;
        self.lowered.shape.extend(&decided);
        if count > MAX_PASSES as u64 {
            return Err(
                count_place.error(format!("this repeats over {MAX_PASSES} times"), format!("is {count}"))
            );
        }
        let (what, taken) = ("the counter of a repeat", "the name is already in use");
        level.names.check_new(var, what, taken, place.field("var").span())?;
        if count == 0 {
            let why = False::new(level, written, &count_place, "0", decided.clone());
            self.leave_out_body(level, (var, body), place, &why);
        }
        let errors = self.errors.len();
        let suffix = level.suffix.clone();
        let around = level.around.clone();
        level.around.extend(decided);
        // The ping-pong buffers before each of the first two iterations.
        let mut pairs = Vec::new();
        let mut starts = Vec::new();
        for i in 0..count {
            starts.push(self.lowered.passes.len());
            if i < 2 {
                pairs.push(self.ping_pongs.clone());
            }
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
        starts.push(self.lowered.passes.len());
        if let ([first, second, third, ..], [one, two]) = (&starts[..], &pairs[..]) {
            self.note_unswapped(one, two, [*first..*second, *second..*third]);
        }
        Ok(())
    }

    /// Records the ping-pong buffers of which a repeat uses both halves, and starts its first two iterations with the
    /// same half in front. `first` and `second` are the buffers before these iterations.
    fn note_unswapped(&mut self, first: &[PingPong], second: &[PingPong], passes: [Range<usize>; 2]) {
        let binds = self.lowered.passes[passes[0].start..passes[1].end].iter().flat_map(|pass| &pass.bind);
        let bound: HashSet<ResourceId> = binds.flat_map(|bind| &bind.resources).copied().collect();
        for (pair, (one, two)) in first.iter().zip(second).enumerate() {
            if one.front == two.front && one.halves.iter().all(|half| bound.contains(half)) {
                let (front, back) = (one.in_front(), one.halves[1 - one.front]);
                let swaps = self.ping_pongs[pair].swaps - one.swaps;
                self.lowered.unswapped.push(Unswapped { pair, front, back, swaps, passes: passes.clone() });
            }
        }
    }
}
