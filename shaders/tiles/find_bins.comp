#version 460
#extension GL_GOOGLE_include_directive : require

// Finds the list of each bin among pairs sorted by bin only.

#include "../args.glsl"
#include "../groups.glsl"

layout(local_size_x = 256) in;

layout(set = 0, binding = 0, std430) readonly buffer PairArgs { uint pair_args[]; };
layout(set = 0, binding = 1, std430) readonly buffer PairKeys { uint pair_keys[]; };
layout(set = 0, binding = 2, std430) writeonly buffer Ranges { uvec2 ranges[]; };

#include "ranges.glsl"

void main() {
    uint count = pair_args[ARGS_VISIBLE];
    uint i = group_index() * gl_WorkGroupSize.x + gl_LocalInvocationIndex;
    if (i <= count) {
        find_ranges(i, count, i == 0u ? 0u : pair_keys[i - 1u], i == count ? 0u : pair_keys[i]);
    }
}
