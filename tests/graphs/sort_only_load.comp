#version 460
#extension GL_GOOGLE_include_directive : require

// Generates the pairs that `Run` describes, and the arguments of the sort. tests/sort.rs generates the same pairs on the CPU.

#include "args.glsl"
#include "groups.glsl"

layout(local_size_x = 64) in;

layout(set = 0, binding = 0, std140) uniform Run {
    uint count;
    uint seed;
    // 0 random, 1 all equal, 2 ascending, 3 descending, 4 few distinct.
    uint kind;
};
layout(set = 0, binding = 1, std430) writeonly buffer Keys { uint keys[]; };
layout(set = 0, binding = 2, std430) writeonly buffer Values { uint values[]; };
layout(set = 0, binding = 3, std430) writeonly buffer Args { uint args[]; };

uint mixed(uint x) {
    x = (x ^ (x >> 16)) * 0x7feb352du;
    x = (x ^ (x >> 15)) * 0x846ca68bu;
    return x ^ (x >> 16);
}

const uint KEY_MASK = 0xffffffffu >> (32 - KEY_BITS);

uint key_of(uint i) {
    switch (kind) {
        case 0u: return mixed(i + seed) & KEY_MASK;
        case 1u: return seed & KEY_MASK;
        case 2u: return i & KEY_MASK;
        case 3u: return (count - i) & KEY_MASK;
        default: return mixed(mixed(i + seed) % 3u) & KEY_MASK;
    }
}

void main() {
    uint i = group_index() * gl_WorkGroupSize.x + gl_LocalInvocationIndex;
    if (i < count) {
        keys[i] = key_of(i);
        values[i] = mixed(i);
    }
    if (i == 0u) {
        // At most 7 workgroups in x, so that the fold into y is tested with few pairs; more if y would exceed the limit of GPUs.
        uint groups = (count + uint(GROUP_KEYS) - 1u) / uint(GROUP_KEYS);
        uint x = clamp(groups, 1u, max(7u, (groups + 65534u) / 65535u));
        args[ARGS_SORT_GROUPS] = x;
        args[ARGS_SORT_GROUPS + 1u] = (groups + x - 1u) / x;
        args[ARGS_SORT_GROUPS + 2u] = 1u;
        args[ARGS_VISIBLE] = count;
    }
}
