#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_EXT_control_flow_attributes : require

// Last pass of binning: numbers the further segments (all but the first of each list) and the bins that have them, by an exclusive scan. A
// workgroup adds up the counts of all bins before its own, which takes less time than waiting for other workgroups.

#include "../fold_groups.glsl"
#include "bins.glsl"
#include "segments.glsl"

const uint THREADS = uint(SCAN_THREADS);
layout(local_size_x = SCAN_THREADS) in;
#include "scan.glsl"

layout(set = 0, binding = 0, std430) readonly buffer Ranges { uvec2 ranges[]; };
// The number of each bin's second segment. Word BIN_COUNT is the count of all further segments.
layout(set = 0, binding = 1, std430) writeonly buffer Further { uint further[]; };
// The bins with several segments, by number; and the number of each such bin.
layout(set = 0, binding = 2, std430) writeonly buffer Composited { uint composited_bins[]; };
layout(set = 0, binding = 4, std430) writeonly buffer Numbers { uint numbers[]; };
// Two indirect dispatches, for all segments and for the pixels of bins with several segments; then the number of these bins.
layout(set = 0, binding = 3, std430) writeonly buffer Groups { uint groups[]; };

void write_groups(uint at, uint count) {
    uvec3 folded = fold_groups(count);
    groups[at] = folded.x;
    groups[at + 1u] = folded.y;
    groups[at + 2u] = folded.z;
}

// Bins per invocation; tiled.ron divides by it.
const uint PER_THREAD = 2u;

// Returns the number of a bin's further segments; 0 beyond the last bin.
uint further_of(uint bin) {
    uvec2 range = ranges[min(bin, uint(BIN_COUNT) - 1u)];
    return bin < uint(BIN_COUNT) ? segments_of(range.y - range.x) - 1u : 0u;
}

void main() {
    uint thread = thread_index();
    uint first = gl_WorkGroupID.x * THREADS * PER_THREAD;
    uint segments = 0u;
    uint bins = 0u;
    uint round = 0u;
    if (first > 0u) {
        uint sum = 0u;
        uint several = 0u;
        for (uint bin = thread; bin < first; bin += THREADS) {
            uint count = further_of(bin);
            sum += count;
            several += min(count, 1u);
        }
        exclusive_sum(sum, round++, segments);
        exclusive_sum(several, round++, bins);
    }
    uint at = first + thread * PER_THREAD;
    uint count[PER_THREAD];
    uint sum = 0u;
    uint several = 0u;
    [[unroll]] for (uint j = 0u; j < PER_THREAD; j++) {
        count[j] = further_of(at + j);
        sum += count[j];
        several += min(count[j], 1u);
    }
    uint before = exclusive_sum(sum, round++, segments);
    uint number = exclusive_sum(several, round++, bins);
    [[unroll]] for (uint j = 0u; j < PER_THREAD; j++) {
        if (at + j < uint(BIN_COUNT)) {
            further[at + j] = before;
        }
        before += count[j];
        if (count[j] > 0u) {
            composited_bins[number] = at + j;
            numbers[at + j] = number;
            number++;
        }
    }
    if (thread == 0u && gl_WorkGroupID.x == gl_NumWorkGroups.x - 1u) {
        further[BIN_COUNT] = segments;
        write_groups(0u, uint(BIN_COUNT) + segments);
        write_groups(3u, bins * (BIN_PIXELS / 256u));
        groups[6] = bins;
    }
}
