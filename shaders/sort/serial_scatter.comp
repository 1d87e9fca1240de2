#version 460
#extension GL_GOOGLE_include_directive : require

// Third pass of a digit, serial: moves every pair to its place. An invocation takes the pairs of its block in order and
// advances its place in the bin by one each time, so the sort is stable.

#include "serial.glsl"

layout(set = 0, binding = 0, std430) readonly buffer Args { uint args[]; };
layout(set = 0, binding = 1, std430) readonly buffer KeysIn { uint keys_in[]; };
layout(set = 0, binding = 2, std430) readonly buffer ValuesIn { uint values_in[]; };
layout(set = 0, binding = 3, std430) buffer Table { uint table[]; };
layout(set = 0, binding = 4, std430) writeonly buffer KeysOut { uint keys_out[]; };
layout(set = 0, binding = 5, std430) writeonly buffer ValuesOut { uint values_out[]; };

void main() {
    uint count = args[ARGS_VISIBLE];
    uint block = invocation_index();
    if (block >= blocks_of(count)) {
        return;
    }
    uint row = block * BINS;
    uint first = block * uint(BLOCK_KEYS);
    uint end = min(first + uint(BLOCK_KEYS), count);
    for (uint i = first; i < end; i++) {
        uint key = keys_in[i];
        uint at = row + digit_of(key);
        uint place = table[at];
        table[at] = place + 1u;
        keys_out[place] = key;
        values_out[place] = values_in[i];
    }
}
