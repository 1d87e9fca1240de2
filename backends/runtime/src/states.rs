//! Finds the pipelines that a plan needs.

use crate::gpu::NextPipeline;
use splatgraph_framework::{ir::*, plan::*};

/// The shaders and the fixed-function state of a pipeline.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PipelineState {
    /// A compute pipeline with this shader.
    Compute(ShaderId),
    /// A graphics pipeline.
    Draw {
        /// The vertex shader.
        vertex: ShaderId,
        /// The fragment shader.
        fragment: ShaderId,
        /// The kind of primitives.
        topology: Topology,
        /// The format and blending of each colour target.
        targets: Vec<(Format, Blend)>,
        /// The use of the depth target; `None` without one.
        depth: Option<DepthAccess>,
    },
}

impl PipelineState {
    /// Lists the shaders in the order of their stages.
    pub fn shaders(&self) -> Vec<ShaderId> {
        match *self {
            PipelineState::Compute(shader) => vec![shader],
            PipelineState::Draw { vertex, fragment, .. } => vec![vertex, fragment],
        }
    }

    /// Returns the state of a pass's pipeline; `None` if it has none.
    fn of(plan: &Plan, pass: &Pass) -> Option<PipelineState> {
        match &pass.work {
            Work::Dispatch { shader, .. } => Some(PipelineState::Compute(*shader)),
            Work::Draw { vertex, fragment, topology, targets, depth, .. } => {
                let targets = targets.iter().filter_map(|target| match plan.resource(target.image).shape {
                    Shape::Image { format, .. } => Some((format, target.blend)),
                    Shape::Buffer { .. } => None,
                });
                Some(PipelineState::Draw {
                    vertex: *vertex,
                    fragment: *fragment,
                    topology: *topology,
                    targets: targets.collect(),
                    depth: depth.map(|depth| depth.access),
                })
            }
            _ => None,
        }
    }
}

/// The pipelines of a plan, without duplicates: passes with equal states share one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PipelineStates<E> {
    /// The states, each with the API-specific data that its pipeline also depends on.
    pub states: Vec<(PipelineState, E)>,
    /// Index into [`PipelineStates::states`], by pass; `None` if the pass has no pipeline or is not in [`Plan::order`].
    pub of_pass: Vec<Option<usize>>,
}

impl<E: PartialEq> PipelineStates<E> {
    /// Lists the pipelines of a checked plan. `extra` returns the API-specific data that a pass's pipeline depends on.
    pub fn new(plan: &Plan, mut extra: impl FnMut(&Pass) -> E) -> PipelineStates<E> {
        let (mut states, mut of_pass) = (Vec::new(), vec![None; plan.passes.len()]);
        for id in plan.order() {
            let pass = plan.pass(id);
            let Some(state) = PipelineState::of(plan, pass) else { continue };
            of_pass[id.index()] = Some(position_or_push(&mut states, (state, extra(pass))));
        }
        PipelineStates { states, of_pass }
    }

    /// Describes pipeline number `done`, which is about to be created.
    ///
    /// # Panics
    /// Panics if there is no such pipeline.
    pub fn next(&self, done: usize) -> NextPipeline {
        let pass = self.of_pass.iter().position(|pipeline| *pipeline == Some(done));
        let pass = PassId(pass.expect("each pipeline is that of a pass") as u32);
        NextPipeline { done, of: self.states.len(), shader: self.states[done].0.shaders()[0], pass }
    }
}

/// Returns the index of `item` in `list`; appends it if it is absent.
pub fn position_or_push<T: PartialEq>(list: &mut Vec<T>, item: T) -> usize {
    list.iter().position(|other| *other == item).unwrap_or_else(|| {
        list.push(item);
        list.len() - 1
    })
}

/// A factor of the blend equation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BlendFactor {
    /// Factor 0.
    Zero,
    /// Factor 1.
    One,
    /// Factor 1 - the fragment's alpha.
    OneMinusSourceAlpha,
    /// Factor equal to the target's alpha.
    TargetAlpha,
}

/// The blend equation: `colour = source * source factor + target * target factor`, likewise for alpha.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BlendFactors {
    /// Factors of the colour, for source and target.
    pub color: (BlendFactor, BlendFactor),
    /// Factors of alpha, for source and target.
    pub alpha: (BlendFactor, BlendFactor),
}

impl BlendFactors {
    /// Returns the factors of a blend mode; `None` if the fragment replaces the target.
    pub fn of(blend: Blend) -> Option<BlendFactors> {
        use BlendFactor as F;
        let (color, alpha) = match blend {
            Blend::Replace => return None,
            Blend::Add => ((F::One, F::One), (F::One, F::One)),
            Blend::PremultipliedOver => ((F::One, F::OneMinusSourceAlpha), (F::One, F::OneMinusSourceAlpha)),
            Blend::TransmittanceOver => ((F::One, F::OneMinusSourceAlpha), (F::Zero, F::OneMinusSourceAlpha)),
            Blend::TransmittanceUnder => ((F::TargetAlpha, F::One), (F::Zero, F::OneMinusSourceAlpha)),
        };
        Some(BlendFactors { color, alpha })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::*;

    #[test]
    fn passes_of_one_shader_and_state_share_a_pipeline() {
        let pipelines = PipelineStates::new(&plan(), |_| ());
        // In pass order: a fill, two dispatches, a draw, the export and the host pass.
        assert_eq!(pipelines.of_pass, [None, Some(0), Some(0), Some(1), None, None]);
        assert_eq!(pipelines.states[0].0, PipelineState::Compute(ShaderId(0)));
        let next = NextPipeline { done: 1, of: 2, shader: ShaderId(1), pass: PassId(3) };
        assert_eq!(pipelines.next(1), next);
    }

    #[test]
    fn a_pass_that_differs_in_what_the_api_adds_has_a_pipeline_of_its_own() {
        let pipelines = PipelineStates::new(&plan(), |pass| pass.name.clone());
        assert_eq!(pipelines.of_pass, [None, Some(0), Some(1), Some(2), None, None]);
    }

    #[test]
    fn a_draws_state_holds_the_formats_and_blends_of_its_targets() {
        let state = PipelineState::Draw {
            vertex: ShaderId(1),
            fragment: ShaderId(2),
            topology: Topology::TriangleStrip,
            targets: vec![(Format::Rgba16Float, Blend::PremultipliedOver)],
            depth: None,
        };
        assert_eq!(PipelineStates::new(&plan(), |_| ()).states[1].0, state);
    }

    #[test]
    fn every_blend_mode_is_the_equation_that_it_documents() {
        use BlendFactor::{One, OneMinusSourceAlpha, TargetAlpha, Zero};
        let factors = |color, alpha| Some(BlendFactors { color, alpha });
        let over = (One, OneMinusSourceAlpha);
        assert_eq!(BlendFactors::of(Blend::Replace), None);
        assert_eq!(BlendFactors::of(Blend::Add), factors((One, One), (One, One)));
        assert_eq!(BlendFactors::of(Blend::PremultipliedOver), factors(over, over));
        let fades = (Zero, OneMinusSourceAlpha);
        assert_eq!(BlendFactors::of(Blend::TransmittanceOver), factors(over, fades));
        assert_eq!(BlendFactors::of(Blend::TransmittanceUnder), factors((TargetAlpha, One), fades));
    }
}
