#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_EXT_control_flow_attributes : require

// Turns the blocks' counts of pairs into places, by an exclusive scan in one workgroup. The sum is the
// number of pairs that the frame needs; as many as the lists hold are sorted. Where pairs are sorted once, blocks are those of
// the projection, whose visible splats are summed as well.

#include "../args.glsl"
#include "../fold_groups.glsl"

const uint THREADS = uint(SCAN_THREADS);
layout(local_size_x = SCAN_THREADS) in;
#include "scan.glsl"

#if SORTED == SORTED_SPLATS
layout(set = 0, binding = 0, std430) readonly buffer Args { uint args[]; };
#else
layout(set = 0, binding = 3, std430) readonly buffer BlockCount { uint block_visible[]; };
#endif
// Pairs that order_ties.comp has to leave in file order.
layout(set = 0, binding = 4, std430) writeonly buffer Unordered { uint unordered; };
layout(set = 0, binding = 1, std430) buffer Blocks { uint block_pairs[]; };
layout(set = 0, binding = 2, std430) writeonly buffer PairArgs { uint pair_args[]; };
// Cleared for the pass that finds the lists.
layout(set = 0, binding = 5, std430) writeonly buffer Ranges { uvec2 ranges[]; };

const uint PER_THREAD = 8u;

void main() {
#if SORTED == SORTED_SPLATS
    uint blocks = (args[ARGS_DRAWN] + uint(PAIR_BLOCK) - 1u) / uint(PAIR_BLOCK);
#else
    uint blocks = (uint(SCENE_COUNT) + 255u) / 256u;
#endif
    uint thread = thread_index();
    for (uint bin = thread; bin < uint(BIN_COUNT); bin += THREADS) {
        ranges[bin] = uvec2(0u);
    }
    uint needed = 0u;
    // This invocation's part of the sum in units of 4,096, which does not overflow, and of the visible splats.
    uint coarse_part = 0u;
#if SORTED == SORTED_PAIRS
    uint visible_part = 0u;
#endif
    uint round = 0u;
    for (uint first = 0u; first < blocks; first += THREADS * PER_THREAD) {
        uint at = first + thread * PER_THREAD;
        uint count[PER_THREAD];
        uint sum = 0u;
        [[unroll]] for (uint j = 0u; j < PER_THREAD; j++) {
            bool is_block = at + j < blocks;
            count[j] = is_block ? block_pairs[at + j] : 0u;
            sum += count[j];
#if SORTED == SORTED_PAIRS
            visible_part += is_block ? block_visible[at + j] : 0u;
#endif
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
#if SORTED == SORTED_PAIRS
    uint visible = 0u;
    exclusive_sum(visible_part, round++, visible);
#endif
    if (thread == 0u) {
        // More than any list holds: the frame overflows, whatever the 32-bit sum is.
        needed = coarse >= (1u << 18) ? 0x7fffffffu : needed;
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
        pair_args[ARGS_DRAWN] = needed;
        unordered = 0u;
#if SORTED == SORTED_PAIRS
        pair_args[ARGS_SEEN] = visible;
#endif
    }
}
