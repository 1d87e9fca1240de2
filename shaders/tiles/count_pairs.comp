#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_EXT_control_flow_attributes : require

// First pass of binning: counts the pairs of a splat and a bin that it may touch, for each block of PAIR_BLOCK splats. If splats are
// sorted by depth before, blocks are of that order, and the bins of a splat are copied to its place in it.

#include "../args.glsl"
#include "../groups.glsl"
#include "bins.glsl"

const uint THREADS = 256u;
layout(local_size_x = 256) in;
#include "scan.glsl"

layout(set = 0, binding = 2, std430) readonly buffer Bins { uint bins_of[]; };
#if SORTED == SORTED_SPLATS
layout(set = 0, binding = 0, std430) readonly buffer Args { uint args[]; };
layout(set = 0, binding = 1, std430) readonly buffer Order { uint order[]; };
layout(set = 0, binding = 3, std430) writeonly buffer SortedBins { uint sorted_bins[]; };
#endif
layout(set = 0, binding = 4, std430) writeonly buffer Blocks { uint block_pairs[]; };

const uint PER_THREAD = uint(PAIR_BLOCK) / THREADS;

void main() {
#if SORTED == SORTED_SPLATS
    uint count = args[ARGS_DRAWN];
#else
    uint count = uint(SCENE_COUNT);
#endif
    uint block = group_index();
    uint first = block * uint(PAIR_BLOCK);
    if (first >= count) {
        return;
    }
    uint thread = thread_index();
    // All loads before the first is needed, so that an invocation waits for memory twice.
    uint index[PER_THREAD];
    [[unroll]] for (uint j = 0u; j < PER_THREAD; j++) {
        uint at = first + j * THREADS + thread;
#if SORTED == SORTED_SPLATS
        index[j] = at < count ? order[at] : 0u;
#else
        index[j] = min(at, count - 1u);
#endif
    }
    uint bins[PER_THREAD];
    [[unroll]] for (uint j = 0u; j < PER_THREAD; j++) {
        bins[j] = bins_of[index[j]];
    }
    uint pairs = 0u;
    [[unroll]] for (uint j = 0u; j < PER_THREAD; j++) {
        uint at = first + j * THREADS + thread;
        if (at < count) {
#if SORTED == SORTED_SPLATS
            sorted_bins[at] = bins[j];
#endif
            pairs += bins_in(unpack_bins(bins[j]));
        }
    }
    uint total = 0u;
    exclusive_sum(pairs, 0u, total);
    if (thread == 0u) {
        block_pairs[block] = total;
    }
}
