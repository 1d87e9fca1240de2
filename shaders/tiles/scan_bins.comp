#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_EXT_control_flow_attributes : require

// Third pass of binning: places the bins' lists one after the other, by an exclusive scan of their lengths in one workgroup, and
// likewise the segments of each phase. Word BIN_COUNT of a scan is the sum: of the lists, all entries that the frame needs, which
// may be more than the buffer holds.

#include "bins.glsl"
#include "segments.glsl"
#define SCAN_THREADS 256
#include "scan.glsl"

layout(set = 0, binding = 0, std430) readonly buffer Lengths { uint lengths[]; };
layout(set = 0, binding = 1, std430) writeonly buffer Starts { uint starts[]; };
// A row per phase.
layout(set = 0, binding = 2, std430) writeonly buffer Segments { uint segment_starts[]; };
// An indirect dispatch per phase: a workgroup for each segment.
layout(set = 0, binding = 3, std430) writeonly buffer Groups { uint groups[]; };

// The cells of each bin that let light through: all.
layout(set = 0, binding = 4, std430) writeonly buffer Open { uint open_cells[]; };

const uint PER_THREAD = 4u;
const uint ROW = uint(BIN_COUNT) + 1u;

void main() {
    uint total = 0u;
    uint segments[PHASES];
    for (uint phase = 0u; phase < uint(PHASES); phase++) {
        segments[phase] = 0u;
    }
    uint round = 0u;
    for (uint first = 0u; first < uint(BIN_COUNT); first += THREADS * PER_THREAD) {
        uint at = first + thread_index() * PER_THREAD;
        uint length[PER_THREAD];
        uint sum = 0u;
        [[unroll]] for (uint j = 0u; j < PER_THREAD; j++) {
            length[j] = at + j < uint(BIN_COUNT) ? lengths[at + j] : 0u;
            sum += length[j];
        }
        uint start = exclusive_sum(sum, round++, total);
        // The segments of each bin; what does not fit is left out.
        uint count[PER_THREAD];
        [[unroll]] for (uint j = 0u; j < PER_THREAD; j++) {
            uint end = start + length[j];
            count[j] = segments_of(min(end, uint(ENTRIES)) - min(start, uint(ENTRIES)));
            if (at + j < uint(BIN_COUNT)) {
                starts[at + j] = start;
                open_cells[2u * (at + j)] = 0xffffffffu;
                open_cells[2u * (at + j) + 1u] = 0xffffffffu;
            }
            start = end;
        }
        for (uint phase = 0u; phase < uint(PHASES); phase++) {
            uint in_phase = 0u;
            [[unroll]] for (uint j = 0u; j < PER_THREAD; j++) {
                in_phase += first_segment(count[j], phase + 1u) - first_segment(count[j], phase);
            }
            uint before = exclusive_sum(in_phase, round++, segments[phase]);
            [[unroll]] for (uint j = 0u; j < PER_THREAD; j++) {
                if (at + j < uint(BIN_COUNT)) {
                    segment_starts[phase * ROW + at + j] = before;
                }
                before += first_segment(count[j], phase + 1u) - first_segment(count[j], phase);
            }
        }
    }
    if (thread_index() == 0u) {
        starts[BIN_COUNT] = total;
        for (uint phase = 0u; phase < uint(PHASES); phase++) {
            segment_starts[phase * ROW + uint(BIN_COUNT)] = segments[phase];
            uint x = min(segments[phase], uint(DEVICE_MAX_GROUPS_X));
            groups[4u * phase] = x;
            groups[4u * phase + 1u] = x == 0u ? 1u : (segments[phase] + x - 1u) / x;
            groups[4u * phase + 2u] = 1u;
            groups[4u * phase + 3u] = segments[phase];
        }
    }
}
