#version 460
#extension GL_GOOGLE_include_directive : require

// Generates pairs of a random key and its index, writes their number, and clears the count of wrong pairs.

#include "../args.glsl"
#include "../fold_groups.glsl"
#include "../groups.glsl"
#include "pairs_key.glsl"

layout(local_size_x = 256) in;

layout(set = 0, binding = 0, std430) writeonly buffer Keys { uint keys[]; };
layout(set = 0, binding = 1, std430) writeonly buffer Values { uint values[]; };
layout(set = 0, binding = 2, std430) writeonly buffer Args { uint args[]; };
layout(set = 0, binding = 3, std430) writeonly buffer Wrong { uint wrong; };

void main() {
    uint i = group_index() * gl_WorkGroupSize.x + gl_LocalInvocationIndex;
    if (i < uint(PAIRS)) {
        keys[i] = key_of(i);
        values[i] = i;
    }
    if (i == 0u) {
        uint groups = (uint(PAIRS) + uint(GROUP_KEYS) - 1u) / uint(GROUP_KEYS);
        uvec3 folded = fold_groups(groups);
        args[ARGS_SORT_GROUPS] = folded.x;
        args[ARGS_SORT_GROUPS + 1u] = folded.y;
        args[ARGS_SORT_GROUPS + 2u] = folded.z;
        args[ARGS_VISIBLE] = uint(PAIRS);
        wrong = 0u;
    }
}
