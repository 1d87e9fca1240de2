#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_EXT_control_flow_attributes : require

// Third pass of binning: places the bins' lists one after the other, by an exclusive scan of their lengths in one workgroup, and
// likewise their segments. Word BIN_COUNT of a scan is the sum: of the lists, all entries that the frame needs, which may be more
// than the buffer holds.

#include "bins.glsl"
#include "segments.glsl"
#define SCAN_THREADS 256
#include "scan.glsl"

layout(set = 0, binding = 0, std430) readonly buffer Lengths { uint lengths[]; };
layout(set = 0, binding = 1, std430) writeonly buffer Starts { uint starts[]; };
layout(set = 0, binding = 2, std430) writeonly buffer Segments { uint segment_starts[]; };
// An indirect dispatch: a workgroup for each segment.
layout(set = 0, binding = 3, std430) writeonly buffer Groups { uint groups[]; };

const uint PER_THREAD = 4u;

void main() {
    uint entries = 0u;
    uint segments = 0u;
    uint round = 0u;
    for (uint first = 0u; first < uint(BIN_COUNT); first += THREADS * PER_THREAD) {
        uint at = first + thread_index() * PER_THREAD;
        uint length[PER_THREAD];
        uint sum = 0u;
        [[unroll]] for (uint j = 0u; j < PER_THREAD; j++) {
            length[j] = at + j < uint(BIN_COUNT) ? lengths[at + j] : 0u;
            sum += length[j];
        }
        uint start = exclusive_sum(sum, round++, entries);
        // The segments of each bin; what does not fit is left out.
        uint count[PER_THREAD];
        sum = 0u;
        [[unroll]] for (uint j = 0u; j < PER_THREAD; j++) {
            uint end = start + length[j];
            count[j] = segments_of(min(end, uint(ENTRIES)) - min(start, uint(ENTRIES)));
            sum += count[j];
            if (at + j < uint(BIN_COUNT)) {
                starts[at + j] = start;
            }
            start = end;
        }
        uint before = exclusive_sum(sum, round++, segments);
        [[unroll]] for (uint j = 0u; j < PER_THREAD; j++) {
            if (at + j < uint(BIN_COUNT)) {
                segment_starts[at + j] = before;
            }
            before += count[j];
        }
    }
    if (thread_index() == 0u) {
        starts[BIN_COUNT] = entries;
        segment_starts[BIN_COUNT] = segments;
        uint x = min(segments, uint(DEVICE_MAX_GROUPS_X));
        groups[0] = x;
        groups[1] = x == 0u ? 1u : (segments + x - 1u) / x;
        groups[2] = 1u;
    }
}
