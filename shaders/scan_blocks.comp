#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require

// Turns the counts of visible splats per block of 256 into offsets: an exclusive scan, in place, by one workgroup. The sum
// is the number of visible splats, which determines the amounts to sort and to draw.

#include "args.glsl"
#include "live.glsl"

layout(local_size_x = 256) in;

layout(set = 0, binding = 0, std430) buffer BlockCount { uint block_count[]; };
layout(set = 0, binding = 1, std430) writeonly buffer Args { uint args[]; };

const uint BLOCKS = (uint(SCENE_COUNT) + 255u) / 256u;
const uint THREADS = 256u;
const uint PER_THREAD = 16u;
const uint SUBGROUPS = THREADS / uint(DEVICE_SUBGROUP_SIZE);

// Two alternating sets, so that one barrier per round is enough.
shared uint subgroup_sum[2][SUBGROUPS];

void write_args(uint visible) {
    uint groups = (visible + uint(GROUP_KEYS) - 1u) / uint(GROUP_KEYS);
    uint x = min(groups, uint(DEVICE_MAX_GROUPS_X));
    args[ARGS_SORT_GROUPS] = x;
    args[ARGS_SORT_GROUPS + 1u] = x == 0u ? 1u : (groups + x - 1u) / x;
    args[ARGS_SORT_GROUPS + 2u] = 1u;
    args[ARGS_VISIBLE] = visible;

    uint drawn = budget >= 1.0 ? visible : min(visible, uint(ceil(max(budget, 0.0) * float(visible))));
    args[ARGS_DRAW] = 4u;
    args[ARGS_DRAW + 1u] = drawn;
    args[ARGS_DRAW + 2u] = 0u;
    args[ARGS_DRAW + 3u] = 0u;
    args[ARGS_DRAWN] = drawn;
}

void main() {
    uint thread = gl_SubgroupID * gl_SubgroupSize + gl_SubgroupInvocationID;
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

        uint inclusive = subgroupInclusiveAdd(sum);
        if (gl_SubgroupInvocationID == gl_SubgroupSize - 1u) {
            subgroup_sum[round & 1u][gl_SubgroupID] = inclusive;
        }
        barrier();
        uint offset = carry + inclusive - sum;
        for (uint s = 0u; s < SUBGROUPS; s++) {
            uint other = subgroup_sum[round & 1u][s];
            offset += s < gl_SubgroupID ? other : 0u;
            carry += other;
        }

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
