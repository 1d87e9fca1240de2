#version 460
layout(local_size_x = 64) in;
layout(set = 0, binding = 0, std430) readonly buffer In { uint from[]; };
layout(set = 0, binding = 1, std430) writeonly buffer Out { uint to[]; };
void main() {
    to[gl_GlobalInvocationID.x] = from[gl_GlobalInvocationID.x];
}
