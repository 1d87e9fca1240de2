#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_EXT_control_flow_attributes : require

// Counts the pairs that the frame needs, in one workgroup. Pairs beyond the capacity of the lists are not sorted. If splats are sorted,
// also turns the blocks' counts of pairs into places, by an exclusive scan.

#include "../args.glsl"
#include "../fold_groups.glsl"

const uint THREADS = uint(SCAN_THREADS);
layout(local_size_x = SCAN_THREADS) in;

layout(set = 0, binding = 0, std430) readonly buffer Amounts { uint amounts[]; };
#if SORTS_SPLATS
#include "scan.glsl"
layout(set = 0, binding = 1, std430) buffer Blocks { uint block_pairs[]; };
#else
#include "../thread_index.glsl"
#endif
layout(set = 0, binding = 2, std430) writeonly buffer PairArgs { uint pair_args[]; };
// Cleared for the pass that finds the lists.
layout(set = 0, binding = 3, std430) writeonly buffer Ranges { uvec2 ranges[]; };
layout(set = 0, binding = 4, std430) writeonly buffer Counts { uint counts[]; };

const uint PER_THREAD = 8u;

void main() {
    uint thread = thread_index();
    for (uint bin = thread; bin < uint(BIN_COUNT); bin += THREADS) {
        ranges[bin] = uvec2(0u);
    }
    uint needed = 0u;
    bool is_wrapped = false;
#if SORTS_SPLATS
    uint blocks = (amounts[ARGS_DRAWN] + uint(PAIR_BLOCK) - 1u) / uint(PAIR_BLOCK);
    // This invocation's part of the sum, in units of 4,096 to avoid overflow.
    uint coarse_part = 0u;
    uint round = 0u;
    for (uint first = 0u; first < blocks; first += THREADS * PER_THREAD) {
        uint at = first + thread * PER_THREAD;
        uint count[PER_THREAD];
        uint sum = 0u;
        [[unroll]] for (uint j = 0u; j < PER_THREAD; j++) {
            count[j] = at + j < blocks ? block_pairs[at + j] : 0u;
            sum += count[j];
        }
        coarse_part += sum >> 12;
        uint next = exclusive_sum(sum, round++, needed);
        [[unroll]] for (uint j = 0u; j < PER_THREAD; j++) {
            if (at + j < blocks) {
                block_pairs[at + j] = next;
            }
            next += count[j];
        }
    }
    uint coarse = 0u;
    exclusive_sum(coarse_part, round++, coarse);
    is_wrapped = coarse >= (1u << 18);
#else
    if (thread == 0u) {
        needed = amounts[COUNTED_PAIRS];
        is_wrapped = amounts[COUNTED_WRAPPED] != 0u;
    }
#endif
    if (thread == 0u) {
        // More than any list holds: the frame overflows, whatever the 32-bit sum is.
        needed = is_wrapped ? 0x7fffffffu : needed;
        uint held = min(needed, uint(ENTRIES));
        uint groups = (held + uint(GROUP_PAIRS) - 1u) / uint(GROUP_PAIRS);
        uvec3 folded = fold_groups(groups);
        pair_args[ARGS_SORT_GROUPS] = folded.x;
        pair_args[ARGS_SORT_GROUPS + 1u] = folded.y;
        pair_args[ARGS_SORT_GROUPS + 2u] = folded.z;
        pair_args[ARGS_VISIBLE] = held;
        // One invocation per pair, and one for the end.
        folded = fold_groups(held / 256u + 1u);
        pair_args[ARGS_DRAW] = folded.x;
        pair_args[ARGS_DRAW + 1u] = folded.y;
        pair_args[ARGS_DRAW + 2u] = folded.z;
        // order_ties.comp adds to it.
        counts[COUNTS_TIED] = 0u;
        counts[COUNTS_NEEDED] = needed;
#if SORTS_SPLATS
        counts[COUNTS_VISIBLE] = amounts[ARGS_VISIBLE];
        counts[COUNTS_DRAWN] = amounts[ARGS_DRAWN];
#else
        counts[COUNTS_VISIBLE] = amounts[COUNTED_VISIBLE];
        counts[COUNTS_DRAWN] = amounts[COUNTED_VISIBLE];
#endif
    }
}
