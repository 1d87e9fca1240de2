#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require

// First pass of binning: counts, for each block of BLOCK_SPLATS splats in the order of their depth, how many of them may touch
// each bin. The bins of a splat are copied to its place in that order, so that the last pass finds them side by side.

#include "../args.glsl"
#include "../groups.glsl"
#include "bins.glsl"

layout(local_size_x = 256) in;

layout(set = 0, binding = 0, std430) readonly buffer Args { uint args[]; };
layout(set = 0, binding = 1, std430) readonly buffer Order { uint order[]; };
layout(set = 0, binding = 2, std430) readonly buffer Bins { uint bins_of[]; };
layout(set = 0, binding = 3, std430) writeonly buffer SortedBins { uint sorted_bins[]; };
// A row per bin, a column per block.
layout(set = 0, binding = 4, std430) writeonly buffer Table { uint table[]; };

shared uint counts[BIN_COUNT];

// Splats that an invocation loads before it counts the first, so that it waits for memory once.
const uint AT_ONCE = 4u;

void main() {
    uint count = args[ARGS_DRAWN];
    uint blocks = (count + uint(BLOCK_SPLATS) - 1u) / uint(BLOCK_SPLATS);
    uint block = group_index();
    if (block >= blocks) {
        return;
    }
    for (uint bin = gl_LocalInvocationIndex; bin < uint(BIN_COUNT); bin += gl_WorkGroupSize.x) {
        counts[bin] = 0u;
    }
    barrier();
    uint first = block * uint(BLOCK_SPLATS);
    uint end = min(first + uint(BLOCK_SPLATS), count);
    for (uint step = first + gl_LocalInvocationIndex; step < end; step += AT_ONCE * gl_WorkGroupSize.x) {
        uint index[AT_ONCE];
        uint bins[AT_ONCE];
        [[unroll]] for (uint j = 0u; j < AT_ONCE; j++) {
            uint at = step + j * gl_WorkGroupSize.x;
            index[j] = at < end ? order[at] : 0u;
        }
        [[unroll]] for (uint j = 0u; j < AT_ONCE; j++) {
            uint at = step + j * gl_WorkGroupSize.x;
            // Beyond the end, a rectangle without bins.
            bins[j] = at < end ? bins_of[index[j]] : 1u;
            if (at < end) {
                sorted_bins[at] = bins[j];
            }
        }
        [[unroll]] for (uint j = 0u; j < AT_ONCE; j++) {
        BinRect r = unpack_bins(bins[j]);
        for (uint y = r.first.y; y <= r.last.y; y++) {
            for (uint x = r.first.x; x <= r.last.x; x++) {
                atomicAdd(counts[min(y * uint(BINS_X) + x, uint(BIN_COUNT) - 1u)], 1u);
            }
        }
        }
    }
    barrier();
    for (uint bin = gl_LocalInvocationIndex; bin < uint(BIN_COUNT); bin += gl_WorkGroupSize.x) {
        table[bin * blocks + block] = counts[bin];
    }
}
