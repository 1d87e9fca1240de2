#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_EXT_control_flow_attributes : require

// Writes the pairs of a splat and a bin in the order of the splats. Invocations take equal shares of the pairs, whatever a splat's bins.
// The key of a pair is its bin. If splats are not sorted by depth before, the bin is followed by as many bits of the depth's key as fit, and
// some more stand above the splat's index. A stable sort of the pairs then makes a list for each bin, near to far.

#include "../args.glsl"
#include "../camera.glsl"
#define KEYS_FILL_THEIR_BITS
#include "../depth_key.glsl"
#include "../groups.glsl"
#include "bins.glsl"

const uint THREADS = 256u;
layout(local_size_x = 256) in;
#include "scan.glsl"

layout(set = 0, binding = 3, std430) readonly buffer Blocks { uint block_start[]; };
layout(set = 0, binding = 4, std430) writeonly buffer PairKeys { uint pair_keys[]; };
layout(set = 0, binding = 5, std430) writeonly buffer PairSplats { uint pair_splats[]; };
#if SORTED == SORTED_SPLATS
layout(set = 0, binding = 0, std430) readonly buffer Args { uint args[]; };
layout(set = 0, binding = 1, std430) readonly buffer Order { uint order[]; };
layout(set = 0, binding = 2, std430) readonly buffer SortedBins { uint bins_of[]; };
#else
layout(set = 0, binding = 2, std430) readonly buffer Bins { uint bins_of[]; };
layout(set = 0, binding = 6, std430) readonly buffer Depth { float depth[]; };
#endif

const uint PER_THREAD = uint(PAIR_BLOCK) / THREADS;

// For each splat, the number of the block's pairs up to and including the splat's.
shared uint splat_pairs[PAIR_BLOCK];

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
    uint round = 0u;
    uint total = 0u;
    uint bins[PER_THREAD];
    [[unroll]] for (uint j = 0u; j < PER_THREAD; j++) {
        bins[j] = bins_of[min(first + j * THREADS + thread, count - 1u)];
    }
    [[unroll]] for (uint j = 0u; j < PER_THREAD; j++) {
        uint at = j * THREADS + thread;
        uint pairs = first + at < count ? bins_in(unpack_bins(bins[j])) : 0u;
        splat_pairs[at] = exclusive_sum(pairs, round++, total) + pairs;
    }
    barrier();

#if SORTED == SORTED_SPLATS
    uint start = block_start[block];
#else
    uint start = block_start[block * PER_THREAD];
#endif
    for (uint pair = thread; pair < total; pair += THREADS) {
        // The splat of the pair: the first whose number exceeds the pair's.
        uint at = 0u;
        [[unroll]] for (uint half_width = uint(PAIR_BLOCK) / 2u; half_width > 0u; half_width /= 2u) {
            at += splat_pairs[at + half_width - 1u] <= pair ? half_width : 0u;
        }
        uint within = pair - (at == 0u ? 0u : splat_pairs[at - 1u]);
        uint splat = min(first + at, count - 1u);
        BinRect r = unpack_bins(bins_of[splat]);
        uint width = r.last.x - r.first.x + 1u;
        uint row = within / width;
        uint bin = (r.first.y + row) * uint(BINS_X) + BIN_COLUMN(r.first.x + within - row * width);
        if (start + pair < uint(ENTRIES)) {
#if SORTED == SORTED_SPLATS
            pair_keys[start + pair] = bin;
            pair_splats[start + pair] = order[splat];
#else
            uint key = depth_key(depth[splat]);
            pair_keys[start + pair] = (bin << HELD_BITS) | (key >> (KEY_BITS - HELD_BITS));
#if REST_BITS > 0
            uint rest = (key >> (KEY_BITS - HELD_BITS - REST_BITS)) & ((1u << REST_BITS) - 1u);
            splat |= rest << INDEX_BITS;
#endif
            pair_splats[start + pair] = splat;
#endif
        }
    }
}
