//! Lowers the plan to Metal's terms, as plain data.
//!
//! The bindings of each pass get their indices in the argument tables from the translated shaders. Nothing calls the
//! API, so the lowering can be tested on any machine.
//!
//! Two things need no lowering. Arguments of indirect commands have equal layouts in both APIs: three words of a
//! dispatch (`MTLDispatchThreadgroupsIndirectArguments`), and four of a draw (`MTLDrawPrimitivesIndirectArguments`:
//! vertices, instances, first vertex, first instance). Threadgroup memory is declared in the shaders, with its size.
//! The y axis of clip space points up in Metal and down in Vulkan. The translated vertex shaders negate it, so
//! viewports and images are unchanged.

use splatgraph_api::{BackendError, LimitExceeded, Unit};
use splatgraph_framework::{ir::*, plan::*};
use std::sync::Arc;

/// State of a pipeline. Passes with equal states share a pipeline.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PipelineState {
    /// State of an `MTLComputePipelineDescriptor`.
    Compute {
        /// Shader of the kernel.
        shader: ShaderId,
        /// Threadgroup size in x, y and z. It is passed with each dispatch.
        threads: [u32; 3],
    },
    /// State of an `MTLRenderPipelineDescriptor`.
    Draw {
        /// The vertex function.
        vertex: ShaderId,
        /// The fragment function.
        fragment: ShaderId,
        /// The primitive type, passed with each draw. The pipeline has only its class.
        topology: Topology,
        /// The colour attachments.
        targets: Vec<TargetState>,
        /// The use of the depth attachment; `None` without one.
        depth: Option<DepthAccess>,
    },
}

/// The state of a colour attachment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TargetState {
    /// The format of the image.
    pub format: Format,
    /// Blending; `None` if the fragment replaces the target.
    pub blend: Option<BlendState>,
}

/// The blend equation: `colour = source * source factor + target * target factor`, likewise for alpha.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BlendState {
    /// Factors of the colour, for source and target.
    pub color: (BlendFactor, BlendFactor),
    /// Factors of alpha, for source and target.
    pub alpha: (BlendFactor, BlendFactor),
}

/// The values of `MTLBlendFactor` that plans use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BlendFactor {
    /// Factor 0.
    Zero,
    /// Factor 1.
    One,
    /// Factor 1 - the fragment's alpha.
    OneMinusSourceAlpha,
    /// Factor equal to the target's alpha.
    DestinationAlpha,
}

/// A shader stage. Each has its own argument tables.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Kernels.
    Compute,
    /// Vertex functions.
    Vertex,
    /// Fragment functions.
    Fragment,
}

/// The shader of one stage of a pass, which determines the stage's argument slots.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StageArguments {
    /// The stage of the shader.
    pub stage: Stage,
    /// The translated shader. It assigns an index to each argument.
    pub msl: Arc<Msl>,
}

/// A slot in one of a stage's argument tables.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ArgumentSlot {
    /// The stage of the table.
    pub stage: Stage,
    /// True for the table of textures, false for the table of buffers.
    pub texture: bool,
    /// The index in the table.
    pub index: u32,
    /// True if the shader needs the buffer's size, passed as word `index` of the buffer of sizes.
    pub sized: bool,
}

/// The pipelines and arguments of a whole plan.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Lowered {
    /// Pipelines of the plan, without duplicates.
    pub pipelines: Vec<PipelineState>,
    /// Index into [`Lowered::pipelines`], by pass; `None` if the pass has no pipeline or is not in the order.
    pub of_pass: Vec<Option<usize>>,
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
/// A shader was not translated, or needs more slots than an argument table has.
pub fn lower(plan: &Plan) -> Result<Lowered, BackendError> {
    let passes = plan.passes.len();
    let mut lowered =
        Lowered { of_pass: vec![None; passes], arguments: vec![Vec::new(); passes], ..Lowered::default() };
    for id in plan.order() {
        let pass = plan.pass(id);
        let Some(state) = pipeline(plan, pass) else { continue };
        let stages: &[(Stage, ShaderId)] = match state {
            PipelineState::Compute { shader, .. } => &[(Stage::Compute, shader)],
            PipelineState::Draw { vertex, fragment, .. } => {
                &[(Stage::Vertex, vertex), (Stage::Fragment, fragment)]
            }
        };
        let stages = stages.iter().map(|&(stage, shader)| arguments(plan.shader(shader), stage));
        lowered.arguments[id.index()] = stages.collect::<Result<_, _>>()?;
        let known = lowered.pipelines.iter().position(|other| *other == state);
        lowered.of_pass[id.index()] = Some(known.unwrap_or_else(|| {
            lowered.pipelines.push(state);
            lowered.pipelines.len() - 1
        }));
    }
    Ok(lowered)
}

fn pipeline(plan: &Plan, pass: &Pass) -> Option<PipelineState> {
    match &pass.work {
        Work::Dispatch { shader, .. } => Some(PipelineState::Compute {
            shader: *shader,
            threads: plan.shader(*shader).reflection.local_size,
        }),
        Work::Draw { vertex, fragment, topology, targets, depth, .. } => {
            let targets = targets.iter().filter_map(|target| match plan.resource(target.image).shape {
                Shape::Image { format, .. } => Some(TargetState { format, blend: blend(target.blend) }),
                Shape::Buffer { .. } => None,
            });
            let targets = targets.collect();
            let depth = depth.map(|depth| depth.access);
            Some(PipelineState::Draw {
                vertex: *vertex,
                fragment: *fragment,
                topology: *topology,
                targets,
                depth,
            })
        }
        _ => None,
    }
}

fn arguments(shader: &Shader, stage: Stage) -> Result<StageArguments, BackendError> {
    let name = &shader.name;
    let Some(msl) = &shader.msl else {
        return Err(BackendError::Invalid(format!(
            "expected shaders in Metal's language, found shader `{name}` without a translation"
        )));
    };
    let most = |texture: bool| {
        let table =
            msl.arguments.iter().filter(move |place| place.texture == texture).map(|place| place.index);
        let own = [msl.push, msl.sizes].into_iter().flatten().filter(move |_| !texture);
        table.chain(own).map(|index| index + 1).max().unwrap_or(0)
    };
    let tables = [("buffers", most(false), Msl::MAX_BUFFERS), ("textures", most(true), Msl::MAX_TEXTURES)];
    for (what, needed, available) in tables {
        if needed > available {
            return Err(BackendError::Limit(LimitExceeded {
                what: format!(
                    "the number of {what} of shader `{name}`, including its push constants and sizes"
                ),
                needed: needed.into(),
                available: available.into(),
                unit: Unit::Count,
            }));
        }
    }
    Ok(StageArguments { stage, msl: msl.clone() })
}

/// Lowers a blend mode; `None` if the fragment replaces the target.
pub fn blend(blend: Blend) -> Option<BlendState> {
    use BlendFactor as F;
    match blend {
        Blend::Replace => None,
        Blend::PremultipliedOver => Some(BlendState {
            color: (F::One, F::OneMinusSourceAlpha),
            alpha: (F::One, F::OneMinusSourceAlpha),
        }),
        Blend::TransmittanceOver => Some(BlendState {
            color: (F::One, F::OneMinusSourceAlpha),
            alpha: (F::Zero, F::OneMinusSourceAlpha),
        }),
        Blend::TransmittanceUnder => Some(BlendState {
            color: (F::DestinationAlpha, F::One),
            alpha: (F::Zero, F::OneMinusSourceAlpha),
        }),
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

/// Returns the number of threadgroups that fill `words` words with 256 threads each, at most 65,535: with fewer
/// threads than words, the kernel loops.
pub fn fill_groups(words: u64) -> u32 {
    const MAX_GROUPS: u64 = 65535;
    words.div_ceil(256).min(MAX_GROUPS) as u32
}

/// Returns the number of threadgroups in x and y that clear an image of this size.
pub fn clear_groups((width, height): (u32, u32)) -> [u32; 2] {
    [width.div_ceil(CLEAR_THREADS[0]), height.div_ceil(CLEAR_THREADS[1])]
}

/// Returns true if an image is interpolated when it is shown: if the sizes differ and its format can be filtered.
pub fn interpolates(format: Format, same_size: bool, filters_floats: bool) -> bool {
    let filtered = match format {
        Format::Rgba8Unorm | Format::Rgba16Float => true,
        Format::Rgba32Float | Format::R32Float => filters_floats,
        Format::R32Uint | Format::Depth32Float => false,
    };
    filtered && !same_size
}

/// Maximum number of samples in a counter sample buffer: 32 KiB of 8 bytes each.
pub const MAX_SAMPLES: u32 = 4096;

/// Returns the index of the counter sample for a runtime timestamp; `None` if it has none.
///
/// The first two timestamps, of the whole frame, come from the command buffer instead. Timestamps beyond the sample
/// buffer's capacity have no sample.
pub fn sample(timestamp: u32) -> Option<u32> {
    timestamp.checked_sub(2).filter(|sample| *sample < MAX_SAMPLES)
}

/// Returns the value of a counter; `None` if it is 0, not sampled, or all ones, `MTLCounterErrorValue`.
pub fn counted(value: u64) -> Option<u64> {
    (value != 0 && value != u64::MAX).then_some(value)
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
    fn passes_of_one_shader_and_state_share_a_pipeline() {
        let lowered = lower(&translated()).unwrap();
        assert_eq!(lowered.pipelines.len(), 2);
        // In pass order: a fill, two dispatches, a draw, the export and the host pass.
        assert_eq!(lowered.of_pass, [None, Some(0), Some(0), Some(1), None, None]);
        assert_eq!(lowered.pipelines[0], PipelineState::Compute { shader: ShaderId(0), threads: [64, 1, 1] });
    }

    #[test]
    fn a_draws_state_holds_the_formats_and_blends_of_its_targets() {
        let lowered = lower(&translated()).unwrap();
        let factors = (BlendFactor::One, BlendFactor::OneMinusSourceAlpha);
        let over = BlendState { color: factors, alpha: factors };
        let state = PipelineState::Draw {
            vertex: ShaderId(1),
            fragment: ShaderId(2),
            topology: Topology::TriangleStrip,
            targets: vec![TargetState { format: Format::Rgba16Float, blend: Some(over) }],
            depth: None,
        };
        assert_eq!(lowered.pipelines[1], state);
        assert_eq!(blend(Blend::Replace), None);
    }

    #[test]
    fn a_binding_has_a_place_in_each_stage_that_reaches_it() {
        let plan = translated();
        let lowered = lower(&plan).unwrap();
        let places = |pass: u32, binding: usize| -> Vec<(Stage, u32, bool)> {
            let id = PassId(pass);
            let places = lowered.places(id, &plan.pass(id).bindings[binding]);
            places.map(|place| (place.stage, place.index, place.sized)).collect()
        };
        assert_eq!(places(1, 0), [(Stage::Compute, 0, true)]);
        // The draw binds the camera, then two elements of an array.
        assert_eq!(places(3, 0), [(Stage::Vertex, 0, false), (Stage::Fragment, 2, false)]);
        assert_eq!(places(3, 1), [(Stage::Fragment, 1, false)]);
        assert_eq!(places(3, 2), [(Stage::Fragment, 0, false)]);
    }

    #[test]
    fn a_shader_without_a_translation_is_named() {
        let mut plan = translated();
        plan.shaders[2].msl = None;
        let error = lower(&plan).unwrap_err().to_string();
        assert!(error.contains("found shader `splat.frag` without a translation"), "{error}");
    }

    #[test]
    fn more_arguments_than_a_table_holds_are_refused_with_both_numbers() {
        let mut plan = translated();
        plan.shaders[0].msl = msl(vec![argument(0, 0, false, 0)], Some(30), Some(31));
        let error = lower(&plan).unwrap_err().to_string();
        assert!(error.contains("buffers of shader `scan.comp`"), "{error}");
        assert!(error.ends_with("expected at most 31, found 32"), "{error}");
        plan.shaders[0].msl = msl(vec![argument(0, 0, true, 128)], None, None);
        assert!(lower(&plan).unwrap_err().to_string().contains("expected at most 128, found 129"));
        plan.shaders[0].msl = msl(vec![argument(0, 0, false, 0)], Some(29), Some(30));
        assert!(lower(&plan).is_ok());
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

    #[test]
    fn a_counter_that_reads_zero_or_an_error_is_unavailable() {
        assert_eq!([counted(0), counted(u64::MAX), counted(17)], [None, None, Some(17)]);
    }

    #[test]
    fn timestamps_of_passes_have_samples_while_there_is_room() {
        assert_eq!([sample(0), sample(1), sample(2), sample(3)], [None, None, Some(0), Some(1)]);
        assert_eq!([sample(4097), sample(4098)], [Some(4095), None]);
    }
}
