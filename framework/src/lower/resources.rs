//! Resolves declarations, imports and ports to numbered buffers and images.

use super::lowered::Declaration;
use super::lowering::{Handle, History, Level, Lowering, PingPong};
use super::scope::{check_identifier, describe, is_identifier};

use crate::expr::Scope;
use crate::ir::{Catalog, Format, HostBuffer, ParamSet, ResourceId, Shape, Source, Span, Usage, Value};
use crate::plan::Resource;
use crate::schema::{
    Expression, Import, Part, PassDecl, Port, Reference, ResourceDecl, ResourceName, is_choice,
};
use crate::source::{Diagnostic, Place, nearest};

impl Lowering<'_> {
    pub(super) fn declare(&mut self, level: &mut Level) {
        let graph = level.graph.clone();
        let root = level.root.clone();
        level.names.take_notes();
        let ports = graph.ports.keys().map(|name| ("ports", name));
        let imports = graph.imports.keys().map(|name| ("imports", name));
        let resources = graph.resources.keys().map(|name| ("resources", name));
        for (list, name) in ports.chain(imports).chain(resources) {
            let span = root.field(list).field(name).key();
            self.errors.extend(check_identifier(name, "a resource", span).err());
            // A reference by this name would be ambiguous: a text can be the name of another resource.
            let same = [("let", graph.lets.contains_key(name)), ("params", graph.params.contains_key(name))];
            if let (Some(Value::Text(_)), Some((list, _))) =
                (level.names.values.get(name), same.iter().find(|(_, has)| *has))
            {
                let message = format!("`{name}` is declared twice");
                let error = Diagnostic::new(message, span, "as a resource");
                let text = "as a text, which could name another resource";
                self.errors.push(error.with_label(root.field(list).field(name).key(), text));
            }
        }
        for (name, import) in &graph.imports {
            let place = root.field("imports").field(name);
            let first = self.lowered.plan.resources.len();
            let handle = self.import(level, name, import, &place);
            self.note(level, first);
            self.enter(level, name, handle, &place);
        }
        for (name, declaration) in &graph.resources {
            let place = root.field("resources").field(name);
            let first = self.lowered.plan.resources.len();
            let handle = self.resource(level, name, declaration, &place);
            self.note(level, first);
            self.enter(level, name, handle, &place);
        }
    }

    /// Takes the notes, and records their parameters as those of the declarations from `first` on.
    fn note(&mut self, level: &Level, first: usize) {
        let params = level.names.take_notes().all();
        for declaration in &mut self.lowered.declarations[first..] {
            declaration.params = params.clone();
        }
    }

    fn enter(&mut self, level: &mut Level, name: &str, handle: Result<Handle, Diagnostic>, place: &Place) {
        match handle {
            Ok(handle) => {
                if level.handles.insert(name.into(), Some(handle)).is_some() {
                    self.errors.push(Diagnostic::new(
                        format!("`{name}` is declared twice"),
                        place.key(),
                        "the name is already used by a port or an import",
                    ));
                }
            }
            Err(diagnostic) => {
                self.errors.push(diagnostic);
                // Declare it anyway, so that its users are not reported as well.
                level.handles.insert(name.into(), None);
            }
        }
    }

    fn import(
        &mut self,
        level: &Level,
        name: &str,
        import: &Import,
        place: &Place,
    ) -> Result<Handle, Diagnostic> {
        let catalog = self.request.catalog;
        let planes = match &import.planes {
            Some(number) => level.names.positive(number, &place.field("planes"))?,
            None => 1,
        };
        let whole = |name: &String| {
            let uniform = || {
                let bytes = *catalog.uniforms.get(name)?;
                let shape = Shape::Buffer { stride: bytes, count: 1 };
                Some(("a uniform block", shape, Source::Frame { uniform: name.clone() }))
            };
            let given = || {
                let HostBuffer { stride, least } = *catalog.buffers.get(name)?;
                let shape = Shape::Buffer { stride, count: least.max(1) };
                Some(("a buffer of the frame", shape, Source::HostBuffer { buffer: name.clone() }))
            };
            uniform().or_else(given)
        };
        if let Some((what, shape, source)) = whole(&import.from) {
            if planes != 1 {
                return Err(place.field("planes").error(format!("{what} has no planes"), "leave this out"));
            }
            let name = format!("{}{name}", level.prefix);
            return Ok(Handle::Plain(vec![self.add(name, shape, source, place.key())]));
        }
        let Some(attribute) = catalog.attribute(&import.from) else {
            let uniforms = catalog.uniforms.keys().chain(catalog.buffers.keys());
            let known = || catalog.attributes.keys().chain(uniforms.clone()).map(String::as_str);
            let diagnostic = place
                .field("from")
                .error(format!("nothing is called `{}`", import.from), "cannot be imported");
            if let Some(family) = catalog.family(&import.from) {
                return Err(diagnostic.with_help(family.help.clone()));
            }
            let all = known().collect::<Vec<_>>().join(", ");
            return Err(diagnostic.with_nearest(&import.from, known(), format!("available: {all}")));
        };
        if planes > attribute.planes as u64 {
            let message = format!("`{}` has {} planes", import.from, attribute.planes);
            return Err(place.field("planes").error(message, format!("asks for {planes}")));
        }
        let shape = Shape::Buffer { stride: attribute.stride, count: attribute.count };
        let ids = (0..planes as u32).map(|plane| {
            let name = match planes {
                1 => format!("{}{name}", level.prefix),
                _ => format!("{}{name}[{plane}]", level.prefix),
            };
            self.add(name, shape, Source::Scene { attribute: import.from.clone(), plane }, place.key())
        });
        Ok(Handle::Plain(ids.collect()))
    }

    fn resource(
        &mut self,
        level: &Level,
        name: &str,
        declaration: &ResourceDecl,
        place: &Place,
    ) -> Result<Handle, Diagnostic> {
        let full = format!("{}{name}", level.prefix);
        match declaration {
            ResourceDecl::Buffer { stride, count, ping_pong, history } => {
                let stride = level.names.positive(stride, &place.field("stride"))?;
                let count = level.names.positive(count, &place.field("count"))?;
                if stride.checked_mul(count).is_none_or(|bytes| bytes > 1 << 48) {
                    return Err(place.field("count").error(
                        "this buffer is larger than any memory",
                        format!("{count} x {stride} bytes"),
                    ));
                }
                if stride % 4 != 0 {
                    return Err(place
                        .field("stride")
                        .error("a stride is a multiple of 4 bytes", format!("is {stride}")));
                }
                let shape = Shape::Buffer { stride, count };
                let mut add = |name| self.add(name, shape, Source::Transient, place.key());
                let handle = if *ping_pong {
                    let halves = [0, 1].map(|i| add(format!("{full}#{i}")));
                    self.lowered.ping_pongs.push(halves);
                    self.ping_pongs.push(PingPong { halves, front: 0, swaps: 0 });
                    Handle::PingPong(self.ping_pongs.len() - 1)
                } else {
                    Handle::Plain(vec![add(full.clone())])
                };
                if level.names.truth(history, &place.field("history"))? {
                    self.add_history(full, shape, &handle, place.key());
                }
                Ok(handle)
            }
            ResourceDecl::Image { format, size, history } => {
                let side = |number, index| -> Result<u32, Diagnostic> {
                    let at = place.field("size").index(index);
                    let v = level.names.positive(number, &at)?;
                    if v > 32768 {
                        return Err(at.error("no device has images this large", format!("is {v}")));
                    }
                    Ok(v as u32)
                };
                let (width, height) = (side(&size.0, 0)?, side(&size.1, 1)?);
                let format = self.format(level, format, &place.field("format"))?;
                let shape = Shape::Image { format, width, height };
                let handle =
                    Handle::Plain(vec![self.add(full.clone(), shape, Source::Transient, place.key())]);
                if level.names.truth(history, &place.field("history"))? {
                    if format == Format::Depth32Float {
                        let message = "a depth image has no history";
                        return Err(place.field("history").error(message, "draws clear it first"));
                    }
                    self.add_history(full, shape, &handle, place.key());
                }
                Ok(handle)
            }
        }
    }

    fn add_history(&mut self, name: String, shape: Shape, of: &Handle, span: Span) {
        let previous_frame = self.add(format!("last({name})"), shape, Source::Transient, span);
        self.histories.push(History { name, previous_frame, of: of.clone() });
    }

    /// Finds the resource that each `last(name)` reads. Call it once all swaps of the frame are known.
    pub(super) fn end_histories(&mut self) {
        for History { name, previous_frame, of } in std::mem::take(&mut self.histories) {
            let real = match of {
                Handle::Plain(ids) => ids[0],
                Handle::PingPong(index) => self.ping_pongs[index].in_front(),
            };
            self.lowered.plan.resources[real.index()].history = Some(name);
            self.lowered.declarations[previous_frame.index()].previous_frame_of = Some(real);
        }
    }

    fn format(&self, level: &Level, format: &Expression, place: &Place) -> Result<Format, Diagnostic> {
        let text = format.text.as_str();
        let named = |name: &str| Format::ALL.into_iter().find(|f| f.name() == name);
        if let Some(format) = named(text) {
            return Ok(format);
        }
        let all = Format::ALL.map(|f| f.name());
        // A single unknown word is a misspelt format rather than an expression.
        let wrong = |name: &str| {
            let diagnostic = place.error(format!("there is no format `{name}`"), "cannot be used");
            match Format::meant_by(name) {
                Some(meant) => diagnostic.with_help(format!("did you mean `{}`?", meant.name())),
                None => diagnostic.with_nearest(name, all, format!("available: {}", all.join(", "))),
            }
        };
        if is_identifier(text) && !level.names.values.contains_key(text) {
            return Err(wrong(text));
        }
        match level.names.expression(format, place)? {
            Value::Text(name) => named(&name).ok_or_else(|| wrong(&name)),
            other => Err(wrong(&other.to_string())),
        }
    }

    pub(super) fn add(&mut self, name: String, shape: Shape, source: Source, span: Span) -> ResourceId {
        let id = ResourceId(self.lowered.plan.resources.len() as u32);
        // This also reports a resource with the name of the live block, which is added last.
        if let Some(first) = self.resource_names.insert(name.clone(), span) {
            self.errors.push(
                Diagnostic::new(format!("two resources are called `{name}`"), span, "the second")
                    .with_label(first, "the first"),
            );
        }
        let (usage, origin) = (Usage::empty(), self.files.origin(span));
        let resource = Resource { name, shape, usage, source, block: None, history: None, origin };
        self.lowered.plan.resources.push(resource);
        let declaration = Declaration { span, previous_frame_of: None, params: ParamSet::new() };
        self.lowered.declarations.push(declaration);
        id
    }

    /// Returns the resources that the reference at `place` refers to at this point of the walk. `Ok(None)` if the
    /// name's declaration or include is invalid, which is already reported.
    pub(super) fn look_up(
        &self,
        level: &Level,
        reference: &Reference,
        place: &Place,
    ) -> Result<Option<Vec<ResourceId>>, Diagnostic> {
        let (name, span) = self.named(level, reference, place)?;
        self.look_up_name(level, name.as_ref(), place, span)
    }

    /// Looks up a reference of a removed pass, like [`Self::look_up`]. Only a name that no graph declares is an error:
    /// the condition that removes the pass may also remove an include, or a history. A name that a constant holds or an
    /// expression chooses is not an error either: the condition may test that name, as in `source != 'none'`.
    pub(super) fn look_up_removed(
        &self,
        level: &Level,
        reference: &Reference,
        place: &Place,
    ) -> Result<Vec<ResourceId>, Diagnostic> {
        if let Some(choice) = &reference.choice {
            level.names.check(choice, place)?;
        }
        let Ok((name, span)) = self.named(level, reference, place) else { return Ok(Vec::new()) };
        let text = &reference.text;
        let is_constant = !level.handles.contains_key(text) && level.names.values.contains_key(text);
        let is_computed = reference.choice.is_some() || is_constant;
        match self.look_up_name(level, name.as_ref(), place, span) {
            Ok(found) => Ok(found.unwrap_or_default()),
            Err(_) if is_computed => Ok(Vec::new()),
            Err(_) if name.is_some_and(|name| level.may_have(&name.name)) => Ok(Vec::new()),
            Err(error) => Err(error),
        }
    }

    /// Evaluates a reference: the name that it stands for, and its place.
    fn named(
        &self,
        level: &Level,
        reference: &Reference,
        place: &Place,
    ) -> Result<(Option<ResourceName>, Span), Diagnostic> {
        let Reference { text, name, choice } = reference;
        // A constant can hold a resource's name, unless a resource has the constant's name.
        let constant = level.names.values.get(text).filter(|_| !level.handles.contains_key(text));
        let chosen = match (choice, constant) {
            (Some(choice), _) => level.names.deciding(|| level.names.expression(choice, place))?,
            (None, Some(value @ Value::Text(_))) => {
                level.names.deciding(|| level.names.get(text));
                value.clone()
            }
            (None, _) => {
                let span = |name: &ResourceName| place.within_string(name.range.clone());
                return Ok((name.clone(), name.as_ref().map_or_else(|| place.span(), span)));
            }
        };
        match chosen {
            Value::Text(name) if !is_choice(&name) => Ok((ResourceName::parse(&name), place.span())),
            other => Err(place.error("a resource is needed here", format!("this is {}", describe(&other)))),
        }
    }

    /// Looks up the parsed name of a reference at `place`, like [`Self::look_up`]. `span` is the place of the name.
    pub(super) fn look_up_name(
        &self,
        level: &Level,
        name: Option<&ResourceName>,
        place: &Place,
        span: Span,
    ) -> Result<Option<Vec<ResourceId>>, Diagnostic> {
        let Some(ResourceName { name, part, .. }) = name else {
            return Err(place
                .error("this is not the name of a resource", "cannot be read")
                .with_help("write `name`, `front(name)`, `back(name)` or `last(name)`"));
        };
        let Some(handle) = level.handles.get(name) else {
            let diagnostic = Diagnostic::new(format!("there is no resource `{name}`"), span, "not declared");
            match name.split_once('.').and_then(|(include, _)| level.absent.get(include)) {
                None => {}
                // The include is invalid, and its own errors have been reported.
                Some(None) => return Ok(None),
                Some(Some(when)) => return Err(diagnostic.with_label(*when, "its include is left out here")),
            }
            return Err(self.suggest_resource(level, name, diagnostic));
        };
        level.note_given(name);
        let Some(handle) = handle else { return Ok(None) };
        match self.part(handle, *part) {
            Some(Handle::Plain(ids)) => Ok(Some(ids)),
            Some(Handle::PingPong(index)) => Ok(Some(vec![self.ping_pongs[index].in_front()])),
            None if *part == Part::PreviousFrame => {
                let is_half = |history: &History| match (handle, &history.of) {
                    (Handle::Plain(ids), Handle::PingPong(of)) => {
                        self.ping_pongs[*of].halves.contains(&ids[0])
                    }
                    _ => false,
                };
                let is_port = level.graph.ports.contains_key(name);
                let label = match is_port && self.histories.iter().any(is_half) {
                    true => "half of a ping-pong buffer: ports need `ping_pong: true` for its history",
                    false => "declared without `history: true`",
                };
                Err(Diagnostic::new(format!("`{name}` has no history"), span, label))
            }
            None => Err(Diagnostic::new(
                format!("`{name}` has no front and back"),
                span,
                "declared without `ping_pong: true`",
            )),
        }
    }

    /// Adds suggestions to the error about an unknown resource.
    fn suggest_resource(&self, level: &Level, name: &str, error: Diagnostic) -> Diagnostic {
        let names = || level.handles.keys().map(String::as_str);
        let catalog @ Catalog { uniforms, buffers, .. } = self.request.catalog;
        let known = catalog.attribute(name).is_some() || catalog.family(name).is_some();
        if known || uniforms.contains_key(name) || buffers.contains_key(name) {
            let last = name.rsplit('.').next().unwrap_or(name);
            return error
                .with_help(format!("import it: `imports: {{ \"{last}\": Import(from: \"{name}\") }}`"));
        }
        let include = name.split_once('.').map(|(include, _)| include);
        let here = self.lowered.includes.iter().filter(|known| known.parent == level.include);
        let includes: Vec<&str> = here.filter_map(|known| known.name.strip_prefix(&level.prefix)).collect();
        let is_below =
            |pass: &PassDecl| matches!(pass, PassDecl::Include { name, .. } if include == Some(name));
        if let Some(include) = include.filter(|include| !includes.contains(include))
            && let Some(below) = level.graph.passes.iter().position(is_below)
        {
            let span = level.root.field("passes").index(below).field("name").span();
            return error
                .with_label(span, format!("the include `{include}` is here"))
                .with_help("passes below an include can use its resources: move it up");
        }
        let Some(include) = include.filter(|_| nearest(name, names()).is_none()) else {
            return error.with_nearest(name, names(), "");
        };
        let of = |include: &str| {
            let prefix = format!("{include}.");
            let own = names().filter(|name| name.starts_with(&prefix)).map(|name| format!("`{name}`"));
            own.collect::<Vec<_>>().join(", ")
        };
        let near = if includes.contains(&include) { Some(include) } else { nearest(include, includes) };
        match near {
            None => error,
            Some(near) if near != include => error.with_help(format!("did you mean the include `{near}`?")),
            Some(_) if of(include).is_empty() => error.with_help(format!(
                "the include `{include}` has no resources of its own: what its ports are given has this graph's names"
            )),
            Some(_) => error.with_help(format!(
                "the include `{include}` has {}; what its ports are given has this graph's names",
                of(include)
            )),
        }
    }

    /// Looks up a single resource, like [`Self::look_up`]. An attribute with several planes is an error.
    pub(super) fn look_up_one(
        &self,
        level: &Level,
        reference: &Reference,
        place: &Place,
    ) -> Result<Option<ResourceId>, Diagnostic> {
        match self.look_up(level, reference, place)?.as_deref() {
            None => Ok(None),
            Some([id]) => Ok(Some(*id)),
            Some(ids) => {
                let text = &reference.text;
                Err(place.error(format!("`{text}` has {} planes", ids.len()), "one buffer is needed here"))
            }
        }
    }

    /// Checks an includer's resource against a port, and returns its handle inside the included graph. A port without
    /// `ping_pong` gets only the front of a ping-pong resource, so that the included graph cannot exchange the halves.
    pub(super) fn port(
        &self,
        name: &str,
        port: &Port,
        given: Handle,
        inner: &Level,
        port_at: &Place,
        at: &Place,
    ) -> Result<Handle, Diagnostic> {
        let (stride, ping_pong) = match port {
            Port::Buffer { stride, ping_pong } => (stride, ping_pong),
            Port::Image { format } => return self.image_port(name, format, given, inner, port_at, at),
        };
        if let Handle::Plain(ids) = &given
            && let Shape::Image { .. } = self.lowered.plan.resource(ids[0]).shape
        {
            return Err(at.error(format!("the port `{name}` takes a buffer"), "this is an image"));
        }
        let handle = match (given, ping_pong) {
            (Handle::PingPong(index), false) => Handle::Plain(vec![self.ping_pongs[index].in_front()]),
            (Handle::Plain(_), true) => {
                return Err(at.error(
                    format!("the port `{name}` needs a front and a back"),
                    "declared without `ping_pong: true`",
                ));
            }
            (handle, _) => handle,
        };
        let first = match &handle {
            Handle::PingPong(index) => self.ping_pongs[*index].halves[0],
            Handle::Plain(ids) => ids[0],
        };
        let wanted = inner.names.positive(stride, &port_at.field("stride"))?;
        match self.lowered.plan.resource(first).shape {
            Shape::Buffer { stride, .. } if stride != wanted => Err(at.error(
                format!("the port `{name}` takes elements of {wanted} bytes"),
                format!("has elements of {stride}"),
            )),
            _ => Ok(handle),
        }
    }

    fn image_port(
        &self,
        name: &str,
        format: &Option<Expression>,
        given: Handle,
        inner: &Level,
        port_at: &Place,
        at: &Place,
    ) -> Result<Handle, Diagnostic> {
        let is_buffer = || at.error(format!("the port `{name}` takes an image"), "this is a buffer");
        let Handle::Plain(ids) = &given else { return Err(is_buffer()) };
        let Shape::Image { format: found, .. } = self.lowered.plan.resource(ids[0]).shape else {
            return Err(is_buffer());
        };
        let wanted = format.as_ref().map(|f| self.format(inner, f, &port_at.field("format"))).transpose()?;
        match wanted.filter(|wanted| *wanted != found) {
            None => Ok(given),
            Some(wanted) => Err(at.error(
                format!("the port `{name}` takes images of the format {}", wanted.name()),
                format!("has the format {}", found.name()),
            )),
        }
    }

    /// Selects a part of a resource; `None` if it has no such part. A whole ping-pong buffer stays a pair.
    pub(super) fn part(&self, handle: &Handle, part: Part) -> Option<Handle> {
        match (handle, part) {
            (_, Part::Whole) => Some(handle.clone()),
            (Handle::PingPong(index), Part::Front | Part::Back) => {
                let pair = &self.ping_pongs[*index];
                let side = if part == Part::Back { 1 - pair.front } else { pair.front };
                Some(Handle::Plain(vec![pair.halves[side]]))
            }
            (_, Part::PreviousFrame) => {
                let history = self.histories.iter().find(|history| history.of == *handle)?;
                Some(Handle::Plain(vec![history.previous_frame]))
            }
            (Handle::Plain(_), _) => None,
        }
    }
}
