//! Checks the interface between the two stages of a draw, and its targets.

use super::linker::{Linker, describe, touch};
use crate::ir::{
    Accesses, Blend, DepthAccess, DepthTarget, Format, Layout, Load, ShaderId, Shape, Source, Span, Stages,
    Target, Use, Varying,
};
use crate::lower::LoweredPass;
use crate::source::Diagnostic;

impl Linker<'_> {
    /// Checks that the vertex shader uses `gl_Position` and outputs every input of the fragment shader, by location and
    /// type. The two are compiled separately, so the compiler does not check this.
    pub(super) fn interface(
        &mut self,
        (vertex, vertex_span): (ShaderId, Span),
        (fragment, span): (ShaderId, Span),
    ) {
        let (from, to) = (&self.shaders[vertex.index()], &self.shaders[fragment.index()]);
        if !from.reflection.uses_position {
            let message = format!("expected `{}` to write `gl_Position`, found no use of it", from.name);
            let label = "the positions of its vertices are undefined";
            self.errors.push(Diagnostic::new(message, vertex_span, label));
        }
        for input in &to.reflection.inputs {
            let output = from.reflection.outputs.iter().find(|o| o.location == input.location);
            let wrong = match output {
                None => format!("`{}` has no output at location {}", from.name, input.location),
                Some(o) if o.glsl_type != input.glsl_type => {
                    format!("`{}` gives it as `{} {}`", from.name, o.glsl_type, o.name)
                }
                Some(_) => continue,
            };
            let message =
                format!("the input `{} {}` of `{}` has no source", input.glsl_type, input.name, to.name);
            self.errors.push(Diagnostic::new(message, span, wrong));
        }
    }

    pub(super) fn targets(
        &mut self,
        fragment: ShaderId,
        pass: &LoweredPass,
        targets: &[Target],
        uses: &mut Vec<Use>,
    ) {
        let shader = self.shaders[fragment.index()].clone();
        let outputs = shader.reflection.outputs.len();
        if outputs != targets.len() || targets.is_empty() {
            self.errors.push(outputs_and_targets(&shader.name, outputs, targets.len(), pass.span));
            return;
        }
        let most = self.device.max_targets;
        if let Some(span) = pass.target_spans.get(most as usize) {
            let message = format!("the device has at most {most} targets in a draw");
            self.error(message, *span, format!("this draw has {}", targets.len()));
        }
        let mut first = None;
        for (i, (target, span)) in targets.iter().zip(&pass.target_spans).enumerate() {
            let image = self.resource(target.image).clone();
            let Shape::Image { width, height, format } = image.shape else {
                self.error(format!("`{}` is a buffer", image.name), *span, "a target must be an image");
                continue;
            };
            if is_depth(&image.shape) {
                let message = format!("`{}` holds depths", image.name);
                let error = Diagnostic::new(message, *span, "a target must hold colours");
                self.errors.push(error.with_help("name it in `depth` of the draw"));
                continue;
            }
            let output = &shader.reflection.outputs[i];
            if output.location as usize != i || !fills(&output.glsl_type, format, target.blend) {
                let declared = self.lowered.declaration(target.image).span;
                let wanted = (&*image.name, format, target.blend);
                let error = wrong_output(&shader.name, output, i, wanted, *span);
                self.errors.push(error.with_label(declared, "declared here"));
                continue;
            }
            if image.source != Source::Transient || self.lowered.real(target.image) != target.image {
                self.error(format!("`{}` cannot be drawn to", image.name), *span, "not the graph's own");
            }
            if targets[..i].iter().any(|t| t.image == target.image) {
                self.error(format!("`{}` is a target twice", image.name), *span, "the second time");
            }
            let (size, first_span, text) =
                first.get_or_insert_with(|| ((width, height), *span, describe(&image)));
            if *size != (width, height) {
                let message = "the targets of a pass must have the same size";
                let error = Diagnostic::new(message, *span, describe(&image));
                self.errors.push(error.with_label(*first_span, text.clone()));
            }
            // A cleared target is only written: blending reads what this pass cleared or drew.
            let (accesses, discards) = match target.load {
                Load::Clear(..) => (Accesses::COLOR_WRITE, true),
                Load::Keep => (Accesses::COLOR_READ | Accesses::COLOR_WRITE, false),
            };
            touch(uses, target.image, Stages::COLOR_OUTPUT, accesses, Some(Layout::ColorTarget), discards);
        }
    }

    pub(super) fn depth(
        &mut self,
        pass: &LoweredPass,
        targets: &[Target],
        depth: Option<DepthTarget>,
        uses: &mut Vec<Use>,
    ) {
        // The depth attachment's span is the last one.
        let (Some(DepthTarget { image, access }), Some(&span)) = (depth, pass.target_spans.last()) else {
            return;
        };
        let found = self.resource(image).clone();
        let Shape::Image { width, height, format: Format::Depth32Float } = found.shape else {
            let message = format!("expected an image of the format depth32f, found {}", describe(&found));
            self.error(message, span, "cannot hold depths");
            return;
        };
        if let Some(target) = targets.first() {
            let target = self.resource(target.image);
            if let Shape::Image { width: w, height: h, .. } = target.shape
                && (w, h) != (width, height)
            {
                let message = "the depth image of a draw must have the size of its targets";
                let error = Diagnostic::new(message, span, describe(&found));
                self.errors.push(error.with_label(pass.target_spans[0], describe(target)));
                return;
            }
        }
        // A cleared attachment is only written: the test reads what this pass cleared or drew.
        let (accesses, discards) = match access {
            DepthAccess::Write => (Accesses::DEPTH_WRITE, true),
            DepthAccess::TestAndWrite => (Accesses::DEPTH_READ | Accesses::DEPTH_WRITE, false),
            DepthAccess::Test => (Accesses::DEPTH_READ, false),
        };
        touch(uses, image, Stages::DEPTH_TESTS, accesses, Some(Layout::DepthTarget), discards);
    }
}

fn is_depth(shape: &Shape) -> bool {
    matches!(shape, Shape::Image { format: Format::Depth32Float, .. })
}

/// Returns the smallest GLSL type that gives every channel of a format a value, and alpha, if blending reads it.
fn output_type(format: Format, blend: Blend) -> &'static str {
    match format {
        _ if blend.reads_alpha() => "vec4",
        Format::Rgba8Unorm | Format::Rgba16Float | Format::Rgba32Float => "vec4",
        Format::R32Uint => "uint",
        Format::R32Float | Format::Depth32Float => "float",
    }
}

/// Returns true if an output of a type defines every channel of a target, and alpha, if blending reads it.
///
/// Vulkan leaves channels that the type lacks undefined, and all channels if one side has integers and the other has
/// floats. Surplus components are discarded.
fn fills(glsl_type: &str, format: Format, blend: Blend) -> bool {
    let (scalars, vectors) = match format {
        Format::R32Uint => (["uint", "uint16_t"], ["uvec", "u16vec"]),
        _ => (["float", "float16_t"], ["vec", "f16vec"]),
    };
    let one = || scalars.contains(&glsl_type).then_some(1);
    let components = vectors.iter().find_map(|prefix| glsl_type.strip_prefix(prefix)?.parse().ok());
    let channels: u32 = if output_type(format, blend) == "vec4" { 4 } else { 1 };
    components.or_else(one).is_some_and(|components| components >= channels)
}

/// Returns the error for a target whose output is at another location, or does not fill it ([`fills`]).
fn wrong_output(
    shader: &str,
    Varying { name, location, glsl_type, .. }: &Varying,
    target: usize,
    (image, format, blend): (&str, Format, Blend),
    span: Span,
) -> Diagnostic {
    let wanted = output_type(format, blend);
    let at = if *location as usize == target { String::new() } else { format!(" at location {location}") };
    let message = format!(
        "expected an output `{wanted}` at location {target} for the target `{image}`, found `{glsl_type} {name}`{at}"
    );
    let format_type = output_type(format, Blend::Replace);
    let label = match wanted == format_type {
        true => format!("`{image}` has the format {}", format.name()),
        false => format!("`{blend:?}` reads the alpha of the output, which `{format_type}` leaves undefined"),
    };
    Diagnostic::new(message, span, label)
        .with_help(format!("declare it in `{shader}`: `layout(location = {target}) out {wanted} {name};`"))
}

/// Returns the error for a draw without targets, or with a number of targets other than its shader's outputs.
fn outputs_and_targets(shader: &str, outputs: usize, targets: usize, pass: Span) -> Diagnostic {
    let counted = |n: usize, what: &str| format!("{n} {what}{}", if n == 1 { "" } else { "s" });
    let expected = match targets {
        0 => "at least one output and one target".to_owned(),
        _ => format!("{} of `{shader}`, one for each target", counted(targets, "output")),
    };
    let (outputs_found, targets_found) = (counted(outputs, "output"), counted(targets, "target"));
    let message = format!("expected {expected}, found {outputs_found}");
    let error = Diagnostic::new(message, pass, format!("this pass has {targets_found}"));
    // The help shows how to add to the side with fewer.
    if outputs < targets.max(1) {
        error.with_help(format!(
            "an output is a line of the shader: `layout(location = {outputs}) out vec4 colour;`"
        ))
    } else {
        let target = "Target(image: \"name of an image\", load: Clear(0, 0, 0, 0), blend: Replace)";
        error.with_help(format!("name an image for each output: `targets: [{target}]`"))
    }
}
