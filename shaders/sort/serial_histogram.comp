#version 460
#extension GL_GOOGLE_include_directive : require

// First pass of a digit, serial: counts each of its values per block, and in total.

#include "serial.glsl"

layout(set = 0, binding = 0, std430) readonly buffer Args { uint args[]; };
layout(set = 0, binding = 1, std430) readonly buffer KeysIn { uint keys_in[]; };
// A row per block, a column per bin, so that an invocation's counters are contiguous.
layout(set = 0, binding = 2, std430) buffer Table { uint table[]; };
layout(set = 0, binding = 3, std430) buffer Totals { uint totals[]; };

void main() {
    uint count = args[ARGS_VISIBLE];
    uint block = invocation_index();
    if (block >= blocks_of(count)) {
        return;
    }
    uint row = block * BINS;
    for (uint bin = 0u; bin < BINS; bin++) {
        table[row + bin] = 0u;
    }
    uint first = block * uint(BLOCK_KEYS);
    uint end = min(first + uint(BLOCK_KEYS), count);
    for (uint i = first; i < end; i++) {
        table[row + digit_of(keys_in[i])] += 1u;
    }
    for (uint bin = 0u; bin <= mask; bin++) {
        uint in_block = table[row + bin];
        if (in_block != 0u) {
            atomicAdd(totals[total_index(bin, 0u)], in_block);
        }
    }
}
