#version 460
#extension GL_GOOGLE_include_directive : require

// Third pass of binning, serial: counts, for each block of pairs, how many of them are in each bin.

#include "../args.glsl"
#include "serial.glsl"

layout(set = 0, binding = 0, std430) readonly buffer Args { uint args[]; };
layout(set = 0, binding = 1, std430) readonly buffer Runs { uint runs[]; };
layout(set = 0, binding = 2, std430) readonly buffer Work { uint work[]; };
layout(set = 0, binding = 3, std430) readonly buffer SortedBins { uint sorted_bins[]; };
// A row per block, a column per bin; all 0 before.
layout(set = 0, binding = 4, std430) buffer Table { uint table[]; };

#include "serial_walk.glsl"

void main() {
    uint block = invocation_index();
    if (block >= work[WORK_BLOCKS]) {
        return;
    }
    uint count = args[ARGS_DRAWN];
    uint pair = block * work[WORK_BLOCK_PAIRS];
    uint end = min(pair + work[WORK_BLOCK_PAIRS], work[WORK_PAIRS]);
    uint row = block * uint(BIN_COUNT);
    Walk w = walk_from(pair, count);
    do {
        table[row + bin_index(w.bin)] += 1u;
        pair++;
        walk_on(w, count);
    } while (pair < end);
}
