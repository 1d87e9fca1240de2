#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_EXT_control_flow_attributes : require

// Third pass of binning: writes the pairs, near to far. They are dealt to the invocations in order, whatever the number of bins of
// each splat. A stable sort by bin then makes a list for each bin, which is still near to far.

#include "../args.glsl"
#include "../groups.glsl"
#include "bins.glsl"
#define SCAN_THREADS 256
#include "scan.glsl"

layout(set = 0, binding = 0, std430) readonly buffer Args { uint args[]; };
layout(set = 0, binding = 1, std430) readonly buffer Order { uint order[]; };
layout(set = 0, binding = 2, std430) readonly buffer SortedBins { uint sorted_bins[]; };
layout(set = 0, binding = 3, std430) readonly buffer Blocks { uint block_start[]; };
layout(set = 0, binding = 4, std430) writeonly buffer PairBins { uint pair_bins[]; };
layout(set = 0, binding = 5, std430) writeonly buffer PairSplats { uint pair_splats[]; };

const uint PER_THREAD = uint(PAIR_BLOCK) / THREADS;

// Of each splat of the block: index, bins, and the pairs up to and with it.
shared uint splat_index[PAIR_BLOCK];
shared uint splat_bins[PAIR_BLOCK];
shared uint splat_pairs[PAIR_BLOCK];

void main() {
    uint count = args[ARGS_DRAWN];
    uint block = group_index();
    uint first = block * uint(PAIR_BLOCK);
    if (first >= count) {
        return;
    }
    uint thread = thread_index();
    uint round = 0u;
    uint total = 0u;
    uint index[PER_THREAD];
    uint bins[PER_THREAD];
    [[unroll]] for (uint j = 0u; j < PER_THREAD; j++) {
        uint at = first + j * THREADS + thread;
        index[j] = at < count ? order[at] : 0u;
        bins[j] = at < count ? sorted_bins[at] : 1u;
    }
    [[unroll]] for (uint j = 0u; j < PER_THREAD; j++) {
        uint at = j * THREADS + thread;
        uint pairs = first + at < count ? bins_in(unpack_bins(bins[j])) : 0u;
        splat_index[at] = index[j];
        splat_bins[at] = bins[j];
        splat_pairs[at] = exclusive_sum(pairs, round++, total) + pairs;
    }
    barrier();

    uint start = block_start[block];
    for (uint pair = thread; pair < total; pair += THREADS) {
        // The splat of the pair: the first whose pairs go beyond it.
        uint at = 0u;
        [[unroll]] for (uint half_width = uint(PAIR_BLOCK) / 2u; half_width > 0u; half_width /= 2u) {
            at += splat_pairs[at + half_width - 1u] <= pair ? half_width : 0u;
        }
        BinRect r = unpack_bins(splat_bins[at]);
        uint within = pair - (at == 0u ? 0u : splat_pairs[at - 1u]);
        uint width = r.last.x - r.first.x + 1u;
        uint row = within / width;
        if (start + pair < uint(ENTRIES)) {
            pair_bins[start + pair] = (r.first.y + row) * uint(BINS_X) + r.first.x + within - row * width;
            pair_splats[start + pair] = splat_index[at];
        }
    }
}
