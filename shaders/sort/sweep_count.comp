#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_EXT_control_flow_attributes : require

// First pass of the one-sweep sort: counts the values of every digit while reading the keys once, and clears the first digit's table.

#include "sweep.glsl"

layout(set = 0, binding = 0, std430) readonly buffer Args { uint args[]; };
layout(set = 0, binding = 1, std430) readonly buffer KeysIn { uint keys_in[]; };
layout(set = 0, binding = 2, std430) writeonly buffer Table { uint table[]; };
layout(set = 0, binding = 3, std430) buffer Totals { uint totals[]; };

// Copies of each counter, used by lanes cyclically: depths share high digits in many lanes, and additions to one word are serialised.
const uint COPIES = uint(DIGITS) * BINS <= 2048u ? 2u : 1u;
shared uint counts[uint(DIGITS) * BINS * COPIES];
// Workgroups that count. With more blocks than that, each counts several, and so adds to the totals less often.
const uint MOST_GROUPS = 512u;

void main() {
    uint count = args[ARGS_VISIBLE];
    uint blocks = blocks_of(count);
    uint each = (blocks + MOST_GROUPS - 1u) / MOST_GROUPS;
    uint first_block = group_index() * each;
    // For higher indices, `first_block` may overflow.
    if (group_index() >= MOST_GROUPS || first_block >= blocks) {
        return;
    }
    uint last_block = min(first_block + each, blocks);
    uint thread = thread_index();
    uint copy = thread % COPIES;
    for (uint i = thread; i < uint(DIGITS) * BINS * COPIES; i += THREADS) {
        counts[i] = 0u;
    }
    for (uint at = first_block * BINS + thread; at < last_block * BINS; at += THREADS) {
        table[at] = 0u;
    }
    barrier();
    // Bits above the key's width are not digits.
    uint width = uint(KEY_BITS - FIRST_BIT);
    for (uint block = first_block; block < last_block; block++) {
        uint first = block * uint(BLOCK_KEYS);
        uint end = min(first + uint(BLOCK_KEYS), count);
        [[unroll]] for (uint i = 0u; i < STEPS; i++) {
            uint at = first + i * THREADS + thread;
            if (at < end) {
                uint key = bitfieldExtract(keys_in[at], FIRST_BIT, int(width));
                [[unroll]] for (uint d = 0u; d < uint(DIGITS); d++) {
                    uint bin = (key >> (d * uint(DIGIT_BITS))) & (BINS - 1u);
                    atomicAdd(counts[(d * BINS + bin) * COPIES + copy], 1u);
                }
            }
        }
    }
    barrier();
    for (uint i = thread; i < uint(DIGITS) * BINS; i += THREADS) {
        uint here = 0u;
        [[unroll]] for (uint c = 0u; c < COPIES; c++) {
            here += counts[i * COPIES + c];
        }
        if (here != 0u) {
            atomicAdd(totals[(i / BINS) * (BINS * uint(TOTAL_PARTS)) + (group_index() % uint(TOTAL_PARTS)) * BINS + i % BINS], here);
        }
    }
}
