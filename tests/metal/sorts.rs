//! The subgroup sort and the serial sort, with every digit width.

use super::clang::Library;
use super::cpu::Cpu;
use super::parity::compare;
use super::{alone, at_every_width_of_lavapipe, change, lavapipe, shaders, translated};
use crate::again::again;
use crate::common::settings;
use crate::sort;
use splatgraph::draw::facts;
use splatgraph::draw::planner::Planner;
use splatgraph_api::{Device, FrameInputs, NoScene};
use splatgraph_framework::ir::DeviceFacts;
use splatgraph_framework::plan::Plan;

/// Number of pairs: more than two blocks in each variant, the last one partly filled.
const COUNT: u32 = 4500;

fn every() -> Vec<(&'static str, u32)> {
    (1..=11).flat_map(|digit_bits| [("subgroup", digit_bits), ("serial", digit_bits)]).collect()
}

/// Builds these sorts from `tests/graphs/sort_only.ron`, without shared memory.
fn plans(device: &DeviceFacts, sorts: &[(&str, u32)], key_bits: u32) -> Vec<Plan> {
    let mut planner = Planner::default();
    planner.share_memory = false;
    let plans = sorts.iter().map(|(sorter, digit_bits)| {
        let block = if *sorter == "serial" { "1000" } else { "512" };
        let bits = [digit_bits, &key_bits].map(u32::to_string);
        let set =
            [("sorter", *sorter), ("digit_bits", &bits[0]), ("key_bits", &bits[1]), ("block_keys", block)];
        let plan = sort::plan(&mut planner, device, COUNT, &settings(&set));
        let mut plan = translated(plan.unwrap_or_else(|errors| panic!("{errors}")));
        plan.name = format!("{sorter} sort, digits of {digit_bits} bits, {} lanes", device.subgroup_size);
        plan
    });
    plans.collect()
}

/// Returns the description of the pairs that `sort_only_load.comp` generates: random keys, or few distinct ones.
fn inputs(few: bool) -> FrameInputs {
    let words = [COUNT, 7, if few { 4 } else { 0 }, 0].map(u32::to_le_bytes);
    FrameInputs { uniforms: [("test.run".to_string(), words.concat())].into(), ..FrameInputs::default() }
}

#[test]
fn sorts_with_digits_of_every_width_give_every_byte_of_lavapipe_after_every_pass() {
    const NAME: &str =
        "metal::sorts::sorts_with_digits_of_every_width_give_every_byte_of_lavapipe_after_every_pass";
    at_every_width_of_lavapipe(NAME, || {
        let mut device = lavapipe();
        let plans = plans(&device.info().facts, &every(), 32);
        let library = Library::new(&shaders(&plans));
        for plan in &plans {
            let found = compare(&mut device, &library, plan, &NoScene, &inputs(false), &[]);
            println!("{}: {} kernels, {} words equal", plan.name, found.kernels, found.equal);
            assert_eq!(found.near, 0);
        }
    });
}

/// Returns the pairs that `pass` binds as `Keys` and `Values`.
fn pairs(plan: &Plan, cpu: &Cpu, pass: &str) -> Vec<(u32, u32)> {
    let bindings = &plan.passes.iter().find(|p| p.name == pass).expect("a pass").bindings;
    let words = |block: &str| -> Vec<u32> {
        let bytes = cpu.bytes(bindings.iter().find(|b| b.name == block).expect("bound").resource);
        bytes.chunks_exact(4).map(|c| u32::from_le_bytes([c[0], c[1], c[2], c[3]])).collect()
    };
    std::iter::zip(words("Keys"), words("Values")).collect()
}

/// Sorts with the kernels on the CPU and with the standard library. Fails if the pairs differ or a kernel fails.
///
/// If `reversed`, threads run in reverse order, and few keys are distinct.
fn sort(plan: &Plan, library: &Library, reversed: bool) -> Result<(), String> {
    let inputs = inputs(reversed);
    let mut cpu = Cpu::new(plan, library, &NoScene, &inputs);
    let mut expected = Vec::new();
    for pass in &plan.frame {
        let name = &plan.pass(*pass).name;
        cpu.run(*pass, reversed).map_err(|error| format!("{name}: {error}"))?;
        if name == "load" {
            expected = pairs(plan, &cpu, "load");
        }
    }
    expected.sort_by_key(|(key, _)| *key);
    if pairs(plan, &cpu, "finish") == expected { Ok(()) } else { Err("other pairs".to_string()) }
}

#[test]
fn sorts_at_every_width_of_simd_groups_and_in_every_order_of_threads_are_those_of_the_standard_library() {
    const NAME: &str = "metal::sorts::sorts_at_every_width_of_simd_groups_and_in_every_order_of_threads_are_those_of_the_standard_library";
    alone(NAME, || {
        // The serial sort uses no SIMD-groups, so its width does not matter.
        let alone: Vec<_> = every().into_iter().filter(|(sorter, _)| *sorter == "subgroup").collect();
        let (narrow, wide) = (facts::portable_device(4), facts::portable_device(64));
        let every = every();
        // Keys of 16 bits take half of the passes.
        let plans = [(facts::apple_device(), &every), (narrow, &alone), (wide, &alone)]
            .map(|(device, sorts)| plans(&device, sorts, 16));
        let plans = plans.concat();
        let library = Library::new(&shaders(&plans));
        for plan in &plans {
            for reversed in [false, true] {
                sort(plan, &library, reversed)
                    .unwrap_or_else(|error| panic!("{}, reversed {reversed}: {error}", plan.name));
            }
        }
    });
}

const BARRIER: &str = "threadgroup_barrier(mem_flags::mem_threadgroup);";
const SIMD_BARRIER: &str =
    "simdgroup_barrier(mem_flags::mem_device | mem_flags::mem_threadgroup | mem_flags::mem_texture);";

/// Mistakes: a piece of the scatter kernel's text, its replacement, and the machine's error.
const WRONG: [(&str, &str, &str); 5] = [
    // Without the barrier, ranks are read before they are counted.
    (BARRIER, "", "sort/scatter.comp: an access beyond the end of a buffer"),
    // Without the barrier, lanes rely on lockstep.
    (SIMD_BARRIER, "", "sort/scatter.comp: an access beyond the end of a buffer"),
    (
        BARRIER,
        "if (gl_SubgroupID != 1u) { threadgroup_barrier(mem_flags::mem_threadgroup); }",
        "some threads do not come to a barrier",
    ),
    (SIMD_BARRIER, "if (valid) { simd_sum(1u); }", "lanes of a SIMD-group are at different operations"),
    (
        ".values_out[place[i_7]]",
        ".values_out[4500u]",
        "sort/scatter.comp: an access beyond the end of a buffer",
    ),
];

/// Runs each case in a separate process, because most cases end the process.
#[test]
fn kernels_without_their_barriers_with_barriers_that_threads_miss_or_beyond_their_buffers_are_found() {
    const NAME: &str = "metal::sorts::kernels_without_their_barriers_with_barriers_that_threads_miss_or_beyond_their_buffers_are_found";
    const CASE: &str = "SPLATGRAPH_METAL_CASE";
    if let Ok(case) = std::env::var(CASE) {
        let (from, to, _) = WRONG[case.parse::<usize>().expect("an index")];
        let mut plan = plans(&facts::apple_device(), &[("subgroup", 5)], 32).remove(0);
        change(&mut plan, "sort/scatter.comp", from, to);
        let library = Library::new(&shaders([&plan]));
        for reversed in [false, true] {
            sort(&plan, &library, reversed).unwrap_or_else(|error| panic!("{error}"));
        }
        return;
    }
    for (case, (from, to, expected)) in WRONG.into_iter().enumerate() {
        let (passed, text) = again(NAME, &[(CASE, &case.to_string())]);
        assert!(!passed && text.contains(expected), "{from} -> {to}: {text}");
    }
}
