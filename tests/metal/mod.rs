//! The shaders in Metal's language, without a Mac: they compile as C++, and kernels on the CPU give lavapipe's bytes.
//!
//! `include/` declares the part of Metal's library that the shaders use, and `machine.cpp` runs threadgroups. [`clang`]
//! compiles, [`cpu`] executes the passes of a plan, and [`parity`] compares them with lavapipe's. docs/metal.md
//! explains what this proves.

mod builtin;
mod clang;
mod cpu;
mod parity;
mod pictures;
mod sorts;
mod texts;

use crate::common;
use splatgraph_framework::ir::{Msl, Shader};
use splatgraph_framework::msl::add_msl;
use splatgraph_framework::plan::Plan;
use splatgraph_vulkan::{Validation, Vulkan};
use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

/// Opens the device that draws the expected bytes. Other tests check these plans with the validation layers.
fn lavapipe() -> Vulkan {
    let device = Vulkan::open(&common::options(Validation::Off));
    let device = device.unwrap_or_else(|e| panic!("the tests need lavapipe: {e}"));
    common::assert_lanes(&device);
    device
}

/// Runs `body` in a separate process, because kernels can crash it.
///
/// lavapipe has one thread there. It then runs workgroups in order, as the emulator does, so both write pairs of splats
/// and bins to the same places.
fn alone(test: &str, body: impl FnOnce()) {
    common::alone_with(test, &[("LP_NUM_THREADS", "1")], body);
}

/// Runs `body` like [`alone`].
///
/// `./x test --long` also runs it at lavapipe's other subgroup widths.
fn at_every_width_of_lavapipe(test: &str, body: impl FnOnce()) {
    alone(test, body);
    if common::long() && common::lanes_are_usual() && std::env::var_os(common::ALONE).is_none() {
        for bits in [128, 512] {
            common::again_with_vectors_of(bits, test);
        }
    }
}

/// Translates the shaders of a plan. Plans share most of them, and translating takes most of these tests' time, so each
/// shader is translated once for each number of lanes.
fn translated(mut plan: Plan) -> Plan {
    type Known = HashMap<(Arc<Vec<u32>>, u32), Arc<Msl>>;
    static KNOWN: Mutex<Option<Known>> = Mutex::new(None);
    let mut known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
    let known = known.get_or_insert_default();
    let lanes = cpu::lanes(&plan);
    for shader in &mut plan.shaders {
        shader.msl = known.get(&(shader.spirv.clone(), lanes)).cloned();
    }
    add_msl(&mut plan).unwrap_or_else(|errors| panic!("{}: {errors:?}", plan.name));
    for shader in &plan.shaders {
        known.extend(shader.msl.clone().map(|msl| ((shader.spirv.clone(), lanes), msl)));
    }
    plan
}

fn shaders<'a>(plans: impl IntoIterator<Item = &'a Plan>) -> Vec<&'a Shader> {
    plans.into_iter().flat_map(|plan| &plan.shaders).collect()
}

fn change(plan: &mut Plan, shader: &str, from: &str, to: &str) {
    let shader = plan.shaders.iter_mut().find(|s| s.name == shader).expect("a shader");
    let msl = shader.msl.as_ref().expect("translated");
    assert!(msl.source.contains(from), "no `{from}` in\n{}", msl.source);
    let source = msl.source.replace(from, to);
    shader.msl = Some(Arc::new(Msl { source, ..Msl::clone(msl) }));
}
