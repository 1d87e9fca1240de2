//! Executes a plan's passes on the CPU, with Metal kernels compiled by clang.

use super::clang::{Call, Image, Library};
use splatgraph_api::{FrameInputs, SceneData};
use splatgraph_framework::ir::{Format, Groups, Msl, PassId, ResourceId, Shape, Source, Work};
use splatgraph_framework::plan::Plan;
use std::ptr::null_mut;

/// The byte that fills memory before anything is written to it.
pub const UNWRITTEN: u8 = 0xa5;

/// Bytes that end at a page boundary; the next page is inaccessible.
struct Memory {
    mapping: *mut u8,
    mapped: usize,
    begin: *mut u8,
    length: usize,
}

impl Memory {
    fn new(length: usize) -> Memory {
        const PAGE: usize = 64 << 10;
        let mapped = length.next_multiple_of(PAGE) + PAGE;
        let flags = libc::MAP_PRIVATE | libc::MAP_ANONYMOUS;
        // SAFETY: a new mapping overlaps no other memory.
        let mapping =
            unsafe { libc::mmap(null_mut(), mapped, libc::PROT_READ | libc::PROT_WRITE, flags, -1, 0) };
        assert!(mapping != libc::MAP_FAILED, "no memory");
        let mapping = mapping.cast::<u8>();
        // SAFETY: both are within the mapping.
        let begin = unsafe {
            assert_eq!(libc::mprotect(mapping.add(mapped - PAGE).cast(), PAGE, libc::PROT_NONE), 0);
            mapping.add(mapped - PAGE - length)
        };
        let mut memory = Memory { mapping, mapped, begin, length };
        memory.bytes_mut().fill(UNWRITTEN);
        memory
    }

    fn bytes(&self) -> &[u8] {
        // SAFETY: the mapping lives as long as this, and no kernel runs while it is borrowed.
        unsafe { std::slice::from_raw_parts(self.begin, self.length) }
    }

    fn bytes_mut(&mut self) -> &mut [u8] {
        // SAFETY: as above, and `&mut self` excludes other borrows.
        unsafe { std::slice::from_raw_parts_mut(self.begin, self.length) }
    }
}

impl Drop for Memory {
    fn drop(&mut self) {
        // SAFETY: `self` owns the mapping.
        unsafe { libc::munmap(self.mapping.cast(), self.mapped) };
    }
}

/// Executes a plan, with separate memory for every resource.
pub struct Cpu<'a> {
    plan: &'a Plan,
    library: &'a Library,
    memory: Vec<Memory>,
}

impl<'a> Cpu<'a> {
    /// Allocates the resources, and fills those that the host provides. `plan` must share no memory and have no host
    /// buffers.
    pub fn new(plan: &'a Plan, library: &'a Library, scene: &dyn SceneData, inputs: &FrameInputs) -> Cpu<'a> {
        let memory = plan.resources.iter().map(|resource| {
            let mut memory = Memory::new(resource.bytes() as usize);
            let bytes = memory.bytes_mut();
            match &resource.source {
                Source::Scene { attribute, plane } => {
                    scene.write(attribute, *plane, 0, bytes).expect("the scene has it")
                }
                Source::Frame { uniform } => bytes.copy_from_slice(&inputs.uniforms[uniform]),
                Source::Live => bytes.copy_from_slice(&inputs.live),
                Source::HostBuffer { .. } => panic!("`{}` comes from the host", resource.name),
                Source::Transient | Source::Readback => {}
            }
            memory
        });
        Cpu { plan, library, memory: memory.collect() }
    }

    pub fn bytes(&self, resource: ResourceId) -> &[u8] {
        self.memory[resource.index()].bytes()
    }

    pub fn set(&mut self, resource: ResourceId, bytes: &[u8]) {
        self.memory[resource.index()].bytes_mut().copy_from_slice(bytes);
    }

    fn word(&self, resource: ResourceId, at: usize) -> u32 {
        let bytes = self.bytes(resource)[at..at + 4].try_into().expect("four bytes");
        u32::from_le_bytes(bytes)
    }

    /// Runs a pass, with threads in reverse order if `reversed`. Returns false if it is a draw, which is skipped.
    /// Export and host passes do nothing.
    pub fn run(&mut self, pass: PassId, reversed: bool) -> Result<bool, String> {
        let plan = self.plan;
        let pass = plan.pass(pass);
        let (shader, groups) = match &pass.work {
            Work::Dispatch { shader, groups } => (plan.shader(*shader), groups),
            Work::Fill { buffer, value } => {
                let words = self.memory[buffer.index()].bytes_mut().chunks_exact_mut(4);
                words.for_each(|word| word.copy_from_slice(&value.to_le_bytes()));
                return Ok(true);
            }
            Work::ClearHistory { resource } => {
                self.memory[resource.index()].bytes_mut().fill(0);
                return Ok(true);
            }
            Work::Draw { .. } => return Ok(false),
            Work::Export | Work::Host => return Ok(true),
        };
        let groups = match groups {
            Groups::Direct(groups) => *groups,
            Groups::Indirect { buffer, offset } => {
                [0, 4, 8].map(|word| self.word(*buffer, *offset as usize + word))
            }
        };
        let msl = shader.msl.as_ref().expect("translated");
        let mut buffers = vec![null_mut(); Msl::MAX_BUFFERS as usize];
        let mut images = Vec::new();
        for argument in &msl.arguments {
            let bound =
                pass.bindings.iter().find(|b| (b.binding, b.element) == (argument.binding, argument.element));
            let bound =
                bound.unwrap_or_else(|| panic!("{}: nothing is bound to {argument:?}", pass.name)).resource;
            let bytes = self.memory[bound.index()].begin;
            match plan.resource(bound).shape {
                Shape::Buffer { .. } => buffers[argument.index as usize] = bytes,
                Shape::Image { format, width, height } => {
                    let format = match format {
                        Format::Rgba8Unorm => 0,
                        Format::Rgba16Float => 1,
                        Format::Rgba32Float => 2,
                        other => panic!("no kernel here has images of {other:?}"),
                    };
                    images.resize(
                        argument.index as usize + 1,
                        Image { bytes: null_mut(), width: 0, height: 0, format: 0 },
                    );
                    images[argument.index as usize] = Image { bytes, width, height, format };
                }
            }
        }
        let mut push = Memory::new(pass.push.len());
        push.bytes_mut().copy_from_slice(&pass.push);
        if let Some(index) = msl.push {
            buffers[index as usize] = push.begin;
        }
        assert!(msl.sizes.is_none(), "{}: no kernel here asks for the sizes of buffers", shader.name);
        let call = Call {
            buffers: &mut buffers,
            images: &mut images,
            groups,
            size: shader.reflection.local_size,
            lanes: lanes(plan),
            reversed,
        };
        self.library.run(shader, call).map(|()| true)
    }
}

pub fn lanes(plan: &Plan) -> u32 {
    match plan.facts["device.subgroup_size"] {
        splatgraph_framework::ir::Value::Int(lanes) => lanes as u32,
        ref other => panic!("a width of {other}"),
    }
}
