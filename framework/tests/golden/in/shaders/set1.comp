#version 460
layout(set = 1, binding = 0, std430) writeonly buffer Out { uint o[]; };
void main() { o[0] = 1; }
