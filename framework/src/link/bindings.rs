//! Checks blocks, images and push constants against the graph's `bind` and `push`.

use super::linker::{Linker, describe, touch};
use crate::ir::{
    Accesses, Binding, DescriptorKind, LIVE_BLOCK, Layout, MemberKind, PushBlock, ReflectedBinding,
    ReflectedKind, ResourceId, Run, ShaderId, Shape, Source, Span, Stages, Use, Value, bytes, to_f32,
};
use crate::lower::{LoweredBind, LoweredPass};
use crate::source::{Diagnostic, nearest};

impl Linker<'_> {
    /// Checks a pass's `bind`. Returns the descriptors of all its stages, and adds the shaders' accesses to `uses`.
    pub(super) fn bindings(
        &mut self,
        pass: &LoweredPass,
        stages: &[(ShaderId, Stages)],
        uses: &mut Vec<Use>,
    ) -> Vec<Binding> {
        let mut bindings: Vec<Binding> = Vec::new();
        let mut used = vec![false; pass.bind.len()];
        for (shader, stage) in stages {
            let reflection = self.shaders[shader.index()].reflection.clone();
            for block in &reflection.bindings {
                let (resources, span) = if block.name == LIVE_BLOCK {
                    (vec![self.lowered.live], pass.span)
                } else if let Some(i) = pass.bind.iter().position(|b| b.block == block.name) {
                    used[i] = true;
                    (pass.bind[i].resources.clone(), pass.bind[i].resource_span)
                } else {
                    self.unbound(pass, stages, *shader, block);
                    continue;
                };
                let Some(kind) = self.fits(*shader, block, &resources, span) else { continue };
                if pass.pass.run == Run::Once && self.changes_every_frame(&resources) {
                    let shader = &self.shaders[shader.index()].name;
                    let label = format!("`{}` of `{shader}`", block.name);
                    self.errors.push(once_every_frame(pass, span, label));
                }
                self.describe_touches(block, kind, &resources, *stage, uses);
                for (element, resource) in resources.iter().enumerate() {
                    let binding = Binding {
                        name: block.name.clone(),
                        binding: block.binding,
                        element: element as u32,
                        kind,
                        resource: *resource,
                    };
                    match bindings
                        .iter()
                        .find(|b| b.binding == binding.binding && b.element == binding.element)
                    {
                        None => bindings.push(binding),
                        Some(same) if *same == binding => {}
                        Some(other) => {
                            let (number, name) = (block.binding, &block.name);
                            let message = format!("`{}` and `{name}` are both binding {number}", other.name);
                            let of_this = |b: &ReflectedBinding| b.name == other.name;
                            let label = match reflection.bindings.iter().any(of_this) {
                                true => format!("`{}` declares both", self.shaders[shader.index()].name),
                                false => "the two shaders of this draw share their bindings".to_string(),
                            };
                            self.error(message, pass.span, label);
                        }
                    }
                }
            }
        }
        for (bind, used) in pass.bind.iter().zip(used) {
            if !used {
                self.unknown(stages, bind);
            }
        }
        bindings.sort_by_key(|b| (b.binding, b.element));
        bindings
    }

    /// Reports a block or an image that the shader uses and the graph does not bind.
    fn unbound(
        &mut self,
        pass: &LoweredPass,
        stages: &[(ShaderId, Stages)],
        shader: ShaderId,
        block: &ReflectedBinding,
    ) {
        let known = |name: &str| stages.iter().any(|(shader, _)| self.declares(*shader, name));
        let shader = &self.shaders[shader.index()].name;
        let what = match block.kind {
            ReflectedKind::StorageImage { .. } => "image",
            _ => "block",
        };
        let diagnostic = Diagnostic::new(
            format!("nothing is bound to the {what} `{}` of `{shader}`", block.name),
            pass.span,
            "in this pass",
        );
        // An entry of `bind` that names no block may be a misspelling of this block's name.
        let stray: Vec<&str> = pass.bind.iter().map(|b| b.block.as_str()).filter(|b| !known(b)).collect();
        let near = nearest(&block.name, stray.iter().copied()).or(match stray[..] {
            [only] => Some(only),
            _ => None,
        });
        self.errors.push(match near {
            Some(near) => diagnostic.with_help(format!("`bind` has `{near}`: is `{}` meant?", block.name)),
            None => {
                diagnostic.with_help(format!("add `\"{}\": \"name of a resource\"` to `bind`", block.name))
            }
        });
    }

    /// Returns true if a shader declares a block of this name, used or not.
    fn declares(&self, shader: ShaderId, block: &str) -> bool {
        let used = |b: &ReflectedBinding| b.name == block;
        self.declared[&shader].contains(block)
            || self.shaders[shader.index()].reflection.bindings.iter().any(used)
    }

    pub(super) fn changes_every_frame(&self, resources: &[ResourceId]) -> bool {
        resources.iter().any(|id| self.resource(*id).source.is_per_frame())
    }

    /// Reports an entry of `bind` that no shader of the pass declares. A block that is declared, but not used with the
    /// current constants, is not an error and stays unbound.
    fn unknown(&mut self, stages: &[(ShaderId, Stages)], bind: &LoweredBind) {
        if stages.iter().any(|(shader, _)| self.declares(*shader, &bind.block)) {
            return;
        }
        let names: Vec<&str> = stages.iter().map(|(s, _)| self.shaders[s.index()].name.as_str()).collect();
        let blocks: Vec<&str> = stages
            .iter()
            .flat_map(|(s, _)| &self.shaders[s.index()].reflection.bindings)
            .map(|b| b.name.as_str())
            .filter(|n| *n != LIVE_BLOCK)
            .collect();
        let diagnostic = Diagnostic::new(
            format!("{} has no block `{}`", quoted(&names), bind.block),
            bind.block_span,
            "bound here",
        );
        let otherwise = match blocks[..] {
            [] => "it binds nothing".to_string(),
            _ => format!("it has {}", quoted(&blocks)),
        };
        self.errors.push(diagnostic.with_nearest(&bind.block, blocks.iter().copied(), otherwise));
    }

    /// Checks the resources bound to a block, and reports mistakes. Returns the kind of descriptor, even for a buffer
    /// that is too large; `None` on a mismatch.
    fn fits(
        &mut self,
        shader: ShaderId,
        block: &ReflectedBinding,
        resources: &[ResourceId],
        span: Span,
    ) -> Option<DescriptorKind> {
        if let Some(error) = self.mismatch(&self.shaders[shader.index()].name, block, resources, span) {
            let declared = self.lowered.declaration(resources[0]).span;
            self.errors.push(error.with_label(declared, "declared here"));
            return None;
        }
        let kind = match block.kind {
            ReflectedKind::StorageBuffer { .. } => DescriptorKind::StorageBuffer,
            ReflectedKind::UniformBuffer { .. } => DescriptorKind::UniformBuffer,
            ReflectedKind::StorageImage { .. } => DescriptorKind::StorageImage,
        };
        let most = self.device.max_storage_bytes;
        let too_large = |id: &&ResourceId| self.resource(**id).shape.bytes() > most;
        if kind == DescriptorKind::StorageBuffer
            && let Some(id) = resources.iter().find(too_large)
        {
            let resource = self.resource(*id);
            let sizes = [resource.shape.bytes(), most];
            let [found, most] = match sizes.map(bytes) {
                [found, most] if found == most => sizes.map(|size| format!("{size} bytes")),
                rounded => rounded,
            };
            let message = format!("`{}` has {found}, and the device binds at most {most}", resource.name);
            let error = Diagnostic::new(message, self.lowered.declaration(*id).span, describe(resource));
            let help = "bind fewer elements, or use a device with a larger storage range";
            self.errors.push(error.with_help(help));
        }
        Some(kind)
    }

    /// Returns the error for resources that cannot be bound to a block of `shader`; `None` if they fit.
    fn mismatch(
        &self,
        shader: &str,
        block: &ReflectedBinding,
        resources: &[ResourceId],
        span: Span,
    ) -> Option<Diagnostic> {
        let error = |message: String, label: String| Some(Diagnostic::new(message, span, label));
        let (first, name) = (self.resource(resources[0]), format!("`{}` of `{shader}`", block.name));
        let own = &first.name;
        let is_image = matches!(block.kind, ReflectedKind::StorageImage { .. });
        if is_image != matches!(first.shape, Shape::Image { .. }) {
            let [theirs, ours] = if is_image { ["an image", "a buffer"] } else { ["a buffer", "an image"] };
            return error(format!("{name} is {theirs}"), format!("`{own}` is {ours}"));
        }
        if block.set != 0 {
            return error(format!("{name} is in set {}", block.set), "everything is in set 0".into());
        }
        if block.count as usize != resources.len() {
            let found = format!("`{own}` has {} planes", resources.len());
            return error(format!("{name} is an array of {}", block.count), found);
        }
        let writes = |found: String| error(format!("`{shader}` writes to `{}`", block.name), found);
        if block.writes && self.lowered.declaration(resources[0]).previous_frame_of.is_some() {
            return writes(format!("`{own}` belongs to the previous frame and can only be read"));
        }
        let is_uniform = matches!(first.source, Source::Frame { .. } | Source::Live);
        match (&block.kind, first.shape) {
            (ReflectedKind::StorageBuffer { .. }, _) if is_uniform => {
                error(format!("`{own}` is a uniform block"), format!("{name} is a storage buffer"))
            }
            (ReflectedKind::UniformBuffer { .. }, _) if !is_uniform => {
                error(format!("{name} is a uniform block"), format!("`{own}` is a storage buffer"))
            }
            (
                ReflectedKind::StorageBuffer { stride: Some(theirs), .. },
                Shape::Buffer { stride: ours, .. },
            ) if u64::from(*theirs) != ours => {
                let found = format!("`{own}` has elements of {ours} bytes");
                let found = error(format!("{name} has elements of {theirs} bytes"), found);
                // In std430 and std140, a `vec3[]` has a stride of 16 bytes.
                match (theirs, ours) {
                    (16, 12) => found.map(|error| {
                        error.with_help(
                            "in an array, a `vec3` takes 16 bytes; three floats in a struct take 12: \
                             `struct Vector { float x, y, z; };`",
                        )
                    }),
                    _ => found,
                }
            }
            (
                ReflectedKind::StorageBuffer { fixed_bytes: bytes, .. }
                | ReflectedKind::UniformBuffer { bytes, .. },
                shape,
            ) if u64::from(*bytes) > shape.bytes() => {
                error(format!("{name} has {bytes} bytes"), format!("`{own}` has {}", shape.bytes()))
            }
            (ReflectedKind::StorageBuffer { .. }, _) if block.writes => match first.source {
                Source::Transient => None,
                Source::Scene { .. } => writes(format!("`{own}` is the scene's and cannot be written")),
                _ => writes(format!("`{own}` is given to every frame and cannot be written")),
            },
            (ReflectedKind::StorageImage { format: Some(theirs) }, Shape::Image { format: ours, .. })
                if *theirs != ours =>
            {
                let found = format!("`{own}` has the format {}", ours.name());
                error(format!("{name} has the format {}", theirs.name()), found)
            }
            _ => None,
        }
    }

    fn describe_touches(
        &self,
        block: &ReflectedBinding,
        kind: DescriptorKind,
        resources: &[ResourceId],
        stage: Stages,
        uses: &mut Vec<Use>,
    ) {
        let mut accesses = Accesses::empty();
        accesses.set(Accesses::STORAGE_READ, block.reads);
        accesses.set(Accesses::STORAGE_WRITE, block.writes);
        let layout = match kind {
            DescriptorKind::UniformBuffer => {
                accesses = Accesses::UNIFORM_READ;
                None
            }
            DescriptorKind::StorageBuffer => None,
            DescriptorKind::StorageImage => Some(Layout::General),
        };
        for resource in resources {
            touch(uses, *resource, stage, accesses, layout, false);
        }
    }

    /// Encodes the push constants of a pass, and checks `push` against the shaders' blocks. Empty if they have none, or
    /// if two shaders declare different blocks.
    pub(super) fn push(&mut self, pass: &LoweredPass, stages: &[(ShaderId, Stages)]) -> Vec<u8> {
        let with_push = |(shader, _): &(ShaderId, Stages)| {
            let shader = &self.shaders[shader.index()];
            Some((shader.name.clone(), shader.reflection.push.clone()?))
        };
        let blocks: Vec<(String, PushBlock)> = stages.iter().filter_map(with_push).collect();
        let mut bytes = Vec::new();
        let members = || {
            blocks.iter().flat_map(|(shader, block)| block.members.iter().map(move |member| (shader, member)))
        };
        let known: Vec<&str> = members().map(|(_, member)| member.name.as_str()).collect();
        // The stages of a draw share the push constants, so their blocks must be equal.
        if blocks.iter().any(|(_, block)| !block.has_layout_of(&blocks[0].1)) {
            let message = "the two shaders declare different push constants";
            self.error(message, pass.span, "in this draw");
        } else if let Some((first, block)) = blocks.first() {
            let most = self.device.max_push_bytes;
            if block.bytes > most {
                let message = format!("the device has at most {most} bytes of push constants");
                let found = format!("`{first}` declares {}", block.bytes);
                let error = Diagnostic::new(message, pass.span, found);
                self.errors.push(error.with_help("pass the values in a buffer, or as live parameters"));
            }
            bytes.resize(block.bytes as usize, 0);
            for member in &block.members {
                // The shader that reads the member, if any does.
                let reader = members().find(|(_, own)| own.name == member.name && own.used);
                let shader = reader.map_or(first, |(shader, _)| shader);
                let Some(push) = pass.push.iter().find(|p| p.name == member.name) else {
                    let message = format!("the push constant `{}` of `{shader}` is not given", member.name);
                    let error = Diagnostic::new(message, pass.span, "in this pass");
                    let entry = |name: &str| format!("\"{name}\": ...");
                    let stray = pass.push.iter().map(|p| p.name.as_str()).filter(|p| !known.contains(p));
                    self.errors.push(error.with_help(match nearest(&member.name, stray) {
                        Some(near) => format!("`push` has `{near}`: is `{}` meant?", member.name),
                        None if pass.push.is_empty() => {
                            let all: Vec<String> = block.members.iter().map(|m| entry(&m.name)).collect();
                            format!("add `push: {{{}}}`", all.join(", "))
                        }
                        None => format!("add `{}` to `push`", entry(&member.name)),
                    }));
                    continue;
                };
                let word = match (member.kind, &push.value) {
                    (MemberKind::Uint, Value::Int(v)) => u32::try_from(*v).ok().map(u32::to_le_bytes),
                    (MemberKind::Uint, Value::Bool(v)) => Some(u32::from(*v).to_le_bytes()),
                    (MemberKind::Int, Value::Int(v)) => i32::try_from(*v).ok().map(i32::to_le_bytes),
                    (MemberKind::Float, Value::Float(v)) => to_f32(*v).map(f32::to_le_bytes),
                    (MemberKind::Float, Value::Int(v)) => {
                        Some(*v as f32).filter(|float| *float as i128 == i128::from(*v)).map(f32::to_le_bytes)
                    }
                    _ => None,
                };
                let at = member.offset as usize;
                match word {
                    Some(word) if at + 4 <= bytes.len() => bytes[at..at + 4].copy_from_slice(&word),
                    _ => {
                        let message =
                            format!("`{}` of `{shader}` is {}", member.name, kind_name(member.kind));
                        let (found, help) = unfit(member.kind, &push.value);
                        let error = Diagnostic::new(message, push.value_span, found);
                        self.errors.push(match help {
                            Some(help) => error.with_help(help),
                            None => error,
                        });
                    }
                }
            }
        }
        for push in &pass.push {
            if !known.contains(&push.name.as_str()) {
                let diagnostic = Diagnostic::new(
                    format!("no shader of this pass has a push constant `{}`", push.name),
                    push.name_span,
                    "given here",
                );
                self.errors.push(diagnostic.with_nearest(&push.name, known.iter().copied(), ""));
            }
        }
        bytes
    }
}

/// Returns the error for a pass of the prologue that reads data which the host rewrites for every frame.
pub(super) fn once_every_frame(pass: &LoweredPass, span: Span, label: impl Into<String>) -> Diagnostic {
    let message = format!("`{}` runs once, but reads values that change every frame", pass.pass.name);
    Diagnostic::new(message, span, label).with_help("let it run every frame, or give it constants")
}

/// Describes why a push constant cannot have a value. Also suggests an expression that it can have, if there is one.
fn unfit(kind: MemberKind, value: &Value) -> (String, Option<&'static str>) {
    let (expected, help) = match (kind, value) {
        (MemberKind::Uint, Value::Int(_)) => ("an integer from 0 to 4294967295", None),
        (MemberKind::Int, Value::Int(_)) => ("an integer from -2147483648 to 2147483647", None),
        (MemberKind::Float, Value::Int(_)) => {
            ("an integer that a 32-bit float represents exactly", Some("`float(x)` rounds it"))
        }
        (MemberKind::Float, Value::Float(_)) => ("a number in the range of 32-bit floats", None),
        (MemberKind::Float, _) => ("a number", None),
        (MemberKind::Uint, _) => ("an integer or a truth value", None),
        (MemberKind::Int, _) => ("an integer", None),
        (MemberKind::Other, _) => return ("given here".into(), None),
    };
    let help = help.or(match (kind, value) {
        (MemberKind::Uint | MemberKind::Int, Value::Float(_)) => Some("`int(x)` truncates the fraction"),
        (MemberKind::Int | MemberKind::Float, Value::Bool(_)) => Some("`int(x)` is 0 or 1"),
        _ => None,
    });
    let found = match value {
        Value::Bool(_) | Value::Int(_) => value.to_string(),
        Value::Float(v) => format!("{v:?}"),
        Value::Text(text) => format!("the string '{text}'"),
    };
    (format!("expected {expected}, found {found}"), help)
}

fn kind_name(kind: MemberKind) -> &'static str {
    match kind {
        MemberKind::Uint => "a uint",
        MemberKind::Int => "an int",
        MemberKind::Float => "a float",
        MemberKind::Other => "not a single number: push constants are uint, int or float",
    }
}

fn quoted(names: &[&str]) -> String {
    names.iter().map(|n| format!("`{n}`")).collect::<Vec<_>>().join(", ")
}
