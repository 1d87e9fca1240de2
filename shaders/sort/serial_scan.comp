#version 460
#extension GL_GOOGLE_include_directive : require

// Second pass of a digit, serial: turns counts into places. An invocation takes one bin: its keys begin after those of all
// lower bins, and each block's after the keys of earlier blocks.

#include "serial.glsl"

layout(set = 0, binding = 0, std430) readonly buffer Args { uint args[]; };
layout(set = 0, binding = 1, std430) buffer Table { uint table[]; };
layout(set = 0, binding = 2, std430) readonly buffer Totals { uint totals[]; };

void main() {
    uint bin = invocation_index();
    if (bin > mask) {
        return;
    }
    uint place = 0u;
    for (uint lower = 0u; lower < bin; lower++) {
        place += totals[total_index(lower, 0u)];
    }
    uint blocks = blocks_of(args[ARGS_VISIBLE]);
    for (uint block = 0u; block < blocks; block++) {
        uint at = block * BINS + bin;
        uint here = table[at];
        table[at] = place;
        place += here;
    }
}
