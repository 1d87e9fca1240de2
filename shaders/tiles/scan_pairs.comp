#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_EXT_control_flow_attributes : require

// Second pass of binning: turns the blocks' counts of pairs into places, by an exclusive scan in one workgroup. The sum is the
// number of pairs that the frame needs; as many as the lists hold are sorted.

#include "../args.glsl"
#include "../fold_groups.glsl"
#include "scan.glsl"

#if SORTED == SORTED_SPLATS
layout(set = 0, binding = 0, std430) readonly buffer Args { uint args[]; };
#endif
layout(set = 0, binding = 1, std430) buffer Blocks { uint block_pairs[]; };
layout(set = 0, binding = 2, std430) writeonly buffer PairArgs { uint pair_args[]; };

const uint PER_THREAD = 8u;

void main() {
#if SORTED == SORTED_SPLATS
    uint count = args[ARGS_DRAWN];
#else
    uint count = uint(SCENE_COUNT);
#endif
    uint blocks = (count + uint(PAIR_BLOCK) - 1u) / uint(PAIR_BLOCK);
    uint thread = thread_index();
    uint needed = 0u;
    // The same in units of 256, which does not overflow.
    uint coarse = 0u;
    uint round = 0u;
    for (uint first = 0u; first < blocks; first += THREADS * PER_THREAD) {
        uint at = first + thread * PER_THREAD;
        uint count[PER_THREAD];
        uint sum = 0u;
        [[unroll]] for (uint j = 0u; j < PER_THREAD; j++) {
            count[j] = at + j < blocks ? block_pairs[at + j] : 0u;
            sum += count[j];
        }
        uint next = exclusive_sum(sum, round++, needed);
        exclusive_sum(sum >> 8, round++, coarse);
        [[unroll]] for (uint j = 0u; j < PER_THREAD; j++) {
            if (at + j < blocks) {
                block_pairs[at + j] = next;
            }
            next += count[j];
        }
    }
    if (thread == 0u) {
        // More than any list holds: the frame is short, whatever the sum of 32 bits says.
        needed = coarse >= (1u << 23) ? 0x7fffffffu : needed;
        uint held = min(needed, uint(ENTRIES));
        uint groups = (held + uint(GROUP_PAIRS) - 1u) / uint(GROUP_PAIRS);
        uvec3 folded = fold_groups(groups);
        pair_args[ARGS_SORT_GROUPS] = folded.x;
        pair_args[ARGS_SORT_GROUPS + 1u] = folded.y;
        pair_args[ARGS_SORT_GROUPS + 2u] = folded.z;
        pair_args[ARGS_VISIBLE] = held;
        // An invocation for each pair, and one for the end.
        folded = fold_groups(held / 256u + 1u);
        pair_args[ARGS_DRAW] = folded.x;
        pair_args[ARGS_DRAW + 1u] = folded.y;
        pair_args[ARGS_DRAW + 2u] = folded.z;
        pair_args[ARGS_DRAWN] = needed;
    }
}
