#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_EXT_control_flow_attributes : require

// Counts the pairs of a splat and a bin that it may touch, for each block of PAIR_BLOCK splats in depth order. Copies the bins of
// a splat to its position in this order.

#include "../args.glsl"
#include "../groups.glsl"
#include "bins.glsl"

const uint THREADS = 256u;
layout(local_size_x = 256) in;
#include "scan.glsl"

layout(set = 0, binding = 2, std430) readonly buffer Bins { uint bins_of[]; };
layout(set = 0, binding = 0, std430) readonly buffer Args { uint args[]; };
layout(set = 0, binding = 1, std430) readonly buffer Order { uint order[]; };
layout(set = 0, binding = 3, std430) writeonly buffer SortedBins { uint sorted_bins[]; };
layout(set = 0, binding = 4, std430) writeonly buffer Blocks { uint block_pairs[]; };

const uint PER_THREAD = uint(PAIR_BLOCK) / THREADS;

void main() {
    uint count = args[ARGS_DRAWN];
    uint block = group_index();
    uint first = block * uint(PAIR_BLOCK);
    if (first >= count) {
        return;
    }
    uint thread = thread_index();
    // All loads come before their first use, so that an invocation waits for memory only twice.
    uint index[PER_THREAD];
    [[unroll]] for (uint j = 0u; j < PER_THREAD; j++) {
        uint at = first + j * THREADS + thread;
        index[j] = at < count ? order[at] : 0u;
    }
    uint bins[PER_THREAD];
    [[unroll]] for (uint j = 0u; j < PER_THREAD; j++) {
        bins[j] = bins_of[index[j]];
    }
    uint pairs = 0u;
    [[unroll]] for (uint j = 0u; j < PER_THREAD; j++) {
        uint at = first + j * THREADS + thread;
        if (at < count) {
            sorted_bins[at] = bins[j];
            pairs += bins_in(unpack_bins(bins[j]));
        }
    }
    uint total = 0u;
    exclusive_sum(pairs, 0u, total);
    if (thread == 0u) {
        block_pairs[block] = total;
    }
}
