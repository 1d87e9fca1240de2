#version 460
layout(set = 0, binding = 0, std430) readonly buffer Count { uint count[]; };
void main() { gl_Position = vec4(count[0]); }
