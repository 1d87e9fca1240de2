//! Shares results of prologues: buffers that one plan has computed once and other plans reuse.
//!
//! Most results of passes with `run: Once` do not change when a window is resized or a constant is set. A [`Recipe`] is
//! everything that such a result depends on: the passes that lead to it, in order, with their shader code, workgroup
//! counts, push constants and bindings, down to the planes of the scene. Results with equal recipes have equal bytes. A
//! new plan shares the buffers that its recipes find in the device's [`Results`], and skips passes whose results are
//! all reused.
//!
//! A buffer has a recipe if only the prologue writes it, if it has no history and no aliases, and if only dispatches
//! and fills compute it, from buffers of the plan and planes of the scene. Frames that read it come later in the queue,
//! behind a barrier. It is never written again.

use crate::attributes::{self, PlaneKey};
use crate::gpu::{Buffer, Gpu};
use crate::lock::lock;
use crate::states::position_or_push;
use crate::usage::{touched, usage};
use splatgraph_framework::{ir::*, plan::*};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, Weak};

/// Everything that a result's bytes depend on. Resources are numbered in order of first appearance.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Recipe {
    result: ResourceId,
    resources: Vec<Ingredient>,
    steps: Vec<RecipeStep>,
}

#[derive(Clone, Debug, PartialEq)]
enum Ingredient {
    Plane(PlaneKey),
    Buffer(Shape),
}

#[derive(Clone, Debug, PartialEq)]
struct RecipeStep {
    /// A dispatch of shader 0, whose code is `spirv`, or a fill.
    work: Work,
    spirv: Option<Arc<Vec<u32>>>,
    /// Binding, element, kind and resource.
    bindings: Vec<(u32, u32, DescriptorKind, ResourceId)>,
    push: Vec<u8>,
}

pub(crate) type Recipes = BTreeMap<ResourceId, Arc<Recipe>>;

pub(crate) fn recipes(plan: &Plan, identity: u64) -> Recipes {
    let prologue = Prologue::new(plan);
    let results = prologue.writers.keys().filter(|id| prologue.is_result(**id));
    results.filter_map(|&id| Some((id, Arc::new(prologue.recipe(id, identity)?)))).collect()
}

/// Returns the prologue's passes that need not run: everything that they write is `taken`, or used only by such passes.
/// Removes from `taken` the results that a remaining pass computes anyway.
pub(crate) fn skipped<T>(plan: &Plan, taken: &mut BTreeMap<ResourceId, T>) -> Vec<PassId> {
    let prologue = Prologue::new(plan);
    let once = plan.used_once();
    let all = &plan.prologue;
    let mut out: Vec<PassId> =
        all.iter().copied().filter(|pass| prologue.written(*pass).next().is_some()).collect();
    // Finds the largest set of passes that no other pass depends on.
    loop {
        let uses = |pass: &PassId, id| touched(plan.pass(*pass)).any(|(used, _)| used == id);
        let needless =
            |id| once.contains(&id) && all.iter().all(|pass| out.contains(pass) || !uses(pass, id));
        let stays = |pass: &PassId| prologue.written(*pass).all(|id| taken.contains_key(&id) || needless(id));
        let fewer: Vec<PassId> = out.iter().copied().filter(stays).collect();
        let counted = taken.len();
        taken.retain(|id, _| {
            prologue.writers.get(id).is_some_and(|passes| passes.iter().all(|pass| fewer.contains(pass)))
        });
        if fewer.len() == out.len() && taken.len() == counted {
            return out;
        }
        out = fewer;
    }
}

/// The prologue of a plan, indexed by the resources that its passes write.
struct Prologue<'a> {
    plan: &'a Plan,
    writers: BTreeMap<ResourceId, Vec<PassId>>,
    written_later: BTreeSet<ResourceId>,
}

impl<'a> Prologue<'a> {
    fn new(plan: &'a Plan) -> Prologue<'a> {
        let mut writers: BTreeMap<ResourceId, Vec<PassId>> = BTreeMap::new();
        for pass in &plan.prologue {
            for (id, _) in touched(plan.pass(*pass)).filter(|(_, writes)| *writes) {
                let passes = writers.entry(id).or_default();
                if passes.last() != Some(pass) {
                    passes.push(*pass);
                }
            }
        }
        let later = plan.frame.iter().flat_map(|pass| touched(plan.pass(*pass)));
        let written_later = later.filter(|(_, writes)| *writes).map(|(id, _)| id).collect();
        Prologue { plan, writers, written_later }
    }

    fn written(&self, pass: PassId) -> impl Iterator<Item = ResourceId> + '_ {
        touched(self.plan.pass(pass)).filter(|(_, writes)| *writes).map(|(id, _)| id)
    }

    fn is_result(&self, id: ResourceId) -> bool {
        let resource = self.plan.resource(id);
        resource.source == Source::Transient
            && resource.history.is_none()
            && matches!(resource.shape, Shape::Buffer { .. })
            && self.plan.aliases(id).next().is_none()
            && !self.written_later.contains(&id)
    }

    /// Returns the recipe of a result. `None` if it depends on anything besides the scene and the plan, on an image, or
    /// on a pass that is neither a dispatch nor a fill.
    fn recipe(&self, result: ResourceId, identity: u64) -> Option<Recipe> {
        let plan = self.plan;
        let mut passes = BTreeSet::new();
        let (mut wanted, mut seen) = (vec![result], BTreeSet::from([result]));
        while let Some(id) = wanted.pop() {
            if attributes::key(plan.resource(id), identity).is_some() {
                continue;
            }
            // A resource that no prologue pass writes comes from the host or has no contents: there is no recipe.
            for &pass in self.writers.get(&id)? {
                passes.insert(pass);
                wanted.extend(touched(plan.pass(pass)).map(|(id, _)| id).filter(|id| seen.insert(*id)));
            }
        }
        let mut numbers: Vec<ResourceId> = Vec::new();
        let mut number = |id| ResourceId(position_or_push(&mut numbers, id) as u32);
        let mut steps = Vec::new();
        for pass in plan.prologue.iter().copied().filter(|pass| passes.contains(pass)) {
            let pass = plan.pass(pass);
            let (mut work, mut spirv) = (pass.work.clone(), None);
            match &mut work {
                Work::Dispatch { shader, groups } => {
                    spirv = Some(plan.shader(*shader).spirv.clone());
                    *shader = ShaderId(0);
                    if let Groups::Indirect { buffer, .. } = groups {
                        *buffer = number(*buffer);
                    }
                }
                Work::Fill { buffer, .. } => *buffer = number(*buffer),
                _ => return None,
            }
            let bindings = pass.bindings.iter().map(|b| (b.binding, b.element, b.kind, number(b.resource)));
            steps.push(RecipeStep { work, spirv, bindings: bindings.collect(), push: pass.push.clone() });
        }
        let result = number(result);
        let ingredient = |id: &ResourceId| {
            let resource = plan.resource(*id);
            match (&resource.source, resource.shape, attributes::key(resource, identity)) {
                (_, _, Some(plane)) => Some(Ingredient::Plane(plane)),
                (Source::Transient, shape @ Shape::Buffer { .. }, _) if resource.history.is_none() => {
                    Some(Ingredient::Buffer(shape))
                }
                _ => None,
            }
        };
        let resources = numbers.iter().map(ingredient).collect::<Option<_>>()?;
        Some(Recipe { result, resources, steps })
    }
}

/// A recipe and its result. The buffer is owned by the plans that use it.
type Computed<G> = (Arc<Recipe>, Weak<Buffer<G>>);

pub(crate) struct Results<G: Gpu> {
    computed: Mutex<Vec<Computed<G>>>,
}

impl<G: Gpu> Default for Results<G> {
    fn default() -> Self {
        Results { computed: Mutex::default() }
    }
}

impl<G: Gpu> Results<G> {
    /// Finds the results for a plan's recipes, among buffers that allow every use that this plan makes of them.
    pub fn find(&self, plan: &Plan, recipes: &Recipes) -> BTreeMap<ResourceId, Arc<Buffer<G>>> {
        let computed = lock(&self.computed);
        let find = |(id, recipe): (&ResourceId, &Arc<Recipe>)| {
            let fit = |(known, buffer): &Computed<G>| {
                let buffer = buffer.upgrade().filter(|_| known == recipe)?;
                buffer.usage.contains(usage(plan.resource(*id))).then_some(buffer)
            };
            Some((*id, computed.iter().find_map(fit)?))
        };
        recipes.iter().filter_map(find).collect()
    }

    /// Adds the results of a plan whose prologue has been submitted, and forgets those that nothing holds any more.
    pub fn add<'a>(&self, results: impl Iterator<Item = (&'a Arc<Recipe>, &'a Arc<Buffer<G>>)>) {
        let mut computed = lock(&self.computed);
        computed.retain(|(_, buffer)| buffer.strong_count() > 0);
        for (recipe, buffer) in results {
            let known = computed.iter().any(|(_, known)| std::ptr::eq(known.as_ptr(), Arc::as_ptr(buffer)));
            if !known {
                computed.push((recipe.clone(), Arc::downgrade(buffer)));
            }
        }
    }
}
