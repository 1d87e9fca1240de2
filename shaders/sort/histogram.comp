#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_EXT_control_flow_attributes : require

// First pass of a digit: counts each of its values per block, and in total.

#include "block.glsl"

layout(set = 0, binding = 0, std430) readonly buffer Args { uint args[]; };
layout(set = 0, binding = 1, std430) readonly buffer KeysIn { uint keys_in[]; };
// A row per bin, a column per block.
layout(set = 0, binding = 2, std430) writeonly buffer Table { uint table[]; };
layout(set = 0, binding = 3, std430) buffer Totals { uint totals[]; };

shared uint counts[BINS];

void main() {
    uint count = args[ARGS_VISIBLE];
    uint blocks = blocks_of(count);
    uint block = group_index();
    if (block >= blocks) {
        return;
    }
    uint thread = thread_index();
    uint first = block * uint(BLOCK_KEYS);
    uint end = min(first + uint(BLOCK_KEYS), count);

    for (uint bin = thread; bin < BINS; bin += THREADS) {
        counts[bin] = 0u;
    }

    uint bins[STEPS];
    [[unroll]] for (uint i = 0u; i < STEPS; i++) {
        uint at = first + i * THREADS + thread;
        bins[i] = at < end ? digit_of(keys_in[at]) : BINS;  // beyond the end, a bin that does not exist
    }
    barrier();
    [[unroll]] for (uint i = 0u; i < STEPS; i++) {
        if (bins[i] < BINS) {
            atomicAdd(counts[bins[i]], 1u);
        }
    }
    barrier();

    for (uint bin = thread; bin < BINS; bin += THREADS) {
        uint in_block = counts[bin];
        table[bin * blocks + block] = in_block;
        if (in_block != 0u) {
            atomicAdd(totals[total_index(bin, block % uint(TOTAL_PARTS))], in_block);
        }
    }
}
