//! Lowers the plan to Metal's terms, as plain data.
//!
//! The bindings of each pass get their indices in the argument tables from the translated shaders. Nothing calls the
//! API, so the lowering can be tested on any machine.
//!
//! Three things need no lowering. Arguments of indirect commands have equal layouts in both APIs: three words of a
//! dispatch (`MTLDispatchThreadgroupsIndirectArguments`), and four of a draw (`MTLDrawPrimitivesIndirectArguments`:
//! vertices, instances, first vertex, first instance). Threadgroup memory is declared in the shaders, with its size.
//! The y axis of clip space points up in Metal and down in Vulkan: the translated vertex shaders negate it, so
//! viewports and images are unchanged.

use splatgraph_api::BackendError;
use splatgraph_framework::{ir::*, plan::*};
use splatgraph_runtime::{PipelineState, PipelineStates};
use std::sync::Arc;

/// The shader of one stage of a pass, which determines the stage's argument slots.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StageArguments {
    /// The stage of the shader. Each has its own argument tables.
    pub stage: ShaderStage,
    /// The translated shader. It assigns an index to each argument.
    pub msl: Arc<Msl>,
}

/// A slot in one of a stage's argument tables.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ArgumentSlot {
    /// The stage of the table.
    pub stage: ShaderStage,
    /// True for the table of textures, false for the table of buffers.
    pub texture: bool,
    /// The index in the table.
    pub index: u32,
    /// True for a buffer of a shader that takes a buffer of sizes ([`Msl::sizes`]); its size is word `index` there.
    pub sized: bool,
}

/// The pipelines and arguments of a whole plan.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Lowered {
    /// Pipelines of the plan.
    pub pipelines: PipelineStates<()>,
    /// The arguments of each pass, by stage; empty for passes without a pipeline.
    pub arguments: Vec<Vec<StageArguments>>,
}

impl Lowered {
    /// Lists the argument slots of a pass's binding, one for each stage whose shader uses it.
    pub fn places(&self, pass: PassId, binding: &Binding) -> impl Iterator<Item = ArgumentSlot> {
        let at = (binding.binding, binding.element);
        self.arguments[pass.index()].iter().filter_map(move |stage| {
            let found = stage.msl.arguments.iter().find(|place| (place.binding, place.element) == at)?;
            let sized = !found.texture && stage.msl.sizes.is_some();
            Some(ArgumentSlot { stage: stage.stage, texture: found.texture, index: found.index, sized })
        })
    }
}

/// Lowers a checked plan to pipelines and arguments.
///
/// # Errors
/// A shader was not translated.
pub fn lower(plan: &Plan) -> Result<Lowered, BackendError> {
    let pipelines = PipelineStates::new(plan, |_| ());
    let stages = |pipeline: &Option<usize>| {
        let shaders = match pipeline.map(|pipeline| &pipelines.states[pipeline].0) {
            None => Vec::new(),
            Some(PipelineState::Compute(shader)) => vec![*shader],
            Some(PipelineState::Draw { vertex, fragment, .. }) => vec![*vertex, *fragment],
        };
        shaders.into_iter().map(|shader| arguments(plan.shader(shader))).collect()
    };
    let arguments = pipelines.of_pass.iter().map(stages).collect::<Result<_, BackendError>>()?;
    Ok(Lowered { pipelines, arguments })
}

fn arguments(shader: &Shader) -> Result<StageArguments, BackendError> {
    match &shader.msl {
        Some(msl) => Ok(StageArguments { stage: shader.reflection.stage, msl: msl.clone() }),
        None => Err(BackendError::Invalid(format!(
            "expected shaders in Metal's language, found shader `{}` without a translation",
            shader.name
        ))),
    }
}

/// The flags of `MTLTextureUsage` that images use.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TextureUsage {
    /// `MTLTextureUsageShaderRead`.
    pub shader_read: bool,
    /// `MTLTextureUsageShaderWrite`.
    pub shader_write: bool,
    /// `MTLTextureUsageRenderTarget`.
    pub render_target: bool,
}

/// Lowers the usage of an image. Copies need no flag, but images are cleared by a kernel and shown by a draw that
/// samples them.
pub fn image_usage(usage: Usage) -> TextureUsage {
    TextureUsage {
        shader_read: usage.intersects(Usage::STORAGE | Usage::COPY_SOURCE),
        shader_write: usage.intersects(Usage::STORAGE | Usage::COPY_TARGET),
        render_target: usage.intersects(Usage::COLOR_TARGET | Usage::DEPTH_TARGET),
    }
}

/// Threadgroup size in x and y of the kernel that clears an image.
pub const CLEAR_THREADS: [u32; 2] = [16, 16];

/// Returns the number of threadgroups of 256 threads that fill `words` 32-bit words.
///
/// At most 65,535: the kernel loops over the rest.
pub fn fill_groups(words: u64) -> u32 {
    const MAX_GROUPS: u64 = 65535;
    words.div_ceil(256).min(MAX_GROUPS) as u32
}

/// Returns the number of threadgroups in x and y that clear an image of this size.
pub fn clear_groups((width, height): (u32, u32)) -> [u32; 2] {
    [width.div_ceil(CLEAR_THREADS[0]), height.div_ceil(CLEAR_THREADS[1])]
}

/// Returns true if an image is interpolated when shown: if the sizes differ and its format can be filtered.
pub fn interpolates(format: Format, same_size: bool, filters_floats: bool) -> bool {
    let filtered = match format {
        Format::Rgba8Unorm | Format::Rgba16Float => true,
        Format::Rgba32Float | Format::R32Float => filters_floats,
        Format::R32Uint | Format::Depth32Float => false,
    };
    filtered && !same_size
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::handmade::*;

    fn argument(binding: u32, element: u32, texture: bool, index: u32) -> MslArgument {
        MslArgument { binding, element, texture, index }
    }

    fn msl(arguments: Vec<MslArgument>, push: Option<u32>, sizes: Option<u32>) -> Option<Arc<Msl>> {
        Some(Arc::new(Msl { source: String::new(), entry: "main0".to_string(), arguments, push, sizes }))
    }

    /// Returns the plan with translations: the vertex shader reads the camera, the fragment shader all three bindings.
    fn translated() -> Plan {
        let mut plan = plan();
        plan.shaders[0].msl = msl(vec![argument(0, 0, false, 0)], Some(1), Some(2));
        plan.shaders[1].msl = msl(vec![argument(1, 0, false, 0)], Some(1), None);
        let all = vec![argument(0, 0, false, 0), argument(0, 1, false, 1), argument(1, 0, false, 2)];
        plan.shaders[2].msl = msl(all, None, None);
        plan
    }

    #[test]
    fn a_binding_has_a_place_in_each_stage_that_reaches_it() {
        let plan = translated();
        let lowered = lower(&plan).unwrap();
        let places = |pass: u32, binding: usize| -> Vec<(ShaderStage, u32, bool)> {
            let id = PassId(pass);
            let places = lowered.places(id, &plan.pass(id).bindings[binding]);
            places.map(|place| (place.stage, place.index, place.sized)).collect()
        };
        assert_eq!(places(1, 0), [(ShaderStage::Compute, 0, true)]);
        // The draw binds the camera, then two elements of an array.
        assert_eq!(places(3, 0), [(ShaderStage::Vertex, 0, false), (ShaderStage::Fragment, 2, false)]);
        assert_eq!(places(3, 1), [(ShaderStage::Fragment, 1, false)]);
        assert_eq!(places(3, 2), [(ShaderStage::Fragment, 0, false)]);
    }

    #[test]
    fn a_shader_without_a_translation_is_named() {
        let mut plan = translated();
        plan.shaders[2].msl = None;
        let error = lower(&plan).unwrap_err().to_string();
        assert!(error.contains("found shader `splat.frag` without a translation"), "{error}");
    }

    #[test]
    fn images_can_be_cleared_where_they_are_written_and_sampled_where_they_are_copied() {
        let shown = image_usage(Usage::COLOR_TARGET | Usage::COPY_SOURCE);
        assert_eq!(shown, TextureUsage { shader_read: true, shader_write: false, render_target: true });
        assert!(image_usage(Usage::COPY_TARGET).shader_write);
        let storage = image_usage(Usage::STORAGE);
        assert!(storage.shader_read && storage.shader_write && !storage.render_target);
        assert_eq!(image_usage(Usage::empty()), TextureUsage::default());
    }

    #[test]
    fn built_in_kernels_cover_every_word_and_pixel() {
        assert_eq!([fill_groups(1), fill_groups(256), fill_groups(257)], [1, 1, 2]);
        assert_eq!(fill_groups(1 << 30), 65535);
        assert_eq!(clear_groups((16, 17)), [1, 2]);
        assert_eq!(clear_groups((1920, 1080)), [120, 68]);
    }

    #[test]
    fn pictures_are_interpolated_where_they_are_scaled_and_the_device_can() {
        assert!(!interpolates(Format::Rgba8Unorm, true, true));
        assert!(interpolates(Format::Rgba8Unorm, false, false));
        assert!(!interpolates(Format::Rgba32Float, false, false));
        assert!(interpolates(Format::Rgba32Float, false, true));
    }
}
