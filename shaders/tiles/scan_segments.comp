#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_EXT_control_flow_attributes : require

// Last pass of binning: numbers the segments of all lists, by an exclusive scan in one workgroup. Word BIN_COUNT is their sum, which
// determines the workgroups of the rasteriser. Segments that are to be composited, those of lists with more than one, are numbered
// once more: these numbers are the places of their sums.

#include "../fold_groups.glsl"
#include "bins.glsl"
#include "segments.glsl"
#include "scan.glsl"

layout(set = 0, binding = 0, std430) readonly buffer Starts { uint starts[]; };
layout(set = 0, binding = 1, std430) writeonly buffer Segments { uint segment_starts[]; };
layout(set = 0, binding = 2, std430) writeonly buffer Places { uint sum_places[]; };
// An indirect dispatch: a workgroup for each segment.
layout(set = 0, binding = 3, std430) writeonly buffer Groups { uint groups[]; };

const uint PER_THREAD = 8u;

void main() {
    uint segments = 0u;
    uint places = 0u;
    uint round = 0u;
    for (uint first = 0u; first < uint(BIN_COUNT); first += THREADS * PER_THREAD) {
        uint at = first + thread_index() * PER_THREAD;
        uint start[PER_THREAD + 1u];
        [[unroll]] for (uint j = 0u; j <= PER_THREAD; j++) {
            start[j] = starts[min(at + j, uint(BIN_COUNT))];
        }
        uint count[PER_THREAD];
        uint sum = 0u;
        uint composited = 0u;
        [[unroll]] for (uint j = 0u; j < PER_THREAD; j++) {
            count[j] = segments_of(start[j + 1u] - start[j]);
            sum += count[j];
            composited += count[j] > 1u ? count[j] : 0u;
        }
        uint before = exclusive_sum(sum, round++, segments);
        uint place = exclusive_sum(composited, round++, places);
        [[unroll]] for (uint j = 0u; j < PER_THREAD; j++) {
            if (at + j < uint(BIN_COUNT)) {
                segment_starts[at + j] = before;
                sum_places[at + j] = place;
            }
            before += count[j];
            place += count[j] > 1u ? count[j] : 0u;
        }
    }
    if (thread_index() == 0u) {
        segment_starts[BIN_COUNT] = segments;
        uvec3 folded = fold_groups(segments);
        groups[0] = folded.x;
        groups[1] = folded.y;
        groups[2] = folded.z;
    }
}
