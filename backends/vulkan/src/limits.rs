//! What a device allows, and a plan held against it.
//!
//! [`check`] is a pure function. It runs before anything is created, so that a plan that is too large is refused with
//! a sentence that names the resource and both numbers, and so that everything after it may index into the plan
//! freely: a plan that was read from a file can say anything.

use crate::error::mib;
use splatgraph_api::BackendError;
use splatgraph_framework::plan::*;
use splatgraph_framework::shader::ShaderStage;
use std::collections::HashSet;

/// The limits of a physical device that plans can run into.
#[derive(Clone, Debug, Default)]
pub(crate) struct Limits {
    pub max_storage_bytes: u64,
    pub max_uniform_bytes: u64,
    pub max_buffer_bytes: u64,
    pub max_push_bytes: u32,
    pub max_groups: [u32; 3],
    pub max_local_size: [u32; 3],
    pub max_invocations: u32,
    pub shared_bytes: u32,
    /// Pixels in x and in y.
    pub max_image_size: u32,
    pub max_targets: u32,
    /// Descriptors that one shader may see.
    pub max_storage_buffers: u32,
    pub max_uniform_buffers: u32,
    pub max_storage_images: u32,
    /// Size of the largest device-local heap.
    pub heap_bytes: u64,
    /// Targets of one draw may blend differently.
    pub independent_blend: bool,
    pub subgroup: SubgroupLimits,
    /// Blending rounds what it writes to half-float images.
    pub rounds_half: bool,
    /// Bits that count in a timestamp; 0 where the queue has none.
    pub timestamp_bits: u32,
    /// Nanoseconds per tick.
    pub timestamp_period: f32,
}

#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SubgroupLimits {
    /// Lanes that compute shaders run with.
    pub size: u32,
    /// The largest that the driver may choose where a pipeline does not ask.
    pub max_size: u32,
    /// A compute pipeline may ask for a size.
    pub selectable: bool,
    /// Subgroups of a workgroup, where a size is asked for.
    pub max_per_group: u32,
}

/// Refuses a plan that contradicts itself ([`BackendError::Invalid`]) or asks for too much ([`BackendError::Limit`]).
/// What it accepts is whole: every id is within range and fits its use.
pub(crate) fn check(plan: &Plan, limits: &Limits) -> Result<(), BackendError> {
    if plan.version != PLAN_VERSION {
        return invalid(format!(
            "the plan is of version {}, and this program executes {PLAN_VERSION}",
            plan.version
        ));
    }
    let checker = Checker { plan, limits };
    for resource in &plan.resources {
        checker.resource(resource)?;
    }
    checker.memory()?;
    let mut seen = HashSet::new();
    for step in plan.prologue.iter().chain(&plan.frame) {
        let pass = checker.passes(step.pass)?;
        if !seen.insert(step.pass) {
            return invalid(format!("pass `{}` is in two steps", pass.name));
        }
        for barrier in &step.barriers {
            let image = checker.resources(barrier.resource, &pass.name)?.is_image();
            if image != barrier.layouts.is_some() || matches!(barrier.layouts, Some((_, Layout::Undefined))) {
                return invalid(format!("a barrier before pass `{}` has layouts that do not fit", pass.name));
            }
        }
        checker.pass(pass)?;
    }
    checker.output()
}

/// A plan that contradicts itself.
pub(crate) fn invalid<T>(text: String) -> Result<T, BackendError> {
    Err(BackendError::Invalid(text))
}

fn over<T>(text: String) -> Result<T, BackendError> {
    Err(BackendError::Limit(text))
}

/// What the checks and the recording ask of a resource.
pub(crate) trait ResourceExt {
    fn is_image(&self) -> bool;
    /// One copy exists per frame in flight.
    fn is_per_frame(&self) -> bool;
}

impl ResourceExt for Resource {
    fn is_image(&self) -> bool {
        matches!(self.shape, Shape::Image { .. })
    }

    fn is_per_frame(&self) -> bool {
        matches!(self.source, Source::Frame { .. } | Source::Live)
    }
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

    /// A resource that `user` uses as `usage`.
    fn used(&self, id: ResourceId, usage: Usage, user: &str) -> Result<&'a Resource, BackendError> {
        let resource = self.resources(id, user)?;
        if !resource.usage.contains(usage) {
            return invalid(format!(
                "`{user}` uses `{}` as {usage:?}, for which it is not made",
                resource.name
            ));
        }
        Ok(resource)
    }

    /// `bytes` bytes at `offset` of a buffer, word by word.
    fn words(
        &self,
        id: ResourceId,
        offset: u64,
        bytes: u64,
        user: &str,
    ) -> Result<&'a Resource, BackendError> {
        let resource = self.resources(id, user)?;
        let inside = offset.checked_add(bytes).is_some_and(|end| end <= resource.bytes());
        if resource.is_image() || !inside || !offset.is_multiple_of(4) {
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
                if bytes > self.limits.max_buffer_bytes {
                    return over(format!(
                        "buffer `{name}` is {}, and a buffer of this device may have {} at most",
                        mib(bytes),
                        mib(self.limits.max_buffer_bytes)
                    ));
                }
            }
            Shape::Image { width, height, .. } => {
                let most = self.limits.max_image_size;
                if resource.source != Source::Transient || width == 0 || height == 0 {
                    return invalid(format!(
                        "image `{name}` is {width} x {height} from {:?}",
                        resource.source
                    ));
                }
                if width.max(height) > most {
                    return over(format!(
                        "image `{name}` is {width} x {height} pixels, and this device has {most} x {most} at most"
                    ));
                }
            }
        }
        Ok(())
    }

    fn memory(&self) -> Result<(), BackendError> {
        let total: u64 = self.plan.resources.iter().fold(0, |sum, r| sum.saturating_add(r.bytes()));
        if total <= self.limits.heap_bytes {
            return Ok(());
        }
        let largest = self.plan.resources.iter().max_by_key(|r| r.bytes());
        let largest = largest.map(|r| format!("; the largest is `{}` with {}", r.name, mib(r.bytes())));
        over(format!(
            "the plan's resources are {} in all, and the device's memory is {}{}",
            mib(total),
            mib(self.limits.heap_bytes),
            largest.unwrap_or_default()
        ))
    }

    fn pass(&self, pass: &Pass) -> Result<(), BackendError> {
        let name = &pass.name;
        if pass.push.len() > self.limits.max_push_bytes as usize {
            return over(format!(
                "pass `{name}` has {} bytes of push constants, and this device takes {}",
                pass.push.len(),
                self.limits.max_push_bytes
            ));
        }
        if !pass.push.len().is_multiple_of(4) {
            return invalid(format!(
                "pass `{name}` has {} bytes of push constants, not whole words",
                pass.push.len()
            ));
        }
        self.bindings(pass)?;
        match &pass.work {
            Work::Dispatch { shader, groups } => self.dispatch(pass, *shader, *groups),
            Work::Draw { vertex, fragment, call, targets, .. } => {
                self.shader(*vertex, ShaderStage::Vertex, name)?;
                self.shader(*fragment, ShaderStage::Fragment, name)?;
                if let DrawCall::Indirect { buffer, offset } = *call {
                    self.indirect(buffer, offset, 16, name)?;
                }
                self.targets(targets, name)
            }
            Work::Fill { buffer, .. } => {
                let bytes = self.used(*buffer, Usage::COPY_TARGET, name)?.bytes();
                let resource = self.words(*buffer, 0, bytes, name)?;
                if !bytes.is_multiple_of(4) {
                    return invalid(format!(
                        "pass `{name}` fills `{}`, which is not whole words",
                        resource.name
                    ));
                }
                Ok(())
            }
            Work::Export => Ok(()),
        }
    }

    fn bindings(&self, pass: &Pass) -> Result<(), BackendError> {
        let (mut storage, mut uniform, mut images) = (0, 0, 0);
        for binding in &pass.bindings {
            let resource = self.resources(binding.resource, &pass.name)?;
            if resource.is_image() != (binding.kind == DescriptorKind::StorageImage) {
                return invalid(format!(
                    "pass `{}` binds `{}` to `{}`, which is not a {:?}",
                    pass.name, resource.name, binding.name, binding.kind
                ));
            }
            let (count, most) = match binding.kind {
                DescriptorKind::StorageBuffer => (&mut storage, self.limits.max_storage_bytes),
                DescriptorKind::UniformBuffer => (&mut uniform, self.limits.max_uniform_bytes),
                DescriptorKind::StorageImage => (&mut images, u64::MAX),
            };
            *count += 1;
            if resource.bytes() > most {
                return over(format!(
                    "`{}`, bound by pass `{}`, is {}, and a {} of this device may have {} at most",
                    resource.name,
                    pass.name,
                    mib(resource.bytes()),
                    if binding.kind == DescriptorKind::StorageBuffer {
                        "storage binding"
                    } else {
                        "uniform block"
                    },
                    mib(most)
                ));
            }
        }
        for (count, most, what) in [
            (storage, self.limits.max_storage_buffers, "storage buffers"),
            (uniform, self.limits.max_uniform_buffers, "uniform blocks"),
            (images, self.limits.max_storage_images, "storage images"),
        ] {
            if count > most {
                return over(format!(
                    "pass `{}` binds {count} {what}, and this device allows {most}",
                    pass.name
                ));
            }
        }
        Ok(())
    }

    fn shader(&self, id: ShaderId, stage: ShaderStage, user: &str) -> Result<&'a Shader, BackendError> {
        match self.plan.shaders.get(id.index()) {
            Some(shader) if shader.spirv.is_empty() => invalid(format!(
                "shader `{}` has no code (plans that were written to a file keep none)",
                shader.name
            )),
            Some(shader) if shader.reflection.stage == stage => Ok(shader),
            _ => invalid(format!("pass `{user}` names shader {}, which is no {stage:?} shader", id.0)),
        }
    }

    fn dispatch(&self, pass: &Pass, shader: ShaderId, groups: Groups) -> Result<(), BackendError> {
        let shader = self.shader(shader, ShaderStage::Compute, &pass.name)?;
        let (local, most) = (shader.reflection.local_size, self.limits.max_local_size);
        let invocations = local.iter().fold(1u32, |product, &n| product.saturating_mul(n));
        if invocations > self.limits.max_invocations || (0..3).any(|i| local[i] > most[i]) {
            return over(format!(
                "shader `{}` has workgroups of {local:?}, and this device allows {most:?} and {} in all",
                shader.name, self.limits.max_invocations
            ));
        }
        if shader.reflection.shared_bytes > self.limits.shared_bytes {
            return over(format!(
                "shader `{}` uses {} bytes of shared memory, and this device has {}",
                shader.name, shader.reflection.shared_bytes, self.limits.shared_bytes
            ));
        }
        match groups {
            Groups::Direct(groups) if (0..3).any(|i| groups[i] > self.limits.max_groups[i]) => over(format!(
                "pass `{}` dispatches {groups:?} workgroups, and this device allows {:?}",
                pass.name, self.limits.max_groups
            )),
            Groups::Direct(_) => Ok(()),
            Groups::Indirect { buffer, offset } => self.indirect(buffer, offset, 12, &pass.name),
        }
    }

    fn indirect(&self, buffer: ResourceId, offset: u64, bytes: u64, user: &str) -> Result<(), BackendError> {
        self.words(buffer, offset, bytes, user)?;
        self.used(buffer, Usage::INDIRECT, user).map(|_| ())
    }

    fn targets(&self, targets: &[Target], user: &str) -> Result<(), BackendError> {
        if targets.is_empty() || targets.len() > self.limits.max_targets as usize {
            return over(format!(
                "pass `{user}` draws into {} targets; this device allows 1 to {}",
                targets.len(),
                self.limits.max_targets
            ));
        }
        let mut sizes = Vec::new();
        for target in targets {
            let resource = self.used(target.image, Usage::COLOR_TARGET, user)?;
            let Shape::Image { width, height, .. } = resource.shape else {
                return invalid(format!("pass `{user}` draws into `{}`, which is no image", resource.name));
            };
            sizes.push((width, height));
        }
        if sizes.iter().any(|&size| size != sizes[0]) {
            return invalid(format!("pass `{user}` draws into targets of different sizes: {sizes:?}"));
        }
        if !self.limits.independent_blend && targets.iter().any(|t| t.blend != targets[0].blend) {
            return over(format!("pass `{user}` blends its targets differently, which this device cannot"));
        }
        Ok(())
    }

    fn output(&self) -> Result<(), BackendError> {
        if !self.resources(self.plan.output, "output")?.is_image() {
            return invalid("the plan's output is not an image".to_string());
        }
        for stat in &self.plan.stats {
            self.words(stat.buffer, stat.offset, 4, &stat.name)?;
        }
        let exports = |steps: &[Step]| -> Vec<bool> {
            steps.iter().map(|step| self.plan.pass(step.pass).work == Work::Export).collect()
        };
        let frame = exports(&self.plan.frame);
        let last_only = frame.iter().rposition(|&e| e).is_some_and(|last| last + 1 == frame.len())
            && frame.iter().filter(|&&e| e).count() == 1;
        if !last_only || exports(&self.plan.prologue).contains(&true) {
            return invalid("a plan exports its output once, in the last step of its frame".to_string());
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::*;

    /// About what lavapipe has.
    fn limits() -> Limits {
        Limits {
            max_storage_bytes: 128 << 20,
            max_uniform_bytes: 65536,
            max_buffer_bytes: 2 << 30,
            max_push_bytes: 128,
            max_groups: [65535; 3],
            max_local_size: [1024; 3],
            max_invocations: 1024,
            shared_bytes: 32768,
            max_image_size: 16384,
            max_targets: 8,
            rounds_half: true,
            max_storage_buffers: 32,
            max_uniform_buffers: 16,
            max_storage_images: 16,
            heap_bytes: 4 << 30,
            independent_blend: true,
            subgroup: SubgroupLimits { size: 8, max_size: 8, selectable: true, max_per_group: 32 },
            timestamp_bits: 64,
            timestamp_period: 1.0,
        }
    }

    /// What is said of an altered plan, under altered limits; empty if it is accepted.
    fn said(alter: impl FnOnce(&mut Plan, &mut Limits)) -> String {
        let (mut plan, mut limits) = (plan(), limits());
        alter(&mut plan, &mut limits);
        check(&plan, &limits).err().map(|error| error.to_string()).unwrap_or_default()
    }

    fn buffer(plan: &mut Plan, id: ResourceId, count: u64) {
        plan.resources[id.index()].shape = Shape::Buffer { stride: 4, count };
    }

    #[test]
    fn a_plan_within_the_limits_is_accepted() {
        assert_eq!(said(|_, _| {}), "");
    }

    #[test]
    fn sizes_are_compared_in_mebibytes_and_name_the_resource() {
        assert_eq!(
            said(|plan, _| buffer(plan, WORDS, 40_000_000)),
            "`words`, bound by pass `scan[0]`, is 152.6 MiB, and a storage binding of this device may have 128.0 MiB \
             at most"
        );
        assert_eq!(
            said(|plan, _| buffer(plan, ARGS, 1 << 30)),
            "buffer `args` is 4096.0 MiB, and a buffer of this device may have 2048.0 MiB at most"
        );
        assert!(said(|plan, _| buffer(plan, CAMERA, 65536)).contains("a uniform block of this device"));
        assert_eq!(
            said(|plan, limits| {
                buffer(plan, SPLATS, 5000);
                limits.heap_bytes = 40_000
            }),
            "the plan's resources are 40768 bytes in all, and the device's memory is 40000 bytes; the largest is \
             `splats` with 20000 bytes"
        );
    }

    #[test]
    fn too_much_of_anything_else_is_refused() {
        let push = said(|_, limits| limits.max_push_bytes = 4);
        assert!(push.contains("pass `clear` has 8 bytes of push constants"), "{push}");
        let groups = said(|_, limits| limits.max_groups[0] = 3);
        assert!(groups.contains("pass `scan[0]` dispatches [4, 1, 1] workgroups"), "{groups}");
        let local = said(|_, limits| limits.max_invocations = 32);
        assert!(local.contains("`scan.comp` has workgroups of [64, 1, 1]"), "{local}");
        let shared = said(|_, limits| limits.shared_bytes = 512);
        assert!(shared.contains("uses 1024 bytes of shared memory"), "{shared}");
        let image = said(|_, limits| limits.max_image_size = 63);
        assert!(image.contains("image `color` is 64 x 32 pixels"), "{image}");
        let storage = said(|_, limits| limits.max_storage_buffers = 1);
        assert!(storage.contains("pass `splat` binds 2 storage buffers"), "{storage}");
        let targets = said(|_, limits| limits.max_targets = 0);
        assert!(targets.contains("1 targets"), "{targets}");
    }

    #[test]
    fn a_plan_that_contradicts_itself_is_refused_and_never_a_panic() {
        let nowhere = ResourceId(77);
        type Alteration = fn(&mut Plan);
        let alterations: [(&str, Alteration); 14] = [
            ("version", |plan| plan.version += 1),
            ("pass 9", |plan| plan.frame[0].pass = PassId(9)),
            ("in two steps", |plan| plan.frame[0].pass = PassId(0)),
            ("resource 77", |plan| plan.output = ResourceId(77)),
            ("resource 77", |plan| plan.passes[1].bindings[0].resource = ResourceId(77)),
            ("no Compute shader", |plan| {
                plan.passes[1].work = Work::Dispatch { shader: ShaderId(1), groups: Groups::Direct([1; 3]) };
            }),
            ("0 elements", |plan| buffer(plan, WORDS, 0)),
            ("not a StorageBuffer", |plan| plan.passes[1].bindings[0].resource = COLOR),
            ("12 bytes at byte 24", |plan| {
                let groups = Groups::Indirect { buffer: ARGS, offset: 24 };
                plan.passes[2].work = Work::Dispatch { shader: ShaderId(0), groups };
            }),
            ("at byte 18446744073709551612", |plan| plan.stats[0].offset = u64::MAX - 3),
            ("uses `splats` as", |plan| plan.passes[0].work = Work::Fill { buffer: SPLATS, value: 0 }),
            ("exports its output once", |plan| drop(plan.frame.pop())),
            ("exports its output once", |plan| plan.frame.rotate_left(1)),
            ("layouts that do not fit", |plan| {
                let nothing = (Stages::COMPUTE, Accesses::STORAGE_WRITE);
                plan.frame[0].barriers.push(barrier(COLOR, nothing, nothing, None));
            }),
        ];
        for (expected, alter) in alterations {
            let text = said(|plan, _| alter(plan));
            assert!(text.contains(expected), "expected `{expected}` in `{text}`");
        }
        let text = said(|plan, _| {
            let some = (Stages::COMPUTE, Accesses::STORAGE_WRITE);
            plan.frame[1].barriers.push(barrier(nowhere, some, some, None));
        });
        assert!(text.contains("resource 77"), "{text}");
    }
}
