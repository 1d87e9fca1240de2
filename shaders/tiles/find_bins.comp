#version 460
#extension GL_GOOGLE_include_directive : require

// Finds where each bin's list starts among the sorted pairs. An invocation takes a pair; one that differs from the pair before it
// starts its own bin, and those between, which have no pairs. Word BIN_COUNT is the end of the last list.

#include "../args.glsl"
#include "../groups.glsl"

layout(local_size_x = 256) in;

layout(set = 0, binding = 0, std430) readonly buffer PairArgs { uint pair_args[]; };
layout(set = 0, binding = 1, std430) readonly buffer PairKeys { uint pair_keys[]; };
layout(set = 0, binding = 2, std430) writeonly buffer Starts { uint starts[]; };

const uint BINS = uint(BIN_COUNT);

uint bin_of(uint pair) {
#if SORTED == SORTED_SPLATS
    uint bin = pair_keys[pair];
#else
    uint bin = pair_keys[pair] >> DEPTH_BITS;
#endif
    return min(bin, BINS - 1u);
}

void main() {
    uint count = pair_args[ARGS_VISIBLE];
    uint i = group_index() * gl_WorkGroupSize.x + gl_LocalInvocationIndex;
    if (i > count) {
        return;
    }
    uint from = i == 0u ? 0u : bin_of(i - 1u) + 1u;
    uint to = i == count ? BINS : bin_of(i);
    // Two a round: lavapipe ends loops after 65,535 rounds.
    for (uint bin = from; bin <= to; bin += 2u) {
        starts[bin] = i;
        if (bin < to) {
            starts[bin + 1u] = i;
        }
    }
}
