#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require

// Second pass of binning: turns the counts of a bin into places within its list, block after block, and finds the length of
// the list. One workgroup takes one bin.

#include "../args.glsl"
#include "../groups.glsl"
#define SCAN_THREADS 256
#include "scan.glsl"

layout(set = 0, binding = 0, std430) readonly buffer Args { uint args[]; };
layout(set = 0, binding = 1, std430) buffer Table { uint table[]; };
layout(set = 0, binding = 2, std430) writeonly buffer Lengths { uint lengths[]; };

const uint PER_THREAD = 8u;

void main() {
    uint bin = group_index();
    if (bin >= uint(BIN_COUNT)) {
        return;
    }
    uint thread = thread_index();
    uint blocks = (args[ARGS_DRAWN] + uint(BLOCK_SPLATS) - 1u) / uint(BLOCK_SPLATS);
    uint row = bin * blocks;
    uint length = 0u;
    uint round = 0u;
    for (uint start = 0u; start < blocks; start += THREADS * PER_THREAD) {
        uint at = start + thread * PER_THREAD;
        uint count[PER_THREAD];
        uint sum = 0u;
        for (uint j = 0u; j < PER_THREAD; j++) {
            count[j] = at + j < blocks ? table[row + at + j] : 0u;
            sum += count[j];
        }
        uint next = exclusive_sum(sum, round, length);
        for (uint j = 0u; j < PER_THREAD; j++) {
            if (at + j < blocks) {
                table[row + at + j] = next;
            }
            next += count[j];
        }
        round++;
    }
    if (thread == 0u) {
        lengths[bin] = length;
    }
}
