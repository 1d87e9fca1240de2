#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require

// Second pass of a digit: turns counts into places. One workgroup takes one bin: its keys begin after those of all lower
// bins, and each block's after the keys of earlier blocks.

#include "block.glsl"
#include "../workgroup_sum.glsl"

layout(set = 0, binding = 0, std430) readonly buffer Args { uint args[]; };
layout(set = 0, binding = 1, std430) buffer Table { uint table[]; };
layout(set = 0, binding = 2, std430) readonly buffer Totals { uint totals[]; };

const uint PER_THREAD = 8u;

void main() {
    uint bin = group_index();
    if (bin > mask) {
        return;
    }
    uint total = 0u;
    for (uint part = 0u; part < uint(TOTAL_PARTS); part++) {
        total += totals[total_index(bin, part)];
    }
    if (total == 0u) {
        return;  // no key is in this bin, so its places are not read
    }

    uint thread = thread_index();
    uint lower = 0u;
    for (uint b = thread; b < bin; b += THREADS) {
        for (uint part = 0u; part < uint(TOTAL_PARTS); part++) {
            lower += totals[total_index(b, part)];
        }
    }
    uint place = 0u;
    exclusive_sum(lower, 0u, place);

    uint blocks = blocks_of(args[ARGS_VISIBLE]);
    uint row = bin * blocks;
    uint round = 1u;
    for (uint start = 0u; start < blocks; start += THREADS * PER_THREAD) {
        uint at = start + thread * PER_THREAD;
        uint count[PER_THREAD];
        uint sum = 0u;
        for (uint j = 0u; j < PER_THREAD; j++) {
            count[j] = at + j < blocks ? table[row + at + j] : 0u;
        }
        for (uint j = 0u; j < PER_THREAD; j++) {
            sum += count[j];
        }
        uint next = exclusive_sum(sum, round, place);
        for (uint j = 0u; j < PER_THREAD; j++) {
            if (at + j < blocks) {
                table[row + at + j] = next;
            }
            next += count[j];
        }
        round++;
    }
}
