#version 460
layout(set = 0, binding = 0, std430) readonly buffer Count { uint count[]; };
layout(location = 0) out vec4 color;
void main() { color = vec4(count[0]); }
