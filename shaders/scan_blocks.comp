#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require

// Turns the counts of visible splats per block of 256 into offsets: an exclusive scan, in place, by one workgroup. The sum
// is the number of visible splats, which determines the amounts to sort and to draw.

#include "args.glsl"
#include "fold_groups.glsl"
#include "live.glsl"

layout(local_size_x = 256) in;

layout(set = 0, binding = 0, std430) buffer BlockCount { uint block_count[]; };
layout(set = 0, binding = 1, std430) writeonly buffer Args { uint args[]; };

const uint BLOCKS = (uint(SCENE_COUNT) + 255u) / 256u;
const uint THREADS = 256u;
const uint PER_THREAD = 16u;
const uint SUBGROUPS = THREADS / uint(DEVICE_SUBGROUP_SIZE);

#include "thread_index.glsl"
#include "workgroup_sum.glsl"

void write_args(uint visible) {
    uint groups = (visible + uint(GROUP_KEYS) - 1u) / uint(GROUP_KEYS);
    uvec3 folded = fold_groups(groups);
    args[ARGS_SORT_GROUPS] = folded.x;
    args[ARGS_SORT_GROUPS + 1u] = folded.y;
    args[ARGS_SORT_GROUPS + 2u] = folded.z;
    args[ARGS_VISIBLE] = visible;

    uint drawn = visible;
#if HAS_BUDGET
    drawn = budget >= 1.0 ? visible : min(visible, uint(ceil(max(budget, 0.0) * float(visible))));
#endif
    args[ARGS_DRAW] = 4u;
    args[ARGS_DRAW + 1u] = drawn;
    args[ARGS_DRAW + 2u] = 0u;
    args[ARGS_DRAW + 3u] = 0u;
    args[ARGS_DRAWN] = drawn;
}

void main() {
    uint thread = thread_index();
    uint carry = 0u;
    uint round = 0u;
    for (uint first = 0u; first < BLOCKS; first += THREADS * PER_THREAD) {
        uint at = first + thread * PER_THREAD;
        uint count[PER_THREAD];
        uint sum = 0u;
        for (uint j = 0u; j < PER_THREAD; j++) {
            count[j] = at + j < BLOCKS ? block_count[at + j] : 0u;
        }
        for (uint j = 0u; j < PER_THREAD; j++) {
            sum += count[j];
        }
        uint offset = exclusive_sum(sum, round, carry);
        for (uint j = 0u; j < PER_THREAD; j++) {
            if (at + j < BLOCKS) {
                block_count[at + j] = offset;
            }
            offset += count[j];
        }
        round++;
    }
    if (thread == 0u) {
        write_args(carry);
    }
}
