#version 460
layout(push_constant) uniform Push { uint shift; };
layout(location = 0) out vec4 color;
void main() { color = vec4(shift); }
