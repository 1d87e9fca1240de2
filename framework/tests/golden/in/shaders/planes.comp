#version 460
layout(set = 0, binding = 0, std430) readonly buffer Sh { vec4 sh[]; } planes[3];
layout(set = 0, binding = 3, std430) writeonly buffer Out { float o[]; };
void main() { o[0] = planes[0].sh[0].x + planes[1].sh[0].x + planes[2].sh[0].x; }
