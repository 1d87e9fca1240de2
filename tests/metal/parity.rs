//! Runs a plan on lavapipe and on the CPU, and compares what every pass wrote.

use super::clang::Library;
use super::cpu::{Cpu, UNWRITTEN};
use splatgraph_api::{Device, FrameInputs, Inspect, SceneData};
use splatgraph_framework::ir::{PassId, ResourceId, Shape, Work};
use splatgraph_framework::plan::Plan;
use splatgraph_vulkan::Vulkan;
use std::collections::BTreeSet;
use std::sync::Arc;

/// Words of a resource that need not be equal.
#[derive(Clone, Copy, Debug)]
pub struct Loose {
    /// Name of the resource, without the suffix of a ping-pong half.
    pub resource: &'static str,
    /// Words per element, and the indices of the words that may differ.
    pub words: (usize, &'static [usize]),
    /// True if the words are pairs of half floats.
    pub halves: bool,
    /// Largest allowed difference of two numbers.
    pub by: f32,
}

#[derive(Debug, Default)]
pub struct Compared {
    /// Kernels that ran.
    pub kernels: usize,
    /// Equal words.
    pub equal: usize,
    /// Unequal words within the tolerance.
    pub near: usize,
}

fn written(plan: &Plan, pass: PassId) -> BTreeSet<ResourceId> {
    plan.pass(pass).uses.iter().filter(|u| u.accesses.writes()).map(|u| u.resource).collect()
}

/// Runs the prologue and one frame of a plan without shared memory on lavapipe and on the CPU.
///
/// Each pass starts from lavapipe's state. Draws run only on lavapipe. Fails if a word differs by more than `loose`
/// allows, or if a word of the output is never written.
pub fn compare(
    device: &mut Vulkan,
    library: &Library,
    plan: &Plan,
    scene: &dyn SceneData,
    inputs: &FrameInputs,
    loose: &[Loose],
) -> Compared {
    let passes: Vec<PassId> =
        plan.order().filter(|pass| !matches!(plan.pass(*pass).work, Work::Export | Work::Host)).collect();
    // Inspects the results of each pass, and the contents of each buffer before its first write.
    let mut inspect: Vec<Inspect> = Vec::new();
    let mut seen = BTreeSet::new();
    for (i, pass) in passes.iter().enumerate() {
        for resource in written(plan, *pass) {
            if seen.insert(resource) && i > 0 && is_buffer(plan, resource) {
                inspect.push(Inspect { resource, after: passes[i - 1] });
            }
            inspect.push(Inspect { resource, after: *pass });
        }
    }
    device.load(in_order(plan), scene, &mut |_| {}).expect("the plan loads");
    let frame =
        device.submit(&FrameInputs { inspect: inspect.clone(), ..inputs.clone() }).expect("submitted");
    let inspected = device.wait(frame).expect("done").inspected;
    let contents = |resource, after| {
        let at = inspect.iter().position(|i| *i == Inspect { resource, after });
        at.map(|at| &inspected[at])
    };

    let mut cpu = Cpu::new(plan, library, scene, inputs);
    let mut compared = Compared::default();
    let mut seen = BTreeSet::new();
    for (i, id) in passes.iter().enumerate() {
        let pass = plan.pass(*id);
        let written = written(plan, *id);
        for resource in &written {
            if seen.insert(*resource) && i > 0 && is_buffer(plan, *resource) {
                cpu.set(*resource, contents(*resource, passes[i - 1]).expect("inspected"));
            }
        }
        let ran = cpu.run(*id, false).unwrap_or_else(|error| panic!("{}: {error}", pass.name));
        compared.kernels += usize::from(matches!(pass.work, Work::Dispatch { .. }));
        for resource in written {
            let expected = contents(resource, *id).expect("inspected");
            let mut next = expected.clone();
            if ran {
                let name = &plan.resource(resource).name;
                let loose = loose.iter().find(|l| name.split('#').next() == Some(l.resource));
                let found = cpu.bytes(resource);
                let is_image = !is_buffer(plan, resource);
                if let Some(text) = compare_words(&mut compared, found, expected, loose, is_image || i == 0) {
                    panic!("{}: after {}, {name} differs: {text}", plan.name, pass.name);
                }
                // Unwritten pixels are undefined on lavapipe, so keep the known byte.
                if is_image {
                    for (next, found) in std::iter::zip(next.chunks_exact_mut(4), found.chunks_exact(4)) {
                        if found == [UNWRITTEN; 4] {
                            next.copy_from_slice(found);
                        }
                    }
                }
            }
            cpu.set(resource, &next);
        }
    }
    let output = cpu.bytes(plan.output).chunks_exact(4);
    assert_eq!(output.filter(|word| *word == [UNWRITTEN; 4]).count(), 0, "{}: pixels are missing", plan.name);
    compared
}

fn is_buffer(plan: &Plan, resource: ResourceId) -> bool {
    matches!(plan.resource(resource).shape, Shape::Buffer { .. })
}

/// Compares word by word, and counts the words in `compared`. Describes the differences; `None` if there are none
/// beyond the tolerance.
///
/// If `unwritten` is true, skips words that nothing has written on the CPU.
fn compare_words(
    compared: &mut Compared,
    found: &[u8],
    expected: &[u8],
    loose: Option<&Loose>,
    unwritten: bool,
) -> Option<String> {
    let mut differ = 0;
    let mut first = None;
    for (at, (found, expected)) in std::iter::zip(words(found), words(expected)).enumerate() {
        if found == expected {
            compared.equal += 1;
        } else if unwritten && found == u32::from_le_bytes([UNWRITTEN; 4]) {
            // Not written on the CPU yet.
        } else if loose.is_some_and(|l| l.words.1.contains(&(at % l.words.0)) && l.allows(found, expected)) {
            compared.near += 1;
        } else {
            differ += 1;
            first = first.or(Some((at, found, expected)));
        }
    }
    first.map(|(at, found, expected)| {
        let (f, e) = (f32::from_bits(found), f32::from_bits(expected));
        format!("{differ} words, the first is word {at}, {found:#x} ({f:e}), not {expected:#x} ({e:e})")
    })
}

impl Loose {
    fn allows(&self, found: u32, expected: u32) -> bool {
        let numbers = |word: u32| {
            let halves = [word as u16, (word >> 16) as u16].map(|bits| half::f16::from_bits(bits).to_f32());
            if self.halves { halves } else { [f32::from_bits(word); 2] }
        };
        // False for NaN.
        std::iter::zip(numbers(found), numbers(expected))
            .all(|(found, expected)| (found - expected).abs() <= self.by)
    }
}

/// Returns the plan with shaders whose float operations lavapipe must not reorder.
///
/// Float arithmetic is decorated like operations on `precise` variables. Otherwise lavapipe's optimiser factors sums,
/// and no other compiler would give the same bits.
fn in_order(plan: &Plan) -> Plan {
    let mut plan = plan.clone();
    for shader in &mut plan.shaders {
        shader.spirv = Arc::new(precise(&shader.spirv));
    }
    plan
}

/// Adds `NoContraction` to a module's instructions that `ARITHMETIC` lists (SPIR-V 1.6, 3.52 "Instructions").
fn precise(spirv: &[u32]) -> Vec<u32> {
    /// Opcodes of FNegate, FAdd, FSub, FMul, FDiv, Dot, and VectorTimesScalar to MatrixTimesMatrix.
    const ARITHMETIC: [u32; 11] = [127, 129, 131, 133, 136, 142, 143, 144, 145, 146, 148];
    const DECORATE: u32 = 71;
    const NO_CONTRACTION: u32 = 42;
    const HEADER: usize = 5;
    let (mut at, mut first) = (HEADER, None);
    let (mut results, mut known) = (BTreeSet::new(), BTreeSet::new());
    while at < spirv.len() {
        let (length, code) = ((spirv[at] >> 16) as usize, spirv[at] & 0xffff);
        if ARITHMETIC.contains(&code) {
            results.insert(spirv[at + 2]);
        }
        if code == DECORATE {
            first = first.or(Some(at));
            if spirv[at + 2] == NO_CONTRACTION {
                known.insert(spirv[at + 1]);
            }
        }
        at += length;
    }
    let first = first.expect("bindings are decorations");
    let added = results.difference(&known).flat_map(|id| [3 << 16 | DECORATE, *id, NO_CONTRACTION]);
    spirv[..first].iter().copied().chain(added).chain(spirv[first..].iter().copied()).collect()
}

fn words(bytes: &[u8]) -> impl Iterator<Item = u32> + '_ {
    bytes.chunks_exact(4).map(|c| u32::from_le_bytes([c[0], c[1], c[2], c[3]]))
}
