#version 460
#extension GL_GOOGLE_include_directive : require

// Compacts the visible splats like compact.comp, with the same result, one block of 256 per invocation.

#include "../camera.glsl"
#include "../depth_key.glsl"
#include "serial_lanes.glsl"

layout(set = 0, binding = 0, std430) readonly buffer Depth { float depth[]; };
layout(set = 0, binding = 1, std430) readonly buffer BlockOffset { uint block_offset[]; };
layout(set = 0, binding = 2, std430) writeonly buffer Keys { uint keys[]; };
layout(set = 0, binding = 3, std430) writeonly buffer Order { uint order[]; };

void main() {
    uint block = invocation_index();
    uint i = block * 256u;
    if (i >= uint(SCENE_COUNT)) {
        return;
    }
    uint end = min(i + 256u, uint(SCENE_COUNT));
    uint place = block_offset[block];
    do {
        float z = depth[i];
        if (z > 0.0) {
            keys[place] = depth_key(z);
            order[place] = i;
            place++;
        }
        i++;
    } while (i < end);
}
