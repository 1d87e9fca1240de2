#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require

// Third pass of binning: places the bins' lists one after the other, by an exclusive scan of their lengths in one workgroup.
// Word BIN_COUNT is the end of the last list: all entries that the frame needs, which may be more than the buffer holds.

#include "scan.glsl"

layout(set = 0, binding = 0, std430) readonly buffer Lengths { uint lengths[]; };
layout(set = 0, binding = 1, std430) writeonly buffer Starts { uint starts[]; };

const uint PER_THREAD = (uint(BIN_COUNT) + THREADS - 1u) / THREADS;

void main() {
    uint at = thread_index() * PER_THREAD;
    uint count[PER_THREAD];
    uint sum = 0u;
    for (uint j = 0u; j < PER_THREAD; j++) {
        count[j] = at + j < uint(BIN_COUNT) ? lengths[at + j] : 0u;
        sum += count[j];
    }
    uint total = 0u;
    uint next = exclusive_sum(sum, 0u, total);
    for (uint j = 0u; j < PER_THREAD; j++) {
        if (at + j < uint(BIN_COUNT)) {
            starts[at + j] = next;
        }
        next += count[j];
    }
    if (at == 0u) {
        starts[BIN_COUNT] = total;
    }
}
