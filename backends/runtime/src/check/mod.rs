//! Checks a plan for consistency, and against the limits of a device.
//!
//! The checks run before anything is created. All later code may index into the plan without checks.

mod host_buffers;

use crate::attributes;
use crate::limits::Limits;
use splatgraph_api::{BackendError, LimitExceeded, Unit, display_bytes};
use splatgraph_framework::ir::ShaderStage;
use splatgraph_framework::{ir::*, plan::*};
use std::collections::HashSet;

/// Maximum number of invocations or vertices of a pass. A larger number is treated as a mistake: no device finishes so
/// many in a reasonable time.
const MAX_INVOCATIONS: u64 = 1 << 40;

/// Refuses a plan that is inconsistent ([`BackendError::Invalid`]), exceeds a limit ([`BackendError::Limit`]) or needs
/// something that the device lacks ([`BackendError::Unsupported`]). A shader feature that the device lacks is an
/// inconsistency, because the linker has checked the features.
///
/// In an accepted plan, the ids of resources, passes, shaders and blocks are in range, and resources suit the work that
/// names them. The declared usage of bound resources is not checked.
pub(crate) fn check(plan: &Plan, limits: &Limits) -> Result<(), BackendError> {
    let checker = Checker { plan, limits };
    let mut histories = HashSet::new();
    for resource in &plan.resources {
        checker.resource(resource).map_err(|error| error.at(&resource.origin))?;
        if let Some(history) = &resource.history
            && !histories.insert(history)
        {
            return invalid(format!(
                "`{}` is not the only resource with the history `{history}`",
                resource.name
            ));
        }
    }
    checker.blocks()?;
    let mut seen = HashSet::new();
    for id in plan.order() {
        let pass = checker.passes(id)?;
        if !seen.insert(id) {
            return invalid(format!("pass `{}` runs twice", pass.name));
        }
        checker.pass(pass).map_err(|error| error.at(&pass.origin))?;
    }
    checker.memory()?;
    checker.dependencies()?;
    checker.layout_changes()?;
    checker.order()?;
    checker.output()
}

/// Finds an image or a pass that is too large for a device with these facts, if there is one. Returns the error and
/// the declaration.
///
/// The linker checks the other facts. The remaining limits are known only once a device is open.
pub fn too_large<'a>(plan: &'a Plan, device: &DeviceFacts) -> Option<(BackendError, &'a Origin)> {
    let image = |r: &'a Resource| Some((image_size(r, device.max_image_size).err()?, &r.origin));
    let work = |pass: &'a Pass| Some((work_size(plan, pass).err()?, &pass.origin));
    let mut passes = plan.order().map(|id| plan.pass(id));
    plan.resources.iter().find_map(image).or_else(|| passes.find_map(work))
}

fn image_size(resource: &Resource, most: u32) -> Result<(), BackendError> {
    let Shape::Image { width, height, .. } = resource.shape else { return Ok(()) };
    let what = || format!("the longer side of image `{}` ({width} x {height} pixels)", resource.name);
    within_count(what, width.max(height), most)
}

/// Refuses a dispatch with more than [`MAX_INVOCATIONS`], or a draw with more vertices than that. Accepts indirect
/// commands and other passes.
fn work_size(plan: &Plan, pass: &Pass) -> Result<(), BackendError> {
    let product = |numbers: &[u32]| numbers.iter().fold(1u64, |all, &n| all.saturating_mul(n.into()));
    let (count, what) = match pass.work {
        Work::Dispatch { shader, groups: Groups::Direct(groups) } => {
            let local =
                plan.shaders.get(shader.index()).map_or([1; 3], |shader| shader.reflection.local_size);
            (product(&groups).saturating_mul(product(&local)), "invocations")
        }
        Work::Draw { call: DrawCall::Direct { vertices, instances }, .. } => {
            (product(&[vertices, instances]), "vertices")
        }
        _ => return Ok(()),
    };
    if count <= MAX_INVOCATIONS {
        return Ok(());
    }
    Err(BackendError::Unsupported(format!(
        "pass `{}` has more {what} than any device finishes in a reasonable time: expected at most {MAX_INVOCATIONS}, found \
         {count}",
        pass.name
    )))
}

pub(crate) fn invalid<T>(text: String) -> Result<T, BackendError> {
    Err(BackendError::Invalid(text))
}

pub(crate) fn within_bytes(
    what: impl FnOnce() -> String,
    needed: u64,
    available: u64,
) -> Result<(), BackendError> {
    within(what, needed, available, Unit::Bytes)
}

fn within_count(
    what: impl FnOnce() -> String,
    needed: impl Into<u64>,
    available: impl Into<u64>,
) -> Result<(), BackendError> {
    within(what, needed.into(), available.into(), Unit::Count)
}

fn within_axes(what: impl Fn() -> String, needed: [u32; 3], available: [u32; 3]) -> Result<(), BackendError> {
    ["x", "y", "z"].iter().zip(needed.iter().zip(available)).try_for_each(|(axis, (needed, available))| {
        within_count(|| format!("{} in {axis}", what()), *needed, available)
    })
}

fn within(
    what: impl FnOnce() -> String,
    needed: u64,
    available: u64,
    unit: Unit,
) -> Result<(), BackendError> {
    if needed <= available {
        return Ok(());
    }
    Err(BackendError::Limit(LimitExceeded { what: what(), needed, available, unit, origin: None }))
}

fn is_image(resource: &Resource) -> bool {
    matches!(resource.shape, Shape::Image { .. })
}

struct Checker<'a> {
    plan: &'a Plan,
    limits: &'a Limits,
}

impl<'a> Checker<'a> {
    fn resources(&self, id: ResourceId, user: &str) -> Result<&'a Resource, BackendError> {
        match self.plan.resources.get(id.index()) {
            Some(resource) => Ok(resource),
            None => invalid(format!("`{user}` names resource {}, which is not in the plan", id.0)),
        }
    }

    fn passes(&self, id: PassId) -> Result<&'a Pass, BackendError> {
        match self.plan.passes.get(id.index()) {
            Some(pass) => Ok(pass),
            None => invalid(format!("a step names pass {}, which is not in the plan", id.0)),
        }
    }

    /// Returns the resource `id`; refuses it if its declared usage lacks `usage`. `user` names the user in the error.
    fn resource_for(&self, id: ResourceId, usage: Usage, user: &str) -> Result<&'a Resource, BackendError> {
        let resource = self.resources(id, user)?;
        if !resource.usage.contains(usage) {
            return invalid(format!(
                "`{user}` uses `{}` as {usage:?}, for which it was not created",
                resource.name
            ));
        }
        Ok(resource)
    }

    /// Returns the buffer `id`; refuses an image, and a byte range that exceeds the buffer or starts within a word.
    fn words(
        &self,
        id: ResourceId,
        offset: u64,
        bytes: u64,
        user: &str,
    ) -> Result<&'a Resource, BackendError> {
        let resource = self.resources(id, user)?;
        let inside = offset.checked_add(bytes).is_some_and(|end| end <= resource.bytes());
        if is_image(resource) || !inside || !offset.is_multiple_of(4) {
            return invalid(format!(
                "`{user}` uses {bytes} bytes at byte {offset} of `{}`, which has {} bytes in words of 4",
                resource.name,
                resource.bytes()
            ));
        }
        Ok(resource)
    }

    fn resource(&self, resource: &Resource) -> Result<(), BackendError> {
        let name = &resource.name;
        match resource.shape {
            Shape::Buffer { stride, count } => {
                let Some(bytes) = stride.checked_mul(count).filter(|&bytes| bytes > 0) else {
                    return invalid(format!("buffer `{name}` has {count} elements of {stride} bytes"));
                };
                within_bytes(|| format!("the size of buffer `{name}`"), bytes, self.limits.max_buffer_bytes)
            }
            Shape::Image { width, height, .. } => {
                if resource.source != Source::Transient || width == 0 || height == 0 {
                    return invalid(format!(
                        "image `{name}` is {width} x {height} from {:?}",
                        resource.source
                    ));
                }
                image_size(resource, self.limits.facts.max_image_size)
            }
        }
    }

    /// Checks that each transient is listed once, in the block it names, and that blocks list nothing else.
    fn blocks(&self) -> Result<(), BackendError> {
        let mut seen = HashSet::new();
        for (index, block) in self.plan.blocks.iter().enumerate() {
            for &id in &block.aliases {
                let resource = self.resources(id, &format!("block {index}"))?;
                if resource.block != Some(BlockId(index as u32)) || !seen.insert(id) {
                    return invalid(format!(
                        "block {index} has an alias `{}` that does not belong to it",
                        resource.name
                    ));
                }
            }
        }
        for (index, resource) in self.plan.resources.iter().enumerate() {
            let transient = resource.source == Source::Transient;
            let housed = seen.contains(&ResourceId(index as u32));
            if transient != resource.block.is_some() || transient != housed {
                let text = if transient { "is in no block" } else { "is not the plan's own" };
                return invalid(format!("`{}` {text}, and names {:?}", resource.name, resource.block));
            }
        }
        Ok(())
    }

    /// Checks that the resources that must be in device memory fit the largest heap. A plane of the scene counts once,
    /// and not at all if only the prologue uses it: it can be placed in host memory (see [`crate::once`]).
    fn memory(&self) -> Result<(), BackendError> {
        let (used_once, mut planes) = (self.plan.used_once(), HashSet::new());
        let mut counts = |(id, resource): &(ResourceId, &Resource)| match attributes::key(resource, 0) {
            Some(plane) => !used_once.contains(id) && planes.insert(plane),
            None => true,
        };
        let all = (0..).map(ResourceId).zip(&self.plan.resources);
        let counted: Vec<_> = all.filter(|item| counts(item)).map(|(_, resource)| resource).collect();
        let others = counted.iter().filter(|r| r.source != Source::Transient);
        let total = others.fold(self.plan.transient_bytes(), |sum, r| sum.saturating_add(r.bytes()));
        let what = || {
            let largest = counted.iter().max_by_key(|r| r.bytes());
            let largest = largest.map(|r| {
                let smaller = if is_image(r) { "; a smaller picture needs less" } else { "" };
                format!(" (the largest is `{}` with {}{smaller})", r.name, display_bytes(r.bytes()))
            });
            format!("the size of the resources that must be on the device{}", largest.unwrap_or_default())
        };
        within_bytes(what, total, self.limits.heap_bytes)
    }

    fn dependencies(&self) -> Result<(), BackendError> {
        for Dependency { first, second, resource, alias, .. } in &self.plan.dependencies {
            let user = &self.passes(*second)?.name;
            self.passes(*first)?;
            self.resources(*resource, user)?;
            alias.map(|alias| self.resources(alias, user)).transpose()?;
        }
        if !self.plan.dependencies.is_sorted_by_key(|dependency| dependency.second) {
            return invalid("the plan's dependencies are not sorted by their later pass".to_string());
        }
        Ok(())
    }

    fn layout_changes(&self) -> Result<(), BackendError> {
        for LayoutChange { image, new, before, .. } in &self.plan.layout_changes {
            let before = &self.passes(*before)?.name;
            let resource = self.resources(*image, before)?;
            if !is_image(resource) || *new == Layout::Undefined {
                return invalid(format!(
                    "a change before `{before}` brings `{}` into the layout {new:?}, which it cannot have",
                    resource.name
                ));
            }
        }
        Ok(())
    }

    fn pass(&self, pass: &Pass) -> Result<(), BackendError> {
        let name = &pass.name;
        let what = || format!("the size of the push constants of pass `{name}`");
        within_bytes(what, pass.push.len() as u64, self.limits.facts.max_push_bytes.into())?;
        if !pass.push.len().is_multiple_of(4) {
            return invalid(format!(
                "pass `{name}` has {} bytes of push constants, not whole words",
                pass.push.len()
            ));
        }
        self.bindings(pass)?;
        for touch in &pass.uses {
            self.resources(touch.resource, name)?;
        }
        self.host_buffers(pass)?;
        work_size(self.plan, pass)?;
        match &pass.work {
            Work::Dispatch { shader, groups } => self.dispatch(pass, *shader, *groups),
            Work::Draw { vertex, fragment, call, targets, depth, .. } => {
                self.shader(*vertex, ShaderStage::Vertex, name)?;
                self.shader(*fragment, ShaderStage::Fragment, name)?;
                if let DrawCall::Indirect { buffer, offset } = *call {
                    self.indirect(buffer, offset, 16, name)?;
                }
                self.targets(targets, *depth, name)
            }
            Work::Fill { buffer, .. } => self.filled(*buffer, name),
            Work::ClearHistory { resource } => {
                let image = is_image(self.resource_for(*resource, Usage::COPY_TARGET, name)?);
                if image { Ok(()) } else { self.filled(*resource, name) }
            }
            Work::Export | Work::Host => Ok(()),
        }
    }

    fn filled(&self, buffer: ResourceId, user: &str) -> Result<(), BackendError> {
        let bytes = self.resource_for(buffer, Usage::COPY_TARGET, user)?.bytes();
        let resource = self.words(buffer, 0, bytes, user)?;
        if !bytes.is_multiple_of(4) {
            return invalid(format!("pass `{user}` fills `{}`, which is not whole words", resource.name));
        }
        Ok(())
    }

    fn bindings(&self, pass: &Pass) -> Result<(), BackendError> {
        for binding in &pass.bindings {
            let resource = self.resources(binding.resource, &pass.name)?;
            if is_image(resource) != (binding.kind == DescriptorKind::StorageImage) {
                return invalid(format!(
                    "pass `{}` binds `{}` to `{}`, which is not a {:?}",
                    pass.name, resource.name, binding.name, binding.kind
                ));
            }
            let (kind, most) = match binding.kind {
                DescriptorKind::StorageBuffer => ("storage buffer", self.limits.facts.max_storage_bytes),
                DescriptorKind::UniformBuffer => ("uniform block", self.limits.max_uniform_bytes),
                DescriptorKind::StorageImage => continue,
            };
            let what =
                || format!("the size of `{}`, bound as a {kind} by pass `{}`", resource.name, pass.name);
            within_bytes(what, resource.bytes(), most)?;
        }
        for (kind, most, kinds) in [
            (DescriptorKind::StorageBuffer, self.limits.max_storage_buffers, "storage buffers"),
            (DescriptorKind::UniformBuffer, self.limits.max_uniform_buffers, "uniform blocks"),
            (DescriptorKind::StorageImage, self.limits.max_storage_images, "storage images"),
        ] {
            let count = pass.bindings.iter().filter(|binding| binding.kind == kind).count() as u64;
            within_count(|| format!("the number of {kinds} bound by pass `{}`", pass.name), count, most)?;
        }
        Ok(())
    }

    fn shader(&self, id: ShaderId, stage: ShaderStage, user: &str) -> Result<&'a Shader, BackendError> {
        match self.plan.shaders.get(id.index()) {
            Some(shader) if shader.spirv.is_empty() => invalid(format!(
                "shader `{}` has no code (plans that were written to a file keep none)",
                shader.name
            )),
            Some(shader) if shader.reflection.stage == stage => {
                let missing = shader.reflection.features.difference(self.limits.facts.features);
                if !missing.is_empty() {
                    let name = &shader.name;
                    return invalid(format!(
                        "shader `{name}` needs {missing}, which the device does not have"
                    ));
                }
                Ok(shader)
            }
            _ => invalid(format!("pass `{user}` names shader {}, which is not a {stage:?} shader", id.0)),
        }
    }

    fn dispatch(&self, pass: &Pass, shader: ShaderId, groups: Groups) -> Result<(), BackendError> {
        let shader = self.shader(shader, ShaderStage::Compute, &pass.name)?;
        let (local, name) = (shader.reflection.local_size, &shader.name);
        let what = || format!("the workgroup size {local:?} of shader `{name}`");
        within_axes(what, local, self.limits.max_local_size)?;
        let invocations = local.iter().fold(1u64, |product, &n| product.saturating_mul(n.into()));
        let what = || format!("the number of invocations in a workgroup {local:?} of shader `{name}`");
        within_count(what, invocations, self.limits.facts.max_invocations)?;
        let what = || format!("the shared memory of shader `{name}`");
        within_bytes(what, shader.reflection.shared_bytes.into(), self.limits.facts.shared_bytes.into())?;
        self.subgroups(shader)?;
        match groups {
            Groups::Direct(groups) => {
                let what = || format!("the number of workgroups {groups:?} of pass `{}`", pass.name);
                within_axes(what, groups, self.limits.facts.max_groups)
            }
            Groups::Indirect { buffer, offset } => self.indirect(buffer, offset, 12, &pass.name),
        }
    }

    /// Refuses a shader with subgroup operations if its subgroup size can differ from the size that the graph assumes.
    /// Either the plan was built for another size, or the driver may choose one. Such a shader can write out of bounds.
    fn subgroups(&self, shader: &Shader) -> Result<(), BackendError> {
        let (limits, local) = (&self.limits.subgroup, shader.reflection.local_size);
        if !shader.reflection.has_subgroups() {
            return Ok(());
        }
        let lanes = self.limits.facts.subgroup_size;
        if let Some(Value::Int(planned)) = self.plan.facts.get("device.subgroup_size")
            && *planned != i64::from(lanes)
        {
            return Err(BackendError::Unsupported(format!(
                "shader `{}` uses subgroup operations: expected a plan for the device's subgroups of {lanes} lanes, found one \
                 for {planned}",
                shader.name
            )));
        }
        if self.limits.has_certain_size(local) {
            return Ok(());
        }
        let remedy = if limits.selectable {
            format!(
                "a fixed size needs workgroups whose size in x is a multiple of {lanes}, with at most {} invocations; this \
                 one has {local:?}",
                u64::from(lanes) * u64::from(limits.max_per_group)
            )
        } else {
            "this device does not let pipelines request a size".to_string()
        };
        Err(BackendError::Unsupported(format!(
            "shader `{}` uses subgroup operations and was compiled for subgroups of {lanes} lanes, but the driver may run it \
             with {} to {}: {remedy}",
            shader.name, limits.min_size, limits.max_size
        )))
    }

    fn indirect(&self, buffer: ResourceId, offset: u64, bytes: u64, user: &str) -> Result<(), BackendError> {
        self.words(buffer, offset, bytes, user)?;
        self.resource_for(buffer, Usage::INDIRECT, user).map(|_| ())
    }

    fn targets(
        &self,
        targets: &[Target],
        depth: Option<DepthTarget>,
        user: &str,
    ) -> Result<(), BackendError> {
        if targets.is_empty() {
            return invalid(format!("pass `{user}` draws into no target"));
        }
        let what = || format!("the number of targets of pass `{user}`");
        within_count(what, targets.len() as u64, self.limits.facts.max_targets)?;
        let mut sizes = Vec::new();
        for target in targets {
            let resource = self.resource_for(target.image, Usage::COLOR_TARGET, user)?;
            let Shape::Image { width, height, .. } = resource.shape else {
                return invalid(format!(
                    "pass `{user}` draws into `{}`, which is not an image",
                    resource.name
                ));
            };
            sizes.push((width, height));
        }
        if let Some(DepthTarget { image, .. }) = depth {
            let resource = self.resource_for(image, Usage::DEPTH_TARGET, user)?;
            let Shape::Image { width, height, format: Format::Depth32Float } = resource.shape else {
                return invalid(format!(
                    "pass `{user}` tests against `{}`, which has no depths",
                    resource.name
                ));
            };
            sizes.push((width, height));
        }
        if sizes.iter().any(|&size| size != sizes[0]) {
            return invalid(format!("pass `{user}` draws into targets of different sizes: {sizes:?}"));
        }
        if !self.limits.independent_blend && targets.iter().any(|t| t.blend != targets[0].blend) {
            return Err(BackendError::Unsupported(format!(
                "pass `{user}` blends its targets differently, which this device does not support"
            )));
        }
        Ok(())
    }

    fn output(&self) -> Result<(), BackendError> {
        if !is_image(self.resources(self.plan.output, "output")?) {
            return invalid("the plan's output is not an image".to_string());
        }
        for stat in &self.plan.stats {
            self.words(stat.buffer, stat.offset, 4, &stat.name)?;
        }
        let readbacks = self.plan.resources.iter().filter(|r| r.source == Source::Readback);
        let bytes: Vec<u64> = readbacks.map(Resource::bytes).collect();
        let room = bytes.first().copied().unwrap_or(0);
        if bytes.len() > 1 || room < 4 * self.plan.stats.len() as u64 {
            return invalid(format!(
                "the plan has {} statistics, and {} resources of {room} bytes to read them back from",
                self.plan.stats.len(),
                bytes.len()
            ));
        }
        Ok(())
    }

    /// Checks the order of passes: histories are cleared only in the prologue, and the frame ends with its only export.
    /// If the plan has statistics, the host's pass follows the export.
    fn order(&self) -> Result<(), BackendError> {
        let work = |pass: &PassId| &self.plan.pass(*pass).work;
        if self.plan.frame.iter().any(|pass| matches!(work(pass), Work::ClearHistory { .. })) {
            return invalid("a frame zeroes a resource's history".to_string());
        }
        let (host, statistics) = (&Work::Host, !self.plan.stats.is_empty());
        let frame: Vec<&Work> = self.plan.frame.iter().map(work).collect();
        let rest = if statistics { frame.strip_suffix(&[host]) } else { Some(frame.as_slice()) };
        let rest = rest.and_then(|rest| rest.strip_suffix(&[&Work::Export]));
        let once = self.plan.prologue.iter().map(work).chain(rest.unwrap_or_default().iter().copied());
        if rest.is_none() || once.into_iter().any(|work| matches!(work, Work::Export | Work::Host)) {
            return invalid(
                "a plan's frame ends with the export of its output, and then the host's pass if it has statistics, and \
                 has both once"
                    .to_string(),
            );
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
