#version 460
layout(push_constant) uniform Push { float scale; };
void main() { gl_Position = vec4(scale); }
