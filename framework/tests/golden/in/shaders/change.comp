#version 460
layout(local_size_x = 64) in;
layout(set = 0, binding = 0, std430) buffer Out { uint o[]; };
void main() { o[gl_GlobalInvocationID.x] += 1; }
