#version 460
#extension GL_GOOGLE_include_directive : require

// Fills the buffer to copy, once, with varying contents: constant contents could be compressed in transit.

#include "../groups.glsl"

layout(local_size_x = 256) in;

layout(set = 0, binding = 0, std430) writeonly buffer From { uvec4 from[]; };

void main() {
    uint i = group_index() * gl_WorkGroupSize.x + gl_LocalInvocationIndex;
    if (i < uint(VECTORS)) {
        from[i] = (4u * i + uvec4(0u, 1u, 2u, 3u)) * 0x9e3779b9u ^ 0x7feb352du;
    }
}
