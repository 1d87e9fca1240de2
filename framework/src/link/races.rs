//! Checks for data races inside a pass.
//!
//! Barriers order passes. Two accesses within one pass have no order, so if one of them writes, no plan can be correct.
//! These passes are rejected:
//!
//! - a resource that is written and bound twice, or drawn to and bound;
//! - a dispatch or a draw that writes its own indirect arguments;
//! - a draw in which one stage accesses data that the other writes, unless all accesses are atomic.
//!
//! The invocations of one stage have no order either. That is the shader's responsibility: by atomics, by a workgroup
//! barrier, or by accessing disjoint elements. The reflected accesses do not show whether a shader is safe.

use super::linker::Linker;
use crate::ir::{DrawCall, ReflectedBinding, ResourceId, ShaderId, Span, Stages, Use, Work};
use crate::lower::{LoweredBind, LoweredPass, LoweredSize};
use crate::source::Diagnostic;

impl Linker<'_> {
    pub(super) fn races(&mut self, pass: &LoweredPass, stages: &[(ShaderId, Stages)], uses: &[Use]) {
        self.bound_twice(pass, uses);
        self.drawn_and_bound(pass);
        self.arguments(pass, stages);
        self.between_stages(pass, stages);
    }

    /// Rejects a resource that is bound twice to a pass that writes it: invocations run in any order.
    fn bound_twice(&mut self, pass: &LoweredPass, uses: &[Use]) {
        // `last(name)` is in the memory of `name`.
        let real = |id: &ResourceId| self.lowered.real(*id);
        for (i, bind) in pass.bind.iter().enumerate() {
            for id in &bind.resources {
                let written = uses.iter().any(|t| real(&t.resource) == real(id) && t.accesses.writes());
                let twice =
                    pass.bind[..i].iter().find(|b| b.resources.iter().any(|other| real(other) == real(id)));
                if let (true, Some(other)) = (written, twice) {
                    let name = &self.resource(real(id)).name;
                    let diagnostic = Diagnostic::new(
                        format!("`{name}` is written and bound twice"),
                        bind.resource_span,
                        "bound here",
                    )
                    .with_label(other.resource_span, "and here");
                    let mut bound =
                        other.resources.iter().chain([id]).filter(|other| real(other) == real(id));
                    let last = bound.find(|id| real(id) != **id);
                    self.errors.push(match last.map(|id| &self.resource(*id).name) {
                        // Only the halves of a ping-pong buffer have `#` in their names: `keys#0` and `keys#1`.
                        Some(last) if name.contains('#') => diagnostic.with_help(format!(
                            "`{last}` is the half of the buffer that is in front at the end of a frame, here `{name}`; with an even number of swaps in \
                             a frame, its first pass can read `{last}` and write the back"
                        )),
                        Some(last) => diagnostic.with_help(format!(
                            "`{last}` is `{name}` before the first write of a frame; write another buffer, and copy it \
                             to `{name}` in a later pass"
                        )),
                        None => diagnostic.with_help(
                            "bind it once, to a block or an image without `readonly` and `writeonly`, or write another \
                             resource"
                        ),
                    });
                }
            }
        }
    }

    /// Rejects an attachment that is also bound in the same pass.
    fn drawn_and_bound(&mut self, pass: &LoweredPass) {
        let Work::Draw { targets, depth, .. } = &pass.pass.work else { return };
        let images = targets.iter().map(|target| target.image).chain(depth.map(|depth| depth.image));
        for (image, span) in images.zip(&pass.target_spans) {
            let binds = |b: &&LoweredBind| b.resources.iter().any(|id| self.lowered.real(*id) == image);
            if let Some(bind) = pass.bind.iter().find(binds) {
                let name = &self.resource(image).name;
                self.errors.push(
                    Diagnostic::new(
                        format!("`{name}` is drawn to and bound in the same pass"),
                        *span,
                        "drawn to here",
                    )
                    .with_label(bind.resource_span, "bound here"),
                );
            }
        }
    }

    /// Rejects a command whose shaders write its own arguments. The written words are unknown, so this covers the whole
    /// buffer.
    fn arguments(&mut self, pass: &LoweredPass, stages: &[(ShaderId, Stages)]) {
        let Some((buffer, span)) = arguments(pass) else { return };
        for bind in &pass.bind {
            let same = bind.resources.iter().any(|id| self.lowered.real(*id) == self.lowered.real(buffer));
            let writer = self.blocks(stages, &bind.block).find(|(_, block)| block.writes);
            let (true, Some((shader, _))) = (same, writer) else { continue };
            let diagnostic = Diagnostic::new(
                format!(
                    "`{}` writes the buffer `{}`, which holds its own arguments",
                    pass.pass.name,
                    self.resource(buffer).name
                ),
                bind.resource_span,
                format!("written by `{}`", self.shaders[shader.index()].name),
            );
            self.errors.push(diagnostic.with_label(span, "the arguments").with_help(
                "no barrier is possible between a command's arguments and its shaders: write another buffer",
            ));
        }
    }

    /// Rejects a draw in which one stage writes data that the other accesses, unless both use only atomics. Stages of
    /// different primitives overlap.
    fn between_stages(&mut self, pass: &LoweredPass, stages: &[(ShaderId, Stages)]) {
        if stages.len() < 2 {
            return;
        }
        for bind in &pass.bind {
            let blocks: Vec<(ShaderId, &ReflectedBinding)> = self.blocks(stages, &bind.block).collect();
            let [(vertex, a), (fragment, b)] = blocks[..] else { continue };
            let uses = |block: &ReflectedBinding| block.reads || block.writes;
            let conflict = uses(a) && uses(b) && (a.writes || b.writes);
            if !conflict || (a.atomics_only && b.atomics_only) {
                continue;
            }
            let does = |block: &ReflectedBinding| match (block.reads, block.writes) {
                (true, true) => "reads and writes",
                (_, true) => "writes",
                _ => "reads",
            };
            let name = |shader: ShaderId| &self.shaders[shader.index()].name;
            let diagnostic = Diagnostic::new(
                format!(
                    "`{}` {} `{}` while `{}` {} it",
                    name(vertex),
                    does(a),
                    bind.block,
                    name(fragment),
                    does(b)
                ),
                bind.resource_span,
                "by both stages of this draw",
            );
            self.errors.push(diagnostic.with_help(
                "no barrier is possible between the stages of a draw: bind two buffers, or use atomics in both stages",
            ));
        }
    }

    fn blocks<'s>(
        &'s self,
        stages: &'s [(ShaderId, Stages)],
        name: &'s str,
    ) -> impl Iterator<Item = (ShaderId, &'s ReflectedBinding)> {
        stages.iter().filter_map(move |(shader, _)| {
            let bindings = &self.shaders[shader.index()].reflection.bindings;
            Some((*shader, bindings.iter().find(|block| block.name == name)?))
        })
    }
}

/// Returns the buffer of a pass's indirect arguments, and the place of its `size` or `call`. `None` for other passes.
pub(super) fn arguments(pass: &LoweredPass) -> Option<(ResourceId, Span)> {
    match pass.pass.work {
        Work::Dispatch { groups: LoweredSize::Indirect { buffer, .. }, .. }
        | Work::Draw { call: DrawCall::Indirect { buffer, .. }, .. } => Some((buffer, pass.size_span)),
        _ => None,
    }
}
