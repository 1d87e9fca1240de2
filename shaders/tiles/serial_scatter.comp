#version 460
#extension GL_GOOGLE_include_directive : require

// Last pass of binning, serial: writes the lists. An invocation takes the pairs of its block in order and advances its place in the
// bin's list by one each time, so lists are near to far and deterministic.

#include "../args.glsl"
#include "serial.glsl"

layout(set = 0, binding = 0, std430) readonly buffer Args { uint args[]; };
layout(set = 0, binding = 1, std430) readonly buffer Runs { uint runs[]; };
layout(set = 0, binding = 2, std430) readonly buffer Work { uint work[]; };
layout(set = 0, binding = 3, std430) readonly buffer SortedBins { uint sorted_bins[]; };
layout(set = 0, binding = 4, std430) readonly buffer Order { uint order[]; };
layout(set = 0, binding = 5, std430) readonly buffer Ranges { uvec2 ranges[]; };
layout(set = 0, binding = 6, std430) buffer Table { uint table[]; };
layout(set = 0, binding = 7, std430) writeonly buffer Lists { uint lists[]; };

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
    uint index = order[w.splat];
    do {
        uint bin = bin_index(w.bin);
        uint rank = table[row + bin];
        table[row + bin] = rank + 1u;
        uint place = ranges[bin].x + rank;
        if (place < uint(ENTRIES)) {
            lists[place] = index;
        }
        pair++;
        walk_on(w, count);
        index = order[w.splat];
    } while (pair < end);
}
