//! Finds code that Metal cannot run although SPIRV-Cross translates it, in the words of the SPIR-V.
//!
//! Below version 3.2, Metal's language has relaxed atomics only, and orders memory only at barriers, between the
//! threads of a threadgroup. SPIRV-Cross drops any other order without an error. Apple's compiler refuses more than
//! [`Msl::MAX_READ_WRITE_TEXTURES`] textures that a function may both read and write.

use std::collections::{HashMap, HashSet};

use crate::ir::{Msl, MslArgument, ShaderStage};

/// Operation codes, decorations and enumerants of the SPIR-V specification.
mod op {
    pub const LINE: u32 = 8;
    pub const CONSTANT: u32 = 43;
    pub const DECORATE: u32 = 71;
    pub const CONTROL_BARRIER: u32 = 224;
    pub const MEMORY_BARRIER: u32 = 225;
    pub const ATOMIC_STORE: u32 = 228;
    pub const ATOMIC_FLAG_CLEAR: u32 = 319;
    /// `OpAtomicLoad` to `OpAtomicXor`, `OpAtomicFlagTestAndSet`, and the atomics on floats.
    pub const OTHER_ATOMICS: [std::ops::RangeInclusive<u32>; 4] =
        [227..=242, 318..=318, 5614..=5615, 6035..=6035];
    pub const COMPARE_EXCHANGES: std::ops::RangeInclusive<u32> = 230..=231;
    pub const NON_WRITABLE: u32 = 24;
    pub const NON_READABLE: u32 = 25;
    pub const BINDING: u32 = 33;
    pub const SUBGROUP: u32 = 3;
    /// Acquire, release, both, and sequentially consistent.
    pub const ORDERED: u32 = 0x1E;
}

/// Returns the reason why Metal cannot run a shader, if there is one.
pub(super) fn check(spirv: &[u32], stage: ShaderStage, arguments: &[MslArgument]) -> Result<(), String> {
    let (mut constants, mut bindings, mut one_way) = (HashMap::new(), HashMap::new(), HashSet::new());
    let is_ordered = |constants: &HashMap<u32, u32>, id: u32| {
        constants.get(&id).is_some_and(|semantics| semantics & op::ORDERED != 0)
    };
    let mut is_fenced = false;
    let mut rest = spirv.get(5..).unwrap_or_default();
    // What is no instruction ends the loop; SPIRV-Cross reports it.
    while let Some((&head, _)) = rest.split_first()
        && let Some((words, after)) = rest.split_at_checked((head >> 16).max(1) as usize)
    {
        rest = after;
        let code = head & 0xFFFF;
        let word = |at: usize| words.get(at).copied().unwrap_or(0);
        if is_fenced && ![op::MEMORY_BARRIER, op::CONTROL_BARRIER, op::LINE].contains(&code) {
            return Err(BARRIER.into());
        }
        let semantics = match code {
            op::CONSTANT => {
                constants.insert(word(2), word(3));
                continue;
            }
            op::DECORATE => {
                match word(2) {
                    op::BINDING => _ = bindings.insert(word(3), word(1)),
                    op::NON_READABLE | op::NON_WRITABLE => _ = one_way.insert(word(1)),
                    _ => {}
                }
                continue;
            }
            op::MEMORY_BARRIER if stage != ShaderStage::Compute => return Err(BARRIER.into()),
            op::MEMORY_BARRIER => {
                is_fenced = constants.get(&word(1)) != Some(&op::SUBGROUP);
                continue;
            }
            op::CONTROL_BARRIER => {
                is_fenced = false;
                continue;
            }
            op::ATOMIC_STORE | op::ATOMIC_FLAG_CLEAR => [word(3), 0],
            code if op::COMPARE_EXCHANGES.contains(&code) => [word(5), word(6)],
            code if op::OTHER_ATOMICS.iter().any(|codes| codes.contains(&code)) => [word(5), 0],
            _ => continue,
        };
        if semantics.into_iter().any(|id| is_ordered(&constants, id)) {
            return Err(ATOMICS.into());
        }
    }
    let is_read_write = |binding: u32| bindings.get(&binding).is_some_and(|id| !one_way.contains(id));
    let images = arguments.iter().filter(|argument| argument.texture && is_read_write(argument.binding));
    let (found, most) = (images.count(), Msl::MAX_READ_WRITE_TEXTURES);
    if found > most as usize {
        return Err(format!(
            "expected at most {most} images that are neither `readonly` nor `writeonly`, found {found}"
        ));
    }
    Ok(())
}

const ATOMICS: &str = "expected atomics without a memory order, found one with acquire or release, which Metal lacks \
                       below version 3.2: use another dispatch instead";

const BARRIER: &str = "expected `memoryBarrier()` only directly before `barrier()` in a compute shader, found one elsewhere: \
                       below version 3.2, Metal orders memory only within a threadgroup, at its barriers; use another \
                       dispatch instead";
