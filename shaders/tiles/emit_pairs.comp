#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_EXT_control_flow_attributes : require

// Writes the pairs of a splat and a bin in the order of depth.

#include "../args.glsl"
#include "../groups.glsl"
#include "bins.glsl"

const uint THREADS = 256u;
layout(local_size_x = 256) in;
#include "scan.glsl"

layout(set = 0, binding = 0, std430) readonly buffer Args { uint args[]; };
layout(set = 0, binding = 1, std430) readonly buffer Order { uint order[]; };
layout(set = 0, binding = 2, std430) readonly buffer SortedBins { uint bins_of[]; };
layout(set = 0, binding = 3, std430) readonly buffer Blocks { uint block_start[]; };

const uint BLOCK = uint(PAIR_BLOCK);
const uint PER_THREAD = BLOCK / THREADS;
#include "emit.glsl"

void main() {
    uint count = args[ARGS_DRAWN];
    uint block = group_index();
    uint first = block * BLOCK;
    if (first >= count) {
        return;
    }
    uint thread = thread_index();
    uint bins[PER_THREAD];
    [[unroll]] for (uint j = 0u; j < PER_THREAD; j++) {
        uint at = j * THREADS + thread;
        uint splat = min(first + at, count - 1u);
        bins[j] = bins_of[splat];
        splat_word[at] = order[splat];
    }
    uint total = 0u;
    [[unroll]] for (uint j = 0u; j < PER_THREAD; j++) {
        uint at = j * THREADS + thread;
        uint pairs = first + at < count ? bins_in(unpack_bins(bins[j])) : 0u;
        splat_ends[at] = exclusive_sum(pairs, j, total) + pairs;
        splat_bins[at] = bins[j];
    }
    barrier();
    write_pairs(block_start[block], total);
}
