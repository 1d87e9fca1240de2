#version 460
#extension GL_GOOGLE_include_directive : require
#include "hash.glsl"
layout(local_size_x = 64) in;
layout(set = 0, binding = 0, std430) writeonly buffer Keys { uint keys[]; };
void main() {
    keys[gl_GlobalInvocationID.x] = hash(gl_GlobalInvocationID.x);
}
