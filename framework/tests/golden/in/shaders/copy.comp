#version 460
layout(local_size_x = 64) in;
layout(set = 0, binding = 0, std430) readonly buffer In { uint i[]; };
layout(set = 0, binding = 1, std430) writeonly buffer Out { uint o[]; };
void main() { o[gl_GlobalInvocationID.x] = i[gl_GlobalInvocationID.x]; }
