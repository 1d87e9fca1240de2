#version 460
#extension GL_GOOGLE_include_directive : require

// Generates pairs of a random key and its index, and writes their number.

#include "../args.glsl"
#include "../fold_groups.glsl"
#include "../groups.glsl"

layout(local_size_x = 256) in;

layout(set = 0, binding = 0, std430) writeonly buffer Keys { uint keys[]; };
layout(set = 0, binding = 1, std430) writeonly buffer Values { uint values[]; };
layout(set = 0, binding = 2, std430) writeonly buffer Args { uint args[]; };

// A bijection on words with random-looking results ("lowbias32" by C. Wellons).
uint mixed(uint x) {
    x = (x ^ (x >> 16)) * 0x7feb352du;
    x = (x ^ (x >> 15)) * 0x846ca68bu;
    return x ^ (x >> 16);
}

void main() {
    uint i = group_index() * gl_WorkGroupSize.x + gl_LocalInvocationIndex;
    if (i < uint(PAIRS)) {
        keys[i] = mixed(i) >> (32 - KEY_BITS);
        values[i] = i;
    }
    if (i == 0u) {
        uint groups = (uint(PAIRS) + uint(GROUP_KEYS) - 1u) / uint(GROUP_KEYS);
        uvec3 folded = fold_groups(groups);
        args[ARGS_SORT_GROUPS] = folded.x;
        args[ARGS_SORT_GROUPS + 1u] = folded.y;
        args[ARGS_SORT_GROUPS + 2u] = folded.z;
        args[ARGS_VISIBLE] = uint(PAIRS);
    }
}
