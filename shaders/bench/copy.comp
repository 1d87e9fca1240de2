#version 460
#extension GL_GOOGLE_include_directive : require

// Copies 16 bytes at a time. An invocation copies several vectors, a workgroup apart: their reads are in flight together, and
// neighbouring invocations access neighbouring vectors.

#include "../groups.glsl"

layout(local_size_x = 256) in;

layout(set = 0, binding = 0, std430) readonly buffer From { uvec4 from[]; };
layout(set = 0, binding = 1, std430) writeonly buffer To { uvec4 to[]; };

void main() {
    uint first = group_index() * gl_WorkGroupSize.x * uint(VECTORS_EACH) + gl_LocalInvocationIndex;
    // The number of vectors is a multiple of a workgroup's, so a workgroup copies its whole range or nothing.
    if (first >= uint(VECTORS)) {
        return;
    }
    uvec4 held[VECTORS_EACH];
    for (uint i = 0u; i < uint(VECTORS_EACH); i++) {
        held[i] = from[first + i * gl_WorkGroupSize.x];
    }
    for (uint i = 0u; i < uint(VECTORS_EACH); i++) {
        to[first + i * gl_WorkGroupSize.x] = held[i];
    }
}
