#version 460
layout(set = 0, binding = 0, std430) buffer Count { uint count[]; };
layout(location = 0) out vec4 color;
void main() { color = vec4(atomicAdd(count[0], 1)); }
