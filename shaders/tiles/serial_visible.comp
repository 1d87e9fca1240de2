#version 460
#extension GL_GOOGLE_include_directive : require

// Counts the visible splats of each block of 256, one block per invocation; other projections count them themselves.

#include "serial_lanes.glsl"

layout(set = 0, binding = 0, std430) readonly buffer Depth { float depth[]; };
layout(set = 0, binding = 1, std430) writeonly buffer BlockCount { uint block_count[]; };

void main() {
    uint block = invocation_index();
    uint i = block * 256u;
    if (i >= uint(SCENE_COUNT)) {
        return;
    }
    uint end = min(i + 256u, uint(SCENE_COUNT));
    uint count = 0u;
    do {
        count += depth[i] > 0.0 ? 1u : 0u;
        i++;
    } while (i < end);
    block_count[block] = count;
}
