#version 460
layout(set = 0, binding = 0, std430) writeonly buffer Out { float o[]; };
layout(push_constant) uniform Push { uint shift; int bias; float scale; vec2 offset; };
void main() { o[0] = float(shift) + float(bias) + scale + offset.x; }
