#version 460
#extension GL_GOOGLE_include_directive : require

// Fourth pass of binning, serial: turns the counts of a bin into places within its list, block after block, and finds the length
// of the list. An invocation takes one bin.

#include "serial.glsl"

layout(set = 0, binding = 0, std430) readonly buffer Work { uint work[]; };
layout(set = 0, binding = 1, std430) buffer Table { uint table[]; };
layout(set = 0, binding = 2, std430) writeonly buffer Lengths { uint lengths[]; };

void main() {
    uint bin = invocation_index();
    if (bin >= uint(BIN_COUNT)) {
        return;
    }
    uint end = work[WORK_BLOCKS] * uint(BIN_COUNT);
    uint length = 0u;
    for (uint at = bin; at < end; at += uint(BIN_COUNT)) {
        uint here = table[at];
        table[at] = length;
        length += here;
    }
    lengths[bin] = length;
}
