#version 460
layout(set = 0, binding = 0, std140) uniform Camera { mat4 matrices[5]; };
layout(set = 0, binding = 1, std430) writeonly buffer Out { float o[]; };
void main() { o[0] = matrices[0][0].x; }
