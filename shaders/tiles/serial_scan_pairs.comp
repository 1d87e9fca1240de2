#version 460
#extension GL_GOOGLE_include_directive : require

// Second pass of binning, serial: turns the number of pairs of each run into the place of its first pair, in one invocation, and
// cuts all pairs into blocks.

#include "../args.glsl"
#include "serial.glsl"

layout(set = 0, binding = 0, std430) readonly buffer Args { uint args[]; };
layout(set = 0, binding = 1, std430) buffer Runs { uint runs[]; };
layout(set = 0, binding = 2, std430) writeonly buffer Work { uint work[]; };
// The tiles that the rasteriser's first pass leaves to the next: none yet. See serial_deep.comp.
layout(set = 0, binding = 3, std430) writeonly buffer Deep { uint deep[]; };

void main() {
    if (invocation_index() != 0u) {
        return;
    }
    uint count = (args[ARGS_DRAWN] + uint(RUN_SPLATS) - 1u) / uint(RUN_SPLATS);
    uint pairs = 0u;
    for (uint run = 0u; run < count; run++) {
        uint here = runs[run];
        runs[run] = pairs;
        // A count beyond 32 bits exceeds the lists in any case.
        pairs = min(pairs, 0x7fffffffu) + min(here, 0x7fffffffu);
    }
    uint block_pairs = clamp((pairs + uint(FEW_BLOCKS) - 1u) / uint(FEW_BLOCKS), 256u, uint(MOST_BLOCK_PAIRS));
    uint blocks = min((pairs + block_pairs - 1u) / block_pairs, uint(MOST_BLOCKS));
    work[WORK_GROUPS] = (blocks + gl_WorkGroupSize.x - 1u) / gl_WorkGroupSize.x;
    work[WORK_GROUPS + 1u] = 1u;
    work[WORK_GROUPS + 2u] = 1u;
    work[WORK_BLOCK_PAIRS] = block_pairs;
    work[WORK_BLOCKS] = blocks;
    work[WORK_PAIRS] = pairs;
    deep[0] = 0u;
    deep[1] = 0u;
    deep[2] = 0u;
    deep[3] = 0u;
}
