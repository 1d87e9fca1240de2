//! Groups consecutive passes of one kind into encoders.

use super::encoding::{Division, EncoderKind};
use splatgraph_framework::{ir::*, plan::*};

pub(super) struct Group {
    pub kind: EncoderKind,
    pub passes: Vec<PassId>,
}

/// Groups passes into encoders according to `division`. The host pass belongs to none.
pub(super) fn divide(plan: &Plan, passes: &[PassId], division: Division) -> Vec<Group> {
    let mut groups: Vec<Group> = Vec::new();
    for id in passes {
        let Some(kind) = kind(&plan.pass(*id).work) else { continue };
        let joins = |group: &&mut Group| {
            division == Division::Merged
                && group.kind == kind
                && (kind != EncoderKind::Render || draws_with(plan, group, *id))
        };
        match groups.last_mut().filter(joins) {
            Some(group) => group.passes.push(*id),
            None => groups.push(Group { kind, passes: vec![*id] }),
        }
    }
    groups
}

fn kind(work: &Work) -> Option<EncoderKind> {
    match work {
        Work::Draw { .. } => Some(EncoderKind::Render),
        Work::Export => Some(EncoderKind::Blit),
        Work::Host => None,
        Work::Dispatch { .. } | Work::Fill { .. } | Work::ClearHistory { .. } => Some(EncoderKind::Compute),
    }
}

/// Returns true if a draw can join the group's encoder. It must have the same targets, keep their contents, and depend
/// on the group's draws only by blending and depth tests.
fn draws_with(plan: &Plan, group: &Group, pass: PassId) -> bool {
    let targets = |pass: PassId| match &plan.pass(pass).work {
        Work::Draw { targets, depth, .. } => (targets.as_slice(), *depth),
        _ => (&[][..], None),
    };
    let ((own, tested), (others, other_depth)) = (targets(pass), targets(group.passes[0]));
    let images = |targets: &[Target]| targets.iter().map(|target| target.image).collect::<Vec<_>>();
    let blends = |dependency: &Dependency| {
        let both = dependency.masks.source_stages | dependency.masks.target_stages;
        let attached = Stages::COLOR_OUTPUT | Stages::DEPTH_TESTS;
        attached.contains(both) && dependency.alias.is_none()
    };
    let inner = |dependency: &&Dependency| {
        dependency.since == Since::Same && group.passes.contains(&dependency.first)
    };
    let keeps = tested.is_none_or(|depth| depth.access != DepthAccess::Write);
    images(own) == images(others)
        && tested.map(|depth| depth.image) == other_depth.map(|depth| depth.image)
        && keeps
        && own.iter().all(|target| target.load == Load::Keep)
        && ordering(plan, pass).filter(inner).all(blends)
}

/// Lists a pass's dependencies that encoders must enforce.
///
/// Layout changes are left out. So are dependencies of the host pass, which waits for the whole command buffer.
pub(super) fn ordering(plan: &Plan, pass: PassId) -> impl Iterator<Item = &Dependency> {
    let of_device = |dependency: &&Dependency| plan.pass(dependency.second).work != Work::Host;
    let dependencies = plan.dependencies_of(pass).iter();
    dependencies.filter(|dependency| dependency.hazard != Hazard::LayoutChange).filter(of_device)
}
