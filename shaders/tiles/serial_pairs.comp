#version 460
#extension GL_GOOGLE_include_directive : require

// First pass of binning, serial: counts the pairs of each run of RUN_SPLATS splats in depth order. The bins of a splat are
// copied to its position in this order, so that later passes read them contiguously.

#include "../args.glsl"
#include "serial.glsl"

layout(set = 0, binding = 0, std430) readonly buffer Args { uint args[]; };
layout(set = 0, binding = 1, std430) readonly buffer Order { uint order[]; };
layout(set = 0, binding = 2, std430) readonly buffer Bins { uint bins_of[]; };
layout(set = 0, binding = 3, std430) writeonly buffer SortedBins { uint sorted_bins[]; };
layout(set = 0, binding = 4, std430) writeonly buffer Runs { uint runs[]; };

void main() {
    uint count = args[ARGS_DRAWN];
    uint run = invocation_index();
    uint first = run * uint(RUN_SPLATS);
    if (first >= count) {
        return;
    }
    uint end = min(first + uint(RUN_SPLATS), count);
    uint pairs = 0u;
    uint i = first;
    do {
        uint bins = bins_of[order[i]];
        sorted_bins[i] = bins;
        pairs += bins_in(unpack_bins(bins));
        i++;
    } while (i < end);
    runs[run] = pairs;
}
